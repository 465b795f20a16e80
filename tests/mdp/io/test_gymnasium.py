"""Models from Gymnasium, against value iteration on the environment's own table."""

import random
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
import pytest
from cli_runner import run
from gymnasium import wrappers
from gymnasium.envs.toy_text import FrozenLakeEnv
from hypothesis import given
from hypothesis import strategies as st
from oracle import by_table
from refusal_tables import refused, table_of_refusals

from exact_mdp import MDP, Policy, ShapeError, certify, evaluate, fingerprint, load, solve

# Gymnasium 1.3 numbers it anew.
NUMBER = max(each.version or 0 for each in gymnasium.registry.values() if each.name == "Taxi")
TAXI = f"Taxi-v{NUMBER}"
IDS = ("FrozenLake-v1", "FrozenLake8x8-v1", "CliffWalking-v1", "CliffWalkingSlippery-v1", TAXI)
OWN_MAP = ["SFH", "FHG", "FFF"]
Table = Mapping[int, Mapping[int, list[tuple[float, int, float, bool]]]]


@pytest.mark.parametrize("name", [*IDS, "a map of one's own"])
def test_values_and_policies_are_those_of_the_environments_table(name: str) -> None:
    env = gymnasium.make(name) if name in IDS else gymnasium.make("FrozenLake-v1", desc=OWN_MAP)
    mdp, table = MDP.from_gymnasium(env, 0.9), env.unwrapped.P
    best, tables = by_table(table, 400, 0.9)
    wanted, action_values = np.array(best), np.array(tables[0])
    values, ends = certify(mdp).value_float[: len(table)], mdp.terminal[: len(table)]
    assert values[~ends] == pytest.approx(wanted[~ends], abs=1e-12)
    assert (values[ends] == 0).all()
    start = env.unwrapped.initial_state_distrib
    assert mdp.start_distribution[: len(table)] == pytest.approx(np.asarray(start))
    assert mdp.name == (name if name in IDS else "FrozenLake-v1")
    greedy, free = action_values.argmax(axis=1), ~mdp.forced[: len(table)]
    for policy in (Policy.of(mdp, action_values, kind="q"), Policy.of(mdp, greedy)):
        assert policy.choices(mdp)[: len(table)][free].tolist() == greedy[free].tolist()


# ---- tables of one's own -----------------------------------------------------------------------


class Env:
    """As little of an environment as a model needs."""

    def __init__(self, table: Any, start: Any = (1,)) -> None:
        self.P = table
        self.initial_state_distrib = start


@st.composite
def tables(draw: st.DrawFn) -> tuple[Table, list[float]]:
    """Tables with terminated outcomes anywhere: into states with moves, with starts, with none."""
    states, actions = draw(st.integers(1, 5)), draw(st.integers(1, 3))
    outcome = st.tuples(st.integers(0, states - 1), st.integers(-3, 3), st.booleans())
    table: dict[int, dict[int, Any]] = {}
    for state in range(states):
        if draw(st.booleans()):
            over = draw(st.booleans())
            table[state] = {a: [(1.0, state, 0, over)] for a in range(actions)}
            continue
        table[state] = {}
        for action in range(actions):
            listed = draw(st.lists(outcome, min_size=1, max_size=4))
            table[state][action] = [(1 / len(listed), *rest) for rest in listed]
    weights = [draw(st.integers(0, 3)) for _ in range(states)]
    weights[draw(st.integers(0, states - 1))] += 1
    return table, [weight / sum(weights) for weight in weights]


@given(tables())
def test_any_table_keeps_its_values(given: tuple[Table, list[float]]) -> None:
    """Of every state in which an episode may be alive, or that is no end."""
    table, start = given
    mdp = MDP.from_gymnasium(Env(table, start), 0.5)
    wanted, values = by_table(table, 60, 0.5)[0], certify(mdp).value_float
    alive: set[int] = set()
    todo = [state for state, weight in enumerate(start) if weight > 0]
    while todo:
        alive.add(state := todo.pop())
        after = {n for row in table[state].values() for _, n, _, over in row if not over}
        todo += after - alive
    for state in alive | {state for state in table if not mdp.terminal[state]}:
        assert values[state] == pytest.approx(wanted[state], abs=1e-12)
    assert mdp.n_states in (len(table), len(table) + 1)
    assert mdp.start_distribution[: len(table)] == pytest.approx(start)


class Vectors(Env):
    observation_space: Any = gymnasium.spaces.MultiDiscrete([2, 2], start=[1, 1])


class Bits(Env):
    observation_space: Any = gymnasium.spaces.MultiBinary(3)


HALF, THIRD = Fraction(1, 2), Fraction(1, 3)
STAY = {s: {0: [(1, s, s, False)]} for s in (0, 1)}
ENTER = {0: {0: [(1, 1, 1, True)]}, 1: {0: [(1, 0, 9, False)]}}
OVER = {0: {0: [(0.5, 1, 1, True), (0.5, -1, 2, True)]}, 1: {0: [(1, 0, 9, False)]}}
TEXTS = {
    0: {0: [(1, 1, 5, False)], 1: [("1/3", 0, 0, False), ("2/3", 1, 2, True)]},
    1: {0: [(1, 1, 0, True)]},
}
NUMPY = {
    np.int64(0): {np.int32(0): [(np.float64(1), np.int64(1), np.float32(0.5), np.True_)]},
    1: {0: [(1, 1, 0, np.False_)]},
}
READ: list[tuple[Any, dict[str, Any], list[object], list[Any]]] = [  # start, rows of the pairs
    (Env(TEXTS, [1, 0]), {}, [1, 0],
     [[(1, 1, 5)], [(THIRD, 0, 0), (1 - THIRD, 1, 2)], [(1, 1, 0)]]),
    (Env(NUMPY, np.array([1.0, 0])), {}, [1, 0], [[(1, 1, HALF)], [(1, 1, 0)]]),
    (Env(ENTER, None), {"start": 0}, [1, 0], [[(1, 1, 1)], [(1, 1, 0)]]),
    # An episode that starts in state 1 is alive there: now the end must be another state.
    (Env(ENTER, None), {"start": {1: HALF, 0: HALF}}, [HALF, HALF, 0],
     [[(1, 2, 1)], [(1, 0, 9)], [(1, 2, 0)]]),
    # An environment may be as little as its table; it starts in state 0, as all models do.
    *((form, {}, [1, 0, 0], [[(HALF, 1, 1), (HALF, 2, 2)], [(1, 1, 0)], [(1, 2, 0)]])
      for form in (OVER, type("Env", (), {"P": OVER})())),
    (type("Env", (), {"P": OVER, "isd": [0, 1]})(), {}, [0, 1, 0],
     [[(HALF, 2, 1), (HALF, 2, 2)], [(1, 0, 9)], [(1, 2, 0)]]),
    ({0: {0: [(1, -1, 3, True)]}}, {"start": [1]}, [1, 0], [[(1, 1, 3)], [(1, 1, 0)]]),
    *((Env(STAY, begins), {}, start, [[(1, 0, 0)], [(1, 1, 1)]])
      for begins, start in (({0: 0.5, 1: 0.5}, [HALF, HALF]), ({1: 1}, [0, 1]),
                            (np.int64(1), [0, 1]), (0, [1, 0]))),
    *((kind(STAY, 0), {}, [1, 0], [[(1, 0, 0)], [(1, 1, 1)]]) for kind in (Vectors, Bits)),
]  # fmt: skip


@pytest.mark.parametrize(("env", "options", "start", "rows"), READ, ids=range(len(READ)))
def test_tables_of_every_form(env: Any, options: Any, start: list[object], rows: list[Any]) -> None:
    mdp = MDP.from_gymnasium(env, "1/2", **options)
    assert mdp.start_distribution.tolist() == start
    assert [mdp.table.row(pair) for pair in range(mdp.n_pairs)] == rows
    named = MDP.from_gymnasium(env, actions=["go", "try"][: mdp.n_actions], name="own", **options)
    assert (named.name, named.actions) == ("own", ("go", "try")[: mdp.n_actions])


GO, AT_END = [(0.5, 0, 0, False), (0.5, 1, 1, True)], [(1.0, 1, 0, True)]
FORMS: list[Any] = [
    [[GO], [AT_END]],
    ((GO,), (AT_END,)),
    [{0: GO}, {0: AT_END}],
    {0: [GO], 1: [AT_END]},
    Env([[GO], [AT_END]], [1, 0]),
    {0.0: {0.0: GO}, 1.0: {0.0: AT_END}},
    {0: {0: [(0.5, 0.0, 0, 0), (0.5, np.float64(1), 1, 1)]}, 1: {0: [(1, 1, 0, 1.0)]}},
    *({0: {0: GO}, 1: row} for row in ({}, [], None)),  # the end has no row of its own
    {0: {0: GO}},
]


@pytest.mark.parametrize("table", FORMS, ids=range(len(FORMS)))
def test_a_table_may_have_other_shapes(table: Any) -> None:
    wanted = MDP.from_gymnasium({0: {0: GO}, 1: {0: AT_END}})
    assert fingerprint(MDP.from_gymnasium(table)) == fingerprint(wanted)


@pytest.mark.parametrize("kind", [np.float32, np.float16])
def test_probabilities_in_single_precision_are_divided_by_their_sum(kind: Any) -> None:
    listed = [(kind(1 / 3), 0, 0, False), (kind(2 / 3), 1, 1, True)]
    total = Fraction(float(listed[0][0])) + Fraction(float(listed[1][0]))
    row = MDP.from_gymnasium({0: {0: listed}}).table.row(0)
    assert [p for p, *_ in row] == [Fraction(float(each[0])) / total for each in listed]


TOYS = {
    "FrozenLake8x8-v1": ("LEFT, DOWN, RIGHT, UP", 10, "row 1, column 2"),
    "CliffWalking-v1": ("UP, RIGHT, DOWN, LEFT", 25, "row 2, column 1"),
    TAXI: (
        "SOUTH, NORTH, EAST, WEST, PICKUP, DROPOFF",
        328,
        "row 3, column 1, passenger Yellow, destination Red",
    ),
}


@pytest.mark.parametrize("name", TOYS)
def test_toys_have_the_names_of_their_environment(name: str) -> None:
    """Taxi's state 328 is the example of its documentation."""
    mdp = MDP.from_gymnasium(name, 0.9)
    actions, state, label = TOYS[name]
    assert (", ".join(mdp.actions), mdp.space.label(state)) == (actions, label)
    assert mdp.space.number(label) == state
    own = [str(number) for number in range(mdp.n_actions)]
    plain = MDP.from_gymnasium(name, 0.9, actions=own, states=range(mdp.space.regular))
    assert (plain.actions, plain.space.names) == (tuple(own), ("state",))
    assert [mdp.action(number) for number in own] == list(range(mdp.n_actions))
    if name == TAXI:
        env = gymnasium.make(name).unwrapped
        assert tuple(mdp.space.values(c)[state] for c in mdp.space.names) == tuple(
            env.decode(state)
        )


def test_labels_say_where_episodes_are_over() -> None:
    lake = MDP.from_gymnasium("FrozenLake-v1")
    assert {name: np.flatnonzero(flags).tolist() for name, flags in lake.labels.items()} == {
        "end": [5, 7, 11, 12, 15], "hole": [5, 7, 11, 12], "goal": [15],
    }  # fmt: skip
    best = certify(lake).start_value
    assert certify(lake.reaching("goal")).start_value == best
    assert certify(lake.reaching("end")).start_value == 1
    taxi = MDP.from_gymnasium(TAXI)  # its drop-off states are entered alive as well
    assert np.flatnonzero(taxi.labels["end"]).tolist() == [500]
    assert np.flatnonzero(taxi.terminal).tolist() == [500]
    assert MDP.from_gymnasium("FrozenLake-v1", labels={}).labels == {}
    endless = MDP.from_gymnasium({0: {0: [(1, 0, 0, False)]}})
    assert endless.labels == {}


class Ward:
    """As little of ICU-Sepsis: two states of a patient, death, survival, and what absorbs both."""

    def __init__(self, strategy: str = "mean") -> None:
        self._inadmissible_action_strategy = strategy
        chances = np.zeros((5, 2, 5))
        chances[0] = [[0.5, 0.25, 0.25, 0, 0], [0, 0.5, 0, 0.5, 0]]
        chances[1] = [[0, 0, 0.75, 0.25, 0], [0, 0, 0.5, 0.5, 0]]
        chances[2:, :, 4] = 1
        gains = np.zeros((5, 2, 5))
        gains[:, :, 3] = 1
        self.dynamics = {
            "tx_mat": chances,
            "r_mat": gains,
            "d_0": np.array([0.75, 0.25, 0, 0, 0]),
            "admissible_actions": [[0, 1], [0], [0, 1], [0, 1], [0, 1]],
        }

    @property
    def unwrapped(self) -> Any:
        return self


def test_matrices_of_dynamics_are_a_model() -> None:
    """Death and survival end an episode: no step counts that leads on from there."""
    env, random = Ward(), np.array([[0.5, 0.5]] * 2 + [[0, 0]] * 3)
    mdp = MDP.from_gymnasium(env)
    assert mdp.start_distribution.tolist() == [0.75, 0.25, 0, 0, 0]
    assert np.flatnonzero(mdp.terminal).tolist() == [2, 3, 4]
    bare = MDP.from_arrays(*map(env.dynamics.get, ("tx_mat", "r_mat")), start=env.dynamics["d_0"])
    for policy, kind in (("random", "auto"), (random, "policy")):
        short, long = (evaluate(model, policy, kind=kind) for model in (mdp, bare))
        # from state 1 survival has 3/8; from state 0, x = x/4 + 3/8 · 3/8 + 1/4
        assert short.mean == pytest.approx(0.75 * (0.25 + 0.375 * 0.375) / 0.75 + 0.25 * 0.375)
        assert (short.mean, short.steps + 1) == pytest.approx((long.mean, long.steps))
    assert solve(mdp).value[1] == 0.5
    admissible = MDP.from_gymnasium(Ward("raise_exception"))
    assert solve(admissible).value[1] == 0.25
    assert admissible.n_pairs == mdp.n_pairs - 1
    refused(lambda: MDP.from_gymnasium(Ward("terminate")), "'terminate'")
    env.dynamics["r_mat"] = np.zeros((5, 2))
    with pytest.raises(ShapeError, match=r"r_mat \(5, 2\)"):
        MDP.from_gymnasium(env)


def test_an_environment_of_ones_own_module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "my_walk.py").write_text(
        "import gymnasium\n\n\nclass Walk(gymnasium.Env):\n"
        "    observation_space = action_space = gymnasium.spaces.Discrete(2)\n"
        "    P = {0: {0: [(1, 0, -1, False)], 1: [(1, -1, 5, True)]}, "
        "1: {0: [(1, 1, 9, False)]}}\n\n\n"
        'gymnasium.register("Walk-v0", entry_point="my_walk:Walk")\n'
    )
    refused(lambda: load("gymnasium:my_walk:Walk-v0"), "no module my_walk", "", "PYTHONPATH")
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "my_start.py").write_text(
        "import gymnasium\nimport my_walk\n\n\nclass Walk(my_walk.Walk):\n"
        "    def reset(self, *, seed=None, options=None):\n        return 1, {}\n\n"
        "    def step(self, action):\n        return 1, 9, False, False, {}\n\n\n"
        'gymnasium.register("Walk-v1", entry_point="my_start:Walk")\n'
    )
    refused(lambda: load("gymnasium:my_start:Walk-v1"), "begins in state 1", "", "--start 1")
    for start in (1, "1", "state 1"):
        assert load("gymnasium:my_start:Walk-v1", start=start).start == ((1, 1),)
    mdp = load("gymnasium:my_walk:Walk-v0", discount="1/2")
    assert (mdp.reward.tolist(), mdp.space.extra) == ([-1, 5, 9, 0], ("end",))


test_tables_that_are_no_model = table_of_refusals(__file__, globals())
BOOM = """import gymnasium

class Boom(gymnasium.Env):
    def __init__(self): raise RuntimeError("no power")

gymnasium.register("Boom-v0", entry_point="my_boom:Boom")
"""


@pytest.mark.parametrize(
    ("module", "text", "words"),
    [
        ("my_boom", BOOM, "the environment my_boom:Boom-v0 raises RuntimeError: no power"),
        ("half_there", "import no_such_thing", "there is no module no_such_thing"),
    ],
)
def test_an_environment_that_cannot_be_made(
    module: str, text: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / f"{module}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    said = run("info", f"gymnasium:{module}:Boom-v0").refusal()
    assert words in said
    assert f"where: gymnasium:{module}:Boom-v0" in said


@pytest.mark.parametrize(
    ("name", "what", "fix"),
    [
        ("FrozenLak-v1", "FrozenLak", "did you mean FrozenLake-v1?"),
        (f"Taxi-v{NUMBER - 1}", "deprecated", f"did you mean {TAXI}?"),
        ("Nothing-v0", "Nothing", "FrozenLake-v1"),
        ("", "Gymnasium cannot make ''", "FrozenLake-v1"),
        ("no_such_module:Env-v0", "no module no_such_module", "PYTHONPATH"),
        ("CartPole-v1", "does not expose its model", "FrozenLake-v1"),
    ],
)
def test_names_that_are_no_model(name: str, what: str, fix: str) -> None:
    error = refused(lambda: load(f"gymnasium:{name}"), what, "", fix)
    assert "Blackjack" not in error.fix
    if "does not expose" in what:
        assert "MDP.from_function(start, actions, outcomes)" in error.fix


class Walk(gymnasium.Env):
    """Two states to walk through, the second of which may be where an episode begins."""

    action_space = observation_space = gymnasium.spaces.Discrete(2)
    P: ClassVar[Any] = {
        0: {0: [(0.5, 0, -1, False), (0.5, 1, -1, False)], 1: [(1.0, 1, -2, False)]},
        1: {0: [(1.0, 0, 0, False)], 1: [(1.0, 1, 5, True)]},
    }
    begins = 0

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.state = self.begins
        return self.state, {}

    def step(self, action: Any) -> Any:
        listed = self.P[self.state][action]
        _, self.state, reward, over = listed[self.np_random.integers(len(listed))]
        return self.state, float(reward), over, False, {}


class Same(gymnasium.Wrapper):
    """Only watches."""

    def step(self, action: Any) -> Any:
        return self.env.step(action)


class Shaped(gymnasium.Wrapper):
    def step(self, action: Any) -> Any:
        state, reward, *rest = self.env.step(action)
        return state, reward - 1, *rest


class Impatient(Walk):
    def step(self, action: Any) -> Any:
        state, reward, over, *rest = super().step(action)
        return state, reward, over or action == 0, *rest


class Drifting(Walk):
    def step(self, action: Any) -> Any:
        _, *rest = super().step(action)
        self.state = 0
        return 0, *rest


class Elsewhere(Walk):
    begins = 1


class Stated(Elsewhere):
    initial_state_distrib = (1, 0)


class Broken(Walk):
    def step(self, action: Any) -> Any:
        raise RuntimeError("no power")


class OwnLake(FrozenLakeEnv):
    def step(self, action: Any) -> Any:
        state, reward, *rest = super().step(action)
        return state, reward - 0.01, *rest


class Plain:
    """An environment of the older form: no seed, and four things from a step."""

    P = Walk.P

    def __init__(self, lost: float = 0) -> None:
        self.lost = lost

    def reset(self) -> int:
        self.state = 0
        return 0

    def step(self, action: int) -> Any:
        _, self.state, reward, over = random.choice(self.P[self.state][action])
        return self.state, reward - self.lost, over, {}


class Stub(gymnasium.Env):
    """An environment that has a table, and no steps yet."""

    action_space = observation_space = gymnasium.spaces.Discrete(2)
    P = Walk.P


def lake() -> Any:
    return gymnasium.make("FrozenLake-v1")


HARMLESS: list[Callable[[Any], Any]] = [
    lambda env: env,
    Same,
    lambda env: wrappers.TimeLimit(env, 7),
    wrappers.RecordEpisodeStatistics,
    wrappers.Autoreset,
    wrappers.OrderEnforcing,
    wrappers.PassiveEnvChecker,
    lambda env: wrappers.DtypeObservation(env, np.float32),
    lambda env: wrappers.TransformObservation(env, lambda seen: seen, env.observation_space),
]


@pytest.mark.parametrize("wrapped", HARMLESS, ids=range(len(HARMLESS)))
def test_a_wrapper_that_changes_nothing_is_looked_through(wrapped: Any) -> None:
    for env in (lake(), Walk()):
        assert fingerprint(MDP.from_gymnasium(wrapped(env))) == fingerprint(MDP.from_gymnasium(env))


CHANGED: list[tuple[Callable[[], Any], str, str]] = [  # an environment, what it does, the remedy
    (lambda: Shaped(lake()), "P lists", "env.unwrapped"),
    (lambda: wrappers.TimeLimit(Shaped(lake()), 7), "P lists", "env.unwrapped"),
    (lambda: Shaped(Walk()), "step(", "env.unwrapped"),
    (
        lambda: wrappers.TransformReward(lake(), lambda r: 10 * r),
        "not its table P",
        "env.unwrapped",
    ),
    (lambda: wrappers.NormalizeReward(Walk()), "P lists", "env.unwrapped"),
    *[  # which Gymnasium 1.2.0 does not have
        (lambda: wrappers.RepeatAction(lake(), 2), "P lists", "env.unwrapped")
        for _ in range(hasattr(wrappers, "RepeatAction"))
    ],
    (lambda: wrappers.DelayObservation(lake(), 1), "P lists", "env.unwrapped"),
    (lambda: wrappers.FrameStackObservation(lake(), 2), "an observation is", "env.unwrapped"),
    (lambda: wrappers.TimeAwareObservation(lake()), "an observation is", "env.unwrapped"),
    (
        lambda: wrappers.TransformObservation(lake(), lambda s: 15 - s, lake().observation_space),
        "reset() begins in state 15",
        "env.unwrapped",
    ),
    (OwnLake, "P lists (next state, reward, terminated)", "unwrapped.P"),
    (Impatient, "True); P lists", "unwrapped.P"),
    (Drifting, "gave (0, ", "unwrapped.P"),
    (Elsewhere, "reset() begins in state 1", "start=1"),
    (Stated, "has no initial probability", "start="),
    (lambda: Plain(1), "P lists", "make P agree"),
    (Broken, "raises RuntimeError: no power", "unwrapped.P"),
    (lambda: gymnasium.make(TAXI, fickle_passenger=True), "fickle", "without fickle_passenger"),
]


@pytest.mark.parametrize(("made", "what", "fix"), CHANGED, ids=range(len(CHANGED)))
def test_an_environment_that_does_more_than_its_table_is_refused(
    made: Callable[[], Any], what: str, fix: str
) -> None:
    env = made()
    refused(lambda: MDP.from_gymnasium(env), what, "", fix)
    if "env.unwrapped" in fix:
        assert MDP.from_gymnasium(env.unwrapped).n_states in (3, 16)
    if "unwrapped.P" in fix:
        assert MDP.from_gymnasium(env.unwrapped.P).n_states in (2, 3, 16)


def test_starts_that_are_given_answer_for_themselves() -> None:
    assert MDP.from_gymnasium(Elsewhere(), start=1).start == ((1, 1),)
    assert MDP.from_gymnasium(Stated(), start={0: "1/2", 1: "1/2"}).n_states == 3
    assert MDP.from_gymnasium(gymnasium.make(TAXI, is_rainy=True)).n_states == 501
    for env in (Plain(), Stub(), Same(Stub())):
        assert MDP.from_gymnasium(env).n_states == 3


def test_an_environment_stays_as_it_was() -> None:
    env = Same(Walk())
    env.reset(seed=3)
    env.step(1)
    before = env.unwrapped.state, env.unwrapped.np_random.bit_generator.state
    numbers = np.random.get_state()[1].tolist()  # noqa: NPY002
    MDP.from_gymnasium(env)
    assert (env.unwrapped.state, env.unwrapped.np_random.bit_generator.state) == before
    assert np.random.get_state()[1].tolist() == numbers  # noqa: NPY002


def test_what_cannot_be_compared_is_said() -> None:
    class Pairs(Walk):
        def reset(self, **given: Any) -> Any:
            return (0, super().reset(**given)[0]), {}

    with pytest.warns(UserWarning, match=r"step\(\) of Pairs was not compared with P"):
        assert MDP.from_gymnasium(Pairs()).n_actions == 2


@pytest.mark.parametrize("same_numbers", [True, False])
def test_a_wrapper_may_number_actions_as_the_matrices_do(same_numbers: bool) -> None:
    """As that of ICU-Sepsis does, which has five doses of two drugs; another order is refused."""

    class Doses(gymnasium.Env):
        action_space = gymnasium.spaces.MultiDiscrete([1, 2])
        observation_space = gymnasium.spaces.Discrete(5)
        dynamics = Ward().dynamics

    class Flat(gymnasium.ActionWrapper):
        action_space = gymnasium.spaces.Discrete(2)

        def action(self, action: int) -> tuple[int, int]:
            return 0, action if same_numbers else 1 - action

    if same_numbers:
        assert MDP.from_gymnasium(wrappers.TimeLimit(Flat(Doses()), 9)).n_actions == 2
        # Matrices are not tried: a wrapper of one's own is refused, whatever it does.
        said = "Same may change the environment", "env", "env.unwrapped"
        refused(lambda: MDP.from_gymnasium(Same(Flat(Doses()))), *said)
        return
    refused(lambda: MDP.from_gymnasium(Flat(Doses())), "Flat changes the environment")


def test_known_values() -> None:
    """At discount 0.99: FrozenLake's 0.542, CliffWalking's 13 steps along the edge of the cliff."""
    lake = MDP.from_gymnasium("FrozenLake-v1", "99/100")
    assert float(certify(lake).start_value) == pytest.approx(0.5420259)
    assert (lake.n_states, lake.n_actions) == (16, 4)
    cliff = MDP.from_gymnasium("CliffWalking-v1", "99/100")
    assert certify(cliff).start_value == -100 * (1 - Fraction(99, 100) ** 13)
    assert cliff.start == ((36, Fraction(1)),)
    assert np.flatnonzero(cliff.terminal).tolist() == [47]
    assert cliff.table.row(cliff.pair_offsets[47]) == [(1, 47, 0)]  # whatever the table lists there
