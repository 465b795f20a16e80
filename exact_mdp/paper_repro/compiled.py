"""What the compiled model says of the tables of the paper: effects, losses and weights.

Every number is read back out of the compiled rows, as an exact rational, so that the paper is
compared with the model that the solvers use, not with the scenario file.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from exact_mdp import MDP, Policy, evaluate
from exact_mdp.paper_repro.paper import ACTIONS, BITS, STATUSES
from exact_mdp.paper_repro.silent_points import Reading


def list_outcomes(mdp: MDP, state: int, action: int) -> list[tuple[Fraction, int, Fraction]]:
    """Return the exact outcomes of an action: probability, next state, reward.

    A state with a single action has the outcomes of that action.
    """
    pairs = mdp.pairs_of(state)
    if len(pairs) == 1:
        pair = pairs[0]
    else:
        pair = mdp.pair(state, action)
    return list(mdp.table.row(pair))


def compute_status_distribution(
    mdp: MDP, vector: int, action: int, *, trial: int = 0
) -> dict[int, Fraction]:
    """Return the exact distribution of the status vector after an action in the first subtask."""
    state = mdp.space.index(subtask=0, trial=trial, status=vector)
    chances = dict.fromkeys(range(16), Fraction(0))
    for probability, following, _ in list_outcomes(mdp, state, action):
        chances[max(int(mdp.space.values("status", np.array([following]))[0]), 0)] += probability
    return chances


def compute_status_probability(
    mdp: MDP, vector: int, action: int, status: str, *, trial: int = 0
) -> Fraction:
    """Return the exact probability that a status is present next, from a status vector."""
    after = compute_status_distribution(mdp, vector, action, trial=trial)
    return sum((p for vector, p in after.items() if vector & BITS[status]), Fraction(0))


def compute_effect(mdp: MDP, source: str, target: str) -> Fraction:
    """Return the change of a status's probability if another status is present."""
    return compute_status_probability(mdp, BITS[source], 0, target) - compute_status_probability(
        mdp, 0, 0, target
    )


def compute_losses(reading: Reading, status: str, action: int) -> list[Fraction]:
    """Return the suboptimality gap of an action in each state with a status and a choice.

    All else is optimal: V(s) - Σ p (r + γ V(s')), exactly, by the certificate.
    """
    mdp, losses = reading.mdp, reading.certificate.losses[-1]
    here = (mdp.space.values("status") == int(status, 2)) & ~mdp.forced & ~mdp.terminal
    return [losses[mdp.pair(state, action)] for state in np.flatnonzero(here).tolist()]


def compute_costs(reading: Reading) -> np.ndarray:
    """Return the loss (16, 4) at the start of an action in a status, all else being optimal."""
    mdp, best = reading.mdp, reading.evaluate_policy("optimal").mean
    status, free = mdp.space.values("status"), ~mdp.forced & ~mdp.terminal
    lost = np.zeros((len(STATUSES), len(ACTIONS)))
    for vector, action in np.ndindex(lost.shape):
        if any(compute_losses(reading, STATUSES[vector], action)):  # exactly 0 where it is optimal
            other = np.where(free & (status == vector), action, reading.optimum)
            lost[vector, action] = best - evaluate(mdp, Policy.of(mdp, other)).mean
    return lost


def list_optimal_actions(reading: Reading, status: str) -> list[set[str]]:
    """Return the set of optimal actions of every state with a status and a choice."""
    by_action = [compute_losses(reading, status, action) for action in range(len(ACTIONS))]
    best = []
    for state in zip(*by_action, strict=True):
        best.append({name for name, lost in zip(ACTIONS, state, strict=True) if lost == 0})
    return best


def list_rewards(reading: Reading) -> list[tuple[int, int, int, bool, Fraction]]:
    """Return action, next status, subtask, whether it is completed, and reward of outcomes.

    Only outcomes of positive probability from a trial before the last one are listed: no subtask is
    skipped there, so the next status can be read off the next state.
    """
    mdp, rows = reading.mdp, []
    trial, subtask, status = (mdp.space.values(name) for name in ("trial", "subtask", "status"))
    before = ~mdp.terminal & ~mdp.forced & (trial < reading.scenario.trials - 1)
    for state in np.flatnonzero(before).tolist():
        for action in range(len(ACTIONS)):
            for probability, following, gain in list_outcomes(mdp, state, action):
                if probability:
                    ended = bool(mdp.terminal[following])
                    done = ended or bool(subtask[following] != subtask[state])
                    if ended:
                        after = 0
                    else:
                        after = int(status[following])
                    rows.append((action, after, int(subtask[state]), done, gain))
    return rows


def derive_weights(reading: Reading) -> dict[str, Fraction]:
    """Return the weights of Table 4 as differences of rewards in compiled rows.

    The reading in which only failed trials cost separates a trial from a timestep; the reading in
    which a skip takes a timestep of its own separates the skip. The weight of a completed subtask
    appears only together with the weight of the assistance: as in the table, the weight of no
    assistance is 0.
    """
    # Rewards of failed trials by next status, and of completed subtasks by action.
    free = Reading(scenario=reading.scenario.with_(readings={"trial_cost": "failed-trials"}))
    failed: dict[int, Fraction] = {}
    completed: dict[tuple[int, bool], Fraction] = {}
    for action, after, subtask, done, gain in list_rewards(reading):
        if done:
            completed[action, subtask == reading.scenario.tasks[0] - 1] = gain
        else:
            failed[after] = gain
    # The weight of a trial: the difference to a reading in which a completed one is free.
    trial = completed[0, False] - next(
        gain
        for action, _, subtask, done, gain in list_rewards(free)
        if done and (action, subtask) == (0, 0)
    )
    # The weight of a status: two status vectors that differ in it alone.
    two = {"forget": (12, 4), "confuse": (12, 8), "anger": (6, 4), "disengaged": (5, 4)}
    by_name = {name: failed[both] - failed[one] for name, (both, one) in two.items()}
    by_name["trial"] = trial
    by_name["timestep"] = timestep = failed[8] - by_name["forget"] - trial
    by_name["subtask-complete"] = completed[0, False] - timestep - trial
    by_name["task-complete"] = completed[0, True] - completed[0, False]
    # The weight of a skip, in the model in which it takes a timestep of its own.
    mdp = reading.skip_model
    state = mdp.space.index(subtask=0, trial=reading.scenario.trials, status=8)
    gain = next(
        gain
        for p, after, gain in list_outcomes(mdp, state, 0)
        if p and not mdp.space.values("status", np.array([after]))[0]
    )
    by_name["subtask-skip"] = gain - timestep
    for action, name in enumerate(ACTIONS):
        by_name[f"assist.{name}"] = completed[action, False] - completed[0, False]
    return by_name
