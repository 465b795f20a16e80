"""Random exact models for property-based tests, and what holds of them in rational arithmetic."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from hypothesis import strategies as st

from exact_mdp import MDP, Column, StateSpace

F = Fraction
Row = tuple[int, int, Fraction, Mapping[int, Fraction]]

DISCOUNTS = (F(0), F(1, 2), F(9, 10), F(9999, 10_000))
REWARDS = st.one_of(
    st.integers(-3, 3).map(F),
    st.fractions(min_value=-5, max_value=5, max_denominator=12),
    st.sampled_from([F(10**9), F(-(10**9)), F(1, 10**9), F(1, 3), F(0)]),
)


@dataclass(frozen=True, kw_only=True)
class Rows:
    """A model as rows (state, action, expected reward, {next state: probability})."""

    n_states: int
    pairs: tuple[Row, ...]
    discount: Fraction

    def model(self, *, floats: bool = False) -> MDP:
        return model_of(self.n_states, self.pairs, self.discount, floats=floats)


def model_of(
    n_states: int, pairs: Sequence[Row], discount: Fraction, *, floats: bool = False, start: int = 0
) -> MDP:
    """Return the model, exact, or of floats that are nearly the same numbers."""
    kind = float if floats else F
    rows = [
        (s, a, [(kind(p), t, kind(r)) for t, p in following.items()])
        for s, a, r, following in pairs
    ]
    assert {s for s, *_ in pairs} == set(range(n_states))
    return MDP.from_outcomes(rows, discount, start=start)


@cache
def of_case(case: Any) -> MDP:
    """The model of a published case, the same for all tests."""
    return model_of(case.n_states, case.pairs, case.discount, start=case.start)


@st.composite
def distributions(
    draw: st.DrawFn, states: Sequence[int], *, through: int | None = None
) -> dict[int, Fraction]:
    """Draw {state: probability} over some of the states, `through` among them."""
    chosen = draw(st.lists(st.sampled_from(states), min_size=1, max_size=4))
    if through is not None:
        chosen.append(through)
    weights = {s: draw(st.sampled_from([1, 1, 2, 3, 7, 1000])) for s in chosen}
    total = sum(weights.values())
    return {s: F(weight, total) for s, weight in weights.items()}


@st.composite
def models(draw: st.DrawFn, *, discounts: Sequence[Fraction] = (*DISCOUNTS, F(1))) -> Rows:
    """Draw a model: missing actions, ties, absorbing states, self loops, unreachable states.

    At discount 1 every policy ends: each pair reaches a state of smaller number, and state 0 ends.
    """
    discount = draw(st.sampled_from(discounts))
    n_states = draw(st.integers(1, 6))
    ends = draw(st.sets(st.integers(0, n_states - 1), max_size=2))
    ends |= {0} if discount == 1 else set()
    # A model whose states are numbered by chance, in order of their levels or the other way.
    acyclic = draw(st.booleans())
    flip = draw(st.booleans())
    rewards = draw(st.lists(REWARDS, min_size=1, max_size=4))
    pairs: list[Row] = []
    for s in range(n_states):
        for a in sorted(draw(st.sets(st.integers(0, 3), min_size=1, max_size=3))):
            if s in ends:
                pairs.append((s, a, F(0), {s: F(1)}))
                continue
            fall = acyclic and s > 0
            through = draw(st.integers(0, s - 1)) if s and (fall or discount == 1) else None
            following = draw(distributions(range(s if fall else n_states), through=through))
            pairs.append((s, a, draw(st.sampled_from(rewards)), following))
            if draw(st.integers(0, 3)) == 0 and a < 3:
                twin = (s, a + 1, *pairs[-1][2:])  # a tie, exactly
                pairs.append(twin)
    pairs = [p for i, p in enumerate(pairs) if (p[0], p[1]) not in {q[:2] for q in pairs[:i]}]
    if flip:
        turn = n_states - 1
        pairs = [(turn - s, a, r, {turn - t: p for t, p in f.items()}) for s, a, r, f in pairs]
    return Rows(n_states=n_states, pairs=tuple(pairs), discount=discount)


@st.composite
def outcome_rows(draw: st.DrawFn, gains: st.SearchStrategy[Fraction]) -> list[Any]:
    """Rows for `MDP.from_outcomes`: 1 to 4 states, 1 to 3 actions; some chances are binary."""
    states, rows = draw(st.integers(1, 4)), []
    for state in range(states):
        for action in draw(st.sets(st.integers(0, 2), min_size=1)):
            weights = draw(st.lists(st.integers(1, 7), min_size=1, max_size=3))
            weights += [32 - sum(weights)] * draw(st.booleans())
            outcomes = [
                (F(w, sum(weights)), draw(st.integers(0, states - 1)), draw(gains)) for w in weights
            ]
            rows.append((state, action, outcomes))
    return rows


ENDLESS_REWARDS: tuple[list[int | F], ...] = (
    [0, 0, 1],
    [0, 0, -1],
    [0, 1, -1],
    [0],
    [-2, -1, 0, 1, F(1, 2)],
    [1, -1],
)
Pairs = tuple[int, tuple[Row, ...]]  # the number of states, and rows


@st.composite
def any_models(draw: st.DrawFn, most: int = 6) -> Pairs:
    """Draw a model of any kind: end components, rewards of either sign, absorbing states."""
    size = draw(st.integers(1, most))
    rewards = draw(st.sampled_from(ENDLESS_REWARDS))
    pairs: list[Row] = []
    for s in range(size):
        for a in range(draw(st.integers(1, 2 if size > 4 else 3))):
            reward = F(draw(st.sampled_from(rewards)))
            one = draw(st.booleans())
            row = (
                {draw(st.integers(0, size - 1)): F(1)} if one else draw(distributions(range(size)))
            )
            pairs.append((s, a, reward, row))
    return size, tuple(pairs)


def exact_values(value: np.ndarray) -> list[Fraction]:
    return [F(float(x)) for x in value]


def exact_gains(mdp: MDP, value: Sequence[Fraction]) -> list[Fraction]:
    """Return what each pair adds to exact values, from the model's own exact table."""
    top, bottom = mdp.table.expected_gain_exact
    added = []
    for pair in range(mdp.n_pairs):
        later = sum((p * value[t] for p, t, _ in mdp.table.row(pair)), F(0))
        reward = F(int(top[pair]), int(bottom[pair]))
        added.append(reward + mdp.discount_exact * later - value[int(mdp.pair_state[pair])])
    return added


@st.composite
def tables(draw: st.DrawFn) -> MDP:
    """A model of a few steps or of a cycle, whose states have a row and something else."""
    times, rows, actions = draw(st.tuples(*[st.integers(1, 3)] * 2, st.integers(2, 3)))
    cyclic = draw(st.booleans())
    end = times * rows
    outcomes = []
    for s, a in product(range(end), range(actions)):
        later = range((s // rows + 1) * rows, min(end, (s // rows + 2) * rows))
        targets = [*range(end), end] if cyclic else [*later] or [end]
        weights = draw(st.lists(st.integers(0, 3), min_size=len(targets), max_size=len(targets)))
        weights[-1] += 1
        reward = draw(st.integers(-4, 4))
        law = [(F(w, sum(weights)), t, reward) for t, w in zip(targets, weights, strict=True) if w]
        outcomes.append((s, a, law))
    outcomes.append((end, 0, [(F(1), end, 0)]))
    columns = (Column(name="time", size=times), Column(name="row", size=rows))
    space = StateSpace(columns=columns, extra=("end",))
    discount = F(9, 10) if cyclic else draw(st.sampled_from([F(1), F(1, 2)]))
    return MDP.from_outcomes(outcomes, discount).with_(space=space)
