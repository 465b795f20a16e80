"""The rounds of modified policy iteration on a small model, many in one compiled call.

A round is a judging pass, a step to T V, and sweeps for the policy found; see
`solvers.dynamic.stopping`, which does the same round by round with the same loops and the same
`solvers.dynamic.pace`, bit for bit. The rounds end where something has to be decided outside: at a
pass that may be the last, and where a policy's linear equations are to be solved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from exact_mdp.mdp.forms.compiling import compiled, inlined
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.bounds import sizes
from exact_mdp.solvers.dynamic import pace
from exact_mdp.solvers.kernels.bellman import (
    UNIT,
    Facts,
    Known,
    Model,
    Slow,
    climb,
    improve,
    settle,
)

TINY = 2.0**-1000
advanced, goal_of, middle_of = inlined(pace.advanced), inlined(pace.goal), inlined(pace.middle)
sizes_of, risen, dropped = inlined(sizes.sizes), inlined(sizes.risen), inlined(sizes.dropped)


class Settings(NamedTuple):
    """Of a run: what does not change on the way.

    `tol` is 0
    where the tolerance is `relative` to the greatest value; `most` sweeps are too many for one
    policy; a run in which nothing is gained ends a `spell` after its `patience`; `last` is the
    number of the last pass; `work` is that of a pass.
    """

    tol: float
    relative: float
    polish: bool
    patience: float
    spell: int
    strict: bool
    uniform: bool
    alike: bool
    weight: float
    least_margin: float
    most_margin: float
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
    mark: float
    since: int
    doubt: float
    slow: bool
    spent: float
    rise: float
    known: bool


@inlined
def extent(value: Floats, ended: Numbers) -> tuple[float, float, bool]:
    """Return the least and the greatest value (S,) of states that go on, and if any has `ended`."""
    low, high, some = np.inf, -np.inf, False
    for state in range(len(value)):
        if ended[state]:
            some = True
        else:
            low, high = min(low, value[state]), max(high, value[state])
    return low, high, some


@inlined
def remembered(policy: Known, rise: float, known: bool) -> Known:
    """Return what earlier passes left, as far as values have risen since."""
    slots, ends, indices, data, numbers, pairs, ceilings, _, _, columns, weights = policy
    return Known(
        slots, ends, indices, data, numbers, pairs, ceilings, rise, known, columns, weights
    )


@compiled
def rounds(
    count: int,
    model: Model,
    facts: Facts,
    policy: Known,
    greatest: sizes.Greatest,
    weights: Floats,
    settings: Settings,
    limits: Slow,
    state: State,
    value: Floats,
    before: Floats,
    step: Floats,
    pairs: Numbers,
    room: Floats,
    errors: Floats,
    extremes: Floats,
) -> tuple[State, bool, bool, bool, int, int]:
    """Go through at most `count` rounds, but the pass that may be the last is only looked at.

    Returns the state, whether the next pass may be the last or is not one for here, whether it
    stands in `step`, `pairs` and `extremes`, whether equations are to be solved, and the policies
    swept for and left alone.
    """
    states, swept, left = len(value), 0, 0
    shift, under, over, iteration, ready, half, best, idle, mark, since = state[:10]
    doubt, slow, spent, rise, known = state[10:]
    weight, uniform, stopped, found, due = settings.weight, settings.uniform, False, False, False
    for _ in range(count):
        bottom, top, some = extent(value, model.ended)
        middle = (bottom + top) / 2
        if uniform and abs(middle) > top - bottom:
            for s in range(states):
                value[s] -= 0.0 if model.ended[s] else middle
            shift += middle
            bottom, top, some = extent(value, model.ended)
        if some:
            bottom, top = min(bottom, 0.0), max(top, 0.0)
        still = bottom == top
        if still:
            stopped = True
            break
        rise = risen(rise, climb(value, before), greatest)
        size, gain, error, noise = sizes_of(bottom, top, model.discount, greatest)
        error += 8 * UNIT * (abs(rise) + size + gain + error)
        spare = dropped(shift, settings.least_margin, settings.most_margin)
        improve(
            0, states, model, remembered(policy, rise, known), value, shift, error, spare,
            step, extremes,
        )  # fmt: skip
        known = True
        low, high = extremes[0], extremes[1]
        floor = noise / settings.least_margin + max(abs(low), abs(high)) * settings.blur
        extremes[2] = floor
        now, least, quiet, fallen, waited, stalled = advanced(
            low, high, floor, weight, settings.tol, best, idle, mark, since, settings.patience
        )
        limit, centre = settings.tol, (low + high) / 2
        if limit == 0:
            largest = 1.0
            for s in range(states):
                largest = max(largest, abs(value[s] + centre * weights[s]))
            limit = settings.relative * largest
        close = stalled or doubt * now <= limit
        weary = waited >= settings.patience
        done = close and (ready or weary or not settings.polish)
        last = iteration + 1 == settings.last or waited >= settings.patience + settings.spell
        if done or last or not np.isfinite(high - low):
            stopped, found = True, True
            break
        half, best, idle, mark, since, ready = now, least, quiet, fallen, waited, close
        iteration += 1
        spent += settings.work
        for s in range(states):
            value[s] += step[s]
        if settings.alike:
            centre, under, over = middle_of(low, high, bottom, top, under, over)
            shift += model.discount * (centre - shift)
        if iteration == 1:
            continue
        if not slow:
            goal = 0.0 if ready else goal_of(best, idle, weight, settings.tol)
            enough, shift = settle(
                model, policy, weights, value, shift, goal, settings.most, limits, uniform, step,
                errors,
            )  # fmt: skip
            swept += enough
            slow = not enough
            if enough:
                continue
        if spent < settings.price:
            left += 1
            continue
        due = True
        break
    reached = State(
        shift, under, over, iteration, ready, half, best, idle, mark, since,
        doubt, slow, spent, rise, known,
    )  # fmt: skip
    return reached, stopped, found, due, swept, left
