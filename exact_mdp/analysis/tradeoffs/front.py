"""The exact Pareto front of two or three expected totals, with the rates of exchange along it.

The expected totals of all policies, mixed ones included, form a polytope. Its Pareto front has
finitely many vertices v, each the totals of a deterministic policy, and

    H(w) = max over policies of w · totals = max over vertices of w · v,   w ≥ 0, Σ w = 1.

The maximum h over the vertices known so far is a lower bound on H, linear on cells of weights. At
each corner of a cell the model is solved with these weights: either H = h there, which a dual
vector of values proves, or a new vertex is found. If H = h at all corners, then H = h everywhere,
as H is convex, and each corner between vertices is the normal of an edge or facet. With two totals
this is the dichotomic scheme of Aneja and Nair, Management Science 25, 1979; with three, the scheme
of Przybylski, Gandibleux and Ehrgott, INFORMS Journal on Computing 22, 2010.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations
from math import gcd
from operator import mul
from typing import Any, ClassVar

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options
from exact_mdp.mdp.graph import strong_components
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.choices import of_every_state
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Integers, to_common_denominator
from exact_mdp.solvers.arguments import is_average, mdp_of, require_average_applies
from exact_mdp.solvers.exact.duals import weigh_values
from exact_mdp.solvers.exact.levels import Level, combine_levels
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.averages import reduce_to_totals
from exact_mdp.solvers.objectives.simplex import list_unit_vectors
from exact_mdp.solvers.objectives.totals import (
    Attained,
    Point,
    TotalsProof,
    find_extreme_policy,
    flow_of,
    list_proof_fields,
)

Weights = tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class Edge:
    """Two neighbouring vertices, by number, and the rate of exchange between them.

    With two totals, `rate` is the loss in the second per unit gained in the first; with three, it
    is the change of all totals per unit gained in the first total that differs.
    """

    start: int
    end: int
    change: Point  # how the totals change from start to end
    rate: Fraction | Point


@dataclass(frozen=True, kw_only=True, eq=False)
class Corner:
    """Weights of the totals, values that no policy exceeds, and the optimal vertices, by number."""

    weights: Point
    dual: Level
    best: tuple[int, ...]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Front(TotalsProof, Pictured):
    """The exact Pareto front of expected totals from the start, and its proof."""

    attained: tuple[Attained, ...]  # a policy for each vertex, in ascending order of totals
    corners: tuple[Corner, ...]  # weights at which the optimal vertex changes

    kinds: ClassVar[tuple[str, ...]] = ("front",)

    def __repr__(self) -> str:
        size = len(self.attained)
        vertices = "one vertex" if size == 1 else f"{size} vertices"
        return f"Front({' and '.join(self.names)}: {vertices}, certified)"

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the totals."""
        return self.of.names

    @property
    def vertices(self) -> list[Point]:
        """The totals of each vertex, in the order of `names`."""
        sign = self.of.sign
        totals = []
        for a in self.attained:
            totals.append(tuple(sign * value for value in a.total))
        return totals

    def _list_policies(self) -> list[Integers]:
        return [each.pairs for each in self.attained]

    @property
    def policies(self) -> list[Integers]:
        """Action numbers (S,) of the policy of each vertex."""
        of = self.of
        return [of.given.pair_action[of.lift_pairs(a.pairs)] for a in self.attained]

    @property
    def edges(self) -> list[Edge]:
        """The edges between neighbouring vertices."""
        vertices, edges, two = self.vertices, list[Edge](), len(self.names) == 2
        # Two vertices are neighbours if they are optimal together at a corner; with three totals,
        # at two corners, the ends of a line of weights.
        shared = Counter[tuple[int, int]]()
        for corner in self.corners:
            shared.update(combinations(corner.best, 2))
        for (i, j), corners in sorted(shared.items()):
            if not two and corners == 1:
                continue
            change = tuple(b - a for a, b in zip(vertices[i], vertices[j], strict=True))
            first = next(abs(step) for step in change if step)
            rate: Fraction | Point = tuple(step / first for step in change)
            if two:
                rate = abs(change[1]) / first
            edges.append(Edge(start=i, end=j, change=change, rate=rate))
        return edges

    @property
    def facets(self) -> list[tuple[Point, tuple[int, ...]]]:
        """Positive weights at which as many vertices are optimal as there are totals, and these."""
        size = len(self.names)
        return [(c.weights, c.best) for c in self.corners if len(c.best) >= size and all(c.weights)]

    def totals(self, policy: PolicyLike) -> Point:
        """Return the exact totals of a policy from the start; it may be mixed."""
        totals = flow_of(self.of, policy).compute_totals(self.of)
        return tuple(self.of.sign * value for value in totals)

    def distance(self, policy: PolicyLike) -> Fraction:
        """Return how much better all totals of a policy could be at once; 0 on the front.

        It is the least H(w) - w · totals over the corners w, whose weights sum to 1.
        """
        of = self.of
        own = flow_of(of, policy).compute_totals(of)
        distances = []
        for c in self.corners:
            distances.append(c.dual.compute_mean(of.mdp.start) - weigh_values(c.weights, own))
        return min(distances)

    def report(self, policies: Mapping[str, PolicyLike] | None = None) -> Report:
        """Return vertices, edges and facets; `policies`, by name, are compared with the front."""

        def name_totals(values: Any) -> dict[str, Fraction]:
            return dict(zip(self.names, values, strict=True))

        mdp, two = self.of.given, len(self.names) == 2
        # Vertices with the actions of their policies, edges, facets, and the given policies.
        choices = []
        for policy in self.policies:
            choices.append([mdp.actions[action] for action in policy])
        each = {name: f"{name}:.10g" for name in self.names}
        note = "rate: how much {1} one point of {0} costs on the way from the row above"
        points = []
        for vertex, names in zip(self.vertices, choices, strict=True):
            points.append({"values": name_totals(vertex), "policy": of_every_state(mdp, names)})
        edges = []
        for e in self.edges:
            edges.append(
                {"from": e.start, "to": e.end, "rate": e.rate if two else name_totals(e.rate)}
            )
        compared = []
        for name, p in (policies or {}).items():
            compared.append(
                {
                    "policy": name,
                    "values": name_totals(self.totals(p)),
                    "distance": self.distance(p),
                }
            )
        facts: dict[str, Any] = {
            "names": list(self.names),
            "claim": self.claim,
            "vertices": points,
            "edges": Shown(edges),
            "facets": Shown(
                [{"weights": name_totals(w), "vertices": list(tight)} for w, tight in self.facets]
            ),
            "policies": compared,
        }
        # For people: the vertices in a row, with the rate between neighbours.
        vertices = Table(
            title="vertices of the front",
            rows=(rows := self.frame()),
            columns=each | {name: f"{name}:.6g" for name in rows.columns[len(each) :]},
            note=note.format(*self.names) if two else "",
        )
        beside = Table(
            title="policies beside the front",
            rows=[one | one["values"] for one in facts["policies"]],
            columns={"policy": "policy", **each, "distance": "distance:.6g"},
            note="distance: by how much every total could be better at once",
        )
        tables = {"vertices": vertices, "policies": beside}
        return Report(title="front", facts=facts, tables=tables)

    def frame(self) -> DataFrame:
        """Return one row for each vertex, with the rate of exchange from the vertex before."""
        frame = data_frame(self.vertices, columns=list(self.names))
        if len(self.names) == 2:
            name = "rate of exchange" if "rate" in self.names else "rate"
            frame[name] = [None, *(edge.rate for edge in self.edges)]
        return frame


@named_options
def tradeoff(model: MDP | Scenario, names: Sequence[str], *, criterion: str = "total") -> Front:
    """Return the exact Pareto front of two or three expected totals from the start.

    Every total is maximised; in a model of costs, minimised.

    Parameters
    ----------
    model : MDP or Scenario
        At discount 1, policies that never end, or miss a goal, are left out if they lose without
        limit in some total; a policy may stay where it earns nothing.
    names : sequence of str
        Two or three of: a component of the reward, `steps`, an event, the probability of a label
        that is never left, or a sum such as `name=2*a-b`.
    criterion : "total" or "average"
        "average" gives the front of averages per step, whatever the discount, if every policy
        visits one state again and again. Its proof is about totals of another model, `front.mdp`,
        which has one more state (`solvers.objectives.averages`).

    Returns
    -------
    Front

    Raises
    ------
    ModelError
        If a total may grow without limit, or no policy has finite totals; and if more than 200
        states form a cycle, as the fractions of a front are then very long.

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
    if isinstance(names, str) or not isinstance(names, Sequence) or len(names) not in (2, 3):
        many = len(names) if isinstance(names, Sequence) and not isinstance(names, str) else names
        raise ModelError(f"a front of {many!r} totals", where="tradeoff", fix="name two or three")
    # Refuse models whose fractions would be very long: large strongly connected components.
    mdp = mdp_of(model)
    if is_average(criterion):
        require_average_applies(mdp)
        mdp, names = reduce_to_totals(mdp, names)
    of = Objectives(mdp, names)
    own = of.rows.pair_state[of.rows.pair]
    moves = sp.csr_array((np.ones(len(own)), (own, of.rows.next)), (of.mdp.n_states,) * 2)
    longest = int(np.bincount(strong_components(moves)).max())
    # With 200 such states, a front of two totals takes a minute or two.
    if longest > 200:
        raise ModelError(
            f"{longest:,} states lead to each other, which makes the fractions of a front very "
            "long",
            where="tradeoff",
            fix="stop after N steps (horizon), or ask for one optimum under limits (subject_to)",
        )

    # Solve the model at every corner, which adds vertices and corners, until none is left.
    search = _FrontSearch(of)
    while missing := search.list_corners() - search.best.keys():
        search.explore_weights(min(missing))
    order = sorted(search.vertices, key=lambda a: tuple(of.sign * v for v in a.total))

    def make_corner(weights: Weights) -> Corner:
        best, shares = search.best[weights], tuple(Fraction(w, sum(weights)) for w in weights)
        lead = [weigh_values(shares, best.total) - weigh_values(shares, a.total) for a in order]
        tight = tuple(i for i, short in enumerate(lead) if not short)
        return Corner(weights=shares, dual=combine_levels(best.values, shares), best=tight)

    # At each corner the values of its optimal policy bound all policies: this is the proof.
    corners = sorted(map(make_corner, search.list_corners()), key=lambda corner: corner.weights)
    return Front(attained=tuple(order), corners=tuple(corners), **list_proof_fields(of, "front"))


class _FrontSearch:
    """The vertices found so far, each with the cell of weights for which it is optimal.

    Weights are whole numbers without a common divisor. `best` holds an optimal policy for all
    weights at which the model was solved.
    """

    def __init__(self, of: Objectives):
        size = len(of.names)
        self.of = of
        self.simplex = [*map(tuple, list_unit_vectors(size, 1))]
        self.vertices: list[Attained] = []
        self.cells: list[list[Weights]] = []
        self.best: dict[Weights, Attained] = {}

    def list_corners(self) -> set[Weights]:
        """Return the corners of all cells, or at the beginning of the simplex of weights."""
        corners = set[Weights]().union(*self.cells)
        return corners or set(self.simplex)

    def explore_weights(self, weights: Weights) -> None:
        """Find an optimal policy for some weights; if its totals are new, add them as a vertex."""
        known = max(self.vertices, key=lambda a: weigh_values(weights, a.total), default=None)
        if known is not None and known.is_optimal(self.of, weights):
            self.best[weights] = known
            return
        new = find_extreme_policy(self.of, weights, None if known is None else known.pairs)
        self.best[weights] = new
        if known is None or weigh_values(weights, new.total) > weigh_values(weights, known.total):
            self._add_vertex(new)

    def _add_vertex(self, new: Attained) -> None:
        """Add a vertex, and cut its cell out of the cells of the others."""
        cell = self.simplex
        for number, other in enumerate(self.vertices):
            ahead, _ = to_common_denominator(
                [a - b for a, b in zip(new.total, other.total, strict=True)]
            )
            left = _clip_polygon(self.cells[number], [-x for x in ahead])
            if left != self.cells[number]:
                self.cells[number], cell = left, _clip_polygon(cell, ahead)
        self.vertices.append(new)
        self.cells.append(cell)


def _clip_polygon(polygon: list[Weights], normal: Sequence[int]) -> list[Weights]:
    """Return the part of a convex polygon with normal · w ≥ 0 (Sutherland and Hodgman, 1974)."""
    side = [sum(map(mul, point, normal)) for point in polygon]
    if min(side, default=0) >= 0:
        return polygon
    inside: list[Weights] = []
    for i, (point, here) in enumerate(zip(polygon, side, strict=True)):
        before, there = polygon[i - 1], side[i - 1]
        # An edge that crosses the line is cut at the point that divides it by the two distances.
        if (here > 0) != (there > 0) and here and there:
            between = []
            for a, b in zip(before, point, strict=True):
                between.append(abs(here) * a + abs(there) * b)
            shared = gcd(*between)
            inside.append(tuple(w // shared for w in between))
        if here >= 0:
            inside.append(point)
    return list(dict.fromkeys(inside))
