"""The optimum's value, and what given policies are worth, at many draws of a model's parameters.

Every draw is a model of its own: it is solved to optimality (the policy re-optimised), and each
given policy is evaluated in it (the policy held fixed). Care scenarios go through compiled loops
that never form the model (`solvers.care`); any other model is built at each draw. Draws are
done in blocks of a fixed size, in any number of threads or processes, so that the same draws give
the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.analysis.sensitivity.base import BaseCase, digest
from exact_mdp.analysis.sensitivity.draws.solver import by_state
from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.fingerprint import fingerprint
from exact_mdp.mdp.parametric import Parametric, parameter_of
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers import evaluate, solve
from exact_mdp.solvers.care import MOST_STATUSES, cut_off
from exact_mdp.solvers.parallel.many import many

BLOCK = 32  # draws in a piece of work where each model is built: a fraction of a second
BATCH = 8192  # the same for the compiled loops
NOISE = 1e-9  # share of the values below which a spread is called rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class Sampled:
    """Start values at every draw.

    Attributes
    ----------
    optimal : (D,)
        The policy re-optimised at each draw; units of reward.
    fixed : (D, N)
        Each policy held fixed.
    error : (D, N + 1)
        Bounds on the errors of `optimal` (column 0) and of each policy's value.
    """

    optimal: Floats
    fixed: Floats
    error: Floats

    @property
    def regret(self) -> Floats:
        """(D, N) what holding each policy costs; 0 where the errors leave open whether it does."""
        lost = self.optimal[:, None] - self.fixed
        return np.where(lost > self.error[:, :1] + self.error[:, 1:], lost, 0.0)

    @property
    def noise(self) -> float:
        """Least difference of two values that is told from rounding."""
        size = float(np.abs(self.optimal).max())
        return max(NOISE * size, 2 * float(self.error.max()))


def sampled(
    model: Parametric,
    names: Sequence[str],
    draws: Floats,
    policies: Sequence[object] = (),
    *,
    n_jobs: int | None = 1,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: bool = False,
) -> Sampled:
    """Return the optimum's value and the policies' at every draw.

    Parameters
    ----------
    names : sequence of str
        The parameters that are drawn; the others keep today's values.
    draws : (D, P) floats
        One row for each draw, a column for each name.
    policies : sequence
        "optimal" at today's values, or anything that `solvers.evaluate` takes.
    n_jobs, scheduler, folder, progress
        See `solvers.parallel.many.many`.

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
    names, draws = tuple(names), _draws(model, names, draws)
    base = BaseCase(mdp=model.at({}))
    weights = [base.held(policy) for policy in policies]
    batch = isinstance(model, ScenarioFamily) and len(model.scenario.statuses) <= MOST_STATUSES
    size = BATCH if batch else BLOCK
    key = {
        "model": fingerprint(base.mdp),
        # Two families may agree today and differ elsewhere.
        "first_draw": fingerprint(_at(model, names, draws, 0)),
        "parameters": list(names),
        "draws": sha256(np.ascontiguousarray(draws, dtype="<f8")).hexdigest(),
        "policies": [digest(weight) for weight in weights],
        "draws_per_file": size,
        "compiled": batch,
    }
    blocks = [(first, draws[first : first + size]) for first in range(0, len(draws), size)]
    work = partial(_solve_block, model, names, weights)
    if batch:
        # Threads of this process share the loops; workers elsewhere take a block each.
        threads = 1 if scheduler is not None else n_jobs
        tables = np.array([by_state(base.mdp, model.scenario, weight) for weight in weights])
        work = partial(_solve_batch, model, names, tables, threads)
        n_jobs = 1 if scheduler is None else n_jobs
    if isinstance(model, ScenarioFamily):
        _tell(model, names, draws, batch=batch)
    done = many(
        work,
        blocks,
        key=key,
        n_jobs=n_jobs,
        scheduler=scheduler,
        folder=folder,
        progress=progress,
        what="draws",
    )
    parts = {name: np.concatenate([block[name] for block in done]) for name in done[0]}
    return Sampled(**parts)


def values(
    model: Parametric,
    names: Sequence[str],
    draws: Floats,
    policy: object = None,
    **how: Any,
) -> Floats:
    """Return (D,) the optimum's value at every draw, or a policy's.

    Examples
    --------
    >>> from exact_mdp import MDP
    >>> from exact_mdp.mdp.parametric import parametric
    >>> model = parametric(MDP.from_arrays([[[1]]], [1], "1/2"))
    >>> values(model, ["discount"], np.array([[0.5], [0.75]])).round(9).tolist()
    [2.0, 4.0]
    """
    if policy is None:
        return sampled(model, names, draws, **how).optimal
    return sampled(model, names, draws, [policy], **how).fixed[:, 0]


def _tell(model: ScenarioFamily, names: Sequence[str], draws: Floats, *, batch: bool) -> None:
    """Warn once where a chance is cut off at 1 in some draw; workers keep silent."""
    if not batch:
        model.tell(dict(zip(names, draws.max(axis=0).tolist(), strict=True)), where=", in draws")
        return
    cut = cut_off(model.scenario, names, draws)
    if cut.any():
        first = int(cut.argmax())
        where = f", {int(cut.sum())} of {len(draws)} draws, the first of them draw {first}"
        model.tell(dict(zip(names, draws[first].tolist(), strict=True)), where=where)


def _draws(model: Parametric, names: Sequence[str], draws: Floats) -> Floats:
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
        wrong = ~((draws[:, column] >= low) & (draws[:, column] <= high))
        wrong |= ~np.isfinite(draws[:, column])
        if wrong.any():
            row = int(wrong.argmax())
            raise ModelError(
                f"{name} is {draws[row, column]:.17g}, outside [{low:g}, {high:g}]",
                where=f"draw {row}",
                fix="draw within that range",
            )
    return draws


def _at(model: Parametric, names: Sequence[str], draws: Floats, row: int, first: int = 0) -> Any:
    try:
        return model.at(dict(zip(names, draws[row].tolist(), strict=True)))
    except ModelError as error:
        where = f"draw {first + row}, {error.where}"
        raise ModelError(error.what, where=where, fix=error.fix) from error


def _solve_block(
    model: Parametric,
    names: tuple[str, ...],
    weights: Sequence[Floats],
    piece: tuple[int, Floats],
) -> dict[str, Floats]:
    first, draws = piece
    value = np.empty((len(draws), 1 + len(weights)))
    error = np.empty_like(value)
    for row in range(len(draws)):
        mdp = _at(model, names, draws, row, first)
        best = solve(mdp).start
        held_fixed = [evaluate(mdp, weight) for weight in weights]
        value[row] = [best.value, *(each.mean for each in held_fixed)]
        error[row] = [best.error, *(each.error_bound for each in held_fixed)]
    return {"optimal": value[:, 0], "fixed": value[:, 1:], "error": error}


# ---- compiled loops ------------------------------------------------------------------------------


def _solve_batch(
    model: ScenarioFamily,
    names: tuple[str, ...],
    tables: Floats,
    threads: int | None,
    piece: tuple[int, Floats],
) -> dict[str, Floats]:
    from exact_mdp.solvers.care import optimal, policy_values

    _, draws = piece
    best = optimal(model.scenario, names, draws, threads=threads, warn=False)
    value, error = [best.start[:, None]], [best.error[:, None]]
    if len(tables):
        found = policy_values(model.scenario, names, draws, tables, threads=threads, warn=False)
        value.append(found.mean)
        error.append(np.broadcast_to(found.error[:, None], found.mean.shape))
    values = np.concatenate(value, axis=1)
    return {"optimal": values[:, 0], "fixed": values[:, 1:], "error": np.concatenate(error, axis=1)}
