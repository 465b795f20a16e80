"""Two parameters at once: which policy is optimal where, and what it is worth.

The model is solved at every point of a grid, the policy re-optimised; a policy that is held fixed
is evaluated beside it. Lines between points of the map are not proved; `thresholds` proves them
along one parameter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.sensitivity.base import BaseCase
from exact_mdp.analysis.sensitivity.ranges import Range, admitted, around, checked
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.chain import reachable
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers import evaluate, solve

if TYPE_CHECKING:
    from pandas import DataFrame

POINTS = 11


@dataclass(frozen=True, kw_only=True, eq=False)
class TwoWay:
    """Optimal policies over a grid of two parameters.

    Attributes
    ----------
    mdp : MDP
        The model at today's values.
    x, y : Parameter
    x_values, y_values : (X,), (Y,)
    value, fixed_value, error : (Y, X)
        Start value of the optimum and of the policy held fixed, and a bound on either's error.
    choices : (Y, X, S) int64
        Optimal action numbers; the lowest where floats cannot tell two apart.
    policy : (Y, X) int64
        Number of the policy on the states that it reaches, in order of appearance.
    """

    mdp: MDP
    x: Parameter
    y: Parameter
    x_values: Floats
    y_values: Floats
    value: Floats
    fixed_value: Floats
    error: Floats
    choices: Integers
    policy: Integers

    def frame(self) -> DataFrame:
        """Return one row for each point of the grid."""
        from pandas import DataFrame

        across, along = np.meshgrid(self.x_values, self.y_values)
        return DataFrame(
            {
                self.x.name: across.reshape(-1),
                self.y.name: along.reshape(-1),
                "policy (number)": self.policy.reshape(-1),
                "value, re-optimised (reward)": self.value.reshape(-1),
                "value, policy fixed (reward)": self.fixed_value.reshape(-1),
                "regret (reward)": np.maximum(self.value - self.fixed_value, 0.0).reshape(-1),
                "error bound (reward)": self.error.reshape(-1),
                "claim": "bounded",
            }
        )

    def actions_at(self, state: int) -> Integers:
        """Return (Y, X) the optimal action number in one state."""
        return self.choices[:, :, state]


def two_way(
    source: Scenario | MDP | Parametric,
    x: str,
    y: str,
    *,
    bounds: dict[str, Range | tuple[object, object]] | None = None,
    policy: object = "optimal",
    points: int = POINTS,
) -> TwoWay:
    """Return the map of the optimal policy over two parameters.

    Parameters
    ----------
    x, y : str
        Different parameters.
    bounds : {name: (low, high)}, optional
        Within today's value ± 20 % where left out.
    policy : "optimal" at today's values, or anything that `solvers.evaluate` takes
        The policy held fixed.
    points : int
        Along each side, evenly spaced, the ends included.

    Raises
    ------
    ModelError
        For unknown names, twice the same one, empty ranges, fewer than 2 points.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> rows = [(0, 0, [("1/2", 1, 4), ("1/2", 2, 0)]), (0, 1, [(1, 1, 1)])]
    >>> mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)]), (2, 0, [(1, 0, 0)])], "1/2")
    >>> found = two_way(
    ...     moving(mdp, {"p": [(0, 1)]}),
    ...     "p",
    ...     "discount",
    ...     points=2,
    ...     bounds={"p": ("1/10", "9/10"), "discount": (0, "1/2")},
    ... )
    >>> found.actions_at(0).tolist()
    [[1, 0], [1, 0]]
    """
    model = parametric(source)
    if x == y:
        raise ModelError(f"{x} twice", where="two-way", fix="name two different parameters")
    if points < 2:
        raise ModelError(f"{points} points", where="two-way", fix="ask for at least 2")
    axes = [parameter_of(model, name) for name in (x, y)]
    stated = checked(model, bounds or {})
    if odd := sorted(set(stated) - {x, y}):
        raise ModelError(
            f"a range of {odd[0]}", where="two-way", fix=f"give ranges of {x} and {y} alone"
        )
    spans = [stated.get(axis.name) or admitted(model, axis, around(axis)) for axis in axes]
    grids = [[s.low + (s.high - s.low) * k / (points - 1) for k in range(points)] for s in spans]
    base = model.at({})
    weights = BaseCase(mdp=base).held(policy)
    value, fixed, error = np.zeros((3, points, points))
    choices = np.zeros((points, points, base.n_states), dtype=np.int64)
    number = np.zeros((points, points), dtype=np.int64)
    known: dict[bytes, int] = {}
    for row, column in _progress(points):
        mdp = model.at({x: grids[0][column], y: grids[1][row]})
        solution = solve(mdp)
        mean = evaluate(mdp, weights).numbers["mean"]
        value[row, column], fixed[row, column] = solution.start_value, mean.value
        error[row, column] = solution.start_error_bound + mean.error
        choices[row, column] = solution.policy
        seen = reachable(mdp, pairs=solution.pairs) & ~mdp.forced
        key = np.where(seen, solution.policy, -1).tobytes()
        number[row, column] = known.setdefault(key, len(known))
    return TwoWay(
        mdp=base,
        x=axes[0],
        y=axes[1],
        x_values=np.array([float(v) for v in grids[0]]),
        y_values=np.array([float(v) for v in grids[1]]),
        value=value,
        fixed_value=fixed,
        error=error,
        choices=choices,
        policy=number,
    )


def _progress(points: int) -> list[tuple[int, int]]:
    from tqdm import tqdm

    places = [(row, column) for row in range(points) for column in range(points)]
    return tqdm(places, desc="two-way", disable=None, leave=False)
