"""What intervals from records are made of: sets of rows, drawn models, the bootstrap."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction as F
from itertools import pairwise
from math import log
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from records import (
    LEVEL,
    NAMES,
    POLICY,
    RATE,
    STAGES,
    by_stage,
    estimated,
    patients,
    recorded,
    staged_policy,
)
from scipy import integrate, optimize, stats

from exact_mdp import (
    MDP,
    ModelError,
    OffPolicy,
    Policy,
    PolicyLike,
    Posterior,
    Robust,
    check,
    solve,
)
from exact_mdp.analysis.gate.data.bounds import robust_bounds
from exact_mdp.analysis.gate.data.off_policy import bootstrap, mean_at_least
from exact_mdp.analysis.gate.data.posterior import drawn, drawn_regrets
from exact_mdp.analysis.gate.data.sets import RowSets
from exact_mdp.analysis.vary.intervals import upper_quantile
from exact_mdp.mdp.questions import by_time
from exact_mdp.solvers import batch

Kind = Robust | Posterior | OffPolicy


def with_more(sets: RowSets, more: np.ndarray) -> RowSets:
    """Return the sets after more observations (L,) that show what was seen, in proportion."""
    counted, episodes = sets.counted + more, sets.episodes
    if episodes is not None:
        episodes *= counted.sum() / sets.counted.sum()
    return replace(sets, counted=counted, episodes=episodes)


def interval_of(by: Kind, mdp: MDP, policy: PolicyLike = POLICY, level: F = LEVEL) -> Any:
    found = check(mdp, policy, confidence=level, by=by, exact_values=False).interval
    assert found is not None
    return found


def wilson(count: int, total: int) -> tuple[float, float]:
    found = stats.binomtest(count, total).proportion_ci(0.95, "wilson")
    return found.low, found.high


# ---- where episodes begin ----------------------------------------------------------------------


def test_the_start_is_a_row_of_its_own() -> None:
    """Its set is that of a pair with the same counts, which leads where episodes begin."""
    frame = patients(0, 300)
    mdp = MDP.from_transitions(frame, discount="1/2")
    count = np.bincount(frame.state, minlength=3)
    first = pd.DataFrame(
        [(n, "first", 0, 0, s) for n, s in enumerate(np.repeat([0, 1], count[:2]).tolist())]
        + [(1000, 0, 0, 0, None), (1001, 1, 0, 0, None), (1002, 0, 1, 0, None)],
        columns=NAMES,
    )  # fmt: skip
    other = MDP.from_transitions(first, discount="1/2")
    value = np.array([0.2, 0.9, -1.0])
    for most in (False, True):
        pair = other.pair("first", "0")
        states = [other.space.number(name) for name in ("0", "1", "end")]
        values = np.zeros(4)
        values[states], values[other.space.number("first")] = value, 0.5
        # One state more, and 1 of 7 rows where the start is 1 of 5: doubts of equal parts.
        row = RowSets.of(other, 0.07, "known").worth(values, most=most).bound[pair] * 2
        start = RowSets.of(mdp, 0.05, "known").at_start(value, most=most)
        assert start == pytest.approx(row, abs=0.02)
        assert (start > value @ count / 300) == most


# ---- robust: sets ------------------------------------------------------------------------------


def test_the_radius_is_the_likelihood_ratio_of_the_prior() -> None:
    """Of two states the mixture is an integral over one number."""
    rows = [(n, "a", "x", 0, "a" if n % 3 else "b") for n in range(12)]
    rows += [(100 + n, "b", "x", 0, "b") for n in range(5)]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount="1/2")
    sets = RowSets.of(mdp, 0.1, "known")
    for pair, (a, b) in enumerate([(8, 4), (0, 5)]):

        def density(q: float, a: int = a, b: int = b) -> float:
            return float(q ** (a - 0.5) * (1 - q) ** (b - 0.5)) / np.pi  # Beta(1/2, 1/2)

        mixture, _ = integrate.quad(density, 0, 1, points=[0.01, 0.99])
        likelihood = sum(k * log(k / (a + b)) for k in (a, b) if k)
        wanted = (likelihood - log(mixture) + log(3 / 0.1)) / (a + b)  # of two pairs and the start
        assert sets.radius[pair] == pytest.approx(wanted, rel=1e-6)
        assert sets.radius[pair] >= wanted * (1 - 1e-7)


@settings(max_examples=30)
@given(st.integers(0, 10**6))
def test_nature_may_send_a_row_where_nobody_saw_it_go(seed: int) -> None:
    """The optimum over rows, next states without counts among them, by an optimiser."""
    rng = np.random.default_rng(seed)
    counts = rng.integers(0, 12, size=4) * (rng.random(4) < 0.7)
    counts[0] += 1
    rows = [(0, "0", "x", 0, str(s)) for s in np.repeat(np.arange(4), counts)]
    rows = [(n, *row[1:]) for n, row in enumerate(rows)]
    rows += [(100 + s, str(s), "x", 0, None) for s in range(1, 4)]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount="1/2")
    sets = RowSets.of(mdp, 0.1, "known")
    value, p = rng.normal(size=mdp.n_states), counts / counts.sum()
    kept = np.append(p, np.zeros(mdp.n_states - 4))
    found = {most: sets.worth(value, most=most) for most in (False, True)}
    positive = kept > 0
    for most, worth in found.items():
        sign = -1.0 if most else 1.0
        law = worth.chosen[0][[0]].toarray()[0]
        assert law.sum() == pytest.approx(1)
        assert (kept[positive] @ np.log(kept[positive] / law[positive])) <= sets.radius[0] + 1e-9
        assert abs(worth.bound[0] - value @ law / 2) < 1e-8
        # The dual of Nilim and El Ghaoui, maximised by a search on one number.
        x = sign * value
        apart = x - x.min()

        def dual(t: float, apart: np.ndarray = apart, x: np.ndarray = x) -> float:
            s = np.exp(t) * positive_or_zero(t)
            mean = kept[positive] @ np.log(apart[positive] + s)
            return -(x.min() - s + np.exp(mean - sets.radius[0]))

        best = max(
            -optimize.minimize_scalar(dual, bounds=(low, low + 10), method="bounded").fun
            for low in range(-60, 20, 10)
        )
        assert sign * worth.bound[0] * 2 <= best + 1e-6
        assert sign * worth.bound[0] * 2 >= best - 1e-5


def positive_or_zero(t: float) -> float:
    return 1.0 if t > -59 else 0.0


# ---- robust: regret ----------------------------------------------------------------------------


Model = tuple[np.ndarray, np.ndarray]  # rows (L, S) and rewards (L,)


def edge(sets: RowSets, aims: np.ndarray, most: np.ndarray) -> Model:
    """Return the model whose rows go from what was seen towards `aims` (L, S) as far as they may.

    Rewards are the greatest where `most` (L,).
    """
    seen = sets.mdp.transition.toarray()
    low, high = np.zeros((len(seen), 1)), np.ones((len(seen), 1))
    for _ in range(45):
        t = (low + high) / 2
        q = (1 - t) * seen + t * aims
        with np.errstate(divide="ignore", invalid="ignore"):
            far = np.where(seen > 0, seen * np.log(seen / q), 0.0).sum(axis=1)
        fits = (far <= sets.radius)[:, None]
        low, high = np.where(fits, t, low), np.where(fits, high, t)
    reward = np.where(most, sets.reward[1], sets.reward[0])
    return (1 - low) * seen + low * aims, sets.mdp.reward if sets.known else reward


def lost(mdp: MDP, model: Model, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return V* and V^π, (2, S), and the probabilities of pairs of both, by value iteration."""
    (rows, reward), first = model, mdp.pair_offsets[:-1]
    value = np.zeros((2, mdp.n_states))
    for _ in range(300):
        worth = reward + mdp.discount * value @ rows.T
        best = np.maximum.reduceat(worth[0], first)
        value = np.stack([best, np.add.reduceat(own * worth[1], first)])
    return value, np.stack([(worth[0] == best[mdp.pair_state]).astype(float), own])


def worst(rng: np.random.Generator, sets: RowSets, own: np.ndarray, sign: int) -> Model:
    """Return a model of the sets of great regret (sign 1) or little (-1), by steps uphill.

    A row adds γ d(s) P V to a value, d the visits: what the optimum gains by it less what the
    policy does says to which state it should go.
    """
    mdp, states = sets.mdp, sets.mdp.n_states
    aims = rng.dirichlet(np.full(states, 0.1), size=mdp.n_pairs)
    model = edge(sets, aims, rng.random(mdp.n_pairs) < 0.5)
    for _ in range(6):
        value, taken = lost(mdp, model, own)
        gain, paid = np.zeros((mdp.n_pairs, states)), np.zeros(mdp.n_pairs)
        for v, share, side in zip(value, taken, (sign, -sign), strict=True):
            mixing = np.zeros((states, mdp.n_pairs))
            mixing[mdp.pair_state, np.arange(mdp.n_pairs)] = share
            chain = np.eye(states) - mdp.discount * mixing @ model[0]
            visits = np.linalg.solve(chain.T, mdp.start_distribution)[mdp.pair_state] * share
            gain, paid = gain + side * visits[:, None] * v, paid + side * visits
        model = edge(sets, np.eye(states)[gain.argmax(axis=1)], paid > 0)
    return model


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(20, 5000), st.booleans(), st.sampled_from("mbp"))
def test_no_model_of_the_sets_has_another_regret(
    seed: int, episodes: int, known: bool, policy: str
) -> None:
    rng = np.random.default_rng(seed)
    frame = recorded(rng, episodes)
    if known:
        frame["reward"] = [
            (0.2, 0.7, 0.5)[s] + a / 4 for s, a in zip(frame.state, frame.action, strict=True)
        ]
    mdp = MDP.from_transitions(frame, discount="9/10")
    forms: dict[str, PolicyLike] = {
        "m": "random",
        "b": solve(mdp).policy,
        "p": POLICY[: mdp.n_states],
    }
    own = Policy.of(mdp, forms[policy]).weights(mdp)
    sets = RowSets.of(mdp, 0.05, "known" if known else (0, 1))
    bounds = robust_bounds(sets, own)
    low, high = bounds.regret
    for sign in (1, -1, 1, -1):
        value = lost(mdp, worst(rng, sets, own, sign), own)[0] @ mdp.start_distribution
        assert low - 1e-7 <= value[0] - value[1] <= high + 1e-7
        for whose, found in zip((bounds.best, bounds.own), value, strict=True):
            least, most = bounds.at_start(mdp, whose)
            assert least - 1e-7 <= found <= most + 1e-7


def test_the_bound_is_narrower_than_that_by_two_models() -> None:
    """What is unsure of the optimum and of the policy alike does not widen the interval."""
    mdp = estimated(recorded(np.random.default_rng(1), 3000))
    sets = RowSets.of(mdp, 0.05, (0, 1))
    best = Policy.of(mdp, solve(mdp).policy).weights(mdp)
    for own in (Policy.of(mdp, POLICY).weights(mdp), best):
        bounds = robust_bounds(sets, own)
        (least, most), (low, high) = (bounds.at_start(mdp, x) for x in (bounds.best, bounds.own))
        assert max(least - high, 0) <= bounds.regret[0] <= bounds.regret[1] < most - low
    assert bounds.regret[1] < (most - low) / 2


def test_with_ever_more_records_the_interval_is_the_regret() -> None:
    mdp = estimated(recorded(np.random.default_rng(1), 300))
    sets = RowSets.of(mdp, 0.05, (0, 1))
    sets = with_more(sets, np.where(sets.counted > 0, 1e14, 0.0))
    found = robust_bounds(sets, Policy.of(mdp, POLICY).weights(mdp)).regret
    wanted = float(check(mdp, POLICY).value.value)
    assert found == (pytest.approx(wanted, abs=1e-4), pytest.approx(wanted, abs=1e-4))


def test_at_discount_1_the_interval_is_that_of_episodes_that_stop_late() -> None:
    """By backward induction from 0, in place of a range that shrinks; the range itself is gone."""
    mdp = MDP.from_transitions(recorded(np.random.default_rng(1), 3000))
    own = Policy.of(mdp, POLICY).weights(mdp)
    sets = RowSets.of(mdp, 0.05, (0, 1))
    for most in (50.0, 5000.0):
        found = robust_bounds(sets, own, (-most, most))
        late = robust_bounds(sets, np.tile(own, (300, 1)))
        assert np.array(late.own) == pytest.approx(np.array(found.own), abs=1e-5)
        assert np.array(late.best) == pytest.approx(np.array(found.best), abs=1e-5)
        assert found.regret == pytest.approx(late.regret, abs=1e-5)
    sets = with_more(sets, np.where(sets.counted > 0, 1e14, 0.0))
    found = robust_bounds(sets, own, (-50, 50))
    wanted = float(check(mdp, POLICY).value.value)
    assert found.regret == (pytest.approx(wanted, abs=1e-4), pytest.approx(wanted, abs=1e-4))


def test_at_discount_1_where_episodes_were_cut_off_the_range_stays() -> None:
    rows = [(n, "s", "ab"[n % 2], n % 2, ("u", None)[n % 2], n % 2 == 0) for n in range(200)]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=[*NAMES, "truncated"]))
    by = Robust(rewards="known", returns=(0, 10))
    audit = check(mdp, "always:b", max_regret="1/10", confidence=0.95, by=by)
    assert audit.regret_interval is not None
    assert audit.regret_interval[1] == pytest.approx(9.0, abs=0.5)
    sets = RowSets.of(mdp, 0.05, "known")
    sets = with_more(sets, np.where(sets.counted > 0, 1e14, 0.0))
    known = robust_bounds(sets, audit.chain.weights, (0, 10)).regret
    assert known[1] == pytest.approx(9, abs=1e-4)  # no number of records decides it


# ---- episodes that stop --------------------------------------------------------------------------


@settings(max_examples=10)
@given(st.integers(0, 10**6), st.integers(20, 3000), st.booleans())
def test_no_model_of_the_sets_has_another_regret_within_a_horizon(
    seed: int, episodes: int, undiscounted: bool
) -> None:
    rng, rate = np.random.default_rng(seed), 1.0 if undiscounted else RATE
    mdp = MDP.from_transitions(recorded(rng, episodes), 1 if undiscounted else "9/10")
    if mdp.n_states != 4 or mdp.n_pairs != 7:  # every pair was seen
        return
    own = STAGES[rng.permutation(3)]
    weights = np.zeros((3, mdp.n_pairs))
    for time, actions in enumerate(own):
        for state in range(4):
            weights[time, mdp.pair(*((state, actions[state]) if state < 3 else ("end", 0)))] = 1
    sets = RowSets.of(mdp, 0.05, (0, 1))
    low, high = robust_bounds(sets, weights).regret
    models = [edge(sets, rng.dirichlet(np.full(4, 0.1), size=7), rng.random(7) < 0.5)]
    if not undiscounted:
        models += [worst(rng, sets, weights[0], sign) for sign in (1, -1)]
    for rows, reward in models:
        full = np.zeros((4, 2, 4))
        earned = np.full((4, 2), -np.inf)
        full[mdp.pair_state, mdp.pair_action] = rows
        earned[mdp.pair_state, mdp.pair_action] = reward
        best, mine = by_stage(full, earned, rate, own)
        assert low - 1e-7 <= (best - mine) @ mdp.start_distribution <= high + 1e-7


def test_with_ever_more_records_it_is_the_regret_within_the_horizon() -> None:
    mdp = MDP.from_transitions(recorded(np.random.default_rng(1), 300), discount=1)
    policy = staged_policy(mdp)
    audit = check(mdp, policy, horizon=3, confidence=0.95, by=Robust(rewards=(0, 1)))
    sets = RowSets.of(mdp, 0.05, (0, 1))
    sets = with_more(sets, np.where(sets.counted > 0, 1e14, 0.0))
    found = robust_bounds(sets, by_time(mdp, audit.chain.weights, 3)).regret
    wanted = float(audit.value.value)
    assert found == (pytest.approx(wanted, abs=1e-4), pytest.approx(wanted, abs=1e-4))
    long = check(mdp, policy=POLICY, horizon=300, confidence=0.95, by=Posterior(n=80))
    assert long.interval is not None
    other = check(mdp, POLICY, confidence=0.95, by=Posterior(n=80)).interval
    assert other is not None
    assert long.interval.high == pytest.approx(other.high, rel=1e-6)  # all are over by then


# ---- posterior ---------------------------------------------------------------------------------


@pytest.mark.parametrize("horizon", [None, 3])
def test_a_draw_is_a_model_that_is_solved(horizon: int | None) -> None:
    """Batches of dense equations agree with the toolkit's own solver, draw by draw."""
    mdp = estimated(recorded(np.random.default_rng(2), 60))
    own = Policy.of(mdp, POLICY).weights(mdp)
    if horizon:
        own = by_time(mdp, Policy.of(mdp.within(3), staged_policy(mdp)).weights(mdp.within(3)), 3)
    batch = drawn(mdp, mdp.observations > 0, 1.0, np.random.default_rng(0), 20)
    lost, table = drawn_regrets(batch, own), np.zeros((3, 4, 2))
    for time, actions in enumerate(STAGES):
        table[time, np.arange(4), actions] = 1
    for draw in range(20):
        # A row of floats sums to 1 but for rounding.
        one = MDP.from_pairs(
            mdp.pair_state, mdp.pair_action, batch.rows[draw], batch.reward[draw], "9/10",
            start=dict(enumerate(batch.start[draw])),
        )  # fmt: skip
        how: Any = {"horizon": 3, "kind": "policy"} if horizon else {}
        audit = check(one, table if horizon else POLICY, exact_values=False, **how)
        assert lost[draw] == pytest.approx(float(audit.value.value), abs=1e-8)


def test_drawn_rows_are_dirichlet() -> None:
    mdp = estimated(recorded(np.random.default_rng(2), 60))
    assert mdp.observations is not None
    assert mdp.counts is not None
    models = drawn(mdp, mdp.observations > 0, 2.0, np.random.default_rng(0), 4000)
    rows, reward, start = models.rows, models.reward, models.start
    drawn_rows = [(mdp.counts[[pair]].toarray()[0], rows[:, pair]) for pair in range(mdp.n_pairs)]
    begun = (np.array([60, 0, 0, 0]), start)
    for counts, found in [begun, *(each for each in drawn_rows if each[0].any())]:
        alpha = counts + 0.5  # 2 observations over 4 states
        n, mean = alpha.sum(), alpha / alpha.sum()
        spread = np.sqrt(mean * (1 - mean) / (n + 1))
        assert found.mean(axis=0) == pytest.approx(mean, abs=5 * spread.max() / 60)
        assert found.std(axis=0) == pytest.approx(spread, rel=0.1)
    assert reward.mean(axis=0) == pytest.approx(mdp.reward, abs=0.05)


@pytest.mark.parametrize("episodes", [40, 400])
def test_the_bootstrap_is_that_of_another_library(episodes: int) -> None:
    rng = np.random.default_rng(episodes)
    weight = rng.exponential(size=episodes) * (rng.random(episodes) < 0.6)
    returns = rng.normal(weight, 1.0)
    found = bootstrap(weight, returns, 0.9, (-9.0, 9.0), 6000, 1)
    other = stats.bootstrap(
        (weight, returns),
        lambda w, g, axis=-1: (w * g).sum(axis=axis) / w.sum(axis=axis),
        paired=True,
        vectorized=True,
        n_resamples=6000,
        confidence_level=0.9,
        method="BCa",
        random_state=np.random.default_rng(2),
    ).confidence_interval
    width = other.high - other.low
    assert found == (
        pytest.approx(other.low, abs=0.06 * width),
        pytest.approx(other.high, abs=0.06 * width),
    )
    assert bootstrap(0 * weight, returns, 0.9, (-9.0, 9.0), 10, 1) == (-9, 9)


def test_the_bootstrap_holds_the_value_where_weights_are_even() -> None:
    found = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        weight, returns = 2.0 * rng.integers(2, size=200), rng.random(200) < 0.3
        low, high = bootstrap(weight, returns.astype(float), 0.95, (0.0, 1.0), 200, seed)
        found += low <= 0.3 <= high
    assert wilson(found, 100)[1] >= float(LEVEL)


def test_the_bootstrap_widens_with_the_confidence() -> None:
    """Also where the correction for skewness has a pole: one return of many is not 0."""
    for sign in (1, -1):
        returns = sign * np.eye(1, 400)[0]
        found = [
            bootstrap(np.ones(400), returns, level, (-1.0, 1.0), 500, 0)
            for level in (0.5, 0.95, 0.9999, 1 - 1e-8, 1 - 1e-9, 1 - 1e-12)
        ]
        assert all(b[0] <= a[0] <= a[1] <= b[1] for a, b in pairwise(found))


@pytest.mark.parametrize("count", [72, 73, 150, 2000])
@pytest.mark.parametrize("level", [0.5, 0.9, 0.95])
def test_the_upper_end_is_the_order_statistic_that_covers(level: float, count: int) -> None:
    """Its coverage by another library's distribution, and that none lower has it; and in draws."""
    rank = int(upper_quantile(np.arange(1.0, count + 1), level))
    below = stats.binom(count, level).cdf
    assert below(rank - 1) >= 0.975 > below(rank - 2)
    samples = np.sort(np.random.default_rng(count).random((4000, count)), axis=1)
    assert (samples[:, rank - 1] >= level).mean() >= 0.975 - 4 * (0.975 * 0.025 / 4000) ** 0.5


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_the_bound_is_that_of_the_theorem(seed: int) -> None:
    """Theorem 1 of Thomas and others as it is printed, with its double sum."""
    sample = np.random.default_rng(seed).exponential(size=120) ** 2
    found, doubt = mean_at_least(sample, 0.05), 0.05
    rest = sample[6:]
    n = len(rest)

    def theorem(c: float) -> float:
        y = np.minimum(rest, c)
        double = np.square(np.subtract.outer(y / c, y / c)).sum()
        scale = 1 / (n / c)
        middle = 7 * n * log(2 / doubt) / (3 * (n - 1))
        return float(
            scale * (y / c).sum()
            - scale * middle
            - scale * (log(2 / doubt) / (n - 1) * double) ** 0.5
        )

    grid = sample[:6].max() * np.geomspace(1e-4, 2.0, 200)
    assert found == 0 or min(abs(found - theorem(c)) for c in grid) < 1e-9
    assert found <= max(0.0, *(theorem(c) for c in grid)) + 1e-9


def test_drawn_models_whose_policies_do_not_settle_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Values of policies that may still improve would let wide bounds pass for no regret."""
    rows = [[["1/2", "1/2"], [0, 1]], [[0, 1], [1, 0]]]
    mdp = MDP.from_arrays(rows, [[0, 1], [0, 4]], "9/10")
    known = np.zeros(mdp.n_pairs, dtype=bool)
    models = drawn(mdp, known, 1.0, np.random.default_rng(0), 3)
    own = np.array([1.0, 0.0, 1.0, 0.0])  # the first policy that is tried, and two are better
    assert (drawn_regrets(models, own) > 0).all()
    monkeypatch.setattr(batch, "IMPROVEMENTS", 1)
    with pytest.raises(ModelError, match="drawn from the posterior is not solved"):
        drawn_regrets(models, own)
