"""Nature's choice within one row, against linear programs, random members, and closed forms."""

from fractions import Fraction
from math import exp, log, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from exact_mdp import MDP, Intervals, ModelError
from exact_mdp.solvers.robust.divergence import Likelihood, RelativeEntropy
from exact_mdp.solvers.robust.sets import L1Ball, blocks_of, inner

fewer = settings(max_examples=40)
WEIGHTS = st.lists(st.integers(1, 50), min_size=1, max_size=7)
RADII = st.sampled_from([0.0, 1e-14, 1e-9, 1e-4, 0.01, 0.1, 0.5, 1.0, 1.9, 5.0])


def row_model(weights: list[int], gains: list[float]) -> MDP:
    """A model whose state 0 has one row: outcome k earns gains[k] and leads to state k + 1."""
    total = sum(weights)
    both = zip(weights, gains, strict=True)
    outcomes = [(Fraction(w, total), k + 1, g) for k, (w, g) in enumerate(both)]
    ends = [(k + 1, 0, [(1, k + 1, 0)]) for k in range(len(weights))]
    return MDP.from_outcomes([(0, 0, outcomes), *ends])


@st.composite
def rows(draw: st.DrawFn) -> tuple[MDP, np.ndarray, np.ndarray]:
    weights = draw(WEIGHTS)
    size = draw(st.sampled_from([1e-6, 1.0, 1e6]))
    gains = draw(
        st.lists(
            st.integers(-300, 300).map(lambda k: k / 64),
            min_size=len(weights),
            max_size=len(weights),
        )
    )
    gains = [float(g) * size for g in gains]
    p = np.array(weights) / sum(weights)
    return row_model(weights, gains), p, np.array(gains)


def asked(mdp: MDP, ambiguity: object, *, against: bool):
    ambiguity.check(mdp)
    blocks = blocks_of(mdp, np.arange(1))
    found = inner(ambiguity, blocks, np.zeros(mdp.n_states), discount=1.0, against=against)
    return float(found.low[0]), float(found.high[0]), found.laws[0][0]


def by_program(gains: np.ndarray, against: bool, **program: object) -> float:
    size = np.abs(gains).max() or 1.0  # the program's tolerances are absolute
    sign = size if against else -size
    cost = np.concatenate([gains / sign, np.zeros(program.pop("slack", 0))])
    found = linprog(cost, **program)
    assert found.status == 0, found.message
    return float(sign * found.fun)


@fewer
@given(rows(), st.sampled_from([0.0, 0.1, 0.2, 0.9, 1.0, 3.0]), st.booleans(), st.booleans())
def test_intervals_against_a_linear_program(row, share, absolute, against) -> None:
    mdp, p, gains = row
    kind = Intervals.absolute if absolute else Intervals.relative
    ambiguity = kind(mdp, share)
    low, high, _ = asked(mdp, ambiguity, against=against)
    n = len(p)
    bounds = list(zip(ambiguity.lower[:n], ambiguity.upper[:n], strict=True))
    right = by_program(gains, against, A_eq=np.ones((1, n)), b_eq=[1.0], bounds=bounds)
    room = 1e-7 * np.abs(gains).max()
    assert low - room <= right <= high + room
    assert high - low <= room


@fewer
@given(rows(), st.sampled_from([0.0, 0.05, 0.3, 1.0, 2.0, 4.0]), st.booleans())
def test_l1_balls_against_a_linear_program(row, radius, against) -> None:
    mdp, p, gains = row
    low, high, _ = asked(mdp, L1Ball(radius=radius), against=against)
    n = len(p)  # variables q and |q - p|
    eye = np.eye(n)
    right = by_program(
        gains,
        against,
        slack=n,
        A_eq=np.concatenate([np.ones((1, n)), np.zeros((1, n))], axis=1),
        b_eq=[1.0],
        A_ub=np.block([[eye, -eye], [-eye, -eye], [np.zeros((1, n)), np.ones((1, n))]]),
        b_ub=np.concatenate([p, -p, [radius]]),
        bounds=(0, None),
    )
    room = 1e-7 * np.abs(gains).max()
    assert low - room <= right <= high + room
    assert high - low <= room


def forward(p: np.ndarray, q: np.ndarray) -> float:
    return float(sum(a * log(a / b) for a, b in zip(p, q, strict=True)))


def backward(p: np.ndarray, q: np.ndarray) -> float:
    return float(sum(b * log(b / a) for a, b in zip(p, q, strict=True) if b > 0))


@pytest.mark.parametrize(
    ("kind", "divergence"), [(Likelihood, forward), (RelativeEntropy, backward)]
)
@fewer
@given(row=rows(), radius=RADII, against=st.booleans(), seed=st.integers(0, 99))
def test_divergence_sets_hold_what_they_return_and_no_member_beats_the_bound(
    kind, divergence, row, radius, against, seed
) -> None:
    mdp, p, gains = row
    low, high, law = asked(mdp, kind(radius=radius), against=against)
    q = law[: len(p)] / law[: len(p)].sum()  # the rest of the block is padding of weight 0
    # Copies of the first outcome that fill the block may have taken no mass.
    assert law[len(p) :].sum() == 0
    span = np.ptp(gains)
    if not (q == 0).any() or kind is RelativeEntropy:
        assert divergence(p, q) <= radius + 1e-13
    # A proven gap: that of rounding, of the divergence too, whose edge is left out by 1e-13.
    edge = min(1e-13 * (1 + radius) / sqrt(radius), sqrt(2 * radius)) if radius else 0.0
    assert high - low <= 1e-10 * np.abs(gains).max() + 10 * edge * span
    rng = np.random.default_rng(seed)
    for other in (rng.dirichlet(np.ones(len(p))), rng.dirichlet(0.2 * np.ones(len(p))) + 1e-12):
        other = other / other.sum()
        near, far = 0.0, 1.0  # towards `other` until the edge
        for _ in range(60):
            middle = (near + far) / 2
            inside = divergence(p, p + middle * (other - p)) <= radius - 1e-14
            near, far = (middle, far) if inside else (near, middle)
        member = p + near * (other - p)
        room = 1e-12 * np.abs(gains).max()
        if against:
            assert member @ gains >= low - room
        else:
            assert member @ gains <= high + room


def test_two_outcomes_have_closed_forms() -> None:
    mdp = row_model([1, 1], [0.0, 1.0])
    for radius in (1e-6, 1e-3, 0.1, 0.5, 2.0):
        low, high, _ = asked(mdp, Likelihood(radius=radius), against=True)
        right = (1 - sqrt(1 - exp(-2 * radius))) / 2  # 4 q (1 - q) = e^-2β
        assert low <= right <= high
        assert high - low < 1e-9
    low, high, law = asked(mdp, RelativeEntropy(radius=1.0), against=True)  # above log 2
    assert (law == [1, 0]).all()
    assert low <= 0 <= high < 1e-12


def test_chi_square_is_near_for_small_radii() -> None:
    mdp, p, gains = row_model([2, 3, 5], [0.0, 2.0, 7.0]), np.array([0.2, 0.3, 0.5]), [0, 2, 7]
    mean = p @ gains
    sd = sqrt(p @ np.square(gains) - mean**2)
    for kind in (Likelihood, RelativeEntropy):
        low, high, _ = asked(mdp, kind(radius=1e-6), against=True)
        assert (low + high) / 2 == pytest.approx(mean - sd * sqrt(2e-6), abs=1e-5)


def test_a_radius_for_each_pair() -> None:
    wait, go = [["1/2", "1/2"], [0, 1]], [["1/4", "3/4"], [0, 1]]
    mdp = MDP.from_arrays([wait, go], [1, 0], layout="ass")
    blocks = blocks_of(mdp, np.arange(2))
    found = inner(
        L1Ball(radius=[0.0, 0.5, 0, 0]), blocks, np.array([1.0, 0.0]), discount=1.0, against=True
    )
    assert found.value.tolist() == [1.5, 1.0]


@pytest.mark.parametrize(
    "make",
    [
        lambda mdp: L1Ball(radius=-0.1),
        lambda mdp: L1Ball(radius=float("nan")),
        lambda mdp: Likelihood(radius=float("inf")),
        lambda mdp: RelativeEntropy(radius="much"),
        lambda mdp: L1Ball(radius=[0.1]).check(mdp),
        lambda mdp: L1Ball(radius=[0.1, -1.0]),
    ],
)
def test_what_is_no_set_of_laws_is_refused(make) -> None:
    mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    with pytest.raises(ModelError):
        make(mdp)
