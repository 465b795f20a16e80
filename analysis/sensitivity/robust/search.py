"""What is found of a policy, and of the best policy, over a box of parameters.

Branch and bound over a box of parameters, with the monotonicity test; see `robust_box`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from heapq import heappop, heappush
from itertools import count
from typing import TYPE_CHECKING, Literal

import numpy as np

from exact_mdp.analysis.sensitivity.exact_chain import ExactChain, fraction
from exact_mdp.analysis.sensitivity.ranges import Range
from exact_mdp.analysis.sensitivity.robust.care import BoxBounds, CareBox
from exact_mdp.analysis.sensitivity.robust.family import FamilyBox
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.solution import Bounded, Certified

if TYPE_CHECKING:
    from pandas import DataFrame


Side = Literal["worst", "best"]


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxExtreme:
    """The least, or the greatest, value of a policy over a box.

    Attributes
    ----------
    side : "worst" or "best"
    low, high : float
        The extreme lies between them.
    point : {name: Fraction}
        Where `reached` is attained.
    reached : Fraction
        The policy's exact value there: the extreme itself where `proven`.
    proven : bool
        Every sign was proven, so that `point` is the exact extreme.
    signs : {name: "rising", "falling", "none" or "open"}
        How the value moves with each parameter, as far as proven: throughout the part of the box
        that is left once the ends proven before it are fixed.
    parts : int
        Boxes that were bounded.
    """

    side: Side
    low: float
    high: float
    point: Mapping[str, Fraction]
    reached: Fraction
    proven: bool
    signs: Mapping[str, str]
    parts: int

    @property
    def value(self) -> Certified | Bounded:
        """The extreme, exact where that is proven, else the middle of its bounds."""
        if self.proven:
            return Certified(value=self.reached)
        middle = (self.low + self.high) / 2
        half = max(self.high - middle, middle - self.low)
        return Bounded(value=middle, error=float(np.nextafter(half, np.inf)))

    @property
    def gap(self) -> float:
        """Distance of the bounds; 0 where the extreme is exact."""
        return 0.0 if self.proven else self.high - self.low

    def frame(self) -> DataFrame:
        """Return where each parameter is at the extreme, and what is proven of its direction."""
        from pandas import DataFrame

        return DataFrame(
            [
                {"parameter": name, "at": float(at), "value moves": self.signs[name]}
                for name, at in self.point.items()
            ]
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxOptimum:
    """What the best policy can be sure of over a box: max_π min_θ V^π(θ).

    Attributes
    ----------
    low, high : float
        It lies between them.
    policy : (L,)
        Probabilities of pairs of the candidate with the best worst case.
    worst : BoxExtreme
        That candidate's worst case.
    candidates : {name: BoxExtreme}
    saddle : bool
        Some point's exact optimum is the candidate's exact worst case: no policy does better.
    """

    low: float
    high: float
    policy: Floats
    worst: BoxExtreme
    candidates: Mapping[str, BoxExtreme]
    saddle: bool

    @property
    def gap(self) -> float:
        """Distance of the bounds."""
        return 0.0 if self.saddle else self.high - self.low

    def frame(self) -> DataFrame:
        """Return each candidate's worst case (reward)."""
        from pandas import DataFrame

        return DataFrame(
            [
                {
                    "policy": name,
                    "worst case from (reward)": found.low,
                    "to (reward)": found.high,
                    "claim": found.value.claim,
                }
                for name, found in self.candidates.items()
            ]
        )


NEARER = 0.99  # of their distance, to which bounds must come within a quarter of the parts


class BoxSearch:
    """Branch and bound; the greatest value is the least of its negative."""

    def __init__(
        self,
        source: Scenario | Parametric,
        weights: Floats,
        spans: Mapping[str, Range],
        side: Side,
    ) -> None:
        if side not in ("worst", "best"):
            raise ModelError(f"unknown side {side!r}", where="robust box", fix="say worst or best")
        self.family, self.weights, self.side = parametric(source), weights, side
        self.sign = 1 if side == "worst" else -1
        self.model: CareBox | FamilyBox
        if isinstance(self.family, ScenarioFamily):
            self.model = CareBox(self.family.scenario, weights, list(spans))
        else:
            low = {name: span.low for name, span in spans.items()}
            high = {name: span.high for name, span in spans.items()}
            self.model = FamilyBox(self.family, weights, low, high)
        self.spans = spans
        self.today = {p.name: p.value for p in self.family.parameters if p.name in spans}
        self.signs = {n: "open" if span.low < span.high else "none" for n, span in spans.items()}
        self.best: tuple[Fraction, dict[str, Fraction]] | None = None
        self.seen: set[tuple[Fraction, ...]] = set()
        self.parts = 0

    def run(self, gap: float, most: int, *, progress: bool = False) -> BoxExtreme:
        """Search until the bounds are within `gap`, or stay apart; see `robust_box.box_extreme`."""
        from tqdm import tqdm

        low = {name: span.low for name, span in self.spans.items()}
        high = {name: span.high for name, span in self.spans.items()}
        tie, heap = count(), []
        least, found = self._narrow(low, high, root=True)
        heappush(heap, (least, next(tie), low, high, found))
        apart, since = np.inf, 0
        silent = None if progress else True
        with tqdm(total=most, desc=f"boxes, {self.side}", disable=silent, delay=1) as bar:
            while heap and self.parts < most:
                bar.update(min(self.parts, most) - bar.n)
                assert self.best is not None
                least, _, low, high, found = heap[0]
                left = float(self.best[0]) * self.sign - least
                if found is None or left <= gap:
                    break
                if left <= NEARER * apart:
                    apart, since = left, self.parts
                elif 4 * (self.parts - since) > most:
                    break
                heappop(heap)
                name = self._widest(low, high, found)
                middle = (low[name] + high[name]) / 2
                for ends in ((low[name], middle), (middle, high[name])):
                    lower, upper = {**low, name: ends[0]}, {**high, name: ends[1]}
                    bound, inside = self._narrow(lower, upper)
                    heappush(heap, (max(bound, least), next(tie), lower, upper, inside))
        assert self.best is not None
        value, point = self.best
        reached = float(value) * self.sign
        # A part that has shrunk to a point is done, and its exact value is in `best`; nor is there
        # anything to find in a part that is bounded from above what was reached.
        above = float(np.nextafter(reached, np.inf))
        left = [part[0] for part in heap if part[4] is not None and part[0] < above]
        least, proven = min(left, default=np.inf), not left
        bottom = min(least, float(np.nextafter(reached, -np.inf)))
        ends = sorted((bottom * self.sign, above * self.sign))
        return BoxExtreme(
            side=self.side,
            low=ends[0],
            high=ends[1],
            point=point,
            reached=value,
            proven=proven,
            signs=self.signs,
            parts=self.parts,
        )

    def _narrow(
        self, low: dict[str, Fraction], high: dict[str, Fraction], *, root: bool = False
    ) -> tuple[float, BoxBounds | None]:
        """Fix proven ends in place; return a lower bound, and what is left open (None: nothing).

        Bounds and values are those of the value times `sign`, so that the least is sought.
        """
        while True:
            self.parts += 1
            found = self.model.bounds(low, high)
            still = True
            for name, (below, above) in found.slopes.items():
                if below < 0 < above:
                    continue
                at, word = low[name], "rising"
                if below == above:
                    at, word = min(max(self.today[name], low[name]), high[name]), "none"
                elif above <= 0:
                    word = "falling"
                if word != "none" and (word == "rising") != (self.sign > 0):
                    at = high[name]
                low[name], high[name], still = at, at, False
                if root:
                    self.signs[name] = word
            if still:
                break
        middle = {}
        for name in low:
            below, above = found.slopes.get(name, (0.0, 0.0))
            falls = (below + above) * self.sign < 0
            middle[name] = high[name] if falls else low[name]
        self._try(middle)
        least = found.low if self.sign > 0 else -found.high
        return least, found if any(low[name] < high[name] for name in low) else None

    def _try(self, point: dict[str, Fraction]) -> None:
        key = tuple(point.values())
        if key in self.seen:
            return
        self.seen.add(key)
        value = exact_value(self.family.at(point), self.weights)
        if self.best is None or value * self.sign < self.best[0] * self.sign:
            self.best = value, dict(point)

    def _widest(
        self, low: Mapping[str, Fraction], high: Mapping[str, Fraction], found: BoxBounds
    ) -> str:
        def reach(name: str) -> float:
            below, above = found.slopes[name]
            return float(high[name] - low[name]) * min(-below, above)

        return max(found.slopes, key=reach)


def exact_value(mdp: MDP, policy: object) -> Fraction:
    """Return a policy's exact value at the start."""
    chain = ExactChain(mdp, policy)
    value = chain.values(chain.reward)
    return sum((weight * fraction(value[state]) for state, weight in mdp.start), Fraction(0))
