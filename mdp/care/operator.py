"""How a status vector moves: independent next statuses, summed out one at a time.

    E[x(s') | s, a] = Σ_s' x(s') Π_i p_i(s, a)^{s'_i} (1 - p_i(s, a))^{1 - s'_i}

is n folds of the vector x, each of which halves it: x(…, 0, …) + p_i (x(…, 1, …) - x(…, 0, …)).
Folding anew for each of the 2^n present vectors s takes 4^n steps. But statuses of s are decided
one by one here, and a next status is folded as soon as its chance depends on nothing undecided, so
that all vectors with the same beginning share what was folded so far. Where a chance depends on all
other statuses if its own is absent, and on none if it is present or assisted, 2 · 3^n steps are
enough: sum over the 3^n ways in which each status is decided and folded, decided and kept, or
undecided. Up to 6 statuses the law is a small matrix, made from the exact one and stored once.

That a product law is applied factor by factor is due to Yates, The design and analysis of factorial
experiments, 1937.

The care model without its matrix: states and rewards as ever, next statuses by their law.

    q(s, a) = const(a, s) + E[x(s') | s, a],    x(s') = gain(s') + γ V(next(s')),

where s' = 0 completes the subtask and every other s' fails the trial, and after the last trial
x(s') is itself an expectation, over what a skip makes of s'. All gains but those of the action and
of the present status depend on s' alone, so that one vector x serves all actions and states of a
trial. `mdp.care.operator` says how expectations are had in far fewer than 4^n steps.

Memory is that of the 2^n · n · A chances and of a few vectors; no table of transitions exists.
Source of the model: Yuan et al. (2025), Section 2.1, Equation 1 and Table 4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from math import lcm
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.care.laws import chances, status_kernels
from exact_mdp.mdp.care.rules import Rules, kinds
from exact_mdp.mdp.care.tables import Tables
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import (
    EXACT_IN_FLOAT,
    Floats,
    Integers,
    Numbers,
    as_float,
    divide,
    float_array,
    integers,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Law:
    """How the status vector moves under R rules (actions, or the skip): apply it with `expect`.

    Attributes
    ----------
    chance : (R, 2^n, n)
        Chance of each status next.
    ready : (R, n, 2) ints
        Statuses are decided from the last to the first; after how many of them, less one, the
        chance of status i is known, where it is absent or present itself.
    dense : (2^n, R · 2^n) or (0, 0)
        The law itself, next vectors in rows, where it is small.
    error : float
        In units of roundoff: E[x] as computed is off by at most error · max |x|.
    """

    chance: Floats
    ready: Integers
    dense: Floats
    error: float

    @property
    def vectors(self) -> int:
        """2^n."""
        return int(self.chance.shape[1])

    def expect(self, x: Floats) -> Floats:
        """Return (R, 2^n) the expectation of x (2^n,) from each present vector."""
        rules = len(self.chance)
        if len(self.dense):
            total = np.zeros(rules * self.vectors)
            for following, worth in enumerate(x.tolist()):
                total += self.dense[following] * worth
            return total.reshape(rules, self.vectors)
        return np.stack([_fold(self.chance[r], self.ready[r], x) for r in range(rules)])


Expect = Callable[[Law, Floats], Floats]


def chances_of(terms: Integers, values: list[Fraction]) -> tuple[Floats, float]:
    """Return the chances (R, 2^n, n), and how many units of roundoff they may be off by."""
    shared = lcm(*(value.denominator for value in values))
    count = terms.shape[-1]
    # Numbers over a common denominator add up exactly, and each chance is rounded once.
    exact = max(abs(value) for value in values) * shared * (count + 1) < EXACT_IN_FLOAT
    one = shared if exact else 1
    numbers = np.array([as_float(value * one) for value in values] + [0.0])
    total = numbers[terms[..., 0]]
    for column in range(1, count):
        total = total + numbers[terms[..., column]]
    chance = np.minimum(total, float(one)) / float(one)
    return np.ascontiguousarray(chance.transpose(1, 0, 2)), 1.0 if exact else count + 3.0


def law_of(chance: Floats, off: float, dense: Floats) -> Law:
    rules, vectors, count = chance.shape
    ready = np.zeros((rules, count, 2), dtype=np.int64)
    for r in range(rules):
        for i in range(count):
            cube = chance[r, :, i].reshape((2,) * count)
            for present in (0, 1):
                part = cube.take([present], axis=i)
                known = count - 1 - i
                for j in range(count):
                    if j != i and (part.take(0, axis=j) != part.take(1, axis=j)).any():
                        known = max(known, count - 1 - j)
                ready[r, i, present] = known
    # A fold is off by the error of p and four roundings of numbers of at most 2 max |x|; a row of
    # the dense law is a sum of 2^n products.
    error = vectors + 3.0 if len(dense) else count * (2 * off + 6.0)
    return Law(chance=chance, ready=ready, dense=dense, error=error)


def _fold(chance: Floats, ready: Integers, x: Floats) -> Floats:
    """Return (2^n,) expectations from every present vector, by the recursion above."""
    count = chance.shape[1]
    found = np.empty(len(x))

    def visit(depth: int, state: int, x: Floats, kept: tuple[int, ...]) -> None:
        if depth == count:
            found[state] = x[0]
            return
        for present in (0, 1):
            here = state | present << depth
            y, left = x, [*kept, depth]
            for place in range(len(left) - 1, -1, -1):  # those kept longest are the last digits
                i = count - 1 - left[place]
                if ready[i, here >> left[place] & 1] <= depth:
                    halves = y.reshape(-1, 2, 2**place)
                    y = halves[:, 0] + chance[here, i] * (halves[:, 1] - halves[:, 0])
                    del left[place]
            visit(depth + 1, here, y.reshape(-1), tuple(left))

    visit(0, 0, x, ())
    return found


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
    >>> from exact_mdp import Scenario
    >>> operator = Scenario.load("yuan2025").operator()
    >>> operator
    CareOperator(yuan2025: 241 states, 4 actions, 961 pairs, discount 1, 13 kB)
    >>> operator.backup(np.zeros(241)).shape
    (961,)
    """

    scenario: Tables
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


def care_operator(scenario: Tables) -> CareOperator:
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
