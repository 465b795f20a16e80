"""Proofs of every kind with one thing changed: none is accepted whose claim is false."""

import json
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import replace
from fractions import Fraction
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_models import under
from proof_models import ENDING, ISLANDS, LOOP, MODELS, THREE, TIES, of

from exact_mdp import MDP, ModelError, best_cvar, certify, check, rationalize, solve, tradeoff
from exact_mdp.analysis.cli.policies import KINDS
from exact_mdp.mdp.io import model_json
from exact_mdp.solvers.bounds.gains import compute_advantages
from exact_mdp.solvers.exact import checker, codec

TIED = of(TIES, start=["1/2", "1/2", 0])
PROOFS: dict[str, Callable[[], Any]] = {
    **{name: lambda mdp=mdp: certify(mdp) for name, mdp in MODELS.items()},
    "average": lambda: certify(of(ISLANDS), criterion="average"),
    "least average": lambda: certify(of(LOOP, sense="min"), criterion="average"),
    "the worst episodes": lambda: best_cvar(TIED, "1/2").certificate,
    "the worst episodes of costs": lambda: (
        best_cvar(of(LOOP, sense="min").within(1), "1/3").certificate
    ),
    "bounds": lambda: certify(of(LOOP, discount="1/2"), bounded=True),
    "bounds of costs": lambda: certify(of(TIES, sense="min"), bounded=True),
    "regret": lambda: check(of(LOOP, discount="1/2"), {0: {0: "1/4", 1: "3/4"}, 1: 0}).certificate,
    "regret of costs": lambda: check(of(TIES, sense="min"), {0: {0: "1/2", 1: "1/2"}}).certificate,
    "regret per step": lambda: (
        check(of(ISLANDS), {0: {0: "2/3", 1: "1/3"}, 2: 1, 4: 1}, criterion="average").certificate
    ),
    "front": lambda: tradeoff(THREE, ["a", "b"]),
    "front of costs": lambda: tradeoff(ENDING, ["a", "b", "c"]),
    "limits": lambda: solve(THREE, subject_to={"b": ">= 15"}),
    "limits of costs": lambda: solve(ENDING, subject_to={"b": "<= 3", "c": ">= 1"}),
    "infeasible": lambda: solve(THREE, subject_to={"b": ">= 600"}),
    "weights": lambda: rationalize(THREE, "always:0"),
    "weights of costs": lambda: rationalize(ENDING, {"0": "1", "1": "0", "2": "0"}),
}


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
    states = len(content.get("policy") or [])
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


def claims_of(proof: Any) -> list[Any]:
    """Return what a proof claims."""
    if proof.kind == "front":
        return [proof.vertices, proof.edges, sorted(proof.facets)]
    if proof.kind == "weights":
        earned = dict(zip(proof.of.names, proof.flow.compute_totals(proof.of), strict=True))
        return [proof.change, proof.weights, proof.alone, earned]
    if proof.kind == "limits":
        return [proof.start_value, proof.totals, proof.prices, proof.closest]
    bias = proof.bias.tolist() if proof.kind == "average" else []
    return [proof.value.tolist(), bias, proof.start_value, proof.unique]


def is_true(proof: Any, made: Any) -> bool:
    """Whether it is so, also of the policy and of the limits that the proof names."""
    mdp, kind = made.mdp, proof.kind
    if kind == "regret":
        policy: dict[int, dict[int, Fraction]] = {}
        for pair, share in proof.policy.to_numbers().items():
            state, action = int(mdp.pair_state[pair]), int(mdp.pair_action[pair])
            policy.setdefault(state, {})[action] = share
        own = check(mdp, policy, criterion=proof.criterion).certificate
        mine, yours = (replace(x.value, mdp=None) for x in (proof, own))
        same = claims_of(mine)[:3] == claims_of(yours)[:3] and proof.regret == own.regret
        return same and is_true(replace(proof.optimum, mdp=mdp), made.optimum)
    if kind == "limits":
        named = {limit.name: str(limit).removeprefix(limit.name) for limit in proof.limits}
        made = solve(mdp, subject_to=named)
    if kind in ("front", "weights", "limits"):
        return claims_of(proof) == claims_of(made)
    asked = {"criterion": "average"} if kind == "average" else {}
    own = certify(under(mdp, proof.policy), **asked)
    if kind == "bounds":
        signed = [-1 if mdp.sense == "min" else 1] * mdp.n_states
        each = zip(signed, proof.low.to_fractions(), own.value, certify(mdp).value,
                   proof.high.to_fractions(), strict=True)  # fmt: skip
        return all(low <= sign * x <= sign * v <= high for sign, low, x, v, high in each)
    values, bias = claims_of(own)[:2]
    if proof.infinite is not None:  # +∞ may be no policy's
        both = zip(values, made.value, strict=True)
        values = [v if abs(v) == inf else x for x, v in both]
    return claims_of(proof) == claims_of(made) and claims_of(proof)[:2] == [values, bias]


@pytest.mark.parametrize("name", PROOFS)
def test_no_change_of_a_proof_is_accepted_that_makes_it_false(name: str, tmp_path: Path) -> None:
    made = PROOFS[name]()
    assert made.violations() == []
    assert made.violations(made.mdp.with_(sense="min" if made.mdp.sense == "max" else "max"))
    made.save(path := tmp_path / "proof.json")
    content, model = json.loads(path.read_text("utf-8")), model_json.encode_model(made.mdp)
    by_checker = made.kind in checker.KEYS
    refused = tried = 0
    for mutant in mutants(content):
        if mutant == content:
            continue
        tried += 1
        try:
            wrong = checker.violations(model, mutant) if by_checker else []
            if not wrong:
                path.write_text(json.dumps(mutant), "utf-8")
                forged = replace(codec.load_proof(KINDS, path), mdp=made.mdp)
                wrong = forged.violations()
        except (ModelError, checker.Unreadable):
            wrong = ["it cannot be read"]
        refused += bool(wrong)
        assert wrong or is_true(forged, made), {k: v for k, v in mutant.items() if v != content[k]}
    assert refused > 0.5 * tried > 25


def test_bounds_that_floats_do_not_prove_are_widened(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the values that are given add seems free of roundings, and so is not enough."""
    errors = list[Any]()

    def free_at_first(*given: Any, **more: Any) -> Any:
        added = compute_advantages(*given, **more)
        errors.append(added.error)
        return replace(added, error=0 * added.error) if len(errors) == 1 else added

    monkeypatch.setattr("exact_mdp.solvers.exact.certify.compute_advantages", free_at_first)
    monkeypatch.setattr("exact_mdp.solvers.exact.certify.UNIT", 0.0)
    rng = np.random.default_rng(0)
    mdp = MDP.from_arrays(rng.dirichlet(np.ones(9), (2, 9)), rng.random((9, 2)), 0.9)
    assert certify(mdp, bounded=True).violations() == []
    assert len(errors) > 3  # of these values, and more than once for the bounds
