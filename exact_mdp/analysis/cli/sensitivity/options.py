"""What the options of an analysis of parameters ask for: a model, a policy, ranges, workers.

To add an analysis, write its function (`exact_mdp.analysis.vary`), a report of it here, and
declare its command and options in `exact_mdp.analysis.cli.commands`.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from fractions import Fraction
from functools import cached_property, wraps
from pathlib import Path
from typing import Any

import click

from exact_mdp.analysis.cli.options import Given, Question, given, policy_from, whole_of
from exact_mdp.analysis.cli.render import Report, to_json
from exact_mdp.analysis.record import run_record
from exact_mdp.analysis.vary.ranges import (
    Ranges,
    checked,
    load_ranges,
    ranges_of,
)
from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.load import Loaded
from exact_mdp.mdp.parametric import Parametric, Posed, parametric
from exact_mdp.mdp.table import FLOAT_RANGE, exact, shown

STATED = ("ranges", "range_file", "relative", "whole")
ROUNDED = "of the perception, and the probabilities of actions that it makes, as rounded to floats"
"""What is certified under a perception: a file may state 1/3, which no float is."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Asked:
    """A model and the options of a sensitivity analysis."""

    given: Given
    options: Mapping[str, Any]

    @property
    def loaded(self) -> Loaded:
        """The model, with what is asked of it."""
        return self.given.loaded

    def __getitem__(self, name: str) -> Any:
        """Return the value of an option; None where it was left out."""
        return self.options.get(name) or None

    @cached_property
    def model(self) -> Parametric:
        """The model with its parameters; what is compiled already stays so."""
        base, question = self.given.endless, self.given.question
        family: Parametric = parametric(base.mdp)
        if base.scenario is not None:
            family = ScenarioFamily(scenario=base.scenario, base=base.mdp)
        return family if question is None else Posed(family=family, ask=question)

    @property
    def form(self) -> str:
        """The policy held fixed, as it was written."""
        return self["policy"] or "optimal"

    @cached_property
    def policy(self) -> Any:
        """The policy held fixed, or "optimal"."""
        seen = self["perception"]
        if self.form == "optimal" and seen is None:
            return self.form
        return policy_from(self.loaded.mdp, self.form, seen)

    @property
    def seed(self) -> int:
        """The seed of the draws."""
        return whole_of(self["seed"] or "0", "--seed", most=2**128)

    @property
    def work(self) -> dict[str, Any]:
        """Where draws are worked on, as the analyses take it."""
        jobs = self["n_jobs"]
        return {
            "n_jobs": None if jobs is None else whole_of(jobs, "--n-jobs", 1, 1024),
            "folder": self["out"],
            "progress": True,
        }

    def ranges(self) -> tuple[Ranges, list[str]]:
        """Return the ranges asked for, and the parameters without one: 0 today, so 0 ± 20 %."""
        spans = stated_ranges(self.model, self.options)
        ranges = Ranges({name: span for name, span in spans.items() if span.low < span.high})
        return ranges, sorted(set(spans) - set(ranges))


def analysis(kind: str) -> Callable[[Callable[[Asked], Report]], Callable[..., Report]]:
    """Make what the command `kind` does of a report on what was asked.

    The model's name, the kind, the discount and the question are added to every result. With --out
    the result is written into that folder, with a record of its making.
    """

    def declare(report: Callable[[Asked], Report]) -> Callable[..., Report]:
        @wraps(report)
        def work(
            *, model: str, sets: tuple[str, ...], discount: str | None, **options: Any
        ) -> Report:
            out, seen = options.get("out"), options.get("perception")
            if out is not None and not out.strip():
                raise ModelError("--out is empty", where="--out", fix="name a folder")
            asking = {field.name: options.pop(field.name) for field in fields(Question)}
            loaded = given(model, sets, discount, **asking)
            answer = report(Asked(given=loaded, options=options))
            result = {**loaded.head, "kind": kind, "perception": seen, **answer.result}
            facts = {
                "model": loaded.loaded.name,
                "analysis": kind,
                "question": loaded.head["question"],
                "start": loaded.head["start"],
                "perception": f"{seen}, which the policy held fixed acts on" if seen else None,
            }
            if out is not None:
                result = _written(loaded, Path(out), kind, result)
            return replace(
                answer, result=result, facts={**facts, **answer.facts}, notes=loaded.notes
            )

        return work

    return declare


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


def stated_ranges(model: Parametric, options: Mapping[str, Any]) -> Ranges:
    """Return the range of each parameter that the options ask for."""
    stated = Ranges()
    if options.get("range_file") is not None:
        stated.update(load_ranges(model, options["range_file"]))
    for text in options.get("ranges") or ():
        name, equals, ends = text.partition("=")
        low, colon, high = ends.partition(":")
        if not equals or not colon:
            raise ModelError(f"{text!r} is not a range", where="--range", fix="write NAME=LOW:HIGH")
        stated.update(checked(model, {name.strip(): (low.strip(), high.strip())}))
    relative, everything = options.get("relative"), options.get("whole")
    if relative is not None and everything:
        raise ModelError("both --relative and --whole", where="options", fix="give one of them")
    share = None if relative is None else _share(relative)
    names = options.get("parameters") or None
    return ranges_of(model, names, stated, "whole" if everything else share)


def _share(relative: str) -> Fraction:
    """Return what --relative states."""
    try:
        share = exact(relative)
    except ModelError as error:
        raise ModelError(error.what, where="--relative", fix=error.fix) from error
    if share and not FLOAT_RANGE[0] < abs(share) < FLOAT_RANGE[1]:
        raise ModelError(
            f"a share of {shown(share)}", where="--relative", fix="choose one nearer to 1"
        )
    return share
