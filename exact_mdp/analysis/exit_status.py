"""How the programs end: one exit status, one sentence, no traceback.

0 done, 1 a check did not hold, 2 bad input or usage, 3 anything else that went wrong. A signal that
asks to stop ends with 128 + its number, as in shells; and 141, without a word, where the reader of
a pipe went away (`| head`). Failures are reported on standard error.

Only a command that comes to its end answers with 0 or 1. Code of the user's that is called on the
way, an environment's module or a trainer, may ask for another end (`sys.exit`, `os._exit`); then
there is no answer, which is 3.
"""

from __future__ import annotations

import atexit
import errno
import io
import json
import os
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any, NoReturn, TextIO

import click

from exact_mdp.analysis.ci import inert
from exact_mdp.mdp.errors import ModelError, short, shown_text

DONE, FAILED, REFUSED, BROKEN, PIPE_CLOSED = 0, 1, 2, 3, 141
SIGNALS = 128  # what shells add to the number of the signal that ended a program
TRACEBACK = "EXACT_MDP_TRACEBACK"
AT_ONCE = os._exit
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
ALSO_CALLED = {"--gamma": "--discount", "--plot": "--html"}

OnError = Callable[[int, str], None]


class NoAnswer(RuntimeError):
    """Code that was called asked the process to end before there was an answer."""


LIMITS = (  # kinds of errors, what is said of them, and the fix
    (NoAnswer, "{}", "let the environment, trainer or policy return instead"),
    (MemoryError, "{}", "use a smaller model"),
    (RecursionError, "something is nested too deeply", "use flatter input"),
    (
        OverflowError,
        "a number is too large to compute with: {}",
        "scale the model, or round its numbers",
    ),
    (
        ImportError,
        "a package cannot be loaded: {}",
        "install the package again, with the extra that this needs",
    ),
)


@contextmanager
def answering() -> Iterator[None]:
    """Raise NoAnswer where code that is called ends the process by `sys.exit` or `os._exit`."""
    before = _exit_by(sys.exit)
    try:
        yield
    except SystemExit as end:
        said = short(f"sys.exit({end.code!r})")
        raise NoAnswer(f"{said} was called before there was an answer") from end
    finally:
        vars(os)["_exit"] = before


def _exit_by(end: Callable[[int], object]) -> Callable[[int], NoReturn]:
    """Let `os._exit` do something else in this process, not in those forked; return what it was."""
    process, before = os.getpid(), os._exit

    def leave_at_once(status: int) -> NoReturn:
        if os.getpid() == process:
            end(status)
        before(status)

    vars(os)["_exit"] = leave_at_once
    return before


class Stopped(KeyboardInterrupt):
    """The process was asked to end by a signal; everything ends as it does after Ctrl-C."""


class Unwritten(ModelError):
    """A result that standard output does not take."""


class Programs(click.Group):
    """A group of commands that is a program of its own: it ends as this module says."""

    def main(
        self, args: Sequence[str] | None = None, prog_name: str | None = None, *_: Any, **__: Any
    ) -> NoReturn:
        """Run, and end the process."""
        name = prog_name or str(self.name)
        if args is None:
            leave(run(self, name, sys.argv[1:]))
        sys.exit(run(self, name, args))


def run(
    command: click.Command, program: str, words: Sequence[str], on_error: OnError | None = None
) -> int:
    """Run a command and return its exit status; what goes wrong is reported on standard error.

    What the command returns is the status; None is 0. `program` is its name in messages, `words`
    are those after the name. If the command fails, `on_error` is called with status and message.
    With --json the last line of standard error is an object with the parts of the message.
    """
    output = None
    try:
        if not _opened():
            what = "standard output is closed, so the result could not be printed"
            raise Unwritten(what, fix="send it to /dev/null to see the exit status alone")
        output = _Output(sys.stdout)
        with redirect_stdout(output), _signals(), warnings.catch_warnings():
            warnings.showwarning = _warner()
            with answering(), command.make_context(program, [*words], obj=[*words]) as context:
                status = command.invoke(context)
            output.flush()
        return int(status or DONE)
    except click.exceptions.Exit as end:  # --help and --version
        return end.exit_code
    except BaseException as raised:
        error = raised
    if os.environ.get(TRACEBACK, "") not in ("", "0"):
        traceback.print_exception(error)
    if output is not None and output.error is not None:
        _silence(sys.stdout)
        if isinstance(output.error, BrokenPipeError):
            return PIPE_CLOSED
        what = f"cannot write to standard output: {output.error.strerror}"
        error = Unwritten(what, fix="make room there, or send it elsewhere")
    status, *parts = _outcome(error, command, program, words)
    kind, what, where, fix = parts = [*map(shown_text, parts)] if parts[2] else parts
    message = f"{kind}: {what}\n  where: {where}\n  fix:   {fix}" if where else what
    say(message)
    if "--json" in words:
        names = ("kind", "what", "where", "fix")
        say(json.dumps({"status": status, "error": dict(zip(names, parts, strict=True))}))
    if on_error is not None:
        on_error(status, message)
    return int(status)


def leave(status: int) -> NoReturn:
    """End the process; after a signal without taking the interpreter apart.

    Work that a signal cut short may have left a library in the middle of something, compiling for
    example, and such a library can crash when it is taken apart.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(AttributeError, OSError, ValueError):
            stream.flush()
    if status > SIGNALS and status != PIPE_CLOSED:
        AT_ONCE(status)
    # Whatever a module does or prints at exit, it changes neither the status nor the result.
    _exit_by(lambda _: AT_ONCE(status))
    atexit.register(_aside_at_exit)  # the last one that is registered comes first
    sys.exit(status)


def _aside_at_exit() -> None:
    with suppress(AttributeError, OSError, ValueError):
        sys.stdout.flush()
        os.dup2(2, 1)


def say(text: str) -> None:
    """Print on standard error, wherever that leads."""
    try:
        print(*map(inert, text.split("\n")), sep="\n", file=sys.stderr, flush=True)
    except OSError:
        _silence(sys.stderr)


def _outcome(
    error: BaseException, command: click.Command, program: str, words: Sequence[str]
) -> tuple[int, str, str, str, str]:
    """Return status, kind, what, where and fix; what is said without a place has only the text."""
    chosen, usage, kind = command, program, type(error).__name__
    if isinstance(command, click.Group):
        context = click.Context(command)
        name = next((word for word in words if word in command.list_commands(context)), "")
        if own := command.get_command(context, name):
            chosen, usage = own, f"{program} {own.name}"
    options = {name: each.name for each in chosen.params for name in each.opts}
    if isinstance(error, KeyboardInterrupt):
        number = error.args[0] if isinstance(error, Stopped) else signal.SIGINT
        asked = f"stopped by {signal.Signals(number).name}"
        return SIGNALS + number, "", "; ".join([asked, *getattr(error, "__notes__", ())]), "", ""
    if isinstance(error, click.NoSuchOption):
        near = ALSO_CALLED.get(error.option_name)
        if near in options:
            error = click.UsageError(f"{error.message} Did you mean {near!r}?", error.ctx)
    if isinstance(error, click.ClickException):
        path = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else ""
        place = path or program
        return REFUSED, kind, error.format_message().removesuffix("."), place, f"see {place} --help"
    if isinstance(error, Unwritten):
        return BROKEN, "OSError", error.what, usage, error.fix
    if isinstance(error, ModelError):
        typed = {word.partition("=")[0] for word in words}  # an argument's name, or its option
        where = next((o for o in options if options[o] == error.where and o in typed), error.where)
        return REFUSED, kind, error.what, where or usage, error.fix or f"see {usage} --help"
    if isinstance(error, UserWarning):  # an error where Python is told so: -W error, PYTHONWARNINGS
        fix = "correct it, or do not turn warnings into errors"
        return REFUSED, kind, str(error), usage, fix
    said = short(" ".join(str(error).split()))
    # By name: the modules that define these errors take long to load.
    if any(base.__name__ in ("SolverError", "Contradiction") for base in type(error).__mro__):
        return BROKEN, "", f"{kind}: {error}", "", ""
    if isinstance(error, OSError) and error.errno is not None:
        place = str(error.filename) if error.filename is not None else usage
        fix = "make room, or write elsewhere" if error.errno in FULL else "try again"
        return BROKEN, "OSError", f"the system refuses: {error.strerror}", place, fix
    if "integer string conversion" in said:
        error = OverflowError(said)
    for kinds, what, fix in LIMITS:
        if isinstance(error, kinds):
            return BROKEN, kind, what.format(said or "not enough memory"), usage, fix
    what = f"an error in the program, not in your input: {said or 'no message'}"
    fix = f"report it with this command; {TRACEBACK}=1 shows the traceback to send with it"
    return BROKEN, kind, what, f"{usage}, in {_place(error)}", fix


def _place(error: BaseException) -> str:
    """Return the last line of this project that an exception went through."""
    place, here = "an unknown place", Path(__file__).resolve().parents[1]
    for frame in traceback.extract_tb(error.__traceback__):
        file = Path(frame.filename).resolve()
        if file.is_relative_to(here) and file.parent != here:
            place = f"{file.relative_to(here).as_posix()}, line {frame.lineno}"
    return place


@contextmanager
def _signals() -> Iterator[None]:
    """Let SIGTERM, and SIGHUP unless it is ignored, stop the work as Ctrl-C does."""
    names = ("SIGTERM", "SIGHUP")
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    taken = [number for number in numbers if signal.getsignal(number) is signal.SIG_DFL]
    if threading.current_thread() is not threading.main_thread():
        taken = []  # only the main thread may say what signals do

    last = list[int]()

    def stop(number: int, _: object) -> None:
        last.append(number)
        if len(last) == 1:  # `timeout` and others signal the process, then its group with it in it
            raise Stopped(number)

    for number in taken:
        signal.signal(number, stop)
    try:
        yield
    finally:
        for number in taken:
            signal.signal(number, signal.SIG_DFL)


# ---- standard streams ----------------------------------------------------------------------------


def _opened() -> bool:
    """Return whether there is a standard output; what is closed leads nowhere from now on.

    A file that is opened later would take the number of a closed stream, and get its text.
    """
    open_before = sys.stdout is not None
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free: this one
    if sys.stderr is None:
        sys.stderr = os.fdopen(os.open(os.devnull, os.O_WRONLY), "w", encoding="utf-8")
    if isinstance(sys.stdout, io.TextIOWrapper):  # a terminal may lack a letter of a state's name
        sys.stdout.reconfigure(errors="backslashreplace")
    return open_before


class _Output:
    """Standard output that remembers why it took nothing more."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.error: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str, /) -> int:
        return int(self._noted(self._stream.write, text))

    def flush(self) -> None:
        self._noted(self._stream.flush)

    def _noted(self, act: Callable[..., Any], *words: str) -> Any:
        try:
            return act(*words)
        except OSError as error:
            self.error = error
            raise


def _silence(stream: TextIO) -> None:
    """Let a stream lead nowhere: Python flushes once more when it ends."""
    with suppress(OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _warner() -> Callable[..., None]:
    """Return what tells a warning as one line on standard error, each text once in a command."""
    shown: set[str] = set()

    def warn(message: Warning | str, *_: object, **__: object) -> None:
        text = shown_text(str(message), lines=True)
        if text not in shown:
            shown.add(text)
            say(f"warning: {text}")

    return warn
