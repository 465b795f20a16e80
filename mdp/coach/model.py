"""COACH, the handwashing assistant: the published reduced model, and a generator of large ones.

A person with dementia washes their hands; the assistant waits or prompts. What the person does
next (their behaviour) is drawn from weights that are made to add up to 1, and the plan step
follows from it:

    P(b' | step, user, prompt) ∝ weight(b' | step, user) + effect(prompt) [b' is what it asks for],
    step' = next(step, b'),    reward = reward(step) - price(prompt | user).

The user responds to prompts or not, and is aware of the task or not; neither ever changes. With
`Coach()` this is the reduced model of 180 states and 6 actions, every number of it published.
`Coach.full()` has the size of the model of Boger et al. (2005), 50,181,120 states and 20 actions.
Of that one only the counts of states and actions were to be had, so its further factors are ours:
a level of dementia, the last prompt with its level, how often it was repeated, prompts that were
ignored, all prompts so far, and time waited. `NUMBERS` says of each number where it comes from.

Sources: those of `mdp.coach.numbers`. Research software, no medical advice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import cache, cached_property
from itertools import product
from math import prod
from typing import Any

from exact_mdp.mdp.care.tables import exact_at
from exact_mdp.mdp.coach.memory import CAREGIVER, NOTHING, Memory
from exact_mdp.mdp.coach.numbers import (
    BEHAVIOURS,
    DEMENTIA,
    EARNED,
    FILE,
    LEVELS,
    NEXT,
    NUMBERS,
    PROMPTS,
    RIGHT,
    RINSE,
    STEPS,
)
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.family import DISCOUNT, Family
from exact_mdp.mdp.parametric.parameter import Parameter
from exact_mdp.mdp.space import Column, StateSpace

MOST_PAIRS = 300_000  # of an explicit model: exact rows take some microseconds an outcome
USERS = tuple(product(("no", "yes"), repeat=2))  # responsive, aware


@dataclass(frozen=True, kw_only=True, eq=False)
class Coach:
    """The handwashing assistant as factors: states and rules, no matrix.

    `compile` makes the explicit exact model of a small one; `solvers.solve` takes any size.

    Attributes
    ----------
    waited, prompted, ignored, repeated : int
        How many values each counter has; 1 leaves it out. The last value means "or more".
    dementia : int
        Levels of dementia: 3, or 1 for the moderate one.
    levels : int
        Levels of a prompt: 3 (and then the last prompt is remembered, a caregiver can be called
        and hands can be asked to be rinsed), or 1.
    numbers : {name: Fraction}
        All of `NUMBERS`; those that are left out are taken from there.

    Examples
    --------
    >>> Coach()
    Coach(180 states, 6 actions, discount 9/10)
    >>> Coach.full()
    Coach(50181120 states, 20 actions, discount 9/10)
    >>> Coach().compile()
    MDP(coach: 180 states, 6 actions, 1080 pairs, 5400 transitions, discount 9/10)
    """

    waited: int = 1
    prompted: int = 1
    ignored: int = 1
    repeated: int = 1
    dementia: int = 1
    levels: int = 1
    numbers: Mapping[str, Fraction] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, allowed in (("dementia", (1, 3)), ("levels", (1, 3))):
            if getattr(self, name) not in allowed:
                raise ModelError(f"{name} is {getattr(self, name)}", where="coach", fix="1 or 3")
        for name in ("waited", "prompted", "ignored", "repeated"):
            size = getattr(self, name)
            if not isinstance(size, int) or size < 1:
                raise ModelError(f"{name} is {size!r}", where="coach", fix="give 1 or more")
        for name in self.numbers:
            if name not in NUMBERS:
                fix = suggest(name, NUMBERS)
                raise ModelError(f"unknown number {name!r}", where="coach", fix=fix)
        given = {name: exact_at(f"coach, {name}", value) for name, value in self.numbers.items()}
        everything = {name: number.value for name, number in NUMBERS.items()} | given
        object.__setattr__(self, "numbers", everything)
        if not 0 <= everything["discount"] < 1:
            raise ModelError(
                f"the discount is {everything['discount']}",
                where="coach",
                fix="from 0 to below 1: the episode never ends",
            )
        weights = [row for user in range(self.n_users) for row in self.weights(user)]
        if min(*self.effects, *self.stalls, *map(min, weights)) < 0 or 0 in map(sum, weights):
            raise ModelError(
                "a weight of a behaviour is negative, or all of them are 0",
                where="coach",
                fix="keep weights positive, and counters times lost shares at most 1",
            )

    @classmethod
    def full(
        cls, *, waited: int = 11, prompted: int = 11, ignored: int = 8, repeated: int = 4
    ) -> Coach:
        """Return the model of the published size, or one with shorter counters.

        Parameters
        ----------
        waited, prompted, ignored, repeated : int
            How many values each counter has.

        Returns
        -------
        Coach

        Examples
        --------
        >>> Coach.full(waited=4, prompted=2, ignored=2, repeated=1).n_states
        207360
        """
        return cls(
            waited=waited,
            prompted=prompted,
            ignored=ignored,
            repeated=repeated,
            dementia=3,
            levels=3,
        )

    def with_numbers(self, numbers: Mapping[str, Any]) -> Coach:
        """Return the same model with other numbers; raises ModelError for unknown names."""
        return replace(self, numbers={**self.numbers, **numbers})

    def __repr__(self) -> str:
        return (
            f"Coach({self.n_states} states, {self.n_actions} actions, "
            f"discount {self.numbers['discount']})"
        )

    # ---- what there is -------------------------------------------------------------------------

    @property
    def prompts(self) -> Mapping[str, str]:
        """Prompts, and the behaviour that each asks for."""
        return PROMPTS | RINSE if self.levels > 1 else PROMPTS

    @cached_property
    def sizes(self) -> tuple[int, ...]:
        """Sizes of what is remembered: waited, prompted, ignored, repeated, level, prompt."""
        last = (self.levels + 1, len(self.prompts)) if self.levels > 1 else (1, 1)
        return self.waited, self.prompted, self.ignored, self.repeated, *last

    @property
    def n_memory(self) -> int:
        """Number of memories, M."""
        return prod(self.sizes)

    @property
    def n_users(self) -> int:
        """Number of kinds of users."""
        return len(USERS) * self.dementia

    @property
    def n_states(self) -> int:
        """Number of states, S."""
        return self.n_users * len(STEPS) * len(BEHAVIOURS) * self.n_memory

    @cached_property
    def actions(self) -> tuple[str, ...]:
        """Action names: nothing, the prompts, and the caregiver."""
        if self.levels == 1:
            return ("nothing", *self.prompts)
        prompts = (f"{prompt}-{level}" for prompt in self.prompts for level in LEVELS)
        return ("nothing", *prompts, "call_caregiver")

    @property
    def n_actions(self) -> int:
        """Number of actions, A."""
        return len(self.actions)

    @cached_property
    def asked(self) -> tuple[int, ...]:
        """What each action asks for: the number of a behaviour, NOTHING, or CAREGIVER."""
        each = [BEHAVIOURS.index(b) for b in self.prompts.values() for _ in range(self.levels)]
        return (NOTHING, *each, CAREGIVER) if self.levels > 1 else (NOTHING, *each)

    @cached_property
    def space(self) -> StateSpace:
        """What the state numbers mean: users outermost, memory innermost."""
        words = [
            ("responsive", ("no", "yes")),
            ("aware", ("no", "yes")),
            ("dementia", DEMENTIA),
            ("step", tuple(STEPS)),
            ("behaviour", BEHAVIOURS),
            *((name, ()) for name in ("waited", "prompted", "ignored", "repeated")),
            ("level", ("none", *LEVELS)),
            ("prompt", tuple(self.prompts)),
        ]
        sizes = (2, 2, self.dementia, len(STEPS), len(BEHAVIOURS), *self.sizes)
        return StateSpace(
            columns=tuple(
                Column(name=name, size=size, words=named)
                for (name, named), size in zip(words, sizes, strict=True)
                if size > 1
            )
        )

    @property
    def start(self) -> tuple[tuple[int, Fraction], ...]:
        """Plan step a, nothing done, no memory; every kind of user alike (dementia: ours)."""
        block = self.n_states // self.n_users
        return tuple((user * block, Fraction(1, self.n_users)) for user in range(self.n_users))

    # ---- the numbers that memory chooses among -------------------------------------------------

    @cached_property
    def _strengths(self) -> tuple[tuple[Fraction, ...], tuple[Fraction, ...]]:
        """Effects and prices of the levels, in units of the published prompt."""
        if self.levels == 1:
            return (Fraction(1),), (Fraction(1),)
        one, at = Fraction(1), self.numbers
        return (
            (at["effect.minimal"], one, at["effect.maximal"]),
            (at["price.minimal"], one, at["price.maximal"]),
        )

    @cached_property
    def effects(self) -> tuple[Fraction, ...]:
        """What prompts add to a weight, by level, prompts ignored and repetitions; 0 first."""
        at, levels = self.numbers, self._strengths[0]
        each = product(levels, range(self.ignored), range(self.repeated))
        return (
            Fraction(0),
            *(
                at["weight.prompted"]
                * level
                * (1 - ignored * at["effect.ignored"])
                * (1 - repeated * at["effect.repeated"])
                for level, ignored, repeated in each
            ),
        )

    def responds(self, user: int) -> bool:
        """Return whether a kind of user responds to prompts."""
        return USERS[user // self.dementia][0] == "yes"

    def aware(self, user: int) -> bool:
        """Return whether a kind of user is aware of the task."""
        return USERS[user // self.dementia][1] == "yes"

    def prices(self, user: int) -> tuple[Any, ...]:
        """Return what actions cost: nothing, the caregiver, prompts by level and number so far."""
        at = self.numbers
        cost = at["cost.aware" if self.aware(user) else "cost.unaware"]
        each = product(self._strengths[1], range(self.prompted))
        dearer = (cost * level * (1 + count * at["price.each"]) for level, count in each)
        return (Fraction(0), at["cost.caregiver"], *dearer)

    @cached_property
    def _prices(self) -> list[tuple[Any, ...]]:
        return [self.prices(user) for user in range(self.n_users)]

    @cached_property
    def stalls(self) -> tuple[Fraction, ...]:
        """Factors of doing nothing, by time waited."""
        return tuple(1 + time * self.numbers["nothing.waited"] for time in range(self.waited))

    def weights(self, user: int) -> list[list[Fraction]]:
        """Return the weights of behaviours of a kind of user, by plan step, before any prompt."""
        at, level = self.numbers, user % self.dementia
        slow = (at["nothing.mild"], Fraction(1), at["nothing.severe"])[level]
        slow = slow if self.dementia > 1 else Fraction(1)
        rows = []
        for right in RIGHT:
            if self.aware(user):
                row = [
                    at["weight.any"] + at["weight.right"] * (b in right.split()) for b in BEHAVIOURS
                ]
            else:
                row = [at["weight.nothing"], *[at["weight.other"]] * 4]
            rows.append([row[0] * slow, *row[1:]])
        return rows

    @property
    def repeat(self) -> Fraction:
        """What it costs to ask for what the user has just done; nothing in the reduced model."""
        return self.numbers["cost.repeat"] if self.levels > 1 else Fraction(0)

    def rewards(self) -> list[Any]:
        """Return what each plan step earns."""
        return [self.numbers[f"reward.{name}"] for name in EARNED]

    @cached_property
    def memory(self) -> Memory:
        """How memory goes on; see `Memory`."""
        return Memory.of(self.sizes, self.asked, self.levels)

    # ---- one row, and all of them --------------------------------------------------------------

    def row(self, state: int, action: int) -> tuple[list[tuple[Any, int]], Any, Any]:
        """Return (probability, next state) of a pair, what the step earns, what the action costs.

        Examples
        --------
        >>> Coach().row(0, 2)[0][2], Coach().row(0, 2)[1:]
        ((Fraction(1, 9), 7), (Fraction(0, 1), Fraction(1, 5)))
        """
        rest, m = divmod(state, self.n_memory)
        rest, behaviour = divmod(rest, len(BEHAVIOURS))
        user, step = divmod(rest, len(STEPS))
        asked, memory = self.asked[action], self.memory
        effect = int(memory.effect[action, m]) * self.responds(user)
        chances = self._chances(user, step, asked, effect, int(memory.waited[m]))
        cost = self._prices[user][memory.price[action, m]]
        cost = cost + self.repeat if asked == behaviour else cost
        outcomes = []
        for b, chance in enumerate(chances):
            there = STEPS.index(NEXT[step][b])
            after = memory.stayed if there == step else memory.moved
            place = (user * len(STEPS) + there) * len(BEHAVIOURS) + b
            outcomes.append((chance, place * self.n_memory + int(after[action, m])))
        return [outcome for outcome in outcomes if outcome[0]], self.rewards()[step], cost

    @cached_property
    def _chances(self) -> Callable[..., list[Any]]:
        """Return the chances of the next behaviours, each distribution worked out once."""

        @cache
        def chances(user: int, step: int, asked: int, effect: int, waited: int) -> list[Any]:
            if asked == CAREGIVER:
                helped = RIGHT[step].split()[0]
                return [Fraction(b == helped) for b in BEHAVIOURS]
            raised = self.weights(user)[step]
            raised[0] = raised[0] * self.stalls[waited]
            if asked >= 0:
                raised[asked] = raised[asked] + self.effects[effect]
            total = sum(raised)
            return [weight / total for weight in raised]

        return chances

    def compile(self) -> MDP:
        """Return the explicit model: one exact row for every state and action.

        Raises
        ------
        ModelError
            Where it would have more than 300,000 pairs; `solve` needs no explicit model.
        """
        rows = self._rows()
        return self._explicit(
            rows,
            components={
                "progress": [earned for _, earned, _ in rows],
                "prompts": [-cost for _, _, cost in rows],
            },
        )

    def _rows(self) -> list[tuple[list[tuple[Any, int]], Any, Any]]:
        """Return `row` of all pairs."""
        pairs = self.n_states * self.n_actions
        if pairs > MOST_PAIRS:
            raise ModelError(
                f"{pairs:,} exact rows are too many to write out",
                where="coach",
                fix="give the model itself to solvers.solve, which needs no matrix",
            )
        return [self.row(*divmod(pair, self.n_actions)) for pair in range(pairs)]

    def _explicit(self, rows: Sequence[Any], **parts: Any) -> MDP:
        return MDP.from_outcomes(
            (
                (
                    *divmod(pair, self.n_actions),
                    [(chance, after, earned - cost) for chance, after in outcomes],
                )
                for pair, (outcomes, earned, cost) in enumerate(rows)
            ),
            self.numbers["discount"],
            start=dict(self.start),
            space=self.space,
            actions=self.actions,
            labels={"done": self.space.values("step") == STEPS.index("k")},
            name="coach",
            **parts,
        )

    # ---- the family of models ------------------------------------------------------------------

    def parametric(self) -> Family:
        """Return the model as a family in its rewards, its costs and its discount.

        Weights of behaviours move chances as quotients, not as polynomials, so that they are no
        parameters; the three whole ones of the file stand beside, one less and one more, and
        `with_numbers` takes any.
        """
        one, at = 1, self.numbers
        return replace(
            self._family(),
            settings={
                name: (
                    self.with_numbers({name: at[name] - one})._family()
                    if at[name] >= one
                    else None,
                    self.with_numbers({name: at[name] + one})._family(),
                )
                for name in ("weight.any", "weight.right", "weight.prompted")
            },
        )

    def _family(self) -> Family:
        used = [n for n in NUMBERS.values() if self.levels > 1 or n.source == FILE]
        rewards = [n.name for n in used if n.moves == "reward" and n.name != DISCOUNT]
        rate = Parameter(
            name=DISCOUNT,
            value=self.numbers[DISCOUNT],
            low=Fraction(0),
            high=Fraction(999_999, 1_000_000),
        )
        numbers = [Parameter(name=name, value=self.numbers[name]) for name in rewards]
        return Family(
            name="coach",
            parameters=(*numbers, rate),
            build=self._at,
        )

    def _at(self, numbers: Mapping[str, Fraction]) -> MDP:
        """Return the explicit model at other numbers, without its components."""
        there = self.with_numbers(numbers)
        return there._explicit(there._rows())
