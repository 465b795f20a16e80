"""Average rewards over parameters: each analysis beside exact averages at its points."""

from __future__ import annotations

from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest

from exact_mdp import (
    MDP,
    Family,
    ModelError,
    Scenario,
    certify,
    check,
    evaluate,
    gradient,
    moving,
    one_way,
    psa,
    sobol,
    solve,
    study,
    tornado,
    two_way,
    worst_point,
)

RANGES = {"arrival": ("1/10", "2/5"), "price": ("1/2", 4)}


def queue_at(at: dict[str, F], sense: str = "min") -> MDP:
    """A queue of at most four customers, served slowly or, at a price, fast."""
    sign, rows = (1 if sense == "min" else -1), []
    for here in range(5):
        for action, served in ((0, F(3, 10)), (1, F(1, 2))):
            if here == 0 and action:
                continue
            paid = sign * (here + action * at["price"])
            up = at["arrival"] if here < 4 else F(0)
            down = served if here else F(0)
            moves = [(up, here + 1, paid), (down, here - 1, paid), (1 - up - down, here, paid)]
            rows.append((here, action, [each for each in moves if each[0]]))
    return MDP.from_outcomes(rows, discount=1, sense=sense)


def queue(sense: str = "min") -> Family:
    return Family(parameters={"arrival": "1/4", "price": 2}, build=lambda at: queue_at(at, sense))


def gain(at: dict[str, F], sense: str = "min") -> F:
    value = certify(queue_at(at, sense), criterion="average").start_value
    assert isinstance(value, F)
    return value


@pytest.mark.parametrize("sense", ["min", "max"])
def test_each_analysis_has_the_exact_averages_of_its_points(sense: str) -> None:
    family, today = queue(sense), {"arrival": F(1, 4), "price": F(2)}
    tables = [
        one_way(family, "arrival", RANGES["arrival"], points=4, criterion="average").table,
        two_way(family, "arrival", "price", ranges=RANGES, points=2, criterion="average").table,
        tornado(family, ranges=RANGES, criterion="average").table,
        psa(
            family,
            8,
            uncertain={"arrival": {"low": 0.1, "high": 0.4, "distribution": "uniform"}},
            criterion="average",
        ).table,
        study(family, {"price": [1, "7/2"]}, criterion="average"),
    ]
    for table in tables:
        assert table.measure == "average reward"
        for row, point in enumerate(table.points.tolist()):
            at = today | {name: F(x) for name, x in zip(table.names, point, strict=True)}
            assert abs(F(table.optimal[row]) - gain(at, sense)) <= F(table.error[row, 0])
        assert (table.regret >= 0).all()
        assert table.lost.shape[1] == 0
    worst = worst_point(family, ranges=RANGES, criterion="average")
    assert dict(worst.point) == {"arrival": F(2, 5), "price": F(4)}
    assert abs(F(worst.optimum.value) - gain(dict(worst.point), sense)) <= F(worst.optimum.error)
    shares = sobol(family, ranges=RANGES, n=8, criterion="average")
    assert "average reward per step" in repr(shares)


def test_actions_count_as_optimal_where_they_keep_gain_and_bias() -> None:
    family = queue()
    for price in (F(1, 2), F(2), F(4)):
        table = study(family, {"price": [price]}, criterion="average")
        proof = certify(queue_at({"arrival": F(1, 4), "price": price}), criterion="average")
        optimal = np.array([[bool(x) for x in proof.optimal_pairs]])
        counted = table.counts[table.counts.sum(axis=1) > 0]
        mdp = family.at({"price": price})
        wanted = np.zeros((5, 2), dtype=int)
        wanted[mdp.pair_state, mdp.pair_action] = optimal[0]
        assert counted.tolist() == wanted[1:].tolist()  # state 0 has a single action


def test_the_reports_say_that_rewards_are_per_step(tmp_path: Path) -> None:
    family = queue()
    for result in (
        one_way(family, "price", (1, 3), points=2, criterion="average"),
        tornado(family, ranges=RANGES, criterion="average"),
        worst_point(family, ranges=RANGES, criterion="average"),
    ):
        assert result.report().facts["criterion"].text == "average reward per step"
    assert "average reward today" in repr(tornado(family, ranges=RANGES, criterion="average"))
    # A folder of finished work does not take an average for a total.
    points = {"price": [1.0, 3.0]}
    study(family, points, criterion="average", folder=tmp_path)
    below = Family(
        parameters=family.parameters,
        build=lambda at: queue_at(at).with_(discount="1/2"),
    )
    with pytest.raises(ModelError, match=r"other work: its record differs in .*criterion"):
        study(below, points, folder=tmp_path)


def test_a_care_scenario_and_an_unknown_criterion() -> None:
    table = study(Scenario.load("tea"), {"discount": ["9/10"]}, criterion="average")
    assert table.optimal.tolist() == [0.0]  # every episode ends
    with pytest.raises(ModelError, match="mean"):
        study(queue(), {"price": [1]}, criterion="mean")


def test_runs_that_stop_after_some_steps_have_no_average() -> None:
    mdp = queue_at({"arrival": F(1, 4), "price": F(2)})
    asked = queue().with_question(lambda each: each.within(3))
    for ask in (
        lambda: study(mdp.within(3), {"discount": [1]}, criterion="average"),
        lambda: study(asked, {"price": [1]}, criterion="average"),
        lambda: one_way(asked, "price", (1, 3), criterion="average"),
        lambda: tornado(asked, ranges=RANGES, criterion="average"),
        lambda: worst_point(asked, ranges=RANGES, criterion="average"),
        lambda: psa(mdp.within(3), 2, criterion="average"),
        lambda: gradient(asked, criterion="average"),
        lambda: gradient(asked, criterion="average", policy="random", exact=False),
        lambda: solve(mdp.within(3), criterion="average"),
        lambda: certify(mdp.within(3), criterion="average"),
        lambda: evaluate(mdp.within(3), "random", criterion="average"),
        lambda: check(mdp.within(3), "random", criterion="average"),
    ):
        with pytest.raises(ModelError, match="an average reward per step has no horizon"):
            ask()


def test_pictures_say_it_too() -> None:
    family = queue()
    bars = tornado(family, ranges=RANGES, criterion="average").plot()
    line = one_way(family, "price", (1, 3), points=3, criterion="average").plot()
    shares = sobol(family, ranges=RANGES, n=4, criterion="average").plot()
    assert bars.get_xlabel() == "average reward, policy re-optimised (reward per step)"
    assert line.get_ylabel() == "average reward (reward per step)"
    assert "average reward along price" in line.get_title(loc="left") + line.get_title()
    assert "average reward" in shares.get_title(loc="left") + shares.get_title()


def test_a_tornado_of_averages_leaves_out_the_discount() -> None:
    moved = moving(queue_at({"arrival": F(1, 4), "price": F(2)}), {"served": [(1, 0)]})
    assert "discount" in {parameter.name for parameter in moved.parameters}
    bars = tornado(moved, criterion="average").frame()
    assert "discount" not in set(bars["parameter"])
    assert len(bars) == len(moved.parameters) - 1
