"""Where states stand in a picture, and which signs actions have."""

from collections import namedtuple
from collections.abc import Callable, Collection, Hashable
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from xml.etree import ElementTree

import matplotlib.pyplot as plt
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import grid
from matplotlib.axes import Axes
from picture_texts import legend_of, texts, texts_of

from exact_mdp import MDP, ModelError, Scenario, check, load, plots, solve

STEPS = {"left": (0, -1), "down": (1, 0), "right": (0, 1), "up": (-1, 0)}
Cell = namedtuple("Cell", "along above key")
WALLS = {(1, 1), (2, 1)}
CARE = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()


def labels(ax: Axes) -> tuple[list[str], list[str]]:
    """Return the names of the rows and of the columns."""
    down, across = ax.get_yticklabels(), ax.get_xticklabels()
    return texts_of(down), texts_of(across)


def numbered(mdp: MDP, **place: object) -> dict[int, tuple[int, int]]:
    """Return the cell in which a picture shows each state."""
    ax = plots.plot_states(mdp, np.arange(mdp.n_states), **place)
    return {int(text.split("\n")[-1]): cell for cell, text in texts(ax).items()}


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


@settings(max_examples=20)
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
    things, cells = mdp.space.columns[0].objects, numbered(mdp)
    assert sorted(cells) == [s for s in range(mdp.n_states) if things[s] != "lost"]
    rows, columns = labels(plots.plot_policy(mdp, "random"))
    for state, (row, column) in cells.items():
        parts = f"{rows[row]}, {columns[column]}".split(", ")
        assert sorted(parts) == sorted(map(str, things[state]))
    for pair in np.flatnonzero(~mdp.terminal[mdp.pair_state]).tolist():
        state, to = int(mdp.pair_state[pair]), max(mdp.table.row(pair))[1]
        if to != state and things[to][order.index(2)] == things[state][order.index(2)]:
            step = tuple(np.subtract(cells[to], cells[state]))
            assert step == STEPS[mdp.actions[mdp.pair_action[pair]]]
    plt.close("all")


@pytest.mark.parametrize(
    ("step", "sign"), [((1, 1), "up"), ((1, 0), "up"), ((-1, 1), "up"), ((-1, 0), "↑")]
)
def test_an_arrow_that_points_elsewhere_is_a_name(step: tuple[int, int], sign: str) -> None:
    """A first part that "up" raises and that stands downwards, with a second that moves along."""

    def after(s: tuple[int, int], a: str) -> tuple[int, int]:
        return s[0] + step[0] * (a == "up"), s[1] + (step[1] if a == "up" else 1)

    def actions(s: tuple[int, int]) -> list[str]:
        return ["up", "stay"] if abs(s[0]) < 3 and s[1] < 3 else []

    mdp = MDP.from_function((0, 0), actions, lambda s, a: [(1, after(s, a), 1)], "1/2")
    for name, shown in (("up", sign), ("stay", "stay")):
        assert {*texts(plots.plot_policy(mdp, f"always:{name}")).values()} == {shown, "∎"}


def test_the_parts_of_a_tuple_are_columns(tmp_path: Path) -> None:
    mdp = world((4, 3), lambda r, c, key: Cell(along=c, above=-r, key=key), WALLS)
    ax = solve(mdp).plot(key=True)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("along", "above")
    assert {*np.ndindex(4, 3)} - texts(ax).keys() == WALLS
    assert labels(ax)[0] == ["0", "-1", "-2", "-3"]
    ax = plots.plot_policy(mdp, "optimal", down="along", across=["key", "above"])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("key, above", "along")
    mdp = world((4, 3), lambda r, c, key: (key, c, -r), WALLS)
    mdp.save(tmp_path / "m.npz")
    for each in (mdp, load(tmp_path / "m.npz")):
        ax = plots.plot_policy(each, "random")
        assert (ax.get_ylabel(), ax.get_xlabel()) == ("state[0], state[2]", "state[1]")
        assert numbered(each) == numbered(mdp)


@pytest.mark.parametrize(
    "states",
    [[(0, 1), (0, 1, 2)], ["a", (0, 1)], [(k, k) for k in range(9)], ["a", "b"], [(0,), (1,)]],
    ids=["lengths", "others go on", "mostly empty", "words", "one part"],
)
def test_what_makes_no_map_is_listed(states: list[Hashable]) -> None:
    after = dict(zip(states, states[1:] + states[:1], strict=True))
    mdp = MDP.from_function(states[0], lambda s: ["go"], lambda s, a: [(1, after[s], 1)], "1/2")
    names = [mdp.space.label(state).removeprefix("state ") for state in range(mdp.n_states)]
    assert labels(plots.plot_policy(mdp, "random"))[0] == names
    with pytest.raises(ModelError, match="as they were found"):
        solve(mdp).plot(shape=(1, len(states)))


@pytest.mark.parametrize(
    "words", [{}, {"across": ["trial"]}, {"down": ["status"], "across": ["trial", "subtask"]}]
)
def test_every_state_has_a_place_of_its_own(words: dict[str, list[str]]) -> None:
    ax = plots.plot_policy(CARE, "random", **words)
    rows, columns = labels(ax)
    assert len(ax.texts) == len(texts(ax)) == len(rows) * len(columns) == CARE.space.regular
    one_row = plots.plot_policy(CARE, "random", across=CARE.space.names)  # too narrow for texts
    drawn = {(int(cell.get_y()), int(cell.get_x())) for cell in one_row.patches}
    assert drawn == {(0, place) for place in range(CARE.space.regular)}


def test_a_part_is_shown_by_its_columns() -> None:
    rows, columns = labels(plots.plot_policy(CARE, "random", subtask=1, trial=0))
    assert rows == columns == ["00", "01", "10", "11"]
    part = numbered(CARE, subtask=1, trial=0)
    assert len(part) == 16
    for state, (row, column) in part.items():
        at = CARE.space.as_dict(state)
        assert (at["status"], str(at["subtask"])) == (rows[row] + columns[column], "1")
    tea = Scenario.load("tea").compile()
    assert numbered(tea, down="subtask", trial=0) == numbered(tea, down=["subtask"], trial=0)


@pytest.mark.parametrize(
    ("actions", "signs"),
    [
        ("UP down Left right", "↑ ↓ ← →"),
        ("north east south west", "↑ → ↓ ←"),
        ("u d l r", "↑ ↓ ← →"),
        ("s m", "s m"),
        ("stop go", "stop go"),
        ("repair a0", "a0 a1"),  # where some names are long, "a1" must not be a name too
    ],
)
def test_signs_of_actions(actions: str, signs: str) -> None:
    names = actions.split()
    rows = [(0, action, [(1, 0, 1)]) for action in range(len(names))]
    mdp = MDP.from_outcomes(rows, "1/2", actions=names)
    pictures = [plots.plot_policy(mdp, [action]) for action in range(len(names))]
    assert [ax.texts[0].get_text() for ax in pictures] == signs.split()


def test_an_audit_marks_exactly_what_is_wrong() -> None:
    audit = check(grid(3, 3), [2, 2, 1, 0, 2, 1, 2, 2, 0])  # goes left from the cell (1, 0)
    assert [each.state for each in audit.disagreements] == [3]
    marked = {c: text for c, text in texts(audit.plot(shape=(3, 3))).items() if "✗" in text}
    assert marked == {(1, 0): "✗ ←\n↓/→"}


def test_a_listed_state_is_named_apart_from_its_actions() -> None:
    """Numbers of actions and of states do not stand side by side; a wrong state is never grey."""
    moves = [(s, a, [(1, 3, a)]) for s in range(3) for a in (0, 1)] + [(3, 0, [(1, 3, 0)])]
    audit = check(MDP.from_outcomes(moves, discount="1/2"), [0, 1, 0, 0])  # begins in state 0
    ax = audit.plot()
    shown = texts_of(ax.texts)
    assert shown == ["✗ 0\n1", "0", "1", "1", "✗ 0\n1", "2", "∎", "3"]
    begins, idle, wrong = (ax.texts[2 * state].get_color() for state in range(3))
    assert begins == wrong != idle
    words = " ".join(legend_of(ax))
    assert "∎ an episode ends" in words
    assert "grey sign: not wrong" in words


def test_names_stay_text(tmp_path: Path) -> None:
    """Dollar signs, angle brackets and quotes are letters of a name: no formula, no element."""
    names = ["from $x^$ to $y$", "<script>&\"'", "$\\frac$", "</text>"]
    rows = [(state, 0, [(1, min(state + 1, 3), 1)]) for state in range(4)]
    mdp = MDP.from_outcomes(rows, "1/2", states=names, actions=["$a_$"], name="$m^$")
    with plots.style():
        plots.plot_policy(mdp, "random").figure.savefig(tmp_path / "names.svg")
    root = ElementTree.parse(tmp_path / "names.svg").getroot()
    texts = {"".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {*names, "$a_$"} <= texts
    assert any("$m^$" in text for text in texts)
    assert not list(root.iter("{http://www.w3.org/2000/svg}script"))
    for module in iter_modules(plots.__path__):  # and every figure is drawn so
        for name, function in vars(import_module(f"{plots.__name__}.{module.name}")).items():
            assert not name.startswith("plot_") or hasattr(function, "__wrapped__"), name


def test_a_horizon_has_a_row_for_each_state_and_a_column_for_each_time() -> None:
    """The loss of a state at a time is the fill of its cell; `time=0` draws the grid again."""
    lake = MDP.from_gymnasium("FrozenLake-v1")
    audit = check(lake, "always:DOWN", horizon=4)
    ax = audit.plot()
    rows, columns = labels(ax)
    assert (len(rows), rows[:2], columns) == (16, ["0, 0", "0, 1"], [*"01234"])
    assert (ax.get_ylabel(), ax.get_xlabel()) == ("row, column", "time")
    wrong = {cell for cell, text in texts(ax).items() if text.startswith("✗")}
    assert wrong == {(each.state % 16, each.state // 16) for each in audit.disagreements}
    assert labels(audit.plot(time=0)) == ([*"0123"], [*"0123"])
    assert labels(audit.plot(down="time", across=["row", "column"]))[0] == [*"01234"]
    # All moves go on by one in time, which is not the way of an arrow.
    words, arrows = (
        {*"←↓→↑"} & {*"".join(texts(each).values())} for each in (ax, audit.plot(time=0))
    )
    assert not words
    assert "↓" in arrows
