"""What is counted: each name's expected amounts, sums of them, and arrivals at a label."""

from fractions import Fraction as F

import pytest

from exact_mdp import MDP, ModelError
from exact_mdp.solvers.objectives.amounts import Objectives

ROWS = [
    (0, 0, [("1/4", 1, 3), ("3/4", 2, -1)]),
    (0, 1, [(1, 2, "1/2")]),
    (1, 0, [("1/2", 1, 0), ("1/2", 2, 4)]),
    (2, 0, [(1, 2, 0)]),
]
MEANS = [F(0), F(1, 2), F(2), F(0)]  # of the rewards: 3/4 - 3/4, 1/2, 2, 0
COST = [F(1, 3), F(0), F(-2), F(0)]


def model(sense: str = "max", discount: object = 1) -> MDP:
    mdp = MDP.from_outcomes(ROWS, discount, components={"cost": COST}, sense=sense)
    return mdp.with_(labels={"done": [2]})


def amounts(of: Objectives) -> list[list[F]]:
    scale = of.rows.scale[of.mdp.pair_state].tolist()
    return [[F(int(top), int(below)) for top, below in zip(own.tolist(), scale, strict=True)]
            for own in of.amounts]  # fmt: skip


@pytest.mark.parametrize(("sense", "sign"), [("max", 1), ("min", -1)])
def test_each_name_has_its_expected_amounts(sense: str, sign: int) -> None:
    names = ["reward", "cost", "steps", "both=2*reward-3*cost", "done"]
    of = Objectives(model(sense), names)
    assert of.names == ("reward", "cost", "steps", "both", "done")
    arrived = [F(3, 4), F(1), F(1, 2), F(0)]
    both = [2 * r - 3 * c for r, c in zip(MEANS, COST, strict=True)]
    wanted = [MEANS, COST, [F(1), F(1), F(1), F(0)], both, arrived]
    assert amounts(of) == [[sign * x for x in each] for each in wanted]
    assert of.sign == sign


def test_weights_add_amounts_up() -> None:
    of = Objectives(model(), ["reward", "cost"])
    rows, unit = of.rows_for([F(1, 2), F(-2, 3)])
    scale = rows.scale[of.mdp.pair_state].tolist()
    found = [F(int(x), int(s)) for x, s in zip(rows.constant.tolist(), scale, strict=True)]
    assert found == [unit * (r / 2 - 2 * c / 3) for r, c in zip(MEANS, COST, strict=True)]
    weighted = [int(x) for x in of.weigh_amounts([3, 5]).tolist()]
    assert [F(x, int(s)) for x, s in zip(weighted, scale, strict=True)] == [
        3 * r + 5 * c for r, c in zip(MEANS, COST, strict=True)
    ]


def test_what_has_no_finite_total_is_refused() -> None:
    ring = MDP.from_outcomes([(0, 0, [(1, 0, 1)])], 1)
    for name, said in (("reward", "never ends"), ("no such", "no such")):
        with pytest.raises(ModelError, match=said):
            Objectives(ring if name == "reward" else model(), [name])
    assert Objectives(ring.with_(discount="1/2"), ["reward"]).names == ("reward",)
    with pytest.raises(ModelError, match="named twice"):
        Objectives(model(), ["cost", "cost=reward"])
