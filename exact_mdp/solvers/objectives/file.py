"""Proofs of fronts and of optima under limits as files, in the form of `solvers.proof.file`.

All have the keys format, version, kind, model, and

    objectives    [texts], as `amounts` reads them
    states        S

An exact front, of kind "front", has besides them

    rank          [S integers], or null: why equations have one solution
    vertices      [{"pairs": [S pairs], "values": [vector, …], "totals": [rational, …]}]: of each
                  policy, by objective
    bounds        [{"weights": [rational, …], "values": vector}]

where a rational is [numerator, denominator], and a vector {"top": [S integers], "below": integer}.
An optimum under limits, of kind "limits" (`.constrained`), has

    rank          as above
    limits        [{"name": text, "sign": 1 or -1, "bound": rational}]
    shift, price  rational, [rational, …]
    pairs, flow   [pairs visited], [rational, …]: their expected visits
    dual          vector

What is read is checked for its form; whether its claims hold is for `violations` to say. Nothing
here imports a solver.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.checker import (
    Attained,
    Limit,
    Point,
    Proof,
    Values,
    constrained_violations,
    front_violations,
    moved_by,
    totals_of,
)
from exact_mdp.solvers.proof.checker import not_of
from exact_mdp.solvers.proof.file import (
    ProofFile,
    array_of,
    count,
    digest,
    hexed,
    hexed_ratio,
    list_of,
    or_none,
    over_one,
    ratio,
    typed,
    wanted,
    write,
)
from exact_mdp.solvers.solution import Claim

FRONT, LIMITS = "front", "limits"


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectivesProof:
    """A proof about totals that stands on its own: `violations` needs only the model.

    Attributes
    ----------
    kind : str
    model : str
        `mdp.exact` of the model.
    objectives : tuple of str
    states : int
    content : dict
        What the checker of this kind takes.
    """

    kind: str
    model: str
    objectives: tuple[str, ...]
    states: int
    content: Mapping[str, Any]

    claim: ClassVar[Claim] = Claim.CERTIFIED

    @classmethod
    def of(cls, kind: str, of: Objectives, **content: Any) -> ObjectivesProof:
        """Return a proof about objectives of a model."""
        model, states = fingerprint(of.mdp), of.mdp.n_states
        return cls(kind=kind, model=model, objectives=of.texts, states=states, content=content)

    def violations(self, mdp: MDP) -> list[str]:
        """Return what does not hold of the proof, in words: nothing where it is sound."""
        if wrong := not_of(mdp, self.model, range(self.states)):
            return wrong
        if any(not 0 <= pair < mdp.n_pairs for pair in _pairs(self.kind, self.content)):
            return ["a pair is none of the model"]
        of = Objectives.of(mdp, self.objectives)
        if not {limit.name for limit in self.content.get("limits", ())} <= {*of.names[1:]}:
            return ["what is limited is not counted"]
        return CHECKS[self.kind](of, **self.content)

    def found(self, mdp: MDP) -> dict[str, Any]:
        """Return what a sound proof proves: totals of vertices, or those under limits.

        Those of limits that nobody keeps are missing.
        """
        of, own = Objectives.of(mdp, self.objectives), self.content
        if self.kind == LIMITS:
            return self._under_limits(of)
        points = sorted(tuple(of.sign * t for t in v.total) for v in own["vertices"])
        totals = [dict(zip(of.texts, point, strict=True)) for point in points]
        return {"names": of.texts, "vertices": len(totals), "totals": totals}

    def _under_limits(self, of: Objectives) -> dict[str, Any]:
        own = self.content
        named = dict(zip(of.names, of.texts, strict=True))  # a name may be given to any sum
        limits = [replace(limit, name=named[limit.name]) for limit in own["limits"]]
        feasible = own["price"][0] == 1
        prices = dict.fromkeys(of.texts[1:], Fraction(0))
        for limit, price in zip(limits, own["price"][1:], strict=True):
            prices[limit.name] += price
        point = totals_of(of, own["flow"])
        total = dict(zip(of.texts, [of.sign * t for t in point], strict=True))
        return {
            "limits": limits,
            "feasible": feasible,
            "exact_start_value": total[of.texts[0]] if feasible else None,
            "totals": {limit.name: total[limit.name] for limit in limits},
            "prices": prices,
            "closest": [moved_by(own["shift"], limit) for limit in limits],
        }

    def save(self, path: str | Path) -> None:
        """Write the proof as JSON."""
        head = {"objectives": list(self.objectives), "states": self.states}
        write(path, self.kind, self.model, head | WRITTEN[self.kind](**self.content))

    @classmethod
    def load(cls, path: str | Path, kind: str) -> ObjectivesProof:
        """Read a proof; raises ModelError where the file is none of this kind."""
        file = ProofFile(path, kind)
        states = file.get("states", count)
        return cls(
            kind=kind,
            model=file.get("model", digest),
            objectives=tuple(file.get("objectives", list_of(typed(str)))),
            states=states,
            content=READ[kind](file, states),
        )


def _pairs(kind: str, content: Mapping[str, Any]) -> list[int]:
    """Return the pairs that are looked up."""
    if kind == FRONT:
        return [pair for vertex in content["vertices"] for pair in vertex.pairs.tolist()]
    return list(content["flow"])


# ---- a kind each: what is written, and what is read ----------------------------------------------

Written = dict[str, object]


def _vector(values: Values) -> Written:
    return {"top": hexed(values.top), "below": f"{values.below:x}"}


def _ratios(numbers: Sequence[Fraction]) -> list[object]:
    return [hexed_ratio(number) for number in numbers]


def _proof(proof: Proof) -> Written:
    return {"rank": None if proof.rank is None else proof.rank.tolist()}


def _vertices(vertices: Sequence[Attained]) -> list[Written]:
    return [
        {
            "pairs": vertex.pairs.tolist(),
            "values": [_vector(v) for v in vertex.values],
            "totals": _ratios(vertex.total),
        }
        for vertex in vertices
    ]


def _front(proof: Proof, vertices: Sequence[Attained], duals: Mapping[Point, Values]) -> Written:
    return _proof(proof) | {
        "vertices": _vertices(vertices),
        "bounds": [{"weights": _ratios(w), "values": _vector(v)} for w, v in duals.items()],
    }


def _limits(
    proof: Proof,
    limits: Sequence[Limit],
    flow: Mapping[int, Fraction],
    price: Sequence[Fraction],
    dual: Values,
    shift: Fraction,
) -> Written:
    return _proof(proof) | {
        "limits": _bounds(limits),
        "shift": hexed_ratio(shift),
        "price": _ratios(price),
        "pairs": list(flow),
        "flow": _ratios(list(flow.values())),
        "dual": _vector(dual),
    }


def _bounds(limits: Sequence[Limit]) -> list[Written]:
    return [
        {"name": each.name, "sign": each.sign, "bound": hexed_ratio(each.bound)} for each in limits
    ]


def _read_proof(file: ProofFile, states: int) -> Proof:
    return Proof(file.get("rank", or_none(array_of(states))))


def _values(states: int) -> Callable[[Any], Values]:
    read = over_one(states)

    def values(parts: Any) -> Values:
        found = read(parts)
        return Values(found.top, found.below)

    return values


def _vertex(file: ProofFile, states: int) -> Callable[[Any], Attained]:
    of = len(file.get("objectives", list_of(typed(str))))

    def vertex(parts: dict[str, Any]) -> Attained:
        return Attained(
            pairs=array_of(states)(parts["pairs"]),
            values=tuple(list_of(_values(states), of)(parts["values"])),
            total=tuple(list_of(ratio, of)(parts["totals"])),
        )

    return vertex


def _empty_or(read: Callable[[Any], Any]) -> Callable[[Any], Any]:
    return lambda value: [] if value == [] else list_of(read)(value)


def _read_front(file: ProofFile, states: int) -> dict[str, Any]:
    of = len(file.get("objectives", list_of(typed(str))))

    def bound(parts: dict[str, Any]) -> tuple[Point, Values]:
        return tuple(list_of(ratio, of)(parts["weights"])), _values(states)(parts["values"])

    return {
        "proof": _read_proof(file, states),
        "vertices": file.get("vertices", list_of(_vertex(file, states))),
        "duals": dict(file.get("bounds", list_of(bound))),
    }


def _limit_list(file: ProofFile) -> list[Limit]:
    def limit(parts: dict[str, Any]) -> Limit:
        sign = typed(int)(parts["sign"])
        return Limit(
            name=typed(str)(parts["name"]),
            sign=wanted(sign, sign in (1, -1)),
            bound=ratio(parts["bound"]),
        )

    return list(file.get("limits", list_of(limit)))


def _read_limits(file: ProofFile, states: int) -> dict[str, Any]:
    limits = _limit_list(file)
    pairs = file.get("pairs", _empty_or(typed(int)))  # none where all has ended at the start
    return {
        "proof": _read_proof(file, states),
        "limits": limits,
        "flow": dict(zip(pairs, file.get("flow", list_of(ratio, len(pairs))), strict=True)),
        "price": file.get("price", list_of(ratio, 1 + len(limits))),
        "dual": file.get("dual", _values(states)),
        "shift": file.get("shift", ratio),
    }


WRITTEN: dict[str, Callable[..., Written]] = {
    FRONT: _front, LIMITS: _limits,
}  # fmt: skip
READ: dict[str, Callable[[ProofFile, int], dict[str, Any]]] = {
    FRONT: _read_front, LIMITS: _read_limits,
}  # fmt: skip
CHECKS: dict[str, Callable[..., list[str]]] = {
    FRONT: front_violations, LIMITS: constrained_violations,
}  # fmt: skip
