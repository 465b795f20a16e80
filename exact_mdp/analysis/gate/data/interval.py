"""Confidence intervals for the regret of a policy, from recorded data.

Each kind of evidence, `Robust`, `Posterior` or `OffPolicy`, has a method `interval(model, own,
confidence)` that returns a `RegretInterval` for a policy's probabilities of pairs: (L,), or (N, L)
by time in episodes of N steps. A limit is kept if the upper end keeps it, and broken if the lower
end breaks it; in between, more records may decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.analysis.vary.intervals import Ranged, estimate_share
from exact_mdp.mdp.errors import ModelError, join_few
from exact_mdp.mdp.io.transitions import CUT_OFF
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.report import Report, Shown
from exact_mdp.mdp.result import DataFrame, Result, data_frame
from exact_mdp.mdp.table import Floats, Integers, exact, float_of
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.claims import Claim, LowHigh, Ordered, is_at_most

Ends = tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RegretInterval(Ordered, Result):
    """A confidence interval for the regret at the start, in the process behind the records.

    `audit.interval <= 0.05` asks whether the whole interval keeps a limit.

    Attributes
    ----------
    confidence : float
        The share of data sets for which the interval is to hold; for a posterior interval, the
        share of models.
    assumptions : tuple of str
        The assumptions on which the interval rests besides the records.
    """

    low: float  # in units of reward
    high: float
    confidence: float
    by: str  # "robust", "posterior" or "off-policy"
    assumptions: tuple[str, ...]
    found: Mapping[str, Any]  # other results of this kind of evidence: {name: number or pair}
    claim: Claim = Claim.ESTIMATED  # bounded if it holds for every process in sets of rows
    draws: Floats | None = None  # (D,) for a posterior: the regret in each model drawn

    advice = "compare its low or high end, or estimate the model from more records"

    @property
    def bounds(self) -> LowHigh:
        """The two ends of the interval."""
        return self.low, self.high

    def __repr__(self) -> str:
        return f"RegretInterval({self})"

    def __str__(self) -> str:
        level = f"{100 * self.confidence:.10g} % confidence"
        return f"{self:.6g} at {level}, {self.by}"

    def __format__(self, spec: str) -> str:
        if not spec:
            return str(self)
        return f"[{self.low:{spec}}, {self.high:{spec}}]"

    def keeps_limit(self, limit: Fraction) -> bool | None:
        """Return whether the regret is at most `limit`; None if the records leave it open."""
        return is_at_most(self.bounds, (limit, limit))

    def within(self, limit: Fraction) -> Ranged:
        """Estimate from the draws the probability that the regret is at most `limit`."""
        assert self.draws is not None
        hits = int((self.draws <= float_of(limit, "limit")).sum())
        return estimate_share(hits, len(self.draws))

    def list_facts(self, limit: Fraction | None) -> dict[str, Any]:
        """Return the facts for a report; with draws, also the probability of keeping the limit."""
        found = dict(self.found)
        if self.draws is not None and limit is not None:
            found["probability_within"] = self.within(limit)
        return {
            "regret_interval": Shown((self.low, self.high), f"{self} ({self.claim})"),
            "confidence": Shown(self.confidence),
            "by": Shown(self.by),
            "interval": found,
            "assumptions": Shown(self.assumptions),
        }

    def report(self) -> Report:
        """Return the interval, the other results, and the assumptions."""
        notes = [f"assumed: {each}" for each in self.assumptions]
        facts = {**self.list_facts(None), "claim": Shown(self.claim)}
        return Report(title="interval of the regret", facts=facts, notes=notes)

    def frame(self) -> DataFrame:
        """Return the interval and the other results in one row."""
        ends = {"low": self.low, "high": self.high, "confidence": self.confidence, "by": self.by}
        return data_frame([ends | dict(self.found)])


def observations_of(mdp: MDP) -> Integers:
    """Return (L,) how often each pair was seen; raise ModelError if the model has no counts."""
    if mdp.observations is None or not mdp.observations.any():
        raise ModelError(
            "the model has no counts, which a confidence needs",
            where="confidence",
            fix="estimate it from records: MDP.from_transitions, or exact-mdp data; counts are "
            "lost when a question is asked or rows change, also by within(N) (give horizon=N)",
        )
    return mdp.observations


def of_process(mdp: MDP) -> tuple[str, ...]:
    """Return the assumptions of every interval on the process behind a model's counts."""
    sentences = [
        "the process has the states and actions that were recorded, and what follows a state and "
        "an action depends on these alone",
    ]
    if mdp.episodes is None:
        sentences.append("episodes begin as the model says")
    else:
        sentences.append(
            "the recorded episodes begin as the process does, independently of one another"
        )
    ends = list_entered_states(mdp)
    if ends:
        sentences.append(
            f"nothing is earned after {_format_first_names(ends)}: states that were entered and "
            "never left count as terminal"
        )
    # `Robust.assumptions` reports actions that nobody took although the model offers them.
    offered = set(zip(mdp.pair_state.tolist(), mdp.pair_action.tolist(), strict=True))
    names = []
    for state, action in never_taken(mdp).tolist():
        if (state, action) not in offered:
            names.append(f"{mdp.space.label(state)}: {mdp.actions[action]}")
    if names:
        sentences.append(
            f"actions that nobody took are not available: {_format_first_names(names)}"
        )
    if mdp.n_actions == 1:
        sentences.append(
            "only one action was ever taken, and no other is available: nothing can be lost"
        )
    return tuple(sentences)


def format_states(mdp: MDP, states: Flags) -> str:
    """Return the names of some states (S,) in brackets."""
    return _format_first_names(mdp.space.labels(np.flatnonzero(states)))


def _format_first_names(names: Sequence[str]) -> str:
    return f"({join_few(names, len(names))})"


def parse_range(given: Any, what: str) -> Ends | None:
    """Return the ends of a range that the user states; None if none is given."""
    if given is None:
        return None
    try:
        low, high = (float(exact(end)) for end in given)
    except (TypeError, ValueError, OverflowError) as error:
        raise ModelError(f"{given!r} is not a range", where=what, fix="give (low, high)") from error
    if not low <= high:
        fix = "give the lower end first"
        raise ModelError(f"the range {low:g} to {high:g} is reversed", where=what, fix=fix)
    return low, high


# ---- questions about the model that records leave open -------------------------------------------


def find_recorded_ends(mdp: MDP) -> Flags:
    """Return (S,) the terminal states that were never left, and where no episode was cut off."""
    left = np.logical_or.reduceat(observations_of(mdp) > 0, mdp.pair_offsets[:-1])
    return mdp.terminal & ~left & ~cut_off(mdp)


def list_entered_states(mdp: MDP) -> tuple[str, ...]:
    """Return the states of a model with counts that were entered and never left.

    They count as terminal, although the episodes may have been cut off there.
    """
    states = np.flatnonzero(find_recorded_ends(mdp)[: mdp.space.regular])
    return tuple(mdp.space.labels(states))


def cut_off(mdp: MDP) -> Flags:
    """Return (S,) the states that were never left and where episodes were cut off.

    The model makes them terminal, too, but their value is unknown.
    """
    return mdp.labels.get(CUT_OFF, np.zeros(mdp.n_states, dtype=bool))


def never_taken(mdp: MDP) -> Integers:
    """Return (N, 2) the states that were left, each with an action that was never taken there."""
    taken = mdp.by_action(observations_of(mdp) > 0)
    return np.argwhere(taken.any(axis=1, keepdims=True) & ~taken)
