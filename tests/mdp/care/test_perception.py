"""Acting on perceived statuses: against the reference model, by file, on the command line."""

from __future__ import annotations

import json
from fractions import Fraction
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from cli_runner import run
from oracle import Oracle

from exact_mdp.mdp import MDP, ModelError, Policy, Scenario
from exact_mdp.mdp.care.perception import independent, perceived, read
from exact_mdp.solvers import evaluate

LABELS = [f"{status:04b}" for status in range(16)]
ACTIONS = ("none", "supportive", "non-directive", "directive")
RATES = ("9/10", "4/5", "19/20", "3/4")
CLEAR = ("7/8", "99/100", "1", "1/2")


@pytest.fixture(scope="module")
def care() -> MDP:
    return Scenario.load("yuan2025").with_(tasks=[2], max_trial=3).compile()


def policy(status: str) -> str:
    """An action for each status that differs between neighbours."""
    return ACTIONS[(3 * int(status, 2) + 2) % 4]


def confusion(true: str, seen: str) -> Fraction:
    """The probability of what is seen, status by status."""
    chance = Fraction(1)
    for present, shown, hit, clear in zip(true, seen, RATES, CLEAR, strict=True):
        if present == "1":
            chance *= Fraction(hit) if shown == "1" else 1 - Fraction(hit)
        else:
            chance *= Fraction(clear) if shown == "0" else 1 - Fraction(clear)
    return chance


def as_csv(path: Path, rows: list[list[object]]) -> Path:
    lines = [",".join(["status", *LABELS])]
    lines += [",".join([label, *map(str, row)]) for label, row in zip(LABELS, rows, strict=True)]
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.fixture
def exact_rows() -> list[list[object]]:
    return [[confusion(true, seen) for seen in LABELS] for true in LABELS]


def test_the_value_is_that_of_the_reference_model(care: MDP, tmp_path: Path, exact_rows) -> None:
    def acting(state: tuple) -> dict[str, Fraction]:
        true = "".join(map(str, state[3]))
        mixed: dict[str, Fraction] = {}
        for seen in LABELS:
            mixed[policy(seen)] = mixed.get(policy(seen), Fraction(0)) + confusion(true, seen)
        return mixed

    wanted = Oracle(tasks=[2], max_trial=3).evaluate(acting, distribution=False)
    matrix = read(as_csv(tmp_path / "seen.csv", exact_rows), care)
    found = evaluate(care, perceived(care, {label: policy(label) for label in LABELS}, matrix))
    assert found.mean == pytest.approx(float(wanted["mean"]), rel=1e-12)
    assert found.sd == pytest.approx(sqrt(wanted["variance"]), rel=1e-10)
    assert found.steps == pytest.approx(float(wanted["steps"]), rel=1e-12)
    assert found.skip_probability == pytest.approx(float(wanted["skip_probability"]), rel=1e-12)


def test_rates_and_matrix_say_the_same(care: MDP, tmp_path: Path, exact_rows) -> None:
    names = ("forgetfulness", "confusion", "anger", "disengagement")
    lines = ["[sensitivity]", *(f'{n} = "{r}"' for n, r in zip(names, RATES, strict=True))]
    lines += ["[specificity]", *(f'{n} = "{r}"' for n, r in zip(names, CLEAR, strict=True))]
    (tmp_path / "seen.toml").write_text("\n".join(lines))
    by_rate = read(tmp_path / "seen.toml", care)
    by_row = read(as_csv(tmp_path / "seen.csv", exact_rows), care)
    assert by_rate == pytest.approx(by_row, abs=1e-15)
    assert by_rate == pytest.approx(independent([0.9, 0.8, 0.95, 0.75], [0.875, 0.99, 1, 0.5]))


def test_seeing_the_truth_changes_nothing(care: MDP) -> None:
    for form in ("random", "always:directive", {label: policy(label) for label in LABELS}):
        plain = Policy.of(care, form).weights(care)
        assert np.array_equal(perceived(care, form, np.eye(16)).weights(care), plain)


def test_every_command_about_a_policy_takes_it(tmp_path: Path) -> None:
    even = [[Fraction(1, 16)] * 16 for _ in LABELS]
    seen = as_csv(tmp_path / "blind.csv", even)
    words = ("yuan2025", "optimal", "--perception", seen, "--json")
    means = [json.loads(run(command, *words).out)["mean"] for command in ("evaluate", "returns")]
    assert means[0] == pytest.approx(means[1], rel=1e-12)
    audit = run("check", *words, "--no-explain")
    assert audit.status == 1
    assert json.loads(audit.out)["learned_value"] == pytest.approx(means[0], rel=1e-12)
    sampled = json.loads(run("simulate", *words, "--episodes", 20_000).out)
    assert abs(sampled["mean"] - means[0]) < 4 * sampled["standard_error"]


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("a.csv", "", "header"),
        ("a.csv", "status,0000\n0000,1\n", "header"),
        ("a.csv", ",".join(["status", *LABELS]) + "\n", "0000 is missing"),
        ("a.csv", ",".join(["status", *LABELS]) + "\n0000,1\n", "values in a row"),
        ("a.csv", ",".join(["status", *LABELS]) + "\n2222" + ",0" * 16 + "\n", "unknown"),
        ("a.csv", ",".join(["status", *LABELS]) + "\n0000,2" + ",0" * 15 + "\n", "outside"),
        ("a.toml", "[sensitivity", "broken TOML"),
        ("a.toml", "[sensitivity]\nanger = 1\n", "missing"),
        ("a.toml", "[sensitivity]\nangre = 1\n", "unknown status"),
        ("a.toml", "[sensitivity]\nanger = nan\n", "finite"),
        ("a.txt", "", "unknown kind"),
    ],
)
def test_broken_files_are_refused(tmp_path: Path, name: str, text: str, what: str) -> None:
    (tmp_path / name).write_text(text)
    done = run("evaluate", "yuan2025", "random", "--perception", tmp_path / name, "--json")
    assert (done.status, done.out) == (2, "")
    assert what in done.err


def test_rows_that_are_no_distribution(care: MDP, tmp_path: Path) -> None:
    rows: list[list[object]] = [[0] * 16 for _ in LABELS]
    with pytest.raises(ModelError, match="row of status 0000 sums to 0, not 1") as failed:
        read(as_csv(tmp_path / "a.csv", rows), care)
    assert str(failed.value.where).endswith("a.csv, line 2")
    matrix = np.eye(16)
    matrix[3, 3] = 0.9
    with pytest.raises(ModelError, match=r"row of status 0011 sums to 0.9, not 1") as failed:
        perceived(care, "random", matrix)
    assert failed.value.where == "confusion matrix, row 3"
    matrix[3, [3, 5]] = 1.25, -0.25
    with pytest.raises(ModelError, match=r"0011 is seen as 0101 with probability -0.25"):
        perceived(care, "random", matrix)
    matrix[3, [3, 5]] = 1, np.nan
    with pytest.raises(ModelError):
        perceived(care, "random", matrix)
    with pytest.raises(ModelError, match="no statuses"):
        perceived(MDP.from_arrays([[[1]]], [0]), "random", np.eye(16))
