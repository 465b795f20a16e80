"""Many policies at once, each beside its own values and visits in fractions."""

from fractions import Fraction as F

import numpy as np
import oracle
import pytest
from small_models import small_model

from exact_mdp import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.learning.sampler import build_q_table_rows
from exact_mdp.solvers.values import layers as module
from exact_mdp.solvers.values.layers import Layers, evaluate_row_policies, find_taken_pairs

DISCOUNTS = [F(0), F(2, 3), F(1)]


def some_policies(mdp: MDP, count: int, seed: int) -> Integers:
    """Pairs (S, N), one of each state in each policy."""
    rng = np.random.default_rng(seed)
    each = [rng.choice(mdp.pairs_of(s), size=count) for s in range(mdp.n_states)]
    return np.array(each).reshape(mdp.n_states, count)


def ends_of(mdp: MDP) -> set[int]:
    return set(np.flatnonzero(mdp.terminal).tolist())


def reached(mdp: MDP) -> set[int]:
    """States to which some policy leads from the start."""
    found, before = {s for s, p in mdp.start if p}, set[int]()
    while found != before:
        before = set(found)
        found |= {t for s, _, _, row in oracle.rows_of(mdp) if s in before for t in row}
    return found


@pytest.mark.parametrize("discount", DISCOUNTS)
def test_values_of_policies(discount: F) -> None:
    for seed in range(5):
        mdp = small_model(seed, discount, falling=True, states=6)
        pairs, here = some_policies(mdp, 7, seed), reached(mdp)
        value, off = Layers(mdp).evaluate_pairs(pairs)
        assert value.shape == pairs.shape
        assert off.tolist() == [0.0] * 7
        for k in range(7):
            law = oracle.rows_of(mdp, pairs[:, k].tolist())
            exact = oracle.policy_values(law, discount, ends_of(mdp))
            wanted = [float(v) if s in here else 0.0 for s, v in enumerate(exact)]
            assert value[:, k] == pytest.approx(wanted, rel=1e-13, abs=1e-14)
        reward = np.arange(mdp.n_pairs) / 4
        other, _ = Layers(mdp).evaluate_pairs(pairs, reward)
        law = [
            (s, a, F(pair, 4), row)
            for pair, (s, a, _, row) in zip(
                pairs[:, 0].tolist(), oracle.rows_of(mdp, pairs[:, 0].tolist()), strict=True
            )
        ]
        exact = oracle.policy_values(law, discount, ends_of(mdp))
        wanted = [float(v) if s in here else 0.0 for s, v in enumerate(exact)]
        assert other[:, 0] == pytest.approx(wanted, rel=1e-13, abs=1e-14)


@pytest.mark.parametrize("discount", DISCOUNTS)
def test_the_best_among_sets_of_actions(discount: F) -> None:
    for seed in range(5):
        mdp = small_model(seed, discount, falling=True)
        rng, here = np.random.default_rng(seed), reached(mdp)
        allowed = rng.random((mdp.n_pairs, 4)) < 0.6
        allowed[some_policies(mdp, 4, seed), np.arange(4)] = True
        value, q, off = Layers(mdp).solve_allowed(allowed)
        assert off.tolist() == [0.0] * 4
        for k in range(4):
            rows = oracle.rows_of(mdp, np.flatnonzero(allowed[:, k]).tolist())
            exact, _ = oracle.solve_exact(mdp.n_states, rows, discount)
            wanted = [float(v) if s in here else 0.0 for s, v in enumerate(exact)]
            assert value[:, k] == pytest.approx(wanted, rel=1e-13, abs=1e-14)
            for pair, (s, _, r, row) in enumerate(oracle.rows_of(mdp)):
                live = s in here and not mdp.terminal[s]
                exactly = float(r + discount * oracle.mean(row, exact)) if live else 0.0
                assert q[pair, k] == pytest.approx(exactly, rel=1e-13, abs=1e-14)


@pytest.mark.parametrize("discount", DISCOUNTS)
def test_visits_of_mixtures(discount: F) -> None:
    for seed in range(5):
        mdp = small_model(seed, discount, falling=True)
        shares = np.random.default_rng(seed).integers(1, 5, size=(mdp.n_pairs, 3)).astype(float)
        shares /= np.add.reduceat(shares, mdp.pair_offsets[:-1])[mdp.pair_state]
        shares[:, 0] = 0
        shares[some_policies(mdp, 1, seed)[:, 0], 0] = 1
        found = Layers(mdp).compute_visits(shares)
        assert found.shape == (mdp.n_states, 3)
        for k in range(3):
            chances = {
                (int(s), int(a)): F(float(p))
                for s, a, p in zip(mdp.pair_state, mdp.pair_action, shares[:, k], strict=True)
            }
            law = oracle.mixed(oracle.rows_of(mdp), chances)
            moves = [
                {} if mdp.terminal[s] else {t: discount * p for t, p in row.items()}
                for s, _, _, row in law
            ]
            exact = oracle.visits(dict(mdp.start), moves)
            assert found[:, k] == pytest.approx([*map(float, exact)], rel=1e-13)


def test_a_model_that_begins_in_an_end_has_no_blocks() -> None:
    mdp = small_model(1, falling=True)
    over = mdp.with_(start=int(np.flatnonzero(mdp.terminal)[0]))
    layers = Layers(over)
    assert layers.blocks == []
    assert not layers.evaluate_pairs(some_policies(over, 2, 0))[0].any()


def test_policies_say_nothing_where_there_is_no_choice() -> None:
    for seed in range(10):
        mdp = small_model(seed, falling=True)
        key = np.random.default_rng(seed).integers(0, 3, size=mdp.n_states)
        policies = np.random.default_rng(seed + 1).integers(0, mdp.n_actions, size=(5, 3))
        pairs = find_taken_pairs(mdp, key, policies)
        for state in range(mdp.n_states):
            named = {int(mdp.pair_action[pair]): pair for pair in mdp.pairs_of(state)}
            for k in range(5):
                first = mdp.pairs_of(state)[0]
                action = int(policies[k, key[state]])
                wanted = first if len(named) == 1 else named.get(action, first)
                assert pairs[state, k] == wanted


@pytest.mark.parametrize("discount", DISCOUNTS)
@pytest.mark.parametrize("numbers", [2**22, 1])
def test_start_values_are_bounded(
    discount: F, numbers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In one table or in several, and one by one where states lead back to each other."""
    monkeypatch.setattr(module, "BLOCK", numbers)
    for seed in range(5):
        mdp = small_model(seed, discount, falling=seed % 4 > 0)
        rows = build_q_table_rows(mdp)
        names = [mdp.pair_action[mdp.pairs_of(s)] for s in range(mdp.n_states)]
        rng = np.random.default_rng(seed)
        policies = np.array([[rng.choice(each) for each in names] for _ in range(5)])
        point = evaluate_row_policies(mdp, rows, policies)
        for policy, value, error in zip(policies, point.value, point.error, strict=True):
            pairs = [mdp.pair(s, int(a)) for s, a in enumerate(policy)]
            exact = oracle.policy_values(oracle.rows_of(mdp, pairs), discount, ends_of(mdp))
            start = sum((p * exact[s] for s, p in mdp.start), F(0))
            assert abs(F(float(value)) - start) <= F(float(error))
            size = [(s, a, abs(r), row) for s, a, r, row in oracle.rows_of(mdp, pairs)]
            most = oracle.policy_values(size, discount, ends_of(mdp))
            whole = float(sum((p * most[s] for s, p in mdp.start), F(0)))
            if seed % 4:
                # Each step rounds products, sums and a few numbers; then the start adds up all.
                longest = int(np.diff(mdp.transition.indptr).max())
                steps = len(Layers(mdp).blocks) * (longest + 6) + mdp.n_states
                assert steps * 2.0**-53 * whole <= error <= (steps + 8) * 2.0**-53 * whole + 1e-290


def test_errors_cover_roundings_of_long_ways() -> None:
    """Rewards that nearly cancel along a hundred steps with three outcomes each."""
    rng, rows = np.random.default_rng(7), []
    for s in range(100):
        p = rng.integers(1, 99, size=3).tolist()
        following = [s + 1, s + 2, s + 3]
        each = [
            (F(w, sum(p)), min(t, 100), F(float(rng.normal() * 1e6)))
            for w, t in zip(p, following, strict=True)
        ]
        rows.append((s, 0, each))
    rows.append((100, 0, [(F(1), 100, F(0))]))
    mdp = MDP.from_outcomes(rows)
    point = evaluate_row_policies(mdp, build_q_table_rows(mdp), np.zeros((1, 101), dtype=np.int64))
    exact = oracle.policy_values(oracle.rows_of(mdp), F(1), {100})[0]
    assert abs(F(float(point.value[0])) - exact) <= F(float(point.error[0]))


def test_rewards_at_the_end_of_the_range_of_floats() -> None:
    for reward in (F(0), F(1, 3 * 10**320)):
        rows = [(0, 0, [(F(1, 3), 1, reward), (F(2, 3), 2, reward)]), (1, 0, [(1, 2, reward)])]
        mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])
        point = evaluate_row_policies(
            mdp, build_q_table_rows(mdp), np.zeros((1, 3), dtype=np.int64)
        )
        exact = reward * F(4, 3)
        assert abs(F(float(point.value[0])) - exact) <= F(float(point.error[0])) <= F(1, 2**900)
