"""The average reward of a policy: gain, bias and shares of time, in floats or exactly.

The gain is the same from all states of a recurrent class; the bias is the value of a state beyond
it (`solvers.endless.chain`). Rationals are used if floats cannot bound the errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from exact_mdp.mdp.report import MOST_LISTED, Report, Shown, Table
from exact_mdp.mdp.result import DataFrame, Result, data_frame
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import BoundedVector
from exact_mdp.solvers.claims import Bounded, Claim, SolverError, Status
from exact_mdp.solvers.endless.chain import Classes, compute_laurent_expansion
from exact_mdp.solvers.values.policy_chain import (
    OfPolicy,
    PolicyChain,
    floats_first,
    is_too_inaccurate,
    round_fractions,
)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class AverageEvaluation(OfPolicy, Result):
    """The gain of a policy (its average reward per step), the bias and the shares of time."""

    chain: PolicyChain  # at discount 1
    classes: Classes
    value: Floats  # (S,) the gain
    error: Floats
    bias: Floats  # (S,)
    bias_error: Floats
    share: BoundedVector  # (S,) share of time in each state in the long run, from the start
    arrivals: BoundedVector  # (S,) expected visits from the start until a class's base is reached

    claim: ClassVar[Claim] = Claim.BOUNDED

    @property
    def visits(self) -> Floats:
        """(S,) the share of time; in transient states the expected visits from the start."""
        recurrent = self.classes.recurrent
        return np.where(recurrent, self.share.value, np.maximum(self.arrivals.value, 0.0))

    @cached_property
    def components(self) -> dict[str, Bounded]:
        """Each reward component's contribution to the gain from the start."""
        mdp, weights, shares = self.mdp, self.chain.weights, (self.share.value, self.share.error)
        total, error = self._sum_components(*(x[mdp.pair_state] * weights for x in shares))
        each = zip(mdp.component_names, total, error, strict=True)
        return {name: Bounded(value=float(x), error=float(off)) for name, x, off in each}

    def report(self) -> Report:
        """Return gain and components, and gain, bias and share of time of each state."""
        frame, parts = self.frame(), self.components
        by_state = None
        if self.mdp.n_states <= MOST_LISTED:
            by_state = frame.set_index("state").to_dict("index")
        facts = {
            "claim": Shown(self.claim),
            "mean": Shown(self.mean, self.start),
            "error_bound": Shown(self.start.error),
            "recurrent_classes": len(self.classes.base),
            "components": Shown({name: each.value for name, each in parts.items()}, parts),
            "by_state": Shown(by_state),
        }
        columns = {name: name for name in ("state", "gain", "bias", "share")}
        table = Table(title="gain, bias and share of time", rows=frame, columns=columns)
        return Report(title="average reward", facts=facts, tables={"states": table})

    def frame(self) -> DataFrame:
        """Return gain, bias and share of time of each state, with their error bounds."""
        columns = {
            "state": self.mdp.space.labels(range(len(self.value))),
            "gain": self.value,
            "gain error": self.error,
            "bias": self.bias,
            "bias error": self.bias_error,
            "share": self.share.value,
            "share error": self.share.error,
        }
        return data_frame(columns)

    def __repr__(self) -> str:
        return f"AverageEvaluation(gain at the start {self.start})"


def evaluate_average(chain: PolicyChain) -> AverageEvaluation:
    """Return the average reward of a policy: in rationals if floats cannot bound it.

    Raises SolverError if rationals would take too long.
    """
    # The gain does not depend on a discount.
    mdp = chain.mdp.undiscounted
    chain = replace(chain, mdp=mdp)
    classes, exact = chain.classes, True
    with floats_first(mdp):
        gain, bias = chain.going_on.evaluate_chain()
        share, arrivals = chain.going_on.compute_limit_distribution()
        # Subnormal floats have fewer digits, and the error bounds do not count that.
        if chain.probability.min() < np.finfo(np.float64).tiny:
            raise SolverError(Status.NO_BOUND, "probabilities are below the range of floats")
        exact = (
            is_too_inaccurate(share, mdp)
            or is_too_inaccurate(gain, mdp)
            or not np.isfinite(share.error).all()
        )
    if exact:
        # The first two terms of the Laurent expansion are gain and bias.
        own = chain.exactly
        classes, levels = own.classes, compute_laurent_expansion(own, own.reward)[:2]
        gain, bias = map(round_fractions, levels)
        share, arrivals = map(round_fractions, own.compute_limit_distribution(mdp.start))
    return AverageEvaluation(
        chain=chain,
        classes=classes,
        value=gain.value,
        error=gain.error,
        bias=bias.value,
        bias_error=bias.error,
        share=share,
        arrivals=arrivals,
    )
