"""Readings of a scenario's text: the choices that it leaves open, one at a time or combined.

Unless others are named, the readings compared are those that differ from the present one in a
single choice (Bojke et al., Characterizing structural uncertainty in decision analytic models,
Value in Health 12, 2009).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from types import MappingProxyType

from mdp.errors import ModelError
from mdp.scenario import READINGS, Scenario
from mdp.table import exact

OPTIONS: Mapping[str, tuple[object, ...]] = MappingProxyType(
    {
        **READINGS,
        # Yuan et al. (2025) state neither the tasks of their experiments nor the discount of the
        # returns that they report.
        "tasks": ((3,), (3, 1), (2,), (4,), (1, 1, 1), (6,)),
        "evaluation_discount": (exact(1), exact("0.95")),
    }
)
"""The choices that the text leaves open, with their options."""


def one_at_a_time(
    scenario: Scenario, options: Mapping[str, Sequence[object]] = OPTIONS
) -> dict[str, dict[str, object]]:
    """Return every reading that differs from the scenario in one choice: {label: settings}.

    Examples
    --------
    >>> found = one_at_a_time(Scenario.load("yuan2025"))
    >>> len(found), list(found)[0]
    (16, 'influence_orientation = column-to-row')
    """
    return {
        _label({name: option}): {name: option}
        for name, several in options.items()
        for option in several
        if not _same(scenario, name, option)
    }


def combinations(
    scenario: Scenario, options: Mapping[str, Sequence[object]] = READINGS
) -> dict[str, dict[str, object]]:
    """Return every combination of options but the scenario's own: {label: settings}.

    Examples
    --------
    >>> len(combinations(Scenario.load("yuan2025")))
    575
    """
    found = {}
    for chosen in product(*options.values()):
        settings = {
            name: option
            for name, option in zip(options, chosen, strict=True)
            if not _same(scenario, name, option)
        }
        if settings:
            found[_label(settings)] = settings
    return found


def variant(scenario: Scenario, label: str, settings: Mapping[str, object]) -> Scenario:
    """Return a scenario under a reading; an error names the reading."""
    try:
        return scenario.with_(parameters={_dotted(name): v for name, v in settings.items()})
    except ModelError as error:
        raise ModelError(
            error.what, where=f"reading {label}: {error.where}", fix=error.fix
        ) from error


def _dotted(name: str) -> str:
    return f"readings.{name}" if name in READINGS else name


def _same(scenario: Scenario, name: str, option: object) -> bool:
    """Whether a scenario has this option already."""
    changed = scenario.with_(parameters={_dotted(name): option})
    return all(
        getattr(changed, part) == getattr(scenario, part)
        for part in ("readings", "tasks", "max_trial", "discount", "parameters")
    )


def _label(settings: Mapping[str, object]) -> str:
    return ", ".join(f"{name} = {_text(option)}" for name, option in settings.items())


def _text(option: object) -> str:
    if isinstance(option, tuple):
        return str(list(option))
    return option if isinstance(option, str) else f"{float(option):g}"
