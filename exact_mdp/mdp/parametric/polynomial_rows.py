"""The rows of a model as polynomials of one parameter, already discounted.

    r(l; y) = Σ_k r_k(l) y^k,     p(l, s'; y) = γ(y) Σ_k P_k(l, s') y^k,     y = θ - θ0

of the pairs of states that are not terminal (`.row_change` finds the coefficients). FLINT's
rationals and polynomials of rationals are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import flint

from exact_mdp.mdp.exact import rational
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.row_change import (
    Change,
    Entries,
    RowChange,
    reward_entries,
    transition_entries,
)

if TYPE_CHECKING:
    from flint import fmpq, fmpq_poly


@dataclass(frozen=True, kw_only=True, eq=False)
class PolynomialRows:
    """The rows on one piece of a parameter, of S states and L pairs."""

    mdp: MDP  # at θ0
    change: RowChange
    rate: fmpq_poly  # the discount
    terminal: list[bool]  # states in which nothing happens, whatever the parameter
    reward: list[fmpq_poly]
    # Discounted probabilities of states that are not terminal; none of terminal states.
    following: list[list[tuple[int, fmpq_poly]]]
    # Probabilities that change, not discounted, those of terminal states included.
    moving: list[fmpq_poly]

    @classmethod
    def of(cls, mdp: MDP, change: RowChange) -> PolynomialRows:
        """Return the rows around the model at the value from which they change."""
        poly = flint.fmpq_poly
        rate = poly([rational(mdp.discount_exact), *map(rational, change.rate)])
        # A state that is left, or earns, next to θ0 is terminal at that very value alone.
        ends = mdp.terminal.copy()
        ends[mdp.pair_state[change.reward.key]] = False
        ends[mdp.pair_state[change.transition.key // mdp.n_states]] = False
        terminal: list[bool] = ends.tolist()
        reward: list[fmpq_poly] = [poly([r]) for r in ratios(reward_entries(mdp))]
        for pair, moved in _polynomials(change.reward):
            reward[pair] += moved
        entries = transition_entries(mdp)
        weight: dict[int, fmpq_poly] = {
            key: poly([p]) for key, p in zip(entries[0].tolist(), ratios(entries), strict=True)
        }
        for key, moved in _polynomials(change.transition):
            weight[key] = weight.get(key, poly()) + moved
        moving = [weight[key] for key in change.transition.key.tolist()]
        following: list[list[tuple[int, fmpq_poly]]] = [[] for _ in reward]
        for key, p in sorted(weight.items()):
            pair, state = divmod(key, mdp.n_states)
            if not terminal[mdp.pair_state[pair]] and not terminal[state]:
                following[pair].append((state, p * rate))
        return cls(
            mdp=mdp,
            change=change,
            rate=rate,
            terminal=terminal,
            reward=reward,
            following=following,
            moving=moving,
        )


def _polynomials(change: Change) -> list[tuple[int, fmpq_poly]]:
    """Return what is added to each entry that moves, by its key."""
    columns = zip(*change.coefficients, strict=True)
    moved = [flint.fmpq_poly([flint.fmpq(0), *map(rational, column)]) for column in columns]
    return list(zip(change.key.tolist(), moved, strict=True))


def ratios(entries: Entries) -> list[fmpq]:
    """Return the numbers of a matrix's entries."""
    _, top, bottom = entries
    return [flint.fmpq(int(a), int(b)) for a, b in zip(top, bottom, strict=True)]
