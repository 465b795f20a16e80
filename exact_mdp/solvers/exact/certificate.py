"""Certificates: proofs of exact optima, and of bounds in floats.

    certificate = certify(mdp)                          # V, all optimal actions and gaps
    certificate = certify(mdp, criterion="average")     # gain and bias
    certificate = certify(mdp, bounded=True)            # lower ≤ V^π ≤ V ≤ upper, floats

`violations` checks every claim of a certificate against the model, in code that is independent of
the solvers (`solvers.exact.checker`, which also defines the levels g, h and w).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from math import inf, ulp
from pathlib import Path
from typing import ClassVar, Self, TypeVar

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import BellmanRows, bellman_rows, fingerprint
from exact_mdp.mdp.graph import Mask, PairGraph
from exact_mdp.mdp.io import model_json
from exact_mdp.mdp.io.parts import write_object
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, build_uniform_policy
from exact_mdp.mdp.result import DataFrame, Pictured, Result
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.bounds.gains import UNIT
from exact_mdp.solvers.claims import Bounded, Certified, Claim, in_decimals, in_float
from exact_mdp.solvers.exact import checker, codec
from exact_mdp.solvers.exact.levels import Level, compute_surpluses, make_fraction
from exact_mdp.solvers.solution import tabulate_by_state


def require_model(given: MDP | None, own: MDP | None, where: str = "violations") -> MDP:
    """Return the given model, or else the certificate's own; raise ModelError without either."""
    mdp = given
    if given is None:
        mdp = own
    if mdp is None:
        raise ModelError(
            "a certificate read from a file does not contain the model",
            where=where,
            fix="give the model: certificate.violations(mdp)",
        )
    return mdp


def _freeze_column(numbers: Iterable[Fraction | None]) -> Numbers:
    column = np.array(list(numbers), dtype=object)
    column.setflags(write=False)
    return column


def exact_rows(mdp: MDP, *, average: bool = False) -> BellmanRows:
    """Return the exact equations of levels, for maximised rewards and rows that sum to 1."""
    if average:
        return bellman_rows(mdp.maximised.undiscounted)
    return bellman_rows(mdp.maximised)


class Contradiction(RuntimeError):
    """A solver and a proof contradict each other, or a proof does not hold."""


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Proof(Result):
    """A proof about a model that a checker can read: of an optimum, of bounds or of totals."""

    kind: str  # the kind of proof, by its name in files
    model: str  # the fingerprint of the model
    mdp: MDP | None = None  # None if the proof was read from a file

    claim: ClassVar[Claim] = Claim.CERTIFIED
    kinds: ClassVar[tuple[str, ...]]

    def violations(self, model: MDP | None = None) -> list[str]:
        """Return the violations in words: an empty list if the proof is sound.

        Parameters
        ----------
        model : MDP, optional
            Needed if the proof was read from a file.
        """
        try:
            return self._find_violations(require_model(model, self.mdp))
        except (checker.Unreadable, TypeError) as error:
            return [str(error)]

    def _find_violations(self, mdp: MDP) -> list[str]:
        problem = model_json.list_problem(mdp)
        return checker.violations(problem, codec.build_file_content(self, int))

    def save(self, path: str | Path) -> None:
        """Write the proof as JSON, for `exact-mdp verify`; docs/reference/certificates.md."""
        write_object(path, codec.build_file_content(self))

    @classmethod
    def load(cls, path: str | Path, model: MDP | None = None) -> Self:
        """Read a proof of this class from a file.

        Parameters
        ----------
        path : str or path
        model : MDP, optional
            The model of the proof, which is needed for optimal actions and gaps.

        Returns
        -------
        Proof

        Raises
        ------
        ModelError
            If the file is not a certificate, proves something else, or belongs to another model.

        Examples
        --------
        >>> from tempfile import TemporaryDirectory
        >>> from exact_mdp.solvers import certify
        >>> mdp = MDP.from_arrays([[[1]]], [1], "1/2")
        >>> with TemporaryDirectory() as folder:
        ...     certify(mdp).save(f"{folder}/proof.json")
        ...     Certificate.load(f"{folder}/proof.json").value
        array([Fraction(2, 1)], dtype=object)
        """
        proof = codec.load_proof(dict.fromkeys(cls.kinds, cls), path)
        if model is not None and proof.model != fingerprint(model):
            raise ModelError(
                "the certificate belongs to another model",
                where=str(path),
                fix="give the model that it belongs to",
            )
        return replace(proof, mdp=model)


AnyProof = TypeVar("AnyProof", bound=Proof)


def require_sound_proof(proof: AnyProof) -> AnyProof:
    """Return a proof if its checker accepts it; otherwise raise Contradiction."""
    faults = proof.violations()
    if faults:
        raise Contradiction(f"a proof does not hold: {faults[0]}")
    return proof


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Certificate(Proof, Pictured):
    """The exact optimum of a total or an average reward, with its proof.

    Attributes
    ----------
    kind : "total" or "average"
    sense : "max" or "min"
        Whether the numbers of the model are rewards or costs.
    policy : (S,) int64
        Action numbers of an optimal policy.
    g, h, w : Level
        The levels, for maximised rewards: costs count as negative rewards. Without g, the values
        are h; else h is the bias for the average reward g, and w proves this.
    rank : (S,) int64, optional
        Proof that every policy ends, or with a goal, that the goal is reached.
    infinite : (S,) int64, optional
        With a goal: 1 where the value is +∞, -1 where it is -∞, 0 elsewhere.
    order : (S,) int64, optional
        With a goal: proof of the infinite values.
    start_value : Fraction, or an infinite float
        Optimal value of the start distribution.
    unique : bool
        Whether every state that optimal actions reach from the start, except terminal ones, has
        only one optimal action.
    model, mdp
        See `Proof`.

    Examples
    --------
    >>> from exact_mdp.solvers import certify
    >>> proof = certify(MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]]))
    >>> proof.frame().iloc[0].to_dict()
    {'state': 'state 0', 'value': 3.0, 'action': '1', 'gap': 2.0, 'exact': Fraction(3, 1)}
    >>> mdp = MDP.from_arrays([[[0, 1], [1, 0]], [[1, 0], [0, 1]]], [[2, 0], [3, "1/2"]])
    >>> proof = certify(mdp, criterion="average")
    >>> proof.start_value, proof.bias.tolist(), proof.violations()
    (Fraction(5, 2), [Fraction(-1, 4), Fraction(1, 4)], [])
    """

    sense: Sense
    policy: Integers
    g: Level | None
    h: Level
    w: Level | None
    rank: Integers | None
    infinite: Integers | None
    order: Integers | None
    start_value: Fraction | float
    unique: bool
    known_optimal: Mask | None = None  # (L,) `optimal_pairs`, if the search found them

    kinds: ClassVar[tuple[str, ...]] = ("total", "average")

    def __repr__(self) -> str:
        best = ""
        if self.sense.costs:
            best = f"{self.sense.best} "
        if self.kind == "average":
            return f"Certificate({len(self.policy)} states, {best}gain at the start {self.start})"
        unique = "not the only optimal policy"
        if self.unique:
            unique = "the only optimal policy"
        return (
            f"Certificate({len(self.policy)} states, "
            f"{best}start value ≈ {in_float(self.start_value):.12g}, {unique})"
        )

    def negated(self, mdp: MDP) -> Self:
        """Return this certificate for `mdp`, the model with negated rewards."""
        return replace(
            self,
            mdp=mdp,
            model=fingerprint(mdp),
            sense=mdp.sense,
            start_value=-self.start_value,
        )

    @property
    def start(self) -> Certified:
        """The optimal value of the start distribution as a claim."""
        return Certified(value=self.start_value)

    @cached_property
    def infinite_sign(self) -> Integers:
        """(S,) 1 where the total of maximised rewards is +∞, -1 where it is -∞, else 0."""
        if self.infinite is not None:
            return self.infinite
        if self.g is None or self.kind == "average":
            return np.zeros(len(self.policy), dtype=np.int64)
        return np.array([(top > 0) - (top < 0) for top in self.g.top], dtype=np.int64)

    @cached_property
    def value(self) -> Numbers:
        """(S,) the optimal values as Fractions, `math.inf` or `-math.inf`; gains for averages."""
        return self._with_infinite(self._values.to_fractions(self.sense.sign))

    @cached_property
    def value_float(self) -> Floats:
        """(S,) the optimal values as floats, each correctly rounded.

        Raises ModelError if a finite value is beyond the range of floats.
        """
        return self._with_infinite(self._values.to_floats(self.sense.sign))

    @property
    def _values(self) -> Level:
        if self.kind == "average" and self.g is not None:
            return self.g
        return self.h

    def _with_infinite(self, values: Numbers) -> Numbers:
        extended, infinite = values.copy(), self.infinite_sign != 0
        extended[infinite] = self.infinite_sign[infinite] * (self.sense.sign * inf)
        extended.setflags(write=False)
        return extended

    @cached_property
    def bias(self) -> Numbers:
        """(S,) the greatest bias of all policies with this gain, as Fractions."""
        if self.kind != "average":
            raise ModelError(
                "a total reward has neither gain nor bias",
                where="certificate",
                fix='ask for certify(mdp, criterion="average")',
            )
        return self.h.to_fractions(self.sense.sign)

    @property
    def pairs(self) -> Integers:
        """(S,) the policy's pairs."""
        mdp = require_model(None, self.mdp, "pairs")
        wanted = np.arange(mdp.n_states) * mdp.n_actions + self.policy
        offered = mdp.pair_state * mdp.n_actions + mdp.pair_action
        return np.asarray(np.searchsorted(offered, wanted))

    @cached_property
    def _gains(self) -> list[list[tuple[int, int]]]:
        """The advantages of all pairs, level by level, without w."""
        mdp = require_model(None, self.mdp, "optimal_pairs")
        rows = exact_rows(mdp, average=self.kind == "average")
        if self.g is None:
            return compute_surpluses(rows, self.h)
        assert self.w is not None
        return compute_surpluses(rows, self.g, self.h, self.w)[:2]

    @cached_property
    def losses(self) -> list[Numbers]:
        """(L,) for each level: a pair's loss of gain and, if that is 0, its loss of h."""
        each = []
        for gain in self._gains:
            each.append(_freeze_column(make_fraction(-top, below) for top, below in gain))
        return [each[0], *(np.asarray(short * (each[0] == 0)) for short in each[1:])]

    @cached_property
    def optimal_pairs(self) -> Mask:
        """(L,) the pairs after which the optimum of their state can still be attained.

        At discount 1 some may have to be left later: waiting in a state of +∞ keeps its value.
        """
        if self.known_optimal is not None:
            return self.known_optimal
        mdp = require_model(None, self.mdp, "optimal_pairs")
        # A pair is optimal for finite values if its advantages are 0 at all levels.
        best = np.ones(mdp.n_pairs, dtype=bool)
        for gain in self._gains:
            best &= np.array([not top for top, _ in gain])
        infinite = self.infinite_sign
        if not infinite.any():
            return np.asarray(best)
        own, after, first = infinite[mdp.pair_state], infinite[mdp.table.next], mdp.table.offsets
        if self.g is None:
            least, most = (f.reduceat(after, first[:-1]) for f in (np.minimum, np.maximum))
            # A pair that leads to +∞ but not to -∞ would make its state infinite: in a finite
            # state, 0 as the least sign means that the pair leads to finite states only.
            best &= least == 0
            above = (least >= 0) & (most > 0)
        else:
            # For a value of +∞, the pairs after which the mean reward is still positive.
            each = zip(self.g.to_fractions()[mdp.pair_state], self._gains[0], strict=True)
            above = np.array([g * below + top > 0 for g, (top, below) in each])
        return np.asarray(np.where(own == 0, best, (own < 0) | above), dtype=bool)

    @cached_property
    def gaps(self) -> Numbers:
        """(S,) the loss of the best action that is not optimal, as Fractions; None without one."""
        mdp = require_model(None, self.mdp, "gaps")
        # Only pairs whose loss is finite count: from finite states, to finite states.
        infinite, counts = self.infinite_sign, ~self.optimal_pairs
        counts &= (infinite == 0)[mdp.pair_state] & ~mdp.terminal[mdp.pair_state]
        if self.g is None:
            counts &= PairGraph.of(mdp).find_pairs_within(infinite == 0)
        else:
            counts &= np.array([not top for top, _ in self._gains[0]])
        # The least loss of each state; fractions are compared by cross multiplication.
        least: list[tuple[int, int] | None] = [None] * mdp.n_states
        for pair in np.flatnonzero(counts).tolist():
            state = int(mdp.pair_state[pair])
            best, (top, below) = least[state], self._gains[-1][pair]
            if best is None or -top * best[1] < best[0] * below:
                least[state] = -top, below
        return _freeze_column(None if best is None else make_fraction(*best) for best in least)

    @property
    def optimal(self) -> Mask:
        """(S, A) whether an action is optimal; False where it is not available."""
        return np.asarray(require_model(None, self.mdp).by_action(self.optimal_pairs))

    def optimal_policy(self) -> Policy:
        """Return the policy that draws each optimal action of a state with equal probability.

        Raises
        ------
        ModelError
            If some policy never ends and a state has several optimal actions: each is optimal, but
            a policy that draws among them may stay in a cycle forever.

        Examples
        --------
        >>> from exact_mdp.solvers import certify
        >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]]] * 3, [[3, 1, 3], [0, 0, 0]])
        >>> certify(mdp).optimal_policy().table[0].tolist()
        [0.5, 0.0, 0.5]
        """
        mdp, optimal = require_model(None, self.mdp), self.optimal
        several = (optimal.sum(axis=1) > 1) & ~mdp.terminal
        endless = self.g is not None or self.infinite is not None
        if endless and several.any():
            raise ModelError(
                "several actions are optimal, but a policy that draws one of them at each step "
                "may never end, and is then not optimal",
                where=mdp.space.place(int(np.flatnonzero(several)[0])),
                fix="take certificate.policy, which is optimal",
            )
        return build_uniform_policy(mdp, optimal)

    def frame(self) -> DataFrame:
        """Return the value of each state, its action, and the loss of the next best action.

        Numbers are decimals, infinite beyond the range of floats; `exact` is the exact value. For
        an average reward the columns are gain and bias.
        """
        value, action = in_decimals(self.value), {"action": self.policy}
        if self.kind == "average":
            columns = {"gain": value, "bias": in_decimals(self.bias)} | action
            return tabulate_by_state(
                self.mdp, columns | {"exact gain": self.value, "exact bias": self.bias}
            )
        columns = {"value": value} | action | {"gap": in_decimals(self.gaps)}
        return tabulate_by_state(self.mdp, columns | {"exact": self.value})


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BoundedCertificate(Proof, Pictured):
    """Proven bounds, in floats, on the optimal values and on the values of a policy.

    Attributes
    ----------
    kind, model, mdp
        See `Proof`.
    sense : "max" or "min"
        Whether the numbers of the model are rewards or costs.
    policy : (S,) int64
        Action numbers.
    low, high : Level
        low ≤ V^π ≤ V ≤ high in every state, for the policy π of this certificate and maximised
        rewards; for costs, these are -upper and -lower.
    rank : (S,) int64, optional
        Proof that every policy ends, at discount 1.

    Examples
    --------
    >>> from exact_mdp.solvers import certify
    >>> certify(MDP.from_arrays([[[1]]], [1], "1/2"), bounded=True).frame().columns.tolist()
    ['state', 'value', 'lower', 'upper', 'action']
    """

    sense: Sense
    policy: Integers
    low: Level
    high: Level
    rank: Integers | None

    claim: ClassVar[Claim] = Claim.BOUNDED
    kinds: ClassVar[tuple[str, ...]] = ("bounds",)

    def __repr__(self) -> str:
        return f"BoundedCertificate({len(self.policy)} states, error ≤ {self.error_bound:.2g})"

    def negated(self, mdp: MDP) -> Self:
        """Return these bounds for `mdp`, the model with negated rewards."""
        return replace(self, mdp=mdp, model=fingerprint(mdp), sense=mdp.sense)

    @cached_property
    def lower(self) -> Floats:
        """(S,) a lower bound on the values."""
        if self.sense.costs:
            return self.high.to_floats(-1)
        return self.low.to_floats()

    @cached_property
    def upper(self) -> Floats:
        """(S,) an upper bound on the values."""
        if self.sense.costs:
            return self.low.to_floats(-1)
        return self.high.to_floats()

    @property
    def value(self) -> Floats:
        """(S,) the middle between the bounds."""
        return self.lower + (self.upper - self.lower) / 2

    @property
    def error_bound(self) -> float:
        """The greatest `error` of a state."""
        return float(self.error.max())

    @property
    def error(self) -> Floats:
        """(S,) upper bounds on |value - V| and |value - V^π|."""
        rounding = 4 * UNIT * float(np.abs([self.lower, self.upper]).max())
        return (self.upper - self.lower) / 2 + rounding

    @property
    def start(self) -> Bounded:
        """The value of the start distribution, with its error bound."""
        mdp = require_model(None, self.mdp, "start")
        middle = float(sum(weight * Fraction(float(self.value[s])) for s, weight in mdp.start))
        return Bounded(value=middle, error=self.error_bound + ulp(middle))

    def frame(self) -> DataFrame:
        """Return the value of each state, its bounds and its action."""
        columns = {"value": self.value, "lower": self.lower, "upper": self.upper}
        return tabulate_by_state(self.mdp, columns | {"action": self.policy})
