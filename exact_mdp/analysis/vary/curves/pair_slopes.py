"""The change of the pairs with one parameter: what derivatives of totals and of averages share.

    c(l) = ∂r(l) + γ Σ_s' ∂P(l, s') V(s') + ∂γ Σ_s' P(l, s') V(s')

is the change of what pair l earns in the next step, with the values V held fixed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from flint import fmpq

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import to_flint
from exact_mdp.mdp.graph import Mask
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.row_change import RowChange
from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.claims import Bounded, Certified

Number = Certified | Bounded
Pass = tuple[Number, Callable[[RowChange, int], Number]]
"""The value at the start, and the derivative on one side of it: 1 the right, -1 the left one."""


def list_slopes(
    mdp: MDP, change: RowChange, kind: Callable[[fmpq], Any], rows: tuple[Integers, Numbers]
) -> tuple[Integers, Numbers, Integers, Numbers]:
    """Return keys and slopes of discounted transitions (P has `rows`), and of rewards."""
    slopes = np.array([*map(kind, change.transition.slope)])
    gains = np.array([*map(kind, change.reward.slope)])
    keys, slopes = change.transition.key, slopes * kind(to_flint(mdp.discount_exact))
    if change.rate[1]:
        keys = np.concatenate([keys, rows[0]])
        slopes = np.concatenate([slopes, rows[1] * kind(change.rate[1])])
    return keys, slopes, change.reward.key, gains


def compute_pair_slopes(
    keys: Integers, slopes: Numbers, gain_keys: Integers, gains: Numbers, value: Numbers, pairs: int
) -> Numbers:
    """Return c(l) (L,) from values (S,)."""
    earned = np.zeros(pairs, dtype=value.dtype)
    pair, following = np.divmod(keys, len(value))
    np.add.at(earned, pair, slopes * value[following])
    np.add.at(earned, gain_keys, gains)
    return earned


class UndecidedInFloats(ModelError):
    """Floats cannot tell which actions are optimal; exact numbers can."""


def make_tie_error(where: str) -> UndecidedInFloats:
    """Return the error for derivatives in floats if several actions may be optimal."""
    return UndecidedInFloats(
        "several actions are optimal, or floats cannot tell them apart",
        where=where,
        fix="ask for exact=True, which gives one-sided derivatives at a tie",
    )


def find_newly_live_states(mdp: MDP, change: RowChange) -> Mask:
    """Return (S,) True for states with a choice that are terminal today, but not nearby."""
    return change.find_states(mdp) & mdp.terminal & ~mdp.forced


def refuse_silence(mdp: MDP, silent: Mask, name: str) -> None:
    """Raise ModelError if the policy held fixed is silent in states (S,) that become live."""
    if silent.any():
        raise ModelError(
            "the policy held fixed names no action in a state that is terminal today, but not for "
            "nearby values of the parameter",
            where=f"parameter {name}, {mdp.space.place(int(silent.argmax()))}",
            fix="give an action there, too, by a mapping or an array over all states",
        )
