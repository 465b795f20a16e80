"""The optimum's value, and the values of given policies, at many draws of a model's parameters.

Every draw is a model of its own: it is solved to optimality (the policy re-optimised), and each
given policy is evaluated in it (the policy held fixed). Draws are done in blocks of a fixed size,
in any number of threads or processes, so that the same draws give the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING, Unpack

import numpy as np

from exact_mdp.analysis.vary.base_case import digest
from exact_mdp.analysis.vary.blocks import How, joined, run
from exact_mdp.analysis.vary.solver import (
    CareSolver,
    DrawSolver,
    models,
    solver_of,
    tell_cut,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.parametric import Parametric, parameter_of
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.care import cut_off
from exact_mdp.solvers.parallel import Arrays

if TYPE_CHECKING:
    from pandas import DataFrame


NOISE = 1e-9  # share of the values below which a spread is called rounding


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Sampled(Result):
    """Start values at every draw.

    Attributes
    ----------
    optimal : (D,)
        The policy re-optimised at each draw; units of reward.
    fixed : (D, N)
        Each policy held fixed.
    error : (D, N + 1)
        Bounds on the errors of `optimal` (column 0) and of each policy's value.
    sign : int
        -1 where values are costs, of which the least is best.
    """

    optimal: Floats
    fixed: Floats
    error: Floats
    sign: int = 1

    @property
    def regret(self) -> Floats:
        """(D, N) what holding each policy costs; 0 where the errors leave open whether it does."""
        lost = self.sign * (self.optimal[:, None] - self.fixed)
        return np.where(lost > self.error[:, :1] + self.error[:, 1:], lost, 0.0)

    @property
    def noise(self) -> float:
        """Least difference of two values that is more than rounding."""
        size = float(np.abs(self.optimal).max())
        return max(NOISE * size, 2 * float(self.error.max()))

    def frame(self) -> DataFrame:
        """Return one row for each draw: the optimum's value and each policy's (reward)."""
        import pandas

        policies = [f"policy {n} (reward)" for n in range(self.fixed.shape[1])]
        table = pandas.DataFrame(self.fixed, columns=policies)
        table.insert(0, "optimum (reward)", self.optimal)
        return table


def sampled(
    model: Parametric,
    names: Sequence[str],
    draws: Floats,
    policies: Sequence[PolicyLike] = (),
    **how: Unpack[How],
) -> Sampled:
    """Return the optimum's value and the policies' at every draw.

    Parameters
    ----------
    model : Parametric
    names : sequence of P str
        The parameters that are drawn; the others keep today's values.
    draws : (D, P) floats
        One row for each draw, a column for each name.
    policies : sequence of PolicyLike
        "optimal" is the optimum at today's values.
    **how
        n_jobs, folder and progress; see `solvers.parallel.many`.

    Returns
    -------
    Sampled

    Raises
    ------
    ModelError
        For no draws, unknown names, and values that the model cannot have; the first draw at
        fault is named.

    Examples
    --------
    >>> from exact_mdp import MDP
    >>> from exact_mdp.mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> model = moving(mdp, {"stay": [(0, 0)]})
    >>> found = sampled(model, ["stay"], np.array([[0.5], [0.75]]), ["optimal"])
    >>> found.optimal.round(9).tolist(), found.regret.tolist()
    ([2.0, 4.0], [[0.0], [0.0]])
    """
    names, draws, solver = tuple(names), _checked(model, names, draws), solver_of(model)
    weights = [solver.base.held(policy) for policy in policies]
    _, first = next(models(model, names, draws[:1], 0))
    size = solver.block // 2
    key = {
        "model": fingerprint(solver.base.mdp),
        "first_draw": fingerprint(first),  # two families may agree today and differ elsewhere
        "parameters": list(names),
        "draws": sha256(np.ascontiguousarray(draws, dtype="<f8").tobytes()).hexdigest(),
        "policies": [digest(weight) for weight in weights],
        "draws_per_file": size,
        "compiled": solver.compiled,
    }
    blocks = [(at, draws[at : at + size]) for at in range(0, len(draws), size)]
    if isinstance(solver, CareSolver):
        tell_cut(model, names, draws, cut_off(solver.scenario, names, draws))
    else:
        tell_cut(model, names, draws)
    found = joined(
        run(solver, "draws", partial(_block, solver, names, weights), blocks, key, **how)
    )
    value = found["value"]
    best, sign = value[:, 0], solver.base.sign
    return Sampled(optimal=best, fixed=value[:, 1:], error=found["error"], sign=sign)


def _block(
    solver: DrawSolver,
    names: tuple[str, ...],
    weights: Sequence[Floats],
    piece: tuple[int, Floats],
) -> Arrays:
    first, draws = piece
    return solver.values(names, draws, weights, optimum=True, first=first)


def _checked(model: Parametric, names: Sequence[str], draws: Floats) -> Floats:
    draws = np.asarray(draws, dtype=float)
    if draws.ndim != 2 or draws.shape[1] != len(names):
        raise ModelError(
            f"draws of shape {draws.shape} for {len(names)} parameters",
            where="draws",
            fix="give one row for each draw and a column for each parameter",
        )
    if not len(draws):
        raise ModelError("no draws", where="draws", fix="ask for at least 1")
    for column, name in enumerate(names):
        parameter = parameter_of(model, name)
        low = -np.inf if parameter.low is None else float(parameter.low)
        high = np.inf if parameter.high is None else float(parameter.high)
        drawn = draws[:, column]
        wrong = ~((drawn >= low) & (drawn <= high) & np.isfinite(drawn))
        if wrong.any():
            row = int(wrong.argmax())
            raise ModelError(
                f"{name} is {drawn[row]:.17g}, outside [{low:g}, {high:g}]",
                where=f"draw {row}",
                fix="draw within that range",
            )
    return draws
