"""Every result shows itself: a table, an HTML table, a few lines, a picture if there is one."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from fractions import Fraction as F
from functools import cache
from html.parser import HTMLParser

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pandas
import pytest
from matplotlib.axes import Axes

from exact_mdp import (
    MDP,
    Audit,
    Counted,
    Intervals,
    Policy,
    Posterior,
    QLearning,
    Robust,
    Scenario,
    TrainingRun,
    accuracy_curves,
    analysis,
    best_cvar,
    best_policy,
    certify,
    check,
    check_trainer,
    compare,
    cost_effectiveness,
    curve,
    error_costs,
    evaluate,
    explore,
    gradient,
    independent,
    learning_curve,
    mean_cvar,
    moving,
    one_way,
    outcomes,
    paper_repro,
    parametric,
    psa,
    rationalize,
    return_distribution,
    robust,
    robust_curve,
    simulate,
    sobol,
    solve,
    solve_robust,
    solvers,
    study,
    thresholds,
    tornado,
    tradeoff,
    train,
    two_way,
    uncertainty,
    worst_point,
)
from exact_mdp.analysis.perception.values import value_under_counts
from exact_mdp.mdp.result import Pictured, Result

mpl.use("Agg")
LINES, LETTERS = 20, 2000
SMALL = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
NAMES = ["base.anger", "reward.anger"]
ROUGH = independent([0.9] * 4, [0.85] * 4)
LEARNER = QLearning(epochs=20)


@cache
def care() -> MDP:
    return SMALL.compile()


@cache
def run() -> TrainingRun:
    return LEARNER.train(care(), 0)


def moved() -> object:
    mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    return study(moving(mdp, {"stay": [(0, 0)]}), {"stay": [0.5, 0.75]})


@cache
def recorded() -> Audit:
    """An audit of a model from records, whose verdict rests on an interval."""
    names = ["episode", "state", "action", "reward", "next_state"]
    rows = [(n, "ill", ("wait", "treat")[n % 2], n % 2, None) for n in range(40)]
    mdp = MDP.from_transitions(pandas.DataFrame(rows, columns=names), discount="1/2")
    return check(mdp, "always:treat", confidence=0.95, by=Robust(rewards="known"))


# One of each kind of result. A new kind is added here; the first test says so.
MADE: dict[str, Callable[[], object]] = {
    "AccuracyCurves": lambda: accuracy_curves(care(), levels=[0.9, 1]),
    "Audit": lambda: check(care(), "always:directive"),
    "AverageEvaluation": lambda: evaluate(care(), "random", criterion="average"),
    "AverageSolution": lambda: solve(care(), criterion="average"),
    "BestPolicy": lambda: best_policy(care()),
    "BoundedCertificate": lambda: certify(care(), bounded=True),
    "CVaROptimum": lambda: best_cvar(care(), "1/10"),
    "Certificate": lambda: certify(care()),
    "ConstrainedSolution": lambda: solve(care(), subject_to={"anger": ">= -50"}),
    "CostEffectiveness": lambda: cost_effectiveness(
        SMALL, {"a": "random", "b": "optimal"}, 50, effect="anger", cost="subtask-complete"
    ),
    "Curve": lambda: one_way(SMALL, "base.anger", (0, 1), points=3),
    "Explorer": lambda: explore(SMALL, "base.anger"),
    "ErrorCosts": lambda: error_costs(care(), "optimal", ROUGH),
    "Evaluation": lambda: evaluate(care(), "random"),
    "Front": lambda: tradeoff(care(), ["anger", "subtask-complete"]),
    "Gradient": lambda: gradient(SMALL),
    "LearningCurve": lambda: learning_curve(care(), run(), rng=1),
    "MeanCVaR": lambda: mean_cvar(care(), "1/10", policies={"random": "random"}),
    "Outcomes": lambda: outcomes(care(), train(care(), LEARNER, 3, rng=0)),
    "PSA": lambda: psa(SMALL, 50, rng=0),
    "PosteriorInterval": lambda: (
        check(recorded().mdp, "always:wait", confidence=0.95, by=Posterior(n=80, rng=0)).interval
    ),
    "PolicyComparison": lambda: compare(care(), {"a": "random", "b": "optimal"}),
    "ReturnDistribution": lambda: return_distribution(care(), "random"),
    "Rationalization": lambda: rationalize(care(), "always:directive"),
    "RegretInterval": lambda: recorded().interval,
    "Robust": lambda: robust(care()),
    "RobustCurve": lambda: robust_curve(care(), "l1", [0, 0.1]),
    "RobustSolution": lambda: solve_robust(care(), Intervals.relative(care(), 0.1)),
    "Study": moved,
    "Simulation": lambda: simulate(care(), "random", 20, 0),
    "Sobol": lambda: sobol(SMALL, names=NAMES, n=8, rng=0),
    "Solution": lambda: solve(care()),
    "Thresholds": lambda: thresholds(SMALL, "base.anger"),
    "TrainerAudit": lambda: check_trainer(
        care(), lambda seed: "optimal", runs=9, share="1/2", alpha=0.05, rng=0
    ),
    "Tornado": lambda: tornado(SMALL, names=NAMES),
    "TwoWay": lambda: two_way(SMALL, *NAMES, points=3),
    "WorstPoint": lambda: worst_point(SMALL, "optimal", {"base.anger": ("1/25", "3/50")}),
    "ValueFunction": lambda: curve(SMALL, "base.anger"),
    "UncertainValue": lambda: value_under_counts(
        care(), "optimal", Counted(counts=50 * np.eye(16, dtype=int), prior=1 / 16), rng=0, n=20
    ),
}


@cache
def made(name: str) -> object:
    return MADE[name]()


def kinds() -> dict[str, type[Result]]:
    """Return every class of results that can be made, by name."""
    for package in (analysis, solvers, paper_repro):
        for module in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            if "kernels" not in module.name and not module.name.endswith(("plugin", "__main__")):
                importlib.import_module(module.name)
    waiting, found = [Result], dict[str, type[Result]]()
    while waiting:
        below = waiting.pop().__subclasses__()
        waiting += below
        found |= {kind.__name__: kind for kind in below if kind.__module__.startswith("exact_mdp")}
    return {name: kind for name, kind in found.items() if not inspect.isabstract(kind)}


class Parsed(HTMLParser):
    """How often each element is opened and closed."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open = dict[str, int]()
        self.feed(page)

    def handle_starttag(self, tag: str, _: object) -> None:
        self.open[tag] = self.open.get(tag, 0) + 1

    def handle_endtag(self, tag: str) -> None:
        self.open[tag] -= 1


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    plt.close("all")


def test_every_kind_of_result_is_made_here() -> None:
    assert set(MADE) == set(kinds())


@pytest.mark.parametrize("name", MADE)
def test_a_result_shows_itself(name: str) -> None:
    found = made(name)
    assert type(found).__name__ == name
    assert isinstance(found, Result)
    for text in (repr(found), str(found)):
        assert 0 < len(text) <= LETTERS
        assert len(text.splitlines()) < LINES
        assert "<" not in text or " at 0x" not in text
    frame = found.frame()
    assert len(frame.columns) > 0
    page = found._repr_html_()
    assert page.count("<tr") <= LINES + 2
    assert str(getattr(found, "claim", "")) in page
    assert set(Parsed(page).open.values()) == {0}
    if isinstance(found, Pictured):
        ax = found.plot()
        assert isinstance(ax, Axes)
        ax.figure.canvas.draw()
        own = plt.subplots()[1]
        assert found.plot(ax=own) is own


@pytest.mark.parametrize(
    "thing",
    [
        lambda: care(),
        lambda: SMALL,
        lambda: run(),
        lambda: Policy.of(care(), "random"),
        lambda: Policy.of(care(), "always:directive"),
        lambda: check(care(), "random").regret,
        lambda: check(care(), np.eye(4)[[0] * 16]).representation,
        lambda: uncertainty(parametric(SMALL)),
        lambda: parametric(SMALL),
    ],
)
def test_so_do_the_things_results_are_made_of(thing: Callable[[], object]) -> None:
    text = repr(thing())
    assert len(text) <= LETTERS, text[:500]
    assert len(text.splitlines()) < LINES


def test_a_table_has_names_and_decimals() -> None:
    """An exact number of hundreds of digits is in the result, not in the page."""
    rows = [[F(1, k), 1 - F(1, k)] for k in (10**9 + 7, 10**9 + 9)]
    mdp = MDP.from_arrays(
        [rows, [[0, 1], [1, 0]]],
        [[0, "1/3"], [1, 0]],
        F(10**9 - 1, 10**9),
        layout="ass",
        actions=["wait", "cut"],
        states=["young", "old"],
    )
    proof, bounded = certify(mdp), certify(mdp, bounded=True)
    for found in (proof, bounded, certify(mdp, criterion="average")):
        table = found.frame()
        assert table["state"].tolist() == ["state young", "state old"]
        assert set(table["action"]) <= {"wait", "cut"}
    assert proof.frame()["value"].tolist() == [float(value) for value in proof.value]
    assert proof.frame()["exact"].tolist() == list(proof.value)
    assert len(str(proof.value[0])) > 40
    for found in (proof, compare(mdp, {"mine": [0, 0], "best": "optimal"})):
        page = found._repr_html_()
        assert max(len(cell) for cell in re.findall("<td>(.*?)</td>", page)) < 25
        assert "≈" in page
