"""Which errors of perception cost a policy most.

The policy π reads the perceived status z, drawn from C(s, ·). With the occupancy d and the action
values Q of the mixed policy π_C that it makes of the true status (`mdp.care.perception`),

    dV / dC(s, z) = Σ_x d(x, s) Σ_a π(a | x, z) Q(x, s, a) = G(s, z),

and moving a small probability from reading s rightly to reading z changes V by G(s, z) - G(s, s)
for each unit of it. The loss against perfect perception is a sum over what is misread as what,

    V^π - V^π_C = Σ_{s, z} C(s, z) Σ_x d(x, s) Σ_a (π(a | x, s) - π(a | x, z)) Q^π(x, s, a),

where Q^π are the action values of whoever reads rightly from the next step on (performance
difference: Kakade and Langford, Approximately optimal approximate reinforcement learning, ICML
2002, lemma 6.1). Sums of products, all of them: with n roundings each is off by at most γ(n) times
the same sum over absolute values, of which one bound for all is given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.analysis.perception.values import Passes
from exact_mdp.mdp.care.perception import by_place, checked, status_names
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table, at_most
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK
from exact_mdp.solvers.solution import Bounded

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ErrorCosts(Pictured):
    """Which errors of perception cost a policy most.

    Attributes
    ----------
    statuses : tuple of str
        Names of the bits, the most significant first.
    value, perfect : Bounded
        The policy's value under the perception, and where it sees the truth.
    derivative : (Z, Z)
        dV / dC(s, z); only differences within a row have a meaning of their own.
    loss : (Z, Z)
        What reading s as z loses; the sum is `perfect` less `value`.
    rates : {status: (by sensitivity, by specificity)}
        The value that one unit more of a status's sensitivity or specificity brings, the reading
        of the other statuses held as it is.
    error : float
        No entry of `derivative` or `loss`, and no rate, is off by more than this.
    """

    statuses: tuple[str, ...]
    value: Bounded
    perfect: Bounded
    derivative: Floats
    loss: Floats
    rates: dict[str, tuple[float, float]]
    error: float

    @property
    def marginal(self) -> Floats:
        """(Z, Z) what each unit of probability moved from s read rightly to z loses."""
        return np.asarray(np.diag(self.derivative)[:, None] - self.derivative)

    @property
    def by_status(self) -> dict[str, tuple[float, float]]:
        """Loss by status: missed where present, and seen where absent.

        An error in which several statuses are misread counts for each of them in equal parts, so
        that these, too, sum to the whole loss.
        """
        number, shift = np.arange(len(self.loss)), np.arange(len(self.statuses))[::-1]
        wrong = (number[:, None] ^ number)[:, :, None] >> shift & 1
        share = wrong / np.maximum(wrong.sum(axis=2, keepdims=True), 1)
        present = number[:, None] >> shift & 1
        split = self.loss[:, :, None] * share
        return {
            name: (
                float(split[present[:, bit] == 1, :, bit].sum()),
                float(split[present[:, bit] == 0, :, bit].sum()),
            )
            for bit, name in enumerate(self.statuses)
        }

    def frame(self) -> DataFrame:
        """Return one row for each pair of statuses that is confused, the costliest first."""
        import pandas

        bits = len(self.statuses)
        rows = [
            (
                format(true, f"0{bits}b"),
                format(seen, f"0{bits}b"),
                self.loss[true, seen],
                self.marginal[true, seen],
            )
            for true, seen in np.ndindex(self.loss.shape)
            if true != seen
        ]
        names = ["true", "perceived", "loss (reward)", "loss per unit of probability (reward)"]
        return pandas.DataFrame(sorted(rows, key=lambda row: -row[2]), columns=names)

    def report(self) -> Report:
        """Return the value, what the errors of each status cost, and the costliest confusions."""
        names = ("missed", "seen", "by_sensitivity", "by_specificity")
        frame, digits = self.frame(), ".4f"
        true, seen, loss, marginal = frame.columns
        headings = ("missed", "seen wrongly", "per unit of sensitivity", "of specificity")
        each = {title: f"{name}:{digits}" for title, name in zip(headings, names, strict=True)}
        costs = {"loss": f"{loss}:{digits}", "per unit of probability": f"{marginal}:{digits}"}
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
                    f"{at_most(self.error)})",
                    columns={"status": "", **each},
                ),
                "costliest": Table(
                    title="the costliest confusions",
                    rows=frame,
                    columns={"true": true, "perceived": seen, **costs},
                    first=12,
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
    passes = Passes(model)
    size, table = passes.statuses, passes.table(policy)
    matrix = checked(confusion, size=size, where="confusion matrix")
    matrix = np.asarray(matrix / matrix.sum(axis=1, keepdims=True))
    weights = passes.weights(table, np.stack([matrix, np.eye(size)]))
    value, q = passes.layers.mean(weights)
    value_read, perfect = passes.at_start(value).tolist()
    met = passes.layers.visits(weights[:, :1])[:, 0][: model.space.regular].reshape(-1, size)
    # (P, Z, Z): what acting by z is worth in s
    by_seen, true_by_seen = (by_place(model, each) @ table.transpose(0, 2, 1) for each in q.T)
    derivative = np.einsum("ps,psz->sz", met, by_seen)
    short = np.diagonal(true_by_seen, axis1=1, axis2=2)[:, :, None] - true_by_seen
    loss = matrix * np.einsum("ps,psz->sz", met, short)
    # Visits sum to the steps at most, and no difference of values exceeds twice the largest.
    error = 4 * size * len(passes.layers.blocks) * passes.rounding * SLACK
    names = status_names(model)
    return ErrorCosts(
        statuses=names,
        value=Bounded(value=value_read, error=passes.rounding),
        perfect=Bounded(value=perfect, error=passes.rounding),
        derivative=derivative,
        loss=loss,
        rates={name: _rate(matrix, derivative, bit, names) for bit, name in enumerate(names)},
        error=error,
    )


def _rate(
    matrix: Floats, derivative: Floats, bit: int, names: tuple[str, ...]
) -> tuple[float, float]:
    """Return dV by sensitivity and by specificity of one status, other readings held."""
    number = np.arange(len(matrix))
    flip = 1 << (len(names) - 1 - bit)
    right = ((number[:, None] ^ number) & flip) == 0
    gain = (matrix + matrix[:, number ^ flip]) * (derivative - derivative[:, number ^ flip])
    gain = (gain * right).sum(axis=1)
    present = number & flip > 0
    return float(gain[present].sum()), float(gain[~present].sum())
