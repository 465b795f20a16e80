"""Every result shows itself: a table, an HTML table, a few lines, a picture if there is one."""

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction as F
from functools import cache
from html import unescape
from typing import Any
from xml.etree import ElementTree

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas
import pytest
import scipy.sparse as sparse
from matplotlib.axes import Axes

import exact_mdp as em
from exact_mdp import Policy, Scenario

mpl.use("Agg")
LINES, LETTERS, SHORT = 20, 2000, 500
SMALL = em.Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
NAMES = ["base.anger", "reward.anger"]
ROUGH = em.independent([0.9] * 4, [0.85] * 4)
LEARNER = em.QLearning(epochs=20)


@cache
def care() -> em.MDP:
    return SMALL.compile()


@cache
def run() -> em.TrainingRun:
    return LEARNER.train(care(), 0)


def moved() -> object:
    mdp = em.MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    return em.study(em.moving(mdp, {"stay": [(0, 0)]}), {"stay": [0.5, 0.75]})


@cache
def recorded() -> em.Audit:
    """An audit of a model from records, whose verdict rests on an interval."""
    names = ["episode", "state", "action", "reward", "next_state"]
    rows = [(n, "ill", ("wait", "treat")[n % 2], n % 2, None) for n in range(40)]
    mdp = em.MDP.from_transitions(pandas.DataFrame(rows, columns=names), discount="1/2")
    return em.check(mdp, "always:treat", confidence=0.95, by=em.Robust(rewards="known"))


# One of each kind of result. A new kind is added here; the first test says so.
MADE: dict[str, Callable[[], Any]] = {
    "Audit": lambda: em.check(care(), "always:directive"),
    "AverageEvaluation": lambda: em.evaluate(care(), "random", criterion="average"),
    "AverageSolution": lambda: em.solve(care(), criterion="average"),
    "BestPolicy": lambda: em.best_policy(care()),
    "BoundedCertificate": lambda: em.certify(care(), bounded=True),
    "CVaROptimum": lambda: em.best_cvar(care(), "1/10"),
    "Certificate": lambda: em.certify(care()),
    "ConstrainedSolution": lambda: em.solve(care(), subject_to={"anger": ">= -50"}),
    "CostEffectiveness": lambda: em.cost_effectiveness(
        SMALL, {"a": "random", "b": "optimal"}, 50, effect="anger", cost="subtask-complete"
    ),
    "Curve": lambda: em.one_way(SMALL, "base.anger", (0, 1), points=3),
    "Explorer": lambda: em.explore(SMALL, "base.anger"),
    "ErrorCosts": lambda: em.error_costs(care(), "optimal", ROUGH),
    "Evaluation": lambda: em.evaluate(care(), "random"),
    "Front": lambda: em.tradeoff(care(), ["anger", "subtask-complete"]),
    "Gradient": lambda: em.gradient(SMALL),
    "LearningCurve": lambda: em.learning_curve(care(), run(), rng=1),
    "Outcomes": lambda: em.outcomes(care(), em.train(care(), LEARNER, 3, rng=0)),
    "PSA": lambda: em.psa(SMALL, 50, rng=0),
    "ReturnDistribution": lambda: em.return_distribution(care(), "random"),
    "Rationalization": lambda: em.rationalize(care(), "always:directive"),
    "RegretCertificate": lambda: em.check(care(), "always:directive").certificate,
    "RegretInterval": lambda: recorded().interval,
    "RobustComparison": lambda: em.robust(care()),
    "RobustSolution": lambda: em.solve_robust(care(), em.Intervals.relative(care(), 0.1)),
    "Study": moved,
    "Trace": lambda: em.cohort_trace(care(), "random", steps=4),
    "Simulation": lambda: em.simulate(care(), "random", 20, 0),
    "Sobol": lambda: em.sobol(SMALL, names=NAMES, n=8, rng=0),
    "Solution": lambda: em.solve(care()),
    "Thresholds": lambda: em.thresholds(SMALL, "base.anger"),
    "TrainerAudit": lambda: em.check_trainer(
        care(), lambda seed: "optimal", runs=9, share="1/2", alpha=0.05, rng=0
    ),
    "Tornado": lambda: em.tornado(SMALL, names=NAMES),
    "TwoWay": lambda: em.two_way(SMALL, *NAMES, points=3),
    "WorstPoint": lambda: em.worst_point(SMALL, "optimal", {"base.anger": ("1/25", "3/50")}),
    "ValueFunction": lambda: em.curve(SMALL, "base.anger"),
}


def kinds() -> set[str]:
    """Return the names of all classes of results that can be made."""
    for module in pkgutil.walk_packages(em.__path__, "exact_mdp."):
        if "kernels" not in module.name and not module.name.endswith(("plugin", "__main__")):
            importlib.import_module(module.name)
    (base,) = (kind for kind in em.Solution.__mro__ if kind.__name__ == "Result")
    waiting, every = [base], list[type]()
    while waiting:
        every += (below := waiting.pop().__subclasses__())
        waiting += below
    own = (kind for kind in every if kind.__module__.startswith("exact_mdp"))
    return {kind.__name__ for kind in own if not inspect.isabstract(kind)}


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    plt.close("all")


def test_every_kind_of_result_is_made_here() -> None:
    assert set(MADE) == kinds()


@pytest.mark.parametrize("name", MADE)
def test_a_result_shows_itself(name: str) -> None:
    result = MADE[name]()
    assert type(result).__name__ == name
    for text in (repr(result), str(result)):
        assert 0 < len(text) <= LETTERS
        assert len(text.splitlines()) < LINES
        assert "<" not in text or " at 0x" not in text
    assert len(repr(result)) < SHORT
    frame = result.frame()
    assert len(frame.columns) > 0
    page = result._repr_html_()
    tables = page.split("<table")[1:]
    assert all(table.count("<tr") <= LINES + 1 for table in tables)
    assert str(getattr(result, "claim", "")) in page
    assert len(ElementTree.fromstring(f"<div>{page}</div>"))  # every element is closed
    if hasattr(result, "plot"):
        ax = result.plot()
        assert isinstance(ax, Axes)
        ax.figure.canvas.draw()
        own = plt.subplots()[1]
        assert result.plot(ax=own) is own


@pytest.mark.parametrize(
    "thing",
    [
        lambda: care(),
        lambda: SMALL,
        lambda: run(),
        lambda: em.Policy.of(care(), "random"),
        lambda: em.Policy.of(care(), "always:directive"),
        lambda: em.check(care(), "random").regret,
        lambda: em.check(care(), np.eye(4)[[0] * 16]).representation,
        lambda: em.uncertainty(em.parametric(SMALL)),
        lambda: em.parametric(SMALL),
    ],
)
def test_the_things_results_are_made_of_show_themselves(thing: Callable[[], object]) -> None:
    text = repr(thing())
    assert len(text) <= LETTERS, text[:500]
    assert len(text.splitlines()) < LINES


def test_a_table_has_names_and_decimals() -> None:
    """An exact number of hundreds of digits is in the result, not in the page."""
    rows = [[F(1, k), 1 - F(1, k)] for k in (10**9 + 7, 10**9 + 9)]
    mdp = em.MDP.from_arrays(
        [rows, [[0, 1], [1, 0]]],
        [[0, "1/3"], [1, 0]],
        F(10**9 - 1, 10**9),
        layout="ass",
        actions=["wait", "cut"],
        states=["young", "old"],
    )
    proof, bounded = em.certify(mdp), em.certify(mdp, bounded=True)
    for result in (proof, bounded, em.certify(mdp, criterion="average")):
        table = result.frame()
        assert table["state"].tolist() == ["state young", "state old"]
        assert set(table["action"]) <= {"wait", "cut"}
    assert proof.frame()["value"].tolist() == [float(value) for value in proof.value]
    assert proof.frame()["exact"].tolist() == list(proof.value)
    assert len(str(proof.value[0])) > 40
    assert max(len(cell) for row in cells(proof._repr_html_()) for cell in row) < 25


# ---- a notebook shows the report -----------------------------------------------------------------


def cells(page: str) -> list[list[str]]:
    """Return the cells of each row, as people see them."""
    rows = re.findall("<tr>(.*?)</tr>", page, re.DOTALL)
    return [[*map(unescape, re.findall("<t[dh][^>]*>(.*?)</t[dh]>", row))] for row in rows]


@pytest.mark.parametrize("name", [name for name in MADE if name != "Explorer"])
def test_a_notebook_shows_all_that_a_report_says(name: str) -> None:
    """Only rows are left out, and then the view says how many."""
    result = MADE[name]()
    report, page = result.report(), result._repr_html_()
    text = "".join(ElementTree.fromstring(f"<div>{page}</div>").itertext())
    lines = [word for line in report.lines().items() for word in line]
    assert all(said in text for said in [report.title, *report.notes, *lines])
    more = []
    for table in report.shown_tables():
        assert table.title in text
        assert table.note in text
        shown = replace(table, first=min(table.first, 20)).cells()
        assert all(row in cells(page) for row in [[*map(str.rstrip, table.columns)], *shown])
        more.append(max(table.count, len(table.rows)) - len(shown))
    assert re.findall(r"([\d,]+) rows more", text) == [f"{rows:,}" for rows in more if rows]


def test_names_are_shown_as_they_are() -> None:
    names = ["<script>alert(1)</script>", "a & b", "&lt;", "'\""]
    ways = np.eye(4)[[1, 2, 3, 3]]
    mdp = em.MDP.from_arrays(
        [ways, ways[::-1]], np.eye(4)[:, :2], 0.5, states=names, actions=names[:2]
    )
    mixed = {names[0]: "1/2", names[1]: "1/2"}
    given = {name: names[1] if name == names[3] else mixed for name in names}
    audit = em.check(mdp, given)
    for result in (mdp, em.Policy.of(mdp, given), em.solve(mdp), em.certify(mdp), audit):
        page = result._repr_html_()
        seen = ElementTree.fromstring(f"<div>{page}</div>")
        assert not seen.findall(".//script")
        assert names[0] in " ".join(seen.itertext())


def test_few_states_of_a_large_model_are_made_for_a_notebook() -> None:
    size = 100_000
    to = np.minimum(np.arange(size) + 1, size - 1)
    walk = sparse.csr_array((np.ones(size), (np.arange(size), to)), shape=(size, size))
    mdp = em.MDP.from_arrays([walk, walk], np.eye(2)[np.arange(size) % 2], discount=0.5)
    for result in (em.solve(mdp), em.solve(mdp, criterion="average")):
        (table,) = result.report().shown_tables()
        assert (len(table.rows), table.count) == (20, size)
        assert len(cells(page := result._repr_html_())) == 21
        assert "99,980 rows more" in page
        assert [*map(str, table.rows["0"])] == result.frame()["state"][:20].tolist()


def test_a_parameter_may_be_called_as_a_column_is() -> None:
    mdp = em.MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    table = em.study(em.moving(mdp, {"value": [(0, 0)]}), {"value": [0.5]})
    head, row = cells(table._repr_html_())
    assert [word.strip() for word in head[:2]] == ["value", "value"]
    assert row[:2] == ["0.5", "2"]


def test_what_each_parameter_is_worth_to_know_is_left_to_those_who_ask() -> None:
    draws = MADE["PSA"]()
    assert [bool(draws.report(evppi=asked).facts["evppi"].value) for asked in (False, True)] == [
        False,
        True,
    ]


# ---- models, policies and scenarios --------------------------------------------------------------


def test_a_model_and_a_policy_are_tables_in_a_notebook() -> None:
    mdp = Scenario.load("tea").with_(tasks=[1], max_trial=2).compile()
    rows = [
        (mdp.space.label(state), mdp.actions[action], mdp.space.label(after), chance, gain)
        for pair, (state, action) in enumerate(zip(mdp.pair_state, mdp.pair_action, strict=True))
        for chance, after, gain in mdp.table.row(pair)
    ]
    assert [tuple(row) for row in mdp.frame().to_numpy()] == rows
    assert len(mdp.frame([mdp.space.label(0)])) == sum(row[0] == rows[0][0] for row in rows)
    for alone in (0, mdp.space.label(0)):
        assert mdp.frame(alone).equals(mdp.frame([0]))
    page = mdp._repr_html_()
    assert page.count("<tr") == 21
    assert f"{len(rows) - 20:,} rows more" in page

    mixed = Policy.of(mdp, "random").frame()
    assert len(mixed) == mdp.n_states
    offered = len(mdp.pairs_of(0))
    shares = sorted(mixed.iloc[0, -mdp.n_actions :])
    assert shares[-offered:] == [F(1, offered)] * offered
    assert sum(shares) == 1
    always = Policy.of(mdp, np.zeros(mdp.n_states, dtype=int))
    assert set(always.frame()["action"]) == {mdp.actions[0]}
    assert "<table" in always._repr_html_()


def test_a_row_that_says_nothing_has_no_shares() -> None:
    mdp = em.MDP.from_arrays([[[0, 1], [0, 1]]] * 2, [[1, 3], [0, 0]])
    rule = np.array([[F(1, 3), F(2, 3)], [np.nan, np.nan]])
    partial = Policy(space=mdp.space, actions=mdp.actions, rule=rule)
    table = partial.frame()
    assert table.loc[0, ["0", "1"]].tolist() == [F(1, 3), F(2, 3)]
    assert table.loc[1, ["0", "1"]].isna().all()
    assert "2/3" in partial._repr_html_()


def test_a_scenario_is_a_table_of_its_parameters() -> None:
    scenario = Scenario.load("yuan2025").with_(parameters={"base.anger": "1/7"})
    frame = scenario.frame()
    assert dict(zip(frame["parameter"], frame["value"], strict=True)) == scenario.values()
    page = scenario._repr_html_()
    assert page.startswith("<p><strong>Scenario(yuan2025: 4 statuses")
    assert ["base.anger", "1/7", "0", "1"] in cells(page)
    assert f"and {len(frame) - 20} rows more" in page
