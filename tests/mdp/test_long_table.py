"""A long table, a row for each outcome, is the model that it was printed from."""

from fractions import Fraction as F
from pathlib import Path

import pandas as pd
import pytest
from small_models import small_model

from exact_mdp import MDP, ModelError, certify, load

NAMES = ["state", "action", "next state", "probability", "reward"]
REPAIR = [
    ("worn", "go on", "worn", "2/3", 1),
    ("worn", "go on", "broken", "1/3", 9),
    ("worn", "repair", "new", 1, 4),
]


def table(rows: list[tuple[object, ...]], *more: str) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=[*NAMES[:4], *more], dtype=object)


@pytest.mark.parametrize("seed", range(12))
def test_a_printed_model_is_read_back(seed: int, tmp_path: Path) -> None:
    """States are numbered in the order of the rows, which is not that of the model."""
    mdp = small_model(seed)
    frame = mdp.frame().sample(frac=1, random_state=seed)
    frame.to_csv(tmp_path / "model.csv", index=False)
    start = {mdp.space.label(state): weight for state, weight in mdp.start}
    expected = certify(mdp).start.value
    for again in (
        MDP.from_frame(frame, mdp.discount_exact, sense=mdp.sense),
        load(tmp_path / "model.csv", discount=mdp.discount_exact).with_(sense=mdp.sense),
    ):
        assert again.n_pairs == mdp.n_pairs
        assert certify(again.with_(start=start)).start.value == expected


def test_costs_are_known_by_their_column() -> None:
    mdp = MDP.from_frame(table(REPAIR, "cost"))
    assert mdp.sense == "min"
    assert [*mdp.frame().columns][-1] == "cost"
    # Go on until it breaks, or repair now: 9 + 1 · 2/3 / (1/3) = 11 against 4.
    assert certify(mdp).start.value == 4
    assert certify(MDP.from_frame(table(REPAIR, "reward"))).start.value == 11
    with pytest.raises(ModelError, match='costs have the sense "min"'):
        MDP.from_frame(table(REPAIR, "cost"), sense="max")


def test_a_cost_beside_another_amount_is_a_component() -> None:
    """As a health economist writes it: effects and costs, both as they are."""
    both = table([(*row, 2) for row in REPAIR], "qaly", "cost")
    with pytest.raises(ModelError, match="a column 'cost' beside other amounts"):
        MDP.from_frame(both)
    assert MDP.from_frame(both.assign(reward=0)).component_names[:2] == ("qaly", "cost")
    assert MDP.from_frame(both, sense="min").sense == "min"
    mdp = MDP.from_frame(both, sense="max")
    assert (mdp.sense, mdp.component_names) == ("max", ("qaly", "cost"))


def test_other_columns_are_components() -> None:
    rows = [(*row, 2) for row in REPAIR]
    apart = MDP.from_frame(table(rows, "wear", "time"))
    assert apart.component_names == ("wear", "time")
    assert apart.table.row(apart.pair(0, "repair"))[0] == (1, 2, 6)
    whole = MDP.from_frame(table([(*row, 13) for row in rows], "wear", "time", "reward"))
    assert whole.component_names == ("wear", "time", "rest")
    assert whole.components[0].tolist() == pytest.approx([11 / 3, 2, 13 - 17 / 3])


def test_usual_names_and_numbers(tmp_path: Path) -> None:
    path = tmp_path / "chain.csv"
    path.write_text("S;A;next_state;P;R\n0;1;0;0.1;1e-3\n0;1;1;9/10;0\n", "utf-8")
    mdp = load(path, discount="1/2", start=0)
    assert (mdp.name, mdp.n_states, mdp.actions) == ("chain", 2, ("1",))
    assert mdp.table.row(0)[0][0] == F(1, 10)
    assert certify(mdp).start.value == F(1, 10000) / (1 - F(1, 20))


@pytest.mark.parametrize(
    ("frame", "said"),
    [
        (table(REPAIR, "cost").drop(columns="cost"), "no reward"),
        (table(REPAIR, "cost").drop(columns="probability"), "no column 'probability'"),
        (table(REPAIR, "cost").rename(columns={"cost": "p"}), "two columns are the probability"),
        (table([("a", "b", pd.NA, 1, 0)], "reward"), "the next state is missing"),
        (table([("a", "b", "a", 1, pd.NA)], "reward"), "the reward is missing"),
        (table([("a", "b", "a", 1, 0)], ""), "has no name"),
        ({"state": ["a"], "action": [0], "next state": ["a", "b"]}, "no table"),
        (table([("a", None, "a", 1, 0)], "reward"), "the action is missing"),
        (table([("a", "b", "a", 1, float("nan"))], "reward"), "the reward is missing"),
        (table([("a", "b", "a", "much", 0)], "reward"), "row 0, probability"),
        (table([("a", "b", "a", "1/2", 0)], "reward"), "sum"),
        ([("a", "b", "a", 1, 0)], "DataFrame"),
    ],
)
def test_bad_tables_are_refused(frame: object, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        MDP.from_frame(frame)


def test_records_are_no_model(tmp_path: Path) -> None:
    path = tmp_path / "records.csv"
    path.write_text("episode,state,action,reward,next_state\n1,a,b,0,a\n", "utf-8")
    with pytest.raises(ModelError, match=r"MDP\.from_transitions"):
        load(path)
