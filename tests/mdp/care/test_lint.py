"""The linter against the reader: the same faults, all at once, with the line and the remedy."""

from __future__ import annotations

import json
import re
import warnings
from importlib.resources import files
from itertools import permutations
from pathlib import Path
from urllib.request import url2pathname

import jsonschema
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from own_scenarios import own_text

from exact_mdp.analysis.pages.page import ADVICE
from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.mdp.care import schema
from exact_mdp.mdp.care.lint import lint
from exact_mdp.mdp.care.toml import KEYS, Reader, parse, shipped
from exact_mdp.mdp.io.structured import toml_of

CARE = files("exact_mdp.mdp.care")
TEMPLATE = (CARE / "template.toml").read_text(encoding="utf-8")
OWN = own_text(3, 3)

FAULTS = [  # what a line becomes, what is said of it, and the remedy
    ("forgetfulness = 0.3", "forgetfulness = 30%", "cannot be read: 30%", "= 0.3"),
    ("forgetfulness = 0.9", "forgetfulness = 90", "outside [0, 1]", "did you mean 0.9?"),
    ("frustration = 0.8", "frustraton = 0.8", "unknown number", "persistence.frustration?"),
    ("forgetfulness = 0.2", "forgetfulness = 0,2", "cannot be read", "= 0.2"),
    ("persistence = 0.2", "persistence = '20 %'", "not a finite", "did you mean 0.2?"),
    ("onset = 0.05", "onset = -0.05", "outside [0, 1]", "did you mean 0.05?"),
    ("persistence = 0.1", "persistence = 2/3", "cannot be read", '= "2/3"'),
    ("onset = 0\n", "onset = .5\n", "cannot be read", "= 0.5"),
    ("actions = [", "actions = [wait, ", "cannot be read", 'write actions = ["wait", "wait"'),
    ("tasks = [2]", "tasks = [0]", "tasks is not a list", "[3, 1]"),
    ("max_trial = 3", "max_trial = 3\nmax_trial = 4", "given twice, first in line", "keep one"),
    ("discount = 1", "discount = 95", "outside [0, 1]", "did you mean 0.95?"),
    ("timestep = 0", "timestap = 0", "unknown number 'reward.timestap'", "reward.timestep?"),
    ("wait = 0", "wait = no", "cannot be read", "a number"),
    ("[status_weight]", "[base]", "[base] stands twice, first in line", "join"),
    ("[readings]", "[readings]\nskip_onsets = 'base'", "unknown reading", "skip_onset?"),
    ("trial = -1\n", "trial -1\n", "neither", "correct that line"),
]


def test_the_template_explains_every_key_and_solves() -> None:
    scenario = parse(TEMPLATE, Scenario)
    assert lint(TEMPLATE, "template") == ()
    assert set(KEYS) <= set(re.findall(r"^#? ?\[?([a-z_]+)", TEMPLATE, re.MULTILINE))
    assert scenario.compile().n_states == 2 * 3 * 4 + 1
    with_options = re.sub(r"^# (\w+ = \"[\w-]+\" *#)", r"\1", TEMPLATE, flags=re.MULTILINE)
    assert set(Reader(toml_of(with_options, "x")).content["readings"]) == set(scenario.readings)
    assert lint(with_options, "x") == ()


@pytest.mark.parametrize("name", shipped())
def test_nothing_is_said_of_shipped_scenarios(name: str) -> None:
    text = (files("exact_mdp.mdp") / "scenarios" / f"{name}.toml").read_text(encoding="utf-8")
    assert lint(text, name) == ()


@pytest.mark.parametrize(("old", "new", "what", "fix"), FAULTS)
def test_each_fault(old: str, new: str, what: str, fix: str) -> None:
    assert old in TEMPLATE
    before, after = TEMPLATE.split(old, 1)
    (found,) = [each for each in lint(before + new + after, "x") if what in each.what]
    fault = before.count("\n") + 1 + new.rstrip("\n").count("\n")
    assert (found.line, found.severity) == (fault, "error")
    assert fix in found.fix
    assert found.text == (before + new + after).split("\n")[fault - 1].strip()


def test_all_faults_at_once() -> None:
    text = TEMPLATE
    for old, new, _, _ in FAULTS:
        text = text.replace(old, new, 1)
    lines = [each.line or 10**6 for each in lint(text, "x")]
    assert lines == sorted(lines)
    found = [f"{each.what} {each.fix}" for each in lint(text, "x")]
    for _, _, what, fix in FAULTS:
        assert any(what in each and fix in each for each in found), (what, fix)
    assert len(found) <= len(FAULTS) + 3  # the trial weight of the broken line is missing, too


@pytest.mark.parametrize(
    ("old", "new", "guess"),
    [
        ("discount = 1", "discount = 1.5", None),
        ("discount = 1", "discount = 12.5", None),
        ("discount = 1", "discount = 2", None),
        ("discount = 1", "discount = 101", None),
        ("discount = 1", "discount = -0.95", "0.95"),
        ("discount = 1", "discount = '150 %'", None),
        ("onset = 0.05", "onset = 1.5", None),
        ("onset = 0.05", "onset = 12.5", "0.125"),
        ("onset = 0.05", "onset = '-5 %'", None),
        ("max_trial = 3", "max_trial = '50 %'", None),
        ("[readings]", "[readings]\nskip_onset = '2'", None),
        ("wait = 0", "wait = '-300 %'", "-3"),
    ],
)
def test_only_numbers_that_may_stand_there_are_guessed(
    old: str, new: str, guess: str | None
) -> None:
    (found,) = lint(TEMPLATE.replace(old, new, 1), "x")
    numbers = re.findall(r"^did you mean (-?[\d.]+)\?", found.fix)
    assert numbers == ([guess] if guess else [])


MORE = [  # what only the whole file shows: names, numbers that are missing, tables
    ("[assistance.prompt.forgetfulness]", "[assistance.pormpt.forgetfulness]"),
    ("[reward]\n", "[assistance.pormpt.forgetfulness]\npersistence = 0.2\n[reward]\n"),
    ("[reward]\n", "[skip.calm]\npersistence = 0.5\n[reward]\n"),
    ("[skip.forgetfulness]\npersistence = 0.5\n", ""),
    ("[skip.frustration]\npersistence = 0.5\n", ""),
    ("subtask-skip = -8\n", ""),
    ("source =", "sorce ="),
    ("[base]\n", "[basis]\nforgetfulness = 0.1\n[base]\n"),
    ("[readings]", "influence = {anger = {}}\n[readings]"),
]
RELATED = {("onset = -0.05", MORE[0][1])}  # the second one makes the first one's name unknown


def said(text: str) -> set[str]:
    return {re.sub(r"\d+", "N", each.what) for each in lint(text, "x")}


def test_no_fault_hides_another_one() -> None:
    faults = [*(each[:2] for each in FAULTS), *MORE]
    alone = {fault: said(TEMPLATE.replace(*fault, 1)) for fault in faults}
    assert all(alone.values())
    pairs = 0
    for fault, other in permutations(faults, 2):
        text = TEMPLATE.replace(*fault, 1)
        if other[0] in text and (fault[1], other[1]) not in RELATED:
            assert alone[fault] <= said(text.replace(*other, 1)), (fault, other)
            pairs += 1
    assert pairs > 0.9 * len(faults) * (len(faults) - 1)


def test_suspicions_are_warnings() -> None:
    text = TEMPLATE.replace("frustration = -4", "frustration = 4").replace(
        "frustration = 0.1\n\n# ...", "frustration = 0.95\n\n# ..."
    )
    sign, clipped = sorted(lint(text, "x"), key=lambda each: "cut off" in each.what)
    assert (sign.severity, sign.text) == ("warning", "frustration = 4")
    assert sign.fix == "did you mean -4?"
    assert clipped.severity == "warning"
    assert "1.05 is cut off at 1" in clipped.what
    assert clipped.text == "frustration = 0.95"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        parse(text, Scenario).compile()


def refused(text: str) -> bool:
    try:
        parse(text, Scenario)
    except ModelError:
        return True
    return False


EDITS = st.sampled_from(["", *'01-.=[]"#x% ', "\n", "s0", "a1"])


@settings(max_examples=60, deadline=None)
@given(data=st.data(), text=st.sampled_from([TEMPLATE, OWN]))
def test_an_error_is_found_exactly_where_the_reader_refuses(data: st.DataObject, text: str) -> None:
    for _ in range(data.draw(st.integers(1, 4))):
        place, cut = data.draw(st.integers(0, len(text))), data.draw(st.integers(0, 6))
        text = text[:place] + data.draw(EDITS) + text[place + cut :]
    found = [each for each in lint(text, "x") if each.severity == "error"]
    assert bool(found) == refused(text), found
    lines = text.split("\n")
    for each in found:
        assert each.what
        assert each.fix
        assert each.line is None or each.text == lines[each.line - 1].strip()


ODD = [*"[]=.'{}#\n\r0-\0\ufeff\u202e", "[[", "nan", "1e999999999", "1/0", "skip = 3\n", "9" * 999]
SHIPPED = [
    (files("exact_mdp.mdp") / "scenarios" / f"{name}.toml").read_text("utf-8") for name in shipped()
]


@settings(max_examples=40, deadline=None)
@given(data=st.data(), text=st.sampled_from(SHIPPED))
def test_lint_lists_what_is_wrong_with_any_text(data: st.DataObject, text: str) -> None:
    for _ in range(data.draw(st.integers(1, 4))):
        place, cut = data.draw(st.integers(0, len(text))), data.draw(st.integers(0, 30))
        text = text[:place] + data.draw(st.sampled_from(ODD)) + text[place + cut :]
    assert any(each.severity == "error" for each in lint(text, "x")) == refused(text)


@pytest.mark.parametrize("odd", ["\\u0000", "\\uFEFF", "\\u202E", "x" * 1001])
@pytest.mark.parametrize("name", ["forgetfulness", "soothe"])
def test_unsafe_names_are_problems_among_others(name: str, odd: str, tmp_path: Path) -> None:
    path = tmp_path / "odd.toml"
    text = TEMPLATE.replace(f'"{name}"', f'"{odd}{name}"', 1).replace("timestep = 0\n", "")
    path.write_text(text, encoding="utf-8")
    done = run("lint", path, "--json")
    assert done.status == 1
    told = [each["what"] for each in done.result["problems"]]
    assert any(each.startswith("the name of a") for each in told)
    assert "the number reward.timestep is missing" in told
    assert refused(text)


# ---- schema and commands ---------------------------------------------------------------------


def test_the_shipped_schema_is_that_of_the_keys() -> None:
    assert schema.FILE.read_text(encoding="utf-8") == schema.text()
    assert set(schema.schema()["properties"]) == set(KEYS)


@pytest.mark.parametrize("text", [TEMPLATE, OWN])
def test_the_schema_takes_what_the_reader_takes(text: str) -> None:
    check = jsonschema.Draft7Validator(schema.schema())
    content = json.loads(json.dumps(toml_of(text, "x", number=float)))
    assert list(check.iter_errors(content)) == []
    for key in ("statuses", "actions", "tasks", "max_trial"):
        assert not check.is_valid({k: v for k, v in content.items() if k != key})
    for table, value in [("base", {"x": 1.5}), ("bse", {}), ("readings", {"skip_onset": "no"})]:
        assert not check.is_valid(content | {table: value})


def test_commands(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    made = run("new", path, "--json")
    assert made.result == {"written": str(path), "notice": ADVICE}
    shipped_line, _, rest = TEMPLATE.partition("\n")
    assert shipped_line == "#:schema schema.json"
    assert path.read_text("utf-8") == rest  # the same on all machines
    (place,) = re.findall(r"first: #:schema file://(.*)\n", made.err)
    assert Path(url2pathname(place)).read_text("utf-8") == schema.text()
    assert run("lint", path, "--json").result["problems"] == []
    again = run("new", path)
    assert (again.status, again.out) == (2, "")
    assert "there already" in again.err
    path.write_text(path.read_text("utf-8").replace("trial = -1", "trial = 1"), encoding="utf-8")
    done = run("lint", path, "--json")
    assert done.status == 1
    (problem,) = done.result["problems"]
    assert problem.keys() == {"line", "text", "what", "fix", "severity"}
    shown = run("lint", path)
    assert "trial = 1" in shown.out
    for words in (("new", tmp_path / "x.json"), ("lint", tmp_path / "none.toml"), ("lint", "tea")):
        done = run(*words)
        assert (done.status, done.out) == (2, "")


def test_names_are_judged_where_the_lists_of_them_are_unreadable() -> None:
    """A misspelt name is not taken for a status: the others are in two tables."""
    text = "statuses = {x\n[base]\nsad = 0.2\nangr = 0.1\n[persistence]\nsad = 0.5\nanger = 0.1\n"
    text += "[influence.sad]\nanger = 0.1\n[reward]\nassist.hug = -1\n"
    said = {problem.line: (problem.what, problem.fix) for problem in lint(text, "x")}
    assert said[4] == ("unknown number 'base.angr'", "did you mean base.anger?")
    assert not {6, 7, 9} & said.keys()


@pytest.mark.parametrize(
    "line", ["a = " + "[" * 100_000, "a." * 3000 + "a = 1", "a = " + "{a = " * 5000]
)
def test_a_text_that_is_nested_too_deeply_is_a_problem(line: str, tmp_path: Path) -> None:
    (tmp_path / "deep.toml").write_text(line)
    assert run("lint", tmp_path / "deep.toml").status == 1
