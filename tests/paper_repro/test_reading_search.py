"""The search over all readings, against two independent implementations."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from random import Random

import numpy as np
import pytest
from oracle import ACTIONS, Oracle, acting
from reading_cases import SMALL, small_search
from reading_twin import moments_of

from exact_mdp.analysis.readings import ReadingSpace
from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.mdp.care.tables import READINGS
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.search import ARRAYS, PAPER_READINGS, _evaluate, search
from exact_mdp.paper_repro.reported import COMPLETIONS, STARTS, policies

BASE = Scenario.load("yuan2025")
ALL = policies()


def oracle_of(number: int) -> Oracle:
    settings = PAPER_READINGS.settings(number)
    readings = {name: str(settings[name]) for name in READINGS}
    tasks, rate = settings["tasks"], settings["evaluation_discount"]
    assert isinstance(tasks, tuple)
    assert isinstance(rate, Fraction)
    return Oracle(readings, list(tasks), discount=rate)


def evaluated(numbers: list[int], chosen: np.ndarray) -> dict[str, np.ndarray]:
    """The package's figures of some readings, one by one."""
    even = [number - number % 2 for number in numbers]
    parts = [_evaluate(BASE, PAPER_READINGS, chosen, [number]) for number in even]
    rows = [number % 2 for number in numbers]
    return {
        name: np.stack([part[name][row] for part, row in zip(parts, rows, strict=True)])
        for name in ARRAYS
    }


def test_every_reading_and_completion_is_there_once() -> None:
    assert len(PAPER_READINGS) == 6912
    assert len(COMPLETIONS) == 512
    assert ALL.shape == (1536, 16)
    assert len(np.unique(ALL, axis=0)) == 1536


def test_policies_do_what_the_text_states() -> None:
    number = {action: k for k, action in enumerate(reported.ACTIONS)}
    angry = [status for status in range(16) if status & 2]
    assert (ALL[:, angry] == number["supportive"]).all()
    assert (ALL[:, 0b1100] == number["directive"]).all()
    pairs = {tuple(row) for row in ALL[:, [0b1000, 0b0100]].tolist()}
    assert pairs == {(3, 2), (2, 3)}
    assert ALL[:3, 0].tolist() == [number[start] for start in STARTS]
    for status in reported.UNSTATED:
        assert set(ALL[:, int(status, 2)].tolist()) == {0, 1, 2, 3}


FAST = (3, 4, 6)  # small models: fractions are quick


@pytest.mark.parametrize(
    "case", [k if k in FAST else pytest.param(k, marks=pytest.mark.slow) for k in range(20)]
)
def test_random_readings_agree_with_exact_fractions(case: int) -> None:
    rng = Random(case)
    number = rng.randrange(len(PAPER_READINGS))
    chosen = ALL[[rng.randrange(len(ALL))]]
    found = evaluated([number], chosen)
    policy = acting({format(s, "04b"): ACTIONS[chosen[0, s]] for s in range(16)})
    model = oracle_of(number)
    exact = model.evaluate(policy, distribution=False)
    assert abs(Fraction(found["mean"][0, 0]) - exact["mean"]) <= Fraction(found["error"][0])
    assert found["variance"][0, 0] == pytest.approx(float(exact["variance"]), rel=1e-10)
    error = Fraction(found["variance_error"][0])
    assert abs(Fraction(found["variance"][0, 0]) - exact["variance"]) <= error
    if case < 4:
        assert abs(Fraction(found["optimum"][0]) - model.value(model.start)) <= Fraction(
            found["error"][0]
        )


TWO = PAPER_READINGS.number(
    tasks=(2,), task_bonus="no-subtask-skipped", skip_timestep="own", skip_onset="base"
)


@pytest.mark.parametrize(
    "number", [TWO, *(pytest.param(k, marks=pytest.mark.slow) for k in (0, 5328, 6911))]
)
def test_the_random_strategy_agrees_with_exact_fractions(number: int) -> None:
    found = evaluated([number], ALL[:1])
    exact = oracle_of(number).evaluate(
        lambda state: dict.fromkeys(ACTIONS, Fraction(1, 4)), distribution=False
    )
    assert found["random_mean"][0] == pytest.approx(float(exact["mean"]), abs=1e-10)
    assert found["random_variance"][0] == pytest.approx(float(exact["variance"]), rel=1e-10)


def test_all_policies_of_random_readings_agree_with_the_twin() -> None:
    rng = Random(1)
    numbers = [rng.randrange(len(PAPER_READINGS)) for _ in range(12)]
    found = evaluated(numbers, ALL)
    for place, number in enumerate(numbers):
        mean, variance = moments_of(PAPER_READINGS.settings(number), ALL)
        assert np.abs(found["mean"][place] - mean).max() < 1e-11
        assert np.abs(found["variance"][place] - variance).max() < 1e-8


def test_readings_stand_in_the_order_of_the_space() -> None:
    found = small_search()
    for number in (0, 1, 17, len(SMALL) - 1):
        scenario = found.reading(number)
        part = _evaluate(BASE, SMALL, ALL[:3], [number - number % 2])
        assert scenario.discount == SMALL.settings(number)["evaluation_discount"]
        assert found.mean[number, 0].tolist() == part["mean"][number % 2].tolist()
        assert found.optimum[number] == part["optimum"][number % 2]
    assert not found.mean.flags.writeable
    assert (found.mean <= found.optimum[:, None, None] + 2 * found.error[:, None, None]).all()


def test_a_policy_is_named_as_it_was_evaluated() -> None:
    found = small_search()
    for completion, start in ((0, 0), (311, 1), (511, 2)):
        named = found.policy(completion, STARTS[start])
        row = ALL[3 * completion + start]
        assert [reported.ACTIONS[k] for k in row] == [named[format(s, "04b")] for s in range(16)]


def test_the_same_figures_mean_equivalent_readings_and_no_others() -> None:
    """What the search finds equal is equal in exact arithmetic, and for a reason."""
    found = small_search()
    first = found.equivalent()
    same = {number: int(k) for number, k in enumerate(first) if k != number}
    for number in range(len(SMALL)):
        settings = SMALL.settings(number)
        expected = dict(settings)
        # A task of one subtask: the last subtask is completed where none was skipped.
        if settings["tasks"] == (1, 1, 1) and settings["task_bonus"] == "no-subtask-skipped":
            expected["task_bonus"] = "last-subtask-completed"
        # Statuses are charged once each, before or after: plain sums over the same statuses.
        resets = settings["skip_timestep"] == "own" and settings["skip_onset"] == "reset"
        if resets and settings["evaluation_discount"] == 1:
            expected["status_cost"] = "next"
        assert int(first[number]) == SMALL.number(**expected)
    assert len(same) == 21

    policy = acting({format(s, "04b"): ACTIONS[ALL[777, s]] for s in range(16)})
    for number in list(same)[::10]:
        results = []
        for each in (number, same[number]):
            settings = dict(SMALL.settings(each))
            tasks, rate = settings.pop("tasks"), settings.pop("evaluation_discount")
            model = Oracle(settings, tasks, discount=rate)
            exact = model.evaluate(policy, distribution=False)
            results.append((exact["mean"], exact["variance"]))
        assert results[0] == results[1]


def test_an_interrupted_search_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import exact_mdp.paper_repro.readings.search as module

    space = ReadingSpace(options={"tasks": ((3,), (2,), (1,)), "evaluation_discount": (1, "19/20")})
    monkeypatch.setattr(module, "BLOCK", 1)
    whole = search(space=space, n_jobs=1, out=tmp_path)
    kept = sorted(tmp_path.glob("*.npz"))
    assert len(kept) == 3
    kept[1].unlink()
    before = kept[0].stat().st_mtime_ns
    again = search(space=space, n_jobs=1, out=tmp_path)
    assert kept[0].stat().st_mtime_ns == before
    assert kept[1].exists()
    for name in ARRAYS:
        assert np.array_equal(getattr(whole, name), getattr(again, name))
    with pytest.raises(ModelError, match="differs in"):
        search(BASE.with_(max_trial=4), space=space, n_jobs=1, out=tmp_path)


def test_the_evaluation_discount_comes_last() -> None:
    with pytest.raises(ModelError, match="evaluation_discount"):
        search(space=ReadingSpace(options={"tasks": ((3,),)}))


@pytest.mark.slow
def test_the_top_of_the_whole_ranking_is_that_of_the_twin() -> None:
    """The 40 best of all 6,912 and 40 drawn at random, evaluated and scored independently."""
    from scipy.special import logsumexp
    from scipy.stats import norm

    from exact_mdp.paper_repro.readings.evidence import evidence

    whole = search()
    found = evidence(whole)
    top = found.ranking[:40].tolist()
    rng = Random(2)
    drawn = [rng.randrange(len(PAPER_READINGS)) for _ in range(40)]
    logs = []
    for number in [*top, *drawn]:
        both = moments_of(PAPER_READINGS.settings(number), ALL)
        mean, variance = (each.reshape(-1, 3) for each in both)
        x = np.array([reported.AVERAGE_RETURN[start] for start in STARTS])
        total = norm.logpdf(x, mean, np.sqrt(variance / 1_000 + 0.01 / 12)).sum(axis=1)
        total += norm.logpdf(140, mean.mean(axis=1), 5)
        logs.append(logsumexp(total) - np.log(512) + norm.logpdf(70, whole.random_mean[number], 5))
    # The twin takes the rounding as one more normal error, which changes little.
    assert logs[:40] == pytest.approx(found.marginal[top], abs=0.02)
    assert max(logs[k] for k in range(40, 80) if drawn[k - 40] not in top) <= min(logs[:40]) + 0.02
