"""Compiled loops are loaded for large models, and for them alone."""

import subprocess
import sys

import pytest

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
import runpy, sys
for words in ("solve yuan2025 --certify", "evaluate yuan2025 optimal", "check yuan2025 optimal",
              "returns yuan2025 optimal", "info yuan2025"):
    sys.argv[1:] = words.split()
    try:
        runpy.run_module("exact_mdp", run_name="__main__")
    except SystemExit as end:
        assert end.code == 0, words
"""


@pytest.mark.parametrize(
    ("code", "loaded"),
    [(SMALL, False), (COMMANDS, False), (LARGE, True)],
    ids=["small", "commands", "large"],
)
def test_the_compiler_is_loaded_for_large_models_alone(code: str, loaded: bool) -> None:
    code += "\nimport sys; print('numba' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == str(loaded)
