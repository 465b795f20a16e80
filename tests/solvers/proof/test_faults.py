"""The checker against planted faults: false claims, wrong proofs, forged numbers."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction as F
from itertools import product
from typing import Any

import numpy as np
import pytest
from certificates import MODELS, certified

from exact_mdp import MDP, Certificate, ModelError, certify

Change = Callable[[Any], dict[str, Any]]


def put(values: Any, place: int, value: object) -> list[Any]:
    changed = list(values)
    changed[place] = value
    return changed


def other(found: Certificate) -> dict[str, Any]:
    """Take the other action in the first state that offers one which is not optimal."""
    mdp = found.mdp
    assert mdp is not None
    pair = int(np.flatnonzero(~found.optimal_pairs)[0])
    state = int(mdp.pair_state[pair])
    return {"policy": np.array(put(found.policy, state, mdp.pair_action[pair]))}


def flip(found: Certificate, place: int) -> dict[str, Any]:
    optimal = found.optimal_pairs.copy()
    optimal[place] = ~optimal[place]
    return {"optimal_pairs": optimal}


def gapped(found: Certificate) -> int:
    """The first state with a gap."""
    return next(s for s, gap in enumerate(found.gap) if gap is not None)


def shifted(found: Certificate) -> dict[str, Any]:
    """Every value larger by 1: the equations of discount 1 hold as before."""
    below = [found.denominator[group] for group in found.group]
    return {
        "numerator": [a + b for a, b in zip(found.numerator, below, strict=True)],
        "start_value": found.start_value + 1,
    }


FAULTS: dict[str, tuple[str, Change]] = {
    "numerator": (
        "Bellman",
        lambda c: {"numerator": put(c.numerator, 0, c.numerator[0] + 1)},
    ),
    "numerator, less": (
        "Bellman",
        lambda c: {"numerator": put(c.numerator, 1, c.numerator[1] - 1)},
    ),
    "denominator": (
        "Bellman",
        lambda c: {"denominator": put(c.denominator, c.group[0], c.denominator[c.group[0]] + 1)},
    ),
    "negative denominator": (
        "positive",
        lambda c: {
            "numerator": [-x for x in c.numerator],
            "denominator": [-x for x in c.denominator],
            "gap": [None if x is None else -x for x in c.gap],
        },
    ),
    "terminal": (
        "terminal",
        lambda c: {"numerator": put(c.numerator, int(np.flatnonzero(c.mdp.terminal)[0]), 1)},
    ),
    "shift": ("terminal", shifted),
    "group": ("denominator is missing", lambda c: {"group": np.full_like(c.group, 99)}),
    "swapped action": ("not optimal", other),
    "action not there": ("not optimal", lambda c: {"policy": np.full_like(c.policy, 99)}),
    "negative action": ("not optimal", lambda c: {"policy": c.policy - 5}),
    "false unique": ("unique", lambda c: {"unique": not c.unique}),
    "pair called optimal": ("optimal actions", lambda c: flip(c, int(np.argmin(c.optimal_pairs)))),
    "pair not called optimal": ("optimal actions", lambda c: flip(c, 0)),
    "gap": ("gap", lambda c: {"gap": put(c.gap, gapped(c), 1 + (c.gap[gapped(c)] or 0))}),
    "gap left out": ("gap", lambda c: {"gap": [None] * len(c.gap)}),
    "gap scale": ("gap", lambda c: {"gap_scale": [2 * x for x in c.gap_scale]}),
    "gap of nothing": (
        "gap",
        lambda c: {"gap": put(c.gap, gapped(c), 0), "gap_scale": [0] * len(c.gap_scale)},
    ),
    "start value": ("start value", lambda c: {"start_value": c.start_value + F(1, 10**30)}),
    "model": ("another model", lambda c: {"model": "0" * 64}),
    "a state too many": ("states", lambda c: {"numerator": [*c.numerator, 0]}),
    "a pair too few": ("pairs", lambda c: {"optimal_pairs": c.optimal_pairs[1:]}),
}
PROOFS: dict[str, Change] = {
    "no proof": lambda c: {"rank": None},
    "flat rank": lambda c: {"rank": np.ones_like(c.group)},
    "rank 0": lambda c: {"rank": np.zeros_like(c.group)},
    "rank that rises": lambda c: {"rank": np.arange(len(c.group)) + 1},
    "short rank": lambda c: {"rank": np.ones(1, dtype=np.int64)},
}


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("name", MODELS)
def test_planted_faults_are_found(name: str, fault: str) -> None:
    expected, change = FAULTS[fault]
    wrong = replace(certified(name), **change(certified(name))).violations()
    assert any(expected in violation for violation in wrong), wrong


@pytest.mark.parametrize("proof", PROOFS)
@pytest.mark.parametrize("name", [name for name in MODELS if "discounted" not in name])
def test_wrong_proofs_are_found(name: str, proof: str) -> None:
    wrong = replace(certified(name), **PROOFS[proof](certified(name))).violations()
    assert wrong == ["nothing proves that the Bellman equations have one solution"]


def test_every_small_rank_is_judged_by_its_definition() -> None:
    found, mdp = certified("cycle"), MODELS["cycle"]
    verdicts = set()
    for rank in product(range(4), repeat=mdp.n_states):
        falls = [
            any(rank[t] < rank[mdp.pair_state[pair]] for _, t, _ in mdp.table.row(pair))
            for pair in range(mdp.n_pairs - 1)
        ]
        sound = all(falls) and rank[3] == 0 and min(rank[:3]) > 0
        wrong = replace(found, rank=np.array(rank)).violations()
        assert (wrong == []) == sound
        verdicts.add(sound)
    assert verdicts == {False, True}


def test_a_proof_that_is_not_needed_is_not_asked_for() -> None:
    found = certified("cycle, discounted")
    assert found.rank is None


# ---- bounds --------------------------------------------------------------------------------------


def moved(vector: np.ndarray, amount: float) -> np.ndarray:
    """Changed in one state, to which another one leads."""
    changed = vector.copy()
    changed[1] += amount
    return changed


FALSE_BOUNDS: dict[str, tuple[str, Change]] = {
    "upper too low": ("upper", lambda c: {"upper": moved(c.upper, -1e-6)}),
    "upper far too high in one state": ("upper", lambda c: {"upper": moved(c.upper, 1e6)}),
    "lower too high": ("lower", lambda c: {"lower": moved(c.lower, 1e-6)}),
    "lower far too low in one state": ("lower", lambda c: {"lower": moved(c.lower, -1e6)}),
    "swapped": ("upper", lambda c: {"upper": c.lower, "lower": c.upper}),
    "weight 0": ("weights", lambda c: {"weight": np.zeros_like(c.weight)}),
    "negative weight": ("weights", lambda c: {"weight": -c.weight}),
    "no number": ("upper is not finite", lambda c: {"upper": c.upper * np.nan}),
    "infinite": ("upper is not finite", lambda c: {"upper": c.upper + np.inf}),
    "terminal": ("not 0 in terminal", lambda c: {"upper": c.upper + 1}),
    "policy": ("not available", lambda c: {"policy": c.policy + 99}),
    "model": ("another model", lambda c: {"model": "0" * 64}),
    "size": ("states", lambda c: {"lower": c.lower[1:]}),
}


@pytest.mark.parametrize("fault", FALSE_BOUNDS)
@pytest.mark.parametrize("name", ["cycle", "cycle, discounted", "cycle of floats"])
def test_false_bounds_are_found(name: str, fault: str) -> None:
    expected, change = FALSE_BOUNDS[fault]
    found = certify(MODELS[name], bounded=True)
    wrong = replace(found, **change(found)).violations()
    assert any(expected in violation for violation in wrong), wrong


def test_a_worse_policy_is_found() -> None:
    mdp, found = MODELS["cycle, discounted"], certify(MODELS["cycle, discounted"], bounded=True)
    pair = int(np.flatnonzero(~certified("cycle, discounted").optimal_pairs)[0])
    policy = found.policy.copy()
    policy[mdp.pair_state[pair]] = mdp.pair_action[pair]
    assert replace(found, policy=policy).violations() == [
        "the lower values are not proven to be below the policy's"
    ]


# ---- forged numbers ------------------------------------------------------------------------------


SMALL = MDP.from_arrays([[["1/3", "2/3"], [0, 1]], [["1/2", "1/2"], [0, 1]]], [1, 0], layout="ass")
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


def test_a_table_of_numpy_integers_in_disguise_is_refused() -> None:
    """An array of objects holds Python integers, which do not overflow."""
    for name in ("weight", "gain"):
        parts: dict[str, Any] = {"weight": np.array([1]), "gain": np.array([1])}
        hidden = np.empty(1, dtype=object)
        hidden[0] = np.int64(1)
        base = MDP.from_arrays([[[1]]], [0], 0.5)
        table = replace(base.table, **(parts | {name: hidden}))
        with pytest.raises(ModelError, match=f"{name} holds a number of type int64"):
            base.with_(table=table)
