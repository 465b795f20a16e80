"""TOML and JSON that come from outside, through one door with limits.

A number of over 4,000 digits, tables nested more than 100 deep and what the syntax does not allow
are refused here, by name, so that nothing behind the door meets them: Python converts no integer of
over 4,300 digits to text, and ends a recursion after about a thousand calls.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Callable
from typing import Any

from exact_mdp.mdp.errors import ModelError, located, short
from exact_mdp.mdp.table import MOST_DIGITS, exact

DEEPEST = 100  # tables and lists within each other; the deepest file that is read has five


def toml_of(text: str, where: str, *, number: Callable[[str], Any] = exact) -> dict[str, Any]:
    r"""Return the content of a TOML text; `where` is the file, `number` reads decimal numbers."""
    try:
        with located(where, instead=True):
            content = tomllib.loads(text, parse_float=number)
    except ModelError:
        raise
    except RecursionError as error:
        raise _too_deep(where) from error
    except ValueError as error:
        raise ModelError(
            f"broken TOML: {short(str(error), 200)}", where=where, fix="correct that place"
        ) from error
    _check(content, where)
    return content


def json_of(text: str | bytes, where: str, **hooks: Any) -> Any:
    """Return the content of a JSON text; `hooks` are those of `json.loads`.

    Examples
    --------
    >>> json_of('{"0000": "none"}', "policy.json")
    {'0000': 'none'}
    """
    try:
        content = json.loads(text, **hooks)
    except ModelError:
        raise
    except RecursionError as error:
        raise _too_deep(where) from error
    except ValueError as error:
        said = "an integer of over 4,000 digits" if "string conversion" in str(error) else error
        raise ModelError(
            f"broken JSON: {short(str(said), 200)}", where=where, fix="correct that place"
        ) from error
    _check(content, where)
    return content


def _check(content: Any, where: str) -> None:
    """Refuse what is too deep or too long, without a recursion."""
    left: list[tuple[tuple[str, ...], Any]] = [((), content)]
    while left:
        path, value = left.pop()
        if len(path) > DEEPEST:
            raise _too_deep(f"{where}, {'.'.join(path)}")
        if isinstance(value, dict):
            left += [((*path, str(key)), below) for key, below in value.items()]
        elif isinstance(value, list):
            left += [((*path, str(place)), below) for place, below in enumerate(value)]
        elif isinstance(value, int) and abs(value) >= 10**MOST_DIGITS:
            name = ".".join(path)
            raise ModelError(
                f"an integer of over {MOST_DIGITS:,} digits",
                where=f"{where}, {name}" if name else where,
                fix="round it",
            )


def _too_deep(where: str) -> ModelError:
    return ModelError(
        f"tables or lists are nested more than {DEEPEST} deep", where=where, fix="use fewer levels"
    )
