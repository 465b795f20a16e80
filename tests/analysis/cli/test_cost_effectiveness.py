"""Strategies are compared on the command line as in Python, with tables of draws from a file."""

import json
from pathlib import Path
from typing import Any

import pandas as pd
import pytest
from cli_runner import run

from exact_mdp import MDP, cost_effectiveness, load

PARTS = {"qaly": [[1, 1], ["3/4", "4/5"], [0, 0]], "cost": [[0, 5], [10, 12], [0, 0]]}
ROWS = [
    [["9/10", "1/10", 0], [0, "4/5", "1/5"], [0, 0, 1]],
    [["19/20", "1/20", 0], [0, "9/10", "1/10"], [0, 0, 1]],
]
NAMES: dict[str, Any] = {"states": ["well", "ill", "dead"], "actions": ["none", "treat"]}
BOTH = ("--strategy", "usual=always:none", "--strategy", "new=always:treat")
STRATEGIES = {"usual": "always:none", "new": "always:treat"}


@pytest.fixture(scope="module")
def care(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("care") / "care.npz"
    MDP.from_arrays(ROWS, [[0, 0]] * 3, "97/100", components=PARTS, **NAMES).save(path)
    return path


def answer(*words: object) -> dict[str, Any]:
    return run("ce", *words, "--json").result


def test_the_base_case(care: Path) -> None:
    found, here = answer(care, *BOTH), cost_effectiveness(load(care), STRATEGIES)
    assert [row["strategy"] for row in found["icers"]] == ["usual", "new"]
    assert found["icers"][1]["ICER"] == here.icers()["ICER"][1]
    text = run("ce", care, *BOTH).out
    assert "none: the base case" in text
    assert "Δ cost" in text


MORE = "; a Family can do more"


def test_amounts_of_a_model_are_said_to_be_held(care: Path) -> None:
    """Only its rows are drawn; in a family, whatever its function takes."""
    text = run("ce", care, *BOTH, "--samples", 5).out
    said = "qaly, cost: held, as a plain model has no parameters of them, and each row varies alone"
    assert said in " ".join(text.split())
    fixed = answer(care, *BOTH, "--samples", 5)["fixed"]
    assert fixed["cost"] == fixed["qaly"] == said.removeprefix("qaly, cost: ") + MORE
    assert "plain model" not in run("ce", care, *BOTH).out


def test_draws_from_a_file(care: Path, tmp_path: Path) -> None:
    table = pd.DataFrame({"discount": [0.9, 0.95, 0.99]})
    table.to_csv(tmp_path / "draws.csv", index=False)
    found = answer(care, *BOTH, "--draws", tmp_path / "draws.csv", "--reference", "usual")
    here = cost_effectiveness(load(care), STRATEGIES, uncertain=table)
    assert found["draws"] == 3
    assert found["icers"] == json.loads(here.report("usual").json())["icers"]
    # Other parameters have the distributions of a second file.
    (tmp_path / "said.toml").write_text('["(state ill, none)"]\neffective_sample_size = 40\n')
    both = answer(
        care, *BOTH, "--draws", tmp_path / "draws.csv", "--uncertain", tmp_path / "said.toml"
    )
    assert both["drawn"]["discount"] == "sample"
    assert both["drawn"]["(state ill, none)"] == "dirichlet"
    assert "(state ill, none)" not in both["assumed"]


def test_a_horizon_and_samples(care: Path) -> None:
    found = answer(care, *BOTH, "--horizon", 5, "--samples", 20, "--seed", 3)
    here = cost_effectiveness(load(care).within(5), STRATEGIES, 20, rng=3)
    assert found["icers"] == json.loads(here.report().json())["icers"]
    assert (found["horizon"], found["seed"]) == (5, 3)
