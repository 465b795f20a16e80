"""Models drawn from the posterior, beside its mean, and their regrets beside all policies."""

from fractions import Fraction as F
from functools import partial
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from records import NAMES, POLICY, STAGES, by_stage, estimated, recorded

from exact_mdp import MDP, ModelError, Posterior
from exact_mdp.analysis.gate.data import posterior as module
from exact_mdp.analysis.gate.data.posterior import drawn_regrets, sample_models
from exact_mdp.analysis.vary.intervals import estimate_quantiles, upper_quantile


class Mean(np.random.Generator):
    """A generator whose Gamma numbers are their mean, so that a draw is the posterior's mean."""

    def __init__(self) -> None:
        super().__init__(np.random.PCG64(0))

    def gamma(self, shape: Any, scale: Any = 1.0, size: Any = None) -> Any:
        return np.array(np.broadcast_to(shape, size if size is not None else np.shape(shape)))


def known_of(mdp: MDP) -> np.ndarray:
    assert mdp.observations is not None
    return np.asarray(mdp.observations > 0)


def test_the_mean_of_rows_is_counts_and_the_prior_over_their_sum() -> None:
    for seed, prior in ((0, 1.0), (1, 5.0)):
        mdp = estimated(recorded(np.random.default_rng(seed), 30))
        known, counts = known_of(mdp), mdp.counts
        assert counts is not None
        models = sample_models(mdp, known, prior, Mean(), 3)
        assert models.rows.shape == (3, mdp.n_pairs, mdp.n_states)
        for pair in range(mdp.n_pairs):
            n, row = counts.toarray()[pair].sum(), counts.toarray()[pair]
            if not known[pair]:
                wanted, earned = mdp.transition.toarray()[pair], mdp.reward[pair]
            else:
                wanted = (row + prior / mdp.n_states) / (n + prior)
                earned, seen = 0.0, mdp.table.row(pair)
                for t in {t for _, t, _ in seen}:
                    rewards = [(float(p) * n, float(r)) for p, to, r in seen if to == t]
                    part = prior / mdp.n_states / len(rewards)
                    earned += sum((c + part) * r for c, r in rewards) / (n + prior)
                never = 1 - len({t for _, t, _ in seen}) / mdp.n_states
                earned += prior * never / (n + prior) * mdp.reward[pair]
            for k in range(3):
                assert models.rows[k, pair] == pytest.approx(wanted, rel=1e-12)
                assert models.reward[k, pair] == pytest.approx(earned, rel=1e-10, abs=1e-12)
        assert mdp.episodes == 30
        begun = (mdp.start_distribution * 30 + prior / mdp.n_states) / (30 + prior)
        assert models.start[0] == pytest.approx(begun, rel=1e-12)
        given = mdp.with_(start=1)
        assert sample_models(given, known, prior, Mean(), 2).start.tolist() == [[0, 1, 0, 0]] * 2
        assert models.rate.tolist() == [0.9] * 3
        assert models.leak.tolist() == [[float(F(1, 10))]]
        assert models.live.all()


def test_a_terminal_state_that_was_seen_to_stay_may_go_on() -> None:
    rows: Any = [(0, "b", "x", 1, "a"), (0, "a", "x", 0, "a"), (1, "b", "x", 1, "c")]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount=1)
    assert mdp.terminal.tolist() == [True, False, True]
    models = sample_models(mdp, known_of(mdp), 1.0, Mean(), 2)
    assert models.structure.ended.tolist() == [False, False, True]
    assert models.live.tolist() == [[True, True, False]] * 2


def test_draws_differ_and_are_laws() -> None:
    mdp = estimated(recorded(np.random.default_rng(0), 30))
    models = sample_models(mdp, known_of(mdp), 1.0, np.random.default_rng(0), 400)
    assert models.rows.sum(axis=2) == pytest.approx(np.ones((400, mdp.n_pairs)))
    counts = mdp.counts
    assert counts is not None
    pair = int(np.argmax(known_of(mdp)))
    n = float(counts.toarray()[pair].sum())
    mean = (counts.toarray()[pair] + 0.25) / (n + 1)
    spread = np.sqrt(mean * (1 - mean) / (n + 2))  # of a Dirichlet law
    assert models.rows[:, pair].mean(axis=0) == pytest.approx(mean, abs=4 * spread.max() / 20)
    assert models.rows[:, pair].std(axis=0) == pytest.approx(spread, rel=0.2, abs=1e-3)
    ends = ~known_of(mdp)
    assert (models.rows[:, ends] == mdp.transition.toarray()[ends]).all()


def start_value(rows: Any, reward: Any, start: Any, pairs: Any) -> float:
    """The value at the start of the policy that takes some pairs, at discount 9/10."""
    chosen = list(pairs)
    return float(start @ np.linalg.solve(np.eye(len(chosen)) - 0.9 * rows[chosen], reward[chosen]))


def test_regrets_of_draws_are_those_of_all_policies() -> None:
    for seed in range(2):
        mdp = estimated(recorded(np.random.default_rng(seed), 10))
        own = (mdp.pair_action == np.array(POLICY)[mdp.pair_state]) | mdp.forced[mdp.pair_state]
        models = sample_models(mdp, known_of(mdp), 1.0, np.random.default_rng(seed), 6)
        found = drawn_regrets(models, own.astype(float))
        for k in range(6):
            start = partial(start_value, models.rows[k], models.reward[k], models.start[k])
            best = max(map(start, product(*(mdp.pairs_of(s) for s in range(mdp.n_states)))))
            lost = best - start(np.flatnonzero(own))
            assert found[k] == pytest.approx(lost, rel=1e-9, abs=1e-9)
            assert found[k] >= 0
            assert lost > 1e-9 or found[k] == 0


def test_regrets_within_a_horizon_are_those_of_stages() -> None:
    mdp = estimated(recorded(np.random.default_rng(3), 40))
    own = (mdp.pair_action == STAGES[:, mdp.pair_state]) | mdp.forced[mdp.pair_state]
    models = sample_models(mdp, known_of(mdp), 1.0, np.random.default_rng(0), 5)
    found = drawn_regrets(models, own.astype(float))
    for k in range(5):
        rows, reward = np.zeros((4, 2, 4)), np.full((4, 2), -1e9)
        for pair, (s, a) in enumerate(zip(mdp.pair_state, mdp.pair_action, strict=True)):
            rows[s, a], reward[s, a] = models.rows[k, pair], models.reward[k, pair]
        rows[3, 1], reward[3, 1] = rows[3, 0], reward[3, 0]
        best, mine = by_stage(rows, reward, 0.9, STAGES) @ models.start[k]
        assert found[k] == pytest.approx(best - mine, rel=1e-9, abs=1e-9)
    one = np.repeat((mdp.pair_action == 0)[None].astype(float), 1, axis=0)
    assert (drawn_regrets(models, one) >= 0).all()


def test_an_interval_is_made_of_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = estimated(recorded(np.random.default_rng(0), 20))
    own = (mdp.pair_action == np.array(POLICY)[mdp.pair_state]) | mdp.forced[mdp.pair_state]
    interval = Posterior(n=300, rng=4, prior=2).interval(mdp, own.astype(float), F(9, 10))
    assert interval.draws is not None
    assert len(interval.draws) == 300
    assert (interval.low, interval.high) == (0, upper_quantile(interval.draws, 0.9))
    assert interval.found["mean"] == interval.draws.mean()
    assert interval.found["prior"] == 2
    assert (interval.found["draws"], interval.found["seed"]) == (300, 4)
    low, high = interval.found["equal_tails"]
    assert (interval.draws < low).mean() <= 0.05
    assert (interval.draws > high).mean() <= 0.05
    tails = estimate_quantiles(interval.draws, [0.05, 0.95])
    assert (low, high) == (tails[0]["low"], tails[1]["high"])
    assert low < np.quantile(interval.draws, 0.1)
    assert high > np.quantile(interval.draws, 0.9)
    counts = list[int]()

    def counted(*given: Any) -> Any:
        counts.append(given[-1])
        return sample_models(*given)

    monkeypatch.setattr(module, "sample_models", counted)
    numbers = mdp.n_pairs * mdp.n_states
    for block, most in ((1, 1), (7 * numbers, 7), (8 * numbers - 1, 7)):  # draws at a time
        monkeypatch.setattr(module, "BLOCK", block)
        again = Posterior(n=300, rng=4, prior=2).interval(mdp, own.astype(float), F(9, 10))
        assert again.draws is not None
        assert len(again.draws) == 300
        assert again.draws.mean() == pytest.approx(interval.draws.mean(), rel=0.3)
        assert (max(counts), sum(counts)) == (most, 300)
        counts.clear()


def test_what_cannot_be_drawn_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = estimated(recorded(np.random.default_rng(0), 20))
    own = np.ones(mdp.n_pairs)
    for prior, good in ((1e-6, True), (1e9, True), ("9/10000000", False), ("2000000001/2", False)):
        if good:
            Posterior(n=40, prior=prior).interval(mdp, own / 2, F(1, 2))
        else:
            with pytest.raises(ModelError, match="the prior is"):
                Posterior(n=40, prior=prior).interval(mdp, own, F(1, 2))
    with pytest.raises(ModelError):
        Posterior(n=1).interval(mdp, own, F(1, 2))
    with pytest.raises(ModelError):
        Posterior(n=10).interval(mdp, own, F(99, 100))
    size = mdp.n_states * mdp.n_pairs
    for most in (size, size - 1):
        monkeypatch.setattr(module, "MOST_NUMBERS", most)
        if most == size:
            Posterior(n=40).interval(mdp, own / 2, F(1, 2))
        else:
            with pytest.raises(ModelError, match="a draw has"):
                Posterior(n=40).interval(mdp, own, F(1, 2))
    rows: Any = [(0, "a", "x", 0, "b", True), (1, "a", "x", 0, None, False)]
    cut = MDP.from_transitions(pd.DataFrame(rows, columns=[*NAMES, "truncated"]), discount="1/2")
    with pytest.raises(ModelError, match="cut off in"):
        Posterior().interval(cut, np.ones(cut.n_pairs), F(1, 2))


def test_draws_of_a_seed_come_in_blocks_of_250() -> None:
    for seed, sense in ((4, "max"), (6, "min")):
        mdp = estimated(recorded(np.random.default_rng(seed), 4)).with_(sense=sense)
        assert 1 in np.asarray(mdp.observations)  # what was seen once is known
        own = ((mdp.pair_action == 0) | mdp.forced[mdp.pair_state]).astype(float)
        interval = Posterior(n=300, rng=seed, prior=3).interval(mdp, own, F(1, 2))
        parts = [
            drawn_regrets(
                sample_models(
                    mdp.maximised, known_of(mdp), 3.0, np.random.default_rng(stream), count
                ),
                own,
            )
            for stream, count in zip(np.random.SeedSequence(seed).spawn(2), (250, 50), strict=True)
        ]
        assert interval.draws is not None
        assert interval.draws.tolist() == np.concatenate(parts).tolist()
        assert (interval.draws >= 0).all()


def test_what_is_not_asked_is_as_documented(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = list[dict[str, Any]]()

    def stop(*_: Any, **how: Any) -> Any:
        asked.append(how)
        raise StopIteration

    assert vars(Posterior()) == {"prior": 1, "n": 2000, "rng": 0, "n_jobs": 1, "progress": False}
    monkeypatch.setattr(module, "run_pieces", stop)
    mdp = estimated(recorded(np.random.default_rng(0), 20))
    own = np.ones(mdp.n_pairs)
    for how in ({"n_jobs": 1, "progress": False}, {"n_jobs": 2, "progress": True}):
        settings: Any = how
        with pytest.raises(StopIteration):
            Posterior(**settings).interval(mdp, own, F(1, 2))
        assert asked.pop() == {"key": {}, "what": "draws"} | how
    with pytest.raises(ModelError, match="10 draws are too few"):  # before anything is drawn
        Posterior(n=10).interval(mdp, own, F(99, 100))
    with pytest.raises(StopIteration):
        Posterior(n=2).interval(mdp, own, F(1, 10))


def test_ends_stay_ends_at_discount_1() -> None:
    mdp = MDP.from_transitions(recorded(np.random.default_rng(0), 30), discount=1)
    known = known_of(mdp)
    models = sample_models(mdp, known, 1.0, np.random.default_rng(0), 5)
    assert models.live.tolist() == [[True, True, True, False]] * 5
    assert models.structure.ended.tolist() == [False, False, False, True]
    assert models.leak.tolist() == [[0]]
    own = (mdp.pair_action == np.array(POLICY)[mdp.pair_state]) | mdp.forced[mdp.pair_state]
    found = drawn_regrets(models, own.astype(float))
    for k in range(5):
        rows, reward = models.rows[k], models.reward[k]

        def value(pairs: Any, rows: Any = rows, reward: Any = reward) -> Any:
            chosen = list(pairs)[:3]
            return np.linalg.solve(np.eye(3) - rows[chosen][:, :3], reward[chosen])

        every = product(*(mdp.pairs_of(s) for s in range(4)))
        best = np.max([value(each) for each in every], axis=0)
        lost = models.start[k][:3] @ (best - value(np.flatnonzero(own)))
        assert found[k] == pytest.approx(lost, rel=1e-9, abs=1e-9)
    below = sample_models(mdp.with_(discount="9/10"), known, 1.0, np.random.default_rng(0), 5)
    assert below.live.all()
    assert not below.structure.ended.any()


def test_states_that_never_followed_have_chances_of_their_own() -> None:
    mdp = estimated(recorded(np.random.default_rng(5), 4))
    models = sample_models(mdp, known_of(mdp), 4.0, np.random.default_rng(0), 50)
    counts = mdp.counts
    assert counts is not None
    never = known_of(mdp)[:, None] & (counts.toarray() == 0)
    assert never.sum() > 1
    drawn = models.rows[:, never]
    assert len(np.unique(drawn)) == drawn.size


def test_a_loss_within_the_bounds_of_both_values_is_none() -> None:
    models: Any = SimpleNamespace(
        optimum=lambda: (None, None, None),
        at_start=lambda *_: (np.array([1.0, 1.0, 1.0]), np.array([0.125, 0.125, 0.125])),
        evaluate=lambda _: (
            np.array([[0.8125], [0.8125], [0.75]]),
            np.array([[0.03125], [0.125], [0.125]]),
        ),
    )
    assert drawn_regrets(models, np.ones(3)).tolist() == [0.1875, 0, 0]
    nothing: Any = SimpleNamespace(optimum=lambda: None)
    with pytest.raises(ModelError, match="an episode may never end"):
        drawn_regrets(nothing, np.ones(3))


def test_roundings_of_stages_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """N steps of L + S + 4 roundings each, of values of at most N max |r|; two values."""
    mdp = estimated(recorded(np.random.default_rng(3), 40))
    own = (mdp.pair_action == STAGES[:, mdp.pair_state]) | mdp.forced[mdp.pair_state]
    noises = list[np.ndarray]()

    def kept(best: Any, mine: Any, noise: Any) -> Any:
        noises.append(noise)
        return best - mine

    monkeypatch.setattr(module, "compute_regrets", kept)
    for count in (1, 3):
        models = sample_models(mdp, known_of(mdp), 1.0, np.random.default_rng(0), count)
        drawn_regrets(models, own.astype(float))
        unit = 3 * (mdp.n_pairs + mdp.n_states + 4) / 2**53
        for noise, reward in zip(noises.pop(), models.reward, strict=True):
            wanted = 2 * unit * 3 * np.abs(reward).max() * (1 + 2.0**-20)
            assert noise == pytest.approx(wanted, rel=1e-9, abs=0)
