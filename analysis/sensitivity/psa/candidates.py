"""Candidates: the policies whose values are worked out in every draw of a probabilistic analysis.

They are the policy that is held, the optimum at today's values, further policies that are given,
and those among the optima of the draws that win most in the draws where these lose most.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from exact_mdp.analysis.sensitivity.base import BaseCase
from exact_mdp.analysis.sensitivity.draws.solver import DrawSolver, merged
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.parallel.pieces import Arrays

POOL = 24  # policies that are considered as candidates
CANDIDATES = 6  # of them kept, beside the policy held and today's optimum
LEAST_GAIN = 1e-2  # of what today's optimum loses, for a policy to be added
HELD, TODAY = "policy", "optimum today"


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A policy whose value is worked out in every draw.

    Attributes
    ----------
    name : str
    weights : (L,)
        Probabilities of the model's pairs.
    frequency : int
        Draws whose optimum was found to be this policy.
    actions : {label: action} or None
        Where it says the same in all states of a label, and does not mix.
    """

    name: str
    weights: Floats
    frequency: int
    actions: Mapping[str, str] | None


def named(base: BaseCase, policy: object, candidates: Sequence[object]) -> list[tuple[str, Floats]]:
    """Return the policies that are given, the one held first, today's optimum among them."""
    today, held = base.held("optimal"), base.held(policy)
    found = [(TODAY if np.array_equal(held, today) else HELD, held)]
    found += [(f"given {n}", base.held(each)) for n, each in enumerate(candidates, 1)]
    if not any(name == TODAY for name, _ in found):
        found.append((TODAY, today))
    return found


def selected(
    solver: DrawSolver,
    names: tuple[str, ...],
    found: Mapping[str, np.ndarray],
    blocks: Sequence[Arrays],
    given: Sequence[tuple[str, Floats]],
    valued: Arrays,
) -> tuple[list[tuple[str, Floats]], dict[bytes, int]]:
    """Return the policies to evaluate, those given and those that add most; and frequencies.

    What the given policies leave to be won is V* - max_c V^c, draw by draw. Policies are considered
    by how much of it lies in the draws whose optimum they are, and compared in the draws in which
    most of it lies. The one that adds most is taken, until none adds a hundredth of the whole.
    """
    rows, which = merged(blocks)
    best, error = valued["value"].max(axis=1), valued["error"].max(axis=1)
    left = found["start"] - best
    left = np.where(left > found["error"] + error, left, 0.0)
    counts = np.bincount(which, minlength=len(rows))
    pool: dict[bytes, Floats] = {}
    frequency: dict[bytes, int] = {}
    known = {identity(weights) for _, weights in given}
    # The rows that matter, and the most frequent ones, whose frequency is told.
    by_loss = np.bincount(which, weights=left, minlength=len(rows))
    order = np.argsort(-by_loss, kind="stable")[:POOL]
    for number in {*order.tolist(), *np.argsort(-counts, kind="stable")[:POOL].tolist()}:
        weights = solver.weights(rows[number])
        told = identity(weights)
        frequency[told] = frequency.get(told, 0) + int(counts[number])
    for number in order[by_loss[order] > 0].tolist():
        weights = solver.weights(rows[number])
        if identity(weights) not in known:
            pool.setdefault(identity(weights), weights)
    picked, total = list(given), float(left.sum())
    if not pool:
        return picked, frequency
    some = np.sort(np.argsort(-left, kind="stable")[: solver.pool])
    others = list(pool.values())
    values = solver.values(names, found["draws"][some], others)["value"]
    best = best[some]
    while len(picked) < len(given) + CANDIDATES:
        gains = np.maximum(values - best[:, None], 0.0).sum(axis=0)
        number = int(gains.argmax())
        if gains[number] <= LEAST_GAIN * total:
            break
        picked.append((f"alternative {len(picked) - len(given) + 1}", others[number]))
        best = np.maximum(best, values[:, number])
    return picked, frequency


def identity(weights: Floats) -> bytes:
    """Return what tells a policy from others."""
    return np.ascontiguousarray(weights, dtype="<f8").tobytes()
