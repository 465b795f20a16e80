"""In a checkout the short names lead to the same modules, and so to the same classes."""

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

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


@pytest.mark.parametrize(
    "words", [["-c", SAME], ["-m", "paper_repro", "--help"], ["-m", "paper_repro.agents", "--help"]]
)
def test_short_names_are_the_same_modules(words: list[str]) -> None:
    if not (ROOT / "mdp").is_dir():
        pytest.skip("a checkout without links")
    done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_a_package_of_the_user_of_that_name_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mdp").mkdir()
    (tmp_path / "mdp" / "__init__.py").touch()
    (tmp_path / "mdp" / "model.py").write_text("OWN = 'own'", "utf-8")
    code = OTHER.format(str(tmp_path))
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.stdout == "own\n", done.stderr
