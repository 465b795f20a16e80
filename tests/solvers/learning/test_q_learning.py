"""Learning from samples: against a twin in plain Python, exact laws, and known convergence."""

from fractions import Fraction
from itertools import pairwise
from math import exp, log, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning_twin import Stream, Twin
from pieces_of_work import contents
from strategies import models

from exact_mdp import (
    MDP,
    Constant,
    Exponential,
    ModelError,
    Policy,
    QLearning,
    Scenario,
    evaluate,
    solve,
    train,
)
from exact_mdp.solvers.learning.q_learning import METHODS, TIES, Trainer
from exact_mdp.solvers.learning.sampler import as_policy, child, rows_of, stream, tables
from exact_mdp.solvers.learning.schedules import PAPER_CONSTANT, PAPER_DECAYING
from exact_mdp.solvers.values.policy_values import policy_values

CARE = Scenario.load("yuan2025")
OTHERS = {"skip_timestep": "own", "task_bonus": "no-subtask-skipped"}


@pytest.fixture(scope="module")
def care() -> MDP:
    return CARE.compile()


@pytest.fixture(scope="module")
def other() -> MDP:
    """Another reading, with states that offer no choice and two tasks."""
    return CARE.with_(readings=OTHERS, tasks=[1, 2]).compile()


# ---- against the twin ----------------------------------------------------------------------------


def compare_with_twin(mdp: MDP, learner: QLearning, seed: int) -> None:
    run = learner.train(mdp, seed)
    rows = rows_of(mdp, learner.columns)
    twin = Twin(
        tables=tables(mdp, rows),
        actions=mdp.n_actions,
        method=learner.method,
        ties=learner.ties,
        discount=float(learner.discount),
        power=learner.rate_power,
        bootstrap_end=learner.bootstrap_end,
        initial=learner.initial,
    )
    words = np.random.SeedSequence(seed).generate_state(4, np.uint64)
    epsilon = learner.exploration.values(learner.epochs)
    rate = learner.rate.values(learner.epochs)
    episodes = learner.epochs * learner.episodes
    at = learner.snapshot_episode
    snapshots = range(at, episodes + 1, learner.episodes) if at else range(0)
    last = range(max(1, episodes + 1 - learner.last), episodes + 1)
    kept = {*snapshots, *last}
    twin.run(words.tolist(), epsilon, rate, learner.episodes, learner.max_steps, kept)
    assert np.array_equal(run.q, twin.table(rows.space.size))
    assert (run.steps, run.cut_short) == (twin.steps, twin.cut)
    assert run.returns.tolist() == twin.returns
    assert run.policies[run.last].tolist() == [twin.policies[number] for number in last]
    assert run.policies[run.snapshots].tolist() == [twin.policies[number] for number in snapshots]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("ties", TIES)
@pytest.mark.parametrize("bootstrap_end", [False, True])
def test_every_bit_is_the_twins(other: MDP, method: str, ties: str, bootstrap_end: bool) -> None:
    learner = QLearning(
        method=method, ties=ties, bootstrap_end=bootstrap_end, epochs=25, rate_power=0.3, last=40
    )
    compare_with_twin(other, learner, seed=5)


@pytest.mark.parametrize(
    "learner",
    [
        QLearning(epochs=60, exploration=PAPER_DECAYING),
        QLearning(epochs=8, columns=("subtask", "trial", "status"), initial=50.0, last=7),
        QLearning(epochs=9, columns=("trial", "status"), discount=1, rate=Exponential(decay=0.3)),
        QLearning(epochs=5, columns=(), rate=Exponential(decay=0.5), snapshot_episode=0),
        QLearning(epochs=30, episodes=3, snapshot_episode=3, max_steps=4, last=500),
        QLearning(epochs=10, exploration=Constant(1.0), ties="random", initial=-3.5),
    ],
    ids=range(6),
)
@pytest.mark.parametrize("seed", [0, 12345678901234567890])
def test_options_are_the_twins(care: MDP, learner: QLearning, seed: int) -> None:
    compare_with_twin(care, learner, seed)


@settings(max_examples=40)
@given(
    model=models(discounts=(Fraction(9, 10), Fraction(1))),
    method=st.sampled_from(METHODS),
    ties=st.sampled_from(TIES),
    seed=st.integers(0, 2**70),
)
def test_any_model_is_learned_as_the_twin_does(model, method: str, ties: str, seed: int) -> None:
    learner = QLearning(
        method=method, ties=ties, epochs=4, episodes=5, max_steps=20, snapshot_episode=2, last=8
    )
    compare_with_twin(model.model(), learner, seed)


def test_the_stream_is_known() -> None:
    """First words of xoshiro256++ from the state 1, 2, 3, 4, as its authors' program gives them."""
    draw = Stream([1, 2, 3, 4])
    known = [41943041, 58720359, 3588806011781223, 3591011842654386, 9228616714210784205]
    assert [draw() for _ in known] == [(word >> 11) / 2**53 for word in known]


# ---- the sampler ---------------------------------------------------------------------------------


@pytest.mark.parametrize("readings", [{}, OTHERS, {"skip_onset": "base"}], ids=str)
def test_alias_columns_are_the_exact_rows(readings: dict[str, str]) -> None:
    mdp = CARE.with_(readings=readings).compile()
    laid = tables(mdp, rows_of(mdp))
    for pair in range(mdp.n_pairs):
        first, last = laid.offsets[pair], laid.offsets[pair + 1]
        found: dict[tuple[int, float], float] = {}
        for column in range(first, last):
            for side, share in ((0, laid.cut[column]), (1, 1 - laid.cut[column])):
                key = (int(laid.next[2 * column + side]), float(laid.gain[2 * column + side]))
                found[key] = found.get(key, 0.0) + share / (last - first)
        expected: dict[tuple[int, float], Fraction] = {}
        for chance, following, gain in mdp.table.row(pair):
            key = (following, float(gain))
            expected[key] = expected.get(key, Fraction(0)) + chance
        assert {key for key, share in found.items() if share > 1e-14} <= set(expected)
        for key, chance in expected.items():
            assert abs(found.get(key, 0.0) - float(chance)) < 1e-14


def test_a_child_is_numpys() -> None:
    parent = np.random.SeedSequence(7)
    for number, spawned in enumerate(parent.spawn(3)):
        ours = child(np.random.SeedSequence(7), number)
        assert stream(ours).tolist() == stream(spawned).tolist()


def test_rows_that_hide_which_actions_there_are_are_refused() -> None:
    rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (1, 1, [(1, 2, 0)]), (1, 2, [(1, 2, 0)])]
    mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])
    with pytest.raises(ModelError, match="share a row"):
        rows_of(mdp, ())
    assert rows_of(mdp).offered.tolist() == [
        [True, True, False],
        [False, True, True],
        [True, False, False],
    ]


# ---- schedules -----------------------------------------------------------------------------------


def test_the_papers_schedules() -> None:
    decay = log(0.97 / 0.77) / 300
    assert PAPER_DECAYING.values(6000)[[0, 300]].tolist() == pytest.approx([1, 0.8], abs=1e-15)
    assert PAPER_DECAYING.values(6000)[5999] == pytest.approx(0.03 + 0.97 * exp(-decay * 5999))
    assert set(PAPER_CONSTANT.values(10)) == {0.1}


@pytest.mark.parametrize("value", [0.03, 0.0, 1.0, 2.0])
def test_a_schedule_through_an_impossible_point_is_refused(value: float) -> None:
    with pytest.raises(ModelError, match="no decay"):
        Exponential.through(value, at=300, minimum=0.03)


@pytest.mark.parametrize(
    "settings",
    [
        {"method": "q-leaning"},
        {"ties": "none"},
        {"epochs": 0},
        {"epochs": 2.0},
        {"episodes": True},
        {"snapshot_episode": 31},
        {"last": 0},
        {"max_steps": 0},
        {"discount": 1.5},
        {"exploration": Constant(1.5)},
        {"exploration": Constant(float("nan"))},
        {"rate": Constant(-0.1)},
        {"initial": float("inf")},
    ],
    ids=str,
)
def test_bad_settings_are_refused(settings: dict[str, object]) -> None:
    with pytest.raises(ModelError) as refused:
        QLearning(**settings)
    assert refused.value.where
    assert refused.value.fix


@pytest.mark.parametrize("seed", [-1, 1.5, "0", None, True])
def test_a_bad_seed_is_refused(care: MDP, seed: object) -> None:
    with pytest.raises(ModelError, match="source of random numbers"):
        QLearning(epochs=1).train(care, seed)


@pytest.mark.parametrize("runs", [0, -1, 1.5, True])
def test_a_bad_number_of_runs_is_refused(care: MDP, runs: object) -> None:
    with pytest.raises(ModelError, match="runs"):
        train(care, SMALL, runs, rng=0)


def test_too_many_policies_to_keep_are_refused() -> None:
    mdp = CARE.with_(tasks=[1000]).compile()
    every = ("subtask", "trial", "status")
    with pytest.raises(ModelError, match="too many"):
        QLearning(columns=every).train(mdp, 0)


# ---- what learning must do -----------------------------------------------------------------------


def test_zero_is_a_seed_of_its_own(care: MDP) -> None:
    learner = QLearning(epochs=3)
    first = learner.train(care, 0).q
    assert np.array_equal(first, learner.train(care, 0).q)
    assert not np.array_equal(first, learner.train(care, 1).q)


@pytest.mark.parametrize("method", METHODS)
def test_with_falling_rates_the_optimum_is_found(method: str) -> None:
    """All columns, rates n^-0.7: the classical conditions of convergence (Watkins and Dayan)."""
    mdp = CARE.with_(tasks=[1], max_trial=2).compile()
    learner = QLearning(
        method=method,
        epochs=3000,
        columns=mdp.space.names,
        discount=1,
        rate=Constant(1.0),
        rate_power=0.7,
        exploration=Exponential(minimum=0.01, decay=0.001),
    )
    run = learner.train(mdp, 3)
    best = solve(mdp)
    assert abs(run.q[0].max() - best.start_value) < 2.0
    regret = best.start_value - evaluate(mdp, run.policy(mdp)).mean
    assert -1e-9 < regret < 0.5


def test_action_values_without_choice_are_policy_values() -> None:
    """SARSA that always explores learns the values of the random policy."""
    mdp = CARE.with_(tasks=[1], max_trial=2, discount="19/20").compile()
    exact = evaluate(mdp, "random").value
    learner = QLearning(
        method="sarsa",
        epochs=4000,
        columns=mdp.space.names,
        rate=Constant(1.0),
        rate_power=0.8,
        exploration=Constant(1.0),
    )
    found = learner.train(mdp, 1).q[0].mean()
    assert abs(found - exact[0]) < 1.0


def test_training_returns_are_those_of_the_exploring_policy(care: MDP) -> None:
    """With a rate of 0 the greedy policy stays, and the returns have its exact ε-greedy mean."""
    epsilon = 0.25
    run = QLearning(epochs=4000, rate=Constant(0.0), exploration=Constant(epsilon)).train(care, 2)
    table = np.full((16, 4), epsilon / 4)
    table[:, 0] += 1 - epsilon
    exact = evaluate(care, Policy.by(care, ("status",), table))
    error = exact.sd / sqrt(4000 * 30)
    assert abs(run.returns.mean() - exact.mean) < 4 * error
    assert abs(run.steps / (4000 * 30) - exact.steps) < 0.05


def test_a_start_distribution_is_drawn_from() -> None:
    rows = [(state, 0, [(1, 2, state)]) for state in range(2)] + [(2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, start={0: "1/4", 1: "3/4"})
    run = QLearning(epochs=200).train(mdp, 0)
    assert abs(run.returns.mean() - 0.75) < 4 * sqrt(0.75 * 0.25 / 6000)


def test_episodes_that_do_not_end_are_cut_and_counted() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, 0)])], discount="9/10")
    run = QLearning(epochs=2, episodes=30, max_steps=50).train(mdp, 0)
    assert (run.steps, run.cut_short) == (2 * 30 * 50, 60)
    assert run.final.tolist() == [0]


# ---- values of many policies ---------------------------------------------------------------------


@pytest.mark.parametrize("readings", [{}, OTHERS], ids=str)
@pytest.mark.parametrize("discount", [1, "19/20"])
def test_policy_values_are_those_of_evaluate(readings: dict[str, str], discount: object) -> None:
    mdp = CARE.with_(readings=readings, discount=discount).compile()
    rows = rows_of(mdp)
    policies = np.random.default_rng(0).integers(0, 4, (12, 16))
    found = policy_values(mdp, rows, policies)
    for policy, value, error in zip(policies, found.value, found.error, strict=True):
        exact = evaluate(mdp, as_policy(mdp, rows.space, policy))
        assert abs(value - exact.mean) <= error + exact.start.error
        assert error < 1e-9


@settings(max_examples=60)
@given(model=models(discounts=(Fraction(9, 10), Fraction(1))), seed=st.integers(0, 100))
def test_policy_values_of_any_model(model, seed: int) -> None:
    mdp = model.model()
    rows = rows_of(mdp)
    draw = np.random.default_rng(seed)
    policies = np.array(
        [[draw.choice(np.flatnonzero(row)) for row in rows.offered] for _ in range(3)]
    )
    found = policy_values(mdp, rows, policies)
    for policy, value, error in zip(policies, found.value, found.error, strict=True):
        exact = evaluate(mdp, Policy.from_choices(mdp, policy))
        assert abs(value - exact.mean) <= error + exact.start.error


# ---- many runs -----------------------------------------------------------------------------------

SMALL = QLearning(epochs=4)


def test_workers_and_number_of_runs_change_nothing(care: MDP, tmp_path: Path) -> None:
    alone = train(care, SMALL, 7, rng=0, n_jobs=1, out=tmp_path / "one")
    many = train(care, SMALL, 7, rng=0, n_jobs=3, out=tmp_path / "three")
    assert contents(tmp_path / "one") == contents(tmp_path / "three")
    few = train(care, SMALL, 2, rng=0)
    for a, b in [*zip(alone, many, strict=True), *zip(alone, few, strict=False)]:
        assert a.q.tobytes() == b.q.tobytes()
        assert np.array_equal(a.policies[a.snapshots], b.policies[b.snapshots])
    by_hand = SMALL.train(care, child(0, 5))
    assert by_hand.q.tobytes() == alone[5].q.tobytes()
    assert all(a.q.tobytes() != b.q.tobytes() for a, b in pairwise(alone))


def test_finished_runs_are_kept_and_used_again(
    care: MDP, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh = train(care, SMALL, 8, rng=1)
    train(care, SMALL, 5, rng=1, out=tmp_path)
    assert sorted(path.name for path in tmp_path.glob("*.npz")) == [
        f"runs-{number:06d}.npz" for number in range(5)
    ]
    done, once = [], Trainer.run
    monkeypatch.setattr(Trainer, "run", lambda self, seed: done.append(seed) or once(self, seed))
    runs = train(care, SMALL, 8, rng=1, out=tmp_path)
    assert len(done) == 3
    for a, b in zip(runs, fresh, strict=True):
        assert (a.steps, a.cut_short, a.space) == (b.steps, b.cut_short, b.space)
        for name in ("q", "policies", "last", "returns"):
            assert np.array_equal(getattr(a, name), getattr(b, name)), name


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"rng": 2}, "seed"),
        ({"settings": QLearning(epochs=5)}, "settings"),
        ({"model": CARE.with_(tasks=[1]).compile()}, "model_hash"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_a_folder_of_another_training_is_refused(
    care: MDP, tmp_path: Path, changes: dict[str, object], named: str
) -> None:
    given = {"model": care, "settings": SMALL, "n": 1, "rng": 1, "out": tmp_path}
    train(**given)
    with pytest.raises(ModelError, match=named):
        train(**given | changes)


def test_a_damaged_file_is_named(care: MDP, tmp_path: Path) -> None:
    train(care, SMALL, 1, rng=1, out=tmp_path)
    path = tmp_path / "runs-000000.npz"
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(ModelError, match="damaged") as refused:
        train(care, SMALL, 1, rng=1, out=tmp_path)
    assert refused.value.where == str(path)


def test_settings_and_runs_cannot_be_changed(care: MDP) -> None:
    run = SMALL.train(care, 0)
    with pytest.raises(AttributeError):
        run.steps = 0
    with pytest.raises(ValueError, match="read-only"):
        run.q[0, 0] = 1.0
    with pytest.raises(AttributeError):
        SMALL.epochs = 1
