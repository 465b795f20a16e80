"""What Q-learning tends to where several states share a row of the Q-table, and its noise there.

While the greedy policy π stays the same, an ε-greedy learner passes through pair l of row k and
action a n(l) times an episode, and each time moves Q(k, a) towards r + γ Q(k', π(k')). On average
it stands still where

    Σ_{l in (k,a)} n(l) [ r(l) + γ Σ_s' P(l, s') Q(k(s'), π(k(s'))) - Q(k, a) ] = 0    for all k, a,

n are the exact visits of the ε-greedy policy, the end has value 0: a linear equation. Where the
greedy policy of its solution is π itself, this is a fixed point of Q-learning under state
aggregation (Singh, Jaakkola and Jordan, NeurIPS 7, 1995). It need not be unique, nor exist.

A constant learning rate α leaves noise around it. With δ the temporal difference, J the Jacobian of
the expected change of Q in an episode and C the covariance of Σ δ over an episode, both exact, the
covariance Σ of Q solves, to first order in α (Benveniste, Métivier and Priouret, Adaptive
Algorithms and Stochastic Approximations, 1990, part II, chapter 4),

    Σ = (I + αJ) Σ (I + αJ)ᵀ + α² C.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg as spl

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.mdp.validate import as_discount
from exact_mdp.solvers.bounds.gains import SLACK, UNIT, gamma
from exact_mdp.solvers.bounds.linear import LinearSystem
from exact_mdp.solvers.learning.sampler import Rows, rows_of
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.visits import visits

if TYPE_CHECKING:
    from pandas import DataFrame

pandas, linalg = later("pandas"), later("scipy.linalg")

MOST_ENTRIES = 3000
ROUNDS = 200  # greedy steps towards a fixed point


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MeanField(Result):
    """The point at which Q-learning stands still on average while one policy is greedy.

    Attributes
    ----------
    policy : (K,) ints
        The greedy policy that is assumed.
    chain : PolicyChain
        The ε-greedy policy's.
    weight : (N,)
        Expected number of times that each outcome of the chain happens in an episode.
    entry, following : (N,) ints
        Entry of the flat table that each outcome of the chain updates, and the one that it looks
        at; -1 for none.
    updates : (K, A)
        Expected updates of each entry in an episode.
    q, error : (K, A)
        Action values and bounds on their rounding errors; NaN and infinity where nothing is
        ever updated.
    """

    mdp: MDP
    rows: Rows
    epsilon: float
    discount: float
    policy: Integers
    chain: PolicyChain
    weight: Floats
    entry: Integers
    following: Integers
    updates: Floats
    q: Floats
    error: Floats

    @property
    def value(self) -> Floats:
        """(K, A) the action values `q`."""
        return self.q

    def frame(self) -> DataFrame:
        """Return one row for each entry that is ever updated."""
        row, action = np.divmod(self.used, self.mdp.n_actions)
        return pandas.DataFrame(
            {
                "row": [self.rows.space.label(number) for number in row.tolist()],
                "action": [self.mdp.actions[number] for number in action.tolist()],
                "value (reward)": self.q[row, action],
                "error bound (reward)": self.error[row, action],
                "updates an episode": self.updates[row, action],
            }
        )

    @property
    def greedy(self) -> Integers:
        """(K,) the greedy policy of `q`; that assumed in rows that are never updated."""
        values = np.where(self.rows.offered & ~np.isnan(self.q), self.q, -np.inf)
        known = np.isfinite(values).any(axis=1)
        return np.where(known, values.argmax(axis=1), self.policy)

    @property
    def consistent(self) -> bool:
        """Whether the greedy policy of `q` is the one assumed: a fixed point of Q-learning."""
        return bool(np.array_equal(self.greedy, self.policy))

    @property
    def gaps(self) -> Floats:
        """(K, A) how far each action is below the largest of its row; NaN where unknown."""
        best = np.nanmax(np.where(np.isnan(self.q), -np.inf, self.q), axis=1, keepdims=True)
        return np.asarray(best - self.q)

    @cached_property
    def used(self) -> Integers:
        """(U,) the entries of the flat table that are ever updated."""
        return np.flatnonzero(self.updates.reshape(-1) > 0)

    @cached_property
    def jacobian(self) -> Floats:
        """(U, U) derivative of the expected change of Q in an episode, per unit of α."""
        live, size = self.following >= 0, self.updates.size
        places = self.entry[live], self.following[live]
        moves = sp.csr_array((self.weight[live], places), (size, size))[self.used][:, self.used]
        updates = np.diag(self.updates.reshape(-1)[self.used])
        return np.asarray(self.discount * moves.toarray() - updates)

    @cached_property
    def drift(self) -> Floats:
        """(U,) expected change of Q in an episode at Q = 0, per unit of α."""
        return -self.jacobian @ self.q.reshape(-1)[self.used]

    @cached_property
    def noise(self) -> Floats:
        """(U, U) covariance, over episodes, of the sum of temporal differences by entry at `q`."""
        chain, size = self.chain, self.updates.size
        q = np.nan_to_num(self.q).reshape(-1)
        ahead = np.where(self.following >= 0, q[self.following], 0.0)
        delta = chain.gain + self.discount * ahead - q[self.entry]
        states, outcomes = self.mdp.n_states, np.arange(len(delta))
        expected = sp.csr_array(
            (chain.probability * delta, (chain.source, self.entry)), (states, size)
        )[:, self.used]
        system = (sp.eye_array(states) - chain.transition).tocsc()
        live = ~self.mdp.terminal
        later = spl.splu(system).solve(np.where(live[:, None], expected.toarray(), 0.0))
        into = sp.csr_array((self.weight * delta, (self.entry, outcomes)), (size, len(delta)))
        cross = into[self.used] @ np.where(live[:, None], later, 0.0)[chain.table.next]
        square = np.bincount(self.entry, self.weight * delta**2, minlength=size)[self.used]
        # The start's own mean is 0 where Q stands still, up to rounding.
        mean = self.mdp.start_distribution @ later
        return np.asarray(np.diag(square) + cross + cross.T - np.outer(mean, mean))

    def covariance(self, rate: float) -> Floats:
        """Return (U, U) the covariance of Q that the learning rate leaves, to first order."""
        step = np.eye(len(self.used)) + rate * self.jacobian
        if np.abs(np.linalg.eigvals(step)).max() >= 1:
            raise ModelError(
                f"at learning rate {rate:g} the mean equation is not stable",
                where="mean field",
                fix="choose a smaller rate",
            )
        return np.asarray(linalg.solve_discrete_lyapunov(step, rate**2 * self.noise))

    def spread(self, rate: float) -> Floats:
        """Return (K, A) the standard deviation of Q that the learning rate leaves."""
        found = np.full(self.updates.size, np.nan)
        found[self.used] = np.sqrt(np.maximum(np.diag(self.covariance(rate)), 0.0))
        return found.reshape(self.updates.shape)


def mean_field(
    model: MDP,
    policy: Sequence[int] | Numbers,
    *,
    epsilon: float,
    discount: object = "19/20",
    columns: Sequence[str] | None = None,
    bootstrap_end: bool = False,
) -> MeanField:
    """Return where Q-learning stands still on average while `policy` is greedy.

    The policy (K,) has the action number of each row; the discount is the learner's, and columns
    and `bootstrap_end` are as in `QLearning`. ModelError says where an episode of the ε-greedy
    policy may never end, or the table is too large.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> found = settle(mdp, [3] * 16, epsilon=0.1)
    >>> found.consistent, found.q[0].round(2).tolist()
    (True, [115.5, 120.47, 124.81, 123.29])
    """
    mdp = model.maximised  # costs are learned as rewards
    rows = rows_of(mdp, columns)
    (count, n_actions), entries = rows.offered.shape, rows.offered.size
    if entries > MOST_ENTRIES:
        raise ModelError(
            f"a Q-table of {entries:,} entries", where="mean field", fix="read fewer columns"
        )
    greedy = np.asarray(policy, dtype=np.int64)
    known = greedy.shape == (count,) and bool(((greedy >= 0) & (greedy < n_actions)).all())
    if not known or not rows.offered[np.arange(count), greedy].all():
        raise ModelError(
            f"a policy of shape {greedy.shape}, or with an action that is not offered",
            where="mean field",
            fix=f"give one available action number for each of the {count} rows",
        )
    rate = float(as_discount(discount))
    chain = _acting(mdp, rows, greedy, epsilon)
    chain.require_end()
    pair = np.repeat(chain.pairs, np.diff(chain.table.offsets))
    entry = rows.key[mdp.pair_state[pair]] * n_actions + mdp.pair_action[pair]
    target = rows.key * n_actions + greedy[rows.key]
    single = mdp.forced & ~mdp.terminal
    target[single] = rows.key[single] * n_actions + mdp.pair_action[mdp.pair_offsets[:-1][single]]
    if not bootstrap_end:
        target[mdp.terminal] = -1
    following = target[chain.table.next]
    found = visits(mdp, chain.undiscounted)
    visited = np.where(mdp.terminal, 0.0, found.value)
    weight = visited[chain.source] * chain.probability
    updates: Floats = np.bincount(entry, weight, minlength=entries).astype(np.float64)
    q, error = np.full(entries, np.nan), np.full(entries, np.inf)
    used = np.flatnonzero(updates > 0)
    on = np.flatnonzero(weight > 0)
    share, at = weight[on] / updates[entry[on]], entry[on]
    live = following[on] >= 0
    places = (at[live], following[on][live])
    moves = sp.csr_array((share[live], places), (entries, entries))
    earned = np.bincount(at, share * chain.gain[on], minlength=entries)[used]
    size = np.bincount(at, share * np.abs(chain.gain[on]), minlength=entries)[used]
    # Everything is a ratio of sums of visits; their relative errors count as this many roundings.
    seen = visited > 0
    doubt = float((found.error[seen] / visited[seen]).max())
    roundings = int(2 * doubt / UNIT) + 2 * len(weight) + chain.roundings + 4
    solved = LinearSystem(moves[used][:, used], rate, roundings=roundings).solve(
        earned.astype(np.float64), gamma(roundings + 2) * size * SLACK
    )
    q[used], error[used] = solved.value, solved.error
    shape = (count, n_actions)
    return MeanField(
        mdp=mdp,
        rows=rows,
        epsilon=float(epsilon),
        discount=rate,
        policy=greedy,
        chain=chain,
        weight=weight,
        entry=entry,
        following=following,
        updates=updates.reshape(shape),
        q=q.reshape(shape),
        error=error.reshape(shape),
    )


def settle(
    model: MDP,
    policy: Sequence[int] | Numbers,
    *,
    held: Sequence[int] = (),
    **options: Any,
) -> MeanField:
    """Return the fixed point that greedy steps from `policy` lead to.

    The options are those of `mean_field`. Where the steps run in a circle the result is not
    `consistent`: no fixed point was found. The rows `held` keep their actions, however poor.
    """
    current = np.array(policy, dtype=np.int64)
    kept = list(held)
    for _ in range(ROUNDS):
        found = mean_field(model, current, **options)
        following = found.greedy.copy()
        following[kept] = current[kept]
        if np.array_equal(following, current):
            break
        current = following
    return found


def _acting(mdp: MDP, rows: Rows, greedy: Integers, epsilon: float) -> PolicyChain:
    """Return the chain of the ε-greedy policy."""
    if not 0 <= epsilon <= 1:
        raise ModelError(f"epsilon is {epsilon}", where="mean field", fix="choose it from 0 to 1")
    counts = np.diff(mdp.pair_offsets)[mdp.pair_state]
    chosen = epsilon / counts
    chosen[mdp.pair_action == greedy[rows.key[mdp.pair_state]]] += 1 - epsilon
    chosen[mdp.forced[mdp.pair_state]] = 1.0
    return PolicyChain.of(mdp, chosen)
