"""Curves of averages: closed forms, proven averages at points, and what the checker refuses."""

from dataclasses import replace
from fractions import Fraction as F
from random import Random
from typing import Any

import pytest
from average_models import average_of, moved_family, two_states

from exact_mdp import MDP, Family, ModelError, Parameter, curve, explore, thresholds
from exact_mdp.analysis.vary.curves.average_equations import AverageEquations
from exact_mdp.analysis.vary.curves.checker import piece_violations
from exact_mdp.analysis.vary.curves.curve import ValueFunction
from exact_mdp.analysis.vary.curves.walk import compute_policy_values
from exact_mdp.mdp.exact import from_flint, to_flint
from exact_mdp.mdp.parametric.row_change import Piece


def chain(**today: object) -> Family:
    parameters = [Parameter(name=name, value=value) for name, value in today.items()]
    return Family(parameters=tuple(parameters), build=two_states)


# ---- closed forms --------------------------------------------------------------------------------


def test_a_chain_of_two_states() -> None:
    """g = r q / (p + q), at any discount."""
    family = chain(p="1/3", q="1/5", r=7)
    line = curve(family, "p", ("1/10", "9/10"), criterion="average")
    (piece,) = line.pieces
    assert piece.value.numerator == (7,)
    assert piece.value.denominator == (1, 5)  # 7 / (1 + 5 p)
    assert line.violations() == []
    assert line.slope("1/2") == (F(-35) / F(7, 2) ** 2,) * 2
    assert line.report().facts["criterion"].text == "average reward per step"
    assert "pieces of the optimal average reward" in line.report().tables["pieces"].title
    assert "average reward" in line.plot().get_ylabel()
    still = curve(two_states({"p": F(1, 3), "q": F(1, 5), "r": F(7)}), "discount", (0, 1),
                  criterion="average")  # fmt: skip
    assert still.at("1/2") == still.at(1) == F(7) * F(1, 5) / (F(1, 3) + F(1, 5))


def machine(at: dict[str, F]) -> MDP:
    """A machine that earns 6 a step, and fails with chance 1/2; repair costs c, or it stands."""
    c = at["c"]
    rows = [(0, 0, [("1/2", 0, 6), ("1/2", 1, 6)]), (1, 0, [(1, 0, -c)]), (1, 1, [(1, 1, 1)])]
    return MDP.from_outcomes(rows)


def test_two_policies_of_which_one_stays_apart() -> None:
    """max((12 - c) / 3, 1): at c = 9 the best policy has another recurrent class."""
    family = Family(parameters={"c": 3}, build=machine, degrees={"c": 1})
    line = curve(family, "c", (0, 20), policy=[0, 0], criterion="average")
    assert line.violations() == []
    assert [piece.value.numerator for piece in line.pieces] == [(4, F(-1, 3)), (1,)]
    (low, high) = line.pieces[0].high
    assert low <= 9 <= high
    assert high - low <= F(1, 10**12)
    assert [line.at(c) for c in (0, 9, 20)] == [4, 1, 1]
    assert line.fixed_at(20) == F(-8, 3)
    (kept,) = line.within(F(1, 2))
    assert (kept.low[0], kept.high) == (0, (F(21, 2), F(21, 2)))
    found = thresholds(family, "c", (0, 20), criterion="average")
    (threshold,) = found.found
    (switch,) = threshold.switches
    assert (switch.label, switch.before, switch.after) == ("state 1", ("0",), ("1",))
    assert found.report().facts["criterion"].value == "average"
    page = explore(family, "c", ranges={"c": (0, 20)}, policy="optimal", criterion="average")
    assert "optimal average reward at the start" in page.page()
    assert page.curves[0].fixed_at(20) == F(-8, 3)


# ---- random models -------------------------------------------------------------------------------


@pytest.mark.parametrize("sense", ["max", "min"])
def test_random_models_beside_proven_averages(sense: str) -> None:
    """Where transitions vanish, at t = 0 or 1, the average may jump, and the curve is refused."""
    pieces, refused = 0, 0
    for seed in range(20):
        rng = Random(f"{sense} {seed}")
        family = moved_family(rng, F(1, 3), sense)
        held = [rng.randrange(len(family.at({}).pairs_of(s))) for s in range(4)]
        span = rng.choice(((F(0), F(1)), (F(1, 9), F(8, 9)), (F(1, 9), F(2, 9)), (F(0), F(1, 2))))
        try:
            line = curve(family, "t", span, policy=held, criterion="average")
        except ModelError as refusal:
            if "the average may jump" not in str(refusal) or "t = 0" not in str(refusal):
                raise
            refused += 1
            continue
        assert line.violations() == []
        pieces += len(line.pieces)
        ends = [end for piece in line.pieces for end in piece.high]
        for t in [span[0] + (span[1] - span[0]) * F(k, 5) for k in (0, 2, 5)] + ends:
            mdp = family.at({"t": t})
            assert line.at(t) == average_of(mdp)
            assert line.fixed_at(t) == average_of(mdp, held)
    assert pieces > 18
    assert refused < 8


# ---- what is refused -----------------------------------------------------------------------------


def leaking(at: dict[str, F]) -> MDP:
    """With chance t state 0 is left for good: the average at the start is 0, and 1 at t = 0."""
    t = at["t"]
    rows = [(0, 0, [(1 - t, 0, 1), (t, 1, 1)] if t else [(1, 0, 1)]), (1, 0, [(1, 1, 0)])]
    return MDP.from_outcomes(rows)


LEAKING = Family(parameters=(Parameter(name="t", value="1/2", low=0, high=1),), build=leaking)


def test_a_jump_is_refused_and_a_piece_that_covers_it_is_not_accepted() -> None:
    line = curve(LEAKING, "t", ("1/4", 1), criterion="average")
    assert line.violations() == []
    assert line.at("1/4") == 0
    with pytest.raises(ModelError, match="the average may jump") as refused:
        curve(LEAKING, "t", (0, 1), criterion="average")
    assert refused.value.where == "t = 0"


@pytest.mark.parametrize(
    ("zeros", "place"),
    [([0, -1, 3], "t = 0.333333"), ([-1, 0, 2], "t ≈ 0.707107"), ([1, -9, 14], "t ≈ 0.142857")],
)
def test_the_first_point_of_a_jump_is_named(zeros: list[int], place: str) -> None:
    """State 0 is left with chance q², where q(t) is 0 between 0 and 1."""

    def build(at: dict[str, F]) -> MDP:
        p = (sum(c * at["t"] ** k for k, c in enumerate(zeros)) / 9) ** 2
        rows = [(0, 0, [(1 - p, 0, 1), (p, 1, 1)] if p else [(1, 0, 1)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows)

    family = Family(parameters={"t": "1/4"}, build=build, degrees={"t": 4})
    with pytest.raises(ModelError, match="the average may jump") as refused:
        curve(family, "t", ("1/9", 1), criterion="average")
    assert refused.value.where == place


def paused(at: dict[str, F]) -> MDP:
    """State 0 earns 2 where it stays; the other action goes, with chance t, to a state of 3."""
    t = at["t"]
    moves = [(1 - t, 0, 0), (t, 1, 0)] if t else [(1, 0, 0)]
    return MDP.from_outcomes([(0, 0, [(1, 0, 2)]), (0, 1, moves), (1, 0, [(1, 1, 3)])])


def test_a_jump_of_the_optimum_alone_is_refused() -> None:
    family = Family(parameters=(Parameter(name="t", value="1/2", low=0, high=1),), build=paused)
    assert curve(family, "t", ("1/9", 1), criterion="average").at("1/9") == 3
    with pytest.raises(ModelError, match="the average may jump"):
        curve(family, "t", (0, 1), criterion="average")
    worse = Family(parameters=family.parameters, build=lambda at: paused(at).with_(sense="min"))
    assert curve(worse, "t", ("1/9", 1), criterion="average").at("1/9") == 2


def test_what_has_no_average_is_refused() -> None:
    mdp = machine({"c": F(3)}).with_(labels={"failed": {1}})
    for asked in (mdp.within(3), mdp.until("failed")):
        for ask in (curve, thresholds):
            with pytest.raises(ModelError, match="an average reward per step has no"):
                ask(asked, "reward.6", (1, 7), criterion="average")
    ring = [(s, 0, [("1/2", s, 1), ("1/2", (s + 1) % 301, 0)]) for s in range(301)]
    with pytest.raises(ModelError, match="states with cycles among them"):
        curve(MDP.from_outcomes(ring), "reward.1", (0, 1), criterion="average")


# ---- the checker ---------------------------------------------------------------------------------


def told(line: ValueFunction, **changes: Any) -> str:
    """Return what the checker says of the first piece with other parts."""
    first, *others = line.pieces
    return "; ".join(replace(line, pieces=(replace(first, **changes), *others)).violations())


def test_the_checker_finds_what_is_wrong() -> None:
    family = Family(parameters={"c": 3}, build=machine, degrees={"c": 1})
    line = curve(family, "c", (0, 20), policy=[0, 0], criterion="average")
    first, second = line.pieces
    numbers, below = first.values
    assert told(line) == ""
    # The values of the second policy are not optimal here; those of a higher gain are of no policy.
    assert "is better" in told(line, values=second.values, optimal=second.optimal)
    raised = [*numbers[:2], *(each + below for each in numbers[2:])]
    assert "are not those that are optimal" in told(line, values=(raised, below))
    assert "the gain at the start is another one" in told(
        line, values=([*numbers[:-1], numbers[-1] + 1], below)
    )
    negative = [-each for each in numbers], -below
    assert "the denominator" in told(line, values=negative)
    assert "are not those that are optimal" in told(line, optimal=~first.optimal)
    assert "has another value in state 1" in told(line, fixed_values=second.values)
    assert "value at the start" in told(line, start=((0, F(1)),))
    assert "a pair of state 1 is better from 8 on" in "; ".join(
        replace(
            line,
            pieces=(replace(first, high=(F(8), F(8))), replace(second, low=(F(8), F(8)))),
        ).violations()
    )


def forked(at: dict[str, F], once: int) -> MDP:
    """From state 0 to a state of 3, or by an action that earns `once`, with chance t, to one of 1.

    At t = 0 both actions keep the gain.
    """
    t = at["t"]
    moves = [(1 - t, 1, once), (t, 2, once)] if t else [(1, 1, once)]
    rows = [(0, 0, [(1, 1, 5)]), (0, 1, moves), (1, 0, [(1, 1, 3)]), (2, 0, [(1, 2, 1)])]
    return MDP.from_outcomes(rows)


def test_the_checker_looks_where_a_transition_vanishes() -> None:
    """What an action earns once more, where it keeps the gain at that point alone, is refused."""

    def family(once: int) -> Family:
        parameters = (Parameter(name="t", value="1/2", low=0, high=1),)
        return Family(parameters=parameters, build=lambda at: forked(at, once))

    line = curve(family(4), "t", (0, 1), criterion="average")
    assert line.violations() == []
    assert line.at(0) == 3
    with pytest.raises(ModelError, match="the average may jump"):
        curve(family(6), "t", (0, 1), criterion="average")
    (piece,) = curve(family(6), "t", ("1/9", 1), criterion="average").pieces
    whole = Piece(low=F(0), high=F(1), origin=F(1, 2))
    equations = AverageEquations(family(6), "t", whole)
    assert [*equations.find_faults()] == []
    assert [*equations.find_point_faults(piece.values, F(0), F(1))] == ["t = 0"]
    assert [*equations.find_point_faults(piece.values, F(1, 9), F(1))] == []
    assert "nothing proves the optimum at t = 0, where a transition vanishes" in [
        *piece_violations(
            family(6), "t", [replace(piece, section=whole, low=(F(0), F(0)))], None, 1,
            kind=AverageEquations,
        )
    ]  # fmt: skip


def test_the_classes_of_a_policy_and_what_it_improves_first() -> None:
    """From state 0 a run ends in state 1 or in state 2; state 3 ends in state 2 for sure."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (1, 0, [(1, 1, at["r"])])]
        rows += [(2, 0, [(1, 2, 2)]), (3, 0, [(1, 2, 0)]), (3, 1, [(1, 0, 9)])]
        return MDP.from_outcomes(rows)

    family = Family(parameters={"r": 1}, build=build)
    section = Piece(low=F(0), high=F(4), origin=F(1))
    equations = AverageEquations(family, "r", section)
    policy = [[(pair, to_flint(F(1)))] for pair in (0, 1, 2, 3)]
    label, ends = equations.label_classes(policy)
    assert (label.tolist(), ends.tolist()) == ([-1, 0, 1, -1], [-1, 0, 1, 1])
    values = compute_policy_values(equations, policy)
    numbers = [number(to_flint(F(4))) / values[1](to_flint(F(4))) for number in values[0]]
    # From the states on: h; then gains, of which the last is that of the start.
    assert [from_flint(x) for x in numbers] == [-3, 0, 0, -2, 3, 4, 2, 2, 3]
    assert [*equations.find_policy_faults(policy, values)] == []
    assert [*equations.find_value_faults(values)] == []
    assert equations.weigh_start(-1) == ((8, F(-1)),)
    # By its other pair state 3 gains wherever state 1 earns more than 2, and else loses.
    assert equations.update_gaps(values, {0, 1, 2, 3}) == {4}
    assert equations.of_gain == {4}
    gap = equations.gap[4]
    assert [gap(to_flint(F(r))) > 0 for r in (1, 3)] == [True, False]
    assert [*equations.choose_improvements([3, 4])] == [4]
    assert [*equations.choose_improvements([3])] == [3]
    assert not equations.improper


def test_gaps_and_faults_that_do_not_depend_on_the_parameter() -> None:
    """State 3 leads to gains of 2 or 7, or earns 1 on the way to 2: all by constant gaps."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 0, at["r"])]), (1, 0, [(1, 1, 7)]), (2, 0, [(1, 2, 2)])]
        rows += [(3, 0, [(1, 2, 0)]), (3, 1, [(1, 1, 0)]), (3, 2, [(1, 2, 1)])]
        return MDP.from_outcomes(rows)

    family = Family(parameters={"r": 1}, build=build)
    equations = AverageEquations(family, "r", Piece(low=F(0), high=F(4), origin=F(1)))
    policy = [[(pair, to_flint(F(1)))] for pair in range(4)]
    values = compute_policy_values(equations, policy)
    assert equations.update_gaps(values, {0, 1, 2, 3}) == {4, 5}
    assert equations.of_gain == {4}
    below = values[1](to_flint(F(2)))
    assert [from_flint(equations.gap[k](to_flint(F(2))) / below) for k in (4, 5)] == [-5, -1]
    mixed = [*policy[:3], [(3, to_flint(F(1, 2))), (4, to_flint(F(1, 2)))]]
    numbers, below = compute_policy_values(equations, mixed)
    assert [*equations.find_policy_faults(mixed, (numbers, below))] == []
    # The relative value of state 3, its gain, and both, whose sum then still is right.
    for moved in ({3: 1}, {7: 1}, {3: -1, 7: 1}):
        wrong = [number + moved.get(k, 0) for k, number in enumerate(numbers)]
        assert [*equations.find_policy_faults(mixed, (wrong, below))] == [3]


def test_a_point_where_a_transition_vanishes_is_proven_or_not() -> None:
    """At t = 0 the second action is as good if it earns 5; a constant loss of gain shows there."""
    parameters = (Parameter(name="t", value="1/2", low=0, high=1),)

    def faults(build: Any, pairs: list[int]) -> list[str]:
        family = Family(parameters=parameters, build=build)
        equations = AverageEquations(family, "t", Piece(low=F(0), high=F(1), origin=F(1, 2)))
        values = compute_policy_values(equations, [[(k, to_flint(F(1)))] for k in pairs])
        return [*equations.find_point_faults(values, F(0), F(1))]

    def with_choice(at: dict[str, F]) -> MDP:
        t = at["t"]
        moves = [(1 - t, 1, 0), (t, 2, 0)] if t else [(1, 1, 0)]
        rows = [(0, 0, moves), (0, 1, [(1, 2, 9)])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 3)]), (2, 0, [(1, 2, 4)])])

    def with_better(at: dict[str, F]) -> MDP:
        t = at["t"]
        moves = [(1 - t, 1, 0), (t, 2, 0)] if 0 < t < 1 else [(1, 1 + int(t), 0)]
        rows = [(0, 0, moves), (1, 0, [(1, 1, 3)]), (2, 0, [(1, 2, 4)])]
        return MDP.from_outcomes([*rows, (3, 0, [(1, 1, 0)]), (3, 1, [(1, 2, 0)])])

    def fading(at: dict[str, F]) -> MDP:
        t = at["t"]
        rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 2, 6)]), (1, 0, [(1, 1, 2 - t)])]
        rows += [(2, 0, [(1, 2, 1)]), (3, 0, [((1 + t) / 4, 1, 0), ((3 - t) / 4, 2, 0)])]
        return MDP.from_outcomes(rows)

    assert faults(lambda at: forked(at, 5), [0, 2, 3]) == []
    assert faults(lambda at: forked(at, 6), [0, 2, 3]) == ["t = 0"]
    # Going to 1 or 2 by chance loses 1 - t of the gain of going to 2, and at t = 1 what that earns.
    assert faults(with_choice, [0, 2, 3]) == ["t = 0", "t = 1"]
    assert faults(with_choice, [1, 2, 3]) == []
    # A pair of another state gains 1 everywhere: the gap is a constant below 0.
    assert faults(with_better, [0, 1, 2, 3]) == ["t = 0", "t = 1"]
    assert faults(with_better, [0, 1, 2, 4]) == []
    # At t = 1 the second action keeps the gain and earns 6 more, but no transition vanishes there.
    assert faults(fading, [0, 2, 3, 4]) == []
