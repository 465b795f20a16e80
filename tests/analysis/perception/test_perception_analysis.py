"""What errors of perception cost: against differences, the reference model, and on paper."""

from __future__ import annotations

import re
from fractions import Fraction
from math import prod
from pathlib import Path

import numpy as np
import pytest
from care_oracle import ACTIONS, Oracle
from cli_runner import run

from exact_mdp import (
    MDP,
    Scenario,
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
        for which in (0, 1):
            ends = []
            for step in (1e-5, -1e-5):
                rates = np.array([HITS, CLEARS])
                rates[which, bit] += step
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


@pytest.mark.parametrize("status", ["all", "confusion"])
def test_curves_are_the_reference_models_values(status: str) -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=3).compile()
    levels = (F(1, 2), F(2, 3), F(1))
    curves = accuracy_curves(mdp, POLICY, levels=map(float, levels), statuses=[status])
    for level, value in zip(levels, curves.values[status], strict=True):
        right = [level if status == "all" or bit == 1 else F(1) for bit in range(4)]

        def decide(state: tuple, right: list[Fraction] = right) -> dict[str, Fraction]:
            mixed = dict.fromkeys(ACTIONS, F(0))
            for seen in LABELS:
                bits = zip(state[3], map(int, seen), right, strict=True)
                mixed[plan(seen)] += prod(x if true == shown else 1 - x for true, shown, x in bits)
            return {action: chance for action, chance in mixed.items() if chance}

        wanted = Oracle(tasks=[1], max_trial=3).evaluate(decide, distribution=False)["mean"]
        assert value == pytest.approx(float(wanted), abs=curves.error + 1e-12 * abs(wanted))


def test_who_does_not_look_does_not_mind(care: MDP) -> None:
    curves = accuracy_curves(care, dict.fromkeys(LABELS, "directive"), statuses=["anger"])
    assert np.ptp(curves.values["anger"]) <= 2 * curves.error


def test_the_command_says_what_the_functions_say(tmp_path: Path) -> None:
    line = "perception yuan2025 --set tasks=[1] --set max_trial=2"
    content = run(line, "--accuracy", "0.9", "--json").result
    mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
    costs = error_costs(mdp, "optimal", independent([0.9] * 4, [0.9] * 4))
    assert content["taken_as_true"]["value"] == pytest.approx(costs.value.value, rel=1e-12)
    assert content["perfect"]["value"] == pytest.approx(float(certify(mdp).start_value), rel=1e-12)
    assert content["errors"]["anger"]["by_sensitivity"] == pytest.approx(costs.rates["anger"][0])
    assert content["claim"] == "bounded"
    pairs = "".join(f"{s},{s}\n" for s in LABELS)
    (tmp_path / "seen.csv").write_text(f"true,perceived\n{pairs}")
    words = ("--perception", tmp_path / "seen.csv", "--prior", "0.1", "--draws", "50")
    content, text = run(line, *words, "--json").result, run(line, *words).out
    low, high = content["counted"]["interval"]
    assert low < content["counted"]["mean"] < high < content["perfect"]["value"]
    assert "taken as true" in text
    assert re.search(r"^counted +95% in \S+ to \S+ \(estimated\)$", text, re.MULTILINE)
