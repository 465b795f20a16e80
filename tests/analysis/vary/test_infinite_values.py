"""Totals of ±∞ at discount 1: analyses that compare refuse them by name, and give no number."""

from collections.abc import Callable
from json import loads
from math import inf
from pathlib import Path

import numpy as np
import pytest
from cli_runner import run

from exact_mdp import (
    MDP,
    Family,
    ModelError,
    Parametric,
    moving,
    one_way,
    psa,
    sobol,
    study,
    tornado,
    two_way,
    worst_point,
)

GAINS = MDP.from_outcomes(  # +∞ whatever is done, though "always:1" throws 5 away
    [
        (0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]),
        (1, 0, [(1, 1, 1)]),
        (2, 0, [(1, 3, 5)]),
        (2, 1, [(1, 3, 0)]),
        (3, 0, [(1, 3, 0)]),
    ]
)
LOSES = MDP.from_outcomes(  # action 0 loses for ever with probability 1/2; the optimum is 3
    [
        (0, 0, [("1/2", 1, -2), ("1/2", 2, 3)]),
        (0, 1, [("1/2", 0, -1), ("1/2", 2, 4)]),
        (1, 0, [(1, 1, -1)]),
        (2, 0, [(1, 2, 0)]),
    ],
    labels={"g": [False, False, True]},
)
BOTH = MDP.from_outcomes(  # half the runs gain for ever, half lose twice as much
    [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (1, 0, [(1, 1, 1)]), (2, 0, [(1, 2, -2)])]
)
DRAWN = {"rng": 0, "n_jobs": 1, "progress": False}
BOX = {"p": ("1/4", "1/2"), "discount": ("1/2", 1)}
ANALYSES: dict[str, Callable[..., object]] = {
    "tornado": tornado,
    "one-way": lambda model, **how: one_way(model, "discount", ("1/2", 1), points=3, **how),
    "two-way": lambda model, **how: two_way(model, "p", "discount", ranges=BOX, points=2, **how),
    "psa": lambda model, **how: psa(model, 4, **DRAWN, **how),
    "sobol": lambda model, **how: sobol(model, n=4, **DRAWN, **how),
}


def chances(mdp: MDP) -> Parametric:
    """Return the model with a chance of its first state that moves."""
    return moving(mdp, {"p": [(0, 1)]})


@pytest.mark.parametrize("name", ANALYSES)
@pytest.mark.parametrize(
    ("mdp", "policy", "what"),
    [
        (GAINS, "optimal", "the optimum is infinite"),
        (GAINS, "always:1", "is infinite"),
        (LOSES, "always:0", "the policy held fixed is infinite"),
        (BOTH, "optimal", "is infinite"),
    ],
)
def test_infinite_values_are_refused(name: str, mdp: MDP, policy: str, what: str) -> None:
    """∞ - ∞ is no regret of 0: what is infinite is named, and no bare warning comes before it."""
    with pytest.raises(ModelError, match=rf"{what}[\s\S]*nothing can be compared[\s\S]*where"):
        ANALYSES[name](chances(mdp), policy=policy)


@pytest.mark.parametrize(
    ("mdp", "policy", "value"),
    [(GAINS, "optimal", inf), (GAINS, "always:1", inf), (LOSES, "always:0", -inf)],
)
def test_a_worst_point_only_compares_values(mdp: MDP, policy: str, value: float) -> None:
    found = worst_point(chances(mdp), ranges={"p": BOX["p"]}, policy=policy)
    assert found.value.value == value


@pytest.mark.parametrize("kind", ["tornado", "psa --samples 4", "sobol --samples 4"])
@pytest.mark.parametrize(
    ("mdp", "more"),
    [(GAINS, "--policy always:1"), (LOSES, "--until g --policy always:0"), (BOTH, "")],
)
def test_commands_refuse_infinite_values(kind: str, mdp: MDP, more: str, tmp_path: Path) -> None:
    """Exit status 2, with what, where and fix; no word of the range of floats."""
    mdp.save(tmp_path / "model.npz")
    refused = run(kind, tmp_path / "model.npz", *more.split()).refusal()
    assert "is infinite, so nothing can be compared" in refused
    assert "where: the total at discount 1" in refused
    assert "floats" not in refused


def test_a_state_of_infinite_value_disturbs_nothing() -> None:
    """The optimum is 3, one action of the start is worth -∞, and every draw prefers the other."""
    table = psa(chances(LOSES), 4, **DRAWN).table
    assert table.counts[0].tolist() == [0, 4]
    assert np.isfinite(table.optimal).all()
    assert table.lost.min(axis=1).tolist() == [0] * 4
    assert (table.lost.max(axis=1) == np.inf).all()
    # An action may lead to both infinities; here it is worth -∞, as more is lost than gained.
    rows = [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (0, 1, [(1, 3, 2)]), (1, 0, [(1, 1, 1)])]
    both = MDP.from_outcomes([*rows, (2, 0, [(1, 2, -2)]), (3, 0, [(1, 3, 0)])])
    table = study(Family(parameters={"x": 1}, build=lambda _: both), {"x": [1]})
    assert (table.optimal.tolist(), table.lost.tolist()) == ([2], [[np.inf, 0]])


def test_commands_about_one_policy_agree(tmp_path: Path) -> None:
    """Where half the runs gain for ever and half lose: samples have no mean, and nobody an sd."""
    BOTH.save(tmp_path / "both.npz")
    for line, mean in (("evaluate", "-inf"), ("returns", "-inf"), ("simulate --episodes 50", None)):
        out = run(line, tmp_path / "both.npz", "optimal").out
        assert f"{'nan' if mean is None else mean} (" in out
        assert "undefined: the mean is infinite" in out
        assert "to -\n" not in out
        stated = loads(run(line, tmp_path / "both.npz", "optimal", "--json").out)
        assert (stated["mean"], stated["sd"]) == (mean, None)
