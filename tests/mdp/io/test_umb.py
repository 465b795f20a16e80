"""UMB files: ours come back with the same laws, and those of others are read."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import umbi
import umbi.ats
from hypothesis import given, settings
from hypothesis import strategies as st
from laws import laws
from umb_files import MODELS, members_of, read_by_umbi

from exact_mdp.mdp import MDP, ModelError
from exact_mdp.mdp.io import umb
from exact_mdp.mdp.io.load import load


@pytest.mark.parametrize("name", MODELS)
def test_ours_come_back_with_the_same_laws(tmp_path: Path, name: str) -> None:
    mdp, path = MODELS[name], tmp_path / "model.umb"
    umb.save(mdp, path)
    again = umb.load(path, discount="9/10")
    assert laws(again) == laws(mdp)
    assert (again.start, again.actions) == (mdp.start, mdp.actions)
    assert again.name == mdp.name
    assert again.discount_exact == Fraction(9, 10)
    assert again.terminal.tolist() == mdp.terminal.tolist()
    assert [file.name for file in tmp_path.iterdir()] == ["model.umb"]
    first = path.read_bytes()
    umb.save(mdp, path)
    assert path.read_bytes() == first


@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_any_rationals_survive(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    numbers = st.one_of(st.fractions(), st.integers(-(10**60), 10**60))
    chances = st.one_of(st.fractions(0, 1), st.fractions(0, 1, max_denominator=2**200))
    listed = []
    for state in range(data.draw(st.integers(1, 4))):
        p = data.draw(chances)
        listed.append((state, 0, [(p, 0, data.draw(numbers)), (1 - p, state, data.draw(numbers))]))
    mdp = MDP.from_outcomes(listed)
    path = tmp_path_factory.mktemp("umb") / "model.umb"
    umb.save(mdp, path)
    assert laws(umb.load(path)) == laws(mdp)


def test_umbi_itself_reads_ours(tmp_path: Path) -> None:
    """The format's own library finds the same chances, expected rewards, labels and columns."""
    mdp, path = MODELS["care"], tmp_path / "care.umb"
    umb.save(mdp, path)
    found = read_by_umbi(path)
    system = found.index.transition_system
    assert (system.time, system.num_players) == ("discrete", 1)
    assert (system.num_states, system.num_choices) == (mdp.n_states, mdp.n_pairs)
    offsets, rewards = found.choice_to_branches, found.annotations["rewards"]
    for pair in range(mdp.n_pairs):
        span = slice(offsets[pair], offsets[pair + 1])
        law = list(
            zip(found.branch_to_probability[span], found.branch_to_target[span], strict=True)
        )
        assert law == [(p, n) for p, n, _ in mdp.table.row(pair)]
        assert all(isinstance(p, Fraction) for p, _ in law)
        mean = sum(p * r for p, _, r in mdp.table.row(pair))
        assert rewards["reward"]["choices"][pair] == mean
    described = {d.description: key for key, d in found.index.annotations["rewards"].items()}
    aliases = {d.alias for d in found.index.annotations["rewards"].values()}
    assert {"subtask_complete", "assist_non_directive", "anger"} <= aliases
    for number, name in enumerate(mdp.component_names):
        values = rewards[described[name]]["choices"]
        assert values == mdp.components[:, number].tolist()
    assert found.annotations["aps"]["terminal"]["states"] == mdp.terminal.tolist()
    assert found.state_is_initial == [state == 0 for state in range(mdp.n_states)]
    assert found.choice_action_to_string == list(mdp.actions)
    variables = found.index.valuations["states"].classes[0].attributes
    assert [(v.name, v.sized_type.size_bits) for v in variables] == [
        (name, 32) for name in mdp.space.names
    ]
    values = np.frombuffer(members_of(path)["valuations/states/valuations.bin"], "<i4")
    columns = [mdp.space.values(name) for name in mdp.space.names]
    assert values.reshape(mdp.n_states, -1).tolist() == np.stack(columns, axis=1).tolist()


def test_components_whose_names_differ_by_signs_alone(tmp_path: Path) -> None:
    names = ("a.b", "a-b", "A_b", "reward")
    parts = np.array([[1.0, 2.0, 3.0, 4.0]])
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 10)])], component_names=names, components=parts)
    umb.save(mdp, tmp_path / "m.umb")
    content = read_by_umbi(tmp_path / "m.umb")
    known_as = [d.alias or key for key, d in content.index.annotations["rewards"].items()]
    assert known_as == ["reward", "a_b", "a_b_", "A_b", "reward_"]
    assert umb.load(tmp_path / "m.umb").reward.tolist() == [10]
    assert umb.load(tmp_path / "m.umb", reward="a_b").reward.tolist() == [1]


# ---- files of others -----------------------------------------------------------------------------


def system(states: int, players: int = 1) -> Any:
    ats = umbi.ats.ExplicitAts()
    ats.num_players = players
    for _ in range(states):
        ats.add_state()
    ats.set_initial_states([0])
    return ats


def written(ats: Any, folder: Path) -> Path:
    path = folder / "theirs.umb"
    umbi.ats.write(ats, path)
    return path


def test_rewards_of_states_choices_and_branches_add_up(tmp_path: Path) -> None:
    ats = system(2)
    ats.num_choice_actions, ats.choice_action_to_name = 2, ["go", "wait"]
    for state, action, branches in (
        (0, 1, [(0, Fraction(1, 3)), (1, Fraction(2, 3))]),
        (0, 0, [(1, Fraction(1))]),
        (1, 0, [(1, Fraction(1))]),
    ):
        choice = ats.add_state_choice(state)
        choice.action = action
        for target, chance in branches:
            choice.add_branch(target, chance)
    reward = ats.add_reward_annotation("cost")
    reward.set_state_values([Fraction(1, 2), 0])
    reward.set_choice_values([10, 20, 0])
    reward.set_branch_values([100, 200, 300, 0])
    mdp = umb.load(written(ats, tmp_path), discount=1)
    assert (mdp.actions, mdp.name) == (("go", "wait"), "theirs")
    half = Fraction(1, 2)
    assert laws(mdp) == {
        (0, "go"): {(1, 320 + half): 1},
        (0, "wait"): {(0, 110 + half): Fraction(1, 3), (1, 210 + half): Fraction(2, 3)},
        (1, "go"): {(1, Fraction(0)): 1},
    }


def chain(**rewards: list[Any]) -> Any:
    """A chain of two states, the second of them without a choice."""
    ats = system(2, players=0)
    choice = ats.add_state_choice(0)
    choice.add_branch(0, 0.25)
    choice.add_branch(1, 0.75)
    for name, values in rewards.items():
        ats.add_reward_annotation(name).set_state_values(values)
    return ats


def test_a_chain_and_a_state_without_choices(tmp_path: Path) -> None:
    mdp = umb.load(written(chain(steps=[1.5, 0.0]), tmp_path), discount=1)
    quarter = Fraction(1, 4)
    assert laws(mdp)[0, "0"] == {(0, Fraction(3, 2)): quarter, (1, Fraction(3, 2)): 1 - quarter}
    assert mdp.terminal.tolist() == [False, True]
    with pytest.raises(ModelError, match="in a state without choices"):
        umb.load(written(chain(steps=[1.5, 2.0]), tmp_path), discount=1)


def test_a_reward_model_is_chosen_by_name(tmp_path: Path) -> None:
    path = written_with_two_rewards(tmp_path)
    for name, value in (("time", 1), ("cost", 7), ("a long name", 7)):
        assert umb.load(path, discount=1, reward=name).reward[0] == value
        assert load(f"{path}#{name}", discount=1).mdp.reward[0] == value
    with pytest.raises(ModelError, match=r"2 reward models(.|\n)*time, a long name"):
        umb.load(path)
    with pytest.raises(ModelError, match=r"no reward model 'tim'(.|\n)*did you mean time"):
        load(f"{path}#tim")
    with pytest.raises(ModelError, match=r"0 reward models(.|\n)*add a reward model"):
        umb.load(written(chain(), tmp_path), discount=1)


def written_with_two_rewards(folder: Path) -> Path:
    content = umbi.ats.ats_to_umb.explicit_ats_to_explicit_umb(chain(time=[1, 0], cost=[7, 0]))
    content.index.annotations["rewards"]["cost"].alias = "a long name"
    umbi.umb.write(content, folder / "theirs.umb")
    return folder / "theirs.umb"


def test_initial_states(tmp_path: Path) -> None:
    ats = chain(steps=[1, 0])
    ats.set_initial_states([0, 1])
    path = written(ats, tmp_path)
    with pytest.raises(ModelError, match="2 initial states"):
        umb.load(path, discount=1)
    assert umb.load(path, discount=1, start=1).start == ((1, Fraction(1)),)
    assert len(umb.load(path, discount=1, start={0: "1/3", 1: "2/3"}).start) == 2
    ats.set_initial_states([])
    with pytest.raises(ModelError, match="0 initial states"):
        umb.load(written(ats, tmp_path), discount=1)


def test_actions_that_repeat_in_a_state_are_numbered(tmp_path: Path) -> None:
    ats = system(1)
    ats.num_choice_actions, ats.choice_action_to_name = 2, ["", "b"]
    for action in (1, 1, 0):
        choice = ats.add_state_choice(0)
        choice.action = action
        choice.add_branch(0, 1.0)
    ats.add_reward_annotation("r").set_choice_values([5, 6, 7])
    mdp = umb.load(written(ats, tmp_path), discount=1)
    assert (mdp.actions, mdp.reward.tolist()) == (("0", "1", "2"), [5, 6, 7])


def test_models_of_other_kinds(tmp_path: Path) -> None:
    timed = chain(steps=[1, 0])
    timed.time, timed.state_to_exit_rate = umbi.ats.TimeType.STOCHASTIC, [1.0, 2.0]
    with pytest.raises(ModelError, match="time is stochastic"):
        umb.load(written(timed, tmp_path), discount=1)
    game = chain(steps=[1, 0])
    game.num_players, game.state_to_player, game.player_to_name = 2, [0, 1], ["x", "y"]
    with pytest.raises(ModelError, match="2 players"):
        umb.load(written(game, tmp_path), discount=1)
    hidden = chain(steps=[1, 0])
    hidden.num_players = 1
    hidden.add_observation_annotation(2).set_state_values([0, 1])
    with pytest.raises(ModelError, match="2 observations"):
        umb.load(written(hidden, tmp_path), discount=1)
    vague = system(1)
    vague.add_state_choice(0).add_branch(0, umbi.datatypes.Interval(0.5, 1.0))
    vague.add_reward_annotation("r").set_state_values([1])
    with pytest.raises(ModelError, match="not a single number"):
        umb.load(written(vague, tmp_path), discount=1)
    half = system(1)
    half.add_state_choice(0).add_branch(0, 0.5)
    half.add_reward_annotation("r").set_state_values([1])
    with pytest.raises(ModelError, match=r"sum to 0\.5, not 1"):
        umb.load(written(half, tmp_path), discount=1)


def test_rewards_that_were_changed_for_choices_alone(tmp_path: Path) -> None:
    """Another tool may change the rewards and pass over our finer ones: they must not win."""
    path = tmp_path / "care.umb"
    umb.save(MODELS["care"], path)
    content = read_by_umbi(path)
    content.index.valuations = None
    content.annotations["rewards"]["reward"]["choices"][7] += 1
    umbi.umb.write(content, path)
    with pytest.raises(ModelError, match="rewards of branches average"):
        umb.load(path)
