"""The proven checker of optima under limits and of fronts, beside the other one."""

import copy
import random
from collections import Counter
from fractions import Fraction as F
from typing import Any

import pytest

from exact_mdp import MDP, ModelError, fingerprint, solve, tradeoff
from exact_mdp.analysis.tradeoffs.front import Front
from exact_mdp.mdp.io import model_json
from exact_mdp.solvers.exact import checker, codec, duals, verified
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.limits import ConstrainedSolution

File = dict[str, Any]


KINDS: dict[str, Any] = {"limits": ConstrainedSolution, "front": Front}


def verdicts(mdp: MDP, content: File) -> tuple[bool, bool]:
    """Whether each of the two checkers accepts what a file has; what it cannot read, it refuses."""
    parts = {key: x for key, x in content.items() if key not in ("format", "version")}
    try:
        proof: Any = codec.decode_record(KINDS[content["kind"]], parts)
        totals = Objectives(mdp, proof.objectives).to_totals()
        known = proof.model == fingerprint(mdp)
        first = known and duals.list_totals_violations(totals, codec.rebuild_proof(proof)) == []
    except (ValueError, TypeError, AttributeError, OverflowError, ModelError):
        first = False
    totals = Objectives(mdp, content["objectives"]).to_totals()
    try:
        model = model_json.encode_model(mdp)
        if content["kind"] == "front":
            second = verified.front_holds(model, content, totals.amounts)
        else:
            second = verified.limits_hold(model, content, totals.names, totals.amounts)
    except verified.Unreadable:
        second = False
    return first, second


def drawn(draw: random.Random) -> MDP:
    """A random model with two components, of three states and an end."""
    rows, parts = list[Any](), {"a": list[Any](), "b": list[Any]()}
    discount: Any = draw.choice([1, "1/2", "9/10"])
    for s in range(3):
        for a in range(draw.randint(1, 3)):
            after = [draw.randrange(s + 1, 4), draw.randrange(4)]
            weights = [draw.randint(1, 4), draw.randint(1, 3)]
            reward = F(draw.randint(-3, 5), draw.choice([1, 2, 3]))
            law = zip(weights, after, strict=True)
            rows.append((s, a, [(F(w, sum(weights)), t, reward) for w, t in law]))
            for part in parts.values():
                part.append(F(draw.randint(-2, 4), draw.choice([1, 1, 2])))
    rows.append((3, 0, [(1, 3, 0)]))
    start = {0: F(1, 2), 1: F(1, 2)} if draw.random() < 0.5 else None
    mdp = MDP.from_outcomes(rows, discount, sense=draw.choice(["max", "min"]), start=start)
    return mdp.with_(components={name: [*part, 0] for name, part in parts.items()})


def proofs(draw: random.Random, count: int) -> list[tuple[MDP, File]]:
    found = list[tuple[MDP, File]]()
    while len(found) < count:
        mdp = drawn(draw)
        limits = {name: f"{draw.choice(['>=', '<='])} {draw.randint(-2, 6)}/2"
                  for name in draw.sample(["a", "b"], draw.choice([1, 2]))}  # fmt: skip
        found.append((mdp, codec.build_file_content(solve(mdp, subject_to=limits))))
    return found


def number(given: str, draw: random.Random) -> str:
    """Another number than a text, by a little or by much."""
    top, _, below = given.partition("/")
    step = draw.choice([-1, 1, 2, -int(top, 16), 16])
    return f"{hex(int(top, 16) + step)}/{below}" if below else hex(int(top, 16) + step)


def altered(content: File, draw: random.Random) -> File:
    """A proof with one number changed, or one part."""
    other = copy.deepcopy(content)
    key = draw.choice(["rank", "limits", "feasible", "flow", "flow", "price", "dual", "shift"])
    if key == "rank" and other[key]:
        other[key][draw.randrange(4)] += draw.choice([-1, 1])
    elif key == "limits":
        limit = draw.choice(other[key])
        part = draw.choice(["sign", "bound", "bound"])
        limit[part] = hex(-int(limit[part], 16)) if part == "sign" else number(limit[part], draw)
    elif key == "feasible":
        other[key] = not other[key]
    elif key in ("flow", "dual"):
        level = other[key]["visits"] if key == "flow" else other[key]
        part = draw.choice(["top", "top", "below"])
        place = draw.randrange(len(level[part]))
        level[part][place] = number(level[part][place], draw)
    elif key == "price":
        place = draw.randrange(len(other[key]))
        other[key][place] = number(other[key][place], draw)
    elif key == "shift":
        other[key] = number(other[key], draw)
    return other


def test_both_checkers_say_the_same_of_whole_and_altered_proofs() -> None:
    draw = random.Random(0)
    found = Counter[tuple[bool, bool, bool]]()
    for mdp, content in proofs(draw, 25):
        assert verdicts(mdp, content) == (True, True)
        for _ in range(12):
            found[content["feasible"], *verdicts(mdp, altered(content, draw))] += 1
    assert not any(first != second for _, first, second in found)
    for feasible in (True, False):
        assert found[feasible, False, False] >= 30
    assert found[True, True, True] + found[False, True, True] >= 10


def test_a_policy_may_not_end_beside_a_goal() -> None:
    """Totals of runs that miss the goal are not finite: both refuse, where such an end is met."""
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [("1/2", 1, 2), ("1/2", 2, 2)]), (1, 0, [(1, 1, 0)]),
            (2, 0, [(1, 2, 0)])]  # fmt: skip
    plain = MDP.from_outcomes(rows, components={"a": [1, 1, 0, 0]})
    content = codec.build_file_content(solve(plain, subject_to={"a": ">= 1"}))
    assert verdicts(plain, content) == (True, True)
    goal = plain.with_(labels={"goal": [s == 1 for s in range(3)]}).until("goal")
    totals = Objectives(plain, content["objectives"]).to_totals()
    model = model_json.encode_model(goal)
    other = content | {"model": fingerprint(goal)}
    assert not verified.limits_hold(model, other, totals.names, totals.amounts)
    wide = duals.Totals(checker.Model(model), totals.names, totals.amounts)
    parts = {key: x for key, x in other.items() if key not in ("format", "version")}
    proof = codec.decode_record(ConstrainedSolution, parts)
    assert duals.list_totals_violations(wide, proof) == [
        "a run may end outside the goal, and its totals are not finite"
    ]


def test_what_is_not_a_proof_of_limits_is_refused() -> None:
    mdp = drawn(random.Random(1))
    content = codec.build_file_content(solve(mdp, subject_to={"a": ">= -9"}))
    totals = Objectives(mdp, content["objectives"]).to_totals()
    given = model_json.encode_model(mdp), totals.names, totals.amounts
    assert verified.limits_hold(given[0], content, *given[1:])
    assert not verified.limits_hold(given[0], content | {"model": "0"}, *given[1:])
    swapped = [totals.amounts[1], totals.amounts[0]]
    assert not verified.limits_hold(given[0], content, totals.names, swapped)
    for change in (
        {"kind": "front"}, {"version": 2.0}, {"more": 1}, {"limits": None}, {"price": []},
        {"limits": [{"name": "z", "sign": 1, "bound": 0}]}, {"feasible": 1}, {"rank": [0]},
        {"limits": [{"name": "a", "sign": 2, "bound": 0}]}, {"flow": []}, {"dual": None},
        {"flow": content["flow"] | {"pairs": [99] * len(content["flow"]["pairs"])}},
    ):  # fmt: skip
        with pytest.raises(verified.Unreadable):
            verified.limits_hold(given[0], content | change, *given[1:])
    with pytest.raises(verified.Unreadable, match="ask exact-mdp verify --proven"):
        verified.holds(given[0], content)


# ---- fronts --------------------------------------------------------------------------------------


def altered_front(content: File, draw: random.Random) -> File:
    """A front with one number changed, or one part left out."""
    other = copy.deepcopy(content)
    corner, vertex = draw.choice(other["corners"]), draw.choice(other["attained"])
    key = draw.choice(["dual", "weights", "best", "pairs", "values", "total", "drop", "rank"])
    if key == "weights":
        step = F(draw.choice([-1, 1]), draw.choice([2, 7, 10**9]))
        top, below = (int(part, 16) for part in corner["weights"][0].split("/"))
        share = F(top, below) + step
        each = (share, 1 - share if draw.random() < 0.8 else F(1, 3))
        corner["weights"] = [f"{hex(x.numerator)}/{hex(x.denominator)}" for x in each]
    elif key == "best":
        corner[key] = draw.choice([[], ["0x0"], [*corner[key], "0x0"]])
    elif key == "pairs":
        vertex[key][draw.randrange(4)] += draw.choice([-1, 1])
    elif key == "total":
        place = draw.randrange(2)
        vertex[key][place] = number(vertex[key][place], draw)
    elif key == "drop":
        part = other[draw.choice(["corners", "attained"])]
        part.pop(draw.randrange(len(part)))
    elif key == "rank" and other[key]:
        other[key][draw.randrange(4)] += draw.choice([-1, 1])
    elif key in ("dual", "values"):
        level = corner[key] if key == "dual" else draw.choice(vertex[key])
        part = draw.choice(["top", "top", "below"])
        place = draw.randrange(len(level[part]))
        level[part][place] = number(level[part][place], draw)
    return other


def test_both_checkers_say_the_same_of_whole_and_altered_fronts() -> None:
    draw = random.Random(2)
    found = Counter[tuple[bool, bool]]()
    for _ in range(20):
        mdp = drawn(draw)
        content = codec.build_file_content(tradeoff(mdp, ["a", "b"]))
        assert verdicts(mdp, content) == (True, True)
        for _ in range(12):
            found[verdicts(mdp, altered_front(content, draw))] += 1
    assert found[True, False] == found[False, True] == 0
    assert min(found[True, True], found[False, False]) >= 5


def test_what_is_not_a_front_is_refused() -> None:
    mdp = drawn(random.Random(3))
    content = codec.build_file_content(tradeoff(mdp, ["a", "b"]))
    amounts = Objectives(mdp, content["objectives"]).to_totals().amounts
    model = model_json.encode_model(mdp)
    assert verified.front_holds(model, content, amounts)
    assert not verified.front_holds(model, content | {"model": "0"}, amounts)
    assert not verified.front_holds(model, content, amounts[::-1])
    assert not verified.front_holds(model, content | {"corners": []}, amounts)
    assert not verified.front_holds(model, content | {"attained": [], "corners": []}, amounts)
    for change in (
        {"kind": "limits"}, {"version": 2.0}, {"more": 1}, {"attained": None}, {"corners": {}},
        {"rank": [0]}, {"attained": [{}]}, {"corners": [{}]},
        {"corners": [content["corners"][0] | {"weights": [1]}]},
        {"attained": [content["attained"][0] | {"pairs": [99] * 4}]},
        {"attained": [content["attained"][0] | {"total": []}]},
    ):  # fmt: skip
        with pytest.raises(verified.Unreadable):
            verified.front_holds(model, content | change, amounts)
    with pytest.raises(verified.Unreadable, match="fronts of two objectives"):
        verified.front_holds(model, content, [*amounts, amounts[0]])
