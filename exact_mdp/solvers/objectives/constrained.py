"""The optimum under limits on expected totals, exactly: a constrained Markov decision process.

    maximise  r(π)   subject to   c_k(π) ≥ b_k,  k = 1 … m,     over all policies π

The totals of policies are the convex hull of those of deterministic ones, so that this is a linear
program over mixtures. Its columns are deterministic policies, found as they are needed: with the
prices λ of the limits in the mixtures known so far, the model is solved for r + λ c; a policy that
is worth more than the prices say is a new column, and where none is, the mixture is optimal
(Dantzig and Wolfe, Operations Research 8, 1960). The values V of that last solution and λ prove it:

    r(π) ≤ μ V - λ b   for every policy that keeps the limits.

The same search, with the least common step t by which all limits are moved to be kept as the
objective, comes first. Where t > 0 no policy keeps them: prices μ ≥ 0 with max over all policies of
μ c(π) < μ b prove it (Farkas), and the moved limits are the closest ones that can be kept.

Where many states lead to each other, and fractions are long, floats first propose the answer whole
(`basis`); mixtures are left for what they get wrong.

The mixture becomes one stationary policy by its visits, and visits are shifted, all totals kept,
until no more pairs than binding limits are taken beside one for each state (Altman, Constrained
Markov Decision Processes, 1999, theorem 3.8).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import flint
import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import fraction, rational
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Integers, Numbers, exact
from exact_mdp.solvers.objectives.amounts import Objectives, reward_name
from exact_mdp.solvers.objectives.basis import by_basis, combined
from exact_mdp.solvers.objectives.checker import (
    Attained,
    Flow,
    Limit,
    Point,
    Rank,
    Values,
    Visits,
    constrained_violations,
    moved_by,
    room,
    tight,
    totals_of,
)
from exact_mdp.solvers.objectives.file import LimitsProof
from exact_mdp.solvers.objectives.occupancy import visits
from exact_mdp.solvers.objectives.optima import extreme, optimum, rank_of
from exact_mdp.solvers.objectives.simplex import maximise
from exact_mdp.solvers.solution import Certified, Claim

if TYPE_CHECKING:
    from pandas import DataFrame

ZERO, ONE = Fraction(0), Fraction(1)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ConstrainedSolution(Result):
    """The optimum under limits and its proof, or a proof that no policy keeps them.

    Attributes
    ----------
    limits : tuple of Limit
    feasible : bool
    shift : Fraction
        The least t such that limits that are all moved by t can be kept: 0 where it is feasible.
    flow : {pair: Fraction}
        Expected visits of pairs under the policy: the optimal one, or one that keeps the moved
        limits.
    price : tuple of Fraction
        Of each limit: what the optimum gains for each unit by which the limit is moved. Where it is
        infeasible, the weights that prove it.
    dual : Values
        What no policy exceeds: the total of the reward, or 0 times it where that is infeasible, and
        of the limited totals times their prices.
    objectives : Objectives
        The reward, then what is limited.
    rank : (S,) int64, optional
        Proof that every policy ends, at discount 1.

    Examples
    --------
    >>> from exact_mdp import solve
    >>> rows = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    >>> mdp = MDP.from_outcomes(rows, components={"cost": [3, 1, 0]})
    >>> found = solve(mdp, subject_to={"cost": "<= 3/2"})
    >>> found.start_value, found.prices, found.randomises
    (Fraction(2, 1), {'cost': Fraction(2, 1)}, {0: {'0': Fraction(1, 4), '1': Fraction(3, 4)}})
    >>> found.violations(), solve(mdp, subject_to={"cost": "<= 1/2"}).closest
    ([], {'cost': Fraction(1, 1)})
    """

    limits: tuple[Limit, ...]
    feasible: bool
    shift: Fraction
    flow: Mapping[int, Fraction]
    price: tuple[Fraction, ...]
    dual: Values
    objectives: Objectives
    rank: Rank

    claim: ClassVar[Claim] = Claim.CERTIFIED

    def __repr__(self) -> str:
        kept = ", ".join(map(str, self.limits))
        if self.start_value is None:
            return f"ConstrainedSolution(no policy keeps {kept}; certified)"
        return f"ConstrainedSolution({float(self.start_value):.12g} with {kept}; certified)"

    @property
    def mdp(self) -> MDP:
        """The model."""
        return self.objectives.mdp

    @cached_property
    def totals(self) -> dict[str, Fraction]:
        """The policy's total of what is limited."""
        return dict(zip(self.objectives.names[1:], self._totals[1:], strict=True))

    @property
    def start_value(self) -> Fraction | None:
        """The optimum, which the policy earns; None where no policy keeps the limits."""
        return self._totals[0] if self.feasible else None

    @property
    def start(self) -> Certified | None:
        """The same as a claim."""
        return None if self.start_value is None else Certified(value=self.start_value)

    @cached_property
    def _totals(self) -> Point:
        of = self.objectives
        return tuple(of.sign * value for value in totals_of(of, self.flow))

    @property
    def prices(self) -> dict[str, Fraction]:
        """The price of each limit by name; of two limits on one name, both together."""
        found = dict.fromkeys(self.objectives.names[1:], ZERO)
        for limit, price in zip(self.limits, self.price, strict=True):
            found[limit.name] += price
        return found

    @property
    def closest(self) -> dict[str, Fraction]:
        """The closest limits that can be kept, all moved by the same step."""
        return {limit.name: limit.bound for limit in self.moved}

    @property
    def moved(self) -> tuple[Limit, ...]:
        """The limits, all moved by the least step that lets them be kept."""
        return tuple(moved_by(self.shift, limit) for limit in self.limits)

    @cached_property
    def chances(self) -> dict[int, dict[int, Fraction]]:
        """The probability of each pair {state: {pair: probability}} in the states visited."""
        found: dict[int, dict[int, Fraction | int]] = {}
        whole = self.flow.top if isinstance(self.flow, Visits) else self.flow
        for pair in sorted(whole):
            found.setdefault(int(self.mdp.pair_state[pair]), {})[pair] = whole[pair]
        return {
            state: {pair: Fraction(amount) / sum(own.values()) for pair, amount in own.items()}
            if len(own) > 1
            else dict.fromkeys(own, ONE)
            for state, own in found.items()
        }

    @property
    def randomises(self) -> dict[int, dict[str, Fraction]]:
        """The states in which the policy draws its action: {state: {action: probability}}."""
        mdp = self.mdp
        return {
            state: {mdp.actions[mdp.pair_action[pair]]: chance for pair, chance in own.items()}
            for state, own in self.chances.items()
            if len(own) > 1
        }

    @cached_property
    def rule(self) -> Numbers:
        """(S, A) Fractions, the probability of each action.

        In states that are never visited, the first that is optimal for the reward and the prices.
        """
        mdp, of = self.mdp, self.objectives
        rule = np.full((mdp.n_states, mdp.n_actions), ZERO, dtype=object)
        weights = combined(of, self.limits, ONE if self.feasible else ZERO, self.price)
        best = tight(of, weights, self.dual)
        rule[np.arange(mdp.n_states), mdp.pair_action[best]] = ONE
        for state, own in self.chances.items():
            rule[state] = ZERO
            for pair, chance in own.items():
                rule[state, mdp.pair_action[pair]] = chance
        return rule

    @cached_property
    def policy(self) -> Policy:
        """The policy, with its exact probabilities."""
        return Policy(space=self.mdp.space, actions=self.mdp.actions, rule=self.rule)

    def frame(self) -> DataFrame:
        """Return one row for each limit: the total, the price, and the closest limit."""
        import pandas

        rows = [
            (str(limit), self.totals[limit.name], price, self.closest[limit.name])
            for limit, price in zip(self.limits, self.price, strict=True)
        ]
        return pandas.DataFrame(rows, columns=["limit", "total", "price", "closest"])

    def violations(self) -> list[str]:
        """Return what does not hold of the solution, in words: nothing where it is sound."""
        of = Objectives.of(self.mdp, self.objectives.texts)
        return constrained_violations(of, **self._claims)

    @property
    def _claims(self) -> dict[str, Any]:
        return {
            "rank": self.rank,
            "limits": self.limits,
            "flow": self.flow,
            "price": (ONE if self.feasible else ZERO, *self.price),
            "dual": self.dual,
            "shift": self.shift,
        }

    def save(self, path: str | Path) -> None:
        """Write the proof as JSON, for `exact-mdp verify`; see `solvers.objectives.file`."""
        LimitsProof.about(self.objectives, **self._claims).save(path)


LIMIT = re.compile(r"\s*(>=|<=)\s*(\S+)\s*$")


def limits_of(subject_to: Mapping[str, Any]) -> tuple[Limit, ...]:
    """Return limits from {name: ">= p/q"}, or from a list of such texts for a name."""
    if not isinstance(subject_to, Mapping) or not subject_to:
        raise ModelError(
            f"{subject_to!r} states no limit",
            where="subject_to",
            fix='give {name: ">= -1/2"}, or "<= …"',
        )
    found = []
    for name, texts in subject_to.items():
        for text in texts if isinstance(texts, list | tuple) else [texts]:
            parts = LIMIT.match(str(text))
            if parts is None:
                raise ModelError(
                    f"{text!r} is no limit",
                    where=f"subject_to {name!r}",
                    fix='write a text with >= or <=, such as ">= -1/2" or "<= 1/20"',
                )
            sign = 1 if parts[1] == ">=" else -1
            found.append(Limit(name=str(name), sign=sign, bound=exact(parts[2])))
    return tuple(found)


def solve_under(mdp: MDP, subject_to: Mapping[str, Any]) -> ConstrainedSolution:
    """Return the optimum under limits; see `solve`."""
    limits = limits_of(subject_to)
    names = list(dict.fromkeys(limit.name for limit in limits))
    of = Objectives.of(mdp, [f"return={reward_name(mdp)}", *names])
    limits = tuple(
        Limit(name=of.names[1 + names.index(each.name)], sign=each.sign, bound=each.bound)
        for each in limits
    )
    found = (by_basis(of, limits) if of.cyclic else None) or relaxed(of, limits)
    return ConstrainedSolution(
        limits=limits,
        feasible=found.shift == 0,
        shift=found.shift,
        flow=found.flow,
        price=found.price,
        dual=found.dual,
        objectives=of,
        rank=rank_of(of),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Relaxed:
    """The optimum over mixtures of policies.

    Attributes
    ----------
    shift, price, dual
        As in `ConstrainedSolution`.
    mixing : _Mixing
        The policies that were found on the way.
    """

    shift: Fraction
    price: tuple[Fraction, ...]
    dual: Values
    mixing: _Mixing

    @cached_property
    def flow(self) -> Flow:
        """The visits of the mixture as one policy that draws few actions."""
        return _purified(self.mixing.of, self.mixing.limits, self.mixing.flow(), self.shift)


def relaxed(of: Objectives, limits: Sequence[Limit]) -> Relaxed:
    """Return the optimum over mixtures."""
    mixing = _Mixing(of, limits)
    shift, price, dual = mixing.closest() or (ZERO, *mixing.best())
    return Relaxed(shift=shift, price=price, dual=dual, mixing=mixing)


class _Mixing:
    """Mixtures of policies: the columns found, and the shares of the last program."""

    def __init__(self, of: Objectives, limits: Sequence[Limit]) -> None:
        self.of, self.limits = of, limits
        self.columns: list[Attained] = []
        self.shares: list[Fraction] = []
        self._add(ONE, [ZERO] * len(limits))

    def closest(self) -> tuple[Fraction, tuple[Fraction, ...], Values] | None:
        """Find mixtures that keep limits moved by the least t; return t, its prices and values.

        None where t is 0.
        """
        count = len(self.limits)
        while True:
            moved = [*[ONE] * count, ZERO]
            costs = [*[ZERO] * len(self.columns), -ONE]
            price, most = self._program(costs, [moved])
            each = zip(price, self.limits, strict=True)
            shift = sum((p * limit.sign * limit.bound for p, limit in each), ZERO) - most
            if not shift:
                return None
            found = self._add(ZERO, price, above=most)
            if found is not None:
                return shift, price, found

    def best(self) -> tuple[tuple[Fraction, ...], Values]:
        """Find the best mixture that keeps the limits; return prices and values."""
        while True:
            price, most = self._program([a.total[0] for a in self.columns], [])
            found = self._add(ONE, price, above=most)
            if found is not None:
                return price, found

    def _program(
        self, costs: list[Fraction], more: list[list[Fraction]]
    ) -> tuple[tuple[Fraction, ...], Fraction]:
        """Mix the columns; return the prices of the limits, and what no column is worth more than.

        Its columns are the policies, `more`, and what each limit is exceeded by.
        """
        count = len(self.limits)
        matrix = [[*self._kept(a), ONE] for a in self.columns] + more
        matrix += [[-ONE if i == k else ZERO for i in range(count + 1)] for k in range(count)]
        right = [limit.sign * limit.bound for limit in self.limits]
        found = maximise([*costs, *[ZERO] * count], matrix, [*right, ONE])
        self.shares = found.x[: len(self.columns)]
        return tuple(-y for y in found.y[:count]), found.y[count]

    def _kept(self, column: Attained) -> list[Fraction]:
        """Return the limited totals of a policy, so that more keeps each limit better."""
        of = self.of
        own = dict(zip(of.names, column.total, strict=True))
        return [of.sign * limit.sign * own[limit.name] for limit in self.limits]

    def _add(
        self, reward: Fraction, price: Sequence[Fraction], above: Fraction | None = None
    ) -> Values | None:
        """Add the best policy for these prices, or return its values where it is no better."""
        weights = combined(self.of, self.limits, reward, price)
        found = optimum(self.of, weights)
        if above is not None and found.total <= above:
            return found.values
        self.columns.append(extreme(self.of, weights, found))
        return None

    def flow(self) -> Flow:
        """Return the visits of pairs under the mixture."""
        found: Flow = {}
        for share, column in zip(self.shares, self.columns, strict=False):
            if share:
                _add_to(found, visits(self.of, column.pairs), share)
        return found


def _add_to(total: Flow, other: Mapping[int, Fraction], share: Fraction) -> None:
    for pair, amount in other.items():
        total[pair] = total.get(pair, ZERO) + share * amount


def _purified(of: Objectives, limits: Sequence[Limit], found: Flow, shift: Fraction) -> Flow:
    """Return visits with the same totals that take few pairs more than one in each state.

    A shift of visits that keeps the binding totals goes on until a pair is not taken any more, or
    another limit binds.
    """
    state, names = of.mdp.pair_state, list(of.names)
    while True:
        totals = totals_of(of, found)
        free_of = [room(of, limit, totals) + shift for limit in limits]
        binding = sorted(
            {names.index(x.name) for x, free in zip(limits, free_of, strict=True) if not free}
        )
        base, extra = of.mdp.pair_offsets[:-1].copy(), list[int]()
        taken = set[int]()
        for pair in sorted(found):
            if state[pair] in taken:
                extra.append(pair)
            else:
                base[state[pair]] = pair
                taken.add(int(state[pair]))
        if len(extra) <= len(binding):
            return found
        steps = [_switch(of, base, pair) for pair in extra[: len(binding) + 1]]
        moves = [totals_of(of, step) for step in steps]
        step = _mixed(steps, _kernel([[move[k] for move in moves] for k in binding], len(steps)))
        ahead = totals_of(of, step)
        far = [found[pair] / -amount for pair, amount in step.items() if amount < 0]
        for limit, free in zip(limits, free_of, strict=True):
            moved = of.sign * limit.sign * ahead[names.index(limit.name)]
            if free and moved < 0:
                far.append(free / -moved)
        _add_to(found, step, min(far))
        found = {pair: amount for pair, amount in found.items() if amount}


def _switch(of: Objectives, base: Integers, pair: int) -> Flow:
    """Return what visits change by where a pair is taken once in place of its state's base pair.

    Only pairs that a policy with these pairs takes from that state on change, so that visits to
    states which the base pairs alone do not reach can be shifted, too.
    """
    rows, state = of.rows, int(of.mdp.pair_state[pair])
    part = slice(int(rows.offsets[pair]), int(rows.offsets[pair + 1]))
    scale = int(rows.scale[state])
    after = zip(rows.next[part].tolist(), rows.weight[part].tolist(), strict=True)
    start = [(state, -ONE), *((following, Fraction(w, scale)) for following, w in after)]
    found = visits(of, base, start)
    _add_to(found, {pair: ONE}, ONE)
    return found


def _mixed(parts: Sequence[Flow], factors: Sequence[Fraction]) -> Flow:
    total: Flow = {}
    for part, factor in zip(parts, factors, strict=True):
        _add_to(total, part, factor)
    return {pair: amount for pair, amount in total.items() if amount}


def _kernel(rows: Sequence[Sequence[Fraction]], size: int) -> list[Fraction]:
    """Return numbers, not all 0, whose sums with each of the fewer than `size` rows are 0."""
    if not rows:
        return [Fraction(i == 0) for i in range(size)]
    matrix = flint.fmpq_mat([[rational(v) for v in row] for row in rows])
    reduced, rank = matrix.rref()
    pivots = [next(j for j in range(size) if reduced[i, j] != 0) for i in range(rank)]
    free = next(j for j in range(size) if j not in pivots)
    found = [Fraction(j == free) for j in range(size)]
    for i, j in enumerate(pivots):
        found[j] = -fraction(reduced[i, free])
    return found
