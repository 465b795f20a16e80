"""Cost-effectiveness against loops and closed forms, and pictures of one's own parameters."""

import itertools
import json
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pandas
import pytest
from cli_runner import run, strict
from matplotlib.figure import Figure
from picture_texts import legend_of, texts_of

from exact_mdp import (
    MDP,
    CostEffectiveness,
    Family,
    ModelError,
    Parameter,
    cost_effectiveness,
    evaluate,
    gradient,
    one_way,
    psa,
    sobol,
    study,
    thresholds,
    tornado,
    tradeoff,
    two_way,
)

PAGE = Path(__file__).resolve().parents[3] / "docs" / "health_economics.md"


def build(at):
    """One step: a treatment gains `gain` for 5, or twice that for 20; nothing is free."""
    parts = {"qaly": [0, at["gain"], 2 * at["gain"], 0], "cost": [0, at["price"], 20, 0]}
    rows = [(0, action, [(1, 1, 0)]) for action in range(3)]
    return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], components=parts)


MODEL = Family(parameters={"gain": 1, "price": 5}, build=build)
POLICIES = {"wait": [0, 0], "treat": [1, 0], "both": [2, 0]}
BETS = Family(parameters={"r": 1}, build=lambda at: MDP.from_arrays([[[1]]] * 2, [[at["r"], 2]], 0))
SAID = {"gain": {"distribution": "uniform", "low": 0, "high": 2}}


@pytest.fixture(scope="module")
def analysis():
    return cost_effectiveness(MODEL, POLICIES, 2000, uncertain=SAID, rng=1)


def test_costs_and_effects_are_those_of_each_draw(analysis) -> None:
    for d in (0, 1999):
        mdp = MODEL.at({"gain": float(analysis.draws[d, 0])})
        for n, policy in enumerate(POLICIES.values()):
            parts = evaluate(mdp, policy).components
            assert analysis.effect[d, n] == pytest.approx(parts["qaly"])
            assert analysis.cost[d, n] == pytest.approx(parts["cost"])
    net = analysis.net_benefit(10)
    assert net == pytest.approx(10 * analysis.effect - analysis.cost)


def test_curve_frontier_and_evpi_are_the_closed_form(analysis) -> None:
    """At λ: waiting is worth 0, treating λ g - 5, both 2 λ g - 20, with g uniform on (0, 2)."""
    for wtp in (4.0, 10.0, 20.0):
        one, two = min(5 / wtp, 2), min(15 / wtp, 2)  # where treating, then both, become best
        exact = np.array([one, two - one, 2 - two]) / 2
        share = analysis.acceptability(wtp)[0]
        assert share == pytest.approx(exact, abs=4 / len(analysis.draws) ** 0.5)
        means = [0, wtp - 5, 2 * wtp - 20]
        best = int(np.argmax(means))
        assert analysis.frontier(wtp) == [([*POLICIES][best], share[best])]
        g = np.linspace(0, 2, 200_001)
        most = np.maximum(0, np.maximum(wtp * g - 5, 2 * wtp * g - 20)).mean()
        evpi = analysis.evpi(wtp)
        assert abs(evpi.value - (most - means[best])) < 4 * evpi.standard_error
        known = analysis.evppi(wtp)["gain"]  # all that is uncertain
        assert known.regression.value == pytest.approx(evpi.value, rel=0.1)
        assert known.regression.standard_error > 0
    assert analysis.frame([4, 10])["best on average"].tolist() == ["wait", "treat"]


def test_draws_whose_model_lacks_a_component_are_refused() -> None:
    """The first draw has those of today. Their order does not matter."""

    def turned(names):
        def build(at):
            parts = names if at["gain"] > 1 else ("qaly", "cost")
            given = dict(zip(parts, ([1], [2]), strict=True))
            return MDP.from_outcomes([(0, 0, [(1, 0, 0)])], "1/2", components=given)

        return Family(parameters={"gain": 1}, build=build)

    gains = pandas.DataFrame({"gain": [0.5, 1.5]})
    with pytest.raises(ModelError, match="components are qaly, price") as caught:
        cost_effectiveness(turned(("qaly", "price")), {"stay": [0]}, uncertain=gains)
    assert caught.value.where == "draw 1"
    other = cost_effectiveness(turned(("cost", "qaly")), {"stay": [0]}, uncertain=gains)
    assert [other.effect.tolist(), other.cost.tolist()] == [[[2], [4]], [[4], [2]]]


def test_strategies_that_are_dominated_have_no_icer() -> None:
    policies = POLICIES | {"again": [1, 0]}
    at = {"price": {"distribution": "uniform", "low": 5, "high": 5.0001}}
    table = cost_effectiveness(MODEL, policies, 5, uncertain=at).icers().set_index("strategy")
    assert table.loc["treat", "ICER"] == pytest.approx(5, rel=1e-4)
    assert table.loc["both", "ICER"] == pytest.approx(15, rel=1e-4)
    assert table.loc["again", "status"] == "equal to treat"
    dear = cost_effectiveness(MODEL, POLICIES, uncertain=pandas.DataFrame([{"price": 12}])).icers()
    assert dear.set_index("strategy").loc["treat", "status"] == "extendedly dominated"


def test_rates_of_a_front_are_icers(analysis) -> None:
    front = tradeoff(MODEL.at({}), ["qaly", "saved=-1*cost"])
    mean = cost_effectiveness(MODEL, POLICIES, 1, uncertain={"gain": {"sd": 1e-9}}).icers()
    assert [float(edge.rate) for edge in front.edges] == pytest.approx(mean["ICER"].tolist()[1:])


def test_the_guide_has_the_numbers_of_the_published_model() -> None:
    """Today's costs and effects of the four strategies, worked out by powers of the matrices."""
    code = re.findall(r"^```python\n(.*?)^```$", PAGE.read_text("utf-8"), re.M | re.S)[0]
    names: dict = {}
    exec(code.partition("analysis = ")[0], names)
    for name in ("u.A", "c.B"):  # costs and utilities are added up exactly
        assert thresholds(names["model"], name, {"u.A": (0.76, 1), "c.B": (12000, 14000)})
    mdp = names["model"].at({})
    for policy in names["strategies"].values():
        action = mdp.action(policy.removeprefix("always:"))
        rows = mdp.transition.toarray()[action::4] if mdp.n_pairs == 16 else None
        parts = evaluate(mdp, policy).components
        state, total = np.array([1.0, 0, 0, 0]), np.zeros(len(mdp.component_names))
        for _ in range(6000):
            total += state @ mdp.components[action::4]
            state = state @ rows / 1.03
        assert list(parts.values()) == pytest.approx(total.tolist(), rel=1e-9)


def test_one_row_of_todays_values_is_the_base_case() -> None:
    today = pandas.DataFrame([{"gain": "1", "price": "10/2"}])
    base = cost_effectiveness(MODEL, POLICIES, uncertain=today)
    assert [base.effect.tolist(), base.cost.tolist()] == [[[0, 1, 2]], [[0, 5, 20]]]
    assert base.icers()["ICER"].tolist()[1:] == [5, 15]
    assert base.acceptability([4, 10, 20]).tolist() == np.eye(3).tolist()
    assert base.frame([10])["EVPI s.e."].isna().all()
    assert str(base.evpi(10)) == "0 (estimated, of one draw)"


def test_a_reward_of_0_beside_components_is_not_shown_in_silence(tmp_path: Path) -> None:
    said = r"the reward is 0 everywhere.* components qaly, cost do not count.*earning\('qaly'\)"
    earning = MODEL.with_question(lambda model: model.earning("qaly"))
    nothing = MODEL.with_question(lambda model: MDP.from_arrays([[[1]]], [0]))
    for ask in (
        tornado,
        gradient,
        lambda model: sobol(model, n=2),
        lambda model: psa(model, 2, uncertain=SAID),
        lambda model: one_way(model, "gain"),
        lambda model: two_way(model, "gain", "price", points=2),
        lambda model: thresholds(model, "gain"),
        lambda model: study(model, {"gain": [1, 2]}),
    ):
        with pytest.warns(UserWarning, match=said):
            ask(MODEL)
        ask(earning)
        ask(nothing)
    # A reward that a parameter brings about is no silence, and neither is another cost.
    free = Family(parameters={"r": 0}, build=lambda at: _with_cost(at["r"]))
    assert gradient(free)["r"].value.value == 1
    tornado(free, ranges={"r": (0, 1)})
    _with_cost(0).save(tmp_path / "free.npz")
    assert "components cost do" in run("gradient", tmp_path / "free.npz").err
    assert not run("gradient", tmp_path / "free.npz", "--reward", "cost").err
    cost_effectiveness(MODEL, POLICIES, 2, uncertain=SAID)


def _with_cost(reward):
    rows = [(0, 0, [(1, 1, reward)]), (1, 0, [(1, 1, 0)])]
    return MDP.from_outcomes(rows, components={"cost": [5, 0]})


def test_units_are_those_that_were_said() -> None:
    price = Parameter(name="price", value=5, low=0, unit="$")
    family = Family(parameters=(price, Parameter(name="gain", value=1)), build=build)
    model = family.with_question(lambda mdp: mdp.earning("cost"))
    table = tornado(model).frame().set_index("parameter")
    assert table["unit"].to_dict() == {"price": "$", "gain": "number"}
    axes = [one_way(model, name, points=2).plot().get_xlabel() for name in ("price", "gain")]
    assert axes == ["price ($)", "gain"]


def test_a_tornado_shows_the_policy_that_was_given() -> None:
    for policy, said in (("always:0", "held fixed"), ("optimal", "re-optimised")):
        bars = tornado(BETS, policy=policy)
        ax = bars.plot()
        assert said in ax.get_xlabel()
        assert ax.lines[0].get_xdata()[0] == bars.today["fixed"].value


def test_a_tornado_shows_the_incremental_net_benefit_of_two_strategies(tmp_path: Path) -> None:
    """At both ends of each range it is what `evaluate` finds, also on the command line."""
    spans = {"gain": (0, 2), "price": (1, 9)}

    def net(at):
        earned = [0, 4 * at["gain"] - at["price"], 8 * at["gain"] - 20]
        return MDP.from_arrays([[[0, 1], [0, 1]]] * 3, [earned, [0] * 3], 0)

    model = Family(parameters={"gain": 1, "price": 5}, build=net)
    bars = tornado(model, policy=[1, 0], against=[2, 0], ranges=spans)
    for row in bars.frame().to_dict("records"):
        for end in ("low", "high"):
            mdp = model.at({row["parameter"]: spans[row["parameter"]][end == "high"]})
            one, other = (evaluate(mdp, policy).start_value for policy in ([1, 0], [2, 0]))
            assert row[f"difference_{end}"] == pytest.approx(one - other)
    assert bars.today["difference"].value == (4 - 5) - (8 - 20)
    path = tmp_path / "bets.json"
    net({"gain": 1, "price": 5}).save(path)
    both = ("--policy", "always:1", "--against", "always:2", "--parameter", "reward.-1")
    found = strict(run("tornado", str(path), *both, "--json").out)
    assert found["difference"] == 11
    np.save(tmp_path / "q.npy", [[0.0, 2.0, 1.0], [0.0, 0.0, 0.0]])
    both = ("--policy", str(tmp_path / "q.npy"), "--kind", "q", *both[2:])
    assert strict(run("tornado", str(path), *both, "--json").out)["difference"] == 11
    assert [found["bars"][0][f"difference_{end}"] for end in ("low", "high")] == [10.8, 11.2]


@pytest.mark.filterwarnings("ignore:the reward is 0 everywhere")
def test_a_map_of_two_parameters_says_what_its_policies_do() -> None:
    for wide in ("1/1000", 1):
        over = two_way(MODEL, "gain", "price", relative=wide, points=3)
        every = [over.list_actions(number) for number in range(int(over.policy.max()) + 1)]
        said = [f"policy {n}: state 0: {own['state 0']}" for n, own in enumerate(every)]
        assert legend_of(over.plot()) == [*said, "today"]


def test_policies_in_a_map_are_told_apart() -> None:
    """Eleven states turn at values of x of their own, one at a value of y."""

    def steps(at):
        rows = [(0, 0, [("1/13", k, 0) for k in range(1, 14)])]
        choices = [(at["x"], k) if k < 12 else (at["y"], 3) for k in range(1, 13)]
        for k, (gain, least) in enumerate(choices, 1):
            rows += [(k, 0, [(1, 13, least + Fraction(1, 2))]), (k, 1, [(1, 13, gain)])]
        return MDP.from_outcomes([*rows, (13, 0, [(1, 13, 0)])], 1)

    model = Family(parameters={"x": 1, "y": 1}, build=steps)
    ends = {"x": (0, 12), "y": (0, 12)}
    over = two_way(model, "x", "y", ranges=ends, points=13)
    ax = over.plot()
    *entries, today = [" ".join(text.split()) for text in legend_of(ax)]
    said = [entry.partition(": ")[2] for entry in entries]
    assert (today, len({*said})) == ("today", len(said))
    assert ax.get_legend().get_title().get_text() == f"how the policies differ ({len(said)} of 24)"
    every = [over.list_actions(number) for number in range(len(said))]
    for own, entry in zip(every, said, strict=True):
        told = dict(part.rsplit(": ", 1) for part in entry.split("; "))
        assert told.items() <= own.items()
        assert sum(told.items() <= other.items() for other in every) == 1
    ax.figure.canvas.draw()
    assert ax.get_legend().get_window_extent().y0 >= 0


def test_a_title_says_how_many_parameters_are_left_out() -> None:
    model = Family(parameters={f"r{k}": k for k in range(1, 21)}, build=_sum)
    with_most = {"tornado": tornado(model), "gradient": gradient(model)}
    with_most["sobol"] = sobol(model, n=64, rng=0)
    for result in with_most.values():
        for most in (7, 20):
            title = result.plot(Figure().subplots(), most=most).get_title(loc="left")
            assert ("7 of 20 parameters" in title) == (most == 7)
    assert "15 of 20 parameters" in tornado(model).plot().get_title(loc="left")


def _sum(at):
    return MDP.from_outcomes([(0, 0, [(1, 1, sum(at.values()))]), (1, 0, [(1, 1, 0)])])


def test_a_tornado_has_no_exponents_beside_its_bars() -> None:
    dear = Family(parameters={"r": 9007}, build=BETS.build)
    assert texts_of(tornado(dear).plot().get_yticklabels()) == ["r [7,206, 10,808]"]


@pytest.mark.filterwarnings("ignore:the reward is 0 everywhere")
def test_a_picture_of_draws_shows_every_candidate() -> None:
    draws = psa(BETS, 50, uncertain={"r": {"distribution": "normal", "sd": 1}})
    assert len(draws.plot().lines) == len(draws.candidates) > 1
    same = psa(MODEL, 5, uncertain=SAID)  # all choices earn nothing
    (line,) = same.plot().lines
    assert [*line.get_xdata(), *line.get_ydata(), line.get_marker()] == [0, 1, "o"]


def test_an_evppi_less_certain_than_evpi_says_how_many_draws_to_take() -> None:
    """The error falls with the root of n, and a regression uses 20,000 draws at most."""
    noisy, needs = SAID | {"price": {"distribution": "uniform", "low": 4, "high": 6}}, []
    for seed, wtp in itertools.product(range(5), (2.4, 2.5, 10)):
        few = cost_effectiveness(MODEL, POLICIES, 100, uncertain=noisy, rng=seed)
        evpi = few.evpi(wtp).value
        for each in few.evppi(wtp).values():
            error, doubts = each.regression.standard_error, " ".join(each.doubts)
            assert ("anything from 0 to EVPI" in doubts) == (error > evpi > 0)
            if error > evpi > 0:
                need = 100 * (2 * error / evpi) ** 2
                take = int(
                    re.findall(r"take (?:about )?n=([\d,]+)", repr(each))[0].replace(",", "")
                )
                assert take == pytest.approx(min(need, 20_000), rel=0.5)
                needs.append(need)
    assert min(needs) < 20_000 < max(needs)


@pytest.mark.parametrize("wtp", [4, "12.5", 1_000, -3])
def test_a_willingness_to_pay_is_marked(analysis, wtp) -> None:
    """Curves reach it; they are the shares of draws, in units of cost per effect."""
    ax, number = analysis.plot(Figure().subplots(), wtp=wtp), float(wtp)
    assert ax.get_xlabel() == "willingness to pay (cost per qaly)"
    assert legend_of(ax)[-1] == f"willingness to pay {number:,.10g}"
    *curves, mark = ax.lines
    assert [*mark.get_xdata()] == [number] * 2
    for n, curve in enumerate(curves[1:]):
        at, shares = curve.get_data()
        assert at.min() <= number <= at.max()
        assert shares == pytest.approx(analysis.acceptability(at)[:, n])
    low, high = ax.get_xlim()
    assert low < number < high


@pytest.mark.parametrize("wtp", ["much", [4, 10], float("nan"), {"a": 1}])
def test_what_is_no_willingness_to_pay_is_not_drawn(analysis, wtp) -> None:
    with pytest.raises(ModelError) as caught:
        analysis.plot(wtp=wtp)
    assert caught.value.where == "willingness to pay"


def test_several_willingnesses_to_pay_are_taken_one_by_one(analysis) -> None:
    two = cost_effectiveness(MODEL, {n: POLICIES[n] for n in ("wait", "treat")}, 50, uncertain=SAID)
    for each in (analysis, two):
        for wtp in ([4.0, 10.0], [4.0, 10.0, 20.0]):
            assert each.evpi(wtp) == [each.evpi(one) for one in wtp]
            alone = [each.net_benefit(one) for one in wtp]
            assert np.array_equal(each.net_benefit(wtp), alone)
        for wrong in ("ten", [4.0, None], float("inf"), [[4.0]]):
            with pytest.raises(ModelError, match=r"willingness to pay"):
                each.evpi(wrong)
        alone = [each.evppi(one) for one in (4.0, 10.0)]
        assert repr(each.evppi([4.0, 10.0])) == repr(alone)


def test_curves_of_many_strategies_look_different() -> None:
    """By colour and dashes, as the legend shows them."""
    many = {key: [0, 0] for key in map(str, range(11))}
    analysis = cost_effectiveness(MODEL, many, 4, uncertain=SAID, rng=0)
    lines = [line for line in analysis.plot().get_lines() if line.get_label() != "frontier"]
    assert len({(line.get_color(), line.get_linestyle()) for line in lines}) == len(lines) == 11


def drawn_year(at):
    """Every year is worth `u`, whatever is done; the two actions cost differently."""
    rows = [(0, 0, [(1, 0, 0)]), (0, 1, [("3/4", 0, 0), ("1/4", 1, 0)]), (1, 0, [(1, 1, 0)])]
    parts = {"qaly": [at["u"]] * 3, "cost": [10, at["dear"], at["later"]]}
    return MDP.from_outcomes(rows, "97/100", components=parts, actions=["cheap", "dear"])


YEARS = Family(parameters={"u": "7/10", "dear": 15, "later": 30}, build=drawn_year)
TWO = {"cheap": "always:cheap", "dear": "always:dear"}


def test_an_effect_that_differs_by_rounding_is_equal() -> None:
    """Both are worth 70/3; floats make 7e-15 more of one of them, an ICER of 1e17."""
    base = cost_effectiveness(YEARS, TWO)
    assert len({*base.effect[0].tolist()}) == 2  # else this test says nothing
    assert base.icers()["status"].tolist() == ["efficient", "dominated"]
    assert base.icers()["ICER"].isna().all()
    assert base.grid(3).tolist() == [0, 0.5, 1]
    assert base.frontier([0, 1e5]) == [("cheap", 1), ("cheap", 1)]
    assert base.evpi(1e5).value == 0


def test_two_names_for_the_same_are_equal_and_share_a_draw() -> None:
    same = pandas.DataFrame({"u": [0.7, 0.3], "dear": [10.0] * 2, "later": [10.0] * 2})
    two = cost_effectiveness(YEARS, TWO, uncertain=same)
    assert sorted(two.icers()["status"]) == ["efficient", "equal to cheap"]
    assert two.acceptability([0, 100, 1e5]).tolist() == [[0.5, 0.5]] * 3
    assert two.frontier([100]) == [("cheap", 0.5)]
    assert two.evpi(1e5).value == 0
    more = cost_effectiveness(YEARS, TWO | {"again": "always:dear"}).icers()
    assert sorted(more["status"]) == ["dominated", "efficient", "equal to dear"]


def test_equal_costs_and_more_effect_dominate() -> None:
    """The costs differ by rounding alone."""

    def built(at):
        parts = {"qaly": [1, 1, "9/10"], "cost": [at["c"]] * 3}
        rows = [(0, 0, [(1, 0, 0)]), (0, 1, [("3/4", 0, 0), ("1/4", 1, 0)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, "97/100", components=parts, actions=["cheap", "dear"])

    table = cost_effectiveness(Family(parameters={"c": "7/10"}, build=built), TWO).icers()
    assert table.set_index("strategy")["status"].to_dict() == {
        "cheap": "efficient",
        "dear": "dominated",
    }


def test_only_the_components_that_count_are_needed() -> None:
    """What is left of the reward is 0 today, and another component then."""
    for today, drawn in ((2, 1.5), ("3/2", 2.0)):
        model = Family(
            parameters={"u": today},
            build=lambda at: MDP.from_outcomes(
                [(0, 0, [(1, 0, 3 * at["u"] - 2)])],
                "1/2",
                components={"qaly": [at["u"]], "cost": [2]} | rest_of(at["u"]),
            ),
        )
        found = cost_effectiveness(model, {"stay": [0]}, uncertain=pandas.DataFrame({"u": [drawn]}))
        assert [found.effect.tolist(), found.cost.tolist()] == [[[2 * drawn]], [[4]]]


def rest_of(u):
    left = 3 * u - 2 - u - 2
    return {"rest": [left]} if left else {}


def test_what_is_counted_for_ever_is_refused() -> None:
    """The reward of state 1 is 0, so that it is an end; its parts are not."""
    built = Family(
        parameters={"c": 1},
        build=lambda at: MDP.from_outcomes(
            [(0, 0, [(1, 1, 5 * at["c"])]), (1, 0, [(1, 1, 0)])],
            components={"qaly": [3, 2], "cost": [5 * at["c"] - 3, -2]},
        ),
    )
    with pytest.raises(ModelError, match="a total is infinite"):
        cost_effectiveness(built, {"p": [0, 0]}, uncertain=pandas.DataFrame({"c": [1.0]}))


def test_without_draws_and_distributions_it_is_the_base_case() -> None:
    base = cost_effectiveness(MODEL, POLICIES)
    assert [base.effect.tolist(), base.cost.tolist()] == [[[0, 1, 2]], [[0, 5, 20]]]
    assert "base case" in repr(base)
    with pytest.raises(ModelError, match="no parameter of the draws"):
        base.evppi(10)
    # Its numbers are bounded; those of draws, and those from elsewhere, are estimated.
    claims = [base, CostEffectiveness.of({"a": 1}, {"a": 2})]
    assert [each.claim for each in claims] == ["bounded", "estimated"]
    errors = base.report().facts["error_bounds"]
    assert errors == {"qaly": np.max(base.effect_error), "cost": np.max(base.cost_error)}
    assert all(0 < error < 1e-12 for error in errors.values())
    certain = MODEL.at({})  # an MDP that has nothing to draw
    assert cost_effectiveness(certain, POLICIES).cost.tolist() == [[0, 5, 20]]


def test_the_report_says_what_was_drawn_and_assumed() -> None:
    model = MDP.from_arrays(
        [[["9/10", "1/10"], [0, 1]]],
        [1, 0],
        "1/2",
        components={"qaly": [[1], [0]], "cost": [[5], [0]]},
        layout="ass",
    )
    found = cost_effectiveness(model, {"stay": "always:0"}, 10, rng=3)
    words = "1 of 1 distributions are not stated, and rest on 100 observations each"
    facts = found.report().facts
    for said in (repr(found), found.report().lines()["assumed"], repr(psa(model, 5))):
        assert words in said
    assert (facts["draws"].value, facts["seed"].value, facts["cost"]) == (10, 3, "cost")
    told = json.loads(found.report().json())
    assert told["assumed"] == ["(state 0, 0)"]
    assert told["icers"][0]["strategy"] == "stay"
    assert len(told["acceptability"]["stay"]) == len(told["willingness_to_pay"])
    stated = {"(state 0, 0)": {"effective_sample_size": 9}}
    sure = cost_effectiveness(model, {"stay": "always:0"}, 5, uncertain=stated)
    assert "not stated" not in repr(sure)
