"""Optima and policies' values at many draws of any parametric model, one draw after the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.sensitivity.base_case import BaseCase
from analysis.sensitivity.policy_rows import distinct
from mdp.parametric import Parametric
from mdp.table import Floats, Integers
from solvers import evaluate, solve
from solvers.gains import gains
from solvers.pieces import Arrays


class ModelSolver:
    """One draw after the other; labels are the states in which there is a choice."""

    block, pool = 64, 32
    compiled = False

    def __init__(self, model: Parametric) -> None:
        self.model = model
        mdp = model.at({})
        self.base = BaseCase(mdp=mdp)
        self.actions = mdp.actions
        self.choosing = np.flatnonzero(~mdp.forced)
        self.labels = tuple(mdp.space.labels(self.choosing))

    def solved(self, names: Sequence[str], draws: Floats) -> Arrays:
        """See `analysis.sensitivity.draw_solver.DrawSolver.solved`."""
        mdp, count = self.base.mdp, len(draws)
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
            error_there = solution.state_error
            doubt = error_there[mdp.pair_state] + drawn.discount * (drawn.transition @ error_there)
            near = gap <= doubt + gains(drawn, solution.value).noise
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
        """See `analysis.sensitivity.draw_solver.DrawSolver.values`."""
        value = np.empty((len(draws), len(policies)))
        error = np.empty_like(value)
        for d, row in enumerate(draws.tolist()):
            drawn = self.model.at(dict(zip(names, row, strict=True)))
            for n, weights in enumerate(policies):
                found = evaluate(drawn, weights)
                value[d, n], error[d, n] = found.mean, found.error_bound
        return {"value": value, "error": error}

    def weights(self, row: Integers) -> Floats:
        """See `analysis.sensitivity.draw_solver.DrawSolver.weights`."""
        return self.base.taken(row)

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """See `analysis.sensitivity.draw_solver.DrawSolver.shown`."""
        mdp, found = self.base.mdp, {}
        for state, label in zip(self.choosing.tolist(), self.labels, strict=True):
            pairs = mdp.pairs_of(state)
            share = weights[list(pairs)]
            if share.max() != 1:
                return None
            found[label] = mdp.actions[int(mdp.pair_action[pairs[int(share.argmax())]])]
        return found
