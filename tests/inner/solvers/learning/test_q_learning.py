"""Learning against a twin in plain Python, and the sampler against exact rows."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learning_twin import Stream, Twin
from strategies import Rows, models

from exact_mdp import MDP, Constant, Exponential, QLearning, Scenario
from exact_mdp.solvers.kernels import learning as kernels
from exact_mdp.solvers.learning import q_learning
from exact_mdp.solvers.learning.sampler import build_q_table_rows, build_sampling_tables

METHODS = ("q-learning", "sarsa", "expected-sarsa", "double-q-learning")
TIES = ("first", "last", "random")
CARE = Scenario.load("yuan2025")
MDP_OF_CARE = CARE.with_(tasks=[1]).compile()
OTHERS = {"skip_timestep": "own", "task_bonus": "no-subtask-skipped"}


# ---- against the twin ----------------------------------------------------------------------------


def compare_with_twin(mdp: MDP, learner: QLearning, seed: int) -> None:
    run = learner.train(mdp, seed)
    rows = build_q_table_rows(mdp, learner.columns)
    twin = Twin(build_sampling_tables(mdp, rows), mdp.n_actions, learner)
    words = np.random.SeedSequence(seed).generate_state(4, np.uint64)
    episodes = learner.epochs * learner.episodes
    at = learner.snapshot_episode
    snapshots = range(at, episodes + 1, learner.episodes) if at else range(0)
    last = range(max(1, episodes + 1 - learner.last), episodes + 1)
    twin.run(words.tolist(), {*snapshots, *last})
    assert np.array_equal(run.q, twin.table(rows.space.size))
    assert (run.steps, run.cut_short) == (twin.steps, twin.cut)
    assert run.returns.tolist() == twin.returns
    assert run.policies[run.last].tolist() == [twin.policies[number] for number in last]
    assert run.policies[run.snapshots].tolist() == [twin.policies[number] for number in snapshots]


@pytest.mark.parametrize("method", METHODS)
def test_a_run_in_pieces_has_the_same_bytes(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop returns to Python after some steps, so that a signal ends it: also within epochs."""
    learner = QLearning(
        method=method, epochs=6, episodes=7, rate_power=0.3, snapshot_episode=3, last=20
    )
    whole = learner.train(MDP_OF_CARE, 5)
    for steps in (1, 90, 2000):
        monkeypatch.setattr(q_learning, "AT_ONCE", steps)
        run = learner.train(MDP_OF_CARE, 5)
        for name in ("q", "policies", "snapshots", "last", "returns"):
            assert getattr(run, name).tobytes() == getattr(whole, name).tobytes()
        assert (run.steps, run.cut_short) == (whole.steps, whole.cut_short)


def test_a_signal_ends_a_long_run_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is raised between two pieces ends the run, as the handler of a signal does."""
    calls = []

    def learn(*arguments: Any) -> Any:
        calls.append(arguments)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return once(*arguments)

    once = kernels.run_learner
    monkeypatch.setattr(kernels, "run_learner", learn)
    with pytest.raises(KeyboardInterrupt):
        QLearning(epochs=2_000_000, snapshot_episode=0).train(MDP_OF_CARE, 0)
    assert len(calls) == 3


def schedules(*rates: float) -> st.SearchStrategy[Any]:
    falling = st.sampled_from(
        [Exponential.through(0.8, at=30, minimum=0.03), Exponential(decay=0.3)]
    )
    return st.one_of(st.sampled_from([Constant(rate) for rate in rates]), falling)


@st.composite
def learners(draw: st.DrawFn) -> QLearning:
    """Draw settings of every kind."""
    episodes = draw(st.integers(1, 30))
    return QLearning(
        method=draw(st.sampled_from(METHODS)), ties=draw(st.sampled_from(TIES)),
        epochs=draw(st.integers(1, 12)), episodes=episodes,
        max_steps=draw(st.sampled_from([4, 20, 100])),
        snapshot_episode=draw(st.integers(0, episodes)), last=draw(st.integers(1, 400)),
        exploration=draw(schedules(0.1, 1.0)), rate=draw(schedules(0.05, 1.0)),
        rate_power=draw(st.sampled_from([0.0, 0.3])), bootstrap_end=draw(st.booleans()),
        initial=draw(st.sampled_from([0.0, 50.0, -3.5])), discount=draw(st.sampled_from([0.95, 1])),
    )  # fmt: skip


@settings(max_examples=80)
@given(models(discounts=(Fraction(9, 10), Fraction(1))), learners(), st.integers(0, 2**70))
def test_every_bit_is_the_twins(model: Rows, learner: QLearning, seed: int) -> None:
    compare_with_twin(model.model(), learner, seed)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("readings", [{}, OTHERS], ids=str)
@pytest.mark.parametrize("columns", [("subtask", "trial", "status"), ("trial", "status"), ()])
def test_every_bit_of_the_care_model_is_the_twins(
    method: str, readings: dict[str, str], columns: tuple[str, ...]
) -> None:
    """Two tasks, and in the other readings states that offer no choice."""
    mdp = CARE.with_(readings=readings, tasks=[1, 2]).compile()
    columns = ("status",) if readings and not columns else columns  # "skip" shares no row
    compare_with_twin(mdp, QLearning(method=method, columns=columns, epochs=9), seed=5)


def test_the_stream_is_known() -> None:
    """First words of xoshiro256++ from the state 1, 2, 3, 4, as its authors' program gives them."""
    draw = Stream([1, 2, 3, 4])
    known = [41943041, 58720359, 3588806011781223, 3591011842654386, 9228616714210784205]
    assert [draw() for _ in known] == [(word >> 11) / 2**53 for word in known]


# ---- the sampler ---------------------------------------------------------------------------------


@pytest.mark.parametrize("readings", [{}, OTHERS, {"skip_onset": "base"}], ids=str)
def test_alias_columns_are_the_exact_rows(readings: dict[str, str]) -> None:
    mdp = CARE.with_(readings=readings).compile()
    laid = build_sampling_tables(mdp, build_q_table_rows(mdp))
    for pair in range(mdp.n_pairs):
        first, last = laid.offsets[pair], laid.offsets[pair + 1]
        chances: dict[tuple[int, float], float] = {}
        for column in range(first, last):
            for side, share in ((0, laid.cut[column]), (1, 1 - laid.cut[column])):
                key = (int(laid.next[2 * column + side]), float(laid.gain[2 * column + side]))
                chances[key] = chances.get(key, 0.0) + share / (last - first)
        expected: dict[tuple[int, float], Fraction] = {}
        for chance, following, gain in mdp.table.row(pair):
            key = (following, float(gain))
            expected[key] = expected.get(key, Fraction(0)) + chance
        assert {key for key, share in chances.items() if share > 1e-14} <= set(expected)
        for key, chance in expected.items():
            assert abs(chances.get(key, 0.0) - float(chance)) < 1e-14
