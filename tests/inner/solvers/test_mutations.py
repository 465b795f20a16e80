"""Certificates of every kind with one thing changed: none is accepted whose claim is false."""

from __future__ import annotations

import json
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from made_models import under

from exact_mdp import MDP, Certificate, ModelError, best_cvar, certify, rationalize, solve, tradeoff
from exact_mdp.analysis.cli.policies import KINDS
from exact_mdp.mdp.io import model_json
from exact_mdp.solvers.exact import checker, codec

LOOP = [
    (0, 0, [("1/2", 0, 1), ("1/2", 1, 0)]),
    (0, 1, [(1, 1, 1)]),
    (1, 0, [("1/3", 0, 2), ("2/3", 1, -1)]),
    (1, 1, [(1, 2, 0)]),
    (2, 0, [(1, 2, 0)]),
]
TIES = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 2, 3)]), (2, 0, [(1, 2, 0)])]
ISLANDS = [
    (0, 0, [(1, 1, 0)]),
    (0, 1, [("1/2", 2, 5), ("1/2", 3, 0)]),
    (1, 0, [(1, 1, 1)]),
    (2, 0, [(1, 2, -1)]),
    (2, 1, [(1, 3, "-1/3")]),
    (3, 0, [(1, 3, 0)]),
    (4, 0, [(1, 4, -1)]),
    (4, 1, [("1/2", 4, 0), ("1/2", 3, 2)]),
]
TURNS = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, -1)]), (1, 1, [(1, 2, 0)]), (2, 0, [(1, 2, 0)])]
WALK = [
    (0, 0, [(1, 0, -1)]),
    (0, 1, [("1/2", 1, -2), ("1/2", 0, 0)]),
    (1, 0, [("2/3", 2, -1), ("1/3", 0, 0)]),
    (2, 0, [(1, 2, 0)]),
    (3, 0, [(1, 3, 0)]),
    (3, 1, [("1/2", 2, 4), ("1/2", 3, 0)]),
    (4, 0, [("1/2", 3, 0), ("1/2", 5, 0)]),
    (5, 0, [(1, 5, 1)]),
]
RICH = [*WALK[:5], (3, 1, [("1/2", 2, 4), ("1/2", 6, 0)]), *WALK[6:], (6, 0, [(1, 6, 1)]),
        (6, 1, [(1, 2, 0)])]  # fmt: skip
GOAL = {"goal": [state == 2 for state in range(6)]}


def negated(rows: Any) -> Any:
    return [(s, a, [(p, t, -r) for p, t, r in outcomes]) for s, a, outcomes in rows]


def of(rows: Any, **parts: Any) -> MDP:
    return MDP.from_outcomes(rows, **parts)


MODELS: dict[str, tuple[MDP, dict[str, Any]]] = {
    "discounted": (of(LOOP, discount="1/2"), {}),
    "least costs": (of(LOOP, discount="9/10", sense="min", start=["1/2", "1/2", 0]), {}),
    "every policy ends": (of(TIES), {}),
    "islands": (of(ISLANDS, start=[1, 0, 0, 0, 0]), {}),
    "a costly island": (of(ISLANDS, sense="min", start=[0, 0, 0, 0, 1]), {}),
    "rewards cancel": (of(TURNS), {}),
    "average": (of(ISLANDS), {"criterion": "average"}),
    "least average": (of(LOOP, sense="min", discount="1/3"), {"criterion": "average"}),
    "goal, rewards": (of(WALK, labels=GOAL).until("goal"), {}),
    "goal, costs": (
        of(negated(WALK), labels=GOAL, sense="min", start=[0, 1, 0, 0, 0, 0]).until("goal"), {},
    ),
    "goal, costs that fall": (
        of(negated(RICH), labels={"goal": [*GOAL["goal"], False]}, sense="min",
           start=[0, 1, 0, 0, 0, 0, 0]).until("goal"), {},
    ),
    "reaching": (of(LOOP, labels={"goal": [False, True, False]}).reaching("goal"), {}),
    "within": (of(LOOP).within(2), {}),
    "the worst episodes": (best_cvar(of(TIES, start=["1/2", "1/2", 0]), "1/2").certificate.mdp, {}),
    "the worst episodes of costs": (
        best_cvar(of(LOOP, sense="min"), "1/3", weight="1/4", horizon=1).certificate.mdp, {},
    ),
    "bounds": (of(LOOP, discount="1/2"), {"bounded": True}),
    "bounds of costs": (of(TIES, sense="min"), {"bounded": True}),
}  # fmt: skip


def changes(value: Any) -> Iterator[Any]:
    """Yield values of the same type, or of another that a field may have."""
    if isinstance(value, bool):
        yield not value
    elif isinstance(value, int):
        yield from (value + 1, value - 1, -value - 1, 2 * value + 1, 0)
    elif isinstance(value, str) and "/" in value:
        number = Fraction(*(int(part, 16) for part in value.split("/")))
        for other in (number + 1, number - 1, -number, number / 2, Fraction(0)):
            yield f"{hex(other.numerator)}/{hex(other.denominator)}"
        yield from ("inf", "-inf")
    elif value in ("inf", "-inf"):
        yield from ("0x0/0x1", "-inf" if value == "inf" else "inf")
    elif isinstance(value, str) and value.lstrip("-").startswith("0x"):
        number = int(value, 16)
        yield from map(hex, (number + 1, number - 1, -number, 2 * number, number // 2, 0))
    elif isinstance(value, str):
        yield from (value[::-1], value[:-1] + "0", "max", "min", "total", "average")
    elif isinstance(value, list):
        for i, each in enumerate(value):
            for other in changes(each):
                yield [*value[:i], other, *value[i + 1 :]]
            if i:
                yield [*value[: i - 1], each, value[i - 1], *value[i + 1 :]]
        yield from (value[:-1], [*value, *value[-1:]], value[::-1], None)
        if value and isinstance(value[0], int):
            yield from ([0] * len(value), [each + 1 for each in value])
        elif value and isinstance(value[0], str) and value[0].lstrip("-").startswith("0x"):
            yield [hex(2 * int(each.partition("/")[0], 16)) for each in value]
    elif isinstance(value, dict):
        for key, each in value.items():
            for other in changes(each):
                yield value | {key: other}
        yield None


def mutants(content: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield a file with one field changed, also by what another field has."""
    states = len(content["policy"])
    level = {"top": ["0x0"] * states, "below": ["0x1"], "group": [0] * states}
    for key, value in content.items():
        for other in changes(value):
            yield content | {key: other}
        for same in ("g", "h", "w", "low", "high"):
            if key in ("g", "h", "w", "low", "high") and content.get(same) not in (None, value):
                yield content | {key: deepcopy(content[same])}
        if value is None:
            yield content | {key: level if key in ("g", "h", "w") else [0] * states}
            yield content | {key: [1] * states}


def claims(content: dict[str, Any], mdp: MDP, folder: Path) -> tuple[Any, ...]:
    """Return what a certificate that was accepted says of the model, and what is true of that."""
    kind = content["kind"]
    if kind == "bounds":
        best = certify(mdp).value
        low, high = (
            [Fraction(int(top, 16), int(content[key]["below"][group], 16))
             for top, group in zip(content[key]["top"], content[key]["group"], strict=True)]
            for key in ("low", "high")
        )  # fmt: skip
        sign = 1 if mdp.sense == "max" else -1
        true = all(a <= sign * v <= b for a, v, b in zip(low, best, high, strict=True))
        own = certify(under(mdp, content["policy"])).value
        true &= all(a <= sign * v for a, v in zip(low, own, strict=True))
        return true, True
    asked = {} if kind == "total" else {"criterion": "average"}
    truth = certify(mdp, **asked)
    (folder / "mutant.json").write_text(json.dumps(content), "utf-8")
    said = Certificate.load(folder / "mutant.json", mdp)
    own = certify(under(mdp, content["policy"]), **asked)
    values = [list(said.value), list(said.bias) if kind == "average" else []]
    right = [list(truth.value), list(truth.bias) if kind == "average" else []]
    attained = [list(own.value), list(own.bias) if kind == "average" else []]
    if content["infinite"] is not None:  # +∞ may be no policy's
        attained[0] = [a if a == r or abs(r) != float("inf") else r
                       for a, r in zip(attained[0], right[0], strict=True)]  # fmt: skip
    return (
        (values, attained, said.start_value, said.unique, said.model, said.sense),
        (right, right, truth.start_value, truth.unique, truth.model, truth.sense),
    )


PARTS = {"a": [0, 5, 1, 7, 2, 3], "b": [4, 1, 6, 2, 5, 5], "c": [1, 0, 2, 2, 0, 1]}
THREE = MDP.from_outcomes(
    [
        (s, a, [("1/2", (s + 1) % 3, PARTS["a"][2 * s + a]), ("1/2", a, PARTS["a"][2 * s + a])])
        for s in range(3)
        for a in (0, 1)
    ],
    "3/4",
    components={"a": PARTS["a"], "b": PARTS["b"]},
)
ENDING = MDP.from_outcomes(
    [(0, 0, [(1, 1, 5)]), (0, 1, [("1/2", 1, 3), ("1/2", 2, 3)]), (1, 0, [(1, 2, 1)]),
     (1, 1, [(1, 2, 2)]), (2, 0, [(1, 2, 0)])],
    components={"a": [5, 3, 1, 2, 0], "b": [0, 1, 4, 1, 0], "c": [1, 2, 0, 1, 0]}, sense="min",
)  # fmt: skip
TOTALS: dict[str, Any] = {
    "front": lambda: tradeoff(THREE, ["a", "b"]),
    "front of costs": lambda: tradeoff(ENDING, ["a", "b", "c"]),
    "limits": lambda: solve(THREE, subject_to={"b": ">= 15"}),
    "limits of costs": lambda: solve(ENDING, subject_to={"b": "<= 3", "c": ">= 1"}),
    "infeasible": lambda: solve(THREE, subject_to={"b": ">= 600"}),
    "weights": lambda: rationalize(THREE, "always:0"),
    "weights of costs": lambda: rationalize(ENDING, {"0": "1", "1": "0", "2": "0"}),
}


def proven(proof: Any) -> list[Any]:
    """What a proof about totals proves."""
    if proof.kind == "front":
        return [proof.vertices, proof.edges, sorted(proof.facets)]
    if proof.kind == "weights":
        earned = dict(zip(proof.of.names, proof.flow.totals(proof.of), strict=True))
        return [proof.change, proof.weights, proof.alone, earned]
    return [proof.start_value, proof.totals, proof.prices, proof.closest]


def truth(proof: Any, made: Any) -> list[Any]:
    """What is true of what a proof is about: a limit may be changed, too."""
    if proof.kind == "limits":
        named = {limit.name: str(limit).removeprefix(limit.name) for limit in proof.limits}
        made = solve(made.mdp, subject_to=named)
    return proven(made)


@pytest.mark.parametrize("name", TOTALS)
def test_no_change_of_a_proof_about_totals_is_accepted_that_makes_it_false(
    name: str, tmp_path: Path
) -> None:
    made = TOTALS[name]()
    made.save(path := tmp_path / "proof.json")
    content, refused, tried = json.loads(path.read_text("utf-8")), 0, 0
    other = {"discount": "1/2"} if made.mdp is THREE else {"sense": "max"}
    assert made.violations() == []
    assert made.violations(made.mdp.with_(**other))
    for key, value in content.items():
        for changed in changes(value):
            if changed == value:
                continue
            path.write_text(json.dumps(content | {key: changed}), "utf-8")
            tried += 1
            try:
                forged = replace(codec.load(KINDS, path), mdp=made.mdp)
                wrong = forged.violations()
            except ModelError:
                refused += 1
                continue
            refused += bool(wrong)
            assert wrong or proven(forged) == truth(forged, made), (key, changed)
    assert refused > 0.5 * tried > 50


def test_a_key_that_is_written_twice_is_refused(tmp_path: Path) -> None:
    TOTALS["limits"]().save(path := tmp_path / "proof.json")
    text = path.read_text("utf-8")
    path.write_text(text.replace('"shift":', '"shift": "0x1/0x1", "shift":'), "utf-8")
    with pytest.raises(ModelError, match="'shift' is written twice"):
        codec.load(KINDS, path)
    (tmp_path / "model.json").write_text('{"states": 1, "states": 2}', "utf-8")
    with pytest.raises(checker.Unreadable, match="'states' is written twice"):
        checker.read(str(tmp_path / "model.json"))


@pytest.mark.parametrize("name", MODELS)
def test_no_change_of_a_certificate_is_accepted_that_makes_it_false(
    name: str, tmp_path: Path
) -> None:
    mdp, asked = MODELS[name]
    certify(mdp, **asked).save(path := tmp_path / "proof.json")
    content, model = json.loads(path.read_text("utf-8")), model_json.content(mdp)
    assert checker.violations(model, content) == []
    tried = 0
    for mutant in mutants(content):
        if mutant == content:
            continue
        tried += 1
        try:
            wrong = checker.violations(model, mutant)
        except checker.Unreadable:
            continue
        if not wrong:
            said, true = claims(mutant, mdp, tmp_path)
            assert said == true, {k: v for k, v in mutant.items() if v != content[k]}
    assert tried > 50
