"""Proofs of what is optimal: exact ones in rational arithmetic, and bounds in floats.

    certificate = certify(mdp)                  # V, all optimal actions and gaps as rationals
    certificate = certify(mdp, bounded=True)    # lower ≤ V^π ≤ V ≤ upper, for large models

A certificate claims; `violations` checks every claim against the model, in code that shares nothing
with the solvers (`solvers.proof.checker`). Rewards that are floats count as the dyadic rationals
that they are; `mdp.rows` says what rows of floats mean.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import inf, lcm
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats, Numbers, divide
from exact_mdp.solvers.proof.checker import (
    BoundedClaims,
    ExactClaims,
    bounded_violations,
    exact_violations,
)
from exact_mdp.solvers.proof.file import bounded_fields, exact_fields, model_of, save
from exact_mdp.solvers.proof.rationals import fractions, primes_of
from exact_mdp.solvers.solution import Certified, Claim, by_state, in_decimals, in_float

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Certificate(ExactClaims, Pictured):
    """Exact optimal values, all optimal actions, and what proves them.

    Numbers are kept as integers over a few shared denominators, because they may have thousands of
    digits; `value` and `gaps` make rationals of them.

    Attributes
    ----------
    model : str
        `mdp.exact` of the model.
    numerator : (S,) sequence of int
    group : (S,) int64
    denominator : sequence of int
        V(s) = numerator[s] / denominator[group[s]].
    policy : (S,) int64
        An optimal policy: the first optimal action number of each state.
    optimal_pairs : (L,) bool
        All pairs that attain the optimal value of their state.
    gap, gap_scale : (S,) sequence of int, or None in `gap` where all actions are optimal
        The best other action loses gap[s] / (gap_scale[s] · denominator[group[s]]).
    unique : bool
        Whether every state that optimal actions reach from the start has only one optimal action,
        terminal states aside, in which it does not matter what is done.
    start_value : Fraction, or an infinite float
        Optimal value of the start distribution.
    rank : (S,) int64, optional
        Proof that every policy ends, where the discount alone does not make values unique.
    endless : EndlessClaims, optional
        What proves the values, and tells the infinite ones, where some policy never ends.
    mdp : MDP, optional
        The model, unless the certificate was read from a file.

    Examples
    --------
    >>> from exact_mdp.solvers import certify
    >>> found = certify(MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]]))
    >>> found.frame().iloc[0].to_dict()
    {'state': 'state 0', 'value': 3.0, 'action': '1', 'gap': 2.0, 'exact': Fraction(3, 1)}
    """

    mdp: MDP | None = None

    claim: ClassVar[Claim] = Claim.CERTIFIED

    def __repr__(self) -> str:
        unique = "the only optimal policy" if self.unique else "not the only optimal policy"
        return (
            f"Certificate({len(self.numerator)} states, "
            f"start value ≈ {in_float(self.start_value):.12g}, {unique})"
        )

    @property
    def start(self) -> Certified:
        """The optimal value of the start distribution as a claim."""
        return Certified(value=self.start_value)

    @cached_property
    def value(self) -> Numbers:
        """(S,) the optimal values as Fractions; `math.inf` and `-math.inf` where infinite."""
        found = fractions(self.numerator, self._below, primes_of(self.denominator))
        return found if self.endless is None else self._infinite(found)

    def _infinite(self, values: Numbers) -> Numbers:
        """Return the values (S,) with infinities where the certificate claims these."""
        assert self.endless is not None
        found = values.copy()
        for sign in (1, -1):
            found[self.endless.sign == sign] = sign * inf
        found.setflags(write=False)
        return found

    @cached_property
    def gaps(self) -> Numbers:
        """(S,) what the best action that is not optimal loses, as Fractions; None without one."""
        below = [own * scale for own, scale in zip(self._below, self.gap_scale, strict=True)]
        primes = lcm(primes_of(self.denominator), *set(self.gap_scale))
        return fractions(self.gap, below, primes)

    @cached_property
    def value_float(self) -> Floats:
        """(S,) the optimal values as floats, each correctly rounded.

        Raises ModelError where one is beyond the floats.
        """
        top, bottom = np.array(self.numerator, object), np.array(self._below, object)
        found = divide(top, bottom)
        return found if self.endless is None else self._infinite(found)

    @property
    def optimal(self) -> NDArray[np.bool_]:
        """(S, A) whether an action is optimal; False where it is not offered.

        Raises ModelError where the certificate was read from a file: it lacks the model.
        """
        return np.asarray(model_of(None, self.mdp).by_action(self.optimal_pairs))

    def optimal_policy(self) -> Policy:
        """Return the policy that draws one of the optimal actions of each state, all alike.

        Raises ModelError where the certificate was read from a file, which lacks the model; and
        where some policy never ends and a state has several: each is right alone, and drawing among
        them may go round for ever.

        Examples
        --------
        >>> from exact_mdp.solvers import certify
        >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]]] * 3, [[3, 1, 3], [0, 0, 0]])
        >>> certify(mdp).optimal_policy().table[0].tolist()
        [0.5, 0.0, 0.5]
        """
        mdp, optimal = model_of(None, self.mdp), self.optimal
        several = (optimal.sum(axis=1) > 1) & ~mdp.terminal
        if self.endless is not None and several.any():
            raise ModelError(
                "several actions are optimal, and not every policy ends: drawn among, they may not "
                "be optimal together",
                where=f"state ({mdp.space.label(int(np.flatnonzero(several)[0]))})",
                fix="take certificate.policy, which is",
            )
        table = optimal / optimal.sum(axis=1, keepdims=True)
        return Policy(
            space=mdp.space, actions=mdp.actions, rule=table, shares=optimal.astype(np.int64)
        )

    @property
    def _below(self) -> list[int]:
        return [self.denominator[group] for group in self.group.tolist()]

    def frame(self) -> DataFrame:
        """Return the value of each state, its action, and what the next best action loses.

        In decimals, infinite beyond the range of floats; `exact` is the value as it is.
        """
        columns = {
            "value": in_decimals(self.value),
            "action": self.policy,
            "gap": in_decimals(self.gaps),
        }
        return by_state(self.mdp, columns | {"exact": self.value})

    def violations(self, model: MDP | None = None) -> list[str]:
        """Return what does not hold of this certificate, in words: nothing where it is sound.

        Parameters
        ----------
        model : MDP, optional
            Needed where the certificate was read from a file.
        """
        return exact_violations(self, model_of(model, self.mdp))

    def save(self, path: str | Path) -> None:
        """Write the certificate as JSON; see `solvers.proof.file` for the format."""
        save(self, path)

    @classmethod
    def load(cls, path: str | Path) -> Certificate:
        """Read a certificate from a file.

        Parameters
        ----------
        path : str or path

        Returns
        -------
        Certificate

        Raises
        ------
        ModelError
            Where the file is not an exact certificate.

        Examples
        --------
        >>> from tempfile import TemporaryDirectory
        >>> from exact_mdp.solvers import certify
        >>> with TemporaryDirectory() as folder:
        ...     certify(MDP.from_arrays([[[1]]], [1], "1/2")).save(f"{folder}/proof.json")
        ...     Certificate.load(f"{folder}/proof.json").value
        array([Fraction(2, 1)], dtype=object)
        """
        return cls(**exact_fields(path))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BoundedCertificate(BoundedClaims, Pictured):
    """Floats that the optimal values, and those of a policy, are proven to lie between.

    Attributes
    ----------
    model : str
        `mdp.exact` of the model.
    lower, upper : (S,)
        lower ≤ V^π ≤ V ≤ upper in every state, for the policy π given here.
    policy : (S,) int64
        Action numbers.
    weight : (S,)
        Proof that values are unique: w > γ P w for all pairs.
    mdp : MDP, optional
        The model, unless the certificate was read from a file.

    Examples
    --------
    >>> from exact_mdp.solvers import certify
    >>> certify(MDP.from_arrays([[[1]]], [1], "1/2"), bounded=True).frame().columns.tolist()
    ['state', 'value', 'lower', 'upper', 'action']
    """

    mdp: MDP | None = None

    claim: ClassVar[Claim] = Claim.BOUNDED

    def __repr__(self) -> str:
        return f"BoundedCertificate({len(self.lower)} states, error ≤ {self.error_bound:.2g})"

    @property
    def value(self) -> Floats:
        """(S,) the middle between the bounds."""
        return self.lower + (self.upper - self.lower) / 2

    @property
    def error_bound(self) -> float:
        """|value - V| and |value - V^π| are at most this in every state."""
        return float(self.error.max(initial=2.0**-51 * self._largest))

    @property
    def _largest(self) -> float:
        return float(max(np.abs(self.lower).max(), np.abs(self.upper).max()))

    @property
    def error(self) -> Floats:
        """(S,) |value - V| and |value - V^π| are at most this."""
        return (self.upper - self.lower) / 2 * (1 + 1e-12) + 2.0**-51 * self._largest

    def frame(self) -> DataFrame:
        """Return the value of each state, its bounds and its action."""
        columns = {"value": self.value, "lower": self.lower, "upper": self.upper}
        return by_state(self.mdp, columns | {"action": self.policy})

    def violations(self, model: MDP | None = None) -> list[str]:
        """Return what does not hold of this certificate, in words: nothing where it is sound."""
        return bounded_violations(self, model_of(model, self.mdp))

    def save(self, path: str | Path) -> None:
        """Write the certificate as JSON; see `solvers.proof.file` for the format."""
        save(self, path)

    @classmethod
    def load(cls, path: str | Path) -> BoundedCertificate:
        """Read a certificate from a file.

        Parameters
        ----------
        path : str or path

        Returns
        -------
        BoundedCertificate

        Raises
        ------
        ModelError
            Where the file is not a certificate of bounds.

        Examples
        --------
        >>> from tempfile import TemporaryDirectory
        >>> from exact_mdp.solvers import certify
        >>> mdp = MDP.from_arrays([[[1]]], [1], "1/2")
        >>> with TemporaryDirectory() as folder:
        ...     certify(mdp, bounded=True).save(f"{folder}/bounds.json")
        ...     BoundedCertificate.load(f"{folder}/bounds.json").violations(mdp)
        []
        """
        return cls(**bounded_fields(path))
