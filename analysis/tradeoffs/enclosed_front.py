"""A front whose fractions are too long to write out: its policies proven, its numbers enclosed.

Which policies are the vertices, which are neighbours, and which pairs tie on each edge is proven by
signs (`solvers.objectives.switches`), as surely as by fractions. Totals, rates and weights are
rationals of, say, 100,000 bits; two short fractions with the number between them stand for each.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from exact_mdp.analysis.gate.limits import totals_under
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Integers, shown
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.checker import Point
from exact_mdp.solvers.objectives.file import CHAIN, ObjectivesProof
from exact_mdp.solvers.objectives.switches import Bracket, Chain, Corner, chain_violations, corners
from exact_mdp.solvers.solution import Claim
from exact_mdp.solvers.values.policy_chain import policy_of

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")


@dataclass(frozen=True, kw_only=True, repr=False)
class Enclosed:
    """A number that is proven to lie between two fractions; they are equal where it is known.

    Examples
    --------
    >>> number = Enclosed(low=Fraction(1, 3), high=Fraction(5, 14))
    >>> number, -number, float(number)
    (0.345238 ± 0.012, -0.345238 ± 0.012, 0.34523809523809523)
    """

    low: Fraction
    high: Fraction

    def __float__(self) -> float:
        return float((self.low + self.high) / 2)

    def __neg__(self) -> Enclosed:
        return Enclosed(low=-self.high, high=-self.low)

    def __sub__(self, other: Enclosed) -> Enclosed:
        return Enclosed(low=self.low - other.high, high=self.high - other.low)

    def __repr__(self) -> str:
        if self.low == self.high:
            return str(self.low)
        return f"{shown((self.low + self.high) / 2)} ± {float(self.high - self.low) / 2:.2g}"


@dataclass(frozen=True, kw_only=True)
class EnclosedEdge:
    """Two neighbouring vertices, by number, and what one total costs of the other between them.

    Attributes
    ----------
    start, end : int
    change : (Enclosed, Enclosed)
        Totals of the end less those of the start.
    rate : Enclosed
        How much of the second total one point of the first costs.
    weights : (Enclosed, Enclosed)
        For which both vertices, and all mixtures, are optimal.
    switches : tuple of (int, str, str)
        The states in which their policies differ, and the actions of both: what the first loses
        against the second with these weights is exactly 0, which defines them.
    """

    start: int
    end: int
    change: tuple[Enclosed, ...]
    rate: Enclosed
    weights: tuple[Enclosed, Enclosed]
    switches: tuple[tuple[int, str, str], ...]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class EnclosedFront(Pictured):
    """The Pareto front of two expected totals from the start, with its numbers enclosed.

    Attributes
    ----------
    names : tuple of str
    chain : Chain
        The proof.
    objectives : Objectives

    Examples
    --------
    >>> from exact_mdp import MDP, tradeoff
    >>> rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (0, 2, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    >>> parts = {"help": [0, 2, 3, 0], "calm": [5, 4, 0, 0]}
    >>> front = tradeoff(MDP.from_outcomes(rows, "1/2", components=parts), list(parts), exact=False)
    >>> [[round(float(total), 9) for total in vertex] for vertex in front.vertices]
    [[0.0, 5.0], [2.0, 4.0], [3.0, 0.0]]
    >>> [(edge.rate, edge.switches) for edge in front.edges], front.violations()
    ([(1/2, ((0, '0', '1'),)), (4, ((0, '1', '2'),))], [])
    """

    names: tuple[str, ...]
    chain: Chain
    objectives: Objectives

    claim: ClassVar[Claim] = Claim.CERTIFIED
    picture: ClassVar[str] = "exact_mdp.analysis.plots.tradeoffs:draw_front"

    def __repr__(self) -> str:
        return (
            f"EnclosedFront({' and '.join(self.names)}: {len(self._corners)} vertices, "
            f"certified, their totals within {float(self._width):.1g})"
        )

    @property
    def _width(self) -> Fraction:
        return max(high - low for totals in self.chain.totals for low, high in totals) / 2

    @cached_property
    def _corners(self) -> list[Corner]:
        return corners(self.objectives, self.chain)

    @property
    def _order(self) -> slice:
        """Vertices have a first total that rises; the chain's is better and better."""
        return slice(None, None, self.objectives.sign)

    @property
    def vertices(self) -> list[tuple[Enclosed, ...]]:
        """The totals of each vertex, by name in the order of `names`."""
        found = [
            tuple(self._signed(total) for total in self.chain.totals[corner.policy])
            for corner in self._corners
        ]
        return found[self._order]

    def _signed(self, bracket: Bracket) -> Enclosed:
        found = Enclosed(low=bracket[0], high=bracket[1])
        return found if self.objectives.sign > 0 else -found

    @property
    def policies(self) -> list[Integers]:
        """Action numbers (S,) of the policy of each vertex."""
        of, numbers = self.objectives, {corner.policy for corner in self._corners}
        every = enumerate(self.chain.policies(of))
        found = [of.mdp.pair_action[pairs] for number, pairs in every if number in numbers]
        return found[self._order]

    @property
    def edges(self) -> list[EnclosedEdge]:
        """The edges between neighbouring vertices."""
        vertices, policies, found = self.vertices, self.policies, list[EnclosedEdge]()
        mdp = self.objectives.mdp
        steps = [(c.switches, self.chain.brackets[c.switches[0]]) for c in self._corners[1:]]
        for number, (switches, (low, high)) in enumerate(steps[self._order]):
            states = [int(mdp.pair_state[self.chain.switches[k]]) for k in switches]
            before, after = policies[number], policies[number + 1]
            found.append(
                EnclosedEdge(
                    start=number,
                    end=number + 1,
                    change=tuple(
                        b - a for a, b in zip(vertices[number], vertices[number + 1], strict=True)
                    ),
                    rate=Enclosed(low=low / (1 - low), high=high / (1 - high)),
                    weights=(Enclosed(low=low, high=high), Enclosed(low=1 - high, high=1 - low)),
                    switches=tuple(
                        (s, mdp.actions[before[s]], mdp.actions[after[s]]) for s in states
                    ),
                )
            )
        return found

    @property
    def facets(self) -> list[tuple[tuple[Enclosed, Enclosed], tuple[int, int]]]:
        """Weights with the two vertices that are optimal for them."""
        return [(edge.weights, (edge.start, edge.end)) for edge in self.edges]

    def totals(self, policy: PolicyLike) -> Point:
        """Return the exact totals of a policy, mixed ones too, from the start: long fractions."""
        of = self.objectives
        return tuple(of.sign * value for value in totals_under(of, policy_of(of.mdp, policy)))

    def distance(self, policy: PolicyLike) -> Enclosed:
        """Return by how much all totals of a policy could be better at once: 0 on the front.

        It is the least (H(w) - w · totals) over the weights w of edges and ends, which sum to 1.
        """
        sign = self.objectives.sign
        a, b = (sign * total for total in self.totals(policy))
        ends = [(Fraction(0), Fraction(0)), (Fraction(1), Fraction(1))]
        at = [ends[0], *(self.chain.brackets[c.switches[0]] for c in self._corners[1:]), ends[1]]
        ahead = [self.chain.totals[c.policy] for c in self._corners]
        each = list(zip(at, [ahead[0], *ahead], strict=True))
        # What is ahead changes linearly with the weight: its least and greatest are at the ends.
        lows, highs = (
            [
                pick(t * (first[k] - a) + (1 - t) * (second[k] - b) for t in where)
                for where, (first, second) in each
            ]
            for k, pick in ((0, min), (1, max))
        )
        return Enclosed(low=max(Fraction(0), min(lows)), high=min(highs))

    def frame(self) -> DataFrame:
        """Return the vertices, one in each row, and what the step from the one before costs."""
        frame = pandas.DataFrame(self.vertices, columns=list(self.names))
        frame["rate"] = [None, *(edge.rate for edge in self.edges)]
        return frame

    def violations(self) -> list[str]:
        """Return what does not hold of the front, in words: nothing where it is sound."""
        of = Objectives.of(self.objectives.mdp, self.objectives.texts)
        return chain_violations(of, self.chain)

    def save(self, path: str | Path) -> None:
        """Write the proof as JSON, for `exact-mdp verify`; see `solvers.objectives.file`."""
        ObjectivesProof.of(CHAIN, self.objectives, chain=self.chain).save(path)
