"""State numbers, their columns and labels: each the inverse of the other."""

from __future__ import annotations

from math import prod

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exact_mdp import Column, ModelError, StateSpace

SPACE = StateSpace(
    columns=(
        Column(name="place", size=3, words=("hall", "kitchen", "bath")),
        Column(name="trial", size=5),
        Column(name="status", size=16, bits=4),
    ),
    extra=("end", "lost"),
)


@st.composite
def spaces(draw: st.DrawFn) -> StateSpace:
    columns = []
    for number in range(draw(st.integers(1, 4))):
        kind, name = draw(st.sampled_from(["plain", "bits", "words"])), f"c{number}"
        if kind == "bits":
            bits = draw(st.integers(1, 3))
            columns.append(Column(name=name, size=2**bits, bits=bits))
        else:
            size = draw(st.integers(1, 4))
            words = tuple(f"w{i}" for i in range(size)) if kind == "words" else ()
            columns.append(Column(name=name, size=size, words=words))
    extra = tuple(f"e{i}" for i in range(draw(st.integers(0, 2))))
    return StateSpace(columns=tuple(columns), extra=extra)


@given(spaces())
def test_numbers_columns_and_labels_agree(space: StateSpace) -> None:
    sizes = [column.size for column in space.columns]
    assert space.regular == prod(sizes)
    assert space.size == prod(sizes) + len(space.extra)
    grid = np.indices(sizes).reshape(len(sizes), -1)
    for column, wanted in zip(space.columns, grid, strict=True):
        values = space.values(column.name)
        assert values.shape == (space.size,)
        assert values[: space.regular].tolist() == wanted.tolist()
        assert (values[space.regular :] == -1).all()
    labels = space.labels(range(space.size))
    assert len(set(labels)) == space.size
    for state in range(space.regular):
        parts = space.as_dict(state)
        parsed = {name: space.column(name).parse(label) for name, label in parts.items()}
        assert list(parts) == list(space.names)
        assert space.index(**parsed) == state
        assert labels[state] == ", ".join(f"{name} {label}" for name, label in parts.items())
    for number, name in enumerate(space.extra, start=space.regular):
        assert labels[number] == name
        assert space.as_dict(number) == {"state": name}


def test_values_of_chosen_states() -> None:
    states = np.array([0, 17, 239, 240, 241])
    assert SPACE.values("place", states).tolist() == [0, 0, 2, -1, -1]
    assert SPACE.values("trial", states).tolist() == [0, 1, 4, -1, -1]
    assert SPACE.values("status", states).tolist() == [0, 1, 15, -1, -1]


def test_columns_that_are_left_out_are_zero() -> None:
    assert SPACE.index(place=1) == 80
    assert SPACE.index() == 0
    assert (
        SPACE.label(SPACE.index(place=1, trial=2, status=5))
        == "place kitchen, trial 2, status 0101"
    )


def test_labels_are_read_with_spaces_around_them() -> None:
    assert SPACE.column("status").parse(" 0100 ") == 4
    assert SPACE.column("place").parse("bath\n") == 2


def test_a_million_states_cost_nothing() -> None:
    space = StateSpace.plain(10**15)
    assert space.label(10**15 - 1) == f"state {10**15 - 1}"
    assert space.index(state=123456789) == 123456789


def test_plain_spaces() -> None:
    assert StateSpace.plain(2).labels([0, 1]) == ["state 0", "state 1"]
    assert StateSpace.plain(2, ["here", "there"]).label(1) == "state there"
    with pytest.raises(ModelError, match="3 state labels for 2 states"):
        StateSpace.plain(2, ["a", "b", "c"])


@pytest.mark.parametrize(
    ("column", "label", "fix"),
    [
        ("status", "010", "4 digits"),
        ("status", "01000", "4 digits"),
        ("status", "0120", "4 digits"),
        ("status", "", "4 digits"),
        ("status", "٠١٠٠", "4 digits"),
        ("trial", "5", "from 0 to 4"),
        ("trial", "-1", "from 0 to 4"),
        ("trial", "1.0", "from 0 to 4"),
        ("trial", "²", "from 0 to 4"),
        ("trial", "9" * 5000, "from 0 to 4"),
        ("place", "kitchn", "kitchen"),
        ("place", "garden", "hall, kitchen, bath"),
    ],
)
def test_labels_that_mean_nothing(column: str, label: str, fix: str) -> None:
    with pytest.raises(ModelError) as caught:
        SPACE.column(column).parse(label)
    assert fix in caught.value.fix
    assert column in caught.value.where


def test_what_does_not_exist() -> None:
    with pytest.raises(ModelError, match="status"):
        SPACE.column("statu")
    with pytest.raises(ModelError, match="unknown state column 'x'"):
        SPACE.index(x=1)
    with pytest.raises(ModelError, match="there is no trial 5: numbers go from 0 to 4"):
        SPACE.index(trial=5)
    for state in (-1, SPACE.size):
        with pytest.raises(ModelError, match="there is no state"):
            SPACE.label(state)
        with pytest.raises(ModelError, match="there is no state"):
            SPACE.as_dict(state)
