"""The commands: what they compute and write, against an independent model; proofs as files."""

import io
import json
import re
import warnings
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from care_oracle import Oracle, oracle_of
from cli_runner import ROOT, run

from exact_mdp import SOLVERS, Policy, Scenario, fingerprint, load

SMALL = "--set tasks=[2] --set max_trial=2"
COLUMN_TO_ROW = "readings.influence_orientation=column-to-row"
# Two actions that do the same at the same price: the optimum is not unique.
TWINS = (
    "--set assistance.non-directive.forgetfulness.persistence=0.05 --set tasks=[1] "
    "--set assistance.non-directive.confusion.persistence=0.05 --set reward.assist.non-directive=-5"
)
# ---- info ------------------------------------------------------------------------------------


def test_settings_change_the_model() -> None:
    words = "--set tasks=[3,1] --set base.anger=1/10 --set discount=0.5 --discount 19/20"
    info = run(f"info yuan2025 {words} --json").result
    assert info["tasks"] == [3, 1]
    assert info["parameters"]["base.anger"] == "1/10"
    assert (info["discount"], info["discount_exact"]) == (0.95, "19/20")


# ---- solve -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        "",
        f"--set {COLUMN_TO_ROW} {SMALL}",
        "--set tasks=[1] --discount 19/20",
        "--set readings.skip_timestep=own --set tasks=[1,1] --set max_trial=2",
        f"--set readings.task_bonus=no-subtask-skipped {SMALL}",
        "--set base.anger=0 --set reward.anger=0 --set tasks=[1]",
        TWINS,
    ],
)
def test_solve_agrees_with_the_oracle(words: str) -> None:
    oracle = described(words)
    plain = run(f"solve yuan2025 {words} --json").result
    best = oracle.value(oracle.start)
    assert abs(Fraction(plain["start_value"]) - best) <= Fraction(plain["error_bound"])
    assert plain["error_bound"] < 1e-9
    assert (plain["claim"], plain["exact_start_value"], plain["unique"]) == ("bounded", None, None)

    exact = run(f"solve yuan2025 {words} --json --certify").result
    assert exact["claim"] == "certified"
    assert Fraction(exact["exact_start_value"]) == best
    assert abs(Fraction(exact["start_value"]) - best) <= Fraction(exact["error_bound"])

    for answer in (plain, exact):
        assert list(answer["policy"]) == [format(status, "04b") for status in range(16)]
        for label, action in answer["policy"].items():
            status = tuple(int(digit) for digit in label)
            assert action in oracle.optimal_actions((0, 0, 1, status))
    assert exact["stationary"] == is_stationary(oracle)
    # Bounds cannot tell whether actions tie.
    assert plain["stationary"] == (None if words == TWINS else is_stationary(oracle))
    assert exact["unique"] == (words != TWINS)


def described(words: str) -> Oracle:
    """Return the oracle's model of the same settings."""
    scenario = Scenario.load("yuan2025")
    for flag, word in zip(words.split()[::2], words.split()[1::2], strict=True):
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


def test_a_tolerance_out_of_reach_is_told_of() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("default")
        done = run("solve yuan2025 --tol 1e-300 --json")
    assert done.status == 0
    said = (
        r"warning: the error bound is \S+: double precision reaches its limit above the tolerance"
    )
    assert re.match(said, done.err)
    assert done.err.count("\n") == 1
    assert json.loads(done.out)["error_bound"] > 1e-300


def test_solve_writes_policy_arrays_and_their_records(tmp_path: Path) -> None:
    policy, arrays = tmp_path / "policy.csv", tmp_path / "arrays.npz"
    words = f"yuan2025 --set {COLUMN_TO_ROW} --json"
    solved = run(f"solve {words}", "--policy-out", policy, "--out", arrays).result
    assert solved["written"] == [str(policy), str(arrays)]
    mdp = load("yuan2025", sets=[COLUMN_TO_ROW])
    for path in (policy, arrays):
        evaluation = run(f"evaluate {words}", path).result
        assert abs(evaluation["mean"] - solved["start_value"]) <= (
            evaluation["error_bound"] + solved["error_bound"]
        )
        record = json.loads(path.with_suffix(".run.json").read_text("utf-8"))
        assert record["model_hash"] == fingerprint(mdp)
        assert record["solver"] == solved["solver"]
        assert record["command"][:2] == ["solve", "yuan2025"]
        assert {"python", "numpy", "scipy", "exact-mdp"} <= set(record["versions"])
        assert record["seed"] is None
        assert bool(record["commit"]) == (ROOT / ".git").exists()
    with np.load(arrays) as archive:
        assert archive["value"][0] == solved["start_value"]
        assert archive["q"].shape == (241, 4)
        assert np.nanmax(archive["q"], axis=1) == pytest.approx(archive["value"])
        chosen = Policy.of(mdp, archive["policy"])
    assert (chosen.choices(mdp) == Policy.of(mdp, policy).choices(mdp)).all()


def test_a_loose_tolerance_does_not_make_an_optimum_stationary() -> None:
    """Here the best action of a status changes with the trial: bounds may not deny it."""
    model = f"solve yuan2025 --set {COLUMN_TO_ROW} --json"
    for more, answer in (("--certify", False), ("", False), ("--tol 50", None)):
        method = " --method value-iteration" * (answer is None)
        assert run(f"{model} {more}{method}").result["stationary"] is answer
    assert run("solve yuan2025 --json").result["stationary"] is True


def test_both_checkers_have_to_accept_a_proof(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    proof = tmp_path / "proof.json"
    run("solve tea --certify --certificate", proof)
    both = "holds (certified, by the proven checker, too)"
    for more, said in ((["--proven"], both), ([], "holds (certified)")):
        done = run("verify", proof, "tea", *more)
        assert (done.status, said in done.out) == (0, True)
    monkeypatch.setattr("exact_mdp.solvers.exact.verified.holds", lambda *_: False)
    done = run("verify", proof, "tea", "--proven", "--json")
    wrong = ["the checker whose soundness is proven does not accept it"]
    assert (done.status, done.result["holds"], done.result["violations"]) == (1, False, wrong)
    assert run("verify", proof, "tea").status == 0


def test_a_file_may_be_standard_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    proof, records, model = (tmp_path / name for name in ("proof.json", "records.csv", "m.npz"))
    run("solve tea --certify --certificate", proof)
    records.write_text("episode,state,action,reward,next_state\n0,a,stay,1,\n", "utf-8")
    policy = json.dumps({f"{status:03b}": "wait" for status in range(8)})
    run("convert tea", whole := tmp_path / "tea.json")
    for words, text, status in (
        (("info", "-"), whole.read_text("utf-8"), 0),
        (("evaluate", "tea", "-"), policy, 0),
        (("check", "tea", "-"), policy, 1),
        (("verify", "-", "tea"), proof.read_text("utf-8"), 0),
        (("data", "-", "--out", model), records.read_text("utf-8"), 0),
        (("lint", "-"), "tasks = [0]", 1),
    ):
        pipe = io.BufferedReader(io.BytesIO(text.encode()))  # which makes room for all it may read
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(pipe))
        done = run(*words, "--json")
        assert done.status == status, (words, done.err)
        assert json.loads(done.out)
    for text in ("", "tasks = [1]\n"):
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
        assert "(-) takes JSON, such as a model.json" in run("solve -").refusal()


def test_the_help_names_every_solver() -> None:
    helped = re.sub(r"-\s+", "-", run("solve --help").out)  # names are broken at their hyphens
    assert [name for name in SOLVERS if name not in helped] == []


def test_the_program_alone_shows_its_help() -> None:
    alone, helped = run(), run("-h")
    assert (alone.status, helped.status) == (2, 0)
    assert alone.out + alone.err == helped.out


def test_a_range_that_is_given_twice_is_refused(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / f"{name}.toml").write_text('"base.anxiety" = [0.02, 0.1]\n')
    for other in (tmp_path / "two.toml", "base.anxiety=0:0.2"):
        words = ("tornado", "tea", "--range", tmp_path / "one.toml", "--range", other)
        assert "the range of base.anxiety is given twice" in run("", *words).refusal()
