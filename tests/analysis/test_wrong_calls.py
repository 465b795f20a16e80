"""What strangers call: taken where it can mean one thing, else refused with what, where and fix."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction
from itertools import product
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cli_runner import run

import exact_mdp
from exact_mdp import (
    MDP,
    Constant,
    Family,
    ModelError,
    OffPolicy,
    Policy,
    QLearning,
    Scenario,
    assert_policy_optimal,
    check,
    cost_effectiveness,
    curve,
    gradient,
    load,
    moving,
    one_way,
    psa,
    rationalize,
    robust,
    robust_curve,
    sobol,
    study,
    thresholds,
    tornado,
    two_way,
    worst_point,
)

STATES = ["a", "b"]
SLOW, FAST = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
P = {"slow": SLOW, "fast": FAST}
REWARDS = [[1, "3/2"], [0, 0]]
ANY: Any = MDP  # that types do not stop a wrong call
NAMED: Any = {"layout": "ass", "actions": ["slow", "fast"], "states": STATES}
MODEL = MDP.from_arrays([SLOW, FAST], REWARDS, "9/10", **NAMED)
GRID = MDP.from_function(
    (0, 0),
    lambda s: ["right", "down"] if max(s) < 2 else [],
    lambda s, a: [(1, (s[0] + (a == "down"), s[1] + (a == "right")), -1)],
)
CARE = Scenario.load("yuan2025").compile()
SWING = MDP.from_outcomes(
    [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 0, -1)]), (2, 0, [(1, 2, 0)])]
)
FLOATS = Family(
    parameters={"r": 0.15},
    build=lambda at: MDP.from_arrays([[[exp(-at["r"]), 1 - exp(-at["r"])], [0, 1]]], [1, 0], 0.5),
)


def table(rows: list[list[float]], index: list[str], columns: list[str]) -> pd.DataFrame:
    return pd.DataFrame(rows, index=index, columns=columns)


REFUSED = """
QLearning(exploration=MDP) -> not a number; exploration; number
QLearning(exploration=2) -> between 0 and 1; 2; from 0 to 1
QLearning(episodes=5) -> snapshot_episode is 10; QLearning; an epoch has 5 episodes
solve(MODEL, subject_to={"steps": 5}) -> 5 is no limit; steps; >= or <=
compare(MODEL, [[0, 0], [1, 0]]) -> policies without names; compare; {name: policy}
solve(MODEL, 1e-06) -> 1e-06 is not a solver; solve; tol=1e-6
solve(3) -> int is not a model; model; MDP.from_
robust(MODEL, 0.1) -> 0.1 is no set of laws; ambiguity; Intervals.relative(model, 0.1)
tornado(MODEL, ranges=[0, 1]) -> [0, 1] is of type list; ranges; {name: (low, high)}
thresholds(FLOATS, "r") -> not polynomials of degree 1 in r; parameter r; not with floats
tornado(3) -> int is not a model; model; a Family
MODEL.reaching(["x"]) -> unknown label ['x']; labels; the model has none
MODEL.component(3) -> unknown component 3; components; choose one of reward
save(3, "x.npz") -> 3 is of type int; save; save(model, path)
save("x.npz", MODEL) -> 'x.npz' is of type str; save; save(model, path)
MDP.save("x.npz", MODEL) -> 'x.npz' is of type str; save; model.save(path)
MDP.from_arrays(P, REWARDS, gamma=0.9) -> gamma=; MDP; say discount=
MDP.from_pairs([0], [0], [[1]], [0], gamma=0.9) -> gamma=; MDP; say discount=
MDP.from_outcomes([(0, 0, [(1, 0, 0)])], gamma=0.9) -> gamma=; MDP; say discount=
MDP.from_function(0, lambda s: [], lambda s, a: [], gamma=0.9) -> gamma=; MDP; say discount=
MDP.from_transitions("no.csv", gamma=0.9) -> gamma=; MDP; say discount=
MODEL.with_(gamma=0.9) -> gamma=; MDP; say discount=
MDP.from_gymnasium({0: {0: [(1, 0, 0, True)]}}, gamma=0.9) -> gamma=; MDP; say discount=
MDP.from_arrays(P, REWARDS, statess=STATES) -> statess=; MDP; did you mean states?
MDP.from_transitions("no.csv", states=STATES) -> states=; MDP; leave it out
MODEL.pair("a") -> 'a' is not; pair; both
GRID.pair((0, 1)) -> (0, 1) is not; pair; both
MDP.from_arrays([SLOW], [1, 0], states=["a", "a"]) ->
    two states have the same name, 'a'; column state; own name
MDP.from_arrays([SLOW, FAST], REWARDS, layout="ass", actions=["x", "x"]) ->
    two actions have the same name, 'x'; actions; own name
MDP.from_arrays([SLOW], [1, 0], start={0: "1/2", 1: "0.50000001"}) ->
    start probabilities sum to 1 + 1e-08, not 1; start; give a distribution
MDP.from_arrays({"go": table([[1]], ["a"], ["b"])}, [0]) ->
    the labels b, and the states are a; P; a row and a column for each state
MODEL.space.label(2) ->
    there is no state 2: numbers go from 0 to 1; state space; choose one of these
Policy.of(MODEL, [0, 9]) ->
    there is no action 9: numbers go from 0 to 1; policy; choose one of these
Policy.of(MODEL, {("a", "slow"): 1}) -> an action value is NaN; state a; every available action
Policy.of(MODEL, {("a", "slow"): 1, ("x", "slow"): 1}) ->
    unknown state 'x'; policy; choose one of a, b
Policy.of(MODEL, {("a", "slow"): 1, ("a", "fats"): 1}) ->
    unknown action 'fats'; policy; did you mean fast?
check(THREE, np.array([[1.0, 2, 3]])) -> a row for each action; policy; transpose, of shape (3, 1)
check(ENDING, np.zeros((2, 3))) -> a row for each action; policy; transpose, of shape (3, 2)
check(ENDING, np.zeros((5, 2))) ->
    no policy of this model; policy; give (4, 2) over all states or (3, 2) over all but end
check(ENDING, np.zeros((3, 2)), gamma=0.9) -> gamma=; check; from_gymnasium(env, discount=
check("yuan2052", "random") -> 'yuan2052'; model; yuan2025
check(MODEL, [0, 0], like=3) -> of another model; like; check(audit.mdp
MODEL.with_(labels={"goal": [0, 1]}) -> type int64; label goal; numbers of some states
MODEL.with_(labels={"goal": [2]}) -> type int64; label goal; numbers of some states
train(MODEL, 3, 1) -> 3 is no learner; train; QLearning()
train(MODEL, QLearning(), 1) -> needs a seed; rng; rng=0
outcomes(MODEL, 3) -> 3 is no list of runs; runs; list
learning_curve(MODEL, 3, rng=0) -> no run of training; learning; train(model
tradeoff(MODEL, 3) -> a front of 3; tradeoff; two
psa(FLOATS, 9, uncertain={"r": ("beta", 8, 92)}, rng=0) ->
    is stated; parameter r; "distribution": "beta", "mean"
robust_curve(MODEL, "l1", ["much"]) -> 'much' is not; radius; 0.1
robust_curve(MODEL, "kl", [True]) -> True is not a number; radius; write
robust_curve(MODEL, "entropy", [10**400]) -> radius of 1e400; radius; larger than a float
Intervals(lower="much", upper=1) -> 'much' is not; lower; 0.1
solve_robust(MODEL, Intervals.relative(MODEL, 0.1), tol="much") ->
    tol is 'much'; robust; positive number
curve(Family(**FAMILY), "p").at("much") -> 'much' is not; parameter p; 0.1
best_cvar(MODEL.within(2), "much") -> 'much' is not; conditional value at risk; 0.1
study(FLOATS, {"r": ["much"]}) -> 'much' is not; points; 0.1
study(FLOATS, {"r": [10**400]}) -> too large for a float; points; units
tornado(FLOATS, relative="much") -> 'much' is not; relative range; 0.1
return_distribution(CARE, "random").cdf("much") -> 'much' is not; return; 0.1
gradient(MODEL, names=3) -> 3 is no list of names; names; a list
best_policy(MODEL, 3) -> 3 is no list of columns; columns; a list
accuracy_curves(CARE, statuses=3) -> 3 is no list of statuses; statuses; a list
accuracy_curves(CARE, levels=["high"]) -> 'high' is not a finite; levels; 0.1
gradient(SWING, policy=[0, 0, 0]) -> some policy never ends; discount 1; --discount
Policy.of(MODEL, {("a", "slow"): 0.5, ("a", "fast"): 0.5}) ->
    probabilities or a Q-table; state a; kind="policy"
"""


NAMES = {name: getattr(exact_mdp, name) for name in exact_mdp.__all__}


def entries(table: str) -> list[tuple[str, str]]:
    """Return the calls of a table and what is said of them; indented lines go on."""
    rows = re.sub(r"\n {4}", " ", table).strip().splitlines()
    return [(call, said) for call, _, said in (row.rpartition(" -> ") for row in rows)]


@pytest.mark.parametrize(("call", "said"), entries(REFUSED))
def test_refused(call: str, said: str) -> None:
    what, where, fix = said.split("; ")
    with pytest.raises(ModelError) as caught:
        eval(call, NAMES | globals())
    assert what in caught.value.what
    assert where in caught.value.where
    assert fix in caught.value.fix


BUILT: dict[str, Any] = {"parameters": {"p": 1}, "build": lambda at: MODEL}
WRONG_TYPES = """
MODEL.with_(states=3) -> states
MODEL.with_(actions=3) -> actions
MODEL.with_(states="ab") -> states
MODEL.with_(actions="ab") -> actions
MODEL.with_(table=3) -> table
MODEL.with_(pair_state=3) -> pair_state
MODEL.with_(space=3) -> space
MODEL.with_(events=3) -> events
MODEL.with_(parameters=3) -> parameters
MODEL.with_(observations=3) -> observations
MODEL.with_(component_names=3) -> component_names
MODEL.with_(component_table=3) -> component_table
MODEL.with_(action_objects=3) -> action_objects
MODEL.with_(float_rewards=3) -> float_rewards
MODEL.with_(discount_exact=0.5) -> discount_exact
MDP.from_arrays(3, [1]) -> P
MDP.from_arrays([[[1]]], [1], layout=[]) -> layout
MDP.from_arrays([[[1]]], [1], states=3) -> states
MDP.from_arrays([[[1]]], [1], actions=3) -> actions
MDP.from_arrays({0: {0: {0: 1}}}, [1], states=3) -> states
MDP.from_function(0, lambda s: [], lambda s, a: [], labels=3) -> labels
MDP.load("no.prism", constants=3) -> constants
MDP.load("no.npz", gamma=0.9) -> MDP
load("yuan2025", sets=3) -> sets
load("yuan2025", sets=[3]) -> sets
MDP.from_transitions("no.csv", columns=3) -> columns
MDP.from_gymnasium({0: {0: [(1, 0, 0, True)]}}, states=3) -> states
MODEL.by_action([1]) -> by_action
Policy.by(MODEL, 3, [0, 0]) -> columns
Policy.by(MODEL, "state", [0, 0]) -> columns
Policy.of(MODEL, [0, 0], kind=[]) -> kind
Policy.of(MODEL, [0, 0]).write(3) -> path
Policy.of(3, [0, 0]) -> model
Policy.by(3, ["state"], [0, 0]) -> model
Policy.always(3, "slow") -> model
Policy.uniform(3) -> model
Policy.from_choices(3, [0, 0]) -> model
Policy.of(MODEL, [0, 0]).weights(3) -> model
fingerprint(3) -> model
moving(MODEL, 3) -> entries
moving(3, {}) -> model
moving(MODEL, {"p": 3}) -> parameter p
moving(MODEL, {}, 3) -> rewards
Family(parameters={"p": 1}, build=3) -> build
Family(**BUILT, degrees=3) -> degrees
Family(**BUILT, breaks=3) -> breaks
Family(**BUILT, rows=3) -> rows
Family(**BUILT, room=3) -> room
Family(**BUILT, settings=3) -> settings
Family(**BUILT).at(3) -> values
"""


@pytest.mark.parametrize(("call", "where"), entries(WRONG_TYPES))
def test_wrong_types_are_refused_by_their_place(call: str, where: str) -> None:
    with pytest.raises(ModelError) as caught:
        eval(call, NAMES | globals())
    assert caught.value.where == where
    assert caught.value.fix


VARIED = moving(MODEL, {"p": [(0, 0)]})
VARY: dict[Callable[..., object], dict[str, Any]] = {
    gradient: {"model": VARIED, "names": 0, "policy": 0},
    tornado: {"model": VARIED, "names": 0, "ranges": 0, "relative": 0, "policy": 0},
    one_way: {"model": VARIED, "name": "p", "ranges": 0, "points": 2, "relative": 0},
    two_way: {"model": VARIED, "x": "p", "y": "discount", "ranges": 0, "points": 2},
    thresholds: {"model": VARIED, "name": "p", "ranges": 0, "relative": 0},
    curve: {"model": VARIED, "name": "p", "ranges": 0, "policy": 0},
    psa: {"model": VARIED, "n": 2, "uncertain": 0, "policy": 0, "folder": 0, "n_jobs": 0},
    sobol: {"model": VARIED, "n": 2, "rng": 0, "names": 0, "ranges": 0, "confidence": 0},
    worst_point: {"model": VARIED, "ranges": 0, "policy": 0},
    study: {"model": VARIED, "points": {"p": [0.5]}, "policies": 0, "folder": 0},
    robust: {"model": MODEL, "ambiguity": 0, "policy": 0},
    robust_curve: {"model": MODEL, "kind": "l1", "radii": [0], "policy": 0},
    cost_effectiveness: {"model": VARIED, "strategies": {"a": [0, 0]}, "n": 2, "uncertain": 0},
}


@pytest.mark.parametrize(
    "wrong", [3.5, "x", [["x"]], {"x": 1}, ANY and object()], ids=list("12345")
)
@pytest.mark.parametrize("function", VARY)
def test_what_varies_takes_or_refuses_whatever_is_given(
    function: Callable[..., object],
    wrong: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """No option ends in an error that is not the toolkit's own; what is needed is given rightly."""
    monkeypatch.chdir(tmp_path)
    needed = {name: each for name, each in VARY[function].items() if each or name == "rng"}
    for name in VARY[function]:
        with suppress(ModelError):
            function(**needed | {name: wrong})


def test_the_optimal_policy_is_said_to_be_that_of_solve() -> None:
    with pytest.raises(ModelError) as caught:
        Policy.of(MODEL, "optimal")
    assert "give optimal" not in caught.value.fix
    assert "solve(mdp).policy" in caught.value.fix


VALUES = {("a", "slow"): 1, ("a", "fast"): 2, ("b", "slow"): 0, ("b", "fast"): 1}
BY_NAME = {
    "slow": table([[0.5, 0.5], [0, 1]], STATES, STATES),
    "fast": table([[1, 0], [1, 0]], ["b", "a"], ["b", "a"]),
}
SHARES = np.array([0.1, 0.2, 0.7], dtype=np.float32)
ENDING = MDP.from_gymnasium({s: {a: [(1, s, a, a < 1)] for a in (0, 1)} for s in range(3)})
THREE = MDP.from_arrays([np.eye(3)], [1, 2, 3], "1/2")
FAMILY: dict[str, Any] = {
    "parameters": {"p": "1/2"},
    "build": lambda at: MDP.from_arrays([[[at["p"], 1 - at["p"]], [0, 1]]], [1, 0]),
}


def rows(mdp: MDP) -> list[Any]:
    return [mdp.table.row(pair) for pair in range(mdp.n_pairs)]


def test_taken() -> None:
    assert QLearning(exploration=0.2).exploration == Constant(0.2)
    assert QLearning(rate="1/4").rate == Constant(0.25)
    assert QLearning(epochs=np.int64(7)).epochs == 7
    assert Family(**FAMILY, degrees={"p": np.int64(1)}).degree("p") == 1
    assert Family(**FAMILY, breaks={"p": np.array([0.25, 0.5])}).breakpoints("p") == (
        Fraction(1, 4),
        Fraction(1, 2),
    )
    assert THREE.with_(labels={"goal": [2, 0]}).labels["goal"].tolist() == [True, False, True]
    assert check("yuan2025", "optimal").value == check(Scenario.load("yuan2025"), "optimal").value
    assert MODEL.pair(("a", "fast")) == 1
    assert MODEL.with_(states=["x", "y"]).space.label(1) == "state y"
    assert rows(MDP.from_arrays(BY_NAME, REWARDS)) == rows(MODEL)
    assert rows(MDP.from_arrays({"slow": pd.DataFrame([[0.5, 0.5], [0, 1]])}, [1, 0], "9/10")) == [
        rows(MDP.from_arrays([SLOW], [1, 0]))[k] for k in range(2)
    ]
    assert MDP.from_arrays(BY_NAME, REWARDS, states=["b", "a"]).P("fast").toarray().tolist() == [
        [1, 0],
        [1, 0],
    ]
    assert MDP.from_arrays(BY_NAME, {"b": 5, "a": 2}).reward.tolist() == [2, 2, 5, 5]
    assert MDP.from_arrays(
        BY_NAME, {"b": {"slow": 5, "fast": 6}, "a": {"fast": 2, "slow": 1}}
    ).reward.tolist() == [1, 2, 5, 6]
    turned = table([[6, 5], [2, 1]], ["b", "a"], ["fast", "slow"])
    priced = MDP.from_arrays(BY_NAME, turned, components={"cost": turned})
    assert priced.reward.tolist() == priced.components[:, 0].tolist() == [1, 2, 5, 6]
    shares = [Fraction(share) for share in SHARES.tolist()]
    assert THREE.with_(start=SHARES).start == tuple(enumerate(s / sum(shares) for s in shares))
    assert Policy.of(MODEL, VALUES).tolist() == [1, 1]
    assert Policy.of(MODEL, {(0, 0): 3, (0, 1): 2, (1, 0): 0, (1, 1): 0}).tolist() == [0, 0]
    assert Policy.of(MODEL, defaultdict(float, {(0, 1): 3.0})).tolist() == [1, 0]
    late = MODEL.within(3)
    assert Policy.of(late, VALUES).tolist() == Policy.of(late, [[1, 2], [0, 1]]).tolist()
    even = Policy.of(MODEL, {("a", "slow"): 0.5, ("a", "fast"): 0.5}, kind="policy")
    assert even.weights(MODEL)[:2].tolist() == [0.5, 0.5]
    assert Policy.of(
        GRID, {(0, 0): "down", (0, 1): "down", (1, 0): "right", (1, 1): "down"}
    ).weights(GRID).sum() == float(GRID.n_states)


def test_a_table_by_state_and_action_is_never_one_by_row_and_column() -> None:
    gymnasium = pytest.importorskip("gymnasium")
    lake = MDP.from_gymnasium("FrozenLake-v1", is_slippery=False)
    assert lake.n_transitions < MDP.from_gymnasium("FrozenLake-v1").n_transitions
    values = np.random.default_rng(0).integers(0, 4, (16, 4))
    by_pair = {(s, a): values[s, a] for s, a in product(range(16), range(4))}
    wanted = Policy.of(lake, values, kind="q").tolist()
    assert Policy.of(lake, by_pair).tolist() == wanted
    named = {(s, lake.actions[a]): x for (s, a), x in by_pair.items()}
    assert Policy.of(lake, named).tolist() == wanted
    by_place = {(row, column): (row + column) % 4 for row in range(4) for column in range(4)}
    assert Policy.of(lake, by_place).tolist() == list(by_place.values())
    lakes: Any = ("gymnasium:FrozenLake-v1", gymnasium.make("FrozenLake-v1"))
    named, made = (check(each, values, kind="q").value for each in lakes)
    assert named == made == check(MDP.from_gymnasium("FrozenLake-v1"), values, kind="q").value
    with pytest.raises(ModelError, match="there is no option is_slippery="):
        MDP.from_gymnasium({0: {0: [(1, 0, 0, True)]}}, is_slippery=False)


# ---- limits that no policy keeps -----------------------------------------------------------------


def test_no_optimum_is_shown_that_ignores_a_limit(tmp_path: Path) -> None:
    limit = {"steps": "<= 1/2"}
    audit = check(MODEL, [0, 0], subject_to=limit)
    assert not audit.passed
    assert not audit.feasible
    assert audit.disagreements == ()
    assert np.isnan([float(audit.value.value), audit.agreement, *audit.regret.by_state]).all()
    for text in (repr(audit), str(audit), audit.message()):
        assert "keep" in text
        assert "optimal" not in text
    assert repr(audit).endswith("failed: no policy keeps steps <= 1/2)")
    with pytest.raises(AssertionError, match="none does"):
        assert_policy_optimal(MODEL, [0, 0], subject_to=limit)
    MODEL.save(tmp_path / "model.npz")
    words = ["check", tmp_path / "model.npz", "always:slow", "--subject-to", "steps <= 1/2"]
    result = run(*words, "--json").result
    assert result["learned_value"] == float(audit.regret.learned.value)
    unknown = ("optimal_value", "regret", "exact_regret", "relative_regret", "agreement")
    assert [result[name] for name in unknown] == [None] * 5
    assert "optimal" not in run(*words).out


# ---- exact numbers -------------------------------------------------------------------------------


def test_exact_numbers_have_an_exact_least_change() -> None:
    """5 is 6.1 - 1.1: the parts of an exact reward are the decimals that add up to it."""
    outcomes = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
    changes = [
        rationalize(
            MDP.from_outcomes(outcomes, components={"gain": gain, "effort": effort}), [1, 0]
        ).change
        for gain, effort in (
            (["6.1", 3, 0], ["-1.1", 0, 0]),
            ([6.1, 3, 0], [-1.1, 0, 0]),
            (np.array([6.1, 3, 0]), np.array([-1.1, 0, 0])),
        )
    ]
    assert changes == [Fraction(10, 21)] * 3


# ---- what is infinite ----------------------------------------------------------------------------


def endless(sense: str, earned: int) -> MDP:
    return MDP.from_outcomes(
        [
            (0, 0, [("1/2", 0, earned), ("1/2", 1, earned)]),
            (0, 1, [("1/2", 2, 1), ("1/2", 1, 1)]),
            (1, 0, [(1, 1, earned)]),
            (2, 0, [(1, 2, 0)]),
        ],
        sense=sense,
        labels={"goal": np.array([False, False, True])},
    )


@pytest.mark.parametrize("sense, earned", [("max", 1), ("max", -1), ("min", 1), ("min", -1)])
def test_what_is_advised_can_be_done(tmp_path: Path, sense: str, earned: int) -> None:
    """Where a total is infinite, each option that a message names is taken, and helps."""
    endless(sense, earned).save(tmp_path / "model.npz")
    seen = 0
    for command, until, steps in product(
        (["solve"], ["check", "random"]), ([], ["--until", "goal"]), ([], ["--horizon", "3"])
    ):
        words = [command[0], tmp_path / "model.npz", *command[1:]]
        done = run(*words, *until, *steps)
        text = " ".join((done.out + done.err).split())
        advised = re.findall(r"--(discount 0\.95|horizon N|criterion average|reach LABEL)", text)
        if not advised:
            assert "infinit" not in text
        for option in advised:
            seen += 1
            name, _, value = option.partition(" ")
            value = {"N": "3", "LABEL": "goal"}.get(value, value)
            question = [] if name == "reach" else until
            again = run(*words, *question, *steps, f"--{name}", value)
            assert again.status in (0, 1), again.err
            assert "infinite" not in again.out
    assert seen


def test_costs_have_no_sign_of_rewards(tmp_path: Path) -> None:
    """The sign of what is infinite is not told of the negation that is computed with."""
    for sense in ("max", "min"):
        with pytest.raises(ModelError, match="both infinite") as caught:
            check(endless(sense, 1).until("goal"), [0, 0, 0])
        assert "∞" not in str(caught.value)
    frame = pd.DataFrame(
        [(1, "x", "go", 1, "y"), (1, "y", "go", 1, "z"), (1, "z", "go", 1, None)],
        columns=["episode", "state", "action", "reward", "next_state"],
    )
    mdp = MDP.from_transitions(frame, sense="min")
    by = OffPolicy(records=frame, rewards=(0, 3), returns=(0.5, 2.5))
    with pytest.raises(ModelError, match="returns from 3 to 3 were recorded"):
        check(mdp, "optimal", confidence=0.9, by=by)


def test_a_saved_model_has_no_states_of_one_name(tmp_path: Path) -> None:
    MODEL.save(tmp_path / "model.npz")
    assert load(tmp_path / "model.npz").space == MODEL.space
    (tmp_path / "p.json").write_text(json.dumps({"a": "fast", "b": "slow"}), "utf-8")
    assert run("check", tmp_path / "model.npz", tmp_path / "p.json").status in (0, 1)
