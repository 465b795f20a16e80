"""Where states stand in a figure, and which signs actions have."""

from collections import namedtuple
from collections.abc import Callable, Collection, Hashable, Iterator
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import grid
from matplotlib.axes import Axes

from exact_mdp import MDP, ModelError, Scenario, check, plots, solve
from exact_mdp.analysis.layout import arrange, cells, symbols


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    plt.close("all")


def texts(ax: Axes) -> dict[tuple[int, int], str]:
    """Return what is written in each cell, by row and column."""
    labels = {}
    for text in ax.texts:
        x, y = text.get_position()
        labels[int(y), int(x)] = text.get_text()
    return labels


STEPS = {"left": (0, -1), "down": (1, 0), "right": (0, 1), "up": (-1, 0)}
Cell = namedtuple("Cell", "along above key")


def world(
    size: tuple[int, int], made: Callable[..., Hashable], walls: Collection[tuple[int, int]] = ()
) -> MDP:
    """A grid whose last corner holds a key and whose first is the way out, with a risk of loss."""
    cells = {(r, c) for r in range(size[0]) for c in range(size[1])} - {*walls}
    place = {made(r, c, key): (r, c, key) for r, c in cells for key in (False, True)}

    def actions(state: Hashable) -> list[str]:
        return [] if state == "lost" or place[state] == (0, 0, True) else [*STEPS]

    def outcomes(state: Hashable, action: str) -> list[tuple[str, Hashable, int]]:
        r, c, key = place[state]
        down, right = STEPS[action]
        r, c = (r + down, c + right) if (r + down, c + right) in cells else (r, c)
        key |= (r, c) == (size[0] - 1, size[1] - 1)
        return [("9/10", made(r, c, key), -1), ("1/10", "lost", -9)]

    return MDP.from_function(made(0, 0, False), actions, outcomes, "9/10")


@settings(max_examples=20, deadline=None)
@given(
    size=st.tuples(st.integers(2, 4), st.integers(2, 4)),
    signs=st.tuples(st.sampled_from([-1, 1]), st.sampled_from([-1, 1])),
    order=st.permutations(range(3)),
)
def test_an_arrow_points_at_the_cell_that_it_leads_to(size, signs, order) -> None:
    """Whichever part of a tuple is the row, and whichever way it counts."""

    def made(r: int, c: int, key: bool) -> tuple[object, ...]:
        parts = (signs[0] * r + 7, signs[1] * c - 20, key)
        return tuple(parts[k] for k in order)

    mdp = world(size, made)
    layout, things = arrange(mdp), mdp.space.columns[0].objects
    assert layout.shown.tolist() == [s for s in range(mdp.n_states) if things[s] != "lost"]
    for state in layout.shown.tolist():
        said = f"{layout.rows[layout.row[state]]}, {layout.columns[layout.column[state]]}"
        assert sorted(said.split(", ")) == sorted(map(str, things[state]))
    for pair in np.flatnonzero(~mdp.terminal[mdp.pair_state]).tolist():
        state, to = mdp.pair_state[pair], max(mdp.table.row(pair))[1]
        if to != state and things[to][order.index(2)] == things[state][order.index(2)]:
            step = (layout.row[to] - layout.row[state], layout.column[to] - layout.column[state])
            assert step == STEPS[mdp.actions[mdp.pair_action[pair]]]


@pytest.mark.parametrize(("step", "sign"), [((1, 1), "up"), ((1, 0), "up"), ((-1, 0), "↑")])
def test_an_arrow_that_points_elsewhere_is_a_name(step: tuple[int, int], sign: str) -> None:
    """A first part that "up" raises and that stands downwards, with a second that moves along."""

    def after(s: tuple[int, int], a: str) -> tuple[int, int]:
        return s[0] + step[0] * (a == "up"), s[1] + (step[1] if a == "up" else 1)

    def actions(s: tuple[int, int]) -> list[str]:
        return ["up", "stay"] if abs(s[0]) < 3 and s[1] < 3 else []

    mdp = MDP.from_function((0, 0), actions, lambda s, a: [(1, after(s, a), 1)], "1/2")
    assert arrange(mdp).signs == (sign, "stay")
    assert {*texts(plots.plot_policy(mdp, "always:up")).values()} == {sign, "∎"}


def test_the_parts_of_a_tuple_are_columns(tmp_path: Path) -> None:
    walls = {(1, 1), (2, 1)}
    mdp = world((4, 3), lambda r, c, key: Cell(along=c, above=-r, key=key), walls)
    ax = solve(mdp).plot(key=True)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("along", "above")
    assert {*np.ndindex(4, 3)} - texts(ax).keys() == walls
    assert [label.get_text() for label in ax.get_yticklabels()] == ["0", "-1", "-2", "-3"]
    ax = plots.plot_policy(mdp, "optimal", down="along", across=["key", "above"])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("key, above", "along")
    mdp = world((4, 3), lambda r, c, key: (key, c, -r), walls)
    mdp.save(tmp_path / "m.npz")
    layout, read = arrange(mdp), arrange(MDP.load(tmp_path / "m.npz"))
    assert (
        (layout.down, layout.across)
        == (read.down, read.across)
        == ("state[2]", "state[0], state[1]")
    )
    assert (layout.row == read.row).all()
    assert (layout.column == read.column).all()


@pytest.mark.parametrize(
    "states",
    [[(0, 1), (0, 1, 2)], ["a", (0, 1)], [(k, k) for k in range(9)], ["a", "b"], [(0,), (1,)]],
    ids=["lengths", "others go on", "mostly empty", "words", "one part"],
)
def test_what_makes_no_map_is_listed(states: list[Hashable]) -> None:
    mdp = MDP.from_function(
        states[0],
        lambda state: ["go"],
        lambda state, action: [(1, states[(states.index(state) + 1) % len(states)], 1)],
        "1/2",
    )
    assert arrange(mdp).listed
    with pytest.raises(ModelError, match="as they were found"):
        arrange(mdp, shape=(1, len(states)))


@pytest.mark.parametrize(
    "words", [{}, {"across": ["trial"]}, {"down": ["status"], "across": ["trial", "subtask"]}]
)
def test_every_state_has_a_place_of_its_own(words: dict[str, list[str]]) -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()
    layout = arrange(mdp, **words)
    places = set(zip(layout.row[layout.shown], layout.column[layout.shown], strict=True))
    assert len(places) == len(layout.shown) == mdp.space.regular
    assert len(layout.rows) * len(layout.columns) == mdp.space.regular


def test_a_part_is_shown_by_its_columns() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()
    part = arrange(mdp, subtask=1, trial=0)
    assert (len(part.shown), part.rows, part.columns) == (16, *[("00", "01", "10", "11")] * 2)
    for state in part.shown:
        at = mdp.space.as_dict(state)
        assert at["status"] == part.rows[part.row[state]] + part.columns[part.column[state]]
        assert str(at["subtask"]) == "1"
    for bad in ({"subtask": 5}, {"nothing": 0}, {"shape": (3, 4)}):
        with pytest.raises(ModelError):
            arrange(mdp, **bad)
    tea = Scenario.load("tea").compile()
    one, two = arrange(tea, down="subtask", trial=0), arrange(tea, down=["subtask"], trial=0)
    assert (one.down, one.across, one.rows) == (two.down, two.across, two.rows)
    assert (one.row == two.row).all()


@pytest.mark.parametrize(
    ("actions", "expected"),
    [
        ("UP down Left right", "↑↓←→"),
        ("north east south west", "↑→↓←"),
        ("u d l r", "↑↓←→"),
        ("s m", "sm"),
        ("stop go", ["stop", "go"]),
        ("repair a0", ["a0", "a1"]),  # where some names are long, "a1" must not be a name too
    ],
)
def test_signs_of_actions(actions: str, expected: str | list[str]) -> None:
    assert symbols(actions.split()) == list(expected)


def test_an_audit_marks_exactly_what_is_wrong() -> None:
    mdp = grid(3, 3)
    audit = check(mdp, [2, 2, 1, 0, 2, 1, 2, 2, 0])  # goes left from the cell (1, 0)
    marked = {place for place, text in texts(audit.plot(shape=(3, 3))).items() if "✗" in text}
    assert marked == {divmod(each.state, 3) for each in audit.disagreements} == {(1, 0)}
    (wrong,) = (
        each for row in cells(audit, arrange(mdp, shape=(3, 3))) for each in row
        if each is not None and each.kind == "wrong"
    )  # fmt: skip
    assert (wrong.text, wrong.small) == ("✗ ←", "↓/→")
    assert "yours LEFT, optimal DOWN or RIGHT" in wrong.title


def test_a_listed_state_is_named_apart_from_its_actions() -> None:
    """Numbers of actions and of states do not stand side by side; a wrong state is never grey."""
    moves = [(s, a, [(1, 3, a)]) for s in range(3) for a in (0, 1)] + [(3, 0, [(1, 3, 0)])]
    audit = check(MDP.from_outcomes(moves, discount="1/2"), [0, 1, 0, 0])  # begins in state 0
    layout = arrange(audit.mdp)
    shown = [each for row in cells(audit, layout) for each in row if each is not None]
    assert [(each.name, each.text, each.small, each.kind) for each in shown] == [
        ("0", "✗ 0", "1", "wrong"),
        ("1", "1", "", "idle"),
        ("2", "✗ 0", "1", "wrong"),
        ("3", "∎", "", "idle"),
    ]
    ax = audit.plot()
    assert [text.get_text() for text in ax.texts[:2]] == ["✗ 0\n1", "0"]
    words = " ".join(text.get_text() for text in ax.get_legend().get_texts())
    assert "∎ an episode ends" in words
    assert "grey sign: not wrong" in words
