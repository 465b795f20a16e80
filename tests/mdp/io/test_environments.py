"""Environments without a table: options on the command line, Blackjack, step() by copies."""

import json
import random
import warnings
from collections import Counter
from fractions import Fraction
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from cli_runner import run
from gymnasium import spaces, wrappers
from refusal_tables import refused

from exact_mdp import MDP, Policy, certify, evaluate, fingerprint, load, save

BLACKJACK = "gymnasium:Blackjack-v1"


def test_options_of_an_environment_on_the_command_line(tmp_path: Path) -> None:
    options: list[tuple[dict[str, str], dict[str, Any]]] = [
        ({"is_slippery": "False"}, {"is_slippery": False}),
        ({"is_slippery": "false", "map_name": "8x8"}, {"is_slippery": False, "map_name": "8x8"}),
        ({"desc": '["SFF", "FHG"]'}, {"desc": ["SFF", "FHG"]}),
        ({"is_slippery": "0"}, {"is_slippery": False}),
    ]
    for words, given in options:
        path = tmp_path / "m.npz"
        env = [word for name, text in words.items() for word in ("--env", f"{name}={text}")]
        done = run("convert", "gymnasium:FrozenLake-v1", path, *env, "--json")
        name = " ".join(["FrozenLake-v1", *(f"{n}={text}" for n, text in words.items())])
        assert done.result["model"] == name
        wanted = MDP.from_gymnasium("FrozenLake-v1", name=name, **given)
        assert fingerprint(load(path)) == fingerprint(wanted)
    done = run("solve", "gymnasium:FrozenLake-v1", "--env", "is_slippery=False", "--json")
    assert done.result["start_value"] == 1


@pytest.mark.parametrize(
    ("model", "option", "said"),
    [
        ("tea", "a=1", "the model is not an environment"),
        ("gymnasium:FrozenLake-v1", "discount=1", "discount is a part of the model"),
        ("gymnasium:FrozenLake-v1", "start=1", "start is a part of the model"),
        ("gymnasium:FrozenLake-v1", "slippery=1", "unexpected keyword argument 'slippery'"),
        ("gymnasium:FrozenLake-v1", "is_slippery", "is not NAME=VALUE"),
        (
            "gymnasium:FrozenLake-v1",
            "is_slippery=no",
            "write is_slippery=True or is_sl",
        ),
        ("gymnasium:FrozenLake-v1", "is_slippery='no'", "its default True of type bool"),
        ("gymnasium:FrozenLake-v1", "is_slippery=0.5", "give a value of type bool"),
        ("gymnasium:FrozenLake-v1", "is_slippery=none", "give a value of type bool"),
        ("gymnasium:Taxi-v4", "is_rainy=nope", "its default False of type bool"),
        ("gymnasium:Blackjack-v1", "natural=ja", "its default False of type bool"),
    ],
)
def test_options_that_are_refused(model: str, option: str, said: str) -> None:
    assert said in run("info", model, "--env", option).refusal()


# ---- Blackjack -----------------------------------------------------------------------------------

RULES = ({}, {"sab": False}, {"sab": False, "natural": True})


@pytest.mark.parametrize("rules", RULES, ids=str)
def test_blackjack_is_what_gymnasium_plays(rules: dict[str, bool]) -> None:
    """Every step of some thousand episodes is in the model, about as often as it says."""
    mdp = MDP.from_gymnasium("Blackjack-v1", **rules)
    env = gymnasium.make("Blackjack-v1", **rules)
    draw, seen, taken = random.Random(0), Counter[Any](), Counter[Any]()
    special = not rules or "natural" in rules
    for seed in range(6000):
        now, _ = env.reset(seed=seed)
        key: Any = tuple(map(int, now))
        if special and key[0] == 21:
            key = f"natural {key}"
        over = False
        while not over:
            action = draw.choice((0, 1))
            after, reward, over, *_ = env.step(action)
            then = "end" if over else tuple(map(int, after))
            seen[key, action, then, Fraction(reward)] += 1
            taken[key, action] += 1
            key = then
    off = 0.0
    for (key, action, then, reward), count in seen.items():
        row = mdp.table.row(mdp.pair(mdp.space.number(key), action))
        chance = {(state, gain): p for p, state, gain in row}[mdp.space.number(then), reward]
        n = taken[key, action]
        off = max(off, abs(count - n * float(chance)) / max(1, n * float(chance)) ** 0.5)
    assert off < 6
    assert sum(weight for _, weight in mdp.start) == 1


def test_blackjack_has_its_known_values() -> None:
    """Sticking on 20 or 21, and the optimum of the rules of Sutton and Barto, by simulation."""
    mdp = load(BLACKJACK)
    assert mdp.n_states == 291
    assert mdp.actions == ("STICK", "HIT")
    optimum = certify(mdp)
    env, draw = gymnasium.make("Blackjack-v1").unwrapped, []
    env.reset(seed=0)
    for policy in (lambda hand: int(hand[0] < 20), lambda hand: int(hand[0] < 17)):
        draw = []
        for _ in range(10_000):
            hand, over = env.reset()[0], False
            while not over:
                hand, reward, over, *_ = env.step(policy(hand))
            draw.append(float(reward))
        error = np.std(draw) / 100
        assert abs(evaluate(mdp, policy).mean - np.mean(draw)) < 4 * error
        assert evaluate(mdp, policy).mean <= optimum.start_value
    best = {mdp.space.label(s).removeprefix("state "): optimum.policy[s] for s in range(291)}
    # The basic strategy for many decks: stick from 12 against 4 to 6, 13 against 2 and 3, else 17;
    # with a usable ace from 18, against 9, 10 and an ace from 19.
    for shown in range(1, 11):
        hard = {4: 12, 5: 12, 6: 12, 2: 13, 3: 13}.get(shown, 17)
        soft = 19 if shown in (1, 9, 10) else 18
        for total in range(12, 22):
            assert best[f"({total}, {shown}, 0)"] == (total < hard)
            assert best[f"({total}, {shown}, 1)"] == (total < soft)


def test_q_tables_of_observations_fit_blackjack(tmp_path: Path) -> None:
    mdp = load(BLACKJACK)
    table = np.random.default_rng(0).normal(size=(32, 11, 2, 2))
    hands = [*np.ndindex(32, 11, 2)]
    wanted = Policy.of(mdp, lambda hand: int(table[*hand].argmax())).choices(mdp).tolist()
    np.save(tmp_path / "q.npy", table)
    forms: list[Any] = [
        table,
        tmp_path / "q.npy",
        {hand: table[hand] for hand in hands},
        {hand: {0: table[hand][0], 1: table[hand][1]} for hand in hands},
        {(hand, a): table[hand][a] for hand in hands for a in (0, 1)},
    ]
    for form in forms:
        with pytest.warns(UserWarning, match="424 of 704 rows are not read"):
            assert Policy.of(mdp, form).choices(mdp).tolist() == wanted
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        done = run("check", BLACKJACK, tmp_path / "q.npy", "--json")
    assert "424 of 704 rows are not read" in done.err
    assert json.loads(done.out)["read_as"] == "q"
    save(mdp, tmp_path / "m.npz")
    assert fingerprint(load(tmp_path / "m.npz")) == fingerprint(mdp)


# ---- environments that have only step() ----------------------------------------------------------


class Maze(gymnasium.Env[Any, int]):
    """A walk over n x n cells to the last one, with traps for whoever copies it."""

    def __init__(self, n: int = 4, **traps: Any) -> None:
        self.n, self.traps = n, traps
        self.action_space = spaces.Discrete(4)
        self.tools = {"dice": [np.random.default_rng(0), random.Random(0)]}
        self.steps, self.key, self.me = 0, False, [self]

    def seen(self) -> Any:
        if "floats" in self.traps:
            return np.array(self.place, dtype=np.float32)
        return np.array([*self.place, *([int(self.key)] if "shown" in self.traps else [])])

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.place, self.key = (0, 0), False
        if "random start" in self.traps:
            self.place = (int(self.np_random.integers(self.n)), 0)
        if "rare start" in self.traps and self.np_random.random() < 1e-9:
            self.place = (1, 0)
        return self.seen(), {}

    def step(self, action: int) -> Any:
        trap = self.traps
        self.steps += "counted" in trap
        if "slips" in trap and self.np_random.random() < 0.001:
            action = 0
        if "dice" in trap and self.tools["dice"][trap["dice"]].random() < 0.001:
            action = 0
        if "global" in trap and np.random.random() < 0.001:  # noqa: NPY002
            action = 0
        if "broken" in trap:
            raise RuntimeError("no power")
        move = ((0, 1), (1, 0), (0, -1), (-1, 0))[action]
        row, column = (
            min(max(a + b, 0), self.n - 1) for a, b in zip(self.place, move, strict=True)
        )
        self.place = (row, column)
        if "key" in trap and self.place == (0, self.n - 1):
            self.key = True
        over = self.place == (self.n - 1, self.n - 1) and ("key" not in trap or self.key)
        return self.seen(), -1 - row / 2, over, "cut" in trap, {}


def test_a_deterministic_environment_is_explored_by_copies() -> None:
    env = wrappers.TimeLimit(Maze(), 30)
    mdp = MDP.from_gymnasium(env, "9/10")
    assert (mdp.n_states, mdp.time_limit, mdp.name) == (16, 30, "Maze")
    # The same maze, described cell by cell.
    mine = MDP.from_function(
        (0, 0), lambda cell: range(4) if cell != "end" else [], step_of(4), "9/10"
    )
    assert certify(mdp).start_value == certify(mine).start_value
    for cell in mine.space.columns[0].objects:
        state, same = mdp.space.number(cell), mine.space.number(cell)
        assert certify(mdp).value[state] == certify(mine).value[same]
    # What the observation shows is a part of the state, and the cell (3, 3) is passed without it.
    with_key = MDP.from_gymnasium(Maze(key=True, shown=True))
    assert with_key.space.lookup.can_find((3, 3, 0))
    assert certify(with_key).start_value == certify(MDP.from_gymnasium(Maze())).start_value


def list_moves(cell: Any) -> range:
    return range(0 if cell == "end" else 4)


def step_of(n: int) -> Any:
    def step(cell: Any, action: int) -> list[Any]:
        env = Maze(n)
        env.place = cell
        _, reward, over, *_ = env.step(action)
        return [(1, "end" if over else env.place, reward)]

    return step


TRAPS: list[tuple[dict[str, Any], str]] = [
    ({"slips": True}, "step(0) in state (0, 0) draws random numbers"),
    ({"dice": 0}, "draws random numbers"),
    ({"dice": 1}, "draws random numbers"),
    ({"global": True}, "draws random numbers"),
    ({"random start": True}, "reset() draws random numbers"),
    ({"rare start": True}, "reset() draws random numbers"),
    ({"counted": True}, "steps has two values in state (0, 0)"),
    ({"key": True}, "key has two values in state"),
    ({"floats": True}, "not whole numbers"),
    ({"cut": True}, "cuts the episode off"),
    ({"broken": True}, "raises RuntimeError: no power"),
    ({"lock": (n for n in "")}, "copy.deepcopy raises TypeError"),
]


@pytest.mark.parametrize(("traps", "said"), TRAPS, ids=range(len(TRAPS)))
def test_other_environments_are_refused_and_what_to_record_is_said(traps: Any, said: str) -> None:
    error = refused(lambda: MDP.from_gymnasium(Maze(**traps)), said, "Maze", "docs/records")
    for name in ("episode", "state", "action", "reward", "next_state", "terminated", "truncated"):
        assert name in error.fix


def test_the_environment_itself_is_not_touched(monkeypatch: pytest.MonkeyPatch) -> None:
    env, before = Maze(), np.random.get_state()[2]  # noqa: NPY002
    monkeypatch.setattr("exact_mdp.mdp.io.gymnasium_steps.MOST", 12)
    refused(lambda: MDP.from_gymnasium(env), "it has more than 12 states")
    assert not hasattr(env, "place")
    assert np.random.get_state()[2] == before  # noqa: NPY002
