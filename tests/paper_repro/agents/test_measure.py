"""Measured perception: the matrix, its intervals and its cost, against an independent model."""

from __future__ import annotations

import csv
import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st
from oracle import STATUSES, Oracle
from scipy.stats import binom

from exact_mdp.mdp import ModelError, Policy, Scenario
from exact_mdp.mdp.care.perception import interval
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.agents.__main__ import main
from exact_mdp.paper_repro.agents.claims import (
    EXACT,
    MODEL,
    PARTLY,
    PEOPLE,
    errors,
    misread,
    statements,
)
from exact_mdp.paper_repro.agents.conversation import conversation, modules_of
from exact_mdp.paper_repro.agents.measure import (
    bits,
    cost,
    count,
    labelled,
    matrix,
    rates,
    to_csv,
    vector,
)
from exact_mdp.paper_repro.agents.scripted import Scripted
from exact_mdp.paper_repro.agents.session import NAME, hold
from exact_mdp.solvers import certify, evaluate

PLAN = reported.policy("non-directive", reported.COMPLETIONS[77])


@pytest.mark.parametrize("noise", [0.0, 0.25, 1.0])
def test_the_scripted_matrix_is_that_of_independent_errors(noise: float) -> None:
    modules, each = modules_of(Scenario.load("yuan2025")), 24
    backend = Scripted(noise=noise)
    found = labelled(modules, backend, backend, each=each, seed=3)
    counts = count([(f.status, f.perceived) for f in found], 4)
    assert counts.sum(axis=1).tolist() == [each] * 16
    wrong = sum(bin(f.status ^ f.perceived).count("1") for f in found)
    if noise in (0, 1):
        assert np.array_equal(counts, errors(noise, 4) * each)
    else:
        low, high = binom.ppf([1e-6, 1 - 1e-6], 4 * len(found), noise)
        assert low <= wrong <= high


def test_behaviour_and_perception_can_come_from_two_backends() -> None:
    modules = modules_of(Scenario.load("yuan2025"))
    found = labelled(modules, Scripted(), Scripted(noise=1.0), each=1, seed=0)
    assert all(f.status ^ f.perceived == 15 for f in found)


def test_the_value_under_errors_is_that_of_the_independent_model() -> None:
    rng = np.random.default_rng(5)
    counts = rng.integers(0, 6, (16, 16)) + 6 * np.eye(16, dtype=np.int64)
    mdp = Scenario.load("yuan2025").with_(tasks=[2], max_trial=3).compile()
    names = [format(number, "04b") for number in range(16)]

    def decide(state: object) -> dict[str, Fraction]:
        assert isinstance(state, tuple)
        row = counts[int("".join(map(str, state[3])), 2)]
        chances: dict[str, Fraction] = {}
        for name, number in zip(names, row.tolist(), strict=True):
            action = PLAN[name]
            chances[action] = chances.get(action, Fraction(0)) + Fraction(number, int(row.sum()))
        return {action: chance for action, chance in chances.items() if chance}

    exact = Oracle(tasks=[2], max_trial=3).evaluate(decide)
    found = cost(mdp, Policy.of(mdp, PLAN), counts, prior=0.0, draws=0, seed=0)
    assert found["measured"]["value"] == pytest.approx(float(exact["mean"]), rel=1e-12)
    assert found["loss"] == found["perfect"]["value"] - found["measured"]["value"]


def test_always_taking_one_status_for_another_is_a_changed_plan() -> None:
    mdp = Scenario.load("yuan2025").compile()
    changed = PLAN | {"0000": PLAN["1000"]}
    found = misread(mdp, Policy.of(mdp, PLAN), {"0000": "1000"})
    assert found == pytest.approx(evaluate(mdp, changed).mean, rel=1e-12)


def test_a_matrix_of_another_size_is_refused() -> None:
    mdp = Scenario.load("yuan2025").compile()
    with pytest.raises(ModelError, match="confusion matrix of 4"):
        cost(mdp, Policy.uniform(mdp), np.ones((4, 4), dtype=int), prior=0, draws=0, seed=0)


@given(st.integers(0, 15))
def test_numbers_and_vectors(number: int) -> None:
    assert vector(bits(number, STATUSES)) == number
    assert list(bits(number, STATUSES)) == list(STATUSES)


def test_a_status_never_seen_needs_a_prior() -> None:
    counts = count([(0, 0), (1, 1)], 2)
    with pytest.raises(ModelError, match="labelled 10, 11"):
        matrix(counts)
    with_prior = matrix(counts, prior=1.0)
    assert with_prior[3].tolist() == [0.25] * 4
    assert with_prior[0].tolist() == [0.4, 0.2, 0.2, 0.2]


@given(st.integers(1, 60).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_intervals_invert_the_binomial_test(case: tuple[int, int]) -> None:
    right, total = case
    low, high = interval(right, total)
    assert 0 <= low <= right / total <= high <= 1
    if right > 0:
        assert binom.sf(right - 1, total, low) == pytest.approx(0.025, rel=1e-6)
    if right < total:
        assert binom.cdf(right, total, high) == pytest.approx(0.025, rel=1e-6)


def test_rates_count_each_status_on_its_own() -> None:
    counts = count([(0b10, 0b10), (0b10, 0b00), (0b01, 0b11), (0b00, 0b00)], 2)
    found = rates(counts, ["anger", "confusion"])
    assert (found["anger"]["sensitivity"]["right"], found["anger"]["sensitivity"]["of"]) == (1, 2)
    assert (found["anger"]["specificity"]["right"], found["anger"]["specificity"]["of"]) == (1, 2)
    assert found["confusion"]["sensitivity"]["rate"] == 1.0
    assert found["confusion"]["specificity"]["of"] == 3


def test_the_posterior_narrows_to_the_counted_value() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1]).compile()
    policy = Policy.of(mdp, PLAN)
    wide, narrow = (
        cost(mdp, policy, np.rint(errors(0.1, 4) * size).astype(int), prior=0, draws=40, seed=1)
        for size in (50, 50_000)
    )
    spans = [np.ptp(found["posterior"]["interval"]) for found in (wide, narrow)]
    assert spans[1] < spans[0] / 10
    assert narrow["posterior"]["mean"] == pytest.approx(narrow["measured"]["value"], abs=0.05)
    low, high = narrow["posterior"]["interval"]
    assert low <= narrow["measured"]["value"] <= high


def test_the_file_is_the_contracts() -> None:
    rows = list(csv.reader(to_csv(errors(0.1, 4)).splitlines()))
    assert rows[0] == ["status", *(format(number, "04b") for number in range(16))]
    assert [row[0] for row in rows[1:]] == rows[0][1:]
    table = np.array([[float(cell) for cell in row[1:]] for row in rows[1:]])
    assert np.array_equal(table, errors(0.1, 4))


def test_measuring_from_the_command_line(tmp_path: Path) -> None:
    words = ["measure", "--each", "2", "--draws", "3", "--noise", "0.3", "--out", str(tmp_path)]
    done = CliRunner().invoke(main, words)
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "perception.json").read_text())
    counts = np.array(result["counts"])
    table = np.loadtxt(tmp_path / "confusion.csv", delimiter=",", skiprows=1, usecols=range(1, 17))
    assert np.array_equal(table, counts / 2)
    lines = [json.loads(text) for text in (tmp_path / "labelled.jsonl").read_text().splitlines()]
    assert lines.pop(0)["kind"] == "header"
    assert np.array_equal(count([(f["status"], f["perceived"]) for f in lines], 4), counts)
    assert "Not medical advice" in result["disclaimer"]
    loss = result["value"]["perfect"]["value"] - result["value"]["measured"]["value"]
    assert done.output.splitlines()[-1].startswith(f"These errors of perception cost {loss:.2f} of")


def test_a_measurement_that_stops_goes_on(tmp_path: Path) -> None:
    words = ["measure", "--each", "1", "--draws", "0", "--noise", "0.3", "--out"]
    assert CliRunner().invoke(main, [*words, str(tmp_path / "whole")]).exit_code == 0
    data = (tmp_path / "whole" / "labelled.jsonl").read_bytes()
    ends = [number + 1 for number, byte in enumerate(data) if byte == 10]
    for cut in (0, 5, ends[0], ends[3], ends[3] + 20, len(data)):
        out = tmp_path / str(cut)
        out.mkdir()
        (out / "labelled.jsonl").write_bytes(data[:cut])
        done = CliRunner().invoke(main, [*words, str(out), "--resume"])
        assert done.exit_code == 0, done.output
        for name in ("labelled.jsonl", "confusion.csv", "perception.json"):
            assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    for more, message in (([], "--resume"), (["--resume", "--seed", "9"], "other settings")):
        done = CliRunner().invoke(main, [*words, str(tmp_path / "whole"), *more])
        assert done.exit_code == 2
        assert message in done.output
    assert (tmp_path / "whole" / "labelled.jsonl").read_bytes() == data


def test_counting_in_recordings(tmp_path: Path) -> None:
    steps = []
    for seed in range(3):
        talk = conversation(Scripted(noise=0.3), policy="random", seed=seed)
        steps += hold(talk, tmp_path / str(seed)).steps
    names = [
        part for seed in range(3) for part in ("--recording", str(tmp_path / str(seed) / NAME))
    ]
    out = ["--out", str(tmp_path / "m"), "--draws", "0"]
    refused = CliRunner().invoke(main, ["measure", *names, *out])
    assert refused.exit_code == 2
    assert "--prior" in refused.output
    done = CliRunner().invoke(main, ["measure", *names, *out, "--prior", "0.1"])
    assert done.exit_code == 0, done.output
    counts = np.array(json.loads((tmp_path / "m" / "perception.json").read_text())["counts"])
    assert counts.sum() == len(steps)
    assert np.trace(counts) == sum(step["status"] == step["perceived"] for step in steps)
    assert not (tmp_path / "m" / "labelled.jsonl").exists()


def test_the_papers_claims_are_told_apart() -> None:
    found = statements(levels=(1.0, 0.9))
    assert {s.kind for s in found} == {EXACT, PARTLY, MODEL, PEOPLE}
    (errs,) = (s for s in found if s.claim.startswith("Despite errors"))
    mdp = Scenario.load("yuan2025").compile()
    best = float(certify(mdp).start_value)
    assert f"100%: {best:.1f}" in errs.found
    done = CliRunner().invoke(main, ["claims", "--json"])
    assert done.exit_code == 0
    assert len(json.loads(done.output)["claims"]) == len(found)
