"""The commands about trade-offs: their JSON, their exit status, and the picture of a front."""

import json
from fractions import Fraction
from pathlib import Path

import matplotlib.pyplot as plt
import pytest
from cli_runner import run
from picture_texts import legend_of

from exact_mdp import MDP, Scenario, tradeoff

SMALL = ("--set", "tasks=[1]", "--set", "max_trial=2")
CARE = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()


def test_a_policy_that_keeps_limits_is_written_and_read(tmp_path: Path) -> None:
    """The exact shares of the whole model do not fit in 64 bits."""
    files, limit = (tmp_path / "p.csv", tmp_path / "p.json"), ("--subject-to", "anger >= -1/2")
    result = run("solve yuan2025 --json --policy-out", files[0], *limit).result
    assert json.loads((tmp_path / "p.run.json").read_text("utf-8"))["solver"] == "limits"
    files[1].write_text(json.dumps(result["policy"]), "utf-8")
    (drawn,) = result["randomises"]
    assert result["policy"][drawn["state"]] == drawn["actions"]
    assert all(sum(map(Fraction, own.values())) == 1 for own in result["policy"].values())
    assert Fraction(result["totals"]["anger"]) == Fraction(-1, 2)
    for file in files:
        mean = run("evaluate yuan2025 --json", file).result["mean"]
        assert mean == pytest.approx(result["start_value"])
        checked = run("check yuan2025 --json", file, *limit)
        assert (checked.status, checked.result["passed"], checked.result["regret"]) == (0, True, 0)


@pytest.mark.parametrize(
    ("more", "status", "said"),
    [
        ((), 1, "no policy keeps them all"),
        (("--method", "auto"), 1, "no policy keeps them all"),
        (("--subject-to", "anger <= -1"), 1, "contradict each other"),
        (("--tol", "1e-3"), 2, "tol"),
        (("--subject-to", "anger=1"), 2, "'anger=1' is not a limit"),
    ],
)
def test_limits_that_no_policy_keeps(more: tuple[str, ...], status: int, said: str) -> None:
    done = run("solve yuan2025", *SMALL, "--subject-to", "anger >= 1/2", *more)
    assert (done.status, said in done.out + done.err) == (status, True)
    assert ("contradict" in done.out) == ("contradict" in said)


def test_the_picture_shows_vertices_and_policies() -> None:
    front = tradeoff(CARE, ["anger", "subtask-complete"])
    ax = front.plot(policies={"at random": "random", "best": front.policies[1]})
    line, *others = ax.lines
    assert list(zip(*line.get_data(), strict=True)) == [
        tuple(map(float, vertex)) for vertex in front.vertices
    ]
    labels = legend_of(ax)
    assert labels[0] == "front"
    assert labels[1].startswith("at random (distance ")
    assert labels[2] == "best (on the front)"
    assert len(others) == 3
    plt.close(ax.figure)
    twice = front.plot(policies={"one": "random", "the same": "random"}).lines
    below, _, above, _ = twice[1:]
    assert above.get_fillstyle() == "none"
    assert above.get_markersize() > below.get_markersize()
    plt.close(twice[0].figure)


def test_a_policy_beside_the_front_is_not_on_it() -> None:
    """One that is level with a vertex in one total and worse in the other is dominated."""
    totals = {"wait": (0, 0), "treat": (1, -5), "dear": (1, -9), "late": (Fraction(1, 2), -7)}
    gain, saved = ([*part, 0] for part in zip(*totals.values(), strict=True))
    rows = [(0, action, [(1, 1, 0)]) for action in range(4)]
    parts = {"gain": gain, "saved": saved}
    mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], components=parts)
    policies = {name: [action, 0] for action, name in enumerate(totals)}
    for sense in ("max", "min"):
        # Costs are the same numbers below 0, and the best are the lowest.
        model = mdp if sense == "max" else mdp.negated()
        ax = tradeoff(model, ["gain", "saved"]).plot(policies=policies)
        assert legend_of(ax)[1:] == [
            "wait (on the front)",
            "treat (on the front)",
            "dear (dominated)",
            "late (distance 0.5)",
        ]
        plt.close(ax.figure)


PROVEN = {
    "tradeoff yuan2025 anger done=subtask-complete-1/2*trial": "vertices",
    "solve yuan2025 --subject-to 'anger >= -1/10'": "start value",
    "solve yuan2025 --subject-to 'anger >= 1/10'": "anger >= 0",
}


@pytest.mark.parametrize("line", PROVEN)
def test_a_proof_is_written_and_what_it_holds_is_shown(line: str, tmp_path: Path) -> None:
    proof = tmp_path / "proof.json"
    result = run(line, *SMALL, "--certificate", proof, "--json").result
    exact = [*(result.get("prices") or {}).values()]
    exact += [each["values"]["done"] for each in result.get("vertices", [])]
    read = run("verify", proof, "yuan2025", *SMALL)
    assert (read.status, "holds (certified)" in read.out) == (0, True)
    assert PROVEN[line] in read.out
    for number in exact:  # short ones as they are
        assert number in read.out or f"{float(Fraction(number)):.10g}" in read.out
    assert run("verify", proof, "yuan2025").status == 1
    proof.write_text(proof.read_text().replace('"kind"', '"kinds"'))
    assert run("verify", proof, "yuan2025", *SMALL).status == 2
