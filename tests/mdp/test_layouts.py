"""Whether actions or states come first in P: what the shape does not say is asked for."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from model_contents import laws

from exact_mdp import MDP, DistributionError, ModelError, Policy, ShapeError, certify, check

ROWS = ([1, 0], [0, 1], [0.5, 0.5])
CUBES = [np.array(rows).reshape(2, 2, 2) for rows in product(ROWS, repeat=4)]
REWARDS = [[1, 2], [3, 5]]


def objects(matrices: Any) -> Any:
    array = np.empty(len(matrices), dtype=object)
    array[:] = [*matrices]
    return array


FORMS: dict[str, Callable[[Any], Any]] = {
    "array": np.array,
    "list": lambda P: np.asarray(P).tolist(),
    "fractions": lambda P: np.vectorize(Fraction, otypes=[object])(P),
    "sparse": lambda P: [sp.csr_array(matrix) for matrix in P],
    "array of matrices": objects,
    "np.matrix": lambda P: [np.asarray(matrix).view(np.matrix) for matrix in P],
    "dictionary": lambda P: dict(enumerate(P)),
    "dictionary of np.matrix": lambda P: {
        k: np.asarray(matrix).view(np.matrix) for k, matrix in enumerate(P)
    },
    "dictionary of sparse": lambda P: {k: sp.csc_array(matrix) for k, matrix in enumerate(P)},
    "dictionary of lists": lambda P: dict(enumerate(np.asarray(P).tolist())),
}


@pytest.mark.parametrize("form", FORMS)
def test_as_many_actions_as_states_need_a_layout_where_it_matters(form: str) -> None:
    """All P of two states and two actions with rows from a few: each reading against its pairs."""
    state, action = [0, 0, 1, 1], [0, 1, 0, 1]
    for P in CUBES:
        by_action = MDP.from_pairs(
            state, action, P.transpose(1, 0, 2).reshape(4, 2), np.ravel(REWARDS), "9/10"
        )
        by_state = MDP.from_pairs(state, action, P.reshape(4, 2), np.ravel(REWARDS), "9/10")
        given = FORMS[form](P)
        for layout, wanted in (("ass", by_action), ("sas", by_state)):
            found = MDP.from_arrays(given, REWARDS, "9/10", layout=layout)
            assert laws(found) == laws(wanted)
        if laws(by_action) == laws(by_state):
            assert laws(MDP.from_arrays(given, REWARDS, "9/10")) == laws(by_action)
        else:
            with pytest.raises(ModelError, match="as many actions as states") as caught:
                MDP.from_arrays(given, REWARDS, "9/10")
            assert 'layout="sas"' in caught.value.fix
            assert 'layout="ass"' in caught.value.fix


@pytest.mark.parametrize("form", FORMS)
def test_elsewhere_the_shape_says_the_layout(form: str) -> None:
    """Three actions, two states; a stated layout is checked, of rewards as well."""
    P = np.array([[[0.5, 0.5], [0, 1]], [[1, 0], [0, 1]], [[0, 1], [1, 0]]])
    R = np.arange(12.0).reshape(3, 2, 2)
    given, rewards = FORMS[form](P), FORMS[form](R)
    wanted = laws(MDP.from_arrays(P, R, layout="ass"))
    assert laws(MDP.from_arrays(given, rewards)) == wanted
    assert laws(MDP.from_arrays(given, rewards, layout="ass")) == wanted
    with pytest.raises(ModelError):
        MDP.from_arrays(given, rewards, layout="sas")
    with pytest.raises(ShapeError, match="rewards have shape"):
        MDP.from_arrays(given, R.transpose(1, 0, 2), layout="ass")


def test_an_optimal_policy_passes_in_the_layout_that_was_meant() -> None:
    """(S, A, S) was read as (A, S, S), and an optimal policy failed, certified."""
    P = np.array([[[1, 0], [0, 1]], [[1, 0], [1, 0]]])
    mdp = MDP.from_arrays(P, [0, 1], "9/10", layout="sas")
    assert check(mdp, Policy.of(mdp, certify(mdp).policy)).passed
    with pytest.raises(ModelError, match="the models differ"):
        MDP.from_arrays(P, [0, 1], "9/10")


def test_rewards_of_transitions_follow_the_layout() -> None:
    """P is the same in both, its rewards are not."""
    P, R = np.full((2, 2, 2), 0.5), np.arange(8.0).reshape(2, 2, 2)
    with pytest.raises(ModelError, match="as many actions as states"):
        MDP.from_arrays(P, R)
    assert MDP.from_arrays(P, R, layout="ass").reward.tolist() == [0.5, 4.5, 2.5, 6.5]
    assert MDP.from_arrays(P, R, layout="sas").reward.tolist() == [0.5, 2.5, 4.5, 6.5]
    assert MDP.from_arrays(P, R + R.transpose(1, 0, 2)).reward.tolist() == [1, 7, 7, 13]


@pytest.mark.parametrize(
    ("row", "what"),
    [([7, 7], "sum to 14"), ([0, 0.9], r"sum to 0\.9"), ([0, np.nan], "is nan"),
     ([-0.5, 1.5], r"is -0\.5"), ([0, 0], "sum to 0")],
)  # fmt: skip
def test_a_faulty_row_does_not_say_the_layout(row: list[float], what: str) -> None:
    """What is not offered may hold anything; what is offered in the other layout may be a fault."""
    P = np.array([[[1, 0], row], [[0, 1], [0, 1]]])
    R = np.array([[1, -np.inf], [2, 3]])
    wanted = MDP.from_pairs([0, 1, 1], [0, 0, 1], [[1, 0], [0, 1], [0, 1]], [1, 2, 3])
    for layout, given in (("sas", P), ("ass", P.transpose(1, 0, 2))):
        assert laws(MDP.from_arrays(given, R, layout=layout)) == laws(wanted)
        with pytest.raises(DistributionError, match=what) as caught:
            MDP.from_arrays(given, R)
        assert f'layout="{layout}"' in caught.value.fix
        assert "(state 1)" in caught.value.where


def test_matrices_by_the_name_of_an_action() -> None:
    """The keys are actions where the matrices are square and not as many as the states."""
    stay, go = np.eye(3), np.roll(np.eye(3), 1, axis=1)
    wanted = laws(MDP.from_arrays([stay, go], [[1, 4], [2, 5], [3, 6]]))
    P = {"stay": stay, "go": go}
    R: Any
    for R in ([[1, 4], [2, 5], [3, 6]], {"stay": [1, 2, 3], "go": [4, 5, 6]}):
        mdp = MDP.from_arrays(P, R)
        assert mdp.actions == ("stay", "go")
        assert {(s, "01"[mdp.action(a)]): law for (s, a), law in laws(mdp).items()} == wanted
    assert MDP.from_arrays(P, {0: 7, 1: 8, 2: 9}).reward.tolist() == [7, 7, 8, 8, 9, 9]
    moves = MDP.from_arrays(P, {"stay": 2 * stay, "go": 3 * go})
    assert moves.reward.tolist() == [2, 3] * 3
    for R in ({"stay": 1, "go": 2}, {"stay": [1, 2], "go": [3, 4]}, {0: [1, 2], 1: [3, 4]}):
        with pytest.raises(ModelError, match="the rewards are a dictionary") as caught:
            MDP.from_arrays(P, R)
        assert caught.value.where == "R"


def test_missing_rows_of_lists_go_by_the_layout_as_well() -> None:
    """A row that is None is not offered: of a state and an action, or of an action and a state."""
    P = [[[1, 0], None], [[0, 1], [1, 0]]]
    with pytest.raises(ModelError, match="as many actions as states"):
        MDP.from_arrays(P, [5, 7])
    by_state = MDP.from_arrays(P, [5, 7], layout="sas")
    assert by_state.R.tolist() == [[5, -np.inf], [7, 7]]
    by_action = MDP.from_arrays(P, [5, 7], layout="ass")
    assert by_action.R.tolist() == [[5, 5], [-np.inf, 7]]


@pytest.mark.parametrize("P", [[(0, 0, 0, 1)], {0: {0: {0: 1}}}, {(0, 0): {0: 1}}])
def test_what_names_its_keys_is_in_no_other_layout(P: Any) -> None:
    with pytest.raises(ModelError, match="are not 'ass'") as caught:
        MDP.from_arrays(P, [1], layout="ass")
    assert caught.value.where == "layout"
