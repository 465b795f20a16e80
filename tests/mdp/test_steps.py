"""Models of steps with rows of their own are worth what the recursion over time says."""

from fractions import Fraction as F

import numpy as np
import pytest
from small_models import small_model

from exact_mdp import MDP, ModelError, Scenario, certify, cost_effectiveness, evaluate


def change_rewards(mdp: MDP, seed: int) -> MDP:
    """The same states and pairs, with other rows and rewards."""
    rng = np.random.default_rng(seed)
    rows = []
    for state in range(mdp.n_states):
        for pair in mdp.pairs_of(state):
            weights = rng.integers(1, 9, size=2)
            rows.append((state, int(mdp.pair_action[pair]), [
                (F(int(w), int(weights.sum())), int(rng.integers(mdp.n_states)),
                 F(int(rng.integers(-9, 9)), int(rng.integers(1, 5)))) for w in weights
            ]))  # fmt: skip
    return MDP.from_outcomes(rows, mdp.discount_exact, start=mdp.start, actions=mdp.actions)


def earn_and_go_on(mdp: MDP, pair: int, value: list[F]) -> F:
    """What a pair is worth if states are worth `value` at the next time."""
    return sum((p * (r + mdp.discount_exact * value[to]) for p, to, r in mdp.table.row(pair)), F(0))


def recursion(models: list[MDP], last: list[F]) -> list[F]:
    """The optimal values at time 0, state by state."""
    value = last
    for mdp in reversed(models):
        value = [
            max(earn_and_go_on(mdp, pair, value) for pair in mdp.pairs_of(state))
            for state in range(mdp.n_states)
        ]
    return value


@pytest.mark.parametrize("seed", range(10))
def test_steps_are_worth_what_the_recursion_says(seed: int) -> None:
    first = small_model(seed, F(9, 10), ends=1)
    models = [first, *(change_rewards(first, 100 * seed + k) for k in range(3))]
    found = certify(MDP.from_steps(models)).value[: first.n_states].tolist()
    assert found == recursion(models, [F(0)] * first.n_states)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("floats", [False, True])
def test_equal_steps_are_a_horizon(seed: int, floats: bool) -> None:
    mdp = small_model(seed, "19/20", labels={"even": np.arange(7) % 2 == 0})
    if floats:
        P = np.random.default_rng(seed).dirichlet(np.ones(4), size=(3, 4))
        mdp = MDP.from_arrays(P, np.arange(12.0).reshape(4, 3) / 7, 0.95, labels={"even": {0, 2}})
    steps, within = MDP.from_steps([mdp] * 4), mdp.within(4)
    assert steps.space.names == within.space.names
    assert steps == within
    for question in (lambda m: m.reaching("even"), lambda m: m.until("even")):
        assert certify(question(steps)).start.value == certify(question(within)).start.value


def test_components_are_kept() -> None:
    P, parts = [[[F(1, 2), F(1, 2)], [0, 1]]], {"qaly": [[1], [0]], "cost": [[F(5, 2)], [0]]}
    well = MDP.from_arrays(P, [1, 0], "1/2", components=parts)
    later = well.with_(components={"qaly": [1, 0], "cost": [F(1, 2), 0]})
    both = MDP.from_steps([well, later])
    assert both.component_names == ("qaly", "cost", "rest")
    found = cost_effectiveness(both, {"stay": "always:0"})
    # 1 + 1/2 · 1/2, and 5/2 + 1/2 · 1/2 · 1/2.
    assert found.effect.tolist() == [[1.25]]
    assert found.cost.tolist() == [[2.625]]
    assert evaluate(both, np.zeros((2, 2), int)).start_value == 1 + 0.25


def test_events_are_kept() -> None:
    first = Scenario.load("yuan2025").with_(tasks=[1])
    years = [first.compile(), first.with_(parameters={"base.anger": "1/10"}).compile()]
    both, counts = MDP.from_steps(years), [year.table.event.sum() for year in years]
    assert both.events == years[0].events
    assert both.table.event.sum() == sum(counts)
    assert counts[0] > 0


MODEL = small_model(0)


@pytest.mark.parametrize(
    ("models", "said"),
    [
        ([], "there is no model"),
        ([MODEL, small_model(0).with_(discount="1/2")], "in its discount"),
        ([MODEL, small_model(0).with_(sense="min")], "in its sense"),
        ([small_model(0), small_model(0, labels={"x": {0}})], "in its labels"),
        ([small_model(0), small_model(0, states=4)], "in its states"),
        ([MODEL, 3], "int is not an MDP"),
        ([MODEL.within(2)], "answers a question already"),
        ([MODEL.with_(labels={"x": {0}}).reaching("x")], "answers a question already"),
    ],
)  # fmt: skip
def test_other_steps_are_refused(models: list[MDP], said: str) -> None:
    with pytest.raises(ModelError, match=said):
        MDP.from_steps(models)


def test_a_start_without_a_time_is_one_at_the_first_time() -> None:
    """Names of the states are enough; what may be a state, or a time and a state, is refused."""
    wards = MDP.from_outcomes(
        [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, 2)])], states=["well", "ill"]
    ).within(3)
    for start in ("ill", {"ill": 1}, "time 0, state ill", (0, "ill"), 1):
        assert wards.with_(start=start).start == ((1, 1),)
    mixed = {"well": "1/3", "ill": "2/3"}
    assert dict(wards.with_(start=mixed).start) == {0: F(1, 3), 1: F(2, 3)}
    assert wards.with_(start="time 1, state well").start == ((2, 1),)

    def ring(width: int) -> MDP:
        def step(place: tuple[int, int], _: int) -> list[tuple[int, tuple[int, int], int]]:
            return [(1, ((place[0] + 1) % 3, width), 0)]

        return MDP.from_function((0, width), lambda place: [0], step).within(2)

    assert ring(7).with_(start=(2, 7)).start == ring(7).with_(start=(0, (2, 7))).start == ((2, 1),)
    with pytest.raises(ModelError, match="may be 'time 1, state") as refused:
        ring(1).with_(start=(1, 1))
    for name in ("time 1, state (1, 1)", "time 0, state (1, 1)"):
        assert name in str(refused.value)
        assert ring(1).with_(start=name).start[0][0] < 6
