"""How uncertain each parameter is: Beta, Dirichlet, normal or gamma around today's value.

A probability with mean m that is worth n observations is Beta(m n, (1 - m) n); probabilities that
make up one row of a model are Dirichlet with the same n (Briggs, Weinstein, Fenwick et al., Medical
Decision Making 32, 2012). n is the *effective sample size*: as much as n patients would tell.
A probability of 0 or 1 has no such distribution and stays as it is. Reward weights are preferences
rather than estimates and stay too, unless a relative standard deviation c is stated: normal with
standard deviation c |m|, or gamma, which keeps the sign.

Every part draws from its own stream, which its name decides, so that adding one leaves the others'
draws as they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.random import SeedSequence

from mdp.errors import ModelError, suggest
from mdp.parameters import Parameter
from mdp.parametric import DISCOUNT, Parametric, parameter_of
from mdp.table import Floats

EFFECTIVE_SAMPLE_SIZE = 100.0
KINDS = ("beta", "dirichlet", "normal", "gamma")
SETTINGS = ("effective_sample_size", "relative_sd", "distribution", "fixed")
SIZES = (1e-6, 1e15)  # effective sample sizes that floats can draw from
SPREADS = (1e-9, 1e3)  # relative standard deviations


@dataclass(frozen=True, kw_only=True)
class Uncertain:
    """The joint distribution of some parameters.

    Attributes
    ----------
    names : tuple of str
        One name; for a Dirichlet all that share a row, what is left of the row going unnamed.
    kind : "beta", "dirichlet", "normal" or "gamma"
    mean : tuple of float
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
        where = f"distribution of {', '.join(self.names)}"
        if self.kind not in KINDS:
            raise ModelError(f"{self.kind!r}", where=where, fix=f"choose one of {', '.join(KINDS)}")
        if len(self.mean) != len(self.names) or not 0 < len(self.names) < (
            math.inf if self.kind == "dirichlet" else 2
        ):
            raise ModelError(
                f"{len(self.names)} names and {len(self.mean)} means for a {self.kind}",
                where=where,
                fix="give one of each; of a dirichlet as many means as names",
            )
        share = self.kind in ("beta", "dirichlet")
        least, most = SIZES if share else SPREADS
        if not least <= self.size <= most:
            what = "effective sample size" if share else "relative standard deviation"
            raise ModelError(
                f"{what} {self.size:g}",
                where=where,
                fix=f"choose a number above 0, from {least:g} to {most:g}",
            )
        if share and not (min(self.mean) > 0 and self.left > 0):
            raise ModelError(
                f"means {', '.join(f'{mean:g}' for mean in self.mean)}",
                where=where,
                fix="name probabilities above 0 whose sum is below 1",
            )
        if not share and (self.mean[0] == 0 or not math.isfinite(self.mean[0])):
            raise ModelError(
                f"a relative spread around {self.mean[0]:g}",
                where=where,
                fix="leave a weight of 0 out, and state finite ones",
            )

    @property
    def left(self) -> float:
        """What the row holds beside the named probabilities."""
        return 1.0 - math.fsum(self.mean)

    @property
    def sd(self) -> tuple[float, ...]:
        """Standard deviation of each parameter."""
        if self.kind in ("beta", "dirichlet"):
            return tuple(math.sqrt(m * (1 - m) / (self.size + 1)) for m in self.mean)
        return (abs(self.mean[0]) * self.size,)

    def draw(self, sequence: SeedSequence, count: int) -> Floats:
        """Return (count, k) draws; the same ones for the same seed."""
        stream = SeedSequence(
            sequence.entropy,
            spawn_key=(*sequence.spawn_key, crc32(" ".join(self.names).encode())),
        )
        rng = np.random.default_rng(stream)
        if self.kind == "beta":
            (m,) = self.mean
            return rng.beta(m * self.size, (1 - m) * self.size, size=(count, 1))
        if self.kind == "dirichlet":
            shape = self.size * np.array([*self.mean, self.left])
            return rng.dirichlet(shape, size=count)[:, :-1]
        if self.kind == "normal":
            return rng.normal(self.mean[0], self.sd[0], size=(count, 1))
        shape = 1 / self.size**2
        sign = math.copysign(1.0, self.mean[0])
        return sign * rng.gamma(shape, abs(self.mean[0]) / shape, size=(count, 1))


@dataclass(frozen=True, kw_only=True)
class Uncertainty:
    """What is drawn and what is held.

    Attributes
    ----------
    parts : tuple of Uncertain
    fixed : {parameter name: reason}
    """

    parts: tuple[Uncertain, ...]
    fixed: Mapping[str, str]

    def __post_init__(self) -> None:
        seen: set[str] = set()
        for name in self.names:
            if name in seen:
                raise ModelError(
                    f"{name} is drawn twice", where="uncertainty", fix="state each name once"
                )
            seen.add(name)

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
    >>> from mdp import Scenario
    >>> from mdp.parametric import parametric
    >>> model = parametric(Scenario.load("yuan2025"))
    >>> found = uncertainty(model, {"base": {"effective_sample_size": 20}})
    >>> found.parts[0].names, found.parts[0].size, found.fixed["persistence.anger"]
    (('base.forgetfulness',), 20.0, '1 today')
    """
    stated = {name: _checked(name, settings) for name, settings in (stated or {}).items()}
    default = number_of({"default": default}, "default", "of which nothing is stated")
    parameters = {parameter.name: parameter for parameter in model.parameters}
    if rows is None:
        rows = getattr(model, "rows", {})
    rows = {label: tuple(row) for label, row in rows.items()}
    for name in stated:
        if name not in rows and not any(_begins(known, name) for known in parameters):
            parameter_of(model, name)
    shared: dict[str, str] = {}
    for label, row in rows.items():
        for name in row:
            if parameter_of(model, name).name in shared:
                raise ModelError(
                    f"{name} is in two rows", where=f"row {label}", fix="name it in one of them"
                )
            shared[name] = label
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


def _checked(name: str, settings: object) -> Mapping[str, object]:
    """Return settings that are known, of the right kind, and go together."""
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
