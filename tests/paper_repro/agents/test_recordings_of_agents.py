"""The agents' files: nothing is counted twice, guessed, or gone on with unless it follows."""

from __future__ import annotations

import json
import shutil
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.paper_repro.agents import local as model_file
from exact_mdp.paper_repro.agents.__main__ import main
from exact_mdp.paper_repro.agents.chat import Style, ask
from exact_mdp.paper_repro.agents.conversation import conversation, modules_of, recorded
from exact_mdp.paper_repro.agents.measure import Notebook
from exact_mdp.paper_repro.agents.prompts import ACTIVITIES, FOLDER, Activity
from exact_mdp.paper_repro.agents.protocol import Request, execution_schema
from exact_mdp.paper_repro.agents.recording import read
from exact_mdp.paper_repro.agents.scripted import Scripted
from exact_mdp.paper_repro.agents.session import NAME, Recorded, hold, replayed
from exact_mdp.paper_repro.agents.views import number

SETS = ("tasks=[1,1]",)


def held(out: Path, limit: int | None = None) -> list[dict[str, Any]]:
    """Hold a short conversation and return its entries."""
    hold(conversation(Scripted(), policy="always:directive", sets=SETS), out, limit=limit)
    return [json.loads(text) for text in (out / NAME).read_text().splitlines()]


def write(out: Path, entries: list[dict[str, Any]]) -> None:
    (out / NAME).write_text("".join(json.dumps(entry) + "\n" for entry in entries))


# ---- resuming and replaying ----------------------------------------------------------------------


@pytest.mark.parametrize(
    "part, value", [("next_state", 10**9), ("next_state", 0), ("return", "999"), ("reward", "7")]
)
def test_a_run_is_not_resumed_from_what_does_not_follow(
    tmp_path: Path, part: str, value: object
) -> None:
    """A state beyond the model is not taken for the end, and no forged sum is gone on with."""
    entries = held(tmp_path, limit=2)
    entries[-1][part] = value
    write(tmp_path, entries)
    kept = (tmp_path / NAME).read_bytes()
    with pytest.raises(ModelError, match=f"does not follow from its settings: timestep 1: {part}"):
        hold(conversation(Scripted(), policy="always:directive", sets=SETS), tmp_path, resume=True)
    assert (tmp_path / NAME).read_bytes() == kept


def test_an_end_before_the_end_is_told(tmp_path: Path) -> None:
    """A recording that stops early and says it is whole differs from the scenario."""
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    entries = held(whole)
    held(cut, limit=1)
    steps = entries[1:2]
    end = entries[-1] | {
        "timesteps": 1, "return": steps[0]["return"], "requests": len(steps[0]["calls"]),
        "attempts": sum(call["attempts"] for call in steps[0]["calls"]),
        "completed": int(steps[0]["event"] == "completed"),
        "skipped": int(steps[0]["event"] == "skipped"),
        "misperceived": int(steps[0]["status"] != steps[0]["perceived"]),
    }  # fmt: skip
    write(cut, [entries[0], *steps, end])
    told = read(cut / NAME)
    assert replayed(recorded(told.header, Recorded(told)), told) == [
        "the end: the scenario was not over there"
    ]


def test_a_replay_says_where_there_is_no_end(tmp_path: Path) -> None:
    """'The same' of half a conversation is not said as if it were whole."""
    held(tmp_path, limit=1)
    done = CliRunner().invoke(main, ["replay", str(tmp_path / NAME)])
    assert done.exit_code == 0, done.output
    assert "1 timesteps" in done.output
    assert "not finished" in done.output


# ---- tokens --------------------------------------------------------------------------------------


@pytest.mark.parametrize("usage", [None, {}, {"prompt_tokens": -1}, {"prompt_tokens": 10**20}])
def test_tokens_that_were_not_counted_are_not_none(usage: object) -> None:
    """An answer of which one attempt was not counted is not counted."""
    request = Request(
        purpose="execution", messages=(("user", "x"),), schema=execution_schema(), facts={}, seed=1
    )
    good = {"prompt_tokens": 100, "completion_tokens": 10}
    answers = [
        {"choices": [{"message": {"content": "{"}}], "usage": good},
        {"choices": [{"message": {"content": '{"speech": "Yes."}'}}], "usage": usage},
    ]
    reply = ask(request, Style(), lambda body: (answers.pop(0), 1), "here")
    assert (reply.attempts, reply.prompt_tokens, reply.completion_tokens) == (2, 0, 0)


def test_a_cost_without_all_counts_is_a_least_one(capsys: pytest.CaptureFixture[str]) -> None:
    """'at least' stands before tokens and cost where an answer was not counted."""
    from exact_mdp.paper_repro.agents.cli import tell_use

    used = {"attempts": 3, "prompt_tokens": 200, "completion_tokens": 20}
    tell_use(used, (1.0, 1.0), 1)
    assert "at least 200 + 20 tokens, cost at least 0.0002" in capsys.readouterr().out
    tell_use(used, (1.0, 1.0), 0)
    assert "at least" not in capsys.readouterr().out
    tell_use(used | {"prompt_tokens": 0, "completion_tokens": 0}, (1.0, 1.0), 3)
    assert "the cost is not known" in capsys.readouterr().out


# ---- measurements --------------------------------------------------------------------------------


def test_a_recording_is_not_counted_twice(tmp_path: Path) -> None:
    """The same conversation twice would halve the variance of what is measured."""
    held(tmp_path)
    shutil.copy(tmp_path / NAME, tmp_path / "copy.jsonl")
    words = ["measure", "--out", str(tmp_path / "out"), "--set", SETS[0], "--draws", "0"]
    for path in (NAME, "copy.jsonl"):
        words += ["--recording", str(tmp_path / path)]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 2, done.output
    assert "would count it twice" in done.output
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "change",
    [
        {"status": 5}, {"status": True}, {"status": 0.0}, {"perceived": 16}, {"perceived": -1},
        {"perceived": "0000"}, {"behaviour": []}, {"behaviour": {"nonverbal": "x"}},
    ],
)  # fmt: skip
def test_a_measurement_goes_on_only_with_its_own_entries(
    tmp_path: Path, change: dict[str, Any]
) -> None:
    """An entry of another status, or of none, is not taken for the next one."""
    header = {"statuses": ["a", "b", "c", "d"]}
    entry = {"status": 0, "perceived": 3, "behaviour": {"nonverbal": "x", "verbal": ""}}
    with Notebook(tmp_path, header, resume=False):
        pass
    path = tmp_path / "labelled.jsonl"
    first = path.read_text()
    path.write_text(first + json.dumps(entry) + "\n")
    with Notebook(tmp_path, header, resume=True) as notebook:
        assert len(notebook.past) == 1
    path.write_text(first + json.dumps(entry | change) + "\n")
    with pytest.raises(ModelError, match="line 2"):
        Notebook(tmp_path, header, resume=True)


# ---- files of one's own --------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name, before, after, told",
    [
        ("guidelines.toml", "[status.", "[stat.", "lacks status"),
        ("guidelines.toml", "meaning = ", "meant = ", "lacks meaning"),
        ("guidelines.toml", "signs = [", "signs = 'x' # [", "signs is not a list"),
        ("guidelines.toml", "version = ", "edition = ", "lacks version"),
        ("perception.toml", "version = 2", "version = 'one'", "version is not a whole number"),
        ("perception.toml", 'message = "user"', 'message = "person"', "not one of system, user"),
        ("perception.toml", "$behaviour", "$behavior", "without a value"),
        ("perception.toml", "$behaviour", "$ 5", "without a value"),
    ],
)
def test_prompts_of_ones_own_are_checked(
    tmp_path: Path, name: str, before: str, after: str, told: str
) -> None:
    """A part that is missing or misspelt is an error by name."""
    folder = tmp_path / "prompts"
    shutil.copytree(FOLDER, folder)
    text = (folder / name).read_text()
    assert before in text
    changed = text.replace(before, after) if "signs" not in before else _one_line(text)
    (folder / name).write_text(changed)
    with pytest.raises(ModelError, match=told):
        modules_of(Scenario.load("yuan2025"), prompts=folder).perception(
            {"nonverbal": "x", "verbal": ""}, 1
        )


def _one_line(text: str) -> str:
    """Return guidelines in which the signs of a status are one text, not a list of them."""
    head, _, rest = text.partition("signs = [")
    return f"{head}signs = 'frowns'{rest[rest.index(']') + 1 :]}"


def test_an_activity_holds_texts(tmp_path: Path) -> None:
    """A number in the place of words is not put into words."""
    text = (ACTIVITIES / "shopping.toml").read_text()
    start = text.index("item = ")
    path = tmp_path / "own.toml"
    path.write_text(text[:start] + "item = 5" + text[text.index("\n", start) :])
    with pytest.raises(ModelError, match="item is not a string"):
        Activity.load(str(path), tasks=[3, 1])


def test_a_file_in_the_place_of_the_model_is_not_taken_for_it(tmp_path: Path) -> None:
    """'There already' is said of the model's file alone."""
    other = tmp_path / "model.gguf"
    other.write_bytes(b"something else")
    done = CliRunner().invoke(main, ["fetch-model", "--out", str(other)])
    assert done.exit_code == 2
    assert "another file is there already" in done.output
    model_file.check(other, sha256(b"something else").hexdigest())


@pytest.mark.parametrize(
    "text, shown",
    [("1/3", "0.33"), ("-1/3", "-0.33"), ("-8", "-8"), (f"{10**400}/3", f"{'3' * 400}.33")],
)
def test_an_exact_number_is_shown_whatever_its_size(text: str, shown: str) -> None:
    """No float stands between a fraction and its two decimals."""
    assert number(text) == shown
