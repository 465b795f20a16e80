"""Mean and variance of the return of many status policies: matrices, NumPy alone, no shared code.

The chances come from the Fraction oracle; the recursion runs over (subtask, trial) and knows
nothing of the package's models, kernels or evaluations.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from oracle import ACTIONS, TABLE_4, Oracle, Status

from exact_mdp.mdp.care.tables import READINGS

Array = NDArray[np.float64]
STATUSES: list[Status] = [(a, b, c, d) for a, b, c, d in product((0, 1), repeat=4)]
BITS = np.array(STATUSES, dtype=float)
W = {name: float(weight) for name, weight in TABLE_4.items()}
ASSIST = np.array([W[f"assist.{action}"] for action in ACTIONS])
COST = BITS @ np.array([W["forget"], W["confuse"], W["anger"], W["disengaged"]])


def _law(chances: Sequence[float]) -> Array:
    law = np.ones(1)
    for p in chances:
        law = np.concatenate([law[:, None] * (1 - p), law[:, None] * p], axis=1).reshape(-1)
    return law


@lru_cache(maxsize=16)
def kernels(orientation: str, present: str, onset: str) -> tuple[Array, Array]:
    """Return K (16, 4, 16) and the law of a skip (16, 16)."""
    model = Oracle(
        {
            "influence_orientation": orientation,
            "influence_on_present": present,
            "skip_onset": onset,
        }
    )
    step = [[_law([float(p) for p in model.chances(s, a)]) for a in ACTIONS] for s in STATUSES]
    skip = [_law([float(p) for p in model.skip_chances(s)]) for s in STATUSES]
    return np.array(step), np.array(skip)


def moments(
    readings: Mapping[str, str],
    tasks: Sequence[int],
    discount: float | Fraction,
    policies: NDArray[np.int64],
    max_trial: int = 5,
) -> tuple[Array, Array]:
    """Return mean and variance (N,) of the return of status policies (N, 16)."""
    step, skip = kernels(
        readings["influence_orientation"],
        readings["influence_on_present"],
        readings["skip_onset"],
    )
    law = step[np.arange(16), policies]  # (N, 16, 16)
    assist = ASSIST[policies]
    g, bonus, rule = float(discount), W["task-complete"], readings["task_bonus"]
    following = readings["status_cost"] == "next"
    own = readings["skip_timestep"] == "own"
    every = W["trial"] * (readings["trial_cost"] == "every-trial")
    trials = max_trial + (readings["max_trial_rule"] == "after")
    flags = (0, 1) if rule == "no-subtask-skipped" else (0,)  # 1: a subtask was skipped
    after = COST if following else np.zeros(16)
    before = np.zeros(16) if following else COST

    count = len(policies)
    ends = [index == size - 1 for size in tasks for index in range(size)]
    first = {flag: np.zeros((2, count, 16)) for flag in flags}  # moments at a subtask's start
    for last in reversed(ends):
        nexts = {}
        for flag in flags:
            done = first[0] if last else first[flag]
            skipped = first[0] if last or len(flags) == 1 else first[1]
            paid = bonus * last * (not flag)
            paid_skip = bonus * last * (rule == "always")
            earned = W["timestep"] + W["subtask-complete"] + every + paid
            complete = shifted(done[:, :, :1], earned, g)
            onward = skip_moments(skipped, skip, after, before, paid_skip, g, own=own)
            for trial in reversed(range(trials)):
                extra = W["timestep"] + W["trial"] + after
                rate = g if own or trial < trials - 1 else 1.0
                x = shifted(onward, extra, rate)
                x[:, :, :1] = complete
                found = np.stack([(law @ part[:, :, None])[:, :, 0] for part in x])
                alone, (m, _) = law[:, :, 0], complete
                found[1] += alone * (2 * assist * m + assist**2)
                found[0] += alone * assist
                onward = shifted(found, before, 1.0)
            nexts[flag] = onward
        first = nexts
    mean = first[0][0, :, 0]
    return mean, first[0][1, :, 0] - mean**2


def shifted(moment: Array, extra: float | Array, rate: float) -> Array:
    """Return both moments of extra + rate · G."""
    m, s = rate * moment[0], rate**2 * moment[1]
    return np.stack([m + extra, s + 2 * m * extra + extra * extra])


def skip_moments(
    nexts: Array, skip: Array, after: Array, before: Array, paid: float, g: float, *, own: bool
) -> Array:
    """Return moments of what follows a status s' that is skipped, its own timestep included."""
    earned = W["subtask-skip"] + paid
    if own:
        x = shifted(nexts, W["timestep"] + earned + after, g)
        return shifted(x @ skip.T, before, 1.0)
    return shifted(nexts, earned, g) @ skip.T


def moments_of(settings: Mapping[str, Any], policies: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return mean and variance of a reading's policies; what it does not set is the default."""
    readings = {name: str(settings.get(name, options[0])) for name, options in READINGS.items()}
    mean, variance = moments(readings, settings["tasks"], settings["evaluation_discount"], policies)
    return mean, variance
