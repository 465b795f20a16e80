"""The one place that knows the direction of the numbers, beside the definition of each question."""

from math import inf

import numpy as np
import pytest

from exact_mdp import MDP, ModelError
from exact_mdp.mdp.sense import Sense


def test_costs_are_negated_rewards_and_come_back() -> None:
    numbers = np.array([1.0, -2.0, 0.0, inf])
    assert Sense.MAX.orient(numbers).tolist() == [1, -2, 0, inf]
    assert Sense.MIN.orient(numbers).tolist() == [-1, 2, 0, -inf]
    assert not np.signbit(Sense.MIN.orient(numbers)[2])  # there is no -0.0
    for sense in Sense:
        assert sense.orient(sense.orient(numbers)).tolist() == numbers.tolist()
        assert sense.opposite.opposite is sense is not sense.opposite
        assert sense.orient(1) == sense.sign
    assert Sense.MAX.orient_interval(1, 2) == (1, 2)
    assert Sense.MIN.orient_interval(1, 2) == (-2, -1)


def test_the_best_and_the_worst_are_those_of_the_sense() -> None:
    assert (Sense.MAX.best_of([2, 3, 1]), Sense.MIN.best_of([2, 3, 1])) == (3, 1)
    assert (Sense.MAX.worst, Sense.MIN.worst) == (-inf, inf)
    assert (Sense.MAX.best, Sense.MIN.best) == ("greatest", "least")
    assert (Sense.MAX.amount, Sense.MIN.amount) == ("reward", "cost")


def test_a_loss_is_how_much_worse_a_value_is() -> None:
    assert (Sense.MAX.loss(5, 3), Sense.MIN.loss(3, 5)) == (2, 2)
    best, own = np.array([inf, -inf, inf, 1.0]), np.array([inf, -inf, 1.0, 0.5])
    assert Sense.MAX.losses(best, own).tolist() == [0, 0, inf, 0.5]
    assert Sense.MIN.losses(-best, -own).tolist() == [0, 0, inf, 0.5]


def test_a_model_has_a_sense_by_its_word() -> None:
    mdp = MDP.from_arrays([[[1]]], [1], "1/2", sense="min")
    assert mdp.sense is Sense.MIN
    assert mdp.sense == "min"
    assert str(mdp.sense) == "min"
    assert mdp.maximised.sense is Sense.MAX
    assert mdp.maximised.maximised is mdp.maximised
    assert Sense.of_options({"sense": "min"}) is Sense.MIN
    assert Sense.of_options({}) is Sense.of_options({"sense": "least"}) is Sense.MAX
    with pytest.raises(ModelError, match="the sense is 'least'"):
        MDP.from_arrays([[[1]]], [1], "1/2", sense="least")
