"""Tabular learning from samples: Q-learning, SARSA, expected SARSA, double Q-learning.

    Q(k, a) ← Q(k, a) + α (r + γ U - Q(k, a)),   k, k' the rows that s and s' read,

where a is ε-greedy in Q(k, ·), and U is 0 if s' is terminal, else

    max_b Q(k', b)                                   Q-learning (Watkins and Dayan 1992)
    Q(k', b) of the action b taken next              SARSA (Rummery and Niranjan 1994)
    (1-ε) max_b Q(k', b) + ε mean_b Q(k', b)         expected SARSA (van Seijen et al. 2009)
    Q₂(k', argmax_b Q₁(k', b)), tables by a coin     double Q-learning (van Hasselt 2010)

Costs are learned as negative rewards. If several states share a row, a constant α leaves noise that
never vanishes: set `rate_power`. Defaults are taken from Yuan et al. (2025), "Learning Algorithm
Design and Training": 6,000 epochs of 30 episodes, α = 0.05, γ = 0.95, ε = 0.1, one row for each
status.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exact_mdp.mdp.errors import ModelError, locate_errors, require_type, suggest_name
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.arrays import find_distinct_rows
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.result import Brief
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.mdp.validate import as_discount, require_count
from exact_mdp.solvers.learning.sampler import (
    Seed,
    build_q_table_rows,
    build_sampling_tables,
    make_random_stream,
)
from exact_mdp.solvers.learning.schedules import PAPER_CONSTANT, Schedule, as_schedule

METHODS = ("q-learning", "sarsa", "expected-sarsa", "double-q-learning")
TIES = ("first", "last", "random")
AT_ONCE = 2**21  # steps between two checks for an interruption, some tenths of a second
MOST_EPOCHS = 2**25  # each epoch takes some fifty bytes


@dataclass(frozen=True, kw_only=True)
class QLearning:
    """Settings of a learner.

    Attributes
    ----------
    method : str
        One of `METHODS`.
    epochs, episodes : int
        Number of epochs, and of episodes in each.
    discount : number or "p/q"
        The learner's discount, which replaces the discount of the model.
    rate, exploration : Schedule or number
        α and ε of each epoch, from 0 to 1; a number holds for all epochs.
    rate_power : float
        The n-th update of an entry uses α n^-power.
    columns : tuple of str, optional
        Columns of the state that the Q-table reads; by default the status alone if there is one,
        else all columns.
    initial : float
        First value of every entry.
    ties : str
        Which of several best actions is taken: one of `TIES`.
    bootstrap_end : bool
        Bootstrap at the end as if the episode continued: the end of a scenario reads the row of
        status 0000. If all columns are read and `initial` is 0, this makes no difference.
    max_steps : int
        Episodes are cut short after this many timesteps; `TrainingRun.cut_short` counts them.
    snapshot_episode : int
        Keep the greedy policy after this episode of each epoch; 0 keeps none.
    last : int
        Number of last episodes after each of which the greedy policy is kept.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> run = QLearning(epochs=20).train(mdp, rng=0)
    >>> run.q.shape, len(run.snapshots), len(run.last)
    ((16, 4), 20, 100)
    """

    method: str = "q-learning"
    epochs: int = 6000
    episodes: int = 30
    discount: object = "19/20"
    rate: Schedule = 0.05
    rate_power: float = 0.0
    exploration: Schedule = PAPER_CONSTANT
    columns: tuple[str, ...] | None = None
    initial: float = 0.0
    ties: str = "first"
    bootstrap_end: bool = False
    max_steps: int = 10_000
    snapshot_episode: int = 10
    last: int = 100

    def __post_init__(self) -> None:
        for name, options in (("method", METHODS), ("ties", TIES)):
            self._require_setting(
                name,
                getattr(self, name) in options,
                suggest_name(str(getattr(self, name)), options),
            )
        for name in ("epochs", "episodes", "max_steps", "last", "snapshot_episode"):
            with locate_errors("QLearning"):
                value = require_count(getattr(self, name), name, int(name != "snapshot_episode"))
            object.__setattr__(self, name, value)
        self._require_setting(
            "epochs",
            self.epochs <= MOST_EPOCHS,
            f"an epoch keeps numbers of its own: choose at most {MOST_EPOCHS:,} of them, with more "
            "episodes in each",
        )
        # The number of all episodes has to fit into 64 bits.
        self._require_setting("episodes", self.episodes <= 2**60 // self.epochs, "choose fewer")
        self._require_setting(
            "snapshot_episode",
            self.snapshot_episode <= self.episodes,
            f"an epoch has {self.episodes} episodes (episodes=): give one of these, or 0 to keep "
            "no policies of epochs",
        )
        for name in ("initial", "rate_power"):
            self._require_setting(name, np.isfinite(getattr(self, name)), "give a finite number")
        self._require_setting(
            "rate_power", self.rate_power >= 0, "rates must not grow: give 0 or more"
        )
        object.__setattr__(self, "discount", as_discount(self.discount))
        for name in ("exploration", "rate"):
            with locate_errors(f"QLearning, {name}"):
                schedule = as_schedule(name, getattr(self, name), self.epochs)
                object.__setattr__(self, name, schedule)

    def _require_setting(self, name: str, holds: object, fix: str) -> None:
        if not holds:
            raise ModelError(f"{name} is {getattr(self, name)!r}", where="QLearning", fix=fix)

    def train(self, model: MDP, rng: Seed) -> TrainingRun:
        """Return one run; the same seed gives the same bytes."""
        require_type(model, MDP, "model", "give an MDP, as load and scenario.compile return one")
        mdp = model.maximised
        read = build_q_table_rows(mdp, self.columns)
        rows = read.space.size
        kept_epochs = 0
        if self.snapshot_episode:
            kept_epochs = self.epochs
        recorded = kept_epochs + self.last
        # Actions of snapshots take 4 bytes each: at most a gigabyte.
        if recorded * rows > 2**28:
            raise ModelError(
                f"{recorded:,} greedy policies of {rows:,} rows are too many to keep",
                where="QLearning",
                fix="set snapshot_episode=0, or keep fewer last policies",
            )
        # The table that acts is the sum of both tables of double Q-learning; others have only one.
        entries, double = rows * mdp.n_actions, self.method == "double-q-learning"
        initial = model.sense.orient(float(self.initial))
        if double:
            both = np.full((2, entries), initial)
            acting = both[0] + both[1]
        else:
            both, acting = np.empty((2, 0)), np.full(entries, initial)
        # Updates are counted only if rates depend on their number.
        counted = 0
        if self.rate_power:
            counted = entries
        counts = np.zeros(counted, dtype=np.int64)
        snapshots = np.zeros((kept_epochs, rows), dtype=np.int32)
        last = np.zeros((min(self.last, self.epochs * self.episodes), rows), dtype=np.int32)
        returns = np.zeros(self.epochs)
        from exact_mdp.solvers.kernels import learning as kernels

        laid_out, source = build_sampling_tables(mdp, read), make_random_stream(rng)
        exploration = np.array(self.exploration.values(self.epochs), dtype=float)
        rate = np.array(self.rate.values(self.epochs), dtype=float)
        # Episodes in portions, between which Python can be interrupted.
        steps, cut_short, episode = 0, 0, 0
        while episode < self.epochs * self.episodes:
            more, also_cut, episode = kernels.run_learner(
                laid_out,
                source,
                both,
                acting,
                counts,
                mdp.n_actions,
                exploration,
                rate,
                float(self.rate_power),
                float(as_discount(self.discount)),
                self.episodes,
                METHODS.index(self.method),
                TIES.index(self.ties),
                bool(self.bootstrap_end),
                self.max_steps,
                self.snapshot_episode,
                snapshots,
                last,
                returns,
                episode,
                AT_ONCE,
            )
            steps, cut_short = steps + int(more), cut_short + int(also_cut)
        # Keep each distinct policy once.
        policies, numbers = find_distinct_rows(np.concatenate([snapshots, last]))
        numbers = numbers.astype(np.int32)
        q = (acting / (1 + double)).reshape(rows, mdp.n_actions)
        # Rewards become costs again in a model of costs.
        q, returns = model.sense.orient(q), model.sense.orient(returns)
        return TrainingRun(
            space=read.space,
            q=q,
            policies=policies,
            snapshots=numbers[: len(snapshots)],
            last=numbers[len(snapshots) :],
            returns=returns,
            steps=steps,
            cut_short=cut_short,
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TrainingRun(Brief):
    """The final Q-table of a learner, and the policies and returns on its way.

    Attributes
    ----------
    space : StateSpace
        The meaning of the K rows of the Q-table.
    q : (K, A)
        Action values at the end, or expected costs in a model of costs; for double Q-learning, the
        mean of both tables.
    policies : (U, K) int32
        Distinct greedy policies, by action number, in the order of their first appearance.
    snapshots : (E,) int32
        The number of the policy that was greedy after episode `snapshot_episode` of each epoch.
    last : (H,) int32
        The number of the policy that was greedy after each of the last episodes, the final one
        last.
    returns : (E,)
        Mean undiscounted return of each epoch's training episodes.
    steps, cut_short : int
        Timesteps in all, and episodes that reached `max_steps`.
    """

    space: StateSpace
    q: Floats
    policies: Numbers
    snapshots: Numbers
    last: Numbers
    returns: Floats
    steps: int
    cut_short: int

    @property
    def final(self) -> Numbers:
        """(K,) the greedy action of each row at the end."""
        return np.asarray(self.policies[self.last[-1]])

    def last_counts(self) -> dict[int, int]:
        """Return the count of each policy in the last episodes, the most frequent first."""
        numbers, counts = np.unique(self.last, return_counts=True)
        order = np.argsort(-counts, kind="stable")
        return dict(zip(numbers[order].tolist(), counts[order].tolist(), strict=True))

    def policy(self, mdp: MDP) -> Policy:
        """Return the final greedy policy."""
        return Policy(space=self.space, actions=mdp.actions, rule=self.final)
