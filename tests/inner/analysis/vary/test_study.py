"""Studies: at every point the optimum and policies of the model that the point makes."""

from fractions import Fraction as F
from itertools import product

import numpy as np
import pytest
from oracle import policies, policy_values, rows_of

from exact_mdp import MDP, Family, study
from exact_mdp.analysis.vary.study import digest, require_room
from exact_mdp.mdp.errors import ModelError

POINTS = {"p": [F(1, 4), F(1, 2), F(3, 4)], "r": [F(0), F(-2), F(5)]}


def build(at: dict[str, F]) -> MDP:
    p, r = at["p"], at["r"]
    rows = [
        (0, 0, [(p, 0, r), (1 - p, 1, 1)]),
        (0, 1, [(1, 1, 2)]),
        (1, 0, [(F(1, 3), 0, 0), (F(2, 3), 1, -r)]),
        (1, 1, [(1 - p, 0, 1), (p, 1, 0)]),
    ]
    return MDP.from_outcomes(rows, "4/5", start={0: "1/4", 1: "3/4"})


@pytest.mark.parametrize("sense", ["max", "min"])
def test_each_point_is_its_model(sense: str) -> None:
    family = Family(parameters={"p": "1/2", "r": 0}, build=lambda at: build(at).with_(sense=sense))
    found = study(family, POINTS, policies=["optimal", "random", [0, 1]])
    today = family.at({})
    for d, (p, r) in enumerate(zip(*POINTS.values(), strict=True)):
        mdp = build({"p": p, "r": r})
        values = {tuple(a for _, a, _, _ in each): policy_values(each, F(4, 5))
                  for each in policies(rows_of(mdp))}  # fmt: skip
        start = {key: v[0] / 4 + 3 * v[1] / 4 for key, v in values.items()}
        best = (max if sense == "max" else min)(start.values())
        assert abs(F(found.optimal[d]) - best) <= F(found.error[d, 0]) < F(1, 10**9)
        assert start[tuple(found.rows[found.which[d]].tolist())] == best
        now = {tuple(a for _, a, _, _ in each): policy_values(each, F(4, 5))
               for each in policies(rows_of(today))}  # fmt: skip
        held = (max if sense == "max" else min)(now, key=lambda key: now[key][0])
        mean = [(s, 0, sum(r for u, _, r, _ in rows_of(mdp) if u == s) / 2,
                 {t: sum(law.get(t, F(0)) for u, _, _, law in rows_of(mdp) if u == s) / 2
                  for t in (0, 1)}) for s in (0, 1)]  # fmt: skip
        random = policy_values(mean, F(4, 5))
        wanted = [start[held], random[0] / 4 + 3 * random[1] / 4, start[0, 1]]
        for n, exact in enumerate(wanted):
            assert abs(F(found.fixed[d, n]) - exact) <= F(found.error[d, n + 1]) < F(1, 10**9)
            assert found.regret[d, n] == pytest.approx(abs(float(best - exact)), abs=1e-12)
    assert found.points.tolist() == [*map(list, zip(*POINTS.values(), strict=True))]
    optimum, fixed = found.bounded(1)
    assert (optimum.value, fixed.value) == (found.optimal[1], found.fixed[1, 0])
    assert (optimum.error, fixed.error) == (found.error[1, 0], found.error[1, 1])


def test_a_digest_tells_policies_apart() -> None:
    one, other = np.array([0.0, 1.0]), np.array([1.0, 0.0])
    seen = {digest(*each) for each in product([one, other], repeat=2)}
    assert len(seen) == 4
    assert digest(one) == digest(one.copy())


def test_too_many_points_are_refused_before_any_work() -> None:
    require_room(10, 2, "fewer")
    with pytest.raises(ModelError):
        require_room(10**12, 50, "fewer")
