"""What the command line prints: tables, strict JSON, help."""

import json
import re
import subprocess
from fractions import Fraction
from pathlib import Path

import pytest
from cli_runner import PROGRAM, launch, run

from exact_mdp import MDP, Policy, evaluate, load, save

# ---- what it prints --------------------------------------------------------------------------


def test_tables_are_plain_text_without_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    for width in ("40", "100"):
        monkeypatch.setenv("COLUMNS", width)
        for line in ("info tea", "solve yuan2025", "evaluate yuan2025 random", "solve tea"):
            done = run(line)
            assert done.status == 0
            assert "\x1b" not in done.out
            assert "…" not in done.out
            assert max(len(text) for text in done.out.splitlines()) <= int(width)
            assert all(text == text.rstrip() for text in done.out.splitlines())
    assert re.search(r"^start value +84\.9137\d+ +\(bounded, within \S+\)$", done.out, re.MULTILINE)
    assert re.search(r"^101 +demonstrate$", done.out, re.MULTILINE)


SMALL = "--set tasks=[1] --set max_trial=2"
TEXTS = {
    f"psa yuan2025 {SMALL} --samples 30 --n-jobs 1": "EVPI|share of draws|expected loss|re-solved",
    f"tornado yuan2025 {SMALL} --policy random": "start value at both ends, policy held fixed",
    f"threshold yuan2025 {SMALL} --parameter base.anger": "start value",
    f"one-way yuan2025 {SMALL} --parameter base.anger --points 3": "0.04",
    f"robust yuan2025 {SMALL} --set-kind kl --radius 1/100": "worst case",
    f"robust yuan2025 {SMALL} --set-kind box --relative 1/10": "worst case",
    f"tradeoff yuan2025 {SMALL} anger steps --policy random": "policies beside the front",
    "train tea --seeds 4 --learner epochs=5": "mean regret|of the runs end optimal|95 %",
    "evaluate gymnasium:CliffWalking-v1 always:0 --discount 0.9": "it may never end",
    f"simulate yuan2025 random {SMALL} --episodes 50": "(estimated, standard error ",
    "solve yuan2025 --certify --set tasks=[40]": "a rational of 2,783 digits; --json prints it",
    "returns yuan2025 random --set reward.anger=-5.1": "(the first 1,000 of 2,512; --json",
    "check yuan2025 random --no-explain": "FAILED|the costliest first|value lost",
}


@pytest.mark.parametrize("line", TEXTS)
def test_people_read_words_and_tables(line: str) -> None:
    done = run(line)
    assert done.status == line.startswith("check")
    assert [words for words in TEXTS[line].split("|") if words not in done.out] == []


VARIED = f"yuan2025 {SMALL} --parameter base.anger"
TABLES = {
    f"tornado {VARIED}": "start value at both ends, policy re-optimised",
    f"gradient {VARIED}": "derivatives of the start value",
    f"curve {VARIED}": "pieces of the optimal value",
    f"one-way {VARIED} --points 3": "value at the start",
    f"two-way {VARIED} --parameter discount --points 2": "value at the start",
    f"sobol {VARIED} --samples 4": "shares of the variance of the start value",
    f"psa {VARIED} --samples 30 --n-jobs 1": "policies held fixed in every draw",
    f"tradeoff yuan2025 {SMALL} anger steps": "",
    f"evaluate yuan2025 {SMALL} random": "",
    f"check yuan2025 {SMALL} random": "",
}


@pytest.mark.parametrize("line", TABLES)
def test_each_table_is_printed_with_its_rows(line: str) -> None:
    """A report without its table looks complete: nothing else says that the table is missing."""
    lines = run(line).out.splitlines()
    rules = [number for number, text in enumerate(lines) if text.startswith("─")]
    assert rules
    titles = [number for number, text in enumerate(lines) if text.startswith(TABLES[line])]
    assert any(title < rule <= title + 4 for title in titles for rule in rules)
    assert all(lines[rule + 1].strip() for rule in rules)


def test_names_of_states_are_printed_as_they_are(tmp_path: Path) -> None:
    names = ["[bold]no markup[/bold]", "Zustand β :smile:"]
    mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0], states=names, actions=["[red]go"])
    path = tmp_path / "model.npz"
    save(mdp, path)
    result = run("solve", path, "--json").result
    assert result["policy_by_state"] == dict.fromkeys(names, "[red]go")
    assert all(name in run("solve", path).out for name in [*names, "[red]go"])
    done = launch("solve", path, PYTHONIOENCODING="ascii")
    assert done.status == 0
    assert "Zustand \\u03b2 :smile:" in done.out


def test_a_policy_that_is_printed_can_be_read(tmp_path: Path) -> None:
    """By status where nothing else decides, otherwise by state."""
    words = [*SMALL.split(), "anger", "trial"]
    mdp, path, sizes = load("yuan2025", sets=words[1:4:2]), tmp_path / "p.json", set()
    for vertex in run("tradeoff yuan2025", *words, "--json").result["vertices"]:
        path.write_text(json.dumps(vertex["policy"]), "utf-8")
        totals = evaluate(mdp, Policy.of(mdp, path)).components
        for name, value in vertex["values"].items():
            assert totals[name] == pytest.approx(float(Fraction(value)))
        sizes.add(len(vertex["policy"]))
    assert sizes == {16, mdp.n_states}


# ---- the program -----------------------------------------------------------------------------


def test_the_program_keeps_its_promises_to_scripts() -> None:
    done = launch("solve yuan2025 --json")
    assert json.loads(done.out)["model"] == "yuan2025"
    assert (done.status, done.err) == (0, "")
    done = launch("solve yuan2026 --json")
    assert (done.status, done.out) == (2, "")
    assert done.err.startswith("ModelError: unknown model 'yuan2026'\n  where: ")
    version = launch("--version")
    assert (version.status, version.out) == (0, "exact-mdp 0.1.0\n")


def test_a_closed_pipe_is_no_error() -> None:
    words = [PROGRAM, "returns", "yuan2025", "random", "--set", "tasks=[1]"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == 141


def test_every_command_has_help() -> None:
    listed = re.findall(r"^  ([a-z][\w-]+)  +\w", run("--help").out, re.M)
    assert len(listed) >= 25
    for name in listed:
        text = run(name, "--help").out
        assert text.startswith(f"Usage: exact-mdp {name} [OPTIONS]")
        assert not re.search(r"^  \[?[A-Z]+[.\]]*$", text, re.M)  # arguments stand in the usage
        options = re.findall(r"^  (-.*(?:\n {6,}\S.*)*)", text, re.M)
        assert options[-1].startswith("-h, --help  ")
        assert max(map(len, text.splitlines())) <= 80
        once = name in ("curve", "one-way")
        assert not (once and "moves. May be repeated" in " ".join(text.split()))
        for option in options:  # behind two blanks, or on a line of its own, it says what it does
            assert re.search(r"(  +|\n {6,})\S+ \S", option), option


@pytest.mark.parametrize(
    ("words", "notice"),
    [
        ("evaluate yuan2025 random", True),
        ("gradient tea --parameter reward.anxiety", True),
        ("info gymnasium:FrozenLake-v1", False),
    ],
)
def test_what_concerns_care_says_that_it_is_no_medical_advice(words: str, notice: bool) -> None:
    assert ("no medical advice" in run(words).out) == notice
    done = run(words, "--json")
    assert ("no medical advice" in json.loads(done.out).get("notice", "")) == notice
    assert "medical" not in done.err
