"""What certificates of averages are made of."""

from fractions import Fraction as F

import numpy as np
from made_models import forest

from exact_mdp.mdp.exact import bellman_rows
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
