"""The analyses of parameters on the command line: what they print, draw, write and refuse."""

import json
from pathlib import Path

import pytest
from cli_runner import run

from exact_mdp import MDP, Scenario, save, sobol, worst_point

YUAN = Scenario.load("yuan2025")
SMALL = YUAN.with_(tasks=[1], max_trial=2)
SET = "yuan2025 --set tasks=[1] --set max_trial=2"


def test_sobol_tells_of_value_and_regret() -> None:
    answer = run(f"sobol {SET} --policy always:directive --samples 4 --json").result
    names = set(answer["first_order"])
    assert {"base.anger", "reward.subtask-complete"} <= names
    assert "assistance.supportive.anger.onset" in answer["without_range"]
    assert names | set(answer["without_range"]) == set(YUAN.names)
    assert (answer["claim"], answer["seed"], answer["confidence"]) == ("estimated", 0, 0.95)
    assert answer["draws"] == 4 * (len(names) + 2)
    for each in (answer, answer["regret"]):
        assert set(each["total"]) == names
        for kind in ("first_order", "total"):
            for name, (low, high) in each[f"{kind}_interval"].items():
                assert low <= each[kind][name] <= high
    expected = sobol(SMALL, policy="always:directive", n=4, rng=0)
    assert answer["total"] == dict(
        zip(expected.names, expected.optimal.total.tolist(), strict=True)
    )
    assert answer["regret"]["mean"] == expected.regret.mean > 0


@pytest.mark.parametrize(
    ("words", "vary"),
    [
        ("--relative 0.1", set(YUAN.names) - {"discount"}),
        ("--parameter discount --parameter base.anger", {"discount", "base.anger"}),
        ("--range discount=0.9:1", {"discount"}),
    ],
)
def test_the_discount_is_held_unless_it_is_named(words: str, vary: set[str]) -> None:
    result = run(f"sobol {SET} --samples 8 {words} --json").result
    assert set(result["total"]) | set(result["without_range"]) == vary


def test_sobol_keeps_its_work(tmp_path: Path) -> None:
    line = f"sobol {SET} --samples 4 --parameter base.anger --json --out"
    answer = run(line, tmp_path / "kept").result
    assert [Path(path).name for path in answer["written"]] == ["sobol.json", "run.json"]
    content = json.loads((tmp_path / "kept" / "sobol.json").read_text())
    assert answer == content | {"notice": answer["notice"]}
    assert json.loads((tmp_path / "kept" / "run.json").read_text())["seed"] == 0
    assert run(line, tmp_path / "kept").result == answer
    assert "differs in" in run(line, tmp_path / "kept", "--seed", 1).refusal()


def test_a_regret_of_nothing_has_no_indices() -> None:
    line = f"sobol {SET} --samples 4 --parameter"
    answer = run(line, "reward.subtask-complete", "--json").result
    assert answer["regret"]["total"] == {"reward.subtask-complete": None}
    assert "shares of the variance of the start value" in run(line, "discount").out


# ---- robust -------------------------------------------------------------------------------------


def test_a_box_tells_the_worst_point_found() -> None:
    box = run(f"robust {SET} --set-kind box --json").result
    assert (box["set_kind"], box["radius"], box["claim"]) == ("box", 0.2, "estimated")
    worst = box["worst_case"]
    point = worst_point(SMALL, ranges={name: tuple(span) for name, span in box["box"].items()})
    assert worst["value"] == pytest.approx(point.value.value, abs=1e-9)
    assert worst["value"] <= worst["optimum"]["value"] < box["start_value"]
    assert all(worst["point"][name] in span for name, span in box["box"].items())
    assert "base.anger" in box["box"]
    assert "reward.anger" not in box["box"]
    wide = run(f"robust {SET} --set-kind box --relative 1/10 --json").result
    assert "reward.anger" in wide["box"]
    assert "discount" not in wide["box"]


def test_states_that_change_alike_are_one_row_for_people() -> None:
    """One row for each change of a status; JSON has every state."""
    line = f"threshold {SET} --parameter base.anger --relative whole"
    changes: dict[tuple, list[dict]] = {}
    for each in run(f"{line} --json").result["switches"]:
        change = (each["columns"]["status"], *each["before"], *each["after"])
        changes.setdefault(change, []).append(each)
    table = run(line).out.partition("optimal actions that change")[2]
    rows = table.partition("\n\n")[0].count("base.anger")
    assert rows == len(changes) < sum(map(len, changes.values()))
    (status, *_), members = max(changes.items(), key=lambda item: len(item[1]))
    assert f"{len(members)} states:" in table
    assert f"status {status}" in table
    for end in (0, -1):
        assert f" {members[end]['threshold']:.6g} " in table


# ---- psa ----------------------------------------------------------------------------------------


def test_psa_says_which_evppi_need_more_draws() -> None:
    line = "psa yuan2025 --samples 100 --effective-sample-size 50"
    details = run(f"{line} --json").result["evppi_details"]
    doubts = [name for name, each in details.items() if "0 to EVPI" in each["doubts"][-1]]
    (note,) = (each for each in run(line).err.splitlines() if "EVPPI of" in each)
    assert f"{doubts[2]} and {len(doubts) - 3} more: the standard error is above EVPI" in note
    assert "take about n=8,000" in note


def test_psa_takes_any_model(tmp_path: Path) -> None:
    file = tmp_path / "wager.npz"
    rows = [(0, 0, [("3/10", 1, 1), ("7/10", 2, 0)]), (0, 1, [("2/5", 1, 1), ("3/5", 2, 0)])]
    save(MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]), file)
    result = run("psa --samples 24 --n-jobs 1 --json", file).result
    assert result["evpi"] > 0
    assert set(result["evppi"]) == {"(state 0, 0)", "(state 0, 1)"}
    assert result["clipped"] is None
    row = tmp_path / "row.toml"
    row.write_text('["(state 0, 0)"]\nfixed = true\n')
    fixed = run("psa --samples 20 --n-jobs 1 --json --uncertain", row, file).result
    assert fixed["fixed"]["(state 0, 0): to state 1"] == "stated to be fixed"
    assert len(fixed["drawn"]) == 1


def test_psa_draws_rewards_and_the_discount_where_they_are_stated(tmp_path: Path) -> None:
    file, stated = tmp_path / "model.npz", tmp_path / "stated.toml"
    save(MDP.from_arrays([[[0, 1], [0, 1]]], [2, 0], "1/2"), file)
    stated.write_text('["reward.2"]\nsd = 0.5\n[discount]\neffective_sample_size = 9\n')
    result = run("psa --samples 64 --n-jobs 1 --json --uncertain", stated, file).result
    kinds = {name: each["distribution"] for name, each in result["drawn"].items()}
    assert kinds == {"reward.2": "normal", "discount": "beta"}
    assert result["value"]["mean"] == pytest.approx(2, abs=0.3)


def test_a_saved_model_has_a_discount_to_vary(tmp_path: Path) -> None:
    file = tmp_path / "loop.npz"
    save(MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0], "9/10"), file)
    line = "sobol --samples 32 --n-jobs 1 --relative 0.05 --parameter discount --json"
    assert run(line, file).result["total"]["discount"] == pytest.approx(1, abs=0.2)
