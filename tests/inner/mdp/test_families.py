"""Pieces and rooms of parameters, and derivatives that are checked at points alone."""

from dataclasses import replace
from fractions import Fraction as F

from exact_mdp import (
    MDP,
    Certified,
    Claim,
    Family,
    Parameter,
    Scenario,
    certify,
    gradient,
    moving,
    parametric,
    thresholds,
)
from exact_mdp.analysis.vary.curves.gradient import Checked
from exact_mdp.mdp.parametric import room_of
from exact_mdp.mdp.parametric.row_change import pieces, row_change


def unit(name: str, value: F) -> Parameter:
    return Parameter(name=name, value=value, low=F(0), high=F(1))


def staying(at) -> MDP:
    """Earn 1 and stay with probability p: V = 1 / (1 - p)."""
    return MDP.from_arrays([[[at["p"], 1 - at["p"]], [0, 1]]], [1, 0])


def two_entries() -> Family:
    """Two probabilities of one row, each with room until both sum to 1."""
    mdp = MDP.from_arrays([[["1/2", "1/4", "1/4"], [0, 1, 0], [0, 0, 1]]], [1, 2, 0], "1/2")
    return moving(mdp, {"a": [(0, 0)], "b": [(0, 1)]})


def start_value(mdp: MDP) -> F:
    value = certify(mdp).value
    return sum((weight * F(value[state]) for state, weight in mdp.start), F(0))


def test_what_is_checked_at_points_alone_is_not_certified() -> None:
    family = Family(parameters=(unit("p", F(1, 2)),), build=staying)
    found = gradient(family)
    value = found["p"].value
    assert isinstance(value, Checked)
    assert (value.value, value.claim) == (4, Claim.CHECKED)
    assert value.points == 6  # degree + 5
    assert "not proven" in str(value)
    assert found.frame()["claim"].tolist() == ["checked"]
    told = thresholds(family, "p", (F(1, 4), F(3, 4)))
    assert told.claim == Claim.CHECKED
    assert gradient(family, exact=False)["p"].claim == Claim.CHECKED
    known = moving(staying({"p": F(1, 2)}), {"p": [(0, 0)]})
    assert gradient(known)["p"].value == Certified(value=F(4))
    assert gradient(replace(known, name="again"))["p"].claim == Claim.CERTIFIED
    other = replace(known, build=lambda at: staying(at))
    assert gradient(other, names=["p"])["p"].claim == Claim.CHECKED


# ---- what was refused, or not told ---------------------------------------------------------------


def test_two_named_entries_of_one_row_have_a_gradient() -> None:
    """Each has room until both sum to 1; V = (1 + 2 b γ / (1 - γ)) / (1 - γ a) by hand."""
    family = two_entries()
    found = gradient(family)

    def value(a: F, b: F) -> F:
        return (1 + 2 * b) / (1 - a / 2)

    a, b = F(1, 2), F(1, 4)
    slopes = {"a": (1 + 2 * b) / 2 / (1 - a / 2) ** 2, "b": 2 / (1 - a / 2)}
    assert start_value(family.at({"a": F(1, 8)})) == value(F(1, 8), b)
    for name, slope in slopes.items():
        each = found[name]
        assert each.value is not None
        assert (each.value.value, each.claim) == (slope, Claim.CERTIFIED)
    assert (room_of(family, "a"), room_of(family, "b")) == ((0, F(3, 4)), (0, F(1, 2)))


def test_a_parameter_at_the_end_of_its_room_has_one_side() -> None:
    family = two_entries()
    a, *rest = family.parameters
    family = replace(family, parameters=(replace(a, value=F(3, 4)), *rest))
    below, above = pieces(family, "a", F(3, 4))
    assert below is not None
    assert above is None


def test_scenario_degrees_hold_at_further_points() -> None:
    """What follows from the rules is checked here: no entry leaves its polynomial in a piece."""
    for readings in ({}, {"skip_onset": "base"}, {"skip_timestep": "own", "skip_onset": "base"}):
        own = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2, readings=readings)
        family = parametric(own)
        free = Family(
            parameters=family.parameters,
            build=lambda at, family=family: family.at(at),
            degrees={p.name: family.degree(p.name) for p in family.parameters},
            breaks={p.name: family.breakpoints(p.name) for p in family.parameters},
        )
        for name in (
            "base.confusion",
            "persistence.anger",
            "influence.anger.confusion",
            "discount",
        ):
            value = own.discount if name == "discount" else own[name]
            below, above = pieces(free, name, value)
            piece = above if above is not None else below
            assert piece is not None
            change = row_change(free, name, piece)  # refuses what does not fit at six points
            assert change.checked is not None
