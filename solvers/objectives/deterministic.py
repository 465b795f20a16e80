"""The best deterministic policy under limits on expected totals, exactly, by branch and bound.

    maximise  r(π)   subject to   c_k(π) ≥ b_k,  k = 1 … m,     over deterministic stationary π

A best policy under limits may have to draw its actions (`constrained`); where that is not wanted,
the problem is NP-hard (Feinberg, Mathematics of Operations Research 25, 2000: it holds the
Hamiltonian cycles of a graph). The optimum over mixtures bounds it from above. Where that optimum
draws in a state s, the problem is split by the action taken in s, and each part is bounded again by
its own mixtures (Land and Doig, Econometrica 28, 1960). The part with the highest bound comes
first. What is returned is the best policy found, a bound on all others, and the parts: of each the
prices and values V over its pairs that prove its bound, or that nothing in it keeps the limits. The
search may end early; then the bound is above the policy, and the gap says how far.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from heapq import heappop, heappush
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.result import Result
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.basis import combined
from exact_mdp.solvers.objectives.checker import (
    Attained,
    Part,
    kept_by,
    pairs_of_part,
    parts_violations,
    tight,
)
from exact_mdp.solvers.objectives.constrained import (
    ConstrainedSolution,
    Relaxed,
    relaxed,
    solve_under,
)
from exact_mdp.solvers.objectives.file import DETERMINISTIC, ObjectivesProof
from exact_mdp.solvers.objectives.optima import attained
from exact_mdp.solvers.solution import Certified, Claim

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")
PARTS = 1_000  # that are bounded before the search ends
ONE = Fraction(1)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class DeterministicSolution(Result):
    """The best deterministic policy under limits that was found, and what none exceeds.

    Attributes
    ----------
    mixed : ConstrainedSolution
        The optimum over all policies, which may draw their actions.
    found : Attained, optional
        The policy; None where none that keeps the limits was found.
    parts : tuple of Part
        What all deterministic policies were split into, and the bound of each.

    Examples
    --------
    >>> from exact_mdp import solve
    >>> rows = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    >>> mdp = MDP.from_outcomes(rows, components={"cost": [3, 1, 0]})
    >>> best = solve(mdp, subject_to={"cost": "<= 3/2"}, deterministic=True)
    >>> best.start_value, best.gap, best.mixed.start_value, best.violations()
    (Fraction(1, 1), Fraction(0, 1), Fraction(2, 1), [])
    """

    mixed: ConstrainedSolution
    found: Attained | None
    parts: tuple[Part, ...]

    claim: ClassVar[Claim] = Claim.CERTIFIED

    def __repr__(self) -> str:
        kept = ", ".join(map(str, self.mixed.limits))
        if self.found is None:
            word = "found none that keeps" if self.feasible is None else "none keeps"
            return f"DeterministicSolution({word} {kept}; certified)"
        gap = f", gap {float(self.gap or 0):.3g}" if self.gap else ""
        return f"DeterministicSolution({float(self.start_value):.12g} with {kept}{gap}; certified)"

    @property
    def objectives(self) -> Objectives:
        """The reward, then what is limited."""
        return self.mixed.objectives

    @property
    def mdp(self) -> MDP:
        """The model."""
        return self.objectives.mdp

    @cached_property
    def bound(self) -> Fraction | None:
        """What no deterministic policy that keeps the limits exceeds; None where there is none.

        In a model of costs, what none falls below.
        """
        open_ = [part.bound for part in self.parts if part.bound is not None]
        return self.objectives.sign * max(open_) if open_ else None

    @property
    def feasible(self) -> bool | None:
        """Whether a deterministic policy keeps the limits; None where the search ended before."""
        if self.found is not None:
            return True
        return False if self.bound is None else None

    @property
    def start_value(self) -> Fraction:
        """The policy's expected return."""
        if self.found is None:
            raise ValueError("no deterministic policy that keeps the limits was found")
        return self.objectives.sign * self.found.total[0]

    @property
    def start(self) -> Certified:
        """The same as a claim."""
        return Certified(value=self.start_value)

    @property
    def gap(self) -> Fraction | None:
        """How far the policy may be from the best one: 0 where it is the best."""
        if self.found is None or self.bound is None:
            return None
        return abs(self.bound - self.start_value)

    @property
    def totals(self) -> dict[str, Fraction]:
        """The policy's total of what is limited."""
        if self.found is None:
            return {}
        of = self.objectives
        return {n: of.sign * t for n, t in zip(of.names[1:], self.found.total[1:], strict=True)}

    @property
    def policy(self) -> Policy:
        """The policy."""
        if self.found is None:
            raise ValueError("no deterministic policy that keeps the limits was found")
        return Policy.from_choices(self.mdp, self.mdp.pair_action[self.found.pairs])

    def frame(self) -> DataFrame:
        """Return one row for each limit: the total, and that of the best mixture."""
        rows = [
            (str(limit), self.totals.get(limit.name), self.mixed.totals[limit.name])
            for limit in self.mixed.limits
        ]
        return pandas.DataFrame(rows, columns=["limit", "total", "mixed"])

    @property
    def _claims(self) -> dict[str, Any]:
        """What the checker takes; its bound is on what is maximised."""
        sign, bound = self.objectives.sign, self.bound
        return {
            "proof": self.mixed.proof, "limits": self.mixed.limits, "found": self.found,
            "parts": self.parts, "bound": None if bound is None else sign * bound,
        }  # fmt: skip

    def violations(self) -> list[str]:
        """Return what does not hold of the solution, in words: nothing where it is sound."""
        return parts_violations(Objectives.of(self.mdp, self.objectives.texts), **self._claims)

    def save(self, path: str | Path) -> None:
        """Write the proof as JSON, for `exact-mdp verify`; see `solvers.objectives.file`."""
        ObjectivesProof.of(DETERMINISTIC, self.objectives, **self._claims).save(path)


def best_deterministic(
    mdp: MDP, subject_to: Mapping[str, Any], most: int = PARTS
) -> DeterministicSolution:
    """Return the best deterministic policy under limits, bounding `most` parts; see `solve`."""
    mixed = solve_under(mdp, subject_to)
    search = _Search(mixed)
    while search.open and search.bounded < most:
        search.split()
    parts = [*search.closed, *(each.part for _, _, each in search.open)]
    return DeterministicSolution(mixed=mixed, found=search.best, parts=tuple(parts))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Open:
    """A part, and the best mixture in it, which draws an action."""

    part: Part
    found: Relaxed


class _Search:
    """The best policy so far, and parts: closed ones, and open ones by falling bound."""

    def __init__(self, mixed: ConstrainedSolution) -> None:
        self.of, self.limits = mixed.objectives, mixed.limits
        self.best: Attained | None = None
        self.closed: list[Part] = []
        self.open: list[tuple[Fraction, int, _Open]] = []
        self.bounded = 0
        self._bound((), ())

    def split(self) -> None:
        """Split the open part of the highest bound by what it does in a state in which it draws."""
        _, _, node = heappop(self.open)
        if self._beaten(node.part):
            self.closed.append(node.part)
            return
        drawn = node.found.drawn(self.of)
        if not drawn:
            self._offer(self._policy(node))
            self.closed.append(node.part)
            return
        state = max(drawn, key=lambda s: sum(drawn[s].values()))
        for pair in self.of.mdp.pairs_of(state):
            like = [a for a in node.found.columns if a.pairs[state] == pair]
            self._bound((*node.part.taken, int(pair)), like)

    def _bound(self, taken: tuple[int, ...], like: Sequence[Attained]) -> None:
        """Bound the part of the policies that take some pairs, and keep what it holds."""
        self.bounded += 1
        of, limits = self.of, self.limits
        allowed = pairs_of_part(of, taken)
        found = relaxed(of, limits, allowed, like)
        weight = ONE if found.shift == 0 else Fraction(0)
        part = Part(
            taken=taken, price=(weight, *found.price), dual=found.dual,
            bound=found.worth if found.shift == 0 else None,
        )  # fmt: skip
        if found.shift:
            self.closed.append(part)
            return
        for column in found.columns:
            self._offer(column)
        if self._beaten(part):
            self.closed.append(part)
        else:
            heappush(self.open, (-found.worth, self.bounded, _Open(part=part, found=found)))

    def _policy(self, node: _Open) -> Attained:
        """Return the policy of a mixture that draws no action."""
        of, part, found = self.of, node.part, node.found
        weights = combined(of, self.limits, ONE, found.price)
        pairs = tight(of, weights, found.dual, pairs_of_part(of, part.taken))
        for pair in found.flow:
            pairs[of.mdp.pair_state[pair]] = pair
        return attained(of, pairs)

    def _offer(self, policy: Attained) -> None:
        better = self.best is None or policy.total[0] > self.best.total[0]
        if better and all(kept_by(self.of, limit, policy.total) for limit in self.limits):
            self.best = policy

    def _beaten(self, part: Part) -> bool:
        return self.best is not None and (part.bound is None or part.bound <= self.best.total[0])
