"""What may be stated of a parameter's uncertainty, checked.

A setting is `effective_sample_size` of a probability, `relative_sd` of a reward weight, with
`distribution` where it is not normal, or `fixed`.

How uncertain each parameter of a model is: what is drawn together, from what, and what is held.

A probability is Beta, or Dirichlet with the others of its row, with an effective sample size
(`analysis.sensitivity.psa.distributions`). A probability of 0 or 1 has no such distribution and
stays as it is. Reward weights are preferences rather than estimates and stay too, unless a relative
standard deviation is stated; so does the discount, unless a size is stated of it.

Reading how uncertain parameters are from a TOML file.

[default]
effective_sample_size = 100

[base]                                 # every parameter whose name begins so
effective_sample_size = 40

["base.anger"]                         # or [base.anger]
effective_sample_size = 15

["reward.subtask-complete"]
distribution = "gamma"                 # or "normal", which it is unless stated
relative_sd = 0.2
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.analysis.sensitivity.psa.distributions import Uncertain, Uncertainty
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, parameter_of

SETTINGS = ("effective_sample_size", "relative_sd", "distribution", "fixed")


def checked_settings(name: str, settings: object) -> Mapping[str, object]:
    """Return settings that are known, of the right kind, and go together.

    Raises
    ------
    ModelError
        For all others.

    Examples
    --------
    >>> checked_settings("base", {"effective_sample_size": 50})
    {'effective_sample_size': 50}
    """
    where = f"parameter {name}"
    if not isinstance(settings, Mapping):
        raise ModelError(
            f"{settings!r:.60} is stated",
            where=where,
            fix=f"state settings of a distribution: {{{SETTINGS[0]} = 50}}",
        )
    for key in settings:
        if key not in SETTINGS:
            raise ModelError(
                f"unknown setting {key!r}", where=where, fix=suggest(str(key), SETTINGS)
            )
    held = settings.get("fixed", False)
    if not isinstance(held, bool):
        raise ModelError(f"fixed is {held!r}", where=where, fix="write fixed = true, or leave out")
    if held and len(settings) > 1:
        raise ModelError(
            "fixed, and a distribution", where=where, fix="state one or the other of it"
        )
    kind = settings.get("distribution", "normal")
    if kind not in ("normal", "gamma"):
        raise ModelError(f"distribution {kind!r}", where=where, fix="choose normal or gamma")
    if "distribution" in settings and "relative_sd" not in settings:
        raise ModelError(
            f"distribution {kind!r} without a relative_sd", where=where, fix="state a relative_sd"
        )
    if "effective_sample_size" in settings and "relative_sd" in settings:
        raise ModelError(
            "both an effective_sample_size and a relative_sd",
            where=where,
            fix="state the first of a probability, the second of a reward weight",
        )
    for key in ("effective_sample_size", "relative_sd"):
        if key in settings:
            number_of(settings, key, name)
    return settings


def number_of(settings: Mapping[str, object], key: str, name: str) -> float:
    """Return a setting that must be a number; raises ModelError where it is none."""
    value = settings[key]
    number = isinstance(value, int | float | np.integer | np.floating)
    if isinstance(value, bool) or not number:
        raise ModelError(f"{key} is {value!r:.60}", where=f"parameter {name}", fix="give a number")
    try:
        return float(value)
    except OverflowError as error:
        raise ModelError(
            f"{key} has more than 300 digits", where=f"parameter {name}", fix="give a smaller one"
        ) from error


EFFECTIVE_SAMPLE_SIZE = 100.0


def uncertainty(
    model: Parametric,
    stated: Mapping[str, Mapping[str, object]] | None = None,
    *,
    default: float = EFFECTIVE_SAMPLE_SIZE,
    names: Sequence[str] | None = None,
    rows: Mapping[str, Sequence[str]] | None = None,
) -> Uncertainty:
    """Return the uncertainty of a model's parameters.

    Parameters
    ----------
    stated : {name, beginning of names, or label of a row: settings}
        Settings are `effective_sample_size`, `relative_sd` with `distribution` ("normal" or
        "gamma"), or `fixed = True`. The longest beginning counts: `influence.anger` before
        `influence`. Entries of a row are drawn together, so that what is stated of them must be
        the same for all, or stated of the row.
    default : float
        Effective sample size of every probability of which nothing is stated.
    names : sequence of str, optional
        Draw these alone: parameters, or labels of rows.
    rows : {label: parameter names}, optional
        Parameters that share a row of the model: Dirichlet, instead of a Beta for each. The
        model's own `rows`, where it has any, unless given.

    Raises
    ------
    ModelError
        For unknown names and settings, and sizes that are not above 0.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.mdp.parametric import parametric
    >>> model = parametric(Scenario.load("yuan2025"))
    >>> found = uncertainty(model, {"base": {"effective_sample_size": 20}})
    >>> found.parts[0].names, found.parts[0].size, found.fixed["persistence.anger"]
    (('base.forgetfulness',), 20.0, '1 today')
    """
    stated = {name: checked_settings(name, settings) for name, settings in (stated or {}).items()}
    default = number_of({"default": default}, "default", "of which nothing is stated")
    parameters = {parameter.name: parameter for parameter in model.parameters}
    if rows is None:
        rows = getattr(model, "rows", {})
    rows = {label: tuple(row) for label, row in rows.items()}
    for name in stated:
        if name not in rows and not any(_begins(known, name) for known in parameters):
            parameter_of(model, name)
    shared = _row_of(model, rows)
    chosen = set(parameters) if names is None else _chosen(model, names, rows)
    fixed: dict[str, str] = {}
    parts: list[Uncertain] = []
    done: set[str] = set()
    for name, parameter in parameters.items():
        if name not in chosen:
            fixed[name] = "not among the names asked for"
            continue
        label = shared.get(name)
        if label in done:
            continue
        if label is None:
            members, part = (name,), _part(parameter, _settings(stated, name), default)
        else:
            done.add(label)
            members = rows[label]
            part = _row([parameters[each] for each in members], label, stated, default)
        if isinstance(part, str):
            fixed |= dict.fromkeys(members, part)
        else:
            parts.append(part)
    return Uncertainty(parts=tuple(parts), fixed=fixed)


def _row_of(model: Parametric, rows: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return the label of the row that a parameter belongs to, of those that belong to one."""
    shared: dict[str, str] = {}
    for label, row in rows.items():
        for name in row:
            if parameter_of(model, name).name in shared:
                raise ModelError(
                    f"{name} is in two rows", where=f"row {label}", fix="name it in one of them"
                )
            shared[name] = label
    return shared


def _chosen(
    model: Parametric, names: Sequence[str], rows: Mapping[str, tuple[str, ...]]
) -> set[str]:
    """Return the parameters that are asked for; of a row all or none."""
    if isinstance(names, str):
        raise ModelError(f"names is the word {names!r}", where="names", fix="give a list of names")
    chosen: set[str] = set()
    for name in names:
        chosen |= set(rows[name]) if name in rows else {parameter_of(model, name).name}
    for label, row in rows.items():
        missing = set(row) - chosen
        if missing and missing != set(row):
            raise ModelError(
                f"{next(name for name in row if name in chosen)} is asked for without the others "
                "of its row",
                where="names",
                fix=f"name the row, {label}: its probabilities are drawn together",
            )
    return chosen


def _begins(name: str, start: str) -> bool:
    return name == start or name.startswith(f"{start}.")


def _settings(stated: Mapping[str, Mapping[str, object]], name: str) -> Mapping[str, object]:
    found = [start for start in stated if _begins(name, start)]
    return stated[max(found, key=len)] if found else {}


def _sized(settings: Mapping[str, object], name: str, default: float) -> float | str:
    """Return the effective sample size of a probability, or why it is held."""
    if settings.get("fixed"):
        return "stated to be fixed"
    if "relative_sd" in settings:
        raise ModelError(
            "a relative spread of a probability",
            where=f"parameter {name}",
            fix="state an effective_sample_size",
        )
    key = "effective_sample_size"
    size = number_of(settings, key, name) if key in settings else default
    # Checked here too, so that a size that cannot be is refused where a mean of 0 or 1 is held.
    return Uncertain(names=(name,), kind="beta", mean=(0.5,), size=size).size


def _part(parameter: Parameter, settings: Mapping[str, object], default: float) -> Uncertain | str:
    """Return the distribution of one parameter, or why it is held."""
    name, mean = parameter.name, float(parameter.value)
    if (parameter.low, parameter.high) == (0, 1):
        size = _sized(settings, name, default)
        if isinstance(size, str):
            return size
        if name == DISCOUNT and "effective_sample_size" not in settings:
            return "the discount is held unless stated otherwise"
        if mean in (0.0, 1.0):
            return f"{mean:g} today"
        return Uncertain(names=(name,), kind="beta", mean=(mean,), size=size)
    if settings.get("fixed"):
        return "stated to be fixed"
    if "effective_sample_size" in settings:
        raise ModelError(
            "an effective sample size of a reward weight",
            where=f"parameter {name}",
            fix="state a relative_sd",
        )
    if "relative_sd" not in settings:
        return "reward weights are held unless stated otherwise"
    spread = number_of(settings, "relative_sd", name)
    kind = str(settings.get("distribution", "normal"))
    # A weight of 0 has no relative spread; what is stated is checked all the same.
    part = Uncertain(names=(name,), kind=kind, mean=(mean or 1.0,), size=spread)
    return part if mean else "0 today"


def _row(
    row: Sequence[Parameter],
    label: str,
    stated: Mapping[str, Mapping[str, object]],
    default: float,
) -> Uncertain | str:
    """Return the joint distribution of a row's entries, or why they are held."""
    names = tuple(parameter.name for parameter in row)
    said = [dict(_settings(stated, name)) for name in names]
    if label in stated:
        said = [each or dict(stated[label]) for each in said] + [dict(stated[label])]
    if any(each != said[0] for each in said):
        raise ModelError(
            "something else is stated of one entry of a row than of another",
            where=f"row {label}",
            fix=f'its probabilities are drawn together: state it once, of "{label}"',
        )
    for parameter in row:
        if (parameter.low, parameter.high) != (0, 1) or parameter.name == DISCOUNT:
            raise ModelError(
                f"{parameter.name} is no probability of a row",
                where=f"row {label}",
                fix="name probabilities",
            )
    size = _sized(said[0], label, default)
    if isinstance(size, str):
        return size
    means = tuple(float(parameter.value) for parameter in row)
    return Uncertain(names=names, kind="dirichlet", mean=means, size=size, label=label)


DEFAULT = "default"


def load_uncertainty(path: str | Path) -> tuple[dict[str, dict[str, object]], float | None]:
    """Return what a file states: {name or beginning: settings}, and the default sample size.

    Raises
    ------
    ModelError
        For broken TOML, a setting that is not known, and a file that states nothing.
    """
    content = toml_of(read_text(path, most=SMALL), str(path), number=float)
    found: dict[str, dict[str, object]] = {}
    _visit("", content, found, str(path))
    if not found:
        raise ModelError(
            "nothing is stated in the file",
            where=str(path),
            fix='write "NAME" = {effective_sample_size = 50}',
        )
    general = found.pop(DEFAULT, {})
    if set(general) - {"effective_sample_size"}:
        raise ModelError(
            "[default] states something else than effective_sample_size",
            where=f"{path}, {DEFAULT}",
            fix="state that of each parameter",
        )
    key = "effective_sample_size"
    return found, number_of(general, key, DEFAULT) if general else None


def _visit(
    prefix: str, table: dict[str, Any], found: dict[str, dict[str, object]], where: str
) -> None:
    for key, value in table.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, dict):
            _visit(name, value, found, where)
        elif prefix and key in SETTINGS:
            found.setdefault(prefix, {})[key] = value
        elif isinstance(value, list):
            raise ModelError(
                f"{name} has a range",
                where=f"{where}, {prefix or 'top level'}",
                fix=f'psa takes distributions: write "{name}" = {{{SETTINGS[0]} = 50}}',
            )
        else:
            raise ModelError(
                f"unknown setting {key!r}",
                where=f"{where}, {prefix or 'top level'}",
                fix=suggest(key, SETTINGS) if prefix else f"write {key} = {{{SETTINGS[0]} = 50}}",
            )
