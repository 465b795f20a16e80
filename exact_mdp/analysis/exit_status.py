"""Exit statuses of the programs: each failure is one status and one sentence, without a traceback.

0 is success, 1 a check that did not hold, 2 bad input or usage, 3 any other failure. After a signal
to stop the status is 128 + its number, as in shells; it is 141, without a message, if the reader of
a pipe has closed it (`| head`). Failures are reported on standard error.

Only a command that finishes returns 0 or 1. If the user's code, such as an environment or a
trainer, calls `sys.exit` on the way, the command has no answer, and the status is 3.
"""

from __future__ import annotations

import errno
import io
import json
import os
import re
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
from exact_mdp.mdp.errors import JSON_FORMAT, ModelError, shorten_text, shown_text

DONE, FAILED, REFUSED, BROKEN = range(4)
SIGNALS = 128  # added to the number of a signal, as shells do
PIPE_CLOSED = SIGNALS + 13  # SIGPIPE, a name that Windows lacks
TRACEBACK = "EXACT_MDP_TRACEBACK"
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
ALSO_CALLED = {"--gamma": "--discount", "--plot": "--html"}


class NoAnswer(RuntimeError):
    """The user's code called `sys.exit` before there was an answer."""


# Message and remedy of an error, by the name of its class, as some modules take long to import.
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
    """Raise NoAnswer if the code inside calls `sys.exit`."""
    try:
        yield
    except SystemExit as end:
        said = shorten_text(f"sys.exit({end.code!r})")
        raise NoAnswer(f"{said} was called before there was an answer") from end


class StrictCommand(click.Command):
    """A command that refuses an option given twice, of which click would take the last."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the words; raise ModelError if two values are given for one thing."""
        if not ctx.resilient_parsing:
            for option, given in self._list_values(ctx, args).items():
                twice = [each for each in given if given.count(each) > 1]
                if twice:
                    raise ModelError(
                        f"{f'{option} {twice[0]}'.strip()} is given twice",
                        where=option,
                        fix="give it once",
                    )
        return super().parse_args(ctx, args)

    def _list_values(self, ctx: click.Context, args: list[str]) -> dict[str, list[str]]:
        """Return for each option, flags apart, the names to which values were given, as KEY=VALUE.

        The name is empty in an option of one value.
        """
        values, _, order = self.make_parser(ctx).parse_args(args=[*args])
        named = dict[str, list[str]]()
        for each in order:
            if not isinstance(each, click.Option) or each.is_flag:
                continue
            if not each.multiple:
                named.setdefault(each.opts[0], []).append("")
            elif re.match(r"\w+=\w", each.metavar or ""):
                texts = [text.partition("=") for text in values[each.name] if "=" in text]
                named[each.opts[0]] = [key.strip() for key, _, _ in texts]
        return named


class Programs(StrictCommand, click.Group):
    """A group of commands that is a program of its own, with the exit statuses of this module."""

    command_class = StrictCommand

    def main(
        self, args: Sequence[str] | None = None, prog_name: str | None = None, *_: Any, **__: Any
    ) -> NoReturn:
        """Run a command and end the process."""
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
    """Run a command and return its exit status; failures are reported on standard error.

    The command returns the status, or None for 0. `program` is its name in messages, and `words`
    follow the name; `on_error` is called with the message of a failure. With --json the last line
    of standard error is an object with the parts of the message.
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
        error = _find_interrupt(raised) or raised
    if os.environ.get(TRACEBACK, "") not in ("", "0"):
        traceback.print_exception(error)
    if context is not None and context.invoked_subcommand and isinstance(command, click.Group):
        command = command.get_command(context, context.invoked_subcommand) or command
        program = f"{program} {command.name}"
    status, said = _describe_failure(error, command, program, words)
    # A message with a place begins with the name of the error.
    kind, message = "", str(said)
    if said.where:
        kind = type(error).__name__
        message = f"{kind}: {said}"
    print_message(message)
    if "--json" in words:
        parts = {"kind": kind, "what": said.what, "where": said.where, "fix": said.fix}
        print_message(json.dumps({"format": JSON_FORMAT, "status": status, "error": parts}))
    if on_error is not None:
        on_error(message)
    return status


def _find_interrupt(error: BaseException | None) -> BaseException | None:
    """Return the interrupt after which a library failed to tidy up, as zipfile may; else None."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__context__
    return error


def end_process(status: int) -> NoReturn:
    """End the process; after a signal, skip the interpreter's shutdown.

    A signal may have interrupted a library in the middle of its work, for example in compiling, and
    such a library can crash during shutdown.
    """
    try:
        sys.stdout.flush()
        # Output that a module prints at exit is not part of the result.
        os.dup2(2, sys.stdout.fileno())
    except (AttributeError, OSError, ValueError):
        _silence_stream(sys.stdout)
    if status > SIGNALS and status != PIPE_CLOSED:
        os._exit(status)
    sys.exit(status)


def print_message(text: str) -> None:
    """Print on standard error; if that is closed, print nothing."""
    try:
        print(*map(defuse_line, text.split("\n")), sep="\n", file=sys.stderr, flush=True)
    except OSError:
        _silence_stream(sys.stderr)


def _print_warning(message: Warning | str, *_: object, told: set[str], **__: object) -> None:
    """Print a warning on one line, each text once in a command."""
    text = shown_text(str(message), lines=True)
    if text not in told:
        told.add(text)
        print_message(f"warning: {text}")


def _describe_failure(
    error: BaseException, command: click.Command, usage: str, words: Sequence[str]
) -> tuple[int, ModelError]:
    """Return the exit status and the message of a failure."""
    kinds = [base.__name__ for base in type(error).__mro__]
    options = {}
    for each in command.params:
        for name in each.opts:
            if name[:1] == "-":
                options[name] = each
    # A signal.
    if isinstance(error, KeyboardInterrupt):
        number = error.args[0] if error.args else signal.SIGINT
        notes = [f"stopped by {signal.Signals(number).name}", *getattr(error, "__notes__", ())]
        return SIGNALS + number, ModelError("; ".join(notes))
    # Bad usage or bad input; the place is the option that was given, if there is one.
    if isinstance(error, click.ClickException):
        what = shorten_text(error.format_message()).removesuffix(".")
        param = getattr(error, "param", None)
        near = ALSO_CALLED.get(getattr(error, "option_name", ""))
        if near in options:
            what = f"{error.message} Did you mean {near!r}?"
        where = param.opts[-1] if isinstance(param, click.Option) else usage
        return REFUSED, ModelError(what, where=where, fix=f"see {usage} --help")
    if isinstance(error, ModelError):
        typed = {word.partition("=")[0] for word in words}  # an argument's name, or its option
        named = (o for o, each in options.items() if each.name == error.where and o in typed)
        where = next(named, error.where) or usage
        return REFUSED, ModelError(error.what, where=where, fix=error.fix or f"see {usage} --help")
    # The operating system.
    if isinstance(error, OSError) and error.errno is not None:
        fix = "make room, or write elsewhere" if error.errno in FULL else "try again"
        what, where = f"the system refuses: {error.strerror}", str(error.filename or usage)
        return BROKEN, ModelError(what, where=where, fix=fix)
    # Any other error, by the nearest class that has a message; BaseException has one.
    kind = next(kind for kind in kinds if kind in KINDS)
    what, fix = KINDS[kind]
    text = " ".join(str(error).split())
    if kind == "MemoryError":
        text = text or "not enough memory"
        if "--horizon" in {word.partition("=")[0] for word in words}:
            fix = "choose fewer steps"
    what = what.format(text or "no message", kind=kinds[0])
    said = ModelError(what, where=usage if fix else "", fix=fix)
    return REFUSED if kind == "UserWarning" else BROKEN, said


@contextmanager
def _interrupt_on_signals() -> Iterator[None]:
    """Make SIGTERM, and SIGHUP unless it is ignored, stop the work as Ctrl-C does."""

    def raise_interrupt(number: int, _: object) -> None:
        # `timeout` and others signal the process, and again its group: ignore the second signal.
        signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt(number)

    with ExitStack() as restored:
        for number in (getattr(signal, name, None) for name in ("SIGTERM", "SIGHUP")):
            if number is not None and signal.getsignal(number) is signal.SIG_DFL:
                with suppress(ValueError):  # only the main thread may set a handler
                    signal.signal(number, raise_interrupt)
                    restored.callback(signal.signal, number, signal.SIG_DFL)
        yield


# ---- standard streams ----------------------------------------------------------------------------


def _open_closed_streams() -> None:
    """Connect closed streams to the null device; raise OSError if standard output is closed.

    Otherwise a file that is opened later would get the number of a closed stream, and its text.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, which is this one
    if sys.stderr is None:
        sys.stderr = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
    if sys.stdout is None:
        what = "standard output is closed, so the result could not be printed"
        raise OSError(errno.EBADF, what)
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal may lack a letter of a state's name
        sys.stdout.reconfigure(errors="backslashreplace")


def _silence_stream(stream: TextIO) -> None:
    """Connect a stream to the null device, as Python flushes it once more at exit."""
    with suppress(AttributeError, OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
