"""What `exact-mdp explore` does: it writes the page of the explorer."""

from __future__ import annotations

import shlex
from dataclasses import replace
from typing import Any

import click

from exact_mdp.analysis.cli.options import check_outputs, given, whole_of
from exact_mdp.analysis.cli.render import Report, Table
from exact_mdp.analysis.cli.sensitivity.options import Asked
from exact_mdp.analysis.pages import explorer
from exact_mdp.mdp.io.files import write_atomically


def explore(
    *,
    model: str,
    policy: str | None,
    parameters: tuple[str, ...],
    html: str,
    grid: str,
    kind: str,
    ranges: tuple[str, ...],
    relative: str | None,
    whole: bool,
    **shared: Any,
) -> Report:
    """Write the page."""
    check_outputs((html, (".html",)))
    loaded = given(model, policy=policy, kind=kind, **shared)
    options = {"ranges": ranges, "relative": relative, "whole": whole, "parameters": parameters}
    asked = Asked(given=loaded, options=options)
    found = explorer.explore(
        asked.model,
        *parameters,
        ranges=asked.ranges()[0],
        policy=loaded.taken,
        said=policy,
        n=whole_of(grid, "--grid", 2, explorer.MOST_GRID),
    )
    found = replace(found, model=loaded.loaded.name)
    words = click.get_current_context().find_root().obj or ()
    write_atomically(html, found.page(rerun=shlex.join(["exact-mdp", *words])))
    frame = found.frame()
    columns = {
        "from": "low:.10g",
        "to": "high:.10g",
        "value": "value_low:.10g",
        "": "value_high:.10g",
    }
    if found.second is not None:
        columns = {found.second.name: f"{found.second.name}:.6g"} | columns
    return loaded.report(
        {"parameters": parameters, "pieces": len(frame), "written": html},
        {"parameters": parameters, "written": html},
        [Table(title="pieces of the optimal value", rows=frame, columns=columns)],
    )
