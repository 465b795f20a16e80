"""How the programs end: one exit status, one sentence, no traceback.

0 done, 1 a check did not hold, 2 bad input or usage, 3 anything else that went wrong. A signal that
asks to stop ends with 128 + its number, as in shells; and 141, without a word, where the reader of
a pipe went away (`| head`). Failures are reported on standard error.

Only a command that comes to its end answers with 0 or 1. Code of the user's that is called on the
way, an environment's module or a trainer, may ask for another end (`sys.exit`); then there is no
answer, which is 3.
"""

from __future__ import annotations

import errno
import io
import json
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import Any, NoReturn, TextIO

import click

from exact_mdp.analysis.ci import defuse_line
from exact_mdp.mdp.errors import ModelError, shorten_text, shown_text

DONE, FAILED, REFUSED, BROKEN, PIPE_CLOSED = 0, 1, 2, 3, 141
FORMAT = 2  # as `mdp.report` has it, which needs packages that may be what is missing
SIGNALS = 128  # what shells add to the number of the signal that ended a program
TRACEBACK = "EXACT_MDP_TRACEBACK"
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
ALSO_CALLED = {"--gamma": "--discount", "--plot": "--html"}


class NoAnswer(RuntimeError):
    """Code that was called asked the process to end before there was an answer."""


# Of errors, by the name of a class, as to load the modules of some takes long: what is said, a fix.
KINDS = {
    "UserWarning": ("{}", "correct it, or do not turn warnings into errors"),
    "SolverError": ("{kind}: {}", ""),
    "Contradiction": ("{kind}: {}", ""),
    "NoAnswer": ("{}", "let the environment, trainer or policy return instead"),
    "MemoryError": ("{}", "use a smaller model"),
    "RecursionError": ("something is nested too deeply", "use flatter input"),
    "OverflowError": (
        "a number is too large to compute with: {}",
        "scale the model, or round its numbers",
    ),
    "ImportError": (
        "a package cannot be loaded: {}",
        "in a checkout of exact-mdp this installs it with all that it needs: pip install .",
    ),
    "BaseException": (
        "an error in the program, not in your input: {}",
        f"report it with this command; {TRACEBACK}=1 shows the traceback to send with it",
    ),
}


@contextmanager
def refuse_exit() -> Iterator[None]:
    """Raise NoAnswer where code that is called ends the process by `sys.exit`."""
    try:
        yield
    except SystemExit as end:
        said = shorten_text(f"sys.exit({end.code!r})")
        raise NoAnswer(f"{said} was called before there was an answer") from end


class Programs(click.Group):
    """A group of commands that is a program of its own: it ends as this module says."""

    def main(
        self, args: Sequence[str] | None = None, prog_name: str | None = None, *_: Any, **__: Any
    ) -> NoReturn:
        """Run, and end the process."""
        name = prog_name or str(self.name)
        if args is None:
            end_process(run_command(self, name, sys.argv[1:]))
        sys.exit(run_command(self, name, args))


def run_command(
    command: click.Command,
    program: str,
    words: Sequence[str],
    on_error: Callable[[str], None] | None = None,
) -> int:
    """Run a command and return its exit status; what goes wrong is reported on standard error.

    What the command returns is the status; None is 0. `program` is its name in messages, `words`
    are those after the name; `on_error` is called with the message of a failure. With --json the
    last line of standard error is an object with the parts of the message.
    """
    context = None
    try:
        _open_closed_streams()
        with _interrupt_on_signals(), warnings.catch_warnings():
            warnings.showwarning = partial(_print_warning, told=set())
            with refuse_exit(), command.make_context(program, [*words], obj=[*words]) as context:
                status = command.invoke(context)
            sys.stdout.flush()
        return int(status or DONE)
    except click.exceptions.Exit as end:  # --help and --version
        return end.exit_code
    except BrokenPipeError:
        return PIPE_CLOSED
    except BaseException as raised:
        error = raised
    if os.environ.get(TRACEBACK, "") not in ("", "0"):
        traceback.print_exception(error)
    if context is not None and context.invoked_subcommand and isinstance(command, click.Group):
        command = command.get_command(context, context.invoked_subcommand) or command
        program = f"{program} {command.name}"
    status, said = _describe_failure(error, command, program, words)
    kind = type(error).__name__ if said.where else ""
    message = f"{kind}: {said}" if kind else str(said)
    print_message(message)
    if "--json" in words:
        parts = {"kind": kind, "what": said.what, "where": said.where, "fix": said.fix}
        print_message(json.dumps({"format": FORMAT, "status": status, "error": parts}))
    if on_error is not None:
        on_error(message)
    return status


def end_process(status: int) -> NoReturn:
    """End the process; after a signal without taking the interpreter apart.

    Work that a signal cut short may have left a library in the middle of something, compiling for
    example, and such a library can crash when it is taken apart.
    """
    try:
        sys.stdout.flush()
        os.dup2(2, sys.stdout.fileno())  # what a module prints at exit is no part of the result
    except (AttributeError, OSError, ValueError):
        _silence_stream(sys.stdout)
    if status > SIGNALS and status != PIPE_CLOSED:
        os._exit(status)
    sys.exit(status)


def print_message(text: str) -> None:
    """Print on standard error, wherever that leads."""
    try:
        print(*map(defuse_line, text.split("\n")), sep="\n", file=sys.stderr, flush=True)
    except OSError:
        _silence_stream(sys.stderr)


def _print_warning(message: Warning | str, *_: object, told: set[str], **__: object) -> None:
    """Say a warning in one line, each text once in a command."""
    text = shown_text(str(message), lines=True)
    if text not in told:
        told.add(text)
        print_message(f"warning: {text}")


def _describe_failure(
    error: BaseException, command: click.Command, usage: str, words: Sequence[str]
) -> tuple[int, ModelError]:
    """Return the status and what is said, without a place where the text says it all."""
    kinds = [base.__name__ for base in type(error).__mro__]
    options = {name: each for each in command.params for name in each.opts if name[:1] == "-"}
    if isinstance(error, KeyboardInterrupt):
        number = error.args[0] if error.args else signal.SIGINT
        notes = [f"stopped by {signal.Signals(number).name}", *getattr(error, "__notes__", ())]
        return SIGNALS + number, ModelError("; ".join(notes))
    if isinstance(error, click.ClickException):
        what = shorten_text(error.format_message()).removesuffix(".")
        param = getattr(error, "param", None)
        near = ALSO_CALLED.get(getattr(error, "option_name", ""))
        what = f"{error.message} Did you mean {near!r}?" if near in options else what
        where = param.opts[-1] if isinstance(param, click.Option) else usage
        return REFUSED, ModelError(what, where=where, fix=f"see {usage} --help")
    if isinstance(error, ModelError):
        typed = {word.partition("=")[0] for word in words}  # an argument's name, or its option
        named = (o for o, each in options.items() if each.name == error.where and o in typed)
        where = next(named, error.where) or usage
        return REFUSED, ModelError(error.what, where=where, fix=error.fix or f"see {usage} --help")
    if isinstance(error, OSError) and error.errno is not None:
        fix = "make room, or write elsewhere" if error.errno in FULL else "try again"
        what, where = f"the system refuses: {error.strerror}", str(error.filename or usage)
        return BROKEN, ModelError(what, where=where, fix=fix)
    kind = next(kind for kind in kinds if kind in KINDS)
    what, fix = KINDS[kind]
    if kind == "MemoryError" and "--horizon" in {word.partition("=")[0] for word in words}:
        fix = "choose fewer steps"
    text = " ".join(str(error).split())
    text = text or ("not enough memory" if kind == "MemoryError" else "no message")
    said = ModelError(what.format(text, kind=kinds[0]), where=usage if fix else "", fix=fix)
    return REFUSED if kind == "UserWarning" else BROKEN, said


@contextmanager
def _interrupt_on_signals() -> Iterator[None]:
    """Let SIGTERM, and SIGHUP unless it is ignored, stop the work as Ctrl-C does."""

    def raise_interrupt(number: int, _: object) -> None:
        # `timeout` and others signal the process, then its group with the process in it.
        signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt(number)

    with ExitStack() as restored:
        for number in (getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")):
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                with suppress(ValueError):  # only the main thread may say what signals do
                    signal.signal(number, raise_interrupt)
                    restored.callback(signal.signal, number, signal.SIG_DFL)
        yield


# ---- standard streams ----------------------------------------------------------------------------


def _open_closed_streams() -> None:
    """Let closed streams lead nowhere; raises OSError where standard output is closed.

    A file that is opened later would take the number of a closed stream, and get its text.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
    if sys.stderr is None:
        sys.stderr = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
    if sys.stdout is None:
        what = "standard output is closed, so the result could not be printed"
        raise OSError(errno.EBADF, what)
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal may lack a letter of a state's name
        sys.stdout.reconfigure(errors="backslashreplace")


def _silence_stream(stream: TextIO) -> None:
    """Let a stream lead nowhere: Python flushes once more when it ends."""
    with suppress(AttributeError, OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
