"""Two parameters at once: which policy is optimal where, and its value.

The model is solved at every point of a grid, the policy re-optimised; a policy that is held fixed
is evaluated beside it. Nothing is known between the points of the grid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import tqdm

from exact_mdp.analysis.vary.base_case import BaseCase, finite_optimum, finite_worth
from exact_mdp.analysis.vary.one_way import grid
from exact_mdp.analysis.vary.ranges import ranges_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.chain import reachable
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats, Integers

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TwoWay(Pictured):
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
        import pandas

        across, along = np.meshgrid(self.x_values, self.y_values)
        lost = self.value - self.fixed_value
        lost = lost if self.mdp.sense == "max" else -lost
        return pandas.DataFrame(
            {
                self.x.name: across.reshape(-1),
                self.y.name: along.reshape(-1),
                "policy (number)": self.policy.reshape(-1),
                "value, re-optimised (reward)": self.value.reshape(-1),
                "value, policy fixed (reward)": self.fixed_value.reshape(-1),
                "regret (reward)": np.maximum(lost, 0.0).reshape(-1),
                "error bound (reward)": self.error.reshape(-1),
                "claim": "bounded",
            }
        )

    def actions_at(self, state: int) -> Integers:
        """Return (Y, X) the optimal action number in one state."""
        return self.choices[:, :, state]


def two_way(
    model: Scenario | MDP | Parametric,
    x: str,
    y: str,
    *,
    policy: PolicyLike = "optimal",
    ranges: Mapping[str, object] | None = None,
    relative: object | None = None,
    points: int = 11,
) -> TwoWay:
    """Return the map of the optimal policy over two parameters.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    x, y : str
        Different parameters.
    policy : PolicyLike
        The policy held fixed; "optimal" is the optimum at today's values.
    ranges : {name: (low, high)}, optional
        Today's value ± 20 % where left out, within what the model admits.
    relative : number, optional
        Another share than 20 %.
    points : int
        Along each side, evenly spaced, the ends included.

    Returns
    -------
    TwoWay

    Raises
    ------
    ModelError
        For unknown names, twice the same one, empty ranges, fewer than 2 points, and where a value
        is infinite.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> rows = [(0, 0, [("1/2", 1, 4), ("1/2", 2, 0)]), (0, 1, [(1, 1, 1)])]
    >>> mdp = MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)]), (2, 0, [(1, 0, 0)])], "1/2")
    >>> ranges = {"p": ("1/10", "9/10"), "discount": (0, "1/2")}
    >>> found = two_way(moving(mdp, {"p": [(0, 1)]}), "p", "discount", points=2, ranges=ranges)
    >>> found.actions_at(0).tolist()
    [[1, 0], [1, 0]]
    """
    family = parametric(model)
    if x == y:
        raise ModelError(
            f"both parameters are {x}", where="two-way", fix="name two different parameters"
        )
    if odd := sorted(set(ranges or {}) - {x, y}):
        raise ModelError(
            f"{odd[0]} has a range, and is neither of the two parameters",
            where="two-way",
            fix=f"give ranges of {x} and {y} alone",
        )
    spans = ranges_of(family, [x, y], ranges, relative)
    across, along = (grid(spans[name], points) for name in (x, y))
    base = BaseCase(mdp=family.at({}))
    held = base.held(policy)
    value, fixed, error = np.zeros((3, points, points))
    choices = np.zeros((points, points, base.mdp.n_states), dtype=np.int64)
    number = np.zeros((points, points), dtype=np.int64)
    known: dict[bytes, int] = {}
    places = list(product(range(points), repeat=2))
    for place in tqdm.tqdm(places, desc="two-way", disable=None, leave=False):
        mdp = family.at({x: across[place[1]], y: along[place[0]]})
        where = f"{x} = {across[place[1]]}, {y} = {along[place[0]]}"
        solution, mean = finite_optimum(mdp, where), finite_worth(mdp, held, where)
        value[place], fixed[place] = solution.start.value, mean.value
        error[place] = solution.start.error + mean.error
        choices[place] = solution.policy
        seen = reachable(mdp, pairs=solution.pairs) & ~mdp.forced
        key = np.where(seen, solution.policy, -1).tobytes()
        number[place] = known.setdefault(key, len(known))
    return TwoWay(
        mdp=base.mdp,
        x=parameter_of(family, x),
        y=parameter_of(family, y),
        x_values=np.array([float(at) for at in across]),
        y_values=np.array([float(at) for at in along]),
        value=value,
        fixed_value=fixed,
        error=error,
        choices=choices,
        policy=number,
    )
