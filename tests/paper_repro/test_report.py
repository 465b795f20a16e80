"""The report and its figures: the committed page is what the code writes; commands and files."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from cli_runner import ask
from golden.runner import FOLDER, differences, trimmed
from refusal_tables import entries

from exact_mdp import READINGS, evaluate
from exact_mdp.paper_repro import run
from exact_mdp.paper_repro.__main__ import main
from exact_mdp.paper_repro.claim import CLAIMS, ClaimVerdict
from exact_mdp.paper_repro.drawing import FIGURES, save_figure
from exact_mdp.paper_repro.paper import FINAL, ORDERS, PAPER, PLACES
from exact_mdp.paper_repro.readme import render_readme
from exact_mdp.paper_repro.silent_points import OPTIONS, POINTS, build_default_reading

ROOT = Path(__file__).parents[2]
RESULTS = json.loads((run.HERE / "results.json").read_text("utf-8"))
README = (run.HERE / "README.md").read_text("utf-8")
LEARNED = [name for name, figure in FIGURES.items() if "learning" in figure.code]


# ---- the committed page --------------------------------------------------------------------------


def test_the_committed_page_is_what_the_code_writes_of_all_that_the_paper_has() -> None:
    assert render_readme(RESULTS, code="./") == README
    numbered = [place for place in PLACES if place.startswith(("Table", "Figure"))]
    assert len(numbered) == 16
    for place in numbered:
        assert re.search(rf"^(### |\*\*|<details><summary>){place}\b", README, re.M), place
    for claim in CLAIMS.values():
        assert README.count(f"(`{claim.id}`)") == 1
    assert len(FIGURES) == 10


def test_what_the_page_links_to_is_there_and_small() -> None:
    links = re.findall(r"\]\((?!http)([^)]+)\)", README)
    anchors = {link for link in links if link.startswith("#")}
    assert anchors == {"#what-the-text-leaves-open"}
    assert "\n## What the text leaves open\n" in README
    assert {Path(link).suffix for link in {*links} - anchors} == {".png", ".py"}
    for link in {*links} - anchors:
        assert (run.HERE / link).is_file(), link
    figures = sorted((run.HERE / "figures").iterdir())
    assert [path.stem for path in figures] == sorted(FIGURES)
    assert sum(path.stat().st_size for path in figures) < 1_200_000


def test_the_page_has_whole_tables_and_its_counts_and_values_first() -> None:
    for block in re.findall(r"(?:^\|.*\|\n)+", README, re.M):
        assert len({line.count("|") for line in block.splitlines()}) == 1, block[:200]
    assert "nan" not in README.split()
    assert "−0.0 " not in README
    verdicts = [entry["verdict"] for entry in RESULTS["claims"] if entry["kind"] == "finding"]
    counted = ", ".join(f"{v} {verdicts.count(v)}" for v in ClaimVerdict if v in verdicts)
    assert f"{len(verdicts)} findings: {counted}." in README
    for order in ("as written", "swapped"):
        assert f"{RESULTS['values'][order]['non-directive']:.2f} with its “respect" in README
    assert "142.07" in (ROOT / "README.md").read_text("utf-8")
    for entry in RESULTS["claims"]:
        failed = f"- {entry['says']} `{entry['name']}`: {entry['why']}."
        assert (failed in README) == (entry["verdict"] == ClaimVerdict.NOT_REPRODUCED), entry[
            "name"
        ]
        assert bool(entry["exact_is"]) == (entry["exact"] is not None), entry["name"]
        if entry.get("count") == 0:
            assert f"| under {entry['chance_below']:.3f}, {entry['exact_is']} |" in README
        assert (
            not entry["exact_is"] or f", {entry['exact_is']} | {entry['verdict_says']} |" in README
        )


def test_the_page_begins_with_the_answer_and_counts_facts() -> None:
    top, _, rest = README.partition("\n## Results\n")
    assert len(top) < 5500
    for row in RESULTS["advice"]:
        paper = ", ".join(row["paper_differs"]) or ("the same" if row["mentioned"] else "not in")
        best = f"**{row['best']}**" if row["paper_differs"] else row["best"]
        assert f"\n| {row['person']} | {best} | {paper}" in top
    assert "(figures/cost_of_choices.png)" in top
    assert README.count("(figures/") == len(FIGURES)
    assert "The 6 claims that are not reproduced come down to 3 facts:" in rest


def test_verdicts_on_returns_of_the_reading_chosen_by_them_are_marked() -> None:
    for entry in RESULTS["claims"]:
        verdict = entry["verdict_under_best_supported_reading"]
        if verdict:
            mark = " (circular)" if entry["name"].startswith("return.") else ""
            (row,) = re.findall(rf"^.*\(`{re.escape(entry['name'])}`\).*$", README, re.M)
            assert f"| {verdict}{mark} |" in row


def test_the_page_names_every_open_point_with_its_options_and_its_place() -> None:
    assert [*OPTIONS] == [*READINGS, "respectively"]
    assert {point: tuple(options) for point, options in POINTS.items()} == READINGS
    assert [*OPTIONS["respectively"]] == [*ORDERS]
    for name, options in OPTIONS.items():
        (row,) = re.findall(rf"^\| `readings\.{name}` \|.*$", README, re.M)
        point = PAPER["open_points"][name]
        assert point["place"] in PLACES
        assert f"{point['place']}: “{point['words']}”: {point['asks']} |" in row
        for option, means in options.items():
            assert f"`{option.replace(' ', '-')}`: {means}, " in row


def test_the_command_on_the_page_works_out_a_claim_under_the_best_supported_reading() -> None:
    (command,) = re.findall(r"exact_mdp\.paper_repro (claim return\.together [^`]*)\n```", README)
    (together,) = (e for e in RESULTS["claims"] if e["name"] == "return.together")
    says = together["verdict_under_best_supported_reading"]
    assert says.startswith("compatible, p = 0.8")
    assert f"verdict: {says}\n" in ask(main, command.replace("\\\n", "")).out


@pytest.mark.parametrize(
    ("file", "order"), [("reported.json", "as written"), ("reported_swapped.json", "swapped")]
)
def test_the_reported_policy_is_a_file_with_the_value_that_the_page_gives(
    file: str, order: str
) -> None:
    policy = run.HERE / file
    assert json.loads(policy.read_text("utf-8")) == build_default_reading().find_reported_policy(
        FINAL, order
    )
    value = evaluate(build_default_reading().mdp, policy).mean
    assert run.round_numbers(value) == RESULTS["values"][order][FINAL]
    assert file in README


# ---- figures -------------------------------------------------------------------------------------


def test_figures_of_learning_are_drawn(tmp_path: Path) -> None:
    reading = build_default_reading(runs=3)
    for name in LEARNED:
        assert all(
            path.stat().st_size > 5000 for path in save_figure(FIGURES[name], reading, tmp_path)
        )


# ---- commands ------------------------------------------------------------------------------------


def test_claims_are_listed_with_their_places() -> None:
    printed = ask(main, "list").out
    assert max(map(len, printed.splitlines())) <= 100
    *claims, figures = re.sub(r"\n +", " ", printed).splitlines()
    assert figures.startswith("figures: ")
    assert "flow (Figure 2)" in figures
    for line, claim in zip(claims, CLAIMS.values(), strict=True):
        assert line == f"{claim.id} ({', '.join(claim.places)}) {claim.says}"


def test_one_claim_alone_and_under_another_reading() -> None:
    done = ask(main, "claim policy.0100")
    assert done.status == 0
    assert "not reproduced" in done.out
    assert "17 of 17 with one change have the same verdict\n" in done.out
    together = ask(main, "claim return.together").out
    assert "14 of 17 with one change have the same verdict\n" in together
    assert "p = 0:" not in together
    assert "\n    compatible, p = 0.0085: “respectively” swapped\n" in together
    swapped = ask(main, "claim return.together --set readings.respectively=swapped").out
    assert re.search(r"verdict: +compatible, p = 0\.0085\n", swapped)
    change = "readings.task_bonus=no-subtask-skipped"
    verdict = r"verdict: +depends on the reading; not reproduced under the default one"
    assert re.search(verdict, ask(main, "claim return.random").out)
    assert re.search(r"verdict: +reproduced", ask(main, "claim return.random --set", change).out)
    few = ask(main, "claim learning.superior --runs 2 --set training.ties=random").out
    assert re.search(r"verdict: +not determined, seen in 100 % of 4 runs\n", few)


@pytest.mark.parametrize(("line", "said"), entries(__file__))
def test_what_cannot_be_done_is_bad_input(line: str, said: str) -> None:
    assert said in ask(main, line).refusal()


def test_numbers_are_rounded_to_what_every_processor_gives_and_bounds_stay_true() -> None:
    claims = [{"exact": 146.23587074344982 + off, "error_bound": 7e-13 + off} for off in (0, 3e-14)]
    one, other = run.round_numbers(claims)
    assert one == other == {"exact": 146.2358707, "error_bound": 5.1e-08}
    assert abs(one["exact"] - claims[0]["exact"]) + 7e-13 <= one["error_bound"]
    others = {"weights": (1e-30 / 3, 2), "none": None, "label": "1.23456789012345", "is": True}
    assert run.round_numbers(others) == others | {"weights": [3.333333333e-31, 2]}
    assert run.round_numbers({"exact": 0.0, "error_bound": 1e-9})["error_bound"] == 1e-9


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_two_kinds_of_processors_write_the_same_results(tmp_path: Path) -> None:
    """OpenBLAS takes the kernels of another processor, which add up in another order."""
    written = []
    for kind in ("Haswell", "Sandybridge"):
        words = [sys.executable, "-m", "paper_repro", "--quick", "--out", str(tmp_path / kind)]
        chosen = {**os.environ, "OPENBLAS_CORETYPE": kind}
        subprocess.run(words, cwd=ROOT, env=chosen, capture_output=True, check=True)
        written.append((tmp_path / kind / "results.json").read_bytes())
    assert written[0] == written[1]


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_the_quick_reproduction_writes_every_file_and_the_pinned_numbers(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "paper_repro", "--quick", "--out", str(tmp_path)]
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stderr == ""  # no warning, no difference from what is pinned
    files = {path.name for path in tmp_path.iterdir()}
    assert files == {"numbers.json", "results.json", "report.md", "run.json", "figures"}
    rows = json.loads((tmp_path / "numbers.json").read_text("utf-8"))
    assert all(
        {"name", "source", "paper", "exact", "difference", "claim"} <= set(row) for row in rows
    )
    assert all(row["exact"] is not None for row in rows)
    pinned = json.loads((FOLDER / "numbers.json").read_text("utf-8"))
    assert [row["name"] for row in rows] == [old["name"] for old in pinned]
    for old, row in zip(pinned, rows, strict=True):
        assert differences({"answer": old}, {"answer": trimmed(row)}) == [], old["name"]
    assert all(claim in done.stdout for claim in CLAIMS)
    assert f"All {len(CLAIMS)} claims are as pinned in expected.toml" in done.stdout
    record = json.loads((tmp_path / "run.json").read_text("utf-8"))
    assert record["quick"]
    assert record["training_runs"] == 100
    assert record["commit"]
    assert len(list((tmp_path / "figures").iterdir())) == 2 * len(FIGURES)
