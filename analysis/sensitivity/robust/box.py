"""The worst and the best that a shared box of parameters can do to a policy, and to the optimum.

All states read the same tables, so that an error in one number moves many rows at once; nature has
one choice of θ in the box, not one for each row. That is not rectangular, and finding the worst θ
is hard in general (Wiesemann, Kuhn and Rustem, Mathematics of Operations Research 38, 2013). Here:

* Where the derivative of V^π by a parameter has one sign throughout the box, the extreme is at that
  parameter's end. Ends that are proven are fixed, which narrows the box and proves further signs
  (the monotonicity test of interval analysis: Hansen and Walster, Global Optimization Using
  Interval Analysis, 2004, chapter 12). Where all are, the extreme is a corner: an exact number.
* Otherwise the box is split along the parameter that may matter most, the most promising part first
  (branch and bound). Bounds of V^π over a part and its values at points bracket the extreme.

For the best policy against the box, max_π min_θ V^π(θ): candidates' worst cases bound it from
below, and the optimum at any point of the box from above; each worst point found is such a point,
and its optimum is the next candidate. Of costs the worst is the greatest, and all is the other way.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from heapq import heappop, heappush
from itertools import count
from typing import TYPE_CHECKING, Literal

import numpy as np

from exact_mdp.analysis.sensitivity.base_case import finite_optimum
from exact_mdp.analysis.sensitivity.exact_chain import ExactChain
from exact_mdp.analysis.sensitivity.ranges import Range, admitted, around, checked, unit_of
from exact_mdp.analysis.sensitivity.robust.care import BoxBounds, CareBox
from exact_mdp.analysis.sensitivity.robust.family import FamilyBox
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, parameter_of, parametric
from exact_mdp.mdp.parametric.symbolic import fraction
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, exact
from exact_mdp.solvers import certify
from exact_mdp.solvers.solution import Bounded, Certified
from exact_mdp.solvers.values.policy_chain import PolicyChain

if TYPE_CHECKING:
    from pandas import DataFrame

pandas, tqdm = later("pandas"), later("tqdm")

Side = Literal["worst", "best"]
Point = dict[str, Fraction]

PARTS = 40
GAP = 1e-6
ROUNDS = 5  # worst points whose optima are tried
NEARER = 0.99  # of their distance, to which bounds must come within a quarter of the parts


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BoxExtreme(Result):
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
        return Certified(value=self.reached) if self.proven else _between(self.low, self.high)

    @property
    def gap(self) -> float:
        """Distance of the bounds; 0 where the extreme is exact."""
        return 0.0 if self.proven else self.high - self.low

    def frame(self) -> DataFrame:
        """Return where each parameter is at the extreme, and what is proven of its direction."""
        return pandas.DataFrame(
            [
                {"parameter": name, "at": float(at), "value moves": self.signs[name]}
                for name, at in self.point.items()
            ]
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BoxOptimum(Result):
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
    def value(self) -> Certified | Bounded:
        """What the best policy can be sure of, exact at a saddle, else the middle of its bounds."""
        return self.worst.value if self.saddle else _between(self.low, self.high)

    @property
    def gap(self) -> float:
        """Distance of the bounds."""
        return 0.0 if self.saddle else self.high - self.low

    def frame(self) -> DataFrame:
        """Return each candidate's worst case (reward)."""
        return pandas.DataFrame(
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


def _between(low: float, high: float) -> Bounded:
    middle = (low + high) / 2
    half = max(high - middle, middle - low)
    return Bounded(value=middle, error=float(np.nextafter(half, np.inf)))


def box_ranges(
    model: Scenario | Parametric,
    ranges: Mapping[str, object] | None = None,
    *,
    relative: object = "1/5",
) -> dict[str, Range]:
    """Return the box: all probabilities among the parameters ± a share, or stated ranges.

    A share of 0 is the tables as they are.
    """
    family = parametric(model)
    if ranges is None:
        share = exact(relative)
        spans = {
            p.name: admitted(family, p, around(p, share))
            if share
            else Range(low=p.value, high=p.value)
            for p in family.parameters
            if unit_of(p) == "probability" and p.value
        }
    else:
        still = {
            parameter_of(family, name).name: given
            for name, given in ranges.items()
            if isinstance(given, Range) and given.low == given.high
        }
        moving = checked(family, {n: given for n, given in ranges.items() if n not in still})
        spans = {name: still.get(name) or moving[name] for name in ranges}
    if DISCOUNT in spans:
        raise ModelError(
            "the discount is not a number of the tables",
            where="robust box",
            fix="leave it out, and vary it with one_way",
        )
    if not spans:
        raise ModelError("nothing moves", where="robust box", fix="give a range")
    return spans


def _opened(
    model: Scenario | Parametric, ranges: Mapping[str, object] | None
) -> tuple[Parametric, dict[str, Range]]:
    """Return the family and the box; warn where a chance is cut off at 1 within the box."""
    family, spans = parametric(model), box_ranges(model, ranges)
    if isinstance(family, ScenarioFamily):
        highest = {name: span.high for name, span in spans.items()}
        family.tell(highest, where=" at the upper ends of the ranges")
    return family, spans


def box_extreme(
    model: Scenario | Parametric,
    policy: PolicyLike,
    ranges: Mapping[str, object] | None = None,
    *,
    side: Side = "worst",
    gap: float = GAP,
    parts: int = PARTS,
    progress: bool = False,
) -> BoxExtreme:
    """Return the worst (or best) value of a fixed policy over a shared box of parameters.

    Parameters
    ----------
    model : Scenario or Parametric
        Its rows are affine in the parameters.
    policy : PolicyLike
        "optimal" is the optimum at today's values.
    ranges : {name: (low, high)}, optional
        All probabilities ± 20 % unless given.
    side : "worst" or "best"
    gap : float
        Distance of the bounds at which to stop; the result says which was reached.
    parts : int
        Boxes to bound at most; fewer where a quarter of them brings the bounds no nearer.
    progress : bool
        Show a bar on standard error where that is a terminal.

    Returns
    -------
    BoxExtreme

    Raises
    ------
    ModelError
        For unknown names, empty ranges, the discount, and rows that are not affine.

    Examples
    --------
    >>> scenario = Scenario.load("yuan2025")
    >>> found = box_extreme(scenario, "optimal", {"base.anger": ("1/25", "3/50")})
    >>> found.proven, found.signs, str(found.point["base.anger"])
    (True, {'base.anger': 'falling'}, '3/50')
    """
    family, spans = _opened(model, ranges)
    weights = PolicyChain.of(family.at({}), policy).chosen
    return _Search(family, weights, spans, side).run(gap, parts, progress)


def box_optimum(
    model: Scenario | Parametric,
    ranges: Mapping[str, object] | None = None,
    *,
    candidates: Mapping[str, PolicyLike] | None = None,
    gap: float = GAP,
    parts: int = PARTS,
    progress: bool = False,
) -> BoxOptimum:
    """Return what the best policy can be sure of over the box, between two bounds.

    Parameters
    ----------
    model, ranges, gap, parts, progress
        See `box_extreme`.
    candidates : {name: PolicyLike}, optional
        Policies to try beside today's optimum and the optima at worst points.

    Returns
    -------
    BoxOptimum

    Raises
    ------
    ModelError
        As `box_extreme` does.

    Examples
    --------
    >>> scenario = Scenario.load("yuan2025")
    >>> found = box_optimum(scenario, {"base.anger": ("1/25", "3/50")})
    >>> found.saddle, round(found.low, 4) == round(found.high, 4)
    (True, True)
    """
    family, spans = _opened(model, ranges)
    mdp = family.at({})
    waiting: list[tuple[str, PolicyLike]] = [
        ("optimal today", "optimal"),
        *(candidates or {}).items(),
    ]
    worst: dict[str, BoxExtreme] = {}
    weights: dict[str, Floats] = {}
    ceiling, seen, costs = np.inf, set(), mdp.sense == "min"
    lowest: MDP | None = None
    while waiting:
        name, policy = waiting.pop(0)
        weights[name] = PolicyChain.of(mdp, policy).chosen
        worst[name] = found = _Search(family, weights[name], spans, "worst").run(
            gap, parts, progress
        )
        key = tuple(found.point.values())
        if key in seen:
            continue
        seen.add(key)
        there = family.at(found.point)
        best = finite_optimum(there, f"worst point {len(seen)}")
        most = -best.start.interval[0] if costs else best.start.interval[1]
        if most < ceiling:
            ceiling, lowest = most, there
        if len(seen) <= ROUNDS:
            waiting.append((f"optimal at worst point {len(seen)}", best.policy))
    sure = {name: -each.high if costs else each.low for name, each in worst.items()}
    first = max(sure, key=lambda name: sure[name])
    ends = sure[first], max(ceiling, sure[first])
    assert lowest is not None
    return BoxOptimum(
        low=-ends[1] if costs else ends[0],
        high=-ends[0] if costs else ends[1],
        policy=weights[first],
        worst=worst[first],
        candidates=worst,
        saddle=worst[first].proven and certify(lowest).start_value == worst[first].reached,
    )


def exact_value(mdp: MDP, policy: PolicyLike) -> Fraction:
    """Return a policy's exact value at the start."""
    chain = ExactChain(mdp, policy)
    value = chain.values(chain.reward)
    return sum((weight * fraction(value[state]) for state, weight in mdp.start), Fraction(0))


class _Search:
    """Branch and bound; the greatest value is the least of its negative."""

    def __init__(
        self, family: Parametric, weights: Floats, spans: Mapping[str, Range], side: Side
    ) -> None:
        if side not in ("worst", "best"):
            raise ModelError(f"unknown side {side!r}", where="robust box", fix="say worst or best")
        self.family, self.weights, self.side = family, weights, side
        self.sign = 1 if (side == "worst") == (family.at({}).sense == "max") else -1
        self.low: Point = {name: span.low for name, span in spans.items()}
        self.high: Point = {name: span.high for name, span in spans.items()}
        self.model: CareBox | FamilyBox
        if isinstance(family, ScenarioFamily):
            self.model = CareBox(family.scenario, weights, list(spans))
        else:
            self.model = FamilyBox(family, weights, self.low, self.high)
        self.today = {p.name: p.value for p in family.parameters if p.name in spans}
        self.signs = {n: "open" if span.low < span.high else "none" for n, span in spans.items()}
        self.best: tuple[Fraction, Point] | None = None
        self.seen: set[tuple[Fraction, ...]] = set()
        self.parts = 0

    def run(self, gap: float, most: int, progress: bool) -> BoxExtreme:
        """Search until the bounds are within `gap`, or stay apart; see `box_extreme`."""
        low, high = dict(self.low), dict(self.high)
        tie = count()
        heap: list[tuple[float, int, Point, Point, BoxBounds | None]] = []
        least, found = self._narrow(low, high, root=True)
        heappush(heap, (least, next(tie), low, high, found))
        apart, since = np.inf, 0
        silent = None if progress else True
        with tqdm.tqdm(total=most, desc=f"boxes, {self.side}", disable=silent, delay=1) as bar:
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
                name = _widest(low, high, found)
                middle = (low[name] + high[name]) / 2
                for start, end in ((low[name], middle), (middle, high[name])):
                    lower, upper = {**low, name: start}, {**high, name: end}
                    bound, inside = self._narrow(lower, upper)
                    heappush(heap, (max(bound, least), next(tie), lower, upper, inside))
        assert self.best is not None
        value, point = self.best
        reached = float(value) * self.sign
        # A part that has shrunk to a point is done, and its exact value is in `best`; nor is there
        # anything to find in a part that is bounded from above what was reached.
        above = float(np.nextafter(reached, np.inf))
        open_parts = [part[0] for part in heap if part[4] is not None and part[0] < above]
        bottom = min(*open_parts, float(np.nextafter(reached, -np.inf)), np.inf)
        ends = sorted((bottom * self.sign, above * self.sign))
        return BoxExtreme(
            side=self.side,
            low=ends[0],
            high=ends[1],
            point=point,
            reached=value,
            proven=not open_parts,
            signs=self.signs,
            parts=self.parts,
        )

    def _narrow(
        self, low: Point, high: Point, *, root: bool = False
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

    def _try(self, point: Point) -> None:
        key = tuple(point.values())
        if key not in self.seen:
            self.seen.add(key)
            value = exact_value(self.family.at(point), self.weights)
            if self.best is None or value * self.sign < self.best[0] * self.sign:
                self.best = value, dict(point)


def _widest(low: Point, high: Point, found: BoxBounds) -> str:
    """Return the parameter that may move the value most, against the sign of its slope."""

    def reach(name: str) -> float:
        below, above = found.slopes[name]
        return float(high[name] - low[name]) * min(-below, above)

    return max(found.slopes, key=reach)
