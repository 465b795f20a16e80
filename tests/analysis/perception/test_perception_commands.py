"""Analyses of a policy held fixed that acts on what it perceives, by command."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from cli_runner import run

from exact_mdp import MDP, Scenario, evaluate, independent, perceived, sobol, solve

SMALL = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
LABELS = [f"{status:04b}" for status in range(16)]
ROUGH = independent([0.9, 0.8, 0.7, 0.95], [0.85, 0.9, 0.75, 0.6])
CARE = SMALL.compile()
POLICY = perceived(CARE, solve(CARE).policy, ROUGH)
VALUE = evaluate(CARE, POLICY).mean
PLAN = {
    label: ("none", "supportive", "non-directive", "directive")[(3 * status + 2) % 4]
    for status, label in enumerate(LABELS)
}
ANGER, CONFUSION = ("--parameter", "base.anger"), ("--parameter", "base.confusion")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    pd.DataFrame(ROUGH, LABELS, LABELS).to_csv("seen.csv", index_label="status")
    Path("plan.json").write_text(json.dumps(PLAN))


def ask(line: str, *words: object) -> tuple[dict[str, Any], str]:
    """Return the JSON of a command and its text, on one line."""
    kind, _, more = line.partition(" ")
    words = (*more.split(), "--set", "tasks=[1]", "--set", "max_trial=2", *words)
    seen = (f"{kind} yuan2025 --perception seen.csv", *words)
    answer = run(*seen, "--json").result
    assert answer["perception"] == "seen.csv"
    return answer, " ".join(run(*seen).out.split())


def at(**values: object) -> MDP:
    return SMALL.with_(parameters=values).compile()


def test_a_tornado_is_that_of_the_policy_held_fixed() -> None:
    answer, text = ask("tornado", *ANGER, *CONFUSION, "--parameter", "influence.anger.confusion")
    assert answer["policy_value"] == pytest.approx(VALUE, rel=1e-12)
    for bar in answer["bars"]:
        for end in ("low", "high"):
            there = at(**{bar["parameter"]: repr(bar[end])})
            value = evaluate(there, POLICY).mean
            assert bar[f"fixed_value_{end}"] == pytest.approx(value, rel=1e-9)
            assert bar[f"value_{end}"] == pytest.approx(solve(there).start_value, rel=1e-9)
    swings = [bar["fixed_swing"] for bar in answer["bars"]]
    assert swings == sorted(swings, reverse=True)
    assert "start value at both ends, policy held fixed" in text
    assert "which the policy acts on" in text
    assert f"{answer['bars'][0]['fixed_value_low']:.6g}" in text


def test_a_gradient_is_that_of_the_mixed_policy_and_says_what_is_certified() -> None:
    answer, text = ask("gradient", *ANGER)
    assert answer["start_value"] == pytest.approx(VALUE, rel=1e-12)
    ends = ("49999/1000000", "50001/1000000")
    below, above = (evaluate(at(**{"base.anger": x}), POLICY).mean for x in ends)
    assert answer["derivatives"]["base.anger"] == pytest.approx((above - below) / 2e-6, rel=1e-6)
    assert answer["claim"] == "certified"
    assert "as rounded to floats" in answer["claim_of"]
    assert "as rounded to floats" in text
    plain = run("gradient yuan2025 --parameter base.anger --json").result
    assert plain["perception"] is None
    assert "claim_of" not in plain


@pytest.mark.parametrize("form", ["optimal", "plan.json"])
def test_psa_and_sobol_hold_it(form: str) -> None:
    words = ("--policy", form, "--n-jobs", 1, *ANGER, *CONFUSION)
    policy = perceived(CARE, PLAN, ROUGH) if form == "plan.json" else POLICY
    wide = sobol(SMALL, names=["base.anger", "base.confusion"], n=8, rng=0, policy=policy)
    assert ask("sobol --samples 8", *words)[0]["regret"]["mean"] == wide.regret.mean > 0
    drawn, _ = ask("psa --samples 30", *words)
    lost = solve(CARE).start_value - evaluate(CARE, policy).mean
    spread = drawn["regret"]
    assert abs(spread["mean"] - lost) < 6 * spread["standard_error"] + 0.05 * lost
    assert drawn["candidates"][0]["actions"] is None  # it mixes


@pytest.mark.parametrize("kind", ["interval", "absolute", "l1", "kl", "entropy"])
def test_the_worst_case_of_it(kind: str) -> None:
    answer, _ = ask(f"robust --radius 0 --set-kind {kind}")
    assert answer["start_value"] == pytest.approx(VALUE, rel=1e-12)
    assert answer["worst_case"]["nominal_policy"]["value"] == pytest.approx(VALUE, rel=1e-6)
    wide, _ = ask(f"robust --radius 0.05 --set-kind {kind}")
    assert wide["worst_case"]["nominal_policy"]["value"] < VALUE - 1e-3


def test_the_worst_case_in_a_box() -> None:
    answer, _ = ask("robust --set-kind box --range base.anger=1/25:3/50")
    worst = evaluate(at(**{"base.anger": "3/50"}), POLICY).mean
    assert answer["worst_case"]["point"] == {"base.anger": 0.06}
    assert answer["worst_case"]["value"] == pytest.approx(worst, rel=1e-9)
    assert answer["start_value"] == pytest.approx(VALUE, rel=1e-12)
