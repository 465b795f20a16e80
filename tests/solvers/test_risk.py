"""Risks of the return, against the distributions of all policies, those with a memory included."""

import csv
import json
from dataclasses import replace
from fractions import Fraction
from itertools import product
from math import inf
from pathlib import Path

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, ModelError, best_cvar, certify, return_distribution

F = Fraction
Distribution = tuple[tuple[Fraction, Fraction], ...]
Rows = list[tuple[int, int, list[tuple[Fraction, int, Fraction]]]]


@st.composite
def trees(draw: st.DrawFn) -> Rows:
    """Draw a model whose transitions lead to smaller numbers; state 0 ends."""
    rows: Rows = [(0, 0, [(F(1), 0, F(0))])]
    gains = st.sampled_from([F(-2), F(-1), F(-1, 2), F(0), F(1), F(3, 2), F(3)])
    for state in range(1, draw(st.integers(2, 4))):
        for action in range(draw(st.integers(1, 2))):
            weights = draw(st.lists(st.sampled_from([1, 1, 2, 9]), min_size=1, max_size=2))
            ends = [draw(st.integers(0, state - 1)) for _ in weights]
            own = [
                (F(w, sum(weights)), to, draw(gains)) for w, to in zip(weights, ends, strict=True)
            ]
            rows.append((state, action, own))
    return rows


def mixed(parts: list[tuple[Fraction, Fraction, Distribution]]) -> Distribution:
    total = dict[Fraction, Fraction]()
    for p, gain, after in parts:
        for value, mass in after:
            total[gain + value] = total.get(gain + value, F(0)) + p * mass
    return tuple(sorted(total.items()))


def distributions(rows: Rows, state: int) -> set[Distribution]:
    """Every distribution of the return that some policy has, whatever it remembers."""
    if state == 0:
        return {((F(0), F(1)),)}
    laws = set[Distribution]()
    for s, _, outcomes in rows:
        if s == state:
            each = [sorted(distributions(rows, to)) for _, to, _ in outcomes]
            for after in product(*each):
                own = zip(outcomes, after, strict=True)
                laws.add(mixed([(p, gain, rest) for (p, _, gain), rest in own]))
    return laws


def mean(of: Distribution) -> Fraction:
    return sum((value * p for value, p in of), F(0))


def worst(of: Distribution, level: Fraction) -> Fraction:
    """The mean of the worst share, by Rockafellar and Uryasev's formula at every return."""
    return max(
        eta - sum((max(eta - value, F(0)) * p for value, p in of), F(0)) / level for eta, _ in of
    )


def model(rows: Rows, sense: str = "max") -> MDP:
    return MDP.from_outcomes(rows, start=max(s for s, *_ in rows), sense=sense)


levels = st.sampled_from([F(1, 10), F(1, 3), F(1, 2), F(9, 10), F(1)])


@settings(max_examples=80)
@given(trees(), levels)
def test_no_policy_with_a_memory_does_better(rows: Rows, level: Fraction) -> None:
    every = distributions(rows, max(s for s, *_ in rows))
    optimum = best_cvar(model(rows), level)
    assert optimum.value == max(worst(of, level) for of in every)
    own = tuple(optimum.distribution().items())
    assert own in every
    assert (worst(own, level), mean(own)) == (optimum.value, optimum.mean)
    assert optimum.violations() == []
    proof = optimum.certificate
    assert proof.mdp is not None
    assert certify(proof.mdp).value.tolist() == proof.value.tolist()
    costs = [(s, a, [(p, to, -gain) for p, to, gain in each]) for s, a, each in rows]
    turned = best_cvar(model(costs, "min"), level)
    assert (turned.value, turned.mean) == (-optimum.value, -optimum.mean)
    assert turned.violations() == []
    assert {-value: p for value, p in turned.distribution().items()} == optimum.distribution()


@settings(max_examples=30)
@given(trees(), levels)
def test_the_worst_episodes_of_a_policy(rows: Rows, level: Fraction) -> None:
    mdp = model(rows)
    law = return_distribution(mdp, "random", exact=True)
    assert law.exact is not None
    own = tuple(zip(law.values, law.exact, strict=True))
    assert law.tail_mean(level) == worst(own, level)
    turned = tuple((-value, p) for value, p in own)
    assert law.tail_mean(level, highest=True) == -worst(turned, level)
    floats = return_distribution(mdp, "random").tail_mean(level)
    assert float(floats) == pytest.approx(float(worst(own, level)))


def test_what_never_ends_has_infinite_tails() -> None:
    rows = [(0, 0, [("1/2", 0, -1), ("1/4", 1, 0), ("1/4", 2, 2)]), (1, 0, [(1, 1, -1)])]
    law = return_distribution(MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])]), "random")
    assert law.tail_mean("1/4") == law.tail_mean(1) == -inf
    assert law.tail_mean("1/4", highest=True) > -inf


def test_what_is_false_is_found() -> None:
    rows = [(0, 0, [("1/2", 1, 10), ("1/2", 1, 0)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    optimum = best_cvar(MDP.from_outcomes(rows), "1/2")
    assert optimum.violations() == []
    for change in (
        {"value": F(5)},
        {"mean": F(5)},
        {"threshold": F(10)},
        {"threshold": F(1, 2)},
    ):
        assert replace(optimum, **change).violations()
    more = replace(optimum.values, top=[top + 1 for top in optimum.values.top])
    for change in ({"values": more}, {"pairs": np.zeros_like(optimum.pairs)}):
        assert replace(optimum, **change).violations()


def test_with_a_horizon_cycles_are_no_matter() -> None:
    rows = [(0, 0, [("1/2", 0, 1), ("1/2", 0, -1)]), (0, 1, [(1, 0, 0)])]
    mdp = MDP.from_outcomes(rows)
    optimum = best_cvar(mdp.within(3), "1/2")
    assert optimum.value == optimum.mean == 0


def test_a_total_until_a_goal_that_every_run_reaches_is_the_same_question() -> None:
    rows = [(0, 0, [("1/2", 1, 1), ("1/2", 2, 3)]), (0, 1, [(1, 2, 2)]), (3, 0, [(1, 3, 0)])]
    for state, step in ((1, 2), (2, 1)):
        rows += [(state, 0, [("1/3", 3, 1), ("2/3", 3, 5)]), (state, 1, [(1, 3, step)])]
    mdp = MDP.from_outcomes(rows, labels={"end": [False, False, False, True]})
    optimum = best_cvar(mdp.until("end"), "1/5")
    assert optimum.violations() == []
    assert optimum.distribution() == best_cvar(mdp, "1/5").distribution()


def test_the_policy_for_the_worst_episodes_is_written(tmp_path: Path) -> None:
    """What the file says, carried forward by hand, has the distribution that is printed."""
    rows = [(0, 0, [("1/2", 1, 3), ("1/2", 1, -2)]), (1, 0, [(1, 2, 0)])]
    rows += [(1, 1, [("1/2", 2, 3), ("1/2", 2, -3)]), (2, 0, [(1, 2, 0)])]
    MDP.from_outcomes(rows).save(tmp_path / "m.npz")
    words = ("risk", tmp_path / "m.npz", "--cvar", "1/3", "--policy-out")
    result = run(*words, tmp_path / "p.csv", "--json").result
    assert run(*words, tmp_path / "p.json").status == 0
    with (tmp_path / "p.csv").open(encoding="utf-8") as file:
        written = [*csv.DictReader(file)]
    assert written == result["policy"]
    assert written == json.loads((tmp_path / "p.json").read_text("utf-8"))
    parts: list[tuple[F, F, Distribution]] = []
    for so_far in (F(-2), F(3)):
        (row,) = [r for r in written if F(r["from"]) <= so_far <= F(r["to"])]
        ahead = [(F(-3), F(1, 2)), (F(3), F(1, 2))] if row["action"] == "1" else [(F(0), F(1))]
        parts.append((F(1, 2), so_far, tuple(ahead)))
    assert {str(z): str(p) for z, p in mixed(parts)} == result["distribution"]
    assert "by state and reward so far" in run(*words[:-1]).out


def test_rules_are_of_states_that_leave_a_choice() -> None:
    """A state where all has ended may have several actions."""
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)]), (1, 1, [(1, 1, 0)])]
    assert best_cvar(MDP.from_outcomes(rows), "1/2").rules() == [(0, 0, 0, "0")]


def test_huge_rewards_that_differ_by_little() -> None:
    rows = [(0, 0, [("1/2", 1, 10**30), ("1/2", 1, 10**30 + 3)]), (0, 1, [(1, 1, 10**30 + 1)])]
    rows = [*rows, (1, 0, [(1, 1, 0)])]
    optimum = best_cvar(MDP.from_outcomes(rows), "3/4")
    assert (optimum.value, optimum.violations()) == (10**30 + 1, [])


def test_a_bet_by_hand() -> None:
    """The coin decides: after a win it may be played safe, and after a loss no more is risked."""
    end, safe = (0, 0, [(F(1), 0, F(0))]), (1, 0, [(F(1), 0, F(0))])
    bold = (1, 1, [(F(1, 2), 0, F(3)), (F(1, 2), 0, F(-2))])
    once = best_cvar(model([end, safe, bold]), "1/2")
    assert (once.value, once.action(1)) == (0, "0")
    rows = [end, safe, bold, (2, 0, [(F(1, 2), 1, F(3)), (F(1, 2), 1, F(-2))])]
    twice = best_cvar(model(rows), "3/4")
    assert twice.value == max(worst(each, F(3, 4)) for each in distributions(rows, 2))
    assert {twice.action(1, gain) for gain in (3, -2)} <= {"0", "1"}
    with pytest.raises(ModelError, match="multiples of 1"):
        twice.action(1, "1/2")
