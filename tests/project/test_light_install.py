"""The core works where every optional package is missing, and each missing one names its extra."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from extras import EXTRAS

ROOT = Path(__file__).resolve().parents[2]

WITHOUT = f"""
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {sorted(EXTRAS)!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
"""

CORE = """
from exact_mdp import MDP, Policy, Scenario, certify, check, evaluate, solve
from exact_mdp.analysis.sensitivity import gradient, tornado
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
    "sensitivity yuan2025 gradient --parameter base.anger",
    "sensitivity yuan2025 tornado --parameter base.anger",
]

NEEDED = {
    "solve yuan2025 --method linear-program": "exact-mdp[lp]",
    "info gymnasium:FrozenLake-v1 --discount 0.9": "exact-mdp[gymnasium]",
    "convert yuan2025 m.umb": "exact-mdp[umb]",
}


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
    code = f"from exact_mdp.analysis.cli import main; sys.exit(main({command.split()!r}))"
    done = run(code, tmp_path)
    assert done.returncode == 2, done.stderr
    assert f'pip install "{NEEDED[command]}"' in done.stderr
    assert done.stdout == ""


def test_so_does_the_reproduction(tmp_path: Path) -> None:
    done = run("from exact_mdp.paper_repro.__main__ import main; main(['--quick'])", tmp_path)
    assert done.returncode == 2, done.stderr
    assert 'pip install "exact-mdp[plots]"' in done.stderr
    assert list(tmp_path.iterdir()) == []
