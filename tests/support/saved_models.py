"""Models of every kind, to be saved and read again: some that are fixed, others drawn."""

from fractions import Fraction

import gymnasium
import numpy as np
import pandas as pd
from hypothesis import strategies as st

from exact_mdp import MDP, Column, Parameter, Scenario, StateSpace

CARE = Scenario.load("yuan2025").with_(tasks=[1, 2], max_trial=2)
WIDE = Fraction(1, 3**60)
LONG = "n" * 500
TABLE = CARE.compile().table
OutcomeTable, Rows = type(TABLE), type(TABLE.rows)
TAXI = max(name for name in gymnasium.registry if name.startswith("Taxi-v"))

MODELS = {
    "care": CARE.compile(),
    "care by other readings": CARE.with_(
        readings={"skip_timestep": "own", "task_bonus": "no-subtask-skipped"}
    ).compile(),
    "care beyond 64 bits": CARE.with_(
        parameters={"base.anger": "0.1234567891234567", "reward.trial": "-1.00000000000000000001"}
    ).compile(),
    "tea": Scenario.load("tea").compile(),
    "floats": MDP.from_arrays(
        [[[0.1, 0.9], [0.0, 1]], [[1, 0], [0.3, 0.7]]], [[0.1, -2.5], [3, 0]], 0.9,
        start={0: 0.25, 1: 0.75}, actions=["stay", "go"], states=["here", "there"], name="two",
        layout="ass",
    ),
    "float moves": MDP.from_arrays(
        np.array([[[0.1, 0.9], [0, 1]]]), np.array([[[0.1, 1e300], [0, -0.0]]]), 0.99
    ),
    "wide": MDP.from_outcomes(
        [(0, 0, [(WIDE, 0, -(10**30)), (1 - WIDE, 1, Fraction(1, 7))]), (1, 0, [(1, 1, 0)])],
        Fraction(10**40 - 1, 10**40), start={0: WIDE, 1: 1 - WIDE},
    ),
    "extra states": MDP.from_outcomes(
        [(s, 0, [(1, 8, 0)]) for s in range(9)], "1/2",
        space=StateSpace(
            columns=(
                Column(name="größe", size=2, words=("klein", "groß")),
                Column(name="bits", size=4, bits=2),
            ),
            extra=("Ende – \U0001f3c1",),
        ),
        name='quoted "name" <b>$x$', parameters=(
            Parameter(name="p", value=WIDE, low=Fraction(0)),
            Parameter(name="q", value=Fraction(-3), high=Fraction(7, 3)),
        ),
    ),
    "costs": MDP.from_arrays(
        [[["1/3", "2/3"], [0, 1]]], [["2/7"], [0]], sense="min", goal=[False, True],
        labels={"goal": [False, True], "nowhere": [False, False], "a-b c": [True, False]},
    ),
    "counted": MDP.from_transitions(
        pd.DataFrame(
            [(1, "a", "go", 1, then) for then in "aab"] + [(1, "b", "go", 2, None)]
            + [(2, "a", "go", 1, "b"), (2, "b", "stay", 0, "b"), (2, "b", "go", 3, None)],
            columns=["episode", "state", "action", "reward", "next_state"],
        ), "9/10",
    ),
    "gymnasium": MDP.from_gymnasium(TAXI, "9/10"),
    "denormal rewards": MDP.from_arrays(
        [[[0.3, 0.7], [0, 1.0]]], [[[1e-320, 2e-322], [0, -0.0]]], 0.5
    ),
    "0 and -0": MDP(
        OutcomeTable(
            rows=Rows(
                offsets=np.array([0, 2, 3]), next=np.array([0, 0, 1]),
                weight=np.array([0.5, 0.5, 1.0]), denominator=np.array([1, 1]),
            ),
            gain=np.array([-0.0, 0.0, 0.0]),
            gain_denominator=np.array([1, 1]), event=np.array([1, 0, 0], dtype=np.uint8),
        ),
        np.array([0, 1]), np.zeros(2, np.int64), space=StateSpace.plain(2), actions=("go",),
        events=("fall",), discount_exact=Fraction(1, 2),
    ),
    "long names": MDP.from_outcomes(
        [(0, 0, [(1, 1, 3)]), (1, 0, [(1, 1, 0)])], "1/2", actions=[LONG], states=[LONG, "b"],
        component_names=(LONG, LONG + "2"), components=np.array([[1.0, 2], [0, 0]]), name=LONG,
    ),
    "columns of one name": MDP.from_outcomes(
        [(0, 0, [(1, 0, 1)])], "1/2", space=StateSpace(columns=(Column(name="x", size=1),) * 2)
    ),
}  # fmt: skip


NAMES = st.text(
    st.characters(exclude_categories=("Cs", "Cc", "Cf", "Zl", "Zp", "Cn")), min_size=1, max_size=9
)

NUMBERS = st.one_of(
    st.fractions(),
    st.integers(-(10**60), 10**60),
    st.floats(-1e300, 1e300),
    st.sampled_from([0.0, -0.0, 5e-324, -5e-324, 2.2250738585072014e-308, 1e-310, 0.1]),
)


@st.composite
def models(draw: st.DrawFn) -> MDP:
    """Draw a model of exact numbers, of floats, or of both, with names and a start."""
    share = draw(st.one_of(st.fractions(0, 1), st.fractions(0, 1, max_denominator=2**200)))
    chances = draw(st.sampled_from([(0.5, 0.5), (0.1, 0.9), ("1/2", 0.5), (share, 1 - share)]))
    size = draw(st.integers(1, 4))
    rows = []
    for state in range(size):
        for action in range(draw(st.integers(1, 2))):
            then = draw(st.integers(0, size - 1))
            listed = [(chances[0], state, draw(NUMBERS)), (chances[1], then, draw(NUMBERS))]
            rows.append((state, action, listed))
    words = draw(st.lists(NAMES, min_size=size, max_size=size, unique=True))
    return MDP.from_outcomes(
        rows,
        draw(st.fractions(0, 1)),
        start=["1/3", *[0] * (size - 2), "2/3"] if size > 1 else None,
        actions=draw(st.lists(NAMES, min_size=2, max_size=2, unique=True)),
        space=StateSpace(columns=(Column(name=draw(NAMES), size=size, words=tuple(words)),)),
        name=draw(NAMES),
        component_names=(draw(NAMES),),
        sense=draw(st.sampled_from(["max", "min"])),
        labels=draw(
            st.dictionaries(
                NAMES, st.lists(st.booleans(), min_size=size, max_size=size), max_size=3
            )
        ),
    )
