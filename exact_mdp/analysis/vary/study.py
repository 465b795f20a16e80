"""A study: the optimum and given policies at many points of a model's parameters, in one table.

A point gives values to some parameters; the others keep today's values. At each point the optimum
is found (the policy re-optimised) and each given policy is evaluated (held fixed). Tornado, grid,
Sobol indices and probabilistic analyses are designs of points and summaries of their tables. They
compare values, so infinite ones, at discount 1, are refused. The models of many points are one
stacked model where that is possible (`solvers.stacked`), and care scenarios are stacked without
them (`solvers.care`); other models are solved one by one. Blocks of points have a fixed
size, so that any number of workers gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from hashlib import sha256
from math import isinf
from typing import Any, ClassVar, TypeVar, Unpack

import numpy as np

from exact_mdp.analysis.vary.ranges import read_points
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import (
    DistributionError,
    ModelError,
    annotate_errors,
    join_few,
    locate_errors,
    require_list,
)
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.parametric.row_change import check_alike
from exact_mdp.mdp.policies.arrays import find_distinct_rows
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.questions.advice import warn_of_zero_reward
from exact_mdp.mdp.report import format_cell
from exact_mdp.mdp.result import DataFrame, Result, data_frame
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.table import BLOCK, MOST_BYTES, Floats, Integers, Numbers
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.arguments import OfCriterion, is_average
from exact_mdp.solvers.bounds.gains import component_errors, compute_advantages
from exact_mdp.solvers.care import ScenarioStack
from exact_mdp.solvers.claims import Bounded, Claim, compute_regrets
from exact_mdp.solvers.endless.average import AverageSolution
from exact_mdp.solvers.parallel import Arrays, How, folder_of, join_blocks, run_pieces
from exact_mdp.solvers.solution import Solution
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.stacked import StackedModel
from exact_mdp.solvers.values.evaluate import Evaluation, evaluate
from exact_mdp.solvers.values.policy_chain import PolicyChain

KEPT = 2**24  # numbers of built models that are kept, 128 MB: building is often the longest part
HELD = "the policy held fixed"
Found = TypeVar("Found", Solution, Evaluation)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Study(OfCriterion, Result):
    """The optimum and N given policies at D points of P parameters: values at the start."""

    names: tuple[str, ...]
    points: Numbers  # (D, P)
    optimal: Floats  # (D,) the policy re-optimised at each point
    fixed: Floats  # (D, N) each policy held fixed
    error: Floats  # (D, N + 1) error bounds, of the optimum and of each policy's value
    sense: Sense  # of the values: the least cost is best
    rows: Integers  # (U, S) the distinct optimal policies, as action numbers
    which: Integers  # (D,) the row of each point's optimal policy
    counts: Integers  # (X, A) points in which an action is optimal up to rounding, by label
    lost: Floats  # (D, A) gap of each first action, NaN if not available; (D, 0) for many starts
    cut: np.ndarray  # (D,) whether a probability was cut off at 1; care scenarios only
    criterion: str = "total"  # or "average": all values are rewards per step

    claim: ClassVar[Claim] = Claim.BOUNDED

    def __repr__(self) -> str:
        return f"Study({len(self.points):,} points of {', '.join(self.names[:3])})"

    @property
    def regret(self) -> Floats:
        """(D, N) the regrets of the policies; 0 if they are within the error bounds."""
        error = self.error[:, :1] + self.error[:, 1:]
        return compute_regrets(self.optimal[:, None], self.fixed, error, self.sense)

    def bound_point_values(self, row: int) -> tuple[Bounded, Bounded]:
        """Return the optimum and the value of the first policy at a point."""
        off, own_off = self.error[row, :2].tolist()
        fixed = Bounded(value=float(self.fixed[row, 0]), error=own_off)
        return Bounded(value=float(self.optimal[row]), error=off), fixed

    def frame(self, names: Sequence[str] | None = None) -> DataFrame:
        """Return one row for each point: its parameters, the optimum, each policy and its regret.

        `names` are headings for the parameters, by default their names.
        """
        table = data_frame({"value": self.optimal})
        for number, (fixed, regret) in enumerate(zip(self.fixed.T, self.regret.T, strict=True)):
            end = ""
            if len(self.fixed.T) > 1:
                end = f"_{number}"
            table[[f"fixed_value{end}", f"regret{end}"]] = np.column_stack([fixed, regret])
        table["error_bound"] = self.error[:, 0] + self.error[:, 1:].max(axis=1, initial=0.0)
        table["claim"] = str(self.claim)
        for place, name in enumerate(self.names if names is None else names):
            column = self.points[:, place].astype(float)
            table.insert(place, name, column, allow_duplicates=True)
        return table


def study(
    model: Scenario | MDP | Parametric,
    points: Mapping[str, Sequence[object]] | DataFrame,
    policies: Sequence[PolicyLike] = ("optimal",),
    *,
    criterion: str = "total",
    **how: Unpack[How],
) -> Study:
    """Return the optimal value and the values of policies at every point.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
    points : {name: D numbers} or pandas.DataFrame
        A column for each parameter that is varied, a row for each point.
    policies : sequence of PolicyLike
        Policies held fixed at every point; "optimal" is the optimum at today's values.
    criterion : "total" or "average"
        Whether values are total rewards, or rewards per step in the long run.
    **how
        n_jobs, folder and progress; see `solvers.parallel.run_pieces`.

    Returns
    -------
    Study

    Raises
    ------
    ModelError
        Without points, for unknown names, and for values that the model cannot have.

    Examples
    --------
    >>> from exact_mdp.mdp.parametric import moving
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> table = study(moving(mdp, {"stay": [(0, 0)]}), {"stay": [0.5, "3/4"]})
    >>> table.optimal.round(9).tolist(), table.regret.tolist()
    ([2.0, 4.0], [[0.0], [0.0]])
    """
    if not isinstance(points, Mapping) and not hasattr(points, "columns"):
        fix = "give {name: numbers}, or a pandas.DataFrame"
        raise ModelError(f"{points!r:.60} is not a table of points", where="points", fix=fix)
    family, names = parametric(model), tuple(points)
    table = read_points(family, points)
    solver = solver_of(family, names, criterion)
    weights = [solver.hold_policy(policy) for policy in require_list(policies, "policies")]
    key = {
        "parameters": list(names),
        "draws": hash_policies(table),
        "policies": [hash_policies(weight) for weight in weights],
    }
    return StudyDraws(solver, table, max(1, solver.block // 2), key, how).run_study(weights)


def require_room_for_points(count: int, parameters: int, fix: str) -> None:
    """Raise ModelError if so many points of so many parameters do not fit in memory."""
    # Four copies of a float, at most, exist at a time.
    size = 4 * 8 * count * parameters
    if size > MOST_BYTES:
        raise ModelError(
            f"{count:,} points of {parameters} parameters take {size / 1e9:,.0f} GB of memory, "
            f"more than {MOST_BYTES / 1e9:g} GB",
            where="points",
            fix=fix,
        )


@dataclass(frozen=True)
class StudyDraws:
    """Points (D, P) to be studied in blocks; `key` distinguishes them from others in a folder."""

    solver: ModelSolver
    points: Numbers
    size: int
    key: Mapping[str, object]
    how: How

    def run_study(self, policies: Sequence[Floats]) -> Study:
        """Return the study of the points and policies."""
        solver, points = self.solver, self.points
        done = self._run_blocks("draws", partial(_solve_block, solver, policies), {})
        whole = join_blocks(done, ("start", "start_error", "value", "error", "lost", "cut"))
        # Workers do not warn: one warning says how many draws were cut off.
        count = int(whole["cut"].sum())
        if isinstance(solver, CareSolver) and count:
            first = int(whole["cut"].argmax())
            values = dict(zip(solver.names, points[first].tolist(), strict=True))
            where = f", {count} of {len(points)} draws, the first of them draw {first}"
            solver.model.warn_of_cutoffs(values, where=where)
        if not (whole["start"].any() or whole["value"].any()):
            warn_of_zero_reward(solver.mdp)
        # Each block numbers its own optimal policies; here equal ones of all blocks become one.
        rows, places = find_distinct_rows(np.concatenate([block["rows"] for block in done]))
        begins = np.cumsum([0, *(len(block["rows"]) for block in done[:-1])])
        own = [at + block["which"] for at, block in zip(begins, done, strict=True)]
        return Study(
            names=solver.names,
            points=points,
            optimal=whole["start"],
            fixed=whole["value"],
            error=np.column_stack([whole["start_error"], whole["error"]]),
            sense=solver.mdp.sense,
            rows=rows,
            which=places[np.concatenate(own)],
            counts=np.sum([block["counts"] for block in done], axis=0),
            lost=whole["lost"],
            cut=whole["cut"],
            criterion=solver.criterion,
        )

    def with_policies(self, table: Study, policies: Sequence[Floats]) -> Study:
        """Return the study extended by the values of more policies."""
        mark, work = hash_policies(*policies), partial(_evaluate_block, self.solver, policies)
        more = join_blocks(self._run_blocks(f"values-{mark[:12]}", work, {"policies": mark}))
        fixed = np.hstack([table.fixed, more["value"]])
        return replace(table, fixed=fixed, error=np.hstack([table.error, more["error"]]))

    def _run_blocks(
        self, what: str, work: Callable[[Any], Arrays], more: Mapping[str, object]
    ) -> list[Arrays]:
        """Run all blocks: draws of a care scenario in threads, other models in processes.

        In a folder each block has its size in its name, so that larger samples can reuse whole
        blocks.
        """
        solver, first = self.solver, range(0, len(self.points), self.size)
        pieces = [(at, self.points[at : at + self.size]) for at in first]
        how: dict[str, Any] = {**self.how, "what": what, "threads": solver.compiled, "key": {}}
        if how.get("folder") is not None:
            start = solver.model.at(dict(zip(solver.names, self.points[0].tolist(), strict=True)))
            how["folder"] = folder_of(how["folder"]) / what
            how["key"] = {
                "model": fingerprint(solver.mdp),
                "first_draw": fingerprint(start),  # models may be the same today alone
                "compiled": solver.compiled,
                "criterion": solver.criterion,
                "block": self.size,
                **self.key,
                **more,
            }
        names = [f"{at:08d}-{len(points)}" for at, points in pieces]
        return run_pieces(work, pieces, names=names, **how)


def _solve_block(
    solver: ModelSolver, policies: Sequence[Floats], piece: tuple[int, Numbers]
) -> Arrays:
    return solver.solve_draws(piece[1], piece[0]) | _evaluate_block(solver, policies, piece)


def _evaluate_block(
    solver: ModelSolver, policies: Sequence[Floats], piece: tuple[int, Numbers]
) -> Arrays:
    first, draws = piece
    if not policies:
        return dict.fromkeys(("value", "error"), np.empty((len(draws), 0)))
    return solver.evaluate_policies(draws, policies, first)


# ---- the models of some draws --------------------------------------------------------------------


class _Drawn:
    """The models of some draws, solved all at once if they can be stacked, else one by one.

    `mdp` is a model with the same pairs. `models` may be left out if the stacked model was made
    without them; `at` describes a draw in words, by its number. `cut` (D,) is whether a probability
    of a draw is cut off at 1. Infinite values are refused if values must be `finite`.
    """

    def __init__(
        self,
        mdp: MDP,
        stacked: StackedModel | None,
        models: Sequence[MDP] = (),
        at: Callable[[int], str] = "draw {}".format,
        cut: Flags | None = None,
        criterion: str = "total",
        *,
        finite: bool = True,
    ) -> None:
        self.mdp, self.stacked, self.models, self.at = mdp, stacked, models, at
        self.criterion, self.finite = criterion, finite
        self.cut = np.zeros(len(models), dtype=bool) if cut is None else cut
        self.size = KEPT  # numbers in memory: models that are not stacked are not kept
        if stacked is not None:
            self.size = stacked.size

    def solve_models(self) -> tuple[Floats, Floats, Floats, Floats, Integers]:
        """Return start and error (D,), gap and doubt (D, L), and the actions (D, S)."""
        mdp, optimum = self.mdp, None
        if self.stacked is not None:
            optimum = self.stacked.optimum()
        if self.stacked is None or optimum is None:
            solve_model = self._solve_model
            if is_average(self.criterion):
                solve_model = self._solve_average
            each = [solve_model(d) for d in range(len(self.models))]
            start, error, gap, doubt, policy = map(np.array, zip(*each, strict=True))
            return start, error, gap, doubt, policy
        value, off, gap, doubt = optimum
        start, error = self.stacked.at_start(value, off)
        # The optimal action of a state: the lowest number among ties.
        tied = np.where(gap <= doubt, np.arange(mdp.n_pairs), mdp.n_pairs)
        policy = mdp.pair_action[np.minimum.reduceat(tied, mdp.pair_offsets[:-1], axis=1)]
        return mdp.sense.orient(start), error, gap, doubt, policy

    def _solve_model(self, d: int) -> tuple[float, float, Floats, Floats, Integers]:
        mdp = self.models[d]
        if self.finite:
            solution = finite_optimum(mdp, self.at(d))
        else:
            solution = solve(mdp)
        here, ahead = solution.value[mdp.pair_state], mdp.backup(solution.value)
        # States may have infinite values although the start has not; a pair that may lead to both
        # infinities has the worst value.
        ahead[np.isnan(ahead)] = mdp.sense.worst
        lost = mdp.sense.losses(here, ahead)
        finite = np.where(np.isinf(solution.value), 0.0, solution.value)
        noise = compute_advantages(mdp, finite).noise
        off = solution.state_error[mdp.pair_state]
        off = off + mdp.discount * (mdp.transition @ solution.state_error)
        taken = np.asarray(solution.policy)
        return solution.start.value, solution.start.error, lost, off + noise, taken

    def _solve_average(self, d: int) -> tuple[float, float, Floats, Floats, Integers]:
        """Return the same of the average reward.

        A pair that keeps the gain of its state falls short by its loss of bias, r - g + P h < h.
        """
        mdp = self.models[d]
        step, here = mdp.undiscounted, mdp.pair_state
        solution = solve(mdp, criterion=self.criterion)
        assert isinstance(solution, AverageSolution)
        # The gain that a pair gives up, and the bias, with bounds on the errors of both.
        error, off = solution.state_error, solution.bias_error
        ahead = compute_advantages(step, solution.value, reward=np.zeros(mdp.n_pairs))
        gap = -mdp.sense.sign * ahead.value
        doubt = ahead.noise + error[here] + step.transition @ error
        once = mdp.sense.loss(solution.bias[here], solution.q)
        noise = compute_advantages(step, solution.bias).noise
        unsure = noise + 2 * error[here] + off[here] + step.transition @ off
        keeps = gap <= doubt
        gap, doubt = np.where(keeps, once, gap), np.where(keeps, unsure, doubt)
        return solution.start.value, solution.start.error, gap, doubt, np.asarray(solution.policy)

    def evaluate_policies(
        self, policies: Sequence[Floats], undecided: Sequence[Flags]
    ) -> tuple[Floats, Floats]:
        """Return the values at the start and their errors (D, N) of policies (N, L).

        Raises ModelError if a policy is silent in a state, among `undecided` (N, S), in which the
        action matters in some model.
        """
        for weights, silent in zip(policies, undecided, strict=True):
            self._require_said(weights, silent)
        if self.stacked is not None:
            mean, error = self.stacked.evaluate(policies)
            return self.mdp.sense.orient(mean), error
        value, error = np.empty((2, len(self.models), len(policies)))
        for d, mdp in enumerate(self.models):
            for n, weights in enumerate(policies):
                if self.finite or is_average(self.criterion):
                    found = finite_worth(mdp, weights, self.at(d), self.criterion)
                else:
                    found = evaluate(mdp, weights).start
                value[d, n], error[d, n] = found.value, found.error
        return value, error

    def compute_totals(
        self, weights: Floats, names: Sequence[str], undecided: Flags
    ) -> tuple[Floats, Floats]:
        """Return the expected totals (D, C) of components under a policy (L,), and errors."""
        self._require_said(weights, undecided)
        amounts = []
        for name in names:  # models may list their components in different orders
            columns = [mdp.components[:, mdp.component_names.index(name)] for mdp in self.models]
            amounts.append(np.stack(columns))
        stacked = self.stacked
        # A component that is counted in a terminal state goes on forever, which only the analysis
        # of a single model takes into account.
        if stacked is None or any(stacked.pays_at_end(each) for each in amounts):
            totals, errors = [], []
            for mdp in self.models:
                numbers = evaluate(mdp, weights).numbers
                row = [numbers[f"component.{name}"] for name in names]
                totals.append([number.value for number in row])
                errors.append([number.error for number in row])
            return np.array(totals), np.array(errors)
        # All models at once: each component in turn is the reward, known up to its error.
        off, each = [component_errors(mdp) for mdp in self.models], []
        for name, earned in zip(names, amounts, strict=True):
            own = []
            for mdp, parts in zip(self.models, off, strict=True):
                own.append(parts[:, mdp.component_names.index(name)])
            each.append(stacked.with_reward(earned, np.stack(own)).evaluate([weights]))
        value, error = zip(*each, strict=True)
        return np.hstack(value), np.hstack(error)

    def _require_said(self, weights: Floats, undecided: Flags) -> None:
        """Raise ModelError if a policy (L,) is silent in states (S,) where the action matters."""
        if undecided.any():
            for d, mdp in enumerate(self.models):
                PolicyChain.of(mdp, weights).require_said(undecided, self.at(d))


def hash_policies(*policies: Floats) -> str:
    """Return a hash of policies, each given by its probabilities of pairs (L,)."""
    content = b"".join(np.ascontiguousarray(each, dtype="<f8").tobytes() for each in policies)
    return sha256(content).hexdigest()


def finite_optimum(mdp: MDP, where: str, criterion: str = "total") -> Solution:
    """Return the optimum; raise ModelError if it is infinite at the start."""
    solution: Solution = solve(mdp, criterion=criterion)
    return _require_finite_start("the optimum", solution, mdp, where)


def finite_worth(mdp: MDP, policy: PolicyLike, where: str, criterion: str = "total") -> Bounded:
    """Return a policy's value at the start; raise ModelError if it is infinite."""
    if is_average(criterion):
        return evaluate(mdp, policy, criterion="average").start
    return _require_finite_start(HELD, evaluate(mdp, policy), mdp, where).start


def _require_finite_start(what: str, found: Found, mdp: MDP, where: str) -> Found:
    if isinf(found.start.value):
        ways = ["give a discount below 1 (--discount 0.95)"]
        # With a goal, a run that misses it is infinite after N steps, too.
        if not mdp.ends.has_goal:
            ways.append("a number of steps (--horizon N, mdp.within(N))")
        if what == HELD:
            ways.append("another policy")
        if not where.startswith("today"):
            ways.append("ranges in which every value is finite")
        raise ModelError(
            f"{what} is infinite, so nothing can be compared",
            where=f"the total at discount 1, {where}",
            fix=", or ".join(ways),
        )
    return found


class ModelSolver:
    """A solver of models at draws (D, Q) of the parameters `names`.

    `mdp` is the model at today's values. A policy is given by its probabilities of pairs (L,), as
    pairs are the same at all values. Values must be `finite`, or may be infinite. `labels` (X,)
    name the states in which a policy is reported, here the `reported` states, those with a choice;
    `place` (S,) is the label of each state, -1 for none. The first `choices` actions are reported.
    """

    block = 64  # draws in a piece of work
    together = 64  # draws in memory at the same time
    pool = 32  # draws of largest regret in which candidate policies are compared
    compiled = False  # whether threads can share the work

    def __init__(
        self,
        model: Parametric,
        names: Sequence[str],
        criterion: str = "total",
        *,
        finite: bool = True,
    ) -> None:
        self.model, self.names, self.mdp = model, tuple(names), model.at({})
        self.criterion, self.finite = criterion, finite
        forced = self.mdp.forced
        self.reported, self.choices = np.flatnonzero(~forced), self.mdp.n_actions
        self.labels = tuple(self.mdp.space.labels(self.reported))
        self.place = np.where(forced, -1, np.cumsum(~forced) - 1)
        self.drawn: dict[str, _Drawn] = {}
        self.undecided: dict[str, Flags] = {}  # by policy: the states in which it is silent

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {"drawn": {}}

    @cached_property
    def solution(self) -> Solution:
        """Today's optimum."""
        if self.finite:
            return finite_optimum(self.mdp, "today's parameters", self.criterion)
        solution: Solution = solve(self.mdp, criterion=self.criterion)
        return solution

    def hold_policy(self, policy: PolicyLike) -> Floats:
        """Return the probabilities of pairs (L,) of a policy; "optimal" is today's optimum."""
        if isinstance(policy, str) and policy == "optimal":
            policy = self.solution
        chain, undecided = PolicyChain.held_fixed(self.mdp, policy)
        self.undecided[hash_policies(chain.chosen)] = undecided
        return chain.chosen

    def _find_undecided_states(self, weights: Floats) -> Flags:
        """Return (S,) the states in which a policy (L,) is silent."""
        return self.undecided.get(hash_policies(weights), np.zeros(self.mdp.n_states, dtype=bool))

    def to_action_numbers(self, weights: Floats) -> Integers:
        """Return (S,) the action numbers of a policy (L,), -1 if it mixes."""
        row, sure = np.full(self.mdp.n_states, -1), np.flatnonzero(weights == 1)
        row[self.mdp.pair_state[sure]] = self.mdp.pair_action[sure]
        return row

    def describe_policy(self, weights: Floats) -> dict[str, str] | None:
        """Return the action at each label; None unless a policy takes one action at each."""
        here = self.place >= 0
        place, row = self.place[here], self.to_action_numbers(weights)[here]
        number = np.empty(len(self.labels), dtype=np.int64)
        number[place] = row
        if (row < 0).any() or (number[place] != row).any():
            return None
        chosen = [self.mdp.actions[action] for action in number.tolist()]
        return dict(zip(self.labels, chosen, strict=True))

    def _split_draws(self, draws: Numbers, first: int) -> Iterator[_Drawn]:
        """Yield the models of draws, some at a time, made once for repeated questions."""
        for begin in range(0, len(draws), self.together):
            some = draws[begin : begin + self.together]
            # The last models are kept, as several questions concern the same draws.
            if some.dtype == object:
                key = repr(some.tolist())
            else:
                key = hash_policies(some)
            made = self.drawn.get(key)
            if made is None:
                made = self._make_models(some, first + begin)
                # Models that do not fit in the memory for kept ones are made again next time.
                if sum(each.size for each in (made, *list(self.drawn.values()))) <= KEPT:
                    self.drawn[key] = made
            yield made

    def _make_models(self, draws: Numbers, first: int) -> _Drawn:
        """Return the models of draws."""
        models, at = [], partial(self._describe_draw, draws, first)
        for d, row in enumerate(draws.tolist()):
            try:
                where = at(d)
                with locate_errors(where), annotate_errors(where):
                    models.append(self.model.at(dict(zip(self.names, row, strict=True))))
                    check_alike(self.mdp, models[-1], start=len(self.mdp.start) == 1)
            except DistributionError as error:
                fix = "choose ranges, or distributions, all of whose numbers make a model: a "
                fix += "beta stays in [0, 1], a gamma and a log-normal above 0; draw "
                fix += "probabilities of one row together: rows={label: [names]}"
                raise type(error)(error.what, where=error.where, fix=fix) from error
        stacked = None
        if not is_average(self.criterion):
            stacked = StackedModel.of(models)
        return _Drawn(models[0], stacked, models, at, criterion=self.criterion, finite=self.finite)

    def _describe_draw(self, draws: Numbers, first: int, d: int) -> str:
        """Return the number of a draw and the first three parameters that it moves."""
        today = {parameter.name: parameter.value for parameter in self.model.parameters}
        moved = []
        for name, x in zip(self.names, draws[d].tolist(), strict=True):
            if x != today[name]:
                moved.append(f"{name} = {format_cell(x)}")
        words = join_few(moved, len(moved), most=3) or "today's parameters"
        return f"draw {first + d}, {words}"

    def solve_draws(self, draws: Numbers, first: int = 0) -> Arrays:
        """Return the optima of draws (D, Q): start, start_error (D,), and others as in `Study`."""
        mdp, parts, policies = self.mdp, list[Arrays](), list[Integers]()
        here = mdp.pair_state == mdp.start[0][0]
        counts = np.zeros((mdp.n_states, mdp.n_actions), dtype=np.int64)
        for drawn in self._split_draws(draws, first):
            start, error, gap, doubt, actions = drawn.solve_models()
            # A pair counts as optimal if its gap is within its error bound.
            counts[mdp.pair_state, mdp.pair_action] += (gap <= doubt).sum(axis=0)
            # The losses of first actions add up to a regret in a total alone.
            single = len(mdp.start) == 1 and not is_average(self.criterion)
            lost = np.full((len(gap), self.choices if single else 0), np.nan)
            if single:
                lost[:, mdp.pair_action[here]] = np.where(gap > doubt, gap, 0.0)[:, here]
            policies.append(actions.astype(np.int32))
            parts.append({"start": start, "start_error": error, "lost": lost, "cut": drawn.cut})
        rows, which = find_distinct_rows(np.concatenate(policies))
        counts = counts[self.reported, : self.choices]
        return join_blocks(parts) | {"rows": rows, "which": which, "counts": counts}

    def evaluate_policies(
        self, draws: Numbers, policies: Sequence[Floats], first: int = 0
    ) -> Arrays:
        """Return values and errors (D, N) of N policies, each given by probabilities (L,)."""
        undecided, parts = [self._find_undecided_states(weights) for weights in policies], []
        for drawn in self._split_draws(draws, first):
            value, error = drawn.evaluate_policies(policies, undecided)
            parts.append({"value": value, "error": error})
        return join_blocks(parts)

    def compute_totals(
        self, draws: Numbers, policies: Sequence[Floats], components: Sequence[str], first: int
    ) -> tuple[Floats, Floats]:
        """Return the totals (D, N, C) of some reward components under N policies, and errors."""
        drawn = self._make_models(draws, first)
        for d, mdp in enumerate(drawn.models):
            if not {*components} <= {*mdp.component_names}:
                raise ModelError(
                    f"the model's components are {', '.join(mdp.component_names)} there, and "
                    f"{', '.join(self.mdp.component_names)} today",
                    where=f"draw {first + d}",
                    fix="make the model by a function that gives its components: Family(build=…)",
                )
        every = [
            drawn.compute_totals(own, components, self._find_undecided_states(own))
            for own in policies
        ]
        totals, error = (np.stack(each, axis=1) for each in zip(*every, strict=True))
        if not np.isfinite(totals).all():
            raise ModelError(
                "a total is infinite, or not known",
                where=f"draw {first + int(np.argwhere(~np.isfinite(totals))[0][0])}",
                fix="give a discount below 1, or a number of steps (mdp.within(100))",
            )
        return totals, error


class CareSolver(ModelSolver):
    """A solver of draws of a care scenario; labels are the statuses at subtask 0, trial 0."""

    block, pool, compiled = 4096, 1000, True
    model: ScenarioFamily

    def __init__(self, model: ScenarioFamily, names: Sequence[str]) -> None:
        super().__init__(model, names)
        scenario, space = model.scenario, self.mdp.space
        states, statuses = np.arange(self.mdp.n_states), len(scenario.statuses)
        self.stack = ScenarioStack(scenario, self.mdp, names)
        self.together = max(1, min(self.together, BLOCK // self.stack.rows))
        # Skipping is the only action of a last trial that takes a timestep of its own.
        self.tried = (space.values("trial") < scenario.trials) & (states < space.regular)
        self.labels = tuple(f"{number:0{statuses}b}" for number in range(2**statuses))
        self.place = np.where(self.tried, states % len(self.labels), -1)
        self.reported, self.choices = np.arange(len(self.labels)), len(scenario.actions)

    def _make_models(self, draws: Numbers, first: int) -> _Drawn:
        """See `ModelSolver._make_models`; no model is built."""
        stacked, cut = self.stack.stack_draws(draws.astype(float))
        return _Drawn(self.mdp, stacked, cut=cut)


def solver_of(
    model: Parametric, names: Sequence[str], criterion: str = "total", *, finite: bool = True
) -> ModelSolver:
    """Return the fastest way to solve a model at many draws of some parameters."""
    if is_average(criterion):
        return ModelSolver(model, names, criterion)
    if isinstance(model, ScenarioFamily) and not model.asks:
        scenario = model.scenario
        # Six statuses have 4^6 transition probabilities for each action; actions are int8.
        if len(scenario.statuses) <= 6 and len(scenario.actions) <= 127:
            return CareSolver(model, names)
    return ModelSolver(model, names, finite=finite)
