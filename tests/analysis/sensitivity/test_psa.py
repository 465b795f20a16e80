"""Probabilistic sensitivity analysis against independent loops and closed forms; EVPPI covers."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction as F
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from forest import burning, forest
from scipy.special import betainc
from scipy.stats import binom, binomtest

from exact_mdp import (
    MDP,
    ModelError,
    Scenario,
    evaluate,
    moving,
    parametric,
    psa,
    solve,
    uncertainty,
)
from exact_mdp.analysis.sensitivity.draws.solver import CareSolver, solver_of
from exact_mdp.analysis.sensitivity.psa.intervals import mean_loss, mean_of, quantiles, wilson
from exact_mdp.analysis.sensitivity.psa.psa import MISSING
from exact_mdp.analysis.sensitivity.psa.rows import row_family
from exact_mdp.analysis.sensitivity.psa.value_of_information import evpi, evppi

YUAN = Scenario.load("yuan2025")
SMALL = YUAN.with_(tasks=[1], max_trial=2)


def excess(mean: float, size: float, sure: float) -> float:
    """E[max(p, sure)] for p ~ Beta(mean size, (1 - mean) size)."""
    a, b = mean * size, (1 - mean) * size
    below = betainc(a, b, sure)
    return sure * below + mean * (1 - betainc(a + 1, b, sure))


def wager(p: str, q: str) -> MDP:
    """One step: action 0 pays 1 with chance p, action 1 with chance q."""
    rows = [
        (0, 0, [(F(p), 1, F(1)), (1 - F(p), 2, F(0))]),
        (0, 1, [(F(q), 1, F(1)), (1 - F(q), 2, F(0))]),
        (1, 0, [(F(1), 1, F(0))]),
        (2, 0, [(F(1), 2, F(0))]),
    ]
    return MDP.from_outcomes(rows, 1)


@pytest.fixture(scope="module")
def care() -> Any:
    return psa(YUAN, 3000, rng=0, effective_sample_size=20)


def test_every_draw_is_solved_and_every_policy_evaluated_in_it(care: Any) -> None:
    for d in (0, 17, 2999):
        drawn = dict(zip(care.names, care.draws[d].tolist(), strict=True))
        mdp = YUAN.with_(parameters=drawn).compile()
        start = solve(mdp).start
        assert abs(care.optimal[d] - start.value) <= care.error[d] + start.error
        for n, candidate in enumerate(care.candidates):
            told = evaluate(mdp, candidate.weights)
            assert abs(care.values[d, n] - told.mean) <= care.value_error[d, n] + told.start.error


def test_moments_are_those_of_an_independent_loop() -> None:
    found = psa(SMALL, 4000, rng=1, effective_sample_size=20)
    mean = np.array([float(SMALL[name]) for name in found.names])
    drawn = np.random.default_rng(99).beta(20 * mean, 20 * (1 - mean), size=(30, len(mean)))
    loop = np.empty(len(drawn))
    lost = np.empty(len(drawn))
    for d, row in enumerate(drawn.tolist()):
        mdp = SMALL.with_(parameters=dict(zip(found.names, row, strict=True))).compile()
        loop[d] = solve(mdp).start_value
        lost[d] = loop[d] - evaluate(mdp, found.candidates[0].weights).mean
    for ours, theirs in ((found.optimal, loop), (found.regret(), lost)):
        error = np.hypot(ours.std() / len(ours) ** 0.5, theirs.std() / len(theirs) ** 0.5)
        assert abs(ours.mean() - theirs.mean()) < 4 * error
    assert found.optimal.std() == pytest.approx(loop.std(), rel=4 / (2 * len(loop)) ** 0.5)


def test_no_candidate_beats_the_optimum_and_evpi_lies_between_its_ends(care: Any) -> None:
    assert (care.values <= (care.optimal + care.error)[:, None] + care.value_error).all()
    worth = care.evpi()
    assert 0 <= worth.low.value <= worth.high.value
    assert care.evpi_of_candidates().value <= worth.high.value + 1e-9
    best = care.values.mean(axis=0).max()
    assert worth.high.value == pytest.approx(care.optimal.mean() - best)


def test_shares_of_optimal_actions_are_those_of_the_draws(care: Any) -> None:
    share, low, high = care.probability_optimal()
    assert share.shape == (16, 4)
    assert (low <= share).all()
    assert (share <= high).all()
    assert (share.sum(axis=1) >= 1).all()  # ties count for each
    losing = (care.lost > 2 * care.error[:, None]).mean(axis=0)
    assert np.allclose(share[0], 1 - losing)


def test_evpi_and_evppi_of_a_wager_are_the_closed_form() -> None:
    model = moving(wager("3/10", "2/5"), {"p": [(0, 1)], "q": [(1, 1)]})
    known = uncertainty(model, {"q": {"fixed": True}}, default=8)
    found = psa(model, 80, rng=2, uncertain=known)
    worth = found.evpi()
    exact = excess(0.3, 8, 0.4) - 0.4
    for each in (worth.low, worth.high, found.evpi_of_candidates()):
        assert abs(each.value - exact) < 4 * each.standard_error
    assert worth.low.value == pytest.approx(worth.high.value)
    partial = found.evppi({"p": ["p"]})["p"]
    for each in (partial.regression, partial.lower):
        assert abs(each.value - exact) < 4 * each.standard_error


def test_a_policy_that_is_often_best_by_little_is_a_candidate() -> None:
    """Of three wagers on a chance p ~ Beta(1, 1), the middle one is best in an eighth of the draws.

    They pay 0, p - 1/2 and 4 p - 19/8: the draws in which most is lost are all of the third.
    EVPI = ∫ max(0, p - 1/2, 4 p - 19/8) dp = (1/8)² / 2 + (3/8) (1/8 + 13/8) / 2 = 43/128.
    """
    p = F(1, 2)
    rows = [
        (0, 0, [(F(1), 3, F(0))]),
        (0, 1, [(p, 3, F(1, 2)), (1 - p, 1, F(-1, 2))]),
        (0, 2, [(p, 3, F(13, 8)), (1 - p, 2, F(-19, 8))]),
        *((s, 0, [(F(1), 3, F(0))]) for s in (1, 2)),
        (3, 0, [(F(1), 3, F(0))]),
    ]
    moved = moving(MDP.from_outcomes(rows, 1), {"p": [(1, 3), (2, 3)]})
    found = psa(moved, 400, rng=5, uncertain=uncertainty(moved, default=2))
    assert len(found.candidates) == 3
    among, most = found.evpi_of_candidates(), found.evpi().high
    assert among.value == pytest.approx(most.value, rel=1e-9)
    known = found.evppi({"p": ["p"]})["p"].regression
    for each in (among, most, known):
        assert abs(each.value - 43 / 128) < 4 * each.standard_error


@pytest.mark.parametrize(("mean", "size", "other"), [(0.3, 8, 0.4), (0.5, 3, 0.5), (0.2, 60, 0.6)])
def test_evppi_of_one_of_two_chances_is_the_closed_form(mean, size, other) -> None:
    rng = np.random.default_rng(3)
    p = rng.beta(mean * size, (1 - mean) * size, size=20_000)
    q = rng.beta(other * 10, (1 - other) * 10, size=len(p))
    values = np.column_stack([p, q])
    found = evppi(values, p[:, None], ("p",))
    exact = excess(mean, size, other) - max(mean, other)
    assert abs(found.regression.value - exact) < 4 * found.regression.standard_error + 1e-9
    assert abs(found.lower.value - exact) < 4 * found.lower.standard_error + 1e-9
    both = evppi(values, values, ("p", "q"))
    whole = evpi(values)
    assert abs(both.regression.value - whole.value) < 4 * whole.standard_error
    assert found.regression.value < both.regression.value + 4 * whole.standard_error


@pytest.mark.parametrize("worth", [0.0, 0.5])
def test_evppi_is_cut_at_evpi_where_the_fit_promises_more(worth: float) -> None:
    """A step that loses, and seldom wins: splines swing above it where nothing is to be won."""
    known = np.linspace(-1, 1, 400)[:, None]
    ahead = np.where(known > 0.3, -1.0, 0.0) + np.where(known > 0.99, 1 + worth, 0.0)
    values = np.hstack([np.zeros_like(known), ahead])
    found, most = evppi(values, known, ("x",)), evpi(values).value
    assert most == pytest.approx(worth * (known > 0.99).mean())
    assert found.regression.value == most
    if worth:
        assert "cut at EVPI of the candidates" in found.doubts


def test_evppi_is_that_of_nested_monte_carlo() -> None:
    found = psa(YUAN, 6000, rng=5, effective_sample_size=8)
    name = "base.disengagement"
    partial = found.evppi({name: [name]})[name]
    rng, outer, inner = np.random.default_rng(6), 150, 200
    solver = solver_of(parametric(YUAN))
    policies = [candidate.weights for candidate in found.candidates]
    mean = np.array([float(YUAN[each]) for each in found.names])
    drawn = rng.beta(8 * mean, 8 * (1 - mean), size=(outer * inner, len(mean)))
    column = found.names.index(name)
    drawn[:, column] = np.repeat(drawn[:outer, column], inner)
    values = solver.values(found.names, drawn, policies)["value"]
    given = values.reshape(outer, inner, -1).mean(axis=1)
    # The mean of a maximum of noisy means lies above: halves of each inner sample tell by how much.
    halves = values.reshape(2 * outer, inner // 2, -1).mean(axis=1)
    alone = values.mean(axis=0).max()
    nested = 2 * (given.max(axis=1).mean() - alone) - (halves.max(axis=1).mean() - alone)
    best = int(values.mean(axis=0).argmax())
    error = (given.max(axis=1) - given[:, best]).std() / outer**0.5
    assert abs(partial.regression.value - nested) < 4 * np.hypot(
        error, partial.regression.standard_error
    )
    assert partial.lower.value <= partial.regression.value + 3 * partial.lower.standard_error


def test_where_weights_alone_are_uncertain_evpi_is_one_number() -> None:
    weights = uncertainty(
        parametric(YUAN), {"reward": {"relative_sd": 0.5}}, names=list_of("reward.")
    )
    found = psa(YUAN, 3000, rng=7, uncertain=weights)
    worth = found.evpi()
    assert worth.low == worth.high
    today = solve(YUAN.compile()).start_value
    # By linearity the best policy is today's, whose mean value over the draws is V*(mean).
    kept = found.values[:, 0]
    assert abs(kept.mean() - today) < 4 * kept.std() / len(kept) ** 0.5
    # The difference of pairs has the same mean as E[V*] - V*(mean), and far less noise.
    assert worth.high.value == pytest.approx((found.optimal - kept).mean())
    assert worth.high.standard_error < kept.std() / len(kept) ** 0.5 / 2


def test_where_todays_optimum_stays_optimal_evpi_of_weights_is_nothing() -> None:
    weights = uncertainty(
        parametric(SMALL), {"reward": {"relative_sd": 1e-4}}, names=["reward.trial"]
    )
    for policy in ("optimal", "always:directive"):
        worth = psa(SMALL, 400, rng=0, uncertain=weights, policy=policy).evpi()
        assert worth.low.value == worth.high.value == 0.0
        assert worth.high.interval == (0.0, 0.0)


def test_candidates_are_sought_where_most_is_lost_and_evppi_is_at_most_their_evpi() -> None:
    found = psa(YUAN, 3000, rng=3)
    among = found.evpi_of_candidates()
    for each in found.evppi().values():
        assert each.regression.value <= among.value + 1e-15
        assert each.reliable == (each.doubts == ())
    regret = found.regret()
    left = (found.optimal - found.values.max(axis=1)).clip(0)
    top = np.argsort(-regret)[:20]
    assert left[top].mean() < regret[top].mean() / 2  # the costly draws have their policies
    alone = replace(found, values=found.values[:, :1], candidates=found.candidates[:1])
    doubted = alone.evppi({"base.anger": ["base.anger"]})["base.anger"]
    assert (MISSING in doubted.doubts) == (
        2 * found.evpi().low.standard_error < found.evpi().low.value
    )


def test_the_lower_estimate_is_on_average_no_more_than_what_knowing_is_worth() -> None:
    rng, count = np.random.default_rng(1), 400
    lower, regression, doubted = [], [], 0
    for _ in range(150):
        known = rng.choice([-1.0, 1.0], size=(count, 1))
        second = 1 + known + (0.8 * count) ** 0.5 * rng.normal(size=(count, 1))
        found = evppi(np.hstack([np.zeros((count, 1)), second]), known, ("x",))  # worth nothing
        lower.append(found.lower.value)
        regression.append(found.regression.value)
        doubted += not found.reliable
    spread = np.std(lower) / len(lower) ** 0.5
    assert np.mean(lower) < 2 * spread
    assert np.mean(regression) > 0.05  # which noise pulls up
    assert doubted > 100


def test_the_interval_of_a_mean_that_few_draws_carry_covers_more_often_than_the_normal_one() -> (
    None
):
    rng, covered, plain = np.random.default_rng(2), 0, 0
    for _ in range(400):
        values = rng.exponential(size=1000) * (rng.random(1000) < 0.02)
        told = mean_loss(values)
        covered += told.low <= 0.02 <= told.high
        low, high = mean_of(values).interval
        plain += low <= 0.02 <= high
        assert told.few == (values.sum() ** 2 < 50 * (values**2).sum())
    assert plain < 0.93 * 400
    assert 0.93 * 400 < covered <= 400
    even = mean_loss(1 + rng.random(5000))
    assert np.allclose(even.interval, mean_of(1 + np.zeros(5000)).value + 0.5, atol=0.02)
    assert not even.few
    assert mean_loss(np.zeros(9)).interval == (0.0, 0.0)


def list_of(start: str) -> list[str]:
    return [name for name in YUAN.names if name.startswith(start)]


def test_workers_and_sample_sizes_change_no_byte(tmp_path: Path) -> None:
    one = psa(SMALL, 9000, rng=0, n_jobs=1)
    two = psa(SMALL, 9000, rng=0, n_jobs=2, folder=tmp_path / "run")
    again = psa(SMALL, 9000, rng=0, n_jobs=1, folder=tmp_path / "run")
    for other in (two, again):
        for name in ("draws", "optimal", "values", "counts", "lost"):
            assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
        assert [c.name for c in one.candidates] == [c.name for c in other.candidates]
    short = psa(SMALL, 100, rng=0)
    assert short.optimal.tobytes() == one.optimal[:100].tobytes()
    assert psa(SMALL, 100, rng=1).optimal.tobytes() != short.optimal.tobytes()


def test_a_larger_sample_uses_the_folder_of_a_smaller_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    psa(SMALL, 5000, rng=0, folder=tmp_path)
    done: list[int] = []
    solved = CareSolver.solved

    def counting(self: CareSolver, names: list[str], draws: np.ndarray) -> dict[str, np.ndarray]:
        done.append(len(draws))
        return solved(self, names, draws)

    monkeypatch.setattr(CareSolver, "solved", counting)
    more = psa(SMALL, 6000, rng=0, folder=tmp_path)
    assert done == [6000 - CareSolver.block]
    assert more.values.tobytes() == psa(SMALL, 6000, rng=0).values.tobytes()


def test_a_model_of_its_rows_is_drawn_by_rows() -> None:
    third = [[[0.34, 0.33, 0.33], [0, 1, 0], [0, 0, 1]], [[0.2, 0.4, 0.4], [0, 1, 0], [0, 0, 1]]]
    family = row_family(MDP.from_arrays(third, [1, 0, 0], discount=0.9))
    found = psa(family, 30, rng=0, effective_sample_size=1)
    assert {part.label for part in found.uncertainty.parts} == set(family.rows)
    assert {part.kind for part in found.uncertainty.parts} == {"dirichlet"}
    assert found.clipped is None  # not worked out


def test_a_folder_of_other_draws_is_refused(tmp_path: Path) -> None:
    psa(SMALL, 50, rng=0, folder=tmp_path)
    with pytest.raises(ModelError, match="seed"):
        psa(SMALL, 50, rng=1, folder=tmp_path)


@pytest.mark.slow
def test_processes_change_no_byte() -> None:
    model = moving(wager("3/10", "2/5"), {"p": [(0, 1)], "q": [(1, 1)]})
    one = psa(model, 200, rng=0)
    two = psa(model, 200, rng=0, n_jobs=2)
    assert one.optimal.tobytes() == two.optimal.tobytes()
    assert one.values.tobytes() == two.values.tobytes()


def test_cut_off_chances_are_counted() -> None:
    sure = YUAN.with_(parameters={"base.anger": "0.9", "influence.disengagement.anger": "0.09"})
    found = psa(sure, 2000, rng=8, effective_sample_size=10)
    place = {name: column for column, name in enumerate(found.names)}
    numbers = {name: found.draws[:, column] for name, column in place.items()}
    over = np.zeros(len(found), dtype=bool)
    statuses = YUAN.statuses
    for target in statuses:
        pushes = [numbers[f"influence.{other}.{target}"] for other in statuses if other != target]
        over |= numbers[f"base.{target}"] + np.sum(pushes, axis=0) > 1
    assert found.clipped.value == pytest.approx(over.mean())
    assert found.clipped.value > 0.3


def test_a_published_model_with_an_uncertain_row() -> None:
    """Forest management (pymdptoolbox): a fire's chance is known from ten years."""
    model = burning("24/25")
    known = uncertainty(model, names=["fire"], default=10)
    found = psa(model, 24, rng=9, uncertain=known)
    assert found.labels == tuple(forest("24/25").space.labels(range(3)))
    g = 0.96
    for d in range(0, 24, 5):
        p, v = found.draws[d, 0], np.zeros(3)
        for _ in range(3000):  # the published model, by value iteration
            waiting = np.array([0, 0, 4]) + g * (p * v[0] + (1 - p) * v[[1, 2, 2]])
            v = np.maximum(waiting, np.array([0, 1, 2]) + g * v[0])
        assert found.optimal[d] == pytest.approx(v[0], rel=1e-9)
    assert found.evpi().low.value <= found.evpi().high.value


def test_intervals_are_those_of_scipy() -> None:
    for successes, count in ((0, 10), (3, 10), (10, 10), (997, 1000)):
        low, high = wilson(successes, count)
        theirs = binomtest(successes, count).proportion_ci(method="wilson")
        assert (float(low), float(high)) == pytest.approx((theirs.low, theirs.high), abs=1e-12)


def test_intervals_of_quantiles_cover_as_often_as_they_say() -> None:
    rng = np.random.default_rng(10)
    inside = 0
    for _ in range(400):
        (found,) = quantiles(rng.exponential(size=300), [0.75])
        inside += found.low <= np.log(4) <= found.high
    assert 0.92 < inside / 400 <= 1


def test_intervals_of_quantiles_end_at_the_order_statistics_that_they_name() -> None:
    """The ⌊np - z √(np(1-p))⌋-th smallest and the ⌈np + z √(np(1-p))⌉ + 1-th; the ends clipped."""
    half, early = quantiles(np.arange(1.0, 1001.0)[::-1], [0.5, 0.1])
    assert (half.low, half.value, half.high) == (469, 500.5, 532)
    assert (early.low, early.high) == (81, 120)
    for found, p in ((half, 0.5), (early, 0.1)):  # sorted, the k-th smallest is k
        cover = binom.cdf(found.high - 1, 1000, p) - binom.cdf(found.low - 1, 1000, p)
        shorter = binom.cdf(found.high - 2, 1000, p) - binom.cdf(found.low, 1000, p)
        assert shorter < cover
        assert 0.95 <= cover < 0.97
    (least,) = quantiles(np.arange(1.0, 11.0), [0.025])
    assert (least.low, least.high) == (1, 3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ({"n": 0}, "0 draws"),
        ({"n": -1}, "-1 draws"),
        ({"n": 5.0}, "5.0 draws"),
        ({"n": True}, "True draws"),
        ({"rng": None}, "None is not a source"),
        ({"rng": True}, "True is not a source"),
        ({"rng": -1}, "-1 is not a source"),
        ({"rng": 1.5}, "1.5 is not a source"),
        ({"effective_sample_size": 0}, "sample size 0"),
        ({"effective_sample_size": float("nan")}, "sample size nan"),
        ({"uncertain": uncertainty(parametric(YUAN), names=["persistence.anger"])}, "uncertain"),
    ],
)
def test_what_cannot_be_drawn_is_refused(words: dict[str, object], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        psa(YUAN, **({"n": 5, "rng": 0} | words))


def test_a_count_of_numpy_is_a_count() -> None:
    found = psa(SMALL, np.int64(7), rng=np.uint8(0))
    assert len(found) == 7
    assert type(found.seed) is int


def test_a_state_that_cannot_be_reached_makes_no_action_optimal() -> None:
    """In every draw the second action gives up 5, whatever another state is worth."""
    half = F(1, 2)
    rows = [(0, 0, [(half, 1, 5), (half, 2, 5)]), (0, 1, [(half, 1, 0), (half, 2, 0)])]
    rows += [(1, 0, [(1, 3, 0)]), (2, 0, [(1, 3, 0)]), (3, 0, [(1, 3, 0)])]
    mdp = MDP.from_outcomes([*rows, (4, 0, [(1, 3, 10**13)])])
    share, _, _ = psa(moving(mdp, {"p": [(0, 1)]}), 20, rng=1).probability_optimal()
    assert np.array(share).tolist() == [[1.0, 0.0]]


# ---- how often the intervals of an EVPPI cover --------------------------------------------------

STEP = 0.02  # what the second action costs below the step


def quadratic() -> float:
    """E[max((x - 1/2)² - 1/20, 0)] less the mean, 1/30, for x uniform."""
    root = sqrt(0.05)
    return 2 * ((0.5**3 - root**3) / 3 - 0.05 * (0.5 - root)) - 1 / 30


def step(edge: float) -> float:
    """1 above the edge, -0.02 below it, against nothing."""
    gain = 1 - edge
    return gain - max(0.0, gain - STEP * edge)


CASES: dict[str, tuple[Callable[[np.ndarray], np.ndarray], float]] = {
    "linear": (lambda x: x - 0.4, 0.08),
    "centred": (lambda x: x - 0.5, 0.125),
    "quadratic": (lambda x: (x - 0.5) ** 2 - 0.05, quadratic()),
    "none": (lambda x: 0.0 * x, 0.0),
    "behind": (lambda x: 0.0 * x - 0.2, 0.0),
    "edge 0.9": (lambda x: np.where(x > 0.9, 1.0, -STEP), step(0.9)),
    "edge 0.95": (lambda x: np.where(x > 0.95, 1.0, -STEP), step(0.95)),
    "edge 0.98": (lambda x: np.where(x > 0.98, 1.0, -STEP), step(0.98)),
    "middle": (lambda x: np.where(x > 0.5, 1.0, -1.0), 0.5),
}


@pytest.mark.parametrize("noise", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("case", CASES)
def test_intervals_without_doubt_cover(case: str, noise: float) -> None:
    """500 draws, 60 times; 95 % or more is not excluded by Wilson's interval of the share."""
    gain, truth = CASES[case]
    rng = np.random.default_rng(3)
    hits = count = 0
    for _ in range(60):
        x = rng.uniform(size=(500, 1))
        ahead = gain(x) + noise * rng.normal(size=x.shape)
        found = evppi(np.hstack([ahead, 0 * ahead]), x, ("x",))
        low, high = found.regression.interval
        if found.reliable:
            count, hits = count + 1, hits + (low <= truth <= high)
    if count:
        assert wilson(hits, count)[1] >= 0.95


@pytest.mark.parametrize(
    "case, least, most",
    [("edge 0.9", 28, 30), ("edge 0.95", 28, 30), ("edge 0.98", 28, 30), ("middle", 28, 30),
     ("linear", 0, 3)],
)  # fmt: skip
def test_a_step_that_shows_is_doubted_and_a_good_fit_is_not(
    case: str, least: int, most: int
) -> None:
    """Splines round a step off; their residuals beside it add up."""
    gain, _ = CASES[case]
    rng = np.random.default_rng(4)
    doubted = 0
    for _ in range(30):
        x = rng.uniform(size=(500, 1))
        ahead = gain(x) + 0.3 * rng.normal(size=x.shape)
        doubted += not evppi(np.hstack([ahead, 0 * ahead]), x, ("x",)).reliable
    assert least <= doubted <= most
