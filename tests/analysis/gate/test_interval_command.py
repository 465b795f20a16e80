"""Intervals on the command line and on the page about them: keys, statuses, reports."""

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


def asked(kind: str, folder: Path, draws: int) -> list[str]:
    """Return the words that ask for a kind of interval."""
    words = ["check", str(folder / "model.npz"), "always:a", "--confidence=0.95", f"--by={kind}"]
    if kind == "posterior":
        return [*words, f"--evidence=n={draws}", "--evidence=rng=2"]
    records = [f"--evidence=records={folder / 'records.csv'}", "--evidence=behaviour=random"]
    return [*words, "--evidence=rewards=0,1", *records * (kind == "off-policy")]


@pytest.mark.parametrize("kind", ["robust", "posterior", "off-policy"])
def test_the_keys_and_the_reports(kind: str, folder: Path, tmp_path: Path) -> None:
    words = asked(kind, folder, 200)
    result = run(*words, "--max-regret=0.9", "--json").result
    assert (result["passed"], result["confidence"], result["by"]) == (True, 0.95, kind)
    claim = "bounded" if kind == "robust" else "estimated"
    assert (result["claim"], result["regret_claim"]) == (claim, "certified")
    low, high = result["regret_interval"]
    assert low <= result["regret"] <= high <= 0.9
    assert result["assumptions"]
    page, report = tmp_path / "page.html", tmp_path / "report.xml"
    limit = result["regret"] + 0.001  # the estimate keeps it, the interval does not
    done = run(*words, f"--max-regret={limit}", "--markdown", f"--html={page}", f"--junit={report}")
    assert done.status == 1
    shown = f"at 95 % confidence, {kind}"
    tree = ElementTree.parse(report)
    listed = {each.get("name"): each.get("value", "") for each in tree.iter("property")}
    assert (shown in listed["regret_interval"], listed["claim"]) == (True, claim)
    assert "no medical advice" in listed["notice"]
    texts = [done.out, page.read_text("utf-8"), report.read_text("utf-8")]
    assert f"{shown} ({claim})" in texts[1]
    for text in texts:
        assert shown in text
        assert "leaves the limit open" in text
        assert "no: it is in" not in text
    assert [text.count("no medical advice") for text in texts[:2]] == [1, 1]
