"""Every problem of a scenario file at once, each with its line, by the rules of `toml.Reader`.

Two things are suspicious where there is no error: a weight whose sign is unlike its meaning, and
chances that add up to more than 1 and are cut off there. A text that is not TOML has one problem.
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
        line = int(at[1]) if at else None
        return [{"line": line, "what": error.what, "fix": error.fix, "severity": "error"}]
    lines, problems = _locate_keys(text), list[dict[str, Any]]()

    def add_problem(key: str, what: str, fix: str, severity: str = "error") -> None:
        while key and key not in lines:  # what is missing belongs to its table
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
    for parameter in tables.parameters if tables else ():
        table, _, weight = parameter.name.partition(".")
        sign = 1 if weight in BONUSES else -1
        if table == "reward" and sign * parameter.value < 0:
            words = "a reward is negative" if sign > 0 else "a cost is positive"
            what = f"{parameter.name} is {format_rational(parameter.value)}: {words}"
            add_problem(
                parameter.name,
                what,
                f"did you mean {format_rational(-parameter.value)}?",
                "warning",
            )
    if tables and (above := describe_excess(Laws.of(tables))):
        first = re.findall(r"(?:base|persistence|influence|skip)\.\S+", above)[0]
        add_problem(first, above, "lower one of these numbers until they sum to 1", "warning")
    return sorted(problems, key=lambda problem: problem["line"] or len(text))


def _locate_keys(text: str) -> dict[str, int]:
    """Return the line of each key and each table of a TOML text, by its dotted name."""
    lines, above = dict[str, int](), list[str]()
    text = TEXTS.sub(lambda part: part[0].count("\n") * "\n" or part[0], text)
    for number, line in enumerate(text.split("\n"), start=1):
        if statement := STATEMENT.match(line):
            path = [part.strip("\"'") for part in NAME.findall(statement[0])]
            above, path = (path, path) if statement[1] else (above, above + path)
            for count in range(len(path)):
                lines.setdefault(".".join(path[: count + 1]), number)
    return lines
