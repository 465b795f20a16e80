"""Proofs about totals that stand alone: fronts, optima under limits, and weights of a reward.

    front      an exact front of two or three totals: its vertices, and what bounds all policies
    limits     an optimum under limits, or that no policy keeps them
    weights    the least change of the weights of a reward that makes a policy optimal

Each has besides its own fields the model's hash, the objectives as `amounts` reads them, and the
rank that proves that every policy ends, at discount 1. `solvers.exact.codec` writes and reads them;
nothing here imports a solver.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.exact import codec
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.checker import (
    Attained,
    Cut,
    Interval,
    Limit,
    Point,
    Values,
    constrained_violations,
    front_violations,
    moved_by,
    rationalization_violations,
    totals_of,
)
from exact_mdp.solvers.solution import Claim


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectivesProof:
    """A proof about totals: `violations` needs only the model.

    Attributes
    ----------
    model : str
        `fingerprint(mdp)`, a hash of the model.
    objectives : tuple of str
    rank : (S,) int64, optional
    """

    model: str
    objectives: tuple[str, ...]
    rank: Integers | None

    kind: ClassVar[str]
    claim: ClassVar[Claim] = Claim.CERTIFIED

    @classmethod
    def about(cls, of: Objectives, **content: Any) -> Any:
        """Return a proof about objectives of a model."""
        return cls(model=fingerprint(of.mdp), objectives=of.texts, **content)

    def violations(self, mdp: MDP) -> list[str]:
        """Return what does not hold of the proof, in words: nothing where it is sound."""
        if self.model != fingerprint(mdp):
            return ["the certificate is of another model"]
        lengths = {len(vector) for vector in self._vectors()} - {mdp.n_states}
        if lengths:
            return [f"it has {lengths} states, the model {mdp.n_states}"]
        if any(not 0 <= pair < mdp.n_pairs for pair in self._pairs()):
            return ["a pair is none of the model"]
        return self._check(Objectives.of(mdp, self.objectives))

    def found(self, mdp: MDP) -> dict[str, Any]:
        """Return what a sound proof proves."""
        return self._proven(Objectives.of(mdp, self.objectives))

    def save(self, path: str | Path) -> None:
        """Write the proof as JSON."""
        codec.save(self.kind, self, path)

    @staticmethod
    def load(path: str | Path) -> ObjectivesProof:
        """Read a proof of any kind; raises ModelError where the file is none."""
        return codec.load(PROOFS, path)[1]

    def _vectors(self) -> Iterator[Any]:
        """Yield what has an entry for each state."""
        raise NotImplementedError

    def _pairs(self) -> Iterator[int]:
        """Yield the pairs that are looked up."""
        raise NotImplementedError

    def _check(self, of: Objectives) -> list[str]:
        raise NotImplementedError

    def _proven(self, of: Objectives) -> dict[str, Any]:
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True, eq=False)
class FrontProof(ObjectivesProof):
    """The vertices of a front, and for weights of the totals what no policy exceeds."""

    vertices: tuple[Attained, ...]
    duals: dict[Point, Values]

    kind: ClassVar[str] = "front"

    def _vectors(self) -> Iterator[Any]:
        for vertex in self.vertices:
            yield vertex.pairs
            yield from (values.top for values in vertex.values)
        yield from (values.top for values in self.duals.values())

    def _pairs(self) -> Iterator[int]:
        return (pair for vertex in self.vertices for pair in vertex.pairs.tolist())

    def _check(self, of: Objectives) -> list[str]:
        sizes = {len(weights) for weights in self.duals}
        sizes |= {len(part) for each in self.vertices for part in (each.values, each.total)}
        if sizes != {len(of.names)} or len(of.names) not in (2, 3):
            return ["its totals or weights are not one for each of two or three objectives"]
        return front_violations(of, self.rank, self.vertices, self.duals)

    def _proven(self, of: Objectives) -> dict[str, Any]:
        points = sorted(tuple(of.sign * t for t in vertex.total) for vertex in self.vertices)
        totals = [dict(zip(of.texts, point, strict=True)) for point in points]
        return {"names": of.texts, "vertices": len(totals), "totals": totals}


@dataclass(frozen=True, kw_only=True, eq=False)
class LimitsProof(ObjectivesProof):
    """Visits of an optimal policy, and prices; or a proof that no policy keeps the limits."""

    limits: tuple[Limit, ...]
    flow: Mapping[int, Fraction]
    price: tuple[Fraction, ...]
    dual: Values
    shift: Fraction

    kind: ClassVar[str] = "limits"

    def _vectors(self) -> Iterator[Any]:
        yield self.dual.top

    def _pairs(self) -> Iterator[int]:
        return iter(self.flow)

    def _check(self, of: Objectives) -> list[str]:
        if not {limit.name for limit in self.limits} <= {*of.names[1:]}:
            return ["what is limited is not counted"]
        if len(self.price) != 1 + len(self.limits) or {abs(l.sign) for l in self.limits} - {1}:
            return ["it has not one price for each limit"]
        return constrained_violations(
            of, self.rank, self.limits, self.flow, self.price, self.dual, self.shift
        )

    def _proven(self, of: Objectives) -> dict[str, Any]:
        named = dict(zip(of.names, of.texts, strict=True))  # a name may be given to any sum
        limits = [replace(limit, name=named[limit.name]) for limit in self.limits]
        feasible = self.price[0] == 1
        prices = dict.fromkeys(of.texts[1:], Fraction(0))
        for limit, price in zip(limits, self.price[1:], strict=True):
            prices[limit.name] += price
        point = totals_of(of, self.flow)
        total = dict(zip(of.texts, [of.sign * t for t in point], strict=True))
        return {
            "limits": limits,
            "feasible": feasible,
            "exact_start_value": total[of.texts[0]] if feasible else None,
            "totals": {limit.name: total[limit.name] for limit in limits},
            "prices": prices,
            "closest": [moved_by(self.shift, limit) for limit in limits],
        }


@dataclass(frozen=True, kw_only=True, eq=False)
class WeightsProof(ObjectivesProof):
    """The least change of weights, visits of the policy, and those that beat it for less."""

    weights: tuple[Fraction, ...]
    change: Fraction
    flow: Mapping[int, Fraction]
    dual: Values
    cuts: tuple[Cut, ...]
    intervals: tuple[Interval, ...]

    kind: ClassVar[str] = "weights"

    def _vectors(self) -> Iterator[Any]:
        yield self.dual.top
        for each in self.intervals:
            yield from (end.top for end in (each.at_low, each.at_high) if end is not None)

    def _pairs(self) -> Iterator[int]:
        flows = [self.flow, *(cut.flow for cut in self.cuts)]
        flows += [flow for each in self.intervals for flow in each.cuts]
        return (pair for flow in flows for pair in flow)

    def _check(self, of: Objectives) -> list[str]:
        if {len(self.weights), len(self.intervals)} != {len(of.names)}:
            return ["it has not one weight and one interval for each objective"]
        return rationalization_violations(
            of,
            self.rank,
            self.flow,
            self.weights,
            self.change,
            self.dual,
            self.cuts,
            self.intervals,
        )

    def _proven(self, of: Objectives) -> dict[str, Any]:
        return {
            "possible": self.change < 1,
            "change": self.change,
            "weights": dict(zip(of.texts, self.weights, strict=True)),
            "alone": {
                name: None if own.ends is None else list(own.ends)
                for name, own in zip(of.texts, self.intervals, strict=True)
            },
        }


PROOFS: dict[str, type[ObjectivesProof]] = {
    proof.kind: proof for proof in (FrontProof, LimitsProof, WeightsProof)
}
