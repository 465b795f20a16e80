"""The best policy that reads only some columns of the state, with a proof that it is the best.

All states in which these columns agree form a *row*, in which a policy takes one action; to find
the best is NP-hard (Littman, Memoryless policies, From Animals to Animats 3, 1994). A relaxation
allows a set of actions in each row, and every state chooses among them with knowledge of the full
state. Its value is at most V + c w, where r + γ P V - V ≤ c m for every allowed pair, with the
weights w and margins m of `solvers.bounds.bounds`, rounding included; it also bounds mixed
policies. Branch and bound (Land and Doig, Econometrica 28, 1960) splits the relaxation with the
greatest bound, at the row in which any single action costs most.

At discount 1 a policy that never ends, or misses a goal, is worth what `solve` says of the model
whose only actions are its own, and may be worth +∞ or -∞; the average reward of a policy is found
alike. A relaxation is then solved as the model of its allowed pairs, and split at the row in which
its policy, in states that it reaches, takes different actions most often.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from heapq import heappop, heappush
from math import inf
from typing import Self

import numpy as np
import scipy.sparse as sp
import tqdm

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, require_list
from exact_mdp.mdp.graph import find_reachable_states, find_start_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import rows_read, space_over
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.result import DataFrame, Result, data_frame
from exact_mdp.mdp.table import BLOCK, Floats, Integers
from exact_mdp.mdp.validate import Flags, require_count
from exact_mdp.solvers.arguments import (
    Criterion,
    is_average,
    mdp_of,
    require_average_applies,
)
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.bounds.gains import POLICIES, SLACK, BoundedVector, first_of, gamma
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain
from exact_mdp.solvers.claims import Bounded
from exact_mdp.solvers.endless.quotient import of_pairs
from exact_mdp.solvers.solution import Solution, answer_maximised
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.layers import Layers, find_taken_pairs, layers_of


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BestPolicy(Result):
    """The best policy found that reads some columns, with an upper bound on all others."""

    columns: tuple[str, ...]
    policy: Policy
    value: Bounded  # at the start
    upper_bound: float  # on deterministic policies that read them; a lower bound for costs
    mixed_upper_bound: float  # the same on all policies that read them, mixed or not
    proven: bool  # whether the search ended: value and `upper_bound` differ by rounding alone
    nodes: int  # relaxations solved

    @property
    def error(self) -> float:
        """The error bound of the value."""
        return self.value.error

    @property
    def actions(self) -> dict[str, str]:
        """The action in each row that has a choice."""
        space, names = self.policy.space, self.policy.actions
        taken = {}
        for row, chances in enumerate(self.policy.table):
            if chances.max() > 0:
                taken[space.label(row) or "all states"] = names[int(chances.argmax())]
        return taken

    def __repr__(self) -> str:
        read = ", ".join(self.columns)
        return f"BestPolicy({read}: value {self.value}; bound on others {self.upper_bound:.6g})"

    def negated(self, mdp: MDP) -> Self:
        """Return this policy for `mdp`, the model with negated rewards."""
        return replace(
            self,
            value=-self.value,
            upper_bound=0.0 - self.upper_bound,
            mixed_upper_bound=0.0 - self.mixed_upper_bound,
        )

    def frame(self) -> DataFrame:
        """Return the policy as a table, one row for each combination of the columns' values."""
        return data_frame([*self.actions.items()], columns=["row", "action"])


def best_policy(
    model: MDP | Scenario,
    columns: Sequence[str] = ("status",),
    *,
    start: Policy | None = None,
    node_limit: int | None = None,
    criterion: Criterion = "total",
) -> BestPolicy:
    """Find the best deterministic policy that reads `columns`, with an upper bound on all.

    Parameters
    ----------
    model : MDP or Scenario
    columns : names of columns of the model's states; none for one action throughout
    start : Policy, optional
        A policy that reads these columns, as an additional starting point.
    node_limit : int, optional
        Greatest number of relaxations to solve; by default 100 to 5,000, by the model's size. The
        upper bound is sound wherever the search ends.
    criterion : "total" or "average"
        The total reward with the model's discount, or the average reward per step in the long run,
        whatever the discount.

    Returns
    -------
    BestPolicy

    Raises
    ------
    ModelError
        If a column is unknown, if states that look alike have no action in common, or if some
        policy may be worth +∞ from one state of the start and -∞ from another.
    SolverError
        At discount 1, if floats cannot bound the values of policies that never end.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> best = best_policy(Scenario.load("yuan2025").compile(), ("status",))
    >>> best.proven, round(best.value.value, 6), best.mixed_upper_bound < 146.2359
    (True, 146.235871, True)
    """
    mdp, make_rows = mdp_of(model), PolicyRows.of
    if is_average(criterion):
        require_average_applies(mdp)
        make_rows = AverageRows
    if node_limit is None:
        # Transitions times relaxations: the limit keeps the default search to a constant effort.
        node_limit = max(100, min(5000, 2**25 // mdp.n_transitions))
    limit = require_count(node_limit, "node_limit")
    search_best = partial(
        _find_best_policy,
        make_rows=partial(make_rows, columns=require_list(columns, "columns")),
        start=start,
        node_limit=limit,
    )
    return answer_maximised(mdp, search_best)


def _find_best_policy(
    mdp: MDP, make_rows: Callable[[MDP], PolicyRows], start: Policy | None, node_limit: int
) -> BestPolicy:
    """Return the best policy of a model of maximised rewards."""
    rows = make_rows(mdp)
    search = _BranchAndBound(rows)
    if start is not None:
        search.offer_policies(rows.choices_of(start)[None])
    search.split_nodes(node_limit)
    value = Bounded(value=search.value, error=search.error)
    upper = max(search.upper, value.interval[0])
    return BestPolicy(
        columns=rows.space.names,
        policy=rows.to_policy(search.choice),
        value=value,
        upper_bound=upper,
        mixed_upper_bound=search.mixed,
        proven=search.ended,
        nodes=search.nodes,
    )


class PolicyRows:
    """The K rows into which some columns group a model's states, with relaxations over A actions.

    For each row, `must_choose` (K,) says whether a state with a choice can be reached, and
    `available` (K, A) which actions are offered by all its states with a choice; `key` (S,) is the
    row of each state. Choices in terminal states, and among actions that are all alike, do not
    count.
    """

    @classmethod
    def of(cls, mdp: MDP, columns: Sequence[str]) -> PolicyRows:
        """Return the rows of a model of maximised rewards, whether or not every policy ends."""
        if mdp.ends.has_improper_policy:
            _require_comparable(mdp)
            return EndlessRows(mdp, columns)
        return cls(mdp, columns)

    def __init__(self, mdp: MDP, columns: Sequence[str]) -> None:
        space = space_over(mdp, columns)
        row = rows_read(mdp, space)
        # In terminal states, and if all actions are alike, the policy has no effect.
        free, met = mdp.ends.choice_matters, find_reachable_states(mdp)
        entry, size = row[mdp.pair_state] * mdp.n_actions + mdp.pair_action, space.size
        offers = np.bincount(entry[free[mdp.pair_state]], minlength=size * mdp.n_actions)
        states = np.bincount(row[free], minlength=size)[:, None]
        # An action is available in a row if every state of the row with a choice offers it.
        self.available = (offers.reshape(size, -1) == states) & (states > 0)
        without = (states[:, 0] > 0) & ~self.available.any(axis=1)
        if without.any():
            raise ModelError(
                "no action is available in all states that the policy cannot tell apart",
                where=space.label(int(np.flatnonzero(without)[0])) or "all states",
                fix="let the policy read more columns",
            )
        self.mdp, self.space, self.key, self.free = mdp, space, row, free
        self.must_choose = np.bincount(row[free & met], minlength=size) > 0
        # Pairs of states without a choice, and of states never reached, are always allowed: they
        # have an entry of their own after all rows.
        choosing = (free & met & ~mdp.terminal)[mdp.pair_state]
        self._entry = np.where(choosing, entry, offers.size)
        used = np.flatnonzero(choosing)
        shape = (offers.size, mdp.n_pairs)
        self._sums = sp.csr_array((np.ones(len(used)), (entry[used], used)), shape)
        self._gain = float(np.abs(mdp.table.compute_gains()).max())
        self._terms = int(np.diff(mdp.table.offsets).max())

    @cached_property
    def _passes(self) -> Cycles | Layers:
        if self.mdp.ends.most_steps is None:
            return Cycles(self.mdp)
        return layers_of(self.mdp)

    @cached_property
    def _reach(self) -> float:
        """By how much a residual of at most 1 changes the start value: w(start) / min m."""
        weights = margin_weights(self.mdp)
        return float(self.mdp.start_distribution @ weights.value) * SLACK / weights.smallest

    def _find_allowed_pairs(self, allowed: Flags) -> Flags:
        """Return the pairs (L, N) that relaxations (N, K, A) allow."""
        flat = allowed.reshape(len(allowed), -1)
        return np.concatenate([flat, np.ones((len(flat), 1), dtype=bool)], axis=1).T[self._entry]

    def to_policy(self, choice: Integers) -> Policy:
        """Return the policy that takes one action number (K,) in each row with a choice."""
        table = np.eye(self.mdp.n_actions)[choice]
        table[~self.available.any(axis=1)] = np.nan
        return Policy(space=self.space, actions=self.mdp.actions, rule=table)

    def choices_of(self, policy: Policy) -> Integers:
        """Return the likeliest action numbers (K,) of a policy that reads these columns alone."""
        taken: Integers = self.available.argmax(axis=1)
        free = np.flatnonzero(self.free)
        taken[self.key[free]] = policy.choices(self.mdp)[free]
        return taken

    def bound_relaxations(self, allowed: Flags) -> tuple[Floats, Integers, Floats]:
        """Return upper bounds (N,) of relaxations (N, K, A), and a policy for each, (N, K).

        The policy takes in each row the action that loses least at the visits of the relaxation's
        own policy; that loss is the third result, (N, K).
        """
        # Solve all relaxations at once: allowed pairs (L, N) give values (S, N) and Q (L, N).
        mdp, pairs = self.mdp, self._find_allowed_pairs(allowed)
        value, q, apart = self._passes.solve_allowed(pairs)
        upper, error = self._at_start(value, apart)

        # The relaxation's policy: in each state the first of its best allowed pairs.
        offsets, state = mdp.pair_offsets[:-1], mdp.pair_state
        q = np.where(pairs, q, -np.inf)
        best = np.maximum.reduceat(q, offsets)[state]
        number = np.where(q >= best, np.arange(mdp.n_pairs)[:, None], mdp.n_pairs)
        visits = self._passes.compute_visits(number == np.minimum.reduceat(number, offsets)[state])

        # The loss of one action for a whole row: visits times suboptimality gaps, over its states.
        lost = visits[state] * np.where(pairs, value[state] - q, 0.0)
        lost = np.asarray((self._sums @ lost).T).reshape(allowed.shape)
        # Losses within rounding are ties, which go to the lowest action number.
        lost[lost <= self._bound_rounding(value)[:, None, None]] = 0.0
        lost[~allowed] = np.inf
        return upper + error, lost.argmin(axis=2), lost.min(axis=2)

    def evaluate_choices(self, choices: Integers) -> BoundedVector:
        """Return the start values (N,) of policies (N, K)."""
        # Blocks of policies limit the memory for values (S, N).
        n_parts = -(-len(choices) * self.mdp.n_states // BLOCK)
        values, errors = [], []
        for part in np.array_split(choices, n_parts):
            taken = find_taken_pairs(self.mdp, self.key, part)
            value, error = self._at_start(*self._passes.evaluate_pairs(taken))
            values.append(value)
            errors.append(error)
        return BoundedVector(value=np.concatenate(values), error=np.concatenate(errors))

    def _at_start(self, value: Floats, apart: Floats) -> tuple[Floats, Floats]:
        """Return start values (N,) and error bounds, for values (S, N) with residuals (N,)."""
        off = (apart + self._bound_rounding(value)) * self._reach
        summing = gamma(len(self.mdp.start) + 2) * np.abs(value).max(axis=0)
        return self.mdp.start_distribution @ value, (off + summing) * SLACK

    def _bound_rounding(self, value: Floats) -> Floats:
        """Return error bounds (N,) of a computed residual r + γPV - V."""
        size = np.abs(value).max(axis=0)
        return np.asarray(gamma(self._terms + 8) * (self._gain + 2 * size))


def _require_comparable(mdp: MDP) -> None:
    """Raise ModelError if some policy may have the value +∞ in one start state, -∞ in another.

    A run that misses a goal is worth the same in every state.
    """
    start = find_start_states(mdp)
    if mdp.ends.has_goal or start.sum() == 1:
        return
    best = np.isposinf(solve(mdp).value) & start
    worst = np.isneginf(solve(mdp.with_(sense="min")).value) & start
    if best.any() and worst.any() and (best | worst).sum() > 1:
        raise ModelError(
            "a policy may be worth +∞ from one state of the start and -∞ from another",
            where="start",
            fix="start in one state: --start, or mdp.with_(start=…)",
        )


class EndlessRows(PolicyRows):
    """The same of a model with improper policies, whose values may be infinite.

    Each relaxation, and each policy, is solved as a model of its own.
    """

    def bound_relaxations(self, allowed: Flags) -> tuple[Floats, Integers, Floats]:
        """Return upper bounds (N,) of relaxations (N, K, A), and a policy for each, (N, K).

        The policy takes in each row the action that the relaxation's own policy takes in most of
        the states that it reaches; in how many it takes others is the third result, (N, K).
        """
        upper = np.empty(len(allowed))
        choice, lost = np.empty((2, *allowed.shape[:2]), dtype=np.int64)
        for number, mask in enumerate(self._find_allowed_pairs(allowed).T):
            node, pairs = allowed[number], np.flatnonzero(mask)
            times = np.zeros(node.shape, dtype=np.int64)
            try:
                solved = self._solve_pairs(pairs)
            except ModelError:
                # Mixed policies that reach the goal in the end earn without limit before: none of
                # them is best, but the policies of smaller relaxations may be.
                upper[number] = inf
            else:
                upper[number] = solved.start.value + solved.start.error * SLACK
                taken = pairs[solved.pairs]
                met = self.free & find_reachable_states(self.mdp, pairs=taken)
                np.add.at(times, (self.key[met], self.mdp.pair_action[taken[met]]), 1)
            choice[number] = np.where(node, times, -1).argmax(axis=1)
            lost[number] = times.sum(axis=1) - times.max(axis=1)
        return upper, choice, lost.astype(np.float64)

    def evaluate_choices(self, choices: Integers) -> BoundedVector:
        """Return the start values (N,) of policies (N, K)."""
        taken = find_taken_pairs(self.mdp, self.key, choices)
        starts = [self._solve_pairs(pairs).start for pairs in taken.T]
        return BoundedVector(
            value=np.array([each.value for each in starts]),
            error=np.array([each.error for each in starts]),
        )

    def _solve_pairs(self, pairs: Integers) -> Solution:
        """Return the optimum of the model of some pairs (K,), as close as floats allow."""
        solution: Solution = solve(of_pairs(self.mdp, pairs), "policy-iteration")
        return solution


class AverageRows(EndlessRows):
    """The same for average rewards."""

    def _solve_pairs(self, pairs: Integers) -> Solution:
        """Return the best average reward of the model of some pairs (K,)."""
        solution: Solution = solve(of_pairs(self.mdp, pairs), criterion="average")
        return solution


class Cycles:
    """The counterpart of `Layers` for models with cycles; it solves one column after the other."""

    def __init__(self, mdp: MDP) -> None:
        self.mdp = mdp

    def solve_allowed(self, allowed: Flags) -> tuple[Floats, Floats, Floats]:
        """See `Layers.solve_allowed`."""
        mdp, first = self.mdp, self.mdp.pair_offsets[:-1]
        values, actions = np.empty((mdp.n_states, allowed.shape[1])), np.empty(allowed.shape)
        apart, pairs = np.empty(allowed.shape[1]), first
        for column, mask in enumerate(allowed.T):
            # Policy iteration, from the policy of the column before, which is often near.
            pairs = np.where(mask[pairs], pairs, first_of(mdp, mask))
            # The bound is sound wherever they end, as it adds the remaining Bellman residual.
            for _ in range(POLICIES):
                chain, reward = policy_chain(mdp, pairs)
                value = LinearSystem(chain, mdp.discount).approximate(reward)
                q = mdp.reward + mdp.discount * (mdp.transition @ value)
                best = np.maximum.reduceat(np.where(mask, q, -np.inf), first)
                # Improve by more than rounding only; `apart` includes the gain left out.
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
        start, visits = self.mdp.start_distribution, []
        for mask in taken.T:
            # d = start + γ P' d, with the transposed chain.
            chain, _ = policy_chain(self.mdp, first_of(self.mdp, mask))
            system = LinearSystem(chain.T.tocsr(), self.mdp.discount)
            visits.append(system.approximate(start))
        return np.stack(visits, axis=1)


class _BranchAndBound:
    """Branch and bound over the rows.

    `choice` (K,) is the best policy so far, and no policy is better than `upper`. A node is a set
    of allowed actions in each row (K, A); the heap holds nodes by their bound, greatest first, each
    with the row at which to split it.
    """

    def __init__(self, rows: PolicyRows) -> None:
        self.rows, self.nodes = rows, 0
        self.heap: list[tuple[float, int, Flags, int]] = []
        self.value, self.error = -np.inf, 0.0
        self.choice: Integers = rows.available.argmax(axis=1)
        # The root allows every available action, and a fixed one in rows without a choice.
        choosing, alone = rows.must_choose[:, None], np.eye(rows.mdp.n_actions, dtype=bool)
        self._expand_nodes(np.where(choosing, rows.available, alone[self.choice])[None])
        # Its bound holds for mixed policies, too.
        self.mixed = self.upper = -self.heap[0][0]

    @property
    def ended(self) -> bool:
        """Whether every bound that is left is within rounding of the best value."""
        return not self.heap or -self.heap[0][0] <= self.value + 4 * self.error

    def split_nodes(self, limit: int) -> None:
        """Split nodes that may hold a better policy, until `limit` relaxations are solved."""
        alone = -np.inf  # the greatest bound of nodes that hold a single policy
        words = {"desc": "policies", "unit": " nodes", "delay": 1, "disable": None, "leave": False}
        with tqdm.tqdm(**words) as bar:
            while not self.ended and self.nodes < limit:
                bound, _, node, row = heappop(self.heap)
                if node[row].sum() == 1:
                    # One action is left in each row: the node cannot be split.
                    alone = max(alone, -bound)
                    continue
                # One child for each action that the node allows in the row.
                actions = np.flatnonzero(node[row])
                children = np.repeat(node[None], len(actions), axis=0)
                children[:, row] = np.eye(node.shape[1], dtype=bool)[actions]
                self._expand_nodes(children)
                bar.update(len(children))
        if self.heap:
            alone = max(alone, -self.heap[0][0])
        self.upper = min(self.upper, alone)

    def _expand_nodes(self, nodes: Flags) -> None:
        """Bound nodes (N, K, A), try their policies, and put them on the heap."""
        upper, choice, lost = self.rows.bound_relaxations(nodes)
        self.offer_policies(choice)
        # Split where a single action costs most, among rows with several.
        rows = np.where(nodes.sum(axis=2) > 1, lost, -1.0).argmax(axis=1)
        for bound, node, row in zip(upper.tolist(), nodes, rows.tolist(), strict=True):
            self.nodes += 1
            heappush(self.heap, (-bound, self.nodes, node, row))

    def offer_policies(self, choices: Integers) -> None:
        """Keep the best of some policies (N, K) if it beats the best so far beyond rounding."""
        own = self.rows.evaluate_choices(choices)
        best = int(own.value.argmax())
        value, error = float(own.value[best]), float(own.error[best])
        if self.nodes == 0 or value > self.value + error + self.error:
            self.value, self.error, self.choice = value, error, choices[best]
