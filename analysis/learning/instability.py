"""Why the greedy action of a row keeps changing: gaps at the fixed point beside the noise there.

`solvers.learning.mean_field` gives the fixed point of Q-learning and the covariance Σ that a
constant learning rate leaves around it. Two predictions follow of how often each action of a row is
greedy.

linear     Q ~ N(Q*, Σ): as if nothing depended on which action is greedy.
switching  Q ← Q + α (h(Q) + C^½ z), z standard normal, once an episode, with the drift h and the
           covariance C of whichever action is greedy in the row at the moment. An action is updated
           often only while it is greedy, and corrected slowly after it came out too low, so that
           its values are low on average (the hot stove effect: Denrell and March, Organization
           Science 12, 2001). The other rows are held at their greedy actions.

Neither uses a sampled episode of the model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.learning.outcomes import Interval, share_interval
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.randomness import RNG, seed_of
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.learning.mean_field import MeanField, settle
from exact_mdp.solvers.learning.q_learning import QLearning
from exact_mdp.solvers.learning.sampler import rows_of

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")

DRAWS = 2**18


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Prediction(Result):
    """How often each action of a row should be greedy at the end of training.

    Attributes
    ----------
    row : int
    label : str
        The row in words.
    field : MeanField
        The fixed point.
    rate : float
        The learning rate α at the end.
    gaps, spread : (A,)
        How far each action is below the best at the fixed point, and the standard deviation that α
        leaves of it; NaN for actions that the row lacks.
    linear, switching : (A,)
        Predicted shares.
    switching_error : (A,)
        Standard errors of `switching`, which is simulated.
    """

    row: int
    label: str
    field: MeanField
    rate: float
    gaps: Floats
    spread: Floats
    linear: Floats
    switching: Floats
    switching_error: Floats

    @property
    def actions(self) -> Integers:
        """(n,) the actions that the row offers."""
        return np.flatnonzero(~np.isnan(self.gaps))

    def frame(self) -> DataFrame:
        """Return one row for each action that is offered."""
        some = self.actions
        return pandas.DataFrame(
            {
                "fixed_point": self.field.q[self.row, some],
                "gap": self.gaps[some],
                "noise": self.spread[some],
                "linear": self.linear[some],
                "switching": self.switching[some],
                "switching_error": self.switching_error[some],
            },
            index=pandas.Index([self.field.mdp.actions[a] for a in some], name="action"),
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Comparison(Result):
    """A prediction beside what runs ended with.

    Attributes
    ----------
    counts : (A,) ints
        Runs that ended with each action.
    intervals : tuple of (low, high)
        Wilson's 95 % intervals of their shares.
    distance : float
        Total variation distance between predicted and observed shares.
    noise : float
        What that distance would be on average if the prediction were right.
    """

    counts: Integers
    intervals: tuple[Interval, ...]
    distance: float
    noise: float

    def frame(self) -> DataFrame:
        """Return one row for each action."""
        low, high = np.array(self.intervals).T
        return pandas.DataFrame({"runs": self.counts, "low share": low, "high share": high})


def predict(
    model: MDP,
    settings: QLearning,
    *,
    row: int = 0,
    policy: Sequence[int] | None = None,
    rng: RNG = 0,
    n: int = 128,
    episodes: int = 8000,
) -> Prediction:
    """Return the shares that theory predicts for the greedy action of a row under `settings`.

    The search for the fixed point starts at `policy` (K,), each row's first action unless given.
    The equation of `switching` is simulated on n paths of this many episodes, the first half of
    which is thrown away. ModelError names settings without a theory (see `require_theory`), and
    greedy steps that find no fixed point.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> found = predict(Scenario.load("yuan2025").compile(), QLearning(), episodes=100, n=4)
    >>> found.label, found.gaps.round(2).tolist()
    ('status 0000', [9.31, 4.34, 0.0, 1.52])
    """
    require_theory(settings)
    mdp, rows = model, rows_of(model, settings.columns)
    first = rows.offered.argmax(axis=1) if policy is None else np.asarray(policy)
    epsilon = float(settings.exploration.values(settings.epochs)[-1])
    rate = float(settings.rate.values(settings.epochs)[-1])

    def settled(start: Integers, held: Sequence[int] = ()) -> MeanField:
        return settle(
            mdp,
            start,
            epsilon=epsilon,
            discount=settings.discount,
            columns=settings.columns,
            bootstrap_end=settings.bootstrap_end,
            held=held,
        )

    field = settled(first)
    if not field.consistent:
        raise ModelError(
            "greedy steps repeat themselves: no fixed point was found",
            where="predict",
            fix="start from another policy, or explore more",
        )
    actions = np.flatnonzero(rows.offered[row])
    regimes = []
    for action in actions:
        start = field.policy.copy()
        start[row] = action
        regimes.append(settled(start, held=[row]))
    entries = row * mdp.n_actions + actions
    place = np.searchsorted(field.used, entries)
    if not np.array_equal(field.used[place % len(field.used)], entries):
        raise ModelError(
            "some of the row's actions are never taken",
            where=rows.space.label(row),
            fix="explore, and choose a row that is visited",
        )
    shares = _switching(regimes, place, rate, (seed_of(rng), n, episodes))

    def over(values: Floats, fill: float) -> Floats:
        full = np.full(mdp.n_actions, fill)
        full[actions] = values
        return full

    return Prediction(
        row=row,
        label=rows.space.label(row),
        field=field,
        rate=rate,
        gaps=over(field.gaps[row, actions], np.nan),
        spread=over(field.spread(rate)[row, actions], np.nan),
        linear=over(_linear(field, place, rate), 0.0),
        switching=over(shares.mean(axis=0), 0.0),
        switching_error=over(shares.std(axis=0, ddof=1) / np.sqrt(n), 0.0),
    )


def require_theory(settings: QLearning) -> None:
    """Raise ModelError for settings that `predict` has no theory for."""
    if settings.method != "q-learning" or settings.rate_power:
        raise ModelError(
            f"there is no theory for {settings.method} with rate_power {settings.rate_power:g}",
            where="predict",
            fix="use Q-learning with a rate that does not depend on visits",
        )


def compare(predicted: Floats, counts: Integers) -> Comparison:
    """Return predicted shares (A,) beside the counts (A,) of runs."""
    total = int(counts.sum())
    observed = counts / total
    drawn = np.random.default_rng(0).multinomial(total, predicted / predicted.sum(), 4000)
    return Comparison(
        counts=counts,
        intervals=tuple(share_interval(int(count), total) for count in counts),
        distance=float(np.abs(predicted - observed).sum() / 2),
        noise=float((np.abs(drawn / total - predicted).sum(axis=1) / 2).mean()),
    )


def _linear(field: MeanField, place: Integers, rate: float) -> Floats:
    """Return (n,) shares of each of n actions being greedy under the normal law."""
    covariance = field.covariance(rate)[np.ix_(place, place)]
    mean = field.q.reshape(-1)[field.used[place]]
    draw = np.random.default_rng(0).standard_normal((DRAWS, len(place)))
    values = mean + draw @ _root(covariance).T
    return np.bincount(values.argmax(axis=1), minlength=len(place)) / DRAWS


def _switching(
    regimes: Sequence[MeanField], place: Integers, rate: float, sizes: tuple[int, int, int]
) -> Floats:
    """Return (n, m) shares of time that each of m actions is greedy."""
    seed, n, episodes = sizes
    used = regimes[0].used
    if any(not np.array_equal(field.used, used) for field in regimes):
        raise ModelError(
            "which entries are updated depends on the greedy action", where="predict", fix="explore"
        )
    drift = [rate * field.drift for field in regimes]
    pull = [np.eye(len(used)) + rate * field.jacobian.T for field in regimes]
    noise = [rate * _root(field.noise).T for field in regimes]
    generator = np.random.default_rng(seed)
    q = np.repeat(regimes[0].q.reshape(1, -1)[:, used], n, axis=0)
    shares = np.zeros((n, len(regimes)))
    for episode in range(episodes):
        greedy = q[:, place].argmax(axis=1)
        draw = generator.standard_normal(q.shape)
        for regime in np.unique(greedy):
            at = greedy == regime
            q[at] = q[at] @ pull[regime] + drift[regime] + draw[at] @ noise[regime]
        if episode >= episodes // 2:
            shares[np.arange(n), q[:, place].argmax(axis=1)] += 1
    return np.asarray(shares / shares.sum(axis=1, keepdims=True))


def _root(covariance: Floats) -> Floats:
    """Return a matrix R with R Rᵀ = covariance."""
    values, vectors = np.linalg.eigh(covariance)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
