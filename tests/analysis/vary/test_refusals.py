"""What analyses of parameters refuse: the models of the table beside this file."""

from dataclasses import replace
from math import inf, nan  # noqa: F401 - the table names them
from typing import Any

import pandas as pd
from made_models import grid  # noqa: F401 - the table names it
from refusal_tables import of_file, table_of_refusals

from exact_mdp import (
    MDP,
    Certificate,
    Column,
    Family,
    Parameter,
    Scenario,
    StateSpace,
    certify,
    curve,
    moving,
    parametric,
    tornado,
    uncertainty,
)

YUAN = Scenario.load("yuan2025")
SMALL = YUAN.with_(tasks=[1], max_trial=2)
CARE, TEA = parametric(YUAN), Scenario.load("tea")
# Puterman (1994), section 3.1
PUTERMAN = MDP.from_outcomes(
    [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])], "1/2"
)
HELD = curve(PUTERMAN, "discount", (0, "99/100"), policy=[0, 0])
WAIT = MDP.from_outcomes(
    [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 2, 5)]), (1, 0, [(1, 1, -1)]), (2, 0, [(1, 2, 0)])]
)
LAWS = MDP.from_arrays([[["1/2", "1/4", "1/4"], ["2/3", "1/3", 0], [0, 0, 1]]], [1, 0, 0])
THIRDS = moving(LAWS, {"a": [(0, 1)], "b": [(0, 2)]})
ROW, ONE, TWO, THREE = "row", "row: to 1", "row: to 2", "other: to 1"
ROWS = replace(
    moving(LAWS, {ONE: [(0, 1)], TWO: [(0, 2)], THREE: [(1, 1)]}, {"reward.1": 1}),
    rows={ROW: (ONE, TWO), "other": (THREE,)},
)
OPEN = Family(
    parameters={"p": "1/2"},
    build=lambda at: MDP.from_arrays([[[1 - at["p"], at["p"]], [0, 1]]], [1, 0], "1/2"),
)
BETS = Family(
    parameters={"r": 1, "s": "1/2"},
    build=lambda at: MDP.from_arrays([[[1]]] * 2, [[at["r"], at["s"]]], 0),
)
CHOICES = {"wait": [0], "treat": [1]}
SAID = {"r": {"distribution": "uniform", "low": 0, "high": 2}}
OWN = pd.DataFrame({"r": [1.0, 2.0, 3.0], "s": [0.1, 0.2, 0.4]})
KINK = Family(
    parameters=(Parameter(name="p", value="1/2", low=0, high=1),),
    build=lambda at: MDP.from_arrays([[[1]]] * 2, [[at["p"], 1 - at["p"]]], 0),
)
APART = Family(
    parameters={"a": "1/2", "b": "1/4"},
    build=lambda at: MDP.from_arrays(
        [[[1 - at["a"] - at["b"], at["a"], at["b"]], [0, 1, 0], [0, 0, 1]]], [1, 0, 0], "1/2"
    ),
)
V = [[4, 1], [1, 9]]


def FIT(**settings: Any) -> Any:
    """Return what two parameters that are stated together make."""
    return uncertainty(APART, {"fit": settings})


ROUND = MDP.from_outcomes(
    [(s, a, [(1, (s + 1) % 201, 0)]) for s in range(201) for a in (0, 1)],
    "1/2",
    components={"a": [0, 1] * 201, "b": [2, 0] * 201},
)


QUOTIENT, ROUNDED = (
    Family(parameters={"u": "1/3"}, build=build)
    for build in (
        lambda at: MDP.from_arrays([[[1]]] * 2, [[1 / (1 + at["u"]), 1]], "1/2"),
        lambda at: MDP.from_arrays([[[1]]] * 2, [[0.1 * float(at["u"]), 1]], "1/2"),
    )
)


def stated(text: str) -> Any:
    return of_file("stated.toml", text, lambda path: uncertainty(CARE, path))


def ranges(text: str) -> Any:
    return of_file("stated.toml", text, lambda path: tornado(CARE, ranges=path))


def read_again(path: Any) -> Certificate:
    certify(PUTERMAN).save(path)
    return Certificate.load(path)


def statuses(rows: list[Any]) -> MDP:
    space = StateSpace(columns=(Column(name="status", size=2, bits=1),), extra=("end",))
    return MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])]).with_(space=space)


ROUNDABOUT = statuses([(s, a, [(1, 1 - s, a)]) for s in (0, 1) for a in (0, 1)])
REVEALING = statuses([(0, 0, [(1, 2, 1)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 2, 1)])])

test_refused = table_of_refusals(__file__, globals())
