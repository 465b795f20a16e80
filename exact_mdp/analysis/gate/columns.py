"""The best policy that reads some columns of the state only, with a proof that it is the best.

All states in which these columns agree form a *row*, in which a policy takes one action; to find
the best is NP-hard (Littman, Memoryless policies, From Animals to Animats 3, 1994). A relaxation
allows a set of actions in each row, and every state chooses among them knowing the full state. Its
value is at most V + c w, where r + γ P V - V ≤ c m for every allowed pair, with the weights w and
margins m of `solvers.bounds.bounds`, rounding included; it bounds mixed policies, too. Branch and
bound (Land and Doig, Econometrica 28, 1960) splits the relaxation of the greatest bound at the row
in which any single action costs most.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heappop, heappush

import numpy as np
import scipy.sparse as sp
import tqdm

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, require_list
from exact_mdp.mdp.graph import find_reachable_states, topological_levels
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import rows_read, space_over
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.result import DataFrame, Result, data_frame
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags, require_count
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.bounds.gains import SLACK, first_of, gamma
from exact_mdp.solvers.bounds.linear import FixedPoint, LinearSystem, policy_chain
from exact_mdp.solvers.solution import Bounded
from exact_mdp.solvers.solver import mdp_of
from exact_mdp.solvers.values.layers import NUMBERS, find_taken_pairs, layers_of

WORK = 2**25  # transitions times relaxations, unless a limit is given
ITERATIONS = 1000  # of policies; a bound counts what is left to gain wherever they end


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BestPolicy(Result):
    """The best policy found that reads some columns, and how good any other can be."""

    columns: tuple[str, ...]
    policy: Policy
    value: Bounded  # at the start
    upper_bound: float  # of any deterministic policy that reads them; of costs, a lower one
    mixed_upper_bound: float  # the same of any policy that reads them, mixed or not
    proven: bool  # whether the search ended: rounding alone is between value and `upper_bound`
    nodes: int  # relaxations solved

    @property
    def error(self) -> float:
        """How far the value may be off."""
        return self.value.error

    @property
    def actions(self) -> dict[str, str]:
        """The action in each row that has a choice."""
        space, names = self.policy.space, self.policy.actions
        return {
            space.label(row) or "all states": names[int(chances.argmax())]
            for row, chances in enumerate(self.policy.table)
            if chances.max() > 0
        }

    def __repr__(self) -> str:
        read = ", ".join(self.columns)
        return f"BestPolicy({read}: value {self.value}; bound on others {self.upper_bound:.6g})"

    def frame(self) -> DataFrame:
        """Return the policy, one row for each combination of values of the columns."""
        return data_frame([*self.actions.items()], columns=["row", "action"])


def best_policy(
    model: MDP | Scenario,
    columns: Sequence[str] = ("status",),
    *,
    start: Policy | None = None,
    node_limit: int | None = None,
) -> BestPolicy:
    """Return the best deterministic policy that reads `columns`, and an upper bound on all.

    Parameters
    ----------
    model : MDP or Scenario
    columns : names of columns of the model's states; none for one action throughout
    start : Policy, optional
        A policy that reads these columns, to begin from as well.
    node_limit : int, optional
        Relaxations to solve at most; 100 to 5,000, by the model's size, unless given. The upper
        bound is sound wherever the search ends.

    Returns
    -------
    BestPolicy

    Raises
    ------
    ModelError
        For an unknown column, where states that look alike have no action in common, and at
        discount 1 where not every policy ends.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> best = best_policy(Scenario.load("yuan2025").compile(), ("status",))
    >>> best.proven, round(best.value.value, 6), best.mixed_upper_bound < 146.2359
    (True, 146.235871, True)
    """
    mdp = mdp_of(model)
    if node_limit is None:
        node_limit = max(100, min(5000, WORK // mdp.n_transitions))
    limit = require_count(node_limit, "node_limit")
    rows = PolicyRows(mdp.maximised, require_list(columns, "columns"))
    search = _BranchAndBound(rows)
    if start is not None:
        search.offer_policies(rows.choices_of(start)[None])
    search.split_nodes(limit)
    value = Bounded(value=search.value, error=search.error)
    upper = max(search.upper, value.interval[0])
    return BestPolicy(
        columns=rows.space.names,
        policy=rows.to_policy(search.choice),
        value=value if mdp.sense == "max" else -value,
        upper_bound=0.0 + mdp.sign * upper,
        mixed_upper_bound=0.0 + mdp.sign * search.mixed,
        proven=search.ended,
        nodes=search.nodes,
    )


class PolicyRows:
    """The K rows that some columns make of a model's states, and relaxations over its A actions.

    Of a row, `asked` (K,) says whether a state with a choice can be reached, and `available` (K, A)
    which actions all its states with a choice offer; `key` (S,) is the row of each state. A choice
    counts where it matters: not where all is over, nor where all actions are alike.
    """

    def __init__(self, mdp: MDP, columns: Sequence[str]) -> None:
        space = space_over(mdp, columns)
        row = rows_read(mdp, space)
        # Where all is over, or all actions are alike, a policy may say anything.
        free, met = mdp.asked & ~mdp.indifferent, find_reachable_states(mdp)
        entry, size = row[mdp.pair_state] * mdp.n_actions + mdp.pair_action, space.size
        offers = np.bincount(entry[free[mdp.pair_state]], minlength=size * mdp.n_actions)
        states = np.bincount(row[free], minlength=size)[:, None]
        self.available = (offers.reshape(size, -1) == states) & (states > 0)
        without = (states[:, 0] > 0) & ~self.available.any(axis=1)
        if without.any():
            raise ModelError(
                "no action is available in all states that the policy cannot tell apart",
                where=space.label(int(np.flatnonzero(without)[0])) or "all states",
                fix="let the policy read more columns",
            )
        self.mdp, self.space, self.key, self.free = mdp, space, row, free
        self.asked = np.bincount(row[free & met], minlength=size) > 0
        # Pairs of states that have no choice, or are never reached, are always allowed.
        choosing = (free & met & ~mdp.terminal)[mdp.pair_state]
        self._entry = np.where(choosing, entry, offers.size)
        used = np.flatnonzero(choosing)
        shape = (offers.size, mdp.n_pairs)
        self._sums = sp.csr_array((np.ones(len(used)), (entry[used], used)), shape)
        self._passes = Cycles(mdp) if topological_levels(mdp) is None else layers_of(mdp)
        weights = margin_weights(mdp)
        self._reach = float(mdp.start_distribution @ weights.value) * SLACK / weights.smallest
        self._gain = float(np.abs(mdp.table.compute_gains()).max())
        self._terms = int(np.diff(mdp.table.offsets).max())

    def to_policy(self, choice: Integers) -> Policy:
        """Return the policy of one action number (K,) a row, silent where there is no choice."""
        table = np.eye(self.mdp.n_actions)[choice]
        table[~self.available.any(axis=1)] = np.nan
        return Policy(space=self.space, actions=self.mdp.actions, rule=table)

    def choices_of(self, policy: Policy) -> Integers:
        """Return the likeliest action numbers (K,) of a policy that reads nothing else."""
        taken: Integers = self.available.argmax(axis=1)
        free = np.flatnonzero(self.free)
        taken[self.key[free]] = policy.choices(self.mdp)[free]
        return taken

    def bound_relaxations(self, allowed: Flags) -> tuple[Floats, Integers, Floats]:
        """Return upper bounds (N,) of relaxations (N, K, A), and a policy for each, (N, K).

        Its action in a row is the one that loses least at the visits of the relaxation's own
        policy; how much that is comes third, (N, K).
        """
        mdp, flat = self.mdp, allowed.reshape(len(allowed), -1)
        pairs = np.concatenate([flat, np.ones((len(flat), 1), dtype=bool)], axis=1).T[self._entry]
        value, q, apart = self._passes.solve_allowed(pairs)
        upper, error = self._at_start(value, apart)
        offsets, state = mdp.pair_offsets[:-1], mdp.pair_state
        q = np.where(pairs, q, -np.inf)
        best = np.maximum.reduceat(q, offsets)[state]
        number = np.where(q >= best, np.arange(mdp.n_pairs)[:, None], mdp.n_pairs)
        visits = self._passes.compute_visits(number == np.minimum.reduceat(number, offsets)[state])
        lost = visits[state] * np.where(pairs, value[state] - q, 0.0)
        lost = np.asarray((self._sums @ lost).T).reshape(allowed.shape)
        # What rounding leaves is not a loss: of equal actions, the lowest number is taken.
        lost[lost <= self._bound_rounding(value)[:, None, None]] = 0.0
        lost[~allowed] = np.inf
        return upper + error, lost.argmin(axis=2), lost.min(axis=2)

    def evaluate_choices(self, choices: Integers) -> FixedPoint:
        """Return the start values (N,) of policies (N, K)."""
        parts = np.array_split(choices, -(-len(choices) * self.mdp.n_states // NUMBERS))
        each = (
            self._passes.evaluate_pairs(find_taken_pairs(self.mdp, self.key, part))
            for part in parts
        )
        value, error = zip(*(self._at_start(*solved) for solved in each), strict=True)
        return FixedPoint(value=np.concatenate(value), error=np.concatenate(error))

    def _at_start(self, value: Floats, apart: Floats) -> tuple[Floats, Floats]:
        """Return start values (N,) and their errors, of values (S, N) so far from a fixed point."""
        off = (apart + self._bound_rounding(value)) * self._reach
        summing = gamma(len(self.mdp.start) + 2) * np.abs(value).max(axis=0)
        return self.mdp.start_distribution @ value, (off + summing) * SLACK

    def _bound_rounding(self, value: Floats) -> Floats:
        """Return (N,) how far a computed r + γPV - V may be from the exact one."""
        size = np.abs(value).max(axis=0)
        return np.asarray(gamma(self._terms + 8) * (self._gain + 2 * size))


class Cycles:
    """What `Layers` is for models without cycles, of any model: one column after the other."""

    def __init__(self, mdp: MDP) -> None:
        self.mdp = mdp

    def solve_allowed(self, allowed: Flags) -> tuple[Floats, Floats, Floats]:
        """See `Layers.solve_allowed`."""
        mdp, first = self.mdp, self.mdp.pair_offsets[:-1]
        values, actions = np.empty((mdp.n_states, allowed.shape[1])), np.empty(allowed.shape)
        apart, pairs = np.empty(allowed.shape[1]), first
        for column, mask in enumerate(allowed.T):
            pairs = np.where(mask[pairs], pairs, first_of(mdp, mask))  # the one before is near
            for _ in range(ITERATIONS):
                chain, reward = policy_chain(mdp, pairs)
                value = LinearSystem(chain, mdp.discount).approximate(reward)
                q = mdp.reward + mdp.discount * (mdp.transition @ value)
                best = np.maximum.reduceat(np.where(mask, q, -np.inf), first)
                # More than rounding; `apart` counts what is not gained for it.
                noise = 2.0**-44 * (np.abs(mdp.reward).max() + np.abs(value).max())
                better = best > q[pairs] + noise
                if not better.any():
                    break
                pairs = np.where(better, first_of(mdp, mask & (q == best[mdp.pair_state])), pairs)
            values[:, column], actions[:, column] = value, q
            apart[column] = np.abs(best - value).max()
        return values, actions, apart

    def evaluate_pairs(self, taken: Integers) -> tuple[Floats, Floats]:
        """See `Layers.evaluate_pairs`."""
        alone = np.zeros((self.mdp.n_pairs, taken.shape[1]), dtype=bool)
        np.put_along_axis(alone, taken, True, axis=0)
        value, _, apart = self.solve_allowed(alone)
        return value, apart

    def compute_visits(self, taken: Flags) -> Floats:
        """Return (S, N) discounted visits from the start where the pairs (L, N) are taken."""
        chains = (policy_chain(self.mdp, first_of(self.mdp, mask))[0] for mask in taken.T)
        systems = (LinearSystem(chain.T.tocsr(), self.mdp.discount) for chain in chains)
        start = self.mdp.start_distribution
        return np.stack([system.approximate(start) for system in systems], axis=1)


class _BranchAndBound:
    """Branch and bound over the rows: `choice` (K,) is best so far, no policy is above `upper`."""

    def __init__(self, rows: PolicyRows) -> None:
        self.rows, self.nodes = rows, 0
        self.heap: list[tuple[float, int, Flags, int]] = []
        self.value, self.error = -np.inf, 0.0
        self.choice: Integers = rows.available.argmax(axis=1)
        asked, alone = rows.asked[:, None], np.eye(rows.mdp.n_actions, dtype=bool)
        self._expand_nodes(np.where(asked, rows.available, alone[self.choice])[None])
        self.mixed = self.upper = -self.heap[0][0]

    @property
    def ended(self) -> bool:
        """Whether no node is left whose bound is above the best value by more than rounding."""
        return not self.heap or -self.heap[0][0] <= self.value + 4 * self.error

    def split_nodes(self, limit: int) -> None:
        """Split the nodes that may hold a better policy, until `limit` relaxations are solved."""
        alone = -np.inf  # the greatest bound of a node of one policy
        words = {"desc": "policies", "unit": " nodes", "delay": 1, "disable": None, "leave": False}
        with tqdm.tqdm(**words) as bar:
            while not self.ended and self.nodes < limit:
                bound, _, node, row = heappop(self.heap)
                if node[row].sum() == 1:
                    alone = max(alone, -bound)
                    continue
                actions = np.flatnonzero(node[row])
                children = np.repeat(node[None], len(actions), axis=0)
                children[:, row] = np.eye(node.shape[1], dtype=bool)[actions]
                self._expand_nodes(children)
                bar.update(len(children))
        self.upper = min(self.upper, max(alone, *(-node[0] for node in self.heap[:1]), -np.inf))

    def _expand_nodes(self, nodes: Flags) -> None:
        """Bound some nodes (N, K, A), keep each with the row that costs most, offer policies."""
        upper, choice, lost = self.rows.bound_relaxations(nodes)
        self.offer_policies(choice)
        rows = np.where(nodes.sum(axis=2) > 1, lost, -1.0).argmax(axis=1)
        for bound, node, row in zip(upper.tolist(), nodes, rows.tolist(), strict=True):
            self.nodes += 1
            heappush(self.heap, (-bound, self.nodes, node, row))

    def offer_policies(self, choices: Integers) -> None:
        """Take the best of some policies (N, K) if it beats the best so far beyond rounding."""
        own = self.rows.evaluate_choices(choices)
        best = int(own.value.argmax())
        value, error = float(own.value[best]), float(own.error[best])
        if value > self.value + error + self.error:
            self.value, self.error, self.choice = value, error, choices[best]
