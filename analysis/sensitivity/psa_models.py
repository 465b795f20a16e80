"""Solving a model at many draws of its parameters, and evaluating policies there.

A care scenario goes through the batched loops (`solvers.care_batch`); any other parametric model is
built, solved and evaluated draw by draw. Both answer with the same arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from mdp.model import MDP
from mdp.parametric import Parametric
from mdp.scenario import Scenario
from mdp.scenario_family import ScenarioFamily
from mdp.table import Floats, Integers
from solvers import evaluate, solve
from solvers.care_batch import optimal, policy_values
from solvers.care_layout import MOST_ACTIONS, MOST_STATUSES, cut_off
from solvers.many import many
from solvers.policy_chain import PolicyChain
from solvers.solution import Solution

Arrays = dict[str, np.ndarray]


class Solver(Protocol):
    """What a probabilistic analysis asks of a model.

    Attributes
    ----------
    mdp : MDP
        The model at today's values.
    block, pool : int
        Draws in one piece of work, and draws of largest regret in which policies are compared to
        choose candidates.
    compiled : bool
    labels, actions : tuples of X and A words
        Where choices are told of, and between what.
    """

    mdp: MDP
    block: int
    pool: int
    compiled: bool
    labels: tuple[str, ...]
    actions: tuple[str, ...]

    def solved(self, names: Sequence[str], draws: Floats) -> Arrays:
        """Return the optima of (D, Q) draws.

        start, error (D,); best (X, A), draws in which an action is optimal up to rounding; lost
        (D, A), what each first action costs, NaN where it is not offered, (D, 0) where there is
        more than one first state; rows (U, G), the policies found, and which (D,) of them is a
        draw's; cut (D,), whether a chance was cut off at 1, of compiled solvers alone.
        """

    def values(self, names: Sequence[str], draws: Floats, policies: Sequence[Floats]) -> Arrays:
        """Return value (D, N) and error (D, N) of N policies, each (L,) probabilities of pairs."""

    def weights(self, row: Integers) -> Floats:
        """Return (L,) probabilities of pairs from a row of `solved`."""

    def held(self, policy: object) -> Floats:
        """Return (L,) probabilities of pairs; "optimal" is the optimum at today's values."""

    def today(self) -> float:
        """Return V* of the start at today's values."""

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """Return the action at each label, where the policy says one and the same there."""


def solver_of(model: Parametric) -> Solver:
    """Return the fastest way to solve a model at many draws."""
    if isinstance(model, ScenarioFamily):
        scenario = model.scenario
        if len(scenario.statuses) <= MOST_STATUSES and len(scenario.actions) <= MOST_ACTIONS:
            return CareSolver(model)
    return ModelSolver(model)


class CareSolver:
    """Batches of draws of a care scenario; labels are the statuses, at subtask 0, trial 0."""

    block, pool = 4096, 1000
    compiled = True

    def __init__(self, model: ScenarioFamily) -> None:
        self.model = model
        self.scenario: Scenario = model.scenario
        self.mdp = model.at({})
        count = len(self.scenario.statuses)
        self.actions = self.scenario.actions
        self.labels = tuple(f"{number:0{count}b}" for number in range(2**count))
        space = self.mdp.space
        self.sizes = tuple(column.size for column in space.columns)
        flags = self.sizes[2] if len(self.sizes) == 4 else 1
        self.shape = (self.sizes[0], self.scenario.trials, flags, 2**count)

    def solved(self, names: Sequence[str], draws: Floats) -> Arrays:
        """See `Solver.solved`."""
        found = optimal(self.scenario, names, draws, gaps=True, actions=True, threads=1)
        assert found.gaps is not None
        assert found.actions is not None
        best = (found.gaps <= 2 * found.error[:, None, None]).sum(axis=0)
        rows, which = distinct(found.actions.reshape(len(draws), -1))
        return {
            "start": found.start,
            "error": found.error,
            "best": best,
            "lost": found.gaps[:, 0],
            "rows": rows,
            "which": which,
            "cut": cut_off(self.scenario, names, draws),
        }

    def values(self, names: Sequence[str], draws: Floats, policies: Sequence[Floats]) -> Arrays:
        """See `Solver.values`."""
        tables = [self._table(weights) for weights in policies]
        value = np.empty((len(draws), len(tables)))
        error = np.zeros((len(draws), len(tables)))
        kinds: dict[tuple[bool, bool], list[int]] = {}
        for number, table in enumerate(tables):
            pure = bool((table.max(axis=-1) == 1).all())
            same = bool((table == table[:1, :1, :1]).all())
            kinds.setdefault((pure, same), []).append(number)
        for (pure, same), numbers in kinds.items():
            chosen = np.stack([tables[number] for number in numbers])
            chosen = chosen[:, 0, 0, 0] if same else chosen
            chosen = chosen.argmax(axis=-1) if pure else chosen
            found = policy_values(self.scenario, names, draws, chosen, threads=1)
            value[:, numbers], error[:, numbers] = found.mean, found.error[:, None]
        return {"value": value, "error": error}

    def _table(self, weights: Floats) -> Floats:
        """Return (K, trials, flags, V, A) probabilities of actions."""
        mdp = self.mdp
        full = np.zeros((mdp.n_states, mdp.n_actions))
        full[mdp.pair_state, mdp.pair_action] = weights
        full = full[: mdp.space.regular].reshape(self.shape[0], -1, *self.shape[2:], mdp.n_actions)
        return full[:, : self.shape[1], ..., : len(self.actions)]

    def weights(self, row: Integers) -> Floats:
        """See `Solver.weights`."""
        mdp = self.mdp
        whole = np.zeros((self.shape[0], self.sizes[1], *self.shape[2:]), dtype=np.int64)
        whole[:, : self.shape[1]] = np.reshape(row, self.shape)
        choice = np.append(whole.reshape(-1), np.zeros(mdp.n_states - whole.size, dtype=np.int64))
        return _taken(mdp, choice)

    def held(self, policy: object) -> Floats:
        """See `Solver.held`."""
        return _held(self.mdp, self.solution, policy)

    @cached_property
    def solution(self) -> Solution:
        """The optimum at today's values."""
        return solve(self.mdp)

    def today(self) -> float:
        """See `Solver.today`."""
        return self.solution.start_value

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """See `Solver.shown`."""
        table = self._table(weights)
        if not ((table == table[:1, :1, :1]).all() and (table.max(axis=-1) == 1).all()):
            return None
        chosen = table[0, 0, 0].argmax(axis=-1)
        return {
            label: self.actions[number] for label, number in zip(self.labels, chosen, strict=True)
        }


class ModelSolver:
    """One draw after the other; labels are the states in which there is a choice."""

    block, pool = 64, 32
    compiled = False

    def __init__(self, model: Parametric) -> None:
        self.model = model
        self.mdp = model.at({})
        self.actions = self.mdp.actions
        self.choosing = np.flatnonzero(~self.mdp.forced)
        self.labels = tuple(self.mdp.space.labels(self.choosing))

    def solved(self, names: Sequence[str], draws: Floats) -> Arrays:
        """See `Solver.solved`."""
        mdp, count = self.mdp, len(draws)
        start, error = np.empty(count), np.empty(count)
        best = np.zeros((mdp.n_states, mdp.n_actions), dtype=np.int64)
        first = [state for state, _ in mdp.start]
        lost = np.full((count, mdp.n_actions if len(first) == 1 else 0), np.nan)
        policies = np.empty((count, mdp.n_states), dtype=np.int16)
        for d, row in enumerate(draws.tolist()):
            drawn = self.model.at(dict(zip(names, row, strict=True)))
            solution = solve(drawn)
            start[d], error[d] = solution.start_value, solution.start_error_bound
            gap = solution.value[mdp.pair_state] - solution.q
            size = float(np.abs(solution.value).max())
            near = gap <= 3 * solution.error_bound + 1e-12 * size
            best[mdp.pair_state[near], mdp.pair_action[near]] += 1
            policies[d] = solution.policy
            if len(first) == 1:
                here = mdp.pair_state == first[0]
                lost[d, mdp.pair_action[here]] = np.maximum(gap[here], 0.0)
        rows, which = distinct(policies)
        return {
            "start": start,
            "error": error,
            "best": best[self.choosing],
            "lost": lost,
            "rows": rows,
            "which": which,
            "cut": np.zeros(count, dtype=bool),
        }

    def values(self, names: Sequence[str], draws: Floats, policies: Sequence[Floats]) -> Arrays:
        """See `Solver.values`."""
        value = np.empty((len(draws), len(policies)))
        error = np.empty_like(value)
        for d, row in enumerate(draws.tolist()):
            drawn = self.model.at(dict(zip(names, row, strict=True)))
            for n, weights in enumerate(policies):
                found = evaluate(drawn, weights)
                value[d, n], error[d, n] = found.mean, found.error_bound
        return {"value": value, "error": error}

    def weights(self, row: Integers) -> Floats:
        """See `Solver.weights`."""
        return _taken(self.mdp, row)

    def held(self, policy: object) -> Floats:
        """See `Solver.held`."""
        return _held(self.mdp, self.solution, policy)

    @cached_property
    def solution(self) -> Solution:
        """The optimum at today's values."""
        return solve(self.mdp)

    def today(self) -> float:
        """See `Solver.today`."""
        return self.solution.start_value

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """See `Solver.shown`."""
        mdp, found = self.mdp, {}
        for state, label in zip(self.choosing.tolist(), self.labels, strict=True):
            pairs = mdp.pairs_of(state)
            share = weights[list(pairs)]
            if share.max() != 1:
                return None
            found[label] = mdp.actions[int(mdp.pair_action[pairs[int(share.argmax())]])]
        return found


def distinct(rows: Integers) -> tuple[Integers, Integers]:
    """Return the (U, G) different rows of (D, G) small integers, and (D,) which of them each is.

    Rows are told apart by two 64-bit sums of random odd multiples; that two rows which differ have
    both sums in common is about as likely as guessing a number of 128 bits.
    """
    width = rows.shape[1] * rows.dtype.itemsize
    padded = np.zeros((len(rows), -(-width // 8) * 8), dtype=np.uint8)
    padded[:, :width] = np.ascontiguousarray(rows).view(np.uint8)
    words = padded.view(np.uint64)
    keys = np.random.default_rng(0).integers(0, 2**63, size=(words.shape[1], 2), dtype=np.uint64)
    sums = words @ (2 * keys + 1)
    both = np.ascontiguousarray(sums).view([("a", np.uint64), ("b", np.uint64)]).reshape(-1)
    _, where, inverse = np.unique(both, return_index=True, return_inverse=True)
    order = np.argsort(where)
    place = np.empty(len(order), dtype=np.int32)
    place[order] = np.arange(len(order))
    return rows[where[order]], place[inverse.reshape(-1)]


def merged(blocks: Sequence[Mapping[str, np.ndarray]]) -> tuple[Integers, Integers]:
    """Return the different rows of several blocks, in order of appearance, and each draw's."""
    found: dict[bytes, int] = {}
    rows, which = [], []
    for block in blocks:
        places = []
        for row in np.ascontiguousarray(block["rows"]):
            places.append(found.setdefault(row.tobytes(), len(found)))
            if places[-1] == len(rows):
                rows.append(row)
        which.append(np.array(places, dtype=np.int64)[block["which"]])
    return np.stack(rows), np.concatenate(which)


def _held(mdp: MDP, optimum: Solution, policy: object) -> Floats:
    """Return (L,) probabilities of pairs of a policy that is held fixed."""
    if isinstance(policy, str) and policy == "optimal":
        weights = np.zeros(mdp.n_pairs)
        weights[optimum.pairs] = 1.0
        return weights
    return PolicyChain.of(mdp, policy).chosen


def _taken(mdp: MDP, choice: Integers) -> Floats:
    """Return (L,) 1 for the pairs that (S,) action numbers take; a state's only pair always."""
    taken = mdp.pair_action == np.asarray(choice)[mdp.pair_state]
    return np.where(mdp.forced[mdp.pair_state], 1.0, taken.astype(float))


def run(
    solver: Solver,
    what: str,
    work: Callable[[Any], Arrays],
    pieces: Sequence[Any],
    key: Mapping[str, object],
    *,
    n_jobs: int | None = 1,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: bool = False,
) -> list[Arrays]:
    """Do pieces of work: compiled loops in threads, other models in processes."""
    settings = {
        "key": dict(key),
        "n_jobs": n_jobs,
        "scheduler": scheduler,
        "folder": None if folder is None else Path(folder) / what,
        "progress": progress,
        "what": what,
    }
    if solver.compiled and scheduler is None and n_jobs != 1:
        from joblib import parallel_config

        with parallel_config(backend="threading"):
            return many(work, pieces, **settings)
    return many(work, pieces, **settings)
