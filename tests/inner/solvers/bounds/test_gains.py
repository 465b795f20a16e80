"""What pairs add to values: beside fractions, with the roundings that the definitions count."""

from collections.abc import Iterator
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from oracle import mean, rows_of

from exact_mdp import MDP, SolverError
from exact_mdp.solvers.bounds import gains as module
from exact_mdp.solvers.bounds.gains import (
    FEW,
    SLACK,
    TINY,
    UNIT,
    Advantages,
    Weights,
    choose_greedy_pairs,
    component_errors,
    compute_advantages,
    count_roundings,
    first_of,
    gamma,
    largest_error,
    reward_errors,
    rounding_facts,
    row_error,
)

Array = np.ndarray[Any, Any]
RATES = (0, 0.5, "9/10", 1 - F(1, 10**9), 1)


def models(kind: type = F) -> Iterator[MDP]:
    """Models with states of several numbers of actions, exact or of floats."""
    rng = np.random.default_rng(0)
    for rate in RATES * 4:
        size, rows = int(rng.integers(1, 6)), list[Any]()
        for s in range(size):
            for a in sorted(rng.choice(4, rng.integers(1, 4), replace=False).tolist()):
                weights = rng.integers(1, 9, rng.integers(1, 5)).tolist()
                law = [(kind(F(w, sum(weights))), int(rng.integers(0, size)),
                        kind(F(int(rng.integers(-9, 10)), 7))) for w in weights]  # fmt: skip
                rows.append((s, a, law))
        yield MDP.from_outcomes(rows, rate)


def values(rng: np.random.Generator, mdp: MDP) -> Iterator[Array]:
    yield np.zeros(mdp.n_states)
    for size in (1e-6, 1.0, 1e9):
        yield size * rng.normal(size=mdp.n_states)
    yield 1e6 + rng.normal(size=mdp.n_states)


def added(mdp: MDP, value: Array, reward: Array | None = None) -> list[F]:
    """What each pair adds, exactly."""
    exact, listed = [F(float(x)) for x in value], list[F]()
    for pair, (s, _, r, law) in enumerate(rows_of(mdp)):
        own = r if reward is None else F(float(reward[pair]))
        listed.append(own + mdp.discount_exact * mean(law, exact) - exact[s])
    return listed


@pytest.mark.parametrize("kind", [F, float])
@pytest.mark.parametrize("compiled", [0, 20_000])
def test_what_is_added_is_exact_up_to_the_error(
    kind: type, compiled: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "COMPILED", compiled)
    rng = np.random.default_rng(1)
    for mdp in models(kind):
        for value in values(rng, mdp):
            for reward in (None, rng.normal(size=mdp.n_pairs)):
                found = compute_advantages(mdp, value, reward=reward)
                exact = added(mdp, value, reward)
                each = zip(found.value.tolist(), exact, found.error.tolist(), strict=True)
                assert all(abs(F(x) - y) <= F(e) for x, y, e in each)


def test_pairs_are_computed_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """However few transitions a block has, its pairs get what they get all at once."""
    rng = np.random.default_rng(7)
    for mdp in models():
        value = rng.normal(size=mdp.n_states)
        whole = compute_advantages(mdp, value)
        monkeypatch.setattr(module.threads, "IN_CACHE", 1)
        ends = module.threads.block_ends(mdp.transition.indptr, most=1)
        assert len(ends) == mdp.n_pairs + 1
        parts = compute_advantages(mdp, value)
        monkeypatch.undo()
        for name in ("value", "error", "noise"):
            np.testing.assert_array_equal(getattr(parts, name), getattr(whole, name))


@pytest.mark.parametrize("kind", [F, float])
def test_errors_count_the_roundings_on_the_way(kind: type) -> None:
    """γ(n + 8) of the flow, γ(4) of the reward and of (1 - γ) V, whose factor is rounded once."""
    rng = np.random.default_rng(2)
    for mdp in models(kind):
        leak = float(1 - mdp.discount_exact)
        assert rounding_facts(mdp).leak == leak
        for value in values(rng, mdp):
            for reward in (None, rng.normal(size=mdp.n_pairs)):
                found = compute_advantages(mdp, value, reward=reward)
                earned = mdp.reward if reward is None else reward
                own, count = value[mdp.pair_state], count_roundings(mdp)
                dense = mdp.transition.toarray()
                flow = mdp.discount * (dense * np.abs(value[None, :] - own[:, None])).sum(axis=1)
                tiny = TINY * (1 + np.abs(value).max()) * (count + 1) if value.any() else 0
                wanted = gamma(count + 8) * flow + FEW * (np.abs(earned) + leak * np.abs(own))
                wanted += UNIT * leak * np.abs(own) + tiny
                wanted += reward_errors(mdp) if reward is None else 0
                np.testing.assert_allclose(found.error, wanted * SLACK, rtol=1e-9, atol=0)
                size = flow + np.abs(own) + np.abs(earned)
                noise = gamma(count + 8) * size + found.error
                np.testing.assert_allclose(found.noise, noise, rtol=1e-9, atol=0)


def test_gamma_is_no_less_than_n_units() -> None:
    for n in (1, 4, 9, 1000, 2**30):
        exact = n * F(1, 2**53) / (1 - n * F(1, 2**53))
        assert exact <= F(gamma(n)) <= exact * (1 + F(8, 2**53))
    assert gamma(4) == FEW
    assert (UNIT, SLACK, TINY) == (2**-53, 1 + 2**-20, 2**-1000)


def test_an_error_of_any_row_is_that_of_its_parts() -> None:
    flow, earned, own = np.array([3.0, 0, 0]), np.array([0, -2.0, 0]), np.array([0, 0, -5.0])
    error = row_error(0.25, np.array([7, 1, 1]), flow, earned, own)
    np.testing.assert_allclose(
        error, [gamma(15) * 3, FEW * 2, FEW * 1.25 + UNIT * 1.25], rtol=1e-14
    )


def test_terms_are_the_numbers_that_are_added_up() -> None:
    for mdp in models():
        assert count_roundings(mdp).tolist() == [len(law) for *_, law in rows_of(mdp)]
    twice: Any = [(0, 0, [(0.25, 0, 1.0), (0.25, 0, 2.0), (0.5, 1, 0.0)]), (1, 0, [(1.0, 1, 0.0)])]
    assert count_roundings(MDP.from_outcomes(twice)).tolist() == [6, 2]
    once: Any = [(0, 0, [(0.5, 0, 1.0), (0.5, 1, 0.0)]), (1, 0, [(1.0, 1, 0.0)])]
    assert count_roundings(MDP.from_outcomes(once)).tolist() == [2, 1]


@pytest.mark.parametrize("kind", [F, float])
def test_rewards_are_exact_up_to_their_error(kind: type) -> None:
    for mdp in models(kind):
        errors = reward_errors(mdp)
        assert errors.shape == (mdp.n_pairs,)
        for pair, (_, _, exact, _) in enumerate(rows_of(mdp)):
            off = abs(F(float(mdp.reward[pair])) - exact)
            assert off <= F(float(errors[pair]))
        table = mdp.table
        if kind is float and table.joint:
            count, paid = (
                np.diff(table.offsets),
                table.compute_probabilities() * np.abs(table.compute_gains()),
            )
            total = np.add.reduceat(paid, table.offsets[:-1])
            wanted = gamma(2 * count + 2) * total * SLACK + count * TINY
        else:
            wanted = UNIT * np.abs(mdp.reward) + TINY * bool(mdp.reward.any())
        np.testing.assert_allclose(errors, wanted, rtol=1e-12)
        facts = rounding_facts(mdp)
        assert facts.most_reward_error == errors.max()
        assert facts.size == np.abs(mdp.reward).max()
        assert facts.most == count_roundings(mdp).max()


def test_components_are_exact_up_to_their_errors() -> None:
    rows: Any = [(0, 0, [(0.5, 0, 1.5), (0.5, 1, 1.5)]), (0, 1, [(1.0, 1, 0.7)]),
                 (1, 0, [(1.0, 1, 0.0)])]  # fmt: skip
    mdp = MDP.from_outcomes(rows, components={"a": [1.25, 0.3, 0.0], "b": [0.25, 0.4, 0.0]})
    errors = component_errors(mdp)
    assert errors.shape == (3, 2)
    np.testing.assert_allclose(errors, UNIT * np.abs(mdp.components) + TINY, rtol=1e-12)


def test_what_is_beyond_the_floats_is_refused() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, 1)])], "1/2")
    for value in ([np.inf, 0.0], [np.nan, 0.0], [1.7e308, -1.7e308]):
        with pytest.raises(SolverError, match="beyond the range of floats"):
            compute_advantages(mdp, np.array(value))


def test_the_greatest_error_of_values_in_a_range() -> None:
    rng = np.random.default_rng(3)
    for mdp in models():
        for low, high in ((-2.0, 1.0), (0.0, 1e6), (-3.0, -1.0), (0.0, 0.0)):
            bound = largest_error(mdp, low, high)
            for _ in range(5):
                value = rng.uniform(low, high, mdp.n_states)
                assert compute_advantages(mdp, value).error.max() <= bound
            facts, size = rounding_facts(mdp), max(abs(low), abs(high))
            wanted = gamma(facts.most + 8) * 1.001 * mdp.discount * (high - low)
            wanted += FEW * (facts.size + facts.leak * size) + UNIT * facts.leak * size
            wanted += facts.most_reward_error + TINY * (1 + size) * (facts.most + 1)
            np.testing.assert_allclose(bound, wanted * SLACK, rtol=1e-12)


# ---- choices -------------------------------------------------------------------------------------


def of_states(mdp: MDP) -> list[list[int]]:
    return [[*mdp.pairs_of(state)] for state in range(mdp.n_states)]


def test_the_first_pair_that_no_other_beats_is_taken() -> None:
    """Ties of one level are settled by the next."""
    rng = np.random.default_rng(4)
    for mdp in models():
        levels = []
        for _ in range(2):
            value = rng.integers(-2, 3, mdp.n_pairs).astype(float)
            noise = rng.choice([0.0, 0.25, 0.5, 1.0], mdp.n_pairs)
            levels.append(Advantages(value=value, error=noise, noise=noise))
        wanted, left = list[int](), set[int]()
        for pairs in of_states(mdp):
            for level in levels:
                best = max(level.value[pair] - level.noise[pair] for pair in pairs)
                pairs = [p for p in pairs if level.value[p] + level.noise[p] >= best]
            wanted.append(pairs[0])
            left |= {*pairs}
        assert choose_greedy_pairs(mdp, *levels).tolist() == wanted
        keep = np.array([int(rng.choice(pairs)) for pairs in of_states(mdp)])
        kept = [int(own) if own in left else first for own, first in zip(keep, wanted, strict=True)]
        assert choose_greedy_pairs(mdp, *levels, keep=keep).tolist() == kept


def test_the_first_of_some_pairs_of_each_state() -> None:
    rng = np.random.default_rng(5)
    for mdp in models():
        some = rng.random(mdp.n_pairs) < 0.5
        some[[pairs[-1] for pairs in of_states(mdp)]] = True
        wanted = [next(pair for pair in pairs if some[pair]) for pairs in of_states(mdp)]
        assert first_of(mdp, some).tolist() == wanted


def test_weights_make_gains_into_steps() -> None:
    """c · m ≥ gain for every margin m within the error of the one that is known."""
    rng = np.random.default_rng(6)
    margin, error = rng.uniform(0.5, 2, 9), 0.25
    weights = Weights(value=np.ones(3), margin=margin, error=error)
    gain = rng.normal(size=9)
    gain[0] = 0.0
    step = weights.compute_ratios(gain)
    for m in (margin - error, margin, margin + error):
        assert (step * m >= gain - 1e-15).all()
    least = np.where(gain > 0, gain / (margin - error), gain / (margin + error))
    np.testing.assert_allclose(step, least)
    assert weights.smallest == margin.min() - error
    assert not weights.uniform
    assert Weights(value=np.ones(3), margin=np.array([0.5]), error=0.0).uniform
    floor = weights.bound_rounding(1e-9, 7.0)
    assert floor == pytest.approx((1e-9 + 7 * (error + 8 * UNIT)) / weights.smallest, rel=1e-15)
    exact = Weights(value=np.ones(3), margin=margin, error=0.0)
    assert exact.bound_rounding(0.0, 4.0) == pytest.approx(32 * UNIT / margin.min(), abs=0)


def test_what_underflows_is_counted() -> None:
    """At discount 1, with no rewards, nothing but underflow is left: of values near, or far off."""
    rows: Any = [(0, 0, [(1, 0, 0)]), (1, 0, [("1/2", 1, 0), ("1/2", 2, 0)]),
                 (2, 0, [("1/3", t, 0) for t in (1, 2, 3)]), (3, 0, [(1, 2, 0)])]  # fmt: skip
    mdp = MDP.from_outcomes(rows)
    for far in (1e-310, 1e300):
        error = compute_advantages(mdp, np.array([far, 0, 0, 0])).error
        np.testing.assert_allclose(error[1:], SLACK * TINY * (1 + far) * np.array([3, 4, 2]))
        bound = largest_error(mdp, far, far)
        assert bound == pytest.approx(SLACK * TINY * (1 + far) * 4, rel=1e-12, abs=0)
    assert not compute_advantages(mdp, np.zeros(4)).error.any()
