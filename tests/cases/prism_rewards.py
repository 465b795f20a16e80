"""Small models of PRISM's own tests with any question's published answer, restated.

Source: prismmodelchecker/prism-tests, functionality/verify/mdps/rewards (rewpoliter, mdp_rewards,
total-reward-2, total-reward-3) and bugfixes/mdp-rewards-gs-loops, each with its .props file.
"""

from dataclasses import dataclass
from fractions import Fraction
from math import inf
from typing import TypeAlias

from exact_mdp import MDP

F = Fraction


@dataclass(frozen=True, kw_only=True)
class Asked:
    """A model, a question about it, and the published answer."""

    model: str
    until: str | None  # the total reward where it is None
    reward: str
    sense: str
    value: Fraction | float
    start: int = 0


Key: TypeAlias = tuple[int, str]  # state, action
Amount: TypeAlias = int | Fraction


def _model(
    moves: list[tuple[int, str, dict[int, str]]],
    rewards: dict[str, dict[Key, Amount]],
    labels: dict[str, set[int]],
) -> MDP:
    """Rows (state, action, law); rewards by component, then by state and action."""
    names = sorted({action for _, action, _ in moves})
    size = 1 + max(s for s, _, _ in moves)
    parts = {
        name: [F(amounts.get((s, a), 0)) for s, a, _ in moves] for name, amounts in rewards.items()
    }
    earned = [
        (s, names.index(a), [(p, t, sum(each)) for t, p in law.items()])
        for (s, a, law), each in zip(moves, zip(*parts.values(), strict=True), strict=True)
    ]
    return MDP.from_outcomes(
        earned,
        actions=names,
        components=parts,
        labels={name: [s in on for s in range(size)] for name, on in labels.items()},
    )


def _walk() -> MDP:
    moves, a, b = [], dict[Key, Amount](), dict[Key, Amount]()
    for s, (here, more) in enumerate(((2, 3), (5, 7), (11, 0))):
        moves += [(s, "go", {s + 1: "1"}), (s, "mix", {s + 1: "1/2", s: "1/2"})]
        a |= {(s, "go"): here + more, (s, "mix"): here}
        b |= {(s, "go"): here, (s, "mix"): here}  # its rewards of unnamed actions are of none here
    moves.append((3, "go", {3: "1"}))
    b[3, "go"] = 17
    return _model(moves, {"a": a, "b": b}, {f"s={s}": {s} for s in range(1, 4)})


def _policy_iteration() -> MDP:
    cost = {"a": 8, "b": 5, "c": 4, "d": 3, "e": 3}
    moves = [
        (0, "a", {1: "1"}), (0, "b", {2: "0.4", 0: "0.6"}),
        (1, "a", {1: "1"}), (1, "e", {5: "0.1", 1: "0.9"}), (1, "b", {3: "0.4", 1: "0.6"}),
        (2, "c", {3: "1"}), (2, "a", {3: "1"}), (2, "b", {2: "1"}),
        (3, "d", {4: "0.3", 3: "0.5", 1: "0.2"}), (3, "c", {3: "1"}), (3, "a", {3: "1"}),
        (3, "e", {4: "0.1", 3: "0.9"}), (3, "b", {3: "1"}),
        (4, "a", {4: "1"}), (5, "a", {5: "1"}),  # deadlocks, which stay
    ]  # fmt: skip
    # A deadlock earns nothing there; before the target is reached it goes on for ever.
    earned: dict[Key, Amount] = {(s, a): cost[a] for s, a, _ in moves if s < 4}
    return _model(moves, {"cost": earned}, {"s=5": {5}})


def _thirds(second: dict[int, str]) -> MDP:
    third = {0: "1/3", 1: "1/3", 2: "1/3"}
    moves = [(0, "a", third), (0, "b", second), (1, "a", {1: "1"}), (2, "a", {2: "1"})]
    rewards: dict[str, dict[Key, Amount]] = {
        "steps": {(0, "a"): 1, (0, "b"): 1, (1, "a"): 1, (2, "a"): 1},
        "s0": {(0, "a"): 1, (0, "b"): 1},
        "s0_a": {(0, "a"): 2},
        "s0_b": {(0, "b"): F(1, 100_000)},
        "s1": {(1, "a"): 1},
    }
    return _model(moves, rewards, {"s=1": {1}, "s=1 or 2": {1, 2}})


MODELS = {
    "mdp_rewards": _walk(),
    "rewpoliter": _policy_iteration(),
    "total-reward-2": _thirds({0: "1"}),
    "total-reward-3": _thirds({2: "1"}),
    "gs-loops": _model(
        [(0, "a", {0: "1/2", 1: "1/2"}), (1, "a", {1: "1"})], {"r": {(0, "a"): 1}}, {"s=1": {1}}
    ),
}


def _of(model: str, *rows: tuple[str | None, str, str, Fraction | float]) -> list[Asked]:
    return [
        Asked(model=model, until=until, reward=reward, sense=sense, value=value)
        for until, reward, sense, value in rows
    ]


PUBLISHED = [
    *_of("rewpoliter", ("s=5", "cost", "min", F(38))),
    *_of("gs-loops", ("s=1", "r", "max", F(2))),
    *_of(
        "mdp_rewards",
        ("s=1", "a", "max", F(5)), ("s=2", "a", "max", F(17)), ("s=3", "a", "max", F(39)),
        (None, "a", "max", F(39)), (None, "a", "min", F(25)),
        (None, "b", "max", inf), (None, "b", "min", inf),
    ),
    *_of(
        "total-reward-2",
        (None, "steps", "max", inf), (None, "s0", "max", inf), (None, "s0_a", "max", F(3)),
        ("s=1", "s0_a", "max", inf), ("s=1 or 2", "s0_a", "max", inf), (None, "s0_b", "max", inf),
        (None, "s1", "max", inf),
    ),
    *_of(
        "total-reward-3",
        (None, "steps", "max", inf), (None, "s0", "max", F(3, 2)), (None, "s0_a", "max", F(3)),
        ("s=1", "s0_a", "max", inf), ("s=1 or 2", "s0_a", "max", F(3)),
        (None, "s0_b", "max", F(1, 100_000)), (None, "s1", "max", inf),
    ),
]  # fmt: skip
