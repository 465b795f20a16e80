"""Structural uncertainty: the same outputs under each way to read the model's text, side by side.

A reading of the text is a model of its own. Each is solved anew (the policy re-optimised), and each
given policy is evaluated in it (the policy held fixed); what holding it costs is its regret there.
Whether the optimum changes is decided over all states that are reached, see
`analysis.sensitivity.carried`. States of two readings need not correspond, so that optimal actions
are told where all of them begin: subtask 0, trial 0, by status. One changes there where no action
is optimal in both; the optimum may do so elsewhere alone. The term is that of Bojke et al. (Value
in Health 12, 2009), see `analysis.sensitivity.structural_readings`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from analysis.sensitivity.carried import Today
from analysis.sensitivity.structural_outputs import PRESENT, hashed, quiet_outputs
from analysis.sensitivity.structural_readings import one_at_a_time, variant
from analysis.sensitivity.structural_result import Reading, Structural
from mdp.chances import excess, warn_of_excess
from mdp.compile import compile_scenario
from mdp.errors import ModelError
from mdp.fingerprint import fingerprint
from mdp.scenario import Scenario
from solvers import solve
from solvers.many import many
from solvers.solution import Bounded

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
        (see `mdp.perception`). The optimum of each reading knows the status.
    elasticities, stability : bool
        Whether to tell the parameter that weighs most, and the stability radius for joint changes
        (see `analysis.sensitivity.joint`).
    n_jobs, scheduler, folder, progress
        See `solvers.many.many`; the result does not depend on them.

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
