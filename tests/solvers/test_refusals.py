"""What solvers refuse: the models of the table beside this file."""

from fractions import Fraction as F

from made_models import garnet
from policy_cases import coin, geometric  # noqa: F401 - the table names it
from refusal_tables import table_of_refusals

from exact_mdp import MDP, SOLVERS, Intervals, QLearning, Scenario

nan, inf = float("nan"), float("inf")
CARE = Scenario.load("yuan2025").compile()
LINE = MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0])  # without cycles
LOOP = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
HALF = LOOP.with_(discount="1/2")
NO = Intervals.relative(LOOP, 0)
MODEL = garnet(9, seed=1, discount="0.99")
SWING = MDP.from_outcomes([(0, 0, [(1, 1, -1)]), (1, 0, [(1, 0, 1)])])
APART = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (1, 0, [(1, 1, -1)])], start=["1/2", "1/2"])
STAYS = MDP.from_outcomes([(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])])
BESIDE = MDP.from_outcomes(
    [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])],
    labels={"goal": [False, True, False]},
).until("goal")
FINE = MDP.from_outcomes(
    [
        (2, 0, [("1/2", 1, 0), ("1/2", 0, 2 + F(1, 10**30))]),
        (2, 1, [("1/2", 0, 1), ("1/2", 0, 2)]),
        *[(1, 0, [(1, 0, 1)]), (0, 0, [(1, 0, 0)])],
    ],
    start=2,
)
HIDDEN = MDP.from_outcomes(
    [(s, a, [(1, min(s + 1, 2), 0)]) for s, a in ((0, 0), (0, 1), (1, 1), (1, 2), (2, 0))]
)
COSTS = MDP.from_arrays(
    [[[0, 1, 0], [0, 0, 1], [0, 0, 1]]] * 2, [[2, 7], [1, 3], [0, 0]], sense="min"
)
TEA = Scenario.load("tea").compile()
LONG = Scenario.load("yuan2025").with_(tasks=[1000]).compile()
QUICK = QLearning(epochs=1)


def having(setting: str) -> str:
    """The solvers that have a setting, as choices of the table."""
    return "|".join(kind.__name__ for kind in SOLVERS.values() if hasattr(kind, setting))


test_refused = table_of_refusals(
    __file__, globals(), SWEEPING=having("tol"), ITERATING=having("max_iterations")
)
