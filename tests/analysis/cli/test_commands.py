"""The commands: what they compute and write, against an independent model; proofs as files."""

import io
import json
import re
import warnings
from collections.abc import Mapping
from fractions import Fraction
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from care_oracle import ACTIONS, END, Oracle, State, oracle_of
from cli_runner import run

from exact_mdp import Policy, Scenario, fingerprint, load

SMALL = ("--set", "tasks=[2]", "--set", "max_trial=2")
COLUMN_TO_ROW = ("--set", "readings.influence_orientation=column-to-row")

TWINS = (  # two actions that do the same at the same price: the optimum is not unique
    *("--set", "assistance.non-directive.forgetfulness.persistence=0.05"),
    *("--set", "assistance.non-directive.confusion.persistence=0.05"),
    *("--set", "reward.assist.non-directive=-5", "--set", "tasks=[1]"),
)


def uniformly(state: State) -> Mapping[str, Fraction]:
    return dict.fromkeys(ACTIONS, Fraction(1, len(ACTIONS)))


# ---- info ------------------------------------------------------------------------------------


def test_info_describes_the_care_model() -> None:
    found = run("info", "yuan2025", "--json").result
    expected = {
        "model": "yuan2025",
        "states": 241,
        "pairs": 961,
        "transitions": 8065,
        "actions": 4,
        "discount": 1.0,
        "terminates": True,
        "acyclic": True,
        "never_ends": None,
        "reachable": len(Oracle().reachable()),
    }
    assert found.items() >= expected.items()
    assert found["action_names"] == list(ACTIONS)
    assert found["model_hash"] == fingerprint(load("yuan2025"))


def test_info_names_a_policy_that_never_ends() -> None:
    found = run("info", "gymnasium:FrozenLake-v1", "--json").result
    assert (found["terminates"], found["acyclic"], found["states"]) == (False, False, 16)
    assert found["never_ends"]["states"] > 0
    assert set(found["never_ends"]["policy"].values()) <= set(found["action_names"])


def test_settings_change_the_model() -> None:
    words = ("--set", "tasks=[3,1]", "--set", "base.anger=1/10", "--set", "discount=0.5")
    found = run("info", "yuan2025", *words, "--discount", "19/20", "--json").result
    assert found["tasks"] == [3, 1]
    assert found["parameters"]["base.anger"] == "1/10"
    assert (found["discount"], found["discount_exact"]) == (0.95, "19/20")


# ---- solve -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        (),
        (*COLUMN_TO_ROW, *SMALL),
        ("--set", "tasks=[1]", "--discount", "19/20"),
        ("--set", "readings.skip_timestep=own", "--set", "tasks=[1,1]", "--set", "max_trial=2"),
        ("--set", "readings.task_bonus=no-subtask-skipped", *SMALL),
        ("--set", "base.anger=0", "--set", "reward.anger=0", "--set", "tasks=[1]"),
        TWINS,
    ],
)
def test_solve_agrees_with_the_oracle(words: tuple[str, ...]) -> None:
    oracle = described(words)
    plain = run("solve", "yuan2025", *words, "--json").result
    best = oracle.value(oracle.start)
    assert abs(Fraction(plain["start_value"]) - best) <= Fraction(plain["error_bound"])
    assert plain["error_bound"] < 1e-9
    assert (plain["claim"], plain["exact_start_value"], plain["unique"]) == ("bounded", None, None)

    exact = run("solve", "yuan2025", *words, "--json", "--certify").result
    assert exact["claim"] == "certified"
    assert Fraction(exact["exact_start_value"]) == best
    assert abs(Fraction(exact["start_value"]) - best) <= Fraction(exact["error_bound"])

    for found in (plain, exact):
        assert list(found["policy"]) == [format(status, "04b") for status in range(16)]
        for label, action in found["policy"].items():
            status = tuple(int(digit) for digit in label)
            assert action in oracle.optimal_actions((0, 0, 1, status))
    assert exact["stationary"] == is_stationary(oracle)
    # Bounds cannot tell whether actions tie.
    assert plain["stationary"] == (None if words == TWINS else is_stationary(oracle))
    optimal = [oracle.optimal_actions(state) for state in optimally_reached(oracle)]
    assert exact["unique"] == all(len(actions) == 1 for actions in optimal)
    assert exact["unique"] == (words != TWINS)


def described(words: tuple[str, ...]) -> Oracle:
    """Return the oracle's model of the same settings."""
    scenario = Scenario.load("yuan2025")
    for flag, word in zip(words[::2], words[1::2], strict=True):
        scenario = scenario.set(word if flag == "--set" else f"discount={word}")
    return oracle_of(scenario)


def is_stationary(oracle: Oracle) -> bool:
    """Return whether one action for each status is optimal in all states that can be reached."""
    common: dict[object, frozenset[str]] = {}
    for state in oracle.reachable():
        if len(oracle.actions(state)) > 1:
            actions = oracle.optimal_actions(state)
            common[state[3]] = common.get(state[3], actions) & actions
    return all(common.values())


def optimally_reached(oracle: Oracle) -> set[State]:
    """Return the states that optimal actions reach from the start, the end aside."""
    found, todo = {oracle.start}, [oracle.start]
    while todo:
        state = todo.pop()
        for action in oracle.optimal_actions(state):
            following = {then for _, then, _, _ in oracle.outcomes(state, action)}
            todo += following - found - {END}
            found |= following - {END}
    return found


@pytest.mark.parametrize(
    "method",
    [
        "value-iteration",
        "gauss-seidel",
        "modified-policy-iteration",
        "policy-iteration",
        "backward-induction",
        "linear-program",
    ],
)
def test_every_method_finds_the_same(method: str) -> None:
    words = ("--set", "tasks=[1]", "--method", method, "--json")
    found = run("solve", "yuan2025", *words).result
    oracle = Oracle(tasks=[1])
    assert found["method"] == method
    assert found["iterations"] >= 1
    assert found["seconds"] >= 0
    assert abs(found["start_value"] - oracle.value(oracle.start)) <= found["error_bound"]


def test_solve_a_model_without_statuses() -> None:
    words = ("gymnasium:FrozenLake-v1", "--discount", "99/100", "--json", "--certify")
    found = json.loads(run("solve", *words).out)
    assert found["start_value"] == pytest.approx(0.542, abs=5e-4)
    assert (found["policy"], found["stationary"]) == (None, None)
    assert len(found["policy_by_state"]) == 16
    assert found["claim"] == "certified"


def test_a_tolerance_out_of_reach_is_told_of() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        done = run("solve", "yuan2025", "--tol", "1e-300", "--json")
    assert done.status == 0
    assert re.fullmatch(r"warning: the error bound is \S+, above the tolerance 1e-300\n", done.err)
    assert json.loads(done.out)["error_bound"] > 1e-300


def test_solve_writes_policy_arrays_and_their_records(tmp_path: Path) -> None:
    policy, arrays = tmp_path / "policy.csv", tmp_path / "arrays.npz"
    words = ("yuan2025", *COLUMN_TO_ROW)
    solved = run("solve", *words, "--policy-out", policy, "--out", arrays, "--json").result
    assert solved["written"] == [str(policy), str(arrays)]
    mdp = load("yuan2025", sets=COLUMN_TO_ROW[1:])
    for path in (policy, arrays):
        found = run("evaluate", *words, path, "--json").result
        assert abs(found["mean"] - solved["start_value"]) <= (
            found["error_bound"] + solved["error_bound"]
        )
        record = json.loads(path.with_suffix(".run.json").read_text("utf-8"))
        assert record["model_hash"] == fingerprint(mdp)
        assert record["solver"] == solved["solver"]
        assert record["command"][:2] == ["solve", "yuan2025"]
        assert {"python", "numpy", "scipy", "exact-mdp"} <= set(record["versions"])
        assert record["seed"] is None
        assert "commit" in record
    with np.load(arrays) as held:
        assert held["value"][0] == solved["start_value"]
        assert held["q"].shape == (241, 4)
        assert np.nanmax(held["q"], axis=1) == pytest.approx(held["value"])
        chosen = Policy.from_choices(mdp, held["policy"])
    assert (chosen.choices(mdp) == Policy.of(mdp, policy).choices(mdp)).all()


# ---- evaluate, returns, simulate -------------------------------------------------------------


@pytest.mark.parametrize("words", [SMALL, (*SMALL, *COLUMN_TO_ROW, "--discount", "19/20")])
def test_evaluate_agrees_with_the_oracle(words: tuple[str, ...]) -> None:
    oracle = described(words)
    exact = oracle.evaluate(uniformly, distribution=False)
    found = run("evaluate", "yuan2025", "random", *words, "--json").result
    assert found["claim"] == "bounded"
    assert abs(found["mean"] - exact["mean"]) <= found["error_bound"] < 1e-9
    assert found["sd"] == pytest.approx(sqrt(exact["variance"]))
    assert found["steps"] == pytest.approx(float(exact["steps"]))
    assert found["skip_probability"] == pytest.approx(float(exact["skip_probability"]))
    assert sum(found["components"].values()) == pytest.approx(found["mean"])
    for name, total in exact["components"].items():
        assert found["components"][name] == pytest.approx(float(total), abs=1e-12)
    assert (found["quantiles"] is None) == ("--discount" in words)


def test_a_policy_that_may_never_end_has_no_number_of_steps() -> None:
    words = ("gymnasium:FrozenLake-v1", "always:0", "--discount", "0.9", "--json")
    found = json.loads(run("evaluate", *words).out)
    assert (found["ends"], found["steps"], found["skip_probability"]) == (
        True,
        found["steps"],
        None,
    )
    words = ("gymnasium:CliffWalking-v1", "always:0", "--discount", "0.9")
    found = run("evaluate", *words, "--json").result
    assert (found["ends"], found["steps"]) == (False, "inf")
    assert found["mean"] == pytest.approx(-10)
    assert "it may never end" in run("evaluate", *words).out


def test_quantiles_rise() -> None:
    found = run("evaluate", "yuan2025", "random", *SMALL, "--json").result["quantiles"]
    assert list(found) == ["0.05", "0.25", "0.5", "0.75", "0.95"]
    assert sorted(found.values()) == list(found.values())


def test_returns_agree_with_the_oracle() -> None:
    words = ("--set", "tasks=[1]", "--set", "reward.timestep=-1/2", "--set", "reward.trial=1/3")
    exact = described(words).evaluate(uniformly)["distribution"]
    found = run("returns", "yuan2025", "random", *words, "--exact", "--json").result
    assert {Fraction(value) for value in found["distribution"]} == set(exact)
    for value, chance in found["distribution"].items():
        assert abs(chance - exact[Fraction(value)]) <= found["error_bound"]
    given = {Fraction(x): Fraction(p) for x, p in found["exact_distribution"].items()}
    assert given == exact
    assert found["mean"] == pytest.approx(float(sum(x * p for x, p in exact.items())))


def test_whole_returns_are_printed_as_integers() -> None:
    found = run("returns", "yuan2025", "optimal", "--json").result
    assert all(re.fullmatch(r"-?[0-9]+", value) for value in found["distribution"])
    assert sum(found["distribution"].values()) == pytest.approx(1)
    mean = sum(int(value) * chance for value, chance in found["distribution"].items())
    assert found["mean"] == pytest.approx(mean)
    assert "exact_distribution" not in found


def test_simulate_agrees_with_evaluate() -> None:
    words = ("yuan2025", "random", "--set", "tasks=[1]")
    exact = run("evaluate", *words, "--json").result
    found = run("simulate", *words, "--episodes", 20_000, "--json").result
    assert (found["claim"], found["episodes"], found["seed"]) == ("estimated", 20_000, 0)
    assert abs(found["mean"] - exact["mean"]) < 4 * found["standard_error"]
    assert found["standard_error"] == pytest.approx(exact["sd"] / sqrt(20_000), rel=0.05)
    shown = run("simulate", *words, "--episodes", 20_000).out
    assert f"(estimated, standard error {found['standard_error']:.2g})" in shown
    same = run("simulate", *words, "--episodes", 20_000, "--seed", 0, "--json")
    assert same.result == found
    other = run("simulate", *words, "--episodes", 20_000, "--seed", 1, "--json").result
    assert other["mean"] != found["mean"]


def test_convert_keeps_the_model(tmp_path: Path) -> None:
    path = tmp_path / "tea.npz"
    found = run("convert", "tea", path, "--set", "max_trial=2", "--json").result
    assert found["written"] == str(path)
    saved = load("tea", sets=["max_trial=2"])
    assert fingerprint(load(path)) == fingerprint(saved)
    first = run("solve", "tea", "--set", "max_trial=2", "--json", "--certify").result
    again = run("solve", path, "--json", "--certify").result
    for key in ("exact_start_value", "policy", "stationary", "unique"):
        assert again[key] == first[key]


def test_verify_tells_proofs_from_what_is_none(tmp_path: Path) -> None:
    exact, bounds = tmp_path / "exact.json", tmp_path / "bounds.json"
    solved = run("solve", "yuan2025", "--certify", "--certificate", exact, "--json").result
    run("solve", "yuan2025", "--certificate", bounds, "--json")
    done = run("verify", exact, "yuan2025", "--json")
    assert (done.status, done.result["holds"], done.result["claim"]) == (0, True, "certified")
    for key in ("exact_start_value", "unique", "start_value"):
        assert done.result[key] == solved[key]
    done = run("verify", bounds, "yuan2025", "--json")
    assert (done.status, done.result["holds"], done.result["claim"]) == (0, True, "bounded")
    value = Fraction(solved["exact_start_value"])
    assert abs(Fraction(done.result["start_value"]) - value) <= done.result["error_bound"]

    for path in (exact, bounds):
        done = run("verify", path, "yuan2025", "--set", "base.anger=0.06", "--json")
        assert (done.status, done.result["holds"]) == (1, False)
        assert done.result["violations"]
    assert "does not hold" in run("verify", exact, "yuan2025", "--discount", "0.9").out

    content = json.loads(exact.read_text("utf-8"))
    top, _, below = content["start_value"].partition("/")
    content["start_value"] = f"{hex(int(top, 16) + 1)}/{below}"
    exact.write_text(json.dumps(content), "utf-8")
    done = run("verify", exact, "yuan2025", "--json")
    assert (done.status, done.result["holds"]) == (1, False)

    np.savez(tmp_path / "solution.npz", value=np.zeros(3))
    done = run("verify", tmp_path / "solution.npz", "yuan2025")
    assert done.status == 2
    assert "not a certificate" in done.err
    assert "--certificate F.json" in done.err


def test_a_loose_tolerance_does_not_make_an_optimum_stationary() -> None:
    """Here the best action of a status changes with the trial: bounds may not deny it."""
    model = ["solve", "yuan2025", "--set", "readings.influence_orientation=column-to-row", "--json"]
    found = [
        run(*model, *more).result["stationary"]
        for more in (["--certify"], [], ["--method", "value-iteration", "--tol", "50"])
    ]
    assert found == [False, False, None]
    usual = run("solve", "yuan2025", "--json").result["stationary"]
    assert usual is True


def test_a_file_may_be_standard_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    proof, records, model = (tmp_path / name for name in ("proof.json", "records.csv", "m.npz"))
    run("solve", "tea", "--certify", "--certificate", proof)
    records.write_text("episode,state,action,reward,next_state\n0,a,stay,1,\n", "utf-8")
    policy = json.dumps({f"{status:03b}": "wait" for status in range(8)})
    for words, text, status in (
        (("evaluate", "tea", "-"), policy, 0),
        (("check", "tea", "-"), policy, 1),
        (("verify", "-", "tea"), proof.read_text("utf-8"), 0),
        (("data", "-", "--out", model), records.read_text("utf-8"), 0),
        (("lint", "-"), "tasks = [0]", 1),
    ):
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
        done = run(*words, "--json")
        assert done.status == status, (words, done.err)
        assert json.loads(done.out)
