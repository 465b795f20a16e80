"""The commands about trade-offs: their JSON, their exit status, and the picture of a front."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from cli_runner import run

from exact_mdp import Scenario, evaluate, solve, tradeoff
from exact_mdp.mdp import ModelError

SMALL = ("--set", "tasks=[1]", "--set", "max_trial=2")
TWO = ("anger", "done=subtask-complete-1/2*trial")


def test_a_front_as_json() -> None:
    found = run("tradeoff", "yuan2025", *TWO, *SMALL, "--policy", "random", "--json").result
    front = tradeoff(Scenario.load("yuan2025").with_(tasks=[1], max_trial=2), ["anger", TWO[1]])
    assert (found["names"], found["claim"]) == (["anger", "done"], "certified")
    got = [tuple(Fraction(v["values"][n]) for n in found["names"]) for v in found["vertices"]]
    assert got == front.vertices
    assert [(e["from"], e["to"]) for e in found["edges"]] == [
        (n, n + 1) for n in range(len(got) - 1)
    ]
    assert [Fraction(e["rate"]) for e in found["edges"]] == [e.rate for e in front.edges]
    assert found["vertices"][0]["policy"].keys() == {f"{n:04b}" for n in range(16)}
    assert Fraction(found["policies"][0]["distance"]) == front.distance("random") > 0
    text = run("tradeoff", "yuan2025", *TWO, *SMALL, "--policy", "random")
    assert (text.status, "policies beside the front" in text.out) == (0, True)


def test_a_front_of_three_totals_as_json() -> None:
    found = run("tradeoff", "yuan2025", *TWO, "steps", *SMALL, "--json").result
    assert {len(facet["weights"]) for facet in found["facets"]} == {3}
    assert all(edge["rate"].keys() == {"anger", "done", "steps"} for edge in found["edges"])


def test_limits_as_json(tmp_path: Path) -> None:
    words = ("solve", "yuan2025", *SMALL, "--subject-to", "anger >= -1/10", "--json")
    found = run(*words, "--policy-out", str(tmp_path / "p.csv")).result
    scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    wanted = solve(scenario, subject_to={"anger": ">= -1/10"})
    assert found["feasible"] is True
    assert Fraction(found["exact_start_value"]) == wanted.start_value
    assert {n: Fraction(p) for n, p in found["prices"].items()} == wanted.prices
    assert Fraction(found["totals"]["anger"]) == Fraction(-1, 10)
    (drawn,) = found["randomises"]
    assert sum(map(Fraction, drawn["actions"].values())) == 1
    assert found["policy"].keys() == {f"{n:04b}" for n in range(16)}
    assert all(sum(map(Fraction, own.values())) == 1 for own in found["policy"].values())
    again = evaluate(scenario.compile(), tmp_path / "p.csv")
    assert again.mean == pytest.approx(found["start_value"])


def test_limits_that_no_policy_keeps() -> None:
    words = ("solve", "yuan2025", *SMALL, "--subject-to", "anger >= 1/2")
    found = run(*words, "--json")
    assert (found.status, found.result["feasible"], found.result["closest"]) == (
        1, False, {"anger": "0"},
    )  # fmt: skip
    assert found.result["exact_start_value"] is None
    text = run(*words)
    assert (text.status, "no policy keeps them all" in text.out) == (1, True)
    for bad in (("--subject-to", "anger > 1"), ("--subject-to", "anger"), ("--method", "auto")):
        assert run(*words, *bad).status == (1 if bad[1] == "auto" else 2)
    assert run(*words, "--tol", "1e-3").status == 2


@pytest.mark.parametrize(
    "names", [("anger",), ("anger", "angre"), ("anger", "trial", "steps", "skip")]
)
def test_what_is_refused(names: tuple[str, ...]) -> None:
    done = run("tradeoff", "yuan2025", *names)
    assert (done.status, done.out) == (2, "")
    assert "fix:" in done.err


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
    with pytest.raises(ModelError, match="no flat picture"):
        tradeoff(scenario, ["anger", "trial", "steps"]).plot()
