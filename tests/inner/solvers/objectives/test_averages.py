"""Averages of several amounts beside proven averages of every deterministic policy."""

from fractions import Fraction as F
from itertools import product
from pathlib import Path
from random import Random
from typing import Any

import pytest
from average_models import average_of
from cli_runner import run
from objective_models import vertices

from exact_mdp import (
    MDP,
    ConstrainedSolution,
    ModelError,
    certify,
    evaluate,
    rationalize,
    solve,
    tradeoff,
)
from exact_mdp.solvers.objectives.averages import reduce_to_totals

PARTS = ("a", "b")


def random_model(rng: Random, sense: str = "max") -> MDP:
    """Return a model of four states, every pair of which may lead to state 1 or to its own state.

    State 3 may be one that no policy reaches.
    """
    rows = []
    for state in range(4):
        for action in range(rng.choice((1, 2, 2))):
            ends = sorted({1, *rng.sample(range(rng.choice((3, 4))), 2)})
            weights = [F(rng.randint(1, 3)) for _ in ends]
            amounts = {name: F(rng.randint(-2, 3)) for name in PARTS}
            outcomes = [
                (w / sum(weights), to, amounts) for w, to in zip(weights, ends, strict=True)
            ]
            rows.append((state, action, outcomes))
    start = [F(1, 2), F(0), F(1, 2), F(0)]
    return MDP.from_outcomes(rows, "9/10", start=start, sense=sense)


def averages(mdp: MDP, choice: Any) -> tuple[F, ...]:
    """Return the proven average of each component under action numbers (S,)."""
    found = []
    for name in PARTS:
        top, bottom = mdp.component(name)
        rows = []
        for state, action in enumerate(choice):
            pair = mdp.pairs_of(state)[action]
            amount = F(int(top[pair]), int(bottom[pair]))
            rows.append((state, 0, [(p, to, amount) for p, to, _ in mdp.table.row(pair)]))
        start = {f"state {state}": weight for state, weight in mdp.start}
        found.append(average_of(MDP.from_outcomes(rows, start=start, sense=mdp.sense)))
    return tuple(found)


def every_average(mdp: MDP) -> dict[tuple[int, ...], tuple[F, ...]]:
    counts = [range(len(mdp.pairs_of(state))) for state in range(mdp.n_states)]
    return {choice: averages(mdp, choice) for choice in product(*counts)}


@pytest.mark.parametrize("sense", ["max", "min"])
def test_a_front_is_the_hull_of_all_policies(sense: str) -> None:
    sign = 1 if sense == "max" else -1
    for seed in range(8):
        mdp = random_model(Random(f"{sense} {seed}"), sense)
        front, every = tradeoff(mdp, PARTS, criterion="average"), every_average(mdp)
        best = vertices([*every.values()], sign)
        assert front.vertices == sorted(best)
        assert front.violations() == []
        for choice, wanted in every.items():
            assert front.totals(choice) == wanted
        for vertex, actions in zip(front.vertices, front.policies, strict=True):
            assert averages(mdp, actions[:-1]) == vertex
        # A policy that mixes its actions, by its shares of time in floats.
        found = evaluate(mdp, "random", criterion="average").components
        mixed = dict(zip(PARTS, front.totals("random"), strict=True))
        for name in PARTS:
            assert abs(F(found[name].value) - mixed[name]) <= F(found[name].error)


@pytest.mark.parametrize("sense", ["max", "min"])
def test_limits_on_averages(sense: str) -> None:
    """The best average under a limit lies on the front of the reward and the limited amount."""
    sign, feasible = (1 if sense == "max" else -1), 0
    for seed in range(10):
        mdp = random_model(Random(f"limits {sense} {seed}"), sense)
        found = solve(mdp, subject_to={"x=2*a": "<= 1/2"}, criterion="average")
        assert isinstance(found, ConstrainedSolution)
        assert found.violations() == []
        every = [(a + b, 2 * a) for a, b in every_average(mdp).values()]
        best = []
        for (one, low), (other, high) in product(every, repeat=2):
            if low <= F(1, 2):
                best.append(one)
            if low < F(1, 2) < high:
                share = (F(1, 2) - low) / (high - low)
                best.append(one + share * (other - one))
        assert found.feasible == bool(best)
        if not best:
            continue
        feasible += 1
        assert found.start_value == sign * max(sign * x for x in best)
        # The policy has these averages in the model itself.
        weights = found.rule[mdp.pair_state, mdp.pair_action].astype(float)
        own = evaluate(mdp, weights, criterion="average")
        assert own.mean == pytest.approx(float(found.start_value))
        assert 2 * own.components["a"].value <= 0.5 + 1e-9
    assert feasible > 4


def test_the_command_line_limits_averages_and_their_proofs_have_no_file(tmp_path: Path) -> None:
    mdp = random_model(Random("limits max 1"), "max")
    mdp.save(model := tmp_path / "model.npz")
    limit, proof = ("--criterion", "average", "--subject-to", "2*a <= 1/2"), tmp_path / "proof.json"
    found = solve(mdp, subject_to={"2*a": "<= 1/2"}, criterion="average")
    answer = run("solve", model, *limit, "--json").result
    assert answer["exact_start_value"] == str(found.start_value)
    assert answer["criterion"] == "average"
    with pytest.raises(ModelError, match="does not know averages"):
        found.save(proof)
    refused = run("solve", model, *limit, "--certificate", proof)
    assert (refused.status, proof.exists()) == (2, False)


@pytest.mark.parametrize("sense", ["max", "min"])
def test_weights_that_make_a_policy_best(sense: str) -> None:
    sign = 1 if sense == "max" else -1
    for seed in range(6):
        rng = Random(f"weights {sense} {seed}")
        mdp = random_model(rng, sense)
        every = every_average(mdp)
        choice = rng.choice([*every])
        found = rationalize(mdp, choice, criterion="average")
        assert found.violations() == []

        def loses(weights: Any, every: Any = every, choice: Any = choice) -> F:
            worth = {c: sign * sum(map(F.__mul__, weights, own)) for c, own in every.items()}
            return max(worth.values()) - worth[choice]

        weights = [found.weights[name] for name in PARTS]
        assert loses(weights) == 0
        assert max(abs(w - 1) for w in weights) == found.change
        less = found.change * F(99, 100)
        for steps in product((-1, F(1, 2), 1), repeat=2):
            assert not less or loses([1 + step * less for step in steps]) > 0
        assert rationalize(mdp, "optimal", criterion="average").change == 0


def test_the_model_of_totals() -> None:
    """From state 0 a step leads to 1 with chance 1/2; state 1 leads back, and earns 4."""
    rows = [(0, 0, [("1/2", 0, 0), ("1/2", 1, 0)]), (1, 0, [(1, 0, 4)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    total, names = reduce_to_totals(mdp, ["reward", "steps", "x=1/2*reward"])
    assert names == ("reward", "steps", "x")
    assert total.discount == 1
    assert total.ends.every_policy_ends
    assert total.space.extra == ("stopped",)
    assert certify(total).start_value == certify(mdp, criterion="average").start_value == F(4, 3)
    assert certify(total.with_(components=None)).start_value == F(4, 3)
    front = tradeoff(mdp, ["reward", "steps"], criterion="average")
    assert front.vertices == [(F(4, 3), 1)]
    assert front.totals("random") == (F(4, 3), 1)


def test_what_no_state_holds_together_is_refused() -> None:
    """A policy may stay in either state."""
    rows = [(s, a, [(1, to, {"a": s, "b": -s})]) for s in (0, 1) for a, to in enumerate((0, 1))]
    mdp = MDP.from_outcomes(rows)
    for ask in (
        lambda: tradeoff(mdp, PARTS, criterion="average"),
        lambda: rationalize(mdp, [0, 0], criterion="average"),
        lambda: solve(mdp, subject_to={"a": "<= 1"}, criterion="average"),
    ):
        with pytest.raises(ModelError, match="no state is visited again and again by every policy"):
            ask()
    for ask in (
        lambda: tradeoff(mdp.within(2), PARTS, criterion="average"),
        lambda: rationalize(mdp.within(2), "random", criterion="average"),
        lambda: solve(mdp.within(2), subject_to={"a": "<= 1"}, criterion="average"),
    ):
        with pytest.raises(ModelError, match="has no horizon"):
            ask()
