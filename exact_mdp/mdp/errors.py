"""Errors that say what is wrong, where, and how to correct it; and the rules for names.

A message may quote text from a file, and that text is not trusted: control characters steer a
terminal and are not allowed in XML 1.0 (section 2.2), others change the direction of text (Unicode
Standard Annex 9), end a line, or cannot be seen. Messages show all of these escaped. A name that
contains one is refused when it is read, so figures, web pages and XML reports need not escape it.
"""

from __future__ import annotations

import re
import warnings
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from functools import partial, wraps
from inspect import currentframe, signature
from itertools import islice
from typing import Any, TypeVar, cast

CONTROL = "\\x00-\\x1f\\x7f-\\x9f"
SEPARATORS = "\\u2028\\u2029"
SURROGATES = "\\ud800-\\udfff"
DIRECTIONS = "\\u061c\\u200e\\u200f\\u202a-\\u202e\\u2066-\\u206f"
INVISIBLE = "\\u200b\\u2060-\\u2064\\ufeff"
NEVER_CHARACTERS = "\\ufffe\\uffff"
UNSAFE = re.compile(f"[{CONTROL}{SEPARATORS}{SURROGATES}{DIRECTIONS}{INVISIBLE}{NEVER_CHARACTERS}]")

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

# Characters allowed in a name, and in a passage that a message quotes. A longer limit would let one
# bad file fill the terminal; a shorter one would cut names that people use.
LONGEST = 1000

FEW_NAMED = 4  # states, actions or other names that a sentence lists
JSON_FORMAT = 2  # of reports and errors: it changes if a key changes its meaning or is removed


def shown_text(text: str, *, lines: bool = False) -> str:
    r"""Return a text with unsafe characters escaped; `lines` keeps the ends of lines."""

    def escape_character(match: re.Match[str]) -> str:
        if lines and match[0] == "\n":
            return "\n"
        return ascii(match[0])[1:-1]

    return UNSAFE.sub(escape_character, text)


class ModelError(ValueError):
    """A model, policy or file that cannot be used as it is.

    Parameters
    ----------
    what : str
        What is wrong, including the offending number.
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
        what, where = shown_text(shorten_text(what)), shown_text(shorten_text(where))
        fix = shown_text(shorten_text(fix, 2 * LONGEST))  # advice may list names
        self.what, self.where, self.fix = what, where, fix
        lines = [what]
        if where:
            lines.append(f"  where: {where}")
        if fix:
            lines.append(f"  fix:   {fix}")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[object, ...]:
        return partial(type(self), where=self.where, fix=self.fix), (self.what,)


class DistributionError(ModelError):
    """Probabilities that do not sum to 1, or one that is negative or not a number."""


class NegativeError(DistributionError):
    """A probability below 0."""


class ShapeError(ModelError):
    """An array with a shape that cannot be interpreted."""


class ScenarioWarning(UserWarning):
    """The tables of a scenario imply a probability above 1."""


def no_such(what: str, number: object, size: int, *, where: str = "") -> ModelError:
    """Return the error for a number outside 0 … size-1."""
    said = f"there is no {what} {number}: numbers go from 0 to {size - 1}"
    return ModelError(said, where=where, fix="choose one of these")


def require_list(given: Iterable[T], what: str) -> list[T]:
    """Return the items as a list; raise ModelError for a string or a non-iterable."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise ModelError(f"{given!r} is not a list of {what}", where=what, fix="give a list")
    return list(given)


def require_type(value: Any, kind: Any, where: str, fix: str) -> Any:
    """Return the value if it has the type `kind` (or one of several); else raise ModelError."""
    if not isinstance(value, kind):
        raise wrong_type(value, where, fix)
    return value


def wrong_type(value: object, where: str, fix: str) -> ModelError:
    """Return the error for a value of a wrong type."""
    what = f"{shorten_text(repr(value), 80)} is of type {type(value).__name__}"
    return ModelError(what, where=where, fix=fix)


def once_each(items: Iterable[tuple[T, Any]], label: Callable[[T], str] = str) -> dict[T, Any]:
    """Return the items as a dictionary; raise ModelError if a key appears twice."""
    listed = list(items)
    entries = dict(listed)
    if len(entries) < len(listed):
        twice = Counter(key for key, _ in listed).most_common(1)[0][0]
        raise ModelError(f"{label(twice)} appears twice", fix="keep one of them")
    return entries


def words_of(names: Iterable[object] | None, where: str) -> tuple[str, ...]:
    """Return names as a tuple of strings; raise ModelError if they are not a list."""
    if names is None:
        return ()
    return tuple(map(str, require_list(names, where)))


@contextmanager
def locate_errors(where: str, *, instead: bool = False) -> Iterator[None]:
    """Prefix the place of a ModelError raised inside with `where`; `instead` replaces it."""
    try:
        yield
    except ModelError as error:
        if error.where.startswith(shown_text(shorten_text(where))):
            raise
        place = where
        if error.where and not instead:
            place = f"{where}, {error.where}"
        raise type(error)(error.what, where=place, fix=error.fix) from error


@contextmanager
def annotate_errors(where: str) -> Iterator[None]:
    """Add a note that says where a user's function failed; the exception itself is unchanged."""
    try:
        yield
    except Exception as error:
        error.add_note(f"raised by the model's own function, for {where}")
        raise


def shorten_text(text: str, most: int = LONGEST) -> str:
    """Return the text, or only its beginning and end if it has more than `most` characters."""
    if len(text) <= most:
        return text
    note = f"… ({len(text):,} characters) …"
    length = max(1, (most - len(note)) // 2)
    return f"{text[:length]}{note}{text[-length:]}"


def join_few(
    texts: Iterable[object], count: int, between: str = ", ", *, most: int = FEW_NAMED
) -> str:
    """Return the first few of `count` texts, and how many more there are.

    >>> join_few("abcdef", 6), join_few("abcdef", 6, "; "), join_few("ab", 2)
    ('a, b, c, d and 2 more', 'a; b; c; d; 2 more', 'a, b')
    """
    said = between.join(map(str, islice(texts, most)))
    if count <= most:
        return said
    last = between
    if between == ", ":
        last = " and "
    return f"{said}{last}{count - most:,} more"


def suggest_name(name: str, known: Iterable[str]) -> str:
    """Return advice that suggests the known name most like `name`, or lists known names."""
    options = list(known)
    # A name that differs in capitals only is meant, even if another one looks more alike.
    close = [option for option in options if option.casefold() == str(name).casefold()]
    if not close:
        close = get_close_matches(str(name)[:LONGEST], options, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]}?"
    # A short list is printed in full; from a long one four names serve as examples.
    every = ", ".join(options)
    if len(options) <= 12 and len(every) <= 600:
        return f"choose one of {every}"
    few = ", ".join(shorten_text(option, 100) for option in options[:4])
    return f"choose one of the {len(options)} known names, such as {few}"


def require_known_name(name: object, options: Collection[str], what: str, where: str = "") -> str:
    """Return the name if it is one of the options; else raise ModelError with a suggestion."""
    if not isinstance(name, str) or name not in options:
        raise ModelError(
            f"unknown {what} {name!r}", where=where, fix=suggest_name(str(name), options)
        )
    return name


def no_option(name: str, known: Iterable[str], where: str) -> ModelError:
    """Return the error for an option that a function does not have."""
    options = list(known)
    fix = suggest_name(name, options)
    # Two mistakes are so common that they get advice of their own.
    if name in ("gamma", "γ", "discount"):
        fix = "it is the model's: mdp.with_(discount=0.9), MDP.from_gymnasium(env, discount=0.9)"
        if "discount" in options:
            fix = "say discount="
    if name == "kind" and "policy" in options:
        fix = 'say it with the array: policy=Policy.of(model, array, kind="policy")'
    return ModelError(f"there is no option {name}=", where=where, fix=fix)


def named_options(function: F) -> F:
    """Turn an unexpected keyword into a ModelError that suggests the right name."""

    @wraps(function)
    def call_with_known_options(*given: Any, **options: Any) -> Any:
        try:
            return function(*given, **options)
        except TypeError as error:
            for name in options:
                if f"unexpected keyword argument '{name}'" in str(error):
                    known = signature(function).parameters
                    place = function.__qualname__.partition(".")[0]  # the class of a method
                    raise no_option(name, known, place) from error
            raise

    return cast("F", call_with_known_options)


def check_names(
    names: Iterable[str], what: str, *, where: str = "names", longest: int = LONGEST
) -> None:
    r"""Raise ModelError for a name that is unsafe, too long, used twice, or not a string."""
    listed: list[Any] = list(names)
    for name in listed:
        if not isinstance(name, str):
            raise wrong_type(name, where, f"give the {what} a text as its name")
    if len(set(listed)) < len(listed):
        twice = Counter(listed).most_common(1)[0][0]
        said = f"two {what}s have the same name, {twice[:40]!r}"
        raise ModelError(said, where=where, fix="give each its own name")
    # All names are searched at once: a model may have a million of them.
    if not UNSAFE.search("".join(listed)) and max(map(len, listed), default=0) <= longest:
        return
    for name in listed:
        if len(name) > longest:
            said = f"{what} {name[:40]!r} has {len(name):,} characters"
            raise ModelError(said, where=where, fix=f"shorten it to {longest:,}")
        unsafe = UNSAFE.search(name)
        if unsafe:
            said = f"{what} {name[:40]!r} contains the character U+{ord(unsafe[0]):04X}"
            fix = "remove it; names are plain text on one line"
            raise ModelError(said, where=where, fix=fix)


def warn_user(message: str, category: type[Warning] = UserWarning) -> None:
    """Warn about the line of the user that called this package."""
    frame, count = currentframe(), 0
    # A context that decorates a function has a frame of its own.
    while frame and frame.f_globals.get("__name__", "").split(".")[0] in (
        "exact_mdp",
        "contextlib",
    ):
        frame, count = frame.f_back, count + 1
    warnings.warn(message, category, stacklevel=count + 1)


@contextmanager
def require_extra(name: str) -> Iterator[None]:
    """Turn a failed import inside into a ModelError that names the extra to install."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing == "exact_mdp":
            raise
        raise ModelError(
            f"the package {missing} is not installed",
            fix=f'install it: pip install "exact-mdp[{name}]"',
        ) from None
