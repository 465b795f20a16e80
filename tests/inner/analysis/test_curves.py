"""Exact curves over a parameter: roots, signs of polynomials, limits, and false pieces."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import flint
import pytest
from flint import fmpq_poly
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import (
    MDP,
    ModelError,
    Parametric,
    Scenario,
    certify,
    check,
    curve,
    moving,
    parametric,
    thresholds,
)
from exact_mdp.analysis.vary.curves import checker, gap_polynomials
from exact_mdp.analysis.vary.curves import roots as real_roots
from exact_mdp.analysis.vary.curves.curve import ValueFunction
from exact_mdp.analysis.vary.curves.roots import (
    nonnegative,
    odd_part,
    positive,
    roots,
    roots_on,
    sign,
    simple,
    variations,
)
from exact_mdp.mdp.exact import rational

F = Fraction
SMALL = Scenario.load("tea").with_(tasks=[1], max_trial=2)


def start_of(mdp: MDP, policy: object) -> Fraction:
    """The exact value of a policy at one point."""
    value = check(mdp, policy, exact_values=True).regret.learned.value
    assert isinstance(value, Fraction)
    return value


def agrees(found: ValueFunction, family: Parametric, at: Fraction, policy: object) -> None:
    mdp = family.at({found.parameter.name: at})
    certificate = certify(mdp)
    assert found.at(at) == certificate.start_value
    assert found.fixed_at(at) == start_of(mdp, policy)
    for piece in found.around(at):
        if piece.low[1] < at < piece.high[0]:
            assert (piece.optimal == certificate.optimal_pairs)[~mdp.terminal[mdp.pair_state]].all()


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
    # One bracket that is wide, between sections, where nothing is checked, proves nothing.
    whole = (found.range.low, found.range.high)
    assert "no piece covers" in broken(found, 1, low=whole)[0]
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


def test_the_checkers_import_no_solver() -> None:
    own = "exact_mdp.analysis.vary.curves"
    allowed = {f"{own}.roots"}
    for module in (checker, real_roots):
        source = Path(module.__file__).read_text("utf-8")
        assert "import exact_mdp" not in source
        lines = (line.split() for line in source.splitlines() if line.startswith("from exact_mdp"))
        assert all(home.startswith("exact_mdp.mdp.") or home in allowed for _, home, *_ in lines)


def test_roots_closer_than_a_bracket_are_told_apart() -> None:
    """A root 1e-20 from an exact one is not mistaken for it."""
    near = F(1, 10**20)
    every = (F(1, 2) - near, F(1, 2), 1 - near)
    poly = flint.fmpq_poly([1])
    for each in every:
        poly = poly * flint.fmpq_poly([rational(-each), 1])
    below = F(0)
    for root, true in zip(roots(poly, F(0), F(1)), every, strict=True):
        found = root.apart(below, F(1, 10**12))
        assert below < found.low <= true <= found.high <= 1
        below = found.high


def rational_poly(numbers: list[Fraction]) -> fmpq_poly:
    from flint import fmpq

    poly = fmpq_poly([1])
    for number in numbers:
        poly *= fmpq_poly([fmpq(-number.numerator, number.denominator), 1])
    return poly


@given(st.lists(st.fractions(-2, 2, max_denominator=20), max_size=6))
@settings(max_examples=60)
def test_roots_are_all_found_once(numbers: list[Fraction]) -> None:
    poly = rational_poly(numbers)
    found = list(roots(simple(poly), F(-1), F(1)))
    inside = sorted({number for number in numbers if -1 < number < 1})
    assert len(found) == len(inside)
    for root, number in zip(found, inside, strict=True):
        near = root.narrowed(F(1, 10**9))
        assert near.low <= number <= near.high
        assert near.high - near.low <= F(1, 10**9)
    assert variations(simple(poly), F(-1), F(1)) >= len(inside)
    assert roots_on(poly, F(-1), F(1)) == len({number for number in numbers if -1 <= number <= 1})
    odd = {number for number in inside if numbers.count(number) % 2}
    assert roots_on(odd_part(poly), F(-1), F(1)) >= len(odd)
    assert all((sign(odd_part(poly), number) == 0) == (number in odd) for number in inside)
    assert sign(poly, F(3)) == 1
