"""How far training tells non-directive from directive help in status 0000, simulated once more.

The gap is Q(0000, non-directive) - Q(0000, directive) in tables over statuses, learned with the
paper's settings (α = 0.05, γ = 0.95, ε = 0.1, the end worth 0). Rows are those of the reference
model, in fractions; the learner is written from the text, all runs at once, and shares nothing with
the library's. `docs/how-to/reproduction.md` tells what is found here.
"""

from __future__ import annotations

import numpy as np
import pytest
from oracle import ACTIONS, CLEAR, END, Oracle

from exact_mdp.paper_repro.claims.learning import gap_first
from exact_mdp.paper_repro.reading import QUICK, default

MOST = 100  # outcomes of a pair
RATE, DISCOUNT, EPSILON, RUNS, STEPS = 0.05, 0.95, 0.1, 400, 50_000


def rows() -> tuple[np.ndarray, ...]:
    """Return, of each state and action, chances added up, next states and rewards; and statuses."""
    model, names = Oracle(), [*ACTIONS, "skip"]
    states = [s for s in sorted(model.reachable(), key=str) if s != END]
    number = {s: i for i, s in enumerate(states)} | {END: len(states)}
    shape = (len(states), 5, MOST)
    total, then, gain = np.full(shape, 2.0), np.zeros(shape, int), np.zeros(shape)
    for s in states:
        for action in model.actions(s):
            at = number[s], names.index(action)
            listed = model.outcomes(s, action)
            total[at][: len(listed)] = np.cumsum([float(p) for p, *_ in listed])
            total[at][len(listed) - 1] = 1.0
            then[at][: len(listed)] = [number[t] for _, t, *_ in listed]
            gain[at][: len(listed)] = [float(sum(parts.values())) for _, _, parts, _ in listed]
    status = np.array([int("".join(map(str, s[3])), 2) for s in states])
    return total, then, gain, status, np.array(number[0, 0, 1, CLEAR])


def gaps() -> tuple[np.ndarray, np.ndarray, float]:
    """Return of each run the mean of the gap over its second half, its end, and the spread."""
    total, then, gain, status, start = rows()
    rng, lane = np.random.default_rng(17), np.arange(RUNS)
    forced = total[:, 4, 0] < 2  # a subtask is skipped
    forced, status = np.append(forced, False), np.append(status, 0)
    q, state = np.zeros((RUNS, 16, 5)), np.full(RUNS, start)
    seen = np.zeros((3, RUNS))
    for step in range(STEPS):
        here = status[state]
        greedy = q[lane, here, :4].argmax(axis=1)
        drawn = np.where(rng.random(RUNS) < EPSILON, rng.integers(4, size=RUNS), greedy)
        action = np.where(forced[state], 4, drawn)
        one = (total[state, action] <= rng.random(RUNS)[:, None]).sum(axis=1)
        after, earned = then[state, action, one], gain[state, action, one]
        best = q[lane, status[after], :4].max(axis=1)
        ahead = np.where(forced[after], q[lane, status[after], 4], best)
        over = after == len(status) - 1
        target = earned + DISCOUNT * np.where(over, 0.0, ahead)
        q[lane, here, action] += RATE * (target - q[lane, here, action])
        state = np.where(over, start, after)
        if 2 * step >= STEPS:
            gap = q[:, 0, 2] - q[:, 0, 3]
            seen += over * np.stack([np.ones(RUNS), gap, gap**2])  # at the ends of episodes
    mean = seen[1] / seen[0]
    return (
        mean,
        q[:, 0, 2] - q[:, 0, 3],
        float(np.sqrt((seen[2] / seen[0]).mean() - mean.mean() ** 2)),
    )


@pytest.mark.slow
def test_the_gap_in_the_first_status() -> None:
    mean, end, spread = gaps()
    error = mean.std(ddof=1) / np.sqrt(RUNS)
    assert error < 0.4
    assert mean.mean() == pytest.approx(3.46, abs=3 * error)
    assert spread == pytest.approx(9.9, rel=0.05)
    reading = default(QUICK)
    own = gap_first(reading, "constant")
    for ours, theirs in ((end, own), (mean.mean() + 0 * own, own)):
        doubt = np.sqrt(ours.var() / RUNS + theirs.var() / len(theirs))
        assert abs(ours.mean() - theirs.mean()) < 4 * doubt
    assert own.std() == pytest.approx(spread, rel=0.25)
