"""The linter against the reader: the same faults, all at once, with the line and the remedy."""

import re
import tomllib
import warnings
from itertools import permutations
from pathlib import Path
from typing import Any

import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from own_scenarios import PACKAGE, SHIPPED, own_text, scenario_of
from refusal_tables import of_file, refused

from exact_mdp import ModelError, Scenario

(TEMPLATE,) = (path.read_text("utf-8") for path in PACKAGE.glob("mdp/**/template.toml"))
OWN = own_text(3, 3)


def lint(text: str) -> list[dict[str, Any]]:
    return of_file("x.toml", text, lambda path: run("lint", path, "--json").result["problems"])


FAULTS = [  # what a line of the template becomes, what is said of it, and the remedy
    ("frustration = 0.8", "frustraton = 0.8", "unknown number", "persistence.frustration?"),
    ("persistence = 0.2", "persistence = '20 %'", "not a finite", "write"),
    ("onset = 0.05", "onset = -0.05", "outside [0, 1]", "in that range"),
    ("frustration = 0.1", "frustration = true", "not a number", "write"),
    ("frustration = 0.1", "frustration = [1]", "not a number", "write"),
    ("frustration = 0.1", "anger = 0.1", "base.anger", "base.frustration"),
    ("frustration = 0.1", "", "the number base.frustration is missing", "state it"),
    ('= ["wait"', '= [1, "wait"', "actions is not a list of different names", "write"),
    ('"soothe"]', '"wait"]', "actions is not a list of different names", "write"),
    ('"soothe"]', '"skip"]', "an action is named 'skip'", "another name"),
    ('"frustration"]', '"frus.tration"]', "statuses is not a list of different", "without dots"),
    ("tasks = [2]", "tasks = [0]", "tasks is not a list", "[3, 1]"),
    ("tasks = [2]", "tasks = []", "tasks is not a list", "[3, 1]"),
    ("tasks = [2]", "tasks = [2, 'x']", "tasks is not a list", "[3, 1]"),
    ("max_trial = 3", "max_trial = 0", "max_trial is 0", "1 or more"),
    ("max_trial = 3", "max_trial = true", "max_trial is True", "1 or more"),
    ("max_trial = 3", "", "max_trial is 'missing'", "1 or more"),
    ("discount = 1", "discount = 95", "outside [0, 1]", "from 0 to 1"),
    ("timestep = 0", "timestap = 0", "unknown number 'reward.timestap'", "reward.timestep?"),
    ("[readings]", "[readings]\nskip_onsets = 'base'", "unknown reading", "skip_onset?"),
    ("[readings]", "[readings]\nskip_onset = 'never'", "unknown option", "base"),
    ("[readings]", "readings = 3", "not a table", "[readings]"),
    ("[base]", "[bases]", "unknown key 'bases'", "base?"),
    ("title =", "colour = 1\ntitle =", "unknown key 'colour'", ""),
    ("title =", "name = 3\ntitle =", "name is not a string", "quotes"),
    ("[skip.frustration]", "[skip.frustration]\nother = 'anger'", "other status", "forgetfulness"),
    ("persistence = 0.5", "other = 'frustration'\nalone = 0", "with-other is missing", "state it"),
    (
        "[assistance.prompt.f",
        "[assistance.pormpt.f",
        "pormpt.forgetfulness.o",
        "prompt.forgetfulness",
    ),
    (
        "[assistance.prompt.f",
        "[assistance.prompt.h",
        "prompt.horgetfulness.o",
        "prompt.forgetfulness",
    ),
    ("[status_weight]", "[status_weight]\nfrustration = 'trial'", "same name", "of its own"),
    ("[status_weight]", "[status_weight]\nanger = 'x'", "unknown status 'anger'", ""),
]


def test_the_template_explains_every_key_and_solves() -> None:
    scenario = scenario_of(TEMPLATE)
    assert lint(TEMPLATE) == []
    assert scenario.compile().n_states == 2 * 3 * 4 + 1
    with_options = re.sub(r"^# (\w+ = \"[\w-]+\" *#)", r"\1", TEMPLATE, flags=re.MULTILINE)
    assert tomllib.loads(with_options)["readings"].keys() == scenario.readings.keys()
    assert lint(with_options) == []


@pytest.mark.parametrize("name", SHIPPED)
def test_nothing_is_said_of_shipped_scenarios(name: str) -> None:
    assert lint(SHIPPED[name]) == []


@pytest.mark.parametrize(("old", "new", "what", "fix"), FAULTS)
def test_each_fault_is_refused_and_found(
    old: str, new: str, what: str, fix: str, tmp_path: Path
) -> None:
    """The linter names the line that is new; what is missing, or of several, is its table's."""
    assert old in TEMPLATE
    text, path = TEMPLATE.replace(old, new, 1), tmp_path / "own.toml"
    path.write_text(text, encoding="utf-8")
    refused(lambda: Scenario.load(path), "", str(path))
    (problem,) = [each for each in lint(text) if what in each["what"]]
    assert fix in problem["fix"]
    assert problem["severity"] == "error"
    lines = text.split("\n")
    added = [line for line in lines if line not in TEMPLATE.split("\n")]
    several = what == "same name" or "missing" in what or old.startswith("[assistance")
    assert several or lines[problem["line"] - 1] in added


MORE = [  # names, numbers that are missing, tables
    ("[reward]\n", "[assistance.sooth.forgetfulness]\npersistence = 0.2\n[reward]\n"),
    ("[reward]\n", "[skip.calm]\npersistence = 0.5\n[reward]\n"),
    ("[skip.forgetfulness]\npersistence = 0.5\n", ""),
    ("[skip.frustration]\npersistence = 0.5\n", ""),
    ("subtask-skip = -8\n", ""),
    ("source =", "sorce ="),
    ("[base]\n", "[basis]\nforgetfulness = 0.1\n[base]\n"),
]
# What hides the names of others.
HIDING = ("[assistance.p", "[bases]", "readings = 3", "other =", "[skip.frustration]\n")


def problems_of(text: str) -> set[str]:
    return {re.sub(r"\d+", "N", each["what"]) for each in lint(text)}


def test_no_fault_hides_another_one() -> None:
    """Except that names cannot be judged where the list of them, or the table, is wrong."""
    faults = [*((old, new) for old, new, *_ in FAULTS if '"' not in f"{old}{new}"), *MORE]
    alone = {fault: problems_of(TEMPLATE.replace(*fault, 1)) for fault in faults}
    assert all(alone.values())
    pairs = 0
    for fault, other in permutations(faults, 2):
        text = TEMPLATE.replace(*fault, 1)
        if other[0] in text and not other[1].startswith(HIDING):
            assert alone[fault] <= problems_of(text.replace(*other, 1)), (fault, other)
            pairs += 1
    assert pairs > 0.8 * len(faults) * (len(faults) - 1)


def test_lines_are_those_of_the_keys_however_they_are_written() -> None:
    text = TEMPLATE.replace("[readings]", "[readings] # a\nskip_onset = 'no'", 1)
    text = text.replace('title = "', 'title = """\n[base]\nforgetfulness = 3 # ', 1)
    text = text.replace('scenario"\n', 'scenario """ # """ and more\n', 1)
    text = text.replace("[base]\nforgetfulness = 0.3", '[ base ]\n"forgetfulness" = 3', 1)
    text = text.replace("[reward.assist]", "[ reward . 'assist' ]", 1)
    text = text.replace("wait = 0", "wait = true", 1)
    lines = {each["line"]: each["what"] for each in lint(text)}
    rows = text.split("\n")
    assert [rows[line - 1] for line in lines if line] == [
        "skip_onset = 'no'",
        '"forgetfulness" = 3',
        next(row for row in rows if row.startswith("wait = true")),
    ]


@pytest.mark.parametrize(
    ("old", "new", "what", "lines"),
    [
        ("base]", "base", "broken TOML", 1),
        ("max_trial = 3", "max_trial = 3\nmax_trial = 4", "broken TOML", 2),
        ("forgetfulness = 0.3", "forgetfulness = 30%", "broken TOML", 1),
        ("forgetfulness = 0.3", "forgetfulness = nan", "'nan' is not a finite", None),
        ("forgetfulness = 0.3", "forgetfulness = 1e99999", "'1e99999' has an exponent", None),
    ],
)
def test_a_text_that_is_not_toml_has_one_problem(
    old: str, new: str, what: str, lines: int | None
) -> None:
    before, after = TEMPLATE.split(old, 1)
    (problem,) = lint(before + new + after)
    assert problem["line"] == (lines and before.count("\n") + lines)
    assert problem["what"].startswith(what)
    assert problem["severity"] == "error"
    assert is_refused(before + new + after)


def test_suspicions_are_warnings() -> None:
    text = TEMPLATE.replace("frustration = -4", "frustration = 4").replace(
        "frustration = 0.1\n\n# ...", "frustration = 0.95\n\n# ..."
    )
    clipped, sign = lint(text)
    rows = text.split("\n")
    assert (sign["severity"], rows[sign["line"] - 1]) == ("warning", "frustration = 4")
    assert sign["fix"] == "did you mean -4?"
    assert (clipped["severity"], rows[clipped["line"] - 1]) == ("warning", "frustration = 0.95")
    assert "1.05 is cut off at 1" in clipped["what"]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        scenario_of(text).compile()


def is_refused(text: str) -> bool:
    try:
        scenario_of(text)
    except ModelError:
        return True
    return False


ODD = [*"[]=.'{}#\n\r0-\0\ufeff\u202e", "[[", "nan", "1e999999999", "1/0", "skip = 3\n", "9" * 999]
EDITS = st.sampled_from(["", *'01-.=[]"#x% ', "\n", "s0", "a1", *ODD])


@settings(max_examples=100)
@given(data=st.data(), text=st.sampled_from([TEMPLATE, OWN, *SHIPPED.values()]))
def test_an_error_is_found_exactly_where_the_reader_refuses(data: st.DataObject, text: str) -> None:
    for _ in range(data.draw(st.integers(1, 4))):
        place, cut = data.draw(st.integers(0, len(text))), data.draw(st.integers(0, 6))
        text = text[:place] + data.draw(EDITS) + text[place + cut :]
    errors = [each for each in lint(text) if each["severity"] == "error"]
    assert bool(errors) == is_refused(text), errors
    for each in errors:
        assert each["what"]
        assert each["fix"]
        assert each["line"] is None or 1 <= each["line"] <= len(text.split("\n"))


@pytest.mark.parametrize("odd", ["\\u0000", "\\uFEFF", "\\u202E", "x" * 1001])
@pytest.mark.parametrize("name", ["forgetfulness", "soothe"])
def test_unsafe_names_are_problems(name: str, odd: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.toml"
    text = TEMPLATE.replace(f'"{name}"', f'"{odd}{name}"', 1)
    path.write_text(text, encoding="utf-8")
    done = run("lint", path, "--json")
    assert done.status == 1
    problems = [each["what"] for each in done.result["problems"]]
    assert any("contains the character" in each or "characters" in each for each in problems)
    assert is_refused(text)


# ---- commands ---------------------------------------------------------------------------------


def test_new_writes_the_template_and_lint_finds_what_is_changed(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    made = run("new", path, "--json")
    assert made.result.keys() == {"format", "written", "notice"}
    assert made.result["written"] == str(path)
    assert "no medical advice" in made.result["notice"]
    assert path.read_text("utf-8") == TEMPLATE
    assert run("lint", path, "--json").result["problems"] == []
    assert "there already" in run("new", path).refusal()
    path.write_text(path.read_text("utf-8").replace("trial = -1", "trial = 1"), encoding="utf-8")
    done = run("lint", path, "--json")
    assert done.status == 1
    (problem,) = done.result["problems"]
    assert problem.keys() == {"line", "what", "fix", "severity"}
    assert "reward.trial is 1" in run("lint", path).out
    for words in (("new", tmp_path / "x.json"), ("lint", tmp_path / "none.toml"), ("lint", "tea")):
        run(*words).refusal()


@pytest.mark.parametrize(
    "line", ["a = " + "[" * 100_000, "a." * 3000 + "a = 1", "a = " + "{a = " * 5000]
)
def test_a_text_that_is_nested_too_deeply_is_a_problem(line: str, tmp_path: Path) -> None:
    (tmp_path / "deep.toml").write_text(line)
    assert run("lint", tmp_path / "deep.toml").status == 1
