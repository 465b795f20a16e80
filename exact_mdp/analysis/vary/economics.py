"""Cost-effectiveness of strategies under uncertainty, as health economists report it.

A strategy is a policy held fixed; its effect E (quality-adjusted life years, say) and its cost C
are expected totals of two components of the reward. At a willingness to pay λ for a unit of effect

    NMB(λ) = λ E - C                                  net monetary benefit,
    CEAC   = share of draws in which a strategy has the greatest NMB,
    CEAF   = the same share, of the strategy whose mean NMB is greatest,
    EVPI   = E[max NMB] - max E[NMB],
    ICER   = (C₂ - C₁) / (E₂ - E₁)                    of neighbours on the efficient frontier

(Fenwick, Claxton and Sculpher, Health Economics 10, 2001). A strategy is *dominated* if another
costs no more and has no less effect, *extendedly dominated* if a mixture of two others does. Which
policies are efficient among all, `tradeoff` says: the rates between neighbours are their ICERs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.analysis.vary.distributions import Stated, Uncertainty, drawn_family, uncertainty
from exact_mdp.analysis.vary.information import PartialInformation, evpi, evppi
from exact_mdp.analysis.vary.psa import drawn, groups_of
from exact_mdp.analysis.vary.study import ModelSolver
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, known
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame, framed
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import RNG, seed_of
from exact_mdp.solvers.solution import Claim

DOMINATED, EXTENDED = "dominated", "extendedly dominated"
STEP = ("incremental cost", "incremental effect", "ICER")
WTP = "willingness to pay"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CostEffectiveness(Pictured):
    """Expected `effect` and `cost` (D, N) of every strategy in every draw (D, Q)."""

    strategies: tuple[str, ...]
    uncertainty: Uncertainty
    draws: Floats
    effect: Floats
    cost: Floats
    components: tuple[str, str]  # names of effect and cost
    seed: int

    claim = Claim.ESTIMATED

    def __repr__(self) -> str:
        return f"CostEffectiveness({', '.join(self.strategies)}; draws {len(self.draws):,})"

    def net_benefit(self, wtp: ArrayLike) -> Floats:
        """Return (D, N) λ E - C at a willingness to pay for a unit of effect; at W, (W, D, N)."""
        return np.multiply.outer(_prices(wtp), self.effect) - self.cost

    def acceptability(self, wtp: ArrayLike) -> Floats:
        """Return (W, N) shares of draws in which a strategy is the best; equals share a draw."""
        values = self.net_benefit(np.atleast_1d(_prices(wtp)))
        best = values == values.max(axis=2, keepdims=True)
        return np.asarray((best / best.sum(axis=2, keepdims=True)).mean(axis=1))

    def frontier(self, wtp: ArrayLike) -> list[tuple[str, float]]:
        """Return the best strategy on average, and the share of draws in which it is the best."""
        best = self.net_benefit(np.atleast_1d(_prices(wtp))).mean(axis=1).argmax(axis=1)
        shares = self.acceptability(wtp)[np.arange(len(best)), best]
        names = [self.strategies[n] for n in best.tolist()]
        return list(zip(names, shares.tolist(), strict=True))

    def evpi(self, wtp: ArrayLike) -> Any:
        """Return what knowing all parameters first would be worth; a list for several `wtp`."""
        values = self.net_benefit(wtp)
        return evpi(values) if values.ndim == 2 else [evpi(each) for each in values]

    def evppi(
        self, wtp: float, groups: Mapping[str, Sequence[str]] | None = None
    ) -> dict[str, PartialInformation]:
        """Return what knowing groups of parameters would be worth; those of `PSA` unless given."""
        value = self.net_benefit(price(wtp))
        return {
            label: evppi(value, self.draws[:, columns], names)
            for label, names, columns in groups_of(self.uncertainty, groups)
        }

    def icers(self) -> DataFrame:
        """Return mean cost and effect of every strategy, the cheapest first, and its ICER.

        Each is compared with the one before it on the efficient frontier; a strategy that is not on
        the frontier has no ICER, and `status` says why.
        """
        rows = data_frame(
            {
                "strategy": self.strategies,
                "cost": self.cost.mean(axis=0),
                "effect": self.effect.mean(axis=0),
            }
        )
        rows = rows.sort_values(["cost", "effect"], ascending=[True, False], ignore_index=True)
        rows = rows.assign(**dict.fromkeys(STEP, np.nan), status="efficient")
        efficient = list[int]()

        def step(one: int, other: int) -> list[float]:
            more, gained = (rows.loc[other, k] - rows.loc[one, k] for k in ("cost", "effect"))
            return [more, gained, more / gained]

        for n in rows.index:
            if efficient and rows.effect[n] <= rows.effect[efficient[-1]]:
                rows.loc[n, "status"] = DOMINATED
                continue
            while len(efficient) > 1 and step(*efficient[-2:])[2] >= step(efficient[-1], n)[2]:
                rows.loc[efficient.pop(), "status"] = EXTENDED
            efficient.append(n)
        for one, other in pairwise(efficient):
            rows.loc[other, list(STEP)] = step(one, other)
        return rows

    def report(self) -> Report:
        """Return cost, effect and ICER of every strategy, and its chance to be the best."""
        chances = framed(self.frame(self.grid(11)), "shares of draws in which each is the best")
        strategies = framed(self.icers(), "strategies, the cheapest first")
        tables = {"strategies": strategies, "chances": chances}
        return Report(title=repr(self), facts={}, tables=tables)

    def frame(self, wtp: ArrayLike | None = None) -> DataFrame:
        """Return one row for each willingness to pay: CEAC, frontier, EVPI."""
        at = self.grid() if wtp is None else np.atleast_1d(_prices(wtp))
        table = data_frame(self.acceptability(at), columns=list(self.strategies))
        table.insert(0, WTP, at)
        table["best on average"] = [name for name, _ in self.frontier(at)]
        gains = [(each.value, each.standard_error) for each in self.evpi(at)]
        table[["EVPI", "EVPI s.e."]] = np.array(gains)
        table["EVPI s.e."] = table["EVPI s.e."].replace(np.inf, np.nan)  # of one draw, unknown
        table["claim"] = str(self.claim)
        return table

    def grid(self, count: int = 51) -> Floats:
        """Return numbers from 0 to twice the largest ICER, to draw curves over."""
        most = float(np.nanmax(np.append(self.icers()["ICER"].to_numpy(dtype=float), 0.0)))
        return np.linspace(0, 2 * most or 1.0, count)


def _prices(wtp: ArrayLike) -> Floats:
    """Return one willingness to pay or several, checked."""
    try:
        prices = np.asarray(wtp, dtype=float)
    except (TypeError, ValueError):
        prices = np.array(np.nan)
    if prices.ndim > 1 or not prices.size or not np.isfinite(prices).all():
        raise ModelError(f"{wtp!r:.60} is no finite number", where=WTP, fix="give one, or a list")
    return prices


def price(wtp: ArrayLike) -> float:
    """Return one willingness to pay, checked."""
    if (prices := _prices(wtp)).ndim:
        raise ModelError("several numbers", where=WTP, fix="give one of them at a time")
    return float(prices)


def cost_effectiveness(
    model: Scenario | MDP | Parametric,
    strategies: Mapping[str, PolicyLike],
    n: int | None = None,
    *,
    effect: str = "qaly",
    cost: str = "cost",
    rng: RNG = 0,
    uncertain: Stated | None = None,
) -> CostEffectiveness:
    """Draw the parameters, and work out cost and effect of every strategy in every draw.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
        Its reward has the two components.
    strategies : {name: PolicyLike}
        Policies that are held fixed; "optimal" is the optimum at today's values.
    n : int, optional
        Draws; of a sample of one's own its first n rows, all unless given.
    effect, cost : str
        Names of components; of costs, more is worse.
    rng : int or numpy.random.Generator
    uncertain : {name: settings}, pandas.DataFrame, file or Uncertainty, optional
        As for `psa`. A table of one row, today's values, is the base case.

    Returns
    -------
    CostEffectiveness

    Raises
    ------
    ModelError
        For unknown components, no strategy, and as `psa` does.

    Examples
    --------
    >>> rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    >>> mdp = MDP.from_outcomes(rows, components={"qaly": [0, 1, 0], "cost": [0, 5, 0]})
    >>> said = {"discount": {"distribution": "uniform", "low": 0.9, "high": 1}}
    >>> analysis = cost_effectiveness(mdp, {"wait": [0, 0], "treat": [1, 0]}, 20, uncertain=said)
    >>> analysis.frontier([4, 10])
    [('wait', 1.0), ('treat', 1.0)]
    """
    family, seed = drawn_family(model), seed_of(rng)
    if not isinstance(strategies, Mapping) or not strategies:
        what = "no strategy" if isinstance(strategies, Mapping) else "strategies without names"
        raise ModelError(what, where="strategies", fix="give {name: policy}, at least one")
    chosen = uncertainty(family, uncertain)
    solver = ModelSolver(family, chosen.names)
    draws = drawn(family, chosen, n, seed, solver.block)
    for name in (effect, cost):
        known(name, solver.mdp.component_names, "component", "cost-effectiveness")
    weights = [solver.held(policy) for policy in strategies.values()]
    every = [
        solver.totals(draws[first : first + solver.block], weights, (effect, cost), first)
        for first in range(0, len(draws), solver.block)
    ]
    effects, costs = np.moveaxis(np.concatenate(every), 2, 0)
    return CostEffectiveness(
        strategies=tuple(strategies),
        uncertainty=chosen,
        draws=draws,
        effect=effects,
        cost=costs,
        components=(effect, cost),
        seed=seed,
    )
