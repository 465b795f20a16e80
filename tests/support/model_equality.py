"""When two models are the same: every exact number, name and label."""

from __future__ import annotations

from typing import Any

import numpy as np

from exact_mdp import MDP


def assert_same(left: MDP, right: MDP) -> None:
    """Fail unless both models hold the same arrays, of the same types, and the same names."""
    for name in ("offsets", "next", "weight", "denominator", "gain", "gain_denominator", "event"):
        ours, theirs = getattr(left.table, name), getattr(right.table, name)
        assert (ours is None) == (theirs is None), name
        if ours is not None:
            same_array(ours, theirs, name)
    for name in ("pair_state", "pair_action", "reward", "components", "pair_offsets"):
        same_array(getattr(left, name), getattr(right, name), name)
    assert (left.observations is None) == (right.observations is None)
    if left.counts is not None and right.counts is not None:
        same_array(left.observations, right.observations, "observations")
        same_array(left.counts.toarray(), right.counts.toarray(), "counts")
    for name in ("data", "indices", "indptr"):
        same_array(getattr(left.transition, name), getattr(right.transition, name), name)
    for name in (
        "space", "actions", "discount_exact", "start", "component_names", "events", "name",
        "parameters", "time_limit", "episodes",
    ):  # fmt: skip
        assert getattr(left, name) == getattr(right, name), name


def same_array(ours: Any, theirs: Any, name: str) -> None:
    assert ours.dtype == theirs.dtype, name
    assert ours.shape == theirs.shape, name
    assert np.array_equal(ours, theirs), name
    if ours.dtype == object:
        assert {type(value) for value in theirs} == {int}, name
