"""Pairs that are redirected, states that become terminal, and labels at which runs end."""

import re
from collections.abc import Mapping
from fractions import Fraction
from fractions import Fraction as F

import numpy as np
import pytest
from oracle import rows_of

from exact_mdp import MDP, Column, ModelError, StateSpace, certify
from exact_mdp.mdp.questions.ending import (
    describe_sense,
    ends_at_label,
    find_labelled_states,
    find_states,
    is_expression,
    list_variables,
    make_terminal,
    redirect_pairs,
)

ROWS = [(0, 0, [("1/3", 0, 4), ("2/3", 1, 7)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 0, "1/2")])]
MODEL = MDP.from_outcomes(ROWS, "1/2", labels={"there": [1]})


def test_redirected_pairs_lead_to_their_states_and_earn_nothing() -> None:
    """Pair 0 leads to 1, and a new pair to 0; the others stay as they are."""
    table = redirect_pairs(MODEL.table, np.array([1, 0, 0, 1], bool), np.array([1, 0, 0, 0]))
    assert [table.row(pair) for pair in range(4)] == [
        [(F(1), 1, F(0))],
        [(F(1), 1, F(2))],
        [(F(1), 0, F(1, 2))],
        [(F(1), 0, F(0))],
    ]


def test_a_terminal_state_stays_in_all_its_pairs() -> None:
    ended = make_terminal(MODEL, np.array([True, False]), name="ended")
    assert rows_of(ended)[:2] == [(0, 0, F(0), {0: F(1)}), (0, 1, F(0), {0: F(1)})]
    assert rows_of(ended)[2] == rows_of(MODEL)[2]
    assert (ended.name, ended.terminal.tolist()) == ("ended", [True, False])


def test_runs_end_at_one_label_only() -> None:
    assert find_labelled_states(MODEL, "there").tolist() == [False, True]
    assert not ends_at_label(MODEL)
    for asked in (MODEL.until("there"), MODEL.reaching("there")):
        assert ends_at_label(asked)
        with pytest.raises(ModelError, match="already answers a question"):
            find_labelled_states(asked, "there")
    with pytest.raises(ModelError, match="the model has none"):
        find_labelled_states(MODEL.with_(labels={}), "there")
    with pytest.raises(ModelError, match="label"):
        find_labelled_states(MODEL, "here")


def test_the_sense_is_said_in_words() -> None:
    costs = MODEL.with_(sense="min")
    assert [describe_sense(mdp) for mdp in (MODEL, costs, costs.reaching("there"))] == [
        *("", "costs to minimise", "least probability of reaching")
    ]


SPACE = StateSpace(
    columns=(
        Column(name="x", size=4),
        Column(name="light", size=3, words=("red", "green", "deep blue")),
        Column(name="code", size=4, bits=2),
    ),
    extra=("out",),
)
WORDS = [
    f"x={x}, y={y}, done={done}" for x in (0, 1, 7) for y in (-2, 5) for done in ("false", "true")
]


def model(space: StateSpace) -> MDP:
    """A model in which each state stays, with the label "even" for states of even number."""
    even = np.arange(space.size) % 2 == 0
    rows = [(state, 0, [(1, state, 0)]) for state in range(space.size)]
    return MDP.from_outcomes(rows, space=space, labels={"even": even})


COLUMNS, NAMED = model(SPACE), model(StateSpace.plain(len(WORDS), WORDS))


def holds_in(text: str, state: int, cells: Mapping[str, str]) -> bool:
    """Evaluate an expression in one state by Python; cells are the values of its variables."""

    def say(match: re.Match[str]) -> str:
        name, sign, value = match[1], match[2], match[3].strip('"')
        if name not in cells:
            return str(sign == "!=")
        if name == "light":
            return str((cells[name] == value) == (sign == "="))
        exactly = f"Fraction({cells[name]!r}) {sign} Fraction({value!r})"
        return str(eval(re.sub(" = ", " == ", exactly)))

    text = re.sub(r'(\w+) *(<=|>=|!=|=|<|>) *("[^"]*"|[\w./-]+)', say, text)
    text = text.replace('"even"', "even").replace("even", str(state % 2 == 0))
    text = text.replace("done", str(cells.get("done") == "true"))
    return bool(eval(text.replace("!", " not ").replace("&", " and ").replace("|", " or ")))


@pytest.mark.parametrize("seed", range(60))
def test_random_expressions(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mdp = (COLUMNS, NAMED)[seed % 2]
    values = {
        "x": ["0", "1", "7/2", "1.5", "9"],
        **({"light": ["red", '"deep blue"']} if mdp is COLUMNS else {"y": ["-2", "5", "0"]}),
    }

    def part(depth: int) -> str:
        kind = rng.integers(6 if depth else 2)
        if kind < 1:
            return str(rng.choice(['"even"', "even", *(["done"] if mdp is NAMED else [])]))
        if kind < 2 or not depth:
            name = str(rng.choice([*values]))
            signs = ["=", "!="] if name == "light" else ["=", "!=", "<", "<=", ">", ">="]
            return f"{name}{rng.choice(signs)}{rng.choice(values[name])}"
        if kind < 3:
            return f"!({part(depth - 1)})"
        if kind < 4:
            return f"({part(depth - 1)})"
        return f"{part(depth - 1)} {'&|'[rng.integers(2)]} {part(depth - 1)}"

    text = part(4)
    found = find_states(mdp, text)
    for state in range(mdp.n_states):
        cells = dict(mdp.space.as_dict(state))
        if mdp is NAMED:
            cells = dict(each.split("=") for each in WORDS[state].split(", "))
        assert found[state] == holds_in(text, state, cells), text


def test_negation_binds_first_and_or_last() -> None:
    assert find_states(COLUMNS, "x=0 & x=1 | x=2").tolist() == find_states(COLUMNS, "x=2").tolist()
    assert find_states(COLUMNS, "x=2 | x=0 & x=1").tolist() == find_states(COLUMNS, "x=2").tolist()
    both = find_states(COLUMNS, "!x=0 & even")
    assert both.tolist() == (~find_states(COLUMNS, "x=0") & COLUMNS.labels["even"]).tolist()


def test_a_state_without_the_variable() -> None:
    last = SPACE.size - 1
    answers = [bool(find_states(COLUMNS, text)[last]) for text in ("x<9", "x!=9", "!(x<9)", "x=0")]
    assert answers == [False, True, True, False]


def test_a_variable_alone_and_too_many_parentheses() -> None:
    assert certify(NAMED.with_(start=1).reaching("done")).start_value == 1
    with pytest.raises(ModelError, match="nested too deeply"):
        find_states(NAMED, "(" * 3000 + "done" + ")" * 3000)


def test_bits_are_no_numbers() -> None:
    assert find_states(COLUMNS, "code=01").sum() == 12
    with pytest.raises(ModelError, match="does not compare two numbers"):
        find_states(COLUMNS, "code<10")
    with pytest.raises(ModelError, match="never has the value '1'"):
        find_states(COLUMNS, "code=1")


def test_variables_of_names() -> None:
    assert [*list_variables(NAMED.space)] == ["x", "y", "done"]
    assert [*list_variables(SPACE)] == ["x", "light", "code"]
    other = StateSpace.plain(2, ["x=1", "y=2"])
    assert list_variables(other)["state"].values == ("x=1", "y=2")
    assert [is_expression(text) for text in ("goal", "far away", "!goal", '"goal"')] == [0, 0, 1, 1]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("z=1", "unknown variable 'z'"),
        ("x=", "a value is missing"),
        ("x=1 &", "a name is missing"),
        ("& x=1", "a name is missing"),
        ("(x=1", r"a \( is not closed"),
        ('light="red', 'a " is not closed'),
        ("x=1 y=1", "'y' is not expected"),
        ("x=1)", r"'\)' is not expected"),
        ("light=rde", "never has the value 'rde'"),
        ("light>red", "does not compare two numbers"),
        ("x<red", "does not compare two numbers"),
        ('"gaol" & x=1', "unknown label or variable 'gaol'"),
        ("light & x=1", "never has the value 'true'"),
    ],
)
def test_what_cannot_be_read(text: str, said: str) -> None:
    with pytest.raises(ModelError, match=said):
        find_states(COLUMNS, text)


def test_questions_take_expressions() -> None:
    def step(place: tuple[int, int], _: int) -> list[tuple[str, tuple[int, int], int]]:
        return [("1/2", (place[0] + move, 0), 1) for move in (1, -1)]

    walk = MDP.from_function((1, 0), lambda place: [0] if place[0] % 3 else [], step)
    named = walk.with_(labels={"top": find_states(walk, 'state="(3, 0)"')})
    for text in ('state="(3, 0)"', "top", "state[0]=3", "state[0]>2 & state[1]=0"):
        assert certify(named.reaching(text)).start_value == Fraction(1, 3)
    assert certify(named.until('top | state="(0, 0)"')).start_value == 2


def test_variables_beside_a_time() -> None:
    """A question within N steps is the same in either order, also of parts of names and tuples."""
    third = [[[Fraction(1, 12)] * 12] * 12]
    named = MDP.from_arrays(third, [0] * 12, states=WORDS)
    pairs = MDP.from_function(
        (0, 0),
        lambda place: [0],
        lambda place, _: [
            ("1/2", ((place[0] + 1) % 3, place[1]), 1),
            ("1/2", (place[0], 1 - place[1]), 1),
        ],
        discount="9/10",
    )
    asked = [(named, "x=7 & y>0 & !done"), (pairs, "state[0]=2 & state[1]=1")]
    for mdp, text in asked:
        for steps in (0, 1, 3):
            first, second = mdp.within(steps).reaching(text), mdp.reaching(text).within(steps)
            assert certify(first).start_value == certify(second).start_value
    assert certify(named.within(1).reaching(asked[0][1])).start_value == Fraction(1, 12)
    found = find_states(named.within(2), "time=1 & x=7")
    assert found.sum() == 4
