"""Two-sided bounds on robust values around any vector V, sound in floating point.

T is the robust Bellman operator: nature's optimum σ_l over the laws of each row, and over the pairs
of a state their maximum, their minimum, or the mean under a policy. Let w be positive but for
terminal states, and let every row leave a margin against the worst law for it,

    m(s) = w(s) - γ max over the pairs l of s, and the laws q of l, of Σ q w  > 0.

As σ_l(V + c w) ≤ σ_l(V) + c γ max Σ q w for c ≥ 0, with nature on either side,

    T V - V ≤ c m  gives  V* ≤ V + c w        (c ≥ 0),
    T V - V ≥ c m  gives  V* ≥ V + c w        (c ≤ 0),

V* the fixed point of T, unique because T is a contraction in the norm weighted by w. A margin thus
proves that episodes end under every policy and every choice of nature. The weights are the greatest
expected discounted number of steps, nature siding with delay: by level where the model is acyclic,
1 where γ < 1, by policy iteration where γ = 1. This is the argument of `solvers.bounds.bounds`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.bounds.gains import SLACK, UNIT
from exact_mdp.solvers.bounds.linear import LinearSystem
from exact_mdp.solvers.robust.sets import Ambiguity, Block, Inner, blocks_of, entries, inner
from exact_mdp.solvers.solution import SolverError, Status

WEIGHT_ITERATIONS = 200


@dataclass(frozen=True, kw_only=True, eq=False)
class Game:
    """Who chooses what: a model, nature's sets, nature's side, and the agent's.

    Attributes
    ----------
    against : bool
        True where nature makes the values of rows as low as it can.
    most : bool
        True where the agent takes the best pair, False where the least.
    weights : (L,), optional
        Probability of each pair, where the agent's policy is fixed.
    """

    mdp: MDP
    ambiguity: Ambiguity
    against: bool
    most: bool = True
    weights: Floats | None = None

    @cached_property
    def pairs(self) -> Integers:
        """(U,) the pairs that count: of states that are not terminal, and taken by the policy."""
        taken = ~self.mdp.terminal[self.mdp.pair_state]
        if self.weights is not None:
            taken &= self.weights > 0
        return np.flatnonzero(taken)

    @cached_property
    def live(self) -> Integers:
        """(T,) the states that are not terminal."""
        return np.flatnonzero(~self.mdp.terminal)

    @cached_property
    def first(self) -> Integers:
        """(T,) the first position in `pairs` of each of these states."""
        return np.searchsorted(self.mdp.pair_state[self.pairs], self.live)

    @cached_property
    def blocks(self) -> list[Block]:
        """The rows of `pairs`."""
        return blocks_of(self.mdp, self.pairs)

    @cached_property
    def share(self) -> Floats:
        """(U,) probability of each pair under the fixed policy."""
        assert self.weights is not None
        share = self.weights[self.pairs]
        return np.asarray(share / np.add.reduceat(share, self.first)[self.row_state])

    @cached_property
    def row_state(self) -> Integers:
        """(U,) position in `live` of the state of each pair."""
        return np.searchsorted(self.live, self.mdp.pair_state[self.pairs])

    @cached_property
    def order(self) -> Integers | None:
        """(S,) levels where the model is acyclic, whatever nature does; None where it is not."""
        return levels(self.mdp)

    def ask(self, value: Floats, *, delay: bool = False) -> Inner:
        """Return what nature makes of each of `pairs`, at values (S,).

        With `delay` both sides are after steps: nature makes rows as valuable as it can, without
        their rewards.
        """
        return inner(
            self.ambiguity,
            self.blocks,
            value,
            discount=self.mdp.discount,
            against=self.against and not delay,
            rewards=not delay,
        )

    def agent(self, q: Floats, *, delay: bool = False) -> Floats:
        """Return (T,) what the agent makes of pair values (U,)."""
        if self.weights is not None:
            return np.asarray(np.add.reduceat(self.share * q, self.first))
        best = np.maximum if self.most or delay else np.minimum
        return np.asarray(best.reduceat(q, self.first))

    def choice(self, q: Floats, *, delay: bool = False) -> Integers:
        """Return (T,) the first position in `pairs` with the best value of each state."""
        best = self.agent(q, delay=delay)
        number = np.where(q == best[self.row_state], np.arange(len(q)), len(q))
        return np.minimum.reduceat(number, self.first)

    def chain(self, laws: list[Floats], chosen: Integers | None) -> tuple[sp.csr_array, Floats]:
        """Return transitions (S, S) and expected rewards (S,) under laws, a pair in each state."""
        mdp = self.mdp
        mask = None
        if chosen is not None:
            mask = np.zeros(len(self.pairs), dtype=bool)
            mask[chosen] = True
        place, following, probability, earned = entries(self.blocks, laws, mask)
        if chosen is None:
            probability, earned = probability * self.share[place], earned * self.share
        source = self.live[self.row_state]
        shape = (mdp.n_states, mdp.n_states)
        matrix = sp.csr_array((probability, (source[place], following)), shape)
        total = np.bincount(source, weights=earned, minlength=mdp.n_states)
        return matrix, np.asarray(total, dtype=np.float64)


@dataclass(frozen=True, kw_only=True, eq=False)
class Margins:
    """Weights w (S,), and margins m (T,) of the states that are not terminal, rounded down."""

    weight: Floats
    margin: Floats


def margins(game: Game) -> Margins:
    """Return verified margins.

    Raises ModelError where some policy and some laws never end at discount 1, SolverError where
    double precision does not suffice.
    """
    mdp, rate, order = game.mdp, game.mdp.discount, game.order
    live = ~mdp.terminal
    if rate == 0 or (order is None and rate < 1):
        weight = live.astype(np.float64)
    elif order is None:
        weight = _longest(game)
    elif rate == 1:
        weight = order.astype(np.float64)
    else:
        weight = np.asarray(-np.expm1(order * np.log(rate)) / (1 - rate))
    found = game.ask(weight, delay=True)
    later = np.maximum.reduceat(found.high, game.first) if len(game.live) else found.high
    margin = (weight[game.live] - later) * (1 - 4 * UNIT)
    if not np.all(margin > 0):
        raise SolverError(Status.NO_BOUND, "no margin against the worst laws can be verified")
    return Margins(weight=weight, margin=np.asarray(margin))


def _longest(game: Game) -> Floats:
    """Return about the greatest expected number of steps, by policy iteration on both choices."""
    live = ~game.mdp.terminal
    weight = live.astype(np.float64)
    for iteration in range(WEIGHT_ITERATIONS):
        found = game.ask(weight, delay=True)
        chosen = None if game.weights is not None else game.choice(found.value, delay=True)
        gain = 1 + game.agent(found.value, delay=True) - weight[game.live]
        # What adds less than half a step leaves a margin of over a half.
        if iteration and gain.max(initial=0.0) < 0.5:
            return weight
        chain, _earned = game.chain(found.laws, chosen)
        _refuse_endless(game.mdp, chain)
        weight = LinearSystem(chain).approximate(live.astype(np.float64))
        if not np.all(np.isfinite(weight)):
            break
    raise SolverError(Status.NO_BOUND, "the end is too many steps away under the worst laws")


def _refuse_endless(mdp: MDP, chain: sp.csr_array) -> None:
    """Raise ModelError where the chain has states from which the end cannot be reached."""
    seen, back = mdp.terminal.copy(), chain.T.tocsr()
    frontier = np.flatnonzero(seen)
    while len(frontier):
        into = np.unique(back[frontier].indices)
        frontier = into[~seen[into]]
        seen[frontier] = True
    if not seen.all():
        stuck = np.flatnonzero(~seen)
        named = ", ".join(f"({mdp.space.label(state)})" for state in stuck[:4].tolist())
        more = f" and {len(stuck) - 4} more" if len(stuck) > 4 else ""
        raise ModelError(
            "discount 1 needs every episode to end, and under laws within the sets one does not",
            where=f"it stays for ever among {named}{more}",
            fix="choose a discount below 1, or smaller sets that keep a way out possible",
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class RobustBounds:
    """value + low · weight ≤ V* ≤ value + high · weight, low ≤ 0 ≤ high.

    The policy of `chosen` has no less than value + kept · weight where the agent maximises, no more
    where it minimises.

    Attributes
    ----------
    value, weight : (S,)
    low, high, kept : float
    chosen : (T,) positions in the game's pairs, or None where the policy is fixed
    asked : Inner
    """

    value: Floats
    weight: Floats
    asked: Inner
    chosen: Integers | None = None
    low: float = 0.0
    high: float = 0.0
    kept: float = 0.0

    @property
    def error(self) -> float:
        """|value - V*| and |value - V of the policy| are at most this times `weight`."""
        return max(-self.low, self.high, abs(self.kept))


def robust_bounds(game: Game, found: Margins, value: Floats) -> RobustBounds:
    """Return bounds on the robust value around `value` (S,), 0 in terminal states."""
    asked, here = game.ask(value), value[game.live]
    chosen = None if game.weights is not None else game.choice(asked.value)
    if not len(here):
        return RobustBounds(value=value, weight=found.weight, asked=asked, chosen=chosen)
    # What rounds here: the mean over pairs, and the difference from the value.
    size = np.abs(here) + np.maximum.reduceat(np.abs(asked.value), game.first)
    doubt = 4 * UNIT * size
    if game.weights is not None:
        most = np.diff(np.append(game.first, len(asked.value))).max()
        doubt = doubt * (1 + float(most))
    rise = float(((game.agent(asked.high) - here + doubt) / found.margin).max())
    fall = float(((game.agent(asked.low) - here - doubt) / found.margin).min())
    kept = 0.0
    if chosen is not None:
        side = asked.low if game.most else asked.high
        reached = (side[chosen] - here - (doubt if game.most else -doubt)) / found.margin
        kept = min(float(reached.min()), 0.0) if game.most else max(float(reached.max()), 0.0)
    low, high = min(fall, 0.0), max(rise, 0.0)
    if not np.isfinite(high - low):
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
    return RobustBounds(
        value=value,
        weight=found.weight,
        asked=asked,
        chosen=chosen,
        low=low * SLACK,
        high=high * SLACK,
        kept=kept * SLACK,
    )
