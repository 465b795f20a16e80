"""What records allow one to say of a regret: an interval at a stated confidence.

`interval(model, own, confidence)` of each kind of evidence, `Robust`, `Posterior` or `OffPolicy`,
gives a `RegretInterval` for a policy's probabilities of pairs: (L,), or (N, L) by time in episodes
of N steps. A limit is kept where its upper end keeps it, and broken where its lower end breaks it;
in between more records decide.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.analysis.gate.regret import is_at_most
from exact_mdp.analysis.vary.intervals import Ranged, estimate_share
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.transitions import CUT_OFF
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.report import Report, Shown
from exact_mdp.mdp.result import DataFrame, Result, data_frame
from exact_mdp.mdp.table import Floats, Integers, exact, float_of
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.solution import Claim

SHOWN = 5  # states that are named

Ends = tuple[float, float]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class RegretInterval(Result):
    """Where the regret at the start lies, in the process that the records are from.

    Attributes
    ----------
    confidence : float
        The share of data sets, of a posterior interval that of the models, that it is to hold for.
    assumptions : tuple of str
        What the interval rests on besides the records.
    """

    low: float  # in units of reward
    high: float
    confidence: float
    by: str  # "robust", "posterior" or "off-policy"
    assumptions: tuple[str, ...]
    found: Mapping[str, Any]  # what else this kind of evidence says: {name: number or pair}
    claim: Claim = Claim.ESTIMATED  # bounded where it holds for every process in sets of rows
    draws: Floats | None = None  # (D,) of the posterior: the regret in each model drawn

    def __repr__(self) -> str:
        return f"RegretInterval({self})"

    def __str__(self) -> str:
        level = f"{100 * self.confidence:.10g} % confidence"
        return f"[{self.low:.6g}, {self.high:.6g}] at {level}, {self.by}"

    def keeps_limit(self, limit: Fraction) -> bool | None:
        """Return whether the regret is at most `limit`; None where the records leave it open."""
        return is_at_most((self.low, self.high), limit)

    def within(self, limit: Fraction) -> Ranged:
        """Return the probability that the regret is at most `limit`, as the draws show it."""
        assert self.draws is not None
        hits = int((self.draws <= float_of(limit, "limit")).sum())
        return estimate_share(hits, len(self.draws))

    def list_facts(self, limit: Fraction | None) -> dict[str, Any]:
        """Return what a report says of it; of draws also how likely the limit is kept."""
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
        """Return the interval, what else was found, and what it rests on."""
        notes = [f"assumed: {each}" for each in self.assumptions]
        facts = {**self.list_facts(None), "claim": Shown(self.claim)}
        return Report(title="interval of the regret", facts=facts, notes=notes)

    def frame(self) -> DataFrame:
        """Return the interval, and what else was found, in one row."""
        ends = {"low": self.low, "high": self.high, "confidence": self.confidence, "by": self.by}
        return data_frame([ends | dict(self.found)])


def observations_of(mdp: MDP) -> Integers:
    """Return (L,) how often each pair was seen; raises ModelError where nobody counted."""
    if mdp.observations is None or not mdp.observations.any():
        raise ModelError(
            "the model has no counts, so that nothing tells how much it knows",
            where="confidence",
            fix="estimate it from records: MDP.from_transitions, or exact-mdp data; a question or "
            "changed rows leave the counts behind, and so does within(N) (give horizon=N)",
        )
    return mdp.observations


def of_process(mdp: MDP) -> tuple[str, ...]:
    """Return what every interval takes for true of the process behind a model's counts."""
    sentences = [
        "the process has the states and actions that were recorded, and what follows a state and "
        "an action depends on these alone",
        "episodes begin as the model says"
        if mdp.episodes is None
        else "the recorded episodes begin as those of the process do, each drawn by itself",
    ]
    if ends := list_entered_states(mdp):
        said = "nothing is earned any more after"
        sentences.append(
            f"{said} {_format_first_names(ends)}: entered and never left, taken for ends"
        )
    # Where actions that nobody took are offered all the same, `Robust.assumptions` says so.
    offered = set(zip(mdp.pair_state.tolist(), mdp.pair_action.tolist(), strict=True))
    if never := [(s, a) for s, a in never_taken(mdp).tolist() if (s, a) not in offered]:
        names = [f"{mdp.space.label(state)}: {mdp.actions[action]}" for state, action in never]
        sentences.append(f"what nobody took is not to be had: {_format_first_names(names)}")
    if mdp.n_actions == 1:
        sentences.append(
            "only one action was ever taken, and no other is to be had: nothing can be lost"
        )
    return tuple(sentences)


def format_states(mdp: MDP, states: Flags) -> str:
    """Return the names of some states (S,) in brackets."""
    return _format_first_names(mdp.space.labels(np.flatnonzero(states)))


def _format_first_names(names: Sequence[str]) -> str:
    more = len(names) - SHOWN
    return f"({', '.join(names[:SHOWN])}{f' and {more:,} more' if more > 0 else ''})"


def parse_range(given: Any, what: str) -> Ends | None:
    """Return the ends of a range that the user states, None where there is none."""
    if given is None:
        return None
    try:
        low, high = (float(exact(end)) for end in given)
    except (TypeError, ValueError, OverflowError) as error:
        raise ModelError(f"{given!r} is no range", where=what, fix="give (low, high)") from error
    if not low <= high:
        fix = "give the lower end first"
        raise ModelError(f"the range {low:g} to {high:g}", where=what, fix=fix)
    return low, high


def of_sense(mdp: MDP, ends: Ends) -> Ends:
    """Return ends of rewards; in a model of costs, those of costs as rewards and the reverse."""
    return ends if mdp.sense == "max" else (-ends[1], -ends[0])


# ---- what records leave open of the model -------------------------------------------------------


def find_recorded_ends(mdp: MDP) -> Flags:
    """Return (S,) ends, worth 0 whatever the rows: nobody left them, and nobody was cut off."""
    left = np.logical_or.reduceat(observations_of(mdp) > 0, mdp.pair_offsets[:-1])
    return mdp.terminal & ~left & ~cut_off(mdp)


def list_entered_states(mdp: MDP) -> tuple[str, ...]:
    """Return the states of a model with counts that were entered and never left.

    It takes them for ends, which the records do not say: they may have been cut off there.
    """
    states = np.flatnonzero(find_recorded_ends(mdp)[: mdp.space.regular])
    return tuple(mdp.space.labels(states))


def cut_off(mdp: MDP) -> Flags:
    """Return (S,) states of a model with counts that nobody left, and where episodes were cut off.

    It takes them for ends, too; nobody knows what they are worth.
    """
    return mdp.labels.get(CUT_OFF, np.zeros(mdp.n_states, dtype=bool))


def never_taken(mdp: MDP) -> Integers:
    """Return (N, 2) the states that were left, and the actions that nobody took there."""
    taken = mdp.by_action(observations_of(mdp) > 0)
    return np.argwhere(taken.any(axis=1, keepdims=True) & ~taken)
