"""What the rounding of floats can move, beside its definition in loops and fractions."""

from collections.abc import Iterator
from fractions import Fraction as F
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import small_model

from exact_mdp import MDP, SolverError
from exact_mdp.analysis.gate.forgiveness import (
    bound_per_use,
    compute_rounding_allowance,
    compute_tie_gaps,
    per_use,
    round_finite_values,
)
from exact_mdp.solvers.bounds.gains import BoundedVector
from exact_mdp.solvers.claims import Status
from exact_mdp.solvers.values.policy_chain import PolicyChain, PolicyEquations


def in_floats(seed: int, discount: object, **kind: Any) -> MDP:
    """A small model whose numbers are given as floats; in some, probabilities or rewards alone."""
    mdp = small_model(seed, discount, states=4, **kind)
    chance: Any = F if seed % 3 == 1 else float
    pay: Any = F if seed % 3 == 2 else float
    rows = [
        (
            int(mdp.pair_state[pair]),
            int(mdp.pair_action[pair]),
            [(chance(p), t, pay(r)) for p, t, r in mdp.table.row(pair)],
        )
        for pair in range(mdp.n_pairs)
    ]
    return MDP.from_outcomes(rows, discount, start=dict(mdp.start))


def outcomes(mdp: MDP) -> Iterator[tuple[int, list[tuple[float, int, float]]]]:
    chance, gain, table = mdp.table.compute_probabilities(), mdp.table.compute_gains(), mdp.table
    for pair in range(mdp.n_pairs):
        here = range(table.offsets[pair], table.offsets[pair + 1])
        yield pair, [(float(chance[i]), int(table.next[i]), float(gain[i])) for i in here]


def half(number: float) -> float:
    return float(np.spacing(abs(number))) / 2


def of_rewards(mdp: MDP, row: list[tuple[float, int, float]]) -> float:
    """ρ: half a unit in the last place of each reward, times its probability."""
    return sum(p * half(r) for p, _, r in row if r) if mdp.float_rewards else 0.0


def of_row(mdp: MDP, row: list[tuple[float, int, float]], x: list[float]) -> float:
    """M: the least Σ ω |x - c| over all c, which is attained at one of the x."""
    if not mdp.float_probabilities:
        return 0.0
    weight = [half(p) if p < 1 else 0.0 for p, _, _ in row]
    return min(sum(w * abs(each - c) for w, each in zip(weight, x, strict=True)) for c in x)


def moved_by_use(mdp: MDP, value: Any, rewards: bool = True) -> list[float]:
    found = []
    for _, row in outcomes(mdp):
        x = [rewards * r + mdp.discount * float(value[t]) for _, t, r in row]
        found.append(rewards * of_rewards(mdp, row) + of_row(mdp, row, x))
    return found


def policies(mdp: MDP, seed: int) -> tuple[PolicyChain, PolicyChain]:
    rng = np.random.default_rng(seed)
    pairs = [[int(rng.choice(mdp.pairs_of(s))) for s in range(mdp.n_states)] for _ in range(2)]
    one, other = (PolicyChain.of(mdp, mdp.pair_action[each]) for each in pairs)
    return one, other


def values_of(chain: PolicyChain) -> tuple[list[F], list[F]]:
    """Values and visits of a policy, exactly."""
    mdp, rate = chain.mdp, chain.mdp.discount_exact
    law = oracle.rows_of(mdp, chain.pairs.tolist())
    over = set(np.flatnonzero(mdp.terminal).tolist())
    moves = [{} if s in over else {t: rate * p for t, p in row.items()} for s, _, _, row in law]
    return oracle.policy_values(law, rate, over), oracle.visits(dict(mdp.start), moves)


@pytest.mark.parametrize("discount", [F(1, 2), F(1)])
def test_what_one_use_of_a_pair_can_move(discount: F) -> None:
    for seed in range(12):
        mdp = in_floats(seed, discount)
        value = np.random.default_rng(seed).normal(size=mdp.n_states) * 10
        known = BoundedVector(value=value, error=np.zeros(mdp.n_states))
        for rewards in (True, False):
            wanted = moved_by_use(mdp, value, rewards)
            found = per_use(mdp, known, rewards=rewards)
            assert (found >= wanted).all()
            assert found == pytest.approx(wanted, rel=1e-5, abs=1e-29)
        doubt = np.arange(1, mdp.n_states + 1) / 8
        unsure = BoundedVector(value=value, error=doubt)
        more = per_use(mdp, unsure) - per_use(mdp, known)
        for pair, row in outcomes(mdp):
            wide = sum(half(p) * doubt[t] for p, t, _ in row if p < 1) * mdp.float_probabilities
            assert more[pair] == pytest.approx(wide * mdp.discount, rel=1e-3, abs=1e-22)


def test_exact_numbers_are_forgiven_nothing() -> None:
    mdp = small_model(0)
    one, other = policies(mdp, 0)
    known = round_finite_values(np.array(values_of(one)[0], dtype=object))
    assert compute_rounding_allowance(mdp, (one, known), (other, known)) == 0
    assert per_use(mdp, known).max() < 1e-290
    assert per_use(mdp, known).max() <= bound_per_use(mdp, known) < 1e-290


@pytest.mark.parametrize("discount", [F(0), F(1, 2), F(1)])
def test_what_is_forgiven_between_two_policies(discount: F) -> None:
    for seed in range(12):
        mdp = in_floats(seed, discount, falling=seed % 2 == 0)
        one, other = policies(mdp, seed)
        (own, met), (best, came) = values_of(one), values_of(other)
        known = [
            (c, round_finite_values(np.array(v, dtype=object)))
            for c, v in ((one, own), (other, best))
        ]
        total = 0.0
        for pair, row in outcomes(mdp):
            s = int(mdp.pair_state[pair])
            if mdp.terminal[s]:
                continue
            u, v = (float(d[s]) * float(c.chosen[pair]) for d, c in ((met, one), (came, other)))
            x = [
                v * (r + mdp.discount * float(best[t])) - u * (r + mdp.discount * float(own[t]))
                for _, t, r in row
            ]
            total += abs(v - u) * of_rewards(mdp, row) + of_row(mdp, row, x)
        found = compute_rounding_allowance(mdp, known[0], known[1])
        assert found >= F(total) * F(999999, 1000000)
        assert float(found) == pytest.approx(total, rel=1e-5, abs=1e-28)


def test_where_a_policy_stays_for_ever_nothing_moves() -> None:
    rows: Any = [
        (0, 0, [(0.3, 1, 0.1), (0.7, 2, 0.7)]),
        (1, 0, [(0.4, 1, 0.0), (0.6, 1, 0.0)]),
        (2, 0, [(1.0, 2, 0.0)]),
        (1, 1, [(1.0, 2, 0.3)]),
        (3, 0, [(0.5, 0, 0.4), (0.5, 0, 0.9)]),
    ]
    mdp = MDP.from_outcomes(rows, start=3)
    stays, leaves = PolicyChain.of(mdp, [0, 0, 0, 0]), PolicyChain.of(mdp, [0, 1, 0, 0])
    zero = BoundedVector(value=np.zeros(4), error=np.zeros(4))
    found = float(compute_rounding_allowance(mdp, (stays, zero), (leaves, zero)))
    assert found == pytest.approx(0.3 * half(0.3), rel=1e-3, abs=1e-28)
    again = float(compute_rounding_allowance(mdp, (stays, zero), (stays, zero)))
    assert 0 < again < 1e-28


def test_nothing_is_forgiven_where_visits_are_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = in_floats(0, F(1, 2))
    one, other = policies(mdp, 0)
    known = BoundedVector(value=np.zeros(mdp.n_states), error=np.zeros(mdp.n_states))
    endless = BoundedVector(value=np.full(mdp.n_states, np.inf), error=np.zeros(mdp.n_states))
    assert compute_rounding_allowance(mdp, (one, endless), (other, endless)) == 0
    large = BoundedVector(value=np.full(mdp.n_states, 1e308), error=np.zeros(mdp.n_states))
    in_floats_alone = in_floats(3, F(99, 100), leaving=False)
    both = policies(in_floats_alone, 0)
    assert compute_rounding_allowance(in_floats_alone, (both[0], large), (both[1], large)) == 0

    def unbounded(_: Any) -> Any:
        raise SolverError(Status.NO_BOUND)

    monkeypatch.setattr(PolicyEquations, "visits", property(unbounded))
    assert compute_rounding_allowance(mdp, (one, known), (other, known)) == 0


def test_what_is_unsure_of_visits_and_values_is_forgiven_as_well(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Of uses v and u that are known up to e_v and e_u, and values V up to e: |v - u| + e_v + e_u
    in place of |v - u|, and errors e_v |r + γ V| + (v + e_v) γ e, and so for u, beside x."""
    for seed in range(6):
        mdp = in_floats(seed, F(1, 2))
        rng, both = np.random.default_rng(seed), policies(mdp, seed)
        known, met = (
            [
                BoundedVector(value=rng.random(mdp.n_states), error=rng.random(mdp.n_states) / 8)
                for _ in both
            ]
            for _ in range(2)
        )
        visits = {id(chain): each for chain, each in zip(both, met, strict=True)}
        monkeypatch.setattr(
            PolicyEquations, "visits", property(lambda of, visits=visits: visits[id(of.chain)])
        )
        total = 0.0
        for pair, row in outcomes(mdp):
            s = int(mdp.pair_state[pair])
            live = [
                float(chain.chosen[pair] * chain.reached[s] * (not mdp.terminal[s]))
                for chain in both
            ]
            use = [x * float(each.value[s]) for x, each in zip(live, met, strict=True)]
            off = [x * float(each.error[s]) for x, each in zip(live, met, strict=True)]
            worth = [[r + float(v.value[t]) / 2 for _, t, r in row] for v in known]
            doubt = [[float(v.error[t]) / 2 for _, t, _ in row] for v in known]
            x = [use[1] * b - use[0] * a for a, b in zip(*worth, strict=True)]
            wide = [
                sum(off[k] * abs(worth[k][i]) + (use[k] + off[k]) * doubt[k][i] for k in range(2))
                for i in range(len(row))
            ]
            total += (abs(use[1] - use[0]) + sum(off)) * of_rewards(mdp, row) + of_row(mdp, row, x)
            if mdp.float_probabilities:
                total += sum(
                    half(p) * each for (p, _, _), each in zip(row, wide, strict=True) if p < 1
                )
        pairs = [*zip(both, known, strict=True)]
        found = compute_rounding_allowance(mdp, pairs[0], pairs[1])
        assert found >= F(total)
        assert float(found) == pytest.approx(total, rel=1e-5, abs=1e-28)


def test_states_in_which_the_optimum_stays_add_nothing_to_a_tie() -> None:
    rows: Any = [
        (0, 0, [(0.3, 1, 0.1), (0.7, 3, 0.2)]),
        (1, 0, [(0.3, 1, 0.0), (0.7, 2, 0.0)]),
        (2, 0, [(0.9, 1, 0.0), (0.1, 2, 0.0)]),
        (2, 1, [(1.0, 3, -1.0)]),
        (3, 0, [(1.0, 3, 0.0)]),
        (4, 0, [(0.5, 3, 0.3), (0.5, 4, 0.7)]),
        (4, 1, [(1.0, 3, 0.7)]),
    ]
    mdp = MDP.from_outcomes(rows)
    value = np.array([3.0, 1.0, 5.0, 0.0, 2.0])
    e = moved_by_use(mdp, value)
    stays = PolicyChain.of(mdp, [0, 0, 0, 0, 0])
    found = compute_tie_gaps(stays, BoundedVector(value=value, error=np.zeros(5)))
    later = [0, 0, 0, 0, 2 * e[5]]
    wanted = [
        e[pair] + sum(p * later[t] for p, t, _ in row) + later[int(mdp.pair_state[pair])]
        for pair, row in outcomes(mdp)
    ]
    assert found == pytest.approx(wanted, rel=1e-5, abs=1e-28)


@pytest.mark.parametrize("discount", [F(0), F(1, 2), F(1)])
def test_the_gap_of_a_tie(discount: F) -> None:
    """e + γ P F + F, with F what the optimum collects of e."""
    for seed in range(9):
        mdp = in_floats(seed, discount)
        best, _ = policies(mdp, seed)
        value = np.array(values_of(best)[0], dtype=object)
        e = moved_by_use(mdp, value)
        law = oracle.rows_of(mdp, best.pairs.tolist())
        over = set(np.flatnonzero(mdp.terminal).tolist())
        taken = [
            (s, a, F(e[pair]), row)
            for pair, (s, a, _, row) in zip(best.pairs.tolist(), law, strict=True)
        ]
        later = oracle.policy_values(taken, discount, over)
        wanted = [
            e[pair] + float(discount * oracle.mean(row, later) + later[s])
            for pair, (s, _, _, row) in enumerate(oracle.rows_of(mdp))
        ]
        found = compute_tie_gaps(best, round_finite_values(value))
        assert found == pytest.approx(wanted, rel=1e-4, abs=1e-28)
        assert (found >= np.array(wanted)).all()


def test_infinite_values_are_counted_as_none() -> None:
    point = round_finite_values(np.array([F(1, 3), np.inf, -np.inf, F(0)], dtype=object))
    assert point.value.tolist() == [1 / 3, 0, 0, 0]
    assert point.error[0] == 2.0**-53 / 3
    assert 0 < point.error[1] == point.error[3] < 1e-290


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("seed", range(10))
def test_no_use_of_a_pair_is_forgiven_more_than_the_widest(exact: bool, seed: int) -> None:
    """Of rewards that differ by orders of magnitude, beside exact rows and rows of floats."""
    rng = np.random.default_rng(seed)
    rows: Any = [[[F(1, 3)] * 3] * 3] * 2 if exact else rng.dirichlet(np.full(3, 0.5), size=(2, 3))
    rewards = rng.normal(size=(2, 3, 3)) * 10.0 ** rng.integers(-9, 9, size=(2, 3, 1))
    mdp = MDP.from_arrays(rows, rewards, discount="1/2")
    value = rng.normal(size=3) * 10.0 ** rng.integers(-9, 9)
    known = BoundedVector(value=value, error=np.abs(value) / 10.0 ** rng.integers(1, 16))
    assert per_use(mdp, known).max() <= bound_per_use(mdp, known)


def test_a_use_may_be_forgiven_as_much_as_the_widest() -> None:
    """Of two outcomes that are equally likely, which differ as much as any two."""
    for far in (0, 10**6):
        rows: Any = [(0, 0, [(0.5, 1, F(far)), (0.5, 1, F(far + 1))]), (1, 0, [(1.0, 1, F(far))])]
        mdp = MDP.from_outcomes(rows, "1/2")
        known = round_finite_values(np.full(2, F(0), dtype=object))
        most, bound = per_use(mdp, known).max(), bound_per_use(mdp, known)
        assert most <= bound <= most * (1 + 1e-9)


def test_the_widest_is_no_wider_than_the_greatest_numbers() -> None:
    rng = np.random.default_rng(0)
    for seed in range(10):
        mdp = in_floats(seed, F(1, 2))
        value, error = rng.normal(size=mdp.n_states), rng.random(mdp.n_states)
        gain = mdp.table.compute_gains()
        size = float(np.abs(gain).max() + np.abs(value).max())
        spread = float(np.ptp(gain)) + float(np.ptp(value) + 2 * error.max()) / 2
        wanted = mdp.float_rewards * size + mdp.float_probabilities * spread / 2
        found = bound_per_use(mdp, BoundedVector(value=value, error=error))
        assert found == pytest.approx(wanted * 2.0**-53, rel=1e-5, abs=1e-29)
