"""Many policies at once, each beside its own values and visits in fractions."""

from fractions import Fraction as F

import numpy as np
import oracle
import pytest
from small_models import small_model

from exact_mdp import MDP
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.values.layers import Layers, find_taken_pairs

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
