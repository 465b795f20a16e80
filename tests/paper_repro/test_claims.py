"""The claims of the paper: pinned, held against the independent model, traceable to their place."""

import itertools
import json
import tomllib
from collections import Counter
from dataclasses import replace
from fractions import Fraction
from math import sqrt
from typing import Any

import numpy as np
import pytest
from care_oracle import ACTIONS, CLEAR, Oracle, acting
from scipy import stats

from exact_mdp import Bounded, Estimated, ModelError, return_distribution
from exact_mdp.paper_repro import run
from exact_mdp.paper_repro.claim import (
    CLAIMS,
    ClaimVerdict,
    compare_approximately,
    compare_average,
    judge_by_chance,
    judge_by_runs,
    judge_claims,
)
from exact_mdp.paper_repro.compiled import compute_costs, compute_losses, derive_weights
from exact_mdp.paper_repro.paper import (
    ANGRY,
    AVERAGES,
    EXPERIMENTS,
    FINAL,
    OPEN,
    ORDERS,
    PLACES,
    REPORTED,
    STATUSES,
    table_3,
)
from exact_mdp.paper_repro.section_2 import trial_flow
from exact_mdp.paper_repro.section_4_1_learning import error_of_pairs
from exact_mdp.paper_repro.section_4_1_policies import probability_of_ranking
from exact_mdp.paper_repro.silent_points import (
    Reading,
    build_default_reading,
    compute_support,
    log_likelihood,
    one_change,
)

pytestmark = pytest.mark.xdist_group("claims")  # one worker computes what all of them compare

EXACT = [claim for claim in CLAIMS.values() if not claim.learns]
RESULTS = json.loads((run.HERE / "results.json").read_text("utf-8"))
COMMITTED: dict[str, Any] = {entry["name"]: entry for entry in RESULTS["claims"]}
PINNED = tomllib.loads(run.EXPECTED.read_text("utf-8"))


@pytest.fixture(scope="module")
def reading() -> Reading:
    return build_default_reading(runs=6)


@pytest.fixture(scope="module")
def claims(reading: Reading) -> dict[str, Any]:
    return {e["name"]: e for e in judge_claims(EXACT, reading, one_change(reading), reading)}


@pytest.fixture(scope="module")
def oracle() -> Oracle:
    return Oracle(tasks=[3])


# ---- every claim ---------------------------------------------------------------------------------


def test_every_claim_has_its_places_and_a_reason_for_what_is_pinned() -> None:
    assert 50 < len(CLAIMS) <= 60
    for claim in CLAIMS.values():
        assert {*claim.places} <= {*PLACES}, claim.id
        assert claim.says.partition("{")[0] == claim.says != "", claim.id
        file, _, function = claim.code.partition(", ")
        assert f"def {function}(" in (run.HERE / file).read_text("utf-8")
    assert list(PINNED) == list(CLAIMS)
    assert all(entry["reason"] for entry in PINNED.values())


def test_the_exact_claims_are_as_pinned_and_as_committed(claims: dict[str, Any]) -> None:
    assert not [
        line for line in run.compare_with_pinned(list(claims.values())) if "no claim" not in line
    ]
    for name in (claim.id for claim in EXACT):
        old, new = COMMITTED[name], claims[name]
        for key in ("says", "source", "paper", "code", "why", "verdict_of_default_reading"):
            assert new[key] == old[key], (name, key)
        if new["exact"] is not None:
            committed = run.round_numbers(new)
            assert committed["exact"] == old["exact"], name
            assert abs(new["exact"] - old["exact"]) <= (old["error_bound"] or 1e-9), name


def test_the_committed_claims_are_as_pinned() -> None:
    assert list(COMMITTED) == list(CLAIMS)
    for name, entry in COMMITTED.items():
        pinned = PINNED[name].get("value")
        if pinned is not None and PINNED[name]["tolerance"] < 1e-6:
            assert entry["exact"] == run.round_numbers(pinned), name
            entry = entry | {"exact": pinned}
        assert [x for x in run.compare_with_pinned([entry]) if "no claim" not in x] == [], name
    assert RESULTS["runs"] == 400
    assert not RESULTS["quick"]


@pytest.mark.parametrize("status, action", [("anger", "supportive"), ("confusion", "directive")])
def test_a_change_of_the_model_is_found_and_names_the_claims(status: str, action: str) -> None:
    change = f"assistance.{action}.{status}.persistence=1/20"
    changed = run.changed_reading(build_default_reading(), [change])
    moved = run.changed_reading(build_default_reading(), [change.replace("1/20", "9/10")])
    names = ["assistance", "return.random", f"return.reported.{FINAL}"]
    for reading, off in ((changed, 0), (moved, 3)):
        entries = list(judge_claims([CLAIMS[n] for n in names], reading, [], reading))
        lines = [line for line in run.compare_with_pinned(entries) if "no claim" not in line]
        assert len({line.split()[0] for line in lines}) == off


def test_a_changed_number_or_verdict_is_found() -> None:
    entry = COMMITTED["policy.0100"]
    for change in ({"exact": 0.5}, {"exact": None}, {"verdict_of_default_reading": "reproduced"}):
        lines = run.compare_with_pinned([entry | change])
        assert [line for line in lines if line.startswith("policy.0100")]
    assert "new is not pinned" in run.compare_with_pinned([entry | {"name": "new"}])


# ---- the independent model -----------------------------------------------------------------------


def test_tables_3_and_4_against_the_independent_model(reading: Reading, oracle: Oracle) -> None:
    read = {**table_3(), **{f"reward.{name}": w for name, w in derive_weights(reading).items()}}
    for name, value in oracle.parameters.items():
        if not name.startswith(("assistance.", "skip.")):
            assert read.pop(name) == value, name
    assert not read


def test_values_against_the_independent_model(
    reading: Reading, claims: dict[str, Any], oracle: Oracle
) -> None:
    best, quarter = oracle.value(oracle.start), dict.fromkeys(ACTIONS, Fraction(1, 4))
    every = {("random", "as written"): (lambda state: quarter, RESULTS["values"]["random"])}
    for start, order in itertools.product(AVERAGES, ORDERS):
        policy = reading.find_reported_policy(start, order)
        assert set(policy) == set(STATUSES)
        assert all(policy[status] == "supportive" for status in (*OPEN, *ANGRY))
        every[start, order] = acting(policy), RESULTS["values"][order][start]
    for named, (policy, committed) in every.items():
        exact, known = reading.evaluate_policy(*named), oracle.evaluate(policy, distribution=False)
        assert abs(Fraction(exact.mean) - known["mean"]) <= Fraction(exact.start.error)
        assert exact.sd == pytest.approx(sqrt(known["variance"]), rel=1e-9)
        assert committed == run.round_numbers(float(known["mean"]))
    optimum = reading.evaluate_policy("optimal")
    assert abs(Fraction(optimum.mean) - best) <= Fraction(optimum.start.error)
    assert RESULTS["values"]["optimal"] == run.round_numbers(float(best))
    for statuses, committed in RESULTS["values"]["directive_in"].items():
        other = reading.find_reported_policy(FINAL) | dict.fromkeys(
            statuses.split(", "), "directive"
        )
        known = oracle.evaluate(acting(other), distribution=False)["mean"]
        assert committed == run.round_numbers(float(known))
    final = oracle.evaluate(acting(reading.find_reported_policy(FINAL)), distribution=False)["mean"]
    assert Fraction(claims["policy.final-is-optimal"]["exact_rational"]) == best - final


@pytest.mark.parametrize("name", ["anger", "1100", "1000", "0100", "0000"])
def test_best_actions_against_the_independent_model(
    claims: dict[str, Any], oracle: Oracle, name: str
) -> None:
    statuses = ANGRY if name == "anger" else [name]
    action = {"anger": "supportive", "0000": FINAL, **REPORTED["stated"]}[name]
    places = itertools.product(range(3), range(5), statuses)
    states = [(k, t, 1, tuple(map(int, status))) for k, t, status in places]
    right = [action in oracle.optimal_actions(state) for state in states]
    assert claims[f"policy.{name}"]["exact"] == sum(right) / len(right)
    assert (claims[f"policy.{name}"]["verdict"] == "reproduced") == all(right)


def test_losses_against_the_independent_model(reading: Reading, oracle: Oracle) -> None:
    exact = []
    for state in ((k, t, 1, (0, 1, 0, 0)) for k, t in itertools.product(range(3), range(5))):
        outcomes = oracle.outcomes(state, "supportive")
        ahead = (p * (sum(gains.values()) + oracle.value(then)) for p, then, gains, _ in outcomes)
        exact.append(oracle.value(state) - sum(ahead))
    assert sorted(compute_losses(reading, "0100", 1)) == sorted(exact)


def test_the_flow_of_trials_against_the_independent_model(reading: Reading, oracle: Oracle) -> None:
    flow = trial_flow(reading, "always:directive")
    reached = {CLEAR: Fraction(1)}
    for trial in range(5):
        assert flow[trial] == pytest.approx(float(sum(reached.values())))
        following: Counter[Any] = Counter()
        for status, weight in reached.items():
            for chance, state, _, skipped in oracle.outcomes((0, trial, 1, status), "directive"):
                following["skip" if skipped else state[3] if state[0] == 0 else None] += (
                    weight * chance
                )
        skips = following.pop("skip", 0)
        following.pop(None)
        reached = following
    assert flow[5] == pytest.approx(float(skips))


# ---- readings ------------------------------------------------------------------------------------


def test_the_likelihood_is_that_of_three_averages_and_a_plot(reading: Reading) -> None:
    expected = -0.5 * ((reading.evaluate_policy("random").mean - 70) / 5) ** 2
    for start, paper in AVERAGES.items():
        exact = reading.evaluate_policy(start, "swapped")
        error = exact.sd / sqrt(EXPERIMENTS)
        expected += -0.5 * ((exact.mean - paper) / error) ** 2 - np.log(error)
    assert log_likelihood(reading, "swapped") == pytest.approx(expected)


@pytest.mark.slow
def test_the_support_of_the_readings_is_as_committed() -> None:
    computed, committed = compute_support(build_default_reading()), RESULTS["readings"]
    assert computed.weights.sum() == pytest.approx(1)
    assert len({each.label for each in computed.readings}) == len(computed.readings) == 1152
    assert computed.rank == committed["default_rank"]
    assert computed.best.label == committed["best"]["label"]
    for point, options in computed.of_options().items():
        assert sum(options.values()) == pytest.approx(1)
        assert options == pytest.approx(committed["options"][point], abs=1e-9)


def test_other_readings_are_named_once_and_change_verdicts(claims: dict[str, Any]) -> None:
    readings = one_change(build_default_reading())
    assert len({each.label for each in readings}) == len(readings) == 17
    assert claims["return.random"]["verdict"] == "depends on the reading"
    assert claims["return.reported.supportive"]["verdict"] == "depends on the reading"
    assert claims["policy.0100"]["under_other_readings"]["reproduced"] == 0
    assert claims["equation1"]["under_other_readings"] is None


def test_a_skip_with_a_timestep_of_its_own_breaks_table_1() -> None:
    own = run.changed_reading(build_default_reading(), ["readings.skip_timestep=own"])
    assert CLAIMS["table1.timesteps"].find(own).verdict is ClaimVerdict.DIFFERS


# ---- rules ---------------------------------------------------------------------------------------


def test_reproduced_is_kept_for_nearly_all_runs() -> None:
    verdicts = [judge_by_runs(count, 400, "runs", "").verdict for count in (0, 1, 379, 380, 400)]
    seen, reproduced = ClaimVerdict.SEEN, ClaimVerdict.REPRODUCED
    assert verdicts == [ClaimVerdict.NOT_REPRODUCED, seen, seen, reproduced, reproduced]
    assert [judge_by_runs(n, 100, "runs", "").verdict for n in (1, 94, 95)] == [
        seen,
        seen,
        reproduced,
    ]
    assert judge_by_runs(24, 100, "runs", "").says == "seen in 24 % of 100 runs"
    assert judge_by_runs(0, 400, "runs", "").says == "not reproduced, seen in none of 400 runs"


@pytest.mark.parametrize(
    ("count", "few", "enough"), [(0, 298, 299), (1, 58, 59)], ids=["none", "all"]
)
def test_a_share_of_none_or_all_decides_only_by_its_confidence_interval(
    count: int, few: int, enough: int
) -> None:
    """None of n excludes a chance of 1 %, and all of n one below 95 %, with 95 % confidence."""
    for n, decided in ((few, False), (enough, True), (1, False)):
        finding = judge_by_runs(count * n, n, "runs", "")
        assert (finding.verdict is not ClaimVerdict.NOT_DETERMINED) == decided, n
        test = stats.binomtest(count * n, n)
        # One-sided, at 95 %: the interval of 90 % has 5 % on either side.
        low, high = test.proportion_ci(0.9, method="exact")
        assert decided == ((high < 0.01) if count == 0 else (low >= 0.95)), n
    pairs = judge_by_runs(0, 160_000, "pairs of runs", "", independent=4)
    assert pairs.says == "not determined, seen in none of 160,000 pairs of runs"
    assert pairs.why.endswith(
        "4 of the pairs of runs are independent, so with 95 % confidence the chance is below 52.8 %"
    )
    assert pairs.details["chance_below"] == 0.528


def test_an_estimate_near_the_limit_decides_nothing() -> None:
    for error, verdict in (
        (0.3, ClaimVerdict.REPRODUCED),
        (0.4, ClaimVerdict.NOT_DETERMINED),
        (float("inf"), ClaimVerdict.NOT_DETERMINED),
    ):
        number = Estimated(value=144.0, standard_error=error)
        assert compare_approximately(140.0, number).verdict is verdict
    for value in (144.999, 145.0):
        exact = Bounded(value=value, error=1e-9)
        assert compare_approximately(140.0, exact).verdict is ClaimVerdict.REPRODUCED


def test_no_chance_is_printed_as_none_and_no_share_as_all_that_is_not() -> None:
    assert judge_by_chance(0.0, "").says == "not reproduced, p < 1e-300"
    for count in (1, 9_999):
        assert judge_by_runs(count, 10_000, "runs", "").says.rpartition("seen in ")[2] == (
            "under 0.1 % of 10,000 runs" if count == 1 else "over 99 % of 10,000 runs"
        )
    far = replace(
        build_default_reading(), scenario=build_default_reading().scenario.with_(tasks=[6])
    )
    finding = CLAIMS["return.together"].find(far)
    assert "p = 0," not in finding.why
    assert finding.says == "not reproduced, p < 1e-300"


def test_claims_that_follow_from_another_fail_for_no_reason_of_their_own(
    claims: dict[str, Any],
) -> None:
    """With non-directive assistance the best one in 0100, all else alike, they would hold."""
    followers = [claim.id for claim in CLAIMS.values() if claim.follows]
    assert {CLAIMS[name].follows for name in followers} == {"policy.0100"}
    assert followers == ["policy.respectively", "policy.personalised", "policy.final-is-optimal"]
    assert [*claims["policy.final-is-optimal"]["cost_by_status"]] == ["0100"]
    # A person whose confusion outlasts directive assistance, but not non-directive one.
    other = run.changed_reading(
        build_default_reading(),
        [
            "assistance.directive.confusion.persistence=3/5",
            "assistance.non-directive.confusion.persistence=1/2",
        ],
    )
    for name in ("policy.0100", *followers[:2]):
        assert CLAIMS[name].find(other).verdict is ClaimVerdict.REPRODUCED, name


def test_the_error_of_a_share_of_pairs_counts_runs() -> None:
    """Over all samples the mean of the estimate is the variance, and what pairs add by themselves.

    M runs are drawn from three kinds and N from two, all alike likely; `law` says which pairs show
    it. Of shares in a whole population the sums are exact.
    """
    for law in ([[1, 0], [0, 1], [1, 1]], [[1, 0], [1, 0], [0, 0]], [[0, 1], [1, 0], [0, 0]]):
        table, (m, n) = np.array(law, dtype=bool), (3, 2)
        samples = [
            table[np.ix_(rows, columns)]
            for rows in itertools.product(range(3), repeat=m)
            for columns in itertools.product(range(2), repeat=n)
        ]
        variance = np.var([each.mean() for each in samples])
        alone = table - table.mean(0) - table.mean(1)[:, None] + table.mean()
        estimates = [error_of_pairs(each) ** 2 for each in samples]
        assert np.mean(estimates) == pytest.approx(variance + alone.var() / (m * n))


def test_the_error_of_a_share_of_pairs_is_that_of_runs_drawn_again() -> None:
    rng = np.random.default_rng(0)
    shown = np.logical_and.outer(rng.random(100) < 0.3, rng.random(100) < 0.35)
    drawn = [
        shown[np.ix_(rng.integers(100, size=100), rng.integers(100, size=100))].mean()
        for _ in range(4000)
    ]
    assert error_of_pairs(shown) == pytest.approx(np.std(drawn), rel=0.05)
    independent = sqrt(shown.mean() * (1 - shown.mean()) / shown.size)
    assert error_of_pairs(shown) > 5 * independent
    assert error_of_pairs(np.zeros((4, 4), dtype=bool)) == 0
    assert COMMITTED["learning.together"]["estimate_standard_error"] is None


def test_an_average_is_compatible_within_three_standard_errors() -> None:
    for errors, verdict in ((2.99, ClaimVerdict.COMPATIBLE), (3.01, ClaimVerdict.NOT_REPRODUCED)):
        answer = compare_average(errors, 0.0, 10.0, 100, error=0.0, why="")
        assert answer.verdict is verdict
        assert answer.number == Bounded(value=0.0, error=0.0)
        assert answer.paper == errors
    assert judge_by_chance(0.01, "").says == "compatible, p = 0.01"


def test_the_three_together_are_a_chi_squared_test(reading: Reading) -> None:
    chances = CLAIMS["return.together"].find(reading).details["probability"]
    for order in ORDERS:
        errors = [
            (reading.evaluate_policy(s, order).mean - paper)
            / (reading.evaluate_policy(s, order).sd / sqrt(EXPERIMENTS))
            for s, paper in AVERAGES.items()
        ]
        expected = stats.chi2.sf(sum(e**2 for e in errors), 3)
        assert chances[order] == pytest.approx(expected, rel=1e-9)


# ---- learning ------------------------------------------------------------------------------------


def test_the_learned_claims_have_verdicts(reading: Reading) -> None:
    claims = [claim for claim in CLAIMS.values() if claim.learns]
    for claim in claims:
        finding = claim.find(reading)
        assert isinstance(finding.verdict, ClaimVerdict)
        assert finding.why
    other = replace(reading, training={"ties": "random"})
    assert (other.train_runs("constant").final != reading.train_runs("constant").final).any()


@pytest.mark.parametrize("change", ["training.tie=first", "training.epochs=0", "base.anger=2"])
def test_changes_that_make_no_sense_are_refused(change: str) -> None:
    with pytest.raises(ModelError):
        assert run.changed_reading(build_default_reading(), [change]).mdp


def test_costs_of_choices_are_those_of_single_changes(reading: Reading, oracle: Oracle) -> None:
    best = oracle.value(oracle.start)
    chosen = {s: ACTIONS[a] for s, a in zip(STATUSES, reading.optimum[:16], strict=True)}
    cost = compute_costs(reading)
    assert (cost.min(axis=1) == 0).all()
    for status, action in (("0000", "none"), ("0100", "non-directive"), ("0001", "directive")):
        other = oracle.evaluate(acting({**chosen, status: action}), distribution=False)["mean"]
        expected = float(best - other)
        assert cost[int(status, 2), ACTIONS.index(action)] == pytest.approx(expected, abs=1e-9)


def test_the_ranking_by_the_normal_law_is_near_the_exact_one(reading: Reading) -> None:
    """The law of a sum of n returns is an n-fold convolution: a power of a Fourier transform."""
    laws = []
    for start in AVERAGES:
        law = return_distribution(reading.mdp, reading.build_policy(start))
        single = np.zeros(1024)
        lattice = np.asarray(law.multiples) * float(law.unit)
        assert (lattice == np.round(lattice)).all()
        np.add.at(single, np.round(lattice).astype(int) + 400, law.probabilities)
        size = 2**20
        laws.append(np.fft.irfft(np.fft.rfft(single, size) ** EXPERIMENTS, size))
    above = np.append(np.cumsum(laws[0][::-1])[::-1][1:], 0.0)
    below = np.insert(np.cumsum(laws[2])[:-1], 0, 0.0)
    exact = [reading.evaluate_policy(start) for start in AVERAGES]
    normal = probability_of_ranking(
        [e.mean for e in exact], [e.sd / sqrt(EXPERIMENTS) for e in exact]
    )
    assert normal == pytest.approx(float((laws[1] * above * below).sum()), abs=1e-5)
