"""The models, policies and records of the golden answers: exact numbers, made by public names."""

import csv
import json
import tomllib
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp import MDP

FOLDER = Path(__file__).parent / "models"
MODELS = tomllib.loads((Path(__file__).parent / "models.toml").read_text("utf-8"))


def parts(text: str) -> dict[str, Fraction]:
    """Return "a 1/2, b 3" as numbers by name."""
    pairs = (each.split() for each in text.split(", ") if each)
    return {name: Fraction(number) for name, number in pairs}


def model(name: str, spec: Mapping[str, Any]) -> MDP:
    """Build a model from rows of text; the total of the components is the reward."""
    rows = spec["rows"]
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
        spec["discount"],
        actions=actions,
        states=states,
        name=name,
        sense=spec["sense"],
        labels={key: [s in named for s in states] for key, named in spec["labels"].items()},
        start={states.index(s): p for s, p in spec["start"].items()},
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
    for name, spec in MODELS.items():
        model(name, spec).save(folder / f"{name}.npz")
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
