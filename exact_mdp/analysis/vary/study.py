"""A study: the optimum and given policies at many points of a model's parameters, in one table.

A point gives values to some parameters; the others keep today's. In the model at each point the
optimum is found (the policy re-optimised) and each given policy is evaluated (held fixed).
Tornado, grid, Sobol indices and probabilistic analyses are designs of points and summaries of their
tables. A care scenario goes through batched loops that never form the model (`solvers.care`), small
models are solved many at once (`solvers.batch`), others one by one; blocks of points have a fixed
size, so that any number of workers gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from hashlib import sha256
from math import inf
from typing import Any, TypeAlias, Unpack

import numpy as np

from exact_mdp.analysis.vary.base_case import BaseCase, digest, finite_optimum, finite_worth
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError, listed
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.forms.numbers import float_array
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.policies.arrays import distinct
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import DataFrame, Result, data_frame
from exact_mdp.mdp.table import Floats, Integers, Numbers, exact
from exact_mdp.solvers.batch import Batch
from exact_mdp.solvers.bounds.gains import gains
from exact_mdp.solvers.care import MOST_ACTIONS, MOST_STATUSES, cut_off, optimal, policy_values
from exact_mdp.solvers.parallel import Arrays, How, folder_of, joined, many
from exact_mdp.solvers.solution import Solution, regrets
from exact_mdp.solvers.values.evaluate import evaluate

SHOWN = 3  # parameters of a point that an error names
KEPT = 2**24  # numbers of built models that are kept for the next question
ROOM = 2**21  # numbers that are worked on at once


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Study(Result):
    """The optimum and N given policies at D points of P parameters: values at the start."""

    names: tuple[str, ...]
    points: Numbers  # (D, P)
    optimal: Floats  # (D,) the policy re-optimised at each point
    fixed: Floats  # (D, N) each policy held fixed
    error: Floats  # (D, N + 1) bounds on the errors of `optimal`, and of each policy's value
    sign: int  # -1 where values are costs, of which the least is best
    rows: Integers  # (U, G) the optimal policies that were found, as the solver writes them
    which: Integers  # (D,) that of each point
    counts: Integers  # (X, A) points in which an action is optimal up to rounding, by label
    lost: Floats  # (D, A) cost of each first action, NaN if not offered; (D, 0): several starts
    cut: np.ndarray  # (D,) whether a chance was cut off at 1, of compiled solvers alone

    def __post_init__(self) -> None:
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array.setflags(write=False)

    @property
    def regret(self) -> Floats:
        """(D, N) what holding each policy costs; 0 where the errors leave open whether it does."""
        error = self.error[:, :1] + self.error[:, 1:]
        return regrets(self.optimal[:, None], self.fixed, error, self.sign)

    def values(self) -> DataFrame:
        """Return one row for each point: the optimum, each policy and its regret (reward)."""
        table = data_frame({"value": self.optimal})
        for number, (fixed, regret) in enumerate(zip(self.fixed.T, self.regret.T, strict=True)):
            end = f"_{number}" * (len(self.fixed.T) > 1)
            table[[f"fixed_value{end}", f"regret{end}"]] = np.column_stack([fixed, regret])
        table["error_bound"] = self.error[:, 0] + self.error[:, 1:].max(axis=1, initial=0.0)
        table["claim"] = "bounded"
        return table

    def frame(self) -> DataFrame:
        """Return one row for each point: its parameters, and what `values` says of it."""
        import pandas

        points = data_frame(self.points.astype(float), columns=list(self.names))
        return pandas.concat([points, self.values()], axis=1)


def study(
    model: Scenario | MDP | Parametric,
    points: Mapping[str, Sequence[object]] | DataFrame,
    policies: Sequence[PolicyLike] = ("optimal",),
    **how: Unpack[How],
) -> Study:
    """Return the optimum's value and the policies' at every point.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    points : {name: D numbers} or pandas.DataFrame
        A column for each parameter that is varied, a row for each point.
    policies : sequence of PolicyLike
        Held fixed at every point; "optimal" is the optimum at today's values.
    **how
        n_jobs, folder and progress; see `solvers.parallel.many`.

    Returns
    -------
    Study

    Raises
    ------
    ModelError
        For no points, unknown names, and values that the model cannot have.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> table = study(moving(mdp, {"stay": [(0, 0)]}), {"stay": [0.5, "3/4"]})
    >>> table.optimal.round(9).tolist(), table.regret.tolist()
    ([2.0, 4.0], [[0.0], [0.0]])
    """
    return study_of(parametric(model), points, policies, **how)[1]


def study_of(
    family: Parametric,
    points: Mapping[str, Sequence[object]] | DataFrame,
    policies: Sequence[PolicyLike],
    **how: Unpack[How],
) -> tuple[DrawSolver, Study]:
    """Return the study of a family, and the solver that it comes from."""
    if not isinstance(points, Mapping) and not hasattr(points, "columns"):
        fix = "give {name: numbers}, or a pandas.DataFrame"
        raise ModelError(f"{points!r:.60} is no table of points", where="points", fix=fix)
    names = tuple(points)
    table, draws = _checked(family, {name: _column(points[name]) for name in names})
    solver = solver_of(family, names)
    weights = [solver.base.held(policy) for policy in listed(policies, "policies")]
    size = max(1, solver.block // 2)
    key = {
        "parameters": list(names),
        "draws": sha256(np.ascontiguousarray(draws, dtype="<f8").tobytes()).hexdigest(),
        "policies": [digest(weight) for weight in weights],
    }
    return solver, Draws(solver, in_blocks(table, size), size, key, how).study(weights)


def in_blocks(points: Numbers, size: int) -> list[Numbers]:
    """Return points (D, P) in blocks of a size, of which the last may be smaller."""
    return [points[at : at + size] for at in range(0, len(points), size)]


def _column(numbers: Any) -> Numbers:
    """Return numbers as an array: of floats where all are, else as each of them was given."""
    column = np.asarray(numbers)
    return column if column.dtype.kind == "f" else np.array(listed(numbers, "points"), dtype=object)


def _checked(model: Parametric, columns: Mapping[str, Numbers]) -> tuple[Numbers, Floats]:
    """Return points (D, P), checked, as they are and as floats."""
    shapes = {column.shape for column in columns.values()}
    if len(shapes) != 1 or len(*shapes) != 1:
        raise ModelError(
            f"columns of shape {', '.join(map(str, sorted(shapes))) or 'none'}",
            where="points",
            fix="give one number for each point and parameter",
        )
    floats = all(column.dtype.kind == "f" for column in columns.values())
    points = np.column_stack([c if floats else c.astype(object) for c in columns.values()])
    if not len(points):
        raise ModelError("no points", where="points", fix="give at least one")
    if not floats:
        points = np.array([[exact(number, "points") for number in row] for row in points.tolist()])
    draws = float_array(points, "points")
    for name, drawn in zip(columns, draws.T, strict=True):
        parameter = parameter_of(model, name)
        low = -inf if parameter.low is None else float(parameter.low)
        high = inf if parameter.high is None else float(parameter.high)
        wrong = ~((drawn >= low) & (drawn <= high) & np.isfinite(drawn))
        if wrong.any():
            row, fault = int(wrong.argmax()), f"outside [{low:g}, {high:g}]"
            fault = fault if np.isfinite(drawn[row]) else "no finite number"
            raise ModelError(
                f"{name} is {drawn[row]:.17g}, {fault}",
                where=f"draw {row}",
                fix="draw finite numbers within its range",
            )
    return points, draws


@dataclass(frozen=True)
class Draws:
    """Points in blocks of a size, of which the last may be smaller, and where they are worked on.

    `key` tells these draws from others in a folder.
    """

    solver: DrawSolver
    blocks: Sequence[Numbers]
    size: int
    key: Mapping[str, object]
    how: How

    def study(self, policies: Sequence[Floats]) -> Study:
        """Return the study of the points and policies."""
        solver, points = self.solver, np.concatenate(self.blocks)
        if not solver.compiled:  # the largest numbers of all are looked at
            self._tell(points.max(axis=0), ", in draws")
        done = self._run("draws", partial(_block, solver, policies), {})
        whole = joined(done, ("start", "start_error", "value", "error", "lost", "cut"))
        if count := int(whole["cut"].sum()):
            first = int(whole["cut"].argmax())
            where = f", {count} of {len(points)} draws, the first of them draw {first}"
            self._tell(points[first], where)
        rows, places = distinct(np.concatenate([block["rows"] for block in done]))
        begins = np.cumsum([0, *(len(block["rows"]) for block in done[:-1])])
        own = [at + block["which"] for at, block in zip(begins, done, strict=True)]
        return Study(
            names=solver.names,
            points=points,
            optimal=whole["start"],
            fixed=whole["value"],
            error=np.column_stack([whole["start_error"], whole["error"]]),
            sign=solver.base.mdp.sign,
            rows=rows,
            which=places[np.concatenate(own)],
            counts=np.sum([block["counts"] for block in done], axis=0),
            lost=whole["lost"],
            cut=whole["cut"],
        )

    def _tell(self, row: Numbers, where: str) -> None:
        """Warn once of the chances of a scenario that are cut off at 1; workers keep silent."""
        if isinstance(self.solver.model, ScenarioFamily) and not self.solver.model.asks:
            values = dict(zip(self.solver.names, row.tolist(), strict=True))
            self.solver.model.tell(values, where=where)

    def with_policies(self, table: Study, policies: Sequence[Floats]) -> Study:
        """Return the study with the values of more policies."""
        mark, work = digest(*policies), partial(_held, self.solver, policies)
        more = joined(self._run(f"values-{mark[:12]}", work, {"policies": mark}))
        fixed = np.hstack([table.fixed, more["value"]])
        return replace(table, fixed=fixed, error=np.hstack([table.error, more["error"]]))

    def _run(
        self, what: str, work: Callable[[Any], Arrays], more: Mapping[str, object]
    ) -> list[Arrays]:
        """Do all blocks: compiled loops in threads, other models in processes.

        In a folder a smaller last one stands apart, so that larger samples can use the whole ones.
        """
        how: dict[str, Any] = {**self.how, "what": what, "threads": self.solver.compiled}
        pieces = [(at * self.size, draws) for at, draws in enumerate(self.blocks)]
        if how.get("folder") is None:
            return many(work, pieces, key={}, **how)
        how |= {"folder": folder_of(how["folder"]) / what, "key": {**self.record, **more}}
        full = sum(len(draws) == self.size for draws in self.blocks)
        last = ("work.json", f"last-{full}-{len(self.blocks[-1])}-")
        done = many(work, pieces[:full], **how)
        return done + many(work, pieces[full:], files=last, **how)

    @cached_property
    def record(self) -> dict[str, object]:
        """What tells the draws from others; their models may be the same today alone."""
        solver = self.solver
        first = next(models(solver.model, solver.names, self.blocks[0][:1], 0))
        marks = {"model": fingerprint(solver.base.mdp), "first_draw": fingerprint(first)}
        return {**marks, "compiled": solver.compiled, "block": self.size, **self.key}


def _block(solver: DrawSolver, policies: Sequence[Floats], piece: tuple[int, Numbers]) -> Arrays:
    return solver.solved(piece[1], piece[0]) | _held(solver, policies, piece)


def _held(solver: DrawSolver, policies: Sequence[Floats], piece: tuple[int, Numbers]) -> Arrays:
    first, draws = piece
    if not policies:
        return dict.fromkeys(("value", "error"), np.empty((len(draws), 0)))
    return solver.values(draws, policies, first)


# ---- models that are built -----------------------------------------------------------------------


def models(
    model: Parametric, names: Sequence[str], draws: Numbers, first: int | None = None
) -> Iterator[MDP]:
    """Yield each draw's model; an error names the draw, counted from `first`."""
    for d, row in enumerate(draws.tolist()):
        try:
            yield model.at(dict(zip(names, row, strict=True)))
        except ModelError as error:
            if first is None:
                raise
            raise ModelError(
                error.what,
                where=f"draw {first + d}, {_moved(model, names, row)}: {error.where}",
                fix="give distributions or ranges without such values (lognormal and gamma stay "
                f"above 0, beta between 0 and 1); else {error.fix}",
            ) from error


def _moved(model: Parametric, names: Sequence[str], row: Sequence[object]) -> str:
    """Return the parameters of a point in words, the first few of many that are moved."""
    today = {parameter.name: parameter.value for parameter in model.parameters}
    moved = [
        f"{name} = {x if isinstance(x, Fraction) else f'{x:g}'}"
        for name, x in zip(names, row, strict=True)
        if x != today[name]
    ]
    return ", ".join(moved[:SHOWN]) + ", …" * (len(moved) > SHOWN) or "today's parameters"


class _Part:
    """Models of some draws, worked on all at once where they can be, else one by one."""

    def __init__(self, models: list[MDP], at: Callable[[int], str]) -> None:
        self.models, self.at = models, at  # where a model is, in words, by its number
        batch = Batch.of(models)
        self.batch = None if batch is None or batch.weights is None else batch
        self.size = KEPT if self.batch is None else self.batch.rows.size  # numbers that are held
        self.sign = models[0].sign

    def optimum(self) -> tuple[Floats, Floats, Floats, Floats, Integers]:
        """Return start and error (D,), gap and doubt (D, L), and the actions (D, S)."""
        mdp = self.models[0]
        batch = None if self.batch is None else self.batch.optimum()
        if self.batch is None or batch is None:
            each = [self._optimum(d) for d in range(len(self.models))]
            start, error, gap, doubt, policy = map(np.array, zip(*each, strict=True))
            return start, error, gap, doubt, policy
        value, off, gap, doubt = batch
        start, error = self.batch.at_start(value, off)
        tied = np.where(gap <= doubt, np.arange(mdp.n_pairs), mdp.n_pairs)
        policy = mdp.pair_action[np.minimum.reduceat(tied, mdp.pair_offsets[:-1], axis=1)]
        return 0.0 + self.sign * start, error, gap, doubt, policy  # no -0.0

    def _optimum(self, d: int) -> tuple[float, float, Floats, Floats, Integers]:
        mdp = self.models[d]
        solution = finite_optimum(mdp, self.at(d))
        lost, noise = lost_by(mdp, solution)
        off = solution.state_error[mdp.pair_state]
        off = off + mdp.discount * (mdp.transition @ solution.state_error)
        taken = np.asarray(solution.policy)
        return solution.start.value, solution.start.error, lost, off + noise, taken

    def held(self, weights: Floats) -> tuple[Floats, Floats]:
        """Return the value at the start and its error (D,) of a policy (L,)."""
        if self.batch is not None:
            mean, error = self.batch.of_policy(weights)
            return 0.0 + self.sign * mean, error
        every = [finite_worth(mdp, weights, self.at(d)) for d, mdp in enumerate(self.models)]
        return np.array([x.value for x in every]), np.array([x.error for x in every])

    def totals(self, weights: Floats) -> Floats:
        """Return (D, C) the expected totals of the components under a policy (L,)."""
        if self.batch is not None:
            return self.batch.totals(weights)
        every = (evaluate(mdp, weights).components.values() for mdp in self.models)
        return np.array([[*each] for each in every])


def lost_by(mdp: MDP, solution: Solution) -> tuple[Floats, Floats]:
    """Return what each pair (L,) loses, and the rounding of that.

    States may be worth ±∞, though the start is not: a pair that leads to -∞ is worth that, else one
    that leads to +∞ that; it loses nothing where its state is worth the same.
    """
    value, here = solution.value, mdp.pair_state
    far = np.isinf(value)
    known = np.where(far, 0.0, value)
    gap = mdp.sign * (known[here] - mdp.backup(known))
    if far.any():
        ahead = np.zeros(mdp.n_pairs)
        for sign in (inf, -inf):
            ahead[mdp.transition @ (value == sign).astype(float) > 0] = sign
        off = far[here] | np.isinf(ahead)
        gap[off] = np.where(value[here] == ahead, 0.0, inf)[off]
    return gap, gains(mdp, known).noise


class ModelSolver:
    """Models that are built; labels are the states in which there is a choice.

    `names` are the parameters that draws (D, Q) give, `base` is today's model, to whose pairs
    policies refer.
    """

    block, pool = 64, 32  # draws in a piece of work; of largest regret, which choose candidates
    compiled = False  # or threads can share the work

    def __init__(self, model: Parametric, names: Sequence[str]) -> None:
        self.model, self.names = model, tuple(names)
        mdp = model.at({})
        self.base, self.actions = BaseCase(mdp=mdp), mdp.actions
        self.choosing = np.flatnonzero(~mdp.forced)
        self.labels = tuple(mdp.space.labels(self.choosing))
        self.built: dict[str, list[_Part]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"built": {}}

    def parts(self, draws: Numbers, first: int | None) -> Iterator[_Part]:
        """Yield the models of draws; what was built of these draws before is used again."""
        key = repr(draws.tolist())
        if key in self.built:
            yield from self.built[key]
            return
        size = max(1, ROOM // (self.base.mdp.n_pairs * self.base.mdp.n_states))
        made: list[_Part] = []
        for at in range(0, len(draws), size):
            some, start = draws[at : at + size], None if first is None else first + at
            built = [*models(self.model, self.names, some, start)]
            made.append(_Part(built, partial(self._at, some, start)))
            yield made[-1]
        if sum(part.size for parts in (made, *self.built.values()) for part in parts) <= KEPT:
            self.built[key] = made

    def _at(self, draws: Numbers, first: int | None, d: int) -> str:
        words = _moved(self.model, self.names, draws[d].tolist())
        return words if first is None or len(self.names) <= SHOWN else f"draw {first + d}, {words}"

    def solved(self, draws: Numbers, first: int | None = None) -> Arrays:
        """Return the optima of (D, Q) draws: start, start_error (D,), and others as in `Study`."""
        mdp, optima = self.base.mdp, [part.optimum() for part in self.parts(draws, first)]
        start, error, gap, doubt, policies = map(np.concatenate, zip(*optima, strict=True))
        rows, which = distinct(policies.astype(np.int32))
        counts = np.zeros((mdp.n_states, mdp.n_actions), dtype=np.int64)
        counts[mdp.pair_state, mdp.pair_action] = (gap <= doubt).sum(axis=0)
        begins = [state for state, _ in mdp.start]
        lost = np.full((len(gap), mdp.n_actions if len(begins) == 1 else 0), np.nan)
        if len(begins) == 1:
            here = mdp.pair_state == begins[0]
            lost[:, mdp.pair_action[here]] = np.maximum(gap[:, here], 0.0)
        return {
            "start": start,
            "start_error": error,
            "rows": rows,
            "which": which,
            "counts": counts[self.choosing],
            "lost": lost,
            "cut": np.zeros(len(draws), dtype=bool),
        }

    def values(
        self, draws: Numbers, policies: Sequence[Floats], first: int | None = None
    ) -> Arrays:
        """Return value (D, N) and error (D, N) of N policies, each (L,) probabilities of pairs."""
        parts = self.parts(draws, first)
        every = [[part.held(weights) for weights in policies] for part in parts]
        value, error = np.concatenate(every, axis=2).swapaxes(0, 1)
        return {"value": value.T, "error": error.T}

    def totals(
        self, draws: Numbers, policies: Sequence[Floats], components: Sequence[str], first: int
    ) -> Floats:
        """Return (D, N, C) expected totals of some components of the reward under N policies."""
        known = self.base.mdp.component_names
        every = list[Floats]()
        for part in self.parts(draws, first):
            of = part.models[0].component_names
            if of != known:
                raise ModelError(
                    f"the model's components are {', '.join(of)} there, and "
                    f"{', '.join(known)} today",
                    where=f"draw {first + sum(map(len, every))}",
                    fix="make the model by a function that gives its components: Family(build=…)",
                )
            every.append(np.stack([part.totals(weights) for weights in policies], axis=1))
        totals = np.concatenate(every)[:, :, [known.index(name) for name in components]]
        if not np.isfinite(totals).all():
            raise ModelError(
                "a total is infinite",
                where=f"draw {first + int(np.argwhere(~np.isfinite(totals))[0][0])}",
                fix="give a discount below 1, or a number of steps (mdp.within(100))",
            )
        return totals

    def weights(self, row: Integers) -> Floats:
        """Return (L,) probabilities of pairs from a row of `solved`."""
        return self.base.taken(row)

    def row(self, weights: Floats) -> Integers | None:
        """Return the row of `solved` with probabilities of pairs (L,); None where they mix."""
        sure = np.flatnonzero(weights == 1)
        return self.base.mdp.pair_action[sure] if len(sure) == self.base.mdp.n_states else None

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """Return the action at each label, where the policy says one and the same there."""
        row = self.row(weights)
        if row is None:
            return None
        chosen = [self.actions[action] for action in row[self.choosing].tolist()]
        return dict(zip(self.labels, chosen, strict=True))


class CareSolver:
    """Batches of draws of a care scenario; labels are the statuses, at subtask 0, trial 0."""

    block, pool = 4096, 1000
    compiled = True

    def __init__(self, model: ScenarioFamily, names: Sequence[str]) -> None:
        self.model: Parametric = model
        self.names, self.scenario = tuple(names), model.scenario
        self.base = BaseCase(mdp=model.at({}))
        count = len(self.scenario.statuses)
        self.actions = self.scenario.actions
        self.labels = tuple(f"{number:0{count}b}" for number in range(2**count))
        self.sizes = tuple(column.size for column in self.base.mdp.space.columns)
        flags = self.sizes[2] if len(self.sizes) == 4 else 1
        self.shape = (self.sizes[0], self.scenario.trials, flags, 2**count)

    def solved(self, draws: Numbers, first: int | None = None) -> Arrays:
        """Return the optima of (D, Q) draws; see `ModelSolver.solved`."""
        draws = draws.astype(float)
        optima = optimal(self.scenario, self.names, draws)
        rows, which = distinct(optima.actions.reshape(len(draws), -1))
        return {
            "start": optima.start,
            "start_error": optima.error,
            "counts": (optima.gaps <= 2 * optima.error[:, None, None]).sum(axis=0),
            "lost": optima.gaps[:, 0],
            "rows": rows,
            "which": which,
            "cut": cut_off(self.scenario, self.names, draws),
        }

    def values(
        self, draws: Numbers, policies: Sequence[Floats], first: int | None = None
    ) -> Arrays:
        """Return value (D, N) and error (D, N) of N policies; see `ModelSolver.values`."""
        tables = np.stack([self.by_state(weights) for weights in policies])
        value, error = policy_values(self.scenario, self.names, draws.astype(float), tables)
        return {"value": value, "error": np.repeat(error[:, None], len(tables), axis=1)}

    def weights(self, row: Integers) -> Floats:
        """Return (L,) probabilities of pairs from a row of `solved`."""
        mdp = self.base.mdp
        whole = np.zeros((self.shape[0], self.sizes[1], *self.shape[2:]), dtype=np.int64)
        whole[:, : self.shape[1]] = np.reshape(row, self.shape)
        choice = np.append(whole.reshape(-1), np.zeros(mdp.n_states - whole.size, dtype=np.int64))
        return self.base.taken(choice)

    def row(self, weights: Floats) -> Integers | None:
        """Return the row of `solved` with probabilities of pairs (L,); None where they mix."""
        table = self.by_state(weights)
        return table.argmax(axis=-1).reshape(-1) if (table.max(axis=-1) == 1).all() else None

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """Return the action at each label, where the policy says one and the same there."""
        row = self.row(weights)
        if row is None or np.ptp(stages := row.reshape(-1, len(self.labels)), axis=0).any():
            return None
        return {label: self.actions[a] for label, a in zip(self.labels, stages[0], strict=True)}

    def by_state(self, weights: Floats) -> Floats:
        """Return (K, trials, flags, V, A) probabilities of actions from (L,) ones of pairs.

        K subtasks, V status vectors; flags are two where a reading remembers skips, else one.
        """
        mdp = self.base.mdp
        table = np.zeros((mdp.n_states, mdp.n_actions))
        table[mdp.pair_state, mdp.pair_action] = weights
        shape = (self.shape[0], self.sizes[1], *self.shape[2:])
        table = table[: mdp.space.regular].reshape(*shape, mdp.n_actions)
        numbers = [mdp.action(name) for name in self.scenario.actions]
        # A last trial in which a skip is the only action is not a trial of the loops.
        return table[:, : self.shape[1]][..., numbers]


DrawSolver: TypeAlias = ModelSolver | CareSolver


def solver_of(model: Parametric, names: Sequence[str]) -> DrawSolver:
    """Return the fastest way to solve a model at many draws of some parameters."""
    if isinstance(model, ScenarioFamily) and not model.asks:
        scenario = model.scenario
        if len(scenario.statuses) <= MOST_STATUSES and len(scenario.actions) <= MOST_ACTIONS:
            return CareSolver(model, names)
    return ModelSolver(model, names)
