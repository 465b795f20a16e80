"""The command `train`: its JSON, its files, and that nothing depends on how it is run."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runner import run, strict

from exact_mdp import MDP, Policy, QLearning, Scenario, evaluate

QUICK = "train yuan2025 --learner=epochs=60 --json"


@pytest.fixture(scope="module")
def result() -> dict:
    return run(QUICK, "--seeds", 20).result


def test_the_last_episodes_of_the_first_run(result: dict) -> None:
    mdp = Scenario.load("yuan2025").compile()
    run = QLearning(epochs=60).train(mdp, np.random.SeedSequence(0).spawn(1)[0])
    first = result["first_run"]
    assert first["episodes"] == 100
    assert first["distinct"] == len(set(run.last.tolist()))
    assert [top["episodes"] for top in first["top"]] == list(run.last_counts().values())[:5]
    for top in first["top"]:
        assert top["value"] == pytest.approx(evaluate(mdp, Policy.of(mdp, top["policy"])).mean)


def test_values_and_regrets_are_exact(result: dict) -> None:
    mdp = Scenario.load("yuan2025").compile()
    for entry in result["policies"]:
        own = evaluate(mdp, Policy.of(mdp, entry["policy"]))
        assert abs(own.mean - entry["value"]) <= own.start.error + entry["error_bound"]
        assert entry["regret"] == pytest.approx(result["optimal_value"] - entry["value"], abs=1e-9)
    total = sum(entry["count"] * entry["regret"] for entry in result["policies"])
    assert result["regret"]["mean"] == pytest.approx(total / 20)
    low, high = result["regret"]["mean_interval"]
    assert low < result["regret"]["mean"] < high
    assert result["best_value_proven"]
    assert result["best_value"] <= result["optimal_value"] + 1e-9


def test_neither_workers_nor_an_interruption_change_a_byte(tmp_path: Path) -> None:
    line = "train yuan2025 --learner=epochs=20 --json"
    plain = run(f"{line} --seeds 40 --seed 7 --n-jobs 1")
    assert plain.out == run(f"{line} --seeds 40 --seed 7 --n-jobs 3").out
    assert run(f"{line} --seeds 20 --seed 7", "--out", tmp_path).status == 0
    again = run(f"{line} --seeds 40 --seed 7", "--out", tmp_path)
    assert again.result | {"written": []} == plain.result
    assert again.result["seeds"] == 40
    assert run(f"{line} --seeds 40 --seed 8").result["regret"] != plain.result["regret"]


def test_the_files_can_be_used(tmp_path: Path) -> None:
    done = run(QUICK, "--out", tmp_path, "--seeds", 2, "--epsilon", "decaying")
    names = {path.name for path in tmp_path.iterdir()}
    written = {"summary.json", "policy.csv", "q.npy", "run.json"}
    assert names == written | {"work.json", "runs-000000.npz", "runs-000001.npz"}
    assert {Path(path).name for path in done.result["written"]} == written
    facts = {key: value for key, value in done.result.items() if key != "notice"}
    assert strict((tmp_path / "summary.json").read_text()) == facts
    record = json.loads((tmp_path / "run.json").read_text())
    assert record["seed"] == 0
    assert "Exponential" in record["solver"]
    first = done.result["policies"][0]
    audit = run("check yuan2025", tmp_path / "policy.csv", "--json")
    assert audit.result["learned_value"] == pytest.approx(first["value"])
    q = np.load(tmp_path / "q.npy")
    assert q.shape == (16, 4)
    audit = run("evaluate yuan2025", tmp_path / "q.npy", "--json")
    values = [entry["value"] for entry in done.result["policies"]]
    assert min(abs(audit.result["mean"] - value) for value in values) < 1e-9


@pytest.mark.parametrize(
    "words",
    [
        "--learner=columns=all",
        "--learner='columns=trial, status' --learner=method=sarsa",
        "--learner=method=double-q-learning --learner=ties=random --learner=initial=100",
        "--learner=method=expected-sarsa --learner=rate=1 --learner=rate_power=0.7",
        "--learner=bootstrap_end=true --learner=discount=9/10 --epsilon 0.3",
        "--set readings.skip_timestep=own --discount 0.95",
        "--set tasks=[1,1] --learner=max_steps=3",
    ],
)
def test_every_setting_of_the_learner_may_be_given(words: str, tmp_path: Path) -> None:
    quick = f"train yuan2025 --learner=epochs=10 --seeds 3 --json {words}"
    trained = run(quick, "--out", tmp_path).result
    assert trained["regret"]["mean"] >= 0
    assert trained["best_value"] <= trained["optimal_value"] + 1e-9
    if "max_steps" in words:
        assert trained["cut_short"] > 0
    policy = "policy.csv" if "trial" in words else "q.npy"
    changes = words.partition(" --")[0] if words.startswith("--set") else ""
    assert run(f"evaluate yuan2025 --json {changes}", tmp_path / policy).status == 0


def test_a_model_that_cannot_be_judged_is_refused_before_the_work(tmp_path: Path) -> None:
    """One state of the start gains for ever, the other loses: no mean to compare with."""
    rows, start = [(0, 0, [(1, 0, 1)]), (1, 0, [(1, 1, -1)])], {0: "1/2", 1: "1/2"}
    MDP.from_outcomes(rows, start=start).save(tmp_path / "both.npz")
    refused = run("train --learner=epochs=1000000 --json", tmp_path / "both.npz").refusal()
    assert "from one state of the start" in refused


def test_a_folder_that_holds_something_else_is_refused(tmp_path: Path) -> None:
    assert run(QUICK, "--seeds", 1, "--out", tmp_path).status == 0
    assert "differs in seed" in run(QUICK, "--seeds", 1, "--out", tmp_path, "--seed", 1).refusal()


def test_a_piece_whose_numbers_were_changed_is_damaged(tmp_path: Path) -> None:
    words = ["train", "tea", "--seeds=1", "--learner=epochs=3", "--n-jobs=1", "--out", tmp_path]
    assert run(*words).status == 0
    with np.load(path := tmp_path / "runs-000000.npz") as archive:
        arrays = {name: archive[name] for name in archive.files}
    for name, value in {"policies": 32767, "last": 32767, "snapshots": -1, "q": 3}.items():
        np.savez(path, **arrays | {name: np.full_like(arrays[name], value)})
        assert run(*words).refusal().startswith("ModelError: the file is damaged\n")
