"""Exact certificates against other exact solvers, and the checker against planted faults."""

import ast
import random
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction as F
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cases import CASES, Case
from cases.reference import every_policy_ends, solve_exact
from certificates import CYCLE, MODELS, certified
from hypothesis import given, settings
from oracle import END, Oracle
from strategies import Rows, exact_gains, model_of, models

from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.solvers import Claim, certify
from exact_mdp.solvers.proof.certificate import Certificate

SOLVERS = Path(__file__).parents[3] / "solvers"
Change = Callable[[Certificate], dict[str, Any]]


def check(found: Certificate, mdp: MDP) -> None:
    """Everything that a certificate claims, computed anew from the model's own rational table."""
    assert found.violations() == []
    value = list(found.value)
    gains = exact_gains(mdp, value)
    best = [[a for a in mdp.pairs_of(s) if gains[a] == 0] for s in range(mdp.n_states)]
    for s in range(mdp.n_states):
        if mdp.terminal[s]:
            assert value[s] == 0
            assert found.optimal_pairs[list(mdp.pairs_of(s))].all()
            continue
        losses = [-gains[a] for a in mdp.pairs_of(s)]
        assert min(losses) == 0
        assert found.optimal_pairs[list(mdp.pairs_of(s))].tolist() == [x == 0 for x in losses]
        assert found.gaps[s] == min((x for x in losses if x), default=None)
        assert mdp.pair(s, int(found.policy[s])) == best[s][0]
    todo = [s for s, weight in mdp.start if weight]
    reached = set(todo)
    while todo:
        s = todo.pop()
        new = {t for a in best[s] for _, t, _ in mdp.table.row(a)} - reached
        reached |= new
        todo += new
    assert found.unique == all(len(best[s]) == 1 for s in reached if not mdp.terminal[s])
    assert found.start_value == sum(weight * value[s] for s, weight in mdp.start)
    assert found.value_float.tolist() == [float(x) for x in value]


def check_reference(rows: Rows, found: Certificate, mdp: MDP) -> None:
    value, optimal = solve_exact(rows.n_states, rows.pairs, rows.discount)
    assert list(found.value) == value
    for s in range(rows.n_states):
        chosen = [a for a in mdp.pairs_of(s) if found.optimal_pairs[a]]
        assert {int(mdp.pair_action[a]) for a in chosen} == set(optimal[s])


# ---- right answers -------------------------------------------------------------------------------


@settings(max_examples=200, deadline=None)
@given(models())
def test_random_models_are_solved_exactly(rows: Rows) -> None:
    mdp = rows.model()
    found = certify(mdp)
    check(found, mdp)
    check_reference(rows, found, mdp)


@settings(max_examples=100, deadline=None)
@given(models())
def test_floats_are_the_dyadic_rationals_that_they_are(rows: Rows) -> None:
    mdp = rows.model(floats=True)
    check(certify(mdp), mdp)


@pytest.mark.parametrize("case", CASES, ids=str)
def test_published_models(case: Case) -> None:
    mdp = model_of(case.n_states, case.pairs, case.discount, start=case.start)
    if case.discount == 1 and not every_policy_ends(case.n_states, case.pairs):
        with pytest.raises(ModelError, match="needs every policy to end"):
            certify(mdp)
        return
    rows = Rows(n_states=case.n_states, pairs=tuple(case.pairs), discount=case.discount)
    found = certify(mdp)
    check(found, mdp)
    check_reference(rows, found, mdp)


@pytest.mark.parametrize("name", MODELS)
def test_models_of_every_kind(name: str) -> None:
    check(certified(name), MODELS[name])


@pytest.mark.parametrize(
    "readings", [{}, {"skip_timestep": "own", "task_bonus": "no-subtask-skipped"}], ids=str
)
def test_care_model(readings: dict[str, str]) -> None:
    scenario = Scenario.load("yuan2025").with_(readings=readings)
    mdp, oracle = scenario.compile(), Oracle(readings)
    found = certify(mdp)
    assert found.violations() == []
    assert found.unique
    assert found.start_value == oracle.value(oracle.start)
    for state in oracle.reachable():
        number = mdp.n_states - 1 if state == END else _number(mdp, state)
        assert found.value[number] == oracle.value(state)
        pairs = [pair for pair in mdp.pairs_of(number) if found.optimal_pairs[pair]]
        if len(mdp.pairs_of(number)) > 1:
            names = {mdp.actions[mdp.pair_action[pair]] for pair in pairs}
            assert names == oracle.optimal_actions(state)


def _number(mdp: MDP, state: Any) -> int:
    subtask, trial, intact, bits = state
    flag = {"skipped": 1 - intact} if "skipped" in mdp.space.names else {}
    status = int("".join(map(str, bits)), 2)
    return mdp.space.index(subtask=subtask, trial=trial, status=status, **flag)


def primes(first: int, count: int) -> list[int]:
    found: list[int] = []
    while len(found) < count:
        if all(first % divisor for divisor in range(2, int(first**0.5) + 1)):
            found.append(first)
        first += 1
    return found


@pytest.mark.parametrize("waiting", [False, True])
@pytest.mark.parametrize("width, depth", [(40, 2), (10, 5)])
def test_denominators_without_common_factors(width: int, depth: int, waiting: bool) -> None:
    """Common denominators of all states would be far longer than each state's own."""
    draw, last = random.Random(width), width * depth
    bottoms = iter(primes(10**5, 4 * last + 1))
    rows = [(last, 0, F(0), {last: F(1)})]
    for s in range(last):
        below = (s // width + 1) * width
        for a in range(2):
            bottom = next(bottoms)
            share = F(draw.randrange(1, bottom // 2), bottom)
            to = below + draw.randrange(width) if below < last else last
            following = {s if waiting and a else last: 1 - share}
            following[to] = following.get(to, F(0)) + share
            rows.append((s, a, F(draw.randrange(-9, 9), next(bottoms)), following))
    rows.sort(key=lambda row: row[:2])
    mdp = model_of(last + 1, rows, F(1))
    found = certify(mdp)
    check(found, mdp)
    check_reference(Rows(n_states=last + 1, pairs=tuple(rows), discount=F(1)), found, mdp)
    lengths = [found.denominator[group].bit_length() for group in found.group]
    assert max(lengths) < 3 * max(int(x.denominator).bit_length() for x in found.value)


def test_denominators_stay_short_where_values_do() -> None:
    chain = [(s, 0, F(1, 10), {s + 1: F(1)}) for s in range(200)]
    found = certify(model_of(201, [*chain, (200, 0, F(0), {200: F(1)})], F(1)))
    assert found.start_value == 20
    assert max(found.denominator) == 10


def test_larger_cycle() -> None:
    draw, rows = random.Random(1), []
    for s in range(60):
        for a in range(3):
            weights = {draw.randrange(60): draw.randrange(1, 50) for _ in range(4)}
            total = sum(weights.values())
            shares = {t: F(weight, total) for t, weight in weights.items()}
            rows.append((s, a, F(draw.randrange(-50, 50), 7), shares))
    mdp = model_of(60, rows, F(99, 100))
    found = certify(mdp)
    check(found, mdp)
    check_reference(Rows(n_states=60, pairs=tuple(rows), discount=F(99, 100)), found, mdp)


@pytest.mark.parametrize("scale", [F(10) ** 300, F(1, 10**300)])
def test_numbers_beyond_floats(scale: F) -> None:
    """Floats overflow or underflow while they seek the first policy; the answer is exact still."""
    pairs = [(s, a, r * scale, row) for s, a, r, row in CYCLE]
    mdp = model_of(4, pairs, F(999_999_999_999, 10**12))
    found = certify(mdp)
    check(found, mdp)
    plain = certify(model_of(4, CYCLE, F(999_999_999_999, 10**12)))
    assert list(found.value) == [x * scale for x in plain.value]


def test_where_all_that_remains_is_to_stop() -> None:
    mdp = model_of(2, [(s, a, F(0), {s: F(1)}) for s in range(2) for a in range(2)], F(1))
    found = certify(mdp)
    check(found, mdp)
    assert found.unique
    assert found.gaps.tolist() == [None, None]


# ---- what has no answer --------------------------------------------------------------------------


def test_a_policy_that_never_ends_is_named() -> None:
    rows = [*CYCLE, (1, 1, F(0), {1: F(1)})]
    rows.sort(key=lambda row: row[:2])
    with pytest.raises(ModelError, match="one does not") as caught:
        certify(model_of(4, rows, F(1)))
    assert "state 1" in caught.value.where


OVERFULL = [
    (0, 0, [(1.0000000005, 1, 1.0), (1e-10, 2, 0.0)]),
    (1, 0, [(1.0, 0, 1.0)]),
    (2, 0, [(1.0, 2, 0.0)]),
]


@pytest.mark.parametrize("discount", [1, 1 - 1e-12])
def test_rows_that_sum_to_too_much_are_refused(discount: float) -> None:
    with pytest.raises(ModelError, match="sum to more than 1"):
        certify(MDP.from_outcomes(OVERFULL, discount))


def test_rows_that_sum_to_more_than_1_are_taken_where_they_end() -> None:
    lossy = certify(MDP.from_outcomes(OVERFULL, 0.999))
    assert (lossy.rank, lossy.weight) == (None, None)
    mdp = MODELS["cycle of floats"]
    assert (bellman_rows(mdp).slack()[~mdp.terminal[mdp.pair_state]] < 0).any()
    assert certified("cycle of floats").weight is not None
    straight = MDP.from_outcomes(
        [(0, 0, [(1.0000000005, 1, 1.0), (1e-10, 2, 0.0)]), (1, 0, [(1.0, 2, 1.0)]), OVERFULL[2]]
    )
    found = certify(straight)
    check(found, straight)
    assert found.rank is not None


# ---- planted faults ------------------------------------------------------------------------------


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
    "no proof": lambda c: {"rank": None, "weight": None},
    "flat rank": lambda c: {"rank": np.ones_like(c.group), "weight": None},
    "rank 0": lambda c: {"rank": np.zeros_like(c.group), "weight": None},
    "rank that rises": lambda c: {"rank": np.arange(len(c.group)) + 1, "weight": None},
    "short rank": lambda c: {"rank": np.ones(1, dtype=np.int64), "weight": None},
    "equal weights": lambda c: {"rank": None, "weight": [1] * len(c.group)},
    "negative weights": lambda c: {"rank": None, "weight": [-1] * len(c.group)},
    "one weight": lambda c: {"rank": None, "weight": [1]},
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


def test_small_weights_are_judged_by_their_definition() -> None:
    found, mdp = certified("cycle of floats"), MODELS["cycle of floats"]
    verdicts = set()
    for weight in product(range(-1, 14), repeat=2):
        margins = [
            weight[mdp.pair_state[pair]]
            - sum(p * (*weight, 0)[t] for p, t, _ in mdp.table.row(pair))
            for pair in range(mdp.n_pairs - 1)
        ]
        sound = min(margins) > 0 and min(weight) > 0
        wrong = replace(found, weight=[*weight, 0]).violations()
        assert (wrong == []) == sound
        verdicts.add(sound)
    assert verdicts == {False, True}


def test_a_proof_that_is_not_needed_is_not_asked_for() -> None:
    found = certified("cycle, discounted")
    assert (found.rank, found.weight) == (None, None)


# ---- the certificate itself ----------------------------------------------------------------------


def test_a_certificate_states_its_claim() -> None:
    found = certified("acyclic")
    assert found.claim is Claim.CERTIFIED
    assert found.start.value == found.start_value == found.value[0]
    assert (
        repr(found) == "Certificate(5 states, start value ≈ 5.14285714286, the only optimal policy)"
    )
    with pytest.raises(ValueError, match="read-only"):
        found.policy[0] = 1


def test_another_model_is_another_model() -> None:
    found = certified("cycle, discounted")
    assert found.violations(MODELS["cycle, discounted"].with_(name="other")) == []
    assert found.violations(MODELS["cycle"]) == ["the certificate is of another model"]


def test_settings_that_do_not_belong() -> None:
    with pytest.raises(ModelError, match="apply only to bounds"):
        certify(MODELS["cycle"], tol=1e-3)


def test_the_checker_can_be_read_in_one_sitting_and_imports_no_solver() -> None:
    for name in ("checker",):
        text = (SOLVERS / "proof" / f"{name}.py").read_text("utf-8")
        assert len(text.splitlines()) <= 265
        tree = ast.parse(text)
        typing = [
            statement
            for node in tree.body
            if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
            for statement in node.body
        ]
        imported = [
            node.module if isinstance(node, ast.ImportFrom) else node.names[0].name
            for node in ast.walk(tree)
            if isinstance(node, ast.Import | ast.ImportFrom) and node not in typing
        ]
        assert not [module for module in imported if "solvers" in str(module)]
        assert "flint" not in text
