"""The loss of a policy by errors of perception, and the costliest errors.

A policy π reads the perceived status z, drawn from C(s, ·). In terms of the true status it is a
mixed policy π_C (`mdp.care.perception`). With the occupancy measure d and action values Q of π_C,

    dV / dC(s, z) = Σ_x d(x, s) Σ_a π(a | x, z) Q(x, s, a),
    V^π - V^π_C = Σ_{s, z} C(s, z) Σ_x d(x, s) Σ_a (π(a | x, s) - π(a | x, z)) Q^π(x, s, a),

where Q^π are the action values of π with perfect perception from the next step on (performance
difference: Kakade and Langford, ICML 2002, lemma 6.1). With errors of at most e_d in d and e_Q in
Q, a sum is off by at most Σ d e_Q + e_d (|Q| + e_Q) and its own rounding.
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
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, TINY, gamma
from exact_mdp.solvers.claims import Bounded
from exact_mdp.solvers.values.evaluate import evaluate
from exact_mdp.solvers.values.policy_chain import policy_of


def _check_actions(model: MDP) -> None:
    """Raise ModelError if the available actions differ between the statuses of a place."""
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
    """The losses of a policy by errors of perception."""

    statuses: tuple[str, ...]  # names of the bits, the most significant first
    value: Bounded  # the value of the policy under the perception
    perfect: Bounded  # its value under perfect perception
    derivative: Floats  # (Z, Z) dV / dC(s, z); only differences within a row have a meaning
    loss: Floats  # (Z, Z) the loss by reading s as z; the sum is the loss against `perfect`
    # The gain per unit of a status's sensitivity and specificity, other statuses unchanged.
    rates: dict[str, tuple[float, float]]
    error: float  # bound for each entry of `derivative` and `loss`, and for each rate
    sense: Sense = Sense.MAX  # of the values: a loss of costs is a higher cost

    @property
    def marginal(self) -> Floats:
        """(Z, Z) the loss per unit of probability moved from reading s correctly to reading z."""
        return self.sense.sign * (np.diag(self.derivative)[:, None] - self.derivative)

    @property
    def by_status(self) -> dict[str, tuple[float, float]]:
        """Loss by status: by missing it when present, and by seeing it when absent.

        An error in which several statuses are misread is split equally between them, so that the
        losses by status sum to the whole loss.
        """
        # Bit k of s XOR z says whether status k is misread.
        number, shift = np.arange(len(self.loss)), np.arange(len(self.statuses))[::-1]
        wrong = (number[:, None] ^ number)[:, :, None] >> shift & 1
        share = wrong / np.maximum(wrong.sum(axis=2, keepdims=True), 1)
        split, present = self.loss[:, :, None] * share, number[:, None] >> shift & 1
        losses = {}
        for bit, name in enumerate(self.statuses):
            missed = float(split[present[:, bit] == 1, :, bit].sum())
            seen = float(split[present[:, bit] == 0, :, bit].sum())
            losses[name] = missed, seen
        return losses

    def frame(self) -> DataFrame:
        """Return one row for each pair of confused statuses, the costliest first."""
        form, loss, marginal, rows = f"0{len(self.statuses)}b", self.loss, self.marginal, []
        for true, seen in np.ndindex(loss.shape):
            if true != seen:
                names = format(true, form), format(seen, form)
                rows.append((*names, loss[true, seen], marginal[true, seen]))
        unit = self.sense.amount
        columns = ["true", "perceived", f"loss ({unit})", f"loss per unit of probability ({unit})"]
        return data_frame(sorted(rows, key=lambda row: -row[2]), columns=columns)

    def report(self) -> Report:
        """Return the value, the loss by the errors of each status, and the costliest confusions."""
        names = ("missed", "seen", "by_sensitivity", "by_specificity")
        headings = ("missed", "seen wrongly", "per unit of sensitivity", "of specificity")
        each = {title: f"{name}:.4f" for title, name in zip(headings, names, strict=True)}
        errors = {}
        for status, lost in self.by_status.items():
            errors[status] = dict(zip(names, (*lost, *self.rates[status]), strict=True))
        confusions = {"loss": self.loss, "marginal": self.marginal, "error_bound": self.error}
        return Report(
            title="errors of perception",
            facts={
                "claim": Shown(self.value.claim),
                "taken_as_true": self.value,
                "errors": errors,
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
    """Compute the losses of a policy by errors of perception, in total and per unit.

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
        If the model has no statuses, or the matrix does not fit them.

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

    # The policy under the perception, and with perfect perception; its action values by status.
    chosen = policy_of(model, policy)
    table = by_place(model, chosen.weights(model))  # by *perceived* status
    both = [evaluate(model, each) for each in (perceived(model, chosen, matrix), chosen)]
    reached, doubt, largest, tables = find_reachable_states(model), 0.0, 0.0, list[Floats]()
    for each in both:
        value = np.where(reached, each.value, 0.0)
        if not np.isfinite(value).all():
            raise ModelError(
                "the policy may go on forever, so the loss by errors of perception is unknown",
                where=model.space.place(int(np.flatnonzero(~np.isfinite(value))[0])),
                fix="give a discount below 1, or a number of steps",
            )
        doubt = max(doubt, float(each.error[reached].max()))
        ahead = np.abs(model.reward) + model.discount * (model.transition @ np.abs(value))
        largest = max(largest, float(ahead.max()))
        # (P, Z, Z): the value of acting on z in s, at each of P places.
        tables.append(by_place(model, model.backup(value)) @ table.transpose(0, 2, 1))
    by_seen, true_by_seen = tables

    # The two formulas at the head of the module.
    visits, regular = both[0].chain.discounted.visits, model.space.regular
    met, unsure = (x[:regular].reshape(-1, size) for x in (visits.value, visits.error))
    derivative = np.einsum("ps,psz->sz", met, by_seen)
    short = np.diagonal(true_by_seen, axis1=1, axis2=2)[:, :, None] - true_by_seen
    sense = model.sense
    loss = sense.sign * matrix * np.einsum("ps,psz->sz", met, short)

    # Rounding: the terms of one number are outcomes, actions, places, and pairs of statuses.
    terms = int(np.diff(model.table.offsets).max()) + model.n_actions + len(met) + size**2 + 16
    off = doubt + float(gamma(terms)) * largest + TINY * terms
    # Entries, and their sums over a row, are differences of two weighted means.
    error = 2 * float(met.sum() * off + unsure.sum() * (largest + off)) * SLACK

    # Sensitivity and specificity of one status: probability moves from each z to z with this bit
    # flipped.
    names, number = status_names(model), np.arange(size)
    rates = {}
    for name, flip in zip(names, 1 << np.arange(len(names))[::-1], strict=True):
        right, present = ((number[:, None] ^ number) & flip) == 0, number & flip > 0
        gain = (matrix + matrix[:, number ^ flip]) * (derivative - derivative[:, number ^ flip])
        gain = sense.sign * (gain * right).sum(axis=1)
        rates[name] = float(gain[present].sum()), float(gain[~present].sum())
    return ErrorCosts(
        statuses=names,
        value=both[0].start,
        perfect=both[1].start,
        derivative=derivative,
        loss=loss,
        sense=sense,
        rates=rates,
        error=error,
    )
