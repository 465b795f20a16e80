"""The value as a function of a parameter, against closed forms and single certificates."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import flint
import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import (
    MDP,
    Certified,
    Family,
    ModelError,
    Parameter,
    Parametric,
    Scenario,
    certify,
    curve,
    explore,
    gradient,
    moving,
    parametric,
    thresholds,
)
from exact_mdp.analysis.sensitivity.curves import checker, gap_polynomials, signs
from exact_mdp.analysis.sensitivity.curves.curve import ValueFunction
from exact_mdp.analysis.sensitivity.curves.signs import nonnegative, positive
from exact_mdp.analysis.sensitivity.exact_chain import ExactChain
from exact_mdp.mdp.numbers import rational

F = Fraction
SMALL = Scenario.load("tea").with_(tasks=[1], max_trial=2)


def start_of(mdp: MDP, policy: object) -> Fraction:
    """The exact value of a policy at one point, by its linear equations."""
    chain = ExactChain(mdp, policy)
    values = chain.values(chain.reward)
    exact = (F(int(values[s].p), int(values[s].q)) * weight for s, weight in mdp.start)
    return sum(exact, F(0))


def agrees(found: ValueFunction, family: Parametric, at: Fraction, policy: object) -> None:
    mdp = family.at({found.parameter.name: at})
    certificate = certify(mdp)
    assert found.at(at) == certificate.start_value
    assert found.fixed_at(at) == start_of(mdp, policy)
    for piece in found.around(at):
        if piece.low[1] < at < piece.high[0]:
            assert (piece.optimal == certificate.optimal_pairs)[~mdp.terminal[mdp.pair_state]].all()


def test_puterman_in_closed_form() -> None:
    # Puterman (1994), section 3.1; QuantEcon.py, quantecon/markov/tests/test_ddp.py
    rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    found = curve(MDP.from_outcomes(rows, "1/2"), "discount", (0, "99/100"))
    low, high = found.pieces
    assert (low.value.numerator, low.value.denominator) == ((10, -11), (1, -1))
    assert (high.value.numerator, high.value.denominator) == (
        (5, F(-11, 2)),
        (1, F(-3, 2), F(1, 2)),
    )
    assert low.high == high.low
    assert low.high[0] <= F(10, 11) <= low.high[1]
    with pytest.raises(ModelError, match="outside the range"):
        found.at(1)


shares = st.integers(1, 6)


@settings(max_examples=25, deadline=None)
@given(
    weights=st.lists(st.tuples(shares, shares, shares), min_size=6, max_size=6),
    rewards=st.lists(st.integers(-5, 5), min_size=6, max_size=6),
    place=st.fractions(0, 1, max_denominator=50),
    name=st.sampled_from(["p", "discount", "gain"]),
    sense=st.sampled_from(["max", "min"]),
)
def test_random_models_with_cycles(
    weights: list[tuple[int, int, int]], rewards: list[int], place: Fraction, name: str, sense: str
) -> None:
    rows = [
        (s // 2, s % 2, [(F(w, sum(each)), t, rewards[s]) for t, w in enumerate(each)])
        for s, each in enumerate(weights)
    ]
    mdp = MDP.from_outcomes(rows, discount="9/10", start={0: F(1, 3), 2: F(2, 3)}, sense=sense)
    gains = {"gain": rewards[1]} if rewards[1] else {"gain": rewards[0]} if rewards[0] else {}
    family = moving(mdp, {"p": [(0, 1)]}, gains)
    if name not in [parameter.name for parameter in family.parameters]:
        return
    found = curve(family, name, policy="random")
    assert found.violations() == []
    span = found.range
    agrees(found, family, span.low + (span.high - span.low) * place, "random")
    for left, right in pairwise(found.pieces):
        assert left.high == right.low
        for end in left.high:
            agrees(found, family, end, "random")


@pytest.mark.parametrize(
    ("limit", "most", "name", "message"),
    [
        ("LARGEST", 1, "gain", "2 states with cycles among them(.|\n)*at most 1 state"),
        ("CYCLIC_DEGREE", 0, "p", "2 states on cycles(.|\n)*degree 1(.|\n)*up to degree 0;"),
    ],
)
def test_the_limit_that_was_hit_is_named(
    limit: str, most: int, name: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [(s, a, [("1/2", 0, 1), ("1/2", 1, a)]) for s in (0, 1) for a in (0, 1)]
    family = moving(MDP.from_outcomes(rows, "9/10"), {"p": [(0, 1)]}, {"gain": 1})
    assert curve(family, name).pieces
    monkeypatch.setattr(gap_polynomials, limit, most)
    with pytest.raises(ModelError, match=message):
        curve(family, name)


@pytest.mark.parametrize("name", ["base.anxiety", "reward.assist.prompt", "discount"])
def test_scenarios(name: str) -> None:
    family = parametric(SMALL)
    span = (F(1, 10), F(9, 10)) if name != "reward.assist.prompt" else (-6, 1)
    found = curve(SMALL, name, span, policy="always:prompt")
    crossed = [t for t in thresholds(SMALL, name, span).found if not t.touch]
    ends = {(t.low, t.high) for t in crossed}
    assert ends <= {piece.high for piece in found.pieces[:-1]}
    assert len(found.frame()) == len(found.pieces) > len(ends)
    for k in range(5):
        agrees(found, family, F(span[0]) + (F(span[1]) - span[0]) * F(k, 4), "always:prompt")


PUTERMAN = MDP.from_outcomes(
    [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])], "1/2"
)


def broken(found: ValueFunction, piece: int, **changes: object) -> list[str]:
    pieces = list(found.pieces)
    pieces[piece] = replace(pieces[piece], **changes)
    return replace(found, pieces=tuple(pieces)).violations()


def test_what_is_false_between_breakpoints_is_found() -> None:
    """Each claim is changed alone; samples at ends and in the middle would see few of these."""
    found = curve(PUTERMAN, "discount", (0, "99/100"), policy=[0, 0])
    assert found.violations() == []
    low, high = found.pieces
    wider = (low.high[0] + F(1, 10**9), low.high[1] + F(1, 10**9))
    # The left policy is not optimal a billionth further; the right one is not so far on the left.
    assert any("is better" in w for w in replace_ends(found, wider))
    assert any("next to" in w or "is better" in w for w in replace_ends(found, nearer(low.high)))
    assert "pair" in broken(found, 0, optimal=~low.optimal)[0]
    assert "another one" in broken(found, 0, value=high.value)[0]
    assert "held fixed" in broken(found, 1, fixed_values=low.values)[0]
    assert "not positive" in broken(found, 1, values=(high.values[0], -high.values[1]))[0]
    assert "no piece covers" in replace(found, pieces=found.pieces[:1]).violations()[0]
    elsewhere = replace(low.section, high=low.low[0])
    assert any("outside" in w for w in broken(found, 0, section=elsewhere))


def test_nothing_is_claimed_in_an_open_bracket() -> None:
    """Policies are proven between brackets: one that is wide, and not checked, proves nothing."""
    found = curve(PUTERMAN, "discount", (0, "99/100"))
    low, high = found.pieces
    whole = replace(low, high=(found.range.low, found.range.high))
    assert "no piece covers" in replace(found, pieces=(whole,)).violations()[0]
    late = replace(high, low=(found.range.low, found.range.high))
    assert "no piece covers" in replace(found, pieces=(late,)).violations()[0]
    wide = (F(1, 2), F(98, 100))
    apart = replace(high, low=wide, section=replace(high.section))
    forged = replace(found, pieces=(replace(low, high=wide), apart))
    assert any("next to" in fault for fault in forged.violations())


def nearer(bracket: tuple[Fraction, Fraction]) -> tuple[Fraction, Fraction]:
    return bracket[0] - F(1, 10**9), bracket[1] - F(1, 10**9)


def replace_ends(found: ValueFunction, bracket: tuple[Fraction, Fraction]) -> list[str]:
    low, high = found.pieces
    pieces = (replace(low, high=bracket), replace(high, low=bracket))
    return replace(found, pieces=pieces).violations()


@pytest.mark.parametrize(
    ("coefficients", "expected"),
    [
        ((1, -4, 4), (True, False)),  # (1 - 2 y)²: a double root, which Bernstein does not decide
        ((1, -4, F(4001, 1000)), (True, True)),
        ((1, -4, F(3999, 1000)), (False, False)),
        ((0, 1), (True, False)),
        ((0, 1, -1), (True, False)),
        ((0, -1, 1), (False, False)),
        ((0, 1, -4, 4), (True, False)),
        ((), (True, False)),
        ((-1,), (False, False)),
    ],
)
def test_signs_on_the_unit_interval(
    coefficients: tuple[Fraction | int, ...], expected: tuple[bool, bool]
) -> None:
    poly = flint.fmpq_poly([rational(c) for c in coefficients])
    assert (nonnegative(poly, F(0), F(1)), positive(poly, F(0), F(1))) == expected


@settings(max_examples=60, deadline=None)
@given(
    ends=st.lists(st.fractions(-1, 2, max_denominator=9), max_size=4),
    lead=st.sampled_from([-1, 1]),
    square=st.booleans(),
)
def test_signs_of_products_of_roots(ends: list[Fraction], lead: int, square: bool) -> None:
    poly = flint.fmpq_poly([lead])
    for end in ends:
        poly = poly * flint.fmpq_poly([rational(-end), 1])
    poly = poly * poly * lead if square else poly
    cuts = sorted({F(0), F(1), *(end for end in ends if 0 < end < 1)})
    signs = [poly(rational((a + b) / 2)) for a, b in pairwise(cuts)]
    assert nonnegative(poly, F(0), F(1)) == (min(signs) >= 0)
    assert positive(poly, F(0), F(1)) == (min(signs) > 0 and not any(0 <= end <= 1 for end in ends))


@settings(max_examples=25, deadline=None)
@given(
    weights=st.lists(st.tuples(shares, shares, shares), min_size=6, max_size=6),
    rewards=st.lists(st.integers(-5, 5), min_size=6, max_size=6),
    limit=st.fractions(0, 2, max_denominator=10),
    relative=st.booleans(),
    sense=st.sampled_from(["max", "min"]),
)
def test_where_a_policy_keeps_a_limit(
    weights: list[tuple[int, int, int]],
    rewards: list[int],
    limit: Fraction,
    relative: bool,
    sense: str,
) -> None:
    rows = [
        (s // 2, s % 2, [(F(w, sum(each)), t, rewards[s]) for t, w in enumerate(each)])
        for s, each in enumerate(weights)
    ]
    mdp = MDP.from_outcomes(rows, discount="1/2", sense=sense)
    found = curve(mdp, "discount", (0, "19/20"), policy=[0, 0, 0])
    kept = found.within(**{"max_relative_regret" if relative else "max_regret": limit})
    tests = [F(19 * k, 20 * 24) for k in range(25)]
    tests += [e for each in kept for e in (*each.low, *each.high)]
    for at in tests:
        best, mine = found.at(at), start_of(mdp.with_(discount=at), [0, 0, 0])
        inside = [each for each in kept if each.low[0] <= at <= each.high[1]]
        if all(
            not (each.low[0] < at < each.low[1] or each.high[0] < at < each.high[1])
            and not (each.low[0] != each.low[1] and at == each.low[0])
            and not (each.high[0] != each.high[1] and at == each.high[1])
            for each in inside
        ):
            assert (abs(best - mine) <= limit * (abs(best) if relative else 1)) == bool(inside)


def test_limits_that_say_nothing_are_refused() -> None:
    found = curve(PUTERMAN, "discount", (0, "99/100"))
    with pytest.raises(ModelError, match="no policy"):
        found.within(1)
    held = curve(PUTERMAN, "discount", (0, "99/100"), policy=[0, 0])
    with pytest.raises(ModelError, match="two limits"):
        held.within(1, 1)
    with pytest.raises(ModelError, match="0 or more"):
        held.within(-1)
    (only,) = held.within()  # optimal from 10/11 on: Puterman (1994), section 3.1
    assert only.low[0] <= F(10, 11) <= only.low[1]
    assert only.high == (F(99, 100),) * 2


def test_the_checkers_import_no_solver() -> None:
    own = "exact_mdp.analysis.sensitivity.curves"
    allowed = {f"{own}.signs"}
    for module in (checker, signs):
        source = Path(module.__file__).read_text("utf-8")
        assert "import exact_mdp" not in source
        lines = (line.split() for line in source.splitlines() if line.startswith("from exact_mdp"))
        assert all(home.startswith("exact_mdp.mdp.") or home in allowed for _, home, *_ in lines)


def test_the_command_says_where_a_policy_keeps_a_limit() -> None:
    words = ("curve", "tea", "--set", "tasks=[1]", "--set", "max_trial=2")
    asked = (*words, "--parameter", "base.anxiety", "--max-relative-regret", "1/100", "--json")
    result = run(*asked, "--policy", "always:prompt").result
    found = curve(SMALL, "base.anxiety", policy="always:prompt")
    kept = found.within(max_relative_regret="1/100")
    brackets = [(*each["from_bracket"], *each["to_bracket"]) for each in result["within"]]
    assert [tuple(map(F, each)) for each in brackets] == [(*e.low, *e.high) for e in kept]
    fixed = result["pieces"][0]["fixed"]
    assert tuple(map(F, fixed["numerator"])) == found.pieces[0].fixed.numerator
    assert "keeps the limit" in run(*asked[:-1]).out  # of the optimum, unless a policy is given
    refused = run(*asked, "--max-regret", "1")
    assert (refused.status, refused.out) == (2, "")
    assert "two limits" in refused.err


@pytest.mark.parametrize("sense", ["max", "min"])
def test_a_table_is_followed_where_nothing_is_earned_today(sense: str) -> None:
    """Its greedy action counts in states that are over, or whose actions are alike, at 0."""
    parameter = Parameter(name="t", value=F(0), low=F(-1), high=F(1))

    def build(at: Mapping[str, F]) -> MDP:
        rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, at["t"])]), (2, 0, [(1, 2, 0)])]
        rows += [(1, 0, [(1, 1, at["t"])]), (1, 1, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, "1/2", sense=sense)

    family = Family(parameters=(parameter,), build=build)
    table = np.array([[0.0, 2.0], [1.0, 3.0], [0.0, 0.0]]) * (1 if sense == "max" else -1)
    found = curve(family, "t", (-1, 1), policy=table)
    for t in (F(-1), F(-1, 2), F(0), F(1)):
        assert found.fixed_at(t) == t  # action 1 in state 0, and nothing after that
    [kept] = found.within(0)  # what it earns in state 0 has to be good, and in state 1 to be bad
    assert (float(kept.low[0]), float(kept.high[1])) == pytest.approx((0, 0))


def test_a_policy_that_is_silent_where_it_matters_elsewhere_is_refused() -> None:
    """A function is not asked about a state in which all is over today."""
    parameter = Parameter(name="t", value=F(0), low=F(-1), high=F(1))
    family = Family(
        parameters=(parameter,),
        build=lambda at: MDP.from_outcomes([(0, 0, [(1, 0, at["t"])]), (0, 1, [(1, 0, 0)])], "1/2"),
    )
    for policy in ([[1.0, 2.0]], [1], {0: 1}, [[0.0, 1.0]]):
        found = curve(family, "t", (-1, 1), policy=policy)
        assert (found.fixed_at(-1), found.fixed_at(1)) == (0, 0)
        assert found.within(0)[0].low[0] == -1
        assert found.within(0)[-1].high[1] == pytest.approx(0)
    with pytest.raises(ModelError, match="says nothing of a state"):
        curve(family, "t", (-1, 1), policy=lambda state: 1)


# ---- discount 1, where some policy never ends ----------------------------------------------------

WAIT = MDP.from_outcomes(
    [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 2, 5)]), (1, 0, [(1, 1, -1)]), (2, 0, [(1, 2, 0)])]
)


@pytest.mark.parametrize("engine", [thresholds, curve, explore])
def test_where_some_policy_never_ends_curves_are_refused(engine: Callable[..., object]) -> None:
    with pytest.raises(ModelError, match="some policy never ends") as refused:
        engine(WAIT, "reward.5")
    assert "discount below 1" in (refused.value.fix or "")
    assert engine(WAIT.with_(discount="9/10"), "reward.5")
    assert engine(WAIT.within(3), "reward.5")


def test_where_some_policy_never_ends_derivatives_are_refused() -> None:
    with pytest.raises(ModelError, match="some policy never ends"):
        gradient(WAIT)
    held = gradient(WAIT, policy=[1, 0, 0], names=["reward.5"])  # this one ends
    assert held["reward.5"].value == Certified(value=F(1))
    assert gradient(WAIT.with_(discount="9/10"))["reward.5"].value == Certified(value=F(1))


def test_a_policy_that_never_ends_at_one_value_alone_is_found() -> None:
    """An episode goes on with the chance (2x - 1)², or 1 - (2x - 1)², and pays 1 a step."""

    def family(stays: Callable[[Fraction], Fraction]) -> Parametric:
        def build(at: Mapping[str, Fraction]) -> MDP:
            p = stays(at["x"])
            row = [(chance, to, 1) for chance, to in ((p, 0), (1 - p, 1)) if chance]
            return MDP.from_outcomes([(0, 0, row), (1, 0, [(1, 1, 0)])])

        x = Parameter(name="x", value=F(1, 4), low=F(0), high=F(1))
        return Family(parameters=(x,), build=build, degrees={"x": 2})

    for stays, wrong, right in (
        (lambda x: (2 * x - 1) ** 2, (0, F(3, 4)), (F(1, 8), F(3, 4))),
        (lambda x: 1 - (2 * x - 1) ** 2, (F(1, 8), F(3, 4)), (F(1, 8), F(3, 8))),
    ):
        with pytest.raises(ModelError, match="some policy never ends"):
            curve(family(stays), "x", wrong)
        found = curve(family(stays), "x", right)
        assert found.at("1/4") == 1 / (1 - stays(F(1, 4)))
        assert found.violations() == []


def test_the_curve_of_the_discount_ends_below_1_where_some_policy_never_ends() -> None:
    for engine in (thresholds, curve):
        assert engine(WAIT, "discount").range.high < 1
    thirds = [0.1, 0.2, 0.3]
    row = [(p, to, 0.0) for to, p in enumerate([*thirds, 1 - sum(thirds)])]
    rest = [(1 / 3, 1, 0), (1 / 3, 2, 0), (1 / 3 + 1e-16, 0, 0)]  # a little more than 1
    ends = [(1, 0, [(1, 0, 0)]), (3, 0, [(1, 4, 1)]), (4, 0, [(1, 4, 0)])]
    floats = MDP.from_outcomes(
        [(0, 0, row), *ends[:1], (2, 0, rest), (2, 1, [(1, 2, 0)]), *ends[1:]]
    )
    by_discount = curve(floats, "discount")
    assert by_discount.violations() == []
    assert by_discount.at("1/2") == certify(floats.with_(discount="1/2")).start_value
