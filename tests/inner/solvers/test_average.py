"""What certificates of averages are made of, and that their checker imports no solver."""

import re
from fractions import Fraction as F
from pathlib import Path

import numpy as np
from made_models import forest

from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.solvers.average import checker
from exact_mdp.solvers.average.chain import ExactAverages


def test_expansions_in_fractions_satisfy_their_equations() -> None:
    mdp = forest("1/2")
    rows = bellman_rows(mdp.undiscounted).of_pairs(np.array([0, 3, 4]))
    chain = ExactAverages(rows)
    g, h, w = chain.expansion(chain.reward)
    following = [dict(enumerate(row)) for row in ([F(1, 10), F(9, 10), 0], [1, 0, 0])]
    for s, row in enumerate(following):
        onward = [sum(p * x[t] for t, p in row.items()) for x in (g, h, w)]
        assert onward[0] == g[s]
        assert g[s] + h[s] - onward[1] == chain.reward[s]
        assert h[s] + w[s] - onward[2] == 0
    assert chain.mean(h).tolist() == chain.mean(w).tolist() == [0]


def test_the_checker_imports_no_solver() -> None:
    source = Path(checker.__file__).read_text("utf-8")
    taken = re.findall(r"^from exact_mdp\.(\S+) import", source, re.M)
    assert {name for name in taken if not name.startswith("mdp.")} == {"solvers.proof.checker"}
