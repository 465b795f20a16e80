"""Checks a certificate against a model in integers, with Python's standard library alone.

    python checker.py model.json certificate.json    exit status 0: it holds, 1: it does not, 2: bad

With d(x) = Σ p(s') x(s') - x(s), for rewards that are maximised, all pairs have d(g) ≤ 0; where
that is 0, r - g + d(h) ≤ 0; where that is 0, too, d(w) - h ≤ 0; and those of the policy all three
as equations: g is the greatest average reward per step, h the greatest bias (Puterman, Markov
Decision Processes, 1994, sections 9.1 and 10.2). Discounted values tend to g / (1 - γ) + h: the
total reward, their limit, is +∞ where g > 0, -∞ where g < 0, else h. Below discount 1, and where a
rank that each pair may lower shows that runs end, V = max r + γ P V alone will do, as h. Goals: see
`reaching`. Files: docs/reference/certificates.md.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from decimal import Decimal
from fractions import Fraction
from functools import partial
from hashlib import sha256
from itertools import chain, islice
from math import gcd, inf, lcm
from operator import mul
from pathlib import Path
from typing import Any

DIGITS = "(?:0x[0-9a-f]{1,100000}|[0-9]{1,4300})"  # more would take too long
NUMBER = re.compile(f"(-?{DIGITS})(/({DIGITS}))?")
INFINITE, MODEL = ("inf", "-inf"), ("states", "discount", "sense", "start", "pairs")
PAIR = ("state", "action", "denominator", "next", "weight", "reward")
LEVELS, RANKS = ("g", "h", "w", "low", "high"), ("rank", "order", "infinite")
HEAD = {"format", "version", "kind", "model", "sense", "policy", "rank"}
OPTIMUM = HEAD | {"g", "h", "w", "infinite", "order", "start_value", "unique"}
INNER, VERDICT = OPTIMUM - {"format", "version"}, HEAD - {"rank"} | {"optimum", "value", "regret"}
KEYS = {"total": OPTIMUM, "average": OPTIMUM, "bounds": HEAD | {"low", "high"}, "regret": VERDICT}


class Unreadable(ValueError):
    """What is no model, or no certificate."""


def ensure(condition: object, what: str) -> None:
    """Raise Unreadable unless a condition holds."""
    if not condition:
        raise Unreadable(what)


def ratio(given: object, what: str, infinite: Container[object] = ()) -> Any:
    """Read an integer, a text such as "-7", "0x1f" or "1/3", or one that may be infinite."""
    if given in infinite:
        return float(str(given))
    text = hex(given) if type(given) is int else given
    match = NUMBER.fullmatch(text) if type(text) is str else None
    try:
        return Fraction(int(match[1], 0), int(match[3] or "1", 0)) if match else Fraction("")
    except (ValueError, ZeroDivisionError) as error:  # 007, 1/0
        raise Unreadable(f"{what}: {str(given)[:40]!r} is no number; long ones as 0x…") from error


def integers(given: Any, what: str, length: int | None = None) -> list[int]:
    """Read a list of integers, of a length if one is given."""
    ensure(type(given) is list and length in (None, len(given)), f"{what}: no list, or its length")
    read = given if {*map(type, given)} <= {int} else [ratio(each, what) for each in given]
    ensure(read is given or {x.denominator for x in read} <= {1}, f"{what}: not all are integers")
    return [*map(int, read)]


def check_head(given: Any, kind: str) -> None:
    """Raise Unreadable unless content is of a kind and of version 2; as texts, 2.0 is another."""
    head = str([given.get("format"), given.get("version")] if type(given) is dict else None)
    ensure(head == f"['exact-mdp {kind}', 2]", f"no {kind}: format and version are {head[:80]}")


def check_keys(given: Any, keys: Iterable[str], what: str) -> None:
    """Raise Unreadable unless an object has these keys."""
    other = ", ".join(sorted({*keys} ^ {*given} if type(given) is dict else keys))
    ensure(not other, f"{what}: keys missing, or too many: {other[:80]}")


def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Return an object of a JSON file; raises Unreadable for a key that is written twice."""
    keys = [key for key, _ in pairs]
    ensure(len({*keys}) == len(keys), f"{max(keys, key=keys.count, default='')!r} is written twice")
    return dict(pairs)


class Level:
    """Numbers of the states: top[s] / below[group[s]], integers."""

    def __init__(self, given: Any, what: str, states: int) -> None:
        check_keys(given, ("top", "below", "group"), what)
        self.top = integers(given["top"], f"{what}.top", states)
        self.below = integers(given["below"], f"{what}.below")
        self.group = integers(given["group"], f"{what}.group", states)
        fits = {*self.group} == {*range(len(self.below))} and min(self.below, default=1) > 0
        ensure(fits, f"{what}: a number below is not positive, or those are not the groups'")
        self._times: dict[frozenset[int], tuple[int, dict[int, int]]] = {}

    def weigh(self, weight: Sequence[Any], states: Sequence[int]) -> tuple[Any, int]:
        """Return the weighted sum of the numbers of some states: top and below."""
        groups = [*map(self.group.__getitem__, states)]
        if (key := frozenset(groups)) not in self._times:
            unit = lcm(*(self.below[each] for each in key))
            self._times[key] = unit, {each: unit // self.below[each] for each in key}
        unit, times = self._times[key]
        factors, numbers = map(times.__getitem__, groups), map(self.top.__getitem__, states)
        return sum(map(mul, map(mul, weight, factors), numbers)), unit


class Model:
    """States and actions of pairs; expected rewards top / below; rows weight / under."""

    def __init__(self, given: Any) -> None:
        check_head(given, "model")
        check_keys(dict.fromkeys(given.keys() & {*MODEL}), MODEL, "the model")
        states, discount, self.sense, start, pairs = map(given.get, MODEL)
        (self.states,), self.discount = integers([states], "states"), ratio(discount, "discount")
        self.missing, self.sign = given.get("unreached", "inf"), 1 if self.sense == "max" else -1
        fits = 0 <= self.discount <= 1 and self.sense in ("max", "min")
        ensure(fits, "the discount is not from 0 to 1, or sense is neither max nor min")
        ensure(self.missing in ("inf", "-inf"), "unreached is neither inf nor -inf")
        fits = type(start) is dict and type(pairs) is list and self.states <= len(pairs)
        ensure(fits, "start is no object, or pairs no list with a pair of each state")
        odds = [ratio(share, "start") for share in start.values()]
        self.start = sorted(x for x in zip(integers([*start], "start"), odds, strict=True) if x[1])
        self.odds = [p for _, p in self.start], [s for s, _ in self.start]
        fits = {*self.odds[1]} <= {*range(self.states)} and sum(odds) == 1 and min(odds) >= 0
        ensure(fits, "start: no distribution of states")
        rows = map(list, zip(*sorted(map(self._row, pairs)), strict=True))
        self.state, self.action, self.top, self.below, self.under, self.next, self.weight = rows
        self.pair = {key: l for l, key in enumerate(zip(self.state, self.action, strict=True))}
        fits = len(self.pair) == len(pairs) and {*self.state} == {*range(self.states)}
        ensure(fits, "two pairs have the same state and action, or the states are not 0, 1, …")
        moving = zip(self.state, self.top, self.next, strict=True)
        self.ends = {*range(self.states)} - {s for s, top, after in moving if top or after != [s]}
        self.goal = None if given.get("goal") is None else {*integers(given["goal"], "goal")}
        ensure(self.goal is None or (self.discount == 1 and self.goal <= self.ends), "the goal")

    def _row(self, given: Any) -> tuple[Any, ...]:
        check_keys(given, PAIR, "a pair")
        state, action, below = integers([given[key] for key in PAIR[:3]], "a pair")
        where, reward = f"state {state}, action {action}", given["reward"]
        after, weight = integers(given["next"], where), integers(given["weight"], where)
        fits = len(after) == len(weight) and min(weight, default=0) > 0 and sum(weight) == below
        ensure(fits, f"{where}: weights, not one for each, above 0, with the denominator as sum")
        ensure(min(after) >= 0 and max(after) < self.states, f"{where}: a next state is none")
        each, shares = (reward, weight) if type(reward) is list else ([reward], [below])
        ensure(len(each) == len(shares), f"{where}: the number of rewards")
        earned = [x if type(x) in (int, Fraction) else ratio(x, where) for x in each]
        mean = Fraction(sum(map(mul, shares, earned)), below)
        total = dict.fromkeys(sorted(after), 0)
        for s, w in zip(after, weight, strict=True):
            total[s] += w
        shared = gcd(below, *total.values())
        row = [w // shared for w in total.values()]
        return state, action, *mean.as_integer_ratio(), below // shared, [*total], row

    def gain(self, rate: Fraction, pair: int, x: Level, earned: Any = None) -> int:
        """Return r + γ Σ p(s') x(s') - x(s), times a positive integer; r may be something else."""
        top, below = earned or (self.sign * self.top[pair], self.below[pair])
        scale = rate.denominator * self.under[pair]
        weight = [*map(rate.numerator.__mul__, self.weight[pair]), -scale]
        change, unit = x.weigh(weight, [*self.next[pair], self.state[pair]])
        return int(top * scale * unit + below * change)

    def isolate(self, given: Any, policy: Any) -> Model:
        """Return the model in which the draws of a policy are the only actions."""
        check_keys(policy, ("pairs", "weights"), "policy")
        listed = integers(policy["pairs"], "policy")
        weights = Level(policy["weights"], "weights", len(listed))
        ensure(listed == sorted({*listed} & {*self.pair.values()}), "policy: pairs out of order")
        parts, pairs = dict[int, list[tuple[int, Fraction, Fraction]]](), list[Any]()
        for place, pair in enumerate(listed):
            share = Fraction(*weights.weigh([1], [place])) / self.under[pair]
            mean = Fraction(self.top[pair], self.below[pair])
            each = zip(self.next[pair], self.weight[pair], strict=True)
            parts.setdefault(self.state[pair], []).extend((s, share * w, mean) for s, w in each)
        for state, part in parts.items():
            after, odds, earned = map(list, zip(*part, strict=True))
            below = lcm(*(x.denominator for x in odds))
            own = state, 0, below, after, [int(x * below) for x in odds], earned
            pairs.append(dict(zip(PAIR, own, strict=True)))
        return Model({**given, "pairs": pairs})

    def digest(self) -> str:
        """Return the SHA-256 of all that counts: lines of integers in hexadecimal."""
        lines: list[Iterable[int]] = [
            [self.states, self.discount.numerator, self.discount.denominator],
            [n for s, p in self.start for n in (s, p.numerator, p.denominator)],
            *(self.state, self.action, self.top, self.below, self.under),
            *(map(len, self.next), chain(*self.next), chain(*self.weight)),
        ]
        aim = "" if self.goal is None else f" {self.missing} {sorted(self.goal)}"
        text = [f"exact-mdp model 2 {self.sense}{aim}", *(" ".join(map(hex, x)) for x in lines)]
        return sha256("\n".join(text).encode()).hexdigest()


class Check:
    """What a certificate claims of a model, and what does not hold of it, in words."""

    def __init__(self, model: Model, given: Any) -> None:
        self.model, self.kind, self.unique = model, given["kind"], given.get("unique")
        states, some = model.states, {key: x for key, x in given.items() if x is not None}
        self.policy = integers(given["policy"], "policy", states)
        ranks = {key: integers(some[key], key, states) for key in RANKS if key in some}
        levels = {key: Level(some[key], key, states) for key in LEVELS if key in some}
        self.parts = [*levels, *ranks]
        self.rank, self.order, self.infinite = (ranks.get(key, []) for key in RANKS)
        ensure(min(self.rank + self.order, default=0) >= 0, "a rank is negative")
        zero = Level({"top": [0] * states, "below": [1], "group": [0] * states}, "zero", states)
        self.g, self.h, self.w = (levels.get(key, zero) for key in LEVELS[:3])
        self.low, self.high = (levels.get(key, self.h) for key in LEVELS[3:])
        self.discount = Fraction(1) if self.kind == "average" else model.discount
        self.gain, self.optimal = partial(model.gain, self.discount), [False] * len(model.state)
        of_sign = ({s for s, sign in enumerate(self.infinite) if sign == x} for x in (0, -1, 1))
        self.finite, self.never, self.above = of_sign
        self.arriving, self.lost = set[int](), (model.missing == "-inf") is (model.sense == "max")
        self.start = ratio(given.get("start_value", 0), "start_value", INFINITE)

    def violations(self) -> Iterator[str]:
        """Yield what does not hold."""
        if other := {*enumerate(self.policy)} - (model := self.model).pair.keys():
            yield f"state {min(other)[0]}: the policy takes an action that there is not"
            return
        taken, one = {model.pair[key] for key in enumerate(self.policy)}, self.discount == 1
        total, alone = self.kind == "total", ["low", "high"] if self.kind == "bounds" else ["h"]
        if self.kind != "average" and self.parts == alone + ["rank"] * one:
            judge = self.judge_values
        elif self.parts == ["g", "h", "w"] and one and not (total and model.goal is not None):
            judge = self.judge_expansion
        elif self.parts == ["h", *RANKS] and total and model.goal is not None:
            judge = self.judge_goal
        else:
            yield f"{', '.join(self.parts) or 'no levels'} prove no {self.kind} of such a model"
            return
        for pair, state in enumerate(model.state):
            if wrong := judge(pair, state, pair in taken):
                yield f"state {state}, action {model.action[pair]}: {wrong}"
        if self.lost and not self.above <= self.arriving:
            yield f"state {min(self.above - self.arriving)}: the goal may be out of reach"
        if self.kind != "bounds" and model.sign * self.start != self.at_start():
            yield "the start value is not that of the start states"
        if self.kind != "bounds" and self.unique is not self.one_optimum():
            yield f"it says wrongly that the optimum is {'' if self.unique else 'not '}unique"

    def falls(self, pair: int, rank: Sequence[int], inside: Container[int]) -> bool:
        """Return whether a pair may lead to a state inside, of a lower rank than its own."""
        own = rank[self.model.state[pair]]
        return any(rank[s] < own and s in inside for s in self.model.next[pair])

    def judge_values(self, pair: int, state: int, taken: bool) -> str:
        """Check U ≥ r + γ P U, of the policy L ≤ r + γ P L, of values both; and that runs end."""
        one, ends, goal = self.discount == 1, state in self.model.ends, self.model.goal
        if one and not ends and not self.falls(pair, self.rank, range(self.model.states)):
            return "the rank does not show that every policy ends"
        if one and ends and goal is not None and state not in goal:
            return "a run may end here, outside the goal"
        if one and ends and not self.low.top[state] <= 0 <= self.high.top[state]:
            return "an end is not worth 0"
        gain = self.gain(pair, self.high)
        self.optimal[pair] = not gain
        if gain > 0:
            return "it is worth more than is claimed"
        less = taken and self.gain(pair, self.low) < 0
        return "the policy is worth less than is claimed" if less else ""

    def judge_expansion(self, pair: int, state: int, taken: bool) -> str:
        """Check g, h and w: the first level that is not 0 is negative; all are 0 for the policy."""
        top, below = self.model.sign * self.model.top[pair], self.model.below[pair]
        (mean, under), (bias, over) = (x.weigh([1], [state]) for x in (self.g, self.h))
        earned = ((0, 1), (top * under - below * mean, below * under), (-bias, over))
        levels = zip("ghw", (self.g, self.h, self.w), earned, strict=True)
        gains = ((name, self.gain(pair, x, each)) for name, x, each in levels)
        name, gain = next(((name, gain) for name, gain in gains if gain), ("", 0))
        self.optimal[pair] = name not in ("g", "h")
        if mean and self.kind == "total":  # infinite: all pairs that keep the sign of the mean
            self.optimal[pair] = mean < 0 or self.gain(pair, self.g, (mean, under)) > 0
        if gain > 0:
            return f"its {name} is more than is claimed"
        return f"the policy's {name} is less than is claimed" if gain and taken else ""

    def judge_goal(self, pair: int, state: int, taken: bool) -> str:
        """Check values where a run that never reaches the goal is worth +∞, or -∞ (`lost`).

        +∞: each pair of a finite state may lower the rank, so that every policy arrives; elsewhere
        the policy may come, by falling order, to states of order 0, and stays in these.
        -∞: each pair of a state of -∞ may lead to one of lower order, or to its own order only. The
        policy arrives from finite states, worth the most that such policies earn; from those of +∞
        pairs may lower the rank, and it goes round in states of order 0 for a gain in each step.
        """
        after, order, lost = self.model.next[pair], self.order, self.lost
        inside, safe = self.finite.issuperset(after), self.never.isdisjoint(after)
        self.optimal[pair] = True
        if state in (self.model.goal or ()):
            worth_0 = state in self.finite and not self.h.top[state]
            return "" if worth_0 else "a state of the goal is not worth 0"
        if state in self.never and lost:
            same = self.never.issuperset(after) and {order[s] for s in after} == {order[state]}
            missed = same or self.falls(pair, order, self.never)
            return "" if missed else "the order does not show that the goal is missed"
        if state in self.above:
            self.optimal[pair] = safe and not self.above.isdisjoint(after)
            if safe and (self.finite & {*after} or self.falls(pair, self.rank, self.above)):
                self.arriving.add(state)
            stays = self.above.issuperset(after) and not any(order[s] for s in (state, *after))
            stays = stays and not (lost and self.gain(pair, self.h) <= 0)
            right = not taken or (safe and (stays or self.falls(pair, order, self.above)))
            return "" if right else "the order does not show that the policy is worth +∞"
        gain = self.gain(pair, self.h) if inside else -1
        self.optimal[pair] = not gain
        if (safe and not inside) or gain > 0 or state not in self.finite:
            return "it is worth more than is claimed"
        if taken and not self.optimal[pair]:
            return "the policy is worth less than is claimed"
        reached = (lost and not taken) or self.falls(pair, self.rank, self.finite)
        return "" if reached else "the rank does not show that the goal is reached"

    def at_start(self) -> Fraction | float:
        """Return the value of the start; of discounted values, their limit at discount 1."""
        if self.kind == "average":
            return Fraction(*self.g.weigh(*self.model.odds))
        signs = {(self.infinite or self.g.top)[s] for s, _ in self.model.start} - {0}
        infinite = {inf if sign > 0 else -inf for sign in signs}
        return sum(infinite) or Fraction(*self.h.weigh(*self.model.odds))  # NaN for both

    def one_optimum(self) -> bool:
        """Return whether states that optimal pairs reach from the start have one each, or end."""
        best: list[list[list[int]]] = [[] for _ in range(self.model.states)]
        for pair, state in enumerate(self.model.state):
            best[state] += [self.model.next[pair]] if self.optimal[pair] else []
        seen = {*(waiting := [state for state, _ in self.model.start])}
        for state in waiting:
            if len(best[state]) != 1 and state not in self.model.ends:
                return False
            waiting += (fresh := {*chain(*best[state])} - seen)
            seen |= fresh
        return True


def compare(model: Model, content: Any, given: Any) -> Iterator[str]:
    """Yield what does not hold: of an optimum, of a policy's value, of the regret between them."""
    for key in ("optimum", "value"):
        check_keys(given[key], INNER, key)
    alone, best = model.isolate(content, given["policy"]), Check(model, given["optimum"])
    own, lost = Check(alone, given["value"]), ratio(given["regret"], "regret", INFINITE)
    for key, each in (("optimum", best), ("value", own)):
        if [given[key]["model"], given[key]["sense"]] != [each.model.digest(), model.sense]:
            yield f"{key}: it belongs to another model"
        yield from (f"{key}: {wrong}" for wrong in each.violations())
    alike = [best.kind, best.parts] == [own.kind, own.parts] and best.kind in ("total", "average")
    ends = best.start, -own.start  # infinite ones alone count; both: NaN
    if not alike or lost != model.sign * (sum(x for x in ends if abs(x) == inf) or sum(ends)):
        yield "the regret is not the difference of an optimum and a value that are proven alike"


def describe(given: Any) -> str:
    """Return in a sentence what a certificate of a regret shows, ten digits of each number."""
    said = given["value"]["start_value"], given["optimum"]["start_value"], given["regret"]
    each = (ratio(x, "", INFINITE) for x in said)
    own, best, lost = (x if abs(x) == inf else Decimal(x.numerator) / x.denominator for x in each)
    return f": the policy earns {own:.10g} at the start, the best {best:.10g}; regret {lost:.10g}"


def violations(model: object, given: Any) -> list[str]:
    """Return up to 20 sentences about rules that two files break: none if the claims hold."""
    check_head(given, "certificate")
    ensure(str(given.get("kind")) in KEYS, f"no kind of {', '.join(KEYS)}: see exact-mdp verify")
    check_keys(given, KEYS[given["kind"]], "the certificate")
    if [given["model"], given["sense"]] != [(of := Model(model)).digest(), of.sense]:
        return ["the certificate belongs to another model"]
    found = compare(of, model, given) if "value" in given else Check(of, given).violations()
    return [*islice(found, 20)]


def read_json(path: str) -> Any:
    """Return the content of a JSON file."""
    try:
        return json.loads(Path(path).read_text("utf-8-sig"), object_pairs_hook=once)
    except (ValueError, RecursionError) as error:
        raise Unreadable(f"{path}: {error}") from error


def main(words: Sequence[str], load: Callable[[str], Any] = read_json) -> int:
    """Check a certificate file against a model file, and say what does not hold."""
    try:
        ensure(len(words) == 2, "give two files: model.json certificate.json")
        wrong = violations(load(words[0]), given := read_json(words[1]))
        said = "holds" + (describe(given) if not wrong and "value" in given else "")
    except (ValueError, OSError) as error:
        print(f"not checked: {error}", file=sys.stderr)
        return 2
    print("\n".join(f"does not hold: {what}" for what in wrong) or said)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
