"""The fingerprint: the same for the same exact content, however stored, and for no other."""

from dataclasses import replace
from fractions import Fraction as F
from hashlib import sha256
from typing import Any

import numpy as np
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from model_contents import negated
from strategies import Rows, models

from exact_mdp import MDP, Scenario, fingerprint

DYADIC = [[[0.5, 0.5, 0], [0.25, 0.5, 0.25], [0, 0, 1]], [[0, 0.125, 0.875], [0, 0, 1], [0, 0, 1]]]
REWARD = [[1, -2.5], [0.75, 3], [0, 0]]
WALK = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [20, 0])
END = np.array([False, True])


def written(numbers: Any) -> Any:
    """The same numbers as strings "p/q", not in lowest terms."""
    if isinstance(numbers, list):
        return [written(number) for number in numbers]
    return f"{3 * F(numbers).numerator}/{3 * F(numbers).denominator}"


def test_models_are_equal_whose_content_is() -> None:
    floats = MDP.from_arrays(DYADIC, REWARD, 0.5)
    by_outcome = np.broadcast_to(np.array(REWARD).T[:, :, None], (2, 3, 3))
    for other in (
        MDP.from_arrays(written(DYADIC), written(REWARD), "1/2", name="other"),
        MDP.from_arrays([sp.csr_array(matrix) for matrix in DYADIC], np.array(REWARD), 0.5),
        MDP.from_arrays(np.array(DYADIC), by_outcome, F(1, 2)),
        MDP.from_arrays(DYADIC, REWARD, 0.5, actions=["a", "b"], states=["x", "y", "z"]),
        floats.with_(labels={"end": [False, False, True]}),
        negated(negated(floats)),
    ):
        assert fingerprint(other) == fingerprint(floats)
        assert floats == other
        assert len({floats, other}) == 1
    assert floats != floats.with_(discount="2/3")
    assert floats != 3
    assert len(dir(floats)) <= 30
    assert all(hasattr(floats, name) for name in dir(floats))


def test_what_differs_in_one_number_or_in_its_question_is_another_model() -> None:
    """Rows beyond 64 bits, in the numerator, the denominator, or both; a tenth is no float."""
    every = [
        MDP.from_outcomes([(0, 0, [(share, 0, reward), (1 - share, 1, 0)]), (1, 0, [(1, 1, 0)])])
        for share in (F(1, 3), F(1, 3**60), 1 - F(1, 3**60), F(1, 2**1060), F(1, 2**1100))
        for reward in (0, 3**60, F(1, 3**60), F(2) ** 1000, F(1, 2**1074), F(1, 2**1075))
    ]
    every += [WALK, WALK.with_(sense="min"), WALK.with_(goal=END), negated(WALK)]
    every += [MDP.from_arrays([[[1]]], [reward], "1/2") for reward in ("1/10", 0.1)]
    care = Scenario.load("yuan2025")
    every += [care.with_(tasks=[n], max_trial=m).compile() for n in (1, 3) for m in (4, 5)]
    assert len({fingerprint(mdp) for mdp in every}) == len(every)
    assert fingerprint(care.compile()) == fingerprint(every[-1])
    for one, other, rate in (
        ("1/10", "0.1", "0.5"),
        (0.0, -0.0, "1/2"),
        (5e-324, F(1, 2**1074), 0.5),
    ):
        left, right = (MDP.from_arrays([[[1]]], [x], y) for x, y in ((one, "1/2"), (other, rate)))
        assert fingerprint(left) == fingerprint(right)


def test_the_hash_is_that_of_the_lines_that_are_documented() -> None:
    """docs/reference/certificates.md: lines of integers in hexadecimal."""
    lines = [
        "exact-mdp model 2 min inf [1]",
        "0x2 0x1 0x1",  # states, discount
        "0x0 0x1 0x1",  # start
        *("0x0 0x1", "0x0 0x0"),  # states and actions of the pairs
        *("0x14 0x0", "0x1 0x1"),  # expected rewards
        *("0x2 0x1", "0x2 0x1"),  # denominators of the rows, and how many next states
        *("0x0 0x1 0x1", "0x1 0x1 0x1"),  # next states, weights
    ]
    walk = WALK.with_(sense="min", goal=END)
    assert fingerprint(walk) == sha256("\n".join(lines).encode()).hexdigest()


@settings(max_examples=60)
@given(models(), st.sampled_from([1, 2, 30, 2**40, 10**25]), st.randoms(use_true_random=False))
def test_how_a_model_is_stored_does_not_matter_and_every_number_does(
    rows: Rows, factor: int, draw: Any
) -> None:
    """Larger denominators; outcomes cut in halves that earn more and less, in any order."""
    mdp, listed = rows.model(), []
    for s, a, r, following in rows.pairs:
        outcomes = [(p / 2, t, r + d) for t, p in following.items() for d in (-1, 1)]
        draw.shuffle(outcomes)
        listed.append((s, a, outcomes))
    draw.shuffle(listed)
    names = ("weight", "denominator", "gain", "gain_denominator")
    larger = {
        name: np.array([int(x) * factor for x in getattr(mdp.table, name)], dtype=object)
        for name in names
    }
    weights = {name: larger.pop(name) for name in names[:2]}
    table = replace(mdp.table, rows=replace(mdp.table.rows, **weights), **larger)
    for same in (MDP.from_outcomes(listed, rows.discount), mdp.with_(table=table)):
        assert fingerprint(same) == fingerprint(mdp)
    others = [mdp.with_(discount=F(1, 7))]
    if mdp.n_states > 1:
        spread = mdp.with_(start={0: F(1, 3), 1: F(2, 3)})
        others += [mdp.with_(start=1), spread]
        turned = replace(spread, start=tuple(reversed(spread.start)))
        assert fingerprint(turned) == fingerprint(spread)
    for i, (s, a, r, following) in enumerate(rows.pairs):
        changes = [(s, a, r + F(1, 10**12), following), (s, a + 9, r, following)]
        if len(following) > 1:
            (t, p), (u, q) = list(following.items())[:2]
            little = min(p, q) / 10**12
            changes.append((s, a, r, {**following, t: p - little, u: q + little}))
        for change in changes:
            pairs = (*rows.pairs[:i], change, *rows.pairs[i + 1 :])
            others.append(replace(rows, pairs=pairs).model())
    assert len({fingerprint(other) for other in [mdp, *others]}) == 1 + len(others)
