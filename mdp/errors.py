"""Errors that say what is wrong, where, and how to correct it.

What a message repeats from a file or a command line is data. Control characters steer a terminal
and are not allowed in XML 1.0 (section 2.2); others change the direction of the text around them
(Unicode Standard Annex 9), end a line, or cannot be seen. Messages show all of these escaped.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches

CONTROL = "\\x00-\\x1f\\x7f-\\x9f"
SEPARATORS = "\\u2028\\u2029"
SURROGATES = "\\ud800-\\udfff"
DIRECTIONS = "\\u061c\\u200e\\u200f\\u202a-\\u202e\\u2066-\\u206f"
INVISIBLE = "\\u200b\\u2060-\\u2064\\ufeff"
NEVER_CHARACTERS = "\\ufffe\\uffff"

UNSAFE = re.compile(f"[{CONTROL}{SEPARATORS}{SURROGATES}{DIRECTIONS}{INVISIBLE}{NEVER_CHARACTERS}]")
"""Characters that no name may hold, and that are escaped where a text is only shown."""


def shown_text(text: str, *, lines: bool = False) -> str:
    r"""Return a text with every character escaped that a terminal or XML could stumble over.

    Parameters
    ----------
    text : str
    lines : bool
        Keep the ends of lines.

    Returns
    -------
    str

    Examples
    --------
    >>> print(shown_text("a" + chr(27) + "[31mb" + chr(0x202E)))
    a\x1b[31mb\u202e
    >>> print(shown_text("two" + chr(10) + "lines"))
    two\nlines
    """

    def escaped(found: re.Match[str]) -> str:
        return found[0] if lines and found[0] == "\n" else ascii(found[0])[1:-1]

    return UNSAFE.sub(escaped, text)


LONGEST = 1000  # characters of what a message quotes


class ModelError(ValueError):
    """A model, policy or file that cannot be used as it is.

    Parameters
    ----------
    what : str
        What is wrong, with the offending number in it.
    where : str, optional
        The state, action, file or key at fault.
    fix : str, optional
        What the user can do about it.

    Examples
    --------
    >>> print(ModelError("discount is 2, outside [0, 1]", where="MDP", fix="choose a smaller one"))
    discount is 2, outside [0, 1]
      where: MDP
      fix:   choose a smaller one
    """

    def __init__(self, what: str, *, where: str = "", fix: str = "") -> None:
        what, where, fix = shown_text(short(what)), shown_text(short(where)), shown_text(fix)
        self.what, self.where, self.fix = what, where, fix
        lines = [what]
        if where:
            lines.append(f"  where: {where}")
        if fix:
            lines.append(f"  fix:   {fix}")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.what, self.where, self.fix)


class ScenarioWarning(UserWarning):
    """The tables of a scenario, as they are read, state what is no probability: more than 1."""


def _rebuild(kind: type[ModelError], what: str, where: str, fix: str) -> ModelError:
    return kind(what, where=where, fix=fix)


def short(text: str, most: int = LONGEST) -> str:
    """Return a text as it is, or its two ends where it has more than `most` characters.

    Examples
    --------
    >>> short("1" * 9000, most=40)
    '111111111… (9,000 characters) …111111111'
    """
    if len(text) <= most:
        return text
    note = f"… ({len(text):,} characters) …"
    kept = max(1, (most - len(note)) // 2)
    return f"{text[:kept]}{note}{text[-kept:]}"


def suggest(name: str, known: Iterable[str]) -> str:
    """Return advice that names the known spelling nearest to `name`.

    Examples
    --------
    >>> suggest("base.angre", ["base.anger", "base.confusion"])
    'did you mean base.anger?'
    >>> suggest("x", ["a", "b"])
    'choose one of a, b'
    """
    options = list(known)
    close = get_close_matches(name[:LONGEST], options, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]}?"
    if len(options) <= 12:
        return f"choose one of {', '.join(options)}"
    return f"choose one of the {len(options)} known names, such as {', '.join(options[:4])}"
