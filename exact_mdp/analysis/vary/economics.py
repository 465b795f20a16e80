"""Cost-effectiveness of strategies under uncertainty, as health economists report it.

A strategy is a policy held fixed; its effect E (quality-adjusted life years, say) and its cost C
are expected totals of two components of the reward. At a willingness to pay λ for a unit of effect

    NMB(λ) = λ E - C                                  net monetary benefit,
    CEAC   = share of draws in which a strategy has the greatest NMB,
    CEAF   = the same share for the strategy whose mean NMB is greatest,
    EVPI   = E[max NMB] - max E[NMB],
    ICER   = (C₂ - C₁) / (E₂ - E₁)                    of neighbours on the efficient frontier

(Fenwick, Claxton and Sculpher, Health Economics 10, 2001). A strategy is *dominated* if another
costs no more and has no less effect, *extendedly dominated* if a mixture of two others does. Two
strategies are equal in cost, effect or net benefit if these differ by no more than their error
bounds. `tradeoff` finds the efficient ones among all policies, with ICERs as rates between
neighbours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.analysis.vary.distributions import Stated, Uncertainty, drawn_family, uncertainty
from exact_mdp.analysis.vary.information import estimate_evpi, estimate_evppi
from exact_mdp.analysis.vary.psa import groups_of, sample_parameters
from exact_mdp.analysis.vary.study import ModelSolver
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, require_known_name, require_type, warn_user
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, parametric
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.questions.origin import Question
from exact_mdp.mdp.report import Report, Shown
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame, frame_to_table
from exact_mdp.mdp.table import Floats, float_of
from exact_mdp.mdp.validate import RNG, as_discount, seed_of
from exact_mdp.solvers.bounds.gains import SLACK, UNIT
from exact_mdp.solvers.claims import Claim

EFFICIENT, EQUAL = "efficient", "equal to {}"
DOMINATED, EXTENDED = "dominated", "extendedly dominated"
REFERENCE, DOMINATES = "reference", "dominates"
COMPARED = {  # signs of incremental cost and effect
    (1, 1): "more cost, more effect",
    (-1, -1): "less cost, less effect",
    (-1, 0): DOMINATES,
    (-1, 1): DOMINATES,
    (0, 1): DOMINATES,
    (1, 0): DOMINATED,
    (1, -1): DOMINATED,
    (0, -1): DOMINATED,
}
MIDDLE = (0.025, 0.975)  # the quantiles between which 95 % of the draws lie
STEP = ("incremental cost", "incremental effect", "ICER")
WTP = "willingness to pay"
BASE = "held in the base case"
NO_PARAMETER = (
    "held, as a plain model has no parameters of them, and each row varies alone; "
    "a Family can do more"
)


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class CostEffectiveness(Pictured):
    """Expected `effect` and `cost` (D, N) of N strategies in D draws of Q parameters.

    `effect_error` and `cost_error` bound their errors; numbers from elsewhere are taken as exact.
    """

    strategies: tuple[str, ...]
    uncertainty: Uncertainty
    draws: Floats
    effect: Floats
    cost: Floats
    components: tuple[str, str]  # names of effect and cost
    seed: int | None  # of the draws; None for draws from elsewhere
    effect_error: Floats | float = 0.0  # (D, N)
    cost_error: Floats | float = 0.0

    @classmethod
    def of(cls, cost: Any, effect: Any, parameters: Any = None) -> Self:
        """Return the analysis of costs and effects from elsewhere, such as another model's draws.

        Parameters
        ----------
        cost, effect : DataFrame or {strategy: numbers}
            A column for each of N strategies and a row for each of D draws; one number for each
            strategy is a base case.
        parameters : DataFrame or {parameter: numbers}, optional
            The parameters of the draws, for `evppi`.

        Returns
        -------
        CostEffectiveness

        Raises
        ------
        ModelError
            If columns or rows differ, and for numbers that are not finite.

        Examples
        --------
        >>> costs = {"usual": 1000, "new": 2500, "old": 1200}
        >>> table = CostEffectiveness.of(costs, {"usual": 2, "new": 2.5, "old": 1.9}).icers()
        >>> table["ICER"].tolist(), table["by"].tolist()
        ([nan, nan, 3000.0], ['', 'usual', ''])
        """
        _require_same_index({"cost": cost, "effect": effect, "parameters": parameters})
        costs, effects = _read_table(cost, "cost"), _read_table(effect, "effect")
        if [*costs] != [*effects]:
            only = [name for name in (*costs, *effects) if (name in costs) != (name in effects)]
            what = f"costs and effects of other strategies: {', '.join(only) or 'another order'}"
            raise ModelError(what, where="effect", fix="give both the same columns")
        given = {} if parameters is None else _read_table(parameters, "parameters")
        lengths = {len(each) for each in (*costs.values(), *effects.values(), *given.values())}
        if len(lengths) > 1:
            what = f"tables of {' and '.join(map(str, sorted(lengths)))} rows"
            raise ModelError(what, where="cost", fix="give all of them one row for each draw")
        sample = np.empty((*lengths, 0))
        if given:
            sample = np.stack([*given.values()], axis=1)
        return cls(
            strategies=tuple(costs),
            uncertainty=Uncertainty.of_sample(tuple(given), sample),
            draws=sample,
            effect=np.array([*effects.values()]).T,
            cost=np.array([*costs.values()]).T,
            components=("effect", "cost"),
            seed=None,
        )

    @property
    def base_case(self) -> bool:
        """Whether nothing is drawn, so all numbers are for today's values."""
        return len(self.draws) == 1 and not self.uncertainty.parts

    @property
    def claim(self) -> Claim:
        """Bounded for a base case that was computed here; estimated from draws or elsewhere."""
        if self.base_case and self.seed is not None:
            return Claim.BOUNDED
        return Claim.ESTIMATED

    def __repr__(self) -> str:
        if self.base_case:
            what = "the base case"
        else:
            what = f"draws {len(self.draws):,}"
        if self.uncertainty.assumption:
            what += f"; {self.uncertainty.assumption}"
        return f"CostEffectiveness({', '.join(self.strategies)}; {what})"

    def net_benefit(self, wtp: ArrayLike) -> Floats:
        """Return net benefits λ E - C (D, N) at a willingness to pay; (W, D, N) for W of them."""
        return np.multiply.outer(_parse_prices(wtp), self.effect) - self.cost

    def _bound_errors(self, wtp: ArrayLike) -> Floats:
        """Return error bounds of net benefits, in the shape of `net_benefit`."""
        price = np.abs(_parse_prices(wtp))
        error = np.multiply.outer(price, self.effect_error + 4 * UNIT * np.abs(self.effect))
        return np.asarray((error + self.cost_error + 4 * UNIT * np.abs(self.cost)) * SLACK)

    def acceptability(self, wtp: ArrayLike) -> Floats:
        """Return the shares (W, N) of draws in which a strategy is best; ties split a draw."""
        prices = np.atleast_1d(_parse_prices(wtp))
        values, error = self.net_benefit(prices), self._bound_errors(prices)
        most = values.argmax(axis=2)[:, :, None]
        behind = np.take_along_axis(values, most, 2) - values
        best = behind <= np.take_along_axis(error, most, 2) + error
        return np.asarray((best / best.sum(axis=2, keepdims=True)).mean(axis=1))

    def frontier(self, wtp: ArrayLike) -> list[tuple[str, float]]:
        """Return the best strategy on average, and the share of draws in which it is the best.

        On a tie it is the strategy that was named first.
        """
        prices = np.atleast_1d(_parse_prices(wtp))
        best = [self._find_best_strategy(price) for price in prices.tolist()]
        shares = self.acceptability(prices)[np.arange(len(best)), best]
        names = [self.strategies[n] for n in best]
        return list(zip(names, shares.tolist(), strict=True))

    def _find_best_strategy(self, wtp: float) -> int:
        """Return the strategy with the greatest mean net benefit; on a tie, the first."""
        means = _Means.of(self.net_benefit(wtp), self._bound_errors(wtp))
        most = int(means.value.argmax())
        ties = [n for n in range(len(self.strategies)) if means.compare_means(n, most) == 0]
        return ties[0]

    def _equalise_ties(self, wtp: float) -> Floats:
        """Return net benefits (D, N), in which ties with the best strategy are made exact.

        Rounding then creates no value of information.
        """
        value, error = self.net_benefit(wtp), self._bound_errors(wtp)
        best = self._find_best_strategy(wtp)
        own = value[:, best : best + 1]
        return np.where(np.abs(value - own) <= error + error[:, best : best + 1], own, value)

    def evpi(self, wtp: ArrayLike, population: float = 1) -> Any:
        """Return the value of knowing all parameters before choosing; a list for several `wtp`.

        It is for one person, times the `population` that the decision concerns. People of later
        years are discounted: 500 a year for ten years are sum(500 * 0.97**t for t in range(10)).
        """
        people = float_of(population, "population")
        if people <= 0:
            fix = "give how many people the decision concerns"
            raise ModelError(f"a population of {people:g}", where="population", fix=fix)
        prices = _parse_prices(wtp)
        every = [
            estimate_evpi(people * self._equalise_ties(each))
            for each in np.atleast_1d(prices).tolist()
        ]
        return every if prices.ndim else every[0]

    def evppi(self, wtp: ArrayLike, groups: Mapping[str, Sequence[str]] | None = None) -> Any:
        """Return {group: value of knowing its parameters}; a list of these for several `wtp`.

        Groups are by default as in `PSA.evppi`; each value is a `PartialInformation`.
        """
        prices, parts = _parse_prices(wtp), groups_of(self.uncertainty, groups)
        every = []
        for price in np.atleast_1d(prices).tolist():
            value = self._equalise_ties(price)
            every.append({
                label: estimate_evppi(value, self.draws[:, columns], names)
                for label, names, columns in parts
            })  # fmt: skip
        return every if prices.ndim else every[0]

    def icers(self, reference: str | None = None) -> DataFrame:
        """Return mean cost, effect and ICER of every strategy, the cheapest first.

        Each is compared with the one before it on the efficient frontier. A strategy that is not on
        the frontier has no ICER, and `status` says why: it is dominated, or extendedly dominated,
        `by` the strategies named; or equal to a strategy named before it. With draws there are the
        limits between which 95 % of the costs and effects lie.

        Parameters
        ----------
        reference : str, optional
            Compare every strategy with this one instead, such as usual care. The ICER is then what
            a unit of effect costs, or what giving one up saves; `status` says which.
        """
        cost = _Means.of(self.cost, self.cost_error)
        effect = _Means.of(self.effect, self.effect_error)
        columns: dict[str, Any] = {"strategy": self.strategies}
        for name, mean, each in (("cost", cost, self.cost), ("effect", effect, self.effect)):
            columns[name] = mean.value
            if not self.base_case:
                low, high = np.quantile(each, MIDDLE, axis=0)
                columns |= {f"{name} low": low, f"{name} high": high}
        columns |= dict.fromkeys(STEP, np.nan)
        if reference is None:
            columns["status"] = _classify_strategies(cost, effect, self.strategies)
            rows = data_frame(columns)
            # The ICER of each efficient strategy, against the efficient one before it.
            efficient = [n for n, said in enumerate(columns["status"]) if said == EFFICIENT]
            efficient.sort(key=lambda n: float(cost.value[n]))
            rows["by"] = _find_dominating(
                cost, effect, columns["status"], efficient, self.strategies
            )
            for one, other in pairwise(efficient):
                rows.loc[other, list(STEP)] = _compare_strategies(cost, effect, other, one)
        else:
            require_known_name(reference, self.strategies, "strategy", "reference")
            one, rows = self.strategies.index(reference), data_frame(columns)
            said = [REFERENCE] * len(self.strategies)
            for other in {*range(len(said))} - {one}:
                signs = cost.compare_means(other, one), effect.compare_means(other, one)
                said[other] = COMPARED.get(signs, EQUAL.format(reference))
                more, gained, ratio = _compare_strategies(cost, effect, other, one)
                if 0 in signs or signs[0] != signs[1]:
                    ratio = np.nan
                rows.loc[other, list(STEP)] = [more, gained, ratio]
            rows["status"] = said
        return rows.sort_values(["cost", "effect"], ascending=[True, False], ignore_index=True)

    def report(self, reference: str | None = None) -> Report:
        """Return cost, effect and ICER of every strategy, and its probability of being best.

        With a `reference`, every strategy is compared with it; see `icers`.
        """
        rows, grid = self.icers(reference), self.grid(11)
        chances = frame_to_table(self.frame(grid), "shares of draws in which each is the best")
        short = {"incremental cost": "Δ cost", "incremental effect": "Δ effect"}
        limits = [f"{name} {end}" for name in ("cost", "effect") for end in ("low", "high")]
        shown = rows.drop(columns=limits, errors="ignore").rename(columns=short)
        tables = {"strategies": frame_to_table(shown, "strategies, the cheapest first")}
        if not self.base_case:
            within = rows[["strategy", *limits]]
            tables["limits"] = frame_to_table(within, "limits of 95 % of the draws")
        tables["chances"] = chances
        drawn = {part.label: part.kind for part in self.uncertainty.parts}
        count, assumed = len(self.draws), self.uncertainty
        held = None
        if NO_PARAMETER in assumed.fixed.values():
            held = f"{', '.join(self.components)}: {NO_PARAMETER}"
        facts = {
            "claim": self.claim,
            **self._list_error_facts(),
            "draws": Shown(count, "none: the base case" if self.base_case else count),
            "seed": Shown(self.seed, None if self.base_case else self.seed),
            "effect": self.components[0],
            "cost": self.components[1],
            "drawn": Shown(drawn, f"{len(drawn)} distributions" if drawn else None),
            "fixed": Shown(assumed.fixed, held),
            "assumed": Shown(assumed.assumed, assumed.assumption or None),
            "strategies": Shown(list(self.strategies)),
            "icers": Shown(rows.to_dict("records")),
            "willingness_to_pay": Shown(grid),
            "acceptability": Shown(
                dict(zip(self.strategies, self.acceptability(grid).T, strict=True))
            ),
            "evpi": Shown([each.value for each in self.evpi(grid)]),
        }
        return Report(title=repr(self), facts=facts, tables=tables)

    def _list_error_facts(self) -> dict[str, Any]:
        """Return the greatest errors of effect and cost in a base case; none in draws."""
        if self.claim != Claim.BOUNDED:
            return {}
        errors = (float(np.max(each)) for each in (self.effect_error, self.cost_error))
        return {"error_bounds": dict(zip(self.components, errors, strict=True))}

    def frame(self, wtp: ArrayLike | None = None) -> DataFrame:
        """Return one row for each willingness to pay: CEAC, frontier, EVPI."""
        if wtp is None:
            at = self.grid()
        else:
            at = np.atleast_1d(_parse_prices(wtp))
        table = data_frame(self.acceptability(at), columns=list(self.strategies))
        table.insert(0, WTP, at)
        table["best on average"] = [name for name, _ in self.frontier(at)]
        gains = [(each.value, each.standard_error) for each in self.evpi(at)]
        table[["EVPI", "EVPI s.e."]] = np.array(gains)
        # The standard error of a single draw is unknown.
        table["EVPI s.e."] = table["EVPI s.e."].replace(np.inf, np.nan)
        table["claim"] = str(self.claim)
        return table

    def grid(self, count: int = 51) -> Floats:
        """Return a grid from 0 to twice the largest ICER, over which curves are drawn."""
        most = float(np.nanmax(np.append(self.icers()["ICER"].to_numpy(dtype=float), 0.0)))
        return np.linspace(0, 2 * most or 1.0, count)


@dataclass(frozen=True)
class _Means:
    """Means (N,) over the draws, and bounds on their errors."""

    value: Floats
    error: Floats

    @classmethod
    def of(cls, numbers: Floats, error: Floats | float) -> _Means:
        """Return the means of numbers (D, N); the error includes the rounding of the sum."""
        rounding = (len(numbers) + 4) * UNIT * np.abs(numbers).mean(axis=0)
        given = np.broadcast_to(error, numbers.shape).mean(axis=0)
        return cls(numbers.mean(axis=0), rounding + given * SLACK)

    def compute_difference(self, one: int, other: int) -> tuple[float, float]:
        """Return the difference of two means, and its error bound."""
        apart = float(self.value[one] - self.value[other])
        return apart, float(self.error[[one, other]].sum() + UNIT * abs(apart)) * SLACK

    def compare_means(self, one: int, other: int) -> int:
        """Return -1, 0 or 1 if one mean is less than the other, equal to it or greater."""
        apart, error = self.compute_difference(one, other)
        if abs(apart) <= error:
            return 0
        if apart > 0:
            return 1
        return -1


def _classify_strategies(cost: _Means, effect: _Means, names: Sequence[str]) -> list[str]:
    """Return the status of each strategy: efficient, or why it is not on the frontier."""
    status = [EFFICIENT] * len(names)
    # 1. Equal strategies: only the first of them is kept.
    kept = list[int]()
    for n, _ in enumerate(names):
        alike = [m for m in kept if cost.compare_means(n, m) == 0 == effect.compare_means(n, m)]
        if alike:
            status[n] = EQUAL.format(names[alike[0]])
        else:
            kept.append(n)
    # 2. Dominated: another costs no more and has no less effect.
    for n in kept:
        for m in kept:
            if m != n and cost.compare_means(m, n) <= 0 <= effect.compare_means(m, n):
                status[n] = DOMINATED
    # 3. Extendedly dominated: ICERs must rise along the frontier (a lower convex hull).
    frontier = list[int]()
    left = [n for n in kept if status[n] == EFFICIENT]
    for n in sorted(left, key=lambda n: float(cost.value[n])):
        while len(frontier) > 1 and not _is_icer_rising(
            cost, effect, frontier[-2], frontier[-1], n
        ):
            status[frontier.pop()] = EXTENDED
        frontier.append(n)
    return status


def _find_dominating(
    cost: _Means, effect: _Means, status: Sequence[str], efficient: Sequence[int],
    names: Sequence[str],
) -> list[str]:  # fmt: skip
    """Return by which strategies each one is dominated, if it is; efficient ones go first."""
    found = [""] * len(names)
    for n, said in enumerate(status):
        if said == DOMINATED:
            others = [m for m in (*efficient, *range(len(names))) if m != n]
            cheaper = [m for m in others if cost.compare_means(m, n) <= 0]
            found[n] = next(names[m] for m in cheaper if effect.compare_means(m, n) >= 0)
        elif said == EXTENDED:
            after = next(k for k, m in enumerate(efficient) if effect.compare_means(m, n) > 0)
            found[n] = f"{names[efficient[after - 1]]} and {names[efficient[after]]}"
    return found


def _compare_strategies(cost: _Means, effect: _Means, other: int, one: int) -> list[float]:
    """Return incremental cost, incremental effect and their ratio; NaN for equal effects."""
    more, _ = cost.compute_difference(other, one)
    gained, _ = effect.compute_difference(other, one)
    return [more, gained, more / gained if gained else np.nan]


def _is_icer_rising(cost: _Means, effect: _Means, first: int, middle: int, last: int) -> bool:
    """Return whether the ICER is surely smaller from first to middle than from middle to last.

    c₁ / e₁ < c₂ / e₂ is tested as c₂ e₁ - c₁ e₂ > 0, beyond the errors of all four differences.
    """
    c1, dc1 = cost.compute_difference(middle, first)
    e1, de1 = effect.compute_difference(middle, first)
    c2, dc2 = cost.compute_difference(last, middle)
    e2, de2 = effect.compute_difference(last, middle)
    apart = c2 * e1 - c1 * e2
    error = abs(c2) * de1 + (abs(e1) + de1) * dc2 + abs(c1) * de2 + (abs(e2) + de2) * dc1
    return apart > (error + 4 * UNIT * (abs(c2 * e1) + abs(c1 * e2))) * SLACK


def _parse_prices(wtp: ArrayLike) -> Floats:
    """Return one willingness to pay or several, checked."""
    try:
        prices = np.asarray(wtp, dtype=float)
    except (TypeError, ValueError):
        prices = np.array(np.nan)
    if prices.ndim > 1 or not prices.size or not np.isfinite(prices).all():
        what = f"{wtp!r:.60} is not a finite number"
        raise ModelError(what, where=WTP, fix="give one, or a list")
    return prices


def _require_same_index(tables: Mapping[str, Any]) -> None:
    """Raise ModelError unless all tables of pandas list the draws in the same order."""
    labelled = {name: each for name, each in tables.items() if hasattr(each, "columns")}
    first, *others = labelled or [""]
    for name in others:
        if len(labelled[name]) != len(labelled[first]):
            what = f"{name} has {len(labelled[name]):,} rows, {first} has {len(labelled[first]):,}"
            raise ModelError(what, where=name, fix="give a row for each draw")
        if [*labelled[name].index] != [*labelled[first].index]:
            what = f"{name} has other row labels than {first}, or another order of rows"
            fix = "give all tables the same labels in the same order, one for each draw"
            raise ModelError(what, where=name, fix=fix)


def _read_table(given: Any, where: str) -> dict[str, Floats]:
    """Return the columns of a table, or {name: numbers}, as floats (D,) by name."""
    if not isinstance(given, Mapping) and not hasattr(given, "columns"):
        fix = "give a DataFrame, or {name: numbers}"
        raise ModelError(f"{type(given).__name__} is not a table", where=where, fix=fix)
    columns = {}
    for name in given:
        numbers = np.atleast_1d(np.asarray(given[name]))
        try:
            columns[str(name)] = numbers.astype(float)
        except (TypeError, ValueError):
            numbers = np.empty((0, 0))
        if numbers.ndim != 1 or not numbers.size or not np.isfinite(columns[str(name)]).all():
            what = "not a list of numbers"
            if numbers.ndim == 1 and numbers.size:
                what = f"a number is {columns[str(name)][~np.isfinite(columns[str(name)])][0]}"
            fix = "give one finite number, or one for each draw"
            raise ModelError(what, where=f"{where} of {name}", fix=fix)
    if not columns:
        raise ModelError("no column", where=where, fix="give one for each strategy")
    return columns


def _warn_of_rate(discount: Fraction, where: str) -> None:
    """Warn of a discount that looks like a rate: 0.03 where 1/1.03 is meant."""
    if 0 < discount < Fraction(1, 2):
        factor = (1 / (1 + discount)).limit_denominator(10**6)
        warn_user(
            f"the {where} is {float(discount):g}, a factor from one step to the next; if a rate is "
            f"meant, give {factor}, which is 1/(1 + rate)"
        )


def parse_price(wtp: ArrayLike) -> float:
    """Return one willingness to pay, checked."""
    prices = _parse_prices(wtp)
    if prices.ndim:
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
    discount: Mapping[str, object] | None = None,
) -> CostEffectiveness:
    """Draw the parameters, and compute cost and effect of every strategy in every draw.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
        Its reward has the two components.
    strategies : {name: PolicyLike}
        Policies held fixed; "optimal" is the optimum at today's values.
    n : int, optional
        Number of draws; from a given sample the first n rows, by default all. Without `n` and
        `uncertain` nothing is drawn: the result is the base case, with today's values.
    effect, cost : str
        Names of components; more cost is worse.
    rng : int or numpy.random.Generator
    uncertain : {name: settings}, pandas.DataFrame, file or Uncertainty, optional
        As for `psa`. The text of the result names the number of observations on which probabilities
        without a stated distribution are assumed to rest.
    discount : {component: number or "p/q"}, optional
        Discounts of cost and effect that differ from the model's own.

    Returns
    -------
    CostEffectiveness

    Raises
    ------
    ModelError
        For unknown components, without strategies, and as `psa` raises it.

    Examples
    --------
    >>> rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
    >>> mdp = MDP.from_outcomes(rows, components={"qaly": [0, 1, 0], "cost": [0, 5, 0]})
    >>> said = {"discount": {"distribution": "uniform", "low": 0.9, "high": 1}}
    >>> analysis = cost_effectiveness(mdp, {"wait": [0, 0], "treat": [1, 0]}, 20, uncertain=said)
    >>> analysis.frontier([4, 10])
    [('wait', 1.0), ('treat', 1.0)]
    """
    seed = seed_of(rng)
    if not isinstance(strategies, Mapping) or not strategies:
        what = "strategies without names"
        if isinstance(strategies, Mapping):
            what = "no strategy"
        raise ModelError(what, where="strategies", fix="give {name: policy}, at least one")
    # Without draws, the base case is a single draw of no parameter.
    family: Parametric
    if n is None and uncertain is None:
        family = parametric(model)
        chosen = Uncertainty(parts=(), fixed={p.name: BASE for p in family.parameters})
        solver, draws = ModelSolver(family, ()), np.empty((1, 0))
    else:
        family = drawn_family(model)
        chosen = uncertainty(family, uncertain)
        if isinstance(model, MDP):
            amounts = dict.fromkeys((effect, cost), NO_PARAMETER)
            chosen = replace(chosen, fixed={**chosen.fixed, **amounts})
        solver = ModelSolver(family, chosen.names)
        draws = sample_parameters(family, chosen, n, seed, solver.block)
    for where, name in (("effect", effect), ("cost", cost)):
        require_known_name(name, solver.mdp.component_names, "component", where)
    _warn_of_rate(solver.mdp.discount_exact, "discount")
    # A solver for each of the two discounts.
    solvers = [solver, solver]
    fix = 'give {component: discount}: {"cost": 0.97, "qaly": 1}'
    for name, rate in require_type(discount or {}, Mapping, "discount", fix).items():
        require_known_name(name, (effect, cost), "component", "discount")
        if DISCOUNT in chosen.names:
            fix = "hold the discount fixed, or leave discount= out"
            raise ModelError("the discount is drawn, and given, too", where="discount", fix=fix)
        _warn_of_rate(as_discount(rate), f"discount of {name}")
        other = family.with_question(Question("with_", {"discount": as_discount(rate)}))
        solvers[(effect, cost).index(name)] = ModelSolver(other, chosen.names)
    # Cost and effect of each strategy, block by block, with error bounds.
    held = [
        solver.solution if isinstance(form, str) and form == "optimal" else form
        for form in strategies.values()
    ]
    totals, errors = np.empty((2, len(draws), len(held), 2))
    for each in dict.fromkeys(solvers):
        own = [column for column in (0, 1) if solvers[column] is each]
        names, weights = [(effect, cost)[column] for column in own], [*map(each.hold_policy, held)]
        for first in range(0, len(draws), each.block):
            here = slice(first, first + each.block)
            found = each.compute_totals(draws[here], weights, names, first)
            totals[here, :, own], errors[here, :, own] = found
    return CostEffectiveness(
        strategies=tuple(strategies),
        uncertainty=chosen,
        draws=draws,
        effect=totals[:, :, 0],
        cost=totals[:, :, 1],
        components=(effect, cost),
        seed=seed,
        effect_error=errors[:, :, 0],
        cost_error=errors[:, :, 1],
    )
