"""What states are worth at a horizon, against backward induction in Fractions."""

from __future__ import annotations

import random
from fractions import Fraction as F
from typing import Any

import pytest

from exact_mdp import MDP, SOLVERS, ModelError, certify, evaluate, solve

Rows = list[tuple[int, int, list[tuple[F, int, Any]]]]


def drawn(rng: random.Random, states: int, *, floats: bool = False, joint: bool = True) -> Rows:
    """Return rows of a model with an absorbing last state, which earns nothing."""
    rows: Rows = []
    for state in range(states - 1):
        for action in range(rng.randint(1, 3)):
            parts = [rng.randint(0, 3) for _ in range(states)]
            parts[rng.randrange(states)] += 1
            base: Any = F(rng.randint(-9, 9), rng.randint(1, 7))
            base = float(base) if floats else base
            rows.append(
                (
                    state,
                    action,
                    [(F(p, sum(parts)), t, base + joint * t) for t, p in enumerate(parts) if p],
                )
            )
    return [*rows, (states - 1, 0, [(F(1), states - 1, 0)])]


def induction(rows: Rows, discount: F, end: list[F], steps: int, best: Any = max) -> list[list[F]]:
    """Return V_0 … V_N of textbook backward induction."""
    values = [end]
    for _ in range(steps):
        after, q = values[0], {}
        for state, _, outcomes in rows:
            own = sum((p * (F(r) + discount * after[t]) for p, t, r in outcomes), F(0))
            q.setdefault(state, []).append(own)
        values.insert(0, [best(own) for _, own in sorted(q.items())])
    return values


@pytest.mark.parametrize("seed", range(12))
def test_a_terminal_value_is_that_of_backward_induction(seed: int) -> None:
    """Fractions and floats, rewards of pairs and of outcomes, costs, a value where all is over."""
    rng = random.Random(seed)
    states, steps = rng.randint(2, 4), rng.randint(1, 4)
    discount = rng.choice([F(1), F(9, 10), F(0)])
    sense, best = rng.choice([("max", max), ("min", min)])
    rows = drawn(rng, states, floats=seed % 3 == 0, joint=seed % 2 == 0)
    end: list[Any] = [F(rng.randint(-9, 9), rng.randint(1, 5)) for _ in range(states)]
    if seed % 4 == 0:
        end = [float(value) for value in end]
    mdp = MDP.from_outcomes(rows, discount, sense=sense, start=[F(1, states)] * states)
    wanted = induction(rows, discount, [F(v) for v in end], steps, best)
    unrolled = mdp.within(steps, terminal_value=end)
    proof = certify(unrolled)
    assert proof.violations() == []
    for time in range(steps):
        assert [proof.value[time * states + s] for s in range(states)] == wanted[time]
    assert proof.start_value == sum(wanted[0]) / states
    found = solve(mdp, horizon=steps, terminal_value=dict(enumerate(end)))
    assert abs(found.start_value - float(proof.start_value)) <= found.start.error + 1e-14
    assert evaluate(unrolled, proof).mean == pytest.approx(found.start_value, abs=1e-12)


def test_every_method_reads_it() -> None:
    rows = drawn(random.Random(0), 3)
    mdp, end = MDP.from_outcomes(rows, "9/10"), [F(50), F(1, 3), F(0)]
    wanted = induction(rows, F(9, 10), end, 3)[0][0]
    for method in SOLVERS:
        found = solve(mdp, method, horizon=3, terminal_value=end)
        assert abs(found.start_value - float(wanted)) <= found.start.error + 1e-14, method


def test_it_is_earned_with_the_last_step_and_is_a_component() -> None:
    """Steps stay N, returns hold it, limits and parts of the reward count it apart."""
    rows = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, components={"effort": [1, 0]}).within(1, terminal_value={1: 4})
    found = evaluate(mdp, "random")
    assert found.components == {"effort": 1.0, "terminal value": 2.0}
    assert (found.mean, found.steps) == (3.0, 1.0)
    quantiles = found.quantiles
    assert quantiles is not None
    assert (quantiles[0.05], quantiles[0.95]) == (1, 5)
    assert solve(mdp, subject_to={"terminal value": ">= 2"}).start_value == 3


def test_without_one_nothing_changes() -> None:
    mdp = MDP.from_outcomes(drawn(random.Random(1), 3), "9/10")
    plain, zero = mdp.within(3), mdp.within(3, terminal_value=[0, 0, 0])
    assert certify(plain).value.tolist() == certify(zero).value.tolist()
    assert plain.terminal.tolist() == zero.terminal.tolist()


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"horizon": 3, "start": [1, 2, 3]}, "terminal_value"),
        ({"terminal_value": [1, 2, 3]}, "give a horizon"),
        ({"horizon": 3, "terminal_value": 5}, "for each state"),
        ({"horizon": 3, "terminal_value": [1, 2]}, "2 entries for 3 states"),
        ({"horizon": 3, "terminal_value": [1, 2, float("nan")]}, "finite"),
        ({"horizon": 3, "terminal_value": {"nowhere": 1}}, "nowhere"),
    ],
)
def test_what_cannot_be_meant_is_refused(given: dict[str, Any], words: str) -> None:
    mdp = MDP.from_outcomes(drawn(random.Random(2), 3), "9/10")
    with pytest.raises(ModelError, match=words):
        solve(mdp, **given)
