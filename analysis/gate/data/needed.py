"""When to stop collecting: which pairs' counts leave a verdict open, and how many more decide it.

The verdict is open while the limit lies inside the robust interval of `analysis.gate.data.robust`.
The regret of the estimated model says to which side more records will bring it, if they show what
was seen, in the same shares and in episodes as long: the *deciding end* is the upper end where that
regret keeps the limit, and the lower end elsewhere. Both ends are computed anew, in the model, for
every number of observations that is asked about; nothing is extrapolated.

*worth* of a pair is the value of information about it: how far the deciding end would move if its
row were known and all others as they are.

*more* is a plan: together these observations decide the verdict, and of no pair could a tenth of
them be left out. Were the end's distance a sum of worth · √(n / n') over the pairs, n' observations
in place of n, the fewest in all would be in proportion to (worth √n)^(2/3). So pairs are brought to
numbers in that proportion (to a tenth of the largest where they are worth less), the least that
decide, by bisection. Then, from the pairs that are worth least, each is given up or lowered as far
as the verdict stays decided. Other plans may need fewer in all. So a plan ends just where the
verdict does, if the shares stay as they are; but more observations show other shares, by chance.

*chance* is how likely they decide it: of `DRAWS` data sets, in which the plan's observations are
drawn from the estimated model, the share that, with what there is, gives the expected verdict.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from math import ceil
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.gate.data.interval import observations_of
from exact_mdp.analysis.gate.data.posterior import Probability
from exact_mdp.analysis.gate.data.robust import Robust, RobustBounds
from exact_mdp.analysis.gate.data.sets import RowSets
from exact_mdp.analysis.sensitivity.psa.intervals import share_of, wilson
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats, Integers

if TYPE_CHECKING:
    from pandas import DataFrame

pandas, tqdm = later("pandas"), later("tqdm")

EXACTLY = 1e15  # observations after which a row counts as known
MOST = 10**12  # observations of a pair that a plan may ask for
SPARED = 0.1  # share of a number that is worth another attempt to save
LEAST_SHAPE = 0.1
DRAWS = 100  # data sets that the chance of a plan is estimated from
TRIED = 60  # pairs whose numbers are lowered one by one; of more models the rest stays


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Needed(Pictured):
    """Which pairs hold a decision open.

    Attributes
    ----------
    mdp : MDP
    limit : Fraction
    confidence : float
    low, high : float
        The robust interval today.
    decided : bool or None
        Whether the regret is at most `limit`; None while that is open.
    expected : bool
        The verdict if more records show what was seen.
    possible : bool
        Whether records can decide it: not where the estimated regret equals the limit.
    pairs : (K,) int64
        Pairs that are worth knowing better, or of which the plan asks for more.
    worth : (K,)
        What knowing each row would move the deciding end by, in units of reward.
    more : (K,) int64
        Observations of each that together decide the verdict; 0 where none does.
    planned : (float, float)
        The interval after them, if they show the same shares.
    chance : Probability, optional
        How likely they decide the verdict as expected, if the process is the estimated model.
    """

    mdp: MDP
    limit: Fraction
    confidence: float
    low: float
    high: float
    decided: bool | None
    expected: bool
    possible: bool
    pairs: Integers
    worth: Floats
    more: Integers
    planned: tuple[float, float]
    chance: Probability | None = None

    picture = "exact_mdp.analysis.plots.records:plot_needed"

    def __repr__(self) -> str:
        now = f"regret in [{self.low:.6g}, {self.high:.6g}], limit {float(self.limit):.6g}"
        if self.decided is not None:
            return f"Needed({now}: decided, {'passes' if self.decided else 'fails'})"
        if not self.possible:
            return f"Needed({now}: open, and the estimate is at the limit itself)"
        return (
            f"Needed({now}: open; {int(self.more.sum()):,} more observations of "
            f"{np.count_nonzero(self.more)} pairs let it {'pass' if self.expected else 'fail'} if "
            f"they show the same shares{self.likely})"
        )

    @property
    def likely(self) -> str:
        """The chance in words; nothing where there is no plan."""
        if self.chance is None:
            return ""
        low, high = self.chance.interval
        return f"; chance {self.chance.value:.0%}, from {low:.0%} to {high:.0%}"

    def frame(self) -> DataFrame:
        """Return a row for each pair, the one that is worth most first."""
        mdp, pairs = self.mdp, self.pairs
        seen = mdp.observations
        assert seen is not None
        found = {
            "state": mdp.space.labels(mdp.pair_state[pairs]),
            "action": [mdp.actions[action] for action in mdp.pair_action[pairs].tolist()],
            "observations": seen[pairs],
            "worth": self.worth,
            "more": self.more,
        }
        return pandas.DataFrame(found)


def needed(
    mdp: MDP, own: Floats, estimate: Fraction, limit: Fraction, confidence: Fraction, by: Robust
) -> Needed:
    """Return what `Audit.needed` does; `own` (L,) is the policy, `estimate` its regret today."""
    sets = RowSets.of(mdp, float(1 - confidence), by.rewards)
    returns, expected = by.range(mdp), estimate <= limit

    def bounds(counts: Floats, *, start: bool = True) -> RobustBounds:
        return RobustBounds(sets=sets.with_more(counts, start=start), own=own, returns=returns)

    def end(counts: Floats, *, start: bool = True) -> float:
        return bounds(counts, start=start).regret_end(most=expected)

    def kept(found: float) -> bool:
        return found <= limit if expected else found > limit

    def decides(counts: Floats) -> bool:
        return kept(end(counts))

    def decided_by(sets: RowSets) -> bool:
        return kept(RobustBounds(sets=sets, own=own, returns=returns).regret_end(most=expected))

    low, high = bounds(np.zeros(mdp.n_pairs)).regret
    decided = True if high <= limit else False if low > limit else None
    worth, more, possible = np.zeros(mdp.n_pairs), np.zeros(mdp.n_pairs), True
    if decided is None:
        worth = _worth(sets, partial(end, start=False))
        possible = decides(np.where(sets.counted > 0, EXACTLY, 0.0))
        if possible:
            more = _plan(sets.counted, worth, decides)
    listed = np.flatnonzero((worth > 0) | (more > 0))
    listed = listed[np.lexsort([-more[listed], -worth[listed]])]
    return Needed(
        mdp=mdp,
        limit=limit,
        confidence=float(confidence),
        low=low,
        high=high,
        decided=decided,
        expected=expected,
        possible=possible,
        pairs=listed,
        worth=worth[listed],
        more=more[listed].astype(np.int64),
        planned=bounds(more).regret if more.any() else (low, high),
        chance=_chance(sets, more, decided_by) if more.any() else None,
    )


def _chance(sets: RowSets, more: Floats, decides: Callable[[RowSets], bool]) -> Probability:
    """Return how likely the plan decides, of data sets drawn from what was seen."""
    rng, mdp, grown = np.random.default_rng(0), sets.mdp, sets.with_more(more)
    table, added, start, total = mdp.table, more.astype(np.int64), mdp.start, mdp.episodes
    rows = [(int(pair), slice(*table.offsets[pair : pair + 2])) for pair in np.flatnonzero(added)]
    found = 0
    for _ in tqdm.trange(DRAWS, desc="data sets", disable=None, delay=2):
        weight = table.weight.copy()
        for pair, row in rows:
            weight[row] += rng.multinomial(added[pair], weight[row] / weight[row].sum())
        if grown.episodes is not None and sets.episodes is not None:
            begins = rng.multinomial(
                round(grown.episodes - sets.episodes), [float(share) for _, share in mdp.start]
            )
            seen = [int(share * int(sets.episodes)) for _, share in mdp.start]
            total = int(begins.sum()) + sum(seen)
            start = tuple(
                (state, Fraction(old + new, total))
                for (state, _), old, new in zip(mdp.start, seen, begins.tolist(), strict=True)
            )
        drawn = replace(
            mdp,
            start=start,
            episodes=total,
            table=replace(table, weight=weight, denominator=table.denominator + added),
            observations=observations_of(mdp) + added,
        )
        found += decides(replace(grown, mdp=drawn, episodes=total))
    share, (low, high) = share_of(found, DRAWS), wilson(found, DRAWS)
    return Probability(
        value=share.value, standard_error=share.standard_error, low=float(low), high=float(high)
    )


def _worth(sets: RowSets, end: Callable[[Floats], float]) -> Floats:
    """Return (L,) how far an end moves where one row is known."""
    found, nothing = np.zeros(len(sets.counted)), np.zeros(len(sets.counted))
    today = end(nothing)
    for pair in tqdm.tqdm(sets.pairs.tolist(), desc="pairs", disable=None, delay=2):
        known = nothing.copy()
        known[pair] = EXACTLY
        found[pair] = abs(end(known) - today)
    return np.where(found > 1e-9 * abs(today), found, 0.0)


def _plan(counted: Floats, worth: Floats, decides: Callable[[Floats], bool]) -> Floats:
    """Return (L,) more observations that decide; none of them could be much fewer."""
    shape = (worth * np.sqrt(counted)) ** (2 / 3)
    shape = np.where(counted > 0, np.maximum(shape / (shape.max() or 1), LEAST_SHAPE), 0.0)

    def level(height: float) -> Floats:
        return np.maximum(np.ceil(height * shape - counted), 0.0)

    def least(given: Callable[[float], Floats], low: float, high: float) -> float:
        """Return about the least number that decides, from one that does not to one that does."""
        while high - low > 1 and high > low * (1 + SPARED / 2):
            middle = (low * high) ** 0.5 if low > 1 else (low + high) / 2
            low, high = (low, middle) if decides(given(middle)) else (middle, high)
        return high

    high = float(counted.max())
    while not decides(level(high)) and high < MOST:
        high *= 2
    plan = level(least(level, 0.0, high))
    used = np.flatnonzero(plan)
    for pair in used[np.argsort(worth[used], kind="stable")][:TRIED].tolist():

        def with_(number: float, pair: int = pair, plan: Floats = plan) -> Floats:
            changed = plan.copy()
            changed[pair] = ceil(number)
            return changed

        plan = with_(0.0 if decides(with_(0.0)) else least(with_, 0.0, float(plan[pair])))
    return plan
