"""Models and policies as tables, as a notebook shows them."""

from fractions import Fraction

import numpy as np

from exact_mdp import MDP, Policy, Scenario


def test_a_model_and_a_policy_are_tables_in_a_notebook() -> None:
    mdp = Scenario.load("tea").with_(tasks=[1], max_trial=2).compile()
    rows = [
        (mdp.space.label(state), mdp.actions[action], mdp.space.label(after), chance, gain)
        for pair, (state, action) in enumerate(zip(mdp.pair_state, mdp.pair_action, strict=True))
        for chance, after, gain in mdp.table.row(pair)
    ]
    assert [tuple(row) for row in mdp.frame().to_numpy()] == rows
    assert len(mdp.frame([mdp.space.label(0)])) == sum(row[0] == rows[0][0] for row in rows)
    for alone in (0, mdp.space.label(0)):
        assert mdp.frame(alone).equals(mdp.frame([0]))
    page = mdp._repr_html_()
    assert page.count("<tr") == 21
    assert f"{len(rows) - 20:,} rows more" in page

    mixed = Policy.of(mdp, "random").frame()
    assert len(mixed) == mdp.n_states
    offered = len(mdp.pairs_of(0))
    shares = sorted(mixed.iloc[0, -mdp.n_actions :])
    assert shares[-offered:] == [Fraction(1, offered)] * offered
    assert sum(shares) == 1
    always = Policy.of(mdp, np.zeros(mdp.n_states, dtype=int))
    assert set(always.frame()["action"]) == {mdp.actions[0]}
    assert "<table" in always._repr_html_()


def test_a_row_that_says_nothing_has_no_shares() -> None:
    mdp = MDP.from_arrays([[[0, 1], [0, 1]]] * 2, [[1, 3], [0, 0]])
    rule = np.array([[Fraction(1, 3), Fraction(2, 3)], [np.nan, np.nan]])
    partial = Policy(space=mdp.space, actions=mdp.actions, rule=rule)
    table = partial.frame()
    assert table.loc[0, ["0", "1"]].tolist() == [Fraction(1, 3), Fraction(2, 3)]
    assert table.loc[1, ["0", "1"]].isna().all()
    assert "2/3" in partial._repr_html_()


def test_a_scenario_is_a_table_of_its_parameters() -> None:
    scenario = Scenario.load("yuan2025").with_(parameters={"base.anger": "1/7"})
    frame = scenario.frame()
    assert dict(zip(frame["parameter"], frame["value"], strict=True)) == scenario.values()
    page = scenario._repr_html_()
    assert page.startswith("<p>Scenario(yuan2025: 4 statuses")
    assert "<td>base.anger</td>\n      <td>1/7</td>" in page
    assert f"and {len(frame) - 20} rows more" in page
