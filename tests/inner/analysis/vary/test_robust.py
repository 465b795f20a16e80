"""Worst and best cases of one wager by closed forms, and worst corners by enumeration."""

import json
from fractions import Fraction
from itertools import product
from math import inf
from typing import Any

import numpy as np
import pytest
from refusal_tables import refused
from scipy.optimize import brentq

from exact_mdp import MDP, Family, Parameter, Scenario, parametric, robust, worst_point
from exact_mdp.solvers.claims import Claim
from exact_mdp.solvers.robust.sets import L1Ball

F = Fraction

# ---- rows that may be off ------------------------------------------------------------------------

CHANCES = (F(1, 2), F(3, 10), F(9, 10))  # of winning, in three wagers
PRIZES = (F(8), F(13), F(4))


def wagers(sense: str = "max") -> MDP:
    """State 0 leads on; in state 1 three wagers win their prize or nothing, a step later."""
    sign = 1 if sense == "max" else -1
    rows: list[Any] = [(0, 0, [(1, 1, 0)])]
    for a, p in enumerate(CHANCES):
        rows.append((1, a, [(p, 2 + a, 0), (1 - p, 5, 0)]))
    rows += [(2 + a, 0, [(1, 5, sign * prize)]) for a, prize in enumerate(PRIZES)]
    return MDP.from_outcomes([*rows, (5, 0, [(1, 5, 0)])], discount="1/2", sense=sense)


def chance_of(kind: str, p: Fraction, radius: float, low: bool) -> float:
    """The least or greatest chance of winning within a set of laws around (p, 1 - p)."""
    one = float(p)
    if kind == "interval":
        ends = (
            max(one * (1 - radius), 1 - (1 - one) * (1 + radius)),
            min(one * (1 + radius), 1 - (1 - one) * (1 - radius)),
        )
        return ends[0] if low else ends[1]
    if kind == "l1":
        return max(one - radius / 2, 0) if low else min(one + radius / 2, 1)

    def far(q: float) -> float:
        return one * np.log(one / q) + (1 - one) * np.log((1 - one) / (1 - q)) - radius

    return brentq(far, 1e-12, one) if low else brentq(far, one, 1 - 1e-12)


USUAL = {"interval": 1 / 5, "l1": 1 / 10, "kl": 1 / 100}


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("kind", USUAL)
@pytest.mark.parametrize("radius", [None, "1/4"])
@pytest.mark.parametrize("policy", [None, 2])
def test_cases_are_those_of_the_least_and_the_greatest_chances(
    kind: str, radius: str | None, policy: int | None, sense: str
) -> None:
    sign, x = 1 if sense == "max" else -1, USUAL[kind] if radius is None else 0.25
    held = [0, policy, 0, 0, 0, 0] if policy is not None else "optimal"
    found = robust(wagers(sense), kind, radius=radius, policy=held)
    nominal, least, most = (
        [float(prize) / 4 * chance for prize, chance in zip(PRIZES, chances, strict=True)]
        for chances in (
            [float(p) for p in CHANCES],
            [chance_of(kind, p, x, True) for p in CHANCES],
            [chance_of(kind, p, x, False) for p in CHANCES],
        )
    )
    own = 0 if policy is None else policy
    if policy is None:
        own = max(range(3), key=lambda a: nominal[a])
    hedged = max(range(3), key=lambda a: least[a])
    for number, wanted in (
        (found.value, nominal[own]),
        (found.worst, least[own]),
        (found.best, most[own]),
        (found.robust.start, max(least)),
        (found.optimistic.start, max(most)),
        (found.robust_value, nominal[hedged]),
        (found.robust_best, most[hedged]),
    ):
        assert number.value == pytest.approx(sign * wanted, abs=1e-9)
    assert found.price.value == pytest.approx(nominal[own] - nominal[hedged], abs=1e-9)
    assert found.gain.value == pytest.approx(max(least) - least[own], abs=1e-9)
    assert found.changed.tolist() == ([1] if own != hedged else [])
    frame = found.frame()
    values = [nominal[own], least[own], most[own], nominal[hedged], max(least), most[hedged],
              max(most)]  # fmt: skip
    assert frame["value (reward)"].tolist() == pytest.approx([sign * v for v in values], abs=1e-9)
    assert frame["policy"].tolist() == ["nominal"] * 3 + ["robust"] * 3 + ["optimistic"]
    assert frame["distributions"].tolist() == [*("nominal", "worst", "best") * 2, "best"]
    told = json.loads(found.report().json())
    changes = [{"state": "state 1", "before": str(own), "after": str(hedged)}]
    assert told["policy_changes"] == (changes if own != hedged else [])
    assert told["price_of_robustness"]["value"] == pytest.approx(found.price.value)
    assert told["worst_case_gain"]["value"] == pytest.approx(found.gain.value)
    for key, number, of in (
        ("worst_case", found.robust.start, found.worst),
        ("best_case", found.optimistic.start, found.best),
    ):
        assert told[key]["value"] == pytest.approx(number.value)
        assert told[key]["nominal_policy"]["value"] == pytest.approx(of.value)
    assert told["robust_policy_value"]["value"] == pytest.approx(found.robust_value.value)
    rows = found.report().tables["values"].rows
    assert [(row["policy"], row["right"], row["worst"], row["best"]) for row in rows] == [
        ("held", found.value, found.worst, found.best),
        ("robust", found.robust_value, found.robust.start, found.robust_best),
    ]


def test_what_is_done_in_states_that_nobody_reaches_is_no_change() -> None:
    """State 1 is left out: the policy that is held stays at the start."""
    rows: list[Any] = [(0, 0, [(1, 3, 5)]), (0, 1, [(1, 1, 0)])]
    rows += [(1, 0, [("1/2", 2, 0), ("1/2", 3, 0)]), (1, 1, [("1/3", 2, 0), ("2/3", 3, 0)])]
    rows += [(2, 0, [(1, 3, 4)]), (3, 0, [(1, 3, 0)])]
    mdp = MDP.from_outcomes(rows, discount="1/2")
    assert robust(mdp, policy=[0, 1, 0, 0]).changed.tolist() == []
    assert robust(mdp, policy=[1, 1, 0, 0]).changed.tolist() == [0, 1]
    mixed = robust(mdp, policy=[1, 0, 0, 0])
    assert mixed.changed.tolist() == [0]
    # The robust policy leads on, and the one that is held stays: both count.
    rows[0] = (0, 0, [(1, 3, "1/8")])
    assert robust(MDP.from_outcomes(rows, discount="1/2"), policy=[0, 1, 0, 0]).changed[1] == 1


def test_a_set_has_a_name_and_a_radius_or_is_given_whole() -> None:
    mdp = wagers()
    given = robust(mdp, L1Ball(radius="1/4"))
    assert given.worst == robust(mdp, "l1", radius=0.25).worst
    fix = '=name the set, as in robust(model, "l1", radius=0.1), or leave out the radius'
    what = "=a radius, and a set that has its own"
    refused(lambda: robust(mdp, L1Ball(radius="1/4"), radius=1), what, "=radius", fix)
    refused(lambda: robust(mdp, "l2"), "=unknown set 'l2'", "=robust", "l1")


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize(
    ("actions", "held", "cases"),
    [  # what one may earn each step for ever, or 3 at once; the value held and the best worst case
        ("-+3", 0, (-inf, inf)), ("-+3", 1, None), ("-+3", 2, (3, inf)),
        ("-3", 0, (-inf, 3)), ("-", 0, None),
    ],
)  # fmt: skip
def test_values_may_be_infinite_and_their_differences_with_them(
    actions: str, held: int, cases: tuple[float, float] | None, sense: str
) -> None:
    sign = 1 if sense == "max" else -1
    outcomes = {"-": (1, 0, -sign), "+": (1, 0, sign), "3": (1, 1, 3 * sign)}
    rows: list[Any] = [(0, a, [outcomes[each]]) for a, each in enumerate(actions)]
    found = robust(MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], sense=sense), policy=[held, 0])
    if cases is None:
        assert (found.price, found.gain) == (None, None)
        assert json.loads(found.report().json())["price_of_robustness"] is None
    else:
        numbers = found.value, found.worst, found.robust_value, found.robust.start
        wanted = pytest.approx([sign * case for case in cases for _ in range(2)])
        assert [number.value for number in numbers] == wanted
        assert (found.price.value, found.gain.value) == (-inf, inf)
        assert (found.price.error, found.gain.error) == (0, 0)


@pytest.mark.parametrize("sense", ["max", "min"])
def test_rewards_per_step_have_cases_too(sense: str) -> None:
    """A machine earns r a step, and fails with chance f for a step: r / (1 + f)."""
    sign = 1 if sense == "max" else -1
    rows: list[Any] = [(0, 0, [("1/2", 0, 4 * sign), ("1/2", 1, 4 * sign)]),
                       (0, 1, [("9/10", 0, 3 * sign), ("1/10", 1, 3 * sign)]),
                       (1, 0, [(1, 0, 0)])]  # fmt: skip
    # At a discount of 1/2 the first action is the better one.
    mdp = MDP.from_outcomes(rows, discount="1/2", sense=sense)
    nominal, least, most = (4 / 1.5, 3 / 1.1), (4 / 1.6, 3 / 1.12), (4 / 1.4, 3 / 1.08)
    for held, own in (([0, 0], 0), ("optimal", 1)):
        found = robust(mdp, policy=held, criterion="average")
        for number, wanted in (
            (found.value, nominal[own]), (found.worst, least[own]), (found.best, most[own]),
            (found.robust.start, least[1]), (found.optimistic.start, most[0]),
            (found.robust_value, nominal[1]), (found.robust_best, most[1]),
        ):  # fmt: skip
            assert number.value == pytest.approx(sign * wanted, abs=1e-9)
        assert found.report().tables["values"].title == "average reward at the start"
        assert json.loads(found.report().json())["criterion"] == "average"


# ---- one choice for all states -------------------------------------------------------------------

NAMES = ("x", "y", "z")


def family(worth: Any, sense: str = "max") -> Family:
    """One step: the first action is worth a function of three numbers, the second 3/2."""
    sign = 1 if sense == "max" else -1

    def build(at: Any) -> MDP:
        first, second = sign * worth(*(at[name] for name in NAMES)), sign * F(3, 2)
        rows = [(0, 0, [(1, 1, first)]), (0, 1, [(1, 1, second)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, discount="1/2", sense=sense)

    return Family(parameters=tuple(Parameter(name=n, value=1) for n in NAMES), build=build)


FUNCTIONS = {
    "sum": lambda x, y, z: x - 2 * y + z,
    "product": lambda x, y, z: x * y * z,
    "turns": lambda x, y, z: (x - 1) * (y - 1) - z,
    "apart": lambda x, y, z: (x - F(3, 4)) * (y - F(3, 4)) + z * (1 - y),
    "constant": lambda x, y, z: F(2),
    "of z": lambda x, y, z: -z,
}
RANGES: dict[str, Any] = {"y": ("1/2", "3/2"), "x": (0, 3), "z": (-1, 2)}


def corner_found(value: Any) -> tuple[dict[str, Fraction], int]:
    """Each parameter at its own worse end, of equals the low; then the best flip."""
    ends = {name: [F(end) for end in ends] for name, ends in RANGES.items()}
    today = dict.fromkeys(RANGES, F(1))
    at = {
        name: int(value(**(today | {name: high})) < value(**(today | {name: low})))
        for name, (low, high) in ends.items()
    }

    def of(chosen: dict[str, int]) -> Fraction:
        return value(**{name: ends[name][k] for name, k in chosen.items()})

    seen = 1
    while True:
        flips = [at | {name: 1 - at[name]} for name in RANGES]
        seen += len(flips)
        least = min(flips, key=of)
        if of(least) >= of(at):
            return {name: ends[name][k] for name, k in at.items()}, seen
        at = least


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_corner_is_one_that_no_flip_of_one_parameter_makes_worse(name: str, sense: str) -> None:
    value, sign = FUNCTIONS[name], 1 if sense == "max" else -1
    found = worst_point(family(value, sense), [0, 0], RANGES)
    point, corners = corner_found(value)
    assert {**found.point} == point
    assert [*found.point] == [*RANGES]
    assert found.corners == corners
    assert found.value.value == pytest.approx(sign * float(value(**point)))
    assert found.optimum.value == pytest.approx(sign * float(max(value(**point), F(3, 2))))
    every = [value(**dict(zip(RANGES, map(F, at), strict=True)))
             for at in product(*RANGES.values())]  # fmt: skip
    if name in ("sum", "constant", "of z"):
        assert value(**point) == min(every)
    for flipped in RANGES:
        low, high = map(F, RANGES[flipped])
        other = point | {flipped: low if point[flipped] == high else high}
        assert value(**other) >= value(**point)
    assert found.frame()["parameter"].tolist() == [*RANGES]
    assert found.frame()["at"].tolist() == [float(each) for each in point.values()]
    facts = found.report().facts["worst_case"].value
    assert facts["value"] == pytest.approx(found.value.value)
    assert facts["point"] == {n: float(at) for n, at in point.items()}
    assert facts["optimum"] == found.optimum
    table = found.report().tables["point"]
    assert table.title == f"the worst of {corners} corners"
    assert table.values() == [[n, float(at)] for n, at in point.items()]
    assert found.claim is Claim.ESTIMATED


def test_random_corners_are_those_of_the_search_by_hand() -> None:
    rng = np.random.default_rng(0)
    for _ in range(12):
        c = [F(int(n), 4) for n in rng.integers(-8, 9, 7)]

        def value(x: Any, y: Any, z: Any, c: Any = c) -> Any:
            return (c[0] * x + c[1] * y + c[2] * z + c[3] * x * y + c[4] * y * z + c[5] * x * z
                    + c[6] * x * y * z)  # fmt: skip

        found = worst_point(family(value), [0, 0], RANGES)
        assert ({**found.point}, found.corners) == corner_found(value)


def test_ranges_are_shares_of_today_unless_stated() -> None:
    model = family(FUNCTIONS["sum"])
    assert {**worst_point(model, [0, 0]).point} == {"x": F(4, 5), "y": F(6, 5), "z": F(4, 5)}
    half = worst_point(model, [0, 0], relative="1/2").point
    assert {**half} == {"x": F(1, 2), "y": F(3, 2), "z": F(1, 2)}
    today = worst_point(model)  # the optimum today is the second action, which nothing changes
    assert today.value.value == 1.5
    one = worst_point(model, [0, 0], {"z": (0, 5)})
    assert ({**one.point}, one.corners) == ({"z": F(0)}, 2)


def forever(sense: str, y: Any = "1/2") -> Family:
    """State 0 earns x a step and ends with probability y; the other action ends, and earns z."""

    def build(at: Any) -> MDP:
        rows = [
            (0, 0, [(at["y"], 1, at["x"]), (1 - at["y"], 0, at["x"])]),
            (0, 1, [(1, 1, at["z"])]),
        ]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], sense=sense)

    low, high = F(0), F(1)
    parameters = [Parameter(name="x", value=1), Parameter(name="z", value=1)]
    return Family(
        parameters=(*parameters, Parameter(name="y", value=y, low=low, high=high)), build=build
    )


@pytest.mark.parametrize("sense", ["max", "min"])
def test_a_value_may_be_infinite_at_the_worst_corner(sense: str) -> None:
    """x / y is worst with y = 0, unless it ends for good."""
    sign = 1 if sense == "max" else -1
    worse, better = F(-sign), F(sign)
    ranges: dict[str, Any] = {"x": sorted((2 * worse, worse)), "y": (0, "1/2"), "z": (0, 1)}
    found = worst_point(forever(sense), [0, 0], ranges)
    assert (found.value.value, found.point["y"]) == (-sign * inf, 0)
    assert found.optimum.value == found.point["z"]
    assert json.loads(found.report().json())["worst_case"]["value"] == f"{-sign * inf:g}"
    # What grows without limit is the best of all: the worst corner ends.
    ranges = {"x": sorted((better, 2 * better)), "y": (0, "1/2"), "z": (0, 1)}
    found = worst_point(forever(sense), [0, 0], ranges)
    assert (found.value.value, found.point["y"]) == (pytest.approx(2 * sign), F(1, 2))
    whole = worst_point(forever(sense, 0), [0, 0], {"x": ranges["x"]})
    assert (whole.value.value, whole.optimum.value) == (sign * inf, sign * inf)


def test_a_warning_names_the_line_and_the_ends_of_the_ranges(
    recwarn: pytest.WarningsRecorder,
) -> None:
    number = Parameter(name="x", value="9/10")
    worst_point(Family(parameters=(number,), build=lambda at: wagers()))
    (said,) = recwarn
    assert (said.filename, "varied up to 1.08" in str(said.message)) == (__file__, True)
    recwarn.clear()
    scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    ranges = {"base.anger": ("1/100", "99/100")}
    worst_point(scenario, "always:none", ranges)
    (said,) = recwarn
    where = " at the upper ends of the ranges: a chance of "
    assert (said.filename, where in str(said.message)) == (__file__, True)
    recwarn.clear()
    asked = parametric(scenario).with_question(lambda mdp: mdp)  # whose models warn by themselves
    worst_point(asked, "always:none", ranges)
    (said,) = recwarn
    assert " where base.anger is 0.99: a chance of " in str(said.message)
