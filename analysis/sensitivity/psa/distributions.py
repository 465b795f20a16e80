"""Distributions of uncertain parameters: Beta, Dirichlet, normal or gamma around today's value.

A probability with mean m that is worth n observations is Beta(m n, (1 - m) n), of variance
m (1 - m) / (n + 1); probabilities that make up one row of a model are Dirichlet with the same n
(Briggs, Weinstein, Fenwick et al., Medical Decision Making 32, 2012). n is the *effective sample
size*: as much as n patients would tell. A reward weight is normal with standard deviation c |m|, or
gamma, which keeps the sign.

Every part draws from its own stream, which its name decides, so that adding one leaves the others'
draws as they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from zlib import crc32

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats

KINDS = ("beta", "dirichlet", "normal", "gamma")
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
                f"{what} {self.size!r}",
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
