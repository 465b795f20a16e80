"""What certificates say: beside values, gaps and optimal actions by the equations alone."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction as F
from math import inf, ulp
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from model_contents import negated
from oracle import Row, best_average, best_total, mean, rows_of, solve_exact

from exact_mdp import MDP, BoundedCertificate, Certificate, ModelError, certify, solve
from exact_mdp.solvers.exact.certificate import exact_rows, require_model
from exact_mdp.solvers.exact.levels import Level

RATES = ("0", "1/2", "9/10")


def model(rng: np.random.Generator, rate: str, *, sense: str = "max", size: int = 0) -> MDP:
    """A random model with ties, ends and states of several numbers of actions."""
    size, rows = size or int(rng.integers(1, 5)), list[Any]()
    for s in range(size):
        for a in sorted(rng.choice(4, rng.integers(1, 4), replace=False).tolist()):
            targets = [*{*rng.integers(0, size, rng.integers(1, 3)).tolist()}]
            reward = int(rng.integers(-1, 2))
            rows.append((s, a, [(F(1, len(targets)), t, reward) for t in targets]))
    return MDP.from_outcomes(rows, rate, sense=sense)


def models(seed: int, *rates: str) -> Iterator[MDP]:
    rng = np.random.default_rng(seed)
    for rate in rates * 12:
        for sense in ("max", "min"):
            yield model(rng, rate, sense=sense)


def maximised(mdp: MDP) -> list[Row]:
    sign = 1 if mdp.sense == "max" else -1
    return [(s, a, sign * r, law) for s, a, r, law in rows_of(mdp)]


def gaps_of(mdp: MDP, losses: list[F | None], optimal: list[bool]) -> list[F | None]:
    """What the best pair that is not optimal loses, but at ends; None without one."""
    listed: list[F | None] = []
    for s in range(mdp.n_states):
        others = [losses[pair] for pair in mdp.pairs_of(s) if not optimal[pair]]
        known = [x for x in others if x is not None]
        listed.append(min(known) if known and not mdp.terminal[s] else None)
    return listed


def test_discounted_optima_are_those_of_all_policies() -> None:
    for mdp in models(0, *RATES):
        sign, rows, proof = 1 if mdp.sense == "max" else -1, maximised(mdp), certify(mdp)
        value, actions = solve_exact(mdp.n_states, rows, mdp.discount_exact)
        assert proof.value.tolist() == [sign * x for x in value]
        assert proof.value_float.tolist() == [float(sign * x) for x in value]
        losses = [value[s] - r - mdp.discount_exact * mean(law, value) for s, _, r, law in rows]
        (lost,) = proof.losses
        assert lost.tolist() == losses
        optimal = [not loss for loss in losses]
        assert proof.optimal_pairs.tolist() == optimal
        for (s, a, *_), best in zip(rows, optimal, strict=True):
            assert best == (a in actions[s])
            assert proof.optimal[s, a] == best
        assert proof.optimal.sum() == sum(optimal)
        assert proof.gaps.tolist() == gaps_of(mdp, [*losses], optimal)
        assert proof.sense.sign == sign
        assert proof.infinite_sign.tolist() == [0] * mdp.n_states
        assert proof.infinite_sign.dtype == np.int64
        offered = [*zip(mdp.pair_state.tolist(), mdp.pair_action.tolist(), strict=True)]
        taken = [offered.index((s, int(a))) for s, a in enumerate(proof.policy)]
        assert proof.pairs.tolist() == taken
        assert all(optimal[pair] for pair in taken)
        start = sum((p * proof.value[int(s)] for s, p in mdp.start), F(0))
        assert proof.start_value == proof.start.value == start
        even = proof.optimal_policy().table
        assert (even > 0).tolist() == proof.optimal.tolist()
        assert all(len({*row[row > 0]}) == 1 for row in even)


def test_averages_are_the_greatest_gain_and_bias() -> None:
    for mdp in models(1, "1", "1/2"):
        sign, rows = 1 if mdp.sense == "max" else -1, maximised(mdp)
        proof, (gain, bias) = certify(mdp, criterion="average"), best_average(rows)
        assert proof.value.tolist() == [sign * x for x in gain]
        assert proof.bias.tolist() == [sign * x for x in bias]
        first = [gain[s] - mean(law, gain) for s, _, _, law in rows]
        second = [gain[s] + bias[s] - r - mean(law, bias) for s, _, r, law in rows]
        assert proof.losses[0].tolist() == first
        both = [*zip(first, second, strict=True)]
        assert proof.losses[1].tolist() == [0 if d else x for d, x in both]
        optimal = [not d and not x for d, x in both]
        assert proof.optimal_pairs.tolist() == optimal
        losses = [None if d else x for d, x in both]
        assert proof.gaps.tolist() == gaps_of(mdp, losses, optimal)
        assert not proof.infinite_sign.any()


def test_totals_without_a_discount_may_be_infinite() -> None:
    seen = set[float]()
    for mdp in models(2, "1"):
        sign, rows = 1 if mdp.sense == "max" else -1, maximised(mdp)
        value = best_total(rows)
        try:
            proof = certify(mdp)
        except ModelError:  # infinite of both signs at the start
            continue
        assert proof.value.tolist() == [sign * x for x in value]
        assert proof.value_float.tolist() == [float(sign * x) for x in value]
        infinite = [0 if abs(x) < inf else 1 if x > 0 else -1 for x in value]
        assert proof.infinite_sign.tolist() == infinite
        seen |= {*infinite}
        if proof.g is None:
            continue
        g, h = proof.g.to_fractions().tolist(), proof.h.to_fractions().tolist()
        optimal, losses = list[bool](), list[F | None]()
        for s, _, r, law in rows:
            ahead, loss = mean(law, g), g[s] + h[s] - r - mean(law, h)
            if infinite[s]:
                optimal.append(infinite[s] < 0 or ahead > 0)
            else:
                optimal.append(ahead == g[s] and not loss)
            losses.append(None if infinite[s] or ahead != g[s] else loss)
        assert proof.optimal_pairs.tolist() == optimal
        assert proof.gaps.tolist() == gaps_of(mdp, losses, optimal)
    assert seen == {0.0, 1.0, -1.0}


def goals() -> Iterator[MDP]:
    """Models of four states, the last of which is the goal, with values of all kinds."""
    rng = np.random.default_rng(3)
    for _ in range(60):
        rows = rows_of(model(rng, "1", size=4))
        listed: list[Any] = [(s, a, [(p, t, r) for t, p in law.items()])
                             for s, a, r, law in rows if s < 3]  # fmt: skip
        mdp = MDP.from_outcomes([*listed, (3, 0, [(1, 3, 0)])], labels={"goal": {3}})
        yield (mdp if rng.random() < 0.5 else negated(mdp)).until("goal")


def test_with_a_goal_pairs_are_worth_what_they_lead_to() -> None:
    seen = set[tuple[int, bool]]()
    for mdp in goals():
        try:
            proof = certify(mdp)
        except ModelError:
            continue
        if proof.infinite is None:
            continue
        infinite, sign = proof.infinite.tolist(), proof.sense.sign
        h = proof.h.to_fractions().tolist()
        for s, x in enumerate(proof.value.tolist()):
            assert x == sign * (infinite[s] * inf if infinite[s] else h[s])
        optimal, losses = list[bool](), list[F | None]()
        for s, _, r, law in maximised(mdp):
            after = {infinite[t] for t in law}
            worth = -1 if -1 in after else 1 if 1 in after else 0
            loss = h[s] - r - mean(law, h) if not (infinite[s] or worth) else None
            optimal.append(infinite[s] < 0 or (worth == infinite[s] and not loss))
            losses.append(None if after != {0} else loss)
            seen.add((infinite[s], optimal[-1]))
        assert proof.optimal_pairs.tolist() == optimal
        wanted = [None if infinite[s] else x for s, x in enumerate(gaps_of(mdp, losses, optimal))]
        assert proof.gaps.tolist() == wanted
    assert {(0, True), (0, False), (1, True), (1, False), (-1, True)} <= seen


# ---- what is shown -------------------------------------------------------------------------------

ROWS: Any = [(0, 0, [(1, 1, 3)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
PLAIN = MDP.from_outcomes(ROWS)
LOOP: Any = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]


def test_a_frame_shows_values_actions_and_gaps() -> None:
    frame = certify(PLAIN).frame()
    assert frame.columns.tolist() == ["state", "value", "action", "gap", "exact"]
    assert frame["value"].tolist() == [3.0, 0.0]
    assert frame["gap"].fillna(-1).tolist() == [2.0, -1]
    assert frame["exact"].tolist() == [3, 0]
    average = certify(MDP.from_outcomes(LOOP), criterion="average").frame()
    names = ["state", "gain", "bias", "action", "exact gain", "exact bias"]
    assert average.columns.tolist() == names
    assert average["gain"].tolist() == average["exact gain"].tolist() == [1, 0]
    endless = certify(MDP.from_outcomes(LOOP)).frame()
    assert endless["value"].tolist() == [inf, 0]


def test_what_is_said_in_one_line() -> None:
    assert repr(certify(PLAIN)) == "Certificate(2 states, start value ≈ 3, the only optimal policy)"
    tied = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 1)]), ROWS[-1]], sense="min")
    assert repr(certify(tied)) == (
        "Certificate(2 states, least start value ≈ 1, not the only optimal policy)"
    )
    for sense, least, gain in (("max", "", 1), ("min", "least ", 0)):
        proof = certify(MDP.from_outcomes(LOOP, sense=sense), criterion="average")
        said = repr(proof)
        assert said.startswith(f"Certificate(2 states, {least}gain at the start ")
        assert proof.start.value == gain
        assert str(proof.start) in said
    bounds = certify(PLAIN, bounded=True)
    assert repr(bounds) == f"BoundedCertificate(2 states, error ≤ {bounds.error_bound:.2g})"


def test_a_total_has_no_bias() -> None:
    with pytest.raises(ModelError, match="a total reward has neither gain nor bias"):
        _ = certify(PLAIN).bias


def test_numbers_cannot_be_changed() -> None:
    proof = certify(PLAIN)
    for array in (proof.value, proof.value_float, proof.gaps, proof.losses[0]):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_several_optimal_actions_may_not_be_optimal_together() -> None:
    """Each of two states may go to the other, or end: both at once go round for ever."""
    rows: Any = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 0, 0)]),
                 (1, 1, [(1, 2, 0)]), (2, 0, [(1, 2, 0)]), (2, 1, [(1, 2, 0)])]  # fmt: skip
    with pytest.raises(ModelError, match="several actions are optimal") as caught:
        certify(MDP.from_outcomes(rows)).optimal_policy()
    assert "state 0" in caught.value.where
    half = certify(MDP.from_outcomes(rows, "1/2")).optimal_policy()
    assert half.table.tolist() == [[0.5, 0.5]] * 3
    once: Any = [
        (0, 0, [(1, 0, -1)]),
        (0, 1, [(1, 1, 0)]),
        (1, 0, [(1, 1, 0)]),
        (1, 1, [(1, 1, 0)]),
    ]
    one = certify(MDP.from_outcomes(once))
    assert one.g is not None
    assert one.optimal_policy().table.tolist() == [[0, 1], [0.5, 0.5]]
    second: Any = [(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 2, 1)]),
                   (1, 1, [(1, 2, 1)]), (2, 0, [(1, 2, 0)])]  # fmt: skip
    with pytest.raises(ModelError, match="several actions are optimal") as caught:
        certify(MDP.from_outcomes(second)).optimal_policy()
    assert "state 1" in caught.value.where


# ---- models and files ----------------------------------------------------------------------------


def test_a_proof_is_of_the_model_given_or_its_own(tmp_path: Path) -> None:
    proof, other = certify(PLAIN), MDP.from_outcomes(ROWS, "1/2")
    assert (
        require_model(None, PLAIN)
        is require_model(PLAIN, None)
        is require_model(PLAIN, other)
        is PLAIN
    )
    for where in ("violations", "here"):
        with pytest.raises(ModelError, match="does not contain the model") as caught:
            require_model(None, None, where)
        assert caught.value.where == where
    assert proof.violations() == proof.violations(PLAIN) == []
    assert proof.violations(other) == ["the certificate belongs to another model"]
    proof.save(path := tmp_path / "proof.json")
    alone, owned = Certificate.load(path), Certificate.load(path, PLAIN)
    assert alone.mdp is None
    assert owned.mdp is PLAIN
    assert alone.value.tolist() == owned.value.tolist() == [3, 0]
    for name in ("pairs", "gaps", "optimal_pairs"):
        with pytest.raises(ModelError, match="does not contain the model") as caught:
            getattr(alone, name)
        assert caught.value.where == name
    with pytest.raises(ModelError, match="the certificate belongs to another model"):
        Certificate.load(path, other)
    with pytest.raises(ModelError, match="kind is 'total', not 'bounds'"):
        BoundedCertificate.load(path)
    wrong = replace(proof, start_value=F(4))
    assert wrong.violations() == ["the start value is not that of the start states"]
    damaged: Any = replace(proof, rank=np.array([1]))
    assert damaged.violations() == ["rank: no list, or its length"]


def test_equations_are_those_that_are_maximised() -> None:
    costs = MDP.from_outcomes(LOOP, "1/2", sense="min")
    assert exact_rows(costs).constant.tolist() == [-2, 0, 0]
    assert exact_rows(costs).scale.tolist() == [2, 1] or exact_rows(costs).scale.tolist() == [2, 2]
    assert exact_rows(costs, average=True).constant.tolist() == [-1, 0, 0]
    assert exact_rows(costs, average=True).scale.tolist() == [1, 1]


# ---- bounds --------------------------------------------------------------------------------------


@pytest.mark.parametrize("sense", ["max", "min"])
def test_bounds_are_on_the_side_that_their_sense_says(sense: str) -> None:
    mdp = MDP.from_outcomes(ROWS, "1/2", sense=sense, start=["1/4", "3/4"])
    level = {"low": Level.of([F(2), F(-1, 4)]), "high": Level.of([F(4), F(1, 2)])}
    proof = replace(certify(mdp, bounded=True), **level)
    low, high = [2.0, -0.25], [4.0, 0.5]
    if sense == "min":
        low, high = [-4.0, -0.5], [-2.0, 0.25]
    assert proof.lower.tolist() == low
    assert proof.upper.tolist() == high
    middle = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    assert proof.value.tolist() == middle
    np.testing.assert_allclose(proof.error, [1 + 2**-49, 0.375 + 2**-49], rtol=1e-16)
    assert proof.error_bound == proof.error.max()
    start = F(1, 4) * F(middle[0]) + F(3, 4) * F(middle[1])
    assert proof.start.value == float(start)
    assert proof.start.error == proof.error_bound + ulp(float(start))
    frame = proof.frame()
    assert frame.columns.tolist() == ["state", "value", "lower", "upper", "action"]
    assert frame["lower"].tolist() == low
    for array in (proof.lower, proof.upper):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


def test_the_error_counts_the_roundings_of_the_middle() -> None:
    rng = np.random.default_rng(4)
    mdp = MDP.from_outcomes(ROWS, "1/2")
    for _ in range(30):
        ends = np.sort(rng.normal(size=(2, 2)) * 10.0 ** rng.integers(-3, 9), axis=0)
        low, high = ([F(float(x)) for x in row] for row in ends)
        proof = replace(certify(mdp, bounded=True, solution=solve(mdp)), low=Level.of(low),
                        high=Level.of(high))  # fmt: skip
        for x, e, a, b in zip(proof.value, proof.error, low, high, strict=True):
            assert abs(F(float(x)) - a) <= F(float(e))
            assert abs(F(float(x)) - b) <= F(float(e))


def test_the_error_at_the_start_counts_the_rounding_of_the_mean() -> None:
    """Values of 3 and 1/8 that are known exactly, of which the mean is 27/32."""
    mdp = MDP.from_outcomes(ROWS, "1/2", start=["1/4", "3/4"])
    known = Level.of([F(3), F(1, 8)])
    proof = replace(certify(mdp, bounded=True), low=known, high=known)
    assert proof.start.value == 27 / 32
    assert proof.start.error == proof.error_bound + ulp(27 / 32) > proof.error_bound


def test_pairs_that_keep_a_positive_mean_are_worth_infinity() -> None:
    rows: Any = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)]), (0, 2, [(1, 2, 9)]),
                 (1, 0, [(1, 1, "1/3")]), (2, 0, [(1, 2, 0)])]  # fmt: skip
    proof = certify(MDP.from_outcomes(rows))
    assert proof.value.tolist() == [inf, inf, 0]
    assert proof.optimal_pairs.tolist() == [True, True, False, True, True]
