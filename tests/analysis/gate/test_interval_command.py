"""Intervals on the command line and on the page about them: keys, statuses, reports."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from cli_runner import run

from exact_mdp import MDP

NAMES = ["episode", "state", "action", "reward", "next_state"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with records of two treatments, and the model that they make."""
    place, rng = tmp_path_factory.mktemp("records"), np.random.default_rng(0)
    rows = [
        (n, "ill", ("a", "b")[n % 2], int(rng.random() < 0.3 + n % 2 / 2), None) for n in range(800)
    ]
    pd.DataFrame(rows, columns=NAMES).to_csv(place / "records.csv", index=False)
    MDP.from_transitions(place / "records.csv", "1/2").save(place / "model.npz")
    return place


@pytest.mark.parametrize("kind", ["robust", "posterior", "off-policy"])
def test_the_keys_and_the_reports(kind: str, folder: Path, tmp_path: Path) -> None:
    more = [f"--evidence=records={folder / 'records.csv'}", "--evidence=behaviour=random"] * (
        kind == "off-policy"
    )
    more += (
        ["--evidence=n=200", "--evidence=rng=2"]
        if kind == "posterior"
        else ["--evidence=rewards=0,1"]
    )
    words = [
        "check",
        str(folder / "model.npz"),
        "always:a",
        "--confidence",
        "0.95",
        "--by",
        kind,
        *more,
    ]
    found = run(*words, "--max-regret", "0.9", "--json").result
    assert (found["passed"], found["confidence"], found["by"]) == (True, 0.95, kind)
    claim = "bounded" if kind == "robust" else "estimated"
    assert (found["claim"], found["regret_claim"]) == (claim, "certified")
    low, high = found["regret_interval"]
    assert low <= found["regret"] <= high <= 0.9
    assert found["assumptions"]
    if kind == "posterior":
        within = found["interval"]["probability_within"]
        assert within["value"] == 1
        assert 0.9 < within["interval"][0] < 1
    if kind == "off-policy":
        assert found["interval"]["effective_sample_size"] == pytest.approx(400)
    page, report = tmp_path / "page.html", tmp_path / "report.xml"
    limit = found["regret"] + 0.001  # the estimate keeps it, the interval does not
    done = run(*words, f"--max-regret={limit}", "--markdown", f"--html={page}", f"--junit={report}")
    assert done.status == 1
    shown = f"at 95 % confidence, {kind}"
    tree = ElementTree.parse(report)
    listed = {each.get("name"): each.get("value") for each in tree.iter("property")}
    assert shown in (listed["regret_interval"] or "")
    assert listed["claim"] == claim
    assert "no medical advice" in (listed["notice"] or "")
    assert f"{shown} ({claim})" in page.read_text("utf-8")
    for text in (done.out, page.read_text("utf-8"), report.read_text("utf-8")):
        assert shown in text
        assert "leaves the limit open" in text
        assert "no: it is in" not in text
    assert page.read_text("utf-8").count("no medical advice") == 1
    assert "no medical advice" in done.out


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["--by", "robust"], "applies to an interval"),
        (["--evidence", "prior=2"], "applies to an interval"),
        (["--confidence", "1"], "a confidence of 1"),
        (["--confidence", "0.9", "--by", "bayes"], "unknown kind"),
        (["--confidence", "0.9", "--evidence", "prior=2"], "does not apply to robust"),
        (["--confidence", "0.9", "--evidence", "rewards=5"], "no range"),
        (["--confidence", "0.9", "--evidence", "rewards=0,x"], "no range"),
        (["--confidence", "0.9", "--by", "off-policy"], "no trajectories"),
        (["--confidence", "0.9", "--by", "posterior", "--evidence", "n=x"], "not a whole number"),
        (["--confidence", "0.9"], "nothing says where rewards lie"),
        (
            [
                "--confidence=.9",
                "--evidence=rewards=0,1",
                "--by=off-policy",
                "--evidence=records=none.csv",
            ],
            "none.csv",
        ),
        (["--confidence", "0.9", "--max-relative-regret", "1"], "total regret alone"),
    ],
)
def test_bad_input_prints_nothing_and_exits_with_2(
    words: list[str], what: str, folder: Path
) -> None:
    done = run("check", folder / "model.npz", "always:a", *words)
    assert (done.status, done.out) == (2, "")
    assert what in done.err
    assert "fix:" in done.err


def test_a_behaviour_that_the_records_refute_is_refused(folder: Path) -> None:
    words = ("--confidence=0.9", "--by=off-policy", f"--evidence=records={folder / 'records.csv'}")
    ranges = ("--evidence=rewards=0,1", "--evidence=behaviour=always:a")
    done = run("check", folder / "model.npz", "always:a", *words, *ranges)
    assert (done.status, done.out) == (2, "")
    assert "the behaviour never does what was recorded" in done.err


def test_a_file_with_other_separators_or_names_is_told_apart(folder: Path, tmp_path: Path) -> None:
    text, other = (folder / "records.csv").read_text("utf-8"), tmp_path / "other.csv"
    words = ("data", other, "--discount=0.9", f"--out={tmp_path / 'other.npz'}")
    other.write_text(text.replace(",", ";"), "utf-8")
    assert "separate columns by commas" in run(*words).err
    other.write_text(text.replace("state", "ward", 1), "utf-8")
    assert "--column state=" in run(*words).err


def test_trajectories_that_tell_nothing_are_refused(folder: Path) -> None:
    words = (
        "--confidence=0.9",
        "--by=off-policy",
        "--evidence=rewards=0,1",
        f"--evidence=records={folder / 'records.csv'}",
    )
    done = run("check", folder / "model.npz", "always:a", *words, "--evidence=behaviour=always:b")
    assert (done.status, done.out) == (2, "")
    assert "never does what the policy does" in done.err
    assert "state ill" in done.err


@pytest.mark.parametrize("by", ["robust", "posterior", "off-policy"])
def test_a_horizon_leaves_no_counts_behind(by: str, folder: Path) -> None:
    more = ["--evidence=n=80"] if by == "posterior" else ["--evidence=rewards=0,1"]
    more += [f"--evidence=records={folder / 'records.csv'}"] * (by == "off-policy")
    words = ("check", folder / "model.npz", "always:a", f"--by={by}", "--confidence=0.95", *more)
    alone, one = (run(*words, *late, "--json").result for late in ([], ["--horizon=1"]))
    assert one["horizon"] == 1
    assert one["regret_interval"][1] <= alone["regret_interval"][1] + 1e-3
    assert one["regret_interval"][0] <= one["regret"] <= one["regret_interval"][1]
