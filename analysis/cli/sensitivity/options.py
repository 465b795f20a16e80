"""What the options of `exact-mdp sensitivity` ask for: a model, a policy, ranges, workers.

What the kinds of `exact-mdp sensitivity` have in common: what they return, and write.

A kind returns its result for JSON, the facts and the tables for people. With --out, the result is
written beside a record of how it was made.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exact_mdp.analysis.cli.options import policy_of, whole_of
from exact_mdp.analysis.cli.render import Grid, to_json
from exact_mdp.analysis.sensitivity.ranges import (
    Range,
    Ranges,
    checked,
    load_ranges,
    ranges_of,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.table import FLOAT_RANGE, exact, shown

if TYPE_CHECKING:
    from exact_mdp.mdp.io.load import Loaded


def model_of(loaded: Loaded) -> Parametric:
    """Return the loaded model with its parameters."""
    return parametric(loaded.scenario if loaded.scenario is not None else loaded.mdp)


def policy_from(loaded: Loaded, options: Mapping[str, Any]) -> object:
    """Return the policy that the options name, or "optimal"."""
    form, perception = options["policy"], options.get("perception")
    if form == "optimal" and perception is None:
        return form
    return policy_of(loaded.mdp, form, perception)


def ranges_from(model: Parametric, options: Mapping[str, Any]) -> Ranges:
    """Return the range of each parameter that is asked for."""
    stated = Ranges()
    if options["range_file"] is not None:
        stated.update(load_ranges(model, options["range_file"]))
    for text in options["ranges"]:
        name, equals, ends = text.partition("=")
        low, colon, high = ends.partition(":")
        if not equals or not colon:
            raise ModelError(f"{text!r} is not a range", where="--range", fix="write NAME=LOW:HIGH")
        stated.update(checked(model, {name.strip(): (low.strip(), high.strip())}))
    if options["relative"] is not None and options["whole"]:
        raise ModelError("both --relative and --whole", where="options", fix="give one of them")
    share = None if options["relative"] is None else share_of(options["relative"])
    relative = "whole" if options["whole"] else share
    return ranges_of(model, options["parameters"] or None, stated, relative)


def share_of(relative: object) -> Fraction:
    """Return what `--relative` states."""

    try:
        share = exact(relative)
    except ModelError as error:
        raise ModelError(error.what, where="--relative", fix=error.fix) from error
    if share and not FLOAT_RANGE[0] < abs(share) < FLOAT_RANGE[1]:
        raise ModelError(
            f"a share of {shown(share)}", where="--relative", fix="choose one nearer to 1"
        )
    return share


def not_empty(spans: Mapping[str, Range]) -> tuple[Ranges, list[str]]:
    """Return the ranges that are more than a point, and the names of the others.

    A parameter that is 0 today has no range around it.
    """
    ranges = Ranges({name: span for name, span in spans.items() if span.low < span.high})
    return ranges, sorted(set(spans) - set(ranges))


def any_range(options: Mapping[str, Any]) -> bool:
    """Return whether the options state ranges."""
    return bool(
        options["ranges"] or options["range_file"] or options["relative"] or options["whole"]
    )


def work_from(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return where the work is done, from the options."""
    jobs = options.get("n_jobs")
    return {
        "n_jobs": None if jobs is None else whole_of(str(jobs), "--n-jobs", 1, 1024),
        "scheduler": options.get("scheduler"),
        "folder": options.get("out"),
        "progress": True,
    }


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

    from exact_mdp.analysis.record import run_record

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
