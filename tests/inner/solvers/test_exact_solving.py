"""What exact solving is made of: order, products, lowest terms, and policies on a cycle."""

from fractions import Fraction as F
from itertools import product
from math import lcm
from typing import Any

import numpy as np
import pytest
from flint import fmpq, fmpq_mat, fmpz
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import gridworld
from strategies import Rows, model_of, models

from exact_mdp import MDP, Certificate, ModelError, Scenario, certify, fingerprint
from exact_mdp.mdp.exact import BellmanRows, bellman_rows
from exact_mdp.solvers.proof import exact
from exact_mdp.solvers.proof.cycle import Cycle, RightSides
from exact_mdp.solvers.proof.losses import losses, short_rows
from exact_mdp.solvers.proof.rationals import fraction, fractions, primes_of
from exact_mdp.solvers.proof.stages import Kind, stages


def check_order(mdp: MDP) -> int:
    """Each state is settled once, after all that it leads to; return the number of stages."""
    settled, count = set(np.flatnonzero(mdp.terminal).tolist()), 0
    for stage in stages(bellman_rows(mdp)):
        own = set(stage.states.tolist())
        assert own.isdisjoint(settled)
        assert len(own) == len(stage.states) > 0
        assert stage.kind is not Kind.CYCLE or len(own) > 1
        known = settled | own if stage.kind is Kind.CYCLE else settled.copy()
        for s in stage.states.tolist():
            after = {t for pair in mdp.pairs_of(s) for _, t, _ in mdp.table.row(pair)}
            assert not mdp.discount_exact or after <= known | {s}
            known |= {s} if stage.kind is Kind.CHAIN else set()
        settled |= own
        count += 1
    assert len(settled) == mdp.n_states
    return count


@settings(max_examples=150, deadline=None)
@given(models())
def test_states_are_settled_after_those_that_they_lead_to(rows: Rows) -> None:
    check_order(rows.model())


def test_runs_and_levels() -> None:
    """Numbered in order, or backwards: in either case a stage for each trial."""
    mdp = Scenario.load("yuan2025").with_(tasks=[4]).compile()
    assert check_order(mdp) == 20
    rows = [
        (
            mdp.n_states - 1 - int(mdp.pair_state[pair]),
            int(mdp.pair_action[pair]),
            [(p, mdp.n_states - 1 - t, r) for p, t, r in mdp.table.row(pair)],
        )
        for pair in range(mdp.n_pairs)
    ]
    assert check_order(MDP.from_outcomes(rows)) == 20


@settings(max_examples=100, deadline=None)
@given(models(), st.integers(1, 3), st.data())
def test_right_sides(rows: Rows, unit: int, data: st.DataObject) -> None:
    """Products in any grouping of states, times any unit; the matrices of a repeated part too."""
    mdp = rows.model()
    found = bellman_rows(mdp)
    sides = RightSides(found)
    value = data.draw(st.lists(st.integers(-9, 9), min_size=mdp.n_states, max_size=mdp.n_states))
    scaled = {s: fmpz(unit * x) for s, x in enumerate(value)}
    for _ in range(2):
        order = data.draw(st.permutations(range(mdp.n_states)))
        cut = data.draw(st.integers(1, mdp.n_states))
        for states in (order[:cut], order[cut:]):
            got = [
                int(number)
                for product in sides.products(np.array(states, dtype=np.int64))
                for number in product(scaled, fmpz(unit))
            ]
            pairs = [pair for s in states for pair in mdp.pairs_of(s)]
            assert len(got) == len(pairs)
            for number, pair in zip(got, pairs, strict=True):
                s = int(mdp.pair_state[pair])
                own, wanted = F(1), F(0)
                for p, t, r in mdp.table.row(pair):
                    wanted += p * (r + mdp.discount_exact * value[t] * (t != s))
                    own -= p * mdp.discount_exact * (t == s)
                assert F(number, unit) == int(found.scale[s]) * wanted
                assert F(sides.pivot[pair]) == int(found.scale[s]) * own
                assert sides.waits[s] == any(
                    t == s and mdp.discount_exact
                    for other in mdp.pairs_of(s)
                    for _, t, _ in mdp.table.row(other)
                )


@settings(max_examples=60, deadline=None)
@given(
    st.integers(1, 4),
    st.sampled_from([(1, 0), (1, 1), (0, 0), ("1/2", "1/3"), (-1, 0)]),
    st.data(),
)
def test_cycles_that_earn_nothing(
    size: int, worth: tuple[object, object], data: st.DataObject
) -> None:
    """What they lead to decides: all attain the greatest value ahead, or not (brute force)."""
    ends, rows = (size, size + 1), []
    for s in range(size):
        for a in range(data.draw(st.integers(1, 2))):
            to, out = data.draw(st.integers(0, size - 1)), data.draw(st.sampled_from(ends))
            rows.append((s, a, [("5/7", to, 0), ("2/7", out, 0)]))
    rows += [(end, 0, [(1, size + 2, value)]) for end, value in zip(ends, worth, strict=True)]
    mdp = MDP.from_outcomes([*rows, (size + 2, 0, [(1, size + 2, 0)])])
    found = certify(mdp)
    assert found.violations() == []
    best = [F(-10)] * size
    for pairs in product(*(mdp.pairs_of(s) for s in range(size))):
        value = dict(zip(ends, map(F, worth), strict=True))
        matrix = fmpq_mat(size, size, [fmpq(int(i == j)) for i in range(size) for j in range(size)])
        right = fmpq_mat(size, 1)
        for s, pair in enumerate(pairs):
            for p, t, _ in mdp.table.row(pair):
                share = fmpq(p.numerator, p.denominator)
                if t < size:
                    matrix[s, t] -= share
                else:
                    right[s, 0] += share * fmpq(value[t].numerator, value[t].denominator)
        for s, number in enumerate(matrix.solve(right).entries()):
            best[s] = max(best[s], F(int(number.p), int(number.q)))
    assert found.value[:size].tolist() == best


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
    found = certify(mdp)
    assert found.violations() == []
    assert found.value[:size].tolist() == [value] * size
    more = mdp.pairs_of(data.draw(st.integers(0, size - 1)))[0]
    gained = rows[more][2]
    rows[more] = (*rows[more][:2], [(p, t, r + 1) for p, t, r in gained])
    other = certify(MDP.from_outcomes([*rows, (size, 0, [(1, size, 0)])]))
    assert other.violations() == []
    assert max(other.value) > value


NUMBERS = st.one_of(
    st.integers(1, 200),
    st.builds(lambda a, b: 2**a * 15**b, st.integers(0, 900), st.integers(0, 9)),
)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(-(10**9), 10**9), NUMBERS), min_size=1, max_size=8), NUMBERS)
def test_lowest_terms(numbers: list[tuple[int, int]], factor: int) -> None:
    top = [a * factor for a, _ in numbers]
    bottom = [b * factor for _, b in numbers]
    wanted = [F(a, b) for a, b in numbers]
    for primes in (primes_of(bottom), lcm(*bottom) * 2**600):
        found = fractions([*top, None], [*bottom, 1], primes).tolist()
        assert found == [*wanted, None]
        assert [str(x) for x in found[:-1]] == [str(x) for x in wanted]  # in lowest terms
        assert all(type(x) is F and type(x.numerator) is int for x in found[:-1])
    assert [fraction(a, b) for a, b in zip(top, bottom, strict=True)] == wanted
    assert hash(fraction(top[0], bottom[0])) == hash(wanted[0])


def test_gridworld() -> None:
    """One cycle of 399 states: symmetric values, and both ways along the diagonal."""
    mdp = gridworld(20)
    found = certify(mdp)
    assert found.violations() == []
    assert max(found.h.below).bit_length() > 1000
    assert not found.unique
    square = found.value.reshape(20, 20)
    assert (square == square.T).all()
    diagonal = [found.optimal_pairs[list(mdp.pairs_of(21 * i))] for i in range(19)]
    assert all(marks.tolist() == [True, True, False, False] for marks in diagonal)


def test_cycles_that_are_too_large_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exact, "LARGEST", 8)
    with pytest.raises(ModelError, match="is too large to be solved exactly"):
        certify(gridworld(4))


def test_fixed_point_finds_what_floats_do_not_see(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gains of one part in 10^17 and many ties: the first policy that is solved is optimal."""
    solved: list[int] = []
    values = Cycle.values

    def counted(cycle: Cycle, policy: np.ndarray) -> tuple[list[fmpz], fmpz]:
        solved.append(len(policy))
        return values(cycle, policy)

    monkeypatch.setattr(Cycle, "values", counted)
    mdp = gridworld(24)
    found = certify(mdp)
    assert solved == [575]
    rows = [
        (s, a, F(1, 2) + a * F(1, 10**20), {(s + 1) % 50: F(1)}) for s in range(50) for a in (0, 1)
    ]
    found = certify(model_of(50, rows, F(1, 2)))
    assert solved == [575, 50]
    assert set(found.value) == {1 + 2 * F(1, 10**20)}


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


@given(
    st.lists(
        st.tuples(
            st.integers(0, 3),
            st.lists(st.tuples(st.integers(0, 3), st.integers(1, 2**20)), min_size=1, max_size=3),
            st.integers(-(2**70), 2**70),
        ),
        min_size=4,
        max_size=8,
    ),
    st.lists(st.integers(-(2**100), 2**100), min_size=4, max_size=4),
    st.integers(1, 2**40),
    st.integers(1, 2**20),
)
def test_losses_by_digits_are_those_of_fractions(
    pairs: list[Any], value: list[int], unit: int, scale: int
) -> None:
    """Carries, signs and numbers of several digits; each state has a pair."""
    pairs = sorted([(s, [(0, 1)], 0) for s in range(4)] + pairs, key=lambda pair: pair[0])
    lengths = [len(row) for _, row, _ in pairs]
    rows = BellmanRows(
        pair_offsets=np.searchsorted([s for s, _, _ in pairs], np.arange(5)),
        terminal=np.zeros(4, dtype=bool),
        scale=np.full(4, scale),
        constant=np.array([c for _, _, c in pairs], dtype=object),
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        next=np.array([t for _, row, _ in pairs for t, _ in row]),
        weight=np.array([w for _, row, _ in pairs for _, w in row]),
    )
    wanted = [
        scale * value[s] - c * unit - sum(w * value[t] for t, w in row) for s, row, c in pairs
    ]
    every = np.arange(len(pairs))
    found = losses(rows, every, lambda states: [value[s] for s in states], unit)
    assert short_rows(rows)
    assert found.numbers(every) == wanted
    assert found.negative.tolist() == [x < 0 for x in wanted]
    assert found.nothing.tolist() == [x == 0 for x in wanted]


@pytest.mark.parametrize("bits", [90, 1100])
def test_what_floats_cannot_tell_apart_is_chosen_exactly(
    bits: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Forty states in a row, each with two actions that differ by less than any rounding.

    Of integers beyond the range of floats none is asked to choose.
    """
    monkeypatch.setattr(exact, "COMPILED", 0)
    size, more = 40, F(1, 2**bits)
    rows: list[Any] = [
        (s, a, [(1, s + 1, 1 + more * a if s % 2 else 1 + more * (1 - a))])
        for s in range(size)
        for a in (0, 1)
    ]
    found = certify(MDP.from_outcomes([*rows, (size, 0, [(1, size, 0)])]))
    assert found.start_value == size * (1 + more)
    assert found.policy[:-1].tolist() == [s % 2 for s in range(size)]
    assert set(found.gaps[:-1]) == {more}
    assert found.violations() == []
