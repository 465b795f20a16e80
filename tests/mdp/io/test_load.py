"""Models by name or file: every form finds its reader, every mistake is named."""

import json
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from cli_runner import run
from model_contents import assert_same
from refusal_tables import refused

import exact_mdp
from exact_mdp import MDP, load, save

SMALL = ["tasks=[1]", "max_trial=1"]


def test_settings_apply_in_order_and_the_discount_last() -> None:
    sets = ["base.anger=0.1", "base.anger=1/5", "discount=0.5", *SMALL]
    assert_same(
        load("yuan2025", sets=sets, discount="9/10"),
        load("yuan2025", sets=["base.anger=1/5", "discount=9/10", *SMALL]),
    )
    assert load("yuan2025", sets=sets, discount="9/10").discount_exact == Fraction(9, 10)
    assert load("yuan2025", sets=sets).discount_exact == Fraction(1, 2)
    assert load("yuan2025", sets=SMALL, discount=0).discount_exact == 0


def test_a_scenario_file(tmp_path: Path) -> None:
    text = (Path(exact_mdp.__file__).parent / "mdp" / "scenarios" / "tea.toml").read_text("utf-8")
    for name in ("my tea.toml", "TEA.TOML"):
        path = tmp_path / name
        path.write_text(text.replace('name = "tea"\n', ""), encoding="utf-8")
        loaded = load(path, sets=["tasks=[2]"])
        assert loaded.name == path.stem
        assert loaded.discount_exact == Fraction(99, 100)
        assert loaded.n_states == 2 * 4 * 8 + 1


@pytest.mark.parametrize("name", ["model.npz", "model.umb", "MODEL.NPZ"])
def test_a_saved_model(tmp_path: Path, name: str) -> None:
    mdp = load("yuan2025", sets=SMALL)
    save(mdp, tmp_path / name)
    assert load(tmp_path / name).name == "yuan2025"
    assert load(str(tmp_path / name), discount="1/3").discount_exact == Fraction(1, 3)


@pytest.mark.parametrize("name", ["-", "model.npz", "m.json", "gymnasium:FrozenLake-v1"])
def test_only_a_scenario_has_values_to_set(name: str) -> None:
    refused(lambda: load(name, sets=["base.anger=1/5"]), "cannot be set", name, "")


def test_without_storm_the_error_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "stormpy", None)
    (tmp_path / "m.prism").write_text("mdp", encoding="utf-8")
    refused(lambda: load(tmp_path / "m.prism"), "stormpy", "", "exact-mdp[models]")
    for model, said in ((tmp_path / "m.prism", "exact-mdp[models]"), ("tea", "has no constants")):
        assert said in run("convert --constants N=4", model, tmp_path / "m.umb").refusal()


@pytest.mark.parametrize(
    ("change", "place"),
    [
        ({"unreached": []}, "unreached"),
        ({"goal": 1}, "goal"),
        ({"time_limit": 0}, "time_limit"),
        ({"start": {"1/2": 1}}, "start"),
        ({"state": 10**400}, "state"),
        ({"next": [10**400]}, "next"),
    ],
    ids=str,
)
def test_a_damaged_model_file_names_the_place(
    change: dict[str, Any], place: str, tmp_path: Path
) -> None:
    MDP.from_outcomes([(0, 0, [(1, 0, 1)])], "1/2").save(tmp_path / "m.json")
    content = json.loads((tmp_path / "m.json").read_text("utf-8"))
    inner = content["pairs"][0] if place in content["pairs"][0] else content
    inner.update(change)
    (tmp_path / "m.json").write_text(json.dumps(content), "utf-8")
    assert place in run("solve", tmp_path / "m.json").refusal()


def test_a_key_that_is_written_twice_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.json"
    MDP.from_outcomes([(0, 0, [(1, 0, 1)])], "1/2").save(path)
    path.write_text(path.read_text("utf-8").replace('"reward": 1', '"reward": 2, "reward": 1'))
    refused(lambda: load(path), "reward appears twice", "m.json")


def test_an_action_beyond_all_memory_is_refused(tmp_path: Path) -> None:
    """Where actions have no names, their numbers are their names."""
    path = tmp_path / "m.json"
    MDP.from_outcomes([(0, 0, [(1, 0, 1)])], "1/2").save(path)
    content = json.loads(path.read_text("utf-8")) | {"action_names": None}
    content["pairs"][0]["action"] = 2**61
    path.write_text(json.dumps(content), "utf-8")
    refused(lambda: load(path), "there is no action 2305843009213693952")
