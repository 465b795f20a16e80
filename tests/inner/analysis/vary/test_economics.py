"""Cost-effectiveness by loops over draws, by exact fractions, and by its definitions."""

import json
from fractions import Fraction
from functools import partial
from itertools import permutations, product
from typing import Any

import numpy as np
import pandas as pd
import pytest
from refusal_tables import refused
from scipy.stats import sem

from exact_mdp import MDP, Family, ModelError, cost_effectiveness, evaluate
from exact_mdp.analysis.vary.distributions import Uncertain, Uncertainty
from exact_mdp.analysis.vary.economics import (
    CostEffectiveness,
    _classify_strategies,
    _is_icer_rising,
    _Means,
    parse_price,
)
from exact_mdp.analysis.vary.information import estimate_evpi, estimate_evppi
from exact_mdp.solvers.bounds.gains import SLACK, UNIT
from exact_mdp.solvers.claims import Claim

NAMES = ("none", "some", "more", "most", "all", "double", "triple")
DRAWN = Uncertainty(
    parts=tuple(Uncertain.of(name, "uniform", low=0, high=1) for name in ("p.one", "p.two")),
    fixed={},
)


def analysis_of(
    effect: Any, cost: Any, draws: Any = None, *, chosen: Uncertainty = DRAWN, **errors: Any
) -> CostEffectiveness:
    effect, cost = np.asarray(effect, dtype=float), np.asarray(cost, dtype=float)
    return CostEffectiveness(
        strategies=NAMES[: effect.shape[1]],
        uncertainty=chosen,
        draws=np.zeros((len(effect), 2)) if draws is None else draws,
        effect=effect,
        cost=cost,
        components=("qaly", "cost"),
        seed=7,
        **errors,
    )


def random_analysis(seed: int) -> CostEffectiveness:
    """Small integers, so that ties are many and each float is exact."""
    rng = np.random.default_rng(seed)
    draws, strategies = int(rng.integers(1, 9)), int(rng.integers(1, 6))
    shape = draws, strategies
    return analysis_of(rng.integers(0, 4, shape), rng.integers(0, 4, shape))


PRICES = (0.0, 0.5, 1.0, 2.0, -1.0)


@pytest.mark.parametrize("seed", range(25))
def test_curves_and_information_are_those_of_loops(seed: int) -> None:
    analysis = random_analysis(seed)
    shares = analysis.acceptability(PRICES)
    frontier = analysis.frontier(PRICES)
    every = analysis.net_benefit(PRICES)
    infos = analysis.evpi(PRICES)
    for w, wtp in enumerate(PRICES):
        net = [
            [wtp * e - c for e, c in zip(*pair, strict=True)]
            for pair in zip(analysis.effect, analysis.cost, strict=True)
        ]
        assert every[w].tolist() == analysis.net_benefit(wtp).tolist() == net
        count, names = len(net), analysis.strategies
        best = [[value == max(row) for value in row] for row in net]
        share = [sum(row[n] / sum(row) for row in best) / count for n in range(len(names))]
        assert shares[w] == pytest.approx(share)
        totals = [Fraction(sum(row[n] for row in net)) for n in range(len(names))]
        first = totals.index(max(totals))
        assert frontier[w] == (names[first], pytest.approx(share[first]))
        assert analysis.frontier(wtp) == [frontier[w]]
        lost = [max(row) - row[first] for row in net]
        assert analysis.evpi(wtp).value == infos[w].value == pytest.approx(sum(lost) / count)
        if count > 1:
            assert infos[w].standard_error == pytest.approx(sem(lost))


def test_groups_are_known_by_regression_on_their_columns() -> None:
    rng = np.random.default_rng(0)
    draws, n = rng.random((60, 2)), 60
    effect = np.column_stack([np.zeros(n), draws @ [3, 1], 2 * draws[:, 1]])
    cost = np.column_stack([np.zeros(n), np.ones(n), 2 * draws[:, 0]])
    analysis = analysis_of(effect, cost, draws)
    net = 0.7 * effect - cost
    found = analysis.evppi(0.7)
    assert found["p.two"] == estimate_evppi(net, draws[:, 1:], ("p.two",))
    assert found["p.one"] == estimate_evppi(net, draws[:, :1], ("p.one",))
    grouped = analysis.evppi(0.7, {"both": ["p.two", "p.one"]})
    assert grouped["both"].regression.value == pytest.approx(estimate_evpi(net).value, rel=0.05)
    assert grouped["both"].parameters == ("p.two", "p.one")


def test_what_differs_by_no_more_than_its_errors_is_equal() -> None:
    """Net benefits 1, 1 + 2⁻²⁰ and 0, of which the errors of effects and costs cover the gap."""
    gap = 2.0**-20
    effect, cost = [[1.0, 1.0 + gap, 0.0]] * 3, [[0.0, 0.0, 0.0]] * 3
    exact = analysis_of(effect, cost)
    assert exact.acceptability(1.0).tolist() == [[0, 1, 0]]
    assert exact.frontier(1.0) == [("some", 1)]
    for share, equal in ((0.6, True), (0.4, False)):
        for key in ("effect_error", "cost_error"):
            for wtp in (1.0, -1.0, 4.0):
                scale = abs(wtp) if key == "cost_error" else 1.0
                error = np.zeros((3, 3))
                error[:, :2] = share * gap * scale
                analysis = analysis_of(effect, cost, **{key: error})
                if wtp > 0:
                    wanted = [0.5, 0.5, 0] if equal else [0, 1, 0]
                    assert analysis.acceptability(wtp).tolist() == [wanted]
                    assert analysis.frontier(wtp)[0][0] == ("none" if equal else "some")
                    assert analysis.evpi(wtp).value == 0
    one = np.zeros((3, 3))
    one[:, 0] = 1.1 * gap  # of one of the two is enough, of another one counts nothing
    assert analysis_of(effect, cost, effect_error=one).acceptability(1.0)[0, 0] == 0.5
    assert analysis_of(effect, cost, effect_error=one[:, ::-1]).acceptability(1.0)[0, 0] == 0
    assert analysis_of(effect, cost, effect_error=one).frontier([1.0]) == [("none", 0.5)]


def test_rounding_is_worth_no_information() -> None:
    """Where strategies are ahead in turn by less than their errors, knowing that is worth 0."""
    effect = [[1.0, 1.0 + 2.0**-20], [1.0 + 2.0**-20, 1.0], [1.0, 1.0]]
    cost, error = np.zeros((3, 2)), np.full((3, 2), 2.0**-20)
    assert analysis_of(effect, cost).evpi(1.0).value > 0
    for own in ([[1, 0]], [[0, 1]], [[0.55, 0.55]]):
        analysis = analysis_of(effect, cost, effect_error=error * own)
        assert analysis.evpi(1.0).value == 0
    assert analysis_of(effect, cost, effect_error=0.45 * error).evpi(1.0).value > 0
    assert analysis_of(np.array(effect)[:, [0]], cost[:, [0]]).evpi([1.0])[0].value == 0
    settled = analysis_of(effect, cost, effect_error=error)._equalise_ties(1.0)
    assert settled.tolist() == [[row[0]] * 2 for row in effect]
    far = np.add(effect, [[0, 3.0]])
    assert np.array_equal(analysis_of(far, cost, effect_error=error)._equalise_ties(1.0), far)


@pytest.mark.parametrize("seed", range(10))
def test_bounds_cover_the_exact_net_benefit_of_numbers_within_their_errors(seed: int) -> None:
    """In fractions, of numbers at the ends of their errors; the bound is not twice as wide."""
    rng = np.random.default_rng(seed)
    effect, cost = rng.normal(size=(2, 3, 2)) * 10.0 ** rng.integers(-3, 4)
    off = {"effect_error": np.abs(rng.normal(size=(3, 2))) * 2.0**-45,
           "cost_error": np.abs(rng.normal(size=(3, 2))) * 2.0**-45}  # fmt: skip
    analysis = analysis_of(effect, cost, **off)
    for wtp in (3.7, -0.3):
        net, bound = analysis.net_benefit(wtp), analysis._bound_errors(wtp)
        for at in product(range(3), range(2)):
            e, c = Fraction(effect[at]), Fraction(cost[at])
            de, dc = Fraction(off["effect_error"][at]), Fraction(off["cost_error"][at])
            ends = [Fraction(wtp) * (e + i * de) - (c + j * dc) for i in (1, -1) for j in (1, -1)]
            far = max(abs(each - Fraction(net[at])) for each in ends)
            own = abs(Fraction(wtp)) * (de + 4 * Fraction(UNIT) * abs(e))
            own += dc + 4 * Fraction(UNIT) * abs(c)
            assert far <= bound[at]
            assert float(own) == pytest.approx(bound[at], rel=1e-5)
            assert own <= Fraction(bound[at])
    assert analysis._bound_errors([1.0, 2.0]).shape == (2, 3, 2)


# ---- means ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(10))
def test_means_and_differences_are_within_their_bounds_in_fractions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    draws = int(rng.integers(1, 40))
    numbers = rng.normal(size=(draws, 3)) * 10.0 ** rng.integers(-3, 4, 3)
    error = np.abs(rng.normal(size=(draws, 3))) * 1e-12
    means = _Means.of(numbers, error)
    exact = [sum(map(Fraction, column)) / draws for column in numbers.T.tolist()]
    given = [sum(map(Fraction, column)) / draws for column in error.T.tolist()]
    size = [sum(abs(Fraction(x)) for x in column) / draws for column in numbers.T.tolist()]
    for n in range(3):
        far = abs(Fraction(float(means.value[n])) - exact[n])
        assert far + given[n] <= Fraction(float(means.error[n]))
        own = given[n] + (draws + 4) * Fraction(UNIT) * size[n]
        assert float(own) == pytest.approx(means.error[n], rel=1e-5)
    for one, other in permutations(range(3), 2):
        apart, off = means.compute_difference(one, other)
        assert apart == means.value[one] - means.value[other]
        wanted = means.error[one] + means.error[other] + UNIT * abs(apart)
        assert off == pytest.approx(wanted * SLACK, rel=1e-12)
    none = _Means.of(np.zeros((draws, 3)), error).error.tolist()
    assert all(Fraction(own) >= least for own, least in zip(none, given, strict=True))
    assert _Means.of(numbers, 0.0).error == pytest.approx(
        [float((draws + 4) * Fraction(UNIT) * each) for each in size]
    )


def test_means_are_equal_within_both_errors() -> None:
    means = _Means(np.array([0.0, 1.0, 3.0]), np.array([0.5, 0.5, 0.25]))
    signs = [[means.compare_means(one, other) for other in range(3)] for one in range(3)]
    assert signs == [[0, 0, -1], [0, 0, -1], [1, 1, 0]]


# ---- the efficient frontier ----------------------------------------------------------------------


def exact_means(numbers: Any) -> _Means:
    return _Means(np.asarray(numbers, dtype=float), np.zeros(len(numbers)))


def said_of(cost: list[int], effect: list[int]) -> list[str]:
    """Why each strategy is efficient or not, by comparing it with all others and all mixtures."""
    points, said = [*zip(cost, effect, strict=True)], list[str]()
    for n, (c, e) in enumerate(points):
        if points.index((c, e)) < n:
            said.append(f"equal to {NAMES[points.index((c, e))]}")
        elif any(c2 <= c and e2 >= e and (c2, e2) != (c, e) for c2, e2 in points):
            said.append("dominated")
        else:  # a mixture of the same effect that costs no more
            mixtures = [
                c1 + Fraction((c2 - c1) * (e - e1), e2 - e1)
                for (c1, e1), (c2, e2) in product(points, repeat=2)
                if e1 < e < e2
            ]
            extended = any(mixture <= c for mixture in mixtures)
            said.append("extendedly dominated" if extended else "efficient")
    return said


@pytest.mark.parametrize("block", range(4))
def test_the_frontier_is_what_no_strategy_and_no_mixture_dominates(block: int) -> None:
    rng = np.random.default_rng(block)
    for _ in range(40):
        count, most = int(rng.integers(1, 8)), int(rng.choice([2, 4, 9, 30]))
        cost, effect = rng.integers(-2, most, (2, count)).tolist()
        if most == 30:  # along a curve that bends, on which many are efficient
            cost = [each * each // 10 for each in effect]
        said = said_of(cost, effect)
        assert _classify_strategies(exact_means(cost), exact_means(effect), NAMES[:count]) == said
        rows = analysis_of([effect, effect], [cost, cost]).icers()
        order = sorted(range(count), key=lambda n: (cost[n], -effect[n]))
        points = [(c, e) for c, e in zip(rows["cost"], rows["effect"], strict=True)]
        assert points == [(cost[n], effect[n]) for n in order]
        by_name = rows.set_index("strategy")
        assert [by_name.loc[name, "status"] for name in NAMES[:count]] == said
        before = None
        for n in order:
            own = by_name.loc[NAMES[n]]
            steps = own[["incremental cost", "incremental effect", "ICER"]].tolist()
            if said[n] == "efficient" and before is not None:
                more, gained = cost[n] - cost[before], effect[n] - effect[before]
                assert steps == pytest.approx([more, gained, more / gained])
            else:
                assert np.isnan(steps).all()
            before = n if said[n] == "efficient" else before
        # Those that dominate do what is said, and mixtures are those of efficient strategies.
        for n in range(count):
            by = [NAMES.index(name) for name in by_name.loc[NAMES[n], "by"].split(" and ") if name]
            assert len(by) == {"dominated": 1, "extendedly dominated": 2}.get(said[n], 0)
            if len(by) == 1:
                no_worse = [
                    m
                    for m in range(count)
                    if m != n and cost[m] <= cost[n] and effect[m] >= effect[n]
                ]
                best = [m for m in no_worse if said[m] == "efficient"]
                assert by[0] in (best or no_worse)
            if len(by) == 2:
                (c1, c2), (e1, e2) = [cost[m] for m in by], [effect[m] for m in by]
                assert {said[m] for m in by} == {"efficient"}
                assert e1 < effect[n] < e2
                assert c1 + Fraction((c2 - c1) * (effect[n] - e1), e2 - e1) <= cost[n]


@pytest.mark.parametrize("seed", range(20))
def test_a_chosen_reference(seed: int) -> None:
    analysis = random_analysis(seed)
    rows = analysis.icers(reference="none").set_index("strategy")
    c, e = analysis.cost.mean(axis=0), analysis.effect.mean(axis=0)
    for n, name in enumerate(analysis.strategies):
        more, gained, own = c[n] - c[0], e[n] - e[0], rows.loc[name]
        if n == 0:
            assert own["status"] == "reference"
            continue
        if more <= 0 <= gained:
            expected = "dominates" if more < gained else "equal to none"
        elif more >= 0 >= gained:
            expected = "dominated"
        else:
            word = "more" if more > 0 else "less"
            expected = f"{word} cost, {word} effect"
        assert own["status"] == expected
        steps = own[["incremental cost", "incremental effect"]].tolist()
        assert steps == pytest.approx([more, gained])
        ratio = more / gained if more * gained > 0 else np.nan
        assert own["ICER"] == pytest.approx(ratio, nan_ok=True)
    assert rows["cost low"].tolist() == np.quantile(analysis.cost, 0.025, axis=0)[
        [analysis.strategies.index(name) for name in rows.index]
    ].tolist()  # fmt: skip


def test_costs_and_effects_from_elsewhere() -> None:
    rng = np.random.default_rng(1)
    draws = pd.DataFrame(rng.normal(size=(400, 2)), columns=["p.one", "p.two"])
    effect = pd.DataFrame({"none": 0 * draws["p.one"], "some": draws["p.one"] + 0.1})
    cost = pd.DataFrame({"none": [0.0] * 400, "some": 0.3 * draws["p.two"]})
    given = CostEffectiveness.of(cost, effect, draws)
    assert given.strategies == ("none", "some")
    assert not given.base_case
    own = analysis_of(effect, cost, draws.to_numpy())
    for price in (0.5, 2.0):
        assert given.evpi(price).value == own.evpi(price).value
        ours, theirs = given.evppi(price), own.evppi(price)
        assert ours["p.one"].regression.value == theirs["p.one"].regression.value
        assert given.evpi(price, population=1000).value == pytest.approx(
            1000 * own.evpi(price).value
        )
    both = given.evppi([0.5, 2.0], {"first": ["p.one"]})
    assert [each["first"].regression.value for each in both] == [
        given.evppi(price)["p.one"].regression.value for price in (0.5, 2.0)
    ]
    alone = CostEffectiveness.of(cost, effect)
    assert not alone.base_case
    assert alone.evpi(1).value == given.evpi(1).value
    for people in (-5, 0):
        fix = "=give how many people the decision concerns"
        call = partial(given.evpi, 1.0, population=people)
        refused(call, f"=a population of {people}", "=population", fix)
    base = CostEffectiveness.of({"a": 1, "b": 3}, {"a": 1, "b": 1.5})
    assert base.base_case
    assert base.icers()["ICER"].tolist()[1] == 4
    assert given.report().facts["seed"].value is None
    assert (given.claim, base.claim) == (Claim.ESTIMATED, Claim.ESTIMATED)
    assert "error_bounds" not in base.report().facts


DRAWS = pd.DataFrame({"a": [1.0, 2.0]})


@pytest.mark.parametrize(
    ("cost", "effect", "parameters", "said"),
    [
        ({"a": 1}, {"b": 1}, None, "other strategies: a, b"),
        ({"a": 1, "b": 2}, {"b": 1, "a": 2}, None, "another order"),
        ({"a": [1, 2]}, {"a": [1]}, None, "tables of 1 and 2 rows"),
        ({"a": [1, 2]}, {"a": [1, 2]}, {"p": [1]}, "tables of 1 and 2 rows"),
        ({"a": "much"}, {"a": 1}, None, "not a list of numbers"),
        ({"a": np.nan}, {"a": 1}, None, "a number is nan"),
        ({"a": [[1]]}, {"a": 1}, None, "not a list of numbers"),
        ({}, {}, None, "no column"),
        ([1, 2], [1, 2], None, "list is not a table"),
        (DRAWS, DRAWS[::-1], None, "effect has other row labels than cost"),
        (DRAWS, DRAWS[:1], None, "effect has 1 rows, cost has"),
        ({"a": [1, 2]}, DRAWS, DRAWS.set_index("a"), "parameters has other row labels than effect"),
    ],
)
def test_bad_tables_are_refused(cost: Any, effect: Any, parameters: Any, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        CostEffectiveness.of(cost, effect, parameters)


def test_two_discounts_are_two_analyses() -> None:
    """Each of the two is the analysis of the model with that discount, draw by draw."""

    def build(at: Any) -> MDP:
        P = [[1 - at["p"], at["p"]], [0, 1]]
        parts = {"qaly": [[1, 1], [0, 0]], "cost": [[5, 9], [0, 0]]}
        return MDP.from_arrays([P, P], [[0, 0], [0, 0]], "9/10", layout="ass", components=parts)

    model = Family(parameters={"p": "1/5"}, build=build)
    said = {"p": {"distribution": "beta", "alpha": 2, "beta": 8}}
    strategies: Any = {"a": "always:0", "b": "always:1", "best": "optimal"}
    both = cost_effectiveness(
        model, strategies, 70, uncertain=said, discount={"cost": "1/2", "qaly": 1}
    )
    for name, rate in (("cost", "1/2"), ("effect", 1)):
        other = model.with_question(lambda mdp, rate=rate: mdp.with_(discount=rate))
        one = cost_effectiveness(other, {"a": "always:0", "b": "always:1"}, 70, uncertain=said)
        assert getattr(both, name)[:, :2].tolist() == getattr(one, name).tolist()
    only = cost_effectiveness(model, strategies, discount={"cost": 0})
    assert only.cost.tolist()[0][:2] == [5, 9]
    cases: list[tuple[Any, tuple[str, str, str]]] = [
        ({"price": 1}, ("=unknown component 'price'", "=discount", "choose one of qaly, cost")),
        ({"cost": 2}, ("discount is 2", "discount", "")),
        (0.9, ("=0.9 is of type float", "=discount",
               '=give {component: discount}: {"cost": 0.97, "qaly": 1}')),
    ]  # fmt: skip
    for wrong, words in cases:
        refused(partial(cost_effectiveness, model, strategies, discount=wrong), *words)
    drawn = {"discount": {"distribution": "uniform", "low": 0.8, "high": 0.9}}
    call = partial(cost_effectiveness, build({"p": 0.5}), strategies, 5, discount={"cost": 1})
    refused(lambda: call(uncertain=drawn), "=the discount is drawn, and given, too", "=discount",
            "=hold the discount fixed, or leave discount= out")  # fmt: skip


def test_strategies_equal_within_their_errors_are_one() -> None:
    close, wide = np.array([0.0, 1e-9, 1.0]), np.array([1e-9, 0.0, 0.0])
    for cost, effect, said in (
        (_Means(close, wide), _Means(close, wide), "equal to none"),
        (_Means(close, 0 * wide), _Means(close, wide), "dominated"),  # it costs more
        (_Means(close, wide), _Means(close, 0 * wide), "efficient"),  # the first gains less
    ):
        assert _classify_strategies(cost, effect, NAMES[:3])[1] == said


def test_three_strategies_bend_where_no_numbers_within_the_errors_say_otherwise() -> None:
    """Near a line, where the errors decide: by the corners of the errors, and by the bound."""
    rng, bent = np.random.default_rng(0), 0
    for _ in range(400):
        steps = rng.uniform(1, 4, (2, 1)) * rng.choice([1, 2, 5], 2)
        steps[0, 1] += rng.uniform(0, 1)
        numbers = np.concatenate([np.zeros((2, 1)), steps.cumsum(axis=1)], axis=1)
        errors = rng.random((2, 3)) * rng.choice([0.003, 0.03, 0.3])
        cost, effect = (_Means(n, e) for n, e in zip(numbers, errors, strict=True))
        (c1, dc1), (e1, de1) = cost.compute_difference(1, 0), effect.compute_difference(1, 0)
        (c2, dc2), (e2, de2) = cost.compute_difference(2, 1), effect.compute_difference(2, 1)
        corners = [
            (c2 + i * dc2) * (e1 + j * de1) - (c1 + k * dc1) * (e2 + m * de2)
            for i, j, k, m in product((-1, 1), repeat=4)
        ]
        found = _is_icer_rising(cost, effect, 0, 1, 2)
        assert not found or min(corners) > 0
        surely = c2 * e1 - c1 * e2 - (abs(c2) * de1 + abs(c1) * de2)
        surely -= (abs(e1) + de1) * dc2 + (abs(e2) + de2) * dc1
        assert found == (surely > 0)
        bent += found
    assert 100 < bent < 300
    # 2 errors of 1/2 move a product of 1 by 1/2 + 3/4: c₂ must be more than 1 + 5/4.
    effect = _Means(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 0.5]))
    for c2, found in ((2.0, False), (2.25, False), (2.2501, True)):
        cost = _Means(np.array([0.0, 1.0, 1 + c2]), np.array([0.5, 0.0, 0.0]))
        assert _is_icer_rising(cost, effect, 0, 1, 2) == found
    assert not _is_icer_rising(exact_means([1, 1, 1]), exact_means([1, 1, 1]), 0, 1, 2)


def test_what_bends_by_rounding_alone_does_not_bend() -> None:
    """1/3 and 2/3 of the way: the exact products of floats differ by less than they round."""
    third = _Means(np.array([0.0, 1 / 3, 1.0]), np.zeros(3))
    assert not _is_icer_rising(third, third, 0, 1, 2)
    more = _Means(np.array([0.0, 1 / 3, 1 + 1e-9]), np.zeros(3))
    assert _is_icer_rising(more, third, 0, 1, 2)
    assert not _is_icer_rising(third, more, 0, 1, 2)
    for scale, unit in product((1e-8, 1.0, 1e8), repeat=2):
        for units, bends in ((2, False), (5, False), (60, True)):
            cost = _Means(scale * np.array([0.0, 1.0, 2 + 2 * units * UNIT]), np.zeros(3))
            line = _Means(unit * np.array([0.0, 1.0, 2.0]), np.zeros(3))
            assert _is_icer_rising(cost, line, 0, 1, 2) == bends


# ---- results -------------------------------------------------------------------------------------


def test_tables_have_the_curves_and_go_to_twice_the_largest_icer() -> None:
    analysis = analysis_of([[0, 1, 2], [0, 2, 2]], [[0, 3, 9], [0, 3, 9]])
    rows = analysis.icers()
    assert rows.index.tolist() == [0, 1, 2]
    turned = analysis_of([[2, 0]], [[9, 0]]).icers()
    assert (turned["strategy"].tolist(), turned.index.tolist()) == (["some", "none"], [0, 1])
    refused(lambda: analysis.icers("all"), "=unknown strategy 'all'", "=reference",
            "choose one of none, some, more")  # fmt: skip
    assert rows["ICER"].tolist() == [pytest.approx(np.nan, nan_ok=True), 2, 12]
    assert analysis.grid().tolist() == pytest.approx([24 * k / 50 for k in range(51)])
    assert analysis.grid(11).tolist() == pytest.approx([24 * k / 10 for k in range(11)])
    frame = analysis.frame([1, 4])
    assert frame.columns.tolist() == [
        "willingness to pay", "none", "some", "more", "best on average", "EVPI", "EVPI s.e.",
        "claim",
    ]  # fmt: skip
    assert frame["willingness to pay"].tolist() == [1, 4]
    assert frame[["none", "some", "more"]].to_numpy().tolist() == [[1, 0, 0], [0, 1, 0]]
    assert frame["best on average"].tolist() == ["none", "some"]
    information = analysis.evpi([1, 4])
    assert frame["EVPI"].tolist() == [each.value for each in information]
    assert frame["EVPI s.e."].tolist() == [each.standard_error for each in information]
    assert len(analysis.frame()) == 51
    assert len(analysis.frame(3)) == 1
    alone = analysis_of([[1.0]], [[2.0]])
    assert alone.grid(3).tolist() == [0, 0.5, 1]
    assert np.isnan(alone.frame(1)["EVPI s.e."]).all()
    dear = analysis_of([[0, 1.0]], [[0, -2.0]])  # the second dominates
    assert dear.grid(3).tolist() == [0, 0.5, 1]


def test_the_report_has_the_numbers_of_the_analysis() -> None:
    analysis = analysis_of([[0, 1, 2], [0, 2, 2]], [[0, 3, 9], [0, 3, 9]])
    told = json.loads(analysis.report().json())
    grid = analysis.grid(11)
    assert told["willingness_to_pay"] == pytest.approx(grid.tolist())
    shares = analysis.acceptability(grid).T
    assert np.array([*told["acceptability"].values()]) == pytest.approx(shares)
    assert told["evpi"] == pytest.approx([each.value for each in analysis.evpi(grid)])
    assert (told["draws"], told["seed"]) == (2, 7)
    assert told["drawn"] == {"p.one": "uniform", "p.two": "uniform"}
    assert told["strategies"] == ["none", "some", "more"]
    assert [row["strategy"] for row in told["icers"]] == ["none", "some", "more"]
    assert (told["effect"], told["cost"], told["claim"]) == ("qaly", "cost", "estimated")
    assert "error_bounds" not in told
    assert repr(analysis) == "CostEffectiveness(none, some, more; draws 2)"
    assert not analysis.base_case
    facts = analysis.report().facts
    assert (facts["draws"].text, facts["seed"].text, facts["assumed"].text) == (2, 7, None)
    titles = [table.title for table in analysis.report().shown_tables()]
    assert titles == [
        "strategies, the cheapest first", "limits of 95 % of the draws",
        "shares of draws in which each is the best",
    ]  # fmt: skip
    sizes = Uncertainty(parts=DRAWN.parts, fixed={}, assumed=("p.two",))
    said = "1 of 2 distributions are not stated, and rest on 100 observations each"
    assumed = analysis_of([[0, 1]], [[0, 3]], chosen=sizes)
    assert repr(assumed) == f"CostEffectiveness(none, some; draws 1; {said})"
    fact = assumed.report().facts["assumed"]
    assert (fact.value, fact.text) == (("p.two",), said)


def test_a_base_case_is_bounded_by_its_greatest_errors() -> None:
    off = {"effect_error": np.array([[1e-9, 2e-9]]), "cost_error": np.array([[4e-9, 3e-9]])}
    base = analysis_of([[0, 1]], [[0, 3]], chosen=Uncertainty(parts=(), fixed={}), **off)
    assert base.base_case
    assert base.claim is Claim.BOUNDED
    assert repr(base) == "CostEffectiveness(none, some; the base case)"
    report = base.report()
    told = json.loads(report.json())
    assert told["error_bounds"] == {"qaly": 2e-9, "cost": 4e-9}
    assert (told["claim"], told["draws"], told["seed"]) == ("bounded", 1, 7)
    assert (report.facts["draws"].text, report.facts["seed"].text) == ("none: the base case", None)
    assert [table.title for table in report.shown_tables()] == [
        "strategies, the cheapest first", "shares of draws in which each is the best",
    ]  # fmt: skip


def test_a_price_is_one_finite_number_and_prices_are_a_list() -> None:
    analysis = random_analysis(0)
    assert (parse_price(3), parse_price("2.5")) == (3, 2.5)
    prices: list[Any] = [[[1, 2]], [], "x", np.nan, np.inf, [1, np.inf], None]
    for wrong in prices:
        with pytest.raises(ModelError, match="not a finite number"):
            analysis.acceptability(wrong)
    with pytest.raises(ModelError, match="several numbers"):
        parse_price([1, 2])
    with pytest.raises(ModelError, match="several numbers"):
        parse_price([1])
    assert len(analysis.evpi([1])) == 1


# ---- models --------------------------------------------------------------------------------------


def build(at: Any) -> MDP:
    """One step: a treatment gains `gain` for a price, or twice that for 20; nothing is free."""
    parts = {"cost": [0, at["price"], 20, 0], "qaly": [0, at["gain"], 2 * at["gain"], 0]}
    rows = [(0, action, [(1, 1, 0)]) for action in range(3)]
    return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], components=parts)


MODEL = Family(parameters={"gain": 1, "price": 5}, build=build)
POLICIES = {"wait": [0, 0], "treat": [1, 0], "both": [2, 0]}


@pytest.mark.parametrize("count", [3, 130])
def test_costs_and_effects_are_those_of_each_draw(count: int) -> None:
    rng = np.random.default_rng(count)
    frame = pd.DataFrame({"gain": rng.random(count), "price": rng.random(count)})
    analysis = cost_effectiveness(MODEL, POLICIES, uncertain=frame, rng=3)
    gain, paid, none = frame["gain"], frame["price"], np.zeros(count)
    assert analysis.effect == pytest.approx(np.column_stack([none, gain, 2 * gain]))
    assert analysis.cost == pytest.approx(np.column_stack([none, paid, none + 20]))
    assert analysis.draws.tolist() == frame.to_numpy().tolist()
    assert analysis.seed == 3
    assert analysis.strategies == ("wait", "treat", "both")
    turned = cost_effectiveness(MODEL, POLICIES, uncertain=frame, effect="cost", cost="qaly")
    assert np.array_equal(turned.effect, analysis.cost)
    assert np.array_equal(turned.cost, analysis.effect)
    assert turned.components == ("cost", "qaly")
    assert np.array_equal(turned.cost_error, analysis.effect_error)
    exact = np.array([[0, Fraction(g), 2 * Fraction(g)] for g in gain])
    apart = np.abs(exact - np.array([[Fraction(x) for x in row] for row in analysis.effect]))
    assert (apart <= np.vectorize(Fraction)(analysis.effect_error)).all()
    few = cost_effectiveness(MODEL, POLICIES, 2, uncertain=frame)
    assert np.array_equal(few.effect, analysis.effect[:2])


def test_nothing_is_drawn_of_the_base_case() -> None:
    base = cost_effectiveness(MODEL, POLICIES)
    assert base.base_case
    assert base.seed == 0
    assert {**base.uncertainty.fixed} == dict.fromkeys(("gain", "price"), "held in the base case")
    assert (base.draws.shape, base.effect.tolist(), base.cost.tolist()) == (
        (1, 0), [[0, 1, 2]], [[0, 5, 20]]
    )  # fmt: skip
    for n, policy in enumerate(POLICIES.values()):
        parts = evaluate(MODEL.at({}), policy).components
        assert (base.effect[0, n], base.cost[0, n]) == (parts["qaly"], parts["cost"])
    drawn = cost_effectiveness(MODEL, {"treat": [1, 0]}, 4, uncertain={"gain": {"sd": 0.1}})
    assert len(drawn.draws) == 4
    assert not drawn.base_case
    with pytest.raises(ModelError, match="the number of draws is missing"):
        cost_effectiveness(MODEL, POLICIES, uncertain={"gain": {"sd": 0.1}})


def test_strategies_have_names_and_components_are_those_of_the_model() -> None:
    lists: list[tuple[Any, str]] = [({}, "no strategy"), ([[0, 0]], "strategies without names")]
    for wrong, said in lists:
        fix = "=give {name: policy}, at least one"
        refused(partial(cost_effectiveness, MODEL, wrong), f"={said}", "=strategies", fix)
    asked: list[dict[str, Any]] = [{"effect": "life"}, {"cost": "life"}]
    for names in asked:
        call = partial(cost_effectiveness, MODEL, POLICIES, **names)
        refused(call, "=unknown component 'life'", f"={next(iter(names))}", "choose one of")


def test_a_rate_in_place_of_a_discount_is_warned_of() -> None:
    today = MODEL.at({})
    with pytest.warns(UserWarning, match=r"is 0\.03, .* a rate is meant, give 100/103,"):
        cost_effectiveness(today.with_(discount="3/100"), POLICIES)
    with pytest.warns(UserWarning, match=r"the discount of cost is 0\.03, ") as warned:
        cost_effectiveness(today, POLICIES, discount={"cost": 0.03})
    assert [each.filename for each in warned] == [__file__]
    for factor in (0, "1/2", 1):  # a warning would be an error here
        cost_effectiveness(today, POLICIES, discount={"qaly": factor})
