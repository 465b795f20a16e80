"""The care model without its matrix: states and rewards as usual, next statuses by their law.

    q(s, a) = const(a, s) + E[x(s') | s, a],    x(s') = gain(s') + γ V(next(s')),

where s' = 0 completes the subtask and every other s' fails the trial, and after the last trial
x(s') is itself an expectation, over what a skip makes of s'. All gains but those of the action and
of the present status depend on s' alone, so that one vector x serves all actions and states of a
trial. The rules are those of `mdp.care.rules`.

The next statuses are independent, and are summed out one at a time:

    E[x(s') | s, a] = Σ_s' x(s') Π_i p_i(s, a)^{s'_i} (1 - p_i(s, a))^{1 - s'_i}

is n folds of the vector x, each of which halves it: x(…, 0, …) + p_i (x(…, 1, …) - x(…, 0, …)).
Folding anew for each of the 2^n present vectors s takes 4^n steps. But statuses of s are decided
one by one here, and a next status is folded as soon as its chance depends on nothing undecided, so
that all vectors with the same beginning share what was folded so far. Where a chance depends on all
other statuses if its own is absent, and on none if it is present or assisted, 2 · 3^n steps are
enough: sum over the 3^n ways in which each status is decided and folded, decided and kept, or
undecided. Up to 6 statuses the law is a small matrix, made from the exact one and stored once.

Memory is that of the 2^n · n · A chances and of a few vectors; no table of transitions exists.
Sources: Yuan et al. (2025), Section 2.1, Equation 1 and Table 4; that a product law is applied
factor by factor is due to Yates, The design and analysis of factorial experiments, 1937.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, ClassVar, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.care.laws import ExactChances, chances
from exact_mdp.mdp.care.rules import FINAL, PLACES, Rules
from exact_mdp.mdp.care.tables import Tables
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.parametric.parameter import Parameter
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Integers, divide, float_array, integers

DENSE_STATUSES = 6
EXPLICIT = (
    *("table", "transition", "reward", "components", "component_names", "events"),
    *("n_transitions", "start_distribution", "pair", "pairs_of", "where", "with_"),
)
"""What an explicit model has and an operator lacks."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Law:
    """How the status vector moves under R laws (of actions, or of the skip).

    Attributes
    ----------
    chance : (R, 2^n, n)
        Chance of each status next, rounded once.
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

    @classmethod
    def of(cls, chance: Floats, dense: Floats) -> Law:
        """Return the law of some chances (R, 2^n, n)."""
        rules, vectors, count = chance.shape
        ready = np.zeros((rules, count, 2), dtype=np.int64)
        for r in range(rules):
            for i in range(count):
                cube = chance[r, :, i].reshape((2,) * count)
                for present in (0, 1):
                    part, known = cube.take([present], axis=i), count - 1 - i
                    for j in range(i):  # a status that is decided later than i, and matters
                        if (part.take(0, axis=j) != part.take(1, axis=j)).any():
                            known = count - 1 - j
                            break
                    ready[r, i, present] = known
        # A fold is off by the error of p and four roundings of numbers of at most 2 max |x|; a row
        # of the dense law is a sum of 2^n products.
        error = vectors + 3.0 if len(dense) else count * 8.0
        return cls(chance=chance, ready=ready, dense=dense, error=error)

    def expect(self, x: Floats) -> Floats:
        """Return (R, 2^n) the expectation of x (2^n,) from each present vector."""
        if len(self.dense):
            total = np.zeros(self.dense.shape[1])
            for following, worth in enumerate(x.tolist()):
                total += self.dense[following] * worth
            return total.reshape(len(self.chance), -1)
        return np.stack([_fold(*law, x) for law in zip(self.chance, self.ready, strict=True)])


Expect = Callable[[Law, Floats], Floats]


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
        Gain of a completed one by place of the subtask and flag; the action's own is in `const`.
    skipped : (3,)
        Gain of a skip by place of the subtask, but for statuses.
    alone : (2^n,)
        What a skip that takes its own timestep charges for statuses, expected.

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

    @classmethod
    def of(cls, scenario: Tables) -> CareOperator:
        """Return the operator of a scenario; see `Scenario.operator`."""
        rules, found = Rules(scenario), chances(scenario)
        sums, bottom = found.sums(scenario)
        whole = integers([bottom])
        chance = divide(np.minimum(sums, bottom), np.broadcast_to(whole, sums.shape))
        step = np.ascontiguousarray(chance[found.step].transpose(1, 0, 2))
        skip = chance[found.skip][None]
        dense = dense_skip = np.empty((0, 0))
        completing = np.prod(1.0 - step, axis=2)
        if len(scenario.statuses) <= DENSE_STATUSES:
            exact = ExactChances(scenario).laws()
            bottoms = np.broadcast_to(exact.step_denominator[..., None], exact.step.shape)
            law = divide(exact.step, bottoms).transpose(2, 1, 0)
            dense = np.ascontiguousarray(law.reshape(rules.vectors, -1))
            bottoms = np.broadcast_to(integers([exact.skip_denominator]), exact.skip.shape)
            dense_skip = np.ascontiguousarray(divide(exact.skip, bottoms).T)
            completing = dense[0].reshape(rules.assistive, -1)
        skipping = Law.of(skip, dense_skip)
        complete = [rules.gain("complete", place, flag) for place in PLACES for flag in (0, 1)]
        return cls(
            scenario=scenario,
            rules=rules,
            step=Law.of(step, dense),
            skip=skipping,
            const=rules.rounded(rules.assist)[:, None] * completing + rules.rounded(rules.present),
            fail=rules.rounded(rules.gain("fail") + rules.following),
            complete=rules.rounded(rules.gains(complete)).reshape(3, 2),
            skipped=rules.rounded(rules.gains([rules.gain("skip", p, 1) for p in PLACES])),
            alone=rules.rounded(rules.present) + skipping.expect(rules.rounded(rules.following))[0],
        )

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

    sense: ClassVar[str] = "max"

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
        return len(self.rules.places) * self.rules.size + 1

    @property
    def n_actions(self) -> int:
        """Number of actions, A."""
        return len(self.actions)

    @property
    def n_pairs(self) -> int:
        """Number of available state-action pairs, L."""
        return len(self.rules.places) * len(self.rules.pairs()[0]) + 1

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
        own = (self.const, self.fail, self.complete, self.skipped, self.alone, self.rules.places)
        return sum(array.nbytes for array in (*laws, *own))

    @cached_property
    def space(self) -> StateSpace:
        """What the state numbers mean."""
        return self.rules.space(len(self.rules.places))

    @cached_property
    def pair_state(self) -> Integers:
        """(L,) state of each pair."""
        starts = np.arange(len(self.rules.places))[:, None] * self.rules.size
        return np.append((starts + self.rules.pairs()[0]).reshape(-1), self.n_states - 1)

    @cached_property
    def pair_action(self) -> Integers:
        """(L,) action of each pair."""
        return np.append(np.tile(self.rules.pairs()[1], len(self.rules.places)), 0)

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

    @cached_property
    def asked(self) -> NDArray[np.bool_]:
        """(S,) True where a policy has to say what is done."""
        return ~self.forced & ~self.terminal

    def action(self, name: str) -> int:
        """Return the number of the action called `name`."""
        if name not in self.actions:
            fix = suggest(name, self.actions)
            raise ModelError(f"unknown action {name!r}", where="actions", fix=fix)
        return self.actions.index(name)

    def backup(self, value: ArrayLike) -> Floats:
        """Return (L,) action values r + γ P V for (S,) state values."""
        value, rules = float_array(value), self.rules
        if value.shape != (self.n_states,):
            raise ModelError(
                f"values of shape {value.shape} for {self.n_states:,} states",
                where=f"operator {self.name}",
                fix="give one value for each state",
            )
        parts = []
        for number in range(len(rules.places)):
            for trial in range(rules.trials):
                for flag in range(rules.flags):
                    x = self.ahead(value, number, trial, flag)
                    parts.append(self.q(x).T.reshape(-1))
            if rules.own:
                parts += [self.alone_q(value, number)] * rules.flags
        return np.concatenate([*parts, np.zeros(1)])

    # ---- one trial -----------------------------------------------------------------------------

    def after(self, value: Floats, number: int, flag: int) -> Floats:
        """Return (2^n,) the values of the first trial behind subtask `number`; 0 at the end."""
        rules, place = self.rules, int(self.rules.places[number])
        if place == FINAL:
            return np.zeros(rules.vectors)
        begin = number * rules.size + int(rules.after(flag, place)[0])
        return value[begin : begin + rules.vectors]

    def ahead(
        self, value: Floats, number: int, trial: int, flag: int, expect: Expect = Law.expect
    ) -> Floats:
        """Return (2^n,) what a trial earns from its outcome on, by next status vector."""
        rules, place, rate = self.rules, int(self.rules.places[number]), self.discount
        if trial + 1 < rules.trials or rules.own:
            begin = number * rules.size + ((trial + 1) * rules.flags + flag) * rules.vectors
            x = self.fail + rate * value[begin : begin + rules.vectors]
        else:
            x = self.fail + (self.skipped[place] + rate * self._skipping(value, number, expect))
        x[0] = self.complete[place, flag] + rate * self.after(value, number, flag)[0]
        return x

    def alone_q(self, value: Floats, number: int, expect: Expect = Law.expect) -> Floats:
        """Return (2^n,) the values of states in which a skip takes its own timestep."""
        own = self.alone + self.skipped[self.rules.places[number]]
        return np.asarray(own + self.discount * self._skipping(value, number, expect))

    def _skipping(self, value: Floats, number: int, expect: Expect) -> Floats:
        """Return (2^n,) the values of the next subtask, expected over what a skip makes of s'."""
        after = self.after(value, number, 1)
        return np.asarray(after[0] + expect(self.skip, after - after[0])[0])

    def q(self, x: Floats, expect: Expect = Law.expect) -> Floats:
        """Return (A, 2^n) action values, from what each next status vector is worth."""
        return np.asarray(self.const + (x[0] + expect(self.step, x - x[0])))


def _refuse(operator: CareOperator, name: str) -> NoReturn:
    raise ModelError(
        f"an operator has no matrix, and this needs one ({name})",
        where=f"operator {operator.scenario.name}",
        fix="compile the scenario: Scenario.compile(); an operator serves solvers.solve (by "
        "backward induction), solvers.operator_mean and backup",
    )
