"""Exactness belongs to each number: any mixture of kinds; what rows of floats mean."""

from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from model_contents import outcomes_of
from oracle import rows_of, solve_exact
from strategies import outcome_rows

from exact_mdp import MDP, DistributionError, certify, fingerprint, load, save

# ---- any kind of number --------------------------------------------------------------------------


def kinds(value: F) -> list[Any]:
    """Return the number in every kind that holds it exactly, floats last."""
    forms: list[Any] = [value, f"{value.numerator}/{value.denominator}"]
    places = next((k for k in range(12) if (value * 10**k).denominator == 1), None)
    if places is not None:
        sign, digits = "-" if value < 0 else "", str(abs(int(value * 10**places))).zfill(places + 1)
        cut = len(digits) - places
        forms.append(f"{sign}{digits[:cut]}.{digits[cut:]}" if places else f"{sign}{digits}")
    if value.denominator == 1:
        forms += [int(value), *(kind(int(value)) for kind in (np.int8, np.int64)
                                if abs(value) < np.iinfo(kind).max)]  # fmt: skip
    with np.errstate(over="ignore"):
        wide = np.longdouble(value.numerator) / np.longdouble(value.denominator)
        floats = [kind(wide) for kind in (float, np.float64, np.longdouble, np.float32, np.float16)]
    return forms + [x for x in floats if np.isfinite(x) and F(*x.as_integer_ratio()) == value]


def again(mdp: MDP) -> MDP:
    return MDP.from_outcomes(
        outcomes_of(mdp), mdp.discount_exact, start=dict(mdp.start), actions=mdp.actions
    )


REWARDS = (F(1, 7), F(1, 4), F(3), F(-2, 5), F(0), F(2**60 + 1), F(1, 2**70), F(-7, 8))
EYE = [[1, 0], [0, 1]]


@settings(max_examples=150)
@given(
    outcome_rows(st.sampled_from(REWARDS)), st.sampled_from([F(0), F(1, 2), F(9, 10)]), st.data()
)
def test_a_number_may_be_given_in_any_kind_that_holds_it(
    rows: list[Any], discount: F, data: st.DataObject
) -> None:
    def any_kind(value: F) -> Any:
        return data.draw(st.sampled_from(kinds(value)))

    mixed = [
        (s, a, [(any_kind(p), t, any_kind(r)) for p, t, r in outcomes]) for s, a, outcomes in rows
    ]
    plain = certify(MDP.from_outcomes(rows, discount))
    other = certify(MDP.from_outcomes(mixed, any_kind(discount)))
    assert list(other.value) == solve_exact(plain.mdp.n_states, rows_of(plain.mdp), discount)[0]
    assert other.violations() == []
    assert list(other.gaps) == list(plain.gaps)
    assert other.optimal_pairs.tolist() == plain.optimal_pairs.tolist()
    assert (other.start_value, other.unique) == (plain.start_value, plain.unique)
    assert other.model == plain.model
    assert fingerprint(again(other.mdp)) == fingerprint(other.mdp)


WIDE = 1 - F(1, 2**64)  # more than a double holds
KINDS = st.sampled_from([
    (value, form) for value in (*REWARDS, F(2**63), F(0.1), WIDE) for form in kinds(value)
])  # fmt: skip


@settings(max_examples=60)
@given(st.lists(KINDS, min_size=1, max_size=4), st.booleans())
def test_each_number_is_what_it_is_beside_any_other_in_every_container(
    drawn: list[Any], sparse: bool
) -> None:
    """A float in a list of words is not read as one; an integer beside a float keeps its end."""
    exact, given_ = map(list, zip(*drawn, strict=True))
    size, objects = len(given_), np.empty(len(given_), dtype=object)
    objects[:] = given_
    eye = sp.eye_array(size, format="csr") if sparse else np.eye(size)
    states = range(size)
    moved = [[x if s == t else 0 for t in states] for s, x in enumerate(given_)]
    each = [[x] for x in given_], [np.array([x]) for x in given_]  # a row for each state
    for mdp in (
        *(MDP.from_arrays([eye], reward, 0) for reward in (given_, objects, *each)),
        *([] if sparse else [MDP.from_arrays([eye], [moved], 0)]),
        MDP.from_pairs(states, [0] * size, eye, given_, 0),
        MDP.from_pairs(states[::-1], [0] * size, np.eye(size)[::-1], given_[::-1], 0),
        MDP.from_outcomes([(s, 0, [(1.0, s, x)]) for s, x in enumerate(given_)], 0),
        *([MDP.from_arrays([eye], np.array(given_), 0)]
          if size == 1 and isinstance(given_[0], np.generic) else []),
    ):  # fmt: skip
        assert list(certify(mdp).value) == exact
    if 0 <= exact[0] <= 1:
        assert MDP.from_arrays([[[1]]], [0], given_[0]).discount_exact == exact[0]


@given(st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=6))
def test_any_float_reward_and_any_wide_number_is_exact(values: list[float]) -> None:
    mdp = MDP.from_outcomes([(s, 0, [(1, s, x)]) for s, x in enumerate(values)], "1/2")
    assert [mdp.table.row(s)[0][2] for s in range(len(values))] == list(map(F, values))
    assert mdp.reward.tolist() == values
    tiny = F(1, 3**60)
    wide = MDP.from_outcomes([(0, 0, [(tiny, 0, 10**30), (1 - tiny, 1, 0)]), (1, 0, [(1, 1, 0)])])
    assert wide.table.weight.dtype == object
    assert wide.table.row(0)[0] == (tiny, 0, 10**30)
    assert (wide.reward[0], wide.transition.data[0]) == (float(tiny * 10**30), float(tiny))


@pytest.mark.parametrize(
    ("twice", "once", "total"),
    [((0.1, 0.2), 0.7, F(3, 10)), (((1 - 1 / 3) / 2, 1 / 3), (1 - 1 / 3) / 2, F(2, 3))],
)
def test_outcomes_that_come_twice_are_read_before_they_are_added_exactly(
    twice: tuple[float, float], once: float, total: F
) -> None:
    """0.1 + 0.2 to one state is 3/10, among outcomes and in a sparse matrix; SciPy adds rewards."""
    rows = [(0, 0, [*((p, 1, 0) for p in twice), (once, 0, 0)]), (1, 0, [(1, 1, 0)])]
    entries = ([*twice, once, 1.0], ([0, 0, 0, 1], [1, 1, 0, 1]))
    sparse = sp.coo_array(entries, shape=(2, 2))
    for mdp in (
        MDP.from_outcomes(rows),
        MDP.from_pairs([0, 1], [0, 0], sparse, [0, 0]),
        MDP.from_arrays([sparse], [0, 0]),
    ):
        assert sum(p for p, t, _ in mdp.table.row(0) if t == 1) == total
        assert mdp.floats
    rewards = sp.coo_array(([0.1, 0.2], ([0, 0], [0, 0])), shape=(2, 1))
    assert certify(MDP.from_arrays([EYE], rewards, 0)).value[0] == F(0.1 + 0.2)
    third = MDP.from_outcomes([(0, 0, [(F(1, 3), 0, 1), (0.25, 0, 1), (F(5, 12), 0, 1)])], 0)
    assert third.table.row(0) == [(F(1), 0, F(1))]


def test_it_stays_known_whether_numbers_were_floats(tmp_path: Any) -> None:
    """In a probability or a reward; when saved, changed, unrolled; not of exact numbers."""
    half = [(F(1, 2), 0, F(1, 3)), (F(1, 2), 1, F(1, 3))]
    for law in ([half[0], (0.5, 1, F(1, 3))], [half[0], (F(1, 2), 1, 0.1)], half):
        mdp = MDP.from_outcomes([(0, 0, law), (1, 0, [(1, 1, 0)])], F(1, 2))
        assert mdp.floats == (law is not half)
        save(mdp, tmp_path / "m.npz")
        for other in (load(tmp_path / "m.npz"), mdp.with_(discount=0.25), mdp.within(2)):
            assert other.floats == mdp.floats


# ---- what rows of floats mean -------------------------------------------------------------------


def row_of(chances: list[object], **named: object) -> list[F]:
    size = len(chances)
    rest = [[0] * k + [1] + [0] * (size - k - 1) for k in range(1, size)]
    mdp = MDP.from_arrays([[chances, *rest]], [1] * size, "9/10")
    exact = {state: p for p, state, _ in mdp.table.row(0)}
    return [exact.get(state, F(0)) for state in range(size)]


@pytest.mark.parametrize("parts", [3, 6, 7, 9, 10, 12, 100, 1000, 10**6])
def test_fractions_that_people_write_are_what_they_wrote(parts: int) -> None:
    for top in {1, 2, parts // 3, parts // 2, parts - 1}:
        left = parts - top
        counts = [top, left // 2, left - left // 2]
        assert row_of([n / parts for n in counts]) == [F(n, parts) for n in counts]
    assert row_of([1 / 3, (1 - 1 / 3) / 2, (1 - 1 / 3) / 2]) == [F(1, 3)] * 3
    assert row_of([0.1 + 0.2, 0.7]) == [F(3, 10), F(7, 10)]


CHANCES = st.lists(st.floats(1e-12, 1), min_size=1, max_size=8)


OFF = st.sampled_from([0.0, 1e-16, -1e-16, 3e-10, -3e-10, 9.9e-10, -9.9e-10])


def nearly_one(parts: list[float], off: float) -> list[float]:
    total = sum(parts)
    parts_of_one = [part / total for part in parts]
    parts_of_one[0] += off if parts_of_one[0] + off > 0 else 0.0
    return parts_of_one


@given(CHANCES, OFF, st.randoms(use_true_random=False))
def test_every_row_sums_to_1_exactly_whatever_the_order(parts, off, random) -> None:
    row = nearly_one(parts, off)
    exact = row_of(row)
    assert sum(exact) == 1
    assert min(exact) > 0
    again = sorted(range(len(row)), key=lambda _: random.random())
    assert row_of([row[k] for k in again]) == [exact[k] for k in again]
    same = {value: {exact[k] for k in range(len(row)) if row[k] == value} for value in row}
    assert all(len(each) == 1 for each in same.values())
    # Nothing moves by more than the row misses 1, and two units in the last place.
    for value, meant in zip(row, exact, strict=True):
        assert abs(F(value) - meant) <= abs(sum(map(F, row)) - 1) + 2 * F(np.spacing(value))


@given(CHANCES, OFF)
def test_a_model_keeps_the_floats_next_to_what_its_rows_mean(tmp_path_factory, parts, off) -> None:
    """A model built again from its rows, or saved and loaded, is the same."""
    row = nearly_one(parts, off)
    mdp = MDP.from_arrays([[row] * len(row)], [1] * len(row), "9/10")
    floats, exact = mdp.transition[[0]].toarray()[0], row_of(row)
    assert [float(p) for p in exact] == floats.tolist()
    assert row_of(floats.tolist()) == exact
    model = MDP.from_arrays([[exact] * len(row)], [1] * len(row), "9/10")
    assert fingerprint(model) == fingerprint(mdp)
    assert (mdp.floats, model.floats) == (True, False)
    assert list(certify(model).value) == list(certify(mdp).value)
    save(mdp, path := tmp_path_factory.mktemp("m") / "m.npz")
    for same in (again(mdp), again(again(mdp)), load(path)):
        assert fingerprint(same) == fingerprint(mdp)


def test_beside_exact_numbers_the_floats_alone_give_way() -> None:
    assert row_of(["1/3", 0.6666666666666666]) == [F(1, 3), F(2, 3)]
    odd = F(123456789, 1000000007)
    row = row_of([odd, 0.4, float(F(6, 10) - odd) + 5e-10])
    assert (row[0], row[1]) == (odd, F(0.4))
    for row in (["1/3", "666666667/1000000000"], [1, 1e-12], [F(0.1), F(0.9)]):
        with pytest.raises(DistributionError):
            row_of(row)


@pytest.mark.parametrize("seed", range(4))
def test_symmetric_actions_tie(seed: int) -> None:
    """Actions whose rows differ in their order alone, before states that are worth the same."""
    rng = np.random.default_rng(seed)
    for row in (rng.dirichlet(np.ones(5)), np.full(5, 0.2), np.array([3, 3, 2, 2, 1]) / 11):
        actions = [np.concatenate([[0], rng.permutation(row)]) for _ in range(4)]
        end = np.eye(6)[1:]
        mdp = MDP.from_arrays(
            np.array([np.vstack([action, end]) for action in actions]), [0, 1, 1, 1, 1, 1], "9/10"
        )
        assert certify(mdp).optimal[0].all()


def test_rounding_leaves_negative_numbers_which_are_0() -> None:
    row = [0.3, 0.7, -4e-16]
    for chances in (row, np.array(row), [*row[:2], -(2.0**-60)]):
        mdp = MDP.from_arrays([[chances, [0, 1, 0], [0, 0, 1]]], [1, 0, 0])
        assert mdp.table.row(0) == [(F(3, 10), 0, 1), (F(7, 10), 1, 1)]
    listed = MDP.from_arrays({0: {0: {0: F(1, 2), 1: 0.5, 2: -1e-17}}, 1: {}, 2: {}}, [0] * 3)
    assert [p for p, *_ in listed.table.row(0)] == [F(1, 2)] * 2


SINGLE = np.float32([0.1, 0.2, 0.7])  # which sum to 0.99999999


@pytest.mark.parametrize("form", ["array", "sparse", "numbers", "doubles", "named", "asked"])
def test_rows_of_single_precision_are_divided_by_their_sums(form: str) -> None:
    rows = np.concatenate([SINGLE[None], np.eye(3, dtype=np.float32)[1:]])
    of_state = {0: dict(enumerate(SINGLE))}
    models = {
        "array": lambda: MDP.from_arrays(rows[None], [0] * 3),
        "sparse": lambda: MDP.from_arrays([sp.csr_array(rows)], [0] * 3),
        "numbers": lambda: MDP.from_arrays([[[*row] for row in rows]], [0] * 3),
        "doubles": lambda: MDP.from_arrays(rows[None].astype(float), [0] * 3),
        "named": lambda: MDP.from_arrays({0: of_state, 1: {}, 2: {}}, [0] * 3),
        "asked": lambda: MDP.from_function(
            0, lambda s: [] if s else [0], lambda *_: [(p, t, 0) for t, p in of_state[0].items()]
        ),
    }
    mdp = models[form]()
    total = sum(map(F, SINGLE.tolist()))
    chances = [p for p, *_ in mdp.table.row(0)]
    assert sum(chances) == 1
    for chance, single in zip(chances, SINGLE.tolist(), strict=True):
        assert abs(chance - F(single) / total) < F(1, 2**53)
    assert mdp.with_(start=SINGLE).start[0][1] == chances[0]
