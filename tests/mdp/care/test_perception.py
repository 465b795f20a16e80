"""Acting on perceived statuses: against the reference model, by file, on the command line.

The matrix of perception may be counted from labelled examples, in several kinds of files.
"""

import json
from fractions import Fraction
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from care_oracle import Oracle
from cli_runner import run
from refusal_tables import of_file, refused, table_of_refusals

from exact_mdp import MDP, Policy, Scenario, counted, evaluate, frequencies, independent, perceived

NAMES = ("forgetfulness", "confusion", "anger", "disengagement")
MODEL = ("yuan2025", "--set", "tasks=[2]", "--set", "max_trial=3")
LABELS = [f"{status:04b}" for status in range(16)]
ACTIONS = ("none", "supportive", "non-directive", "directive")
RATES = ("9/10", "4/5", "19/20", "3/4")
CLEAR = ("7/8", "99/100", "1", "1/2")


@pytest.fixture(scope="module")
def care() -> MDP:
    return Scenario.load("yuan2025").with_(tasks=[2], max_trial=3).compile()


def confusion(true: str, seen: str) -> Fraction:
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


PLAN = {label: ACTIONS[(3 * status + 2) % 4] for status, label in enumerate(LABELS)}
EXACT: list[list[object]] = [[confusion(true, seen) for seen in LABELS] for true in LABELS]


@pytest.fixture(autouse=True)
def plan(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("plan.json").write_text(json.dumps(PLAN))


def evaluated(seen: Path) -> dict[str, Any]:
    return run("evaluate", *MODEL, "plan.json", "--perception", seen, "--json").result


def test_the_value_is_that_of_the_reference_model(tmp_path: Path) -> None:
    def acting(state: tuple) -> dict[str, Fraction]:
        true = "".join(map(str, state[3]))
        mixed: dict[str, Fraction] = {}
        for seen in LABELS:
            mixed[PLAN[seen]] = mixed.get(PLAN[seen], Fraction(0)) + confusion(true, seen)
        return mixed

    wanted = Oracle(tasks=[2], max_trial=3).evaluate(acting, distribution=False)
    facts = evaluated(as_csv(tmp_path / "seen.csv", EXACT))
    assert facts["mean"] == pytest.approx(float(wanted["mean"]), rel=1e-12)
    assert facts["sd"] == pytest.approx(sqrt(wanted["variance"]), rel=1e-10)
    assert facts["steps"] == pytest.approx(float(wanted["steps"]), rel=1e-12)
    assert facts["skip_probability"] == pytest.approx(float(wanted["skip_probability"]), rel=1e-12)


def test_rates_and_matrix_say_the_same(care: MDP, tmp_path: Path) -> None:
    lines = ["[sensitivity]", *(f'{n} = "{r}"' for n, r in zip(NAMES, RATES, strict=True))]
    lines += ["[specificity]", *(f'{n} = "{r}"' for n, r in zip(NAMES, CLEAR, strict=True))]
    (tmp_path / "seen.toml").write_text("\n".join(lines))
    by_rate = evaluated(tmp_path / "seen.toml")["mean"]
    assert by_rate == pytest.approx(evaluated(as_csv(tmp_path / "seen.csv", EXACT))["mean"])
    matrix = independent([0.9, 0.8, 0.95, 0.75], [0.875, 0.99, 1, 0.5])
    assert by_rate == pytest.approx(evaluate(care, perceived(care, PLAN, matrix)).mean)


def test_seeing_the_truth_changes_nothing(care: MDP) -> None:
    for form in ("random", "always:directive", PLAN):
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


HEAD = ",".join(["status", *LABELS]) + "\n"


def seen(name: str, text: str) -> None:
    words = "evaluate yuan2025 random --json --perception"
    raise of_file(name, text, lambda path: run(words, path).error())


test_broken_files_are_refused = table_of_refusals(__file__, globals())


def test_rows_that_are_no_distribution(care: MDP, tmp_path: Path) -> None:
    rows: list[list[object]] = [[0] * 16 for _ in LABELS]
    done = run("evaluate", *MODEL, "random", "--perception", as_csv(tmp_path / "a.csv", rows))
    assert "row of status 0000 is not a distribution: it sums to 0" in done.refusal()
    assert "a.csv, row 0" in done.refusal()
    matrix = np.eye(16)
    matrix[3, 3] = 0.9
    said = "row of status 0011 is not a distribution: it sums to 0.9", "confusion matrix, row 3"
    refused(lambda: perceived(care, "random", matrix), *said)
    matrix[3, [3, 5]] = 1.25, -0.25
    said = ("its least number is -0.25",)
    refused(lambda: perceived(care, "random", matrix), *said)
    matrix[3, [3, 5]] = 1, np.nan
    refused(lambda: perceived(care, "random", matrix))
    refused(lambda: perceived(MDP.from_arrays([[[1]]], [0]), "random", np.eye(16)), "no statuses")


# ---- counted from labelled examples -------------------------------------------------------------


def examples() -> list[tuple[str, str]]:
    rng = np.random.default_rng(0)
    pairs = [(s, s if rng.random() < 0.8 else int(rng.integers(16))) for s in [*range(16)] * 6]
    return [(f"{s:04b}", f"{z:04b}") for s, z in pairs]


def test_every_form_gives_the_same_counts_and_draws(care: MDP, tmp_path: Path) -> None:
    pairs = examples()
    table = np.zeros((16, 16), dtype=int)
    for s, z in pairs:
        table[int(s, 2), int(z, 2)] += 1
    header = {"kind": "header", "statuses": list(NAMES)}
    talk = [{"kind": "step", "status": s, "perceived": z, "action": "none"} for s, z in pairs]
    lines = [json.dumps(entry) for entry in [header, *talk, {"kind": "end", "return": "3"}]]
    (tmp_path / "a.jsonl").write_text("\n".join(lines) + '\n{"status": "00')  # a broken last line
    labels = [{"status": int(s, 2), "perceived": int(z, 2)} for s, z in pairs]
    (tmp_path / "b.jsonl").write_text("\n".join(map(json.dumps, labels)))  # and no newline
    mean = evaluate(care, perceived(care, PLAN, frequencies(table))).mean
    for name in ("a.jsonl", "b.jsonl"):
        assert evaluated(tmp_path / name)["mean"] == pytest.approx(mean, rel=1e-12)
        done = run("perception --policy plan.json --json", *MODEL, "--perception", tmp_path / name)
        assert done.result["counted"] == len(pairs)
    assert np.array_equal(counted(pairs, size=16), table)
    assert frequencies(table) == pytest.approx(table / table.sum(axis=1)[:, None])


def test_commands_name_the_file_that_labels_too_little(tmp_path: Path) -> None:
    (tmp_path / "few.jsonl").write_text('{"status": "0000", "perceived": "0000"}\n')
    seen = ("--perception", tmp_path / "few.jsonl")
    for words in (("evaluate", "yuan2025", "random"), ("perception", "yuan2025")):
        said = run(*words, *seen).refusal()
        assert f"where: {tmp_path / 'few.jsonl'}" in said
        assert "labelled 0001, 0010, 0011, 0100 and 11 more" in said
