"""Calls as newcomers write them: taken where they have one meaning; advice that works.

What is refused stands in the table beside this file.
"""

import re
from contextlib import suppress
from fractions import Fraction as F
from functools import partial
from itertools import product
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cli_runner import run
from made_models import forest
from records import POLICY, estimated, recorded
from refusal_tables import refused, table_of_refusals

import exact_mdp
from exact_mdp import (
    MDP,
    Column,
    Constant,
    Family,
    ModelError,
    OffPolicy,
    Policy,
    QLearning,
    Scenario,
    StateSpace,
    assert_policy_optimal,
    check,
    check_trainer,
    load,
    moving,
    rationalize,
)

nan, inf = float("nan"), float("inf")
STATES = ["a", "b"]
SLOW, FAST = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
P = {"slow": SLOW, "fast": FAST}
REWARDS = [[1, "3/2"], [0, 0]]
MODEL = MDP.from_arrays(P, REWARDS, "9/10", states=STATES)
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
BUILT: dict[str, Any] = {"parameters": {"p": "1/2"}, "build": lambda at: MODEL}
ENDING = MDP.from_gymnasium({s: {a: [(1, s, a, a < 1)] for a in (0, 1)} for s in range(3)})
THREE = MDP.from_arrays([np.eye(3)], [1, 2, 3], "1/2")
FOREST = forest("9/10")
EARN = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, 2)])])
EVEN = MDP.from_arrays([np.eye(2)] * 2, [[1, 0], [0, 1]], "1/2", layout="ass", states=STATES)
# A third action is offered in state 1 alone, and no action in both rows of APART.
RARE = MDP.from_outcomes(
    [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 0)]), (1, 1, [(1, 2, 0)]), (1, 2, [(1, 2, 0)]),
     (2, 0, [(1, 2, 0)])]
)  # fmt: skip
TIMES = StateSpace(columns=(Column(name="time", size=2), Column(name="row", size=1)), extra=("o",))
APART = MDP.from_outcomes(
    [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 1)]), (1, 2, [(1, 2, 0)]), (1, 3, [(1, 2, 1)]),
     (2, 0, [(1, 2, 0)])]
).with_(space=TIMES)  # fmt: skip
LEAST, ENDS = F(1, 10**400), [[0, 1, 0], [0, 0, 0]]
MASKED = np.ma.masked_array([[9.0, 1, 0], *ENDS], mask=np.eye(3) * [1, 0, 0])
TRAINED = partial(check_trainer, MODEL, lambda seed: [1, 0])
FRAME = recorded(np.random.default_rng(4), 100)
SEEN = estimated(FRAME)
JUDGED = partial(check, SEEN, POLICY, confidence=0.95)


def table(rows: list[list[float]], index: list[str], columns: list[str]) -> pd.DataFrame:
    return pd.DataFrame(rows, index=index, columns=columns)


def by_records(records: pd.DataFrame = FRAME, model: MDP = SEEN, **how: Any) -> Any:
    by = OffPolicy(records=records, **{"rewards": (0, 1)} | how)
    return check(model, POLICY, confidence=0.95, by=by)


FAMILY: dict[str, Any] = {
    "parameters": {"p": "1/2"},
    "build": lambda at: MDP.from_arrays([[[at["p"], 1 - at["p"]], [0, 1]]], [1, 0]),
}


test_refused = table_of_refusals(__file__, globals())


VARIED = moving(MODEL, {"p": [(0, 0)]})
VARY: dict[str, dict[str, Any]] = {
    "gradient": {"model": VARIED, "names": 0, "policy": 0},
    "tornado": {"model": VARIED, "names": 0, "ranges": 0, "relative": 0, "policy": 0, "against": 0},
    "one_way": {"model": VARIED, "name": "p", "ranges": 0, "points": 2, "relative": 0},
    "two_way": {"model": VARIED, "x": "p", "y": "discount", "ranges": 0, "points": 2},
    "thresholds": {"model": VARIED, "name": "p", "ranges": 0, "relative": 0},
    "curve": {"model": VARIED, "name": "p", "ranges": 0, "policy": 0},
    "psa": {"model": VARIED, "n": 2, "uncertain": 0, "policy": 0, "folder": 0, "n_jobs": 0},
    "sobol": {"model": VARIED, "n": 2, "rng": 0, "names": 0, "ranges": 0, "confidence": 0},
    "worst_point": {"model": VARIED, "ranges": 0, "policy": 0},
    "study": {"model": VARIED, "points": {"p": [0.5]}, "policies": 0, "folder": 0},
    "robust": {"model": MODEL, "ambiguity": 0, "radius": 0, "policy": 0},
    "cost_effectiveness": {"model": VARIED, "strategies": {"a": [0, 0]}, "n": 2, "uncertain": 0},
}


@pytest.mark.parametrize("wrong", [3.5, "x", [["x"]], {"x": 1}, object()], ids=list("12345"))
@pytest.mark.parametrize("function", VARY)
def test_what_varies_takes_or_refuses_whatever_is_given(
    function: str, wrong: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No option ends in an error that is not the toolkit's own; what is needed is given rightly."""
    monkeypatch.chdir(tmp_path)
    needed = {name: each for name, each in VARY[function].items() if each or name == "rng"}
    for name in VARY[function]:
        with suppress(ModelError):
            getattr(exact_mdp, function)(**needed | {name: wrong})


def rows(mdp: MDP) -> list[Any]:
    return [mdp.table.row(pair) for pair in range(mdp.n_pairs)]


def test_what_has_one_meaning_is_taken() -> None:
    assert QLearning(exploration=0.2).exploration == Constant(0.2)
    assert QLearning(rate="1/4").rate == Constant(0.25)
    assert QLearning(epochs=np.int64(7)).epochs == 7
    assert Family(**FAMILY, degrees={"p": np.int64(1)}).degree("p") == 1
    breaks = Family(**FAMILY, breaks={"p": np.array([0.25, 0.5])})
    assert breaks.breakpoints("p") == (F(1, 4), F(1, 2))
    assert THREE.with_(labels={"goal": [2, 0]}).labels["goal"].tolist() == [True, False, True]
    assert check("yuan2025", "optimal").value == check(Scenario.load("yuan2025"), "optimal").value
    assert MODEL.with_(states=["x", "y"]).space.label(1) == "state y"
    assert rows(MDP.from_arrays({"slow": pd.DataFrame([[0.5, 0.5], [0, 1]])}, [1, 0], "9/10")) == [
        rows(MDP.from_arrays([SLOW], [1, 0]))[k] for k in range(2)
    ]
    by_place = {(0, 0): "down", (0, 1): "down", (1, 0): "right", (1, 1): "down"}
    assert Policy.of(GRID, by_place).weights(GRID).sum() == float(GRID.n_states)


def test_what_is_asked_of_environments_that_are_made() -> None:
    gymnasium = pytest.importorskip("gymnasium")
    lake, pole = gymnasium.make("FrozenLake-v1"), gymnasium.make("CartPole-v1")
    refused(lambda: MDP.from_gymnasium(lake, is_slippery=False), "is_slippery=", "MDP")
    refused(lambda: MDP.from_gymnasium(lake, startt=3), "startt=", "MDP", "did you mean start?")
    refused(lambda: check(pole, [0, 0]), "does not expose its model as P", "CartPole-v1")


def test_a_table_by_state_and_action_is_never_one_by_row_and_column() -> None:
    gymnasium = pytest.importorskip("gymnasium")
    lake = MDP.from_gymnasium("FrozenLake-v1", is_slippery=False)
    assert lake.n_transitions < MDP.from_gymnasium("FrozenLake-v1").n_transitions
    values = np.random.default_rng(0).integers(0, 4, (16, 4))
    by_pair = {(s, a): values[s, a] for s, a in product(range(16), range(4))}
    table = Policy.of(lake, values, kind="q")
    for kind in ("auto", "q"):
        read = Policy.of(lake, by_pair, kind=kind)
        assert (read.rule.tolist(), read.read_as) == (table.rule.tolist(), "q")
    by_place = {(row, column): (row + column) % 4 for row in range(4) for column in range(4)}
    assert Policy.of(lake, by_place).rule.tolist() == list(by_place.values())
    lakes: Any = ("gymnasium:FrozenLake-v1", gymnasium.make("FrozenLake-v1"))
    named, made = (check(each, values, kind="q").value for each in lakes)
    assert named == made == check(MDP.from_gymnasium("FrozenLake-v1"), values, kind="q").value


# ---- limits that no policy keeps -----------------------------------------------------------------


def test_no_optimum_is_shown_that_ignores_a_limit(tmp_path: Path) -> None:
    limit = {"steps": "<= 1/2"}
    audit = check(MODEL, [0, 0], subject_to=limit)
    assert not audit.passed
    assert not audit.feasible
    assert audit.disagreements == ()
    unknown = [float(audit.value.value), audit.agreement, audit.agreement_by_visits]
    assert np.isnan([*unknown, *audit.regret.by_state]).all()
    assert audit.message().endswith("there is no optimum to compare with; learned 1.818181818")
    for text in (repr(audit), str(audit), audit.message()):
        assert "keep" in text
        assert "optimal" not in text
    assert repr(audit).endswith("failed: no policy keeps steps <= 1/2)")
    with pytest.raises(AssertionError, match="none does"):
        assert_policy_optimal(MODEL, [0, 0], subject_to=limit)
    MODEL.save(tmp_path / "model.npz")
    assert load(tmp_path / "model.npz").space == MODEL.space
    words = ["check", tmp_path / "model.npz", "always:slow", "--subject-to", "steps <= 1/2"]
    result = run(*words, "--json").result
    assert result["learned_value"] == float(audit.regret.learned.value)
    for name in ("optimal_value", "regret", "exact_regret", "relative_regret", "agreement"):
        assert result[name] is None
    assert "optimal" not in run(*words).out


# ---- exact numbers -------------------------------------------------------------------------------


def test_exact_numbers_have_an_exact_least_change() -> None:
    """5 is 6.1 - 1.1: the parts of an exact reward are the decimals that add up to it."""
    outcomes = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])]
    for gain, effort in (
        (["6.1", 3, 0], ["-1.1", 0, 0]),
        ([6.1, 3, 0], [-1.1, 0, 0]),
        (np.array([6.1, 3, 0]), np.array([-1.1, 0, 0])),
    ):
        mdp = MDP.from_outcomes(outcomes, components={"gain": gain, "effort": effort})
        assert rationalize(mdp, [1, 0]).change == F(10, 21)


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


def test_a_model_by_name_or_file_is_varied_as_one_that_is_loaded(tmp_path: Path) -> None:
    """A scenario keeps its own parameters; a model its rewards and its discount."""
    tea = exact_mdp.Scenario.load("tea")
    by_name = exact_mdp.one_way("tea", "base.anxiety", points=3)
    assert by_name.frame().equals(exact_mdp.one_way(tea, "base.anxiety", points=3).frame())
    mdp = forest("9/10")
    mdp.save(path := tmp_path / "forest.npz")
    assert exact_mdp.tornado(path).frame().equals(exact_mdp.tornado(mdp).frame())
