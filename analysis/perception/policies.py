"""The best policy that reads what it perceives and remembers nothing, with a proof.

A memoryless policy takes one action wherever it perceives the same (the status alone, or place and
status). To find the best is NP-hard (Littman, Memoryless policies, From Animals to Animats 3,
1994), and the search is that of `analysis.gate.column_policies` with other relaxations. A node
allows a set of actions for each thing perceived, either one or all; its bound lets whoever acts
know the true status where all are allowed, beside what it perceives:

    V(x, s) = Σ_z C(s, z) max over the actions a allowed where (x, z) is perceived of Q(x, s, a)

With one action for each it is the value of that policy.

The bound at the root, V* of whoever knows the status, holds for mixed policies, too; a lower one
for them is the upper bound of `solvers.pomdp.pomdp`, which holds for every controller.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.analysis.gate.column_policies import BestPolicy, searched
from exact_mdp.analysis.gate.relaxation import Expansion, Flags, Rows, one_hot
from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, PolicyLike
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.pomdp.values import acting, at_start, rounding, values, visits

CELLS = 2**22  # places × statuses × actions × relaxations solved at once
NODES = 10_000


def best_perceived_policy(
    model: MDP,
    confusion: ArrayLike | Process,
    columns: Sequence[str] = ("status",),
    *,
    start: Policy | None = None,
    node_limit: int = NODES,
) -> BestPolicy:
    """Return the best deterministic memoryless policy on perceptions, and bounds on all others.

    The policy reads `columns`, the perceived status among them; the search begins from `start`,
    too, and solves at most this many relaxations: `upper_bound` is sound wherever it ends. The
    confusion (Z, Z) has the perceived status (column) given the true one (row).

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.mdp.care.perception import independent
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> best = best_perceived_policy(mdp, independent([0.9] * 4, [0.9] * 4))
    >>> best.proven, round(best.value.value, 4), round(best.mixed_upper_bound, 4)
    (True, 141.4675, 146.2359)
    """
    if "status" not in columns:
        raise ModelError(
            "a policy that does not read the status",
            where="columns",
            fix="add status, or use analysis.gate.column_policies.best_policy",
        )
    if node_limit < 1:
        raise ModelError(f"node_limit is {node_limit}", where="columns", fix="give 1 or more")
    process = confusion if isinstance(confusion, Process) else Process.of(model, confusion)
    rows = perceived_rows(process, columns)
    found = searched(rows, PerceivedRelaxations(rows, process), start=start, node_limit=node_limit)
    lowest = max(found.mixed_upper_bound, found.value.interval[0])
    return replace(found, mixed_upper_bound=lowest, upper_bound=min(found.upper_bound, lowest))


def place_by_place(process: Process, policies: Sequence[PolicyLike]) -> Policy:
    """Return a good policy that reads place and perceived status, from others by improvement.

    A place is visited once, so what is best in it for each perception, the other places held, is
    known from its visits and action values; places are improved from the last to the first
    until nothing improves. The best policy that results is returned.
    """
    best, worth = process.table(policies[0]), -inf
    for policy in policies:
        table, before = process.table(policy).copy(), -inf
        while True:
            weights = acting(process, table)
            value, _ = values(process, weights)
            met = visits(process, weights)[..., 0]
            reached = float(at_start(process, value)[0])
            if reached > worth:
                best, worth = table.copy(), reached
            if not reached > before + rounding(process):
                break
            before = reached
            following = value[..., 0].copy()
            for place in reversed(process.order):
                here = process.reward[place].copy()
                for move in process.moves[place]:
                    here += process.discount * (move.chance @ following[move.place][move.reach]).T
                here[:, ~process.offered[place]] = -np.inf
                believed = met[place][:, None] * process.confusion
                worth_by_seen = believed.T @ np.where(np.isfinite(here), here, 0.0)
                worth_by_seen[:, ~process.offered[place]] = -np.inf
                seen = believed.any(axis=0)
                table[place][seen] = one_hot(worth_by_seen.argmax(axis=1), table.shape[2])[seen]
                doing = process.confusion @ table[place]
                following[place] = (doing * np.where(doing > 0, here, 0.0)).sum(axis=1)
    mdp = process.mdp
    whole = np.full((mdp.n_states, mdp.n_actions), np.nan)
    whole[: mdp.space.regular] = best.reshape(-1, mdp.n_actions)
    for state in range(mdp.space.regular, mdp.n_states):
        whole[state] = np.eye(mdp.n_actions)[mdp.pair_action[mdp.pair_offsets[state]]]
    return Policy(space=mdp.space, actions=mdp.actions, rule=whole)


def status_names(model: MDP) -> tuple[str, ...]:
    """Return the names of the statuses, the most significant bit first; numbers where unnamed."""
    names = [p.name.removeprefix("base.") for p in model.parameters if p.name.startswith("base.")]
    bits = model.space.column("status").size.bit_length() - 1
    return tuple(names) if len(names) == bits else tuple(f"bit {bit}" for bit in range(bits))


def perceived_rows(process: Process, columns: Sequence[str]) -> Rows:
    """Return the rows of a policy's table, asked where a perception may lead to them."""
    rows = Rows.of(process.mdp, columns)
    size = process.statuses
    asked = np.zeros(len(rows.available), dtype=bool)
    for place, likely in _statuses_reached(process).items():
        if process.offered[place].sum() > 1:
            seen = process.confusion[likely].any(axis=0)
            asked[rows.row[place * size : (place + 1) * size][seen]] = True
    return replace(rows, asked=asked)


def _statuses_reached(process: Process) -> dict[int, Flags]:
    """Return the statuses (Z,) that are possible at each place reached."""
    possible = {place: np.zeros(process.statuses, dtype=bool) for place in process.order}
    possible[process.start_place] = process.start > 0
    for place in process.order:
        for move in process.moves[place]:
            arrived = move.chance[:, possible[place]].any(axis=(0, 1))
            possible[move.place][move.reach] |= arrived
    return possible


class PerceivedRelaxations:
    """Solves relaxations given as allowed actions (N, K, A), one or all of those available."""

    def __init__(self, rows: Rows, process: Process) -> None:
        self.rows, self.process = rows, process
        places, statuses, actions = process.reward.shape
        self.batch = max(1, min(256, CELLS // (places * statuses * actions)))
        self._row = rows.row[: places * statuses].reshape(places, statuses)
        self._error = rounding(process)
        # A place with one action on offer is outside the policy's say.
        self._free = process.offered.sum(axis=1) > 1
        self._open = np.where(self._free[:, None], rows.available[self._row[:, 0]], process.offered)

    def expand(self, allowed: Flags, worth: float = -np.inf) -> Expansion:
        """See `Relaxations.expand` of the gate; `loss` counts all of a row's actions."""
        open_share, weights = self._shares(allowed)
        value, q, best = self._solve(open_share, weights)
        upper = at_start(self.process, value) + self._error
        kept = np.flatnonzero(upper > worth)
        if len(kept) < len(upper):
            allowed, q, best = allowed[kept], q[..., kept], best[..., kept]
            open_share, weights = open_share[..., kept], weights[..., kept]
        gap = best[:, :, None] - q
        greedy = q == np.where(self._open[:, None, :, None], q, -np.inf).max(axis=2, keepdims=True)
        greedy = greedy & (np.cumsum(greedy, axis=2) == 1)
        cost = self._costs(weights + open_share[:, :, None] * greedy, gap)
        cost[cost <= self._error] = 0.0
        choice = np.where(allowed, cost, np.inf).argmin(axis=2)
        chosen = one_hot(choice, allowed.shape[2])
        still_open = allowed.sum(axis=2) > 1
        _, taken = self._shares(chosen)
        lost = self._costs(taken, gap) * (chosen & still_open[:, :, None])
        # To split at the row whose actions lose most in sum takes fewer nodes than at the row that
        # costs the policy most.
        loss = np.where(still_open, (cost * allowed).sum(axis=2), 0.0)
        rest = upper[kept] - self._error - lost.sum(axis=(1, 2))
        return Expansion(upper=upper, kept=kept, choice=choice, value=rest, loss=loss)

    def evaluate(self, choices: Integers) -> tuple[Floats, Floats]:
        """See `analysis.gate.relaxation.Relaxations.evaluate`."""
        found = []
        for first in range(0, len(choices), self.batch):
            some = one_hot(choices[first : first + self.batch], self.process.offered.shape[1])
            _, weights = self._shares(some)
            found.append(at_start(self.process, values(self.process, weights)[0]))
        value = np.concatenate(found)
        return value, np.full(len(value), self._error)

    def _shares(self, allowed: Flags) -> tuple[Floats, Floats]:
        """Return (P, Z, N) how likely all actions are open in each true status; (P, Z, A, N) fixed.

        Rows with one action are fixed; the others are open.
        """
        confusion = self.process.confusion
        single = allowed.sum(axis=2) == 1
        fixed = (allowed & single[:, :, None])[:, self._row]  # (N, P, Z, A)
        fixed = np.where(self._free[:, None, None], fixed, self.process.offered[:, None, :]).astype(
            np.float64
        )
        weights = acting(self.process, fixed)
        loose = (~single[:, self._row] & self._free[:, None]).astype(np.float64)
        return np.ascontiguousarray(np.moveaxis(loose @ confusion.T, 0, -1)), weights

    def _solve(self, open_share: Floats, weights: Floats) -> tuple[Floats, Floats, Floats]:
        """Return values (P, Z, N), action values (P, Z, A, N) and the best open ones (P, Z, N)."""
        process = self.process
        value, q = np.zeros(open_share.shape), np.zeros(weights.shape)
        best = np.zeros(open_share.shape)
        for place in reversed(process.order):
            q[place] = process.reward[place][:, :, None]
            for move in process.moves[place]:
                ahead = move.chance @ value[move.place][move.reach]
                q[place] += process.discount * ahead.transpose(1, 0, 2)
            best[place] = q[place][:, self._open[place]].max(axis=1)
            value[place] = open_share[place] * best[place]
            value[place] += (weights[place] * q[place]).sum(axis=1)
        return value, q, best

    def _costs(self, weights: Floats, gap: Floats) -> Floats:
        """Return (N, K, A) what each row's actions lose, by the visits of policies (P, Z, A, N)."""
        process = self.process
        met = visits(process, weights)[:, :, None] * gap
        met[~self._free] = 0.0
        seen = np.einsum("sz,psan->pzan", process.confusion, met, optimize=True)
        cost = np.zeros((len(self.rows.available), *seen.shape[2:]))
        np.add.at(cost, self._row, seen)
        return np.asarray(np.moveaxis(cost, 2, 0))
