"""The best policy for the conditional value at risk: the mean of the worst share α of episodes.

    CVaR_α(Z) = max over η of  η - E (η - Z)⁺ / α

(Rockafellar and Uryasev, Journal of Risk 2, 2000), for the return Z. The best policy for a
threshold η depends on the state and on the remaining target, η less the reward so far (Bäuerle and
Ott, Mathematical Methods of Operations Research 74, 2011). `Budgeted` adds this target to the
states, which gives an acyclic model of a total reward. `Certificate` proves its values for all
thresholds at once.

Among policies of equal value the one with the greatest mean is taken. All numbers are integers over
one denominator for each state, or in large models floats. A float V(s, w) is computed from n
outcomes with an error of at most γ(n + 4) W beside the errors of the V(s', w'), for the greatest
width W of high(s) - low(s), so that D steps have an error of at most D γ(n + 4) W. The value of the
policy that is found, computed by the same sums, is as near.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cache, cached_property, partial
from itertools import groupby
from math import gcd, lcm
from typing import Any

import numpy as np

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.components import require_amounts
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import from_flint, to_flint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.questions.ending import NO_DATA, NO_GOAL, ONE_COMPONENT
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import DataFrame, Result, data_frame
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import (
    Floats,
    Integers,
    Numbers,
    concatenate_ranges,
    exact,
    format_rational,
    make_ones,
    to_integer_array,
)
from exact_mdp.mdp.validate import as_share
from exact_mdp.solvers.arguments import mdp_of
from exact_mdp.solvers.bounds.gains import SLACK, gamma
from exact_mdp.solvers.claims import Bounded, Certified, Claim
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.find import build_certificate
from exact_mdp.solvers.exact.levels import Level
from exact_mdp.solvers.values.returns import tail_mean

CELLS = 20_000_000  # outcomes times returns, which limits memory
EXACT_CELLS = 2_000_000  # the most of them for exact numbers by default: measured, 20 s
WHERE = "risk of the return"


class Budgeted:
    """The model of -E (η - Z)⁺, whose states hold the remaining target of the return.

    Rewards are multiples k of a unit, and returns from a state s lie between low(s) and high(s),

        low(s) = min over pairs l, outcomes (p, s', k) of l:  k + low(s').

    From (s, w) an outcome leads to (s', w - k). A target below low(s') is always reached: the
    budget is low(s'). A target above high(s') is missed by at least the surplus: this is paid at
    once, and the budget is high(s').
    """

    def __init__(self, model: MDP) -> None:
        """Build the states and outcomes of the new model."""
        require_amounts(model.table, "the mean of the worst episodes")
        mdp = model.maximised
        ends, level = mdp.terminal, mdp.ends.most_steps
        if mdp.discount_exact != 1 or level is None:
            raise ModelError(
                "the mean of the worst episodes is found at discount 1, without cycles",
                where=WHERE,
                fix="choose discount 1, and a horizon (--horizon N, mdp.within(N)), which has none",
            )
        if mdp.ends.outside_goal.any():
            raise ModelError(
                "episodes may end without the goal, at an infinite cost",
                where=WHERE,
                fix="state a model of rewards or costs, without a question of a goal",
            )
        table, pair = mdp.table, mdp.table.pair
        # Rewards of outcomes as integer multiples of one unit.
        (weight, denominator), (gain, below) = table.rows.integers, table.integer_gains
        if len(gain) == table.pairs:
            gain = gain[pair]
        shared = lcm(*below.tolist())
        whole = []
        for g, b in zip(gain.tolist(), below[pair].tolist(), strict=True):
            whole.append(g * (shared // b))
        size = gcd(*whole) or shared
        gain = to_integer_array(g // size for g in whole)
        # Sort outcomes within their pair, so that the new states rise.
        sort = np.lexsort((-gain, table.next, pair))
        rows = replace(table.rows, weight=weight[sort], denominator=denominator, sound=False)
        self.table = replace(
            table,
            rows=rows,
            gain=gain[sort],
            gain_denominator=make_ones(table.pairs),
            event=None,
        )
        self.mdp, self.unit, self.depth = mdp, Fraction(size, shared), int(level.max())
        # States that are not terminal, from the end on.
        self.order = [int(s) for s in np.argsort(level, kind="stable") if not ends[s]]
        self.low, self.high = low, high = np.zeros((2, mdp.n_states), dtype=object)
        # The least and the greatest return from each state, by backward induction.
        cells = self.cells = 0
        for state in self.order:
            here = self.outcomes_of(state)
            to, gains = self.table.next[here], self.table.gain[here]
            low[state], high[state] = min(gains + low[to]), max(gains + high[to])
            cells += len(to) * (high[state] - low[state] + 1)
        self.cells = int(cells)
        if cells > CELLS:
            raise ModelError(
                f"{cells:,} pairs of an outcome and a return, "
                f"in steps of {format_rational(self.unit)}",
                where=WHERE,
                fix=f"use a model with at most {CELLS:,}: fewer states, or rounder rewards",
            )

    @cached_property
    def first(self) -> Integers:
        """(S+1,) the number of (s, low(s)) among the states of the new model."""
        return np.append(0, np.cumsum(self.high - self.low + 1)).astype(np.int64)

    def outcomes_of(self, state: int) -> slice:
        """Return the outcomes of all pairs of a state."""
        pairs = self.mdp.pairs_of(state)
        return slice(int(self.table.offsets[pairs.start]), int(self.table.offsets[pairs.stop]))

    def list_successors(self, state: int) -> tuple[Integers, Numbers]:
        """Return the new states (budgets, outcomes) and their rewards, which are never above 0."""
        here = self.outcomes_of(state)
        to, gain = self.table.next[here], self.table.gain[here]
        # Budgets count from low(s): an outcome shifts them by its reward and by low(s') - low(s).
        shift = (self.low[state] - gain - self.low[to]).astype(np.int64)
        budget = np.arange(self.high[state] - self.low[state] + 1)[:, None] + shift
        # Below 0 nothing is short; above the greatest budget the surplus is paid.
        within = np.clip(budget, 0, self.first[to + 1] - self.first[to] - 1)
        return self.first[to] + within, -np.maximum(budget - within, 0)

    def find_state(self, state: int, wanted: int) -> int:
        """Return the number of the new state for a state and a remaining target."""
        low, high = int(self.low[state]), int(self.high[state])
        return int(self.first[state]) + min(max(wanted, low), high) - low

    @property
    def thresholds(self) -> range:
        """The returns from the start; one of them is the best threshold."""
        begins = [state for state, _ in self.mdp.start]
        return range(int(min(self.low[begins])), int(max(self.high[begins])) + 1)

    def list_start(self, threshold: int) -> tuple[tuple[int, Fraction], ...]:
        """Return the new states in which episodes start, with their probabilities."""
        return tuple((self.find_state(s, threshold), p) for s, p in self.mdp.start)

    def compute_cvar(self, values: Level | FloatValues, threshold: int, level: Fraction) -> Any:
        """Return the CVaR of the best policy for a threshold."""
        lacking = sum(p * max(threshold - int(self.high[s]), 0) for s, p in self.mdp.start)
        return threshold + (values.compute_mean(self.list_start(threshold)) - lacking) / level

    def build_budgeted_model(self, threshold: int) -> MDP:
        """Return the new model, with the start for a threshold."""
        # Each state is repeated for its budgets, with all of its pairs.
        old, each = self.mdp, [self.list_successors(state) for state in range(self.mdp.n_states)]
        # One copy of each state for each of its budgets, and of its pairs for each copy.
        state = np.repeat(np.arange(old.n_states), np.diff(self.first))
        pairs = concatenate_ranges(old.pair_offsets[state], old.pair_offsets[state + 1])
        table = self.table.of_pairs(pairs)
        rows = replace(table.rows, next=np.concatenate([to.ravel() for to, _ in each]))
        gain = np.concatenate([earned.ravel() for _, earned in each])
        parts: dict[str, Any] = {
            "table": replace(table, rows=rows).with_reward(gain, make_ones(len(pairs))),
            "pair_state": np.repeat(np.arange(len(state)), np.diff(old.pair_offsets)[state]),
            "pair_action": old.pair_action[pairs],
            "space": StateSpace.plain(len(state)),
            "start": self.list_start(threshold),
            "time_limit": None,
            "labels": {},
            **NO_GOAL,
            **ONE_COMPONENT,
            **NO_DATA,
        }
        return replace(old, **parts)


@dataclass(frozen=True, eq=False)
class FloatValues:
    """Values (S',) of the new states in floats, each with an error of at most `error`."""

    value: Floats
    error: float

    def compute_mean(self, weights: Iterable[tuple[int, Fraction]]) -> float:
        """Return Σ weight · x(s) over (state, weight) pairs."""
        return float(sum(float(weight) * self.value[state] for state, weight in weights))


def _solve_budgeted(
    of: Budgeted, *, exact: bool
) -> tuple[Integers, Level | FloatValues, Level | FloatValues]:
    """Return pairs of the old model for the new states, their values, and the means of returns."""
    first, table = of.first, of.table
    kind: Any = np.float64
    if exact:
        kind = object
    denominator = np.repeat(table.denominator, np.diff(table.offsets))
    chance = (table.weight.astype(object) / denominator.astype(object)).astype(np.float64)
    value, mean = np.zeros((2, int(first[-1])), dtype=kind)
    below = np.ones(of.mdp.n_states, dtype=object)
    pairs = np.repeat(of.mdp.pair_offsets[:-1], np.diff(first))
    for state in of.order:
        here, (after, earned) = of.outcomes_of(state), of.list_successors(state)
        own, gain = of.mdp.pairs_of(state), table.gain[here]
        times: Numbers = chance[here]
        if exact:
            # Backward induction over integers: values of one state share a denominator.
            then = below[table.next[here]]
            scale = then * denominator[here]
            below[state] = lcm(*scale.tolist())
            times = table.weight[here] * (below[state] // scale)
            earned, gain = then * earned, then * gain
        starts = table.offsets[own.start : own.stop] - here.start
        # Two totals of each pair and budget: minus the shortage, and the return itself.
        shortage, returned = value[after] + earned.astype(kind), mean[after] + gain.astype(kind)
        totals = np.add.reduceat(times * shortage, starts, axis=1)
        means = np.add.reduceat(times * returned, starts, axis=1)
        # Least shortage first; among pairs that share it, the greatest mean return.
        most = totals.max(axis=1)
        means = np.where(totals == most[:, None], means, -np.inf)
        new = slice(int(first[state]), int(first[state + 1]))
        value[new], mean[new] = most, means.max(axis=1)
        pairs[new] = own.start + means.argmax(axis=1)
    if exact:
        parts: dict[str, Any] = {"below": below.tolist()}
        parts["group"] = np.repeat(np.arange(of.mdp.n_states), np.diff(first))
        return pairs, Level(top=value.tolist(), **parts), Level(top=mean.tolist(), **parts)
    # The error of one step, as at the head of the module, times the number of steps.
    width = float(max(of.high - of.low))
    size = 2 * float(max(np.abs([of.high, of.low]).max(axis=0)))  # a reward, and a return after it
    each = of.depth * float(gamma(int(np.diff(table.offsets).max()) + 4)) * SLACK
    return pairs, FloatValues(value, each * width), FloatValues(mean, each * size)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CVaROptimum(Result):
    """A policy with the greatest mean of the worst share of episodes.

    The numbers are Fractions with a proof, or floats within `error`.
    """

    mdp: MDP
    level: Fraction
    value: Fraction | float
    mean: Fraction | float
    threshold: Fraction  # η: the policy minimises the expected shortage below it
    budgeted: Budgeted
    pairs: Integers  # the pair of `mdp` that is taken in each state of `budgeted`
    values: Level | FloatValues  # the values of these states, for maximised rewards
    error: float = 0.0  # bounds the errors of value and mean; 0 if they are exact

    @property
    def claim(self) -> Claim:
        """Certified, or bounded if the numbers are floats."""
        if self._exact:
            return Claim.CERTIFIED
        return Claim.BOUNDED

    @property
    def _exact(self) -> bool:
        return isinstance(self.values, Level)

    def __repr__(self) -> str:
        return (
            f"CVaROptimum(worst {format_rational(self.level)}: {float(self.value):.6g}, "
            f"mean {float(self.mean):.6g}; {self.claim})"
        )

    def _claim_number(self, number: Fraction | float) -> Certified | Bounded:
        if self._exact:
            return Certified(value=number)
        return Bounded(value=float(number), error=self.error)

    @property
    def _unit(self) -> Fraction:
        return self.mdp.sense.sign * self.budgeted.unit

    @cached_property
    def certificate(self) -> Certificate:
        """The proof of the values of `budgeted`, for all thresholds.

        Raises ModelError if the numbers are floats.
        """
        of = self.budgeted
        if not isinstance(self.values, Level):
            raise ModelError(
                "numbers with an error bound have no certificate",
                where=WHERE,
                fix="ask best_cvar(model, level, exact=True), which may take long",
            )
        model = of.build_budgeted_model(int(self.threshold / self._unit))
        first = np.repeat(of.mdp.pair_offsets[:-1], np.diff(of.first))
        pairs = model.pair_offsets[:-1] + self.pairs - first
        return build_certificate(model, pairs, h=self.values, rank=model.ends.rank_in_proof)

    def action(self, state: int, so_far: object = 0) -> str:
        """Return the policy's action in a state, given the reward so far."""
        wanted = (self.threshold - exact(so_far, "reward so far")) / self._unit
        if wanted.denominator != 1:
            raise ModelError(
                f"no reward so far can be {format_rational(exact(so_far))}",
                where=WHERE,
                fix=f"rewards are multiples of {format_rational(self.budgeted.unit)}",
            )
        pair = self.pairs[self.budgeted.find_state(state, int(wanted))]
        return str(self.mdp.actions[self.mdp.pair_action[pair]])

    @cached_property
    def _met(self) -> dict[int, dict[Fraction, Fraction]]:
        """The probability of each reward so far in each state under the policy."""
        read: Callable[[Any], Any] = float
        write: Callable[[Any], Any] = float
        if self._exact:
            read, write = to_flint, from_flint
        of, aim = self.budgeted, int(self.threshold / self._unit)
        met = [defaultdict[int, Any](int) for _ in range(of.mdp.n_states)]
        for state, weight in of.mdp.start:
            met[state][0] += read(weight)
        row = cache(lambda l: [(read(p), to, int(k)) for p, to, k in of.table.row(l)])
        # From the start to the end, as each state comes before all that follow it.
        for state in reversed(of.order):
            for so_far, mass in met[state].items():
                for p, to, k in row(int(self.pairs[of.find_state(state, aim - so_far)])):
                    met[to][so_far + k] += mass * p
        known = {}
        for state, own in enumerate(met):
            if own:
                masses = [(self._unit * k, write(mass)) for k, mass in own.items()]
                known[state] = dict(sorted(masses))
        return known

    def rules(self) -> list[tuple[int, Fraction, Fraction, str]]:
        """Return the policy as rows (state, from, to, action), by rewards so far that can occur."""
        rows = []
        for state, so_far in self._met.items():
            if self.mdp.ends.must_choose[state]:
                # Neighbouring rewards with the same action make one row.
                for action, group in groupby(so_far, partial(self.action, state)):
                    own = [*group]
                    rows.append((state, own[0], own[-1], action))
        return rows

    def distribution(self) -> dict[Fraction, Any]:
        """Return the probability of every return under the policy, in increasing order.

        Fractions, or floats if the optimum is bounded; a float is right up to rounding.
        """
        total = defaultdict[Fraction, Any](int)
        for state, masses in self._met.items():
            if self.mdp.terminal[state]:
                for value, mass in masses.items():
                    total[value] += mass
        return dict(sorted(total.items()))

    def violations(self) -> list[str]:
        """Return the violations in words: an empty list if the policy is optimal."""
        wrong, threshold = self.certificate.violations(), self.threshold / self._unit
        of, distribution = self.budgeted, self.distribution()
        each: dict[Any, Fraction]
        each = {k: of.compute_cvar(self.values, k, self.level) for k in of.thresholds}
        if not each.get(threshold) == max(each.values()) == self.value / self._unit:
            wrong.append("another threshold gives more")
        if tail_mean(distribution, self.level, highest=self.mdp.sense.costs) != self.value:
            wrong.append("the worst episodes of the policy have another mean")
        if sum(z * p for z, p in distribution.items()) != self.mean:
            wrong.append("the policy has another mean")
        return wrong

    def report(self) -> Report:
        """Return the mean of the worst episodes and of all, and the policy."""
        label = self.mdp.space.label
        listed = []
        for state, low, high, action in self.rules():
            listed.append({"state": label(state), "from": low, "to": high, "action": action})
        facts = {
            "claim": Shown(self.claim),
            "measure": Shown("cvar"),
            "value": Shown(self.value, self._claim_number(self.value)),
            "level": Shown(self.level, f"the worst {self.level} of the episodes"),
            "mean": Shown(self.mean, self._claim_number(self.mean)),
            "threshold": self.threshold,
            "distribution": Shown(self.distribution()),
            "policy": listed,
        }
        if not self._exact:
            facts["error_bound"] = self.error
        rules = Table(
            title="best policy for the worst episodes, by state and reward so far",
            columns={"state": "state", "from": "from:.10g", "to": "to:.10g", "action": "action"},
            first=20,
        )
        return Report(title="mean of the worst episodes", facts=facts, tables={"policy": rules})

    def frame(self) -> DataFrame:
        """Return the distribution of the return."""
        returns = self.distribution()
        return data_frame(
            {"return": map(float, returns), "probability": map(float, returns.values())}
        )


def best_cvar(model: MDP | Scenario, level: object, *, exact: bool | None = None) -> CVaROptimum:
    """Return a policy with the greatest mean return of the worst episodes.

    In a model of costs, the least mean cost of the worst episodes. The policy remembers the reward
    so far.

    Parameters
    ----------
    model : MDP or Scenario
        With discount 1 and without cycles, such as `mdp.within(n)`.
    level : number or "p/q"
        The share of the worst episodes, above 0; 1 gives the mean of all episodes.
    exact : bool, optional
        Whether numbers are exact, with a proof, or floats with an error bound; by default exact up
        to two million pairs of an outcome and a return.

    Returns
    -------
    CVaROptimum

    Raises
    ------
    ModelError
        For other discounts, cycles, too many returns, and numbers out of range.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 1, 10), ("1/2", 1, 0)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    >>> best = best_cvar(MDP.from_outcomes(rows), "1/2")
    >>> str(best.value), str(best.mean), best.action(0)
    ('4', '4', '1')
    """
    mdp, share = mdp_of(model), as_share(level, "share of the worst episodes")
    of = Budgeted(mdp)
    if exact is None:
        exact = of.cells <= EXACT_CELLS
    pairs, values, means = _solve_budgeted(of, exact=exact)
    # The best threshold: the greatest CVaR, then the greatest mean, then the lowest threshold.
    rated = []
    for k in of.thresholds:
        rated.append((of.compute_cvar(values, k, share), means.compute_mean(of.list_start(k)), -k))
    value, mean, least = max(rated)
    unit = mdp.sense.sign * of.unit
    return CVaROptimum(
        mdp=mdp,
        level=share,
        value=unit * value,
        mean=unit * mean,
        threshold=unit * -least,
        budgeted=of,
        pairs=pairs,
        values=values,
        error=_bound_error(of, values, means, share),
    )


def _bound_error(
    of: Budgeted, values: Level | FloatValues, means: Level | FloatValues, level: Fraction
) -> float:
    """Return a bound on the errors of the value and the mean; 0 if they are exact."""
    if isinstance(values, Level) or isinstance(means, Level):
        return 0.0
    width, share = float(max(of.high - of.low)), float(level)
    size = float(max(np.abs([of.high, of.low]).max(axis=0)))
    # Beside the errors of the values: the mean over the start, three operations, and the unit.
    rounding = gamma(len(of.mdp.start) + 8) * (size + 2 * width / share)
    error = max(values.error / share, means.error) + rounding
    return float(error * float(of.unit)) * SLACK
