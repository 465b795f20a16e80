"""Checks a certificate against a model, with Python's standard library alone.

    python verified.py model.json certificate.json

Exit status 0: it holds, 1: it does not, 2: a file is not of the format, or is of a kind that
this program does not cover: it covers totals, averages, bounds and regrets, and with the package,
which knows the amounts counted, limits and fronts of two objectives.

That what `check`, `check_regret`, `check_limits` and `check_front` accept holds is a theorem, one
for each, proven in Coq without an axiom. They speak of every policy, which may draw its actions and
depend on all that came before. Of a total, no policy earns more in the limit of many steps than is
claimed, and that of the certificate earns it; bounds lie on both sides; of an average, no policy
earns more per step; values under a goal mean what the format says. Of a regret, this holds of the
optimum, the policy earns exactly its value, and the regret is the difference. Under limits, no
policy that keeps them earns more; beyond a front there is no policy. If a total that is proven by
its values is said to be unique, then every optimal policy takes the same actions wherever it comes,
unless the discount is 0. The statements are Claims.v, RegretClaims.v, LimitsClaims.v and
FrontsClaims.v in proof/theories/ of the project, with the definitions in Spec.v.

What has to be believed besides: Coq; that it extracts the program rightly, and that a short one
makes Python of it; and that the model file is the model meant. What follows "reading" is not
proven. It reads the files, refuses what the format does not allow, compares the hash, and finds
hints, such as the states that are ends. The program tests all hints, so that a wrong one can only
refuse. That right certificates are accepted is tested, not proven.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable, Sequence
from decimal import Decimal
from fractions import Fraction
from functools import reduce
from hashlib import sha256
from itertools import pairwise
from math import gcd, lcm
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

# the proven program: to_python.py writes it here
# ruff: noqa: F401, TID251
from exact_mdp.solvers.exact.verified import (
    Bounds,
    Certificate,
    Claim,
    Corner,
    Expansion,
    Extended,
    Finite,
    Front,
    Hints,
    Level,
    Limit,
    Limited,
    MinusInfinity,
    Model,
    Outcome,
    Pair,
    PlusInfinity,
    Q,
    Ratio,
    Reaching,
    Values,
    Verdict,
    Vertex,
    arrives,
    check,
    check_front,
    check_limits,
    check_regret,
    drawn_model,
    earned,
    is_one,
    optimal,
    reward_sum,
    stays,
)

# end of the proven program

T = TypeVar("T")


def grouped(terms: list[tuple[int, T]]) -> Callable[[int], list[T]]:
    """Return the terms of each state, in their order."""
    found: dict[int, list[T]] = {}
    for state, term in terms:
        found.setdefault(state, []).append(term)
    return lambda state: found.get(state, [])


def divided(a: int, b: int) -> int:
    """Return the quotient of integers, rounded down; 0 for a divisor of 0, as in Coq."""
    return a // b if b else 0


# ---- reading, without proof ----------------------------------------------------------------------

DIGITS = "(?:0x[0-9a-f]{1,100000}|[0-9]{1,4300})"  # more would take too long
NUMBER = re.compile(f"(-?{DIGITS})(?:/({DIGITS}))?")
PARTS = {"state", "action", "denominator", "next", "weight", "reward"}
HEAD = {"format", "version", "kind", "model", "sense", "policy", "rank"}
KEYS = {
    "total": HEAD | {"g", "h", "w", "infinite", "order", "start_value", "unique"},
    "average": HEAD | {"g", "h", "w", "infinite", "order", "start_value", "unique"},
    "bounds": HEAD | {"low", "high"},
    "regret": HEAD - {"rank"} | {"optimum", "value", "regret"},
}
INNER = KEYS["total"] - {"format", "version"}
LIMITED = {"format", "version", "kind", "model", "objectives", "rank", "limits", "feasible",
           "flow", "price", "dual", "shift"}  # fmt: skip
FRONT = {"format", "version", "kind", "model", "objectives", "rank", "attained", "corners"}


class Unreadable(ValueError):
    """What is no model, or no certificate."""


def needed(condition: object, what: str) -> None:
    """Raise Unreadable unless a condition holds."""
    if not condition:
        raise Unreadable(what)


def fraction(given: object, where: str) -> Fraction:
    """Read an integer, or a text such as "-7", "0x1f" or "1/3"."""
    text = hex(given) if type(given) is int else given
    match = NUMBER.fullmatch(text) if isinstance(text, str) else None
    needed(match, f"{where}: not a number")
    assert match
    try:
        return Fraction(int(match[1], 0), int(match[2] or "1", 0))
    except (ValueError, ZeroDivisionError) as error:  # 007, 1/0
        raise Unreadable(f"{where}: not a number; long ones are in hexadecimal") from error


def integer(given: object, where: str) -> int:
    """Read an integer."""
    number = fraction(given, where)
    needed(number.denominator == 1, f"{where}: not an integer")
    return number.numerator


def integers(given: object, where: str, length: int | None = None) -> list[int]:
    """Read a list of integers, of a length if one is given."""
    if not isinstance(given, list) or length not in (None, len(given)):
        raise Unreadable(f"{where}: not a list, or not of this length")
    return [integer(each, where) for each in given]


def content_of(given: object, what: str) -> dict[str, Any]:
    """Return an object that says it is of a kind, and of version 2."""
    if not isinstance(given, dict):
        raise Unreadable(f"not a {what}")
    head = given.get("format"), given.get("version")
    needed(head == (f"exact-mdp {what}", 2) and type(head[1]) is int, f"not a {what} of version 2")
    return given


def with_keys(given: object, keys: Iterable[str], where: str) -> dict[str, Any]:
    """Return an object, which has these keys and no others."""
    if not isinstance(given, dict) or given.keys() != {*keys}:
        raise Unreadable(f"{where}: a key is missing, or there is one too many")
    return given


def pair_of(given: object, states: int) -> Pair:
    """Read a pair."""
    own = with_keys(given, PARTS, "a pair")
    state, action, below = (integer(own[key], key) for key in ("state", "action", "denominator"))
    where = f"state {state}, action {action}"
    after, weight = integers(own["next"], where), integers(own["weight"], where)
    each = own["reward"] if isinstance(own["reward"], list) else [own["reward"]] * len(after)
    rewards = [fraction(x, where) for x in each]
    needed(len(after) == len(weight) == len(rewards) > 0, f"{where}: not one of each next state")
    needed(min(weight) > 0 and sum(weight) == below, f"{where}: the weights")
    needed(0 <= min(after) <= max(after) < states, f"{where}: a next state is not a state")
    rows = zip(after, weight, rewards, strict=True)
    return Pair(state, action, below, [Outcome(t, w, Q(*x.as_integer_ratio())) for t, w, x in rows])


def model_of(given: object) -> tuple[Model, str]:
    """Read a model; return the first line of what its hash is made of, too."""
    own = content_of(given, "model")
    for key in ("states", "discount", "sense", "start", "pairs"):
        needed(key in own, f"the model: {key} is missing")
    sense, missing = own["sense"], own.get("unreached", "inf")
    needed(sense in ("max", "min"), "sense is neither max nor min")
    needed(missing in ("inf", "-inf"), "unreached is neither inf nor -inf")
    states, discount = integer(own["states"], "states"), fraction(own["discount"], "discount")
    needed(0 <= discount <= 1, "the discount is not from 0 to 1")
    listed = own["pairs"] if isinstance(own["pairs"], list) else []
    needed(states <= len(listed), "pairs: not a list with a pair of each state")
    pairs = sorted((pair_of(each, states) for each in listed), key=lambda pair: pair[:2])
    names = [pair[:2] for pair in pairs]
    needed(len({*names}) == len(names), "two pairs have the same state and action")
    needed({s for s, _ in names} == {*range(states)}, "the states of pairs are not 0, 1, …")
    begin = own["start"] if isinstance(own["start"], dict) else {}
    start = [(integer(s, "start"), fraction(share, "start")) for s, share in begin.items()]
    shares = [share for _, share in start if share]
    fits = {s for s, share in start if share} <= {*range(states)} and sum(shares) == 1
    needed(fits and min(shares) > 0, "start: not a distribution of states")
    goal = None
    if own.get("goal") is not None:
        goal = {*integers(own["goal"], "goal")}
        moving = {pair.state for pair in pairs if not stays(pair)}
        needed(discount == 1 and goal <= {*range(states)} - moving, "the goal is not made of ends")
    live = sorted((s, share) for s, share in start if share)
    model = Model(
        states, Q(*discount.as_integer_ratio()), sense == "max",
        [(s, Q(*share.as_integer_ratio())) for s, share in live], pairs,
        None if goal is None else goal.__contains__, (missing == "-inf") is (sense == "max"),
    )  # fmt: skip
    aim = "" if goal is None else f" {missing} {sorted(goal)}"
    return model, f"exact-mdp model 2 {sense}{aim}"


def digest(m: Model, first: str) -> str:
    """Return the SHA-256 of all that counts: a first line, and integers in hexadecimal."""
    rows, rewards = list[tuple[int, list[tuple[int, int]]]](), list[Fraction]()
    for pair in m.pairs:
        total = dict.fromkeys(sorted(outcome.next for outcome in pair.outcomes), 0)
        for outcome in pair.outcomes:
            total[outcome.next] += outcome.weight
        shared = gcd(pair.denominator, *total.values())
        rows.append((pair.denominator // shared, [(s, w // shared) for s, w in total.items()]))
        top, below = reward_sum(pair)
        rewards.append(Fraction(top, below * pair.denominator))
    lines: list[Iterable[int]] = [
        [m.states, *m.discount],
        [n for s, (top, below) in m.start for n in (s, top, below)],
        [pair.state for pair in m.pairs],
        [pair.action for pair in m.pairs],
        [reward.numerator for reward in rewards],
        [reward.denominator for reward in rewards],
        [below for below, _ in rows],
        [len(row) for _, row in rows],
        [s for _, row in rows for s, _ in row],
        [w for _, row in rows for _, w in row],
    ]
    text = "\n".join([first, *(" ".join(map(hex, line)) for line in lines)])
    return sha256(text.encode()).hexdigest()


def level_of(given: object, where: str, states: int) -> Level:
    """Read a level."""
    own = with_keys(given, ("top", "below", "group"), where)
    top, below = integers(own["top"], where, states), integers(own["below"], where)
    group = integers(own["group"], where, states)
    fits = {*group} == {*range(len(below))} and min(below, default=1) > 0
    needed(fits, f"{where}: denominators that are not positive, or not those of the groups")
    return [(x, below[k]) for x, k in zip(top, group, strict=True)].__getitem__


def extended(given: object, where: str) -> Extended:
    """Read a number, or an infinite one."""
    if given in ("inf", "-inf"):
        return PlusInfinity() if given == "inf" else MinusInfinity()
    return Finite(Q(*fraction(given, where).as_integer_ratio()))


def certificate_of(own: dict[str, Any], m: Model) -> Certificate | None:
    """Read a certificate; return None where its parts prove nothing of its kind."""
    some = {key: x for key, x in own.items() if x is not None}
    policy = integers(own["policy"], "policy", m.states)
    rank, order, infinite = (
        integers(some[key], key, m.states) if key in some else None
        for key in ("rank", "order", "infinite")
    )
    needed(min([*(rank or []), *(order or [])], default=0) >= 0, "a rank is negative")
    levels = {
        key: level_of(some[key], key, m.states)
        for key in ("g", "h", "w", "low", "high") if key in some
    }  # fmt: skip
    ranks = None if rank is None else rank.__getitem__
    value = extended(own.get("start_value", 0), "start_value")
    kind, parts = own["kind"], [*levels]
    claim: Claim
    if order is not None or infinite is not None:
        if kind != "total" or parts != ["h"] or None in (rank, order, infinite):
            return None
        assert ranks
        assert order is not None
        assert infinite is not None
        claim = Reaching(levels["h"], ranks, order.__getitem__, infinite.__getitem__)
    elif (kind, parts) == ("bounds", ["low", "high"]):
        claim = Bounds(levels["low"], levels["high"], ranks)
    elif (kind, parts) == ("total", ["h"]):
        claim = Values(levels["h"], ranks)
    elif parts == ["g", "h", "w"] and rank is None:
        claim = Expansion(kind == "average", levels["g"], levels["h"], levels["w"])
    else:
        return None
    unique = own.get("unique", False)
    return Certificate(policy.__getitem__, claim, value, unique) if type(unique) is bool else None


def verdict_of(own: dict[str, Any], m: Model) -> Verdict | None:
    """Read a verdict on a policy; return None where a part proves nothing of its kind."""
    inner = [with_keys(own[key], INNER, key) for key in ("optimum", "value")]
    policy = with_keys(own["policy"], ("pairs", "weights"), "policy")
    listed = integers(policy["pairs"], "policy")
    weight = level_of(policy["weights"], "weights", len(listed))
    needed(listed == sorted({*listed}), "policy: pairs that are not in their order")
    shares, whole = [Q(0, 1)] * len(m.pairs), [Fraction(0)] * m.states
    for number, place in enumerate(listed):
        needed(0 <= place < len(shares) and weight(number)[0] > 0, "no pair, or no weight above 0")
        shares[place] = Q(*weight(number))
        whole[m.pairs[place].state] += Fraction(*weight(number))
    needed({*whole} == {1}, "policy: weights that do not sum to 1 in a state")
    places = {pair[:2]: k for k, pair in enumerate(m.pairs)}
    optimum, value = (certificate_of(each, m) for each in inner)
    lost = extended(own["regret"], "regret")
    if optimum is None or value is None:
        return None
    return Verdict(optimum, counted_by(places, shares), value, lost)


# ---- hints ---------------------------------------------------------------------------------------


def hints_of(m: Model, c: Certificate) -> Hints:
    """Return the hints that `check` tests: ends, states that are reached, ways."""
    own: list[list[Pair]] = [[] for _ in range(m.states)]
    for pair in m.pairs:
        own[pair.state].append(pair)
    ends = [all(map(stays, pairs)) for pairs in own]
    out, along = [0] * m.states, [c.actions(s) for s in range(m.states)]
    if isinstance(c.claims, Reaching):
        rank, infinite = c.claims.rank, c.claims.infinite
        for s, pairs in enumerate(own):
            out[s] = next((p.action for p in pairs if arrives(rank, infinite, p)), 0)
    reached, toward, ways = [False] * m.states, [-1] * m.states, dict[int, tuple[int, int]]()
    target = first = second = leaving = 0
    waiting = [] if isinstance(c.claims, Bounds) else [s for s, _ in m.start]
    for s in waiting:
        reached[s] = True
    for s in waiting:
        best = [pair for pair in own[s] if optimal(m, c.claims, pair)]
        if len(best) > 1 and not ends[s]:
            target, first, second = s, best[0].action, best[1].action
            leaving, steps = next(p.action for p in own[s] if not stays(p)), 0
            toward[s] = 0
            while s in ways:
                s, action = ways[s]
                steps += 1
                toward[s], along[s] = steps, action
            break
        for pair in best:
            for t in {outcome.next for outcome in pair.outcomes if not reached[outcome.next]}:
                reached[t], ways[t] = True, (s, pair.action)
                waiting.append(t)
    return Hints(
        ends.__getitem__, reached.__getitem__, out.__getitem__, toward.__getitem__,
        along.__getitem__, target, first, second, leaving,
    )  # fmt: skip


# ---- several totals ------------------------------------------------------------------------------


def limits_hold(
    model: object, certificate: object, names: Sequence[str], amounts: Sequence[Sequence[Fraction]]
) -> bool:
    """Return whether a proof of an optimum under limits holds; raises Unreadable for bad content.

    What a file counts is a text such as "2*a-b": `names` are those of its objectives, of which the
    first is the reward, and `amounts` what the pairs earn of each, more being better.
    """
    own = with_keys(content_of(certificate, "certificate"), LIMITED, "the certificate")
    needed(own["kind"] == "limits", "not a proof of an optimum under limits")
    m, first = model_of(model)
    needed(type(own["feasible"]) is bool, "feasible is neither true nor false")
    c = limited_of(own, m, names, amounts)
    rewards = [Fraction(*earned(m, pair)) for pair in m.pairs]
    if own["model"] != digest(m, first) or [*amounts[0]] != rewards:
        return False
    return check_limits(m, c, hints_of_totals(m, amounts))


def hints_of_totals(m: Model, amounts: Sequence[Sequence[Fraction]]) -> Hints:
    """Return states in which nothing is earned any more, those that are reached, and actions."""
    pairs: list[list[Pair]] = [[] for _ in range(m.states)]
    for pair in m.pairs:
        pairs[pair.state].append(pair)
    moving = {pair.state for pair in m.pairs if any(o.next != pair.state for o in pair.outcomes)}
    earning = {p.state for each in amounts for p, x in zip(m.pairs, each, strict=True) if x}
    ends = [s not in moving | earning for s in range(m.states)]
    waiting = [s for s, _ in m.start]
    reached = {*waiting}
    for s in waiting:
        after = {outcome.next for pair in pairs[s] for outcome in pair.outcomes} - reached
        reached |= after
        waiting += after
    first = [each[0].action for each in pairs].__getitem__
    return Hints(ends.__getitem__, reached.__contains__, first, first, first, 0, 0, 0, 0)


def limited_of(
    own: dict[str, Any], m: Model, names: Sequence[str], amounts: Sequence[Sequence[Fraction]]
) -> Limited:
    """Read an optimum under limits: at most is at least of the negatives."""
    places, sign = {pair[:2]: k for k, pair in enumerate(m.pairs)}, 1 if m.maximise else -1
    needed(isinstance(own["limits"], list) and isinstance(own["price"], list), "limits, price")
    needed(len(own["limits"]) == len(own["price"]), "not one price for each limit")
    limits = list[Limit]()
    for given_limit, price in zip(own["limits"], own["price"], strict=True):
        each = with_keys(given_limit, ("name", "sign", "bound"), "a limit")
        side, bound = integer(each["sign"], "a limit"), fraction(each["bound"], "a limit")
        needed(each["name"] in names[1:], "what is limited is not counted")
        needed(side in (1, -1), "a limit is neither >= nor <=")
        column = amounts[[*names].index(each["name"])]
        counts = [Q(*(side * sign * x).as_integer_ratio()) for x in column]
        worth = Q(*fraction(price, "price").as_integer_ratio())
        limits.append(
            Limit(counted_by(places, counts), Q(*(side * bound).as_integer_ratio()), worth)
        )
    flow = with_keys(own["flow"], ("pairs", "visits"), "flow")
    listed = integers(flow["pairs"], "flow")
    visits = level_of(flow["visits"], "visits", len(listed))
    often = [(0, 1)] * len(m.pairs)
    for number, place in enumerate(listed):
        needed(0 <= place < len(often) and not often[place][0], "a pair is none, or twice")
        often[place] = visits(number)
        needed(often[place][0] > 0, "visits are not above 0")
    rank = None if own["rank"] is None else integers(own["rank"], "rank", m.states)
    needed(min(rank or [], default=0) >= 0, "a rank is negative")
    dual, shift = level_of(own["dual"], "dual", m.states), fraction(own["shift"], "shift")
    ranks = rank.__getitem__ if rank and is_one(m.discount) else None
    return Limited(
        limits, own["feasible"], lambda s, a: often[places[s, a]], dual,
        Q(*shift.as_integer_ratio()), ranks,
    )  # fmt: skip


def front_holds(model: object, certificate: object, amounts: Sequence[Sequence[Fraction]]) -> bool:
    """Return whether a front of two objectives holds; raises Unreadable for bad content.

    `amounts` are what the pairs earn of each objective, more being better.
    """
    own = with_keys(content_of(certificate, "certificate"), FRONT, "the certificate")
    needed(own["kind"] == "front", "not a front")
    needed(len(amounts) == 2, "the proof covers fronts of two objectives")
    m, first_line = model_of(model)
    listed = [vertex_of(each, m) for each in objects(own["attained"], "attained")]
    vertices = [vertex for vertex in listed if vertex]
    totals = [[Fraction(*x) for x in (v.first_total, v.second_total)] for v in vertices]
    corners, shares = list[Corner](), [list[Fraction]() for _ in vertices]
    for each in objects(own["corners"], "corners"):
        part = with_keys(each, ("weights", "dual", "best"), "a corner")
        weights = [fraction(x, "weights") for x in objects(part["weights"], "weights")]
        needed(len(weights) == 2, "not one weight for each objective")
        dual = level_of(part["dual"], "dual", m.states)
        corners.append(Corner(Q(*weights[0].as_integer_ratio()), dual))
        worth = [weights[0] * a + weights[1] * b for a, b in totals]
        best = [k for k, x in enumerate(worth) if x == max(worth)]
        if sum(weights) != 1 or integers(part["best"], "best") != best:
            return False
        for k in best:
            shares[k].append(weights[0])
    several = all(own_shares and min(own_shares) < max(own_shares) for own_shares in shares)
    alike = len({tuple(total) for total in totals}) < len(totals)
    same = own["model"] == digest(m, first_line)
    if not same or len(vertices) < len(listed) or alike or not several:
        return False
    rank = None if own["rank"] is None else integers(own["rank"], "rank", m.states)
    needed(min(rank or [], default=0) >= 0, "a rank is negative")
    places = {pair[:2]: k for k, pair in enumerate(m.pairs)}
    first, second = ([Q(*x.as_integer_ratio()) for x in column] for column in amounts)
    front = Front(
        counted_by(places, first), counted_by(places, second), vertices,
        sorted(corners, key=lambda corner: Fraction(*corner.share)),
        rank.__getitem__ if rank and is_one(m.discount) else None,
    )  # fmt: skip
    return check_front(m, front, hints_of_totals(m, amounts))


def vertex_of(given_vertex: object, m: Model) -> Vertex | None:
    """Read a vertex; return None where its pairs are not one of each state."""
    own = with_keys(given_vertex, ("pairs", "values", "total"), "a vertex")
    pairs = integers(own["pairs"], "a vertex")
    needed(all(0 <= pair < len(m.pairs) for pair in pairs), "a pair is none of the model")
    values = [level_of(x, "values", m.states) for x in objects(own["values"], "values")]
    total = [fraction(x, "total") for x in objects(own["total"], "total")]
    needed(len(values) == len(total) == 2, "not one total for each objective")
    if [m.pairs[pair].state for pair in pairs] != [*range(m.states)]:
        return None
    actions = [m.pairs[pair].action for pair in pairs].__getitem__
    first, second = (Q(*x.as_integer_ratio()) for x in total)
    return Vertex(actions, values[0], values[1], first, second)


def objects(given: object, where: str) -> list[Any]:
    """Return a list."""
    if not isinstance(given, list):
        raise Unreadable(f"{where}: not a list")
    return given


def counted_by(places: dict[tuple[int, int], int], numbers: Sequence[Q]) -> Callable[[int, int], Q]:
    """Return numbers of pairs as a function of state and action."""
    return lambda state, action: numbers[places[state, action]]


# ---- files ---------------------------------------------------------------------------------------


def holds(model: object, certificate: object) -> bool:
    """Return whether the claims of one file hold for another; raises Unreadable for bad content."""
    own = content_of(certificate, "certificate")
    kind = own.get("kind")
    if kind in ("front", "limits"):
        raise Unreadable("what is counted is not in the files: ask exact-mdp verify --proven")
    if not isinstance(kind, str) or kind not in KEYS:
        raise Unreadable(f"the proof covers {', '.join(KEYS)}, not {str(kind)[:40]!r}")
    with_keys(own, KEYS[kind], "the certificate")
    m, first = model_of(model)
    if [own["model"], own["sense"]] != [digest(m, first), "max" if m.maximise else "min"]:
        return False
    if kind == "regret":
        return verdict_holds(own, m, first)
    c = certificate_of(own, m)
    return c is not None and check(m, c, hints_of(m, c))


def verdict_holds(own: dict[str, Any], m: Model, first: str) -> bool:
    """Return whether a verdict holds of a model; `first` is the first line of what is hashed."""
    v = verdict_of(own, m)
    if v is None:
        return False
    alone = drawn_model(m, v)
    heads = [[own[key]["model"], own[key]["sense"]] for key in ("optimum", "value")]
    if heads != [[own["model"], own["sense"]], [digest(alone, first), own["sense"]]]:
        return False
    return check_regret(m, v, hints_of(m, v.optimum), hints_of(alone, v.own))


def describe(own: dict[str, Any]) -> str:
    """Return in a sentence what a verdict that holds shows, ten digits of each number."""
    said = list[str]()
    for x in (own["value"]["start_value"], own["optimum"]["start_value"], own["regret"]):
        if x in ("inf", "-inf"):
            said.append(x)
        else:
            number = fraction(x, "")
            said.append(f"{Decimal(number.numerator) / number.denominator:.10g}")
    worth, best, lost = said
    return f": the policy earns {worth} at the start, the best {best}; regret {lost}"


def once(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of a JSON file; raises Unreadable for a key that is written twice."""
    needed(len(dict(pairs)) == len(pairs), "a key is written twice")
    return dict(pairs)


def read(path: str) -> Any:
    """Return the content of a JSON file."""
    try:
        return json.loads(Path(path).read_text("utf-8-sig"), object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise Unreadable(f"{path}: {error}") from error


def main(words: Sequence[str]) -> int:
    """Check a certificate file against a model file."""
    try:
        needed(len(words) == 2, "give two files: model.json certificate.json")
        right = holds(read(words[0]), certificate := read(words[1]))
    except (ValueError, OSError) as error:
        print(f"not checked: {error}", file=sys.stderr)
        return 2
    if not right:
        print("does not hold")
        return 1
    print("holds" + (describe(certificate) if certificate["kind"] == "regret" else ""))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
