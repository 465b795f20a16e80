"""Change a module in one place at a time, and tell whether a test fails.

    python tests/mutation/mutants.py solvers/exact/levels.py    its test file, then the room's

A process collects the tests and runs them once to see which of them runs which line. For each
change it starts a copy of itself (fork), in which the functions of the module get the changed code;
there the tests run that come to the line, the file beside the module first, then the quickest of
the room as long as their time is not up, until one fails. A change of what is run when a module is
loaded (a constant, a default) makes the copy load everything again. What no test notices is written
to left.toml, where a person says why: of a change with a reason the room is not asked again. After
tests were written, --listed tries the changes in that list alone.
"""

import ast
import gc
import json
import os
import resource
import signal
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from traceback import print_exc
from types import CodeType, FunctionType
from typing import Any

import click
import coverage
import pytest
from _pytest.runner import runtestprotocol
from _pytest.warnings import catch_warnings_for_item
from changes import Change, changes

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "exact_mdp"
LIST = Path(__file__).with_name("left.toml")
LEFT, BESIDE, ROOM = "left", "beside", "room"
OPTIONS = ["-q", "--capture=no", "-p", "no:cacheprovider", "-o", "timeout=0"]
ROOM_SECONDS = 10.0  # of the room's tests for one change
MEMORY = 6 << 30  # bytes: a change may ask for arrays without end


def beside(module: Path) -> Path:
    """Return the test file beside a module: the same path in tests/inner."""
    path = module.relative_to(PACKAGE)
    return ROOT / "tests" / "inner" / path.parent / f"test_{path.stem}.py"


def room_of(module: Path) -> list[Path]:
    """Return the tests of a module's room: those of its folder, of the inner names and others."""
    folder = module.relative_to(PACKAGE).parent
    outer = [ROOT / "tests" / folder, ROOT / "tests" / folder.parent]
    inner = ROOT / "tests" / "inner" / folder
    return [path for path in (inner, next(path for path in outer if path.exists()), module)
            if path.exists()]  # fmt: skip


@dataclass
class Known:
    """What one run of all tests without a change tells of them."""

    seconds: dict[str, float]
    tests: dict[str, dict[int, list[str]]]  # file → line → the tests that run it

    def of(self, module: Path, change: Change) -> tuple[list[str], list[str]]:
        """Return the tests that run a change, the quickest first: beside it, and of the room."""
        of_line = self.tests.get(str(module), {})
        names = {test for line in change.lines for test in of_line.get(line, ())}
        names = {*self.seconds} if change.at_import else names
        file = beside(module).relative_to(ROOT).as_posix() + "::"
        near, far = list[str](), list[str]()
        left = ROOM_SECONDS
        for name in sorted(names, key=self.seconds.__getitem__):
            if name.startswith(file):
                near.append(name)
            elif left > self.seconds[name] or not far:
                far.append(name)
                left -= self.seconds[name]
        return near, far


@dataclass
class Result:
    """What became of a module's changes."""

    fates: Counter[str] = field(default_factory=Counter)
    left: list[Change] = field(default_factory=list)


class Mutants:
    """Runs the tests of changed modules in place of pytest's own loop."""

    def __init__(
        self, modules: list[Path], *, only_beside: bool, only_listed: bool, workers: int,
        every: int, verbose: bool,
    ) -> None:  # fmt: skip
        self.modules, self.only_beside, self.workers = modules, only_beside, workers
        self.only_listed, self.every, self.verbose = only_listed, every, verbose
        self.items = dict[str, pytest.Item]()
        self.results = {module: Result() for module in modules}
        self.reasons = {module: reasons(module) for module in modules}

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.items = {item.nodeid: item for item in session.items}
        known = self.without_change()
        running: dict[int, tuple[Path, Change]] = {}

        def finish() -> None:
            pid, status = os.wait()
            module, change = running.pop(pid)
            self.note(module, change, status)

        for module in self.modules:
            gc.unfreeze()  # what is frozen is not among the objects in which functions are found
            tree, functions = ast.parse(module.read_text("utf-8")), functions_of(module)
            gc.collect()
            gc.freeze()  # so that copies share the memory
            for change in islice(changes(tree), 0, None, self.every):
                if self.only_listed and change.key not in self.reasons[module]:
                    self.results[module].fates[BESIDE] += 1
                    continue
                code = compile(tree, str(module), "exec")
                while len(running) >= self.workers:
                    finish()
                if pid := os.fork():
                    running[pid] = module, change
                else:
                    self.in_copy(module, change, code, known, functions)
        while running:
            finish()
        if self.only_listed:
            for module, result in self.results.items():
                room = section_of(module).get(ROOM, 0)  # noticed there before, counted above
                result.fates += Counter({ROOM: room})
                result.fates -= Counter({BESIDE: room})
        return True

    def note(self, module: Path, change: Change, status: int) -> None:
        """Count what became of a change."""
        code = os.waitstatus_to_exitcode(status)
        by_code = {0: LEFT, 1: BESIDE, 2: ROOM, -signal.SIGPROF: BESIDE, -signal.SIGVTALRM: ROOM}
        fate = by_code.get(code, f"ended with {code}")
        self.results[module].fates[fate] += 1
        if fate == LEFT:
            self.results[module].left.append(change)
        if self.verbose and fate != BESIDE:
            name = module.relative_to(PACKAGE)
            print(f"{fate:6} {name}:{change.lines.start} {change.where}: "
                  f"{change.before}  →  {change.after}", flush=True)  # fmt: skip

    def without_change(self) -> Known:
        """Run all tests once, in a copy, and return what they run and how long they take."""
        with TemporaryDirectory() as folder:
            path = Path(folder) / "known.json"
            if pid := os.fork():
                _, status = os.waitpid(pid, 0)
                if status:
                    raise click.ClickException("the tests fail without any change: see above")
                content = json.loads(path.read_text("utf-8"))
            else:
                try:
                    path.write_text(json.dumps(self.measured()), "utf-8")
                except BaseException:
                    print_exc()
                finally:
                    os._exit(not path.exists())
        lines = {file: {int(l): tests for l, tests in each.items()}
                 for file, each in content["tests"].items()}  # fmt: skip
        return Known(content["seconds"], lines)

    def measured(self) -> dict[str, Any]:
        """Run all tests, and return the seconds of each and the tests of each line."""
        files = [str(module) for module in self.modules]
        tracer = coverage.Coverage(data_file=None, config_file=False, include=files)
        seconds: dict[str, float] = {}
        failed = list[str]()
        tracer.start()
        for name, following in zip(self.items, [*list(self.items)[1:], None], strict=True):
            tracer.switch_context(name)
            began = process_time()
            for report in self.reports(name, following):
                if report.failed:
                    print(f"{name}:\n{report.longreprtext}", file=sys.stderr, flush=True)
                    failed.append(name)
            seconds[name] = process_time() - began
        tracer.stop()
        if failed:
            print("these tests fail without any change:", *failed, file=sys.stderr, flush=True)
            os._exit(1)
        data = tracer.get_data()
        return {
            "seconds": seconds,
            "tests": {file: data.contexts_by_lineno(file) for file in data.measured_files()},
        }

    def reports(self, name: str, following: str | None) -> list[pytest.TestReport]:
        """Run a test as pytest does, with the warnings that it allows, and return its reports."""
        item, after = self.items[name], self.items[following] if following else None
        with catch_warnings_for_item(item.config, item.ihook, when="runtest", item=item):
            return runtestprotocol(item, log=False, nextitem=after)

    def in_copy(
        self, module: Path, change: Change, code: CodeType, known: Known,
        functions: list[FunctionType],
    ) -> None:  # fmt: skip
        """Put a change into this process, run the tests that come to it, and end with its fate."""
        stage = 3  # what fails before the tests is a mistake here, and no test's merit
        try:
            os.setpgid(0, 0)
            resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
            quiet = os.open(os.devnull, os.O_WRONLY)
            os.dup2(quiet, 1), os.dup2(quiet, 2)
            near, far = known.of(module, change)
            if self.only_beside or self.reasons[module].get(change.key):
                far = []
            in_place = not change.at_import and exchange(functions, code)
            fails = self.fail if in_place else partial(fail_anew, module, code)
            stages = (1, near, signal.ITIMER_PROF), (2, far, signal.ITIMER_VIRTUAL)
            for stage, tests, timer in stages:
                signal.setitimer(timer, 10 + 5 * sum(map(known.seconds.__getitem__, tests)))
                if tests and fails(tests):
                    os._exit(stage)
                signal.setitimer(timer, 0)
            os._exit(0)
        except BaseException:
            os._exit(stage)

    def fail(self, tests: list[str]) -> bool:
        """Whether one of the tests fails in this process."""
        return any(
            report.failed
            for name, following in zip(tests, [*tests[1:], None], strict=True)
            for report in self.reports(name, following)
        )


def functions_of(module: Path) -> list[FunctionType]:
    """Return all functions of a module that are loaded, wherever they are held."""
    made = (each for each in gc.get_objects() if isinstance(each, FunctionType))
    return [each for each in made if each.__code__.co_filename == str(module)]


def exchange(functions: list[FunctionType], code: CodeType) -> bool:
    """Give functions the changed code of their module; False where one has none of its kind."""
    codes = list(codes_in(code))
    count, changed = Counter(map(name_of, codes)), {name_of(each): each for each in codes}
    for function in functions:
        name = name_of(function.__code__)
        other = changed.get(name) if count[name] == 1 else None  # two on a line look alike
        if other is None or other.co_freevars != function.__code__.co_freevars:
            return False
        function.__code__ = other
    return True


def name_of(code: CodeType) -> tuple[str, int]:
    return code.co_qualname, code.co_firstlineno


def codes_in(code: CodeType) -> Iterator[CodeType]:
    """Yield the code of all functions in a module's code."""
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield constant
            yield from codes_in(constant)


class Changed(MetaPathFinder, SourceFileLoader):
    """Loads a module from changed code."""

    def __init__(self, module: Path, code: CodeType) -> None:
        name = ".".join(["exact_mdp", *module.relative_to(PACKAGE).with_suffix("").parts])
        SourceFileLoader.__init__(self, name, str(module))
        self.code = code

    def find_spec(self, name: str, *_: Any) -> ModuleSpec | None:
        return spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def get_code(self, _: str) -> CodeType:
        return self.code


def fail_anew(module: Path, code: CodeType, tests: list[str]) -> bool:
    """Whether one of the tests fails after everything of the project has been loaded again."""
    for name, loaded in [*sys.modules.items()]:
        file = Path(getattr(loaded, "__file__", None) or os.sep)
        if file.is_relative_to(PACKAGE) or file.is_relative_to(ROOT / "tests"):
            del sys.modules[name]
    sys.meta_path.insert(0, Changed(module, code))
    return pytest.main([*OPTIONS, "-x", *tests]) != 0


def table(results: dict[Path, Result], only_beside: bool) -> str:
    """Return how many changes of each module were noticed, and where."""
    lines = [f"{'module':40} {'changes':>8} {'beside':>8} {'room':>8} {'left':>8} {'beside':>8} "
             f"{'all':>8}"]  # fmt: skip
    for module, result in results.items():
        fates, count = result.fates, result.fates.total()
        name = module.relative_to(PACKAGE).as_posix()
        shares = [fates[BESIDE] / (count or 1), 1 - fates[LEFT] / (count or 1)]
        lines.append(
            f"{name:40} {count:8} {fates[BESIDE]:8} {fates[ROOM]:8} {fates[LEFT]:8} "
            f"{shares[0]:8.1%} {'' if only_beside else format(shares[1], '8.1%')}"
        )
        lines += [f"  {fate}: {n}" for fate, n in fates.items() if fate not in (BESIDE, ROOM, LEFT)]
    return "\n".join(lines)


def sections() -> dict[str, Any]:
    """Return what the list says, by module."""
    return tomllib.loads(LIST.read_text("utf-8")) if LIST.exists() else {}


def section_of(module: Path) -> dict[str, Any]:
    """Return what the list says of a module."""
    section: dict[str, Any] = sections().get(module.relative_to(PACKAGE).as_posix(), {})
    return section


def reasons(module: Path) -> dict[tuple[str, ...], str]:
    """Return why no test notices changes of a module, as the list says."""
    return {tuple(each[:3]): each[3] for each in section_of(module).get(LEFT, ())}


def write_list(results: dict[Path, Result]) -> None:
    """Write what is left of these modules into the list; reasons given before stay."""
    known = sections()
    for module, result in results.items():
        name, fates = module.relative_to(PACKAGE).as_posix(), result.fates
        why = reasons(module)
        left = [[*change.key, why.get(change.key, "")] for change in result.left]
        counts = {"changes": fates.total(), BESIDE: fates[BESIDE], ROOM: fates[ROOM]}
        known[name] = counts | {LEFT: left}
    lines = ["# What `make mutants` found: how many changes of each module are noticed by the test",
             "# file beside it and by the tests of its room, and those left: [function, before,",
             "# after, why no test notices]. Where the reason begins with \"the same\", the change",
             "# makes no difference.", ""]  # fmt: skip
    for name, content in sorted(known.items()):
        lines += [
            f"[{json.dumps(name)}]",
            *(f"{key} = {content[key]}" for key in content if key != LEFT),
        ]
        lines += [
            "left = [",
            *(f"    {json.dumps(each, ensure_ascii=False)}," for each in content[LEFT]),
            "]",
            "",
        ]
    LIST.write_text("\n".join(lines), "utf-8")


@click.command()
@click.argument("paths", nargs=-1, required=True, type=click.Path(exists=True, path_type=Path))
@click.option(
    "--beside", "only_beside", is_flag=True, help="Only the files beside: all else is left."
)
@click.option("--listed", "only_listed", is_flag=True, help="Only the changes in the list.")
@click.option("--workers", default=2, show_default=True, help="Copies at a time.")
@click.option("--every", default=1, show_default=True, help="Only each n-th change; no list.")
@click.option("--verbose", is_flag=True, help="Show each change that no file beside notices.")
def main(
    paths: tuple[Path, ...], only_beside: bool, only_listed: bool, workers: int, every: int,
    verbose: bool,
) -> None:  # fmt: skip
    """Change modules, or all of a folder, in one place at a time, and say what tests notice."""
    os.chdir(ROOT)
    files = [file for path in paths for file in ([path] if path.is_file() else path.rglob("*.py"))]
    modules = sorted(file.resolve() for file in files if file.name != "__init__.py")
    tests = {beside(module) for module in modules if beside(module).exists()}
    if not only_beside:
        tests |= {path for module in modules for path in room_of(module)}
    if not tests:
        raise click.UsageError(
            f"no tests beside: {beside(modules[0]).relative_to(ROOT)} is missing"
        )
    which: dict[str, Any] = {"only_beside": only_beside, "only_listed": only_listed, "every": every}
    mutants = Mutants(modules, **which, workers=workers, verbose=verbose)
    status = pytest.main([*OPTIONS, *sorted(map(str, tests))], plugins=[mutants])
    if status == pytest.ExitCode.INTERNAL_ERROR:
        raise click.ClickException("nothing was tried, and the list is as before")
    print(table(mutants.results, only_beside))
    if every == 1:
        write_list(mutants.results)


if __name__ == "__main__":
    main()
