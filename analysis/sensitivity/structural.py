"""Readings of a scenario's text: the choices that it leaves open, one at a time or combined.

Unless others are named, the readings compared are those that differ from the present one in a
single choice (Bojke et al., Characterizing structural uncertainty in decision analytic models,
Value in Health 12, 2009).

What comes out under each reading of a scenario's text, side by side.

Structural uncertainty: the same outputs under each way to read the model's text, side by side.

A reading of the text is a model of its own. Each is solved anew (the policy re-optimised), and each
given policy is evaluated in it (the policy held fixed); what holding it costs is its regret there.
Whether the optimum changes is decided over all states that are reached, see
`analysis.sensitivity.structural_outputs`. States of two readings need not correspond, so that
optimal actions are told where all of them begin: subtask 0, trial 0, by status. One changes there
where no action is optimal in both; the optimum may do so elsewhere alone. The term is that of Bojke
et al. (Value in Health 12, 2009), see `analysis.sensitivity.structural`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.analysis.sensitivity.structural_outputs import PRESENT, Today, hashed, quiet_outputs
from exact_mdp.mdp.care.compile import compile_scenario
from exact_mdp.mdp.care.laws import excess, warn_of_excess
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.care.tables import READINGS
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.fingerprint import fingerprint
from exact_mdp.mdp.table import exact
from exact_mdp.solvers import solve
from exact_mdp.solvers.parallel.many import many
from exact_mdp.solvers.solution import Bounded

if TYPE_CHECKING:
    from pandas import DataFrame


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """What comes out under one reading.

    Attributes
    ----------
    label : str
        What it changes.
    settings : mapping
        The same, as `Scenario.with_` takes it.
    states : int
    optimal : Bounded
        Start value with the policy re-optimised.
    sd : float
        Standard deviation of the optimal policy's return.
    actions : (V,)
        An optimal action in each status at subtask 0, trial 0.
    optimal_actions : (V, A) bool
        All of them, up to rounding.
    optimum_changes : bool
        No optimal policy of the model as it is is optimal here.
    changed : tuple of str
        Statuses in which no action is optimal both here and as it is, at subtask 0, trial 0.
    policies : {name: Bounded}
        Start values of policies held fixed.
    top : str
        The parameter of the tables whose elasticity is the largest in absolute value; empty where
        not asked for.
    elasticity : float
    stability : float
        Share of ± 20 % by which all parameters may move at once, at least, before the optimal
        policy can change; NaN where not asked for.
    """

    label: str
    settings: Mapping[str, object]
    states: int
    optimal: Bounded
    sd: float
    actions: tuple[str, ...]
    optimal_actions: NDArray[np.bool_]
    optimum_changes: bool
    changed: tuple[str, ...]
    policies: Mapping[str, Bounded]
    top: str
    elasticity: float
    stability: float

    def regret(self, name: str) -> Bounded:
        """Return what holding a policy costs; 0 where the errors leave open whether it does."""
        lost = self.optimal.value - self.policies[name].value
        error = self.optimal.error + self.policies[name].error
        return Bounded(value=lost if lost > error else 0.0, error=error)


@dataclass(frozen=True, kw_only=True, eq=False)
class Structural:
    """Outputs under every reading; the first one is the present one.

    Attributes
    ----------
    readings : tuple of Reading
    statuses : tuple of str
        Labels of the statuses, such as 0100.
    """

    readings: tuple[Reading, ...]
    statuses: tuple[str, ...]

    @property
    def present(self) -> Reading:
        """The reading that the scenario has."""
        return self.readings[0]

    def frame(self) -> DataFrame:
        """Return one row for each reading; values, sd and regrets in units of reward."""
        from pandas import DataFrame

        rows = []
        for each in self.readings:
            row: dict[str, Any] = {
                "reading": each.label,
                "states": each.states,
                "start value (reward)": each.optimal.value,
                "sd (reward)": each.sd,
                "optimum changes": each.optimum_changes,
                "changes at subtask 0, trial 0": " ".join(each.changed),
            }
            for name, value in each.policies.items():
                row[f"value of {name} (reward)"] = value.value
                row[f"regret of {name} (reward)"] = each.regret(name).value
            if each.top:
                row["top parameter"] = each.top
                row["its elasticity (% per %)"] = each.elasticity
            if not np.isnan(each.stability):
                row["stability radius (share of ± 20 %)"] = each.stability
            rows.append(row | dict(zip(self.statuses, each.actions, strict=True)))
        table = DataFrame(rows)
        table["claim"] = "bounded"
        table.attrs["present"] = {k: str(v) for k, v in self.present.settings.items()}
        table.attrs["units"] = "rewards of the scenario; probabilities and shares without unit"
        table.attrs["policy"] = "re-optimised under each reading; named policies held fixed"
        return table


CARRIED = "optimum as it is"


def structural(
    scenario: Scenario,
    readings: Mapping[str, Mapping[str, object]] | None = None,
    *,
    policies: Mapping[str, object] | None = None,
    perception: ArrayLike | None = None,
    elasticities: bool = True,
    stability: bool = True,
    n_jobs: int | None = 1,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: bool = False,
) -> Structural:
    """Return the same outputs under every reading.

    Parameters
    ----------
    readings : {label: settings}, optional
        Settings as `Scenario.with_` takes them, besides the scenario's own; `one_at_a_time` unless
        given (see also `combinations`).
    policies : {name: policy}, optional
        Anything that `Policy.of` takes and that every reading has the states for, such as a
        policy by status. Today's optimum is always among them, carried over state by state.
    perception : (Z, Z), optional
        Confusion of the perceived status (column) given the true one, on which all of these act
        (see `mdp.care.perception`). The optimum of each reading knows the status.
    elasticities, stability : bool
        Whether to tell the parameter that weighs most, and the stability radius for joint changes
        (see `analysis.sensitivity.thresholds.joint`).
    n_jobs, scheduler, folder, progress
        See `solvers.parallel.many.many`; the result does not depend on them.

    Raises
    ------
    ModelError
        For an unknown reading or option, or a policy that does not fit a reading's states.

    Examples
    --------
    >>> small = Scenario.load("yuan2025").with_(tasks=[1], max_trial=1)
    >>> readings = {"skip in its own step": {"skip_timestep": "own"}}
    >>> found = structural(small, readings, policies={"directive": "always:directive"})
    >>> [round(each.optimal.value, 3) for each in found.readings]
    [50.87, 50.405]
    """
    if not isinstance(scenario, Scenario):
        raise ModelError(
            "readings belong to care scenarios, not to this model",
            where="structural",
            fix="name a scenario, or a scenario file",
        )
    chosen = one_at_a_time(scenario) if readings is None else dict(readings)
    if PRESENT in chosen:
        raise ModelError(
            f"a reading called {PRESENT!r}", where="structural", fix="call it something else"
        )
    mdp = compile_scenario(scenario)
    status = mdp.space.column("status")
    names = [*(policies or {})]
    if CARRIED in names:
        raise ModelError(
            f"a policy called {CARRIED!r}", where="structural", fix="call it something else"
        )
    forms = [*(policies or {}).values()]
    optimum = solve(mdp)
    today = Today.of(scenario, mdp, optimum)
    variants = [scenario, *(variant(scenario, label, each) for label, each in chosen.items())]
    _warn_of_excess([PRESENT, *chosen], variants)
    pieces = list(zip([PRESENT, *chosen], variants, strict=True))
    confusion = None if perception is None else np.asarray(perception, dtype=np.float64)
    held = [(CARRIED, optimum.policy), *zip(names, forms, strict=True)]
    hashes = [hashed(mdp, name, form, confusion) for name, form in held]
    key: dict[str, object] = {}
    if folder is not None:
        key = {
            "readings": [fingerprint(compile_scenario(each)) for each in variants],
            "labels": [PRESENT, *chosen],
            "policies": hashes,
            "elasticities": elasticities,
            "stability": stability,
        }
    work = partial(quiet_outputs, today, names, forms, confusion, elasticities, stability)
    found = many(
        work,
        pieces,
        key=key,
        n_jobs=n_jobs,
        scheduler=scheduler,
        folder=folder,
        progress=progress,
        what="readings",
    )
    labels = tuple(status.label(value) for value in range(status.size))
    present = found[0]["optimal_actions"]
    everything = [{}, *chosen.values()]
    return Structural(
        statuses=labels,
        readings=tuple(
            _reading(label, settings, [CARRIED, *names], labels, scenario.actions, present, each)
            for (label, _), settings, each in zip(pieces, everything, found, strict=True)
        ),
    )


def _warn_of_excess(labels: Sequence[str], variants: Sequence[Scenario]) -> None:
    """Warn once of the readings under which a chance is cut off at 1."""
    over = [place for place, each in enumerate(variants) if excess(each) is not None]
    if over:
        more = f" and {len(over) - 1} other readings" if len(over) > 1 else ""
        where = f", under the reading {labels[over[0]]!r}{more}"
        warn_of_excess(variants[over[0]], where=where, stacklevel=3)


def _reading(
    label: str,
    settings: Mapping[str, object],
    names: Sequence[str],
    statuses: Sequence[str],
    actions: Sequence[str],
    present: NDArray[np.bool_],
    found: Mapping[str, Any],
) -> Reading:
    changes = ~(present & found["optimal_actions"]).any(axis=1)
    values = zip(found["value"][1:].tolist(), found["error"][1:].tolist(), strict=True)
    return Reading(
        label=label,
        settings=MappingProxyType(dict(settings)),
        states=int(found["states"]),
        optimal=Bounded(value=float(found["value"][0]), error=float(found["error"][0])),
        sd=float(found["sd"]),
        actions=tuple(actions[number] for number in found["actions"].tolist()),
        optimal_actions=found["optimal_actions"],
        optimum_changes=bool(found["changes"]),
        changed=tuple(name for name, each in zip(statuses, changes, strict=True) if each),
        policies={
            name: Bounded(value=value, error=error)
            for name, (value, error) in zip(names, values, strict=True)
        },
        top=str(found["top"]),
        elasticity=float(found["elasticity"]),
        stability=float(found["stability"]),
    )
