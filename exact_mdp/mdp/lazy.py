"""Heavy and optional packages, loaded when they are first used: the one list of them.

    nx = later("networkx")        # at the top of a module; nothing is loaded yet
    nx.DiGraph()                  # loads it, or names the extra that brings it

A package's own names load when they are first asked for, too:

    __getattr__, __dir__ = names_later(__name__, {"exact_mdp.solvers.solve": ["solve"]})

Compiled loops take a third of a second to load, as long as some seventy solves of small models in
NumPy. When to load them is decided here, on one rule: a command is short, a session goes on.

- A model of `COMPILED` transitions or more is worth them at once.
- A command, the program `exact-mdp`, runs the loops of small models in NumPy `MANY` times, which
  takes about as long as loading does. So it takes about twice the least time at most, however much
  there turns out to be to solve (the ski rental problem: Karlin, Manasse, Rudolph and Sleator,
  Algorithmica 3, 1988).
- Any other process, a notebook or a script, solves its first model in the same way, and has the
  loops loaded in its second `solve`. A call counts once, with all that it solves in turn.

The rule counts and looks at no clock, so that a process does the same each time it is run. Both
ways give the same bits: no answer depends on which one was taken.

The core, which `pip install exact-mdp` brings, is NumPy, SciPy, pandas, numba, python-flint,
joblib, tqdm, click, rich and jinja2: all that the commands need, but for what the extras name.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import cache, wraps
from importlib import import_module
from threading import Thread
from types import ModuleType, SimpleNamespace
from typing import Any, TypeVar, cast

from exact_mdp.mdp.errors import ModelError

# Each package that loads late, and the extra that brings it.
EXTRAS = {
    "bitstring": "umb",
    "certifi": "agents-openai",
    "clarabel": "lp",
    "cvxpy": "lp",
    "gymnasium": "gymnasium",
    "highspy": "lp",
    "httpcore": "agents-openai",
    "ipywidgets": "notebooks",
    "matplotlib": "plots",
    "networkx": "plots",
    "pyarrow": "parquet",
    "stormpy": "storm",
    "umbi": "umb",
    "xllamacpp": "agents-local",
}

# Parts of the core that take long to load: 0.1 to 0.5 s each.
HEAVY = (
    "exact_mdp.analysis.gate.data",  # of models from records alone
    "exact_mdp.analysis.plots",  # draw with matplotlib
    "exact_mdp.mdp.care.perception",
    "exact_mdp.mdp.forms.compiling",  # numba
    "exact_mdp.mdp.forms.rows",  # numba
    "exact_mdp.mdp.io",  # each format on its own
    "exact_mdp.paper_repro.agents.transport",  # made of classes of httpcore
    "exact_mdp.solvers.kernels",
    "exact_mdp.solvers.objectives",  # for limits on totals alone
    "flint",
    "jinja2",
    "joblib",
    "numba",
    "pandas",
    "rich",
    "scipy",
    "tqdm",
)


def load(name: str) -> ModuleType:
    """Return a module, of a package in `EXTRAS` or `HEAVY`, that may be missing.

    Raises ModelError where its package is not installed; the error names the extra that brings it.

    Examples
    --------
    >>> load("scipy.sparse").__name__
    'scipy.sparse'
    """
    package = name.partition(".")[0]
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in (package, *EXTRAS, *HEAVY):
            raise
        extra = EXTRAS.get(missing)
        what = f"exact-mdp[{extra}]" if extra else missing
        raise ModelError(
            f"the package {missing} is not installed", fix=f'install it: pip install "{what}"'
        ) from None


class _Later(ModuleType):
    """Stands for a module until one of its attributes is asked for."""

    def __getattr__(self, name: str) -> Any:
        value = getattr(load(self.__name__), name)
        setattr(self, name, value)
        return value


def later(name: str) -> Any:
    """Return a module, in `EXTRAS` or `HEAVY`, that is loaded when an attribute is first asked for.

    Examples
    --------
    >>> pandas = later("pandas")
    >>> pandas.DataFrame({"a": [1]}).shape
    (1, 1)
    """
    if not name.startswith((*EXTRAS, *HEAVY)):
        raise ModelError(f"{name} is not in the list of packages that load late", where="later")
    return _Later(name)


LARGE = 200_000  # steps of a loop in Python that take about as long as loading compiled code


def worth_compiling(steps: int, package: str = "numba") -> bool:
    """Return whether a loop is for compiled code: where that is loaded, or once it pays to load it.

    Examples
    --------
    >>> worth_compiling(10**6)
    True
    """
    return package in sys.modules or steps >= LARGE


COMPILER = "exact_mdp.mdp.forms.compiling"  # of loops of any kind
LOOPS = "exact_mdp.solvers.kernels.bellman"
COMPILED = 20_000  # transitions that take long enough, swept again and again, to load loops for
MANY = 1000  # loops of small models in NumPy that take as long as loading: of some hundred solves

# Threads may miscount a call of each other's: that moves the loading, and no answer.
_process = SimpleNamespace(command=False, calls=0, inside=False, loops=0)
Call = TypeVar("Call", bound=Callable[..., Any])


def as_command() -> None:
    """Take this process for a command, which is short."""
    _process.command = True


def asked(function: Call) -> Call:
    """Count the calls of a function that solves; those on the way are a part of one."""

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        if _process.inside:
            return function(*args, **kwargs)
        _process.calls, _process.inside = _process.calls + 1, True
        try:
            return function(*args, **kwargs)
        finally:
            _process.inside = False

    return cast("Call", call)


def loops_pay(transitions: int, least: int) -> bool:
    """Return whether compiled loops are for a solve: loaded, or worth it, as said above.

    Examples
    --------
    >>> loops_pay(10**6, least=COMPILED)
    True
    """
    if LOOPS in sys.modules or transitions >= least:
        return True
    _process.loops += 1
    goes_on = _process.calls > 1 and not _process.command
    return (goes_on or _process.loops > MANY) and _compiler_loads()


@cache
def _compiler_loads() -> bool:
    """Load the compiler, and return whether that succeeds; say once what is in the way.

    In a thread, which an interrupt from the keyboard does not reach: a module that is left half
    loaded would fail for the rest of the session.
    """
    failed = list[Exception]()

    def bring() -> None:
        try:
            load(LOOPS)
        except (ImportError, ModelError) as error:
            failed.append(error)

    thread = Thread(target=bring)
    thread.start()
    thread.join()
    if not failed:
        return True
    reason = str(failed[0]).splitlines()[0]
    warnings.warn(
        f"loops are not compiled: {reason}; answers are the same, and slower", stacklevel=2
    )
    return False


def names_later(
    package: str, homes: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package whose names load when first asked for.

    `homes` says by module which names come from it. Type checkers read the same imports under
    `TYPE_CHECKING`.

    Examples
    --------
    >>> get, names = names_later(__name__, {"math": ["pi", "tau"]})
    >>> get("pi"), names()
    (3.14..., ['pi', 'tau'])
    """
    home = {name: module for module, names in homes.items() for name in names}

    def get(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(home[name]), name)
        setattr(sys.modules[package], name, value)  # found at once from now on
        return value

    return get, lambda: sorted(home)
