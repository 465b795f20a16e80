"""What `exact-mdp sensitivity` does: hand the options to a kind, and show what it found."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import fields, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from exact_mdp.analysis.cli.commands import sensitivity as declared
from exact_mdp.analysis.cli.options import Given, Question, given
from exact_mdp.analysis.cli.render import Report, to_json
from exact_mdp.analysis.cli.sensitivity import KINDS
from exact_mdp.analysis.cli.sensitivity.options import Asked
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import write_atomically


def sensitivity(
    *, model: str, kind: str, sets: tuple[str, ...], discount: str | None, **options: Any
) -> Report:
    """Run one kind of sensitivity analysis."""
    asking = {field.name: options.pop(field.name) for field in fields(Question)}
    check(kind, options)
    loaded = given(model, sets, discount, **asking)
    module, _, function = KINDS[kind].does.partition(":")
    asked = Asked(given=loaded, options=options)
    found: Report = getattr(import_module(f"{__package__}.{module}"), function)(asked)
    seen = options.get("perception")
    result = {**loaded.head, "kind": kind, "perception": seen, **found.result}
    facts = {
        "model": loaded.loaded.name,
        "analysis": kind,
        "question": loaded.head["question"],
        "start": loaded.head["start"],
        "perception": f"{seen}, which the policy held fixed acts on" if seen else None,
    }
    if options.get("out") is not None:
        result = _written(loaded, Path(options["out"]), kind, result)
    return replace(found, result=result, facts={**facts, **found.facts}, notes=loaded.notes)


def check(kind: str, options: Mapping[str, Any]) -> None:
    """Raise ModelError for an option that the kind does not use."""
    used = KINDS[kind]
    for name, value in options.items():
        if name in used.uses or value is None or value is False or value == ():
            continue
        takers = ", ".join(each for each in KINDS if name in KINDS[each].uses)
        raise ModelError(
            f"{_spelled(name)} does not apply to {kind}{f': {used.about}' if used.about else ''}",
            where=f"sensitivity {kind}",
            fix=f"leave it out; it applies to {takers}",
        )
    if options.get("out") is not None and not options["out"].strip():
        raise ModelError("--out is empty", where="--out", fix="name a folder")


def _spelled(name: str) -> str:
    """Return an option as users write it, for the name of its value."""
    return next(max(each.opts, key=len) for each in declared.params if each.name == name)


def _written(asked: Given, folder: Path, kind: str, result: dict[str, Any]) -> dict[str, Any]:
    """Write the result and the record of its making into the folder of --out."""
    context = click.get_current_context(silent=True)
    words = (context.find_root().obj or ()) if context is not None else ()
    paths = [folder / f"{kind}.json", folder / "run.json"]
    result["written"] = [str(path) for path in paths]
    record = run_record(
        asked.mdp, model=asked.loaded.name, solver=kind, seed=result.get("seed"), command=words
    )
    write_atomically(paths[0], to_json(result) + "\n")
    write_atomically(paths[1], json.dumps(record, indent=2) + "\n")
    return result
