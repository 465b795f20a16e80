"""The fingerprint: the same for the same exact content, however stored, and for no other."""

from dataclasses import replace
from fractions import Fraction as F
from hashlib import sha256

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import Rows, models

from exact_mdp import MDP, Scenario, fingerprint

DYADIC = [[[0.5, 0.5, 0], [0.25, 0.5, 0.25], [0, 0, 1]], [[0, 0.125, 0.875], [0, 0, 1], [0, 0, 1]]]
REWARD = [[1, -2.5], [0.75, 3], [0, 0]]


def written(numbers: object) -> object:
    """The same numbers as strings "p/q", not in lowest terms."""
    if isinstance(numbers, list):
        return [written(number) for number in numbers]
    value = F(numbers)
    return f"{3 * value.numerator}/{3 * value.denominator}"


def scaled(mdp: MDP, factor: int) -> MDP:
    """The same model over denominators that are `factor` times as large."""
    table = mdp.table
    parts = ("weight", "denominator", "gain", "gain_denominator")
    larger = {}
    for name in parts:
        values = [int(value) * factor for value in getattr(table, name)]
        larger[name] = np.array(values, dtype=object)
    return mdp.with_(table=replace(table, **larger))


def test_floats_and_rationals_agree() -> None:
    floats = MDP.from_arrays(DYADIC, REWARD, 0.5)
    rational = MDP.from_arrays(written(DYADIC), written(REWARD), "1/2")
    sparse = MDP.from_arrays([sp.csr_array(matrix) for matrix in DYADIC], np.array(REWARD), 0.5)
    by_outcome = np.broadcast_to(np.array(REWARD).T[:, :, None], (2, 3, 3))
    joint = MDP.from_arrays(np.array(DYADIC), by_outcome, F(1, 2))
    assert len({fingerprint(mdp) for mdp in (floats, rational, sparse, joint)}) == 1


def test_models_are_equal_whose_content_is() -> None:
    floats = MDP.from_arrays(DYADIC, REWARD, 0.5)
    other = MDP.from_arrays(written(DYADIC), written(REWARD), "1/2", name="other")
    assert floats == other
    assert len({floats, other}) == 1
    assert floats != other.with_(discount="2/3")
    assert floats != 3
    assert len(dir(floats)) <= 30
    assert all(hasattr(floats, name) for name in dir(floats))


def test_costs_and_goals_are_other_models_and_labels_are_not() -> None:
    walk, end = [[["1/2", "1/2"], [0, 1]]], [False, True]
    plain = MDP.from_arrays(walk, [1, 0])
    of_three = plain.with_(sense="min"), plain.with_(goal=end), plain.negated()
    assert len({fingerprint(mdp) for mdp in (plain, *of_three)}) == 4
    assert fingerprint(plain.with_(labels={"end": end})) == fingerprint(plain)
    assert fingerprint(plain.negated().negated()) == fingerprint(plain)


def test_the_hash_is_that_of_the_lines_that_are_documented() -> None:
    """docs/reference/certificates.md: lines of integers in hexadecimal."""
    walk = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [20, 0], sense="min")
    walk = walk.with_(goal=np.array([False, True]))
    lines = [
        "exact-mdp model 2 min inf [1]",
        "0x2 0x1 0x1",  # states, discount
        "0x0 0x1 0x1",  # start
        *("0x0 0x1", "0x0 0x0"),  # states and actions of the pairs
        *("0x14 0x0", "0x1 0x1"),  # expected rewards
        *("0x2 0x1", "0x2 0x1"),  # denominators of the rows, and how many next states
        *("0x0 0x1 0x1", "0x1 0x1 0x1"),  # next states, weights
    ]
    assert fingerprint(walk) == sha256("\n".join(lines).encode()).hexdigest()


def test_a_tenth_is_not_the_float_nearest_to_it() -> None:
    tenth = fingerprint(MDP.from_arrays([[[1]]], ["1/10"], "1/2"))
    assert tenth != fingerprint(MDP.from_arrays([[[1]]], [0.1], "1/2"))
    assert tenth == fingerprint(MDP.from_arrays([[[1]]], ["0.1"], "0.5"))
    zero = fingerprint(MDP.from_arrays([[[1]]], [0.0], "1/2"))
    assert zero == fingerprint(MDP.from_arrays([[[1]]], [-0.0], "1/2"))


@settings(max_examples=100, deadline=None)
@given(models(), st.sampled_from([1, 2, 30, 2**40, 10**25]))
def test_denominators_do_not_matter(rows: Rows, factor: int) -> None:
    mdp = rows.model()
    assert fingerprint(scaled(mdp, factor)) == fingerprint(mdp)


@settings(max_examples=60, deadline=None)
@given(models(), st.randoms(use_true_random=False))
def test_how_outcomes_are_listed_does_not_matter(rows: Rows, draw: st.random_module) -> None:
    """Outcomes cut in halves that earn more and less, in any order."""
    mdp = rows.model()
    listed = []
    for s, a, r, following in rows.pairs:
        outcomes = [(p / 2, t, r + d) for t, p in following.items() for d in (-1, 1)]
        draw.shuffle(outcomes)
        listed.append((s, a, outcomes))
    draw.shuffle(listed)
    assert fingerprint(MDP.from_outcomes(listed, rows.discount)) == fingerprint(mdp)


@settings(max_examples=60, deadline=None)
@given(models())
def test_every_number_matters(rows: Rows) -> None:
    mdp, seen = rows.model(), {fingerprint(rows.model())}
    changed = [mdp.with_(discount=F(1, 7))]
    if mdp.n_states > 1:
        changed += [mdp.with_(start=1), mdp.with_(start={0: F(1, 3), 1: F(2, 3)})]
    for i, (s, a, r, following) in enumerate(rows.pairs):
        others = [(s, a, r + F(1, 10**12), following), (s, a + 9, r, following)]
        if len(following) > 1:
            (t, p), (u, q) = list(following.items())[:2]
            little = min(p, q) / 10**12
            others.append((s, a, r, {**following, t: p - little, u: q + little}))
        for other in others:
            pairs = (*rows.pairs[:i], other, *rows.pairs[i + 1 :])
            changed.append(replace(rows, pairs=pairs).model())
    for other in changed:
        assert fingerprint(other) not in seen
        seen.add(fingerprint(other))


def test_names_do_not_matter() -> None:
    mdp = MDP.from_arrays(DYADIC, REWARD, 0.5)
    named = MDP.from_arrays(
        DYADIC, REWARD, 0.5, actions=["wait", "act"], states=["well", "ill", "gone"], name="other"
    )
    assert fingerprint(mdp) == fingerprint(named)


def test_start_is_a_distribution() -> None:
    mdp = MDP.from_arrays(DYADIC, REWARD, 0.5, start={0: "1/3", 2: "2/3"})
    turned = replace(mdp, start=(mdp.start[1], mdp.start[0], (1, F(0))))
    assert fingerprint(mdp) == fingerprint(turned)
    assert fingerprint(mdp) != fingerprint(mdp.with_(start=0))


def test_numbers_of_any_size() -> None:
    """Rows beyond 64 bits, in the numerator, the denominator, or both."""
    models = [
        MDP.from_outcomes([(0, 0, [(share, 0, reward), (1 - share, 1, 0)]), (1, 0, [(1, 1, 0)])])
        for share in (F(1, 3), F(1, 3**60), 1 - F(1, 3**60), F(1, 2**1060), F(1, 2**1100))
        for reward in (0, 3**60, F(1, 3**60), F(2) ** 1000, F(1, 2**1074), F(1, 2**1075))
    ]
    assert len({fingerprint(mdp) for mdp in models}) == len(models)
    tiny = MDP.from_outcomes([(0, 0, [(1, 0, 5e-324)])], "1/2")
    same = MDP.from_outcomes([(0, 0, [(1, 0, F(1, 2**1074))])], "1/2")
    assert fingerprint(tiny) == fingerprint(same)


@pytest.mark.parametrize("subtasks", [1, 3])
def test_scenarios_have_their_own(subtasks: int) -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[subtasks])
    mdp = scenario.compile()
    assert fingerprint(mdp) == fingerprint(scenario.compile())
    assert fingerprint(mdp) != fingerprint(scenario.with_(max_trial=4).compile())
