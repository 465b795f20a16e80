"""Small models of every kind that certificates treat differently, shared by their tests."""

from fractions import Fraction as F
from functools import cache

from strategies import Row, model_of

from exact_mdp import MDP, Certificate, Scenario, certify

THIRD = F(1, 3)


def end(state: int) -> Row:
    return (state, 0, F(0), {state: F(1)})


# Two actions, one the better; a tie; and a state that is not reached.
ACYCLIC: tuple[Row, ...] = (
    (0, 0, F(1), {1: THIRD, 2: 1 - THIRD}),
    (0, 1, F(1, 7), {1: F(1)}),
    (1, 0, F(5), {3: F(1)}),
    (1, 1, F(4), {3: F(1)}),
    (2, 0, F(2), {3: F(1)}),
    (2, 2, F(2), {1: F(0) + F(1, 10**9), 3: 1 - F(1, 10**9)}),
    end(3),
    (4, 0, F(1), {3: F(1)}),
    (4, 1, F(1), {3: F(1)}),
)
# Waiting is possible in both states, in one of them to advantage.
WAITING: tuple[Row, ...] = (
    (0, 0, F(1), {0: F(1, 2), 1: F(1, 2)}),
    (0, 1, F(1), {0: F(9, 10), 2: F(1, 10)}),
    (0, 2, F(7), {1: F(1)}),
    (1, 0, F(-1), {1: F(3, 4), 2: F(1, 4)}),
    (1, 1, F(-6), {2: F(1)}),
    end(2),
)
# Three states that lead to each other, of which the second need never be left at discount < 1.
CYCLE: tuple[Row, ...] = (
    (0, 0, F(1), {1: F(1, 2), 2: F(1, 2)}),
    (0, 1, F(2), {2: F(4, 5), 3: F(1, 5)}),
    (1, 0, F(-1), {0: F(2, 3), 3: THIRD}),
    (1, 3, F(0), {2: F(1, 2), 3: F(1, 2)}),
    (2, 0, F(3), {0: F(1, 4), 1: F(1, 2), 3: F(1, 4)}),
    end(3),
)
MODELS = {
    "acyclic": model_of(5, ACYCLIC, F(1)),
    "acyclic, discounted": model_of(5, ACYCLIC, F(1, 2)),
    "waiting": model_of(3, WAITING, F(1)),
    "cycle": model_of(4, CYCLE, F(1)),
    "cycle, discounted": model_of(4, CYCLE, F(9, 10)),
    # what floats mean sums to 1
    "cycle of floats": MDP.from_outcomes(
        [
            (0, 0, [(0.8, 1, 1.0), (0.1, 0, 0.5), (0.1, 2, 0.0)]),
            (0, 1, [(0.7, 1, 1.0), (0.2, 0, 0.5), (0.1, 2, 1.0)]),
            (1, 0, [(0.1, 1, -1.0), (0.8, 0, -1.0), (0.1, 0, 2.0)]),
            (2, 0, [(1.0, 2, 0.0)]),
        ]
    ),
    "care": Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile(),
}


@cache
def certified(name: str) -> Certificate:
    return certify(MODELS[name])
