"""Errors that say what is wrong, where, and how to correct it; and what names may hold.

What a message repeats from a file is data: control characters steer a terminal and are not allowed
in XML 1.0 (section 2.2), others change the direction of text (Unicode Standard Annex 9), end a
line, or cannot be seen. Messages show all of these escaped; a name that holds one is refused where
it comes in, so that figures, web pages and XML reports need not escape it.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches
from functools import partial, wraps
from inspect import signature
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

LONGEST = 1000  # characters of a name, and of what a message quotes
LONGEST_FIX = 2000  # of advice, which may list names
LONGEST_LIST = 600  # of all names in a list; of more, a few are named
LONGEST_TEXT = 20_000  # of a text of several lines, such as a source
SHOWN = 40


def shown_text(text: str, *, lines: bool = False) -> str:
    r"""Return a text with unsafe characters escaped, ends of lines kept where `lines` says so."""

    def escape_character(match: re.Match[str]) -> str:
        return match[0] if lines and match[0] == "\n" else ascii(match[0])[1:-1]

    return UNSAFE.sub(escape_character, text)


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
        what, where = shown_text(shorten_text(what)), shown_text(shorten_text(where))
        fix = shown_text(shorten_text(fix, LONGEST_FIX))
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
    """Probabilities that do not sum to 1, or of which one is negative or no number."""


class NegativeError(DistributionError):
    """A probability below 0."""


class ShapeError(ModelError):
    """An array whose shape fits no reading."""


class ScenarioWarning(UserWarning):
    """The tables of a scenario, as they are read, state a probability above 1."""


def no_such(what: str, number: object, size: int, *, where: str = "") -> ModelError:
    """Return the error to raise for a number that none of `size` things has."""
    said = f"there is no {what} {number}: numbers go from 0 to {size - 1}"
    return ModelError(said, where=where, fix="choose one of these")


def require_list(given: Iterable[T], what: str) -> list[T]:
    """Return what is listed; raises ModelError for a text or what is no list."""
    if isinstance(given, str) or not isinstance(given, Iterable):
        raise ModelError(f"{given!r} is no list of {what}", where=what, fix="give a list")
    return list(given)


def require_type(value: Any, kind: Any, where: str, fix: str) -> Any:
    """Return a value of a type, or of one of several; raises ModelError for another value."""
    if not isinstance(value, kind):
        raise ModelError(
            f"{shorten_text(repr(value), 80)} is of type {type(value).__name__}",
            where=where,
            fix=fix,
        )
    return value


def once_each(items: Iterable[tuple[T, Any]], label: Callable[[T], str] = str) -> dict[T, Any]:
    """Return what is said of each thing; raises ModelError where it is said twice of one."""
    listed = list(items)
    entries = dict(listed)
    if len(entries) < len(listed):
        twice = Counter(key for key, _ in listed).most_common(1)[0][0]
        raise ModelError(f"{label(twice)} appears twice", fix="keep one of them")
    return entries


def words_of(names: Iterable[object] | None, where: str) -> tuple[str, ...]:
    """Return names as texts; raises ModelError for a text alone, and for what is no list."""
    return () if names is None else tuple(map(str, require_list(names, where)))


@contextmanager
def locate_errors(where: str, *, instead: bool = False) -> Iterator[None]:
    """Put a place in front of that of a ModelError raised inside, or `instead` of it."""
    try:
        yield
    except ModelError as error:
        if error.where.startswith(shown_text(shorten_text(where))):
            raise
        place = f"{where}, {error.where}" if error.where and not instead else where
        raise type(error)(error.what, where=place, fix=error.fix) from error


@contextmanager
def annotate_errors(where: str) -> Iterator[None]:
    """Note the place on an error of the user's own function, which stays what it is."""
    try:
        yield
    except Exception as error:
        error.add_note(f"raised by the model's own function, for {where}")
        raise


def shorten_text(text: str, most: int = LONGEST) -> str:
    """Return a text as it is, or its two ends where it has more than `most` characters."""
    if len(text) <= most:
        return text
    note = f"… ({len(text):,} characters) …"
    length = max(1, (most - len(note)) // 2)
    return f"{text[:length]}{note}{text[-length:]}"


def suggest_name(name: str, known: Iterable[str]) -> str:
    """Return advice that names the known spelling nearest to `name`."""
    options = list(known)
    close = [option for option in options if option.casefold() == str(name).casefold()]
    if close := close or get_close_matches(str(name)[:LONGEST], options, n=1, cutoff=0.6):
        return f"did you mean {close[0]}?"
    every = ", ".join(options)
    if len(options) <= 12 and len(every) <= LONGEST_LIST:
        return f"choose one of {every}"
    few = ", ".join(shorten_text(option, LONGEST_LIST // 6) for option in options[:4])
    return f"choose one of the {len(options)} known names, such as {few}"


def require_known_name(name: object, options: Collection[str], what: str, where: str = "") -> str:
    """Return a name that is one of the options; raises ModelError with the nearest for another."""
    if not isinstance(name, str) or name not in options:
        raise ModelError(
            f"unknown {what} {name!r}", where=where, fix=suggest_name(str(name), options)
        )
    return name


def no_option(name: str, known: Iterable[str], where: str) -> ModelError:
    """Return the error to raise for an option that a function does not have."""
    options = list(known)
    fix = suggest_name(name, options)
    if name in ("gamma", "γ", "discount"):
        fix = "it is the model's: mdp.with_(discount=0.9), MDP.from_gymnasium(env, discount=0.9)"
        fix = "say discount=" if "discount" in options else fix
    if name == "kind" and "policy" in options:
        fix = 'say it with the array: policy=Policy.of(model, array, kind="policy")'
    return ModelError(f"there is no option {name}=", where=where, fix=fix)


def named_options(function: F) -> F:
    """Let a function refuse an option that it does not have as it refuses any bad input."""

    @wraps(function)
    def call_with_known_options(*given: Any, **options: Any) -> Any:
        try:
            return function(*given, **options)
        except TypeError as error:
            for name in options:
                if f"unexpected keyword argument '{name}'" in str(error):
                    known = signature(function).parameters
                    place = function.__qualname__.partition(".")[0]  # of a method, its class
                    raise no_option(name, known, place) from error
            raise

    return cast("F", call_with_known_options)


def check_names(
    names: Iterable[str], what: str, *, where: str = "names", longest: int = LONGEST
) -> None:
    r"""Raise ModelError for a name that is unsafe, too long, no text, or that of two things."""
    listed: list[Any] = list(names)
    for name in listed:
        require_type(name, str, where, f"give the {what} a text as its name")
    if len(set(listed)) < len(listed):
        twice = Counter(listed).most_common(1)[0][0]
        said = f"two {what}s have the same name, {twice[:SHOWN]!r}"
        raise ModelError(said, where=where, fix="give each its own name")
    # One search through all of them: a million states may have a name each.
    if not UNSAFE.search("".join(listed)) and max(map(len, listed), default=0) <= longest:
        return
    for name in listed:
        if len(name) > longest:
            said = f"{what} {name[:SHOWN]!r} has {len(name):,} characters"
            raise ModelError(said, where=where, fix=f"shorten it to {longest:,}")
        if unsafe := UNSAFE.search(name):
            said = f"{what} {name[:SHOWN]!r} holds the character U+{ord(unsafe[0]):04X}"
            fix = "remove it; names are plain text on one line"
            raise ModelError(said, where=where, fix=fix)


@contextmanager
def require_extra(name: str) -> Iterator[None]:
    """Name the extra that brings a package which an import inside does not find."""
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
