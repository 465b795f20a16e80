"""Speed: exact solving, batches of draws, and learning, beside what one would write otherwise.

Each comparison runs on the same data, one after the other in the same process; values are compared
before anything is timed, and each test asserts the least ratio that the fast way is for. quantecon
is given ready arrays (its time to build a model from tables is not counted), and the compiled loops
are warm. Rates of learning are per second of one core's time. `make bench` prints the figures.
"""

import random
from collections.abc import Callable, Mapping
from fractions import Fraction as F
from time import perf_counter, thread_time
from typing import Any

import numpy as np
import pytest
from oracle import solve_exact
from strategies import model_of

from exact_mdp import MDP, QLearning, Scenario, certify, solve, train
from exact_mdp.solvers.care import optimal, policy_values
from exact_mdp.solvers.learning.q_learning import Trainer
from exact_mdp.solvers.learning.sampler import child, rows_of

pytestmark = pytest.mark.bench

SCENARIO = Scenario.load("yuan2025")
NAMES = [n for n in SCENARIO.names if not n.startswith("reward.") and 0 < SCENARIO[n] < 1]
DRAWS = 100_000
PEER_DRAWS = 20
EPSILON, RATE, DISCOUNT = 0.1, 0.05, 0.95
SLOW_EPISODES = 3000


@pytest.fixture
def show(benchmark: Any, capsys: pytest.CaptureFixture[str]) -> Callable[..., None]:
    """Print figures, and keep them with the benchmark."""

    def printed(figures: Mapping[str, float]) -> None:
        benchmark.extra_info.update(figures)
        with capsys.disabled():
            print()
            for name, value in figures.items():
                print(f"  {name:<70}{value:>14,.4g}")

    return printed


def fastest(work: Callable[[], object], repeats: int = 3) -> float:
    seconds = []
    for _ in range(repeats):
        started = perf_counter()
        work()
        seconds.append(perf_counter() - started)
    return min(seconds)


# ---- exact solving -------------------------------------------------------------------------------


def backward_induction(mdp: MDP) -> list[F]:
    """V by fractions, states in falling order: the care model's transitions lead upward."""
    value = [F(0)] * mdp.n_states
    rows = [mdp.table.row(pair) for pair in range(mdp.n_pairs)]
    for s in range(mdp.n_states - 2, -1, -1):
        value[s] = max(
            sum((p * (r + value[t]) for p, t, r in rows[pair]), F(0)) for pair in mdp.pairs_of(s)
        )
    return value


def times_as_fast(benchmark: Any, mdp: MDP, slow: Callable[[], list[F]]) -> float:
    """How many times as fast the exact solver is; both find the same values."""
    certify(mdp)  # what is imported when first needed
    started = perf_counter()
    value = slow()
    seconds = perf_counter() - started
    assert list(benchmark.pedantic(certify, (mdp,), rounds=3).value) == value
    ratio = seconds / fastest(lambda: certify(mdp))
    benchmark.extra_info["times as fast as fractions"] = round(ratio, 1)
    return ratio


@pytest.mark.parametrize("subtasks, least", [(3, 5), (30, 20)])
def test_backward_induction(benchmark: Any, subtasks: int, least: float) -> None:
    mdp = SCENARIO.with_(tasks=[subtasks]).compile()
    assert times_as_fast(benchmark, mdp, lambda: backward_induction(mdp)) > least


@pytest.mark.parametrize("states, least", [(30, 5), (100, 50)])
def test_policy_iteration(benchmark: Any, states: int, least: float) -> None:
    draw, rows = random.Random(1), []
    for s in range(states):
        for a in range(3):
            weights = {draw.randrange(states): draw.randrange(1, 50) for _ in range(4)}
            total = sum(weights.values())
            shares = {t: F(weight, total) for t, weight in weights.items()}
            rows.append((s, a, F(draw.randrange(-50, 50), 7), shares))
    mdp = model_of(states, rows, F(99, 100))
    assert times_as_fast(benchmark, mdp, lambda: solve_exact(states, rows, F(99, 100))[0]) > least


@pytest.mark.parametrize("subtasks", [3, 30, 100])
def test_certify_and_check(benchmark: Any, subtasks: int) -> None:
    mdp = SCENARIO.with_(tasks=[subtasks]).compile()
    optimum = certify(mdp)
    assert optimum.unique
    benchmark.extra_info["seconds to certify"] = fastest(lambda: certify(mdp))
    assert benchmark.pedantic(optimum.violations, rounds=3) == []


# ---- many draws and policies at once -------------------------------------------------------------


def drawn(count: int) -> np.ndarray:
    mean = np.array([float(SCENARIO[name]) for name in NAMES])
    size = (count, len(NAMES))
    return np.random.default_rng(0).beta(50 * mean, 50 * (1 - mean), size=size)


def compiled(row: np.ndarray) -> MDP:
    return SCENARIO.with_(parameters=dict(zip(NAMES, row.tolist(), strict=True))).compile()


def peer_model(mdp: MDP):
    """Return the same model for quantecon; its discount must be below 1, the rewards stay."""
    from quantecon.markov import DiscreteDP

    return DiscreteDP(
        np.array(mdp.reward),
        mdp.transition.copy(),
        1 - 1e-9,
        np.array(mdp.pair_state),
        np.array(mdp.pair_action),
    )


def test_draws_a_second(benchmark: Any, show: Callable[..., None]) -> None:
    draws = drawn(DRAWS)
    optima = optimal(SCENARIO, NAMES, draws)
    models = [compiled(row) for row in draws[:PEER_DRAWS]]
    peers = [peer_model(mdp) for mdp in models]
    for number, (mdp, peer) in enumerate(zip(models, peers, strict=True)):
        start = mdp.start[0][0]
        theirs = peer.solve(method="policy_iteration").v[start]
        assert abs(solve(mdp).start_value - optima.start[number]) < 1e-9
        assert abs(theirs - optima.start[number]) < 1e-4
    benchmark.pedantic(optimal, args=(SCENARIO, NAMES, draws), rounds=3)
    ours = fastest(lambda: optimal(SCENARIO, NAMES, draws)) / DRAWS
    methods = ("policy_iteration", "modified_policy_iteration", "value_iteration")
    theirs = {
        method: fastest(lambda m=method: [peer.solve(method=m) for peer in peers]) / PEER_DRAWS
        for method in methods
    }
    anew = fastest(lambda: [solve(compiled(row)) for row in draws[:PEER_DRAWS]]) / PEER_DRAWS
    best = min(theirs.values())
    figures = {
        f"seconds for {DRAWS:,} draws": ours * DRAWS,
        "microseconds a draw": 1e6 * ours,
        **{f"microseconds a draw, quantecon {m}": 1e6 * s for m, s in theirs.items()},
        "microseconds a draw, compile and solve": 1e6 * anew,
        "quantecon's best / ours": best / ours,
        "compile and solve / ours": anew / ours,
    }
    show(figures)
    assert ours * DRAWS < 2
    assert best > 50 * ours


def test_policies_a_second(benchmark: Any, show: Callable[..., None]) -> None:
    chosen = np.eye(4)[np.random.default_rng(1).integers(0, 4, size=(1536, 16))]
    figures = {}
    for readings in ({}, {"task_bonus": "no-subtask-skipped", "skip_timestep": "own"}):
        scenario = SCENARIO.with_(readings=readings)
        stages = optimal(scenario, (), np.empty((1, 0))).actions.shape[1:-1]
        policies = np.broadcast_to(chosen[:, None, None, None], (1536, *stages, 16, 4))

        def work(scenario: Scenario = scenario, policies: np.ndarray = policies) -> object:
            return policy_values(scenario, (), np.empty((1, 0)), policies)

        work()
        name = f"microseconds a policy, {readings or 'default readings'}"
        figures[name] = 1e6 * fastest(work, 5) / len(policies)
    benchmark.pedantic(work, rounds=3)
    show(figures)
    assert max(figures.values()) < 20


# ---- learning ------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def care() -> MDP:
    return SCENARIO.compile()


def rate_of(train: Callable[[], int], repeats: int) -> float:
    """Return the largest number of steps a second over some repeats."""
    rates = []
    for _ in range(repeats):
        started = thread_time()
        steps = train()
        rates.append(steps / (thread_time() - started))
    return max(rates)


def numpy_loop(mdp: MDP, episodes: int, seed: int) -> int:
    """The learner as one would write it with NumPy: arrays for the model, a loop for the steps."""
    draw, q = np.random.default_rng(seed), np.zeros((16, 4))
    key, table = rows_of(mdp).key, mdp.table
    chances, gains = table.probabilities(), table.gains()
    totals = np.cumsum(chances)
    totals -= np.repeat(
        totals[table.offsets[:-1]] - chances[table.offsets[:-1]], np.diff(table.offsets)
    )
    steps = 0
    for _ in range(episodes):
        state = mdp.start[0][0]
        while not mdp.terminal[state]:
            row = key[state]
            action = draw.integers(4) if draw.random() < EPSILON else np.argmax(q[row])
            pair = mdp.pair_offsets[state] + action
            first, last = table.offsets[pair], table.offsets[pair + 1]
            place = first + np.searchsorted(totals[first : last - 1], draw.random(), side="right")
            state = table.next[place]
            ahead = 0.0 if mdp.terminal[state] else np.max(q[key[state]])
            q[row, action] += RATE * (gains[place] + DISCOUNT * ahead - q[row, action])
            steps += 1
    return steps


def test_steps_a_second(care: MDP, benchmark: Any, show: Callable[..., None]) -> None:
    trainer = Trainer(QLearning(), care)
    trainer.run(0)
    run = benchmark.pedantic(trainer.run, args=(1,), rounds=15)
    ours = rate_of(lambda: trainer.run(1).steps, 15)
    plain = rate_of(lambda: numpy_loop(care, SLOW_EPISODES, 1), 3)
    figures = {
        "steps of one training": run.steps,
        "steps/s, compiled": ours,
        "steps/s, NumPy loop": plain,
        "compiled / NumPy loop": ours / plain,
        "seconds of one training": run.steps / ours,
    }
    show(figures)
    assert ours > 50 * plain


@pytest.mark.parametrize("jobs", [1, 2])
def test_seeds_a_second(care: MDP, benchmark: Any, jobs: int) -> None:
    QLearning(epochs=1).train(care, child(0, 0))
    runs = benchmark.pedantic(
        train, args=(care, QLearning(), 64), kwargs={"rng": 0, "n_jobs": jobs}, rounds=2
    )
    benchmark.extra_info["seeds/s"] = len(runs) / benchmark.stats.stats.min
