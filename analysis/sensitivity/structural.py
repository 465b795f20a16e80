"""Structural uncertainty: the same outputs under each reading of a scenario's text, side by side.

A reading of the text is a model of its own. Each is solved anew (the policy re-optimised), and each
given policy is evaluated in it (the policy held fixed); what holding it costs is its regret there.
Whether the optimum changes is decided over all states that are reached, see
`analysis.sensitivity.carried_optimum`. States of two readings need not correspond, so that optimal
actions are compared where all of them begin: subtask 0, trial 0, by status. One changes there where
no action is optimal in both; the optimum may do so elsewhere alone.

Unless others are named, the readings compared are those that differ from the present one in a
single choice (Bojke et al., Characterizing structural uncertainty in decision analytic models,
Value in Health 12, 2009).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.analysis.sensitivity.base_case import digest, finite_optimum, finite_worth
from exact_mdp.analysis.sensitivity.carried_optimum import Today, best_pairs
from exact_mdp.analysis.sensitivity.draws.blocks import How
from exact_mdp.analysis.sensitivity.draws.sampled import sampled
from exact_mdp.analysis.sensitivity.gradient import gradient
from exact_mdp.analysis.sensitivity.joint_radius import joint_radius
from exact_mdp.mdp.care.compile import compile_scenario
from exact_mdp.mdp.care.laws import excess, warn_of_excess
from exact_mdp.mdp.care.perception import perceived
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.care.tables import READINGS
from exact_mdp.mdp.errors import ModelError, ScenarioWarning
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, PolicyLike
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, Integers, exact
from exact_mdp.solvers import evaluate
from exact_mdp.solvers.parallel.many import many
from exact_mdp.solvers.solution import Bounded, Solution

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")

PRESENT = "as it is"
CARRIED = "optimum as it is"
STEP = Fraction(1, 10_000)  # of a difference, as a share of the parameter
MOST_TRIED = 5

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


# ---- readings --------------------------------------------------------------------------------


def one_at_a_time(
    model: Scenario, options: Mapping[str, Sequence[object]] = OPTIONS
) -> dict[str, dict[str, object]]:
    """Return every reading that differs from the scenario in one choice.

    Parameters
    ----------
    model : Scenario
    options : {choice: options}, optional

    Returns
    -------
    {label: settings}

    Examples
    --------
    >>> found = one_at_a_time(Scenario.load("yuan2025"))
    >>> len(found), list(found)[0]
    (16, 'influence_orientation = column-to-row')
    """
    each = ({name: option} for name, several in options.items() for option in several)
    return _other(model, each)


def combinations(
    model: Scenario, options: Mapping[str, Sequence[object]] = READINGS
) -> dict[str, dict[str, object]]:
    """Return every combination of options but the scenario's own.

    Parameters
    ----------
    model : Scenario
    options : {choice: options}, optional

    Returns
    -------
    {label: settings}

    Examples
    --------
    >>> len(combinations(Scenario.load("yuan2025")))
    575
    """
    chosen = product(*options.values())
    return _other(model, (dict(zip(options, each, strict=True)) for each in chosen))


def _other(model: Scenario, readings: Iterable[dict[str, object]]) -> dict[str, dict[str, object]]:
    """Return what each reading changes in a scenario, where it changes anything, by its label."""
    found = {}
    for reading in readings:
        settings = {n: option for n, option in reading.items() if not _same(model, n, option)}
        if settings:
            found[", ".join(f"{name} = {_text(o)}" for name, o in settings.items())] = settings
    return found


def _same(model: Scenario, name: str, option: object) -> bool:
    """Whether a scenario has this option already."""
    changed = model.with_(parameters={_dotted(name): option})
    return all(
        getattr(changed, part) == getattr(model, part)
        for part in ("readings", "tasks", "max_trial", "discount", "parameters")
    )


def _dotted(name: str) -> str:
    return f"readings.{name}" if name in READINGS else name


def _text(option: object) -> str:
    if isinstance(option, tuple):
        return str(list(option))
    return option if isinstance(option, str) else f"{float(exact(option)):g}"


def _variant(model: Scenario, label: str, settings: Mapping[str, object]) -> Scenario:
    """Return a scenario under a reading; an error names the reading."""
    try:
        return model.with_(parameters={_dotted(name): v for name, v in settings.items()})
    except ModelError as error:
        where = f"reading {label}: {error.where}"
        raise ModelError(error.what, where=where, fix=error.fix) from error


# ---- results ---------------------------------------------------------------------------------


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


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Structural(Result):
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

    @property
    def value(self) -> Bounded:
        """The optimal start value under the present reading."""
        return self.present.optimal

    @property
    def error(self) -> float:
        """Bound on the error of `value`."""
        return self.value.error

    def frame(self) -> DataFrame:
        """Return one row for each reading; values, sd and regrets in units of reward."""
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
        table = pandas.DataFrame(rows).assign(claim="bounded")
        table.attrs["policy"] = "re-optimised under each reading; named policies held fixed"
        return table


def structural(
    model: Scenario,
    readings: Mapping[str, Mapping[str, object]] | None = None,
    *,
    policies: Mapping[str, PolicyLike] | None = None,
    perception: ArrayLike | None = None,
    elasticities: bool = True,
    stability: bool = True,
    **how: Unpack[How],
) -> Structural:
    """Return the same outputs under every reading.

    Parameters
    ----------
    model : Scenario
    readings : {label: settings}, optional
        Settings as `Scenario.with_` takes them, besides the scenario's own; `one_at_a_time` unless
        given (see also `combinations`).
    policies : {name: PolicyLike}, optional
        Policies held fixed, for which every reading has the states, such as a policy by status.
        Today's optimum is always among them, carried over state by state.
    perception : (Z, Z), optional
        Confusion of the perceived status (column) given the true one, on which all of these act
        (see `mdp.care.perception`). The optimum of each reading knows the status.
    elasticities, stability : bool
        Whether to find the parameter that weighs most, and the stability radius for joint changes
        (see `analysis.sensitivity.joint_radius`).
    **how
        Where the work is done: n_jobs, scheduler, folder and progress of
        `solvers.parallel.many.many`; the result does not depend on them.

    Returns
    -------
    Structural

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
    if not isinstance(model, Scenario):
        raise ModelError(
            "readings belong to care scenarios, not to this model",
            where="structural",
            fix="name a scenario, or a scenario file",
        )
    chosen = one_at_a_time(model) if readings is None else dict(readings)
    held = dict(policies or {})
    for what, name, given in (("reading", PRESENT, chosen), ("policy", CARRIED, held)):
        if name in given:
            raise ModelError(
                f"a {what} called {name!r}", where="structural", fix="call it something else"
            )
    mdp = compile_scenario(model)
    optimum = finite_optimum(mdp, f"reading {PRESENT!r}")
    everything: dict[str, Mapping[str, object]] = {PRESENT: {}, **chosen}
    variants = {PRESENT: model} | {n: _variant(model, n, each) for n, each in chosen.items()}
    _warn_of_excess(variants)
    confusion = None if perception is None else np.asarray(perception, dtype=np.float64)
    # Every policy is read, and refused where it does not fit, before anything is solved.
    hashes = [
        f"{name} {digest(_weights(mdp, PRESENT, name, form, confusion))}"
        for name, form in {CARRIED: optimum.policy, **held}.items()
    ]
    key: dict[str, object] = {}
    if how.get("folder") is not None:
        key = {
            "readings": [fingerprint(compile_scenario(each)) for each in variants.values()],
            "labels": list(variants),
            "policies": hashes,
            "elasticities": elasticities,
            "stability": stability,
        }
    today = Today.of(model, mdp, optimum)
    found = many(
        partial(_outputs, today, held, confusion, elasticities, stability),
        list(variants.items()),
        key=key,
        what="readings",
        **how,
    )
    status = mdp.space.column("status")
    statuses = tuple(status.label(value) for value in range(status.size))
    present = found[0]["optimal_actions"]
    return Structural(
        statuses=statuses,
        readings=tuple(
            _reading(label, settings, [CARRIED, *held], statuses, model.actions, present, each)
            for (label, settings), each in zip(everything.items(), found, strict=True)
        ),
    )


def _warn_of_excess(variants: Mapping[str, Scenario]) -> None:
    """Warn once of the readings under which a chance is cut off at 1."""
    over = [label for label, each in variants.items() if excess(each) is not None]
    if over:
        more = f" and {len(over) - 1} other readings" if len(over) > 1 else ""
        where = f", under the reading {over[0]!r}{more}"
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
    numbers = zip(found["value"].tolist(), found["error"].tolist(), strict=True)
    optimal, *fixed = (Bounded(value=value, error=error) for value, error in numbers)
    return Reading(
        label=label,
        settings=MappingProxyType(dict(settings)),
        states=int(found["states"]),
        optimal=optimal,
        sd=float(found["sd"]),
        actions=tuple(actions[number] for number in found["actions"].tolist()),
        optimal_actions=found["optimal_actions"],
        optimum_changes=bool(found["changes"]),
        changed=tuple(name for name, each in zip(statuses, changes, strict=True) if each),
        policies=dict(zip(names, fixed, strict=True)),
        top=str(found["top"]),
        elasticity=float(found["elasticity"]),
        stability=float(found["stability"]),
    )


# ---- one reading -----------------------------------------------------------------------------


def _outputs(
    today: Today,
    held: Mapping[str, PolicyLike],
    perception: Floats | None,
    elasticities: bool,
    stability: bool,
    piece: tuple[str, Scenario],
) -> dict[str, Any]:
    """Return what comes out under one reading, (label, scenario), as arrays."""
    label, scenario = piece
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)  # the caller has warned of all readings
        mdp = scenario.compile()
        where = f"reading {label!r}"
        solution = finite_optimum(mdp, where)
        choices, changes = today.carried(scenario, mdp, solution)
        weights = [
            _weights(mdp, label, name, form, perception)
            for name, form in {"optimum": choices, **held}.items()
        ]
        values = [solution.start, *(finite_worth(mdp, each, where) for each in weights)]
        optimal, actions = _first_actions(scenario, mdp, solution)
        top, elasticity = _top(scenario) if elasticities else ("", np.nan)
        return {
            "states": np.int64(mdp.n_states),
            "value": np.array([each.value for each in values]),
            "error": np.array([each.error for each in values]),
            "sd": np.float64(evaluate(mdp, solution.policy).sd),
            "changes": np.bool_(changes),
            "optimal_actions": optimal,
            "actions": actions,
            "top": np.array(top),
            "elasticity": np.float64(elasticity),
            "stability": np.float64(joint_radius(scenario).share if stability else np.nan),
        }


def _first_actions(
    scenario: Scenario, mdp: MDP, solution: Solution
) -> tuple[NDArray[np.bool_], Integers]:
    """Return (V, A) whether an action is optimal, and (V,) one that is, at subtask 0, trial 0."""
    size = mdp.space.column("status").size
    good, number = best_pairs(mdp, solution), scenario.actions.index
    optimal = np.zeros((size, len(scenario.actions)), dtype=bool)
    actions = np.zeros(size, dtype=np.int64)
    for value in range(size):
        state = mdp.space.index(subtask=0, trial=0, status=value)
        for pair in mdp.pairs_of(state):
            optimal[value, number(mdp.actions[mdp.pair_action[pair]])] = good[pair]
        actions[value] = number(mdp.actions[solution.policy[state]])
    return optimal, actions


def _top(scenario: Scenario) -> tuple[str, float]:
    """Return the table's parameter of largest elasticity, and the elasticity.

    Differences of the optimum's values put the parameters in order; the derivative of the first
    one then comes from the envelope theorem. One without a single derivative is passed over.
    """
    slopes = _slopes(scenario)
    for name in sorted(slopes, key=lambda each: -abs(slopes[each]))[:MOST_TRIED]:
        elasticity = gradient(scenario, names=[name], exact=False)[name].elasticity
        if elasticity is not None:
            return name, elasticity
    return "", np.nan


def _slopes(scenario: Scenario) -> dict[str, float]:
    """Return θ dV*/dθ of every parameter that is not 0, by differences within its range."""
    moving = [parameter for parameter in scenario.parameters if parameter.value]
    names = [parameter.name for parameter in moving]
    today = np.array([float(parameter.value) for parameter in moving])
    ends = np.array([[float(p.value * (1 - STEP)), float(p.value * (1 + STEP))] for p in moving])
    for row, parameter in enumerate(moving):
        low = -np.inf if parameter.low is None else float(parameter.low)
        high = np.inf if parameter.high is None else float(parameter.high)
        ends[row] = np.clip(ends[row], low, high)
    draws = np.tile(today, (2 * len(names), 1))
    rows = np.arange(len(names))
    draws[2 * rows, rows], draws[2 * rows + 1, rows] = ends.T
    value = sampled(scenario.parametric(), names, draws).optimal
    steps = (ends[:, 1] - ends[:, 0]) / today
    return dict(zip(names, ((value[1::2] - value[::2]) / steps).tolist(), strict=True))


def _weights(
    mdp: MDP, label: str, name: str, form: PolicyLike, perception: Floats | None
) -> Floats:
    """Return (L,) probabilities of pairs of a policy; an error names policy and reading."""
    try:
        policy = Policy.of(mdp, form)
        return (policy if perception is None else perceived(mdp, policy, perception)).weights(mdp)
    except ModelError as error:
        where = f"policy {name}, reading {label}: {error.where}"
        raise ModelError(error.what, where=where, fix=error.fix) from error
