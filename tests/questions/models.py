"""Small random models, the questions about them, and how the toolkit is asked the same.

A `Case` is one model and one question: the problem of the oracle beside the model of the toolkit,
today and at other values of two parameters, p (the probability of one entry of a row, of which the
others share what is left) and r (the amount of one component that a pair earns).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction as F
from functools import cached_property
from random import Random
from typing import Any

from exact_mdp import MDP, Column, Family, Parameter, Policy, StateSpace

from . import oracle
from .oracle import Outcome, Plain, Problem

ACTIONS = ("a", "b", "c")
SPACE = StateSpace(columns=(Column(name="place", size=2), Column(name="status", size=2, bits=1)))
SIZE = 4
PARTS = ("qaly", "cost")
DISCOUNTS = (F(1, 2), F(3, 4), F(9, 10))


@dataclass(frozen=True)
class Shape:
    """What random models of a question look like."""

    discount: str = "below"  # below 1, "one", or "any" of both
    ending: bool = False  # whether every policy ends
    by_outcome: bool = False  # whether components differ between outcomes of a pair
    ends: bool = False  # whether an end has several actions
    starts: bool = False  # whether there are two states to start in
    sense: str = "max"
    labelled_ends: bool = False  # whether the goal is an end, beside which there is another one


@dataclass(frozen=True)
class Question:
    """A question: how the oracle and the toolkit are asked, and what its models look like."""

    name: str
    of_oracle: Callable[[Plain], Problem]
    of_toolkit: Callable[[MDP], MDP]
    shape: Shape
    options: Mapping[str, Any]  # of the analyses, such as the criterion
    amount: str | None = None  # the component that counts, where it is one


def _total(plain: Plain) -> Problem:
    return oracle.total(plain)


def _same(mdp: MDP) -> MDP:
    return mdp


def _until(plain: Plain) -> Problem:
    return oracle.until(plain, "goal")


def _asked(
    name: str,
    of_oracle: Callable[[Plain], Problem],
    of_toolkit: Callable[[MDP], MDP],
    amount: str | None = None,
    options: Mapping[str, Any] | None = None,
    **shape: Any,
) -> Question:
    return Question(name, of_oracle, of_toolkit, Shape(**shape), options or {}, amount)


QUESTIONS = (
    _asked("discounted", _total, _same),
    _asked("total, every policy ends", _total, _same, discount="one", ending=True),
    _asked("total, policies that never end", _total, _same, discount="one"),
    _asked("until, max", _until, lambda m: m.until("goal"), discount="one", labelled_ends=True),
    _asked(
        "until, min",
        _until,
        lambda m: m.until("goal"),
        discount="one",
        labelled_ends=True,
        sense="min",
    ),
    _asked("until, discounted", _until, lambda m: m.until("goal"), labelled_ends=True),
    _asked(
        "reaching",
        lambda p: oracle.reaching(p, "goal"),
        lambda m: m.reaching("goal"),
        discount="any",
    ),
    _asked(
        "reaching, least",
        lambda p: oracle.reaching(p, "goal"),
        lambda m: m.reaching("goal"),
        discount="any",
        sense="min",
    ),
    _asked(
        "within",
        lambda p: oracle.within(oracle.total(p), 2),
        lambda m: m.within(2),
        discount="any",
    ),
    _asked(
        "within of until",
        lambda p: oracle.within(_until(p), 3),
        lambda m: m.until("goal").within(3),
        discount="any",
        sense="min",
        labelled_ends=True,
    ),
    _asked(
        "until of within",
        lambda p: oracle.within(_until(p), 3),
        lambda m: m.within(3).until("goal"),
        discount="any",
        sense="min",
        labelled_ends=True,
    ),
    _asked(
        "average",
        lambda p: replace(oracle.total(p), average=True),
        _same,
        options={"criterion": "average"},
        discount="any",
    ),
    _asked("costs", _total, _same, sense="min"),
    _asked(
        "several starts",
        _total,
        _same,
        discount="one",
        starts=True,
    ),
    _asked(
        "components by outcome",
        lambda p: oracle.until(p, "goal", oracle.component("qaly")),
        lambda m: m.until("goal", reward="qaly"),
        amount="qaly",
        by_outcome=True,
        labelled_ends=True,
    ),
    _asked("ends with several actions", _total, _same, ends=True),
    _asked(
        "ends with several actions, total", _total, _same, ends=True, discount="one", ending=True
    ),
)


# ---- random models -------------------------------------------------------------------------------


def _chances(rng: Random, count: int) -> list[F]:
    whole = [rng.randint(1, 3) for _ in range(count)]
    return [F(each, sum(whole)) for each in whole]


def _row(rng: Random, state: int, shape: Shape) -> list[Outcome]:
    """Return random outcomes of a pair."""
    count = rng.choice((1, 2, 2, 3))
    targets = sorted(rng.sample(range(SIZE), count))
    if shape.ending and max(targets) <= state:
        targets[-1] = rng.randint(state + 1, SIZE - 1)
    shared = {name: F(rng.randint(-2, 3)) for name in PARTS}
    outcomes = []
    for p, to in zip(_chances(rng, len(targets)), targets, strict=True):
        amounts = {name: F(rng.randint(-2, 3)) for name in PARTS} if shape.by_outcome else shared
        outcomes.append((p, to, amounts))
    if shape.by_outcome and rng.random() < 0.3:  # two outcomes that lead to one state
        p, to, amounts = outcomes.pop()
        other = {name: F(rng.randint(-2, 3)) for name in PARTS}
        outcomes += [(p / 2, to, amounts), (p / 2, to, other)]
    return outcomes


def _stays(state: int) -> list[Outcome]:
    return [(F(1), state, dict.fromkeys(PARTS, F(0)))]


def random_model(rng: Random, shape: Shape) -> Plain:
    """Return a random model of four states, in the last of which a run often ends."""
    rows = list[list[tuple[int, list[Outcome]]]]()
    last_ends = shape.ending or shape.ends or shape.labelled_ends or rng.random() < 0.5
    for state in range(SIZE):
        actions = sorted(rng.sample(range(3), rng.choice((1, 1, 2, 2, 3))))
        beside = shape.labelled_ends and state == SIZE - 2 and rng.random() < 0.5
        if (last_ends and state == SIZE - 1) or beside:
            several = shape.ends or rng.random() < 0.2
            actions = [0, 1] if several else [0]
            rows.append([(action, _stays(state)) for action in actions])
            continue
        rows.append([(action, _row(rng, state, shape)) for action in actions])
    if shape.discount == "any":
        discount = rng.choice((*DISCOUNTS, F(1), F(1)))
    else:
        discount = F(1) if shape.discount == "one" else rng.choice(DISCOUNTS)
    start = {0: F(1)} if not shape.starts else {0: F(1, 3), rng.randint(1, SIZE - 1): F(2, 3)}
    goal = frozenset({SIZE - 1} if rng.random() < 0.8 else {SIZE - 1, rng.randrange(1, SIZE)})
    return Plain(rows, discount, start, shape.sense, {"goal": goal})


def toolkit_model(plain: Plain) -> MDP:
    """Return the model of the toolkit."""
    rows = [
        (state, action, [(p, to, dict(amounts)) for p, to, amounts in outcomes])
        for state, each in enumerate(plain.rows)
        for action, outcomes in each
    ]
    labels = {
        name: [state in states for state in range(len(plain.rows))]
        for name, states in plain.labels.items()
    }
    start = [plain.start.get(state, F(0)) for state in range(len(plain.rows))]
    return MDP.from_outcomes(
        rows,
        plain.discount,
        start=start,
        labels=labels,
        sense=plain.sense,
        space=SPACE,
        actions=ACTIONS,
    )


# ---- cases ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """A model, a question about it, and what is varied."""

    plain: Plain
    question: Question
    entry: tuple[int, int, int] | None  # the state, the place of the action, and next state of p
    pair: tuple[int, int]  # the state and the place of the action that earn r
    choice: tuple[int, ...]  # a policy: the place of the action in each state

    @classmethod
    def random(cls, rng: Random, question: Question) -> Case:
        """Return a random case."""
        plain = random_model(rng, question.shape)
        entries = [
            (s, k, to)
            for s, each in enumerate(plain.rows)
            for k, (_, outcomes) in enumerate(each)
            for to in {to for _, to, _ in outcomes}
            if len({to for _, to, _ in outcomes}) > 1
        ]
        moving = [
            (s, k)
            for s, each in enumerate(plain.rows)
            for k, (_, outcomes) in enumerate(each)
            if any(sum(amounts.values()) for *_, amounts in outcomes) or len(outcomes) > 1
        ]
        pair = rng.choice(moving) if moving else (0, 0)
        choice = tuple(rng.randrange(len(each)) for each in plain.rows)
        return cls(plain, question, rng.choice(entries) if entries else None, pair, choice)

    # ---- today -----------------------------------------------------------------------------------

    @cached_property
    def problem(self) -> Problem:
        """What the oracle is asked."""
        return self.question.of_oracle(self.plain)

    @cached_property
    def base(self) -> MDP:
        """The model of the toolkit, before the question."""
        return toolkit_model(self.plain)

    @cached_property
    def mdp(self) -> MDP:
        """What the toolkit is asked."""
        return self.question.of_toolkit(self.base)

    @cached_property
    def policy(self) -> Policy:
        """The policy, as the toolkit takes it."""
        actions = [each[k][0] for each, k in zip(self.plain.rows, self.choice, strict=True)]
        return Policy.of(self.base, actions)

    def mixture(self, problem: Problem, choice: Sequence[int] | None = None) -> list[list[F]]:
        """Return a policy over the model's states as one of the problem, the same at every time."""
        chosen = self.choice if choice is None else choice
        repeated = [chosen[s % SIZE] for s in range(len(problem.moves))]
        return [
            [F(k == taken) for k in range(len(each))] if len(each) > 1 else [F(1)]
            for each, taken in zip(problem.moves, repeated, strict=True)
        ]

    @cached_property
    def optimum(self) -> list[oracle.Value]:
        """The best values."""
        return oracle.optimum(self.problem)

    @cached_property
    def worth(self) -> list[oracle.Value]:
        """The values of the policy."""
        return oracle.evaluate(self.problem, self.mixture(self.problem))

    def start_of(self, values: Sequence[oracle.Value]) -> oracle.Value | None:
        """Return the value at the start."""
        return oracle.at_start(self.problem, values)

    # ---- at other values of the parameters -------------------------------------------------------

    @cached_property
    def today(self) -> dict[str, F]:
        """The values of p and r in the model."""
        s, k = self.pair
        amounts = {each["qaly"] for *_, each in self.plain.rows[s][k][1]}
        values = {"r": max(amounts)}
        if self.entry is not None:
            s, k, to = self.entry
            values["p"] = sum((p for p, t, _ in self.plain.rows[s][k][1] if t == to), F(0))
        return values

    def plain_at(self, values: Mapping[str, F]) -> Plain:
        """Return the model at other values of the parameters."""
        changed = self.plain
        if values.get("r", self.today["r"]) != self.today["r"]:
            s, k = self.pair
            outcomes = [
                (p, to, {**each, "qaly": each["qaly"] + values["r"] - self.today["r"]})
                for p, to, each in changed.rows[s][k][1]
            ]
            changed = changed.with_row(s, k, outcomes)
        if self.entry is not None and values.get("p", self.today["p"]) != self.today["p"]:
            s, k, to = self.entry
            changed = changed.with_chance(s, k, {to: values["p"]})
        return changed

    def problem_at(self, values: Mapping[str, F]) -> Problem:
        """Return the problem at other values."""
        return self.question.of_oracle(self.plain_at(values))

    def optimum_at(self, values: Mapping[str, F]) -> oracle.Value | None:
        """Return the best value at the start, at other values."""
        problem = self.problem_at(values)
        return oracle.at_start(problem, oracle.optimum(problem))

    def worth_at(
        self, values: Mapping[str, F], choice: Sequence[int] | None = None
    ) -> oracle.Value | None:
        """Return the value of a policy at the start, at other values."""
        problem = self.problem_at(values)
        return oracle.at_start(problem, oracle.evaluate(problem, self.mixture(problem, choice)))

    @cached_property
    def family(self) -> Family:
        """The models of the toolkit at all values, each with the question asked of it."""
        parameters = [Parameter(name="r", value=self.today["r"], unit="reward")]
        if "p" in self.today:
            parameters.append(Parameter(name="p", value=self.today["p"], low=F(0), high=F(1)))

        def build(at: Mapping[str, F]) -> MDP:
            return self.question.of_toolkit(toolkit_model(self.plain_at(at)))

        return Family(parameters=tuple(parameters), build=build)

    @property
    def spans(self) -> dict[str, tuple[F, F]]:
        """Ranges of the parameters, inside of what they may be."""
        spans = {"r": (self.today["r"] - 2, self.today["r"] + 1)}
        if "p" in self.today:
            p = self.today["p"]
            spans["p"] = (p / 2, (1 + p) / 2)
        return spans
