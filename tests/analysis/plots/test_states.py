"""Pictures of any model: what stands in a cell, at a bar, at an edge is what was computed."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from cli_runner import run
from hypothesis import given
from hypothesis import strategies as st
from made_models import forest, grid
from matplotlib.colors import to_hex
from picture_texts import legend_of, texts, texts_of
from refusal_tables import refused

from exact_mdp import (
    MDP,
    ModelError,
    Scenario,
    check,
    curve,
    evaluate,
    plots,
    return_distribution,
    save,
    solve,
)


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


def test_a_map_over_any_two_columns() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()
    visits = evaluate(mdp, "random").plot(visits=True, down=["trial"], across=["subtask"], status=4)
    expected = evaluate(mdp, "random").visits
    labels = texts(visits)
    assert (visits.get_xlabel(), visits.get_ylabel()) == ("subtask", "trial")
    for (trial, subtask), text in labels.items():
        number = float(text.rpartition("\n")[2])
        state = mdp.space.index(subtask=subtask, trial=trial, status=4)
        assert number == pytest.approx(expected[state], rel=5e-3)
    policy = plots.plot_policy(mdp, "always:directive", subtask=1)
    assert set(texts(policy).values()) == {"a3"}
    assert len(texts(policy)) == 32


def test_a_map_that_is_too_large_names_a_column_to_hold_fixed() -> None:
    """What is advised can be drawn; states that are only numbered have no columns."""
    care = Scenario.load("yuan2025").with_(tasks=[2] * 30).compile()
    cliff = MDP.from_gymnasium("CliffWalking-v1").within(100)
    for mdp, name in ((cliff, "time"), (care, "subtask")):
        error = refused(lambda mdp=mdp: plots.plot_policy(mdp, "random"), "cells", "plot")
        assert f"such as {name}=0, or read" in error.fix
        plots.plot_policy(mdp, "random", **{name: 0})
    numbered = MDP.from_arrays([np.eye(4500)], np.zeros(4500), 0.9)
    refused(
        lambda: plots.plot_policy(numbered, "random"),
        "4,500 cells",
        "plot",
        "=read the table: .frame()",
    )


def test_a_legend_explains_what_is_drawn_alone() -> None:
    """Nothing lost: no scale, no shade. Cells without texts: no sign. A title says the time."""
    lake = MDP.from_gymnasium("FrozenLake-v1", "9/10", is_slippery=False)
    best = check(lake, solve(lake).policy).plot()
    assert not any("✗" in words for words in legend_of(best))
    assert len(best.figure.axes) == 1
    # A policy that is wrong where nobody comes loses nothing.
    unseen = [solve(lake).policy[state] for state in range(16)]
    unseen[3] = 2
    audit = check(lake, unseen)
    assert audit.regret.at_start.value == 0
    assert audit.disagreements
    ax = audit.plot()
    assert len(ax.figure.axes) == 1
    assert any("✗" in words for words in legend_of(ax))
    assert {patch.get_facecolor() for patch in ax.patches if patch.get_fill()} == {(1, 1, 1, 1)}
    assert len(check(lake, [0] * 16).plot().figure.axes) == 2
    timed = check(lake, [0] * 16, horizon=60)
    assert legend_of(timed.plot()) == ["start"]
    assert "; time 50 – " in timed.plot(time=50).get_title(loc="left")
    same = plots.plot_states(lake, np.full(16, 2.5))
    assert (len(same.figure.axes), legend_of(same)[0]) == (1, "2.5")


def test_values_beyond_all_bounds_are_written() -> None:
    shown = texts(plots.plot_states(grid(1, 3), [np.inf, -np.inf, np.nan], shape=(1, 3)))
    assert [shown[0, column] for column in range(3)] == ["inf", "-inf", "∎\nnan"]
    ax = plots.plot_states(grid(1, 3), [np.inf, -np.inf, 1.0])
    ax.figure.canvas.draw()
    assert [text.get_text().strip() for text in ax.texts] == ["inf", "-inf", ""]


def test_a_value_function_is_drawn_by_its_exact_values() -> None:
    mdp = forest("24/25")
    value_curve = curve(mdp, "discount", ("1/2", "9/10"), policy=[0, 1, 1])
    ax = value_curve.plot(n=5)
    for line in ax.lines:
        fixed = line.get_linestyle() == "--"
        for x, y in zip(*line.get_data(), strict=True) if len(line.get_xdata()) == 5 else ():
            changed = mdp.with_(discount=x)
            best = evaluate(changed, [0, 1, 1]).mean if fixed else solve(changed).start_value
            assert y == pytest.approx(best)
    assert [line.get_linestyle() for line in ax.lines].count(":") == len(value_curve.pieces) - 1
    assert "certified" in ax.get_ylabel()
    assert legend_of(ax)[-1] == "today: 0.96, outside"
    inside = curve(forest("4/5"), "discount", ("1/2", "9/10")).plot()
    assert inside.lines[-1].get_xdata()[0] == 0.8


def test_names_in_a_graph_are_text() -> None:
    names = ['"]; evil [label="', "\\n\\", "$x^$ <b>", "a | {b}"]
    rows = [(s, a, [("1/3", s, a), ("2/3", s + 1, 0)]) for s in range(3) for a in range(2)]
    mdp = MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], states=names, actions=names[:2])
    written = texts_of(plots.plot_transitions(mdp, "random").texts)
    assert set(written) == {*names, "1/3", "2/3", "1/3, 1"}


def test_a_graph_of_many_states_shows_what_the_policy_does_alone() -> None:
    """Of 16 states the arrows of every action would lie over each other's texts."""
    ax = plots.plot_transitions(grid(4, 4), [1] * 16)
    written = texts_of(ax.texts)
    assert written.count("DOWN") == 15
    assert not {"LEFT", "RIGHT", "UP"} & set(written)
    assert all(box.get_alpha() is None for text in ax.texts if (box := text.get_bbox_patch()))
    few = texts_of(plots.plot_transitions(grid(2, 2), [1] * 4).texts)
    assert {"LEFT", "DOWN"} <= set(few)
    dense = MDP.from_arrays(np.full((1, 12, 12), 1 / 12), np.zeros(12), 0.9)
    with pytest.raises(ModelError, match="144 outcomes"):
        plots.plot_transitions(dense, [0] * 12)


def test_start_goal_and_holes_are_told_apart() -> None:
    lake = MDP.from_gymnasium("FrozenLake-v1", "99/100")
    results = solve(lake), check(lake, [0] * 16)
    for ax in (plots.plot_policy(lake, "optimal"), *(each.plot() for each in results)):
        words = legend_of(ax)
        assert {"start", "G goal", "H hole"} <= set(words)
        assert ax.get_title(loc="left").endswith("FrozenLake-v1")
        written = texts_of(ax.texts)
        assert [sum(t.startswith(sign) for t in written) for sign in "GH"] == [1, 4]
    assert "∎ an episode ends" in legend_of(plots.plot_policy(grid(2, 2), [1] * 4))


def test_named_states_keep_their_names() -> None:
    names = ["in good health", "ill", "dead"]
    moves = [[["1/2", "1/2", 0], [0, "1/2", "1/2"], [0, 0, 1]]] * 2
    mdp = MDP.from_arrays(moves, [1, 0, 0], "9/10", states=names)
    for ax in (plots.plot_policy(mdp, [0, 1, 0]), check(mdp, [0, 1, 0]).plot()):
        assert texts_of(ax.get_yticklabels()) == names


@pytest.mark.parametrize(
    ("form", "written"),
    [
        ("a machine in the northern hall in condition {k}", "…ondition 42"),
        ("{k}: a machine in the northern hall", "42: a machi…"),
        ("{a}th machine of those in hall {b}", "2th m…hall 2"),
        ("the big machine {k} in the northern hall", "42"),
        ("m{k}", "m42"),
    ],
)
def test_names_that_differ_are_cut_to_texts_that_differ(form: str, written: str) -> None:
    """A name is cut at the end, at the start, or in the middle; else the state has its number."""
    names = [form.format(k=k, a=k // 20, b=k % 20) for k in range(200)]
    mdp = MDP.from_arrays(np.eye(200)[np.newaxis], np.zeros(200), 0.9, states=names)
    for ax in (check(mdp, [0] * 200).plot(), plots.plot_policy(mdp, [0] * 200)):
        corners = texts_of(ax.texts)
        assert written in corners
        assert len({*corners}) == 201  # and the sign of an end
    ticks = texts_of(solve(mdp).plot().get_xticklabels())
    assert len({*ticks}) == len(ticks) == 40
    assert max(map(len, ticks)) <= 26


def test_the_frames_of_many_cells_do_not_cover_them() -> None:
    """Of 1,600 cells the colour says what is lost; of 16 a frame says that it is."""
    lake = MDP.from_gymnasium("FrozenLake-v1")
    for horizon, widest in ((None, 1.6), (100, 0.2)):
        ax = check(lake, [1] * 16, horizon=horizon).plot()
        frames = {patch.get_linewidth() for patch in ax.patches if patch.get_fill()}
        assert max(frames) == widest


@pytest.mark.parametrize("size", [(9, 7), (4.5, 3.2), (3.3, 2.5), (1.5, 1.2)])
def test_texts_fit_into_their_cells_or_are_left_out(size: tuple[float, float]) -> None:
    ax = plt.subplots(figsize=size)[1]
    check(MDP.from_gymnasium("FrozenLake-v1"), "random").plot(ax=ax)
    ax.figure.draw_without_rendering()
    cell = ax.transData.transform((1, 0))[0] - ax.transData.transform((0, 0))[0]
    assert bool(ax.texts) == (size[0] > 2)
    assert all(text.get_window_extent().width <= cell for text in ax.texts if "any of" in str(text))
    plt.close("all")


def test_infinite_losses_are_marked_apart_from_the_scale_of_finite_ones(tmp_path: Path) -> None:
    """State 0 waits for ever, state 1 loses 3, state 2 loses 1; all begin, and lead to the end."""
    costs = [(0, 1, 1), (1, 0, 4), (1, 1, 1), (2, 0, 2), (2, 1, 1)]
    moves = [(state, action, [(1, 3, -cost)]) for state, action, cost in costs]
    model = MDP.from_outcomes(
        [(0, 0, [(1, 0, -1)]), *moves, (3, 0, [(1, 3, 0)])], start=dict.fromkeys(range(3), "1/3")
    )
    audit = check(model, [0, 0, 0, 0])
    ax = audit.plot()
    cells = ax.patches[:3]
    assert [bool(cell.get_hatch()) for cell in cells] == [True, False, False]
    fills = [to_hex(cell.get_facecolor()) for cell in cells]
    assert len({*fills}) == 3
    assert ax.figure.axes[1].get_ylim() == (0, 1)  # what state 1 loses, at a third of the starts
    assert fills[1] == "#d55e00"  # the end of that scale
    assert "loses infinitely much" in legend_of(ax)
    # The page shows the same.
    save(model, tmp_path / "m.json")
    (tmp_path / "p.json").write_text("[0, 0, 0, 0]", "utf-8")
    run("check", tmp_path / "m.json", tmp_path / "p.json", "--html", tmp_path / "a.html")
    page = (tmp_path / "a.html").read_text("utf-8")
    assert page.count('class="wrong endless"') == 1
    for said in ("striped ones infinitely", "--shade:1.000", "--shade:0.333"):
        assert said in page


def test_a_law_without_finite_returns_is_drawn() -> None:
    """Every run goes on for ever: nothing stands in the picture but the title."""
    law = return_distribution(MDP.from_outcomes([(0, 0, [(1, 0, 1)])]), "always:0")
    ax = law.plot()
    assert not ax.patches
    assert "never ends, and is infinite, with probability 1" in ax.get_title(loc="left")
