"""--criterion average on the command line: solve, verify, evaluate, check."""

from pathlib import Path

import numpy as np
import pytest
from cli_runner import run
from made_models import forest

AVERAGE = ("--criterion", "average")


@pytest.fixture
def model(tmp_path: Path) -> Path:
    forest("9/10").save(tmp_path / "forest.npz")
    return tmp_path / "forest.npz"


def test_an_average_is_solved_proven_and_verified(model: Path, tmp_path: Path) -> None:
    proof, arrays = tmp_path / "proof.json", tmp_path / "arrays.npz"
    files = ("--certificate", proof, "--out", arrays, "--policy-out", tmp_path / "policy.csv")
    found = run("solve", model, *AVERAGE, "--certify", *files, "--json").result
    assert found["criterion"] == "average"
    assert (found["exact_start_value"], found["claim"]) == ("81/25", "certified")
    assert found["bias"] == {"0": "-162/25", "1": "-72/25", "2": "28/25"}
    assert found["policy_by_state"] == {"0": "0", "1": "0", "2": "0"}
    assert np.load(arrays)["bias"].tolist() == [-6.48, -2.88, 1.12]
    verified = run("verify", proof, model, "--json").result
    assert (verified["holds"], verified["exact_start_value"]) == (True, "81/25")
    proof.write_text(proof.read_text().replace('"0x51"', '"0x52"', 1))
    assert run("verify", proof, model).status == 1
    assert run("check", model, tmp_path / "policy.csv", *AVERAGE).status == 0
