"""What the names of a model may hold: one rule for every reader and every constructor.

Names of states, actions, columns, components, events, statuses and parameters reach terminals,
figures, web pages and XML reports. A name that steers the terminal, turns the text around it or
looks like another one is refused where it comes in, so that nothing behind has to escape it.
"""

from __future__ import annotations

from collections.abc import Iterable

from mdp.errors import UNSAFE, ModelError, shown_text

LONGEST = 1000
LONGEST_TEXT = 20_000
"""Characters of a name, and of a text of several lines such as a source."""
SHOWN = 40


def check_names(names: Iterable[str], what: str, *, where: str = "") -> None:
    """Raise ModelError where a name holds a character that is not one to read, or is too long.

    Parameters
    ----------
    names : iterable of str
    what : str
        What they are names of, such as "action".
    where : str, optional
        The file or part of the model; "names" where it is left out.

    Raises
    ------
    ModelError
        For control characters, ends of lines, characters that change the direction of text,
        invisible ones, halves of surrogate pairs, and names of over 1,000 characters.

    Examples
    --------
    >>> check_names(["größer", "<b>", "$x$", "مساعدة"], "action")
    >>> check_names(["stay", "go" + chr(0x202E)], "action")
    Traceback (most recent call last):
    ...
    mdp.errors.ModelError: the name of an action holds the character U+202E: go\\u202e
      where: names
      fix:   remove it; names are plain text on one line
    """
    listed = list(names)
    for name in listed:
        if not isinstance(name, str):
            raise ModelError(
                f"the name of {_a(what)} is {_short(repr(name))}, not a text",
                where=where or "names",
                fix="give a text",
            )
    # One search through all of them: a million states may have a name each.
    if not UNSAFE.search("".join(listed)) and max(map(len, listed), default=0) <= LONGEST:
        return
    for name in listed:
        _check(name, f"the name of {_a(what)}", where or "names")


def check_text(text: str, what: str, *, where: str = "") -> None:
    """Raise ModelError as `check_names` does, of a text that may have several lines.

    Parameters
    ----------
    text : str
    what : str
        What it is, such as "source".
    where : str, optional

    Raises
    ------
    ModelError
        As for names, with 20,000 characters; ends of lines and tabs are allowed.

    Examples
    --------
    >>> check_text("Yuan et al. (2025)" + chr(10) + "Table 3", "source")
    """
    _check(
        text.replace("\n", "").replace("\t", ""), f"the {what}", where or what, longest=LONGEST_TEXT
    )


def _check(name: str, what: str, where: str, longest: int = LONGEST) -> None:
    if len(name) > longest:
        raise ModelError(
            f"{what} has {len(name):,} characters: {_short(name)}",
            where=where,
            fix=f"shorten it to {longest:,}",
        )
    found = UNSAFE.search(name)
    if found:
        raise ModelError(
            f"{what} holds the character U+{ord(found[0]):04X}: {_short(name)}",
            where=where,
            fix="remove it; names are plain text on one line",
        )


def _short(name: str) -> str:
    return shown_text(name[:SHOWN]) + ("…" if len(name) > SHOWN else "")


def _a(noun: str) -> str:
    return f"{'an' if noun[0] in 'aeiou' else 'a'} {noun}"
