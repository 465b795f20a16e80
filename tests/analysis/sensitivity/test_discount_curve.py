"""The curve of a discount, whose last piece is optimal close to 1, and the curve as a command."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import pytest
from cases import BY_NAME
from cli_runner import run
from hypothesis import given, settings
from made_models import forest
from oracle import best_average, gain_and_bias
from strategies import Rows, models

from exact_mdp import Scenario, certify, curve, evaluate, solve

F = Fraction


def test_the_curve_covers_all_that_a_parameter_may_be() -> None:
    value_curve = curve(Scenario.load("tea").with_(tasks=[1], max_trial=2), "base.anxiety")
    assert (value_curve.range.low, value_curve.range.high) == (0, 1)
    assert value_curve.violations() == []
    assert value_curve.at(0) != value_curve.at(1)


def test_the_command(tmp_path: object) -> None:
    words = ("curve", "tea", "--set", "tasks=[1]", "--set", "max_trial=2")
    result = run(*words, "--parameter", "base.anxiety", "--json").result
    assert result["claim"] == "certified"
    pieces = result["pieces"]
    assert (pieces[0]["from"], pieces[-1]["to"]) == ("0", "1")
    assert all(a["to"] == b["from"] for a, b in pairwise(pieces))
    first, at = pieces[0], F(pieces[0]["to"]) / 2
    top = sum(F(c) * at**k for k, c in enumerate(first["numerator"]))
    below = sum(F(c) * at**k for k, c in enumerate(first["denominator"]))
    scenario = Scenario.load("tea").with_(tasks=[1], max_trial=2)
    assert top / below == curve(scenario, "base.anxiety").at(at)
    mdp = scenario.with_(parameters={"base.anxiety": at}).compile()
    assert evaluate(mdp, first["policy"]).mean == pytest.approx(float(top / below))
    far = run(*words, "--parameter", "discount", "--json").result["pieces"][-1]
    assert F(far["from"]) < 1
    last = scenario.compile().with_(discount="999999/1000000")
    assert evaluate(last, far["policy"]).mean == pytest.approx(solve(last).start.value)
    assert "pieces of the optimal value" in run(*words, "--parameter", "discount").out


@settings(max_examples=10, deadline=None)
@given(rows=models(discounts=(F(1, 2),)))
def test_the_last_piece_has_the_best_gain_and_of_these_the_best_bias(rows: Rows) -> None:
    """V = g / (1 - γ) + h + …: its first two terms (Puterman 1994, theorem 10.1.5)."""
    mdp = rows.model()
    optimal = curve(mdp, "discount").pieces[-1].optimal
    pairs = [next(p for p in mdp.pairs_of(s) if optimal[p]) for s in range(mdp.n_states)]
    actions = mdp.pair_action[pairs].tolist()
    chosen = [next(r for r in rows.pairs if r[:2] == (s, a)) for s, a in enumerate(actions)]
    gain, bias = gain_and_bias(chosen)
    assert (gain, bias) == best_average(rows.pairs)
    average = certify(mdp, criterion="average")
    assert tuple(average.value) == gain
    assert average.optimal_pairs[pairs].all()


def test_howards_taxicab_at_every_discount() -> None:
    """Howard (1960), chapter 4: the stand in every town, at discount 1 and at those near to it."""
    case = BY_NAME["howard-taxicab"]
    mdp = Rows(n_states=3, pairs=case.pairs, discount=case.discount).model()
    by_discount = curve(mdp, "discount")
    assert by_discount.violations() == []
    assert by_discount.pieces[-1].optimal[[mdp.pair(s, 1) for s in range(3)]].all()
    last = by_discount.pieces[-1].value
    gain = sum(c for c in last.numerator) / -sum(k * c for k, c in enumerate(last.denominator))
    assert gain == certify(mdp, criterion="average").value[0]  # the residue at 1


def test_the_forest_switches_where_two_of_its_policies_are_equal() -> None:
    # pymdptoolbox src/tests/test_PolicyIteration.py: values at 0.9 and 0.96, never cut
    value_curve = curve(forest("1/2"), "discount", (0, "99/100"))
    assert (value_curve.at("9/10"), value_curve.at("24/25")) == (F("26.244"), F("74.6496"))
    assert value_curve.violations() == []
    last, before = value_curve.pieces[-1], value_curve.pieces[-2]
    # Waiting in the middle is worth it from γ on where 9/10 (1 + 9/10 γ …) pays for the cut's 1:
    # 1 + γ V_0 = γ (V_0 / 10 + 9/10 V_2), with V_2 = 4 + γ (V_0 / 10 + 9/10 V_2).
    low, high = before.high
    for at, sign in ((low, 1), (high, -1)):
        mdp = forest("1/2").with_(discount=at)
        value = certify(mdp).value
        gain = 1 + at * value[0] - at * (value[0] / 10 + F(9, 10) * value[2])
        assert gain * sign >= 0
    assert last.optimal[[mdp.pair(s, 0) for s in range(3)]].all()
