"""Sampled episodes of a controller that tracks its belief, all of them side by side.

States and rewards are drawn from the model's own outcome table and perceptions from the confusion
matrix; beliefs are tracked as `solvers.pomdp.belief` does. Places never come back, so the episodes
that pass through a place are taken together, place by place.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.pomdp.search import Vectors
from exact_mdp.solvers.values.simulate import Simulation


def simulate_beliefs(
    process: Process,
    vectors: Sequence[Vectors],
    episodes: int,
    seed: int | np.random.Generator,
) -> Simulation:
    """Return the sampled returns of a belief controller's episodes.

    Parameters
    ----------
    vectors : as for `solvers.pomdp.belief.BeliefController`
    episodes : int
    seed : whole number, or a generator

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.mdp.care.perception import independent
    >>> from exact_mdp.solvers.pomdp.belief import qmdp_vectors
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> process = Process.of(mdp, independent([0.9] * 4, [0.9] * 4))
    >>> found = simulate_beliefs(process, qmdp_vectors(process), 4000, seed=0)
    >>> abs(found.mean - 145.8) < 4 * found.standard_error
    True
    """
    generator = np.random.default_rng(seed)
    mdp, size = process.mdp, process.statuses
    table, gains = mdp.table, mdp.table.gains()
    per_pair = len(gains) == table.pairs
    chance = np.concatenate([[0.0], np.cumsum(table.probabilities())])
    pair = np.full((mdp.n_states, mdp.n_actions), -1)
    pair[mdp.pair_state, mdp.pair_action] = np.arange(mdp.n_pairs)
    seeing = np.cumsum(process.confusion, axis=1)

    place = np.full(episodes, process.start_place)
    status = _drawn(np.cumsum(process.start)[None], np.zeros(episodes, dtype=int), generator)
    belief = np.repeat(process.start[None], episodes, axis=0)
    returns, factor = np.zeros(episodes), np.ones(episodes)
    steps, happened = np.zeros(episodes, dtype=np.int64), np.zeros(episodes, dtype=np.uint8)
    for here in process.order:
        now = np.flatnonzero(place == here)
        if not len(now):
            continue
        seen = _drawn(seeing, status[now], generator)
        after = belief[now] * process.confusion[:, seen].T
        known = vectors[here]
        action = known.action[(after @ known.value.T).argmax(axis=1)]
        taken = pair[here * size + status[now], action]
        first, last = chance[table.offsets[taken]], chance[table.offsets[taken + 1]]
        share = first + generator.random(len(now)) * (last - first)
        outcome = np.searchsorted(chance, share, side="right") - 1
        outcome = np.clip(outcome, table.offsets[taken], table.offsets[taken + 1] - 1)
        returns[now] += factor[now] * gains[taken if per_pair else outcome]
        factor[now] *= mdp.discount
        steps[now] += 1
        following = table.next[outcome].astype(np.int64)
        event = np.zeros(len(now), dtype=np.uint8)
        if table.event is not None:
            event = table.event[outcome]
        happened[now] |= event
        place[now] = np.where(following < mdp.space.regular, following // size, -1)
        status[now] = following % size
        for move in process.moves[here]:
            chosen = (place[now] == move.place) & ((event & process.mask) == move.signal)
            some = np.flatnonzero(chosen)
            if not len(some):
                continue
            law = move.chance[action[some]]
            moved = np.einsum("ns,nsr->nr", after[some], law)
            belief[now[some]] = 0.0
            belief[np.ix_(now[some], move.reach)] = moved / moved.sum(axis=1, keepdims=True)
    return Simulation(
        returns=returns,
        steps=steps,
        events={name: float(((happened >> bit) & 1).mean()) for bit, name in enumerate(mdp.events)},
        truncated=0,
        truncation_error=0.0,
    )


def _drawn(cumulative: Floats, row: Integers, generator: np.random.Generator) -> Integers:
    """Return a number for each row (N,) of cumulative probabilities (R, Z)."""
    share = generator.random(len(row)) * cumulative[row, -1]
    found = (cumulative[row] <= share[:, None]).sum(axis=1)
    return np.asarray(np.minimum(found, cumulative.shape[1] - 1), dtype=np.int64)
