"""The rounds of modified policy iteration on a small model, many in one compiled call.

A round is a judging pass, a step to T V, and sweeps for the policy found; see
`solvers.dynamic.stopping`, which does the same round by round with the same loops and the same
`solvers.dynamic.pace`, bit for bit. The rounds end where something has to be decided outside: at a
pass that may be the last, and where a policy's linear equations are to be solved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.dynamic import pace
from exact_mdp.solvers.kernels.bellman import Facts, Known, Model, Slow, hold, judge, settle
from exact_mdp.solvers.kernels.compiling import compiled, inlined

TINY = 2.0**-1000
advanced, goal_of, middle_of = map(inlined, (pace.advanced, pace.goal, pace.middle))


class Settings(NamedTuple):
    """Of a run: what does not change on the way.

    `tol` is 0 where the tolerance is `relative` to the greatest value; `most` sweeps are too many
    for one policy; `last` is the number of the last pass; `work` is that of a pass.
    """

    tol: float
    relative: float
    polish: bool
    strict: bool
    uniform: bool
    weight: float
    least_margin: float
    blur: float
    most: int
    last: int
    work: float
    price: float


class State(NamedTuple):
    """Of a run between two passes: see `solvers.dynamic.stopping`."""

    shift: float
    least: float
    most: float
    iteration: int
    ready: bool
    half: float
    best: float
    idle: int
    doubt: float
    slow: bool
    spent: float


@inlined
def extent(value: Floats) -> tuple[float, float]:
    """Return the least and the greatest of some values (S,)."""
    low, high = np.inf, -np.inf
    for state in range(len(value)):
        low, high = min(low, value[state]), max(high, value[state])
    return low, high


@compiled
def rounds(
    count: int,
    model: Model,
    facts: Facts,
    policy: Known,
    weights: Floats,
    settings: Settings,
    limits: Slow,
    state: State,
    value: Floats,
    step: Floats,
    pairs: Numbers,
    room: Floats,
    errors: Floats,
    extremes: Floats,
) -> tuple[State, bool, bool, int, int]:
    """Go through at most `count` rounds, but the pass that may be the last is only looked at.

    Returns the state, whether a pass stands in `step`, `pairs` and `extremes` that has yet to be
    counted, whether equations are to be solved, and the policies swept for and left alone.
    """
    states, swept, left = len(value), 0, 0
    shift, under, over, iteration, ready, half, best, idle, doubt, slow, spent = state
    weight, uniform = settings.weight, settings.uniform
    for _ in range(count):
        bottom, top = extent(value)
        middle = (bottom + top) / 2
        if uniform and abs(middle) > top - bottom:
            for s in range(states):
                value[s] -= middle
            shift += middle
            bottom, top = extent(value)
        size = max(abs(bottom), abs(top))
        known = Facts(
            facts.reward_error,
            facts.leak_error,
            facts.margin_error,
            facts.merged,
            TINY * (1 + size) if size != 0 else 0.0,
            facts.rounding,
        )
        still = bottom == top
        judge(
            0, states, model, known, policy, value, shift, settings.strict, still,
            0.0, 0.0, step, pairs, room, extremes,
        )  # fmt: skip
        low, high, floor = extremes[0], extremes[1], extremes[2] / settings.least_margin
        floor += max(abs(low), abs(high)) * settings.blur
        extremes[2] = floor
        now, least, since, stalled = advanced(low, high, floor, weight, settings.tol, best, idle)
        limit, centre = settings.tol, (low + high) / 2
        if limit == 0:
            greatest = 1.0
            for s in range(states):
                greatest = max(greatest, abs(value[s] + centre * weights[s]))
            limit = settings.relative * greatest
        close = stalled or doubt * now <= limit
        done = close and (ready or not settings.polish)
        if done or iteration + 1 == settings.last or not np.isfinite(high - low):
            reached = State(
                shift, under, over, iteration, ready, half, best, idle, doubt, slow, spent
            )
            return reached, True, False, swept, left
        half, best, idle, ready = now, least, since, close
        iteration += 1
        spent += settings.work
        for s in range(states):
            value[s] += step[s]
        if uniform:
            centre, under, over = middle_of(low, high, bottom, top, under, over)
            shift += model.discount * (centre - shift)
        if iteration == 1:
            continue
        if not slow:
            hold(model, pairs, policy)
            goal = 0.0 if ready else goal_of(half, idle, weight, settings.tol)
            found, shift = settle(
                model, policy, weights, value, shift, goal, settings.most, limits, uniform, step,
                errors,
            )  # fmt: skip
            swept += found
            slow = not found
            if found:
                continue
        if spent < settings.price:
            left += 1
            continue
        reached = State(shift, under, over, iteration, ready, half, best, idle, doubt, slow, spent)
        return reached, False, True, swept, left
    reached = State(shift, under, over, iteration, ready, half, best, idle, doubt, slow, spent)
    return reached, False, False, swept, left
