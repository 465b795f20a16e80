"""What strangers call and what cannot be: the models of the table beside this file."""

from contextlib import suppress
from fractions import Fraction as F
from functools import partial
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from made_models import forest
from records import POLICY, estimated, recorded
from refusal_tables import table_of_refusals

import exact_mdp
from exact_mdp import (
    MDP,
    Column,
    Family,
    ModelError,
    OffPolicy,
    Scenario,
    StateSpace,
    check,
    check_trainer,
    moving,
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
    [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (1, 2, [(1, 2, 0)]), (1, 3, [(1, 2, 0)]),
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


test_refused = table_of_refusals(__file__, globals())


VARIED = moving(MODEL, {"p": [(0, 0)]})
VARY: dict[str, dict[str, Any]] = {
    "gradient": {"model": VARIED, "names": 0, "policy": 0},
    "tornado": {"model": VARIED, "names": 0, "ranges": 0, "relative": 0, "policy": 0},
    "one_way": {"model": VARIED, "name": "p", "ranges": 0, "points": 2, "relative": 0},
    "two_way": {"model": VARIED, "x": "p", "y": "discount", "ranges": 0, "points": 2},
    "thresholds": {"model": VARIED, "name": "p", "ranges": 0, "relative": 0},
    "curve": {"model": VARIED, "name": "p", "ranges": 0, "policy": 0},
    "psa": {"model": VARIED, "n": 2, "uncertain": 0, "policy": 0, "folder": 0, "n_jobs": 0},
    "sobol": {"model": VARIED, "n": 2, "rng": 0, "names": 0, "ranges": 0, "confidence": 0},
    "worst_point": {"model": VARIED, "ranges": 0, "policy": 0},
    "study": {"model": VARIED, "points": {"p": [0.5]}, "policies": 0, "folder": 0},
    "robust": {"model": MODEL, "ambiguity": 0, "policy": 0},
    "robust_curve": {"model": MODEL, "kind": "l1", "radii": [0], "policy": 0},
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
