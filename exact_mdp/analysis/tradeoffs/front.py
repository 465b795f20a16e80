"""The exact front of two or three expected totals: what policies attain, and at what exchange rate.

The totals that policies, mixed ones too, attain at the start are a polytope. Its Pareto front has
finitely many vertices v, each the totals of a deterministic policy, and

    H(w) = max over policies of w · totals = max over vertices of w · v,   w ≥ 0, Σ w = 1.

The vertices known so far give h ≤ H, linear on cells of weights. At each corner of a cell the model
is solved with these weights: either H = h there, which a dual vector of values proves, or a new
vertex is found. When H = h at all corners, H = h (H is convex), and each corner between vertices is
the normal of an edge or facet. With two totals this is the dichotomic scheme of Aneja and Nair,
Management Science 25, 1979; with three that of Przybylski, Gandibleux and Ehrgott, INFORMS Journal
on Computing 22, 2010.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import combinations
from math import gcd
from operator import mul
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from exact_mdp.analysis.gate.limits import totals_under
from exact_mdp.analysis.optimum import of_every_state
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Integers, common
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.checker import (
    Attained,
    Point,
    Rank,
    Values,
    best_for,
    front_violations,
)
from exact_mdp.solvers.objectives.file import FrontProof
from exact_mdp.solvers.objectives.optima import (
    Losses,
    attained,
    extreme,
    known_optimum,
    optimum,
    proposed,
    rank_of,
)
from exact_mdp.solvers.solution import Claim
from exact_mdp.solvers.solver import mdp_of
from exact_mdp.solvers.values.policy_chain import policy_of

if TYPE_CHECKING:
    from pandas import DataFrame

Weights = tuple[int, ...]
LONGEST = 200  # states that lead to each other: a front of two totals takes a minute or two


@dataclass(frozen=True, kw_only=True)
class Edge:
    """Two neighbouring vertices, by number, and what one total costs of another between them.

    Attributes
    ----------
    start, end : int
    change : tuple of Fraction
        Totals of the end less those of the start.
    rate : Fraction or tuple of Fraction
        With two totals, how much of the second one point of the first costs; with three, the
        change for each point by which the first that differs rises.
    weights : tuple of Fraction, optional
        With two totals, the weights for which both vertices, and all mixtures, are optimal.
    """

    start: int
    end: int
    change: Point
    rate: Fraction | Point
    weights: Point | None = None


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Front(Pictured):
    """The exact Pareto front of expected totals from the start, and its proof.

    Attributes
    ----------
    names : tuple of str
    attained : tuple of Attained
        A deterministic policy for each vertex, in rising order of the first total.
    duals : {weights: Values}
        For the corners of the weights, values of states that no policy exceeds.
    rank : (S,) int64, optional
        Proof that every policy ends, at discount 1.
    objectives : Objectives

    Examples
    --------
    >>> rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (0, 2, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    >>> parts = {"help": [0, 2, 3, 0], "calm": [5, 4, 0, 0]}
    >>> front = tradeoff(MDP.from_outcomes(rows, components=parts), ["help", "calm"])
    >>> [tuple(map(str, vertex)) for vertex in front.vertices]
    [('0', '5'), ('2', '4'), ('3', '0')]
    >>> [str(edge.rate) for edge in front.edges], front.violations()
    (['1/2', '4'], [])
    """

    names: tuple[str, ...]
    attained: tuple[Attained, ...]
    duals: Mapping[Point, Values]
    rank: Rank
    objectives: Objectives

    claim: ClassVar[Claim] = Claim.CERTIFIED

    def __repr__(self) -> str:
        return f"Front({' and '.join(self.names)}: {len(self.attained)} vertices, certified)"

    @property
    def vertices(self) -> list[Point]:
        """The totals of each vertex, by name in the order of `names`."""
        sign = self.objectives.sign
        return [tuple(sign * value for value in a.total) for a in self.attained]

    @property
    def policies(self) -> list[Integers]:
        """Action numbers (S,) of the policy of each vertex."""
        return [self.objectives.mdp.pair_action[a.pairs] for a in self.attained]

    @property
    def edges(self) -> list[Edge]:
        """The edges between neighbouring vertices."""
        vertices, found = self.vertices, []
        size = len(self.names)
        shared: dict[tuple[int, int], list[Point]] = {}
        for weights, tight in self._tight.items():
            for both in combinations(tight, 2):
                shared.setdefault(both, []).append(weights)
        for (i, j), corners in sorted(shared.items()):
            if len(corners) < size - 1:
                continue
            change = tuple(b - a for a, b in zip(vertices[i], vertices[j], strict=True))
            first = next(step for step in change if step)
            each = tuple(step / abs(first) for step in change)
            two = size == 2
            found.append(
                Edge(
                    start=i,
                    end=j,
                    change=change,
                    rate=abs(each[1]) if two else each,
                    weights=corners[0] if two else None,
                )
            )
        return found

    @property
    def facets(self) -> list[tuple[Point, tuple[int, ...]]]:
        """Weights, all positive, with the vertices that are optimal for them: one for each name."""
        size = len(self.names)
        return [(w, tight) for w, tight in self._tight.items() if len(tight) >= size and all(w)]

    @cached_property
    def _tight(self) -> dict[Point, tuple[int, ...]]:
        """Which vertices are optimal at each corner."""
        return best_for(self.duals, [a.total for a in self.attained])

    def totals(self, policy: PolicyLike) -> Point:
        """Return the exact totals of a policy, mixed ones too, from the start."""
        of = self.objectives
        return tuple(of.sign * value for value in totals_under(of, policy_of(of.mdp, policy)))

    def distance(self, policy: PolicyLike) -> Fraction:
        """Return by how much all totals of a policy could be better at once: 0 on the front.

        It is the least (H(w) - w · totals) over the corners w, whose weights sum to 1.
        """
        of = self.objectives
        own = totals_under(of, policy_of(of.mdp, policy))
        return min(of.at_start(*v) - _worth(w, own) for w, v in self.duals.items())

    def report(self, policies: Mapping[str, PolicyLike] | None = None) -> Report:
        """Return vertices, edges and facets; `policies` by name are placed beside the front."""

        def named(values: Any) -> dict[str, Fraction]:
            return dict(zip(self.names, values, strict=True))

        mdp = self.objectives.mdp
        vertices = [
            {
                "values": named(vertex),
                "policy": of_every_state(mdp, [mdp.actions[a] for a in policy]),
            }
            for vertex, policy in zip(self.vertices, self.policies, strict=True)
        ]
        edges = [
            {
                "from": edge.start,
                "to": edge.end,
                "rate": named(edge.rate) if isinstance(edge.rate, tuple) else edge.rate,
            }
            for edge in self.edges
        ]
        beside: list[dict[str, Any]] = [
            {
                "policy": name,
                "values": named(self.totals(policy)),
                "distance": self.distance(policy),
            }
            for name, policy in (policies or {}).items()
        ]
        two = len(self.names) == 2
        rates = [None, *(each["rate"] for each in edges)]
        each = {name: f"{name}:.10g" for name in self.names}
        return Report(
            title="front",
            facts={
                "names": list(self.names),
                "claim": self.claim,
                "vertices": vertices,
                "edges": Shown(edges),
                "facets": Shown(
                    [
                        {"weights": named(weights), "vertices": list(tight)}
                        for weights, tight in self.facets
                    ]
                ),
                "policies": beside,
            },
            tables={
                "vertices": Table(
                    title="vertices of the front",
                    rows=[
                        named(vertex) | ({"rate of exchange": rates[number]} if two else {})
                        for number, vertex in enumerate(self.vertices)
                    ],
                    columns={**each, "rate": "rate of exchange:.6g"} if two else each,
                    note=f"rate: how much {self.names[1]} one point of {self.names[0]} costs on "
                    "the way from the row above"
                    if two
                    else "",
                ),
                "policies": Table(
                    title="policies beside the front",
                    rows=[one | one["values"] for one in beside],
                    columns={"policy": "policy", **each, "distance": "distance:.6g"},
                    note="distance: by how much every total could be better at once",
                ),
            },
        )

    def frame(self) -> DataFrame:
        """Return the vertices, one in each row, and what the step from the one before costs."""
        import pandas

        frame = pandas.DataFrame(self.vertices, columns=list(self.names))
        if len(self.names) == 2:
            frame["rate"] = [None, *(edge.rate for edge in self.edges)]
        return frame

    def violations(self) -> list[str]:
        """Return what does not hold of the front, in words: nothing where it is sound."""
        of = Objectives.of(self.objectives.mdp, self.objectives.texts)
        return front_violations(of, self.rank, self.attained, self.duals)

    def save(self, path: str | Path) -> None:
        """Write the proof as JSON, for `exact-mdp verify`; see `solvers.objectives.file`."""
        parts = {"rank": self.rank, "vertices": self.attained, "duals": self.duals}
        FrontProof.about(self.objectives, **parts).save(path)


def tradeoff(model: MDP | Scenario, names: Sequence[str]) -> Front:
    """Return the exact Pareto front of two or three expected totals from the start.

    Every total is maximised; in a model of costs, minimised.

    Parameters
    ----------
    model : MDP or Scenario
        With a discount below 1, or at discount 1 where every policy ends.
    names : sequence of str
        Two or three of: a component of the reward, `steps`, an event, a label that is not left
        again (its probability), or a sum such as `name=2*a-b`.

    Returns
    -------
    Front

    Raises
    ------
    ModelError
        For an unknown name, or a total that is infinite under some policy; and where more than 200
        states lead to each other, as the fractions of a front are then very long.

    Examples
    --------
    >>> scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    >>> front = tradeoff(scenario, ["anger", "subtask-complete"])
    >>> len(front.vertices) == len(front.edges) + 1, front.violations()
    (True, [])
    """
    if isinstance(names, str) or not isinstance(names, Sequence) or len(names) not in (2, 3):
        many = len(names) if isinstance(names, Sequence) and not isinstance(names, str) else names
        raise ModelError(
            f"a front of {many!r} totals",
            where="tradeoff",
            fix="name two or three",
        )
    of = Objectives.of(mdp_of(model), names)
    if of.longest_cycle > LONGEST:
        raise ModelError(
            f"{of.longest_cycle:,} states lead to each other, and the fractions of a front are "
            "very long then",
            where="tradeoff",
            fix="stop after N steps (horizon), or ask for one optimum under limits (subject_to)",
        )
    vertices, duals = _chain(of) if len(names) == 2 else _cells(of)
    return Front(
        names=of.names,
        attained=tuple(sorted(vertices, key=lambda a: tuple(of.sign * v for v in a.total))),
        duals={
            tuple(Fraction(w, sum(corner)) for w in corner): Values(
                values.top, values.below * sum(corner)
            )
            for corner, values in sorted(duals.items())
        },
        rank=rank_of(of),
        objectives=of,
    )


def _chain(of: Objectives) -> tuple[list[Attained], dict[Weights, Values]]:
    """Return the vertices of two totals, and what bounds all policies for each edge's weights.

    Between two vertices that are known, the normal of their chord either finds one beyond, or
    proves the chord an edge (Aneja and Nair, 1979). Floats propose policies; what pairs lose
    against one, exactly, proves it optimal or not.
    """
    duals, ends = dict[Weights, Values](), list[Attained]()
    for alone in ((0, 1), (1, 0)):
        own = optimum(of, alone)
        duals[alone] = own.values
        ends.append(extreme(of, alone, own))
    first, last = (Losses(of, end) for end in ends)
    vertices, open_ = [ends[0]], [] if ends[0].total == ends[1].total else [(first, last)]
    while open_:
        left, right = open_.pop()
        a, b = left.policy.total, right.policy.total
        ahead, _ = common([a[1] - b[1], b[0] - a[0]])
        weights = tuple(number // gcd(*ahead) for number in ahead)
        best = left
        signs = left.signs(weights)
        if signs.min() < 0:
            shares = [Fraction(w, sum(weights)) for w in weights]
            best = Losses(of, attained(of, proposed(of, shares, left.policy.pairs)))
            signs = best.signs(weights)
        proven = signs.min() >= 0
        found = best.optimum(of, weights, signs) if proven else optimum(of, weights)
        if found.total > _worth(weights, a):
            unique = proven and len(found.optimal) == of.mdp.n_states
            new = best if unique else Losses(of, extreme(of, weights, found))
            open_ += [(new, right), (left, new)]
        else:
            duals[weights] = found.values
            vertices.append(right.policy)
    return vertices, duals


def _cells(of: Objectives) -> tuple[list[Attained], dict[Weights, Values]]:
    """Return the vertices of three totals, and what bounds all policies at each facet."""
    search = _Search(of)
    while missing := search.corners() - search.duals.keys():
        search.look(min(missing))
    return search.vertices, {corner: search.duals[corner] for corner in search.corners()}


class _Search:
    """The vertices found, and the cell of weights for which each is the best.

    Weights are whole numbers without a common divisor. `duals` has the values that bound the total
    of all policies, for each of the weights that were looked at.
    """

    def __init__(self, of: Objectives):
        size = len(of.names)
        self.of = of
        self.simplex = [tuple(int(i == k) for i in range(size)) for k in range(size)]
        self.vertices: list[Attained] = []
        self.cells: list[list[Weights]] = []
        self.duals: dict[Weights, Values] = {}

    def corners(self) -> set[Weights]:
        """Return the corners of all cells, to begin with those of all weights."""
        return {w for cell in self.cells for w in cell} or set(self.simplex)

    def look(self, weights: Weights) -> None:
        """Solve for weights: keep what bounds all policies, and a vertex where one is new."""
        if self.vertices:
            best = max(self.vertices, key=lambda a: _worth(weights, a.total))
            if known := known_optimum(self.of, weights, best):
                self.duals[weights] = known
                return
        found = optimum(self.of, weights)
        self.duals[weights] = found.values
        if all(_worth(weights, a.total) < found.total for a in self.vertices):
            self._add(extreme(self.of, weights, found))

    def _add(self, new: Attained) -> None:
        cell = self.simplex
        for number, other in enumerate(self.vertices):
            lead = [a - b for a, b in zip(new.total, other.total, strict=True)]
            ahead, _ = common(lead)
            left = _clipped(self.cells[number], [-x for x in ahead])
            if left != self.cells[number]:
                self.cells[number] = left
                cell = _clipped(cell, ahead)
        self.vertices.append(new)
        self.cells.append(cell)


def _clipped(polygon: list[Weights], normal: Sequence[int]) -> list[Weights]:
    """Return the part of a convex polygon where normal · w ≥ 0 (Sutherland and Hodgman, 1974)."""
    side = [sum(map(mul, point, normal)) for point in polygon]
    if min(side, default=0) >= 0:
        return polygon
    found: list[Weights] = []
    for i, (point, here) in enumerate(zip(polygon, side, strict=True)):
        before, there = polygon[i - 1], side[i - 1]
        if (here > 0) != (there > 0) and here and there:
            between = [abs(here) * a + abs(there) * b for a, b in zip(before, point, strict=True)]
            shared = gcd(*between)
            found.append(tuple(w // shared for w in between))
        if here >= 0:
            found.append(point)
    return list(dict.fromkeys(found))


def _worth(weights: Sequence[Any], values: Sequence[Fraction]) -> Fraction:
    return sum((w * v for w, v in zip(weights, values, strict=True)), Fraction(0))
