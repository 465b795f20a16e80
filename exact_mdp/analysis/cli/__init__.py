"""The program `exact-mdp`; `exact_mdp.analysis.exit_status` says how it ends.

`commands` makes its commands from functions, and `render` shows the report. A failure is reported
on standard error as what, where and fix, with nothing on standard output.
"""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from textwrap import indent

import click
from click.shell_completion import shell_complete

from exact_mdp.analysis import ci
from exact_mdp.analysis.cli.commands import HELP, Commands
from exact_mdp.analysis.exit_status import REFUSED, end_process, print_message, run_command
from exact_mdp.mdp.io.formats import FORMATS, describe_formats

PROGRAM = "exact-mdp"
COMPLETE = "_EXACT_MDP_COMPLETE"  # set by the shell when it completes words


@click.group(
    cls=Commands,
    context_settings={"help_option_names": HELP},
    epilog="MODEL is a shipped scenario (yuan2025, tea), a file, gymnasium:ID, or - for a .json "
    f"model on standard input. Files: {describe_formats(FORMATS)}.",
)
@click.version_option(package_name=PROGRAM, message="%(prog)s %(version)s")
def cli() -> None:
    """Exact analysis of finite Markov decision processes."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, by default the one of this process, and return its exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    completion = os.environ.get(COMPLETE)
    if completion:
        return shell_complete(cli, {}, PROGRAM, COMPLETE, completion)
    if words:
        status = run_command(cli, PROGRAM, words, on_error=_prepare_error_report(words))
    else:
        # An empty command in a job has no verdict, so it must not succeed.
        print_message(cli.get_help(click.Context(cli, info_name=PROGRAM, **cli.context_settings)))
        status = REFUSED
    if arguments is None:
        end_process(status)
    return status


def _prepare_error_report(words: list[str]) -> Callable[[str], None] | None:
    """Return a function that reports a failed check in its JUnit file and on GitHub's page.

    The file states from the start that the check did not end, so that no report of an earlier run
    remains if the process is killed.
    """
    if words[0] != "check" or not set(HELP).isdisjoint(words):
        return None
    named = re.findall("\0--junit[=\0]([^\0]+\\.xml)\0", "\0".join([*words, ""]), re.IGNORECASE)
    junit = None
    if named and Path(named[-1]).parent.is_dir():
        junit = named[-1]
    title = f"{PROGRAM} check"
    ci.write_error(
        junit, title, "the check did not end: the process was killed, or is still at work"
    )

    def on_error(message: str) -> None:
        ci.write_error(junit, title, message)
        ci.print_annotation(title, message)
        with suppress(ValueError, OSError):
            ci.append_summary(f"## The check came to no verdict\n\n{indent(message, ' ' * 4)}")

    return on_error
