"""Long division by a float inverse against p-adic lifting, and against the equations themselves."""

from dataclasses import replace
from fractions import Fraction as F

import numpy as np
import pytest
from flint import fmpz
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.mdp.exact import bellman_rows, fingerprint
from exact_mdp.solvers import certify
from exact_mdp.solvers.proof import exact
from exact_mdp.solvers.proof import linear as exact_linear
from exact_mdp.solvers.proof.certificate import Certificate
from exact_mdp.solvers.proof.linear import Equations


@st.composite
def equations(draw: st.DrawFn, *, largest: int = 50) -> Equations:
    """Draw an M-matrix: pivots above the sum of the weights, at times by very little."""
    size = draw(st.integers(1, largest))
    bits = draw(st.sampled_from([1, 5, 30, 57, 64, 200, 1200]))
    seed = draw(st.integers(0, 2**32))
    rng = np.random.default_rng(seed)
    row, column, weight, pivot = [], [], [], []
    for i in range(size):
        others = [j for j in np.unique(rng.integers(0, size, 4)).tolist() if j != i]
        shares = [int(rng.integers(1, 2**30)) * 2**bits // 2**30 + 1 for _ in others]
        row += [i] * len(others)
        column += others
        weight += shares
        pivot.append(sum(shares) * draw(st.sampled_from([1, 1, 2])) + draw(st.integers(1, 9)))
    kind = np.int64 if bits < 60 else object
    return Equations(
        pivot=pivot,
        row=np.array(row, dtype=np.int64),
        column=np.array(column, dtype=np.int64),
        weight=np.array(weight, dtype=kind),
    )


NUMBERS = st.one_of(st.integers(-9, 9), st.integers(-(2**70), 2**70), st.just(3**500))


@settings(max_examples=60, deadline=None)
@given(equations(), st.data())
def test_division_and_lifting_agree(system: Equations, data: st.DataObject) -> None:
    size = len(system.pivot)
    right = [fmpz(x) for x in data.draw(st.lists(NUMBERS, min_size=size, max_size=size))]
    value, below = system._lifted(right)
    found = system.divide(right)
    if found is not None:
        assert system._satisfied(*found, right)
        assert [F(int(x), int(found[1])) for x in found[0]] == [
            F(int(x), int(below)) for x in value
        ]
        wrong = [*found[0][:-1], found[0][-1] + 1]
        assert not system._satisfied(wrong, found[1], right)


@settings(max_examples=50, deadline=None)
@given(equations(), st.integers(1, 300))
def test_approximations_are_as_close_as_they_say(system: Equations, places: int) -> None:
    right = [fmpz(5 - i) for i in range(len(system.pivot))]
    value, below = system._lifted(right)
    found = system.approximate(right, places)
    if found is not None:
        numbers, more = found
        assert places <= more < places + 32
        ones, under = system._lifted([fmpz(p) for p in system.pivot])
        stretch = F(int(max(ones)), int(under))
        for number, x in zip(numbers, value, strict=True):
            assert abs(number - F(int(x), int(below)) * 2**more) <= 5 * stretch


def test_most_systems_are_divided() -> None:
    """Without it, the tests above could pass with nothing tested."""
    rng = np.random.default_rng(0)
    size = 200
    column = rng.integers(0, size, 3 * size)
    row = np.repeat(np.arange(size), 3)
    column, row = column[column != row], row[column != row]
    weight = rng.integers(1, 10**6, len(row))
    pivot = [int(weight[row == i].sum() * 101 // 100) + 1 for i in range(size)]
    system = Equations(pivot=pivot, row=row, column=column, weight=weight)
    right = [fmpz(int(x)) for x in rng.integers(-(10**6), 10**6, size)]
    found = system.divide(right)
    assert found is not None
    assert system._satisfied(*found, right)
    assert found[1].bit_length() > 3000


def test_what_floats_cannot_divide_is_lifted() -> None:
    """Rows that sum to nearly 1: the inverse is larger than the precision of floats."""
    ring = np.arange(60)
    system = Equations(
        pivot=[2**60] * 60, row=ring, column=(ring + 1) % 60, weight=np.full(60, 2**60 - 1)
    )
    assert system.divide([fmpz(1)] * 60) is None
    value, below = system.solve([fmpz(1)] * 60)
    assert [x / below for x in value] == [1] * 60
    singular = replace(system, weight=np.full(60, 2**60))
    with pytest.raises(ZeroDivisionError):
        singular.solve([fmpz(1)] * 60)


def gridworld(width: int) -> MDP:
    """Steps that go astray to either side with probability 1/10, and many ties."""

    def at(row: int, column: int) -> int:
        return min(max(row, 0), width - 1) * width + min(max(column, 0), width - 1)

    rows = []
    for i in range(width):
        for j in range(width):
            for action, (down, right) in enumerate([(0, 1), (1, 0), (0, -1), (-1, 0)]):
                sides = [at(i + right, j + down), at(i - right, j - down)]
                ahead = (F(8, 10), at(i + down, j + right), -1)
                astray = [(F(1, 10), side, -1) for side in sides]
                goal = at(i, j) == width**2 - 1
                outcomes = [(1, at(i, j), 0)] if goal else [ahead, *astray]
                rows.append((at(i, j), action, outcomes))
    return MDP.from_outcomes(rows, F(99, 100))


def test_gridworld() -> None:
    """One cycle of 399 states: symmetric values, and both ways along the diagonal."""
    mdp = gridworld(20)
    found = certify(mdp)
    assert found.violations() == []
    assert max(found.denominator).bit_length() > 1000
    assert not found.unique
    square = found.value.reshape(20, 20)
    assert (square == square.T).all()
    diagonal = [found.optimal_pairs[list(mdp.pairs_of(21 * i))] for i in range(19)]
    assert all(marks.tolist() == [True, True, False, False] for marks in diagonal)


def test_cycles_that_are_too_large_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exact, "LARGEST", 8)
    with pytest.raises(ModelError, match="is too large to be solved exactly"):
        certify(gridworld(4))
    monkeypatch.undo()
    monkeypatch.setattr(exact_linear, "FEW", 1000)
    monkeypatch.setattr(exact_linear, "MANY", 8)
    with pytest.raises(ModelError, match="ill-conditioned"):
        certify(gridworld(4))


def test_policy_iteration_repairs_a_poor_start(monkeypatch: pytest.MonkeyPatch) -> None:
    """The exact part alone reaches the optimum, from the worst policy if need be."""
    mdp = gridworld(5)
    wanted = certify(mdp)
    monkeypatch.setattr(
        "exact_mdp.solvers.proof.cycle.Cycle.policy",
        lambda cycle: cycle.offsets[1:].astype(np.int64) - 1,
    )
    found = certify(mdp)
    assert found.violations() == []
    assert list(found.value) == list(wanted.value)
    assert isinstance(found, Certificate)
    assert fingerprint(mdp) == found.model


def test_scenarios_without_cycles_need_no_linear_equations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exact_mdp.solvers.proof.cycle.Cycle.values", None)
    assert certify(Scenario.load("yuan2025").compile()).unique
    assert bellman_rows(gridworld(2)).scale.tolist() == [1000, 1000, 1000, 100]
