"""What errors of perception cost a policy, and which cost most.

A policy π reads the perceived status z, drawn from C(s, ·). With the occupancy d and the action
values Q of the mixed policy π_C that it makes of the true status (`mdp.care.perception`),

    dV / dC(s, z) = Σ_x d(x, s) Σ_a π(a | x, z) Q(x, s, a),
    V^π - V^π_C = Σ_{s, z} C(s, z) Σ_x d(x, s) Σ_a (π(a | x, s) - π(a | x, z)) Q^π(x, s, a),

where Q^π are the action values of whoever reads rightly from the next step on (performance
difference: Kakade and Langford, ICML 2002, lemma 6.1). With d within e_d and Q within e_Q of the
exact ones, a sum is off by at most Σ d e_Q + e_d (|Q| + e_Q) and its own rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.mdp.care.perception import (
    by_place,
    perceived,
    require_confusion_matrix,
    status_names,
    status_size,
)
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table, format_error_bound
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame, frame_to_table
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, TINY, gamma
from exact_mdp.solvers.solution import Bounded
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.policy_chain import policy_of


def _check_actions(model: MDP) -> None:
    """Raise ModelError where a place offers other actions in one of its statuses."""
    offered = by_place(model, np.ones(model.n_pairs)) > 0
    differ = np.flatnonzero((offered != offered[:, :1]).any(axis=(1, 2)))
    if len(differ):
        raise ModelError(
            "the available actions reveal the status",
            where=f"{model.space.place(int(differ[0]) * status_size(model))} and its other "
            "statuses",
            fix="offer the same actions in every status of a place",
        )


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ErrorCosts(Pictured):
    """Which errors of perception cost a policy most."""

    statuses: tuple[str, ...]  # names of the bits, the most significant first
    value: Bounded  # of the policy under the perception
    perfect: Bounded  # where it sees the truth
    derivative: Floats  # (Z, Z) dV / dC(s, z); only differences within a row have a meaning
    loss: Floats  # (Z, Z) what reading s as z loses; the sum is what `perfect` is better by
    # What a unit more of a status's sensitivity or specificity brings, others read as they are.
    rates: dict[str, tuple[float, float]]
    error: float  # of each entry of `derivative` and `loss`, and of each rate, at most
    sign: int = 1  # -1 where values are costs: a loss is what they are more

    @property
    def marginal(self) -> Floats:
        """(Z, Z) what each unit of probability moved from s read rightly to z loses."""
        return self.sign * (np.diag(self.derivative)[:, None] - self.derivative)

    @property
    def by_status(self) -> dict[str, tuple[float, float]]:
        """Loss by status: missed where present, and seen where absent.

        An error in which several statuses are misread counts for each of them in equal parts, so
        that these, too, sum to the whole loss.
        """
        number, shift = np.arange(len(self.loss)), np.arange(len(self.statuses))[::-1]
        wrong = (number[:, None] ^ number)[:, :, None] >> shift & 1
        share = wrong / np.maximum(wrong.sum(axis=2, keepdims=True), 1)
        split, present = self.loss[:, :, None] * share, number[:, None] >> shift & 1
        sums = [
            [float(split[present[:, bit] == there, :, bit].sum()) for there in (1, 0)]
            for bit in range(len(shift))
        ]
        return {name: (lost, seen) for name, (lost, seen) in zip(self.statuses, sums, strict=True)}

    def frame(self) -> DataFrame:
        """Return one row for each pair of statuses that is confused, the costliest first."""
        form, loss, marginal = f"0{len(self.statuses)}b", self.loss, self.marginal
        rows = [
            (format(true, form), format(seen, form), loss[true, seen], marginal[true, seen])
            for true, seen in np.ndindex(loss.shape)
            if true != seen
        ]
        unit = "reward" if self.sign > 0 else "cost"
        names = ["true", "perceived", f"loss ({unit})", f"loss per unit of probability ({unit})"]
        return data_frame(sorted(rows, key=lambda row: -row[2]), columns=names)

    def report(self) -> Report:
        """Return the value, what the errors of each status cost, and the costliest confusions."""
        names = ("missed", "seen", "by_sensitivity", "by_specificity")
        headings = ("missed", "seen wrongly", "per unit of sensitivity", "of specificity")
        each = {title: f"{name}:.4f" for title, name in zip(headings, names, strict=True)}
        confusions = {"loss": self.loss, "marginal": self.marginal, "error_bound": self.error}
        return Report(
            title="errors of perception",
            facts={
                "claim": Shown(self.value.claim),
                "taken_as_true": self.value,
                "errors": {
                    status: dict(zip(names, (*lost, *self.rates[status]), strict=True))
                    for status, lost in self.by_status.items()
                },
                "confusions": Shown(confusions),
            },
            tables={
                "errors": Table(
                    title="what errors cost where the status seen is taken for true (within "
                    f"{format_error_bound(self.error)})",
                    columns={"status": "", **each},
                ),
                "costliest": replace(
                    frame_to_table(self.frame(), "the costliest confusions"), first=12
                ),
            },
        )


def error_costs(model: MDP, policy: PolicyLike, confusion: ArrayLike) -> ErrorCosts:
    """Return which errors of perception cost a policy most, at the margin and in all.

    Parameters
    ----------
    model : MDP
        Compiled from a scenario.
    policy : policy
        It reads the perceived status.
    confusion : (Z, Z) array
        The probabilities of the perceived status (columns) given the true one (row).

    Returns
    -------
    ErrorCosts

    Raises
    ------
    ModelError
        Where the model has no statuses, or the matrix does not fit them.

    Examples
    --------
    >>> from exact_mdp import Scenario, error_costs, independent
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> costs = error_costs(mdp, "optimal", independent([0.9] * 4, [0.9] * 4))
    >>> whole = costs.perfect.value - costs.value.value
    >>> bool(abs(costs.loss.sum() - whole) < 1e-9), max(costs.by_status, key=costs.by_status.get)
    (True, 'disengagement')
    """
    size = status_size(model)
    matrix = require_confusion_matrix(confusion, size=size, where="confusion matrix")
    matrix = matrix / matrix.sum(axis=1, keepdims=True)
    _check_actions(model)
    chosen = policy_of(model, policy)
    table = by_place(model, chosen.weights(model))  # by *perceived* status
    both = [evaluate(model, each) for each in (perceived(model, chosen, matrix), chosen)]
    reached, doubt, largest, tables = find_reachable_states(model), 0.0, 0.0, list[Floats]()
    for each in both:
        value = np.where(reached, each.value, 0.0)
        if not np.isfinite(value).all():
            raise ModelError(
                "the policy may go on for ever, and what errors of perception cost is unknown",
                where=model.space.place(int(np.flatnonzero(~np.isfinite(value))[0])),
                fix="give a discount below 1, or a number of steps",
            )
        doubt = max(doubt, float(each.error[reached].max()))
        ahead = np.abs(model.reward) + model.discount * (model.transition @ np.abs(value))
        largest = max(largest, float(ahead.max()))
        # (P, Z, Z): what acting by z is worth in s
        tables.append(by_place(model, model.backup(value)) @ table.transpose(0, 2, 1))
    by_seen, true_by_seen = tables
    visits, regular = both[0].chain.discounted.visits, model.space.regular
    met, unsure = (x[:regular].reshape(-1, size) for x in (visits.value, visits.error))
    derivative = np.einsum("ps,psz->sz", met, by_seen)
    short = np.diagonal(true_by_seen, axis1=1, axis2=2)[:, :, None] - true_by_seen
    sign = model.sign  # of costs, what is lost is what they are more
    loss = sign * matrix * np.einsum("ps,psz->sz", met, short)
    # What is added to one number: outcomes, actions, places, then statuses true and perceived.
    terms = int(np.diff(model.table.offsets).max()) + model.n_actions + len(met) + size**2 + 16
    off = doubt + float(gamma(terms)) * largest + TINY * terms
    # Entries and their sums over a row are differences of two, each in parts that sum to 1.
    error = 2 * float(met.sum() * off + unsure.sum() * (largest + off)) * SLACK
    names, number = status_names(model), np.arange(size)
    rates = {}
    for name, flip in zip(names, 1 << np.arange(len(names))[::-1], strict=True):
        right, present = ((number[:, None] ^ number) & flip) == 0, number & flip > 0
        gain = (matrix + matrix[:, number ^ flip]) * (derivative - derivative[:, number ^ flip])
        gain = sign * (gain * right).sum(axis=1)
        rates[name] = float(gain[present].sum()), float(gain[~present].sum())
    return ErrorCosts(
        statuses=names,
        value=both[0].start,
        perfect=both[1].start,
        derivative=derivative,
        loss=loss,
        sign=sign,
        rates=rates,
        error=error,
    )
