"""The best average reward per step: exact, certified, against every policy and against limits."""

from dataclasses import replace
from fractions import Fraction as F

import numpy as np
import pytest
from cases import BY_NAME
from strategies import Rows

from exact_mdp import MDP, Certificate, certify


def proven(mdp: MDP) -> Certificate:
    optimum = certify(mdp, criterion="average")
    assert optimum.violations() == []
    return optimum


# model, gain of each state, and who published it
WAIT = F(4) * F(9, 10) ** 9
KNOWN = {
    # pymdptoolbox src/tests/test_RelativeValueIteration.py: 3.24; 3.885235246, an iterate that
    # stopped before 35/9; 1.549681956
    "forest-3-9/10": [F(81, 25)] * 3,
    "toolbox-small-9/10": [F(35, 9)] * 2,
    "forest-10-24/25": [WAIT] * 10,
    # Puterman, example 9.1.1; msdm msdm/tests/domains/__init__.py
    "puterman-multichain-1/2": [F(3), F(2), F(2)],
    # Puterman, sections 3.1 and 8.2: leaving a state of gain 5 - ... ends at -1 for ever
    "puterman-two-state-1/2": [F(-1), F(-1)],
}


@pytest.mark.parametrize("name", KNOWN)
def test_published_gains(name: str) -> None:
    case = BY_NAME[name]
    mdp = Rows(n_states=case.n_states, pairs=case.pairs, discount=case.discount).model()
    assert proven(mdp).value.tolist() == KNOWN[name]


def test_howards_taxicab() -> None:
    """Howard (1960), chapter 4: 13.34 a trip, at the stand in every town."""
    case = BY_NAME["howard-taxicab"]
    optimum = proven(Rows(n_states=3, pairs=case.pairs, discount=case.discount).model())
    assert optimum.policy.tolist() == [1, 1, 1]
    assert float(optimum.value[0]) == pytest.approx(13.34454, abs=5e-6)


def test_tijms_maintenance() -> None:
    """Tijms, A First Course in Stochastic Models (2003), section 6.4, p. 251: the least costs.

    A machine wears out, from 1 to 4; broken (5), it is repaired in two days, the second one 6. A
    repair before costs 7, 7 and 5. The optimum waits in 1 to 3 and repairs in 4.
    """
    wear = [{0: "9/10", 1: "1/10"}, {1: "4/5", 2: "1/10", 3: "1/20", 4: "1/20"}]
    wear += [{2: "7/10", 3: "1/10", 4: "1/5"}, {3: "1/2", 4: "1/2"}]
    rows = [(s, 0, [(p, t, 0) for t, p in row.items()]) for s, row in enumerate(wear)]
    rows += [(s, 1, [(1, 0, cost)]) for s, cost in ((1, 7), (2, 7), (3, 5))]
    rows += [(4, 2, [(1, 5, 10)]), (5, 2, [(1, 0, 0)])]
    optimum = certify(MDP.from_outcomes(sorted(rows), sense="min"), criterion="average")
    assert optimum.violations() == []
    assert optimum.policy.tolist() == [0, 0, 0, 1, 2, 2]
    assert [float(g) for g in optimum.value] == pytest.approx([0.4338] * 6, abs=5e-5)
    relative = [float(h - optimum.bias[5]) for h in optimum.bias]
    assert relative == pytest.approx([0.4338, 4.7717, 6.5982, 5, 9.5662, 0], abs=5e-5)


def test_gain_and_bias_of_putermans_two_classes() -> None:
    """Puterman, example 8.2.2, pages 345 and 346: its recurrent states."""
    rows = [[1, 0, 0], [0, F(2, 5), F(3, 5)], [0, F(7, 10), F(3, 10)]]
    optimum = proven(MDP.from_arrays([rows], [[2], [5], [4]]))
    assert optimum.value.tolist() == [2, F(59, 13), F(59, 13)]  # 4.538
    assert optimum.bias.tolist() == [0, F(60, 169), F(-70, 169)]  # 0.354 and -0.416 from 4.538
    assert [float(x) for x in optimum.bias] == pytest.approx([0, 0.354, -0.416], abs=2e-3)


def test_rows_of_floats_mean_what_was_written() -> None:
    wait, cut = [[0.1, 0.9, 0], [0.1, 0, 0.9], [0.1, 0, 0.9]], [[1, 0, 0]] * 3
    mdp = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], 0.5)
    assert proven(mdp).value[0] == 4 * F(9, 10) ** 2
    step = mdp.undiscounted
    assert step.undiscounted is step
    assert (step.discount, step.floats) == (1, True)


# ---- certificates --------------------------------------------------------------------------------


def multichain() -> MDP:
    case = BY_NAME["puterman-multichain-1/2"]
    return Rows(n_states=3, pairs=case.pairs, discount=F(1, 2)).model()


def test_a_policy_of_less_bias_is_found() -> None:
    """Both ways to the end earn its gain; one of them earns 5 on the way."""
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 5)]), (1, 0, [(1, 1, 1)])])
    good, worse = proven(mdp), proven(mdp.with_(table=mdp.table.of_pairs(np.array([0, 0, 2]))))
    changed = replace(worse, model=good.model, mdp=mdp)
    assert changed.violations()[0] == "state 0, action 1: its h is more than is claimed"
    assert good.bias.tolist() == [4, 0]
    assert good.losses[1].tolist() == [5, 0, 0]


def test_a_policy_of_the_same_relative_values_and_less_bias_is_found() -> None:
    """To stay is worth 0; to go and come back earns 1 and costs 1 in turn, but the 1 first."""
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 0, -1)])])
    good = proven(mdp)
    assert good.bias.tolist() == [F(1, 2), F(-1, 2)]
    worse = proven(mdp.with_(table=mdp.table.of_pairs(np.array([0, 0, 2]))))
    changed = replace(worse, model=good.model, mdp=mdp)
    assert changed.violations()[0] == "state 0, action 1: its w is more than is claimed"
    assert worse.bias.tolist() == [0, -1]
