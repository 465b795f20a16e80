"""Sampled episodes, beside a loop that draws them one by one from the same uniform numbers."""

from fractions import Fraction as F
from math import inf, isfinite, isnan, log, sqrt
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_models import given, random_policy, small_model, with_events

from exact_mdp import MDP, ModelError, simulate
from exact_mdp.mdp.report import format_interval, format_number
from exact_mdp.solvers.values import simulate as module
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.simulate import Simulation


class Uniform(np.random.Generator):
    """Hands out numbers in the order of steps, and keeps them."""

    def __init__(self, seed: int) -> None:
        super().__init__(np.random.PCG64(seed))
        self.kept = list[Any]()

    def random(self, size: Any = None, *_: Any, **__: Any) -> Any:
        numbers = super().random(size)
        self.kept.append(numbers)
        return numbers


def looped(mdp: MDP, chain: PolicyChain, kept: list[Any], n: int, limit: int | None) -> Any:
    """Each episode by itself: the first outcome whose cumulative chance exceeds the number."""
    draws = [each.tolist() for each in kept]
    begins = [s for s, p in sorted(mdp.start) if p]
    chance = dict(mdp.start)
    state = [begins[0]] * n
    if len(begins) > 1:
        for k, u in enumerate(draws.pop(0)):
            ahead = F(0)
            for s in begins:
                ahead += chance[s]
                if u < ahead:
                    state[k] = s
                    break
    total, steps, bits = [0.0] * n, [0] * n, [0] * n
    factor, step = 1.0, 0
    while any(not mdp.terminal[s] for s in state) and (limit is None or step < limit):
        running = [k for k in range(n) if not mdp.terminal[state[k]]]
        for k, u in zip(running, draws.pop(0), strict=True):
            places = np.flatnonzero(chain.source == state[k])
            ahead = np.cumsum(chain.probability[places]) / chain.probability[places].sum()
            place = places[int((ahead <= u).sum())]
            total[k] += factor * float(chain.gain[place])
            steps[k] += 1
            if chain.table.event is not None:
                bits[k] |= int(chain.table.event[place])
            state[k] = int(chain.table.next[place])
        factor, step = factor * mdp.discount, step + 1
    assert not draws
    return total, steps, bits, state


@pytest.mark.parametrize("discount", [F(1, 2), F(1)])
def test_episodes_are_those_of_a_loop(discount: F) -> None:
    for seed in range(6):
        kind: Any = {"start": seed % 5} if seed % 2 else {}
        mdp = with_events(small_model(seed, discount, **kind), seed)
        if mdp.terminal[[s for s, _ in mdp.start]].all():
            continue
        chances = random_policy(mdp, seed, pure=seed == 3)
        rng, n = Uniform(seed), 30
        sample = simulate(mdp, given(chances), n, rng)
        limit = 40 if discount < 1 else None  # 2⁻⁴⁰ < 10⁻¹² < 2⁻³⁹
        chain = PolicyChain.of(mdp, given(chances))
        total, steps, bits, state = looped(mdp, chain, rng.kept, n, limit)
        assert sample.returns == pytest.approx(total, rel=1e-14, abs=1e-14)
        assert sample.steps.tolist() == steps
        assert sample.steps.dtype == np.int64
        for bit, name in enumerate(("first", "second")):
            assert sample.events[name] == sum(each >> bit & 1 for each in bits) / n
        running = sum(not mdp.terminal[s] for s in state)
        assert (sample.truncated, sample.endless, sample.episodes) == (running, 0, n)
        assert sample.mean == pytest.approx(np.mean(total))
        assert sample.sd == pytest.approx(np.std(total, ddof=1))
        assert sample.standard_error == pytest.approx(np.std(total, ddof=1) / sqrt(n))
        assert sample.mean_steps == np.mean(steps)


def test_the_same_seed_gives_the_same_episodes() -> None:
    mdp = small_model(2)
    one, other = (simulate(mdp, "random", 50, rng=7) for _ in range(2))
    assert one.returns.tolist() == other.returns.tolist()
    assert one.returns.tolist() != simulate(mdp, "random", 50, rng=8).returns.tolist()
    generator = np.random.default_rng(7)
    assert simulate(mdp, "random", 50, generator).returns.tolist() == one.returns.tolist()
    with pytest.raises(ModelError):
        simulate(mdp, "random", 0, rng=7)


STAYS: Any = [(0, 0, [(1, 0, F(-3, 4))])]  # for ever


def test_what_follows_a_cut_is_in_the_error() -> None:
    """γ^t max|r| / (1 - γ), of which the exact return is no further away."""
    for rate in (F(1, 2), F(9, 10), F(99, 100)):
        sample = simulate(MDP.from_outcomes(STAYS, rate), [0], 2, rng=0)
        steps = int(sample.steps[0])
        assert rate**steps <= F(1, 10**12) * F(1000001, 1000000)
        assert rate ** (steps - 2) > F(1, 10**12)
        error = F(3, 4) * rate**steps / (1 - rate)
        assert error <= F(sample.truncation_error) <= error * F(100001, 100000)
        exact = F(-3, 4) / (1 - rate)
        assert abs(F(float(sample.returns[0])) - exact) <= F(sample.truncation_error) + F(1, 10**12)
        assert sample.truncated == 2
    none = simulate(MDP.from_outcomes(STAYS, 0), [0], 3, rng=0)
    assert none.steps.tolist() == [1, 1, 1]
    assert 0 <= none.truncation_error <= 1e-290


def test_rewards_that_no_episode_comes_to_are_not_in_the_error() -> None:
    rows: Any = [(0, 0, [(1, 0, 100)]), (1, 0, [(1, 1, 1)]), (2, 0, [(1, 2, -7)])]
    sample = simulate(MDP.from_outcomes(rows, "1/2", start=1), "random", 1, rng=0)
    steps = int(sample.steps[0])
    assert sample.truncation_error == pytest.approx(2.0 ** (1 - steps), rel=1e-5)


def test_starts_are_drawn_by_their_chances() -> None:
    """Of chances whose floats sum to less than 1, a number between is that of the last start."""

    class Last(np.random.Generator):
        def random(self, size: Any = None, *_: Any, **__: Any) -> Any:
            return np.full(size, np.nextafter(1.0, 0.0))

    rows: Any = [(s, 0, [(1, 10, s)]) for s in range(10)] + [(10, 0, [(1, 10, 0)])]
    mdp = MDP.from_outcomes(rows, start=dict.fromkeys(range(10), F(1, 10)))
    generator = Last(np.random.PCG64(0))
    assert simulate(mdp, "random", 2, generator).returns.tolist() == [9, 9]

    class Edge(Last):
        def random(self, size: Any = None, *_: Any, **__: Any) -> Any:
            return np.full(size, 0.5)

    class First(Last):
        def random(self, size: Any = None, *_: Any, **__: Any) -> Any:
            return np.zeros(size)

    # 0 is that of a state's first outcome, and not of the last outcome of the state before.
    rows = [(s, 0, [(F(1, 2), 4, 2 * s), (F(1, 2), 3, 2 * s + 1)]) for s in range(3)]
    few = MDP.from_outcomes([*rows, *((s, 0, [(1, s, 0)]) for s in (3, 4))], start=1)
    assert simulate(few, "random", 1, First(np.random.PCG64(0))).returns.tolist() == [
        float(few.table.row(1)[0][2])
    ]
    half = mdp.with_(start={2: "1/2", 7: "1/2"})
    assert simulate(half, "random", 1, Edge(np.random.PCG64(0))).returns.tolist() == [7]


def test_without_a_step_a_run_is_where_it_begins() -> None:
    rows = [(0, 0, [(1, 1, 4)]), (1, 0, [(1, 0, 1)])]
    mdp = MDP.from_outcomes(rows, "1/2", labels={"there": [1]}, start={0: "1/4", 1: "3/4"})
    sample = simulate(mdp.reaching("there"), [0, 0], 400, rng=0, horizon=0)
    assert {*sample.returns.tolist()} == {0, 1}
    assert abs(sample.mean - 3 / 4) < 5 * (3 / 16 / 400) ** 0.5
    still = simulate(mdp, [0, 0], 5, rng=0, horizon=0)
    assert (still.returns.tolist(), still.steps.tolist(), still.truncated) == ([0] * 5, [0] * 5, 5)


def test_a_horizon_is_no_error() -> None:
    rows: Any = [(0, 0, [(F(1, 2), 1, 1), (F(1, 2), 0, 2)]), (1, 0, [(1, 1, 0)])]
    for discount in (1, "1/2"):
        sample = simulate(MDP.from_outcomes(rows, discount), [0, 0], 200, rng=0, horizon=2)
        assert sample.truncation_error == 0
        rate = float(F(discount))
        assert {*sample.returns.tolist()} == {1, 2 + rate, 2 + 2 * rate}
        assert sample.truncated == int((sample.returns == 2 + 2 * rate).sum()) > 20
        assert sample.steps.tolist() == [1 if x == 1 else 2 for x in sample.returns]
    both: Any = [*rows, (2, 0, [(1, 2, 0)])]
    begun = MDP.from_outcomes(both, start={0: "1/2", 2: "1/2"})
    assert 20 < simulate(begun, [0, 0, 0], 400, rng=1, horizon=2).truncated < 90


def test_runs_for_ever_have_infinite_returns() -> None:
    rows: Any = [
        (0, 0, [(F(1, 3), s, s) for s in (1, 2, 3)]),
        (1, 0, [(1, 1, 1)]),
        (2, 0, [(1, 2, 0)]),
        (3, 0, [(1, 3, -1)]),
        (4, 0, [(1, 5, 0)]),
        (5, 0, [(1, 4, 0)]),  # at rest
    ]
    mdp = MDP.from_outcomes(rows)
    sample = simulate(mdp, "random", 90, rng=0)
    counts = [int((sample.returns == x).sum()) for x in (inf, 2, -inf)]
    assert sum(counts) == 90
    assert min(counts) > 15
    assert sample.endless == counts[0] + counts[2]
    assert sample.never_ends == sample.endless / 90
    assert isnan(sample.mean)
    assert isnan(sample.sd)
    assert sample.mean_steps == inf
    rest = simulate(mdp.with_(start=4), "random", 5, rng=0)
    assert (rest.endless, rest.never_ends, rest.mean, rest.mean_steps) == (5, 0, 0, inf)
    assert simulate(mdp.with_(start=1), "random", 5, rng=0).mean == inf


def test_long_episodes_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    rate = F(99, 100)
    needed = int(np.ceil(log(1e-12) / log(0.99)))
    mdp = MDP.from_outcomes(STAYS, rate)
    monkeypatch.setattr(module, "MOST_STEPS", needed)
    assert simulate(mdp, [0], 1, rng=0).steps.tolist() == [needed]
    monkeypatch.setattr(module, "MOST_STEPS", needed - 1)
    with pytest.raises(ModelError, match=f"first {needed:,} steps count"):
        simulate(mdp, [0], 1, rng=0)
    assert simulate(mdp, [0], 1, rng=0, horizon=5).steps.tolist() == [5]
    ending = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])], rate)
    assert simulate(ending, [0, 0], 1, rng=0).returns.tolist() == [1]


def test_returns_beyond_floats_are_refused() -> None:
    big = 2**1023
    rows: Any = [(0, 0, [(1, 1, big)]), (1, 0, [(1, 2, big)]), (2, 0, [(1, 2, 0)])]
    with pytest.raises(ModelError, match="beyond the range of floats"):
        simulate(MDP.from_outcomes(rows), "random", 2, rng=0)
    huge = Simulation(
        returns=np.full(3, 2.0**1023),
        steps=np.ones(3, dtype=np.int64),
        events={},
        truncated=0,
        truncation_error=0.0,
    )
    assert huge.mean == inf


def sampled(returns: list[float], **parts: Any) -> Simulation:
    known: dict[str, Any] = {"events": {}, "truncated": 0, "truncation_error": 0.0}
    steps = np.arange(1, len(returns) + 1)
    return Simulation(returns=np.array(returns), steps=steps, **(known | parts))


def test_an_estimate_keeps_what_was_cut_off() -> None:
    sample = sampled([1.0, 2.0, 6.0], truncation_error=0.5, truncated=1)
    assert sample.value.value == 3
    assert sample.value.standard_error == pytest.approx(sqrt(7 / 3))
    assert sample.value.cut_off == 0.5
    assert sample.endless == 0
    assert sampled([1.0, 3.0]).sd == pytest.approx(sqrt(2))
    assert sampled([2.0**1023] * 2 + [-(2.0**1023)] * 2).sd == inf
    assert not isfinite(sampled([2.0**1023] * 4 + [-(2.0**1023)] * 4).sd)  # inf - inf on the way


def test_a_report_shows_what_is_not_0() -> None:
    sample = sampled([1.0, 2.0, 6.0], truncation_error=0.5, truncated=1)
    for own, endless in ((sample, False), (sampled([1.0, inf], endless=1), True)):
        facts = own.report().facts
        for name in ("mean", "standard_error", "interval", "sd", "never_ends", "truncated"):
            wanted = own.value.interval if name == "interval" else getattr(own, name)
            assert np.array_equal(facts[name].value, wanted, equal_nan=True)
        assert facts["truncation_error"].value == own.truncation_error
        assert facts["steps"].value == own.mean_steps
        assert facts["never_ends"].text == (own.never_ends or None)
        assert facts["truncated"].text == (own.truncated or None)
        assert facts["truncation_error"].text == (own.truncation_error or None)
        assert ("never end" in str(facts["steps"].text)) == endless
    for own in (sample, sampled([1.0, 2.0, 4.6])):
        low, high = own.value.interval
        digits = own.standard_error / 10
        facts = own.report().facts
        assert facts["interval"].text == f"{format_interval(low, high, digits)} (95 %)"
        assert facts["sd"].text == format_number(own.sd, digits)


def test_one_episode_has_no_spread() -> None:
    sample = simulate(small_model(0), "random", 1, rng=0)
    assert sample.sd == sample.standard_error == inf
    facts = sample.report().facts
    assert facts["episodes"] == 1
    frame = simulate(small_model(0), "random", 4, rng=0).frame()
    assert [*frame.columns] == ["return", "steps"]


def test_a_table_is_read_as_it_is_said() -> None:
    rows: Any = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])]
    mdp, table = MDP.from_outcomes(rows), np.array([[0.25, 0.75], [1, 0]])
    assert {*simulate(mdp, table, 30, rng=0, kind="q").returns.tolist()} == {2}
    assert {*simulate(mdp, table, 30, rng=0, kind="policy").returns.tolist()} == {1, 2}


def test_a_bar_is_shown_at_a_terminal_and_only_if_it_takes_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown = list[dict[str, Any]]()

    class Bar:
        def __init__(self, **how: Any) -> None:
            shown.append(how)

        def __enter__(self) -> "Bar":
            return self

        def __exit__(self, *_: object) -> None:
            pass

        def update(self) -> None:
            shown.append({})

    monkeypatch.setattr(module, "tqdm", SimpleNamespace(tqdm=Bar))
    steps = int(simulate(small_model(0), "random", 1, rng=0).steps[0])
    how = {"desc": "simulating", "unit": "step", "delay": 2, "disable": None}
    assert shown == [how, *[{}] * steps]
