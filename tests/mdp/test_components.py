"""Reward components: exact rationals by name, in every constructor, change and file."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, ModelError, Scenario, load, save

F = Fraction
P = [[["1/3", "2/3"], [0, 1]], [["1/2", "1/2"], [0, 1]]]
AMOUNTS = st.one_of(st.fractions(-9, 9, max_denominator=7), st.floats(-4, 4), st.integers(-9, 9))


def amounts(mdp: MDP, name: str) -> list[Fraction]:
    top, bottom = mdp.component(name)
    return [F(int(a), int(b)) for a, b in zip(top, bottom, strict=True)]


def test_every_constructor_takes_components_by_name() -> None:
    """The same model four ways: arrays, pairs out of order, outcomes and an environment's table."""
    effort, rest = [F(1, 3), F(2), F(0), F(0)], [F(2, 3), F(-1), F(0), F(0)]
    reward = [1, 1, 0, 0]
    arrays = MDP.from_arrays(
        P, [[1, 1], [0, 0]], components={"effort": [["1/3", 2], [0, 0]]}, layout="ass"
    )
    order = [2, 0, 3, 1]
    state, action = np.array([0, 0, 1, 1])[order], np.array([0, 1, 0, 1])[order]
    rows = np.array([P[0][0], P[1][0], [0, 1], [0, 1]], dtype=object)[order]
    given = {"effort": [effort[i] for i in order]}
    pairs = MDP.from_pairs(state, action, rows, np.array(reward)[order], components=given)
    listed = [
        (int(s), int(a), [(p, t, reward[i]) for t, p in enumerate(row) if p])
        for i, s, a, row in zip(order, state, action, rows, strict=True)
    ]
    outcomes = MDP.from_outcomes(listed, components=given)

    chances = {s: {a: [(float(F(p)), t, reward[2 * s + a], False) for t, p in enumerate(row) if p]
               for a, row in enumerate([P[0][s], P[1][s]])} for s in (0, 1)}  # fmt: skip
    table = MDP.from_gymnasium(SimpleNamespace(P=chances), start=0, components={"effort": effort})
    for mdp in (arrays, pairs, outcomes, table):
        assert mdp.component_names == ("effort", "rest")
        assert amounts(mdp, "effort") == effort
    assert amounts(pairs, "rest") == amounts(outcomes, "rest") == amounts(arrays, "rest") == rest
    changed = arrays.with_(components={"all": reward})
    assert (changed.component_names, amounts(changed, "all")) == (("all",), reward)


def test_amounts_of_transitions_are_averaged_exactly() -> None:
    by_move = np.array([[[3, "3/2"], [0, 0]]] * 2, dtype=object)
    mdp = MDP.from_arrays(P, by_move, components={"move": by_move}, layout="ass")
    assert mdp.component_names == ("move",)
    assert amounts(mdp, "move") == [2, F(9, 4), 0, 0]


@settings(max_examples=40)
@given(parts=st.lists(st.lists(AMOUNTS, min_size=3, max_size=3), min_size=1, max_size=3))
def test_numbers_are_kept_and_what_is_left_is_the_rest(
    tmp_path_factory: pytest.TempPathFactory, parts: list[list[Any]]
) -> None:
    names = [f"c{number}" for number in range(len(parts))]
    rows = np.array([[0, 1, 0], [0, 0, 1], [0, 0, 1]])
    reward = ["1/7", 5, 0]
    mdp = MDP.from_pairs(
        [0, 1, 2], [0, 0, 0], rows, reward, "1/2", components=dict(zip(names, parts, strict=True))
    )
    total = [sum((F(row[pair]) for row in parts), F(0)) for pair in range(3)]
    path = tmp_path_factory.mktemp("kept")
    for found in (mdp, npz_of(mdp, path), mdp.negated().negated(), mdp.within(2)):
        pairs = [found.pair(state, 0) for state in range(3)]
        for name, row in zip(names, parts, strict=True):
            assert [amounts(found, name)[pair] for pair in pairs] == [F(value) for value in row]
        if "rest" in found.component_names:
            left = [amounts(found, "rest")[pair] for pair in pairs]
            assert left == [F(r) - t for r, t in zip(reward, total, strict=True)]
    assert ("rest" in mdp.component_names) is (total != [F(r) for r in reward])
    assert np.allclose(mdp.components.sum(axis=1), mdp.reward)


def npz_of(mdp: MDP, folder: Path) -> MDP:
    save(mdp, folder / "m.npz")
    return load(folder / "m.npz")


def test_a_scenario_has_exact_components() -> None:
    """Each is a sum of weights times probabilities; together they are the reward exactly."""
    mdp = Scenario.load("yuan2025").compile()
    top, bottom = mdp.table.expected_gain_exact()
    total = [sum(row) for row in zip(*(amounts(mdp, n) for n in mdp.component_names), strict=True)]
    assert total == [F(int(a), int(b)) for a, b in zip(top, bottom, strict=True)]
    scenario = Scenario.load("yuan2025")
    done = amounts(mdp, "subtask-complete")[0] / scenario["reward.subtask-complete"]
    assert done == sum(p for p, s, r in mdp.table.row(0) if s == 16 * mdp.space.columns[1].size)


def test_files_keep_wide_numbers_and_old_ones_are_read(tmp_path: Path) -> None:
    wide = {"a": [F(10**40 + 1, 3**50), 0], "b": ["1/3", 0]}
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])], components=wide)
    save(mdp, tmp_path / "m.umb")
    for again in (npz_of(mdp, tmp_path), load(tmp_path / "m.umb")):
        assert again.component_table == mdp.component_table
    arrays = dict(np.load(tmp_path / "m.npz"))
    arrays.pop("component_denominator")
    old = arrays | {"components": mdp.components}
    text = bytes(old["header"]).decode().replace('"component_denominator", ', "")
    np.savez(tmp_path / "old.npz", **old | {"header": np.frombuffer(text.encode(), np.uint8)})
    assert np.array_equal(load(tmp_path / "old.npz").components, mdp.components)


@pytest.mark.parametrize(
    ("components", "message"),
    [
        ({"a": [1, 2, 3]}, "not \\(2,\\)"),
        ({"a": ["x", 0]}, "not a finite rational"),
        ({"a": [np.nan, 0.0]}, "an amount is nan"),
        ({}, "no component is given"),
        ({"rest": [1, 0], "a": [2, 0]}, "called 'rest'"),
        (np.ones((2, 2)), "for 0 names"),
    ],
)
def test_what_is_no_component(components: Any, message: str) -> None:
    rows = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    with pytest.raises(ModelError, match=message):
        MDP.from_outcomes(rows, components=components)
    with pytest.raises(ModelError, match="unknown component 'rewrad'"):
        MDP.from_outcomes(rows).component("rewrad")
