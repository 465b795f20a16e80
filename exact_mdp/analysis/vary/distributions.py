"""Distributions of uncertain parameters: Beta, Dirichlet, normal or gamma around today's value.

A probability with mean m that rests on n observations is Beta(m n, (1 - m) n), of variance
m (1 - m) / (n + 1); probabilities that make up one row of a model are Dirichlet with the same n
(Briggs, Weinstein, Fenwick et al., Medical Decision Making 32, 2012). n is the *effective sample
size*: the information of n patients. A reward weight is normal with standard deviation c |m|, or
gamma, which keeps the sign.

A probability of 0 or 1 has no such distribution and stays as it is. Reward weights are preferences
rather than estimates and stay too, unless a relative standard deviation is stated; so does the
discount, unless a size is stated of it. What is stated may be in a TOML file:

    [default]
    effective_sample_size = 100

    [base]                                 # every parameter whose name begins so
    effective_sample_size = 40

    ["base.anger"]                         # or [base.anger]
    effective_sample_size = 15

    ["reward.subtask-complete"]
    distribution = "gamma"                 # or "normal", which it is unless stated
    relative_sd = 0.2

    [influence]
    fixed = true

Every part draws from its own stream, which its name decides, so that adding one leaves the others'
draws as they are.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.analysis.vary.ranges import unit_of
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, parameter_of
from exact_mdp.mdp.parametric.family import place_of
from exact_mdp.mdp.result import Brief
from exact_mdp.mdp.table import Floats

KINDS = ("beta", "dirichlet", "normal", "gamma")
SIZES = (1e-6, 1e15)  # effective sample sizes that floats can draw from
SPREADS = (1e-9, 1e3)  # relative standard deviations
EFFECTIVE_SAMPLE_SIZE = 100.0
SIZE, SPREAD, DEFAULT = "effective_sample_size", "relative_sd", "default"
SETTINGS = (SIZE, SPREAD, "distribution", "fixed")
FIXED = "stated to be fixed"

Settings = Mapping[str, object]


@dataclass(frozen=True, kw_only=True)
class Uncertain:
    """The joint distribution of some parameters.

    Attributes
    ----------
    names : tuple of k str
        One name; for a Dirichlet all that share a row, what is left of the row going unnamed.
    kind : "beta", "dirichlet", "normal" or "gamma"
    mean : tuple of k float
    size : float
        Effective sample size of a beta or Dirichlet; of the others the relative standard deviation.
    label : str
        What the part is called; its name unless given.

    Examples
    --------
    >>> part = Uncertain(names=("p",), kind="beta", mean=(0.25,), size=19)
    >>> round(part.sd[0], 4)
    0.0968
    """

    names: tuple[str, ...]
    kind: str
    mean: tuple[float, ...]
    size: float
    label: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "label", self.label or ", ".join(self.names))
        most_names = math.inf if self.kind == "dirichlet" else 1
        least, most = SIZES if self.share else SPREADS
        what, fix = "", ""
        if self.kind not in KINDS:
            what, fix = repr(self.kind), f"choose one of {', '.join(KINDS)}"
        elif len(self.mean) != len(self.names) or not 1 <= len(self.names) <= most_names:
            what = f"{len(self.names)} names and {len(self.mean)} means for a {self.kind}"
            fix = "give one of each; of a dirichlet as many means as names"
        elif not least <= self.size <= most:
            kind = "effective sample size" if self.share else "relative standard deviation"
            what = f"{kind} {self.size!r}"
            fix = f"choose a number above 0, from {least:g} to {most:g}"
        elif self.share and not (min(self.mean) > 0 and self.left > 0):
            what = f"means {', '.join(f'{mean:g}' for mean in self.mean)}"
            fix = "name probabilities above 0 whose sum is below 1"
        elif not self.share and (self.mean[0] == 0 or not math.isfinite(self.mean[0])):
            what = f"a relative spread around {self.mean[0]:g}"
            fix = "leave a weight of 0 out, and state finite ones"
        if what:
            where = f"distribution of {', '.join(self.names)}"
            raise ModelError(what, where=where, fix=fix)

    @property
    def share(self) -> bool:
        """Whether the parameters are probabilities."""
        return self.kind in ("beta", "dirichlet")

    @property
    def left(self) -> float:
        """What the row holds beside the named probabilities."""
        return 1.0 - math.fsum(self.mean)

    @property
    def sd(self) -> tuple[float, ...]:
        """Standard deviation of each parameter."""
        if self.share:
            return tuple(math.sqrt(m * (1 - m) / (self.size + 1)) for m in self.mean)
        return (abs(self.mean[0]) * self.size,)

    def draw(self, sequence: SeedSequence, count: int) -> Floats:
        """Return (count, k) draws; the same ones for the same seed."""
        own = (*sequence.spawn_key, crc32(" ".join(self.names).encode()))
        rng = np.random.default_rng(SeedSequence(sequence.entropy, spawn_key=own))
        mean = self.mean[0]
        if self.kind == "beta":
            return rng.beta(mean * self.size, (1 - mean) * self.size, size=(count, 1))
        if self.kind == "dirichlet":
            return rng.dirichlet(self.size * np.array([*self.mean, self.left]), size=count)[:, :-1]
        if self.kind == "normal":
            return rng.normal(mean, self.sd[0], size=(count, 1))
        shape = 1 / self.size**2
        return math.copysign(1.0, mean) * rng.gamma(shape, abs(mean) / shape, size=(count, 1))


@dataclass(frozen=True, kw_only=True, repr=False)
class Uncertainty(Brief):
    """What is drawn and what is held.

    Attributes
    ----------
    parts : tuple of Uncertain
    fixed : {parameter name: reason}
    """

    parts: tuple[Uncertain, ...]
    fixed: Mapping[str, str]

    def __post_init__(self) -> None:
        for name, count in Counter(self.names).items():
            if count > 1:
                raise ModelError(
                    f"{name} is drawn twice", where="uncertainty", fix="state each name once"
                )

    @property
    def names(self) -> tuple[str, ...]:
        """The Q parameters that are drawn, in the order of the draws' columns."""
        return tuple(name for part in self.parts for name in part.names)

    @property
    def mean(self) -> Floats:
        """(Q,) means, which are today's values."""
        return np.array([mean for part in self.parts for mean in part.mean])

    def draw(self, sequence: SeedSequence, count: int) -> Floats:
        """Return (count, Q) draws."""
        if not self.parts:
            return np.empty((count, 0))
        return np.hstack([part.draw(sequence, count) for part in self.parts])

    def checked(self, model: Parametric) -> Uncertainty:
        """Return it; raises ModelError where a name is not the model's, or nothing is drawn."""
        for name in self.names:
            parameter_of(model, name)
        if not self.parts:
            raise ModelError(
                "no parameter is uncertain", where=place_of(model), fix="state what is drawn"
            )
        return self


def uncertainty(
    model: Parametric,
    stated: Mapping[str, Settings] | None = None,
    *,
    default: float = EFFECTIVE_SAMPLE_SIZE,
    names: Sequence[str] | None = None,
) -> Uncertainty:
    """Return the uncertainty of a model's parameters.

    Parameters
    ----------
    model : Parametric
        Its `rows`, where it has any, are the parameters that share a row, by the row's label:
        Dirichlet, instead of a Beta for each.
    stated : {name, beginning of names, or label of a row: settings}
        Settings are `effective_sample_size`, `relative_sd` with `distribution` ("normal" or
        "gamma"), or `fixed = True`. The longest beginning counts: `influence.anger` before
        `influence`. Entries of a row are drawn together, so that what is stated of them must be
        the same for all, or stated of the row.
    default : float
        Effective sample size of every probability of which nothing is stated.
    names : sequence of str, optional
        Draw these alone: parameters, or labels of rows.

    Returns
    -------
    Uncertainty

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
    stated = {name: _checked(name, settings) for name, settings in (stated or {}).items()}
    default = _number({"default": default}, "default", "of which nothing is stated")
    parameters = {parameter.name: parameter for parameter in model.parameters}
    rows = {label: tuple(row) for label, row in getattr(model, "rows", {}).items()}
    for name in stated:
        if name not in rows and not any(_begins(known, name) for known in parameters):
            parameter_of(model, name)
    chosen = set(parameters) if names is None else _chosen(model, names, rows)
    label_of: dict[str, str] = {}
    for label, row in rows.items():
        for name in row:
            if label_of.setdefault(parameter_of(model, name).name, label) != label:
                raise ModelError(
                    f"{name} is in two rows", where=f"row {label}", fix="name it in one of them"
                )
    fixed: dict[str, str] = {}
    parts: dict[str, Uncertain] = {}
    for name, parameter in parameters.items():
        label = label_of.get(name, name)
        members = rows.get(label, (name,)) if name in label_of else (name,)
        if name not in chosen:
            fixed[name] = "not among the names asked for"
        elif name not in fixed and label not in parts:
            try:
                if name in label_of:
                    parts[label] = _row([parameters[m] for m in members], label, stated, default)
                else:
                    parts[label] = _alone(parameter, _settings(stated, name), default)
            except _Held as reason:
                fixed |= dict.fromkeys(members, str(reason))
    return Uncertainty(parts=tuple(parts.values()), fixed=fixed)


class _Held(Exception):
    """Why a parameter is not drawn."""


def _alone(parameter: Parameter, settings: Settings, default: float) -> Uncertain:
    """Return the distribution of one parameter; raises _Held where it is not drawn."""
    name, mean = parameter.name, float(parameter.value)
    if unit_of(parameter) != "reward":
        size = _size(settings, name, default)
        if name == DISCOUNT and SIZE not in settings:
            raise _Held("the discount is held unless stated otherwise")
        if mean in (0.0, 1.0):
            raise _Held(f"{mean:g} today")
        return Uncertain(names=(name,), kind="beta", mean=(mean,), size=size)
    if settings.get("fixed"):
        raise _Held(FIXED)
    if SIZE in settings:
        raise ModelError(
            "an effective sample size of a reward weight",
            where=f"parameter {name}",
            fix="state a relative_sd",
        )
    if SPREAD not in settings:
        raise _Held("reward weights are held unless stated otherwise")
    spread, kind = _number(settings, SPREAD, name), str(settings.get("distribution", "normal"))
    # A weight of 0 has no relative spread; what is stated is checked all the same.
    part = Uncertain(names=(name,), kind=kind, mean=(mean or 1.0,), size=spread)
    if not mean:
        raise _Held("0 today")
    return part


def _row(
    row: Sequence[Parameter], label: str, stated: Mapping[str, Settings], default: float
) -> Uncertain:
    """Return the joint distribution of a row's entries; raises _Held where they are not drawn."""
    names = tuple(parameter.name for parameter in row)
    said = [dict(_settings(stated, name)) for name in names]
    if label in stated:
        said = [each or dict(stated[label]) for each in said] + [dict(stated[label])]
    if any(each != said[0] for each in said):
        raise ModelError(
            "the entries of a row have different settings",
            where=f"row {label}",
            fix=f'its probabilities are drawn together: state them once, for "{label}"',
        )
    for parameter in row:
        if unit_of(parameter) != "probability":
            raise ModelError(
                f"{parameter.name} is not a probability of a row",
                where=f"row {label}",
                fix="name probabilities",
            )
    size = _size(said[0], label, default)
    means = tuple(float(parameter.value) for parameter in row)
    return Uncertain(names=names, kind="dirichlet", mean=means, size=size, label=label)


def _size(settings: Settings, name: str, default: float) -> float:
    """Return the effective sample size of a probability; raises _Held where it is fixed."""
    if settings.get("fixed"):
        raise _Held(FIXED)
    if SPREAD in settings:
        raise ModelError(
            "a relative spread of a probability",
            where=f"parameter {name}",
            fix="state an effective_sample_size",
        )
    size = _number(settings, SIZE, name) if SIZE in settings else default
    # Checked here too, so that a size that cannot be is refused where a mean of 0 or 1 is held.
    return Uncertain(names=(name,), kind="beta", mean=(0.5,), size=size).size


def _chosen(
    model: Parametric, names: Sequence[str], rows: Mapping[str, tuple[str, ...]]
) -> set[str]:
    """Return the parameters that are asked for; of a row all or none."""
    if isinstance(names, str):
        raise ModelError(
            f"names is one string, {names!r}", where="names", fix="give a list of names"
        )
    chosen: set[str] = set()
    for name in names:
        chosen |= set(rows[name]) if name in rows else {parameter_of(model, name).name}
    for label, row in rows.items():
        if not chosen.isdisjoint(row) and not chosen.issuperset(row):
            raise ModelError(
                f"{next(name for name in row if name in chosen)} is asked for without the others "
                "of its row",
                where="names",
                fix=f"name the row, {label}: its probabilities are drawn together",
            )
    return chosen


def _begins(name: str, start: str) -> bool:
    return f"{name}.".startswith(f"{start}.")


def _settings(stated: Mapping[str, Settings], name: str) -> Settings:
    """Return what is stated of the longest beginning of a name."""
    found = [start for start in stated if _begins(name, start)]
    return stated[max(found, key=len)] if found else {}


def _checked(name: str, settings: object) -> Settings:
    """Return settings that are known, of the right kind, and go together."""
    where = f"parameter {name}"
    if not isinstance(settings, Mapping):
        raise ModelError(
            f"{settings!r:.60} is stated",
            where=where,
            fix=f"state settings of a distribution: {{{SIZE} = 50}}",
        )
    for key in settings:
        if key not in SETTINGS:
            fix = suggest(str(key), SETTINGS)
            raise ModelError(f"unknown setting {key!r}", where=where, fix=fix)
    held, kind = settings.get("fixed", False), settings.get("distribution", "normal")
    what = ""
    if not isinstance(held, bool):
        what, fix = f"fixed is {held!r}", "write fixed = true, or leave it out"
    elif held and len(settings) > 1:
        what, fix = "fixed, and a distribution", "state one of the two"
    elif kind not in ("normal", "gamma"):
        what, fix = f"distribution {kind!r}", "choose normal or gamma"
    elif "distribution" in settings and SPREAD not in settings:
        what, fix = f"distribution {kind!r} without a relative_sd", "state a relative_sd"
    elif SIZE in settings and SPREAD in settings:
        what = "both an effective_sample_size and a relative_sd"
        fix = "state the first for a probability, the second for a reward weight"
    if what:
        raise ModelError(what, where=where, fix=fix)
    for key in {SIZE, SPREAD} & settings.keys():
        _number(settings, key, name)
    return settings


def _number(settings: Settings, key: str, name: str) -> float:
    """Return a setting that must be a number; raises ModelError where it is none."""
    value, where = settings[key], f"parameter {name}"
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise ModelError(f"{key} is {value!r:.60}", where=where, fix="give a number")
    try:
        return float(value)
    except OverflowError as error:
        what = f"{key} has more than 300 digits"
        raise ModelError(what, where=where, fix="give a smaller one") from error


def load_uncertainty(path: str | Path) -> tuple[dict[str, dict[str, object]], float | None]:
    """Return what a TOML file states of uncertainty, and the default sample size.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    {name or beginning of names: settings}, float or None

    Raises
    ------
    ModelError
        For broken TOML, a setting that is not known, and a file that states nothing.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "stated.toml")
    ...     _ = file.write_text('"base.anger" = {effective_sample_size = 50}')
    ...     load_uncertainty(file)
    ({'base.anger': {'effective_sample_size': 50}}, None)
    """
    found: dict[str, dict[str, object]] = {}
    _visit("", toml_of(read_text(path, most=SMALL), str(path), number=float), found, str(path))
    if not found:
        raise ModelError(
            "nothing is stated in the file",
            where=str(path),
            fix=f'write "NAME" = {{{SIZE} = 50}}',
        )
    general = found.pop(DEFAULT, {})
    if set(general) - {SIZE}:
        raise ModelError(
            "[default] states more than effective_sample_size",
            where=f"{path}, {DEFAULT}",
            fix="state the rest for each parameter",
        )
    return found, _number(general, SIZE, DEFAULT) if general else None


def _visit(
    prefix: str, table: dict[str, Any], found: dict[str, dict[str, object]], path: str
) -> None:
    where = f"{path}, {prefix or 'top level'}"
    for key, value in table.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, dict):
            _visit(name, value, found, path)
        elif prefix and key in SETTINGS:
            found.setdefault(prefix, {})[key] = value
        elif isinstance(value, list):
            fix = f'psa takes distributions: write "{name}" = {{{SIZE} = 50}}'
            raise ModelError(f"{name} has a range", where=where, fix=fix)
        else:
            fix = suggest(key, SETTINGS) if prefix else f"write {key} = {{{SIZE} = 50}}"
            raise ModelError(f"unknown setting {key!r}", where=where, fix=fix)
