"""The models, policies and records of the golden answers: exact numbers, made by public names."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path

import numpy as np

from exact_mdp import MDP

FOLDER = Path(__file__).parent / "models"
# One pair: state, action, its rewards by component, its next states.
Row = tuple[str, str, str, str]

REPAIR: tuple[Row, ...] = (
    ("new", "run", "energy 1", "new 3/4, worn 1/4"),
    ("new", "service", "energy 1, work 1/3", "new 9/10, worn 1/10"),
    ("worn", "run", "energy 5/3", "worn 1/2, broken 1/2"),
    ("worn", "service", "energy 5/3, work 2", "new 2/3, worn 1/3"),
    ("worn", "replace", "work 9", "new 1"),
    ("broken", "repair", "work 6", "worn 6/7, broken 1/7"),
    ("broken", "replace", "work 11", "new 1"),
)
# Two closed classes, and a state that chooses between them; in each class another choice.
CLASSES: tuple[Row, ...] = (
    ("hall", "left", "pay -4", "west 1/2, hall 1/2"),
    ("hall", "right", "pay -1", "east 1/3, hall 2/3"),
    ("hall", "wait", "pay 2", "hall 1"),
    ("west", "walk", "pay 7", "cave 1/2, west 1/2"),
    ("west", "ride", "pay 4", "cave 1/5, west 4/5"),
    ("cave", "walk", "pay -1/3", "west 1"),
    ("east", "walk", "pay 5/2", "east 2/3, lake 1/3"),
    ("lake", "walk", "pay 3", "east 1"),
    ("lake", "swim", "pay 13/4", "lake 4/5, east 1/5"),
)
# At discount 1: rest and turn make cycles without reward, trap is not left again.
LOOPS: tuple[Row, ...] = (
    ("home", "rest", "", "home 1"),
    ("home", "go", "toll -1, steps -1", "road 2/3, ditch 1/3"),
    ("road", "turn", "", "home 1"),
    ("road", "drive", "toll -2, steps -1", "goal 1/2, road 1/3, trap 1/6"),
    ("road", "walk", "steps -4, gift 5", "goal 3/4, ditch 1/4"),
    ("ditch", "climb", "steps -2, gift 1/7", "road 5/6, ditch 1/6"),
    ("ditch", "turn", "", "road 1"),
    ("trap", "stay", "", "trap 1"),
    ("goal", "stay", "", "goal 1"),
)
# At discount 1: a state that earns for ever, one that loses for ever, and ways around both.
ENDLESS: tuple[Row, ...] = (
    ("gate", "try", "coins 0", "mine 1/4, pit 1/4, out 1/2"),
    ("gate", "leave", "coins 5/3", "out 1"),
    ("lane", "safe", "coins 7/2", "out 1"),
    ("lane", "risk", "coins 9", "pit 1/9, out 8/9"),
    ("mine", "dig", "coins 1/2", "mine 1"),
    ("mine", "stop", "coins 1", "out 1"),
    ("pit", "fall", "coins -1", "pit 1"),
    ("out", "stay", "", "out 1"),
)
# No cycles: a project in three phases, where money and days are at odds.
PROJECT: tuple[Row, ...] = (
    ("plan", "short", "days -1, money -3, worth 2", "build 1/2, redo 1/2"),
    ("plan", "long", "days -4, money -5, worth 3", "build 7/8, redo 1/8"),
    ("redo", "fast", "days -1, money -6", "build 1"),
    ("redo", "slow", "days -3, money -2", "build 1"),
    ("build", "team", "days -2, money -7, worth 12", "sold 2/3, kept 1/3"),
    ("build", "alone", "days -5, money -2, worth 11", "sold 3/4, kept 1/4"),
    ("build", "buy", "days 0, money -12, worth 13", "sold 1"),
    ("sold", "stop", "", "sold 1"),
    ("kept", "stop", "", "kept 1"),
)


def parts(text: str) -> dict[str, Fraction]:
    """Return "a 1/2, b 3" as numbers by name."""
    pairs = (each.split() for each in text.split(", ") if each)
    return {name: Fraction(number) for name, number in pairs}


def model(
    name: str,
    rows: tuple[Row, ...],
    discount: str,
    labels: Mapping[str, tuple[str, ...]],
    start: Mapping[str, str] | None = None,
    sense: str = "max",
) -> MDP:
    """Build a model from rows of text; the total of the components is the reward."""
    states = list(dict.fromkeys(state for state, *_ in rows))
    actions = list(dict.fromkeys(action for _, action, *_ in rows))
    amounts = [parts(rewards) for _, _, rewards, _ in rows]
    names = list(dict.fromkeys(name for row in amounts for name in row))
    mdp = MDP.from_outcomes(
        [
            (states.index(s), actions.index(a), [(p, states.index(t), sum(row.values()))
             for t, p in parts(outcomes).items()])
            for (s, a, _, outcomes), row in zip(rows, amounts, strict=True)
        ],
        discount,
        actions=actions,
        states=states,
        name=name,
        sense=sense,
        labels={key: [s in named for s in states] for key, named in labels.items()},
        start={states.index(s): p for s, p in (start or {states[0]: "1"}).items()},
    )  # fmt: skip
    order = sorted(
        range(len(rows)), key=lambda n: (states.index(rows[n][0]), actions.index(rows[n][1]))
    )
    return mdp.with_(components={name: [amounts[n].get(name, 0) for n in order] for name in names})


def records() -> list[tuple[object, ...]]:
    """Return 80 episodes of a treatment, which an arithmetic pattern fills in."""
    rows: list[tuple[object, ...]] = []
    for episode in range(80):
        state = ("ill", "weak")[episode % 2]
        for step in range(6):
            mark = (7 * episode + 11 * step + episode * step) % 20
            action = "ab"[(episode + step) % 3 == 0]
            cured = mark < (9 if action == "b" else 5)
            then = "" if cured else ("ill", "weak")[mark % 2]
            rows.append((episode, state, action, ("-1/2", "-5/4")[action == "b"], then))
            if cured:
                break
            state = then
    return rows


def write(folder: Path = FOLDER) -> None:
    """Write every file."""
    folder.mkdir(exist_ok=True)
    mixed = {"new": "1/3", "worn": "2/3"}
    model("repair", REPAIR, "9/10", {"down": ("broken",)}, mixed, "min").save(folder / "repair.npz")
    model("classes", CLASSES, "99/100", {"water": ("lake",)}).save(folder / "classes.npz")
    places = {"goal": ("goal",), "lost": ("trap",), "dry": ("home", "road", "goal")}
    model("loops", LOOPS, "1", places).save(folder / "loops.npz")
    model("endless", ENDLESS, "1", {"out": ("out",)}).save(folder / "endless.npz")
    model("project", PROJECT, "1", {"sold": ("sold",)}).save(folder / "project.npz")
    whole = (folder / "repair.npz").read_bytes()
    (folder / "damaged.npz").write_bytes(whole[: len(whole) // 2])
    with (folder / "records.csv").open("w", encoding="utf-8", newline="") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(("episode", "state", "action", "reward", "next_state"))
        table.writerows(records())
    words = [f"{n:04b}" for n in range(16)]
    care = ("none", "supportive", "non-directive", "directive")
    fixed = {word: care[(3 * n + 1) % 4] for n, word in enumerate(words)}
    (folder / "fixed.json").write_text(json.dumps(fixed, indent=1) + "\n", "utf-8")
    lines = [f"{word},{care[n % 4]},0.25\n{word},{care[(n + 1) % 4]},0.75\n"
             for n, word in enumerate(words)]  # fmt: skip
    (folder / "mixed.csv").write_text("status,action,probability\n" + "".join(lines), "utf-8")
    np.save(folder / "table.npy", np.array([[(5 * s + 3 * a) % 7 for a in range(4)]
                                            for s in range(16)], dtype=float))  # fmt: skip
    seen = "".join(f"{name} = {value}\n" for name, value in
                   zip(("forgetfulness", "confusion", "anger", "disengagement"),
                       ("0.9", "0.8", "0.95", "0.85"), strict=True))  # fmt: skip
    (folder / "perception.toml").write_text(
        f"[sensitivity]\n{seen}\n[specificity]\n{seen}", "utf-8"
    )
