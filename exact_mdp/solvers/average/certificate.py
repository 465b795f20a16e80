"""A proof of the best average reward per step: gain and bias as rationals, and what proves them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.average.checker import AverageClaims, Rationals, average_violations, surplus
from exact_mdp.solvers.proof.file import average_fields, model_of, save
from exact_mdp.solvers.proof.rationals import fractions
from exact_mdp.solvers.solution import Certified, Claim, by_state, in_decimals

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AverageCertificate(AverageClaims, Pictured):
    """The greatest average reward per step, exactly, and a policy that earns it.

    Attributes
    ----------
    model : str
        `mdp.exact` of the model.
    policy : (S,) int64
        Action numbers of a policy with this gain and this bias.
    g, h, w : integers over one denominator each
        Gain, bias, and the vector that proves the bias; `value` and `bias` are Fractions.
    start_value : Fraction
        Gain of the start distribution.
    mdp : MDP, optional
        The model, unless the certificate was read from a file.

    Examples
    --------
    >>> from exact_mdp.solvers import certify
    >>> mdp = MDP.from_arrays([[[0, 1], [1, 0]], [[1, 0], [0, 1]]], [[2, 0], [3, "1/2"]])
    >>> found = certify(mdp, criterion="average")
    >>> found.start_value, found.bias.tolist(), found.violations()
    (Fraction(5, 2), [Fraction(-1, 4), Fraction(1, 4)], [])
    """

    mdp: MDP | None = None

    claim: ClassVar[Claim] = Claim.CERTIFIED

    def __repr__(self) -> str:
        return f"AverageCertificate({len(self.policy)} states, gain at the start {self.start})"

    @property
    def start(self) -> Certified:
        """The greatest gain from the start distribution, as a claim."""
        return Certified(value=self.start_value)

    @cached_property
    def value(self) -> Numbers:
        """(S,) the greatest average reward per step from each state, as Fractions."""
        return _fractions(self.g)

    @cached_property
    def bias(self) -> Numbers:
        """(S,) the greatest bias of the policies with this gain, as Fractions."""
        return _fractions(self.h)

    @cached_property
    def losses(self) -> tuple[Numbers, Numbers]:
        """(L,) what each pair loses of the gain, and, where that is nothing, of the bias.

        Raises ModelError where the certificate was read from a file.
        """
        mdp = model_of(None, self.mdp, "losses")
        rows, claimed = bellman_rows(mdp.maximised.undiscounted), (self.g, self.h, self.w)
        if mdp.sense == "min":
            claimed = (self.g.negated(), self.h.negated(), self.w.negated())
        gain, bias, _ = surplus(rows, *claimed)
        own = rows.scale[rows.pair_state].astype(object)
        primes = self.g.below * self.h.below
        lost = fractions((-gain).tolist(), (own * self.g.below).tolist(), primes)
        short = fractions((-bias).tolist(), (own * primes).tolist(), primes)
        return lost, np.asarray(short * (lost == 0))

    @cached_property
    def optimal_pairs(self) -> NDArray[np.bool_]:
        """(L,) the pairs that lose nothing: whoever takes no others earns this gain."""
        lost, short = self.losses
        return np.asarray((lost == 0) & (short == 0), dtype=bool)

    @property
    def value_float(self) -> Floats:
        """(S,) the gain as floats, each correctly rounded."""
        return self.value.astype(np.float64)

    def frame(self) -> DataFrame:
        """Return gain, bias and action of each state, in decimals and as they are."""
        decimals = {"gain": in_decimals(self.value), "bias": in_decimals(self.bias)}
        columns = decimals | {"action": self.policy}
        return by_state(self.mdp, columns | {"exact gain": self.value, "exact bias": self.bias})

    def violations(self, model: MDP | None = None) -> list[str]:
        """Return what does not hold of this certificate, in words: nothing where it is sound.

        Parameters
        ----------
        model : MDP, optional
            Needed where the certificate was read from a file.
        """
        return average_violations(self, model_of(model, self.mdp))

    def save(self, path: str | Path) -> None:
        """Write the certificate as JSON; see `solvers.proof.file` for the format."""
        save(self, path)

    @classmethod
    def load(cls, path: str | Path) -> AverageCertificate:
        """Read a certificate from a file.

        Parameters
        ----------
        path : str or path

        Returns
        -------
        AverageCertificate

        Raises
        ------
        ModelError
            Where the file is not a certificate of average optimality.

        Examples
        --------
        >>> from tempfile import TemporaryDirectory
        >>> from exact_mdp.solvers import certify
        >>> mdp = MDP.from_arrays([[[1]]], [1])
        >>> with TemporaryDirectory() as folder:
        ...     certify(mdp, criterion="average").save(f"{folder}/proof.json")
        ...     AverageCertificate.load(f"{folder}/proof.json").violations(mdp)
        []
        """
        return cls(**average_fields(path))


def _fractions(found: Rationals) -> Numbers:
    return fractions(found.top, [found.below] * len(found.top), found.below)
