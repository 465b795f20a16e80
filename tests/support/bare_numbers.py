"""Numbers of a report that say nothing of how far they can be trusted."""

from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from exact_mdp import Claim
from exact_mdp.mdp.report import Report, Shown

GIVEN = ("Policy(", "MDP(", "Uncertainty(")  # what a user brought is no finding


def bare_numbers(report: Report) -> list[str]:
    """Return where numbers stand that carry no claim, unless the report has one for all of them.

    A rational is exact, and a whole number is counted: what remains are floats.
    """
    claim = report.facts.get("claim", "")
    claim = claim.value if isinstance(claim, Shown) else claim
    for_all = [*map(str, Claim), None]  # None: of what does not hold
    said = any(f"({claim})" in report.title for claim in Claim)
    if claim in for_all or said or report.title.startswith(GIVEN):
        return []
    facts = {key: value for key, value in report.facts.items() if key != "discount"}  # given
    rows = {key: table.rows for key, table in report.tables.items() if table.rows is not None}
    return sorted({*floats_in(facts, ""), *floats_in(rows, "table ")})


def floats_in(value: Any, where: str) -> Iterator[str]:
    """Yield the places of floats in what a report holds."""
    if isinstance(value, Shown):
        yield from floats_in(value.value, where)
        yield from floats_in(value.text, where)
    elif hasattr(value, "claim") and hasattr(value, "value"):
        return
    elif hasattr(value, "to_dict"):
        yield from floats_in(value.to_dict("list"), where)
    elif isinstance(value, Mapping):
        for key, below in value.items():
            yield from floats_in(below, f"{where}{key} ")
    elif isinstance(value, list | tuple):
        for below in value:
            yield from floats_in(below, where)
    elif is_dataclass(value) and not isinstance(value, type):
        for each in fields(value):
            yield from floats_in(getattr(value, each.name), f"{where}{each.name} ")
    elif (
        isinstance(value, float | np.floating) or getattr(value, "dtype", np.dtype(int)).kind == "f"
    ):
        yield where.strip()
