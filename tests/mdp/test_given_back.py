"""What a model tells can be given to its constructors: they make the same model."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from model_contents import laws
from strategies import Rows, models

from exact_mdp import MDP, ModelError

THIRD = Fraction(1, 3)


def rows_of(mdp: MDP, order: list[int]) -> list[Any]:
    """Rows for `MDP.from_outcomes`, in any order."""
    return [(int(mdp.pair_state[l]), int(mdp.pair_action[l]), mdp.table.row(l)) for l in order]


MAKERS: dict[str, Callable[..., MDP]] = {
    "arrays": lambda mdp, order, **told: MDP.from_arrays(
        [mdp.P(action) for action in mdp.actions], mdp.R, mdp.discount_exact,
        layout="ass", **told,
    ),
    "pairs": lambda mdp, order, **told: MDP.from_pairs(
        mdp.pair_state, mdp.pair_action, mdp.transition, mdp.reward, mdp.discount_exact, **told
    ),
    "outcomes": lambda mdp, order, **told: MDP.from_outcomes(
        rows_of(mdp, [*range(mdp.n_pairs)]), mdp.discount_exact, **told
    ),
    "with": lambda mdp, order, **told: mdp.with_(**told),
}  # fmt: skip


@pytest.mark.parametrize("maker", MAKERS)
@given(models())
def test_all_that_a_model_tells(maker: str, drawn: Rows) -> None:
    mdp = drawn.model()
    last = mdp.n_states - 1
    flags = np.arange(mdp.n_states) == last
    mdp = mdp.with_(
        start={0: 1} if not last else {0: THIRD, last: 1 - THIRD},
        labels={"last": flags},
        components={"pairs": np.arange(mdp.n_pairs)},
        name="drawn",
    )
    names = ("start", "labels", "name", "sense", "space", "actions", "action_objects", "goal")
    told = {name: getattr(mdp, name) for name in names}
    again = MAKERS[maker](
        mdp, [], **told, components=mdp.components, component_names=mdp.component_names
    )
    for name in ("start", "name", "sense", "space", "actions", "component_names"):
        assert getattr(again, name) == getattr(mdp, name)
    assert again.components.tolist() == mdp.components.tolist()
    assert again.labels["last"].tolist() == flags.tolist()
    assert laws(again).keys() == laws(mdp).keys()
    assert pickle.loads(pickle.dumps(again)).start == mdp.start


def test_a_start_as_it_is_told_goes_by_the_models_order() -> None:
    """Names that are other numbers do not matter; pairs that others wrote go by name."""
    mdp = MDP.from_arrays(
        [np.eye(3)], [0] * 3, states=["2", "0", "1"], start={"1": THIRD, "0": 1 - THIRD}
    )
    assert mdp.start == ((1, 1 - THIRD), (2, THIRD))
    assert mdp.with_(start=mdp.start).start == mdp.start
    with pytest.raises(ModelError, match="in the model's order, which differ"):
        mdp.with_(start=[(1, THIRD), (2, 1 - THIRD)])
    words = MDP.from_arrays([np.eye(2)], [0] * 2, states=["a", "b"])
    assert words.with_(start=[("a", "1/3"), ("b", "2/3")]).start == ((0, THIRD), (1, 1 - THIRD))
    with pytest.raises(ModelError, match="a state appears twice"):
        words.with_(start=[("a", "1/3"), ("a", "2/3")])


def test_a_start_beside_states_that_are_tuples() -> None:
    mdp = MDP.from_function(
        (0, 0), lambda s: ["go"] if s == (0, 0) else [], lambda s, a: [(1, (0, 1), 0)]
    )
    assert mdp.with_(start=mdp.start).start == mdp.start
    assert mdp.with_(start=(0, 1)).start == ((1, Fraction(1)),)
    assert mdp.with_(start=[((0, 1), 1)]).start == ((1, Fraction(1)),)
    with pytest.raises(ModelError, match="may be a state, or a state and its probability"):
        mdp.with_(start=[(0, 1)])
    with pytest.raises(ModelError, match="goes by numbers"):
        MDP.from_function(mdp.start, lambda s: [], lambda s, a: [])
    timed = mdp.within(2)
    assert timed.with_(start=timed.start).start == timed.start


@pytest.mark.parametrize("order", [[0, 1, 2], [2, 0, 1]])
def test_counts_are_given_back_by_the_observations(order: list[int]) -> None:
    """Rows of probabilities and how often each was observed, in any order of the pairs."""
    steps = [("low", "wait", 0, "low"), *[("low", "wait", 1, "high")] * 3, ("low", "go", 5, "high")]
    names = ["episode", "state", "action", "reward", "next_state"]
    frame = pd.DataFrame([(k, *step) for k, step in enumerate(steps)], columns=names)
    mdp = MDP.from_transitions(frame, "9/10")
    assert mdp.n_pairs == len(order)
    assert mdp.observations is not None
    told = {
        "space": mdp.space,
        "actions": mdp.actions,
        "start": mdp.start,
        "episodes": mdp.episodes,
    }
    told["observations"] = mdp.observations[order].tolist()
    for again in (
        MDP.from_outcomes(rows_of(mdp, order), "9/10", **told),
        MDP.from_pairs(
            mdp.pair_state[order], mdp.pair_action[order], mdp.transition[order], mdp.reward[order],
            "9/10", **told,
        ),
    ):  # fmt: skip
        assert again.counts is not None
        assert again.observations is not None
        assert mdp.counts is not None
        assert again.counts.toarray().tolist() == mdp.counts.toarray().tolist()
        assert again.observations.tolist() == mdp.observations.tolist()
    told["observations"] = [3] * 3
    with pytest.raises(ModelError, match="not counts over the observations"):
        MDP.from_outcomes(rows_of(mdp, order), "9/10", **told)
