"""Certificates of tiny probabilities, and forged ones."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exact_mdp.mdp import MDP, ModelError
from exact_mdp.mdp.table import OutcomeTable, ones
from exact_mdp.solvers import SolverError, certify, evaluate, solve
from exact_mdp.solvers.proof.certificate import BoundedCertificate, Certificate


@pytest.mark.parametrize("stay", [1.0, 1 + 2.0**-52, 1 + 2.0**-40])
@pytest.mark.parametrize("leave", [1e-20, 1e-300, 5e-324])
def test_a_row_that_stays_for_ever_is_refused_by_name(stay: float, leave: float) -> None:
    """1.0 to stay and 1e-20 to leave: as numbers, the state is never left; no division by zero."""
    for rows in ([[stay, leave], [0, 1]], [[stay, leave, 0], [0.5, 0, 0.5], [0, 0, 1]]):
        mdp = MDP.from_arrays([rows], [1.0, *[0.0] * (len(rows) - 1)], 1)
        with pytest.raises(ModelError, match="sum to more than 1") as caught:
            certify(mdp)
        assert "state 0" in caught.value.where
        for attempt in (solve, lambda mdp: certify(mdp, bounded=True)):
            with pytest.raises(SolverError):
                attempt(mdp)
        found = certify(mdp.with_(discount=0.5))
        assert found.violations() == []


@pytest.mark.parametrize("tiny", [F(1, 10**20), F(1, 10**400), F(1, 2**1100)])
@pytest.mark.parametrize("around", [False, True])
def test_tiny_probabilities_do_not_vanish(tiny: F, around: bool) -> None:
    """Exact chances that no float holds beside 1, or at all, still lead out, on a cycle too."""
    other = 2 if around else 0
    mdp = MDP.from_outcomes(
        [
            (0, 0, [(1 - tiny, other, 1), (tiny, 1, 0)]),
            (2, 0, [(1 - tiny, 0, 1), (tiny, 1, 0)]),
            (1, 0, [(1, 1, 0)]),
        ],
        1,
    )
    found = certify(mdp)
    assert found.value[0] == (1 - tiny) / tiny
    assert found.violations() == []


def test_floats_that_suggest_a_policy_may_overflow() -> None:
    """Equations whose shares are beyond the floats are solved exactly, or refused by reason."""
    stay = 1 - F(1, 2**1100)
    rows = [
        (0, 0, [(stay, 0, 1), (F(1, 2**31), 1, 0)]),
        (1, 0, [(F(1, 2), 0, 1), (F(1, 2), 2, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    with pytest.raises(ModelError, match="sum to more than 1"):
        certify(MDP.from_outcomes(rows, 1))


SMALL = MDP.from_arrays([[["1/3", "2/3"], [0, 1]], [["1/2", "1/2"], [0, 1]]], [1, 0])
EXACT = certify(SMALL)


def wrapped(values: Any) -> list[np.int64]:
    return [np.int64(value) for value in values]


class Own(int):
    """An integer that could answer as it likes."""


FORGED: dict[str, dict[str, Any]] = {
    "numerators": {"numerator": wrapped(EXACT.numerator)},
    "denominators": {"denominator": wrapped(EXACT.denominator)},
    "gap scales": {"gap_scale": wrapped(EXACT.gap_scale)},
    "gaps": {"gap": [None if gap is None else np.int64(gap) for gap in EXACT.gap]},
    "truth values": {"numerator": [EXACT.numerator[0], False]},
    "floats": {"numerator": [float(value) for value in EXACT.numerator]},
    "integers of another class": {"numerator": [Own(value) for value in EXACT.numerator]},
    "weights": {"weight": wrapped([1, 1])},
    "start value": {"start_value": F(np.int64(3), np.int64(2))},
    "start value as a float": {"start_value": float(EXACT.start_value)},
    "unique": {"unique": np.bool_(EXACT.unique)},
    "ranks": {"rank": np.array([1.0, 0.0])},
}  # fmt: skip


@pytest.mark.parametrize("name", FORGED)
def test_numbers_that_are_not_pythons_own_are_refused(name: str) -> None:
    """Numerators and denominators are Python integers, or the certificate is none."""
    assert EXACT.violations() == []
    wrong = replace(EXACT, **FORGED[name]).violations()
    assert any("type" in line or "unique" in line for line in wrong)


def test_a_certificate_that_overflows_into_the_truth_is_refused() -> None:
    """Of NumPy's integers, 2^64 times as much may look right."""
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 2**32)]), (1, 0, [(1, 1, 0)])], 1)
    good = certify(mdp)
    with np.errstate(over="ignore"):
        forged = replace(good, numerator=[np.int64(2**32), 0], denominator=[np.int64(1)] * 2)
    assert forged.violations() != []


@pytest.mark.parametrize("kind", [np.float32, np.longdouble, np.int64, object])
@pytest.mark.parametrize("vector", ["lower", "upper", "weight"])
def test_bounds_are_doubles_or_refused(vector: str, kind: Any) -> None:
    """The rounding that the checker counts is that of doubles."""
    found = certify(SMALL, bounded=True)
    assert found.violations() == []
    forged = replace(found, **{vector: getattr(found, vector).astype(kind)})
    assert any("type" in line for line in forged.violations())
    policy = replace(found, policy=found.policy.astype(np.uint64))
    assert any("policy is of type uint64" in line for line in policy.violations())


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("numerators", [1, 0]), ("numerators", [True, "0"]), ("numerators", ["1.5", "0"]),
        ("denominators", [2]), ("denominators", ["0"]), ("denominators", ["-2"]),
        ("gap_scales", [1, 1]), ("start_value", [3, 2]), ("group", [0.0, 0.0]),
        ("group", [True, False]), ("policy", [2**70, 0]), ("policy", [False, False]),
        ("unique", 1), ("pairs", True),
    ],
)  # fmt: skip
def test_forged_files_are_refused(key: str, value: object, tmp_path: Path) -> None:
    """Numbers of another form than the file's own never become part of a certificate."""
    path = tmp_path / "c.json"
    EXACT.save(path)
    data = json.loads(path.read_text())
    assert Certificate.load(path).violations(SMALL) == []
    path.write_text(json.dumps(data | {key: value}))
    with pytest.raises(ModelError, match=key):
        Certificate.load(path)


def test_forged_bounds_in_files_are_refused(tmp_path: Path) -> None:
    """Bounds are hexadecimal floats in words."""
    path = tmp_path / "c.json"
    certify(SMALL, bounded=True).save(path)
    data = json.loads(path.read_text())
    for value in ([1, 0], [1.5, 0.0], [True, False], ["nan", "0x0.0p+0"], ["inf", "0x0.0p+0"]):
        path.write_text(json.dumps(data | {"lower": value}))
        with pytest.raises(ModelError, match="lower"):
            BoundedCertificate.load(path)


def test_a_table_of_numpy_integers_in_disguise_is_refused() -> None:
    """An array of objects holds Python integers, which do not overflow."""
    for name in ("weight", "gain"):
        parts: dict[str, Any] = {"weight": np.array([1]), "gain": np.array([1])}
        hidden = np.empty(1, dtype=object)
        hidden[0] = np.int64(1)
        table = OutcomeTable(
            offsets=np.array([0, 1]), next=np.array([0]), denominator=ones(1),
            gain_denominator=ones(1), **(parts | {name: hidden}),
        )  # fmt: skip
        base = MDP.from_arrays([[[1]]], [0], 0.5)
        with pytest.raises(ModelError, match=f"{name} holds a number of type int64"):
            base.with_(table=table)


def test_evaluation_refuses_what_floats_cannot_tell() -> None:
    """A policy that leaves with probability 1e-20 beside 1.0 has no bounded value at discount 1."""
    mdp = MDP.from_arrays([[[1.0, 1e-20], [0, 1]]], [1.0, 0.0], 1)
    with pytest.raises(SolverError):
        evaluate(mdp, "random")
