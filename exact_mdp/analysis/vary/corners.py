"""The worst point found for a policy among the corners of its parameters' ranges.

All states read the same tables, so that nature has one choice of the parameters, not one for each
row. To find the worst is hard in general (Wiesemann, Kuhn and Rustem, Mathematics of Operations
Research 38, 2013). Here corners are searched: each parameter begins at the end at which the policy
is worth less while the others keep today's values; then the one parameter is moved to its other end
that lowers the value most, until none does. The value at the corner that this ends in is a number
that the policy comes to, so that the worst case is no better. Whether it is worse, at another
corner or inside, is not known: the worst case is estimated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.vary.base_case import finite_optimum, finite_worth
from exact_mdp.analysis.vary.ranges import spans_of
from exact_mdp.analysis.vary.study import solver_of
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table, cell
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.solution import Bounded, Claim

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class WorstPoint(Result):
    """The worst corner that was found.

    Attributes
    ----------
    point : {name: Fraction}
        Where each parameter is.
    value : Bounded
        What the policy is worth there: its worst case is no better.
    optimum : Bounded
        The optimal value there: the worst case of no policy is better.
    corners : int
        How many were evaluated.
    """

    point: Mapping[str, Fraction]
    value: Bounded
    optimum: Bounded
    corners: int

    @property
    def claim(self) -> Claim:
        """Estimated: a worse point may exist."""
        return Claim.ESTIMATED

    def report(self) -> Report:
        """Return the value there, and the corner."""
        value = {"value": self.value.value, "error_bound": self.value.error, "claim": self.claim}
        point = {name: float(at) for name, at in self.point.items()}
        said = f"at best {cell(self.value)}, not proven to be the worst point (estimated)"
        return Report(
            title="worst corner",
            facts={
                "claim": Shown(self.claim),
                "nature": "one choice of the parameters for all states",
                "worst_case": Shown(value | {"point": point, "optimum": self.optimum}, said),
            },
            tables={
                "point": Table(
                    title=f"the worst of {self.corners:,} corners",
                    rows=[{"name": name, "at": at} for name, at in point.items()],
                    columns={"parameter": "name", "at the worst point": "at:.6g"},
                )
            },
        )

    def frame(self) -> DataFrame:
        """Return where each parameter is."""
        import pandas

        at = [float(each) for each in self.point.values()]
        return pandas.DataFrame({"parameter": list(self.point), "at": at})


def worst_point(
    model: Scenario | MDP | Parametric,
    policy: PolicyLike = "optimal",
    ranges: Mapping[str, object] | None = None,
    *,
    relative: object | None = None,
) -> WorstPoint:
    """Return the worst corner of the parameters' ranges that a search finds for a policy.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    policy : PolicyLike
        Held fixed; "optimal" is the optimum at today's values.
    ranges : {name: (low, high)}, optional
        Today's values ± 20 % unless given, of all parameters but the discount.
    relative : number, optional
        Another share than 20 %.

    Returns
    -------
    WorstPoint

    Raises
    ------
    ModelError
        For unknown names, empty ranges, values that the model cannot have together, and where a
        value is infinite.

    Examples
    --------
    >>> worst = worst_point(Scenario.load("yuan2025"), ranges={"base.anger": ("1/25", "3/50")})
    >>> str(worst.point["base.anger"]), worst.value.value < 146.2
    ('3/50', True)
    """
    family = parametric(model)
    spans = spans_of(family, None, ranges, relative)
    names = [parameter.name for parameter in spans]
    if isinstance(family, ScenarioFamily):
        highest = {parameter.name: span.high for parameter, span in spans.items()}
        family.tell(highest, where=" at the upper ends of the ranges")
    solver = solver_of(family, names)
    fixed, sign = solver.base.held(policy), solver.base.sign
    ends = np.array([[float(span.low), float(span.high)] for span in spans.values()])
    every = np.arange(len(names))

    def worth(points: Floats) -> Floats:
        return np.asarray(sign * solver.values(points, [fixed])["value"][:, 0])

    def flipped(point: Floats, end: np.ndarray) -> Floats:
        """Return one point for each parameter, which is at its given end there."""
        points = np.tile(point, (len(names), 1))
        points[every, every] = ends[every, end]
        return points

    today = np.array([float(parameter.value) for parameter in spans])
    alone = [worth(flipped(today, np.full(len(names), end))) for end in (0, 1)]
    corner = (alone[1] < alone[0]).astype(int)
    least, corners = float(worth(ends[every, corner][None])[0]), 1
    while True:
        moved = worth(flipped(ends[every, corner], 1 - corner))
        corners += len(moved)
        best = int(moved.argmin())
        if moved[best] >= least:
            break
        corner[best], least = 1 - corner[best], float(moved[best])
    point = {
        parameter.name: span.high if end else span.low
        for (parameter, span), end in zip(spans.items(), corner.tolist(), strict=True)
    }
    there = family.at(point)
    return WorstPoint(
        point=point,
        value=finite_worth(there, fixed, "at the worst point found"),
        optimum=finite_optimum(there, "at the worst point found").start,
        corners=corners,
    )
