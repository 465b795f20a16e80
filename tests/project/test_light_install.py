"""The core works where every optional package is missing, and each missing one names its extra."""

import subprocess
import sys
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
OPTIONAL = {package: extra for extra, packages in EXTRAS.items() for package in packages}

WITHOUT = f"""
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {sorted(OPTIONAL)!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
sys.path.insert(0, {str(ROOT)!r})
"""
CORE = """
from exact_mdp import MDP, PolicyIteration, Scenario, certify, check, evaluate, gradient
from exact_mdp import return_distribution, simulate, solve, tornado
from exact_mdp.analysis.cli import main

scenario = Scenario.load("yuan2025").with_(tasks=[1])
mdp = scenario.compile()
assert solve(mdp).status and solve(mdp, PolicyIteration()).frame() is not None
assert certify(mdp).violations() == []
assert not check(mdp, "always:directive").passed
assert evaluate(mdp, "random").frame() is not None
assert simulate(mdp, "random", 20, 0) and return_distribution(mdp, "random")
assert gradient(scenario, names=["base.anger"]) and tornado(scenario, names=["base.anger"])
for words in (
    "info yuan2025", "solve yuan2025 --certify", "evaluate yuan2025 random",
    "returns yuan2025 random", "check yuan2025 optimal --html page.html --junit report.xml",
    "simulate yuan2025 random --episodes 20", "gradient yuan2025 --parameter base.anger",
    "tornado yuan2025 --parameter base.anger",
):
    assert main(words.split()) == 0, words
"""
COMMANDS = {
    "solve yuan2025 --method linear-program": "lp",
    "info gymnasium:FrozenLake-v1 --discount 0.9": "models",
    "info model.prism": "models",
    "info model.umb": "models",
    "convert yuan2025 m.umb": "models",
    "data log.parquet --out m.npz": "models",
}
IN_PYTHON = {
    "from exact_mdp import draw": "plots",
    "from exact_mdp.analysis.plots import style": "plots",
    "from exact_mdp import MDP, solve; solve(MDP.from_arrays([[[1]]], [0], '1/2')).plot()": "plots",
    "import exact_mdp.mdp.environment": "models",
    "from exact_mdp.paper_repro.agents.endpoint import Endpoint as E; E(model='m', base_url='https://x')":
        "agents",
}  # fmt: skip


def run(code: str, folder: Path) -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-W", "error", "-c", WITHOUT + code]
    return subprocess.run(
        words, cwd=folder, capture_output=True, text=True, stdin=subprocess.DEVNULL
    )


def test_python_and_the_commands_need_the_core_alone(tmp_path: Path) -> None:
    done = run(CORE, tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", COMMANDS)
def test_a_missing_package_names_its_extra(tmp_path: Path, command: str) -> None:
    for name in ("model.prism", "model.umb", "log.parquet"):
        (tmp_path / name).write_text("mdp")
    code = f"from exact_mdp.analysis.cli import main; sys.exit(main({command.split()!r}))"
    done = run(code, tmp_path)
    assert (done.returncode, done.stdout) == (2, ""), done.stderr
    assert f'pip install "exact-mdp[{COMMANDS[command]}]"' in done.stderr


@pytest.mark.parametrize("code", IN_PYTHON)
def test_in_python_a_missing_package_names_its_extra(tmp_path: Path, code: str) -> None:
    done = run(code, tmp_path)
    assert "exact_mdp.mdp.errors.ModelError: the package" in done.stderr
    assert f'pip install "exact-mdp[{IN_PYTHON[code]}]"' in done.stderr


def test_a_missing_package_of_the_core_is_named_with_the_command_that_installs_it(
    tmp_path: Path,
) -> None:
    hidden = WITHOUT.replace(f"in {sorted(OPTIONAL)!r}", "== 'tqdm'")
    code = "from exact_mdp.paper_repro.__main__ import main; main(['list'])"
    done = subprocess.run(
        [sys.executable, "-c", hidden + code], cwd=tmp_path, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout) == (3, "")
    assert "No module named 'tqdm'" in done.stderr
    assert done.stderr.rstrip().endswith("pip install .")


def test_in_the_reproduction_a_missing_package_names_its_extra(tmp_path: Path) -> None:
    done = run("from exact_mdp.paper_repro.__main__ import main; main(['--quick'])", tmp_path)
    assert done.returncode == 2, done.stderr
    assert 'pip install "exact-mdp[plots]"' in done.stderr
    assert list(tmp_path.iterdir()) == []
