"""The worst and the best that a shared box of parameters can do to a policy, and to the optimum.

All states read the same tables, so that an error in one number moves many rows at once; nature has
one choice of θ in the box, not one for each row. That is not rectangular, and finding the worst θ
is hard in general (Wiesemann, Kuhn and Rustem, Mathematics of Operations Research 38, 2013). Here:

* Where the derivative of V^π by a parameter has one sign throughout the box, the extreme is at that
  parameter's end. Ends that are proven are fixed, which narrows the box and proves further signs
  (the monotonicity test of interval analysis: Hansen and Walster, Global Optimization Using
  Interval Analysis, 2004, chapter 12). Where all are, the extreme is a corner: an exact number.
* Otherwise the box is split along the parameter that may matter most, the most promising part first
  (branch and bound). Bounds of V^π over a part and its values at points bracket the extreme; what
  distance is left is told.

For the best policy against the box, max_π min_θ V^π(θ): candidates' worst cases bound it from
below, and the optimum at any point of the box from above; each worst point found is such a point,
and its optimum is the next candidate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction

import numpy as np

from exact_mdp.analysis.sensitivity.ranges import Range, admitted, around, checked
from exact_mdp.analysis.sensitivity.robust.search import (
    BoxExtreme,
    BoxOptimum,
    BoxSearch,
    Side,
    exact_value,
)
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, parameter_of, parametric
from exact_mdp.mdp.table import Floats, exact
from exact_mdp.solvers import solve
from exact_mdp.solvers.values.policy_chain import PolicyChain

__all__ = [
    "BoxExtreme",
    "BoxOptimum",
    "box_extreme",
    "box_optimum",
    "box_ranges",
    "corners",
    "exact_value",
]

PARTS = 40
GAP = 1e-6


def box_ranges(
    source: Scenario | Parametric,
    ranges: Mapping[str, object] | None = None,
    *,
    relative: object = "1/5",
) -> dict[str, Range]:
    """Return the box: all probabilities among the parameters ± a share, or stated ranges.

    A share of 0 is the tables as they are.

    Examples
    --------
    >>> box = box_ranges(Scenario.load("yuan2025"))
    >>> len(box), box["base.anger"]
    (32, Range(low=Fraction(1, 25), high=Fraction(3, 50)))
    """
    family = parametric(source)
    if ranges is None:
        share = exact(relative)
        spans = {
            p.name: admitted(family, p, around(p, share))
            if share
            else Range(low=p.value, high=p.value)
            for p in family.parameters
            if (p.low, p.high) == (0, 1) and p.value and p.name != DISCOUNT
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
            "the discount is no number of the tables",
            where="robust box",
            fix="leave it out, and vary it with one_way",
        )
    if not spans:
        raise ModelError("nothing moves", where="robust box", fix="give a range")
    return spans


def tell_of_box(family: Parametric, spans: Mapping[str, Range]) -> None:
    """Warn where a chance of a care scenario is cut off at 1 within a box."""
    if isinstance(family, ScenarioFamily):
        highest = {name: span.high for name, span in spans.items()}
        family.tell(highest, where=" at the upper ends of the ranges")


def box_extreme(
    source: Scenario | Parametric,
    policy: object,
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
    source : Scenario, or a parametric model whose rows are affine in the parameters
    policy : "optimal" at today's values, or anything that `solvers.evaluate` takes
    ranges : {name: (low, high)}, optional
        All probabilities ± 20 % unless given.
    gap : float
        Distance of the bounds at which to stop; the result tells which was reached.
    parts : int
        Boxes to bound at most; fewer where a quarter of them brings the bounds no nearer.
    progress : bool
        Show a bar on standard error where that is a terminal.

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
    spans, family = box_ranges(source, ranges), parametric(source)
    tell_of_box(family, spans)
    mdp = family.at({})
    held = solve(mdp) if isinstance(policy, str) and policy == "optimal" else policy
    weights = PolicyChain.of(mdp, held).chosen
    return BoxSearch(family, weights, spans, side).run(gap, parts, progress=progress)


def box_optimum(
    source: Scenario | Parametric,
    ranges: Mapping[str, object] | None = None,
    *,
    candidates: Mapping[str, object] | None = None,
    rounds: int = 5,
    gap: float = GAP,
    parts: int = PARTS,
    progress: bool = False,
) -> BoxOptimum:
    """Return what the best policy can be sure of over the box, between two bounds.

    Parameters
    ----------
    candidates : {name: policy}, optional
        Policies to try beside today's optimum and the optima at worst points.
    rounds : int
        Worst points to follow.
    gap, parts, progress
        See `box_extreme`.

    Examples
    --------
    >>> scenario = Scenario.load("yuan2025")
    >>> found = box_optimum(scenario, {"base.anger": ("1/25", "3/50")})
    >>> found.saddle, round(found.low, 4) == round(found.high, 4)
    (True, True)
    """
    spans, family = box_ranges(source, ranges), parametric(source)
    tell_of_box(family, spans)
    mdp = family.at({})
    waiting: list[tuple[str, object]] = [("optimal today", solve(mdp)), *(candidates or {}).items()]
    worst: dict[str, BoxExtreme] = {}
    weights: dict[str, Floats] = {}
    ceiling, seen = np.inf, set()
    lowest: MDP | None = None
    while waiting:
        name, policy = waiting.pop(0)
        weights[name] = PolicyChain.of(mdp, policy).chosen
        search = BoxSearch(family, weights[name], spans, "worst")
        worst[name] = found = search.run(gap, parts, progress=progress)
        key = tuple(found.point.values())
        if key in seen:
            continue
        seen.add(key)
        there = family.at(found.point)
        best = solve(there)
        if best.start.interval[1] < ceiling:
            ceiling, lowest = best.start.interval[1], there
        if len(seen) <= rounds:
            waiting.append((f"optimal at worst point {len(seen)}", best.policy))
    first = max(worst, key=lambda name: worst[name].low)
    assert lowest is not None
    saddle = worst[first].proven and _optimum(lowest) == worst[first].reached
    return BoxOptimum(
        low=worst[first].low,
        high=max(ceiling, worst[first].low),
        policy=weights[first],
        worst=worst[first],
        candidates=worst,
        saddle=saddle,
    )


def _optimum(mdp: MDP) -> Fraction:
    """Return the exact optimal value at the start."""
    from exact_mdp.solvers import certify

    value = certify(mdp).value
    return sum((weight * Fraction(value[state]) for state, weight in mdp.start), Fraction(0))


def corners(ranges: Mapping[str, Range], number: int, seed: int) -> Iterable[dict[str, Fraction]]:
    """Yield random corners of a box.

    Examples
    --------
    >>> box = {"p": Range(low=Fraction(0), high=Fraction(1))}
    >>> sorted(str(point["p"]) for point in corners(box, 1, seed=0)) in (["0"], ["1"])
    True
    """
    rng = np.random.default_rng(seed)
    for _ in range(number):
        ends = rng.integers(0, 2, len(ranges)).tolist()
        yield {
            name: span.high if end else span.low
            for (name, span), end in zip(ranges.items(), ends, strict=True)
        }
