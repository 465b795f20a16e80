"""What no constructor takes for a model: the calls of the table beside this file."""

from fractions import Fraction
from functools import partial
from inspect import signature
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from refusal_tables import refused, table_of_refusals

import exact_mdp
from exact_mdp import MDP, DistributionError, NegativeError, Scenario, ShapeError

HALF, INF = Fraction(1, 2), float("inf")
P = np.array([[[0.5, 0.5, 0.0], [0, 0.25, 0.75], [0, 0, 1]], [[0, 1, 0], [0.5, 0, 0.5], [0, 0, 1]]])
R = np.array([[1.0, 2.0], [3.0, -4.0], [0.0, 0.0]])
EYE = np.eye(2)
SPARSE = sp.csr_array(EYE)
STAYS = sp.csr_array(np.array([[1.0, 0], [1, 0]]))
ALIKE = [np.array([[1.0, 0], [1, 0]])] * 2  # the same in both layouts
TWO = {"a": {"x": {"a": 1}, "y": {"a": 1}}, "b": {"x": {"b": 1}}}
QUADRUPLES = [(0, 0, 1, 1), (0, 1, 0, 1), (1, 0, 1, 1)]
RAGGED = [[[0.5, 0.5], [0, 1]], [[1, 0]]]
CYCLE = [(0, 0, 1, 1), (1, 1, 2, 1), (2, 2, 0, 1)]
THIRDS = np.full((2, 3, 3), 1 / 3)
SINGLE = np.random.default_rng(0).random((1, 9, 9)).astype(np.float32)
SINGLE /= SINGLE.sum(axis=-1, keepdims=True)
ONWARD = sp.csr_array([[1, 1], [0, 1]])
ENDS = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]


def spoiled(action: int, state: int, following: int, value: float) -> Any:
    array = P.copy()
    array[action, state, following] = value
    return array


def damaged(place: int) -> sp.csr_array:
    matrix = sp.csr_array(EYE)
    matrix.indices[1] = place
    return matrix


class Nameless:
    def __repr__(self) -> str:
        return "one"


KINDS = {
    "sum to": DistributionError, "not 1": DistributionError,
    "probability is nan": DistributionError, "probability is -": NegativeError,
    "have shape": ShapeError, "entries in a list": ShapeError, "that are not numbers": ShapeError,
}  # fmt: skip


def explored(start: Any, actions: Any, outcomes: Any) -> MDP:
    def asked(answer: Any) -> Any:
        return answer if callable(answer) else lambda *_: answer

    return MDP.from_function(start, asked(actions), asked(outcomes), max_states=9)


made = partial(MDP.from_arrays, P, R)
BASE = made(0.9)
test_what_is_no_model_is_refused = table_of_refusals(__file__, globals(), KINDS)


def test_an_error_of_the_users_function_stays_what_it_is() -> None:
    broken = KeyError("mine")

    def fails(*_: Any) -> Any:
        raise broken

    def later(*_: Any) -> Any:
        yield from fails()

    for ask in (fails, later):
        for actions, outcomes, where in ((lambda s: ["go"], ask, ", action go"), (ask, fails, "")):
            with pytest.raises(KeyError) as caught:
                MDP.from_function(0, actions, outcomes)
            assert caught.value is broken
            assert broken.__notes__[-1].endswith(f"for state 0{where}")


TAKES_MODEL = (
    "solve certify evaluate check assert_policy_optimal return_distribution simulate train tradeoff"
    " rationalize curve thresholds tornado one_way two_way gradient robust"
)


@pytest.mark.parametrize("name", TAKES_MODEL.split())
def test_an_option_that_there_is_not_is_refused(name: str) -> None:
    function = getattr(exact_mdp, name)
    care = Scenario.load("yuan2025")
    given = (care, "random") if "policy" in signature(function).parameters else (care,)
    said = "no option gamma=", "", "mdp.with_(discount="
    assert refused(lambda: function(*given, gamma=0.9), *said).where
