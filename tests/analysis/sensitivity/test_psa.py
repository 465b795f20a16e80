"""Probabilistic sensitivity analysis against independent loops and closed forms."""

import json
from dataclasses import replace
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest
from cli_runner import run
from scipy.special import betainc
from scipy.stats import binom, binomtest

from exact_mdp.analysis.sensitivity.draws.solver import CareSolver, solver_of
from exact_mdp.analysis.sensitivity.psa.distributions import uncertainty
from exact_mdp.analysis.sensitivity.psa.expected_loss import expected_loss
from exact_mdp.analysis.sensitivity.psa.intervals import mean_loss, mean_of, quantiles, wilson
from exact_mdp.analysis.sensitivity.psa.psa import MISSING, PSA, psa
from exact_mdp.analysis.sensitivity.psa.rows import row_family
from exact_mdp.analysis.sensitivity.psa.value_of_information import evpi, evppi
from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.mdp.io.npz import save
from exact_mdp.mdp.parametric import moving, parametric
from exact_mdp.solvers import evaluate, solve

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
def care() -> PSA:
    return psa(YUAN, 3000, rng=0, effective_sample_size=20)


def test_every_draw_is_solved_and_every_policy_evaluated_in_it(care: PSA) -> None:
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


def test_no_candidate_beats_the_optimum_and_evpi_lies_between_its_ends(care: PSA) -> None:
    assert (care.values <= (care.optimal + care.error)[:, None] + care.value_error).all()
    worth = care.evpi()
    assert 0 <= worth.low.value <= worth.high.value
    assert care.evpi_of_candidates().value <= worth.high.value + 1e-9
    best = care.values.mean(axis=0).max()
    assert worth.high.value == pytest.approx(care.optimal.mean() - best)


def test_shares_of_optimal_actions_are_those_of_the_draws(care: PSA) -> None:
    share, low, high = care.probability_optimal()
    assert share.shape == (16, 4)
    assert (low <= share).all()
    assert (share <= high).all()
    assert (share.sum(axis=1) >= 1).all()  # ties count for each
    losing = (care.lost > 2 * care.error[:, None]).mean(axis=0)
    assert np.allclose(share[0], 1 - losing)


def test_the_acceptability_curve_rises_to_one(care: PSA) -> None:
    regret = care.regret()
    tolerances = [0.0, 1e-3, 0.1, regret.max()]
    found = [each.value for each in care.acceptability(tolerances)]
    assert found == sorted(found)
    assert found[-1] == 1
    assert found[1] == pytest.approx((regret <= 1e-3).mean())


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


def test_what_is_not_known_to_matter_is_worth_nothing() -> None:
    rng = np.random.default_rng(4)
    values, idle = rng.normal(size=(20_000, 2)), rng.normal(size=(20_000, 1))
    found = evppi(values, idle, ("idle",))
    assert abs(found.lower.value) < 4 * found.lower.standard_error
    assert found.regression.value < 0.02


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
def test_processes_and_a_local_cluster_change_no_byte() -> None:
    model = moving(wager("3/10", "2/5"), {"p": [(0, 1)], "q": [(1, 1)]})
    one = psa(model, 200, rng=0)
    for how in ({"n_jobs": 2}, {"n_jobs": 2, "scheduler": "local"}):
        two = psa(model, 200, rng=0, **how)
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
    wait = [["1/10", "9/10", 0], ["1/10", 0, "9/10"], ["1/10", 0, "9/10"]]
    cut = [[1, 0, 0]] * 3
    forest = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], "24/25")
    pairs = [forest.pair(state, 0) for state in range(3)]
    model = moving(forest, {"fire": [(pair, 0) for pair in pairs]})
    known = uncertainty(model, names=["fire"], default=10)
    found = psa(model, 24, rng=9, uncertain=known)
    assert found.labels == tuple(forest.space.labels(range(3)))
    g = 0.96
    for d in range(0, 24, 5):
        p, v = found.draws[d, 0], np.zeros(3)
        for _ in range(3000):  # the published model, by value iteration
            waiting = np.array([0, 0, 4]) + g * (p * v[0] + (1 - p) * v[[1, 2, 2]])
            v = np.maximum(waiting, np.array([0, 1, 2]) + g * v[0])
        assert found.optimal[d] == pytest.approx(v[0], rel=1e-9)
    assert found.evpi().low.value <= found.evpi().high.value


def test_the_expected_loss_falls_as_more_is_known_and_bounds_evpi() -> None:
    found = expected_loss(
        YUAN, {"today": "optimal", "random": "random"}, [10, 100, 1000], rng=0, n=200
    )
    assert found.loss.shape == (3, 2)
    assert found.loss[0, 0] > found.loss[1, 0] > found.loss[2, 0] >= 0
    assert (found.loss[:, 1] > 10).all()
    alone = psa(YUAN, 200, rng=0, effective_sample_size=100)
    error = 4 * found.standard_error[1, 0] + 4 * alone.evpi().high.standard_error
    assert abs(found.loss[1, 0] - alone.regret().mean()) < error
    assert list(found.frame()["policy"]) == ["today", "random"] * 3


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


# ---- the command ---------------------------------------------------------------------------------


def test_the_command_prints_what_scripts_read() -> None:
    words = ("sensitivity", "yuan2025", "psa", "--samples", "400", "--seed", "3", "--json")
    found = run(*words).result
    assert {"start_value", "acceptability", "evpi", "evppi", "p_optimal"} <= set(found)
    assert found["draws"] == 400
    assert found["seed"] == 3
    assert found["claim"] == "estimated"
    assert found["start_value"] == pytest.approx(solve(YUAN.compile()).start_value)
    direct = psa(YUAN, 400, rng=3)
    assert found["value"]["mean"] == pytest.approx(direct.optimal.mean())
    assert found["evpi"] == pytest.approx(direct.evpi().high.value)
    low, high = (found["evpi_bounds"][end]["value"] for end in ("low", "high"))
    assert 0 <= low <= high == found["evpi"]
    assert set(found["drawn"]) == set(direct.names)
    assert set(found["p_optimal"]) == {f"{number:04b}" for number in range(16)}
    assert found["acceptability"]["probability"][0] == pytest.approx((direct.regret() == 0).mean())
    assert found["evppi"]["base.*"] >= 0
    curve = found["expected_loss"]
    assert curve["along"] == "effective_sample_size"
    assert list(curve["policies"]) == [each["name"] for each in found["candidates"]]
    told = curve["policies"]["optimum today"]
    points = curve["points"]
    alone = expected_loss(YUAN, {"today": "optimal"}, points, rng=3, n=curve["draws"])
    assert told["loss"] == pytest.approx(alone.loss[:, 0].tolist())
    assert told["low"][0] < told["loss"][0] < told["high"][0]
    assert found["regret"]["few_draws"] == (found["regret"]["draws_that_carry_it"] < 50)
    assert all(each["reliable"] != bool(each["doubts"]) for each in found["evppi_details"].values())
    assert run(*words, "--n-jobs", "2").result == found


def test_the_command_holds_the_policy_that_is_named() -> None:
    found = run(
        "sensitivity", "yuan2025", "psa", "--samples", 300, "--policy", "always:directive", "--json"
    ).result
    assert found["policy"] == "always:directive"
    assert found["regret"]["mean"] > 50
    assert found["acceptability"]["probability"][0] == 0
    told = run("sensitivity", "yuan2025", "psa", "--samples", 300).out
    for words in ("EVPI", "share of draws", "expected loss", "every draw re-solved"):
        assert words in told


def test_the_command_takes_any_model(tmp_path: Path) -> None:
    file = tmp_path / "wager.npz"
    save(wager("3/10", "2/5"), file)
    found = run("sensitivity", file, "psa", "--samples", 24, "--n-jobs", 1, "--json").result
    assert found["evpi"] > 0
    assert set(found["evppi"]) == {"(state 0, 0)", "(state 0, 1)"}
    assert found["clipped"] is None
    assert found["expected_loss"]["draws"] == 2
    row = tmp_path / "row.toml"
    row.write_text('["(state 0, 0)"]\nfixed = true\n')
    words = ("--samples", 20, "--n-jobs", 1, "--json", "--effective-sample-size", row)
    held = run("sensitivity", file, "psa", *words).result
    assert held["fixed"]["(state 0, 0): to state 1"] == "stated to be fixed"
    assert len(held["drawn"]) == 1


def test_the_command_keeps_its_work(tmp_path: Path) -> None:
    words = ("sensitivity", "yuan2025", "psa", "--samples", 60, "--out", tmp_path, "--json")
    found = run(*words).result
    assert run(*words).result == found
    kept = json.loads((tmp_path / "psa.json").read_text())
    assert kept["evpi"] == found["evpi"]
    assert [path.name for path in tmp_path.glob("loss-*/points/*.npz")]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--samples", "0"), "--samples"),
        (("--samples", "-3"), "--samples"),
        (("--effective-sample-size", "0"), "effective sample size 0"),
        (("--effective-sample-size", "-1"), "effective sample size -1"),
        (("--effective-sample-size", "many"), "not a number"),
        (("--effective-sample-size", "none.toml"), "none.toml"),
        (("--parameter", "base.angre"), "did you mean base.anger"),
        (("--range", "base.anger=0:1"), "not ranges"),
        (("--relative", "0.2"), "not ranges"),
        (("--seed", "x"), "--seed"),
        (("--policy", "always:nothing"), "nothing"),
    ],
)
def test_the_command_refuses_what_cannot_be(words: tuple[str, ...], message: str) -> None:
    done = run("sensitivity", "yuan2025", "psa", *words)
    assert done.status == 2
    assert done.out == ""
    assert message in done.err


def test_a_file_with_a_slip_of_the_pen_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "uncertain.toml"
    file.write_text('["base.angre"]\neffective_sample_size = 10\n')
    done = run("sensitivity", "yuan2025", "psa", "--effective-sample-size", file)
    assert done.status == 2
    assert "did you mean base.anger" in done.err
    assert "uncertain.toml" in done.err
