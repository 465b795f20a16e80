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
from typing import TYPE_CHECKING, overload

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.analysis.vary.distributions import Settings, Uncertainty
from exact_mdp.analysis.vary.information import PartialInformation, evpi, evppi
from exact_mdp.analysis.vary.intervals import MeanLoss
from exact_mdp.analysis.vary.psa import drawn, groups_of, uncertain_of
from exact_mdp.analysis.vary.study import ModelSolver
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, known
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.result import Pictured
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import RNG, seed_of
from exact_mdp.solvers.solution import Claim

if TYPE_CHECKING:
    from pandas import DataFrame

DOMINATED, EXTENDED = "dominated", "extendedly dominated"
WTP = "willingness to pay"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CostEffectiveness(Pictured):
    """Expected cost and effect of every strategy in every draw.

    Attributes
    ----------
    strategies : tuple of N str
    uncertainty : Uncertainty
    draws : (D, Q)
        Drawn parameters, in the order of `uncertainty.names`.
    effect, cost : (D, N)
    seed : int
    """

    strategies: tuple[str, ...]
    uncertainty: Uncertainty
    draws: Floats
    effect: Floats
    cost: Floats
    seed: int

    def __repr__(self) -> str:
        return f"CostEffectiveness({', '.join(self.strategies)}; draws {len(self.draws):,})"

    @property
    def claim(self) -> Claim:
        """Estimated."""
        return Claim.ESTIMATED

    def net_benefit(self, wtp: ArrayLike) -> Floats:
        """Return (D, N) λ E - C at a willingness to pay for a unit of effect; at W, (W, D, N)."""
        return np.multiply.outer(_prices(wtp), self.effect) - self.cost

    def acceptability(self, wtp: ArrayLike) -> Floats:
        """Return (W, N) shares of draws in which a strategy is the best, for each of W numbers.

        Strategies that are equally good share a draw.
        """
        values = self.net_benefit(np.atleast_1d(_prices(wtp)))
        best = values == values.max(axis=2, keepdims=True)
        return np.asarray((best / best.sum(axis=2, keepdims=True)).mean(axis=1))

    def frontier(self, wtp: ArrayLike) -> list[tuple[str, float]]:
        """Return the best strategy on average, and the share of draws in which it is the best."""
        best = self.net_benefit(np.atleast_1d(_prices(wtp))).mean(axis=1).argmax(axis=1).tolist()
        shares = self.acceptability(wtp).tolist()
        return [(self.strategies[n], each[n]) for n, each in zip(best, shares, strict=True)]

    @overload
    def evpi(self, wtp: float) -> MeanLoss: ...
    @overload
    def evpi(self, wtp: Sequence[float] | Floats) -> list[MeanLoss]: ...
    def evpi(self, wtp: ArrayLike) -> MeanLoss | list[MeanLoss]:
        """Return what knowing all parameters before choosing a strategy would be worth.

        At several numbers, a list of one for each.
        """
        values = self.net_benefit(wtp)
        return evpi(values) if values.ndim == 2 else [evpi(each) for each in values]

    def evppi(
        self, wtp: float, groups: Mapping[str, Sequence[str]] | None = None
    ) -> dict[str, PartialInformation]:
        """Return what knowing some parameters would be worth, with its standard error.

        Groups are {name: parameter names}; each parameter alone unless given. Raises ModelError for
        more than one willingness to pay.
        """
        if _prices(wtp).ndim:
            raise ModelError("several numbers", where=WTP, fix="ask for the EVPPI at each of them")
        value = self.net_benefit(wtp)
        return {
            label: evppi(value, self.draws[:, columns], names)
            for label, names, columns in groups_of(self.uncertainty, groups)
        }

    def icers(self) -> DataFrame:
        """Return mean cost and effect of every strategy, the cheapest first, and its ICER.

        Each is compared with the one before it on the efficient frontier; a strategy that is not on
        the frontier has no ICER, and `status` says why.
        """
        import pandas

        cost, effect = self.cost.mean(axis=0), self.effect.mean(axis=0)
        order = sorted(range(len(cost)), key=lambda n: (cost[n], -effect[n]))
        efficient, status = list[int](), dict[int, str]()
        for n in order:
            if efficient and effect[n] <= effect[efficient[-1]]:
                status[n] = DOMINATED
                continue
            while len(efficient) > 1 and _ratio(cost, effect, *efficient[-2:]) >= _ratio(
                cost, effect, efficient[-1], n
            ):
                status[efficient.pop()] = EXTENDED
            efficient.append(n)
        before = dict(zip(efficient[1:], efficient, strict=False))
        rows = [
            {
                "strategy": self.strategies[n],
                "cost": cost[n],
                "effect": effect[n],
                "incremental cost": cost[n] - cost[before[n]] if n in before else np.nan,
                "incremental effect": effect[n] - effect[before[n]] if n in before else np.nan,
                "ICER": _ratio(cost, effect, before[n], n) if n in before else np.nan,
                "status": status.get(n, "efficient"),
            }
            for n in order
        ]
        return pandas.DataFrame(rows)

    def frame(self, wtp: ArrayLike | None = None) -> DataFrame:
        """Return one row for each willingness to pay: CEAC, frontier, EVPI."""
        import pandas

        at = self.grid() if wtp is None else np.atleast_1d(_prices(wtp))
        table = pandas.DataFrame(self.acceptability(at), columns=list(self.strategies))
        table.insert(0, WTP, at)
        table["best on average"] = [name for name, _ in self.frontier(at)]
        evpi = self.evpi(at)
        table["EVPI"] = [each.value for each in evpi]
        errors = np.array([each.standard_error for each in evpi])
        table["EVPI ±"] = np.where(np.isfinite(errors), errors, np.nan)  # of one draw, unknown
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
    if prices.ndim > 1 or not np.isfinite(prices).all():
        raise ModelError(f"{wtp!r:.60} is given", where=WTP, fix="give a number, or a list of them")
    return prices


def _ratio(cost: Floats, effect: Floats, one: int, other: int) -> float:
    return float((cost[other] - cost[one]) / (effect[other] - effect[one]))


def cost_effectiveness(
    model: Scenario | MDP | Parametric,
    strategies: Mapping[str, PolicyLike],
    n: int | None = None,
    *,
    effect: str = "qaly",
    cost: str = "cost",
    rng: RNG = 0,
    uncertain: Uncertainty | Mapping[str, Settings] | DataFrame | None = None,
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
    uncertain : {name: settings}, pandas.DataFrame or Uncertainty, optional
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
    >>> from exact_mdp.mdp.parametric import Family
    >>> def build(at):
    ...     parts = {"qaly": [0, at["gain"], 0], "cost": [0, 5, 0]}
    ...     rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    ...     return MDP.from_outcomes(rows, components=parts)
    >>> model = Family(parameters={"gain": 1}, build=build)
    >>> said = {"gain": {"distribution": "uniform", "low": 0, "high": 2}}
    >>> analysis = cost_effectiveness(model, {"wait": [0, 0], "treat": [1, 0]}, 400, uncertain=said)
    >>> analysis.frontier(10)[0][0], abs(float(analysis.acceptability(10)[0, 1]) - 3 / 4) < 0.1
    ('treat', True)
    """
    family, seed = parametric(model), seed_of(rng)
    if not isinstance(strategies, Mapping) or not strategies:
        what = "no strategy" if isinstance(strategies, Mapping) else "strategies without names"
        raise ModelError(what, where="strategies", fix="give {name: policy}, at least one")
    chosen = uncertain_of(family, uncertain)
    solver = ModelSolver(family, chosen.names)
    for name in (effect, cost):
        known(name, solver.base.mdp.component_names, "component", "cost-effectiveness")
    blocks, _ = drawn(chosen, n, seed, solver.block)
    weights = [solver.base.held(policy) for policy in strategies.values()]
    totals = np.concatenate(
        [
            solver.totals(each, weights, (effect, cost), at * solver.block)
            for at, each in enumerate(blocks)
        ]
    )
    return CostEffectiveness(
        strategies=tuple(strategies),
        uncertainty=chosen,
        draws=np.concatenate(blocks),
        effect=totals[:, :, 0],
        cost=totals[:, :, 1],
        seed=seed,
    )
