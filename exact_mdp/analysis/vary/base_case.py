"""The base case: a model at today's values, its optimum, and the policies that are held fixed.

A policy is held as the probabilities of the model's (state, action) pairs, so that it can be
evaluated at other values of the parameters, where the pairs are the same.

Analyses compare values at several parameters, and optima with policies. A total reward at discount
1 may be infinite, and ∞ - ∞ is undefined: `finite_optimum` and `finite_worth` refuse such a value
by name, and every analysis that compares takes its values from them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from hashlib import sha256
from math import isinf

import numpy as np

from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Family, Parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.solution import Bounded, Solution
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True, eq=False)
class BaseCase:
    """A model at today's values; it is solved once, when that is first asked for.

    `labels` (X,) are what a policy is told by: the states with a choice, or their statuses.
    """

    mdp: MDP
    labels: tuple[str, ...]
    place: Integers  # (S,) which label a state has, -1 for none

    @cached_property
    def solution(self) -> Solution:
        """The optimum."""
        return finite_optimum(self.mdp, "today's parameters")

    def held(self, policy: PolicyLike) -> Floats:
        """Return (L,) probabilities of pairs of a policy; "optimal" is today's optimum."""
        today = isinstance(policy, str) and policy == "optimal"
        return PolicyChain.of(self.mdp, self.solution if today else policy).chosen

    def row(self, weights: Floats) -> Integers:
        """Return (S,) the action numbers of a policy (L,), -1 where it mixes."""
        row, sure = np.full(self.mdp.n_states, -1), np.flatnonzero(weights == 1)
        row[self.mdp.pair_state[sure]] = self.mdp.pair_action[sure]
        return row

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """Return the action at each label, where a policy says one and the same there."""
        here = self.place >= 0
        place, row = self.place[here], self.row(weights)[here]
        number = np.empty(len(self.labels), dtype=np.int64)
        number[place] = row
        if (row < 0).any() or (number[place] != row).any():
            return None
        chosen = [self.mdp.actions[action] for action in number.tolist()]
        return dict(zip(self.labels, chosen, strict=True))


def actions_of(mdp: MDP, pairs: Flags) -> list[tuple[str, ...]]:
    """Return the names of the actions that a set of pairs (L,) has in each state."""
    names: list[list[str]] = [[] for _ in range(mdp.n_states)]
    for pair in np.flatnonzero(pairs).tolist():
        names[mdp.pair_state[pair]].append(mdp.actions[mdp.pair_action[pair]])
    return [tuple(each) for each in names]


def finite_optimum(mdp: MDP, where: str) -> Solution:
    """Return the optimum; raises ModelError where it is infinite at the start."""
    solution: Solution = solve(mdp)
    _refuse_infinite("the optimum", solution.start, where)
    return solution


def finite_worth(mdp: MDP, policy: PolicyLike, where: str) -> Bounded:
    """Return a policy's value at the start; raises ModelError where it is infinite."""
    value = evaluate(mdp, policy).start
    _refuse_infinite("the policy held fixed", value, where)
    return value


def _refuse_infinite(what: str, value: Bounded, where: str) -> None:
    if isinf(value.value):
        raise ModelError(
            f"{what} is infinite, so that nothing can be compared",
            where=f"the total at discount 1, {where}",
            fix="give a discount below 1 (--discount 0.95), another policy, or ranges in which "
            "every value is finite",
        )


def unending(where: str) -> ModelError:
    """Return the error of an analysis that follows no policies that never end."""
    return ModelError(
        "some policy never ends",
        where=f"the total at discount 1, {where}",
        fix="give a discount below 1 (--discount 0.95), or a range in which every policy ends",
    )


def digest(*policies: Floats) -> str:
    """Return a hash of policies, (L,) probabilities of pairs each; other policies have another."""
    content = b"".join(np.ascontiguousarray(each, dtype="<f8").tobytes() for each in policies)
    return sha256(content).hexdigest()


def held_at(family: Parametric, name: str, value: Fraction) -> Parametric:
    """Return the family with another value of a parameter that does not move."""
    if isinstance(family, ScenarioFamily):
        return replace(family, scenario=family.scenario.with_(parameters={name: value}), base=None)
    if isinstance(family, Family):
        moved = (replace(p, value=value) if p.name == name else p for p in family.parameters)
        return replace(family, parameters=tuple(moved))
    raise ModelError(
        f"the parameters of {family.name} cannot be held",
        where=f"parameter {name}",
        fix="give a scenario, a model or a Family, or one parameter alone",
    )
