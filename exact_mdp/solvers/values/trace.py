"""Cohort traces: the share of a cohort in each state at each time, under a policy.

    x_0 = the start,    x_{t+1} = x_t P_π

A terminal state keeps those who have come to it, so every row sums to 1. A model with a column of
its own for the time (`within`, `from_steps`) has the trace of all its steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, named_options
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.questions.horizon import count_steps
from exact_mdp.mdp.report import Report, Shown
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame, frame_to_table
from exact_mdp.mdp.table import MOST_BYTES, Floats
from exact_mdp.mdp.validate import require_count
from exact_mdp.solvers.arguments import mdp_of
from exact_mdp.solvers.bounds.gains import SLACK, gamma
from exact_mdp.solvers.claims import Claim
from exact_mdp.solvers.values.policy_chain import PolicyChain


@dataclass(frozen=True, kw_only=True, repr=False)
class Trace(Pictured):
    """The share (N+1, S) of a cohort in each of S states at the times 0 … N.

    `states` are the names of the states, and `error` bounds the error of every share.
    """

    states: tuple[str, ...]
    share: Floats
    error: float

    claim: ClassVar[Claim] = Claim.BOUNDED

    def __repr__(self) -> str:
        times, states = self.share.shape
        return f"Trace({times - 1:,} steps, {states:,} states; bounded, within {self.error:.1e})"

    def frame(self) -> DataFrame:
        """Return the shares as a table, one row for each time."""
        table = data_frame(self.share, columns=list(self.states))
        table.insert(0, "time", range(len(self.share)))
        return table

    def report(self) -> Report:
        """Return the table, and the error that bounds all its numbers."""
        facts = {
            "claim": Shown(self.claim),
            "steps": len(self.share) - 1,
            "error_bound": Shown(self.error),
        }
        return Report(title=repr(self), facts=facts, tables={"trace": frame_to_table(self.frame())})


@named_options
def cohort_trace(
    model: Scenario | MDP, policy: PolicyLike = "optimal", steps: int | None = None
) -> Trace:
    """Return the share of a cohort in each state at each time.

    Parameters
    ----------
    model : Scenario or MDP
        With a time of its own, or without.
    policy : PolicyLike
    steps : int, optional
        The number of steps of a model without a time.

    Returns
    -------
    Trace

    Raises
    ------
    ModelError
        Without a number of steps, or with one for a model that has its own.

    Examples
    --------
    >>> ill = MDP.from_arrays([[["9/10", "1/10"], [0, 1]]], [1, 0], states=["ill", "dead"])
    >>> print(cohort_trace(ill, steps=2).frame().round(2).to_string(index=False))
     time  ill  dead
        0 1.00  0.00
        1 0.90  0.10
        2 0.81  0.19
    """
    mdp = mdp_of(model)
    space = mdp.space.untimed
    if space is None:
        fix = "say how many: steps=40, or ask a model that stops: mdp.within(40)"
        if steps is None:
            raise ModelError("the number of steps is missing", where="steps", fix=fix)
        space, own = mdp.space, np.arange(mdp.n_states)
    else:
        if steps is not None:
            fix = "leave steps out"
            raise ModelError("the model has a number of steps of its own", where="steps", fix=fix)
        steps = count_steps(mdp)
        # The number of each state without its time; extra states come last.
        states, last = np.arange(mdp.n_states), mdp.space.regular
        own = np.where(states < last, states % space.regular, states - last + space.regular)
    count = require_count(steps, "steps", least=0)
    if (count + 1) * space.size * 8 > MOST_BYTES:
        what = f"{count:,} steps of {space.size:,} states take more than {MOST_BYTES / 1e9:g} GB"
        raise ModelError(what, where="steps", fix="choose fewer steps")
    chain = PolicyChain.of(mdp, policy)
    onward, over = chain.transition.T.tocsr(), mdp.terminal
    at, rows = mdp.start_distribution, []
    for step in range(count + 1):
        if step:
            at = onward @ at + np.where(over, at, 0.0)
        rows.append(np.bincount(own, weights=at))
    # A step adds up at most as many products as outcomes arrive in a state, and those who have come
    # there before; the sums are at most 1, so each step adds γ to the error of every share. The
    # start is rounded once, and a state's share is a sum over all times.
    terms = int(np.diff(onward.indptr).max()) + chain.roundings + 1
    error = count * gamma(terms) + gamma(count + 1)
    return Trace(
        states=tuple(map(space.plain_label, range(space.size))),
        share=np.array(rows),
        error=float(error * SLACK),
    )
