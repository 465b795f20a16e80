"""Certificates of a policy's regret: beside enumeration in fractions, on files, and false ones."""

import copy
import json
from collections.abc import Callable
from contextlib import suppress
from fractions import Fraction as F
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from altered_certificates import verdicts
from cli_runner import run
from oracle import (
    best_average,
    best_total,
    gain_and_bias,
    mixed,
    policies,
    policy_values,
    rows_of,
    total,
    until,
)
from proof_models import MODELS, of
from small_models import given, random_policy, small_model

from exact_mdp import MDP, Audit, ModelError, certify, check

File = dict[str, Any]


def contents(audit: Audit, folder: Path) -> tuple[File, File]:
    """The model and the certificate of an audit, as their files hold them."""
    audit.mdp.save(folder / "model.json")
    audit.certificate.save(folder / "proof.json")
    model, proof = (
        json.loads((folder / f"{x}.json").read_text("utf-8")) for x in ("model", "proof")
    )
    return model, proof


def at_start(mdp: MDP, values: Any) -> Any:
    """The mean over the start, where a value that is infinite decides."""
    infinite = {values[s] for s, p in mdp.start if p} & {inf, -inf}
    return infinite.pop() if infinite else sum(p * values[s] for s, p in mdp.start)


# ---- beside enumeration --------------------------------------------------------------------------


def value_at(rate: F) -> Callable[[Any], list[Any]]:
    return lambda policy: policy_values(policy, rate)


def best_at(rate: F, sense: str) -> Callable[[Any], list[Any]]:
    def best(rows: Any) -> list[Any]:
        each = [policy_values(policy, rate) for policy in policies(rows)]
        return [(max if sense == "max" else min)(values) for values in zip(*each, strict=True)]

    return best


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("pure", [True, False])
@pytest.mark.parametrize("kind", ["discounted", "ends", "endless", "average"])
def test_the_certificate_is_what_enumeration_finds(
    kind: str, pure: bool, sense: str, seed: int, tmp_path: Path
) -> None:
    parts: Any = {"falling": kind == "ends", "leaving": kind != "endless", "states": 4}
    start = 0 if kind == "endless" else None  # a start that mixes infinities has no value
    parts |= {} if start is None else {"start": start}
    mdp = small_model(seed, F(2, 3) if kind == "discounted" else 1, sense=sense, **parts)
    chances, sign = random_policy(mdp, seed, pure=pure), 1 if sense == "max" else -1
    rows = rows_of(mdp)
    signed = [(s, a, sign * r, law) for s, a, r, law in rows]
    own_rows = mixed(signed, chances)
    if kind == "average":
        best, own = best_average(signed)[0], gain_and_bias(own_rows)[0]
    elif kind == "discounted":
        best, own = best_at(F(2, 3), "max")(signed), value_at(F(2, 3))(own_rows)
    else:
        best, own = best_total(signed), total(own_rows)
    criterion: Any = "average" if kind == "average" else "total"
    most, mine = at_start(mdp, best), at_start(mdp, own)
    if most == mine and abs(most) == inf:
        with pytest.raises(ModelError, match="both infinite"):
            check(mdp, given(chances), criterion=criterion)
        return
    audit = check(mdp, given(chances), criterion=criterion)
    proof = audit.certificate
    lost = inf if inf in (most, -mine) else most - mine
    assert proof.optimum.start_value == sign * most
    assert proof.value.start_value == sign * mine
    assert proof.regret == audit.value.value == lost
    assert proof.value.value.tolist() == [sign * x for x in own]
    assert proof.policy.to_numbers() == {
        pair: chances[key]
        for pair, key in enumerate(zip(mdp.pair_state, mdp.pair_action, strict=True))
        if key in chances
    }
    assert proof.violations() == []
    assert verdicts(*contents(audit, tmp_path)) == (0, 0)
    assert type(proof).load(tmp_path / "proof.json", mdp).regret == lost


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("missing", ["pays", "costs"])
def test_a_policy_that_may_miss_the_goal(missing: str, seed: int, tmp_path: Path) -> None:
    sense = "min" if missing == "costs" else "max"
    states = 6
    mdp = small_model(seed, states=4, sense=sense, start=seed % states)
    ends = np.flatnonzero(mdp.terminal)[:1]
    mdp = mdp.with_(labels={"goal": np.isin(np.arange(states), ends)}).until("goal")
    chances = random_policy(mdp, seed)
    own = at_start(
        mdp, until(mixed(rows_of(mdp), chances), np.isin(np.arange(states), ends).tolist())
    )
    try:
        audit = check(mdp, given(chances))
    except ModelError:
        assert certify(mdp).start_value == own
        return
    assert audit.certificate.value.start_value == own
    assert audit.certificate.optimum.start_value == certify(mdp).start_value
    assert verdicts(*contents(audit, tmp_path)) == (0, 0)


@pytest.mark.parametrize("name", MODELS)
def test_models_of_every_kind(name: str, tmp_path: Path) -> None:
    mdp = MODELS[name]
    audits = list[Audit]()
    named: list[Any] = ["optimal", "random", "always:0", "always:1"]
    for policy in named if name == "within" else [*named, given(random_policy(mdp, 1))]:
        with suppress(ModelError):  # infinite, as the optimum; or not all states have this action
            audits.append(check(mdp, policy))
    assert audits
    for audit in audits:
        assert verdicts(*contents(audit, tmp_path)) == (0, 0)


# ---- false certificates --------------------------------------------------------------------------

HALF = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 1)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]


@pytest.fixture
def honest(tmp_path: Path) -> tuple[File, File]:
    """The model of two states that the page explains, and a policy that loses 4/15."""
    audit = check(of(HALF, discount="1/2"), {0: {0: F(1, 4), 1: F(3, 4)}})
    assert audit.certificate.regret == F(4, 15)
    return contents(audit, tmp_path)


FORGED: dict[str, Callable[[File], object]] = {
    "no regret": lambda proof: proof.update(regret="0x0/0x1"),
    "an infinite regret": lambda proof: proof.update(regret="inf"),
    "a regret below any": lambda proof: proof.update(regret="-inf"),
    "another policy": lambda proof: proof["policy"]["weights"].update(top=["0x3", "0x1", "0x4"]),
    "the value of the optimum": lambda proof: proof.update(value=proof["optimum"], regret=0),
    "a better value": lambda proof: proof["value"].update(start_value="0x4/0x3"),
    "a better level": lambda proof: proof["value"]["h"].update(top=["0x4", "0x0"]),
    "the value as optimum": lambda proof: proof.update(optimum=proof["value"], regret=0),
    "another model": lambda proof: proof["value"].update(model=proof["model"]),
    "another sense": lambda proof: proof["value"].update(sense="min"),
    "an average": lambda proof: proof["value"].update(kind="average"),
    "averages": lambda proof: [proof[x].update(kind="average") for x in ("optimum", "value")],
    "bounds": lambda proof: [proof[x].update(kind="bounds") for x in ("optimum", "value")],
    "an unknown kind": lambda proof: [proof[x].update(kind="x") for x in ("optimum", "value")],
}
BAD: dict[str, Callable[[File], object]] = {
    "no weight for a state": lambda proof: proof.update(
        policy={"pairs": [0], "weights": {"top": [1], "below": [1], "group": [0]}}
    ),
    "weights above 1": lambda proof: proof["policy"]["weights"].update(top=["0x2", "0x3", "0x4"]),
    "weights below 0": lambda proof: proof["policy"]["weights"].update(top=["-0x1", "0x5", "0x4"]),
    "a pair twice": lambda proof: proof["policy"].update(pairs=[0, 0, 2]),
    "pairs out of order": lambda proof: proof["policy"].update(pairs=[1, 0, 2]),
    "a pair that is none": lambda proof: proof["policy"].update(pairs=[0, 1, 3]),
    "no number": lambda proof: proof.update(regret="a lot"),
    "no policy": lambda proof: proof.update(policy=None),
    "no value": lambda proof: proof.update(value=None),
    "a head inside": lambda proof: proof["value"].update(version=2),
    "a key too few": lambda proof: proof["optimum"].pop("rank"),
    "a key too many": lambda proof: proof.update(rank=None),
}


@pytest.mark.parametrize("what", FORGED)
def test_forged_certificates_do_not_hold(what: str, honest: tuple[File, File]) -> None:
    model, proof = honest
    assert verdicts(model, proof) == (0, 0)
    FORGED[what](forged := copy.deepcopy(proof))
    assert forged != proof
    assert verdicts(model, forged) == (1, 1)


@pytest.mark.parametrize("what", BAD)
def test_bad_certificates_are_not_read(what: str, honest: tuple[File, File]) -> None:
    model, proof = honest
    BAD[what](bad := copy.deepcopy(proof))
    assert verdicts(model, bad) == (2, 2)


def test_two_proofs_of_different_kinds_show_no_regret(tmp_path: Path) -> None:
    """A total proven by values and one by gain and bias are not compared."""
    mdp = of([*HALF[:2], (1, 0, [(1, 1, 0)]), (1, 1, [(1, 1, -1)])])
    audit = check(mdp, {0: 1, 1: 0})
    model, proof = contents(audit, tmp_path)
    assert verdicts(model, proof) == (0, 0)
    alone = certify(of([HALF[1], HALF[2]]))
    alone.save(tmp_path / "alone.json")
    other = json.loads((tmp_path / "alone.json").read_text("utf-8"))
    assert other["g"] is None is not proof["value"]["g"]
    for key in ("format", "version"):
        other.pop(key)
    other |= {"model": proof["value"]["model"], "policy": [0, 0]}
    assert verdicts(model, proof | {"value": other}) == (1, 1)


# ---- the command ---------------------------------------------------------------------------------


@pytest.mark.parametrize("more", [(), ("--discount", "9/10"), ("--horizon", "5")])
@pytest.mark.parametrize("policy", ["optimal", "always:wait", "random"])
def test_check_writes_what_verify_accepts(
    policy: str, more: tuple[str, ...], tmp_path: Path
) -> None:
    proof = tmp_path / "proof.json"
    done = run("check", "tea", policy, *more, "--certificate", proof, "--json")
    assert (done.status, done.err) == (1 - done.result["passed"], "")
    read = run("verify", proof, "tea", *more, "--proven", "--json")
    assert (read.status, read.err, read.result["holds"]) == (0, "", True)
    for key in ("exact_regret", "regret", "optimal_value", "learned_value"):
        assert read.result[key] == done.result[key], key
    assert read.result["kind"] == "regret"
    said = f"the policy is worth {done.result['learned_value']:.10g}, the optimum is "
    assert said in run("verify", proof, "tea", *more).out.replace("\n", " ")
    assert run("verify", proof, "tea", "--discount", "1/7").status == 1


def test_of_a_reward_per_step(tmp_path: Path) -> None:
    model, proof = tmp_path / "m.npz", tmp_path / "proof.json"
    of([(0, 0, [(1, 1, 1)]), (0, 1, [(1, 0, 1)]), (1, 0, [(1, 0, 3)])]).save(model)
    done = run("check", model, "always:1", "--criterion", "average", "--certificate", proof)
    assert done.status == 1
    read = run("verify", proof, model, "--proven", "--json").result
    assert (read["exact_regret"], read["criterion"], read["holds"]) == ("1", "average", True)


def test_what_is_not_exact_has_no_certificate(tmp_path: Path) -> None:
    proof = tmp_path / "proof.json"
    mdp = small_model(3, "9/10")
    with pytest.raises(ModelError, match="the regret is bounded, not exact: "):
        _ = check(mdp, "random", exact_values=False).certificate
    for words, said in (
        (("--subject-to", "steps <= 100"), "--subject-to does not apply to a certificate"),
        (("--confidence", "0.95"), "--confidence does not apply to a certificate"),
    ):
        done = run("check", "tea", "optimal", *words, "--certificate", proof)
        assert (done.status, done.out) == (2, "")
        assert said in done.err
    done = run("check", "tea", "optimal", "random", "--certificate", proof)
    assert (done.status, done.out) == (2, "")
    assert "--certificate does not apply to several policies" in done.err
    done = run("check", "tea", "optimal", "--certificate", tmp_path / "proof.txt")
    assert (done.status, done.out) == (2, "")
    assert list(tmp_path.iterdir()) == []


def test_a_regret_within_bounds_is_refused_before_anything_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for limit in ("EXACT_TRANSITIONS", "EXACT_IN_TIME"):  # as of a model that is too large
        monkeypatch.setattr(f"exact_mdp.analysis.gate.regret.{limit}", 0)
    words = ("check", "tea", "random", "--discount", "9/10", "--max-regret", "100")
    proof, page = tmp_path / "proof.json", tmp_path / "page.html"
    done = run(*words, "--certificate", proof, "--html", page)
    assert (done.status, done.out) == (2, "")
    assert "the regret is bounded, not exact: " in done.err
    assert "--certify" in done.err
    assert list(tmp_path.iterdir()) == []
    done = run(*words, "--certify", "--certificate", proof, "--json")
    assert (done.status, done.result["regret_claim"]) == (0, "certified")
    verify = ("verify", proof, "tea", "--discount", "9/10", "--proven", "--json")
    assert run(*verify).result["exact_regret"] == done.result["exact_regret"]


def test_limits_and_intervals_have_no_certificate() -> None:
    mdp = small_model(3, "9/10")
    audit = check(mdp, "random", subject_to={"reward": ">= -1000"})
    with pytest.raises(ModelError, match="a regret against the optimum without limits"):
        _ = audit.certificate
