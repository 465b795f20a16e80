"""Scenarios of made-up numbers, and their laws once more, worked out from the rules alone."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory

from care_oracle import independent

import exact_mdp
from exact_mdp import Scenario

PACKAGE = Path(exact_mdp.__file__).parent
SHIPPED = {path.stem: path.read_text("utf-8") for path in PACKAGE.glob("*/scenarios/*.toml")}


def scenario_of(text: str) -> Scenario:
    """Read a scenario as from a file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.toml"
        path.write_text(text, encoding="utf-8")
        return Scenario.load(path)


def independent_law(scenario: Scenario, status: tuple[int, ...], action: str) -> list[Fraction]:
    """The chance of each status being 1 next, by the rules of Section 2.1, default readings."""
    values, names = scenario.values(), scenario.statuses
    result = []
    for i, name in enumerate(names):
        given = f"assistance.{action}.{name}.{'persistence' if status[i] else 'onset'}"
        push = sum(values[f"influence.{names[j]}.{name}"] for j in range(len(names)) if j != i
                   and status[j])  # fmt: skip
        raised = min(Fraction(1), values[f"base.{name}"] + push)
        free = values[f"persistence.{name}"] if status[i] else raised
        result.append(values.get(given, free))
    return result


def skip_law(scenario: Scenario, status: tuple[int, ...]) -> list[Fraction]:
    values, names = scenario.values(), scenario.statuses
    result = []
    for i, name in enumerate(names):
        rule = "persistence"
        if name in scenario.others:
            rule = "with-other" if status[names.index(scenario.others[name])] else "alone"
        result.append(values[f"skip.{name}.{rule}"] if status[i] else Fraction(0))
    return result


def check_own(scenario: Scenario, pairs: Iterable[int]) -> None:
    """Compare a one-task model, read by default, with laws worked out here."""
    mdp, count = scenario.compile(), len(scenario.statuses)
    (subtasks,) = scenario.tasks
    reward = {name: scenario[f"reward.{name}"] for name in scenario.components}
    for pair in pairs:
        labels = mdp.space.as_dict(int(mdp.pair_state[pair]))
        subtask, trial = int(labels["subtask"]), int(labels["trial"])
        status = tuple(int(bit) for bit in labels["status"])
        action = mdp.actions[mdp.pair_action[pair]]

        def number(subtask: int, trial: int, bits: tuple[int, ...]) -> int:
            if subtask == subtasks:
                return mdp.n_states - 1
            code = int("".join(map(str, bits)), 2)
            return mdp.space.index(subtask=subtask, trial=trial, status=code)

        wanted: dict[tuple[int, Fraction], Fraction] = defaultdict(Fraction)
        for p, after in independent(independent_law(scenario, status, action)):
            gain = reward["timestep"] + reward["trial"]
            gain += sum(reward[scenario.weights[n]] for n, bit in
                        zip(scenario.statuses, after, strict=True) if bit)  # fmt: skip
            bonus = reward["task-complete"] * (subtask + 1 == subtasks)
            if not any(after):
                gain += reward["subtask-complete"] + reward[f"assist.{action}"] + bonus
                wanted[number(subtask + 1, 0, (0,) * count), gain] += p
            elif trial + 1 < scenario.max_trial:
                wanted[number(subtask, trial + 1, after), gain] += p
            else:
                gain += reward["subtask-skip"] + bonus
                for q, kept in independent(skip_law(scenario, after)):
                    wanted[number(subtask + 1, 0, kept), gain] += p * q
        found: dict[tuple[int, Fraction], Fraction] = defaultdict(Fraction)
        for p, following, gain in mdp.table.row(pair):
            found[following, gain] += p
        assert found == wanted, mdp.where(pair)


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
