"""What the kinds of `exact-mdp sensitivity` have in common: what they return, and write.

A kind returns its result for JSON, the facts and the tables for people. With --out, the result is
written beside a record of how it was made.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.cli_output import Grid, to_json
from mdp.files import write_atomically

if TYPE_CHECKING:
    from mdp.load import Loaded

Report = tuple[dict[str, Any], dict[str, str], list[Grid]]
SHOWN = 40  # rows of a table for people
ROUNDED = "of the perception, and the probabilities of actions that it makes, as rounded to floats"
"""What is certified under a perception: a file may state 1/3, which no float is."""


def only_first(count: int, shown: int = SHOWN) -> str:
    """Return how many rows of a table are shown, where that is not all of them.

    Examples
    --------
    >>> only_first(40), only_first(52)
    ('', ', the first 40 of 52')
    """
    return f", the first {shown} of {count}" if count > shown else ""


def written(
    loaded: Loaded, options: Mapping[str, Any], result: dict[str, Any], kind: str
) -> dict[str, Any]:
    """Write the result and its record into the folder of --out, where there is one."""
    out = options.get("out")
    if out is None:
        return result
    import click

    from analysis.record import run_record

    context = click.get_current_context(silent=True)
    words = (context.find_root().obj or ()) if context is not None else ()
    folder = Path(out)
    paths = [folder / f"{kind}.json", folder / "run.json"]
    result["written"] = [str(path) for path in paths]
    head = {"model": loaded.name, "kind": kind, "discount": loaded.mdp.discount}
    head["perception"] = options.get("perception")
    record = run_record(
        loaded.mdp, model=loaded.name, solver=kind, seed=result.get("seed"), command=words
    )
    write_atomically(paths[0], to_json(head | result) + "\n")
    write_atomically(paths[1], json.dumps(record, indent=2) + "\n")
    return result
