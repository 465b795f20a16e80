"""What errors of perception cost: against differences, the reference model, and on paper."""

from __future__ import annotations

import json
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from care_oracle import ACTIONS, Oracle
from cli_runner import run

from exact_mdp import (
    MDP,
    Column,
    ModelError,
    Scenario,
    StateSpace,
    accuracy_curves,
    certify,
    error_costs,
    evaluate,
    independent,
    perceived,
)

F = Fraction
LABELS = [f"{status:04b}" for status in range(16)]
HITS, CLEARS = [0.9, 0.8, 0.7, 0.95], [0.85, 0.9, 0.75, 0.6]
ROUGH = independent(HITS, CLEARS)


def plan(status: str) -> str:
    return ACTIONS[(3 * int(status, 2) + 2) % 4]


POLICY = {label: plan(label) for label in LABELS}


@pytest.fixture(scope="module")
def care() -> MDP:
    return Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()


def worth(mdp: MDP, matrix: np.ndarray, policy: object = POLICY) -> float:
    return evaluate(mdp, perceived(mdp, policy, matrix)).mean


def test_what_one_more_misreading_costs(care: MDP) -> None:
    costs = error_costs(care, POLICY, ROUGH)
    rng = np.random.default_rng(0)
    for true, seen in rng.integers(0, 16, (12, 2)).tolist():
        step, moved = 1e-5, []
        for sign in (1, -1):
            matrix = ROUGH.copy()
            matrix[true, true] -= sign * step
            matrix[true, seen] += sign * step
            moved.append(worth(care, matrix))
        slope = (moved[1] - moved[0]) / (2 * step)
        assert costs.marginal[true, seen] == pytest.approx(slope, rel=1e-5, abs=1e-6)


def test_what_a_rate_is_worth(care: MDP) -> None:
    costs = error_costs(care, POLICY, ROUGH)
    for bit, name in enumerate(costs.statuses):
        for which, (hits, clears) in enumerate(((HITS, CLEARS), (CLEARS, HITS))):
            ends = []
            for sign in (1, -1):
                changed = list(hits)
                changed[bit] += sign * 1e-5
                rates = (changed, clears) if which == 0 else (clears, changed)
                ends.append(worth(care, independent(*rates)))
            slope = (ends[0] - ends[1]) / 2e-5
            assert costs.rates[name][which] == pytest.approx(slope, rel=1e-5, abs=1e-6)


def test_losses_add_up(care: MDP) -> None:
    for policy in (POLICY, "random", "always:directive"):
        costs = error_costs(care, policy, ROUGH)
        whole = evaluate(care, policy).mean - worth(care, ROUGH, policy)
        assert costs.loss.sum() == pytest.approx(whole, abs=2 * costs.error)
        parts = [part for both in costs.by_status.values() for part in both]
        assert sum(parts) == pytest.approx(whole, abs=2 * costs.error)
        assert np.diag(costs.loss).tolist() == [0.0] * 16
    assert costs.loss == pytest.approx(np.zeros((16, 16)), abs=costs.error)


def test_curves_are_the_reference_models_values() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=3).compile()
    levels = (F(1, 2), F(2, 3), F(1))
    how = {"levels": map(float, levels), "statuses": ["anger"]}
    curves = accuracy_curves(mdp, dict.fromkeys(LABELS, "directive"), **how)
    assert np.ptp(curves.values["anger"]) <= 2 * curves.error  # who does not look does not mind
    for status in ("all", "confusion"):
        how = {"levels": map(float, levels), "statuses": [status]}
        curves = accuracy_curves(mdp, POLICY, **how)
        for x, value in zip(levels, curves.values[status], strict=True):

            def decide(state: object, x: Fraction = x, status: str = status) -> dict:
                assert isinstance(state, tuple)
                true = "".join(map(str, state[3]))
                mixed: dict[str, Fraction] = {}
                for seen in LABELS:
                    chance = F(1)
                    for bit, (a, b) in enumerate(zip(true, seen, strict=True)):
                        sure = status == "confusion" and bit != 1
                        right = F(1) if sure else x
                        chance *= right if a == b else 1 - right
                    if chance:
                        mixed[plan(seen)] = mixed.get(plan(seen), F(0)) + chance
                return mixed

            wanted = Oracle(tasks=[1], max_trial=3).evaluate(decide, distribution=False)["mean"]
            assert value == pytest.approx(float(wanted), abs=curves.error + 1e-12 * abs(wanted))


def test_models_whose_errors_have_no_price() -> None:
    """States that come back, and actions that reveal the status."""
    space = StateSpace(columns=(Column(name="status", size=2, bits=1),), extra=("end",))
    end = (2, 0, [(1, 2, 0)])
    turning = [(s, 0, [("1/2", 1 - s, 1), ("1/2", 2, 0)]) for s in (0, 1)]
    revealing = [(0, 0, [(1, 2, 1)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 2, 1)])]
    for rows, said in ((turning, "come back"), (revealing, "reveal the status")):
        mdp = MDP.from_outcomes([*rows, end]).with_(space=space)
        for ask in (error_costs, lambda *given: accuracy_curves(given[0])):
            with pytest.raises(ModelError, match=said):
                ask(mdp, "optimal", np.eye(2))
    with pytest.raises(ModelError, match="no statuses"):
        error_costs(MDP.from_arrays([[[1]]], [0]), "optimal", np.eye(1))


def test_the_command_says_what_the_functions_say(tmp_path: Path) -> None:
    model = ("yuan2025", "--set", "tasks=[1]", "--set", "max_trial=2")
    words = (*model, "--accuracy", "0.9")
    content = json.loads(run("perception", *words, "--json").out)
    mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
    matrix = independent([0.9] * 4, [0.9] * 4)
    costs = error_costs(mdp, "optimal", matrix)
    assert content["taken_as_true"]["value"] == pytest.approx(costs.value.value, rel=1e-12)
    assert content["perfect"]["value"] == pytest.approx(float(certify(mdp).start_value), rel=1e-12)
    assert content["errors"]["anger"]["by_sensitivity"] == pytest.approx(costs.rates["anger"][0])
    assert content["claim"] == "bounded"
    pairs = "".join(f"{s},{s}\n" for s in LABELS)
    (tmp_path / "seen.csv").write_text(f"true,perceived\n{pairs}")
    words = (*model, "--perception", tmp_path / "seen.csv", "--prior")
    content = json.loads(run("perception", *words, "0.1", "--draws", "50", "--json").out)
    low, high = content["counted"]["interval"]
    text = run("perception", *words, "0.1", "--draws", "50").out
    assert "taken as true" in text
    assert re.search(r"^counted +95% in \S+ to \S+ \(estimated\)$", text, re.MULTILINE)
    assert low < content["counted"]["mean"] < high < content["perfect"]["value"]
