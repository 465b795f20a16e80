"""What intervals from records are made of: sets of rows, and drawn models."""

from dataclasses import replace
from math import exp, lgamma, log
from typing import Any

import numpy as np
import pandas as pd
import pytest
from flint import arb, ctx
from hypothesis import given, settings
from hypothesis import strategies as st
from records import NAMES, POLICY, STAGES, estimated, recorded, staged_policy
from scipy import integrate, optimize

from exact_mdp import MDP, ModelError, Policy, Robust, check, solve
from exact_mdp.analysis.gate.data.posterior import drawn_regrets, sample_models
from exact_mdp.analysis.gate.data.robust import robust_bounds
from exact_mdp.analysis.gate.data.sets import RowSets, _bound_mean_above, _compute_radii
from exact_mdp.analysis.vary.intervals import mean_at_least
from exact_mdp.mdp.questions.horizon import split_by_time
from exact_mdp.solvers import stacked

SEEDS = st.integers(0, 10**6)
Model = tuple[np.ndarray, np.ndarray]  # rows (L, S) and rewards (L,)

# ---- sets ----------------------------------------------------------------------------------------


def of_counts(counts: list[list[int]]) -> MDP:
    """Return the model of episodes of one step, `counts` (S, S) from each state to each."""
    each = np.repeat(list(np.ndindex(len(counts), len(counts))), np.ravel(counts), axis=0)
    rows = [(n, str(s), "x", 0, str(t)) for n, (s, t) in enumerate(each)]
    return MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount="1/2")


def radius(counts: np.ndarray, share: float) -> float:
    """Return log(1/δ) + log of the likelihood over its mixture by a Dirichlet prior, each."""
    n, part = counts.sum(), 1 / len(counts)
    mixture = sum(lgamma(c + part) - lgamma(part) for c in counts) - lgamma(n + 1)
    return float((sum(c * log(c / n) for c in counts if c) - mixture - log(share)) / n)


def test_the_radius_is_the_likelihood_ratio_of_the_prior() -> None:
    """Of two states the mixture is an integral over one number."""
    sets = RowSets.of(of_counts([[8, 4], [0, 5]]), 0.1, "known")
    for pair, (a, b) in enumerate([(8, 4), (0, 5)]):

        def density(q: float, a: int = a, b: int = b) -> float:
            return float(q ** (a - 0.5) * (1 - q) ** (b - 0.5)) / np.pi  # Beta(1/2, 1/2)

        mixture, _ = integrate.quad(density, 0, 1, points=[0.01, 0.99])
        likelihood = sum(k * log(k / (a + b)) for k in (a, b) if k)
        wanted = (likelihood - log(mixture) + log(3 / 0.1)) / (a + b)  # of two pairs and the start
        assert wanted * (1 - 1e-7) <= sets.radius[pair] <= wanted * (1 + 1e-6)
        assert wanted == pytest.approx(radius(np.array([a, b]), 0.1 / 3), rel=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_no_rounding_makes_a_set_smaller(seed: int) -> None:
    """Of a row of many outcomes, and of rewards seen 10¹³ times, in 60 digits."""
    c = np.random.default_rng(seed).integers(1, 3, size=20_000)
    n, states, doubt = int(c.sum()), 400_000, 2.0**-9
    far = _compute_radii(c / n, 0 * c, np.array([float(n)]), states, doubt)[0]
    with ctx.workprec(200):
        part, size = arb(1) / states, arb(n)
        each = {k: arb(k) * (arb(k) / n).log() - (k + part).lgamma() for k in (1, 2)}
        exact = sum(
            (times * each[k] for k, times in enumerate(np.bincount(c).tolist()) if k), arb()
        )
        exact += len(c) * part.lgamma() + (size + 1).lgamma() - arb(doubt).log()
        assert arb(float(far)) * n >= exact
        edge = 2.0**-38 * (1 + seed / 7)
        most = _bound_mean_above(np.zeros(1), np.array([edge]))[0]
        assert -(1 - arb(float(most))).log() >= edge


def least(value: np.ndarray, p: np.ndarray, far: float) -> float:
    """Return min q·v over KL(p ‖ q) ≤ far, by its dual, which searches for one number."""
    apart, seen = value - value.min(), p > 0

    def dual(t: float) -> float:
        s = exp(t) if t > -59 else 0.0
        return float(s - value.min() - exp(p[seen] @ np.log(apart[seen] + s) - far))

    ends = [(low, low + 10) for low in range(-60, 20, 10)]
    return max(-optimize.minimize_scalar(dual, bounds=b, method="bounded").fun for b in ends)


@settings(max_examples=30)
@given(SEEDS)
def test_nature_may_send_a_row_where_nobody_saw_it_go(seed: int) -> None:
    """The optimum over rows, next states without counts among them; the start is such a row."""
    rng = np.random.default_rng(seed)
    row = rng.integers(0, 12, size=4) * (rng.random(4) < 0.7) + np.eye(4, dtype=int)[0]
    mdp = of_counts([row.tolist(), *np.diag(rng.integers(1, 12, size=4)).tolist()[1:]])
    sets = RowSets.of(mdp, 0.1, "known")
    value, start = rng.normal(size=4), mdp.start_distribution
    for most in (False, True):
        sign, extreme = -1.0 if most else 1.0, sets.solve_inner_problem(value, most=most)
        law, p = extreme.piece()[0][[0]].toarray()[0], row / row.sum()
        assert law.sum() == pytest.approx(1)
        assert p[p > 0] @ np.log(p[p > 0] / law[p > 0]) <= sets.radius[0] + 1e-9
        assert abs(extreme.bound[0] - value @ law / 2) < 1e-8
        begins = radius(start * float(mdp.episodes or 0), sets.share)
        for bound, wanted in (
            (2 * extreme.bound[0], least(sign * value, p, sets.radius[0])),
            (sets.at_start(value, most=most), least(sign * value, start, begins)),
        ):
            assert wanted - 1e-5 <= sign * bound <= wanted + 1e-6


# ---- regret --------------------------------------------------------------------------------------


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


def values(mdp: MDP, model: Model, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return V* and V^π (2, S) of a policy (N, L) by time, and what both do first (2, L)."""
    (rows, reward), value = model, np.zeros((2, mdp.n_states))
    for weights in own[::-1]:
        gains = reward + mdp.discount * value @ rows.T
        best = np.maximum.reduceat(gains[0], mdp.pair_offsets[:-1])
        value = np.stack([best, np.add.reduceat(weights * gains[1], mdp.pair_offsets[:-1])])
    return value, np.stack([(gains[0] == best[mdp.pair_state]).astype(float), own[0]])


def extreme(rng: np.random.Generator, sets: RowSets, own: np.ndarray, sign: int) -> Model:
    """Return a model of the sets of great regret (sign 1) or little (-1), by steps uphill.

    A row adds γ d(s) P V to a value, d the visits: what the optimum gains by it less what the
    policy does says to which state it should go.
    """
    mdp, states = sets.mdp, sets.mdp.n_states
    aims = rng.dirichlet(np.full(states, 0.1), size=mdp.n_pairs)
    model = edge(sets, aims, rng.random(mdp.n_pairs) < 0.5)
    for _ in range(6):
        value, taken = values(mdp, model, own)
        gain, paid = np.zeros((mdp.n_pairs, states)), np.zeros(mdp.n_pairs)
        for v, share, side in zip(value, taken, (sign, -sign), strict=True):
            mixing = np.zeros((states, mdp.n_pairs))
            mixing[mdp.pair_state, np.arange(mdp.n_pairs)] = share
            chain = np.eye(states) - 0.9 * mixing @ model[0]
            visits = np.linalg.solve(chain.T, mdp.start_distribution)[mdp.pair_state] * share
            gain, paid = gain + side * visits[:, None] * v, paid + side * visits
        model = edge(sets, np.eye(states)[gain.argmax(axis=1)], paid > 0)
    return model


@settings(max_examples=30)
@given(SEEDS, st.integers(20, 5000), st.booleans(), st.sampled_from("mbp"), st.integers(0, 2))
def test_no_model_of_the_sets_has_another_regret(
    seed: int, episodes: int, known: bool, policy: str, late: int
) -> None:
    """For ever, discounted; and within three steps, by a policy of each step, at discount 1 too."""
    rng = np.random.default_rng(seed)
    frame = recorded(rng, episodes)
    if known:
        frame["reward"] = np.array([0.2, 0.7, 0.5])[frame.state.astype(int)] + frame.action / 4
    mdp = MDP.from_transitions(frame, discount=1 if late == 2 else "9/10")
    one_each = np.zeros((3, mdp.n_pairs))
    for weights in one_each:
        weights[rng.integers(mdp.pair_offsets[:-1], mdp.pair_offsets[1:])] = 1
    own = one_each if late else one_each[0]
    if policy != "p" and not late:
        own = Policy.of(mdp, "random" if policy == "m" else solve(mdp).policy).weights(mdp)
    sets = RowSets.of(mdp, 0.05, "known" if known else (0, 1))
    bounds = robust_bounds(sets, own)
    low, high = bounds.regret
    for sign in (1, -1, 1, -1):
        steps = own if late else np.tile(own, (300, 1))
        value = values(mdp, extreme(rng, sets, steps, sign), steps)[0] @ mdp.start_distribution
        assert low - 1e-7 <= value[0] - value[1] <= high + 1e-7
        for whose, bound in zip((bounds.best, bounds.own), value, strict=True):
            ends = bounds.at_start(mdp, whose)
            assert ends[0] - 1e-7 <= bound <= ends[1] + 1e-7


@pytest.mark.parametrize("how", ["discounted", "undiscounted", "within 3 steps", "cut off"])
def test_with_ever_more_records_the_interval_is_the_regret(how: str) -> None:
    frame, returns = recorded(np.random.default_rng(1), 300), None
    mdp = MDP.from_transitions(frame, discount="9/10" if how == "discounted" else 1)
    own, wanted = Policy.of(mdp, POLICY).weights(mdp), check(mdp, POLICY).value.value
    rewards: Any = (0, 1)
    if how == "undiscounted":
        returns = (-50.0, 50.0)
    if how == "within 3 steps":
        audit = check(mdp, staged_policy(mdp), horizon=3)
        own, wanted = split_by_time(mdp, audit.chain.weights, 3), audit.value.value
    if how == "cut off":  # what follows there stays unknown: 0 to 10, of which 1 is earned before
        rows = [(n, "s", "ab"[n % 2], n % 2, ("u", None)[n % 2], n % 2 == 0) for n in range(200)]
        mdp = MDP.from_transitions(pd.DataFrame(rows, columns=[*NAMES, "truncated"]))
        by, wanted = Robust(rewards="known", returns=(0, 10)), 9
        high = check(mdp, "always:b", confidence=0.95, by=by).regret_interval[1]
        assert high == pytest.approx(9.0, abs=0.5)
        own, rewards, returns = Policy.of(mdp, "always:b").weights(mdp), "known", (0.0, 10.0)
    sets = RowSets.of(mdp, 0.05, rewards)
    counted = sets.counted + np.where(sets.counted > 0, 1e14, 0.0)
    episodes = sets.episodes * counted.sum() / sets.counted.sum()
    sets = replace(sets, counted=counted, episodes=episodes)
    low, high = robust_bounds(sets, own, returns).regret
    assert high == pytest.approx(float(wanted), abs=1e-4)
    assert how == "cut off" or low == pytest.approx(float(wanted), abs=1e-4)


# ---- posterior -----------------------------------------------------------------------------------


@pytest.mark.parametrize("horizon", [None, 3])
def test_a_draw_is_a_model_that_is_solved(horizon: int | None) -> None:
    """Batches of dense equations agree with the toolkit's own solver, draw by draw."""
    mdp = estimated(recorded(np.random.default_rng(2), 60))
    own = Policy.of(mdp, POLICY).weights(mdp)
    if horizon:
        own = split_by_time(
            mdp, Policy.of(mdp.within(3), staged_policy(mdp)).weights(mdp.within(3)), 3
        )
    models = sample_models(mdp, mdp.observations > 0, 1.0, np.random.default_rng(0), 20)
    regret, table = drawn_regrets(models, own), np.eye(2)[STAGES]
    for draw in range(20):
        one = MDP.from_pairs(
            mdp.pair_state, mdp.pair_action, models.rows[draw], models.reward[draw], "9/10",
            start=dict(enumerate(models.start[draw])),
        )  # fmt: skip
        how: Any = {"horizon": 3, "kind": "policy"} if horizon else {}
        audit = check(one, table if horizon else POLICY, exact_values=False, **how)
        assert regret[draw] == pytest.approx(float(audit.value.value), abs=1e-8)


def test_drawn_models_whose_policies_do_not_settle_are_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Values of policies that may still improve would let wide bounds pass for no regret."""
    rows = [[["1/2", "1/2"], [0, 1]], [[0, 1], [1, 0]]]
    mdp = MDP.from_arrays(rows, [[0, 1], [0, 4]], "9/10")
    models = sample_models(mdp, np.zeros(mdp.n_pairs, dtype=bool), 1.0, np.random.default_rng(0), 3)
    own = np.array([1.0, 0.0, 1.0, 0.0])  # the first policy that is tried, and two are better
    assert (drawn_regrets(models, own) > 0).all()
    monkeypatch.setattr(stacked, "POLICIES", 1)
    with pytest.raises(ModelError, match="drawn from the posterior has no solution"):
        drawn_regrets(models, own)


# ---- off-policy ----------------------------------------------------------------------------------


@settings(max_examples=20)
@given(SEEDS)
def test_the_bound_is_that_of_the_theorem(seed: int) -> None:
    """Theorem 1 of Thomas and others as it is printed, with its double sum."""
    sample, doubt = np.random.default_rng(seed).exponential(size=120) ** 2, 0.05
    bound, rest = mean_at_least(sample, doubt), sample[6:]
    n, grid = len(rest), sample[:6].max() * np.geomspace(1e-4, 2.0, 200)

    def theorem(c: float) -> float:
        y = np.minimum(rest, c) / c
        double = np.square(np.subtract.outer(y, y)).sum()
        middle = 7 * n * log(2 / doubt) / (3 * (n - 1))
        return float(c / n * (y.sum() - middle - (log(2 / doubt) / (n - 1) * double) ** 0.5))

    assert bound == 0 or min(abs(bound - theorem(c)) for c in grid) < 1e-9
    assert bound <= max(0.0, *(theorem(c) for c in grid)) + 1e-9
