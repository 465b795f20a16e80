"""Runs that end at a label, and the states that a label or an expression stands for.

A pair is redirected if it leads surely to one state and earns 0; a state becomes terminal if its
pairs are redirected to itself.

An expression compares state variables, and joins comparisons and labels by & and |:

    x=3 & (y>1 | !"goal")

A variable is a column of the state space. If states have names such as "x=3, done=true", as from a
PRISM program, its variables are x and done; if states are tuples, state[0] is the first part. A
variable is compared (=, !=, <, <=, >, >=) with a number or a word; a word with spaces needs
quotation marks. A variable that is true or false may stand alone. ! binds more closely than &, and
& more closely than |. A comparison does not hold in a state without the variable, such as an
additional end, but its negation does.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, require_known_name, suggest_name
from exact_mdp.mdp.forms.names import text_of
from exact_mdp.mdp.space import Column, Integers, StateSpace
from exact_mdp.mdp.table import Numbers, OutcomeTable
from exact_mdp.mdp.validate import Flags, Parts

REACHED = "reached"
ONE_COMPONENT = {"component_names": ("reward",)}
# A question changes the rows, so counts of the original rows no longer describe them.
NO_DATA: dict[str, Any] = {"observations": None, "episodes": None}
NO_GOAL: dict[str, Any] = {"goal": None, "target": None}


def describe_sense(model: Parts) -> str:
    """Return in words what the value of a model measures; "" for rewards to maximise."""
    if REACHED in model.space.extra:
        return f"{model.sense.best} probability of reaching"
    if model.sense.costs:
        return "costs to minimise"
    return ""


def ends_at_label(model: Parts) -> bool:
    """Return whether runs end at a label: the model is one of `until` or `reaching`."""
    return model.target is not None or REACHED in model.space.extra


def find_labelled_states(model: Parts, label: str) -> Flags:
    """Return the states (S,) of a label, or of an expression over labels and state variables.

    Raises ModelError if the label is unknown, if the expression cannot be read, and if the model
    already answers a question: its runs have been cut off.
    """
    if ends_at_label(model):
        raise ModelError(
            "this model already answers a question, and its runs end there",
            where=f"label {label!r}",
            fix="ask the model that it was made from, or give one label to the states of both "
            "questions",
        )
    named = isinstance(label, str) and label not in model.labels
    if named and (is_expression(label) or label in list_variables(model.space)):
        return find_states(model, label)
    if not model.labels:
        raise ModelError(
            f"unknown label {label!r}",
            where="labels",
            fix="the model has none: build it with labels={name: (S,) truth values}, or give an "
            "expression such as 'state=3'",
        )
    return model.labels[require_known_name(label, model.labels, "label", "labels")]


def redirect_pairs(table: OutcomeTable, ends: Flags, follows: Numbers) -> OutcomeTable:
    """Return a table in which the pairs in `ends` (L,) lead surely to `follows` (L,), earning 0.

    Both arrays may have one entry more, for a new pair at the end.
    """

    def append_certain_pair(name: str, values: Numbers) -> Numbers:
        return np.concatenate([values, fill_certain(name, values, 1)])

    # Append one certain outcome; every redirected pair then becomes a copy of it.
    ending = table.map_numbers(
        append_certain_pair,
        append_certain_pair,
        offsets=np.append(table.offsets, table.offsets[-1] + 1),
        next_states=np.append(table.next, table.next.dtype.type(0)),
    )
    ended = ending.of_pairs(np.where(ends, table.pairs, np.arange(len(ends))))
    # Each copy leads to a state of its own.
    lengths = np.diff(ended.offsets)
    moved = np.repeat(np.asarray(follows), lengths).astype(ended.next.dtype)
    following = np.where(np.repeat(ends, lengths), moved, ended.next)
    return replace(ended, rows=replace(ended.rows, next=following))


def make_terminal(model: Any, states: Flags, **changes: Any) -> Any:
    """Return the model with the given states (S,) made terminal, and with other changes."""
    table = redirect_pairs(model.table, states[model.pair_state], model.pair_state)
    return replace(model, table=table, **NO_DATA, **changes)


def fill_certain(name: str, values: Numbers, count: int) -> Numbers:
    """Return entries of the array `name` for `count` outcomes that are certain and earn 0."""
    one = name == "weight" or name.endswith("denominator")
    return np.full((count, *values.shape[1:]), int(one), dtype=values.dtype)


# ---- expressions ---------------------------------------------------------------------------------

COMPARED: dict[str, Callable[[Any, Any], bool]] = {
    "=": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
TOKEN = re.compile(r'\s*(?:(<=|>=|!=|[=<>!&|()])|"([^"]*)"|([^\s<>=!&|()"]+))')
NAMED = re.compile(r"(\w+)=([^,=]+)")
NUMBER = re.compile(r"-?[0-9]{1,400}(\.[0-9]{1,400}|/0*[1-9][0-9]{0,400})?")


def is_expression(text: object) -> bool:
    """Return whether a text is more than a name: it compares, negates, joins or quotes."""
    return isinstance(text, str) and bool(re.search(r'[<>=!&|()"]', text))


def find_states(model: Parts, text: str) -> Flags:
    """Return (S,) True for the states of which an expression holds.

    Raises ModelError for a text that cannot be read, and for unknown labels and variables.
    """
    try:
        return _Reader(model, text).read_whole()
    except RecursionError:
        what, fix = "the expression is nested too deeply", "use fewer parentheses and negations"
        raise ModelError(what, where=f"{text!r:.60}", fix=fix) from None


class _Reader:
    """Reads an expression from left to right; each method returns the states of a part of it."""

    def __init__(self, model: Parts, text: str) -> None:
        self.model, self.text = model, text
        self.variables = list_variables(model.space)
        self.tokens = list[tuple[str, str]]()  # (kind, text); kinds are "sign", "quoted" and "word"
        place = 0
        while place < len(text.rstrip()):
            found = TOKEN.match(text, place)
            if found is None:
                raise self._refuse('a " is not closed', "close it")
            groups = zip(("sign", "quoted", "word"), found.groups(), strict=True)
            self.tokens += [(kind, token) for kind, token in groups if token is not None]
            place = found.end()

    def read_whole(self) -> Flags:
        """Return the states of the whole expression."""
        holds = self._read_joined("|")
        if self.tokens:
            raise self._refuse(f"{self.tokens[0][1]!r} is not expected", "put & or | before it")
        return holds

    def _read_joined(self, sign: str) -> Flags:
        """Return the states of parts joined by & or by |; the parts of | are joined by &."""
        read_part: Callable[[], Flags] = self._read_negated
        join: Callable[[Flags, Flags], Flags] = np.logical_and
        if sign == "|":
            read_part, join = partial(self._read_joined, "&"), np.logical_or
        holds = read_part()
        while self._take(sign):
            holds = join(holds, read_part())
        return holds

    def _read_negated(self) -> Flags:
        """Return the states of a comparison, of a label, or of a part in parentheses."""
        if self._take("!"):
            return ~self._read_negated()
        if self._take("("):
            holds = self._read_joined("|")
            if not self._take(")"):
                raise self._refuse("a ( is not closed", "close it")
            return holds
        name, quoted = self._take_name("a name")
        sign = next((sign for sign in COMPARED if self._take(sign)), None)
        if sign is not None:
            return self._compare(name, sign, self._take_name("a value")[0])
        if name in self.model.labels:
            return self.model.labels[name]
        if not quoted and name in self.variables:
            return self._compare(name, "=", "true")
        known = [*self.model.labels, *self.variables]
        raise self._refuse(f"unknown label or variable {name!r}", suggest_name(name, known))

    def _compare(self, name: str, sign: str, text: str) -> Flags:
        """Return the states in which a variable compares with a value."""
        if name not in self.variables:
            raise self._refuse(f"unknown variable {name!r}", suggest_name(name, self.variables))
        variable, order = self.variables[name], sign not in ("=", "!=")
        given = variable.numbers_of([text])[0]
        if order and (given is None or None in variable.numbers):
            fix = "compare numbers by <, <=, > and >=, and other values by = and !="
            raise self._refuse(f"{name} {sign} {text} does not compare two numbers", fix)
        if given is None and text not in variable.values:
            fix = suggest_name(text, variable.values)
            raise self._refuse(f"{name} never has the value {text!r}", fix)
        pairs = zip(variable.values, variable.numbers, strict=True)
        holds = [
            COMPARED[sign](number, given) if None not in (number, given) else
            COMPARED[sign](value, text)
            for value, number in pairs
        ]  # fmt: skip
        # The last answer is for states without the variable, which have the number -1.
        return np.array([*holds, sign == "!="])[variable.number]

    def _take(self, sign: str) -> bool:
        """Whether the next token is this sign; if so, go on after it."""
        if self.tokens[:1] != [("sign", sign)]:
            return False
        self.tokens.pop(0)
        return True

    def _take_name(self, what: str) -> tuple[str, bool]:
        """Return a word or a quoted text, and whether it is quoted."""
        if not self.tokens or self.tokens[0][0] == "sign":
            raise self._refuse(f"{what} is missing", 'write it as x=3 & y>1, or !"label"')
        kind, text = self.tokens.pop(0)
        return text, kind == "quoted"

    def _refuse(self, what: str, fix: str) -> ModelError:
        """Return the error for this expression."""
        return ModelError(what, where=f"{self.text!r}", fix=fix)


@dataclass(frozen=True)
class Variable:
    """A variable of the states: its values as texts, and the place of each state's value."""

    values: tuple[str, ...]
    number: Integers  # (S,), -1 in a state without the variable
    of_bits: bool = False

    @cached_property
    def numbers(self) -> list[Fraction | None]:
        """The values that are numbers; None for the others."""
        return self.numbers_of(self.values)

    def numbers_of(self, texts: Iterable[str]) -> list[Fraction | None]:
        """Return texts as numbers, None for other texts; rows of bits are not numbers."""
        return [
            Fraction(text) if NUMBER.fullmatch(text) and not self.of_bits else None
            for text in texts
        ]


def list_variables(space: StateSpace) -> dict[str, Variable]:
    """Return the variables of the states, by name."""
    variables: dict[str, Variable] = {}
    for column in space.columns:
        variables |= _list_column_variables(column, space.values(column.name))
    return variables


def _list_column_variables(column: Column, place: Integers) -> dict[str, Variable]:
    """Return the variables that a column stands for, in states with these places (S,) in it."""
    named = [dict(re.findall(NAMED, word)) for word in column.words]
    if named and named[0] and all({*each} == {*named[0]} for each in named):
        return {name: _gather([each[name] for each in named], place) for name in named[0]}
    # States that are tuples have their parts.
    parts: dict[str, Variable] = {}
    things = [thing for thing in column.objects if isinstance(thing, tuple)]
    lengths = {*map(len, things)}
    if len(things) == len(column.objects) and len(lengths) == 1:
        for number in range(*lengths):
            texts = [text_of(thing[number]) for thing in things]
            parts[f"{column.name}[{number}]"] = _gather(texts, place)
    parts[column.name] = Variable(
        values=tuple(map(column.label, range(column.size))),
        number=place,
        of_bits=column.bits > 0,
    )
    return parts


def _gather(words: list[str], place: Integers) -> Variable:
    """Return the variable with one of some values for each place in a column."""
    values = tuple(dict.fromkeys(words))
    numbers = {value: number for number, value in enumerate(values)}
    # The last number is for states without the column, which have the place -1.
    number = np.array([*map(numbers.__getitem__, words), -1], dtype=np.int64)
    return Variable(values=values, number=number[place])
