"""Sensitivity analyses of a policy held fixed that acts on what it perceives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from cli_runner import run

from exact_mdp import MDP, Scenario, evaluate, independent, perceived, solve

SMALL = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
SET = ("--set", "tasks=[1]", "--set", "max_trial=2")
ANGER = ("--parameter", "base.anger")
ROUGH = independent([0.9, 0.8, 0.7, 0.95], [0.85, 0.9, 0.75, 0.6])
PLAN = {
    f"{s:04b}": ("none", "supportive", "non-directive", "directive")[(3 * s + 2) % 4]
    for s in range(16)
}


@pytest.fixture(scope="module")
def mdp() -> MDP:
    return SMALL.compile()


@pytest.fixture
def seen(tmp_path: Path) -> Path:
    labels = [f"{s:04b}" for s in range(16)]
    lines = ["status," + ",".join(labels)]
    rows = zip(labels, ROUGH.tolist(), strict=True)
    lines += [f"{label}," + ",".join(map(repr, row)) for label, row in rows]
    (tmp_path / "seen.csv").write_text("\n".join(lines) + "\n")
    return tmp_path / "seen.csv"


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    import json

    (tmp_path / "plan.json").write_text(json.dumps(PLAN))
    return tmp_path / "plan.json"


def ask(kind: str, seen: Path, *words: object) -> dict[str, Any]:
    done = run(kind, "yuan2025", *SET, "--perception", seen, "--json", *words)
    assert done.status == 0, done.err
    assert done.result["perception"] == str(seen)
    return done.result


def at(**values: object) -> MDP:
    return SMALL.with_(parameters=values).compile()


def test_a_tornado_is_that_of_the_policy_held_fixed(mdp: MDP, seen: Path) -> None:
    words = (*ANGER, "--parameter", "base.confusion", "--parameter", "influence.anger.confusion")
    answer = ask("tornado", seen, *words)
    policy = perceived(mdp, solve(mdp).policy, ROUGH)
    assert answer["policy_value"] == pytest.approx(evaluate(mdp, policy).mean, rel=1e-12)
    for bar in answer["bars"]:
        for end in ("low", "high"):
            there = at(**{bar["parameter"]: repr(bar[end])})
            value = evaluate(there, policy).mean
            assert bar[f"fixed_value_{end}"] == pytest.approx(value, rel=1e-9)
            assert bar[f"value_{end}"] == pytest.approx(solve(there).start_value, rel=1e-9)
    swings = [bar["fixed_swing"] for bar in answer["bars"]]
    assert swings == sorted(swings, reverse=True)
    text = run("tornado", "yuan2025", *SET, "--perception", seen, *words)
    flat = " ".join(text.out.split())
    assert "start value at both ends, policy held fixed" in flat
    assert "which the policy acts on" in flat
    assert f"{answer['bars'][0]['fixed_value_low']:.6g}" in flat


def test_a_gradient_is_that_of_the_mixed_policy_and_says_what_is_certified(
    mdp: MDP, seen: Path
) -> None:
    answer = ask("gradient", seen, *ANGER)
    policy = perceived(mdp, solve(mdp).policy, ROUGH)
    assert answer["start_value"] == pytest.approx(evaluate(mdp, policy).mean, rel=1e-12)
    ends = ("49999/1000000", "50001/1000000")
    below, above = (evaluate(at(**{"base.anger": x}), policy).mean for x in ends)
    assert answer["derivatives"]["base.anger"] == pytest.approx((above - below) / 2e-6, rel=1e-6)
    assert answer["claim"] == "certified"
    assert "as rounded to floats" in answer["claim_of"]
    text = run("gradient", "yuan2025", *SET, "--perception", seen, *ANGER).out
    assert "as rounded to floats" in " ".join(text.split())
    plain = run("gradient", "yuan2025", *SET, *ANGER, "--json").result
    assert plain["perception"] is None
    assert "claim_of" not in plain


@pytest.mark.parametrize("form", ["optimal", "plan"])
def test_psa_and_sobol_hold_it(form: str, mdp: MDP, seen: Path, plan: Path) -> None:
    from exact_mdp import sobol

    stated, source = (plan, PLAN) if form == "plan" else (form, solve(mdp).policy)
    words = ("--policy", stated, "--n-jobs", 1, *ANGER, "--parameter", "base.confusion")
    policy, names = perceived(mdp, source, ROUGH), ["base.anger", "base.confusion"]
    wide = sobol(SMALL, names=names, n=8, rng=0, policy=policy)
    assert ask("sobol", seen, *words, "--samples", 8)["regret"]["mean"] == wide.regret.mean > 0
    drawn = ask("psa", seen, *words, "--samples", 30)
    lost = solve(mdp).start_value - evaluate(mdp, policy).mean
    spread = drawn["regret"]
    assert abs(spread["mean"] - lost) < 6 * spread["standard_error"] + 0.05 * lost
    assert drawn["candidates"][0]["actions"] is None  # it mixes


def test_the_worst_case_of_it(mdp: MDP, seen: Path) -> None:
    policy = perceived(mdp, solve(mdp).policy, ROUGH)
    value = evaluate(mdp, policy).mean
    for kind in ("interval", "absolute", "l1", "kl", "entropy"):
        answer = ask("robust", seen, "--set-kind", kind, "--radius", "0")
        assert answer["start_value"] == pytest.approx(value, rel=1e-12)
        assert answer["worst_case"]["nominal_policy"]["value"] == pytest.approx(value, rel=1e-6)
        wide = ask("robust", seen, "--set-kind", kind, "--radius", "0.05")
        assert wide["worst_case"]["nominal_policy"]["value"] < value - 1e-3


def test_the_worst_case_in_a_box(mdp: MDP, seen: Path) -> None:
    words = ("--set-kind", "box", "--range", "base.anger=1/25:3/50")
    answer = ask("robust", seen, *words)
    policy = perceived(mdp, solve(mdp).policy, ROUGH)
    worst = evaluate(at(**{"base.anger": "3/50"}), policy).mean
    assert answer["worst_case"]["point"] == {"base.anger": 0.06}
    assert answer["worst_case"]["value"] == pytest.approx(worst, rel=1e-9)
    assert answer["start_value"] == pytest.approx(evaluate(mdp, policy).mean, rel=1e-12)
