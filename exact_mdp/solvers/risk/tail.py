"""The best policy for the mean of the worst share α of all episodes (CVaR of the return Z).

    CVaR_α(Z) = max over η of  η - E (η - Z)⁺ / α

(Rockafellar and Uryasev, Journal of Risk 2, 2000), so that the best policy minimises the expected
shortage for some η, a possible return. With w, what is still wanted of the return from state s,

    F_s(w) = min over pairs l of s of  Σ p F_s'(w - k)      for outcomes (p, s', k),     F(w) = w⁺

at the end (Bäuerle and Ott 2011; Chow, Tamar, Mannor and Pavone, Risk-sensitive and robust
decision-making: a CVaR optimization approach, 2015). No policy with a memory of more than w does
better. Of equal shortages, the one of the greater mean is taken; it is the greatest there is, below
low(s) and above high(s) (`.lattice`), where shortages are 0 or w less the mean.

A weight v of the mean asks for the most of (1 - v) CVaR + v E Z: then F less λ E Z is minimised,
with λ = α v / (1 - v). All numbers are integers over one denominator for each state.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from itertools import groupby
from math import lcm
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Integers, Numbers, exact, shown
from exact_mdp.solvers.risk.checker import Shortages, tail_violations
from exact_mdp.solvers.risk.lattice import Lattice, share_of
from exact_mdp.solvers.solution import Claim
from exact_mdp.solvers.solver import mdp_of

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CVaROptimum(Result):
    """A policy with the greatest mean of the worst share of episodes.

    Attributes
    ----------
    mdp : MDP
        The model; with a horizon, that with the time in its states.
    level : Fraction
        The share of episodes.
    weight : Fraction
        Of the mean.
    value, mean : Fraction
        The mean of the worst share, and of all episodes, under the policy.
    threshold : Fraction
        The return η: the policy minimises the expected shortage from it.
    lattice : Lattice
        Of rewards, that is of costs times -1.
    shortages : Shortages
    """

    mdp: MDP
    level: Fraction
    weight: Fraction
    value: Fraction
    mean: Fraction
    threshold: Fraction
    lattice: Lattice
    shortages: Shortages

    claim = Claim.CERTIFIED

    def __repr__(self) -> str:
        return (
            f"CVaROptimum(worst {shown(self.level)}: {float(self.value):.6g}, "
            f"mean {float(self.mean):.6g}; certified)"
        )

    @property
    def _sign(self) -> int:
        return 1 if self.mdp.sense == "max" else -1

    def action(self, state: int, so_far: object = 0) -> str:
        """Return what the policy does in a state after a reward of so much."""
        wanted = (self._sign * (self.threshold - exact(so_far))) / self.lattice.unit
        if wanted.denominator != 1:
            raise ModelError(
                f"no reward so far can be {shown(exact(so_far))}",
                where="risk of the return",
                fix=f"rewards are multiples of {shown(self.lattice.unit)}",
            )
        pair = self.shortages.pair(state, int(wanted))
        return str(self.mdp.actions[self.mdp.pair_action[pair]])

    def rules(self) -> list[tuple[int, Fraction, Fraction, str]]:
        """Return the policy as (state, from, to, action), for rewards so far within two ends.

        These are all that it meets from the start, in the states that leave a choice.
        """
        turned, found = self._sign * self.lattice.unit, list[tuple[int, Fraction, Fraction, str]]()
        met = self.shortages.met(self._sign * self.threshold / self.lattice.unit)
        for state, masses in met.items():
            if self.mdp.asked[state]:
                so_far = sorted(turned * k for k in masses)
                for action, group in groupby(so_far, partial(self.action, state)):
                    own = [*group]
                    found.append((state, own[0], own[-1], action))
        return found

    def distribution(self) -> dict[Fraction, Fraction]:
        """Return the exact probability of every return under the policy, in rising order."""
        turned = self._sign * self.lattice.unit
        found = self.shortages.returns(self._sign * self.threshold / self.lattice.unit)
        return dict(sorted((turned * k, probability) for k, probability in found.items()))

    def violations(self) -> list[str]:
        """Return what does not hold, in words: nothing where the policy is the best."""
        claimed = (self.value, self.mean, self.threshold)
        in_units = tuple(self._sign * each / self.lattice.unit for each in claimed)
        return tail_violations(self.shortages, self.level, self.weight, *in_units)

    def frame(self) -> DataFrame:
        """Return the distribution of the return."""
        import pandas

        found = self.distribution()
        returns, probability = [*map(float, found)], [*map(float, found.values())]
        return pandas.DataFrame({"return": returns, "probability": probability})


def best_cvar(
    model: MDP | Scenario, level: object, *, weight: object = 0, horizon: int | None = None
) -> CVaROptimum:
    """Return a policy with the greatest mean return of the worst episodes, exactly.

    In a model of costs, the least mean cost of the worst episodes. The policy remembers the reward
    so far.

    Parameters
    ----------
    model : MDP or Scenario
        With discount 1 and without cycles, or with a horizon.
    level : number or "p/q"
        The share of the worst episodes, above 0; at 1 that is the mean of all.
    weight : number or "p/q"
        Of the mean, below 1: (1 - weight) CVaR + weight · mean is greatest.
    horizon : int, optional
        Stop after so many steps.

    Returns
    -------
    CVaROptimum

    Raises
    ------
    ModelError
        For other discounts, cycles, too many returns, and numbers out of range.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 1, 10), ("1/2", 1, 0)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    >>> found = best_cvar(MDP.from_outcomes(rows), "1/2")
    >>> str(found.value), str(found.mean), found.action(0)
    ('4', '4', '1')
    """
    mdp, share, part = mdp_of(model), share_of(level), exact(weight)
    if not 0 <= part < 1:
        raise ModelError(
            f"the weight of the mean is {shown(part)}",
            where="weight of the mean",
            fix="choose 0 or more, below 1",
        )
    lattice = Lattice.of(mdp, horizon)
    shortages = _least(lattice, share * part / (1 - part))
    low, high = shortages.span
    best: tuple[Fraction, Fraction, int] | None = None
    for wanted in range(low, high + 1):
        lack, mean = shortages.start(wanted)
        worth = (1 - part) * (wanted - lack / share) + part * mean
        if best is None or (worth, mean) > best[:2]:
            best, found = (worth, mean, wanted), wanted - lack / share
    assert best is not None
    unit = lattice.unit if mdp.sense == "max" else -lattice.unit
    return CVaROptimum(
        mdp=mdp if horizon is None else mdp.within(horizon),
        level=share,
        weight=part,
        value=unit * found,
        mean=unit * best[1],
        threshold=unit * best[2],
        lattice=lattice,
        shortages=shortages,
    )


def _least(lattice: Lattice, trade: Fraction) -> Shortages:
    """Work out the least shortages, from the end on."""
    count = lattice.mdp.n_states
    nothing: Any = np.array([0], dtype=object)
    lack, mean, below = [nothing] * count, [nothing] * count, [1] * count
    choice: list[Integers] = [np.array([pairs[0]]) for pairs in lattice.pairs]
    for state in lattice.order:
        wanted = np.arange(lattice.low[state], lattice.high[state] + 1)
        every = [lattice.rows[pair] for pair in lattice.pairs[state]]
        unit = lcm(*(scale * below[to] for _, scale, ends in every for to, _ in ends))
        best: tuple[Numbers, Numbers, Numbers] | None = None
        for pair, (weights, scale, ends) in zip(lattice.pairs[state], every, strict=True):
            short = np.zeros(len(wanted), dtype=object)
            gain = np.zeros(len(wanted), dtype=object)
            for weight, (to, k) in zip(weights, ends, strict=True):
                times, at = weight * (unit // (scale * below[to])), wanted - k - lattice.low[to]
                last = len(lack[to]) - 1
                place, over = np.clip(at, 0, last), np.maximum(at - last, 0).astype(object)
                short += times * (lack[to][place] + over * below[to])
                gain += times * (mean[to][place] + k * below[to])
            score = trade.denominator * short - trade.numerator * gain
            if best is None:
                best = (score, short, gain)
                choice[state] = np.full(len(wanted), pair)
                continue
            better = (score < best[0]) | ((score == best[0]) & (gain > best[2]))
            better = np.asarray(better, dtype=bool)
            for old, new in zip(best, (score, short, gain), strict=True):
                old[better] = new[better]
            choice[state][better] = pair
        assert best is not None
        lack[state], mean[state], below[state] = best[1], best[2], unit
    return Shortages(lattice=lattice, trade=trade, lack=lack, mean=mean, below=below, choice=choice)
