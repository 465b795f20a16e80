"""The care model without its matrix: states and rewards as ever, next statuses by their law.

    q(s, a) = const(a, s) + E[x(s') | s, a],    x(s') = gain(s') + γ V(next(s')),

where s' = 0 completes the subtask and every other s' fails the trial, and after the last trial
x(s') is itself an expectation, over what a skip makes of s'. All gains but those of the action and
of the present status depend on s' alone, so that one vector x serves all actions and states of a
trial. `mdp.operator_law` says how expectations are had in far fewer than 4^n steps.

Memory is that of the 2^n · n · A chances and of a few vectors; no table of transitions exists.
Source of the model: Yuan et al. (2025), Section 2.1, Equation 1 and Table 4.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mdp.chances import chances
from mdp.errors import ModelError, suggest
from mdp.laws import status_kernels
from mdp.operator_law import Expect, Law, chances_of, law_of
from mdp.parameters import Parameter
from mdp.rules import Rules, kinds
from mdp.space import StateSpace
from mdp.table import Floats, Integers, Numbers, divide, float_array, integers

if TYPE_CHECKING:
    from mdp.scenario import Scenario

DENSE_STATUSES = 6
EXPLICIT = (
    *("table", "transition", "reward", "components", "component_names", "events"),
    *("n_transitions", "start_distribution", "pair", "pairs_of", "where", "with_"),
)
"""What an explicit model has and an operator lacks."""


@dataclass(frozen=True, kw_only=True, eq=False)
class CareOperator:
    """A care scenario as an operator on values; made by `Scenario.operator`.

    States, pairs and their numbers are those of `Scenario.compile`. `solvers.solve` takes it.

    Attributes
    ----------
    scenario : Scenario
    rules : Rules
    step, skip : Law
        Of the next status vector under each action, and when a subtask is skipped.
    const : (A, 2^n)
        What an action earns in a status vector whatever comes next: its assistance where the
        subtask is completed, and the present cost where that is charged.
    fail : (2^n,)
        Gain of a failed trial by next status vector.
    complete : (3, 2)
        Gain of a completed one by kind of subtask and flag; the action's own is in `const`.
    skipped : (3,)
        What a skip adds, by kind of subtask.
    alone : (2^n,)
        Expected gain, but for `skipped`, of a skip that takes its own timestep.
    kinds : (K,) ints
        Each subtask: 0 inside a task, 1 last of one, 2 last of all.

    Examples
    --------
    >>> from mdp import Scenario
    >>> operator = Scenario.load("yuan2025").operator()
    >>> operator
    CareOperator(yuan2025: 241 states, 4 actions, 961 pairs, discount 1, 13 kB)
    >>> operator.backup(np.zeros(241)).shape
    (961,)
    """

    scenario: Scenario
    rules: Rules
    step: Law
    skip: Law
    const: Floats
    fail: Floats
    complete: Floats
    skipped: Floats
    alone: Floats
    kinds: Integers

    def __repr__(self) -> str:
        return (
            f"CareOperator({self.name}: {self.n_states} states, {self.n_actions} actions, "
            f"{self.n_pairs} pairs, discount {self.discount_exact}, {self.nbytes // 1000} kB)"
        )

    def __getattr__(self, name: str) -> Any:
        if name in EXPLICIT:
            _refuse(self, name)
        raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")

    # ---- what it has in common with the explicit model -----------------------------------------

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self.scenario.name

    @property
    def actions(self) -> tuple[str, ...]:
        """Action names."""
        return self.rules.actions

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return len(self.kinds) * self.rules.size + 1

    @property
    def n_actions(self) -> int:
        """Number of actions, A."""
        return len(self.actions)

    @property
    def n_pairs(self) -> int:
        """Number of available state-action pairs, L."""
        return len(self.kinds) * len(self.rules.pairs()[0]) + 1

    @property
    def discount_exact(self) -> Fraction:
        """The discount."""
        return self.scenario.discount

    @property
    def discount(self) -> float:
        """The discount as a float."""
        return float(self.scenario.discount)

    @property
    def start(self) -> tuple[tuple[int, Fraction], ...]:
        """The first state: no status present."""
        return ((0, Fraction(1)),)

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The scenario's parameters."""
        return self.scenario.parameters

    @property
    def nbytes(self) -> int:
        """Bytes that the operator takes itself."""
        laws = [a for law in (self.step, self.skip) for a in (law.chance, law.ready, law.dense)]
        own = (self.const, self.fail, self.complete, self.skipped, self.alone, self.kinds)
        return sum(array.nbytes for array in (*laws, *own))

    @cached_property
    def space(self) -> StateSpace:
        """What the state numbers mean."""
        return self.rules.space(self.scenario)

    @cached_property
    def pair_state(self) -> Integers:
        """(L,) state of each pair."""
        count, found = len(self.kinds), np.full(self.n_pairs, self.n_states - 1)
        starts = np.arange(count)[:, None] * self.rules.size
        np.add(starts, self.rules.pairs()[0], out=found[:-1].reshape(count, -1))
        return found

    @cached_property
    def pair_action(self) -> Integers:
        """(L,) action of each pair."""
        found = np.zeros(self.n_pairs, dtype=np.int64)
        found[:-1].reshape(len(self.kinds), -1)[:] = self.rules.pairs()[1]
        return found

    @cached_property
    def pair_offsets(self) -> Integers:
        """(S+1,) pairs of state s are pair_offsets[s] … pair_offsets[s+1]-1."""
        counts = np.bincount(self.pair_state, minlength=self.n_states)
        return np.concatenate([[0], np.cumsum(counts)])

    @cached_property
    def terminal(self) -> NDArray[np.bool_]:
        """(S,) True at the end."""
        return np.asarray(np.arange(self.n_states) == self.n_states - 1)

    @cached_property
    def forced(self) -> NDArray[np.bool_]:
        """(S,) True where a state has a single action."""
        return np.asarray(np.diff(self.pair_offsets) == 1)

    def action(self, name: str) -> int:
        """Return the number of the action called `name`."""
        if name not in self.actions:
            fix = suggest(name, self.actions)
            raise ModelError(f"unknown action {name!r}", where="actions", fix=fix)
        return self.actions.index(name)

    def backup(self, value: ArrayLike) -> Floats:
        """Return (L,) action values r + γ P V for (S,) state values."""
        value = float_array(value)
        if value.shape != (self.n_states,):
            raise ModelError(
                f"values of shape {value.shape} for {self.n_states:,} states",
                where=f"operator {self.name}",
                fix="give one value for each state",
            )
        q = np.zeros(self.n_pairs)
        width = (self.n_pairs - 1) // len(self.kinds)
        wide = self.rules.assistive * self.rules.vectors
        for number in range(len(self.kinds)):
            block = q[number * width : (number + 1) * width]
            for layer, (trial, flag) in enumerate(self.layers()):
                x, _ = self.ahead(value, number, trial, flag)
                block[layer * wide : (layer + 1) * wide] = self.q(x).T.reshape(-1)
            if self.rules.own:
                alone = self.alone_q(value, number)
                block[wide * len(self.layers()) :] = np.tile(alone, self.rules.flags)
        return q

    # ---- one trial -----------------------------------------------------------------------------

    def layers(self) -> list[tuple[int, int]]:
        """Return trial and flag of each group of states with a choice, in their order."""
        return [(t, f) for t in range(self.rules.trials) for f in range(self.rules.flags)]

    def after(self, value: Floats, number: int, flag: int) -> Floats:
        """Return (2^n,) the values of the first trial behind subtask `number`; 0 at the end."""
        kind, vectors = int(self.kinds[number]), self.rules.vectors
        if kind == 2:
            return np.zeros(vectors)
        begin = (number + 1) * self.rules.size + self.rules.kept(flag, last=kind > 0) * vectors
        return value[begin : begin + vectors]

    def ahead(
        self, value: Floats, number: int, trial: int, flag: int, expect: Expect = Law.expect
    ) -> tuple[Floats, float]:
        """Return what a trial earns from its outcome on, by next status vector.

        Also returns how far the expectation over a skip in it may be off, in units of roundoff.
        """
        rules, kind, rate = self.rules, int(self.kinds[number]), self.discount
        next_first, error = self.after(value, number, flag)[0], 0.0
        if trial + 1 < rules.trials or rules.own:
            begin = number * rules.size + ((trial + 1) * rules.flags + flag) * rules.vectors
            x = self.fail + rate * value[begin : begin + rules.vectors]
        else:
            after = self.after(value, number, 1)
            base = after[0]
            spread = after - base
            x = self.fail + (self.skipped[kind] + rate * (base + expect(self.skip, spread)[0]))
            error = self.skip.error * float(np.abs(spread).max())
        x[0] = self.complete[kind, flag] + rate * next_first
        return x, error

    def alone_q(self, value: Floats, number: int, expect: Expect = Law.expect) -> Floats:
        """Return (2^n,) the values of states in which a skip takes its own timestep."""
        after = self.after(value, number, 1)
        base = after[0]
        law = base + expect(self.skip, after - base)[0]
        return np.asarray((self.alone + self.skipped[self.kinds[number]]) + self.discount * law)

    def q(self, x: Floats, expect: Expect = Law.expect) -> Floats:
        """Return (A, 2^n) action values, from what each next status vector is worth."""
        base = x[0]
        return np.asarray(self.const + (base + expect(self.step, x - base)))


def care_operator(scenario: Scenario) -> CareOperator:
    """Return the operator of a scenario; see `Scenario.operator`."""
    count = len(scenario.statuses)
    found = chances(scenario)
    rules = Rules(scenario, found.bits)
    values = [parameter.value for parameter in scenario.parameters]
    step, off = chances_of(found.step, values)
    skip, skip_off = chances_of(found.skip[:, None], values)
    dense, dense_skip = np.empty((0, 0)), np.empty((0, 0))
    if count <= DENSE_STATUSES:
        exact = status_kernels(scenario)
        law = divide(
            exact.step, np.broadcast_to(exact.step_denominator[..., None], exact.step.shape)
        )
        dense = np.ascontiguousarray(law.transpose(2, 1, 0).reshape(rules.vectors, -1))
        bottom = np.broadcast_to(integers([exact.skip_denominator]), exact.skip.shape)
        dense_skip = np.ascontiguousarray(divide(exact.skip, bottom).T)
    laws = law_of(step, off, dense), law_of(skip, skip_off, dense_skip)
    none = np.prod(1.0 - step, axis=2)
    assist = as_gains(rules, rules.assist)
    cost = as_gains(rules, rules.cost)
    present = np.zeros_like(cost) if rules.following else cost
    following = rules.cost if rules.following else 0 * rules.cost
    fixed = float(as_gains(rules, rules.gains([rules.worth["timestep"]]))[0])
    alone = fixed + (laws[1].expect(cost)[0] if rules.following else cost)
    places = range(3)
    complete = [[rules.completing(last=k > 0, flag=f) for f in range(2)] for k in places]
    return CareOperator(
        scenario=scenario,
        rules=rules,
        step=laws[0],
        skip=laws[1],
        const=assist[:, None] * (dense[0].reshape(len(assist), -1) if len(dense) else none)
        + present,
        fail=as_gains(rules, rules.gains([rules.failing()]) + following),
        complete=as_gains(rules, rules.gains([g for row in complete for g in row])).reshape(3, 2),
        skipped=as_gains(rules, rules.gains([rules.skipping(last=k > 0) for k in places])),
        alone=alone,
        kinds=kinds(scenario),
    )


def _refuse(operator: CareOperator, name: str) -> NoReturn:
    raise ModelError(
        f"an operator has no matrix, and this needs one ({name})",
        where=f"operator {operator.scenario.name}",
        fix="compile the scenario: Scenario.compile(); an operator serves solvers.solve (by "
        "backward induction), solvers.operator_mean and backup",
    )


def as_gains(rules: Rules, values: Numbers) -> Floats:
    """Return sums of weights as floats, each rounded once."""
    return divide(values, np.broadcast_to(integers([rules.scale]), values.shape))
