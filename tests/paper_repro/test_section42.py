"""The report's part about the two agents: what is said of each claim, and the figures."""

from __future__ import annotations

import matplotlib as mpl
import pytest

from exact_mdp.mdp import Scenario
from exact_mdp.mdp.care.perception import perceived
from exact_mdp.paper_repro.agents.claims import EXACT, statements
from exact_mdp.paper_repro.claims import all_claims
from exact_mdp.paper_repro.report import agents
from exact_mdp.paper_repro.report.figures import PICTURES
from exact_mdp.paper_repro.reported import FIGURES
from exact_mdp.solvers import evaluate


def test_each_statement_is_told_with_who_can_check_it() -> None:
    (told,) = agents.agents_part().more.values()
    for each, text in zip(statements(), told, strict=True):
        assert text == f"{each.claim} ({each.place}): {each.kind}."


def test_what_is_said_to_be_decided_here_is_decided_in_the_table_of_claims() -> None:
    listed = [claim for claim in all_claims() if claim.id.startswith("agents.")]
    for each, claim in zip(statements(), listed, strict=True):
        assert each.claim == claim.says
        assert (each.kind == EXACT) == (claim.rule != "open"), claim.id


def test_the_measured_perception_is_that_of_its_noise() -> None:
    found = agents.measured()
    assert found.counts.counts.sum() == 16 * agents.EACH
    rates = found.counts.rates(Scenario.load(agents.SCENARIO).statuses)
    inside = [
        rate.low <= 1 - agents.NOISE <= rate.high
        for both in rates.values()
        for rate in both.values()
    ]
    assert sum(inside) >= 7  # of eight intervals at 95 %
    mean = found.costs.value.value
    seen = perceived(found.mdp, found.policy, found.counts.counts / agents.EACH)
    assert mean == pytest.approx(evaluate(found.mdp, seen).mean, rel=1e-12)


@pytest.mark.slow
def test_figures_and_numbers() -> None:
    import matplotlib.pyplot as plt

    mpl.use("Agg")
    for picture in agents.PICTURES:
        assert picture.name.isidentifier()
        assert picture.caption
        assert picture.draw().axes[0].get_title()
    plt.close("all")
    prices, _, _, needed = agents.worsening()
    at = prices[agents.LEVELS.index(0.9)]
    assert at.taken_as_true.value < at.memoryless.value.value < at.filtering.lower
    assert 0.86 < needed.enough < 0.88
    found = agents.measured()
    assert found.value.interval[0] < found.value.interval[1] < found.costs.perfect.value


def test_every_figure_of_the_paper_is_answered() -> None:
    part = agents.agents_part()
    shown = [*PICTURES, *part.figures, *part.tables, *part.texts]
    places = {place for each in shown for place in each.place.split(", ")}
    assert set(FIGURES) <= places
    (recording,) = (text for text in part.texts if text.place == "Figure 11")
    for row in part.tables[0].rows:  # the table and the text are of one conversation
        assert row[-1] in recording.body or row[-1] == "(silent)"
