"""The ranges of parameters, exact, and where a model admits them."""

import os
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusal_tables import refused

from exact_mdp import (
    MDP,
    Family,
    ModelError,
    Parameter,
    Scenario,
    moving,
    one_way,
    parametric,
    sobol,
    tornado,
    two_way,
    worst_point,
)
from exact_mdp.analysis.vary.ranges import (
    RELATIVE,
    Range,
    Ranges,
    flatten_entries,
    is_probability,
    list_usual_parameters,
    make_range_around,
    range_of,
    ranges_of,
    read_points,
    read_ranges,
    restrict_range,
    spans_of,
    unit_of,
)

F = Fraction


def parameter(value: object, low: object = None, high: object = None, **more: Any) -> Parameter:
    return Parameter(**({"name": "x", "value": value, "low": low, "high": high} | more))


def ends(span: Range) -> tuple[Fraction, Fraction]:
    return span.low, span.high


def test_units_follow_from_what_a_parameter_may_be() -> None:
    assert unit_of(parameter("1/2", 0, 1)) == "probability"
    assert unit_of(parameter("1/2", 0, 1, unit="euro")) == "euro"
    assert unit_of(parameter("1/2", 0, 1, name="discount")) == "per step"
    for low, high in ((0, None), (None, 1), (None, None), (0, 2), ("1/4", 1)):
        assert unit_of(parameter("1/2", low, high)) == "number"
        assert not is_probability(parameter("1/2", low, high))
    assert is_probability(parameter("1/2", 0, 1))
    assert not is_probability(parameter("1/2", 0, 1, name="discount"))


@pytest.mark.parametrize("value", [F(1, 2), F(-3), F(0), F(7)])
@pytest.mark.parametrize("share", ["1/5", "1/2", 2, 0.25])
def test_a_share_of_the_value_to_both_sides(value: Fraction, share: object) -> None:
    reach = abs(value) * F(share)
    low, high = value - reach, value + reach
    assert ends(make_range_around(parameter(value), share)) == (low, high)
    bounded = parameter(value, value - 1, value + 2)
    assert ends(make_range_around(bounded, share)) == (max(low, value - 1), min(high, value + 2))


def test_the_whole_is_all_that_a_parameter_may_be() -> None:
    assert ends(make_range_around(parameter(3, -1, 9), "whole")) == (-1, 9)
    assert ends(make_range_around(parameter(3, None, 9), "whole")) == (0, 9)
    assert ends(make_range_around(parameter(-3, -9), "whole")) == (-9, 0)
    assert ends(make_range_around(parameter(3), "whole")) == (0, 6)
    assert 5 * RELATIVE == 1
    assert ends(make_range_around(parameter(10))) == (8, 12)
    for wrong in (0, -1, "-1/5", "all", 10**300, 10**400):
        with pytest.raises(ModelError, match="relative"):
            make_range_around(parameter(3), wrong)
    assert ends(make_range_around(parameter(1), 10**300 - 1)) == (2 - 10**300, 10**300)
    assert ends(make_range_around(parameter(1), F(1, 10**9))) == (1 - F(1, 10**9), 1 + F(1, 10**9))
    assert ends(make_range_around(parameter(1), 1)) == (0, 2)


def test_a_range_keeps_its_ends_exact_and_in_order() -> None:
    assert ends(Range(low="1/3", high=0.5)) == (F(1, 3), F(1, 2))
    assert ends(Range(low=2, high=2)) == (2, 2)
    said = "=the range from 2 to 1 is empty", "=range", "=put the smaller number first"
    refused(lambda: Range(low=2, high=1), *said)


# ---- what a model admits -------------------------------------------------------------------------

LOOP = MDP.from_outcomes([(0, 0, [("1/2", 0, 1), ("1/4", 1, 0), ("1/4", 2, 0)]),
                          (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])], discount="9/10")  # fmt: skip
ROW = moving(LOOP, {"stay": [(0, 0)], "one": [(0, 1)]})


def named(model: Any, name: str) -> Parameter:
    return next(each for each in model.parameters if each.name == name)


def test_named_probabilities_of_a_row_leave_room_for_each_other() -> None:
    stay = named(ROW, "stay")
    assert ends(restrict_range(ROW, stay, Range(low=0, high=1))) == (0, F(3, 4))
    assert ends(restrict_range(ROW, stay, Range(low="1/4", high="5/8"))) == (F(1, 4), F(5, 8))
    assert ends(ranges_of(ROW, ["one"], None, "whole")["one"]) == (0, F(1, 2))
    scenario = parametric(Scenario.load("yuan2025"))
    span = Range(low=0, high=1)
    assert restrict_range(scenario, named(scenario, "base.anger"), span) is span


def test_an_end_without_finite_values_is_halved_towards_today() -> None:
    """At discount 1 an episode may go on for ever: 9/10 ends half way, at 19/20."""
    stays = MDP.from_arrays([[[1]]], [1], "9/10")
    discount = named(parametric(stays), "discount")
    found = restrict_range(parametric(stays), discount, Range(low="1/2", high=1))
    assert ends(found) == (F(1, 2), F(19, 20))
    assert ends(restrict_range(parametric(stays), discount, Range(low="9/10", high=1))) == (
        F(9, 10), F(19, 20)
    )  # fmt: skip


def build(at: Any) -> MDP:
    """A model where x is from 1/3 to 7/8, one that ends in all but y above 6/5."""
    if not F(1, 3) <= at["x"] <= F(7, 8):
        raise ModelError("x", where="x", fix="x")
    rows = [[0, 1], [0, 1]] if at["y"] <= F(6, 5) else [[1, 0], [0, 1]]
    return MDP.from_arrays([rows], [1, 0])


LIMITED = Family(parameters=(parameter("1/2"), parameter(1, name="y")), build=build)


def test_ends_at_which_no_model_can_be_built_are_halved_one_by_one() -> None:
    x, y = LIMITED.parameters
    # From 0: 0, 1/4, 3/8; from 1: 1, 3/4.
    assert ends(restrict_range(LIMITED, x, Range(low=0, high=1))) == (F(3, 8), F(3, 4))
    assert ends(restrict_range(LIMITED, x, Range(low="2/5", high="4/5"))) == (F(2, 5), F(4, 5))
    assert ends(restrict_range(LIMITED, y, Range(low=0, high=2))) == (
        0,
        F(9, 8),
    )  # 2, 3/2, 5/4, 9/8
    point = Range(low="1/2", high="1/2")
    assert ends(restrict_range(LIMITED, x, point)) == (F(1, 2), F(1, 2))


def test_what_no_halving_reaches_has_no_range_there() -> None:
    """After 40 halvings an end is today's value."""

    def only(width: Fraction) -> Family:
        def build(at: Any) -> MDP:
            if at["x"] > 1 + width:
                raise ModelError("x", where="x", fix="x")
            return MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0])

        return Family(parameters=(parameter(1),), build=build)

    for k, high in ((38, 1 + F(1, 2**38)), (39, 1 + F(1, 2**39)), (40, 1)):
        model = only(F(1, 2**k))
        (x,) = model.parameters
        assert ends(restrict_range(model, x, Range(low=0, high=2))) == (0, high)


def test_a_model_without_finite_values_today_keeps_its_range() -> None:
    stays = parametric(MDP.from_arrays([[[1]]], [1], 1))
    reward = named(stays, "reward.1")
    assert ends(restrict_range(stays, reward, Range(low=0, high=2))) == (0, 2)


# ---- what is stated ------------------------------------------------------------------------------

MODEL = Family(
    parameters=(
        parameter("1/2", 0, 1, name="p"), parameter(0, name="zero"), parameter(10, name="cost.a"),
        parameter("9/10", 0, 1, name="discount"),
    ),
    build=lambda at: MDP.from_arrays([[[0, 1], [0, 1]]], [1, 0]),
)  # fmt: skip


def test_stated_ranges_are_pairs_within_what_may_be() -> None:
    found = read_ranges(MODEL, {"p": (0, "1/3"), "zero": [-1, 0.5], "cost.a": Range(low=1, high=2)})
    assert {name: ends(span) for name, span in found.items()} == {
        "p": (0, F(1, 3)), "zero": (-1, F(1, 2)), "cost.a": (1, 2),
    }  # fmt: skip
    assert read_ranges(MODEL, found) is found
    assert read_ranges(MODEL, None) == read_ranges(MODEL, {}) == Ranges()
    pair = "range of p"
    wrong: list[tuple[Any, str, str, str]] = [
        ({"p": (0, 2)}, "=p is 2, outside [0, 1]", pair, "choose a value"),
        ({"p": (-1, 1)}, "=p is -1, outside [0, 1]", pair, "choose a value"),
        ({"p": (1, 1)}, "=the range from 1 to 1 is empty", pair, "give two different numbers"),
        ({"p": (1, 0)}, "=the range from 1 to 0 is empty", pair, "put the smaller number first"),
        *(({"p": each}, "=not a pair of numbers", pair, "give low and high")
          for each in (1, (1, 2, 3), (0,), "01")),
        ({"p": (0, "x")}, "='x' is not a finite rational number", pair, "write 0.1"),
        ({"unknown": (0, 1)}, "=unknown parameter 'unknown'", "model", "choose one of p, zero"),
        ([("p", 0, 1)], "=[('p', 0, 1)] is of type list", "ranges",
         "give {name: (low, high)}, or a .toml file"),
    ]  # fmt: skip
    for ranges, what, where, fix in wrong:
        refused(partial(read_ranges, MODEL, ranges), what, f"={where}", fix)


def test_a_file_states_ranges_by_dotted_names(tmp_path: Path) -> None:
    file = tmp_path / "ranges.toml"
    file.write_text('p = [0.25, "3/4"]\n[cost]\na = [1, 2]\n')
    for path in (file, str(file)):
        found = read_ranges(MODEL, path)
        assert {n: ends(s) for n, s in found.items()} == {"p": (F(1, 4), F(3, 4)), "cost.a": (1, 2)}
    for text in ("", "q = [1, 2]", "p = 1", "[p]"):
        file.write_text(text)
        with pytest.raises(ModelError, match=r"ranges\.toml"):
            read_ranges(MODEL, file)
    file.write_text("")
    refused(partial(read_ranges, MODEL, file), "=no range in the file", f"={file}",
            'write "NAME" = [low, high]')  # fmt: skip
    os.truncate(file, 2**24 + 1)
    refused(partial(read_ranges, MODEL, file), "more than the 16,777,216 bytes", f"={file}")
    table = {"a": 1, "b": {"c": 2, "d": {"e": [3]}}, "f": {}}
    assert [*flatten_entries(table)] == [("", "a", 1), ("b", "c", 2), ("b.d", "e", [3])]


def test_ranges_are_stated_or_around_today() -> None:
    def of(*args: Any) -> dict[str, tuple[Fraction, Fraction]]:
        return {name: ends(span) for name, span in ranges_of(MODEL, *args).items()}

    every = {"p": (F(2, 5), F(3, 5)), "zero": (0, 0), "cost.a": (8, 12),
             "discount": (F(18, 25), 1)}  # fmt: skip
    assert of() == every
    assert of(["cost.a", "p"]) == {"cost.a": (8, 12), "p": every["p"]}
    assert of(None, {"p": (0, 1)}) == {"p": (0, 1)}
    assert of(["zero", "p"], {"p": (0, 1)}) == {"zero": (0, 0), "p": (0, 1)}
    assert of(["p", "cost.a"], None, "1/2") == {"p": (F(1, 4), F(3, 4)), "cost.a": (5, 15)}
    assert of(["p"], None, "whole") == {"p": (0, 1)}
    assert ends(range_of(MODEL, "p")) == every["p"]
    assert ends(range_of(MODEL, "p", (0, "1/4"))) == (0, F(1, 4))
    assert ends(range_of(MODEL, "p", Range(low=0, high=1))) == (0, 1)
    assert ends(range_of(MODEL, "p", {"p": (0, "1/2"), "zero": (0, 1)})) == (0, F(1, 2))
    assert ends(range_of(MODEL, "p", None, "1/2")) == (F(1, 4), F(3, 4))
    for model, name, said in (
        (MODEL, "zero", "0: a share of 0 is 0"),
        (point_family(1), "x", "1: no other value has a model with finite values"),
    ):
        fix = f'=give it one: ranges={{"{name}": (low, high)}}, --range {name}=LOW:HIGH'
        what = f"=the range of {name} has one point, {said}"
        refused(partial(range_of, model, name), what, "=model", fix)


def point_family(value: int) -> Family:
    """A model that exists at today's value alone."""

    def build(at: Any) -> MDP:
        if at["x"] != value:
            raise ModelError("x", where="x", fix="x")
        return MODEL.build(at)

    return Family(parameters=(parameter(value),), build=build)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (parameter("9/10"), True),
        (parameter("5/6"), False),  # up to 1, and no further
        (parameter("9/10", unit="euro"), False),
        (parameter("9/10", 0), False),
        (parameter("9/10", None, 2), False),
        (parameter("1/2"), False),
        (parameter(1), False),
        (parameter("11/10"), False),
        (parameter("-9/10"), False),
    ],
)
def test_a_plain_number_below_1_that_is_varied_beyond_may_be_a_probability(
    given: Parameter, told: bool, recwarn: pytest.WarningsRecorder
) -> None:
    model = Family(parameters=(given,), build=MODEL.build)
    ranges_of(model)
    assert (len(recwarn) == 1) == told
    if told:
        assert str(recwarn[0].message) == (
            "x, 0.9 today, is varied up to 1.08; if it is a utility or a probability, state "
            'Parameter(name="x", value=…, low=0, high=1), else its range'
        )
    recwarn.clear()
    ranges_of(model, None, None, "1/4")  # who says a share knows
    ranges_of(model, None, {"x": (given.value / 2, given.value)} if given.value > 0 else None)
    assert len(recwarn) == 0


@pytest.mark.parametrize(
    "analyse",
    [
        partial(one_way, name="x", points=2),
        partial(two_way, x="x", y="y", points=2),
        partial(tornado, names=["x"]),
        partial(sobol, names=["x"], n=2),
        worst_point,
    ],
)
def test_a_warning_is_of_the_line_that_asks_for_an_analysis(
    analyse: Callable[[Family], object], recwarn: pytest.WarningsRecorder
) -> None:
    analyse(Family(parameters=(parameter("9/10"), parameter(2, name="y")), build=MODEL.build))
    assert [each.filename for each in recwarn] == [__file__]


def test_what_varies_together_has_a_range_and_is_not_the_discount() -> None:
    assert list_usual_parameters(MODEL) == ["p", "zero", "cost.a"]
    alone = Family(parameters=(parameter("9/10", 0, 1, name="discount"),), build=MODEL.build)
    assert list_usual_parameters(alone) == ["discount"]

    def of(*args: Any) -> dict[str, tuple[Fraction, Fraction]]:
        return {each.name: ends(span) for each, span in spans_of(MODEL, *args).items()}

    assert of() == {"p": (F(2, 5), F(3, 5)), "cost.a": (8, 12)}
    assert of(["discount"]) == {"discount": (F(18, 25), 1)}
    assert of(None, {"discount": ("1/2", "3/4")}) == {"discount": (F(1, 2), F(3, 4))}
    assert of(["zero", "p"], {"zero": (0, 1)}) == {"zero": (0, 1), "p": (F(2, 5), F(3, 5))}
    assert of(["zero", "p"], None, "1/2") == {"p": (F(1, 4), F(3, 4))}
    call = partial(spans_of, MODEL, ["zero"])
    refused(call, "=no parameter has a range", "=model", "=state a range")


def test_points_are_checked_by_column_and_draw() -> None:
    family = Family(
        parameters=(Parameter(name="p", value="1/2", low=0, high=1), Parameter(name="r", value=0)),
        build=lambda values: MDP.from_arrays([[[1]]], [0], "1/2"),
    )
    points = read_points(family, {"r": [-(10.0**6), 2.0], "p": [0.0, 1.0]})
    assert points.tolist() == [[-(10.0**6), 0.0], [2.0, 1.0]]
    assert read_points(family, {"p": ["1/3", 1]}).tolist() == [[Fraction(1, 3)], [Fraction(1)]]
    for table, what, where in (
        ({"p": [0.5, 1.5]}, "p is 1.5, outside [0, 1]", "draw 1"),
        ({"p": [-0.5, 1]}, "p is -0.5, outside [0, 1]", "draw 0"),
        ({"p": []}, "no row", "points"),
        ({"p": [0.5], "r": [1.0, 2.0]}, "columns of shape (1,), (2,)", "points"),
        ({"p": [[0.5]]}, "columns of shape (1, 1)", "points"),
        ({}, "columns of shape none", "points"),
        ({"p": [0.5, np.nan]}, "p is nan, not a finite number", "draw 1"),
        ({"r": [0.5, 1, -np.inf]}, "r is -inf, not a finite number", "draw 2"),
        ({1: [0.5]}, "1 is of type int", "points"),
    ):
        with pytest.raises(ModelError) as caught:
            read_points(family, table)
        assert (caught.value.what, caught.value.where) == (what, where)
