"""What a test case is: a published model in exact rationals, with the answer it must give."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction

Row = Mapping[int, Fraction]
Pair = tuple[int, int, Fraction, Row]
Number = Fraction | float


@dataclass(frozen=True, kw_only=True, eq=False)
class Case:
    """A model, where it comes from, and what is known of its solution.

    `pairs` holds (state, action, expected reward, {next state: probability}), one per available
    pair. Episodes end in absorbing states: every action there is a self loop without reward.

    `values` are the published optimal values, of all states or of some. A Fraction is exact; a
    float was published to few digits and holds within `tolerance`. `policy` has one published
    optimal action per state listed, `optimal` the whole set of optimal actions. `wrong_policy` is
    a policy that somebody took for optimal, or simply another one, of the values `wrong_values`;
    `uniform_values` are those of choosing among a state's actions at random.

    `proper` says whether every policy ends. It may be false at discount 1 only: then values may
    be known and a solver is still free to refuse the model.
    """

    name: str
    source: str
    pairs: tuple[Pair, ...]
    discount: Fraction
    values: Mapping[int, Number]
    tolerance: float = 0.0
    policy: Mapping[int, int] = field(default_factory=dict)
    optimal: Mapping[int, frozenset[int]] = field(default_factory=dict)
    wrong_policy: Mapping[int, int] = field(default_factory=dict)
    wrong_values: Mapping[int, Number] = field(default_factory=dict)
    uniform_values: Mapping[int, Number] = field(default_factory=dict)
    start: int = 0
    proper: bool = True

    @property
    def n_states(self) -> int:
        return 1 + max(state for state, *_ in self.pairs)

    def __str__(self) -> str:
        return self.name


def row(*outcomes: tuple[int, Fraction | int]) -> dict[int, Fraction]:
    """A distribution from (next state, probability); equal states add up, zeros are left out."""
    total: dict[int, Fraction] = {}
    for state, probability in outcomes:
        if probability:
            total[state] = total.get(state, Fraction(0)) + probability
    return total


def rows(text: str) -> tuple[Pair, ...]:
    """Pairs from "state action reward: next probability, …; …"; what is certain stands alone."""
    pairs: list[Pair] = []
    for line in text.strip().replace(";", "\n").splitlines():
        head, _, tail = line.partition(":")
        state, action, reward = head.split()
        outcomes = [outcome.split() for outcome in tail.split(",")]
        law = row(
            *((int(after), Fraction(chance[0] if chance else 1)) for after, *chance in outcomes)
        )
        pairs.append((int(state), int(action), Fraction(reward), law))
    return tuple(pairs)


def end(state: int, n_actions: int = 1) -> list[Pair]:
    """The pairs of an absorbing state."""
    return [(state, action, Fraction(0), {state: Fraction(1)}) for action in range(n_actions)]


def indexed(numbers: Iterable[Number]) -> dict[int, Number]:
    """{0: first, 1: second, …}."""
    return dict(enumerate(numbers))


def table(text: str) -> dict[int, Number]:
    """The same from numbers written with blanks between them."""
    return indexed(map(float, text.split()))


def actions(policy: Iterable[int]) -> dict[int, int]:
    """{0: first action, 1: second action, …}."""
    return dict(enumerate(policy))


def best(*sets: Iterable[int]) -> dict[int, frozenset[int]]:
    """The sets of optimal actions of the first states."""
    return {state: frozenset(each) for state, each in enumerate(sets)}


def over_horizon(pairs: Iterable[Pair], horizon: int) -> tuple[Pair, ...]:
    """The model over a finite horizon: S states before each step, in the order of time, an end."""
    pairs = tuple(pairs)
    n_states = 1 + max(state for state, *_ in pairs)
    last = horizon * n_states
    listed: list[Pair] = []
    for t in range(horizon):
        for s, a, r, law in pairs:
            later = ((min(last, (t + 1) * n_states + u), p) for u, p in law.items())
            listed.append((t * n_states + s, a, r, row(*later)))
    return (*listed, *end(last))
