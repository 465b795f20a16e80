"""What the commands answer with `--json`, and what each key means.

`answers` runs every line of `reference/json.toml`; the page of the JSON keys shows the keys of each
answer. A test holds that each key of an answer has a meaning there, and each meaning an answer.
"""

from __future__ import annotations

import json
import shlex
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from exact_mdp import MDP, certify
from exact_mdp.analysis.cli import main

SOURCE = Path(__file__).resolve().parents[1] / "reference" / "json.toml"
SEEN = ["treat,1,well"] * 60 + ["treat,0,ill"] * 20 + ["wait,1,well"] * 10 + ["wait,0,ill"] * 10


def declared() -> tuple[dict[str, str], dict[str, str]]:
    """Return the line of every command, and the meaning of every key."""
    found = tomllib.loads(SOURCE.read_text("utf-8"))
    return found["lines"], found["keys"]


def meaning(command: str, key: str, meanings: Mapping[str, str]) -> str | None:
    """Return what a key means in a command's answer."""
    return meanings.get(f"{command}: {key}", meanings.get(key))


def prepare() -> None:
    """Write the files that the lines name."""
    np.save("q_table.npy", np.eye(3)[[1] * 8])
    stay = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 1)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    model = MDP.from_outcomes(stay, discount="1/2")
    model.save("mine.npz")
    certify(model).save("proof.json")
    rows = [f"{number},ill,{row}" for number, row in enumerate(SEEN)]
    Path("records.csv").write_text("\n".join(["episode,state,action,reward,next_state", *rows]))
    with redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        main(["data", "records.csv", "--discount", "1/2", "--out", "records.npz"])


def answers(lines: Mapping[str, str]) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield what every command answers, in an empty folder."""
    with TemporaryDirectory() as folder, chdir(folder):
        prepare()
        for command, line in lines.items():
            with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as told:
                status = main([*shlex.split(line), "--json"])
            if status > 1:
                raise ValueError(f"{line}: {told.getvalue()}")
            yield command, json.loads(out.getvalue())
