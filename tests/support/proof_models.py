"""Small models for proofs of every kind: loops, ties, islands, goals, costs and limits."""

from typing import Any

from model_contents import negated

from exact_mdp import MDP

LOOP = [
    (0, 0, [("1/2", 0, 1), ("1/2", 1, 0)]),
    (0, 1, [(1, 1, 1)]),
    (1, 0, [("1/3", 0, 2), ("2/3", 1, -1)]),
    (1, 1, [(1, 2, 0)]),
    (2, 0, [(1, 2, 0)]),
]
TIES = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 2, 3)]), (2, 0, [(1, 2, 0)])]
ISLANDS = [
    (0, 0, [(1, 1, 0)]),
    (0, 1, [("1/2", 2, 5), ("1/2", 3, 0)]),
    (1, 0, [(1, 1, 1)]),
    (2, 0, [(1, 2, -1)]),
    (2, 1, [(1, 3, "-1/3")]),
    (3, 0, [(1, 3, 0)]),
    (4, 0, [(1, 4, -1)]),
    (4, 1, [("1/2", 4, 0), ("1/2", 3, 2)]),
]
TURNS = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, -1)]), (1, 1, [(1, 2, 0)]), (2, 0, [(1, 2, 0)])]
WALK = [
    (0, 0, [(1, 0, -1)]),
    (0, 1, [("1/2", 1, -2), ("1/2", 0, 0)]),
    (1, 0, [("2/3", 2, -1), ("1/3", 0, 0)]),
    (2, 0, [(1, 2, 0)]),
    (3, 0, [(1, 3, 0)]),
    (3, 1, [("1/2", 2, 4), ("1/2", 3, 0)]),
    (4, 0, [("1/2", 3, 0), ("1/2", 5, 0)]),
    (5, 0, [(1, 5, 1)]),
]
RICH = [*WALK[:5], (3, 1, [("1/2", 2, 4), ("1/2", 6, 0)]), *WALK[6:], (6, 0, [(1, 6, 1)]),
        (6, 1, [(1, 2, 0)])]  # fmt: skip
GOAL = {"goal": [state == 2 for state in range(6)]}


def of(rows: Any, **parts: Any) -> MDP:
    return MDP.from_outcomes(rows, **parts)


PARTS = {"a": [0, 5, 1, 7, 2, 3], "b": [4, 1, 6, 2, 5, 5], "c": [1, 0, 2, 2, 0, 1]}
THREE = of(
    [
        (s, a, [("1/2", (s + 1) % 3, PARTS["a"][2 * s + a]), ("1/2", a, PARTS["a"][2 * s + a])])
        for s in range(3)
        for a in (0, 1)
    ],
    discount="3/4",
    components={"a": PARTS["a"], "b": PARTS["b"]},
)
ENDING = of(
    [(0, 0, [(1, 1, 5)]), (0, 1, [("1/2", 1, 3), ("1/2", 2, 3)]), (1, 0, [(1, 2, 1)]),
     (1, 1, [(1, 2, 2)]), (2, 0, [(1, 2, 0)])],
    components={"a": [5, 3, 1, 2, 0], "b": [0, 1, 4, 1, 0], "c": [1, 2, 0, 1, 0]}, sense="min",
)  # fmt: skip
MODELS: dict[str, MDP] = {
    "discounted": of(LOOP, discount="1/2"),
    "least costs": of(LOOP, discount="9/10", sense="min", start=["1/2", "1/2", 0]),
    "every policy ends": of(TIES),
    "islands": of(ISLANDS, start=[1, 0, 0, 0, 0]),
    "a costly island": of(ISLANDS, sense="min", start=[0, 0, 0, 0, 1]),
    "rewards cancel": of(TURNS),
    "goal, rewards": of(WALK, labels=GOAL).until("goal"),
    "goal, costs": negated(of(WALK, labels=GOAL, start=1)).until("goal"),
    "goal, costs that fall": negated(
        of(RICH, labels={"goal": [*GOAL["goal"], False]}, start=1)
    ).until("goal"),
    "reaching": of(LOOP, labels={"goal": [False, True, False]}).reaching("goal"),
    "within": of(LOOP).within(2),
}  # fmt: skip
