"""Optima and policies' values at many draws of a care scenario, by batched loops.

The loops never form the model (`solvers.care_batch`), and take thousands of draws at once.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.sensitivity.base_case import BaseCase
from analysis.sensitivity.policy_rows import distinct
from mdp.model import MDP
from mdp.scenario import Scenario
from mdp.scenario_family import ScenarioFamily
from mdp.table import Floats, Integers
from solvers.care_batch import optimal, policy_values
from solvers.care_layout import cut_off
from solvers.pieces import Arrays


class CareSolver:
    """Batches of draws of a care scenario; labels are the statuses, at subtask 0, trial 0."""

    block, pool = 4096, 1000
    compiled = True

    def __init__(self, model: ScenarioFamily) -> None:
        self.scenario: Scenario = model.scenario
        self.base = BaseCase(mdp=model.at({}))
        count = len(self.scenario.statuses)
        self.actions = self.scenario.actions
        self.labels = tuple(f"{number:0{count}b}" for number in range(2**count))
        space = self.base.mdp.space
        self.sizes = tuple(column.size for column in space.columns)
        flags = self.sizes[2] if len(self.sizes) == 4 else 1
        self.shape = (self.sizes[0], self.scenario.trials, flags, 2**count)

    def solved(self, names: Sequence[str], draws: Floats) -> Arrays:
        """See `analysis.sensitivity.draw_solver.DrawSolver.solved`."""
        found = optimal(self.scenario, names, draws, gaps=True, actions=True, threads=1, warn=False)
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
        """See `analysis.sensitivity.draw_solver.DrawSolver.values`."""
        tables = [by_state(self.base.mdp, self.scenario, weights) for weights in policies]
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
            found = policy_values(self.scenario, names, draws, chosen, threads=1, warn=False)
            value[:, numbers], error[:, numbers] = found.mean, found.error[:, None]
        return {"value": value, "error": error}

    def weights(self, row: Integers) -> Floats:
        """See `analysis.sensitivity.draw_solver.DrawSolver.weights`."""
        mdp = self.base.mdp
        whole = np.zeros((self.shape[0], self.sizes[1], *self.shape[2:]), dtype=np.int64)
        whole[:, : self.shape[1]] = np.reshape(row, self.shape)
        choice = np.append(whole.reshape(-1), np.zeros(mdp.n_states - whole.size, dtype=np.int64))
        return self.base.taken(choice)

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """See `analysis.sensitivity.draw_solver.DrawSolver.shown`."""
        table = by_state(self.base.mdp, self.scenario, weights)
        if not ((table == table[:1, :1, :1]).all() and (table.max(axis=-1) == 1).all()):
            return None
        chosen = table[0, 0, 0].argmax(axis=-1)
        return {
            label: self.actions[number] for label, number in zip(self.labels, chosen, strict=True)
        }


def by_state(mdp: MDP, scenario: Scenario, weights: Floats) -> Floats:
    """Return (K, trials, flags, V, A) probabilities of actions from (L,) probabilities of pairs.

    K subtasks, V status vectors; flags are two where a reading remembers skips, else one.
    """
    sizes = {column.name: column.size for column in mdp.space.columns}
    shape = (sizes["subtask"], sizes["trial"], sizes.get("skipped", 1), sizes["status"])
    table = np.zeros((mdp.n_states, mdp.n_actions))
    table[mdp.pair_state, mdp.pair_action] = weights
    table = table[: mdp.space.regular].reshape(*shape, mdp.n_actions)
    numbers = [mdp.action(name) for name in scenario.actions]
    # A last trial in which a skip is the only action is no trial of the loops.
    return table[:, : scenario.trials][..., numbers]
