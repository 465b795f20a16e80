"""The value of a mixed policy in rational arithmetic, and each pair's exact distance to the best.

A state in which a policy takes pair l with probability π(l) has the row Σ_l π(l) P_l and the reward
Σ_l π(l) r(l). These are built in integers from the Bellman rows of the model and the exact
probabilities of the actions. The values that come out are put into their equations. That these have
one solution is known wherever the optimum has been proven: a rank that falls along every pair, or
w > γ P w, holds for mixtures of rows, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import lcm

import numpy as np

from exact_mdp.mdp.exact import BellmanRows, bellman_rows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, divide, in_proportion, integers
from exact_mdp.solvers.objectives.occupancy import flow
from exact_mdp.solvers.proof.exact import ExactValues, solve_exactly
from exact_mdp.solvers.proof.margins import Values, alike
from exact_mdp.solvers.proof.rationals import fraction, on_average
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactPolicy:
    """Exact values V(s) = numerator[s] / denominator[group[s]] of a policy."""

    mdp: MDP
    numerator: Sequence[int]
    group: Integers
    denominator: Sequence[int]

    @cached_property
    def value_float(self) -> Floats:
        """(S,) the values, each rounded once."""
        return divide(np.array(self.numerator, object), np.array(self._below, object))

    @cached_property
    def value(self) -> list[Fraction]:
        """The values of all states."""
        return [fraction(a, b) for a, b in zip(self.numerator, self._below, strict=True)]

    @cached_property
    def start_value(self) -> Fraction:
        """The value of the start distribution."""
        return on_average(self.mdp.start, self.numerator, self.group, self.denominator)

    @property
    def _below(self) -> list[int]:
        return [self.denominator[group] for group in self.group.tolist()]


def exact_policy(chain: PolicyChain, earned: Sequence[Fraction] | None = None) -> ExactPolicy:
    """Return the exact values of a policy whose equations are known to have one solution.

    With `earned`, (S,) Fractions, that is what each state earns in place of the model's rewards.
    """
    mdp = chain.mdp
    rows, times = mixed_rows(bellman_rows(mdp), chain), 1
    if earned is not None:
        times = lcm(*(number.denominator for number in earned))
        scaled = zip(earned, rows.scale.tolist(), strict=True)
        constant = [int(number * times) * scale for number, scale in scaled]
        rows = replace(rows, constant=integers(constant))
    found = solve_exactly(rows)
    if not _holds(rows, found):
        raise RuntimeError("exact values of a policy do not solve its equations")
    return ExactPolicy(
        mdp=mdp,
        numerator=found.numerator,
        group=found.group,
        denominator=[below * times for below in found.denominator],
    )


def exact_visits(chain: PolicyChain) -> Floats:
    """Return (S,) expected discounted visits from the start, each rounded once from a rational.

    They solve d(t) = μ(t) + γ Σ_s d(s) P(s, t) over the states reached; terminal states count
    arrivals.
    """
    mdp = chain.mdp
    rows = mixed_rows(bellman_rows(mdp), chain)
    equations, found = flow(mdp, rows, np.flatnonzero(chain.reached & ~mdp.terminal))
    if not _holds(equations, found):
        raise RuntimeError("exact visits of a policy do not solve their equations")
    return ExactPolicy(
        mdp=mdp, numerator=found.numerator, group=found.group, denominator=found.denominator
    ).value_float


def mixed_rows(rows: BellmanRows, chain: PolicyChain) -> BellmanRows:
    """Return the Bellman rows of the model in which each state has the policy's mixed pair."""
    if len(chain.pairs) == len(rows.scale):  # one pair a state: its row as it is
        return rows.of_pairs(chain.pairs)
    offsets, following, weight = rows.offsets.tolist(), rows.next.tolist(), rows.weight.tolist()
    constant, scale = rows.constant.tolist(), rows.scale.tolist()
    scales, constants, lengths = list[int](), list[int](), list[int]()
    targets, weights = list[int](), list[int]()
    for state in range(len(scale)):
        chances = chain.exact_weights(state)
        taken, shares = list(chances), in_proportion(list(chances.values()))
        row: dict[int, int] = {}
        for share, l in zip(shares, taken, strict=True):
            for i in range(offsets[l], offsets[l + 1]):
                row[following[i]] = row.get(following[i], 0) + share * weight[i]
        scales.append(scale[state] * sum(shares))
        constants.append(sum(share * constant[l] for share, l in zip(shares, taken, strict=True)))
        lengths.append(len(row))
        for target in sorted(row):
            targets.append(target)
            weights.append(row[target])
    return BellmanRows(
        pair_offsets=np.arange(len(scales) + 1),
        terminal=rows.terminal,
        scale=integers(scales),
        constant=integers(constants),
        offsets=np.concatenate([[0], np.cumsum(lengths, dtype=np.int64)]),
        next=np.array(targets, dtype=rows.next.dtype),
        weight=integers(weights),
    )


def exact_gaps(mdp: MDP, best: Values, pairs: Iterable[int]) -> dict[int, tuple[int, int]]:
    """Return V*(s) - Q*(l) of some pairs as numerator and denominator, both integers."""
    found: dict[int, tuple[int, int]] = {}
    asked = np.unique(np.array(list(pairs), dtype=np.int64))
    if not len(asked):
        return found
    rows = bellman_rows(mdp)
    for l, first in zip(asked.tolist(), alike(mdp, asked).tolist(), strict=True):
        if first != l:
            found[l] = found[first]
            continue
        state = int(mdp.pair_state[l])
        part = slice(int(rows.offsets[l]), int(rows.offsets[l + 1]))
        loss, unit = _loss(
            best, state, int(rows.scale[state]), int(rows.constant[l]),
            rows.next[part].tolist(), rows.weight[part].tolist(),
        )  # fmt: skip
        found[l] = loss, unit * int(rows.scale[state])
    return found


def _loss(
    of: Values, state: int, scale: int, constant: int,
    following: Sequence[int], weight: Sequence[int],
) -> tuple[int, int]:  # fmt: skip
    """Return scale · V - constant - Σ weight V' as an integer over a second one."""
    below = of.denominator
    own = below[of.group[state]]
    groups = of.group[list(following)].tolist()
    unit = lcm(own, *{below[group] for group in groups})
    times = {group: unit // below[group] for group in {*groups}}
    later = sum(
        w * of.numerator[t] * times[group]
        for t, w, group in zip(following, weight, groups, strict=True)
    )
    return scale * of.numerator[state] * (unit // own) - constant * unit - later, unit


def _holds(rows: BellmanRows, found: ExactValues) -> bool:
    """Return whether values solve the equations of rows with one pair for each state."""
    offsets, scale, constant = rows.offsets.tolist(), rows.scale.tolist(), rows.constant.tolist()
    following, weight = rows.next.tolist(), rows.weight.tolist()
    for state in range(len(scale)):
        if rows.terminal[state]:
            if found.numerator[state]:
                return False
            continue
        part = slice(offsets[state], offsets[state + 1])
        loss, _ = _loss(found, state, scale[state], constant[state], following[part], weight[part])
        if loss:
            return False
    return True
