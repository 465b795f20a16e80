"""Scenarios of made-up numbers, and their laws once more, worked out from the rules alone."""

from collections import defaultdict
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import pytest
from care_oracle import Oracle, State, oracle_of
from policy_cases import state_of
from refusal_tables import of_file

import exact_mdp
from exact_mdp import MDP, Scenario

PACKAGE = Path(exact_mdp.__file__).parent
SHIPPED = {path.stem: path.read_text("utf-8") for path in PACKAGE.glob("*/scenarios/*.toml")}


def scenario_of(text: str) -> Scenario:
    scenario: Scenario = of_file("scenario.toml", text, Scenario.load)
    return scenario


Law = dict[tuple[State, Fraction, bool], Fraction]


def law_of(mdp: MDP, pair: int) -> Law:
    """What the compiled model says of one pair."""
    law: Law = defaultdict(Fraction)
    table = mdp.table
    assert table.event is not None
    first = int(table.offsets[pair])
    for i, (probability, following, reward) in enumerate(table.row(pair)):
        skipped = bool(table.event[first + i])
        law[state_of(mdp, following), reward, skipped] += probability
    return law


def wanted_of(oracle: Oracle, state: State, action: str) -> tuple[Law, dict[str, Fraction]]:
    """What the reference says of it, with the expected reward components."""
    law: Law = defaultdict(Fraction)
    parts: dict[str, Fraction] = defaultdict(Fraction)
    for probability, following, rewards, skipped in oracle.outcomes(state, action):
        law[following, sum(rewards.values(), Fraction(0)), skipped] += probability
        for name, reward in rewards.items():
            parts[name] += probability * reward
    return law, parts


def check_pairs(mdp: MDP, oracle: Oracle, pairs: Iterable[int]) -> None:
    for pair in pairs:
        state = state_of(mdp, int(mdp.pair_state[pair]))
        action = mdp.actions[mdp.pair_action[pair]]
        law, parts = wanted_of(oracle, state, action)
        assert law_of(mdp, pair) == law, mdp.where(pair)
        amounts = dict(zip(mdp.component_names, mdp.components[pair], strict=True))
        for name, value in amounts.items():
            assert value == pytest.approx(float(parts.get(name, 0)), rel=1e-14, abs=1e-14)


def check_own(scenario: Scenario, pairs: Iterable[int]) -> None:
    check_pairs(scenario.compile(), oracle_of(scenario), pairs)


def own_text(statuses: int, actions: int) -> str:
    """A scenario of made-up numbers, with its first two statuses tied to each other on a skip."""
    names = [f"s{i}" for i in range(statuses)]
    lines = [f"statuses = {names}", f"actions = {[f'a{i}' for i in range(actions)]}"]
    lines += ["tasks = [2]", "max_trial = 2", "[base]"]
    lines += [f"{name} = 0.{i + 1}" for i, name in enumerate(names)]
    lines += ["[persistence]", *(f'{name} = "{i + 2}/{i + 3}"' for i, name in enumerate(names))]
    for i, name in enumerate(names):
        lines += [f"[influence.{name}]", f"{names[(i + 1) % statuses]} = 0.25"]
        number = i % (actions - 1) + 1
        lines += [f"[assistance.a{number}.{name}]", f"persistence = 0.{i}", "onset = 0.05"]
        lines += [f"[skip.{name}]"]
        if i < 2:
            lines += [f"other = '{names[1 - i]}'", "alone = 0.1", "with-other = 0.9"]
        else:
            lines += ["persistence = 0.5"]
    weights = ["trial", "subtask-complete", "subtask-skip", "timestep", "task-complete", *names]
    lines += ["[reward]", *(f"{weight} = {i - 5}.5" for i, weight in enumerate(weights))]
    lines += ["[reward.assist]", *(f"a{i} = -{i}" for i in range(actions))]
    return "\n".join(lines)
