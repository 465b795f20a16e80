"""What every answer owes to the exact one: it is no further away than its own error."""

import warnings
from collections.abc import Callable, Iterable
from fractions import Fraction as F
from typing import Any

import numpy as np

from exact_mdp import SOLVERS, Bounded

# Solvers that take a million cheap sweeps on chains that mix slowly, unless they are stopped.
SWEEPING = [name for name, kind in SOLVERS.items() if getattr(kind, "max_iterations", 0) >= 10**6]
assert SWEEPING == ["value-iteration", "gauss-seidel"]


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
    floats = np.broadcast_to(error, len(answer.value)).tolist()
    exact = {number: F(number) for number in {*floats}}
    return [exact[number] for number in floats]


def near(values: Iterable[Any], errors: Iterable[Any], exact: Iterable[Any]) -> None:
    """Infinite values are said, and the others are no further away than their errors."""
    given = list(zip(values, errors, exact, strict=True))
    # Copies of a model share these objects: what is the same three times is looked at once.
    different = {
        (value, id(error), id(right)): (value, error, right) for value, error, right in given
    }
    for value, error, right in different.values():
        assert value == right or abs(F(value) - right) <= F(error)


def holds(answer: Any, exact: Iterable[Any]) -> None:
    near(answer.value, errors_of(answer), exact)


def within(number: Bounded, exact: F) -> bool:
    return abs(F(number.value) - exact) <= F(number.error)


def agree(one: Any, other: Any) -> bool:
    """Whether two bounded answers may be of the same values."""
    return bool((np.abs(one.value - other.value) <= one.error + other.error).all())
