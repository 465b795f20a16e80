"""What is optimal is chosen exactly: ties, near ties, cycles, and what floats cannot tell."""

from fractions import Fraction as F
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import gridworld
from oracle import rows_of, solve_exact

from exact_mdp import MDP, certify


@settings(max_examples=60, deadline=None)
@given(
    st.integers(1, 4), st.sampled_from([(1, 0), (1, 1), (0, 0), ("1/2", "1/3"), (-1, 0)]), st.data()
)
def test_cycles_that_earn_nothing(
    size: int, amounts: tuple[object, object], data: st.DataObject
) -> None:
    """What they lead to decides: all attain the greatest value ahead, or not."""
    ends, rows = (size, size + 1), []
    for s in range(size):
        for a in range(data.draw(st.integers(1, 2))):
            to, out = data.draw(st.integers(0, size - 1)), data.draw(st.sampled_from(ends))
            rows.append((s, a, [("5/7", to, 0), ("2/7", out, 0)]))
    rows += [(end, 0, [(1, size + 2, value)]) for end, value in zip(ends, amounts, strict=True)]
    mdp = MDP.from_outcomes([*rows, (size + 2, 0, [(1, size + 2, 0)])])
    optimum = certify(mdp)
    assert optimum.violations() == []
    assert optimum.value.tolist() == solve_exact(size + 3, rows_of(mdp), F(1))[0]


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 5), st.integers(-4, 4), st.integers(1, 3), st.data())
def test_one_value_everywhere(size: int, top: int, bottom: int, data: st.DataObject) -> None:
    """Rewards of the value times the chance to end; less in some pairs, more in one at times."""
    value, rows = F(top, bottom), []
    for s in range(size):
        for a in range(data.draw(st.integers(1, 3))):
            out, to = (
                data.draw(st.sampled_from([F(1, 3), F(1)])),
                data.draw(st.integers(0, size - 1)),
            )
            less = data.draw(st.sampled_from([F(0), F(0), F(1, 7), F(2)])) if a else F(0)
            reached = [(out, size, 0), (1 - out, to, 0)][: 1 + (out < 1)]
            rows.append((s, a, [(p, t, value * out - less) for p, t, _ in reached]))
    mdp = MDP.from_outcomes([*rows, (size, 0, [(1, size, 0)])])
    optimum = certify(mdp)
    assert optimum.violations() == []
    assert optimum.value[:size].tolist() == [value] * size
    more = mdp.pairs_of(data.draw(st.integers(0, size - 1)))[0]
    gained = rows[more][2]
    rows[more] = (*rows[more][:2], [(p, t, r + 1) for p, t, r in gained])
    other = certify(MDP.from_outcomes([*rows, (size, 0, [(1, size, 0)])]))
    assert other.violations() == []
    assert max(other.value) > value


def test_gridworld() -> None:
    """One cycle of 399 states: symmetric values, and both ways along the diagonal."""
    mdp = gridworld(20)
    optimum = certify(mdp)
    assert optimum.violations() == []
    assert max(optimum.h.below).bit_length() > 1000
    assert not optimum.unique
    square = optimum.value.reshape(20, 20)
    assert (square == square.T).all()
    diagonal = [optimum.optimal_pairs[list(mdp.pairs_of(21 * i))] for i in range(19)]
    assert all(marks.tolist() == [True, True, False, False] for marks in diagonal)


@pytest.mark.parametrize("bits", [90, 1100])
def test_what_floats_cannot_tell_apart_is_chosen_exactly(bits: int) -> None:
    """Forty states in a row, each with two actions that differ by less than any rounding."""
    size, more = 40, F(1, 2**bits)
    rows: list[Any] = [
        (s, a, [(1, s + 1, 1 + more * a if s % 2 else 1 + more * (1 - a))])
        for s in range(size)
        for a in (0, 1)
    ]
    optimum = certify(MDP.from_outcomes([*rows, (size, 0, [(1, size, 0)])]))
    assert optimum.start_value == size * (1 + more)
    assert optimum.policy[:-1].tolist() == [s % 2 for s in range(size)]
    assert set(optimum.gaps[:-1]) == {more}
    assert optimum.violations() == []
