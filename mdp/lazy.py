"""Heavy and optional packages, loaded when they are first used: the one list of them.

    nx = later("networkx")        # at the top of a module; nothing is loaded yet
    nx.DiGraph()                  # loads it, or names the extra that brings it

A package's own names load when they are first asked for, too:

    __getattr__, __dir__ = names_later(__name__, {"exact_mdp.solvers.solve": ["solve"]})

The core, which `pip install exact-mdp` brings, is NumPy, SciPy, pandas, numba, python-flint,
joblib, tqdm, click, rich and jinja2: all that the commands need, but for what the extras name.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from types import ModuleType
from typing import Any

from exact_mdp.mdp.errors import ModelError

# Each package that loads late, and the extra that brings it.
EXTRAS = {
    "SALib": "sensitivity",
    "bitstring": "umb",
    "certifi": "agents-openai",
    "clarabel": "lp",
    "cvxpy": "lp",
    "dask": "cluster",
    "distributed": "cluster",
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
        if missing not in (package, *EXTRAS):
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


def names_later(
    package: str, homes: Mapping[str, Sequence[str]]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__getattr__` and `__dir__` of a package whose names load when first asked for.

    `homes` says by module which names come from it. Type checkers read the same imports under
    `TYPE_CHECKING`.

    Examples
    --------
    >>> get, names = names_later("mine", {"math": ["pi", "tau"]})
    >>> get("pi"), names()
    (3.14..., ['pi', 'tau'])
    """
    home = {name: module for module, names in homes.items() for name in names}

    def get(name: str) -> Any:
        if name not in home:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(home[name]), name)

    return get, lambda: sorted(home)
