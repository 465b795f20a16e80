"""The checker: small false certificates, its arithmetic beside fractions, and weaker checkers."""

import json
from collections.abc import Callable
from fractions import Fraction as F
from functools import cache
from math import inf
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from certified_models import MODELS as PLAIN
from oracle import mean, rows_of
from proof_models import ISLANDS, LOOP, MODELS, of

from exact_mdp import MDP, certify, fingerprint
from exact_mdp.mdp.io import model_json
from exact_mdp.solvers.exact import checker, codec
from exact_mdp.solvers.exact.checker import Check, Level, Model, Unreadable, violations

File = dict[str, Any]

# ---- files by hand -------------------------------------------------------------------------------


def row(state: int, action: int, after: list[int], reward: Any = 0, **more: Any) -> File:
    """A pair that leads to each next state with the same chance."""
    return {
        "state": state, "action": action, "reward": reward, "denominator": len(after),
        "next": after, "weight": [1] * len(after),
    } | more  # fmt: skip


def model(*pairs: File, **more: Any) -> File:
    """A model of rewards at discount 1 whose runs begin in state 0."""
    states = 1 + max(pair["state"] for pair in pairs)
    head = {"format": "exact-mdp model", "version": 2, "states": states, "discount": 1}
    return head | {"sense": "max", "start": {"0": 1}, "pairs": [*pairs]} | more


def level(*numbers: int) -> File:
    return {"top": [*numbers], "below": [1], "group": [0] * len(numbers)}


def claim(of: File, value: Any, **parts: Any) -> File:
    """A certificate of a value at the start; first actions, and no part, unless it is said."""
    states = of["states"]
    head = {"format": "exact-mdp certificate", "version": 2, "kind": "total"}
    none = dict.fromkeys(("g", "h", "w", "rank", "infinite", "order"))
    said = {"sense": of["sense"], "policy": [0] * states, "start_value": value, "unique": True}
    return head | none | said | {"model": Model(of).digest()} | parts


LEAST = {"unreached": "-inf"}  # missing the goal is worth the least
MOST = {"unreached": "inf"}
Case = tuple[File, File, str]  # a model, a certificate of something false, and what is said of it


def case(of: File, value: Any, said: str, **parts: Any) -> Case:
    return of, claim(of, value, **parts), said


LOW_RANK = "state {}, action {}: the rank does not show that the goal is reached"
LOW_ORDER = "state {}, action 0: the order does not show that the policy is worth +∞"
FALSE: dict[str, Case] = {
    # values alone
    "an end that is worth 5": case(
        model(row(0, 0, [0])), 5, "state 0, action 0: an end is not worth 0", h=level(5), rank=[0]
    ),
    "waiting for ever for 5 that never come": case(
        model(row(0, 0, [0]), row(0, 1, [1]), row(1, 0, [1])), 5,
        "state 0, action 0: the rank does not show that every policy ends",
        h=level(5, 0), rank=[1, 0],
    ),
    "an end outside the goal, which counts as the goal": case(
        model(row(0, 0, [1, 2]), row(1, 0, [1]), row(2, 0, [2]), goal=[1], **LEAST), 0,
        "state 2, action 0: a run may end here, outside the goal", h=level(0, 0, 0), rank=[1, 0, 0],
    ),
    "a policy that earns nothing, said to earn 1": case(
        model(row(0, 0, [1]), row(1, 0, [1])), 1,
        "state 0, action 0: the policy is worth less than is claimed",
        h=level(1, 0), rank=[1, 0], unique=False,
    ),
    "an action that earns 2, left out": case(
        model(row(0, 0, [1]), row(0, 1, [1], 2), row(1, 0, [1])), 0,
        "state 0, action 1: it is worth more than is claimed", h=level(0, 0), rank=[1, 0],
    ),
    # gain and bias
    "an average of 1 without rewards": case(
        model(row(0, 0, [0])), 1, "state 0, action 0: the policy's h is less than is claimed",
        kind="average", g=level(1), h=level(0), w=level(0),
    ),
    "a greater average, left out": case(
        model(row(0, 0, [0]), row(0, 1, [0], 1)), 0,
        "state 0, action 1: its h is more than is claimed",
        kind="average", g=level(0), h=level(0), w=level(0), unique=False,
    ),
    "an average that another state has": case(
        model(row(0, 0, [0]), row(0, 1, [1]), row(1, 0, [1], 1)), 0,
        "state 0, action 1: its g is more than is claimed",
        kind="average", g=level(0, 1), h=level(0, 0), w=level(0, 0),
    ),
    "1 and -1 in turn, of which the mean of totals, 1/2, is the limit": case(
        model(row(0, 0, [1], 1), row(1, 0, [0], -1)), 1,
        "state 0, action 0: the policy's w is less than is claimed",
        g=level(0, 0), h=level(1, 0), w=level(0, 0),
    ),
    "a better bias, left out": case(
        model(row(0, 0, [1]), row(0, 1, [1], 1), row(1, 0, [1])), 0,
        "state 0, action 1: its h is more than is claimed",
        g=level(0, 0), h=level(0, 0), w=level(0, 0),
    ),
    # a goal
    "a goal that is worth 5": case(
        model(row(0, 0, [1]), row(1, 0, [1]), goal=[1], **LEAST), 5,
        "state 1, action 0: a state of the goal is not worth 0",
        h=level(5, 5), rank=[1, 0], infinite=[0, 0], order=[0, 0],
    ),
    "a goal that is worth +∞": case(
        model(row(0, 0, [0]), goal=[0], **MOST), "inf",
        "state 0, action 0: a state of the goal is not worth 0",
        h=level(0), rank=[0], infinite=[1], order=[0],
    ),
    "a way that may go back, and surely arrives, called lost": case(
        model(row(0, 0, [1]), row(1, 0, [0, 2]), row(2, 0, [2]), goal=[2], **LEAST), "-inf",
        "state 0, action 0: the order does not show that the goal is missed",
        h=level(0, 0, 0), rank=[0, 0, 0], infinite=[-1, -1, 0], order=[0, 1, 0],
    ),
    "the same way, called missed for ever": case(
        model(row(0, 0, [1]), row(1, 0, [0, 2]), row(2, 0, [2]), goal=[2], **MOST), "inf",
        LOW_ORDER.format(0),
        h=level(0, 0, 0), rank=[0, 0, 0], infinite=[1, 1, 0], order=[0, 1, 0],
    ),
    "losses without end, called gains": case(
        model(row(0, 0, [0], -1), row(0, 1, [1]), row(1, 0, [1]), goal=[1], **LEAST), "inf",
        LOW_ORDER.format(0), h=level(0, 0), rank=[1, 0], infinite=[1, 0], order=[0, 0],
    ),
    "a loop without gain, called a gain": case(
        model(row(0, 0, [0]), row(0, 1, [1]), row(1, 0, [1]), goal=[1], **LEAST), "inf",
        LOW_ORDER.format(0), h=level(0, 0), rank=[1, 0], infinite=[1, 0], order=[0, 0],
    ),
    "gains that can be had only at the risk of being stuck": case(
        model(row(0, 0, [1, 3]), row(0, 1, [2]), row(1, 0, [1], 1), row(1, 1, [2]), row(2, 0, [2]),
              row(3, 0, [3]), goal=[2], **LEAST), "inf",
        LOW_ORDER.format(0),
        h=level(0, 0, 0, 0), rank=[1, 1, 0, 0], infinite=[1, 1, 0, -1], order=[1, 0, 0, 0],
        unique=False,
    ),
    "gains without end, but also without a way to the goal": case(
        model(row(0, 0, [0], 1), row(1, 0, [1]), goal=[1], **LEAST), "inf",
        "state 0: the goal may be out of reach",
        h=level(0, 0), rank=[1, 0], infinite=[1, 0], order=[0, 0],
    ),
    "gains without end, but no safe way to the goal": case(
        model(row(0, 0, [0], 1), row(0, 1, [1, 2]), row(1, 0, [1]), row(2, 0, [2]), goal=[1],
              **LEAST), "inf",
        "state 0: the goal may be out of reach",
        h=level(0, 0, 0), rank=[1, 0, 0], infinite=[1, 0, -1], order=[0, 0, 0],
    ),
    "waiting beside a goal that costs 1": case(
        model(row(0, 0, [0]), row(0, 1, [1], -1), row(1, 0, [1]), goal=[1], **LEAST), 0,
        LOW_RANK.format(0, 0), h=level(0, 0), rank=[0, 0], infinite=[0, 0], order=[0, 0],
    ),
    "a goal that may be missed for +∞, called reached": case(
        model(row(0, 0, [1]), row(0, 1, [0]), row(1, 0, [1]), goal=[1], **MOST), 0,
        LOW_RANK.format(0, 1), h=level(0, 0), rank=[1, 0], infinite=[0, 0], order=[0, 0],
        unique=False,
    ),
    "0 beside a state that is worth +∞": case(
        model(row(0, 0, [2]), row(0, 1, [1]), row(1, 0, [1], 1), row(1, 1, [2]), row(2, 0, [2]),
              goal=[2], **LEAST), 0,
        "state 0, action 1: it is worth more than is claimed",
        h=level(0, 0, 0), rank=[1, 1, 0], infinite=[0, 1, 0], order=[0, 0, 0],
    ),
    "a way to the goal that earns nothing, said to earn 1": case(
        model(row(0, 0, [1]), row(1, 0, [1]), goal=[1], **LEAST), 1,
        "state 0, action 0: the policy is worth less than is claimed",
        h=level(1, 0), rank=[1, 0], infinite=[0, 0], order=[0, 0], unique=False,
    ),
    "a way to the goal that earns 1, left out": case(
        model(row(0, 0, [1]), row(0, 1, [1], 1), row(1, 0, [1]), goal=[1], **LEAST), 0,
        "state 0, action 1: it is worth more than is claimed",
        h=level(0, 0), rank=[1, 0], infinite=[0, 0], order=[0, 0],
    ),
    "-∞ where missing the goal is worth the most": case(
        model(row(0, 0, [0]), row(1, 0, [1]), goal=[1], **MOST), "-inf",
        "state 0, action 0: it is worth more than is claimed",
        h=level(0, 0), rank=[1, 0], infinite=[-1, 0], order=[0, 0], unique=True,
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", FALSE)
def test_a_false_certificate_breaks_a_rule(what: str) -> None:
    given, certificate, said = FALSE[what]
    first, *others = violations(given, certificate)
    assert first == said
    assert all("the optimum is" in other for other in others)


# Each is a change of one clause of the checker, and a false certificate that it would let through.
WEAKER: list[tuple[str, str, str]] = [
    ("if one and ends and not self.low.top[state] <= 0 <= self.high.top[state]:", "if False:",
     "an end that is worth 5"),
    ("if one and not ends and not self.falls(pair, self.rank, range(self.model.states)):",
     "if False:", "waiting for ever for 5 that never come"),
    ("if one and ends and goal is not None and state not in goal:", "if False:",
     "an end outside the goal, which counts as the goal"),
    ("less = taken and self.gain(pair, self.low) < 0", "less = False",
     "a policy that earns nothing, said to earn 1"),
    ('is less than is claimed" if gain and taken else ""', 'is less" if False else ""',
     "an average of 1 without rewards"),
    ('zip("ghw", (self.g, self.h, self.w), earned, strict=True)',
     'zip("gh", (self.g, self.h), earned)',
     "1 and -1 in turn, of which the mean of totals, 1/2, is the limit"),
    ("worth_0 = state in self.finite and not self.h.top[state]", "worth_0 = state in self.finite",
     "a goal that is worth 5"),
    ("{order[s] for s in after} == {order[state]}", "True",
     "a way that may go back, and surely arrives, called lost"),
    (" and not any(order[s] for s in (state, *after))", "", "the same way, called missed for ever"),
    ("stays = stays and not (lost and self.gain(pair, self.h) <= 0)", "pass",
     "losses without end, called gains"),
    ("lost and self.gain(pair, self.h) <= 0", "lost and self.gain(pair, self.h) < 0",
     "a loop without gain, called a gain"),
    ("not taken or (safe and (stays or", "not taken or (True and (stays or",
     "gains that can be had only at the risk of being stuck"),
    ("if self.lost and not self.above <= self.arriving:", "if False:",
     "gains without end, but also without a way to the goal"),
    ("if safe and (self.finite & {*after} or", "if (self.finite & {*after} or",
     "gains without end, but no safe way to the goal"),
    ('return "" if reached else', 'return "" if True else', "waiting beside a goal that costs 1"),
    ("reached = (lost and not taken) or", "reached = not taken or",
     "a goal that may be missed for +∞, called reached"),
    ("if (safe and not inside) or gain > 0 or", "if gain > 0 or",
     "0 beside a state that is worth +∞"),
    ("if taken and not self.optimal[pair]:", "if False:",
     "a way to the goal that earns nothing, said to earn 1"),
]  # fmt: skip


@pytest.mark.parametrize("clause, instead, what", WEAKER)
def test_each_clause_stops_a_false_certificate(clause: str, instead: str, what: str) -> None:
    """Without it, a checker of the same text accepts what is false."""
    text = Path(str(checker.__file__)).read_text("utf-8")
    assert text.count(clause) == 1
    weaker = ModuleType("weaker")
    exec(text.replace(clause, instead), vars(weaker))
    given, certificate, _ = FALSE[what]
    assert violations(given, certificate) != []
    assert weaker.violations(given, certificate) == []


# ---- certificates that hold ----------------------------------------------------------------------


@cache
def proven(name: str) -> tuple[File, File]:
    """Return the files of a model and of its proof."""
    kind = {"averages": "average", "least averages": "average"}.get(name)
    bounded = name in ("bounds", "bounds at discount 1")
    mdp = {
        "averages": of(ISLANDS), "least averages": of(LOOP, sense="min"),
        "bounds": of(LOOP, discount="1/2"), "bounds at discount 1": PLAIN["cycle"],
    }.get(name) or (MODELS | PLAIN)[name]  # fmt: skip
    if bounded:
        proof: Any = certify(mdp, bounded=True)
    else:
        proof = certify(mdp, criterion=kind or "total")
    return model_json.encode_model(mdp), codec.build_file_content(proof, int)


HOLD = [*MODELS, *PLAIN, "averages", "least averages", "bounds", "bounds at discount 1"]


@pytest.mark.parametrize("name", HOLD)
def test_right_certificates_hold_and_no_other_start_value_does(name: str) -> None:
    given, proof = proven(name)
    assert violations(given, proof) == []
    if proof["kind"] == "bounds":
        return
    value = proof["start_value"]
    for other in ("inf", "-inf", "0x7/0x5", "-0x7/0x5"):
        if other != value:
            assert violations(given, proof | {"start_value": other}) == [
                "the start value is not that of the start states"
            ]
    unique = proof["unique"]
    said = "it says wrongly that the optimum is {}unique"
    wrong = violations(given, proof | {"unique": not unique})
    assert wrong == [said.format("not " if unique else "")]
    for other in (None, int(unique)):  # 1 is not true
        assert violations(given, proof | {"unique": other}) == [
            said.format("" if other else "not ")
        ]


UNIQUE: dict[str, tuple[File, bool, dict[str, Any]]] = {
    "one way": (model(row(0, 0, [1], 1), row(0, 1, [1]), row(1, 0, [1])), True,
                {"h": level(1, 0), "rank": [1, 0]}),
    "two ways": (model(row(0, 0, [1], 1), row(0, 1, [1], 1), row(1, 0, [1])), False,
                 {"h": level(1, 0), "rank": [1, 0]}),
    "two ways, where no run comes": (
        model(row(0, 0, [1], 1), row(1, 0, [1]), row(2, 0, [1]), row(2, 1, [1])), True,
        {"h": level(1, 0, 0), "rank": [1, 0, 1]}),
    "two ways in the second step": (
        model(row(0, 0, [2], 1), row(1, 0, [1]), row(2, 0, [1]), row(2, 1, [1])), False,
        {"h": level(1, 0, 0), "rank": [2, 0, 1]}),
    "two ways where one of the starts is": (
        model(row(0, 0, [1], 1), row(1, 0, [1]), row(2, 0, [1], 1), row(2, 1, [1], 1),
              start={"0": "1/2", "2": "1/2"}), False,
        {"h": level(1, 0, 1), "rank": [1, 0, 1]}),
    "two actions at the end": (
        model(row(0, 0, [1], 1), row(1, 0, [1]), row(1, 1, [1])), True,
        {"h": level(1, 0), "rank": [1, 0]}),
    "two ways, one of which bears less in the end": (
        model(row(0, 0, [0], 1), row(0, 1, [0])), True,
        {"g": level(1), "h": level(0), "w": level(0), "kind": "average"}),
    "two that are as good in the long run, of unlike bias": (
        model(row(0, 0, [1], 1), row(0, 1, [1], 2), row(1, 0, [1], 1)), True,
        {"g": level(1, 1), "h": level(1, 0), "w": level(-1, 0), "kind": "average",
         "policy": [1, 0]}),
    "two of the same gain and bias": (
        model(row(0, 0, [0]), row(0, 1, [1]), row(1, 0, [1]), row(1, 1, [0])), False,
        {"g": level(0, 0), "h": level(0, 0), "w": level(0, 0)}),
}  # fmt: skip


@pytest.mark.parametrize("what", UNIQUE)
def test_an_optimum_is_unique_where_each_state_met_has_one_optimal_pair(what: str) -> None:
    given, unique, parts = UNIQUE[what]
    value = (parts["g"] if parts.get("kind") == "average" else parts["h"])["top"][0]
    proof = claim(given, value, unique=unique, **parts)
    assert violations(given, proof) == []
    said = f"it says wrongly that the optimum is {'not ' if unique else ''}unique"
    assert violations(given, proof | {"unique": not unique}) == [said]


def test_infinite_totals_are_of_the_pairs_that_keep_the_sign_of_their_mean() -> None:
    both = model(row(0, 0, [0], 1), row(0, 1, [0], 2), row(0, 2, [1], 9), row(1, 0, [1]))
    proof = claim(both, "inf", policy=[1, 0], g=level(2, 0), h=level(0, 0), w=level(0, 0),
                  unique=False)  # fmt: skip
    assert violations(both, proof) == []  # each of the first two is worth +∞
    assert violations(both, proof | {"unique": True}) != []
    one = model(row(0, 0, [0], 1), row(0, 2, [1], 9), row(1, 0, [1]))
    parts: Any = {"g": level(1, 0), "h": level(0, 0), "w": level(0, 0)}
    assert violations(one, claim(one, "inf", **parts)) == []
    never = model(row(0, 0, [0], -1), row(0, 1, [0], -2))
    parts = {"g": level(-1), "h": level(0), "w": level(0)}
    assert violations(never, claim(never, "-inf", unique=False, **parts)) == []
    costs = never | {"sense": "min"}
    parts = {"g": level(2), "h": level(0), "w": level(0), "policy": [1]}
    assert violations(costs, claim(costs, "-inf", unique=False, **parts)) == []
    average = claim(costs, "-2", kind="average", **parts)
    assert violations(costs, average) == []


def test_starts_of_both_infinities_have_no_value() -> None:
    given = model(row(0, 0, [0], 1), row(1, 0, [1], -1), start={"0": "1/2", "1": "1/2"})
    for value in ("inf", "-inf", 0):
        proof = claim(given, value, g=level(1, -1), h=level(0, 0), w=level(0, 0))
        assert violations(given, proof) == ["the start value is not that of the start states"]


def test_rules_of_a_goal_hold_for_pairs_that_come_nearer() -> None:
    """+∞ by falling order, then in order 0; -∞ by falling order; and what both lead to."""
    most = model(row(0, 0, [1, 3]), row(0, 1, [3]), row(1, 0, [2]), row(2, 0, [2], -1),
                 row(2, 1, [3], 5), row(3, 0, [3]), goal=[3], **MOST)  # fmt: skip
    parts = {"h": level(0, 0, 0, 0), "rank": [0] * 4, "infinite": [1, 1, 1, 0],
             "order": [2, 1, 0, 0]}  # fmt: skip
    assert violations(most, claim(most, "inf", **parts)) == []
    assert violations(most, claim(most, "inf", **parts | {"order": [1, 0, 0, 0]})) == []
    for order in ([1, 1, 0, 0], [0, 0, 0, 0], [2, 1, 1, 0]):
        assert violations(most, claim(most, "inf", **parts | {"order": order})) != []
    least = model(row(0, 0, [1, 2]), row(1, 0, [1]), row(2, 0, [2]), row(3, 0, [0, 3]),
                  row(3, 1, [2, 4], 1), row(4, 0, [4], 2), row(4, 1, [2]), start={"0": 1},
                  goal=[2], **LEAST)  # fmt: skip
    parts = {"h": level(0, 0, 0, 0, 0), "rank": [0, 0, 0, 1, 1], "infinite": [-1, -1, 0, 1, 1],
             "order": [1, 0, 0, 1, 0], "policy": [0, 0, 0, 1, 0]}  # fmt: skip
    assert violations(least, claim(least, "-inf", **parts)) == []
    for infinite in ([-1, 0, 0, 1, 1], [-1, -1, 0, 0, 1], [-1, -1, 0, 1, 0], [0, -1, 0, 1, 1]):
        assert violations(least, claim(least, "-inf", **parts | {"infinite": infinite})) != []
    for order in ([0, 0, 0, 1, 0], [1, 0, 0, 0, 0], [1, 0, 0, 1, 1]):
        assert violations(least, claim(least, "-inf", **parts | {"order": order})) != []
    for rank in ([0, 0, 0, 1, 1], [0, 0, 0, 0, 0], [1, 1, 1, 1, 1]):
        assert violations(least, claim(least, "-inf", **parts | {"rank": rank})) == []


def test_pairs_that_leave_a_gain_or_the_way_to_the_goal_are_not_optimal() -> None:
    gains = model(row(0, 0, [0], 1), row(0, 1, [1]), row(0, 2, [1], 5), row(1, 0, [1]), goal=[1],
                  **LEAST)  # fmt: skip
    parts: Any = {"h": level(0, 0), "rank": [1, 0], "infinite": [1, 0], "order": [0, 0]}
    assert violations(gains, claim(gains, "inf", **parts)) == []
    stuck = model(row(0, 0, [1]), row(0, 1, [2], 9), row(1, 0, [1]), row(2, 0, [2]), goal=[1],
                  **LEAST)  # fmt: skip
    parts = {"h": level(0, 0, 0), "rank": [1, 0, 0], "infinite": [0, 0, -1], "order": [0, 0, 0]}
    assert violations(stuck, claim(stuck, 0, **parts)) == []


def test_a_start_may_name_states_in_which_no_run_begins() -> None:
    given = model(row(0, 0, [1], 1), row(1, 0, [1]), start={"0": 1, "1": 0})
    assert violations(given, claim(given, 1, h=level(1, 0), rank=[1, 0])) == []


def test_bounds_lie_on_both_sides() -> None:
    given = model(row(0, 0, [1], 3), row(0, 1, [1], 4), row(1, 0, [1]))
    head = claim(given, 0)
    for key in ("g", "h", "w", "infinite", "order", "start_value", "unique"):
        del head[key]
    for low, high, holds in ((3, 4, True), (2, 9, True), (4, 4, False), (3, 3, False)):
        proof = head | {"kind": "bounds", "low": level(low, 0), "high": level(high, 0),
                        "rank": [1, 0]}  # fmt: skip
        assert (violations(given, proof) == []) is holds
    ends = head | {"kind": "bounds", "low": level(3, -1), "high": level(5, 1), "rank": [1, 0]}
    assert violations(given, ends | {"low": level(2, -1)}) == []
    for part, number in (("low", 1), ("high", -1)):
        said = violations(given, ends | {part: level(9 * number, number)})
        assert "state 1, action 0: an end is not worth 0" in said


def test_kinds_have_the_parts_that_prove_them() -> None:
    """Which levels and ranks prove what, in words; nothing else is looked at."""
    total, goal = model(row(0, 0, [0])), model(row(0, 0, [0]), goal=[0])
    half = total | {"discount": "1/2"}
    zero, ranks = level(0), {"rank": [0], "infinite": [0], "order": [0]}
    three = {"g": zero, "h": zero, "w": zero}
    for given, parts, said in (
        (total, {"h": zero, "rank": [0]}, None), (total, three, None), (half, {"h": zero}, None),
        (goal, {"h": zero} | ranks, None), (goal, {"h": zero, "rank": [0]}, None),
        (total, {}, "no levels prove no total of such a model"),
        (total, {"h": zero}, "h prove no total of such a model"),
        (half, {"h": zero, "rank": [0]}, "h, rank prove no total of such a model"),
        (half, three, "g, h, w prove no total of such a model"),
        (goal, three, "g, h, w prove no total of such a model"),
        (total, {"h": zero} | ranks, "h, rank, order, infinite prove no total of such a model"),
        (total, three | {"rank": [0]}, "g, h, w, rank prove no total of such a model"),
        (total, {"g": zero, "h": zero}, "g, h prove no total of such a model"),
    ):  # fmt: skip
        assert violations(given, claim(given, 0, **parts)) == ([said] if said else [])
    for given in (total, goal, half):
        assert violations(given, claim(given, 0, kind="average", **three)) == []
        said = "h, rank prove no average of such a model"
        parts = {"h": zero, "rank": [0]}
        assert violations(given, claim(given, 0, kind="average", **parts)) == [said]
        said = "h, rank, order, infinite prove no average of such a model"
        assert violations(given, claim(given, 0, kind="average", h=zero, **ranks)) == [said]


def test_what_is_said_of_a_policy_and_of_another_model() -> None:
    given = model(row(0, 0, [0]), row(1, 2, [1]))
    parts = {"h": level(0, 0), "rank": [0, 0]}
    assert violations(given, claim(given, 0, policy=[0, 2], **parts)) == []
    for policy, state in (([0, 0], 1), ([1, 2], 0), ([2, 0], 0), ([-1, 2], 0)):
        said = [f"state {state}: the policy takes an action that there is not"]
        assert violations(given, claim(given, 0, policy=policy, **parts)) == said
    other = claim(given, 0, policy=[0, 2], **parts)
    for change in ({"sense": "min"}, {"model": "0" * 64}, {"model": None}):
        assert violations(given, other | change) == ["the certificate belongs to another model"]
    many = model(*(row(s, 0, [s]) for s in range(30)))
    wrong = violations(many, claim(many, 1, h=level(*[1] * 30), rank=[0] * 30))
    assert wrong == [f"state {s}, action 0: an end is not worth 0" for s in range(20)]


# ---- what is read --------------------------------------------------------------------------------

GOOD = model(row(0, 0, [1], 1), row(1, 0, [1]))
SOUND = claim(GOOD, 1, h=level(1, 0), rank=[1, 0])


def unread(given: Any, certificate: Any) -> str:
    with pytest.raises(Unreadable) as caught:
        violations(given, certificate)
    return str(caught.value)


@pytest.mark.parametrize("version", [2.0, True, "2", None, 1, 3, [2]])
@pytest.mark.parametrize("kind", ["model", "certificate"])
def test_version_2_is_an_integer(kind: str, version: Any) -> None:
    assert violations(GOOD, SOUND) == []
    changed = {"model": GOOD, "certificate": SOUND}
    changed[kind] = changed[kind] | {"version": version}
    said = f"no {kind}: format and version are ['exact-mdp {kind}', {version!r}]"
    assert unread(*changed.values()) == said


@pytest.mark.parametrize("given", [None, [], "exact-mdp model", 2, {}, SOUND])
def test_what_is_no_model_says_so(given: Any) -> None:
    assert unread(given, SOUND).startswith("no model: format and version are ")
    assert unread(GOOD, GOOD if given is SOUND else given).startswith("no certificate: ")


def pair(**changes: Any) -> File:
    """A model whose first pair is changed."""
    first, *others = GOOD["pairs"]
    return GOOD | {"pairs": [first | changes, *others]}


BAD_MODELS: list[tuple[File, str]] = [
    *[(GOOD | {key: value}, "states: not all are integers" if value == "1/2" else "is no number")
      for key, value in (("states", 2.0), ("states", True), ("states", "1/2"), ("states", None))],
    *[(GOOD | {"discount": x}, "discount: ") for x in (1.0, True, None, "0.5", "1/0", "007")],
    *[(GOOD | {"discount": x}, "the discount is not from 0 to 1") for x in ("3/2", -1)],
    *[(GOOD | {"sense": x}, "sense is neither max nor min") for x in ("most", None, 1)],
    *[(GOOD | {"unreached": x}, "unreached is neither inf nor -inf") for x in ("5", 0, None)],
    *[(GOOD | {"start": x}, "start is no object") for x in ([1], None, "0")],
    *[(GOOD | {"pairs": x}, "pairs no list with a pair of each state") for x in ([], None, {})],
    (GOOD | {"states": 3}, "pairs no list with a pair of each state"),
    *[(GOOD | {"start": x}, "start: no distribution of states")
      for x in ({"0": "1/2"}, {"0": 2, "1": -1}, {"7": 1}, {"-1": 1}, {"0": 1, "1": "1/9"})],
    *[(GOOD | {"start": x}, "start: ") for x in ({"0": 1.0}, {"0": True}, {"a": 1}, {"1/2": 1})],
    (GOOD | {"start": {}}, "start: no distribution of states"),
    *[({k: v for k, v in GOOD.items() if k != key}, f"keys missing, or too many: {key}")
      for key in ("states", "discount", "sense", "start", "pairs")],
    *[(pair(**{key: x}), what) for key, x, what in (
        ("state", True, "a pair: 'True' is no number"), ("action", 0.0, "a pair: '0.0' is no"),
        ("denominator", 1.0, "a pair: '1.0' is no"), ("next", [1.0], "state 0, action 0: '1.0'"),
        ("next", [True], "state 0, action 0: 'True' is no number"), ("next", 1, "no list"),
        ("weight", [1.0], "state 0, action 0: '1.0'"), ("weight", [True], "'True' is no number"),
        ("reward", 0.5, "state 0, action 0: '0.5' is no number"),
        ("reward", True, "state 0, action 0: 'True' is no number"),
        ("reward", [1.0], "state 0, action 0: '1.0' is no number"),
        ("reward", None, "is no number"), ("reward", [1, 1], "the number of rewards"),
        ("reward", [], "the number of rewards"),
        ("weight", [2], "weights, not one for each, above 0"), ("weight", [], "weights, not one"),
        ("weight", [0], "weights, not one for each"), ("denominator", 2, "weights, not one"),
        ("next", [2], "a next state is none"), ("next", [-1], "a next state is none"),
        ("next", [1, 0], "weights, not one for each"), ("state", 1, "two pairs have the same"),
        ("state", 2, "the states are not 0, 1"), ("state", -1, "the states are not 0, 1"),
    )],
    (pair(next=[1, 0], weight=[2, -1]), "weights, not one for each, above 0"),
    (pair(next=[1, 0], weight=[1, 0]), "weights, not one for each, above 0"),
    (pair(next=[], weight=[], denominator=0), "weights, not one for each, above 0"),
    (pair(more=1), "a pair: keys missing, or too many: more"),
    (GOOD | {"goal": [0]}, "the goal"), (GOOD | {"goal": [2]}, "the goal"),
    (GOOD | {"goal": [1], "discount": "1/2"}, "the goal"),
    (GOOD | {"goal": [1.0]}, "goal: '1.0' is no number"), (GOOD | {"goal": [True]}, "'True' is no"),
    (GOOD | {"goal": 1}, "goal: no list"),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(BAD_MODELS)))
def test_what_is_no_model_is_refused_in_words(number: int) -> None:
    given, said = BAD_MODELS[number]
    assert said in unread(given, SOUND)


def put(key: str, **changes: Any) -> File:
    return SOUND | {key: SOUND[key] | changes}


BAD_CERTIFICATES: list[tuple[File, str]] = [
    *[(SOUND | {"kind": x}, "no kind of total, average, bounds") for x in ("front", None, 2)],
    (SOUND | {"more": 1}, "the certificate: keys missing, or too many: more"),
    ({k: v for k, v in SOUND.items() if k != "g"}, "keys missing, or too many: g"),
    *[(SOUND | {key: x}, f"{key}: ") for key in ("policy", "rank", "order", "infinite")
      for x in ([1.0, 0], [True, 0], [1], [1, 0, 0], 1, "10", ["1/2", 0], [None, 0])],
    (SOUND | {"policy": None}, "policy: no list"),
    *[(SOUND | {key: [1, -1]}, "a rank is negative") for key in ("rank", "order")],
    *[(SOUND | {"start_value": x}, "start_value: ") for x in (1.0, True, None, "nan", "1/0")],
    *[(put("h", top=x), "h.top: ") for x in ([1.0, 0], [True, 0], [1], [1, 0, 0], None)],
    *[(put("h", below=x), "h.below: ") for x in ([1.0], [True], 1, None)],
    *[(put("h", group=x), "h.group: ") for x in ([0.0, 0], [False, 0], [0], None)],
    *[(put("h", **x), "h: a number below is not positive, or those are not the groups'") for x in (
        {"below": [0]}, {"below": [-1]}, {"below": [1, 7]}, {"group": [0, 1]}, {"below": []},
        {"group": [1, 1]}, {"group": [-1, -1]},
    )],
    (put("h", more=1), "h: keys missing, or too many: more"),
    (SOUND | {"h": [1, 0]}, "h: keys missing, or too many: below, group, top"),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(BAD_CERTIFICATES)))
def test_what_is_no_certificate_is_refused_in_words(number: int) -> None:
    certificate, said = BAD_CERTIFICATES[number]
    assert said in unread(GOOD, certificate)


def test_numbers_are_read_as_the_format_says() -> None:
    for text, value in {
        7: F(7), -7: F(-7), "7": F(7), "-7": F(-7), "1/3": F(1, 3), "-2/6": F(-1, 3), "0": F(0),
        "0x1f": F(31), "-0x1f/0x2": F(-31, 2), "10/0x5": F(2), 10**4000: F(10**4000),
    }.items():  # fmt: skip
        assert checker.ratio(text, "it") == value
    for text in ("", "1.5", "1/", "/2", "+1", " 1", "1 ", "0X1F", "1/-3", "1/0", "007", "1e3",
                 "inf", "9" * 5000, None, 1.0, True, [1], F(1, 3)):  # fmt: skip
        with pytest.raises(Unreadable, match=r"it: .* is no number; long ones as 0x"):
            checker.ratio(text, "it")
    assert checker.integers([1, "0x2", "6/2"], "it") == [1, 2, 3]
    assert checker.integers([], "it") == checker.integers([], "it", 0) == []
    for given, length in ((["1/2"], None), ([1], 2), ((1,), None), ({1: 1}, None), ([1], 0)):
        with pytest.raises(Unreadable):
            checker.integers(given, "it", length)
    assert checker.once([("a", 1), ("b", 2)]) == {"a": 1, "b": 2}
    assert checker.once([]) == {}
    with pytest.raises(Unreadable, match="'b' is written twice"):
        checker.once([("a", 1), ("b", 2), ("b", 3)])


# ---- arithmetic ----------------------------------------------------------------------------------


def random_model(rng: np.random.Generator) -> MDP:
    size, rows = int(rng.integers(1, 5)), list[Any]()
    for s in range(size):
        for a in sorted(rng.choice(4, rng.integers(1, 4), replace=False).tolist()):
            count = int(rng.integers(1, 4))
            weights = rng.integers(1, 7, count).tolist()
            law = [
                (F(w, sum(weights)), int(rng.integers(0, size)),
                 F(int(rng.integers(-9, 10)), int(rng.integers(1, 5))))
                for w in weights
            ]  # fmt: skip
            rows.append((s, a, law))
    start = rng.integers(0, 4, size)
    start[rng.integers(0, size)] += 1
    chances = [F(int(x), int(start.sum())) for x in start]
    rate = ("0", "1/2", "9/10", "1")[int(rng.integers(0, 4))]
    return MDP.from_outcomes(rows, rate, start=chances, sense=("max", "min")[int(rng.integers(2))])


def test_a_model_is_read_as_its_rows_say() -> None:
    """And its hash is that of the package, which is computed in another way."""
    rng = np.random.default_rng(0)
    for _ in range(40):
        mdp = random_model(rng)
        given = model_json.encode_model(mdp)
        given["pairs"].reverse()
        read = Model(given)
        assert read.digest() == fingerprint(mdp)
        assert read.discount == mdp.discount_exact
        for number, (s, a, reward, law) in enumerate(rows_of(mdp)):
            assert (read.state[number], read.action[number]) == (s, a)
            assert F(read.top[number], read.below[number]) == reward
            moves = zip(read.next[number], read.weight[number], strict=True)
            assert {t: F(w, read.under[number]) for t, w in moves} == dict(law)
            assert read.next[number] == sorted(law)
            assert read.pair[s, a] == number
        absorbing = [all(r == 0 and {*law} == {s} for t, _, r, law in rows_of(mdp) if t == s)
                     for s in range(mdp.n_states)]  # fmt: skip
        assert read.ends == {s for s, ends in enumerate(absorbing) if ends}
        assert read.start == [(int(s), p) for s, p in mdp.start if p]


def test_a_model_is_read_alike_from_texts_and_from_numbers() -> None:
    """Integers of 2^53 and above are texts in a file, and numbers in the same process."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        rows = rng.random((2, 3, 3))
        gains = rng.standard_normal((2, 3, 3)) * 10.0 ** rng.integers(-20, 20)
        mdp = MDP.from_arrays(rows / rows.sum(axis=2, keepdims=True), gains, rng.random())
        written = model_json.encode_model(mdp)
        handed = model_json.list_problem(mdp)
        assert any(type(x) is str for pair in written["pairs"] for x in pair["weight"])
        assert {type(x) for pair in handed["pairs"] for x in pair["weight"]} == {int}
        assert Model(written).digest() == Model(handed).digest() == fingerprint(mdp)
    rows: Any = [(0, 0, [("1/2", 0, "6/2"), ("1/2", 1, "1/3")]), (1, 0, [(1, 1, 0)])]
    one, other = model_json.list_problem(MDP.from_outcomes(rows, "1/2"))["pairs"]
    assert (one["reward"], other["reward"]) == ([3, F(1, 3)], 0)
    assert [type(x) for x in (*one["reward"], other["reward"])] == [int, F, int]


def test_hashes_tell_goals_and_what_missing_them_is_worth() -> None:
    ends = [row(0, 0, [1]), row(1, 0, [1]), row(2, 0, [2])]
    models = [
        model(*ends),
        *(
            model(*ends, goal=goal, unreached=worth)
            for goal in ([1], [2], [1, 2], [])
            for worth in ("inf", "-inf")
        ),
    ]
    assert len({Model(given).digest() for given in models}) == len(models) == 9
    assert Model(models[0] | {"goal": None}).digest() == Model(models[0]).digest()
    again = Model(model(*ends, goal=[2, 1]))
    assert again.digest() == Model(model(*ends, goal=[1, 2], unreached="inf")).digest()


def test_levels_are_weighted_as_fractions_are() -> None:
    rng = np.random.default_rng(1)
    for _ in range(40):
        states, groups = int(rng.integers(1, 6)), int(rng.integers(1, 4))
        group = [*range(groups), *rng.integers(0, groups, states).tolist()]
        top = rng.integers(-9, 10, len(group)).tolist()
        below = rng.integers(1, 9, groups).tolist()
        given = Level({"top": top, "below": below, "group": group}, "it", len(group))
        for _ in range(2):  # what is kept of the first time is right the second time
            chosen = rng.integers(0, len(group), 3).tolist()
            weights = [F(int(n), 5) for n in rng.integers(-4, 5, 3)]
            wanted = sum((w * F(top[s], below[group[s]])
                          for w, s in zip(weights, chosen, strict=True)), F(0))  # fmt: skip
            number, unit = given.weigh(weights, chosen)
            assert F(number) / unit == wanted


def test_gains_have_the_sign_of_the_equation() -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        mdp = random_model(rng)
        read, rows = Model(model_json.encode_model(mdp)), rows_of(mdp)
        states, sign = mdp.n_states, 1 if mdp.sense == "max" else -1
        group = [int(s % 2) for s in range(states)]
        below = rng.integers(1, 5, len({*group})).tolist()
        top = rng.integers(-5, 6, states).tolist()
        values = Level({"top": top, "below": below, "group": group}, "it", states)
        numbers = [F(t, below[k]) for t, k in zip(top, group, strict=True)]
        for number, (s, _, reward, law) in enumerate(rows):
            for rate in (F(1), F(2, 3)):
                ahead = rate * mean(law, numbers) - numbers[s]
                for earned, other in ((sign * reward, None), (F(-2, 3), (-2, 3)), (F(0), (0, 1))):
                    gain = read.gain(rate, number, values, other)
                    wanted = earned + ahead
                    assert isinstance(gain, int)
                    assert (gain > 0, gain < 0) == (wanted > 0, wanted < 0)


def test_the_start_value_is_the_mean_over_the_start() -> None:
    given = model(
        row(0, 0, [1], 3), row(1, 0, [1]), row(2, 0, [1], 5), start={"0": "1/4", "2": "3/4"}
    )
    parts = {"h": level(3, 0, 5), "rank": [1, 0, 1]}
    assert violations(given, claim(given, "9/2", **parts)) == []
    check = Check(Model(given), claim(given, "9/2", **parts))
    assert (check.at_start(), check.start) == (F(9, 2), F(9, 2))
    parts = {"g": level(3, 0, 5), "h": level(0, 0, 0), "w": level(0, 0, 0)}
    assert Check(Model(given), claim(given, 0, kind="average", **parts)).at_start() == F(9, 2)
    assert Check(Model(given), claim(given, 0, **parts)).at_start() == inf


# ---- the regret of a policy ----------------------------------------------------------------------


def regret(given: File, best: File, own: File, lost: Any) -> File:
    """A certificate of what the policy loses that takes the last action of each state."""
    pairs = {pair["state"]: number for number, pair in enumerate(given["pairs"])}
    policy = {"pairs": [*pairs.values()], "weights": level(*[1] * given["states"])}
    alone = Model(given).isolate(given, policy).digest()
    parts = {"optimum": claim(given, **best), "value": claim(given, **own) | {"model": alone}}
    for part in parts.values():
        del part["format"], part["version"]
    head = {"format": "exact-mdp certificate", "version": 2, "kind": "regret"}
    said = {"model": Model(given).digest(), "sense": given["sense"], "policy": policy}
    return head | said | parts | {"regret": lost}


UNLIKE = "the regret is not the difference of an optimum and a value that are proven alike"


def test_a_regret_is_of_an_optimum_and_a_value_that_are_proven_alike() -> None:
    given = model(row(0, 0, [1], 3), row(0, 1, [1], 1), row(1, 0, [1]))
    zero, alone = level(0, 0), {"h": level(1, 0), "rank": [1, 0]}
    best = {"value": 3, "h": level(3, 0), "rank": [1, 0]}
    levels = {"g": zero, "h": level(1, 0), "w": level(-1, 0)}
    assert violations(given, regret(given, best, {"value": 1, **alone}, 2)) == []
    for wrong in (3, 1, 0, -2, "inf"):
        assert violations(given, regret(given, best, {"value": 1, **alone}, wrong)) == [UNLIKE]
    assert violations(given, regret(given, best, {"value": 1, **levels}, 2)) == [UNLIKE]


def test_beside_an_infinite_optimum_a_finite_value_does_not_count() -> None:
    given = model(row(0, 0, [0], 1), row(0, 1, [1], 3), row(1, 0, [1]))
    best = {"value": "inf", "g": level(1, 0), "h": level(0, 0), "w": level(0, 0)}
    own = {"value": 3, "g": level(0, 0), "h": level(3, 0), "w": level(-3, 0)}
    assert violations(given, regret(given, best, own, "inf")) == []
    for wrong in (3, -3, 0, "-inf"):
        assert violations(given, regret(given, best, own, wrong)) == [UNLIKE]


# ---- on the command line -------------------------------------------------------------------------


def test_the_exit_status_says_whether_it_holds(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def run(given: Any, certificate: Any) -> tuple[int, str, str]:
        paths = tmp_path / "model.json", tmp_path / "proof.json"
        for path, content in zip(paths, (given, certificate), strict=True):
            text = content if isinstance(content, str) else json.dumps(content)
            path.write_text(text, "utf-8-sig")
        status = checker.main([*map(str, paths)])
        return status, *capsys.readouterr()

    assert run(GOOD, SOUND) == (0, "holds\n", "")
    wrong = SOUND | {"start_value": 2, "unique": False}
    assert run(GOOD, wrong) == (
        1, "does not hold: the start value is not that of the start states\n"
        "does not hold: it says wrongly that the optimum is not unique\n", "",
    )  # fmt: skip
    status, out, err = run(GOOD, SOUND | {"version": 2.0})
    assert (status, out) == (2, "")
    assert err.startswith("not checked: no certificate: format and version are ")
    bad: dict[str, str] = {"{": "proof.json: ", '{"a": 1, "a": 2}': "'a' is written twice",
                           "[" * 100_000: "proof.json: "}  # fmt: skip
    for text, said in bad.items():
        status, out, err = run(GOOD, text)
        assert (status, out, said in err) == (2, "", True)
    for words in ([], ["model.json"], ["a", "b", "c"]):
        assert checker.main(words) == 2
        assert capsys.readouterr().err == (
            "not checked: give two files: model.json certificate.json\n"
        )
    assert checker.main(["there-is-none", "nor-this"]) == 2
    assert "there-is-none" in capsys.readouterr().err
    load: Callable[[str], Any] = {"a model": GOOD}.__getitem__
    (tmp_path / "proof.json").write_text(json.dumps(SOUND), "utf-8")
    assert checker.main(["a model", str(tmp_path / "proof.json")], load) == 0
