"""Values of one policy under many confusions of the status at once.

With accuracy x a status is read rightly with probability x where it is present and where it is
absent, the statuses independently. Where only counts of a confusion are known, its rows are drawn
from their posterior.

A confusion C makes a mixed policy π_C of the true status. Every number is a sum of products: with D
steps at most, n roundings in each of them and R the greatest reward of an outcome, a value is off
by at most γ(D n) D R (Higham, Accuracy and Stability of Numerical Algorithms, 2002, section 3.1).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import inf
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.mdp.care.perception import (
    LEVEL,
    Counted,
    by_place,
    independent,
    status_names,
    status_size,
)
from exact_mdp.mdp.errors import ModelError, known, listed
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Pictured, Result
from exact_mdp.mdp.table import Floats, float_of
from exact_mdp.mdp.validate import RNG, seed_of
from exact_mdp.solvers.bounds.bounds import levels
from exact_mdp.solvers.bounds.gains import SLACK, TINY, gamma
from exact_mdp.solvers.solution import Bounded, Estimated
from exact_mdp.solvers.values.layers import Layers
from exact_mdp.solvers.values.policy_chain import policy_of

if TYPE_CHECKING:
    from pandas import DataFrame

ALL = "all"
BATCH = 256  # matrices evaluated at once


class Passes:
    """Passes over the states of a model with statuses, of P places and Z statuses.

    Attributes
    ----------
    mdp : MDP
    layers : Layers
    rounding : float
        No value that is computed here is off by more.
    """

    def __init__(self, mdp: MDP) -> None:
        size, level = status_size(mdp), levels(mdp)
        if level is None:
            raise ModelError(
                "states come back to themselves, and what errors of perception cost is computed "
                "where they do not",
                where=f"model {mdp.name}".strip(),
                fix="use a scenario, whose trials and subtasks are counted",
            )
        offered = by_place(mdp, np.ones(mdp.n_pairs)) > 0
        differ = (offered != offered[:, :1]).any(axis=(1, 2))
        if differ.any():
            place = int(np.flatnonzero(differ)[0])
            raise ModelError(
                "the available actions reveal the status",
                where=f"{mdp.space.place(place * size)} and its other statuses",
                fix="offer the same actions in every status of a place",
            )
        self.mdp, self.statuses = mdp, size
        self.layers = Layers(mdp)
        steps = len(self.layers.blocks)
        widest = int(np.diff(mdp.table.offsets).max())
        largest = steps * float(np.abs(mdp.table.gains()).max(initial=0.0)) * SLACK
        terms = steps * (widest + 2 * size + 2 * mdp.n_actions + 12) + mdp.n_states + 4 * size
        self.rounding = (float(gamma(terms)) * largest + TINY * terms) * SLACK

    def table(self, policy: PolicyLike) -> Floats:
        """Return (P, Z, A) what a policy does at each place and *perceived* status."""
        return by_place(self.mdp, policy_of(self.mdp, policy).weights(self.mdp))

    def weights(self, table: Floats, confusions: Floats) -> Floats:
        """Return (L, N) probabilities of pairs in each *true* status, of confusions (N, Z, Z)."""
        mdp, regular = self.mdp, self.mdp.space.regular
        mixed = (confusions[:, None] @ table).reshape(len(confusions), regular, mdp.n_actions)
        inside = mdp.pair_state < regular  # the end has a single pair
        weights = np.ones((mdp.n_pairs, len(confusions)))
        weights[inside] = mixed[:, mdp.pair_state[inside], mdp.pair_action[inside]].T
        total = np.add.reduceat(weights, mdp.pair_offsets[:-1])
        return np.asarray(weights / total[mdp.pair_state])

    def at_start(self, values: Floats) -> Floats:
        """Return (N,) start values of values (S, N)."""
        return np.asarray(self.mdp.start_distribution @ values)

    def start_values(self, table: Floats, confusions: Floats) -> Floats:
        """Return (N,) the start values of a policy (P, Z, A) under confusions (N, Z, Z)."""
        return self.at_start(self.layers.mean(self.weights(table, confusions))[0])


def confusion_at(model: MDP, accuracy: float, status: str = ALL) -> Floats:
    """Return the confusion (Z, Z) at one accuracy of a status, the others perfect, or of all."""
    if not 0 <= accuracy <= 1:
        raise ModelError(f"accuracy is {accuracy}", where="accuracy", fix="choose from 0 to 1")
    names = status_names(model)
    known(status, (*names, ALL), "status", "accuracy")
    rates = [accuracy if status in (name, ALL) else 1.0 for name in names]
    return independent(rates, rates)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AccuracyCurves(Pictured):
    """Values of a policy on perceptions along accuracies, status by status and for all.

    Attributes
    ----------
    levels : (M,)
    values : {status, or "all": (M,)}
        The value where this status is perceived with the accuracy and the others perfectly.
    error : float
        No value is off by more than this.
    """

    levels: Floats
    values: dict[str, Floats]
    error: float

    def frame(self) -> DataFrame:
        """Return one row for each accuracy, one column for each status and for all."""
        import pandas

        return pandas.DataFrame({"accuracy": self.levels} | self.values)


def accuracy_curves(
    model: MDP,
    policy: PolicyLike = "optimal",
    *,
    levels: Iterable[float] | None = None,
    statuses: Sequence[str] | None = None,
) -> AccuracyCurves:
    """Return the value of a policy that takes what it perceives for true, along accuracies.

    Parameters
    ----------
    model : MDP
        With a column `status`.
    policy : PolicyLike
    levels : iterable of float, optional
        Accuracies; 51 from 0.5 to 1 unless given.
    statuses : sequence of str, optional
        The curves; one for each status and "all" unless given.

    Returns
    -------
    AccuracyCurves

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> curves = accuracy_curves(Scenario.load("yuan2025").compile(), levels=[0.9, 1])
    >>> curves.values["all"].round(4).tolist()
    [140.7766, 146.2359]
    """
    grid = np.linspace(0.5, 1.0, 51)
    if levels is not None:
        grid = np.array([float_of(level, "levels") for level in listed(levels, "levels")])
    passes = Passes(model)
    table, curves = passes.table(policy), {}
    names = (*status_names(model), ALL)
    for name in names if statuses is None else listed(statuses, "statuses"):
        matrices = np.stack([confusion_at(model, x, name) for x in grid.tolist()])
        curves[name] = passes.start_values(table, matrices)
    return AccuracyCurves(levels=grid, values=curves, error=passes.rounding)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class UncertainValue(Result):
    """A policy's value where the confusion is known from counts only.

    Attributes
    ----------
    at_mean : Bounded
        Under the posterior mean of the confusion.
    value : Estimated
        The mean over matrices drawn from the posterior.
    interval : (low, high)
        The credible interval, between quantiles of the draws.
    level : float
    draws : (N,)
        The values.
    """

    at_mean: Bounded
    value: Estimated
    interval: tuple[float, float]
    level: float
    draws: Floats

    @property
    def error(self) -> float:
        """The standard error of the mean."""
        return self.value.standard_error

    def frame(self) -> DataFrame:
        """Return one row for each draw."""
        import pandas

        return pandas.DataFrame({"value (reward)": self.draws})


def value_under_counts(
    model: MDP,
    policy: PolicyLike,
    counts: Counted,
    *,
    rng: RNG,
    n: int = 2000,
    level: float = LEVEL,
) -> UncertainValue:
    """Return the value of a policy under a confusion of which only counts are known.

    Of n matrices that are drawn from the posterior of the counts, which have a prior.
    """
    if n < 1 or not 0 < level < 1:
        raise ModelError(
            f"{n} draws, level {level}",
            where="value_under_counts",
            fix="give 1 or more, and such as 0.95",
        )
    drawn = rng if isinstance(rng, np.random.Generator) else np.random.default_rng(seed_of(rng))
    passes = Passes(model)
    table = passes.table(policy)
    sizes = [min(BATCH, n - first) for first in range(0, n, BATCH)]
    matrices = (counts.samples(drawn, size) for size in sizes)
    draws = np.concatenate([passes.start_values(table, some) for some in matrices])
    draws.setflags(write=False)
    tail = (1 - level) / 2
    low, high = np.quantile(draws, [tail, 1 - tail]).tolist()
    error = float(draws.std(ddof=1) / np.sqrt(n)) if n > 1 else inf
    return UncertainValue(
        at_mean=Bounded(
            value=float(passes.start_values(table, counts.mean[None])[0]), error=passes.rounding
        ),
        value=Estimated(value=float(draws.mean()), standard_error=error),
        interval=(low, high),
        level=level,
        draws=draws,
    )
