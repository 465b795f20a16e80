"""The main job: its files, its numbers against the independent model, its figures."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from fractions import Fraction
from math import sqrt
from pathlib import Path

import pytest
from click.testing import CliRunner
from oracle import Oracle

from mdp import Policy, Scenario
from paper_repro import reported
from paper_repro.__main__ import main
from paper_repro.figures import FIGURES, status_law
from paper_repro.numbers import Study, all_numbers, study
from solvers import evaluate


@pytest.fixture(scope="module")
def default() -> Study:
    return study(Scenario.load("yuan2025"))


def test_the_main_job_writes_everything_it_names(tmp_path: Path) -> None:
    out = tmp_path / "results"
    result = CliRunner().invoke(main, ["--quick", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert "paper / exact / difference" in result.output
    assert str(out / "figures") in result.output.replace("\n", "")
    rows = json.loads((out / "numbers.json").read_text())
    assert len(rows) == 5 + 20 + 13
    for row in rows:
        assert {"name", "source", "paper", "exact", "difference", "claim"} <= set(row)
        assert row["claim"] in ("certified", "bounded", "estimated")
    for row in rows[:5]:
        assert abs(row["simulated"] - row["exact"]) < 5 * row["simulated_standard_error"]
    assert json.loads((out / "run.json").read_text())["quick"] is True
    for name in FIGURES:
        assert (out / "figures" / f"{name}.png").read_bytes()[:4] == b"\x89PNG"
        ET.parse(out / "figures" / f"{name}.svg")
        assert f"figures/{name}.png" in (out / "report.md").read_text()


def test_a_folder_that_cannot_be_made_is_bad_input(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    result = CliRunner().invoke(main, ["--quick", "--out", str(blocked / "results")])
    assert result.exit_code == 2
    assert "cannot make the folder" in result.output


def test_the_tables_of_the_compiled_model_are_the_papers(default: Study) -> None:
    tables = [n for n in all_numbers(default) if n.name.startswith("table")]
    assert len(tables) == 20 + 13
    for number in tables:
        assert number.difference == pytest.approx(0, abs=1e-15), number.name


@pytest.mark.parametrize("start", reported.AVERAGE_RETURN)
def test_reported_policies_against_the_independent_model(default: Study, start: str) -> None:
    actions = reported.policy(start, default.completion)
    exact = Oracle(tasks=[3]).evaluate(
        lambda state: {actions["".join(map(str, state[3]))]: Fraction(1)}
    )
    number = next(n for n in all_numbers(default) if n.name == f"return.reported.{start}")
    assert number.exact == pytest.approx(float(exact["mean"]), rel=1e-12)
    assert number.sd == pytest.approx(sqrt(exact["variance"]), rel=1e-10)
    assert number.standard_error == pytest.approx(number.sd / sqrt(1000))
    assert number.difference == number.exact - number.paper


def test_the_range_holds_every_completion_and_is_reached(default: Study) -> None:
    lowest, highest = default.spread["reported.supportive"]
    means = [
        evaluate(default.mdp, reported.policy("supportive", filled)).mean
        for filled in reported.completions()[::15]
    ]
    assert lowest - 1e-9 <= min(means)
    assert max(means) <= highest + 1e-9
    final = default.spread["reported.non-directive"][1]
    assert default.evaluations["reported.non-directive"].mean == pytest.approx(final, rel=1e-12)


def test_the_drawn_law_is_that_of_independent_statuses(default: Study) -> None:
    law = status_law(default.mdp, default.mdp.action("directive"))
    assert law.sum(axis=1) == pytest.approx(1)
    # 1100 under a3: forgetfulness and confusion 1/20 each, anger 5+6+8 %, disengagement 20+2+2 %.
    assert law[0b1100, 0b0000] == pytest.approx(0.95 * 0.95 * 0.81 * 0.76)
    assert law[0b1100, 0b1011] == pytest.approx(0.05 * 0.95 * 0.19 * 0.24)


def test_a_policy_by_status_is_complete(default: Study) -> None:
    policy = reported.policy("directive", reported.completions()[0])
    assert len(policy) == 16
    assert policy["0000"] == "directive"
    assert policy["1111"] == "supportive"
    assert Policy.of(default.mdp, policy).deterministic
