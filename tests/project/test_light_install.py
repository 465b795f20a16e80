"""The core works where every optional package is missing, and each missing one names its extra."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

# What the core does without, by the extra that brings it.
EXTRAS = {
    "lp": {"clarabel", "cvxpy"},
    "plots": {"matplotlib", "networkx"},
    "models": {"bitstring", "gymnasium", "pyarrow", "stormpy", "umbi"},
    "notebooks": {"IPython", "ipykernel", "jupyterlab"},
    "agents": {"httpx"},
}
OPTIONAL = set().union(*EXTRAS.values())
# Whoever reads a module of these folders has read one that names the extra.
GUARDED = ("exact_mdp/analysis/plots/", "exact_mdp/paper_repro/")

WITHOUT = f"""
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {sorted(OPTIONAL)!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
"""

CORE = """
from exact_mdp import MDP, Policy, Scenario, certify, check, evaluate, gradient, solve, tornado
from exact_mdp.solvers import PolicyIteration, return_distribution, simulate

scenario = Scenario.load("yuan2025").with_(tasks=[1])
mdp = scenario.compile()
assert solve(mdp).status and solve(mdp, PolicyIteration()).frame() is not None
assert certify(mdp).violations() == []
assert not check(mdp, "always:directive").passed
assert evaluate(mdp, "random").frame() is not None
assert simulate(mdp, "random", 20, 0) and return_distribution(mdp, "random")
assert gradient(scenario, names=["base.anger"]) and tornado(scenario, names=["base.anger"])
"""

COMMANDS = [
    "info yuan2025",
    "solve yuan2025 --certify",
    "evaluate yuan2025 random",
    "returns yuan2025 random",
    "check yuan2025 optimal --html page.html --junit report.xml",
    "simulate yuan2025 random --episodes 20",
    "gradient yuan2025 --parameter base.anger",
    "tornado yuan2025 --parameter base.anger",
]

NEEDED = {
    "solve yuan2025 --method linear-program": "exact-mdp[lp]",
    "info gymnasium:FrozenLake-v1 --discount 0.9": "exact-mdp[models]",
    "info model.prism": "exact-mdp[models]",
    "info model.umb": "exact-mdp[models]",
    "convert yuan2025 m.umb": "exact-mdp[models]",
    "data log.parquet --out m.npz": "exact-mdp[models]",
}
IN_PYTHON = {
    "from exact_mdp import draw": "exact-mdp[plots]",
    "from exact_mdp.analysis.plots import style": "exact-mdp[plots]",
    "from exact_mdp import MDP, solve; solve(MDP.from_arrays([[[1]]], [0], '1/2')).plot()":
        "exact-mdp[plots]",
    "import exact_mdp.mdp.environment": "exact-mdp[models]",
    "from exact_mdp.paper_repro.agents.endpoint import Endpoint; Endpoint(model='m', base_url='https://x')":
        "exact-mdp[agents]",
}  # fmt: skip


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    code = f"{WITHOUT}sys.path.insert(0, {str(ROOT)!r})\n{code}"
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        cwd=folder, capture_output=True, text=True, check=False, stdin=subprocess.DEVNULL,
    )  # fmt: skip


def test_python_needs_the_core_alone(tmp_path: Path) -> None:
    done = run(CORE, tmp_path)
    assert done.returncode == 0, done.stderr


def test_the_commands_need_the_core_alone(tmp_path: Path) -> None:
    words = [command.split() for command in COMMANDS]
    code = f"""
from exact_mdp.analysis.cli import main
for words in {words!r}:
    assert main(words) == 0, words
"""
    done = run(code, tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", NEEDED)
def test_a_missing_package_names_its_extra(tmp_path: Path, command: str) -> None:
    for name in ("model.prism", "model.umb", "log.parquet"):
        (tmp_path / name).write_text("mdp")
    code = f"from exact_mdp.analysis.cli import main; sys.exit(main({command.split()!r}))"
    done = run(code, tmp_path)
    assert done.returncode == 2, done.stderr
    assert f'pip install "{NEEDED[command]}"' in done.stderr
    assert done.stdout == ""


@pytest.mark.parametrize("code", IN_PYTHON)
def test_so_it_does_in_python(tmp_path: Path, code: str) -> None:
    done = run(code, tmp_path)
    assert "exact_mdp.mdp.errors.ModelError: the package" in done.stderr
    assert f'pip install "{IN_PYTHON[code]}"' in done.stderr


def test_every_optional_import_stands_under_its_extra() -> None:
    """No import of such a package fails in words of Python's own."""
    astray = []
    for path in sorted((ROOT / "exact_mdp").rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        if not name.startswith(GUARDED):
            tree = ast.parse(path.read_text("utf-8"))
            astray += [f"{name}: {each}" for each in unguarded(tree, extra=None)]
    assert astray == []
    assert list(unguarded(ast.parse("import cvxpy"), extra=None)) == ["cvxpy"]
    wrong = ast.parse("with extra('plots'):\n    def f():\n        from cvxpy import Problem")
    assert list(unguarded(wrong, extra=None)) == ["cvxpy"]


def unguarded(node: ast.AST, extra: str | None) -> Iterator[str]:
    """Yield the optional packages that are imported, but not where that extra is named."""
    match node:
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return
        case ast.With(items=[ast.withitem(context_expr=ast.Call(ast.Name("extra"), [argument]))]):
            extra = ast.literal_eval(argument)
        case ast.Import(names=names):
            yield from absent((each.name for each in names), extra)
        case ast.ImportFrom(module=str(module), level=0):
            yield from absent([module], extra)
    for child in ast.iter_child_nodes(node):
        yield from unguarded(child, extra)


def absent(modules: Iterable[str], extra: str | None) -> list[str]:
    """Return the packages of modules that are optional, and that the extra does not bring."""
    packages = {module.partition(".")[0] for module in modules}
    return sorted((packages & OPTIONAL) - EXTRAS.get(extra or "", set()))


def test_the_list_is_that_of_the_extras() -> None:
    """Each package stands in the extra that a message would name."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    for extra, packages in EXTRAS.items():
        lines = declared["optional-dependencies"][extra]
        brought = {re.split(r"[^\w-]", line)[0] for line in lines} - {"exact-mdp", "gymnasium"}
        assert brought <= packages, extra
    assert set(declared["optional-dependencies"]) == {*EXTRAS, "all", "bench"}


def test_so_does_the_reproduction(tmp_path: Path) -> None:
    done = run("from exact_mdp.paper_repro.__main__ import main; main(['--quick'])", tmp_path)
    assert done.returncode == 2, done.stderr
    assert 'pip install "exact-mdp[plots]"' in done.stderr
    assert list(tmp_path.iterdir()) == []
