"""Pictures of any model: what stands in a cell, at a bar, at an edge is what was computed."""

from __future__ import annotations

import re
from collections import namedtuple
from collections.abc import Callable, Collection, Hashable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from forest import forest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.axes import Axes
from random_models import dense

from exact_mdp import (
    MDP,
    Certificate,
    ModelError,
    Scenario,
    certify,
    check,
    compare,
    curve,
    evaluate,
    plots,
    return_distribution,
    solve,
)
from exact_mdp.analysis.gate.cells import cells
from exact_mdp.analysis.graph import dot
from exact_mdp.analysis.layout import arrange

mpl.use("Agg")
MOVES = ["LEFT", "DOWN", "RIGHT", "UP"]


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    yield
    plt.close("all")


def grid(rows: int, columns: int) -> MDP:
    """A grid world in which each step costs 1, and which ends in its last cell."""
    goal, listed = rows * columns - 1, []
    for state in range(goal):
        r, c = divmod(state, columns)
        for action, (down, right) in enumerate([(0, -1), (1, 0), (0, 1), (-1, 0)]):
            to = min(max(r + down, 0), rows - 1), min(max(c + right, 0), columns - 1)
            listed.append((state, action, [(1, to[0] * columns + to[1], -1)]))
    listed.append((goal, 0, [(1, goal, 0)]))
    return MDP.from_outcomes(listed, discount="9/10", actions=MOVES)


def texts(ax: Axes) -> dict[tuple[int, int], str]:
    """Return what is written in each cell, by row and column."""
    found = {}
    for text in ax.texts:
        x, y = text.get_position()
        found[int(y), int(x)] = text.get_text()
    return found


@given(st.integers(1, 4), st.integers(2, 4))
def test_every_cell_shows_its_states_value_and_action(rows: int, columns: int) -> None:
    mdp = grid(rows, columns)
    solution = solve(mdp)
    shown = texts(solution.plot(shape=(rows, columns)))
    assert len(shown) == mdp.n_states
    for state in range(mdp.n_states - 1):
        arrow, value = shown[divmod(state, columns)].split("\n")
        assert arrow == "←↓→↑"[solution.policy[state]]
        assert float(value) == pytest.approx(solution.value[state], rel=5e-3)
    assert shown[rows - 1, columns - 1] == "∎\n0"
    plt.close("all")


def test_bars_where_states_are_only_numbered() -> None:
    solution = solve(forest("24/25"))
    ax = solution.plot()
    assert [bar.get_height() for bar in ax.patches] == pytest.approx(solution.value.tolist())
    assert certify(forest("24/25")).plot().patches[0].get_height() == pytest.approx(74.6496)
    assert ax.get_ylabel() == "value (reward)"


def test_a_map_over_any_two_columns() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()
    visits = evaluate(mdp, "random").plot(visits=True, down=["trial"], across=["subtask"], status=4)
    expected = evaluate(mdp, "random").visits
    found = texts(visits)
    assert (visits.get_xlabel(), visits.get_ylabel()) == ("subtask", "trial")
    for (trial, subtask), text in found.items():
        number = float(text.rpartition("\n")[2])
        state = mdp.space.index(subtask=subtask, trial=trial, status=4)
        assert number == pytest.approx(expected[state], rel=5e-3)
    policy = plots.plot_policy(mdp, "always:directive", subtask=1)
    assert set(texts(policy).values()) == {"a3"}
    assert len(texts(policy)) == 32


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
    assert arrange(mdp).signs == (sign, "a1")
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
    ("place", "message"),
    [
        ({"down": "nonsense"}, "unknown state column 'nonsense'"),
        ({"across": ["rubbish"]}, "unknown state column 'rubbish'"),
        ({"foo": 3}, "unknown state column 'foo'"),
        ({"shape": (2, 3), "down": "state"}, "a shape and columns"),
    ],
)
def test_places_that_no_model_has(place: dict[str, object], message: str) -> None:
    for model in (grid(2, 3), forest("9/10")):
        with pytest.raises(ModelError, match=message):
            solve(model).plot(**place)


def test_one_column_needs_no_list() -> None:
    tea = Scenario.load("tea").compile()
    one, two = arrange(tea, down="subtask", trial=0), arrange(tea, down=["subtask"], trial=0)
    assert (one.down, one.across, one.rows) == (two.down, two.across, two.rows)
    assert (one.row == two.row).all()


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
    for words in ("∎ an episode ends", "in the corner the state", "not wrong and never visited"):
        assert words in " ".join(ax.get_title().split())


def test_values_beyond_all_bounds_are_written() -> None:
    shown = texts(plots.plot_states(grid(1, 3), [np.inf, -np.inf, np.nan], shape=(1, 3)))
    assert [shown[0, column] for column in range(3)] == ["inf", "-inf", "∎\nnan"]
    ax = plots.plot_states(grid(1, 3), [np.inf, -np.inf, 1.0])
    ax.figure.canvas.draw()
    assert [text.get_text().strip() for text in ax.texts] == ["inf", "-inf", ""]


@pytest.mark.parametrize(
    ("draw", "message"),
    [
        (lambda: plots.plot_states(grid(2, 2), [1.0]), "values of shape"),
        (
            lambda: plots.plot_states(grid(80, 60), np.zeros(4800), shape=(80, 60)),
            "a map of 4,800 cells",
        ),
        (lambda: plots.plot_transitions(grid(7, 7)), "a graph of 49 states"),
        (lambda: dot(grid(15, 15)), "a graph of 225 states"),
        (lambda: compare(grid(2, 2), {}), "no policies"),
    ],
)
def test_what_cannot_be_drawn_is_refused(draw: Callable[[], object], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        draw()


def test_a_certificate_from_a_file_says_that_it_has_no_model(tmp_path: object) -> None:
    certify(forest("9/10")).save(f"{tmp_path}/proof.json")
    with pytest.raises(ModelError, match="does not contain the model"):
        Certificate.load(f"{tmp_path}/proof.json").plot()


def test_policies_side_by_side_have_their_exact_values() -> None:
    mdp = forest("24/25")
    found = compare(mdp, {"wait": [0, 0, 0], "wrong": [0, 1, 1], "mixed": "random"})
    exact = {row.policy: row.exact for row in found.frame().itertuples()}
    assert exact["wait"] == certify(mdp).start_value == found.value.value
    assert exact["wrong"] == Fraction(10800, 932)
    assert float(exact["mixed"]) == pytest.approx(evaluate(mdp, "random").mean)
    bars = [bar.get_width() for bar in found.plot().patches]
    assert bars == pytest.approx([float(value) for value in exact.values()])


def test_bounds_of_a_large_comparison_hold() -> None:
    mdp = grid(15, 15)  # one cycle of 224 states
    found = compare(mdp, {"down": "always:DOWN", "best": "optimal"})
    assert found.claim == "bounded"
    assert found.frame()["exact"].isna().all()
    exact = {"down": -10, "best": -10 * (1 - Fraction(9, 10) ** 28)}  # for ever; 28 steps
    for name, each in found.regrets.items():
        low, high = each.learned.interval
        assert low <= exact[name] <= high


def test_a_value_function_is_drawn_by_its_exact_values() -> None:
    mdp = forest("24/25")
    found = curve(mdp, "discount", ("1/2", "9/10"), policy=[0, 1, 1])
    ax = found.plot(n=5)
    for line in ax.lines:
        fixed = line.get_linestyle() == "--"
        for x, y in zip(*line.get_data(), strict=True) if len(line.get_xdata()) == 5 else ():
            changed = mdp.with_(discount=x)
            best = evaluate(changed, [0, 1, 1]).mean if fixed else solve(changed).start_value
            assert y == pytest.approx(best)
    assert [line.get_linestyle() for line in ax.lines].count(":") == len(found.pieces) - 1
    assert "certified" in ax.get_ylabel()
    assert ax.get_legend().get_texts()[-1].get_text() == "today: 0.96, outside"
    inside = curve(forest("4/5"), "discount", ("1/2", "9/10")).plot()
    assert inside.lines[-1].get_xdata()[0] == 0.8


LINE = re.compile(r'^  (\w+) -> (\w+) \[label="((?:[^"\\]|\\.)*)"(.*)\]$')
NASTY = ['"]; evil [label="', "\\n\\", "$x^$ <b>", "a | {b}"]


def test_dot_holds_every_transition_and_names_are_text() -> None:
    rows = [(s, a, [("1/3", s, a), ("2/3", s + 1, 0)]) for s in range(3) for a in range(2)]
    mdp = MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], states=NASTY, actions=NASTY[:2])
    lines = dot(mdp, [1, 1, 1, 0]).splitlines()
    assert (lines[0], lines[-1]) == ("digraph {", "}")
    edges = [found.groups() for found in map(LINE.match, lines) if found]
    assert len(edges) == 6 + 12
    plain = [re.sub(r"\\(.)", r"\1", label) for _, _, label, _ in edges]
    assert set(plain[::3]) == set(NASTY[:2])
    assert set(plain) - set(NASTY) == {"1/3", "2/3", "1/3, 1"}
    assert sum("penwidth" in rest for *_, rest in edges) == 9  # of one action in each state
    for name in NASTY:
        assert any(f"state {name}" in re.sub(r"\\(.)", r"\1", line) for line in lines)
    written = [text.get_text() for text in plots.plot_transitions(mdp, "random").texts]
    assert set(NASTY) <= set(written)


def test_a_graph_of_many_states_shows_what_the_policy_does_alone() -> None:
    """Of 16 states the arrows of every action would lie over each other's texts."""
    ax = plots.plot_transitions(grid(4, 4), [1] * 16)
    written = [text.get_text() for text in ax.texts]
    assert written.count("DOWN") == 15
    assert not {"LEFT", "RIGHT", "UP"} & set(written)
    assert all(box.get_alpha() is None for text in ax.texts if (box := text.get_bbox_patch()))
    few = [text.get_text() for text in plots.plot_transitions(grid(2, 2), [1] * 4).texts]
    assert {"LEFT", "DOWN"} <= set(few)


@pytest.mark.parametrize("policy", [None, "random", [0] * 16])
def test_a_graph_that_would_be_a_tangle_is_a_heat_map(policy: Any) -> None:
    """Its title says so; the shades are the probabilities from state to state."""
    mdp = dense(16, rng=3)
    ax = plots.plot_transitions(mdp, policy)
    assert "outcomes are too many for a graph" in ax.get_title()
    shades = np.asarray(ax.images[0].get_array())
    each = [mdp.P(action).toarray() for action in range(mdp.n_actions)]
    assert np.allclose(shades, each[0] if isinstance(policy, list) else np.mean(each, axis=0))


def test_the_sign_of_an_end_is_in_the_legend() -> None:
    legend = plots.plot_policy(
        MDP.from_gymnasium("FrozenLake-v1", "99/100"), "optimal"
    ).get_legend()
    assert "∎ an episode ends" in [text.get_text() for text in legend.get_texts()]
    solved = plots.plot_policy(grid(2, 2), [1] * 4).get_legend()
    assert "∎ an episode ends" in [text.get_text() for text in solved.get_texts()]


@pytest.mark.parametrize("bin", [None, 10.0])
def test_a_law_without_finite_returns_is_drawn(bin: float | None) -> None:
    """Every run goes on for ever: nothing stands in the picture but the title."""
    law = return_distribution(MDP.from_outcomes([(0, 0, [(1, 0, 1)])]), "always:0")
    ax = plots.plot_return_distribution(law, bin=bin)
    assert not ax.patches
    assert "never ends, and is infinite, with probability 1" in ax.get_title()
