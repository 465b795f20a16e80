"""The parts that files share: numbers as JSON and back, what is left out, what a file states."""

import json
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import pytest

from exact_mdp import MDP, ModelError
from exact_mdp.mdp.io.parts import (
    PARTS,
    build_model,
    encode_hexadecimal,
    encode_parts,
    encode_rationals,
    list_sets,
    parse_natural,
    parse_positive,
    parse_rational,
    parse_unreached,
    states_format,
    write_object,
)
from exact_mdp.mdp.io.structured import require_shape

STEP = MDP.from_outcomes(
    [(0, 0, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])], "1/2", labels={"goal": [False, True]}, name="step"
)
LARGE = 2**53


@pytest.mark.parametrize(
    ("number", "written"),
    [
        (F(0), 0),
        (F(-7), -7),
        (F(LARGE - 1), LARGE - 1),
        (F(LARGE), hex(LARGE)),
        (F(-LARGE), hex(-LARGE)),
        (F(-1, 3), "-1/3"),
        (F(1, LARGE - 1), f"1/{LARGE - 1}"),
        (F(1, LARGE), f"0x1/{hex(LARGE)}"),
        (F(-LARGE - 1, 2), f"{hex(-LARGE - 1)}/0x2"),
    ],
)
def test_a_number_is_written_and_read(number: F, written: Any) -> None:
    assert encode_rationals(number) == written
    assert encode_rationals({"a": (number, ["x"])}) == {"a": [written, ["x"]]}
    assert parse_rational(json.loads(json.dumps(written))) == number
    assert parse_rational(encode_hexadecimal(number)) == number


@pytest.mark.parametrize(
    ("parse", "given"),
    [
        *((parse_rational, each) for each in (0.5, True, None, "007", "1/0", "1e3", "1/-2", "")),
        *((parse_natural, each) for each in (-1, 2**62, 1.0, True, "1")),
        *((parse_positive, each) for each in (0, -1, "1/2", None)),
        *((parse_unreached, each) for each in (0, None, "nan", ["inf"])),
    ],
)
def test_what_is_no_such_number_is_refused(parse: Any, given: Any) -> None:
    with pytest.raises(ModelError, match="is not"):
        parse(given)


def test_the_limits_of_numbers() -> None:
    assert (parse_natural(0), parse_natural(2**62 - 1), parse_positive("0x1")) == (0, 2**62 - 1, 1)
    assert (parse_unreached("inf"), parse_unreached("-inf")) == (float("inf"), -float("inf"))


def test_shared_parts_come_back() -> None:
    for mdp in (STEP, STEP.until("goal"), STEP.with_(discount=1, time_limit=3).reaching("goal")):
        written = json.loads(json.dumps(encode_rationals(encode_parts(mdp))))
        assert ("averaged" in written) == mdp.table.averaged
        again = build_model(
            require_shape(written, PARTS),
            mdp.table,
            pair_state=mdp.pair_state,
            pair_action=mdp.pair_action,
            space=mdp.space,
            actions=mdp.actions,
            start=mdp.start,
            labels=mdp.labels,
            component_names=mdp.component_names,
            **list_sets(mdp),
        )
        for name in ("name", "discount_exact", "sense", "time_limit", "unreached", "floats"):
            assert getattr(again, name) == getattr(mdp, name)
        assert encode_parts(again) == encode_parts(mdp)


def test_a_goal_stands_for_its_target() -> None:
    assert list_sets(STEP) == {}
    assert [*list_sets(STEP.until("goal"))] == ["target"]
    goal = list_sets(STEP.with_(discount=1).until("goal"))
    assert [*goal] == ["goal"]


def test_a_file_states_its_format(tmp_path: Path) -> None:
    assert states_format({"format": "a", "version": 1}, "a", 1)
    for given in ([], {}, {"format": "a", "version": 1.0}, {"format": "a", "version": True},
                  {"format": "b", "version": 1}, {"format": "a", "version": 2}):  # fmt: skip
        assert not states_format(given, "a", 1)
    content = {"pairs": [{"a": 1}, {"b": "ü"}], "name": "x", "start": [0, 1]}
    write_object(tmp_path / "m", content, ["pairs"])
    text = (tmp_path / "m").read_text("utf-8")
    assert text == (
        '{"name": "x",\n "start": [0, 1],\n "pairs": [\n  {"a": 1},\n  {"b": "\\u00fc"}]}\n'
    )
    assert json.loads(text) == content
