"""All problems of a scenario file, each with its line, as `toml.Reader` finds them.

Without errors there may be two kinds of warnings: a weight with an unlikely sign, and probabilities
that add up to more than 1 and are cut off there. A text that is not TOML has one problem.
"""

from __future__ import annotations

import re
from typing import Any

from exact_mdp.mdp.care.laws import Laws, describe_excess
from exact_mdp.mdp.care.tables import BONUSES, ScenarioTables
from exact_mdp.mdp.care.toml import Reader
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.table import format_rational

TEXTS = re.compile(r'"""(?s:.*?)"""|\'\'\'(?s:.*?)\'\'\'|"(?:\\.|[^"\\\n])*"|\'[^\'\n]*\'|#.*')
NAME = re.compile(r"""[\w-]+|"[^"]*"|'[^']*'""")
STATEMENT = re.compile(rf"\s*(?:(\[)(?:{NAME.pattern}|[\s.])+\]|(?:{NAME.pattern}|[\s.])+=)")


def lint_scenario(text: str, name: str) -> list[dict[str, Any]]:
    """Return the line, what, fix and severity of every problem of a scenario's text."""
    try:
        reader = Reader(toml_of(text, name), name)
    except ModelError as error:
        at = re.search(r"at line (\d+)", error.what)
        line = None
        if at:
            line = int(at[1])
        return [{"line": line, "what": error.what, "fix": error.fix, "severity": "error"}]
    lines, problems = _locate_keys(text), list[dict[str, Any]]()

    def add_problem(key: str, what: str, fix: str, severity: str = "error") -> None:
        while key and key not in lines:  # a missing key gets the line of its table
            key = key.rpartition(".")[0]
        problems.append({"line": lines.get(key), "what": what, "fix": fix, "severity": severity})

    faults, tables = reader.problems, None
    if not faults:
        try:
            tables = ScenarioTables(**reader.parts)
        except ModelError as error:
            faults = [error]
    for fault in faults:
        add_problem(fault.where, fault.what, fault.fix)
    if tables is None:
        return _sort_by_line(problems, text)
    # Warnings: signs of weights, and sums of probabilities above 1.
    for parameter in tables.parameters:
        table, _, weight = parameter.name.partition(".")
        if table != "reward":
            continue
        wrong, words = parameter.value > 0, "a cost is positive"
        if weight in BONUSES:
            wrong, words = parameter.value < 0, "a reward is negative"
        if wrong:
            what = f"{parameter.name} is {format_rational(parameter.value)}: {words}"
            add_problem(
                parameter.name,
                what,
                f"did you mean {format_rational(-parameter.value)}?",
                "warning",
            )
    above = describe_excess(Laws.of(tables))
    if above:
        first = re.findall(r"(?:base|persistence|influence|skip)\.\S+", above)[0]
        add_problem(first, above, "lower one of these numbers until they sum to 1", "warning")
    return _sort_by_line(problems, text)


def _sort_by_line(problems: list[dict[str, Any]], text: str) -> list[dict[str, Any]]:
    """Return problems in the order of the text; those without a line come last."""
    return sorted(problems, key=lambda problem: problem["line"] or len(text))


def _locate_keys(text: str) -> dict[str, int]:
    """Return the line of each key and each table of a TOML text, by its dotted name."""
    lines, above = dict[str, int](), list[str]()
    # Strings and comments may look like keys: replace such text over several lines by empty lines.
    text = TEXTS.sub(lambda part: part[0].count("\n") * "\n" or part[0], text)
    for number, line in enumerate(text.split("\n"), start=1):
        statement = STATEMENT.match(line)
        if statement:
            path = [part.strip("\"'") for part in NAME.findall(statement[0])]
            if statement[1]:  # the header of a table
                above = path
            else:
                path = above + path
            for count in range(len(path)):
                lines.setdefault(".".join(path[: count + 1]), number)
    return lines
