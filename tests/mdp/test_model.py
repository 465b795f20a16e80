"""What a model is called, where it starts, how it is changed; and that nothing else changes it."""

from __future__ import annotations

import pickle
from fractions import Fraction

import numpy as np
import pytest
from laws import laws

from exact_mdp.mdp import MDP, ModelError, StateSpace

HALF = Fraction(1, 2)
P = np.array([[[0.5, 0.5, 0.0], [0, 0.25, 0.75], [0, 0, 1]], [[0, 1, 0], [0.5, 0, 0.5], [0, 0, 1]]])
R_PAIR = np.array([[1.0, 2.0], [3.0, -4.0], [0.0, 0.0]])


def test_names_and_start() -> None:
    mdp = MDP.from_arrays(
        P, R_PAIR, 0.9, start={1: "1/3", 0: "2/3", 2: 0}, actions=["stay", "go"],
        states=["a", "b", "c"], name="three",
    )  # fmt: skip
    assert mdp.start == ((0, Fraction(2, 3)), (1, Fraction(1, 3)))
    assert mdp.start_distribution == pytest.approx([2 / 3, 1 / 3, 0])
    assert (mdp.actions, mdp.name, mdp.space.label(1)) == (("stay", "go"), "three", "state b")
    assert mdp.where(3) == "state (state b), action go"
    assert mdp.pair(1, "go") == mdp.pair(1, 1) == 3
    with pytest.raises(ModelError, match="did you mean stay"):
        mdp.action("sty")


def test_with_validates_again() -> None:
    mdp = MDP.from_arrays(P, R_PAIR, 0.9)
    assert mdp.with_(discount="1/3").discount_exact == Fraction(1, 3)
    assert mdp.discount == 0.9
    assert mdp.with_(start=2).start == ((2, Fraction(1)),)
    assert mdp.with_(start={0: HALF, 2: HALF}).start_distribution.tolist() == [0.5, 0, 0.5]
    assert mdp.with_(name="x", actions=("l", "r")).actions == ("l", "r")
    for bad in (
        {"discount": 1.5},
        {"discount": "x"},
        {"start": 3},
        {"start": -1},
        {"start": {0: HALF}},
        {"start": {0: 2, 1: -1}},
        {"start": {0: 10**400}},
        {"discount": 10**400},
        {"start": "first"},
        {"start": True},
        {"start": {}},
        {"actions": ("a", "a")},
        {"actions": ("a",)},
        {"space": StateSpace.plain(2)},
        {"space": StateSpace.plain(4)},
        {"pair_state": mdp.pair_state[::-1]},
        {"pair_state": mdp.pair_state[:-1]},
        {"components": np.zeros((6, 1))},
        {"components": np.zeros((5, 1))},
    ):
        with pytest.raises(ModelError):
            mdp.with_(**bad)


def test_a_new_table_has_new_components() -> None:
    mdp = MDP.from_arrays(P, R_PAIR, 0.9)
    other = MDP.from_arrays(P, R_PAIR + 1, 0.9)
    changed = mdp.with_(table=other.table)
    assert changed.reward.tolist() == other.reward.tolist()
    assert changed.components[:, 0].tolist() == other.reward.tolist()


def test_a_model_is_frozen_and_survives_a_pickle() -> None:
    mdp = MDP.from_outcomes(
        [(0, 0, [("1/3", 0, 1), ("2/3", 1, 2)]), (1, 0, [(1, 1, 0)])], "9/10", name="small"
    )
    for model in (mdp, pickle.loads(pickle.dumps(mdp))):
        assert laws(model) == laws(mdp)
        assert (model.name, model.discount_exact, model.space) == (
            "small",
            Fraction(9, 10),
            mdp.space,
        )
        for array in (
            model.reward, model.components, model.pair_state, model.pair_action,
            model.pair_offsets, model.table.offsets, model.table.next, model.table.weight,
            model.table.gain, model.transition.data, model.transition.indices,
            model.start_distribution,
        ):  # fmt: skip
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0
        with pytest.raises(AttributeError):
            model.name = "other"


def test_repr_says_the_sizes() -> None:
    assert repr(MDP.from_arrays(P, R_PAIR, "9/10", name="three")) == (
        "MDP(three: 3 states, 2 actions, 6 pairs, 9 transitions, discount 9/10)"
    )
