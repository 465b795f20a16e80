"""The shape of the code: which module may import which, what is loaded when, the short names."""

import ast
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

import networkx as nx
import pytest

import exact_mdp

PACKAGE = Path(exact_mdp.__file__).parent
ROOT = Path(__file__).resolve().parents[2]
ROOMS = ["mdp", "solvers", "analysis", "paper_repro"]  # each imports itself and those before it
USERS = (ROOMS[-1], "analysis/cli")
NUMBA = ["mdp/forms/compiling.py", "mdp/forms/rows.py", "solvers/kernels/*.py"]
HEAVY = {
    *("IPython", "certifi", "click", "cvxpy", "flint", "gymnasium", "httpx", "jinja2", "joblib"),
    *("jupyter", "matplotlib", "networkx", "numba", "numpy", "pandas", "pyarrow", "rich", "scipy"),
    *("stormpy", "tqdm", "umbi"),
}
Import = tuple[str, str, bool]  # the file, the module, whether inside a function or for types alone


def imports(files: dict[str, str]) -> list[Import]:
    """Return all imports of the files; ours by the name below exact_mdp, which itself is ""."""
    modules = {module_of(path) for path in files}
    listed: list[Import] = []

    def visit(path: str, node: ast.AST, inside: bool) -> None:
        names: list[list[str]] = []
        if isinstance(node, ast.Import):
            names = [[alias.name] for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}:{node.lineno}: a relative import"
            names = [[f"{node.module}.{alias.name}", node.module or ""] for alias in node.names]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            names = [[word.value] for word in node.args[:1] if isinstance(word, ast.Constant)]
        for choice in names:
            own = [name.removeprefix("exact_mdp.") for name in choice]
            known = [name for name in own if name in modules]
            listed.append(
                (path, known[0] if known else choice[-1].removesuffix("exact_mdp"), inside)
            )
        types = isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        inside = inside or types or isinstance(node, ast.FunctionDef | ast.Lambda)
        for child in ast.iter_child_nodes(node):
            visit(path, child, inside)

    for path, text in files.items():
        visit(path, ast.parse(text, path), False)
    return listed


def module_of(path: str) -> str:
    return path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def upward(listed: list[Import]) -> list[Import]:
    """Imports of a later room, and of the public names where a module is loaded.

    The last room, the reproduction, and the command line are users of the public names.
    """
    room = {name: place for place, name in enumerate(ROOMS)}
    return [
        (path, name, inside)
        for path, name, inside in listed
        if room.get(name.split(".")[0], -1) > room[path.split("/")[0]]
        or not (name or inside or path.startswith(USERS) or path.endswith("__init__.py"))
    ]


def circles(listed: list[Import]) -> list[list[str]]:
    graph = nx.DiGraph((module_of(path), name) for path, name, _ in listed)
    return [sorted(part) for part in nx.strongly_connected_components(graph) if len(part) > 1]


def test_imports_point_one_way() -> None:
    files = [file for room in ROOMS for file in (PACKAGE / room).rglob("*.py")]
    texts = {file.relative_to(PACKAGE).as_posix(): file.read_text("utf-8") for file in files}
    listed = imports(texts)
    assert upward(listed) == []
    assert circles(listed) == []
    numba = {path for path, name, _ in listed if name.split(".")[0] in ("numba", "llvmlite")}
    assert numba
    assert [path for path in numba if not any(fnmatch(path, each) for each in NUMBA)] == []


def test_the_checkers_of_curves_import_no_solver() -> None:
    folder = PACKAGE / "analysis" / "vary" / "curves"
    texts = {f"analysis/vary/curves/{n}.py": (folder / f"{n}.py").read_text("utf-8")
             for n in ("checker", "equations", "roots")}  # fmt: skip
    own = ("exact_mdp.analysis.vary.curves.equations", "exact_mdp.analysis.vary.curves.roots")
    for _, name, _ in imports(texts):
        assert not name.startswith("exact_mdp") or name.startswith(("exact_mdp.mdp.", *own))


def python(*words: str) -> str:
    done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def loaded(code: str) -> set[str]:
    code += "\nimport sys; print(*{name.partition('.')[0] for name in sys.modules})"
    return set(python("-W", "error", "-c", code).splitlines()[-1].split())


SMALL = """
import numpy as np
from exact_mdp import MDP, PolicyIteration, Scenario, ValueIteration
from exact_mdp import certify, check, evaluate, solve
floats = MDP.from_arrays(np.random.default_rng(0).dirichlet([1] * 5, (2, 5)), [[1, 2]] * 5, 0.9)
for mdp in (Scenario.load("yuan2025").compile(), floats):
    certify(mdp), check(mdp, "optimal"), evaluate(mdp, "random")
    for method in (ValueIteration(), PolicyIteration(), None):
        solve(mdp, method)
"""
LARGE = """
import numpy as np
from exact_mdp import MDP, solve
rows = np.random.default_rng(0).dirichlet([1] * 110, (2, 110))
solve(MDP.from_arrays(rows, [[1, 2]] * 110, 0.9))
"""
COMMANDS = """
from exact_mdp.analysis.cli import main
for words in ("solve yuan2025 --certify", "evaluate yuan2025 optimal", "check yuan2025 optimal",
              "returns yuan2025 optimal", "info yuan2025"):
    assert main(words.split()) == 0, words
"""


@pytest.mark.parametrize(("code", "large"), [(SMALL, False), (COMMANDS, False), (LARGE, True)])
def test_the_compiler_is_loaded_for_large_models_alone(code: str, large: bool) -> None:
    assert ("numba" in loaded(code)) == large


@pytest.mark.parametrize(
    ("code", "allowed"),
    [
        *((f"import exact_mdp{room}", set()) for room in ["", *(f".{room}" for room in ROOMS)]),
        (
            "from exact_mdp import MDP, Scenario, solve, evaluate, certify",
            {"flint", "numpy", "scipy", "tqdm"},
        ),
        ("import exact_mdp.analysis.cli", {"click"}),
        ("from exact_mdp.analysis.cli import main; main(['solve', '--help'])", {"click"}),
        ("import exact_mdp.paper_repro.__main__", {"click"}),
    ],
)
def test_what_is_used_first_loads_little(code: str, allowed: set[str]) -> None:
    assert loaded(code) & HEAVY <= allowed


SAME = """
import exact_mdp, exact_mdp.mdp.model, exact_mdp.paper_repro.claim
from mdp.model import MDP
from mdp import MDP as short
import mdp.parametric.family, solvers.solver, analysis.gate.check, paper_repro.claim
assert MDP is short is exact_mdp.MDP
assert mdp.parametric.family.Family is exact_mdp.Family
assert solvers.solver.solve is exact_mdp.solve
assert analysis.gate.check.Audit is exact_mdp.Audit
assert paper_repro.claim is exact_mdp.paper_repro.claim
assert exact_mdp.mdp.model.__spec__.name == MDP.__module__ == "exact_mdp.mdp.model"
"""
OTHER = (
    "import sys; sys.path.insert(0, {!r}); import exact_mdp.mdp, mdp.model; print(mdp.model.OWN)"
)


@pytest.mark.skipif(not (ROOT / "mdp").is_dir(), reason="a checkout without links")
def test_short_names_are_the_same_modules_unless_the_user_has_some_of_that_name(
    tmp_path: Path,
) -> None:
    python("-c", SAME)
    assert "--quick" in python("-m", "paper_repro", "--help")
    assert "Usage" in python("-m", "paper_repro.agents", "--help")
    (tmp_path / "mdp").mkdir()
    (tmp_path / "mdp" / "__init__.py").touch()
    (tmp_path / "mdp" / "model.py").write_text("OWN = 'own'", "utf-8")
    assert python("-c", OTHER.format(str(tmp_path))) == "own\n"
