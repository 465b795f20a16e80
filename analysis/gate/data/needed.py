"""When to stop collecting: which pairs' counts leave a verdict open, and how many more decide it.

The verdict is open while the limit lies inside the robust interval of `analysis.gate.data.robust`.
The regret of the estimated model says to which side more records will bring it, if they show what
was seen, in the same shares and in episodes as long: the *deciding end* is the upper end where that
regret keeps the limit, and the lower end elsewhere. Both ends are computed anew, in the model, for
every number of observations that is asked about; nothing is extrapolated.

*worth* of a pair is the value of information about it: how far the deciding end would move if its
row were known and all others as they are. Each takes a robust solve, which begins at today's
values. Where more than `TRIED` pairs were counted, those are asked about one by one that promise
most: by the width of their rows at today's values, times their expected visits by the policy and
by the choices that decide today's end. The others are asked about together: `rest` is what knowing
all of them at once is worth.

*more* is a plan: together these observations decide the verdict, and of no pair could a tenth of
them be left out. Were the end's distance a sum of worth · √(n / n') over the pairs, n' observations
in place of n, the fewest in all would be in proportion to (worth √n)^(2/3). So pairs are brought to
numbers in that proportion (to a tenth of the largest where they are worth less), the least that
decide, by bisection. Then, from the pairs that are worth least, each is given up or lowered as far
as the verdict stays decided; those that were asked about together also stand together here, and
come in only where the verdict needs them. Other plans may need fewer in all. So a plan ends just
where the verdict does, if the shares stay as they are; but more observations show other shares, by
chance.

*chance* is how likely they decide it: of `DRAWS` data sets, in which the plan's observations are
drawn from the estimated model, the share that, with what there is, gives the expected verdict.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from math import nan
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.analysis.gate.data.bounds import RobustBounds
from exact_mdp.analysis.gate.data.interval import observations_of
from exact_mdp.analysis.gate.data.posterior import Probability
from exact_mdp.analysis.gate.data.robust import Robust
from exact_mdp.analysis.gate.data.sets import RowSets
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
SMALL = 1e-7  # of the values' range: steps not worth another one
TINY = 5e-324
DRAWS = 100  # data sets that the chance of a plan is estimated from
TRIED = 30  # pairs that are asked about one by one


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
        Whether more records of the same kind can decide it: not where the estimated regret equals
        the limit, nor where states in which episodes were cut off, the range of rewards or, at
        discount 1, that of totals hold it open.
    known : float
        The deciding end if all rows that were counted were known; NaN where nothing is open.
    pairs : (K,) int64
        Pairs that are worth knowing better, or of which the plan asks for more.
    worth : (K,)
        What knowing each row would move the deciding end by, in units of reward; NaN where it was
        asked about together with others alone.
    more : (K,) int64
        Observations of each that together decide the verdict; 0 where none does.
    planned : (float, float)
        The interval after them, if they show the same shares.
    chance : Probability, optional
        How likely they decide the verdict as expected, if the process is the estimated model.
    rest : (int, float)
        How many pairs were asked about together, and what knowing all of them is worth.
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
    rest: tuple[int, float] = (0, 0.0)
    known: float = nan

    picture = "exact_mdp.analysis.plots.records:plot_needed"

    def __repr__(self) -> str:
        now = f"regret in [{self.low:.6g}, {self.high:.6g}], limit {float(self.limit):.6g}"
        return f"Needed({now}: {self.told})"

    @property
    def told(self) -> str:
        """What is needed, in words."""
        if self.decided is not None:
            return f"decided, {'passes' if self.decided else 'fails'}"
        if not self.possible:
            side = "upper" if self.expected else "lower"
            return (
                "open, and no more records of this kind decide it: if all rows that were counted "
                f"were known, the {side} end would be {self.known:.6g}"
            )
        return (
            f"open; {int(self.more.sum()):,} more observations of "
            f"{np.count_nonzero(self.more)} pairs let it {'pass' if self.expected else 'fail'} if "
            f"they show the same shares{self.likely}"
        )

    @property
    def others(self) -> str:
        """What the pairs that were asked about together are worth; nothing where there are none."""
        pairs, worth = self.rest
        return f"; {pairs:,} other pairs, all known at once: {worth:.6g}" if pairs else ""

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
    today = RobustBounds(sets=sets, own=own, returns=by.range(mdp))
    expected = estimate <= limit
    (low, high), near = today.regret, today.found

    def bounds(sets: RowSets) -> RobustBounds:
        return RobustBounds(sets=sets, own=own, returns=today.returns, near=near, small=SMALL)

    def end(more: Floats, *, start: bool = True) -> float:
        return bounds(sets.with_more(more, start=start)).regret_end(most=expected)

    def short(more: Floats) -> float:
        """Return how far the deciding end is from deciding; 0 or less where it decides."""
        return signed(end(more))

    def signed(found: float) -> float:
        gap = found - float(limit) if expected else float(limit) - found
        return gap if (found <= limit if expected else found > limit) else max(gap, TINY)

    decided = True if high <= limit else False if low > limit else None
    worth, more, possible, rest = np.zeros(mdp.n_pairs), np.zeros(mdp.n_pairs), True, (0, 0.0)
    last = nan
    if decided is None:
        asked = _promising(today, most=expected)
        together = np.setdiff1d(sets.pairs, asked)
        worth, known = _worth(asked, together, partial(end, start=False), mdp.n_pairs)
        rest = len(together), known
        last = end(np.where(sets.counted > 0, EXACTLY, 0.0))
        possible = signed(last) <= 0
        if possible:
            more = _plan(sets.counted, worth, asked, together, short)
    planned = bounds(sets.with_more(more))
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
        planned=planned.regret if more.any() else (low, high),
        chance=_chance(
            sets,
            more,
            lambda drawn: (
                signed(replace(bounds(drawn), near=planned.found).regret_end(most=expected)) <= 0
            ),
        )
        if more.any()
        else None,
        rest=rest,
        known=last,
    )


def _promising(today: RobustBounds, *, most: bool) -> Integers:
    """Return the counted pairs to ask about one by one, `TRIED` at most."""
    sets, mdp = today.sets, today.mdp
    if len(sets.pairs) <= TRIED:
        return sets.pairs
    middle = (today.own_low + today.own_high) / 2
    width = sets.worth(middle, most=True).bound - sets.worth(middle, most=False).bound
    visits = today.visits(most=most)[mdp.pair_state] * (1 + today.own) + today.own_visits
    return np.sort(sets.pairs[np.argsort(-(width * visits)[sets.pairs], kind="stable")[:TRIED]])


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
    return Probability.of(found, DRAWS)


def _worth(
    asked: Integers, together: Integers, end: Callable[[Floats], float], pairs: int
) -> tuple[Floats, float]:
    """Return (L,) how far an end moves where one row is known, and what the others are worth."""
    found, nothing = np.zeros(pairs), np.zeros(pairs)
    today = end(nothing)

    def moved(known: Any) -> float:
        more = nothing.copy()
        more[known] = EXACTLY
        by = abs(end(more) - today)
        return by if by > 1e-9 * abs(today) else 0.0

    for pair in tqdm.tqdm(asked.tolist(), desc="pairs", disable=None, delay=2):
        found[pair] = moved(pair)
    found[together] = np.nan
    return found, moved(together) if len(together) else 0.0


def _plan(
    counted: Floats,
    worth: Floats,
    asked: Integers,
    together: Integers,
    short: Callable[[Floats], float],
) -> Floats:
    """Return (L,) more observations that decide; none of them could be much fewer."""
    shape, known = np.zeros(len(counted)), np.zeros(len(counted))
    shape[asked] = (worth[asked] * np.sqrt(counted[asked])) ** (2 / 3)
    shape[asked] = np.maximum(shape[asked] / (shape.max() or 1), LEAST_SHAPE)
    known[asked] = EXACTLY
    groups = [np.array([pair]) for pair in asked[np.argsort(worth[asked], kind="stable")].tolist()]
    if len(together) and short(known) > 0:
        shape[together] = LEAST_SHAPE
        groups.insert(0, together)

    def level(height: float) -> Floats:
        return np.maximum(np.ceil(height * shape - counted), 0.0)

    low, high = 0.0, float(counted.max())
    far, near = short(level(low)), short(level(high))
    while near > 0 and high < MOST:
        low, far, high = high, near, 2 * high
        near = short(level(high))
    height = _least(partial(_of, short, level), (low, far), (high, near))
    plan = level(height)
    left = short(plan)
    for group in tqdm.tqdm(groups, desc="plan", disable=None, delay=2):
        if not (largest := float(plan[group].max())):
            continue

        def with_(number: float, group: Integers = group, plan: Floats = plan) -> Floats:
            changed = plan.copy()
            changed[group] = np.ceil(plan[group] * (number / plan[group].max()))
            return changed

        without = short(with_(0.0))
        number = 0.0
        if without > 0:
            number = _least(partial(_of, short, with_), (0.0, without), (largest, left))
        if number < largest:
            plan = with_(number)
            left = short(plan)
    return plan


def _of(short: Callable[[Floats], float], plan: Callable[[float], Floats], number: float) -> float:
    return short(plan(number))


def _least(
    short: Callable[[float], float], low: tuple[float, float], high: tuple[float, float]
) -> float:
    """Return about the least number that decides, from two with what each is short of it.

    Secants, between which the interval is halved where they hardly narrow it.
    """
    (low_at, far), (high_at, near) = low, high
    if far <= 0:
        return low_at
    turn = 0
    while high_at - low_at > 1 and high_at > low_at * (1 + SPARED / 2):
        middle = (low_at * high_at) ** 0.5 if low_at > 1 else (low_at + high_at) / 2
        if turn % 3 < 2:
            root = low_at + (high_at - low_at) * far / (far - near)
            # A little to the side of the root that is further away, so that both ends come near.
            aim = root * (1 + SPARED / 5 * (1 if high_at - root > root - low_at else -1))
            middle = min(max(aim, low_at + 0.5), high_at - 0.5)
        found = short(middle)
        if found <= 0:
            high_at, near = middle, found
        else:
            low_at, far = middle, found
        turn += 1
    return high_at
