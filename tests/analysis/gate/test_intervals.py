"""Intervals for the regret in the process behind records: they hold, and are what they say."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from fractions import Fraction as F
from itertools import pairwise
from math import lgamma, log
from pathlib import Path
from typing import Any

import joblib
import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, optimize, stats

from exact_mdp import MDP, ModelError, OffPolicy, PolicyLike, Posterior, Robust, check
from exact_mdp.analysis.gate.data.bootstrap import Episodes
from exact_mdp.analysis.gate.data.bounds import RobustBounds
from exact_mdp.analysis.gate.data.interval import Evidence
from exact_mdp.analysis.gate.data.off_policy import mean_at_least
from exact_mdp.analysis.gate.data.posterior import PosteriorInterval, _Model
from exact_mdp.analysis.gate.data.robust import staged
from exact_mdp.analysis.gate.data.sets import RowSets
from exact_mdp.analysis.sensitivity.psa.intervals import upper_quantile, wilson
from exact_mdp.mdp.questions import by_time
from exact_mdp.solvers.values.policy_chain import PolicyChain

NAMES = ["episode", "state", "action", "reward", "next_state"]
LEVEL = F(19, 20)

# States 0, 1, 2 and the end, actions 0 and 1; a reward is 1 with a chance of its own.
ROWS = np.array(
    [
        [[0.1, 0.5, 0.1, 0.3], [0.2, 0.1, 0.4, 0.3]],
        [[0.0, 0.3, 0.3, 0.4], [0.3, 0.3, 0.0, 0.4]],
        [[0.2, 0.2, 0.3, 0.3], [0.1, 0.0, 0.2, 0.7]],
    ]
)
CHANCES = np.array([[0.2, 0.7], [0.5, 0.4], [0.9, 0.1]])
POLICY = [0, 1, 0, 0]
RATE = 0.9


def with_more(sets: RowSets, more: np.ndarray) -> RowSets:
    """Return the sets after more observations (L,) that show what was seen, in proportion."""
    counted, episodes = sets.counted + more, sets.episodes
    if episodes is not None:
        episodes *= counted.sum() / sets.counted.sum()
    return replace(sets, counted=counted, episodes=episodes)


def recorded(rng: np.random.Generator, episodes: int) -> pd.DataFrame:
    """Return episodes of a behaviour that takes both actions equally often, all at once."""
    parts, state, alive, time = [], np.zeros(episodes, dtype=int), np.arange(episodes), 0
    while len(alive):
        action = rng.integers(2, size=len(alive))
        total = ROWS[state, action].cumsum(axis=1)
        then = (rng.random((len(alive), 1)) > total).sum(axis=1).clip(max=3)
        reward = (rng.random(len(alive)) < CHANCES[state, action]).astype(int)
        parts.append(np.stack([alive, np.full_like(alive, time), state, action, reward, then], 1))
        state, alive, time = then[then < 3], alive[then < 3], time + 1
    rows = np.concatenate(parts)
    rows = rows[np.lexsort([rows[:, 1], rows[:, 0]])]
    frame = pd.DataFrame(rows[:, [0, 2, 3, 4]], columns=NAMES[:4])
    return frame.assign(next_state=pd.array(rows[:, 5], dtype="Int64").astype(object)).assign(
        next_state=lambda table: table["next_state"].where(table["next_state"] < 3, None)
    )


def truth() -> tuple[float, float]:
    """Return the optimum's value and the regret of POLICY, by equations of this file's own."""

    def value(policy: tuple[int, ...]) -> float:
        chain = np.array([ROWS[s, a, :3] for s, a in enumerate(policy)])
        earned = np.array([CHANCES[s, a] for s, a in enumerate(policy)])
        return float(np.linalg.solve(np.eye(3) - RATE * chain, earned)[0])

    best = max(value((a, b, c)) for a in (0, 1) for b in (0, 1) for c in (0, 1))
    return best, best - value((0, 1, 0))


def estimated(frame: pd.DataFrame) -> tuple[MDP, PolicyChain]:
    mdp = MDP.from_transitions(frame, discount="9/10")
    assert mdp.n_states == 4
    return mdp, PolicyChain.of(mdp, POLICY)


# ---- coverage ----------------------------------------------------------------------------------

KINDS: dict[str, Callable[[pd.DataFrame, int], Evidence]] = {
    "robust": lambda frame, seed: Robust(rewards=(0, 1)),
    "posterior": lambda frame, seed: Posterior(n=400, rng=seed),
    "off-policy": lambda frame, seed: OffPolicy(records=frame, behaviour="random", rewards=(0, 1)),
}


def held(kind: str, episodes: int, sets: int) -> int:
    """Return how many of `sets` data sets give an interval that holds the true regret."""
    _, lost = truth()
    found = 0
    for seed in range(sets):
        frame = recorded(np.random.default_rng([episodes, seed]), episodes)
        interval = KINDS[kind](frame, seed).interval(*estimated(frame), LEVEL)
        found += interval.low <= lost <= interval.high
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_intervals_hold_the_truth(kind: str) -> None:
    """The stated share is not above the Wilson interval of the share that hold it."""
    assert float(wilson(held(kind, 300, 25), 25)[1]) >= float(LEVEL)


@pytest.mark.slow
@pytest.mark.parametrize("episodes", [100, 400, 1600])
@pytest.mark.parametrize("kind", KINDS)
def test_of_400_data_sets_the_stated_share_holds_the_truth(kind: str, episodes: int) -> None:
    """In the model above: 3 states without ties, one start, a policy with some regret."""
    assert float(wilson(held(kind, episodes, 400), 400)[1]) >= float(LEVEL)


def test_where_actions_tie_every_kind_holds_0() -> None:
    """Twelve choices without a difference: the regret is 0, which nearly no draw shows."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        rows = [(n, f"s{n % 12}", "ab"[n // 12 % 2], rng.integers(2), None) for n in range(600)]
        frame = pd.DataFrame(rows, columns=NAMES)
        mdp = MDP.from_transitions(frame, "1/2")
        chain = PolicyChain.of(mdp, "always:a")
        for kind, make in KINDS.items():
            found = make(frame, seed).interval(mdp, chain, LEVEL)
            assert found.low == 0, kind
            if isinstance(found, PosteriorInterval):
                assert found.found["equal_tails"][0] > 0  # which is why it has no lower end
                assert found.decided(F(1, 1000)) is None
    audit = check(mdp, "always:a", max_regret="1/1000", confidence=0.95, by=Posterior(n=400))
    assert audit.undecided
    assert "kept with probability 0 by the posterior" in audit.message()


@pytest.mark.parametrize("episodes", [12, 40])
def test_the_posterior_holds_with_few_records(episodes: int) -> None:
    found, sets, (_, lost) = 0, 60, truth()
    for seed in range(sets):
        frame = recorded(np.random.default_rng([7, episodes, seed]), episodes)
        interval = KINDS["posterior"](frame, seed).interval(*estimated(frame), LEVEL)
        found += interval.high >= lost
    assert float(wilson(found, sets)[1]) >= float(LEVEL)


# ---- where episodes begin ----------------------------------------------------------------------


def patients(seed: int, episodes: int) -> pd.DataFrame:
    """Return episodes of one step: half of the patients are severe, and lose 1 by action 0."""
    rng = np.random.default_rng([episodes, seed])
    severe, action = rng.integers(2, size=(2, episodes))
    frame = pd.DataFrame({"episode": range(episodes), "state": severe, "action": action})
    return frame.assign(reward=np.where(severe, action, 1), next_state=None)


@pytest.mark.parametrize("kind", KINDS)
def test_a_start_that_is_from_the_records_is_not_known(kind: str) -> None:
    """Rows and rewards are certain here; that half of the patients are severe is not."""
    found, narrow = 0, 0
    for seed in range(25):
        frame = patients(seed, 3000)
        mdp = MDP.from_transitions(frame, discount="1/2")
        chain, by = PolicyChain.of(mdp, "always:0"), KINDS[kind](frame, seed)
        interval = by.interval(mdp, chain, LEVEL)
        found += interval.low <= 0.5 <= interval.high
        narrow += interval.high < 0.7
        if kind != "off-policy" and not seed:
            given = by.interval(mdp.with_(start={0: "1/2", 1: "1/2"}), chain, LEVEL)
            wide, narrow_too = interval.high - 0.5, given.high - 0.5
            assert narrow_too < wide / 2
            assert "episodes begin as the model says" in given.assumptions
            assert "episodes begin as the model says" not in interval.assumptions
    assert float(wilson(found, 25)[1]) >= float(LEVEL)
    assert narrow == 25 or kind == "off-policy"


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


# ---- states that no record leaves ---------------------------------------------------------------


def test_states_that_were_only_entered_are_named() -> None:
    rows = [(n, "s", ("risky", "safe")[n % 2], n % 2 / 2, ("trap", None)[n % 2]) for n in range(80)]
    frame = pd.DataFrame(rows, columns=NAMES)
    mdp = MDP.from_transitions(frame, discount="1/2")
    chain = PolicyChain.of(mdp, "always:risky")
    kinds: dict[str, Evidence] = {
        "robust": Robust(rewards="known"),
        "posterior": Posterior(n=80),
        "off-policy": OffPolicy(records=frame, rewards="known"),
    }
    for kind, by in kinds.items():
        found = by.interval(mdp, chain, LEVEL)
        named = [each for each in found.assumptions if "state trap" in each]
        assert len(named) == 1, kind
        assert "end" not in named[0].split("(")[1].split(")")[0]
    assert found.found["taken_for_ended"] == 40
    assert found.found["cut_off"] == 0


def test_where_episodes_were_cut_off_anything_may_follow() -> None:
    """The regret of every process that goes on there as it likes lies inside, by brute force."""
    names, rows = [*NAMES, "truncated"], []
    for n in range(200):
        rows.append(
            (n, "s", ("risky", "safe")[n % 2], n % 2 / 2, ("trap", None)[n % 2], n % 2 == 0)
        )
    frame = pd.DataFrame(rows, columns=names)
    mdp = MDP.from_transitions(frame, discount="1/2")
    assert mdp.labels["cut off"].tolist() == [mdp.space.label(s) == "state trap" for s in range(3)]
    for policy in ("risky", "safe"):
        chain = PolicyChain.of(mdp, f"always:{policy}")
        for kind in ("robust", "off-policy"):
            by = Robust(rewards="known") if kind == "robust" else KINDS[kind](frame, 0)
            found = by.interval(mdp, chain, LEVEL)
            assert any("(state trap)" in each for each in found.assumptions)
            assert not any("taken for ends" in each for each in found.assumptions)
            # In the trap rewards of 0 to 1/2 follow for ever: worth 0 to 1, and 0 to 1/2 today.
            for worth in (0.0, 0.3, 1.0):
                value = {"risky": 0.5 * worth, "safe": 0.5}
                regret = max(value.values()) - value[policy]
                assert found.low <= regret <= found.high
        with pytest.raises(ModelError, match="cut off in"):
            Posterior().interval(mdp, chain, LEVEL)
    ended = MDP.from_transitions(frame.drop(columns="truncated"), discount="1/2")
    chain = PolicyChain.of(ended, "always:risky")
    assert Robust(rewards="known").interval(ended, chain, LEVEL).low > 0.1  # an end, worth 0


def test_what_follows_a_cut_does_not_matter_after_one_step_from_a_known_start() -> None:
    rows = [(n, "s", "ab"[n % 2], n % 2, "u", True) for n in range(100)]
    frame = pd.DataFrame(rows, columns=[*NAMES, "truncated"])
    known = MDP.from_transitions(frame, start="s")
    how: dict[str, Any] = {"confidence": 0.95, "by": Posterior(n=80)}
    assert check(known, "always:a", horizon=1, **how).regret_interval == (0, 1)
    for mdp, horizon in ((known, 2), (MDP.from_transitions(frame), 1)):
        with pytest.raises(ModelError, match="cut off in"):
            check(mdp, "always:a", horizon=horizon, **how)


@pytest.mark.parametrize("kind", KINDS)
def test_of_one_action_alone_every_interval_says_so(kind: str) -> None:
    frame = pd.DataFrame([(n, "s", "a", n % 2, None) for n in range(80)], columns=NAMES)
    mdp = MDP.from_transitions(frame, "1/2")
    found = KINDS[kind](frame, 0).interval(mdp, PolicyChain.of(mdp, "always:a"), LEVEL)
    assert any("only one action was ever taken" in each for each in found.assumptions)


def test_a_behaviour_in_an_array_is_one_of_probabilities(tmp_path: Path) -> None:
    frame = recorded(np.random.default_rng(4), 100)
    mdp, chain = estimated(frame)
    shares = np.full((4, 2), 0.5)
    np.save(tmp_path / "behaviour.npy", shares)

    def by(behaviour: Any) -> tuple[float, float]:
        how = OffPolicy(records=frame, rewards=(0, 1), n=10, behaviour=behaviour)
        found = how.interval(mdp, chain, LEVEL)
        return found.low, found.high

    assert by(shares) == by(str(tmp_path / "behaviour.npy")) == by("random")
    with pytest.raises(ModelError):  # a Q-table
        by(np.array([[3.0, 1.0]] * 4))


@pytest.mark.parametrize("limit", [1, 2])
def test_what_is_cut_off_without_a_next_state_counts(limit: int) -> None:
    """Who is not cured within the limit is cut off: to leave these rows out would cure them all."""
    rng, rows = np.random.default_rng(limit), []
    for n in range(600):
        for time in range(1, limit + 1):
            action = ("wait", "treat")[rng.integers(2)]
            cured = rng.random() < (0.1 if action == "wait" else 0.8)
            goes_on = not cured and time < limit
            then = "cured" if cured else "ill" if goes_on else None
            rows.append((n, "ill", action, float(cured), then, not cured and not goes_on))
            if not goes_on:
                break
    frame = pd.DataFrame(rows, columns=[*NAMES, "truncated"])
    mdp = MDP.from_transitions(frame, discount="9/10")
    chain = PolicyChain.of(mdp, "always:wait")
    waits, treated = (p / (1 - 0.9 * (1 - p)) for p in (0.1, 0.8))
    for by in (Robust(rewards="known"), KINDS["off-policy"](frame, 0)):
        found = by.interval(mdp, chain, LEVEL)
        assert found.low <= treated - waits <= found.high
        assert any("cut off" in each for each in found.assumptions)
    with pytest.raises(ModelError, match="cut off in"):
        Posterior(n=80).interval(mdp, chain, LEVEL)


def test_trajectories_tell_nothing_of_another_start() -> None:
    frame = patients(0, 300)
    mdp = MDP.from_transitions(frame, discount="1/2", start={0: "1/10", 1: "9/10"})
    with pytest.raises(ModelError, match="the records begin as they began"):
        KINDS["off-policy"](frame, 0).interval(mdp, PolicyChain.of(mdp, "always:0"), LEVEL)


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


def test_the_sets_hold_at_every_time_at_once() -> None:
    """A likelihood ratio exceeds 1/δ at some time of 400 in a share δ of the runs, at most."""
    rng, q, doubt = np.random.default_rng(5), np.array([0.6, 0.3, 0.1, 0.0]), 0.1
    drawn = rng.random((1000, 400, 1)) > q.cumsum()[:3]
    counts = np.cumsum(np.eye(4)[drawn.sum(axis=2)], axis=1)
    n = np.arange(1, 401)
    gammas = np.array([[lgamma(k + part) for k in range(401)] for part in (0.25, 1.0)])
    mixed = gammas[0][counts.astype(int)].sum(axis=2) - 4 * lgamma(0.25) - gammas[1][n]
    own = (counts[:, :, :3] * np.log(q[:3])).sum(axis=2)
    broken = ((mixed - own) > log(1 / doubt)).any(axis=1)
    assert float(wilson(int(broken.sum()), 1000)[0]) <= doubt


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
    forms: dict[str, PolicyLike] = {"m": "random", "b": "optimal", "p": POLICY[: mdp.n_states]}
    own = PolicyChain.of(mdp, forms[policy]).weights
    sets = RowSets.of(mdp, 0.05, "known" if known else (0, 1))
    bounds = RobustBounds(sets=sets, own=own)
    low, high = bounds.regret
    for sign in (1, -1, 1, -1):
        value = lost(mdp, worst(rng, sets, own, sign), own)[0] @ mdp.start_distribution
        assert low - 1e-7 <= value[0] - value[1] <= high + 1e-7
        for whose, found in zip(("best", "own"), value, strict=True):
            least, most = bounds.at_start(mdp, whose)
            assert least - 1e-7 <= found <= most + 1e-7


def test_the_bound_is_narrower_than_that_by_two_models() -> None:
    """What is unsure of the optimum and of the policy alike does not widen the interval."""
    mdp, chain = estimated(recorded(np.random.default_rng(1), 3000))
    sets = RowSets.of(mdp, 0.05, (0, 1))
    best = PolicyChain.of(mdp, "optimal").weights
    for own in (chain.weights, best):
        bounds = RobustBounds(sets=sets, own=own)
        (least, most), (low, high) = bounds.at_start(mdp, "best"), bounds.at_start(mdp, "own")
        assert max(least - high, 0) <= bounds.regret[0] <= bounds.regret[1] < most - low
    assert bounds.regret[1] < (most - low) / 2


def test_with_ever_more_records_the_interval_is_the_regret() -> None:
    mdp, chain = estimated(recorded(np.random.default_rng(1), 300))
    sets = RowSets.of(mdp, 0.05, (0, 1))
    sets = with_more(sets, np.where(sets.counted > 0, 1e14, 0.0))
    found = RobustBounds(sets=sets, own=chain.weights).regret
    wanted = float(check(mdp, POLICY).value.value)
    assert found == (pytest.approx(wanted, abs=1e-4), pytest.approx(wanted, abs=1e-4))


def test_costs_have_the_interval_of_rewards() -> None:
    frame = recorded(np.random.default_rng(1), 300)
    rewards, chain = estimated(frame)
    costs = MDP.from_transitions(frame.assign(reward=-frame.reward), "9/10", sense="min")
    one = Robust(rewards=(0, 1)).interval(rewards, chain, LEVEL)
    other = Robust(rewards=(-1, 0)).interval(costs, PolicyChain.of(costs, POLICY), LEVEL)
    assert (one.low, one.high) == pytest.approx((other.low, other.high))
    assert one.found["learned_value"][0] == pytest.approx(-other.found["learned_value"][1])


def test_at_discount_1_a_range_of_returns_is_needed() -> None:
    frame = recorded(np.random.default_rng(1), 4000)
    mdp = MDP.from_transitions(frame)
    with pytest.raises(ModelError, match="how long an episode"):
        check(mdp, POLICY, confidence=0.95, by=Robust(rewards=(0, 1)))
    audit = check(mdp, POLICY, confidence=0.95, by=Robust(rewards=(0, 1), returns=(0, 20)))
    assert audit.regret_interval is not None
    low, high = audit.regret_interval
    assert low <= float(audit.value.value) <= high < 20
    with pytest.raises(ModelError, match="a reward of 1 was seen"):  # at the end of an episode
        check(mdp, POLICY, confidence=0.95, by=Robust(rewards=(0, 1), returns=(0, 0.5)))


def test_at_discount_1_the_interval_is_that_of_episodes_that_stop_late() -> None:
    """By backward induction from 0, in place of a range that shrinks; the range itself is gone."""
    mdp = MDP.from_transitions(recorded(np.random.default_rng(1), 3000))
    own = PolicyChain.of(mdp, POLICY).weights
    sets = RowSets.of(mdp, 0.05, (0, 1))
    for most in (50.0, 5000.0):
        found = RobustBounds(sets=sets, own=own, returns=(-most, most))
        late = staged(sets, np.tile(own, (300, 1)))
        assert found.over.tolist() == [False, False, False, True]
        for name in ("own_low", "own_high", "best_low", "best_high"):
            assert vars(late)[name] == pytest.approx(getattr(found, name), abs=1e-5)
        assert found.regret == pytest.approx(late.regret, abs=1e-5)
    sets = with_more(sets, np.where(sets.counted > 0, 1e14, 0.0))
    found = RobustBounds(sets=sets, own=own, returns=(-50, 50))
    wanted = float(check(mdp, POLICY).value.value)
    assert found.regret == (pytest.approx(wanted, abs=1e-4), pytest.approx(wanted, abs=1e-4))


@pytest.mark.parametrize("kind", ["robust", "off-policy"])
@pytest.mark.parametrize("end", ["well", None])
def test_at_discount_1_ends_are_worth_nothing(kind: str, end: str | None) -> None:
    """Who waits is ill for 5 days, who is treated for 2: 5 less 2 times 1.25 is lost."""
    rng, rows = np.random.default_rng(0), []
    for n in range(3000):
        state: str | None = "ill"
        while state == "ill":
            action = ("wait", "treat")[rng.integers(2)]
            cured = rng.random() < (0.5 if action == "treat" else 0.2)
            state = end if cured else "ill"
            rows.append((n, "ill", action, -1 if action == "wait" else -1.25, state))
    frame = pd.DataFrame(rows, columns=NAMES)
    mdp = MDP.from_transitions(frame)
    how: dict[str, Any] = {"rewards": "known", "returns": (-60, 0)}
    by: Evidence = Robust(**how)
    if kind == "off-policy":
        by = OffPolicy(records=frame, behaviour="random", n=10, **how)
    found = by.interval(mdp, PolicyChain.of(mdp, "always:wait"), LEVEL)
    assert found.low <= 2.5 <= found.high
    assert found.high < (4 if kind == "robust" else 58)
    least, most = found.found["optimal_value"]
    assert -2.8 < least <= -2.5 <= most < -2.2
    best = by.interval(mdp, PolicyChain.of(mdp, "always:treat"), LEVEL)
    assert best.low == 0
    assert kind != "robust" or best.high < 1e-6


def test_at_discount_1_where_episodes_were_cut_off_the_range_stays() -> None:
    rows = [(n, "s", "ab"[n % 2], n % 2, ("u", None)[n % 2], n % 2 == 0) for n in range(200)]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=[*NAMES, "truncated"]))
    by = Robust(rewards="known", returns=(0, 10))
    audit = check(mdp, "always:b", max_regret="1/10", confidence=0.95, by=by)
    assert audit.regret_interval is not None
    assert audit.regret_interval[1] == pytest.approx(9.0, abs=0.5)
    sets = RowSets.of(mdp, 0.05, "known")
    sets = with_more(sets, np.where(sets.counted > 0, 1e14, 0.0))
    known = RobustBounds(sets=sets, own=audit.chain.weights, returns=(0, 10)).regret
    assert known[1] == pytest.approx(9, abs=1e-4)  # no number of records decides it


@pytest.mark.parametrize(
    ("returns", "last", "refused"),
    [((2, 10), None, 1), ((2, 10), "u", None), ((1, 10), None, None), ((0, 3), "u", 4)],
)
def test_a_range_of_totals_has_room_for_what_was_seen(
    returns: tuple[int, int], last: str | None, refused: int | None
) -> None:
    """1 is all that is earned where the episode is over, not where it was cut off."""
    rows = [(n, "s", "ab"[n % 2], (4, 1)[n % 2], last if n % 2 else None) for n in range(40)]
    table = pd.DataFrame([(*row, row[-1] == "u") for row in rows], columns=[*NAMES, "truncated"])
    mdp, by = MDP.from_transitions(table), Robust(rewards=(1, 4), returns=returns)
    told = pytest.raises(ModelError, match=f"a reward of {refused} was seen, after which no total")
    with told if refused else nullcontext():
        assert check(mdp, "always:a", confidence=0.95, by=by).interval is not None


# ---- episodes that stop --------------------------------------------------------------------------

STAGES = np.array([[0, 1, 0, 0], [1, 1, 0, 0], [1, 0, 1, 0]])  # actions (N, S), by time


def by_stage(rows: np.ndarray, reward: np.ndarray, rate: float, own: np.ndarray) -> np.ndarray:
    """Return V* and V^π (2, S) at time 0: rows (S, A, S), rewards (S, A), actions (N, S)."""
    value = np.zeros((2, len(rows)))
    for actions in own[::-1]:
        worth = reward[None] + rate * np.einsum("sat,vt->vsa", rows, value)
        value = np.stack([worth[0].max(axis=1), worth[1][np.arange(len(rows)), actions]])
    return value


def within_truth() -> float:
    rows = np.concatenate([ROWS, np.eye(4)[[3]][:, None].repeat(2, axis=1)])
    reward = np.concatenate([CHANCES, np.zeros((1, 2))])
    best, own = by_stage(rows, reward, RATE, STAGES)[:, 0]
    return float(best - own)


def staged_policy(mdp: MDP) -> PolicyLike:
    """Return STAGES as a policy of `mdp.within(3)`."""
    within = mdp.within(3)
    actions = np.zeros(within.n_states, dtype=int)
    for state in range(within.n_states):
        at = within.space.as_dict(state)
        if "time" in at and int(at["time"]) < 3 and str(at["state"]).isdecimal():
            actions[state] = STAGES[int(at["time"]), int(at["state"])]
    return actions


@pytest.mark.parametrize("kind", KINDS)
def test_intervals_of_episodes_that_stop_hold_the_truth(kind: str) -> None:
    found, lost = 0, within_truth()
    for seed in range(25):
        frame = recorded(np.random.default_rng([8, seed]), 300)
        mdp = MDP.from_transitions(frame, discount="9/10")
        policy = staged_policy(mdp)
        by = KINDS[kind](frame, seed)
        audit = check(mdp, policy, horizon=3, confidence=0.95, by=by, exact_values=False)
        assert audit.interval is not None
        found += audit.interval.low <= lost <= audit.interval.high
        if not seed:
            point = float(audit.value.value)
            assert audit.interval.low <= point <= audit.interval.high
    assert float(wilson(found, 25)[1]) >= float(LEVEL)


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
    low, high = staged(sets, weights).regret
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
    found = staged(sets, by_time(mdp, audit.chain.weights, 3)).regret
    wanted = float(audit.value.value)
    assert found == (pytest.approx(wanted, abs=1e-4), pytest.approx(wanted, abs=1e-4))
    long = check(mdp, policy=POLICY, horizon=300, confidence=0.95, by=Posterior(n=80))
    assert long.interval is not None
    other = check(mdp, POLICY, confidence=0.95, by=Posterior(n=80)).interval
    assert other is not None
    assert long.interval.high == pytest.approx(other.high, rel=1e-6)  # all are over by then


def test_a_draw_is_solved_within_the_horizon() -> None:
    mdp = MDP.from_transitions(recorded(np.random.default_rng(2), 60), discount="9/10")
    policy = staged_policy(mdp)
    own = by_time(mdp, PolicyChain.of(mdp.within(3), policy).weights, 3)
    model = _Model.of(mdp, own, 1.0)
    rows, reward, start = model.drawn(np.random.default_rng(0), 5)
    found = model.regret(rows, reward, start)
    for draw in range(5):
        drawn = MDP.from_pairs(
            mdp.pair_state, mdp.pair_action, rows[draw], reward[draw], "9/10",
            start=dict(enumerate(start[draw])),
        )  # fmt: skip
        table = np.zeros((3, 4, 2))
        for time, actions in enumerate(STAGES):
            table[time, np.arange(4), actions] = 1
        lost = check(drawn, table, horizon=3, kind="policy", exact_values=False).value.value
        assert found[draw] == pytest.approx(float(lost), abs=1e-8)


def test_trajectories_count_up_to_the_horizon() -> None:
    rows = [(1, "a", "x", 1, "b"), (1, "b", "y", 2, "a"), (1, "a", "y", 4, None)]
    rows += [(2, "a", "x", 8, "b"), (2, "b", "x", 16, None), (3, "a", "y", 32, "b")]
    frame = pd.DataFrame(rows, columns=NAMES)
    mdp = MDP.from_transitions(frame, discount="1/2")
    by = OffPolicy(records=frame, behaviour="random", rewards=(0, 32), n=10)
    found = check(mdp, "always:x", horizon=1, confidence=0.95, by=by).interval
    assert found is not None
    # One step: x has weight 2 in the first two episodes, which earn 1 and 8; none was cut off.
    assert found.found["ordinary"] == pytest.approx((2 * 1 + 2 * 8) / 3)
    assert (found.found["cut_off"], found.found["effective_sample_size"]) == (0, 2.0)
    two = check(mdp, "always:x", horizon=2, confidence=0.95, by=by).interval
    assert two is not None
    assert two.found["ordinary"] == pytest.approx(4 * (8 + 16 / 2) / 3)
    assert two.found["cut_off"] == 1  # the third, after one step


# ---- posterior ---------------------------------------------------------------------------------


def test_a_draw_is_a_model_that_is_solved() -> None:
    """Batches of dense equations agree with the toolkit's own solver, draw by draw."""
    mdp, chain = estimated(recorded(np.random.default_rng(2), 60))
    model = _Model.of(mdp, chain.weights, 1.0)
    rows, reward, start = model.drawn(np.random.default_rng(0), 20)
    found = model.regret(rows, reward, start)
    for draw in range(20):
        # A row of floats sums to 1 but for rounding.
        drawn = MDP.from_pairs(
            mdp.pair_state, mdp.pair_action, rows[draw], reward[draw], "9/10",
            start=dict(enumerate(start[draw])),
        )  # fmt: skip
        assert found[draw] == pytest.approx(
            float(check(drawn, POLICY, exact_values=False).value.value), abs=1e-8
        )


def test_a_draw_that_is_not_solved_gives_no_number(monkeypatch: pytest.MonkeyPatch) -> None:
    """The optimum of the estimated model is not that of all draws."""
    mdp, chain = estimated(recorded(np.random.default_rng(2), 60))
    monkeypatch.setattr("exact_mdp.analysis.gate.data.posterior.IMPROVEMENTS", 1)
    with pytest.raises(ModelError, match="needs more than 1 policies"):
        Posterior(n=100).interval(mdp, chain, LEVEL)


def test_drawn_rows_are_dirichlet() -> None:
    mdp, chain = estimated(recorded(np.random.default_rng(2), 60))
    model = _Model.of(mdp, chain.weights, 2.0)
    rows, reward, start = model.drawn(np.random.default_rng(0), 4000)
    assert mdp.observations is not None
    assert mdp.counts is not None
    drawn = [(mdp.counts[[pair]].toarray()[0], rows[:, pair]) for pair in range(mdp.n_pairs)]
    begun = (np.array([60, 0, 0, 0]), start)
    for counts, found in [begun, *(each for each in drawn if each[0].any())]:
        alpha = counts + 0.5  # 2 observations over 4 states
        n, mean = alpha.sum(), alpha / alpha.sum()
        spread = np.sqrt(mean * (1 - mean) / (n + 1))
        assert found.mean(axis=0) == pytest.approx(mean, abs=5 * spread.max() / 60)
        assert found.std(axis=0) == pytest.approx(spread, rel=0.1)
    assert reward.mean(axis=0) == pytest.approx(mdp.reward, abs=0.05)


@pytest.mark.parametrize(
    "how",
    [
        {"n_jobs": 2, "threads": True},
        pytest.param({"n_jobs": 2}, marks=pytest.mark.slow),
    ],
)
def test_the_same_seed_gives_the_same_bytes_wherever(how: dict[str, Any], tmp_path: Path) -> None:
    frame = recorded(np.random.default_rng(2), 60)
    mdp, chain = estimated(frame)

    def draws(seed: int = 3, folder: Path | None = None, **how: Any) -> bytes:
        one, other = (None if folder is None else folder / name for name in "ab")
        models = Posterior(n=600, rng=seed, folder=one, **how).interval(mdp, chain, LEVEL).draws
        by = OffPolicy(records=frame, rewards=(0, 1), n=600, rng=seed, folder=other, **how)
        again = by.interval(mdp, chain, LEVEL).found["bootstrap"]
        return models.tobytes() + np.array(again).tobytes()

    here = draws(folder=tmp_path)
    assert here == draws(folder=tmp_path)  # read, not drawn
    with joblib.parallel_config("threading") if how.pop("threads", False) else nullcontext():
        assert draws(**how) == here
    assert draws(4)[-16:] != here[-16:]
    assert draws(4)[:-16] != here[:-16]


@pytest.mark.parametrize("episodes", [40, 400])
def test_the_bootstrap_is_that_of_another_library(episodes: int) -> None:
    rng = np.random.default_rng(episodes)
    weight = rng.exponential(size=episodes) ** 2 * (rng.random(episodes) < 0.6)
    returns = rng.normal(weight, 1.0)
    found = Episodes(weight=weight, returns=returns).interval(0.9, (-9.0, 9.0), 6000, 1)
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
    assert Episodes(weight=0 * weight, returns=returns).interval(0.9, (-9.0, 9.0), 10, 1) == (-9, 9)


def test_the_bootstrap_holds_the_value_where_weights_are_even() -> None:
    found = 0
    for seed in range(100):
        rng = np.random.default_rng(seed)
        weight, returns = 2.0 * rng.integers(2, size=200), rng.random(200) < 0.3
        drawn = Episodes(weight=weight, returns=returns.astype(float))
        low, high = drawn.interval(0.95, (0.0, 1.0), 200, seed)
        found += low <= 0.3 <= high
    assert float(wilson(found, 100)[1]) >= float(LEVEL)


def test_the_bootstrap_widens_with_the_confidence() -> None:
    """Also where the correction for skewness has a pole: one return of many is not 0."""
    for sign in (1, -1):
        returns = sign * np.eye(1, 400)[0]
        drawn = Episodes(weight=np.ones(400), returns=returns)
        found = [
            drawn.interval(level, (-1.0, 1.0), 500, 0)
            for level in (0.5, 0.95, 0.9999, 1 - 1e-8, 1 - 1e-9, 1 - 1e-12)
        ]
        assert all(b[0] <= a[0] <= a[1] <= b[1] for a, b in pairwise(found))


@pytest.mark.parametrize(("level", "least"), [("1/2", 6), (0.95, 72), (0.99, 368), (0.999, 3688)])
def test_too_few_draws_show_no_upper_end(level: Any, least: int) -> None:
    """As many as are needed for the greatest to be above the quantile in 97.5 % of samples."""
    assert 1 - float(F(str(level))) ** least >= 0.975 > 1 - float(F(str(level))) ** (least - 1)
    mdp, chain = estimated(recorded(np.random.default_rng(4), 100))
    with pytest.raises(ModelError, match=f"{least - 1:,} draws do not show") as caught:
        Posterior(n=least - 1).interval(mdp, chain, F(str(level)))
    assert f"n={least})" in str(caught.value)
    found = Posterior(n=least).interval(mdp, chain, F(str(level)))
    assert found.high == found.draws.max()


@pytest.mark.parametrize("count", [72, 73, 150, 2000])
@pytest.mark.parametrize("level", [0.5, 0.9, 0.95])
def test_the_upper_end_is_the_order_statistic_that_covers(level: float, count: int) -> None:
    """Its coverage by another library's distribution, and that none lower has it; and in draws."""
    rank = int(upper_quantile(np.arange(1.0, count + 1), level))
    below = stats.binom(count, level).cdf
    assert below(rank - 1) >= 0.975 > below(rank - 2)
    samples = np.sort(np.random.default_rng(count).random((4000, count)), axis=1)
    assert (samples[:, rank - 1] >= level).mean() >= 0.975 - 4 * (0.975 * 0.025 / 4000) ** 0.5


def test_the_probability_is_a_share_of_the_draws() -> None:
    mdp, chain = estimated(recorded(np.random.default_rng(2), 60))
    found = Posterior(n=600).interval(mdp, chain, LEVEL)
    share = found.within(F(1, 2))
    assert share.value == np.mean(found.draws <= 0.5)
    assert share.interval == tuple(float(end) for end in wilson(share.value * 600, 600))
    with pytest.raises(ModelError):
        found.within(float("nan"))  # type: ignore[arg-type]
    assert found.within(F(1000)).interval[0] < 1  # all draws agree, and some doubt is left
    assert np.quantile(found.draws, 0.95) <= found.high <= np.quantile(found.draws, 0.98)
    low, high = found.found["equal_tails"]
    assert low <= np.quantile(found.draws, 0.025) < np.quantile(found.draws, 0.975) <= high


# ---- off-policy --------------------------------------------------------------------------------


def test_weights_and_returns_are_those_of_the_episodes() -> None:
    rows = [
        (1, "a", "x", 1, "b"), (1, "b", "y", 2, None),
        (2, "a", "y", 4, "a"), (2, "a", "x", 8, "b"), (2, "b", "x", 16, "b"),
        (3, "a", "x", 3, None),
    ]  # fmt: skip
    frame = pd.DataFrame(rows, columns=NAMES)
    mdp = MDP.from_transitions(frame, discount="1/2")
    chain = PolicyChain.of(mdp, {"a": "x", "b": "x"})
    weights = np.array([0.0, 0.0, 2.0])  # π/b is 2, or 0; the second episode takes y first
    returns = np.array([2.0, 12.0, 3.0])
    for records in (frame, [frame.iloc[n : n + 1] for n in range(6)]):
        by = OffPolicy(records=records, behaviour="random", rewards=(0, 16))
        found = by.interval(mdp, chain, LEVEL).found
        assert found["ordinary"] == pytest.approx(float((weights * returns).mean()))
        assert found["weighted"] == pytest.approx(float(weights @ returns / weights.sum()))
        assert (found["effective_sample_size"], found["cut_off"]) == (1.0, 1)
    # Estimated, the behaviour takes x in a with 3/4 and in b with 1/2.
    found = OffPolicy(records=frame, rewards=(0, 16)).interval(mdp, chain, LEVEL).found
    assert found["ordinary"] == pytest.approx(float(4 / 3 * 3 / 3))


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


# ---- what needs more records -------------------------------------------------------------------


def test_records_that_show_the_same_again_count_as_the_sets_foresee() -> None:
    frame = recorded(np.random.default_rng(3), 60)
    twice = pd.concat([frame, frame.assign(episode=frame.episode + 10**6)])
    one, other = (RowSets.of(MDP.from_transitions(x, "9/10"), 0.05, (0, 1)) for x in (frame, twice))
    assert other.radius == pytest.approx(with_more(one, one.counted).radius)
    assert other.reward[1] == pytest.approx(with_more(one, one.counted).reward[1])


# ---- the gate ----------------------------------------------------------------------------------


def test_the_gate_passes_on_the_bound_and_never_on_the_estimate() -> None:
    frame = recorded(np.random.default_rng(4), 200)
    mdp, _ = estimated(frame)
    point = check(mdp, POLICY).value.value
    limit = point + F(1, 100)
    assert check(mdp, POLICY, max_regret=limit).passed
    for kind, make in KINDS.items():
        audit = check(mdp, POLICY, max_regret=limit, confidence=0.95, by=make(frame, 0))
        assert audit.regret_interval is not None
        low, high = audit.regret_interval
        assert low <= limit < high, kind
        assert not audit.passed
        assert audit.undecided
        assert "not known to be at most" in audit.message()
        assert kind in audit.message()
        assert check(mdp, POLICY, max_regret=high, confidence=0.95, by=make(frame, 0)).passed
        if low > 0:
            failed = check(mdp, POLICY, max_regret=low / 2, confidence=0.95, by=make(frame, 0))
            assert not failed.undecided
            assert not failed.passed


def test_a_policy_that_is_best_beyond_doubt_passes_without_a_limit() -> None:
    rows = [(n, "ill", "wait", 0, None) for n in range(60)]
    rows += [(n + 60, "ill", "treat", 1, None) for n in range(60)]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount="1/2")
    by = Robust(rewards="known")
    assert check(mdp, "always:treat", confidence=0.95, by=by).regret_interval == (0.0, 0.0)
    assert check(mdp, "always:treat", confidence=0.95, by=by).passed
    assert not check(mdp, "always:wait", confidence=0.95, by=by).passed


@pytest.mark.parametrize(
    ("asked", "what"),
    [
        ({"by": "posterior"}, "no confidence"),
        ({"confidence": 95}, "a confidence of 95"),
        ({"confidence": "high"}, "high"),
        ({"confidence": f"0.{'9' * 20}", "by": "posterior"}, "a confidence of 0.9999"),
        ({"confidence": F(1, 10**400), "by": "posterior"}, "a confidence of 1/1000"),
        ({"confidence": 0.95, "by": "bootstrap"}, "unknown kind"),
        ({"confidence": 0.95, "by": "off-policy"}, "no trajectories"),
        ({"confidence": 0.95, "max_relative_regret": 1}, "total regret alone"),
        ({"confidence": 0.95, "criterion": "average"}, "total regret alone"),
        (
            {"confidence": 0.95, "horizon": 5, "by": Robust(rewards=(0, 1), returns=(0, 9))},
            "rewards bound",
        ),
        ({"confidence": 0.95}, "nothing says where rewards lie"),
        ({"confidence": 0.95, "by": Robust(rewards=(0, "1/2"))}, "rewards from 0 to 1"),
        ({"confidence": 0.95, "by": Robust(rewards=(1, 0))}, "the range"),
        ({"confidence": 0.95, "by": Robust(rewards="all")}, "rewards are 'all'"),
        ({"confidence": 0.95, "by": Robust(rewards="known")}, "two rewards"),
        ({"confidence": 0.95, "by": Posterior(prior=0)}, "the prior"),
        ({"confidence": 0.95, "by": Posterior(n=1)}, "draws"),
    ],
)
def test_what_cannot_be_is_refused(asked: dict[str, Any], what: str) -> None:
    mdp, _ = estimated(recorded(np.random.default_rng(4), 100))
    with pytest.raises(ModelError, match=what):
        check(mdp, POLICY, **asked)


def test_records_that_do_not_fit_are_refused() -> None:
    frame = recorded(np.random.default_rng(4), 100)
    mdp, chain = estimated(frame)

    def refused(what: str, records: pd.DataFrame = frame, **how: Any) -> None:
        with pytest.raises(ModelError, match=what):
            OffPolicy(records=records, rewards=(0, 1), **how).interval(mdp, chain, LEVEL)

    refused("never does what the policy does", behaviour="always:1")
    refused("no state '9'", frame.assign(state=9, next_state=None, episode=range(len(frame))))
    refused("no action 'left'", frame.assign(action="left"))
    with pytest.raises(ModelError, match="nothing says where rewards lie"):
        OffPolicy(records=frame).interval(mdp, chain, LEVEL)
    elsewhere = MDP.from_transitions(frame, discount="9/10", start=1)
    with pytest.raises(ModelError, match="begins where the model never does"):
        OffPolicy(records=frame, rewards=(0, 1)).interval(elsewhere, chain, LEVEL)
    refused("no column", frame.drop(columns="reward"))
    refused("a reward of 1 was seen", returns=(0, "1/2"))
    refused("returns from", returns=(0, 1))
    with pytest.raises(ModelError, match="no counts"):
        check(MDP.from_arrays([[[1]]], [1], "1/2"), [0], confidence=0.95)


@pytest.mark.parametrize("by", [3, Robust, object()], ids=["a number", "a class", "nothing"])
def test_what_makes_no_interval_is_refused(by: Any) -> None:
    mdp, _ = estimated(recorded(np.random.default_rng(0), 20))
    with pytest.raises(ModelError, match="not a kind of interval"):
        check(mdp, "random", confidence=0.95, by=by)
