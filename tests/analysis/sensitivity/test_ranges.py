"""Parametric models, one-way and two-way analyses, their figures, and the command."""

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from care_oracle import oracle_of

from exact_mdp import (
    MDP,
    Family,
    ModelError,
    Parameter,
    Range,
    Scenario,
    load_ranges,
    moving,
    one_way,
    parametric,
    thresholds,
    tornado,
    two_way,
)

F = Fraction
SMALL = {"tasks": [1], "max_trial": 2}


def scenario(**readings: str) -> Scenario:
    return Scenario.load("yuan2025").with_(readings=readings, **SMALL)


def test_a_range_that_passes_1_by_default_is_warned_of() -> None:
    """A utility may not be 1.02; an open number may, and where a range is stated nobody asks."""
    family = Family(
        parameters={"u": "17/20"}, build=lambda at: MDP.from_arrays([[[1]]], [at["u"]], "1/2")
    )
    with pytest.warns(UserWarning, match=r'u, 0.85 today, .* to 1.02; .*name="u", .*high=1'):
        tornado(family)
    assert tornado(family, ranges={"u": (0, 1)}).bars[0].high.at == 1
    assert tornado(family, relative="1/5").bars[0].high.at == F(51, 50)
    bounded = replace(family, parameters=(Parameter(name="u", value="17/20", low=0, high=1),))
    assert tornado(bounded).bars[0].high.at == 1


# ---- parametric models -----------------------------------------------------------------------


def test_numbers_of_many_digits_compile_to_distributions() -> None:
    own = Scenario.load("yuan2025")
    for name in ("skip.disengagement.persistence", "persistence.disengagement", "base.anger"):
        mdp = own.with_(parameters={name: F(1234567890123, 10**13)}).compile()
        assert (np.add.reduceat(mdp.table.weight, mdp.table.offsets[:-1]) > 0).all()


def test_rows_make_room_in_proportion() -> None:
    mdp = MDP.from_arrays([[["1/2", "1/4", "1/4"], [0, 1, 0], [0, 0, 1]]], [1, 0, 0])
    family = moving(mdp, {"a": [(0, 0)], "b": [(0, 1)]})
    row = family.at({"a": "1/10", "b": "3/10"}).table.row(0)
    assert [p for p, _, _ in row] == [F(1, 10), F(3, 10), F(6, 10)]
    with pytest.raises(ModelError, match="more than 1"):
        family.at({"a": "9/10", "b": "3/10"})
    with pytest.raises(ModelError, match="outside"):
        family.at({"a": 2})
    with pytest.raises(ModelError, match="all of a row"):
        moving(mdp, {"a": [(1, 1)]})
    with pytest.raises(ModelError, match="2 different"):
        moving(mdp, {"a": [(0, 0), (0, 1)]})
    with pytest.raises(ModelError, match="twice by one"):
        moving(mdp, {"a": [(0, 0), (0, 0)]})


def test_what_is_left_of_a_float_row_is_what_is_there() -> None:
    """A row of floats means tenths: the other outcomes share what the named ones leave of 1."""
    given = [0.1, 0.2, 0.7 - 2.0**-34]
    assert sum(map(F, given)) < 1 - F(1, 10**11)
    family = moving(MDP.from_arrays([[given, [0, 1, 0], [0, 0, 1]]], [1, 0, 0]), {"a": [(0, 0)]})
    row = [p for p, _, _ in family.at({"a": "1/4"}).table.row(0)]
    assert (row[0], sum(row)) == (F(1, 4), 1)
    assert row[1] / row[2] == F(2, 7)


# ---- one-way ---------------------------------------------------------------------------------


def test_bars_are_values_of_an_independent_model() -> None:
    own = scenario(influence_orientation="column-to-row")
    names = ["base.confusion", "reward.anger"]
    bars = tornado(own, policy="always:directive", names=names)
    for bar in bars.bars:
        for end in (bar.low, bar.high):
            twin = oracle_of(own, {bar.parameter.name: end.at})
            assert end.optimal.value == pytest.approx(float(twin.value(twin.start)), abs=1e-9)
            fixed = twin.evaluate(lambda _: {"directive": F(1)}, distribution=False)["mean"]
            assert end.fixed.value == pytest.approx(float(fixed), abs=1e-9)
            assert end.regret.value == pytest.approx(end.optimal.value - end.fixed.value)
            assert end.regret.error >= end.optimal.error + end.fixed.error
    assert [bar.swing for bar in bars.bars] == sorted((b.swing for b in bars.bars), reverse=True)
    base = next(bar for bar in bars.bars if bar.parameter.name == "base.confusion")
    assert (base.low.at, base.high.at) == (F(24, 100), F(36, 100))
    assert bars.frame()["unit"].tolist() == [
        "probability" if bar.parameter.name.startswith("base") else "reward" for bar in bars.bars
    ]


def test_ranges_are_shares_of_today_that_end_where_the_parameter_does() -> None:
    given = (("p", "1/10", 0, 1), ("q", "9/10", 0, 1), ("r", -5, None, None))
    family = Family(
        parameters=[Parameter(name=n, value=v, low=low, high=high) for n, v, low, high in given],
        build=lambda at: MDP.from_arrays([[[1]]], [sum(at.values())], 0),
    )
    for relative, wanted in (
        (2, {"p": (0, F(3, 10)), "q": (0, 1), "r": (-15, 5)}),
        ("1/2", {"p": (F(1, 20), F(3, 20)), "q": (F(9, 20), 1), "r": (F(-15, 2), F(-5, 2))}),
    ):
        bars = tornado(family, relative=relative).bars
        assert {bar.parameter.name: (bar.low.at, bar.high.at) for bar in bars} == wanted


def test_curves_start_to_part_at_a_threshold() -> None:
    own, name = scenario(), "reward.assist.non-directive"
    low, high = thresholds(own, name, (-10, 0)).stable(reached=True)
    assert -10 < low < -3
    assert high == 0
    curve = one_way(own, name, (low, high), points=5)
    assert curve.table.regret.max() < 1e-9
    below = one_way(own, name, (-10, low), points=5)
    assert below.table.regret[0, 0] > 1e-3
    assert len(curve.frame()) == 5


def test_ranges_from_a_file(tmp_path: Path) -> None:
    family = parametric(scenario())
    file = tmp_path / "ranges.toml"
    file.write_text('"base.anger" = [0.02, "1/10"]\n[reward]\nanger = [-6, -4]\n', "utf-8")
    ranges = load_ranges(family, file)
    assert ranges["base.anger"] == Range(low=F(1, 50), high=F(1, 10))
    assert set(ranges) == {"base.anger", "reward.anger"}
    for text, message in (
        ('"base.angre" = [0, 1]', r"unknown parameter 'base\.angre'"),
        ('"base.anger" = [0.2, 0.1]', "empty"),
        ('"base.anger" = [0.2, 0.2]', "empty"),
        ('"base.anger" = [0.2, 1.1]', "outside"),
        ('"base.anger" = 0.2', "not a pair"),
        ('"base.anger" = [0.2', "broken TOML"),
        ("", "no range"),
    ):
        file.write_text(text, "utf-8")
        with pytest.raises(ModelError, match=message):
            load_ranges(family, file)


# ---- two-way ---------------------------------------------------------------------------------


def test_two_way_map_agrees_with_thresholds_along_its_rows() -> None:
    own, x = scenario(), "assistance.directive.confusion.persistence"
    grid = two_way(own, x, "base.confusion", ranges={x: (0, 1)}, points=5)
    assert grid.policy.shape == (5, 5)
    today = thresholds(own, x, (0, 1))
    across = grid.table.points[:5, 0]
    middle = grid.choices[2]  # base.confusion as it is today
    for column in range(4):
        moved = np.flatnonzero(middle[column] != middle[column + 1]).tolist()
        inside = [t for t in today.found if across[column] < t.value]
        inside = [t for t in inside if t.value < across[column + 1]]
        assert set(moved) <= {switch.state for t in inside for switch in t.switches}
    frame = grid.frame()
    assert len(frame) == 25
    assert (frame["regret"] >= 0).all()
    assert frame["value"][10] >= frame["fixed_value"][10] - 1e-9
    with pytest.raises(ModelError, match="both parameters are"):
        two_way(own, x, x)
    with pytest.raises(ModelError, match=r"base\.anger has a range"):
        two_way(own, x, "base.confusion", ranges={"base.anger": (0, 1)})
