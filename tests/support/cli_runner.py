"""Running the command line in tests: in this process, or as the installed program."""

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from functools import cache
from io import StringIO
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, NoReturn

import click
from click.testing import CliRunner

from exact_mdp import ModelError

ROOT = Path(__file__).resolve().parents[2]
SCRIPTS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["scripts"]
main = resolve_name(SCRIPTS["exact-mdp"])
PROGRAM = Path(sys.executable).with_name("exact-mdp")


@dataclass(frozen=True, kw_only=True)
class Done:
    status: int
    out: str
    err: str

    @property
    def result(self) -> dict[str, Any]:
        """The JSON object that it printed, which has to be all that it printed but for notes."""
        assert self.status in (0, 1), self.err
        assert [line for line in self.err.splitlines() if not line.startswith("note: ")] == []
        content = strict(self.out)
        assert isinstance(content, dict)
        return content

    def refusal(self, status: int = 2) -> str:
        """The error: what, where and fix, in three lines, and nothing else on either stream."""
        assert (self.status, self.out) == (status, ""), self.err
        text = re.sub(
            r'\n\{"format": 2, "status": \d, "error": \{.*\}\}\n$', "\n", self.err
        )  # with --json
        assert re.fullmatch(r"[A-Z]\w+: [^\n]+\n  where: [^\n]+\n  fix:   [^\n]+\n", text), text
        assert len(text) < 3500
        return text

    def error(self) -> ModelError:
        """The refusal as the error that it was."""
        what, where, fix = re.split(r"\n  where: |\n  fix:   ", self.refusal().strip())
        return ModelError(what.partition(": ")[2], where=where, fix=fix)


def strict(text: str) -> Any:
    """Read JSON that has no NaN and no infinity."""

    def refuse(name: str) -> NoReturn:
        raise AssertionError(f"{name} in JSON")

    return json.loads(text, parse_constant=refuse)


def run(line: str = "", *words: object) -> Done:
    """Run a command in this process, by the entry point of the installed program.

    The line is split as a shell does, the other words are not.
    """
    typed = [*shlex.split(line), *map(str, words)]
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        status = main(typed)
    if status == 2 and typed and typed[0] in options():
        check_advice(typed[0], err.getvalue())
    return Done(status=status, out=out.getvalue(), err=err.getvalue())


@cache
def options() -> dict[str, set[str]]:
    """The options of each command."""
    group = resolve_name("exact_mdp.analysis.cli:cli")
    context = click.Context(group)
    made = {name: group.get_command(context, name) for name in group.list_commands(context)}
    return {
        name: {option for param in each.params for option in param.opts} | {"--help"}
        for name, each in made.items()
    }


def check_advice(command: str, message: str) -> None:
    """Assert that the command has the options that a fix names, unless it names another command."""
    fix = message.rpartition("  fix:   ")[2].partition("\n")[0]
    advised = {*re.findall(r"--[a-z][a-z-]+", fix)} if "exact-mdp" not in fix else set()
    assert advised <= options()[command], f"{command} has not all of {advised}"


def ask(program: Any, line: str = "", *words: object) -> Done:
    """Run another program of the project in this process."""
    answer = CliRunner().invoke(program, [*shlex.split(line), *map(str, words)])
    return Done(status=answer.exit_code, out=answer.stdout, err=answer.stderr)


def launch(line: str, *words: object, **environment: str) -> Done:
    done = subprocess.run(
        [PROGRAM, *shlex.split(line), *map(str, words)],
        capture_output=True,
        encoding="utf-8",
        env=os.environ | environment,
    )
    return Done(status=done.returncode, out=done.stdout, err=done.stderr)
