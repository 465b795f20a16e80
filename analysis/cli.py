"""The program `exact-mdp`: its commands, its exit statuses and how it fails.

0 done, 1 a check did not hold, 2 bad input or usage. A failure is told on standard error as what,
where and fix, with nothing on standard output. To add a command, write it and name it in COMMANDS.
"""

from __future__ import annotations

import io
import os
import sys
import warnings
from collections.abc import Callable, Sequence

import click

from analysis.cli_check import check
from analysis.cli_evaluate import evaluate, returns, simulate
from analysis.cli_model import convert, info
from analysis.cli_perception import perception
from analysis.cli_sensitivity import sensitivity
from analysis.cli_solve import solve
from analysis.cli_train import train
from analysis.cli_verify import verify

PROGRAM = "exact-mdp"
COMMANDS = (
    info,
    solve,
    evaluate,
    returns,
    simulate,
    verify,
    convert,
    check,
    train,
    sensitivity,
    perception,
)

DONE, FAILED, REFUSED, INTERRUPTED, PIPE_CLOSED = 0, 1, 2, 130, 141


@click.group(
    commands=COMMANDS,
    no_args_is_help=False,
    epilog="MODEL is a shipped scenario (yuan2025, tea), a .toml scenario, a saved .npz or .umb "
    "model, or gymnasium:ID.",
)
@click.version_option(package_name=PROGRAM, message="%(prog)s %(version)s")
def cli() -> None:
    """Exact analysis of finite Markov decision processes."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit status.

    Parameters
    ----------
    arguments : sequence of str, optional
        The words after the program's name; those of this process unless given.
    """
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal may lack a letter of a state's name
        sys.stdout.reconfigure(errors="backslashreplace")
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        with warnings.catch_warnings():
            warnings.showwarning = _warner()
            with cli.make_context(PROGRAM, list(words), obj=words) as context:
                status = cli.invoke(context)
        sys.stdout.flush()
    except click.exceptions.Exit as end:  # --help and --version
        return end.exit_code
    except click.ClickException as error:
        path = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else ""
        what = error.format_message().removesuffix(".")
        return _tell(type(error).__name__, what, path or PROGRAM, f"see {path or PROGRAM} --help")
    except KeyboardInterrupt:
        return INTERRUPTED
    except BrokenPipeError:
        # Python flushes once more when it ends; let that go nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return PIPE_CLOSED
    except MemoryError as error:
        return _tell(
            "MemoryError", str(error) or "not enough memory", PROGRAM, "use a smaller model"
        )
    except Warning as error:  # an error where Python is told so: -W error, PYTHONWARNINGS
        return _tell(
            type(error).__name__, str(error), PROGRAM, "correct it, or let warnings be warnings"
        )
    except (ValueError, RuntimeError) as error:
        return _refuse(error, words)
    return int(status or DONE)


def _refuse(error: Exception, words: Sequence[str]) -> int:
    """Tell of a refused model or an answer that cannot be given; raise anything else again."""
    from mdp.errors import ModelError

    if isinstance(error, ModelError):
        command = next((word for word in words if word in cli.commands), "")
        usage = f"{PROGRAM} {command}".strip()
        where, fix = error.where or usage, error.fix or f"see {usage} --help"
        return _tell("ModelError", error.what, where, fix)

    from analysis.optimum import Contradiction
    from solvers.solution import SolverError

    if isinstance(error, SolverError | Contradiction):
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return FAILED
    raise error


def _tell(kind: str, what: str, where: str, fix: str) -> int:
    print(f"{kind}: {what}\n  where: {where}\n  fix:   {fix}", file=sys.stderr)
    return REFUSED


def _warner() -> Callable[..., None]:
    """Return what tells a warning as one line on standard error, each text once in a command."""
    told: set[str] = set()

    def warn(message: Warning | str, *rest: object, **more: object) -> None:
        if str(message) not in told:
            told.add(str(message))
            print(f"warning: {message}", file=sys.stderr)

    return warn
