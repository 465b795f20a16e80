"""Maps of two parameters, against certificates at points and lines worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise, product

import matplotlib.pyplot as plt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp.analysis.sensitivity import two_way
from exact_mdp.analysis.sensitivity.curves import exact_map
from exact_mdp.analysis.sensitivity.curves.exact_map import ExactMap
from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.mdp.parametric import Parametric, moving, parametric
from exact_mdp.solvers import certify

F = Fraction
SMALL = Scenario.load("tea").with_(tasks=[1], max_trial=2)


def holds(found: ExactMap, family: Parametric, names: tuple[str, str], x: F, y: F) -> None:
    proof = certify(family.at({names[0]: x, names[1]: y}))
    numbers = found.at(x, y)
    assert numbers
    for number in numbers:
        assert proof.optimal_pairs[found.optimal[number]].all()


def two_bets() -> Parametric:
    """From 0: a bet that wins 4 with chance p, or a sure gain of 1 a step later."""
    rows = [(0, 0, [("1/2", 1, 4), ("1/2", 2, 0)]), (0, 1, [(1, 3, 0)]), (3, 0, [(1, 1, 1)])]
    ends = [(1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
    return moving(MDP.from_outcomes([*rows, *ends], "1/2"), {"p": [(0, 1)]})


def test_a_line_by_hand() -> None:
    """The bet is worth 4 p, waiting γ: the line is y = 4 x."""
    box = {"p": ("1/10", "9/10"), "discount": ("1/10", "9/10")}
    found = two_way(two_bets(), "p", "discount", ranges=box, points=3, exact=True)
    assert found.map is not None
    lines = {str(f) for slab in found.map.slabs for f, _ in slab.curves}
    assert lines == {"4*x - y"}
    (bet,), (wait,) = found.map.at("1/2", "1/2"), found.map.at("1/10", "1/2")
    assert bet != wait
    assert found.map.at("1/5", "4/5") == {bet, wait}
    assert found.map.at("1/5", "81/100") == {wait}
    assert found.map.at("1/5", "79/100") == {bet}
    with pytest.raises(ModelError, match="outside the rectangle"):
        found.map.at(1, 1)
    assert "policies that are optimal" in found.plot().get_title()
    assert found.plot(state=0).get_xlabel().startswith("p")
    plt.close("all")


@pytest.mark.parametrize(
    ("across", "along"),
    [((0, 2), (0, 1)), ((0, 2), (1, 2)), ((0, 3), (1, 2)), ((1, 2), (0, 3)), ((0, 1), (0, 1))],
)
def test_a_line_that_leaves(across: tuple[int, int], along: tuple[int, int]) -> None:
    """The greater of two rewards x and y is optimal, also where x = y leaves at any side."""
    rows = [(0, 0, [(1, 1, 3)]), (0, 1, [(1, 1, 5)]), (1, 0, [(1, 1, 0)])]
    family = moving(MDP.from_outcomes(rows, 1), {}, {"x": 3, "y": 5})
    box = {"x": across, "y": along}
    result = two_way(family, "x", "y", ranges=box, points=2, exact=True)
    found = result.map
    assert found is not None
    for x, y in product(range(13), repeat=2):
        at = F(x, 4), F(y, 4)
        if all(e.low <= v <= e.high for e, v in zip(found.box, at, strict=True)):
            best = {(x >= y, x <= y)} if x != y else {(True, False), (False, True)}
            assert {tuple(found.optimal[n][:2]) for n in found.at(*at)} == best
    for line in result.plot().lines[:-1]:
        assert line.get_ydata() == pytest.approx(line.get_xdata(), abs=1e-8)
    plt.close("all")


def test_slabs_cover_the_rectangle() -> None:
    names, box = (
        ("reward.assist.prompt", "base.anxiety"),
        {
            "reward.assist.prompt": (-6, 1),
            "base.anxiety": ("1/10", "1/2"),
        },
    )
    family = parametric(SMALL)
    found = two_way(SMALL, *names, ranges=box, points=2, exact=True).map
    assert found is not None
    assert str(found.claim) == "certified"
    ends = [found.slabs[0].low, *(slab.high for slab in found.slabs)]
    assert ends[0] == (-6, -6)
    assert ends[-1] == (1, 1)
    assert all(a.high == b.low for a, b in pairwise(found.slabs))
    assert len(found.optimal) > 2
    assert found.violations() == []
    for i in range(5):
        for j in range(4):
            holds(found, family, names, -6 + F(7 * i + 1, 5), F(1, 10) + F(2 * j + 1, 20))


@settings(max_examples=15, deadline=None)
@given(
    gains=st.lists(st.integers(-4, 4), min_size=6, max_size=6),
    weights=st.lists(st.integers(1, 5), min_size=6, max_size=6),
    spots=st.lists(st.tuples(st.integers(0, 40), st.integers(0, 40)), min_size=6, max_size=6),
)
def test_random_models(gains: list[int], weights: list[int], spots: list[tuple[int, int]]) -> None:
    """Two steps, chances and the discount moved: lines of degree 2 and more."""
    rows = []
    for k, (gain, weight) in enumerate(zip(gains, weights, strict=True)):
        state, action = divmod(k, 2)
        ends = (state + 1, 3) if state < 2 else (3, 3)
        p = F(weight, 6)
        rows.append((state, action, [(p, ends[0], gain), (1 - p, ends[1], -gain + action)]))
    mdp = MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], "1/2")
    family = moving(mdp, {"p": [(0, 1)]})
    box = {"p": (0, 1), "discount": (0, 1)}
    result = two_way(family, "p", "discount", ranges=box, points=2, exact=True)
    assert result.map is not None, result.sampled
    assert result.map.violations() == []
    for x, y in spots:
        holds(result.map, family, ("p", "discount"), F(x, 40), F(y, 40))


def test_the_checker_notices_a_forged_map() -> None:
    """Each policy, line, slab and mark is needed."""
    box = {"p": ("1/10", "9/10"), "discount": ("1/10", "9/10")}
    found = two_way(two_bets(), "p", "discount", ranges=box, points=2, exact=True).map
    assert found is not None
    assert found.violations() == []
    number = next(n for n, slab in enumerate(found.slabs) if slab.curves)
    slab, rest = found.slabs[number], found.slabs

    def instead(**changes: object) -> tuple[object, ...]:
        return (*rest[:number], replace(slab, **changes), *rest[number + 1 :])  # type: ignore[arg-type]

    low, high = slab.low, slab.high
    middle = (low[1] + high[0]) / 2
    wider = (*rest[: number - 1], replace(slab, low=rest[number - 1].low), *rest[number + 1 :])
    marks = found.optimal[0].copy()
    marks[0] = not marks[0]
    for broken in (
        replace(found, slabs=rest[1:]),
        replace(found, slabs=(*rest[:number], *rest[number + 1 :])),
        replace(found, slabs=instead(policies=slab.policies[::-1])),
        replace(found, slabs=instead(policies=slab.policies[:1], curves=())),
        replace(found, slabs=instead(policies=slab.policies[1:], curves=())),
        replace(found, slabs=instead(curves=tuple((f, n + 1) for f, n in slab.curves))),
        replace(found, slabs=instead(high=(middle, middle))),
        replace(found, optimal=(marks, *found.optimal[1:])),
        *([replace(found, slabs=wider)] if number else []),
    ):
        assert broken.violations()


def test_where_nothing_is_proven_it_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = [(s, a, [("1/2", 0, 1), ("1/2", 1, a)]) for s in (0, 1) for a in (0, 1)]
    family = moving(MDP.from_outcomes(rows, "9/10"), {"p": [(0, 1)]}, {"gain": 1})
    box = {"p": ("1/4", "3/4"), "gain": (0, 2)}
    found = two_way(family, "p", "gain", ranges=box, points=2, exact=True)
    assert (found.map, found.sampled) == (None, "states lead back to each other")
    assert two_way(family, "p", "gain", ranges=box, points=2).sampled == "no map was asked for"
    assert "sampled" in found.plot().get_title()
    plt.close("all")
    monkeypatch.setattr(exact_map, "DEGREE", 0)
    box = {"p": ("1/10", "9/10"), "discount": ("1/10", "9/10")}
    refused = two_way(two_bets(), "p", "discount", ranges=box, points=2, exact=True)
    assert "of degree 1" in refused.sampled
    whole = {"base.anxiety": (0, 1), "base.distraction": (0, 1)}
    cut = two_way(SMALL, *whole, ranges=whole, points=2, exact=True)
    assert (cut.map, "rows pass from one polynomial" in cut.sampled) == (None, True)
