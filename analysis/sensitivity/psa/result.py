"""What is found in the draws of a probabilistic sensitivity analysis.

What is said of the draws, and of which policy:

- the distribution of V*, the policy re-optimised in every draw;
- the distribution of the regret V* - V^π of a policy π held fixed, and its *acceptability curve*,
  the probability that its regret is at most Δ, by Δ: how much willingness to accept a loss it takes
  for the policy to be accepted (after Chen, Ayer and Chhatwal, Medical Decision Making 37, 2017,
  whose curve tells the confidence in the base-case policy by that willingness; Δ = 0 is the
  probability that the policy is optimal);
- the probability that each action is optimal, by status, with Wilson's interval;
- what knowing all parameters before choosing would be worth,

      EVPI = E[max_π V^π] - max_π E[V^π] = E[V*] - max_π E[V^π].

The best of all policies for uncertain parameters is hard to find (Steimle, Kaufman and Denton, IISE
Transactions 53, 2021), so EVPI is told by two ends. Its upper end takes the best policy found.
Its lower end lets everything but the first action be chosen in full knowledge: no policy is worth
more than max_a E[Q*(start, a)], hence EVPI ≥ min_a E[V* - Q*(start, a)]. Where reward weights alone
are uncertain, values are linear in them, the best policy is the optimum at their means, and EVPI is
E[V*] - V*(mean), one number. Every difference is that of pairs in the same draw.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.analysis.sensitivity.psa.candidates import TODAY, Candidate
from exact_mdp.analysis.sensitivity.psa.distributions import Uncertainty
from exact_mdp.analysis.sensitivity.psa.intervals import MeanLoss, mean_loss, share_of, wilson
from exact_mdp.analysis.sensitivity.psa.value_of_information import PartialInformation, evpi, evppi
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.solution import Estimated

if TYPE_CHECKING:
    from pandas import DataFrame

REGRESSED = 20_000  # draws of a regression: its error is far below that of so many draws
MISSING = "EVPI among the candidates is below the lower end of EVPI"


@dataclass(frozen=True, kw_only=True)
class Information:
    """EVPI over all policies, between two estimates; they are one where it is known which is best.

    Attributes
    ----------
    low, high : MeanLoss
    best : str
        Name of the best candidate, by which `high` is reckoned.
    """

    low: MeanLoss
    high: MeanLoss
    best: str


@dataclass(frozen=True, kw_only=True, eq=False)
class PSA:
    """The draws of a probabilistic sensitivity analysis and what was found in each.

    Attributes
    ----------
    model : str
    uncertainty : Uncertainty
    seed : int
    draws : (D, Q)
        Drawn parameters, in the order of `uncertainty.names`.
    start, error : (D,)
        V* of the start in each draw, and how far it may be off; units of reward.
    candidates : tuple of N Candidate
        The policy that is held comes first.
    values, value_error : (D, N)
        Their values.
    labels, actions : words
        Statuses at subtask 0, trial 0 of a care scenario; of other models the states with a choice.
    compiled : bool
        Whether the batched loops of the care model did the work.
    optimal : (X, A) ints
        Draws in which an action is optimal, up to rounding.
    lost : (D, A)
        What each action costs in the first state; (D, 0) where there is more than one.
    cut : (D,) bool
        Whether some chance was cut off at 1, where `compiled`.
    today : float
        V* at today's values.
    """

    model: str
    uncertainty: Uncertainty
    seed: int
    draws: Floats
    start: Floats
    error: Floats
    candidates: tuple[Candidate, ...]
    values: Floats
    value_error: Floats
    labels: tuple[str, ...]
    actions: tuple[str, ...]
    compiled: bool
    optimal: Integers
    lost: Floats
    cut: np.ndarray
    today: float

    def __post_init__(self) -> None:
        for array in (self.draws, self.start, self.error, self.values, self.optimal, self.lost):
            array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.start)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that were drawn."""
        return self.uncertainty.names

    def regret(self, candidate: int = 0) -> Floats:
        """Return (D,) V* less a candidate's value; 0 where rounding may be all there is."""
        gap = self.start - self.values[:, candidate]
        return np.where(gap > self.error + self.value_error[:, candidate], gap, 0.0)

    @property
    def clipped(self) -> Estimated | None:
        """Share of draws in which some chance was cut off at 1; None where that is not known."""
        return share_of(int(self.cut.sum()), len(self)) if self.compiled else None

    def acceptability(self, tolerances: ArrayLike, candidate: int = 0) -> list[Estimated]:
        """Return the probability that the candidate loses at most Δ, for each Δ."""
        regret = np.sort(self.regret(candidate))
        inside = np.searchsorted(regret, np.asarray(tolerances, dtype=float), side="right")
        return [share_of(int(n), len(self)) for n in inside]

    def accepted(self, tolerances: ArrayLike, candidate: int = 0) -> tuple[Floats, Floats, Floats]:
        """Return the same probabilities with the ends of Wilson's 95 % intervals."""
        share = np.array([each.value for each in self.acceptability(tolerances, candidate)])
        low, high = wilson(np.rint(share * len(self)), len(self))
        return share, low, high

    def probability_optimal(self) -> tuple[Floats, Floats, Floats]:
        """Return (X, A) shares of draws in which each action is optimal, and Wilson's intervals."""
        low, high = wilson(self.optimal, len(self))
        return self.optimal / len(self), low, high

    def evpi(self) -> Information:
        """Return what knowing every drawn parameter would be worth, over all policies."""
        if self.compiled and all(name.startswith("reward.") for name in self.names):
            today = [candidate.name for candidate in self.candidates].index(TODAY)
            found = mean_loss(self.regret(today))
            return Information(low=found, high=found, best=TODAY)
        best = int(self.values.mean(axis=0).argmax())
        high, low = mean_loss(self.regret(best)), mean_loss(np.zeros(len(self)))
        if self.lost.shape[1]:
            lost = self.lost[:, int(np.nanargmin(self.lost.mean(axis=0)))]
            noise = 3 * self.error + self.value_error[:, best] + 1e-12 * np.abs(self.start)
            low = mean_loss(np.where(lost > noise, lost, 0.0))
        return Information(low=low, high=high, best=self.candidates[best].name)

    def evpi_of_candidates(self) -> MeanLoss:
        """Return what it would be worth to know before choosing among the candidates."""
        return evpi(self.values)

    def evppi(
        self, groups: Mapping[str, Sequence[str]] | None = None, *, most: int = REGRESSED
    ) -> dict[str, PartialInformation]:
        """Return what knowing some parameters would be worth, choosing among the candidates.

        Parameters
        ----------
        groups : {name: parameter names}, optional
            Each parameter, or row of parameters, alone, and `groups_of` them, unless given.
        most : int
            No more than this many of the first draws are used.

        Notes
        -----
        No estimate is above EVPI of the same candidates in the same draws. Where that is below the
        lower end of EVPI over all policies, by more than twice the standard error, the candidates
        miss policies that matter, which every estimate's `doubts` then tell.
        """
        if groups is None:
            alone = {part.label: part.names for part in self.uncertainty.parts}
            groups = alone | groups_of(self.uncertainty)
        place = {name: column for column, name in enumerate(self.names)}
        among, least = self.evpi_of_candidates(), self.evpi().low
        apart = 2 * np.hypot(among.standard_error, least.standard_error)
        doubt = (MISSING,) if among.value + apart < least.value else ()
        found = {}
        for label, members in groups.items():
            unknown = [name for name in members if name not in place]
            if unknown:
                raise ModelError(
                    f"{unknown[0]!r} is not drawn",
                    where=f"EVPPI of {label}",
                    fix="name parameters that are drawn",
                )
            columns = self.draws[:most, [place[name] for name in members]]
            each = evppi(self.values[:most], columns, tuple(members))
            found[label] = replace(each, doubts=(*each.doubts, *doubt))
        return found

    def frame(self) -> DataFrame:
        """Return a table: the drawn parameters, V*, each candidate's value (units of reward)."""
        from pandas import DataFrame

        table = DataFrame(self.draws, columns=list(self.names))
        table["V* (reward)"] = self.start
        for number, candidate in enumerate(self.candidates):
            table[f"{candidate.name} (reward)"] = self.values[:, number]
        return table


def groups_of(chosen: Uncertainty) -> dict[str, tuple[str, ...]]:
    """Return the drawn parameters by the beginning of their names, where several share one.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.mdp.parametric import parametric
    >>> from exact_mdp.analysis.sensitivity.psa.uncertainty import uncertainty
    >>> model = parametric(Scenario.load("yuan2025"))
    >>> list(groups_of(uncertainty(model)))
    ['base.*', 'persistence.*', 'influence.*', 'assistance.*', 'skip.*']
    """
    found: dict[str, list[str]] = {}
    for part in chosen.parts:
        start, dot, _ = part.names[0].partition(".")
        if dot and part.kind != "dirichlet":
            found.setdefault(f"{start}.*", []).extend(part.names)
    return {name: tuple(members) for name, members in found.items() if len(members) > 1}
