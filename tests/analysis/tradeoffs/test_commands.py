"""The commands about trade-offs: their JSON, their exit status, and the picture of a front."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from cli_runner import run

from exact_mdp import MDP, ModelError, Policy, Scenario, check, evaluate, solve, tradeoff

SMALL = ("--set", "tasks=[1]", "--set", "max_trial=2")
TWO = ("anger", "done=subtask-complete-1/2*trial")


def as_read(mdp: MDP, folder: Path, policy: object) -> Policy:
    """The policy that a file with a part of the JSON says."""
    (folder / "own.json").write_text(json.dumps(policy), encoding="utf-8")
    return Policy.of(mdp, folder / "own.json")


def test_limits_as_json(tmp_path: Path) -> None:
    words = ("solve", "yuan2025", *SMALL, "--subject-to", "anger >= -1/10", "--json")
    result = run(*words, "--policy-out", str(tmp_path / "p.csv")).result
    scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    wanted = solve(scenario, subject_to={"anger": ">= -1/10"})
    assert result["feasible"] is True
    assert Fraction(result["exact_start_value"]) == wanted.start_value
    assert {n: Fraction(p) for n, p in result["prices"].items()} == wanted.prices
    assert Fraction(result["totals"]["anger"]) == Fraction(-1, 10)
    (drawn,) = result["randomises"]
    assert sum(map(Fraction, drawn["actions"].values())) == 1
    assert all(sum(map(Fraction, own.values())) == 1 for own in result["policy"].values())
    assert result["policy"][drawn["state"]] == drawn["actions"]
    mdp = scenario.compile()
    for given in (tmp_path / "p.csv", as_read(mdp, tmp_path, result["policy"])):
        assert evaluate(mdp, given).mean == pytest.approx(result["start_value"])
        assert check(mdp, given, subject_to={"anger": ">= -1/10"}).passed


def test_a_check_reads_the_policy_that_limits_wrote(tmp_path: Path) -> None:
    """The exact shares of the whole model do not fit in 64 bits."""
    file, limit = tmp_path / "p.csv", ("--subject-to", "anger >= -1/2", "--json")
    result = run("solve", "yuan2025", *limit, "--policy-out", file).result
    checked = run("check", "yuan2025", file, *limit)
    assert (checked.status, checked.result["passed"], checked.result["regret"]) == (0, True, 0)
    (tmp_path / "p.json").write_text(json.dumps(result["policy"]), encoding="utf-8")
    assert run("check", "yuan2025", tmp_path / "p.json", *limit).status == 0


def test_a_policy_with_the_time_in_its_states(tmp_path: Path) -> None:
    words = (*TWO, *SMALL, "--horizon", "2")
    result = run("tradeoff", "yuan2025", *words, "--json").result
    mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile().within(2)
    front = tradeoff(mdp, TWO)
    for vertex, point in zip(result["vertices"], front.vertices, strict=True):
        assert front.totals(as_read(mdp, tmp_path, vertex["policy"])) == point


def test_limits_that_no_policy_keeps() -> None:
    words = ("solve", "yuan2025", *SMALL, "--subject-to", "anger >= 1/2")
    done = run(*words, "--json")
    assert (done.status, done.result["feasible"], done.result["closest"]) == (
        1, False, {"anger": "0"},
    )  # fmt: skip
    assert done.result["exact_start_value"] is None
    text = run(*words)
    assert (text.status, "no policy keeps them all" in text.out) == (1, True)
    for bad in (("--subject-to", "anger > 1"), ("--subject-to", "anger"), ("--method", "auto")):
        assert run(*words, *bad).status == (1 if bad[1] == "auto" else 2)
    assert run(*words, "--tol", "1e-3").status == 2
    for text in ("anger>1", "anger=1"):
        assert f"'{text}' is no limit" in run(*words[:-1], text).err
    against = run(*words, "--subject-to", "anger <= -1")
    assert (against.status, "contradict each other" in against.out) == (1, True)
    assert "contradict" not in run(*words).out
    for key in ("start_value", "exact_start_value", "error_bound"):
        assert done.result[key] is None


def test_the_picture_shows_vertices_and_policies() -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    front = tradeoff(scenario, ["anger", "subtask-complete"])
    ax = front.plot(policies={"at random": "random", "best": front.policies[1]})
    line, *others = ax.lines
    assert list(zip(*line.get_data(), strict=True)) == [
        tuple(map(float, vertex)) for vertex in front.vertices
    ]
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels[0] == "front"
    assert labels[1].startswith("at random (distance ")
    assert labels[2] == "best (on the front)"
    assert len(others) == 3
    plt.close(ax.figure)
    twice = front.plot(policies={"one": "random", "the same": "random"}).lines
    below, _, above, _ = twice[1:]
    assert (below.get_fillstyle(), above.get_fillstyle()) == ("full", "none")
    assert above.get_markersize() > below.get_markersize()
    plt.close(twice[0].figure)
    with pytest.raises(ModelError, match="no flat picture"):
        tradeoff(scenario, ["anger", "trial", "steps"]).plot()


def test_commands_write_proofs(tmp_path: Path) -> None:
    front, limits = tmp_path / "f.json", tmp_path / "l.json"
    run("tradeoff", "yuan2025", *TWO, *SMALL, "--certificate", front)
    limit = ("--subject-to", "anger >= -1/10")
    wanted = run("solve", "yuan2025", *SMALL, *limit, "--certificate", limits, "--json").result
    assert wanted["written"] == [str(limits)]
    for path, number in ((front, "vertices"), (limits, "start value")):
        text = run("verify", path, "yuan2025", *SMALL)
        assert (text.status, "holds (certified)" in text.out, number in text.out) == (0, True, True)
    result = run("verify", limits, "yuan2025", *SMALL, "--json").result
    for key in ("exact_start_value", "limits", "totals", "prices", "closest"):
        assert result[key] == wanted[key]
    assert f"{float(Fraction(wanted['prices']['anger'])):.10g}" in text.out
    vertices = run("tradeoff", "yuan2025", *TWO, *SMALL, "--json").result["vertices"]
    read = run("verify", front, "yuan2025", *SMALL, "--json").result
    each = [(v["values"]["anger"], v["values"]["done"]) for v in vertices]
    assert [(total["anger"], total[TWO[1]]) for total in read["totals"]] == each
    assert f"{float(Fraction(each[0][1])):.10g}" in run("verify", front, "yuan2025", *SMALL).out
    over = ("--subject-to", "anger >= 1/10", "--certificate", limits)
    wanted = run("solve", "yuan2025", *SMALL, *over, "--json").result
    result = run("verify", limits, "yuan2025", *SMALL, "--json").result
    assert (result["feasible"], result["closest"]) == (False, wanted["closest"])
    assert "anger >= 0" in run("verify", limits, "yuan2025", *SMALL).out
    assert run("verify", limits, "yuan2025").status == 1
    front.write_text(front.read_text().replace('"corners"', '"corner"'))
    assert run("verify", front, "yuan2025", *SMALL).status == 2
