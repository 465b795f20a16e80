"""Episodes that stop after N steps, against recursions that share nothing with the toolkit."""

import json
from fractions import Fraction as F
from pathlib import Path

import gymnasium
import numpy as np
import pytest
from cli_runner import run, strict
from oracle import by_table

from exact_mdp import (
    MDP,
    ModelError,
    Policy,
    certify,
    check,
    cohort_trace,
    evaluate,
    fingerprint,
    load,
    save,
    simulate,
    solve,
)

LAKE = "FrozenLake-v1"


@pytest.mark.parametrize(
    ("name", "steps", "value"), [(LAKE, 100, 0.7441903), ("FrozenLake8x8-v1", 200, 0.9132202)]
)
def test_known_optima_within_the_registered_limit(name: str, steps: int, value: float) -> None:
    mdp = MDP.from_gymnasium(name)
    assert mdp.time_limit == steps
    solution = solve(mdp, horizon=steps)
    assert solution.start_value == pytest.approx(value, abs=1e-7)
    wanted, _ = by_table(gymnasium.make(name).unwrapped.P, steps)
    assert abs(solution.start_value - wanted[0]) <= solution.start.error + 1e-13
    assert (solution.value.reshape(steps + 1, -1)[steps] == 0).all()


def test_tables_over_states_and_over_times_are_both_policies() -> None:
    """(S, A) is the same at every time, (N, S, A) is not; arrays of choices likewise."""
    mdp, steps, table = MDP.from_gymnasium(LAKE), 20, gymnasium.make(LAKE).unwrapped.P
    _, tables = by_table(table, steps)
    whole = np.array(tables)
    assert whole.shape == (steps, 16, 4)
    best = solve(mdp, horizon=steps).start_value
    choices = whole.argmax(axis=2)
    one_hot = np.eye(4)[choices]
    for given in (choices, one_hot):
        assert evaluate(mdp, given, horizon=steps).mean == pytest.approx(best, abs=1e-12)
    audit = check(mdp, whole, horizon=steps)
    assert float(audit.regret.at_start.value) < 1e-15
    assert audit.q_error is not None
    assert audit.q_error.largest < 1e-12
    first = choices[0]
    wanted = by_table(table, steps, choices=first)[0][0]
    assert wanted < best - 1e-3
    for given in (
        first,
        one_hot[0],
        Policy.of(mdp, whole[0], kind="q"),
        {str(s): str(a) for s, a in enumerate(first)},
    ):
        assert evaluate(mdp, given, horizon=steps).mean == pytest.approx(wanted, abs=1e-12)
    lost = check(mdp, whole[0], horizon=steps)
    assert float(lost.regret.learned.value) == pytest.approx(wanted, abs=1e-12)
    assert lost.policy.columns == ("row", "column")
    for named in ("random", "always:1"):
        assert 0 <= evaluate(mdp, named, horizon=steps).mean < best


def test_it_is_earned_with_the_last_step_and_is_a_component() -> None:
    """Steps stay N, returns hold it, limits and parts of the reward count it apart."""
    rows = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, components={"effort": [1, 0]}).within(1, terminal_value={1: 4})
    evaluation = evaluate(mdp, "random")
    assert evaluation.components == {"effort": 1.0, "terminal value": 2.0}
    assert (evaluation.mean, evaluation.steps) == (3.0, 1.0)
    quantiles = evaluation.quantiles
    assert quantiles is not None
    assert (quantiles[0.05], quantiles[0.95]) == (1, 5)
    assert solve(mdp, subject_to={"terminal value": ">= 2"}).start_value == 3


# ---- the limit of an environment ---------------------------------------------------------------


def walk() -> MDP:
    """From a to b or c, and from b to a; only b is home."""
    rows = [[[0, "1/2", "1/2"], [1, 0, 0], [0, 0, 1]], [[0, 0, 1], [0, 1, 0], [0, 0, 1]]]
    labels = {"home": [False, True, False]}
    return MDP.from_arrays(rows, [1, 4, 0], "1/2", states=["a", "b", "c"], labels=labels)


def test_without_a_step_a_value_is_the_terminal_one_and_home_is_where_one_is() -> None:
    """V_0(s) = v(s), and P(F<=0 home) = 1 in home, 0 elsewhere."""
    mdp = walk()
    assert list(certify(mdp.within(0)).value) == [0, 0, 0]
    assert list(certify(mdp.within(0, terminal_value=[3, -1, "1/3"])).value[:3]) == [3, -1, F(1, 3)]
    assert solve(mdp, horizon=0, terminal_value={"b": 7}).value[:3].tolist() == [0, 7, 0]
    for asked in (mdp.reaching("home").within(0), mdp.within(0).reaching("home")):
        assert list(certify(asked).value[:3]) == [0, 1, 0]
    until = mdp.with_(discount=1).until("home").within(0)
    assert certify(until).value.tolist() == [float("inf"), 0, float("inf")]
    begun = mdp.reaching("state=b").with_(start="b")
    assert evaluate(begun, "random", horizon=0).mean == 1
    assert simulate(begun, "random", 5, 0, horizon=0).returns.tolist() == [1] * 5
    assert check(begun, "random", horizon=0).passed
    assert simulate(mdp, "random", 5, 0, horizon=0).truncated == 5


@pytest.mark.parametrize("steps", [0, 1, 2])
def test_a_horizon_is_called_by_its_number_of_steps_with_a_terminal_value_or_not(
    steps: int,
) -> None:
    for end in (None, [3, -1, 2]):
        asked = walk().within(steps, terminal_value=end)
        assert f", horizon {steps}, start" in str(check(asked, "random"))
        assert len(cohort_trace(asked, "random").frame()) == steps + 1


def test_a_probability_earns_no_terminal_value(tmp_path: Path) -> None:
    mdp, end = walk(), {"a": 5}
    with pytest.raises(ModelError, match="probability"):
        mdp.reaching("home").within(1, terminal_value=end)
    both = mdp.within(1, terminal_value=end).reaching("home")
    assert list(certify(both).value[:3]) == [F(1, 2), 1, 0]
    with pytest.raises(ModelError, match=r"within\(0\).reaching"):
        mdp.reaching("home").with_(discount="1/2").within(0)
    path = str(tmp_path / "walk.json")
    save(mdp, path)
    options = ("--reach", "home", "--horizon", "0", "--start")
    for name, chance in (("a", 0), ("b", 1)):
        assert strict(run("solve", path, *options, name, "--json").out)["start_value"] == chance


def test_a_model_keeps_the_limit_of_its_environment(tmp_path: Path) -> None:
    """From the registration or the wrappers, through changes and through the project's file."""
    bare = gymnasium.make(LAKE).unwrapped
    limits = {
        100: gymnasium.make(LAKE),
        7: gymnasium.wrappers.TimeLimit(bare, 7),
        9: gymnasium.wrappers.TimeLimit(gymnasium.make(LAKE, max_episode_steps=9), 300),
        None: gymnasium.make(LAKE, max_episode_steps=-1),
    }
    for limit, env in limits.items():
        assert MDP.from_gymnasium(env).time_limit == limit
    assert MDP.from_gymnasium("CliffWalking-v1").time_limit is None
    mdp = MDP.from_gymnasium(LAKE).with_(discount="1/2")
    for name in ("lake.npz", "lake.json"):
        save(mdp, tmp_path / name)
        assert load(tmp_path / name).time_limit == mdp.time_limit == 100
    content = json.loads((tmp_path / "lake.json").read_text("utf-8"))
    del content["time_limit"]  # as in files of other programs
    (tmp_path / "lake.json").write_text(json.dumps(content), "utf-8")
    assert load(tmp_path / "lake.json").time_limit is None
    assert certify(mdp).violations() == []
    assert mdp.within(3).time_limit is None
    # It changes no transition and no certificate.
    assert fingerprint(mdp) == fingerprint(mdp.with_(time_limit=None))


COMMANDS = {
    "solve": (),
    "returns": ("random",),
    "evaluate": ("random",),
    "check": ("random", "--no-explain"),
    "simulate": ("random", "--episodes", "50"),
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_says_once_that_it_leaves_the_limit_out(command: str, tmp_path: Path) -> None:
    words = (command, f"gymnasium:{LAKE}", *COMMANDS[command], "--json")
    within = run(*words, "--horizon", "100")
    assert (within.err, strict(within.out)["horizon"]) == ("", 100)
    other = run(*words, "--horizon", "20").err
    said = "the environment stops after 100 steps; this answer is for episodes of 20 steps"
    assert other.count(said) == 1
    if command == "returns":  # for discount 1 alone
        assert sum(within.result["distribution"].values()) == pytest.approx(1, abs=1e-12)
        return
    done = run(*words, "--discount", "9/10")
    assert done.err.count("the environment stops after 100 steps") == 1
    assert "--horizon 100" in done.err
    assert strict(done.out)["horizon"] is None
    if command == "check":
        run(*words, "--discount", "9/10", "--html", f"{tmp_path}/p.html")
        assert "Note: the environment stops after 100 steps" in (tmp_path / "p.html").read_text()
