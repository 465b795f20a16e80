"""Draws solved a second: the batched engine, quantecon in a loop, and compiling each draw anew.

All solve the care model, default readings, at the same Beta draws of its probabilities, in one
process. quantecon is given ready arrays (its time to build a model from tables is not counted), the
compiled loops are warm. Values are compared before anything is timed.
"""

from collections.abc import Callable
from time import perf_counter

import numpy as np
import pytest

from exact_mdp.mdp import MDP, Scenario
from exact_mdp.solvers import solve
from exact_mdp.solvers.care import optimal, policy_values

pytestmark = pytest.mark.bench

SCENARIO = Scenario.load("yuan2025")
NAMES = [n for n in SCENARIO.names if not n.startswith("reward.") and 0 < SCENARIO[n] < 1]
DRAWS = 100_000
PEER_DRAWS = 20


def drawn(count: int) -> np.ndarray:
    mean = np.array([float(SCENARIO[name]) for name in NAMES])
    size = (count, len(NAMES))
    return np.random.default_rng(0).beta(50 * mean, 50 * (1 - mean), size=size)


def fastest(work: Callable[[], object], repeats: int = 3) -> float:
    seconds = []
    for _ in range(repeats):
        started = perf_counter()
        work()
        seconds.append(perf_counter() - started)
    return min(seconds)


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


def test_draws_a_second(benchmark, capsys: pytest.CaptureFixture[str]) -> None:
    draws = drawn(DRAWS)
    found = optimal(SCENARIO, NAMES, draws)
    models = [compiled(row) for row in draws[:PEER_DRAWS]]
    peers = [peer_model(mdp) for mdp in models]
    for number, (mdp, peer) in enumerate(zip(models, peers, strict=True)):
        start = mdp.start[0][0]
        theirs = peer.solve(method="policy_iteration").v[start]
        assert abs(solve(mdp).start_value - found.start[number]) < 1e-9
        assert abs(theirs - found.start[number]) < 1e-4
    benchmark.pedantic(optimal, args=(SCENARIO, NAMES, draws), rounds=3)
    ours = fastest(lambda: optimal(SCENARIO, NAMES, draws)) / DRAWS
    alone = fastest(lambda: optimal(SCENARIO, NAMES, draws, threads=1)) / DRAWS
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
        "microseconds a draw, one thread": 1e6 * alone,
        **{f"microseconds a draw, quantecon {m}": 1e6 * s for m, s in theirs.items()},
        "microseconds a draw, compile and solve": 1e6 * anew,
        "quantecon's best / ours": best / ours,
        "compile and solve / ours": anew / ours,
    }
    benchmark.extra_info.update(figures)
    with capsys.disabled():
        print()
        for name, value in figures.items():
            print(f"  {name:<60}{value:>14,.4g}")
    assert ours * DRAWS < 2
    assert best > 50 * ours


def test_policies_a_second(benchmark, capsys: pytest.CaptureFixture[str]) -> None:
    policies = np.random.default_rng(1).integers(0, 4, size=(1536, 16))
    figures = {}
    for readings in ({}, {"task_bonus": "no-subtask-skipped", "skip_timestep": "own"}):
        scenario = SCENARIO.with_(readings=readings)

        def work(scenario: Scenario = scenario) -> object:
            return policy_values(scenario, (), None, policies, second_moment=True, threads=1)

        work()
        figures[str(readings or "default readings")] = 1e6 * fastest(work, 5) / len(policies)
    benchmark.pedantic(work, rounds=3)
    benchmark.extra_info.update(figures)
    with capsys.disabled():
        print("\n  microseconds for mean and variance of a policy, one thread")
        for name, value in figures.items():
            print(f"  {name:<70}{value:>8.3g}")
    assert max(figures.values()) < 20
