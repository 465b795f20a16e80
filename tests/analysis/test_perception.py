"""What errors of perception cost, and analyses of a policy that acts on what it perceives.

Against differences, and values of the policy that mixes as perception does.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from care_oracle import ACTIONS
from cli_runner import run

from exact_mdp import (
    MDP,
    Column,
    Scenario,
    StateSpace,
    error_costs,
    evaluate,
    independent,
    perceived,
    sobol,
    solve,
)

LABELS = [f"{status:04b}" for status in range(16)]
HITS, CLEARS = [0.9, 0.8, 0.7, 0.95], [0.85, 0.9, 0.75, 0.6]
ROUGH = independent(HITS, CLEARS)
PLAN = {label: ACTIONS[(3 * status + 2) % 4] for status, label in enumerate(LABELS)}
SMALL = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
CARE = SMALL.compile()
HELD = perceived(CARE, solve(CARE).policy, ROUGH)
VALUE = evaluate(CARE, HELD).mean


@pytest.fixture(scope="module")
def care() -> MDP:
    return SMALL.with_(tasks=[2]).compile()


def mean_return(mdp: MDP, matrix: np.ndarray, policy: object = PLAN) -> float:
    return evaluate(mdp, perceived(mdp, policy, matrix)).mean


def test_what_one_more_misreading_costs(care: MDP) -> None:
    costs = error_costs(care, PLAN, ROUGH)
    rng = np.random.default_rng(0)
    for true, seen in rng.integers(0, 16, (12, 2)).tolist():
        step, moved = 1e-5, []
        for sign in (1, -1):
            matrix = ROUGH.copy()
            matrix[true, true] -= sign * step
            matrix[true, seen] += sign * step
            moved.append(mean_return(care, matrix))
        slope = (moved[1] - moved[0]) / (2 * step)
        assert costs.marginal[true, seen] == pytest.approx(slope, rel=1e-5, abs=1e-6)


def test_what_a_rate_is_worth(care: MDP) -> None:
    costs = error_costs(care, PLAN, ROUGH)
    for bit, name in enumerate(costs.statuses):
        for which in (0, 1):
            ends = []
            for step in (1e-5, -1e-5):
                rates = np.array([HITS, CLEARS])
                rates[which, bit] += step
                ends.append(mean_return(care, independent(*rates)))
            slope = (ends[0] - ends[1]) / 2e-5
            assert costs.rates[name][which] == pytest.approx(slope, rel=1e-5, abs=1e-6)


def test_losses_add_up(care: MDP) -> None:
    for policy in (PLAN, "random", "always:directive"):
        costs = error_costs(care, policy, ROUGH)
        whole = evaluate(care, policy).mean - mean_return(care, ROUGH, policy)
        assert costs.loss.sum() == pytest.approx(whole, abs=2 * costs.error)
        parts = [part for both in costs.by_status.values() for part in both]
        assert sum(parts) == pytest.approx(whole, abs=2 * costs.error)
        assert np.diag(costs.loss).tolist() == [0.0] * 16
    assert costs.loss == pytest.approx(np.zeros((16, 16)), abs=costs.error)


def test_states_may_come_back() -> None:
    rows = [(s, a, [("1/2", 1 - s, 1 - s - a), ("1/2", 2, 0)]) for s in (0, 1) for a in (0, 1)]
    space = StateSpace(columns=(Column(name="status", size=2, bits=1),), extra=("end",))
    mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])]).with_(space=space)
    seen = independent([0.75], [0.9])
    costs = error_costs(mdp, [0, 1, 0], seen)
    assert costs.value.value == pytest.approx(mean_return(mdp, seen, [0, 1, 0]))
    lost = costs.perfect.value - costs.value.value
    assert costs.loss.sum() == pytest.approx(lost, abs=2 * costs.error)


# ---- by command ----------------------------------------------------------------------------------

MODEL = "yuan2025 --set tasks=[1] --set max_trial=2"
ANGER, CONFUSION = ("--parameter", "base.anger"), ("--parameter", "base.confusion")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    pd.DataFrame(ROUGH, LABELS, LABELS).to_csv("seen.csv", index_label="status")
    Path("plan.json").write_text(json.dumps(PLAN))


def ask(kind: str, *words: object) -> tuple[dict[str, Any], str]:
    """Return the JSON of a command and its text, on one line."""
    seen = (f"{kind} {MODEL} --perception seen.csv", *words)
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
            value = evaluate(there, HELD).mean
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
    below, above = (evaluate(at(**{"base.anger": x}), HELD).mean for x in ends)
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
    policy = perceived(CARE, PLAN, ROUGH) if form == "plan.json" else HELD
    wide = sobol(SMALL, names=["base.anger", "base.confusion"], n=8, rng=0, policy=policy)
    assert ask("sobol", "--samples", 8, *words)[0]["regret"]["mean"] == wide.regret.mean > 0
    drawn, _ = ask("psa", "--samples", 30, *words)
    lost = solve(CARE).start_value - evaluate(CARE, policy).mean
    spread = drawn["regret"]
    assert abs(spread["mean"] - lost) < 6 * spread["standard_error"] + 0.05 * lost
    assert drawn["candidates"][0]["actions"] is None  # it mixes


@pytest.mark.parametrize("kind", ["interval", "l1", "kl"])
def test_the_worst_case_of_it(kind: str) -> None:
    answer, _ = ask("robust", "--radius", 0, "--set-kind", kind)
    assert answer["start_value"] == pytest.approx(VALUE, rel=1e-12)
    assert answer["worst_case"]["nominal_policy"]["value"] == pytest.approx(VALUE, rel=1e-6)
    wide, _ = ask("robust", "--radius", 0.05, "--set-kind", kind)
    assert wide["worst_case"]["nominal_policy"]["value"] < VALUE - 1e-3
