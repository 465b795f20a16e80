"""The shape of the code: which module may import which, and what is imported only when used."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import networkx as nx
import pytest

ROOT = Path(__file__).resolve().parents[2]

# Imports point one way: a package may import itself and those before it.
LAYERS = ["mdp", "solvers", "analysis", "paper_repro"]
# numba is imported by these modules alone, wherever in them.
NUMBA_MODULES = ["mdp/forms/compiling.py", "mdp/forms/rows.py", "solvers/kernels/*.py"]

# Packages which are slow to import or optional, and the modules that may import them at their
# top because their whole job is that package. Everywhere else they are taken with `later`.
LAZY = {
    "IPython": [],
    "cvxpy": [],
    "dask": [],
    "distributed": [],
    "gymnasium": ["mdp/environment.py"],
    "httpcore": ["paper_repro/agents/transport.py"],
    "ipywidgets": [],
    "jupyter": [],
    "jupyter_client": [],
    "jupytext": [],
    "matplotlib": ["analysis/plots/*.py", "paper_repro/report/*.py"],
    "mdpsolver": [],
    "nbclient": [],
    "nbconvert": [],
    "nbformat": [],
    "numba": NUMBA_MODULES,
    "pandas": [],
    "quantecon": [],
    "stormpy": [],
    "umbi": [],
    "xllamacpp": [],
}


@dataclass(frozen=True)
class Import:
    """One import of the module called name, by the file at path."""

    path: str
    line: int
    name: str
    at_import_time: bool

    @property
    def package(self) -> str:
        return self.name.removeprefix("exact_mdp.").partition(".")[0]

    def __str__(self) -> str:
        return f"{self.path}:{self.line} imports {self.name}"


def modules() -> list[Path]:
    return sorted(path for layer in LAYERS for path in (ROOT / "exact_mdp" / layer).rglob("*.py"))


def imports_of(path: str, source: str) -> list[Import]:
    """Return every import in the source, those in functions and under TYPE_CHECKING too."""
    package = path.split("/")[:-1]

    def visit(node: ast.AST, at_import_time: bool) -> Iterator[Import]:
        match node:
            case ast.Import(names=names):
                for alias in names:
                    yield Import(path, node.lineno, alias.name, at_import_time)
            case ast.ImportFrom(module=module, names=names, level=0):
                yield Import(path, node.lineno, module or "", at_import_time)
            case ast.ImportFrom(module=module, names=names, level=level):
                base = package[: len(package) - level + 1]
                for name in [module] if module else [alias.name for alias in names]:
                    yield Import(path, node.lineno, ".".join([*base, name]), at_import_time)
            case ast.Call(
                func=ast.Name(id="import_module" | "__import__" | "load")
                | ast.Attribute(attr="import_module"),
                args=[ast.Constant(value=str(name)), *_],
            ) if not name.startswith("."):
                yield Import(path, node.lineno, name, at_import_time)
            case ast.Call(func=ast.Name(id="later"), args=[ast.Constant(value=str(name)), *_]):
                yield Import(path, node.lineno, name, False)  # loaded when it is first used
        for field, value in ast.iter_fields(node):
            inside = at_import_time and not (
                isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
                and field == "body"
            )
            if isinstance(node, ast.If) and field == "body":
                inside = inside and not is_type_checking(node.test)
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from visit(child, inside)

    return list(visit(ast.parse(source, path), True))


def is_type_checking(test: ast.expr) -> bool:
    match test:
        case ast.Name(id="TYPE_CHECKING") | ast.Attribute(attr="TYPE_CHECKING"):
            return True
    return False


@cache
def all_imports() -> list[Import]:
    return [
        found
        for path in modules()
        for found in imports_of(
            path.relative_to(ROOT / "exact_mdp").as_posix(), path.read_text("utf-8")
        )
    ]


def allowed(path: str, patterns: list[str]) -> bool:
    return any(fnmatch(path, pattern) for pattern in patterns)


def against_layers(imports: list[Import]) -> list[str]:
    return [
        str(found)
        for found in imports
        if found.package in LAYERS
        and LAYERS.index(found.package) > LAYERS.index(found.path.partition("/")[0])
    ]


def too_early(imports: list[Import]) -> list[str]:
    return [
        str(found)
        for found in imports
        if found.at_import_time and not allowed(found.path, LAZY.get(found.package, ["*"]))
    ]


def circles(sources: dict[str, str]) -> list[list[str]]:
    """Return the modules of {path: source} that import each other, in groups.

    Imports in functions and under TYPE_CHECKING count; that a package runs before what is in it
    does not.
    """
    names = {
        path: path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        for path in sources
    }
    known, graph = set(names.values()), nx.DiGraph()
    for path, source in sources.items():
        for node in ast.walk(ast.parse(source, path)):
            match node:
                case ast.ImportFrom(module=str(module), names=aliases, level=0):
                    wanted = [(f"{module}.{alias.name}", module) for alias in aliases]
                case ast.Import(names=aliases):
                    wanted = [(alias.name, alias.name) for alias in aliases]
                case ast.Call(func=ast.Name(id="later"), args=[ast.Constant(value=str(name))]):
                    wanted = [(name, name)]
                case _:
                    continue
            for either in wanted:  # a module of a package, or else a name in a module
                below = [name.removeprefix("exact_mdp.") for name in either]
                found = [name for name in below if name in known]
                graph.add_edges_from((names[path], name) for name in found[:1])
    groups = nx.strongly_connected_components(graph)
    return sorted(sorted(group) for group in groups if len(group) > 1)


def test_imports_point_one_way() -> None:
    assert against_layers(all_imports()) == []


def test_no_modules_import_each_other() -> None:
    sources = {
        path.relative_to(ROOT / "exact_mdp").as_posix(): path.read_text("utf-8")
        for path in modules()
    }
    assert circles(sources) == []


def test_no_package_imports_what_is_not_installed_with_it() -> None:
    outside = {"tests", "notebooks"}
    assert [str(found) for found in all_imports() if found.package in outside] == []


def test_numba_is_imported_by_the_kernels_alone() -> None:
    numba = [found for found in all_imports() if found.package in {"numba", "llvmlite"}]
    assert [str(found) for found in numba if not allowed(found.path, NUMBA_MODULES)] == []


def test_heavy_packages_are_imported_when_used() -> None:
    assert too_early(all_imports()) == []


# The modules that import another one by its name when they need it; everything else is imported at
# the top of a module, packages that are heavy or optional by `later` or `load`.
BY_NAME = {
    "mdp/lazy.py": "the one loader of heavy and optional packages, and of a package's own names",
    "analysis/cli/__init__.py": "JUnit files are written by one command",
    "analysis/cli/commands.py": "a command loads its own work, so that help comes at once",
    "analysis/cli/sensitivity/run.py": "a kind loads its own analysis",
    "analysis/pytest_plugin.py": "a plugin costs the tests of others nothing",
}


def inside_functions(source: str) -> list[str]:
    """Return the imports in the functions of a source, as they are written."""
    functions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)
    return [
        ast.unparse(node)
        for function in ast.walk(ast.parse(source))
        if isinstance(function, functions)
        for node in ast.walk(function)
        if isinstance(node, ast.Import | ast.ImportFrom)
    ]


def test_no_function_imports() -> None:
    sources = {
        path.relative_to(ROOT / "exact_mdp").as_posix(): path.read_text("utf-8")
        for path in modules()
    }
    found = {path: inside_functions(source) for path, source in sources.items()}
    assert {path: names for path, names in found.items() if names} == {}


def test_modules_that_import_by_name_are_listed_with_a_reason() -> None:
    found = {
        path.relative_to(ROOT / "exact_mdp").as_posix()
        for path in modules()
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.Name | ast.Attribute)
        and getattr(node, "id", getattr(node, "attr", "")) in ("import_module", "__import__")
    }
    assert found == set(BY_NAME)


def test_imports_in_functions_are_found() -> None:
    source = "import a\ndef f():\n    from b import c\n    g = lambda: a"
    assert inside_functions(source) == ["from b import c"]


@pytest.mark.parametrize("layer", LAYERS)
def test_importing_a_package_loads_no_heavy_package(layer: str) -> None:
    code = f"import sys, exact_mdp.{layer}; print(*sorted(set(sys.modules) & {set(LAZY)!r}))"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], cwd=ROOT, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == []


# What a module loads in a fresh process, beyond the standard library and the packages here; what is
# loaded first has been paid for already.
LOADED = [
    ("exact_mdp.mdp", "numpy, scipy.sparse", set()),
    ("exact_mdp.solvers", "numpy, scipy.sparse", set()),
    (
        "exact_mdp.solvers.learning.training, exact_mdp.solvers.parallel",
        "numpy, scipy.sparse",
        set(),
    ),
    ("exact_mdp.analysis.cli", "sys", {"click"}),
    ("exact_mdp.paper_repro.__main__", "sys", {"click"}),
]


def loaded(module: str, first: str) -> list[str]:
    """Return the modules from elsewhere that importing `module` loads after `first`."""
    code = f"import sys, {first}; known = set(sys.modules); import {module}; "
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code + "print(*sorted(set(sys.modules) - known))"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    own = sys.stdlib_module_names | {"exact_mdp", *LAYERS}
    return [name for name in done.stdout.split() if name.partition(".")[0] not in own]


@pytest.mark.parametrize(("module", "first", "allowed"), LOADED, ids=lambda value: str(value)[:20])
def test_importing_costs_no_more_than_its_arrays(
    module: str, first: str, allowed: set[str]
) -> None:
    found = loaded(module, first)
    assert [name for name in found if name.partition(".")[0] not in allowed] == []


def test_what_is_loaded_is_found() -> None:
    assert "numba" in loaded("exact_mdp.solvers.kernels.tables", "numpy, scipy.sparse")
    assert "scipy.optimize" in loaded("scipy.optimize", "numpy, scipy.sparse")


def test_no_module_is_called_utils() -> None:
    assert [path for path in modules() if "utils" in (path.stem, path.parent.name)] == []


def test_every_package_says_that_it_is_typed() -> None:
    assert [
        layer for layer in LAYERS if not (ROOT / "exact_mdp" / layer / "py.typed").is_file()
    ] == []


@pytest.mark.parametrize(
    ("source", "name", "at_import_time"),
    [
        ("import exact_mdp.solvers.policy", "exact_mdp.solvers.policy", True),
        ("pandas = later('pandas')", "pandas", False),
        ("from solvers import policy", "solvers", True),
        ("from . import rewards", "mdp.io.rewards", True),
        ("from ..build import rows", "mdp.build", True),
        ("def f():\n    import pandas as pd", "pandas", False),
        ("def f():\n    from matplotlib import pyplot", "matplotlib", False),
        ("class C:\n    import cvxpy", "cvxpy", True),
        ("try:\n    import numba\nexcept ImportError:\n    pass", "numba", True),
        ("if TYPE_CHECKING:\n    import pandas", "pandas", False),
        ("if TYPE_CHECKING:\n    pass\nelse:\n    import pandas", "pandas", True),
        ("x = importlib.import_module('cvxpy')", "cvxpy", True),
        ("f = lambda: __import__('cvxpy')", "cvxpy", False),
    ],
)
def test_imports_are_found(source: str, name: str, at_import_time: bool) -> None:
    (found,) = imports_of("mdp/io/model.py", source)
    assert (found.name, found.at_import_time) == (name, at_import_time)


def test_what_is_forbidden_is_found() -> None:
    upward = imports_of("mdp/model.py", "def f():\n    from exact_mdp.solvers import rows")
    assert against_layers(upward) == ["mdp/model.py:2 imports exact_mdp.solvers"]
    assert too_early(upward) == []
    early = imports_of("analysis/gate/check.py", "import mdp\nimport matplotlib.pyplot as plt")
    assert against_layers(early) == []
    assert too_early(early) == ["analysis/gate/check.py:2 imports matplotlib.pyplot"]
    assert too_early(imports_of("analysis/plots/returns.py", "import matplotlib")) == []


def test_circles_are_found() -> None:
    typing = "if TYPE_CHECKING:\n    from exact_mdp.mdp.io.b import B"
    inside = "def f():\n    from exact_mdp.mdp import c"
    back = "import exact_mdp.mdp.a"
    ring = {"mdp/a.py": typing, "mdp/io/b.py": inside, "mdp/c.py": back}
    assert circles(ring) == [["mdp.a", "mdp.c", "mdp.io.b"]]
    assert circles({**ring, "mdp/c.py": "import exact_mdp.mdp.space"}) == []
