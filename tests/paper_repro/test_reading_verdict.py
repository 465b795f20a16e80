"""The verdict on the reported policy, the chance of its ranking, and what learning ends with."""

from __future__ import annotations

from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from reading_cases import small_search, small_study

from exact_mdp.analysis.learning.outcomes import outcomes
from exact_mdp.mdp import ModelError
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.evidence import evidence
from exact_mdp.paper_repro.readings.reported_policy import (
    cost_by_status,
    normal_ranking,
    ranked,
    sums,
    under_reading,
)
from exact_mdp.paper_repro.readings.training import SETTINGS, combined, learning, to_train
from exact_mdp.paper_repro.reported import STARTS, compatible, policies
from exact_mdp.solvers.learning.training import train
from exact_mdp.solvers.solution import Certified
from exact_mdp.solvers.values.returns import return_distribution


def test_the_verdict_agrees_with_the_search() -> None:
    search = small_search()
    for reading, completion in ((0, 100), (9, 300)):
        found = under_reading(search, reading, completion)
        assert isinstance(found.regret, Certified)
        assert float(found.value.value) == pytest.approx(search.mean[reading, completion, 0])
        assert float(found.optimal.value) == pytest.approx(search.optimum[reading])
        assert found.regret.value == found.optimal.value - found.value.value
        for place, start in enumerate(STARTS):
            assert found.evaluations[start].mean == pytest.approx(
                search.mean[reading, completion, place]
            )
        costs = cost_by_status(found.audit, found.mdp.space)
        assert sum(costs.values()) == pytest.approx(float(found.regret.value))
        low, high = found.regret_range
        assert low <= float(found.regret.value) + 1e-9
        assert float(found.regret.value) <= high + 1e-9


def test_costs_by_status_are_those_of_the_states_that_err() -> None:
    found = under_reading(small_search(), 0, 0)
    costs = cost_by_status(found.audit, found.mdp.space)
    assert "0100" in costs
    assert "0000" not in costs
    assert list(costs.values()) == sorted(costs.values(), reverse=True)


def test_discounted_returns_have_no_exact_ranking() -> None:
    found = under_reading(small_search(), 1, 0)
    assert [chance.exact for chance in found.ranking] == [None, None]
    assert found.ranking[0].best == found.ranking[0].normal


def test_the_normal_ranking_is_a_bivariate_normal_probability() -> None:
    from scipy.stats import multivariate_normal

    mean, variance, n = np.array([3.0, 2.0, 1.5]), np.array([40.0, 90.0, 20.0]), 50
    v = variance / n
    law = multivariate_normal(
        [mean[1] - mean[0], mean[2] - mean[1]], [[v[0] + v[1], -v[1]], [-v[1], v[1] + v[2]]]
    )
    assert normal_ranking(mean, variance, n) == pytest.approx(law.cdf([0, 0]), abs=1e-7)


@pytest.mark.parametrize("experiments", [20, 1_000])
def test_the_ranking_of_averages_agrees_with_simulation_and_normal_averages(
    experiments: int,
) -> None:
    found = under_reading(small_search(), 0, 20)
    laws = [return_distribution(found.mdp, found.evaluations[start].chain) for start in STARTS]
    exact = ranked(*(sums(law, experiments) for law in laws))
    rng, runs = np.random.default_rng(5), 5_000
    totals = [
        rng.multinomial(experiments, law.probabilities / law.probabilities.sum(), size=runs)
        @ law.multiples.astype(float)
        for law in laws
    ]
    share = float(((totals[0] > totals[1]) & (totals[1] > totals[2])).mean())
    assert abs(share - exact.value) <= 4 * sqrt(max(share * (1 - share), 1e-4) / runs)
    mean = np.array([found.evaluations[start].mean for start in STARTS])
    variance = np.array([found.evaluations[start].start_variance for start in STARTS])
    normal = normal_ranking(mean, variance, experiments)
    assert normal == pytest.approx(exact.value, abs=0.05 if experiments == 20 else 1e-4)


# ---- learning ----------------------------------------------------------------------------------


def test_learning_is_that_of_the_training_module(tmp_path: Path) -> None:
    search = small_search()
    found = learning(search, [0, 1, 8], seeds=3, seed=4, n_jobs=1, out=tmp_path)
    assert found.readings.tolist() == [0, 0, 8]  # 1 differs from 0 in the evaluation alone
    mdp = search.reading(8).compile()
    for place, settings in enumerate(SETTINGS.values()):
        runs = train(mdp, settings, 3, rng=4)
        assert found.unique[2, place].tolist() == outcomes(mdp, runs, bound=False).distinct.tolist()
        assert np.array_equal(found.final[2, place], [run.final for run in runs])
    again = learning(search, [0, 1, 8], seeds=3, seed=4, n_jobs=1, out=tmp_path)
    assert np.array_equal(found.unique, again.unique)
    with pytest.raises(ModelError, match="differs in"):
        learning(search, [0, 1, 8], seeds=3, seed=5, n_jobs=1, out=tmp_path)


def test_the_likelihood_of_learning_counts_runs() -> None:
    found = learning(small_search(), [0], seeds=4, seed=0, n_jobs=1)
    three, two = (found.unique[0, 0] == 3).sum(), (found.unique[0, 1] == 2).sum()
    assert found.hits.tolist() == [[three, two]]
    assert found.log_likelihood[0] == pytest.approx(np.log((three + 1) / 6 * (two + 1) / 6))
    low, high = found.interval(0, 0)
    assert 0 <= low <= three / 4 <= high <= 1


def test_nothing_is_trained_without_seeds_or_readings() -> None:
    with pytest.raises(ModelError, match="seeds"):
        learning(small_search(), [0], seeds=0, seed=0)
    with pytest.raises(ModelError, match="readings"):
        to_train(evidence(small_search()), 0)


def test_compatible_policies_are_those_of_the_search() -> None:
    listed = policies()
    assert all(compatible(row) for row in listed[::50])
    for status, action in (("0010", 2), ("1100", 1), ("1000", 0), ("0000", 0)):
        changed = listed[10].copy()
        changed[int(status, 2)] = action
        assert not compatible(changed)


def test_readings_to_train_are_the_best_supported_once_each() -> None:
    found = evidence(small_search())
    chosen = to_train(found, 5)
    assert len(set(chosen.tolist())) == 5
    assert chosen[0] in (found.ranking[0], found.ranking[0] - 1)
    assert all(number % 2 == 0 for number in chosen)


def test_weights_combine_both_kinds_of_evidence() -> None:
    study = small_study()
    numbers, weights, left = combined(study.main, study.learned)
    assert weights.sum() == pytest.approx(1)
    assert (np.diff(weights) <= 0).all()
    assert 0 <= left < 1
    place = {int(number): at for at, number in enumerate(study.learned.readings)}
    logs = [
        study.main.marginal[n] + study.learned.log_likelihood[place[int(n) - int(n) % 2]]
        for n in numbers
    ]
    ratios = np.exp(np.array(logs) - logs[0])
    assert weights / weights[0] == pytest.approx(ratios)


# ---- the whole ---------------------------------------------------------------------------------


def test_sentences_say_what_the_numbers_say() -> None:
    study = small_study()
    sentences = study.sentences
    kinds = {sentence.kind for sentence in sentences}
    assert {"fit", "optimal", "equivalent", "learning"} <= kinds
    assert kinds & {"identified", "favoured", "not identified"}
    text = "\n".join(sentence.text for sentence in sentences)
    assert "21 of 96 readings" in text
    assert f"{len(study.main.credible())} of 96 readings are needed" in text
    best = {o.reading: o for o in study.main.support if o.log10_against == 0}
    if best["tasks"].verdict != "not identified":
        told = "Tasks of an experiment: one task of 3 subtasks is"
        assert f"{told} {best['tasks'].verdict}" in text
    count = int(study.search.optimal_under("0100", "directive").sum())
    assert f"directive under {count} of 96 readings" in text
    assert "In 0100 the text states non-directive. Optimal there," in text


def test_every_figure_is_drawn() -> None:
    import matplotlib.pyplot as plt

    from exact_mdp.analysis.plots import style
    from exact_mdp.paper_repro.report.readings import PICTURES

    study = small_study()
    for picture in PICTURES:
        with style():
            figure = picture.draw(study)
            figure.canvas.draw()
        assert figure.axes
        assert all(ax.has_data() for ax in figure.axes)
        plt.close(figure)


def test_the_ranking_figure_marks_the_reported_averages() -> None:
    import matplotlib.pyplot as plt

    from exact_mdp.paper_repro.report.readings import PICTURES

    (ranking,) = (picture for picture in PICTURES if picture.name == "reading_ranking")
    figure = ranking.draw(small_study())
    lines = {
        float(line.get_xdata()[0]) for line in figure.axes[1].lines if len(line.get_xdata()) == 2
    }
    assert set(reported.AVERAGE_RETURN.values()) <= lines
    plt.close(figure)
