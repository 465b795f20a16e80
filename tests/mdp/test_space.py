"""State numbers, their columns and labels: each the inverse of the other."""

from math import prod

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from refusal_tables import table_of_refusals

from exact_mdp import Column, StateSpace

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
        kind, name, size = draw(st.sampled_from("pbw")), f"c{number}", draw(st.integers(1, 4))
        if kind == "b":
            columns.append(Column(name=name, size=2**size, bits=size))
        else:
            words = tuple(f"w{i}" for i in range(size)) if kind == "w" else ()
            columns.append(Column(name=name, size=size, words=words))
    extra = tuple(f"e{i}" for i in range(draw(st.integers(0, 2))))
    return StateSpace(columns=tuple(columns), extra=extra)


@given(spaces(), st.data())
def test_numbers_columns_and_labels_agree(space: StateSpace, data: st.DataObject) -> None:
    sizes = [column.size for column in space.columns]
    assert (space.regular, space.size) == (prod(sizes), prod(sizes) + len(space.extra))
    grid = np.indices(sizes).reshape(len(sizes), -1)
    some = np.array(data.draw(st.lists(st.integers(0, space.size - 1), min_size=1)))
    for column, wanted in zip(space.columns, grid, strict=True):
        values = space.values(column.name)
        assert values.tolist() == wanted.tolist() + [-1] * len(space.extra)
        assert space.values(column.name, some).tolist() == values[some].tolist()
    labels = space.labels(range(space.size))
    assert len(set(labels)) == space.size
    assert tuple(labels[space.regular :]) == space.extra
    for state in range(space.regular):
        parts = space.as_dict(state)
        parsed = {name: space.column(name).number(f" {label}\n") for name, label in parts.items()}
        assert list(parts) == list(space.names)
        assert space.index(**parsed) == state
        assert space.index(**{name: n for name, n in parsed.items() if n}) == state
        assert labels[state] == ", ".join(f"{name} {label}" for name, label in parts.items())


def test_labels_are_those_of_the_columns() -> None:
    assert SPACE.label(SPACE.index(place=1, trial=2, status=5)) == (
        "place kitchen, trial 2, status 0101"
    )
    assert SPACE.as_dict(SPACE.size - 1) == {"state": "lost"}
    assert StateSpace.plain(10**15).label(10**15 - 1) == f"state {10**15 - 1}"  # costs nothing
    assert StateSpace.plain(10**15).index(state=123456789) == 123456789
    assert StateSpace.plain(2, ["here", "there"]).label(1) == "state there"


test_what_does_not_exist = table_of_refusals(__file__, globals())
