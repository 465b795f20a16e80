"""Fronts proven by signs: against all policies of small models, against fractions, and forged."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from objective_models import totals, with_components

from exact_mdp import MDP, solve, tradeoff
from exact_mdp.analysis.tradeoffs.enclosed_front import Enclosed, EnclosedFront
from exact_mdp.analysis.tradeoffs.front import Front
from exact_mdp.analysis.tradeoffs.rationalize import rationalize
from exact_mdp.mdp import ModelError
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.checker import slack
from exact_mdp.solvers.objectives.fixed_point import FixedPoint
from exact_mdp.solvers.objectives.optima import attained
from exact_mdp.solvers.objectives.parametric import chain_of
from exact_mdp.solvers.objectives.switches import chain_violations

F = Fraction


def on_a_cycle(states: int, seed: int = 1, discount: str = "9/10", ends: bool = False) -> MDP:
    """A random model in which all states lead to each other, of 3 actions."""
    rng, rows = np.random.default_rng(seed), []
    for state in range(states):
        for action in range(3):
            ahead = rng.choice(states, 3, replace=False)
            share = rng.integers(1, 10, 3)
            below = int(share.sum()) + ends
            row = [(F(int(p), below), int(s), 0) for p, s in zip(share, ahead, strict=True)]
            rows.append((state, action, [*row, (F(1, below), states, 0)] if ends else row))
    if ends:
        rows.append((states, 0, [(1, states, 0)]))
    pairs = 3 * states
    parts = {n: [*rng.integers(0, 20, pairs).tolist(), *[0] * ends] for n in ("a", "b")}
    return MDP.from_outcomes(rows, discount, components=parts)


def enclosed(mdp: MDP, names: list[str]) -> EnclosedFront:
    front = tradeoff(mdp, names, exact=False)
    assert isinstance(front, EnclosedFront)
    return front


def same(short: EnclosedFront, front: Front) -> None:
    """The vertices, policies' totals, rates, weights and distances of both agree."""
    assert short.violations() == []
    assert len(short.vertices) == len(front.vertices)
    for bounds, vertex, policy in zip(short.vertices, front.vertices, short.policies, strict=True):
        assert all(b.low <= v <= b.high for b, v in zip(bounds, vertex, strict=True))
        assert front.totals(policy) == vertex
    for edge, exact in zip(short.edges, front.edges, strict=True):
        assert edge.rate.low <= exact.rate <= edge.rate.high
        assert all(b.low <= v <= b.high for b, v in zip(edge.change, exact.change, strict=True))
        assert exact.weights is not None
        assert all(b.low <= v <= b.high for b, v in zip(edge.weights, exact.weights, strict=True))
        before, after = (short.policies[n] for n in (edge.start, edge.end))
        actions = front.objectives.mdp.actions
        for state, left, taken in edge.switches:
            assert (actions[before[state]], actions[after[state]]) == (left, taken)
    far, exact_far = short.distance("random"), front.distance("random")
    assert far.low <= exact_far <= far.high


@settings(max_examples=40)
@given(mdp=with_components(2))
def test_signs_find_the_front_of_all_policies(mdp: MDP) -> None:
    """Where signs tell policies apart; ties of pairs that move otherwise are left to fractions."""
    of = Objectives.of(mdp, ["c0", "c1"])
    chain = chain_of(of)
    front = tradeoff(mdp, ["c0", "c1"])
    assert isinstance(front, Front)
    if chain is None:
        with pytest.raises(ModelError, match="do not tell"):
            tradeoff(mdp, ["c0", "c1"], exact=False)
        return
    assert chain_violations(of, chain) == []
    same(EnclosedFront(names=of.names, chain=chain, objectives=of), front)
    every = [tuple(of.sign * v for v in point) for point in totals(mdp, ["c0", "c1"])]
    for weight in (F(1, 7), F(2, 5), F(7, 8)):
        best = max(weight * a + (1 - weight) * b for a, b in every)
        found = [v for low, high in chain.totals for v in [(low[1], high[1])]]
        assert best <= max(weight * a + (1 - weight) * b for a, b in found)


@pytest.mark.parametrize(
    "mdp",
    [
        on_a_cycle(12),
        on_a_cycle(25, 2, "0.95"),
        on_a_cycle(12, 3, "1", ends=True),
        on_a_cycle(10, 4).with_(sense="min"),
    ],
    ids=["discount", "floats", "ends", "costs"],
)
def test_signs_and_fractions_agree(mdp: MDP) -> None:
    front = tradeoff(mdp, ["a", "b"])
    assert isinstance(front, Front)
    same(enclosed(mdp, ["a", "b"]), front)


def test_long_fractions_are_bounded_by_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exact_mdp.analysis.tradeoffs.front.LONG", 20)
    mdp = on_a_cycle(24)
    front = tradeoff(mdp, ["a", "b"])
    assert isinstance(front, EnclosedFront)
    assert front.violations() == []
    assert all(v.high - v.low < F(1, 2**60) for vertex in front.vertices for v in vertex)
    assert front.frame().shape == (len(front.vertices), 3)
    rates = [float(edge.rate) for edge in front.edges]
    assert rates == sorted(rates)
    point = front.totals(front.policies[0])
    assert all(b.low <= v <= b.high for b, v in zip(front.vertices[0], point, strict=True))
    assert front.distance(front.policies[0]).low >= 0


def test_pairs_of_the_same_moves_switch_at_once() -> None:
    """Three states trade at the same rate, one of them is never reached: two vertices, exactly."""
    rows = [(s, a, [(1, (s + 1) % 2, 0)]) for s in range(2) for a in (0, 1)]
    rows += [(2, a, [(1, 0, 0)]) for a in (0, 1)]
    parts = {"a": [0, 1] * 3, "b": [2, 0] * 3}
    mdp = MDP.from_outcomes(rows, "1/2", components=parts)
    front = enclosed(mdp, ["a", "b"])
    assert len(front.chain.switches) == 3
    assert len(front.vertices) == 2
    (edge,) = front.edges
    assert (edge.rate.low, edge.rate.high) == (2, 2)
    assert sorted(state for state, _, _ in edge.switches) == [0, 1]
    assert front.violations() == []
    same(front, tradeoff(mdp, ["a", "b"]))  # type: ignore[arg-type]


def test_at_discount_0_only_the_start_counts() -> None:
    """A switch in the state that comes next is no vertex, and no part of an edge."""
    gains = zip(product(range(2), repeat=2), [2, 1, 5, 1], strict=True)
    rows = [(s, a, [(1, 1, gain)]) for (s, a), gain in gains]
    parts = {"a": [2, 0, 5, 0], "b": [0, 1, 0, 1]}
    mdp = MDP.from_outcomes(rows, 0, components=parts)
    front = enclosed(mdp, ["a", "b"])
    same(front, tradeoff(mdp, ["a", "b"]))  # type: ignore[arg-type]
    assert [edge.switches for edge in front.edges] == [((0, "1", "0"),)]
    limited = solve(mdp, subject_to={"b": ">= 1/2"})
    assert (limited.start_value, limited.violations()) == (F(3, 2), [])
    assert rationalize(mdp, [1, 0]).violations() == []


def test_the_checker_notices_a_forged_chain() -> None:
    """Every part of the proof, changed a little, is refused."""
    front = enclosed(on_a_cycle(12), ["a", "b"])
    chain, of = front.chain, front.objectives
    assert len(chain.switches) > 4
    low, high = chain.brackets[2]
    swapped = (*chain.switches[:2], chain.switches[3], chain.switches[2], *chain.switches[4:])
    first = chain.first.copy()
    first[0] = first[0] + 1 if first[0] < 2 else 0
    width = high - low
    other = ((F(0), F(0)), (F(0), F(0)))
    for broken in (
        replace(chain, first=first),
        replace(chain, first=chain.first[:-1]),
        replace(chain, switches=swapped),
        replace(chain, switches=chain.switches[:-1]),
        replace(
            chain,
            switches=chain.switches[:-1],
            brackets=chain.brackets[:-1],
            totals=chain.totals[:-1],
        ),
        replace(chain, switches=chain.switches[1:], brackets=chain.brackets[1:],
                totals=chain.totals[1:]),
        replace(chain, brackets=(*chain.brackets[:2], (low - width, low), *chain.brackets[3:])),
        replace(chain, brackets=(*chain.brackets[:2], (high, high + width), *chain.brackets[3:])),
        replace(chain, brackets=(*chain.brackets[:2], (low, low), *chain.brackets[3:])),
        replace(chain, totals=(other, *chain.totals[1:])),
        replace(chain, totals=(tuple((b, b) for _, b in chain.totals[0]), *chain.totals[1:])),
        replace(chain, weight=tuple(-w for w in chain.weight)),
        replace(chain, weight=chain.weight[1:]),
        replace(chain, switches=(int(chain.first[0]), *chain.switches),
                brackets=(chain.brackets[0], *chain.brackets),
                totals=(chain.totals[0], *chain.totals)),
    ):  # fmt: skip
        assert chain_violations(of, broken)
        assert replace(front, chain=broken).violations()
    far = Objectives.of(on_a_cycle(12, discount=f"1/{2**1200}"), ["a", "b"])
    assert "floats" in chain_violations(far, chain)[0]  # none hold that


@pytest.mark.parametrize("seed", range(4))
def test_fixed_point_encloses_what_pairs_lose(seed: int) -> None:
    """Totals and signs of policies, with few bits and many, after switches, against fractions."""
    mdp, rng = on_a_cycle(8, seed, "99/100"), np.random.default_rng(seed)
    of = Objectives.of(mdp, ["a", "b"])
    fixed = FixedPoint(of, np.ones(8, dtype=object), mdp.pair_offsets[:-1].copy())
    for pair in rng.choice(mdp.n_pairs, 8).tolist():
        if fixed.pairs[mdp.pair_state[pair]] == pair:
            continue
        fixed.switch(pair)
        for _ in range(int(rng.integers(3))):
            assert fixed.sharpen()
        exact = attained(of, fixed.pairs)
        assert all(a <= v <= b for v, (a, b) in zip(exact.total, fixed.totals(), strict=True))
        shares = int(rng.integers(9)), int(rng.integers(1, 9))
        each = zip(shares, of.amounts, exact.values, strict=True)
        lost = sum(n * slack(of, own, v) * F(1, v.below) for n, own, v in each)
        assert fixed.signs(shares).tolist() == [(x > 0) - (x < 0) for x in lost]  # type: ignore[union-attr]


def test_enclosed_numbers_add_up() -> None:
    a, b = Enclosed(low=F(1), high=F(2)), Enclosed(low=F(3), high=F(3))
    assert (b - a, -a) == (Enclosed(low=F(1), high=F(2)), Enclosed(low=F(-2), high=F(-1)))
    assert (float(a), str(b)) == (1.5, "3")


def test_three_totals_have_no_bounds() -> None:
    with pytest.raises(ModelError, match="three totals"):
        tradeoff(on_a_cycle(5), ["a", "b", "steps"], exact=False)


def test_the_command_prints_bounds(tmp_path: Path) -> None:
    mdp = on_a_cycle(105)
    mdp.save(tmp_path / "long.npz")
    words = ("tradeoff", tmp_path / "long.npz", "a", "b", "--certificate", tmp_path / "p.json")
    found = run(*words, "--json").result
    front = tradeoff(mdp, ["a", "b"])
    assert isinstance(front, EnclosedFront)
    for vertex, bounds in zip(found["vertices"], front.vertices, strict=True):
        for name, own in zip("ab", bounds, strict=True):
            ends = vertex["values"][name]
            assert (F(ends["low"]), F(ends["high"])) == (own.low, own.high)
    assert found["claim"] == "certified"
    assert {*found["edges"][0]["rate"]} == {"low", "high"}
    checked = run("verify", tmp_path / "p.json", tmp_path / "long.npz", "--json")
    assert (checked.status, checked.result["vertices"]) == (0, len(front.vertices))
    assert checked.result["totals"] == [vertex["values"] for vertex in found["vertices"]]
    proof = json.loads((tmp_path / "p.json").read_text())
    first = next(iter(proof["totals"][0]))
    first[1] = ["f4240", "1"]  # a range that holds, and says little: it is shown as wide as it is
    (tmp_path / "p.json").write_text(json.dumps(proof))
    assert " to 1000000" in run("verify", tmp_path / "p.json", tmp_path / "long.npz").out


@pytest.mark.slow
def test_a_long_front_has_the_totals_of_its_policies() -> None:
    """Of 400 states: some vertices, solved in fractions, and their order."""
    mdp = on_a_cycle(400)
    front = enclosed(mdp, ["a", "b"])
    assert front.violations() == []
    rates = [float(edge.rate) for edge in front.edges]
    assert rates == sorted(rates)
    for number in range(0, len(front.vertices), len(front.vertices) // 4):
        point = front.totals(front.policies[number])
        bounds = zip(front.vertices[number], point, strict=True)
        assert all(own.low <= value <= own.high for own, value in bounds)
