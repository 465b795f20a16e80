"""Published models with known answers, in exact rationals; they import nothing of the project."""

from . import checkers, gambling, gridworlds, handwashing, puterman, small
from .case import Case

CASES: tuple[Case, ...] = (
    *puterman.CASES,
    *small.CASES,
    *gridworlds.CASES,
    *gambling.CASES,
    *checkers.CASES,
    *handwashing.CASES,
)
BY_NAME: dict[str, Case] = {case.name: case for case in CASES}

__all__ = ["BY_NAME", "CASES", "Case"]
