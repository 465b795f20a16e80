"""What every answer owes to the exact one: it is no further away than its own error."""

import warnings
from collections.abc import Callable, Iterable
from fractions import Fraction as F
from typing import Any

import numpy as np

from exact_mdp import Bounded


def quietly(ask: Callable[..., Any], *given: Any, **more: Any) -> Any:
    """The answer, without a warning that a tolerance was not reached."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return ask(*given, **more)


def errors_of(answer: Any) -> list[F]:
    """The error of each value: 0 where they are certified."""
    if answer.claim == "certified":
        return [F(0)] * len(answer.value)
    error = answer.error if hasattr(answer, "error") else answer.error_bound
    return [*map(F, np.broadcast_to(error, len(answer.value)).tolist())]


def near(values: Iterable[Any], errors: Iterable[Any], exact: Iterable[Any]) -> None:
    """Infinite values are said, and the others are no further away than their errors."""
    for value, error, right in zip(values, errors, exact, strict=True):
        assert value == right or abs(F(value) - right) <= F(error)


def holds(answer: Any, exact: Iterable[Any]) -> None:
    near(answer.value, errors_of(answer), exact)


def within(number: Bounded, exact: F) -> bool:
    return abs(F(number.value) - exact) <= F(number.error)


def agree(one: Any, other: Any) -> bool:
    """Whether two bounded answers may be of the same values."""
    return bool((np.abs(one.value - other.value) <= one.error + other.error).all())
