"""The shape of the code: which module may import which, and what is loaded only when used."""

import ast
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

import networkx as nx
import pytest

import exact_mdp

PACKAGE = Path(exact_mdp.__file__).parent
ROOMS = ["mdp", "solvers", "analysis", "paper_repro"]  # each imports itself and those before it
NUMBA = ["mdp/forms/compiling.py", "mdp/forms/rows.py", "solvers/kernels/*.py"]
HEAVY = {
    *("IPython", "certifi", "click", "cvxpy", "flint", "gymnasium", "httpcore", "jinja2", "joblib"),
    *("jupyter", "matplotlib", "networkx", "numba", "pandas", "pyarrow", "rich", "stormpy", "tqdm"),
    *("umbi", "xllamacpp"),
}


class Import(NamedTuple):
    path: str  # of the file
    name: str  # of the module, below exact_mdp if it is one of its own
    inside: bool  # a function, or only for type checkers


def sources() -> dict[str, str]:
    files = sorted(file for room in ROOMS for file in (PACKAGE / room).rglob("*.py"))
    return {file.relative_to(PACKAGE).as_posix(): file.read_text("utf-8") for file in files}


def imports(given: dict[str, str]) -> list[Import]:
    """Return what the files import anywhere, a module for each name that is one.

    The public names, `import exact_mdp`, are listed too: as "".
    """
    modules = {module_of(path) for path in given}
    found = []

    def visit(path: str, node: ast.AST, inside: bool) -> None:
        names: list[tuple[str, ...]] = []
        if isinstance(node, ast.Import):
            names = [(alias.name,) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: a relative import"
            of = node.module or ""
            names = [(f"{of}.{alias.name}", of) for alias in node.names]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            names = [(ast.literal_eval(word),) for word in node.args[:1] if is_text(word)]
        for choice in names:
            own = [name.partition("exact_mdp.")[2] for name in choice]
            known = [name for name in own if name in modules]
            name = known[0] if known else choice[-1]
            found.append(Import(path, "" if name == "exact_mdp" else name, inside))
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            inside = True
        inside = inside or isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for child in ast.iter_child_nodes(node):
            visit(path, child, inside)

    for path, text in given.items():
        visit(path, ast.parse(text, path), False)
    return found


def is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def module_of(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def upward(found: list[Import]) -> list[Import]:
    """Return imports of a later room, and of the public names where a module is loaded.

    The last room, the reproduction, is a user of the public names.
    """
    room = {name: place for place, name in enumerate(ROOMS)}
    return [
        each
        for each in found
        if room.get(each.name.split(".")[0], -1) > room[each.path.split("/")[0]]
        or (
            each.name == ""
            and not each.inside
            and not each.path.startswith(ROOMS[-1])
            and not each.path.endswith("__init__.py")
        )
    ]


def circles(found: list[Import]) -> list[list[str]]:
    graph = nx.DiGraph((module_of(each.path), each.name) for each in found)
    groups = nx.strongly_connected_components(graph)
    return sorted(sorted(group) for group in groups if len(group) > 1)


ALL = imports(sources())


def test_imports_point_one_way() -> None:
    assert upward(ALL) == []


def test_no_modules_import_each_other() -> None:
    assert circles(ALL) == []


def test_numba_is_imported_by_the_kernels_alone() -> None:
    numba = {each.path for each in ALL if each.name.split(".")[0] in ("numba", "llvmlite")}
    assert numba
    assert [path for path in numba if not any(fnmatch(path, allowed) for allowed in NUMBA)] == []


def test_what_is_forbidden_is_found() -> None:
    lower = {"mdp/a.py": "def f():\n    from exact_mdp.solvers import b", "solvers/b.py": ""}
    assert upward(imports(lower)) == [Import("mdp/a.py", "solvers.b", True)]
    assert len(upward(imports({"mdp/a.py": "import exact_mdp"}))) == 1
    assert upward(imports({"mdp/a.py": "def f():\n    import exact_mdp"})) == []
    typing = "if TYPE_CHECKING:\n    from exact_mdp.mdp.io.b import B"
    ring = {"mdp/a.py": typing, "mdp/io/b.py": "f = lambda: import_module('exact_mdp.mdp.a')"}
    assert circles(imports(ring)) == [["mdp.a", "mdp.io.b"]]
    assert circles(imports({**ring, "mdp/io/b.py": "import exact_mdp.mdp"})) == []


def loaded(code: str) -> set[str]:
    """Return the packages that a new process has loaded after the code."""
    code += "\nimport sys; print(*{name.partition('.')[0] for name in sys.modules})"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize("room", ["", *(f".{room}" for room in ROOMS)])
def test_importing_a_room_loads_nothing_heavy(room: str) -> None:
    assert loaded(f"import exact_mdp{room}") & HEAVY == set()


@pytest.mark.parametrize(
    ("code", "allowed"),
    [
        (
            "from exact_mdp import MDP, Scenario, solve, evaluate, certify",
            {"flint", "tqdm"},
        ),
        ("import exact_mdp.analysis.cli", {"click"}),
        ("import exact_mdp.paper_repro.__main__", {"click"}),
    ],
)
def test_what_is_used_first_loads_little(code: str, allowed: set[str]) -> None:
    assert loaded(code) & HEAVY <= allowed


def test_what_is_loaded_is_found() -> None:
    assert "numba" in loaded("import exact_mdp.solvers.kernels.learning")
