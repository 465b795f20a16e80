"""UMB files: umbi reads ours, we read those of others, and what is damaged or lies is refused.

That nothing is lost is tested for all formats together, in `test_formats`.
"""

import json
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
import umbi
from archives import annotate, foreign_umb, is_refused, read_by_umbi, tarred, untarred, written
from model_contents import laws

from exact_mdp import MDP, ModelError, Scenario, certify, evaluate, load, save

F = Fraction
CARE = Scenario.load("yuan2025").with_(tasks=[1, 1], max_trial=1).compile()


def test_umbi_itself_reads_ours(tmp_path: Path) -> None:
    """The format's own library finds the same chances, expected rewards and labels."""
    mdp, path = CARE, tmp_path / "care.umb"
    save(mdp, path)
    theirs = read_by_umbi(path)
    system = theirs.index.transition_system
    assert (system.time, system.num_players) == ("discrete", 1)
    assert (system.num_states, system.num_choices) == (mdp.n_states, mdp.n_pairs)
    offsets, rewards = theirs.choice_to_branches, theirs.annotations["rewards"]
    for pair in range(mdp.n_pairs):
        span = slice(offsets[pair], offsets[pair + 1])
        law = list(
            zip(theirs.branch_to_probability[span], theirs.branch_to_target[span], strict=True)
        )
        assert law == [(p, n) for p, n, _ in mdp.table.row(pair)]
        assert all(isinstance(p, Fraction) for p, _ in law)
        mean = sum(p * r for p, _, r in mdp.table.row(pair))
        assert rewards["reward"]["choices"][pair] == mean
    assert theirs.annotations["aps"]["terminal"]["states"] == mdp.terminal.tolist()
    assert theirs.state_is_initial == [state == 0 for state in range(mdp.n_states)]
    assert theirs.choice_action_to_string == list(mdp.actions)


def test_rewards_of_pairs_stay_exact_beside_float_probabilities(tmp_path: Path) -> None:
    path, rows = tmp_path / "m.umb", [[[0.3, 0.7], [0.1, 0.9]]]
    save(MDP.from_arrays(rows, [["1/3"], [1]], "9/10"), path)
    assert read_by_umbi(path).annotations["rewards"]["reward"]["choices"] == [Fraction(1, 3), 1]
    assert load(path).table.row(0)[0] == (Fraction(3, 10), 0, Fraction(1, 3))


def test_labels_whose_names_differ_by_signs_alone(tmp_path: Path) -> None:
    labels = {name: [True] for name in ("a.b", "a-b", "A_b", "terminal")}
    save(MDP.from_outcomes([(0, 0, [(1, 0, 10)])], labels=labels), tmp_path / "m.umb")
    described = read_by_umbi(tmp_path / "m.umb").index.annotations["aps"]
    known_as = [each.alias or key for key, each in described.items()]
    assert known_as == ["terminal", "a_b", "a_b_1", "A_b", "terminal_3"]
    with pytest.raises(ModelError, match="unknown reward model 'a_b'"):
        load(f"{tmp_path / 'm.umb'}#a_b")


# ---- files of others -----------------------------------------------------------------------------


def test_rewards_of_states_choices_and_branches_add_up(tmp_path: Path) -> None:
    third, half = Fraction(1, 3), Fraction(1, 2)
    values = {"states": [half, 0], "choices": [10, 20, 0], "branches": [100, 200, 300, 0]}
    content = foreign_umb(
        [[[(0, third), (1, 1 - third)], [(1, Fraction(1))]], [[(1, Fraction(1))]]], {"cost": values}
    )
    act(content, [1, 0, 0], ["go", "wait"])
    mdp = load(written(content, tmp_path), discount=1)
    assert (mdp.actions, mdp.name) == (("go", "wait"), "theirs")
    assert laws(mdp) == {
        (0, "go"): {(1, 320 + half): 1},
        (0, "wait"): {(0, 110 + half): third, (1, 210 + half): 1 - third},
        (1, "go"): {(1, Fraction(0)): 1},
    }


def chain(*, initial: Sequence[int] = (0,), **rewards: list[Any]) -> Any:
    """A chain of two states, the second of them without a choice."""
    given = {name: {"states": values} for name, values in rewards.items()}
    content = foreign_umb([[[(0, 0.25), (1, 0.75)]], []], given, initial=initial)
    content.index.transition_system.num_players = 0
    return content


def act(content: Any, chosen: list[int], names: list[str]) -> None:
    content.index.transition_system.num_choice_actions = len(names)
    content.choice_to_choice_action, content.choice_action_to_string = chosen, names


def test_a_chain_and_a_state_without_choices(tmp_path: Path) -> None:
    mdp = load(written(chain(steps=[1.5, 0.0]), tmp_path), discount=1)
    quarter = Fraction(1, 4)
    assert laws(mdp)[0, "0"] == {(0, Fraction(3, 2)): quarter, (1, Fraction(3, 2)): 1 - quarter}
    assert mdp.terminal.tolist() == [False, True]
    with pytest.raises(ModelError, match="in a state without choices"):
        load(written(chain(steps=[1.5, 2.0]), tmp_path), discount=1)


def test_a_reward_model_is_chosen_by_name(tmp_path: Path) -> None:
    path = written_with_two_rewards(tmp_path)
    for name, value in (("time", 1), ("a long name", 7)):
        assert load(f"{path}#{name}", discount=1).reward[0] == value
    with pytest.raises(ModelError, match=r"unknown reward model 'tim'(.|\n)*did you mean time"):
        load(f"{path}#tim", discount=1)


def test_several_reward_models_and_none(tmp_path: Path) -> None:
    """Unless one is named, all are components of the reward, which is their sum; or it is 0."""
    path = written_with_two_rewards(tmp_path)
    with pytest.warns(UserWarning, match="rewards time, a long name are added up"):
        mdp = load(path, discount=1)
    assert mdp.component_names == ("time", "a long name")
    assert mdp.components.tolist() == [[1, 7], [0, 0]]
    assert mdp.reward.tolist() == [8, 0]
    bare = load(written(chain(), tmp_path), discount=1)
    assert bare.reward.tolist() == [0, 0]
    exact = chain(reward=[Fraction(1, 2), 0], cost=[Fraction(1, 3), 0])
    both = load(written(exact, tmp_path), discount=1)  # the one called reward is the reward
    assert both.component_names == ("cost", "rest")
    assert certify(both.with_(labels={"end": [False, True]}).until("end", "rest")).value[0] == F(
        1, 6
    ) / F(3, 4)
    named = chain(reward=[3, 0], rest=[1, 0], **{"rest'": [1, 0]})
    three = load(written(named, tmp_path), discount=1)  # what is left gets a name of its own
    assert three.component_names == ("rest", "rest'", "rest''")
    assert three.components.tolist() == [[1, 1, 1], [0, 0, 0]]


def written_with_two_rewards(folder: Path) -> Path:
    content = chain(time=[1, 0], cost=[7, 0])
    content.index.annotations["rewards"]["cost"].alias = "a long name"
    return written(content, folder)


def test_initial_states(tmp_path: Path) -> None:
    path = written(chain(steps=[1, 0], initial=[0, 1]), tmp_path)
    with pytest.warns(UserWarning, match="first of 2 initial states, state 0; --start"):
        assert load(path, discount=1).labels["init"].tolist() == [True, True]
    assert load(path, discount=1, start=1).start == ((1, Fraction(1)),)
    assert len(load(path, discount=1, start={0: "1/3", 1: "2/3"}).start) == 2
    with pytest.raises(ModelError, match="no initial state"):
        load(written(chain(steps=[1, 0], initial=[]), tmp_path), discount=1)
    one = load(written(chain(steps=[1, 0]), tmp_path), discount=1)
    assert one.labels["init"].tolist() == [True, False]


@pytest.mark.parametrize(
    ("chosen", "names", "read"),
    [
        ([1, 1, 0], ["", "b"], ["b", "b#2", "unnamed"]),
        ([0, 1, 0], ["", "b"], ["unnamed", "b", "unnamed#2"]),
        ([0, 1, 2], ["", "b", ""], ["unnamed", "b", "unnamed#2"]),  # Storm's names may repeat
        ([2, 1, 0], ["", "b", "unnamed"], ["unnamed", "b", "unnamed'"]),
        ([0, 0, 1], ["b", "b#2"], ["b", "b#2'", "b#2"]),
        ([1, 0, 0], ["", ""], ["a1", "a0", "a0#2"]),  # umbi reads no names then
    ],
)
def test_each_choice_keeps_its_name(
    chosen: list[int], names: list[str], read: list[str], tmp_path: Path
) -> None:
    """Where it has none, or another choice of the state has the same, it gets one of its own."""
    content = foreign_umb([[[(0, 1.0)]] * 3], {"r": {"choices": [5, 6, 7]}})
    act(content, chosen, names)
    mdp = load(written(content, tmp_path), discount=1)
    assert {mdp.actions[a]: r for a, r in zip(mdp.pair_action, mdp.reward, strict=True)} == dict(
        zip(read, [5, 6, 7], strict=True)
    )
    save(mdp, tmp_path / "again.npz")
    again = load(tmp_path / "again.npz")
    assert [evaluate(again, f"always:{name}", horizon=1).mean for name in read] == [5, 6, 7]


def test_models_of_other_kinds(tmp_path: Path) -> None:
    timed = chain(steps=[1, 0])
    system, timed.state_to_exit_rate = timed.index.transition_system, [1.0, 2.0]
    system.time, system.exit_rate_type = "stochastic", system.branch_probability_type
    game = chain(steps=[1, 0])
    system, game.state_to_player = game.index.transition_system, [0, 1]
    system.num_players, system.player_to_name = 2, ["x", "y"]
    hidden = chain(steps=[1, 0])
    system, hidden.entity_to_observation = hidden.index.transition_system, [0, 1]
    system.num_players, system.num_observations = 1, 2
    system.observations_apply_to = "states"
    rewards = {"r": {"states": [1]}}
    vague = foreign_umb([[[(0, umbi.datatypes.Interval(0.5, 1.0))]]], rewards)
    half = foreign_umb([[[(0, 0.5)]]], rewards)
    for content, message in (
        (timed, "time is stochastic"),
        (game, "2 players"),
        (hidden, "2 observations"),
        (vague, "is not a number"),
        (half, r"sum to 0\.5, not 1"),
    ):
        with pytest.raises(ModelError, match=message):
            load(written(content, tmp_path), discount=1)


# ---- damage -----------------------------------------------------------------------------------


def members_of_care(folder: Path) -> dict[str, bytes]:
    save(CARE, folder / "good.umb")
    return untarred(folder / "good.umb")


def refused(content: bytes, message: str, folder: Path) -> None:
    (folder / "bad.umb").write_bytes(content)
    is_refused(folder / "bad.umb", message, discount=1)


@pytest.mark.parametrize(
    ("name", "place", "value", "message"),
    [
        ("branch-to-target.bin", 0, 33, "leads to state 33 of 33"),
        ("branch-to-target.bin", 0, 2**63, "leads to state"),
        ("branch-to-probability.bin", 0, 2**62, "sum to"),
        ("branch-to-probability.bin", 0, 2**64 - 1, "a probability is"),
        ("branch-to-probability.bin", 8, 0, "damaged"),
        ("state-to-choices.bin", 8, 2**40, "offsets that do not run"),
        ("choice-to-branches.bin", 8, 2**40, "offsets that do not run"),
        ("choice-to-branches.bin", 8, 0, "sum to 0, not 1"),
        ("actions/choices/values.bin", 0, 9, "an action beyond"),
    ],
)
def test_numbers_that_make_no_model(
    tmp_path: Path, name: str, place: int, value: int, message: str
) -> None:
    """Files of others are refused for their numbers, ours also for not being what we wrote."""
    members = members_of_care(tmp_path)
    data = members[name]
    members[name] = data[:place] + value.to_bytes(8, "little") + data[place + 8 :]
    refused(tarred(members), "", tmp_path)
    index = json.loads(members["index.json"])
    del index["annotations"]["exact-mdp"]
    refused(tarred(members | {"index.json": json.dumps(index).encode()}), message, tmp_path)


# ---- labels, names and variables -----------------------------------------------------------------


def test_labels_names_and_variables_of_others(tmp_path: Path) -> None:
    content = foreign_umb([[[(1, Fraction(1))]], [[(2, Fraction(1))]], [[(2, Fraction(1))]]])
    annotate(content, "aps", "goal", {"states": [False, False, True]})
    content.index.annotations["aps"]["goal"].alias = "The goal"
    struct = umbi.binary.StructType()
    struct.add_attribute("x", umbi.binary.SizedType(umbi.datatypes.NumericPrimitiveType.INT, 3))
    struct.add_attribute("on", umbi.binary.SizedType(umbi.datatypes.PrimitiveType.BOOL, 1))
    struct.pad_to_byte()
    content.index.valuations = {
        "states": umbi.umb.index.ValuationDescription(unique=True, classes=[struct])
    }
    encoder = umbi.umb.umb_to_tar.UmbEncoder()
    encoder.add_index_file(content)
    encoder.add_state_files(content)
    encoder.add_transition_files(content)
    encoder.add_annotation_files(content)
    files = dict(encoder.items())
    # Four bits of a byte, the lowest first: x in two's complement, then on.
    files["valuations/states/valuations.bin"] = bytes([0b0_111, 0b1_000, 0b1_011])
    path = tmp_path / "theirs.umb"
    path.write_bytes(tarred(files))
    mdp = load(path, discount=1)
    assert list(mdp.labels) == ["The goal", "init"]
    assert mdp.labels["The goal"].tolist() == [False, False, True]
    assert mdp.space.labels(range(3)) == [
        "state x=-1, on=false", "state x=0, on=true", "state x=3, on=true",
    ]  # fmt: skip
    assert certify(mdp.reaching("The goal")).start_value == 1
    assert load(path, discount=1, start="x=3, on=true").start == ((2, 1),)
