"""The parts that exact solving is made of: order, products, and rationals in lowest terms."""

from fractions import Fraction as F
from math import lcm

import numpy as np
from flint import fmpz
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import Rows, models

from exact_mdp.mdp import MDP, Scenario
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.solvers.proof.cycle import RightSides
from exact_mdp.solvers.proof.exact import stages
from exact_mdp.solvers.proof.rationals import fraction, fractions, primes_of


def check_order(mdp: MDP) -> int:
    """Each state is settled once, after all that it leads to; return the number of stages."""
    settled, count = set(np.flatnonzero(mdp.terminal).tolist()), 0
    for stage in stages(bellman_rows(mdp)):
        own = set(stage.states.tolist())
        assert own.isdisjoint(settled)
        assert len(own) == len(stage.states) > 0
        after = {
            (s, t)
            for s in own
            for pair in mdp.pairs_of(s)
            for _, t, _ in mdp.table.row(pair)
            if t not in settled and mdp.discount_exact
        }
        if stage.cyclic:
            assert len(own) > 1
            assert {t for _, t in after} <= own
        else:
            assert all(s == t for s, t in after)
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
