"""Every problem of a scenario file at once, with its line, and what was probably meant.

TOML's own reader stops at the first fault. Here each statement of the file is read alone, so that a
broken one hides no other; where a number can be guessed (20% is 0.2), the rest is checked with the
guess. The keys and their rules are those of `toml.Reader`, which reads every scenario. Two things
are no errors and yet suspicious: a weight whose sign is unlike its meaning, and chances that add up
to more than 1 and are cut off there.
"""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from exact_mdp.mdp.care.laws import excess
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.care.tables import BONUSES
from exact_mdp.mdp.care.toml import TABLES, Reader
from exact_mdp.mdp.errors import ModelError, shown_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.table import exact, shown

HEADER = re.compile(r"\s*\[([^\[\]]*)\]\s*(#.*)?$")
BEGINS = re.compile(r"\s*([\w.\"'-]+\s*=|\[[^\[\],]*\]\s*(#.*)?$)")
LOOSE = str.maketrans({"−": "-", "–": "-", "\N{FULLWIDTH PERCENT SIGN}": "%"})
LONGEST = 1000  # lines of a statement
WORD = re.compile(r"[^\s,\[\]\"']+(?: [^\s,\[\]\"']+)*")


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One thing that is wrong with a file, or suspicious.

    Attributes
    ----------
    line : int or None
        None where something is missing from the whole file.
    text : str
        That line.
    what, fix : str
    severity : str
        error or warning.
    """

    line: int | None
    text: str
    what: str
    fix: str
    severity: str = "error"


def lint(text: str, name: str) -> tuple[Problem, ...]:
    """Return every problem of a scenario's text, in the order of its lines.

    Examples
    --------
    >>> for problem in lint("statuses = ['anger']\\nmax_trial = 3\\n[base]\\nanger = 20%", "x")[:2]:
    ...     print(problem.line, problem.what, "|", problem.fix)
    4 base.anger cannot be read: 20% | write anger = 0.2
    None actions is not a list of different names | write, ... ["forgetfulness", "anger"], ...
    """
    return _File(text).problems(name)


@dataclass(kw_only=True)
class _File:
    """The statements of a file, put together one by one."""

    text: str = field(kw_only=False)
    content: dict[str, Any] = field(default_factory=dict)
    line: dict[str, int] = field(default_factory=dict)  # of each key, by its dotted name
    opened: dict[str, int] = field(default_factory=dict)  # line of each [table]
    unread: set[str] = field(default_factory=set)
    found: list[Problem] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.lines = self.text.split("\n")
        self.table: tuple[str, ...] = ()
        sound = list(self.lines)
        for number, statement in _statements(self.lines):
            before = len(self.found)
            if header := HEADER.match(statement):
                self._open(number, header[1])
                continue
            self._state(number, statement)
            if len(self.found) > before:
                last = number + statement.count("\n")
                sound[number - 1 : last] = [""] * (last - number + 1)
        try:  # what only the whole text shows
            toml_of("\n".join(sound), "file")
        except ModelError as error:
            found = re.search(r"at line (\d+)", error.what)
            at = int(found[1]) if found else None
            if not self.found or (at and at not in {each.line for each in self.found}):
                self._add(at, error.what, error.fix)

    def problems(self, name: str) -> tuple[Problem, ...]:
        """Return what is wrong with the whole."""
        reader = Reader(self.content, unread=self.unread)
        scenario = reader.read(Scenario, default_name=name)
        if scenario is None:  # the names are unreadable: tables that have one number each tell them
            known = self.content | {"statuses": self._statuses()}
            known |= {"actions": [*self._names("reward", "assist")]}
            first = {key for key, _ in reader.problems} | self.unread
            named = {key: known[key] for key in ("statuses", "actions") if key in first}
            again = Reader(self.content | named, unread=self.unread)
            scenario = again.read(Scenario, default_name=name)
            reader.problems += [each for each in again.problems if each[0] not in first]
        told: set[str] = set()
        for key, error in reader.problems:
            parts = key.split(".")
            above = {".".join(parts[:count]) for count in range(1, len(parts))}
            if not above & told:
                self._add(self._line_of(key), error.what, self._advice(key, error))
            told.add(key)
        if scenario is not None:
            self._suspect(scenario)
        last = len(self.lines) + 1  # what is missing comes last
        return tuple(sorted(self.found, key=lambda problem: problem.line or last))

    def _statuses(self) -> list[str]:
        """Return the names that two tables of statuses have, else those that have a base number."""
        inner = [self._names("influence", row) for row in self._names("influence")]
        inner += [self._names("assistance", act) for act in self._names("assistance")]
        tables = [*map(self._names, ("base", "persistence", "skip", "influence")), *inner]
        times = Counter(name for table in tables for name in table)
        return [name for name in times if times[name] > 1] or [*self._names("base")]

    def _names(self, *path: str) -> dict[str, Any]:
        """Return the table at a path, empty where there is none."""
        table: Any = self.content
        for part in path:
            table = table.get(part) if isinstance(table, dict) else None
        return table if isinstance(table, dict) else {}

    def _add(self, line: int | None, what: str, fix: str, severity: str = "error") -> None:
        text = shown_text(self.lines[line - 1].strip()) if line else ""
        self.found.append(Problem(line=line, text=text, what=what, fix=fix, severity=severity))

    def _line_of(self, key: str) -> int | None:
        """Return the line of a key, or of the table that it belongs in."""
        while key and key not in self.line:
            key = key.rpartition(".")[0]
        return self.line.get(key)

    # ---- statements --------------------------------------------------------------------------

    def _open(self, number: int, title: str) -> None:
        """Begin a table."""
        try:
            path: list[str] = []
            below = tomllib.loads(f"[{title}]")
            while below:
                path += below
                below = below[path[-1]]
        except ValueError:
            path = [part.strip() for part in title.split(".")]
            self._add(number, f"[{title}] is not the name of a table", f"write [{'.'.join(path)}]")
        self.table = tuple(path)
        self._put(number, self.table, {}, table=True)

    def _state(self, number: int, statement: str) -> None:
        """Read one `key = value`; where its value is broken, take what was probably meant."""
        key, equals, value = statement.partition("=")
        name = key.strip().strip("\"'")
        try:
            stated = toml_of(statement, "")
        except ModelError as error:
            if not equals or not name:
                self._add(number, "neither a [table] nor key = value", "correct that line")
                return
            dotted = ".".join((*self.table, name))
            numeric = dotted.partition(".")[0] in TABLES and name != "other"
            guess, said = _meant(value, words=not numeric), shown_text(value.strip())[:60]
            fault = error.what.removeprefix("broken TOML: ").partition(" (at ")[0]
            fix = "write a number" if numeric else f"correct it ({fault})"
            fix = f"write {name} = {guess}" if guess else fix
            self._add(number, f"{dotted} cannot be read: {said}", fix)
            if not guess:
                self.unread.add(dotted)
                self.line.setdefault(dotted, number)
                return
            stated = tomllib.loads(f"value = {guess}", parse_float=exact)
            stated = {name: stated["value"]}
        self._put(number, self.table, stated)

    def _put(
        self, number: int, path: tuple[str, ...], stated: dict[str, Any], *, table: bool = False
    ) -> None:
        """Add what a statement says to the content; a key that is there already is named."""
        dotted, here = ".".join(path), self.content
        if table and (first := self.opened.setdefault(dotted, number)) != number:
            self._add(number, f"[{dotted}] stands twice, first in line {first}", "join the two")
        for count, part in enumerate(path, start=1):
            self.line.setdefault(".".join(path[:count]), number)
            here = here.setdefault(part, {})
            if not isinstance(here, dict):
                self._add(number, f"{dotted} is a value and a table", "keep one of them")
                return
        for key, value in stated.items():
            name = ".".join((*path, key))
            if isinstance(value, dict) and isinstance(here.get(key, {}), dict):
                self._put(number, (*path, key), value)
            elif key in here:
                first = self.line[name]
                self._add(number, f"{name} is given twice, first in line {first}", "keep one")
            else:
                here[key] = value
                self.line[name] = number

    # ---- what was meant ----------------------------------------------------------------------

    def _advice(self, key: str, error: ModelError) -> str:
        """Return how to correct a value, with the number that was probably meant."""
        value: Any = self.content
        for part in key.split("."):
            value = value.get(part) if isinstance(value, dict) else None
        table, guess = key.partition(".")[0], None
        chance = table == "discount" or (table in TABLES and table != "reward")
        if isinstance(value, str) and (chance or table in ("reward", "max_trial")):
            guess = _meant(value)
            number = exact(guess.strip('"')) if guess else Fraction(1)
            fits = 0 <= number <= 1 if chance else table == "reward" or _count(number)
            guess = guess if fits else None
        elif chance and isinstance(value, int | Fraction) and not isinstance(value, bool):
            number = Fraction(value)
            if 2 <= number <= 100 and (key != "discount" or number >= 50):
                guess = _written(number / 100)  # 1.5 is no percentage that anybody means
            elif -1 <= number < 0:
                guess = _written(-number)
        return f"did you mean {guess}? ({error.fix})" if guess else error.fix

    def _suspect(self, scenario: Scenario) -> None:
        """Warn of signs unlike their meaning, and of chances above 1."""
        for parameter in scenario.parameters:
            name = parameter.name.removeprefix("reward.")
            if name == parameter.name or not parameter.value:
                continue
            gain = name in BONUSES
            if gain != (parameter.value > 0):
                words = "a reward is negative" if gain else "a cost is positive"
                what = f"{parameter.name} is {shown(parameter.value)}: {words}"
                line = self._line_of(parameter.name)
                self._add(line, what, f"did you mean {_written(-parameter.value)}?", "warning")
        if (said := excess(scenario)) is not None:
            names = re.findall(r"((?:base|persistence|influence|skip)\.[\w.-]+)", said)
            line = self._line_of(names[0]) if names else None
            self._add(line, said, "lower one of these numbers until they sum to 1", "warning")


def _statements(lines: list[str]) -> Iterator[tuple[int, str]]:
    """Yield the first line's number and the text of each statement, an open one up to the next."""
    number = 0
    while number < len(lines):
        last = number + 1
        if lines[number].strip() and not lines[number].lstrip().startswith("#"):
            most = min(len(lines), number + LONGEST)
            while last < most and _open("\n".join(lines[number:last])):
                if BEGINS.match(lines[last]):
                    break
                last += 1
            yield number + 1, "\n".join(lines[number:last])
        number = last


def _open(statement: str) -> bool:
    """Whether a list or a text of several lines has not ended."""
    bare = re.sub(r'"""(?s:.*?)"""|\'\'\'(?s:.*?)\'\'\'', "", statement)
    if '"""' in bare or "'''" in bare:
        return True
    bare = re.sub(r'"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\'|#.*', "", bare)
    return sum(map(bare.count, "[{")) > sum(map(bare.count, "]}"))


def _meant(value: str, *, words: bool = False) -> str | None:
    """Return the TOML that a broken value was probably meant to be; `words` may be texts.

    Examples
    --------
    >>> _meant(" 20 % # often"), _meant("2/3"), _meant("0,25"), _meant(".5"), _meant("often")
    ('0.2', '"2/3"', '0.25', '0.5', None)
    >>> _meant("[a, b c", words=True)
    '["a", "b c"]'
    """
    text = value.partition("#")[0].strip().translate(LOOSE)
    plain = re.sub(r"^(-?\d*),(\d+)", r"\1.\2", text.strip("\"'“”‘’ "))
    number, percent, rest = plain.partition("%")
    try:
        found = exact(number.strip()) / (100 if percent else 1)
        if not rest.strip():
            return _written(found)
    except ModelError:
        pass
    quoted = re.sub("[\"'“”‘’]", "", text) + "]" * (text.count("[") - text.count("]"))
    quoted = WORD.sub(lambda word: word[0] if word[0].isdigit() else f'"{word[0]}"', quoted)
    try:
        tomllib.loads(f"value = {quoted}")
    except (ValueError, RecursionError):
        return None
    return quoted if words else None


def _count(number: Fraction) -> bool:
    return number > 0 and number.denominator == 1


def _written(number: Fraction) -> str:
    """Return a number as a file states it exactly."""
    text = shown(number, 15)
    return text if exact(text) == number else f'"{number}"'
