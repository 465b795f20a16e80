"""Certificates that hold, altered ones, random ones and weakened ones, for both checkers.

    python tests/support/altered_certificates.py [how many, 20000] [seed, 0]

compares the verdict of `checker` with that of `verified`, the proven one, on each of them, and
prints by kind how many both accept and refuse. The exit status is 1 if they differ on one.

altered    a proof of a random model; in one or two places the proof, or the model, is another
weakened   such a proof, in which one number of a level is a little less, or more
random     tiny models, with levels, ranks and policies that are drawn
"""

import copy
import random
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from math import isnan
from typing import Any

import numpy as np

from exact_mdp import MDP, ModelError, certify, check
from exact_mdp.mdp.io import model_json
from exact_mdp.solvers.exact import checker, codec, verified

File = dict[str, Any]
Case = tuple[str, File, File]  # what it is, a model, a certificate
LEVELS = ("g", "h", "w", "low", "high")
FIXED = ("format", "version", "model", "sense", "kind")
KINDS = ("discounted", "ends", "average", "expansion", "goal", "goal", "goal")
INNER = ("optimum", "value")  # the two certificates in that of a regret


# ---- verdicts ------------------------------------------------------------------------------------


def verdicts(model: object, certificate: object) -> tuple[int, int]:
    """The exit statuses of both checkers: 0 holds, 1 does not hold, 2 not checked."""
    try:
        first = int(bool(checker.violations(model, certificate)))
    except checker.Unreadable:
        first = 2
    try:
        second = int(not verified.holds(model, certificate))
    except verified.Unreadable:
        second = 2
    return first, second


# ---- proofs of random models ---------------------------------------------------------------------


def random_model(draw: random.Random, kind: str) -> MDP:
    """A model of 2 to 7 states, some of which are ends."""
    states, rows = draw.randint(2, 7), list[Any]()
    for s in range(states):
        if s == states - 1 or (kind != "average" and draw.random() < 0.15):
            rows.append((s, 0, [(1, s, 0)]))
            continue
        for a in range(draw.randint(1, 3)):
            after = [draw.randrange(states) for _ in range(draw.randint(1, 3))]
            after += [draw.randrange(s + 1, states)] if kind == "ends" else []
            weights = [draw.randint(1, 5) for _ in after]
            rewards = [Fraction(draw.choice([-2, -1, -1, 0, 0, 0, 1, 2, 3]),
                                draw.choice([1, 1, 1, 2, 3])) for _ in after]  # fmt: skip
            law = zip(weights, after, rewards, strict=True)
            rows.append((s, a, [(Fraction(w, sum(weights)), t, x) for w, t, x in law]))
    discount = draw.choice(["1/2", "9/10", "2/3"]) if kind == "discounted" else 1
    start: Any = {0: "1/2", states - 2: "1/2"} if states > 2 and draw.random() < 0.3 else None
    mdp = MDP.from_outcomes(rows, discount, sense=draw.choice(["max", "min"]), start=start)
    if kind == "goal":
        ends = np.flatnonzero(mdp.terminal).tolist()
        goal = draw.sample(ends, draw.randint(1, len(ends)))
        mdp = mdp.with_(labels={"goal": np.isin(np.arange(states), goal)}).until("goal")
    return mdp


def random_policy(draw: random.Random, mdp: MDP) -> np.ndarray:
    """Probabilities of actions (S, A): quarters, or 1 and 0."""
    table, parts = np.zeros((mdp.n_states, mdp.n_actions)), draw.choice([1, 4])
    for state in range(mdp.n_states):
        for pair in draw.choices(mdp.pairs_of(state), k=parts):
            table[state, mdp.pair_action[pair]] += 1 / parts
    return table


def proofs(draw: random.Random) -> Iterator[Case]:
    """Proofs of random models, for ever: of an optimum, of bounds, or of a policy's regret."""
    while True:
        kind = draw.choice(KINDS)
        mdp, turn = random_model(draw, kind), draw.random()
        criterion: Any = "average" if kind == "average" else "total"
        proof: Any
        try:
            if turn < 0.4:
                policy = random_policy(draw, mdp)
                proof = check(mdp, policy, kind="policy", criterion=criterion).certificate
                kind = f"{kind}, regret"
            elif kind in ("discounted", "ends") and turn < 0.7:
                proof = certify(mdp, bounded=True)
            else:
                proof = certify(mdp, criterion=criterion)
        except ModelError:  # a start that mixes both infinities, or two values that are infinite
            continue
        yield kind, model_json.encode_model(mdp), codec.build_file_content(proof, int)


# ---- changes -------------------------------------------------------------------------------------


def change_certificate(draw: random.Random, proof: File) -> None:
    if proof["kind"] == "regret" and draw.random() < 0.7:
        key = draw.choice(["optimum", "value", "value", "policy", "policy"])
        if key != "policy":
            return change_certificate(draw, proof[key])
        return change_policy(draw, proof[key])
    key = draw.choice([k for k, x in proof.items() if x is not None and k not in FIXED])
    own = proof[key]
    if key == "unique":
        proof[key] = not own
    elif key in (*INNER, "policy") and isinstance(own, dict):
        own[draw.choice([*own])] = draw.choice([None, 0, "1/2", [], {}, "total", "average", True])
    elif key in ("start_value", "regret"):
        proof[key] = draw.choice(["inf", "-inf", 0, 1, "1/2", own])
    elif isinstance(own, dict):
        part = own[draw.choice(["top", "top", "top", "below", "group"])]
        place = draw.randrange(len(part))
        part[place] += draw.choice([-1, 1, 2, -part[place], -2 * part[place], 10])
    else:
        place = draw.randrange(len(own))
        own[place] = draw.choice([own[place] - 1, own[place] + 1, 0, draw.choice(own), -1, 1])


def change_policy(draw: random.Random, policy: File) -> None:
    """Move a weight of a policy to another pair, or take another number somewhere."""
    part = draw.choice([policy["pairs"], policy["weights"]["top"], policy["weights"]["below"]])
    place = draw.randrange(len(part))
    part[place] += draw.choice([-1, 1, 2, -part[place]])
    if part is policy["weights"]["top"] and draw.random() < 0.7:
        part[draw.randrange(len(part))] -= draw.choice([-1, 1, 2])


def change_model(draw: random.Random, model: File, proof: File) -> None:
    key = draw.choice(["discount", "sense", "start", "drop", "unreached", "goal", *["pair"] * 5])
    if key == "discount":
        model[key] = draw.choice(["1/3", 1, "99/100", 0])
    elif key == "sense":
        model[key] = proof[key] = "min" if model[key] == "max" else "max"
        for inner in INNER:
            proof.get(inner, {})[key] = proof[key]
    elif key == "start":
        model[key] = {str(draw.randrange(model["states"])): 1}
    elif key == "unreached":
        model[key] = "-inf" if model.get(key, "inf") == "inf" else "inf"
    elif key == "goal":
        model[key] = [model["states"] - 1] if model.get(key) is None else model[key][1:]
    elif key == "drop":
        model["pairs"].pop(draw.randrange(len(model["pairs"])))
    else:
        change_pair(draw, draw.choice(model["pairs"]), model["states"])


def change_pair(draw: random.Random, pair: File, states: int) -> None:
    key = draw.choice(["reward", "next", "weight", "state", "action"])
    place = draw.randrange(len(pair["next"]))
    if key == "reward":
        reward = draw.choice([0, 1, -1, "1/2"])
        if isinstance(pair[key], list):
            pair[key][place] = reward
        else:
            pair[key] = reward
    elif key == "next":
        pair[key][place] = draw.randrange(states)
    elif key == "weight":
        pair[key][place] += 1
        pair["denominator"] += int(draw.random() < 0.9)
    else:
        pair[key] += draw.choice([-1, 1])


def renewed(model: File, proof: File) -> None:
    """Write the hash of a model, if it is one, and of a policy's, into a certificate."""
    with suppress(checker.Unreadable, TypeError):
        read = checker.Model(model)
        proof["model"] = read.digest()
        if proof["kind"] == "regret":
            proof["optimum"]["model"] = proof["model"]
            proof["value"]["model"] = read.isolate(model, proof["policy"]).digest()


def altered(draw: random.Random, case: Case) -> Case:
    kind, model, proof = copy.deepcopy(case)
    for _ in range(draw.choice([1, 1, 1, 2])):
        if draw.random() < 0.7:
            with suppress(TypeError, KeyError, IndexError):  # a first change left no such part
                change_certificate(draw, proof)
        else:
            change_model(draw, model, proof)
    renewed(model, proof)
    return f"altered, {kind}", model, proof


def weakened(draw: random.Random, case: Case) -> Case:
    """A proof in which one level has another number in one state, by a hundredth or less."""
    kind, model, whole = copy.deepcopy(case)
    proof = whole[draw.choice(INNER)] if whole["kind"] == "regret" else whole
    level = proof[draw.choice([key for key in LEVELS if proof.get(key)])]
    times, place = 10 ** draw.randint(2, 30), draw.randrange(len(level["top"]))
    level["below"] = [times * below for below in level["below"]]
    level["top"] = [times * top for top in level["top"]]
    level["top"][place] += draw.choice([-1, 1])
    return f"weakened, {kind}", model, whole


# ---- random certificates -------------------------------------------------------------------------


def drawn(draw: random.Random, states: int) -> File:
    tops = [draw.choice([0, 0, 1, -1, 2]) for _ in range(states)]
    return {"top": tops, "below": [draw.choice([1, 1, 1, 2])], "group": [0] * states}


def tiny_model(draw: random.Random, style: str) -> File:
    states, pairs = draw.choice([2, 2, 3]), list[File]()
    sense = draw.choice(["max", "min"])
    sign = 1 if sense == "max" else -1
    rewards = [0, sign, sign] if style == "above" else [0, 0, 0, 1, -1]
    for s in range(states):
        last = s == states - 1 and draw.random() < 0.7
        for a in range(1 if last else draw.choice([1, 1, 2])):
            after = [s] if last else draw.sample(range(states), draw.choice([1, 1, 2]))
            pairs.append({
                "state": s, "action": a, "denominator": len(after), "next": after,
                "weight": [1] * len(after), "reward": 0 if last else draw.choice(rewards),
            })  # fmt: skip
    least = "-inf" if sense == "max" else "inf"
    goal = None if style in ("rank", "expansion", "discount") else [states - 1]
    return {
        "format": "exact-mdp model", "version": 2, "states": states, "sense": sense,
        "discount": "1/2" if style == "discount" else 1, "start": {str(draw.randrange(states)): 1},
        "pairs": pairs, "goal": goal,
        "unreached": least if style == "above" else draw.choice(["inf", "-inf"]),
    }  # fmt: skip


def drawn_certificate(draw: random.Random, style: str, model: File) -> File:
    states = model["states"]

    def each(*numbers: int) -> list[int]:
        return [draw.choice(numbers) for _ in range(states)]

    proof: File = {
        "format": "exact-mdp certificate", "version": 2, "kind": "total", "model": None,
        "sense": model["sense"], "policy": each(0, 0, 1), "g": None, "h": drawn(draw, states),
        "w": None, "rank": None, "infinite": None, "order": None, "start_value": 0, "unique": True,
    }  # fmt: skip
    zero = {"top": [0] * states, "below": [1], "group": [0] * states}
    if style in ("goal", "above"):
        above = (1, 1, 0, -1) if style == "above" else (0, 1, -1)
        proof |= {"rank": each(0, 1, 2), "order": each(0, 0, 1), "infinite": each(*above)}
        proof["h"]["top"][-1] = proof["infinite"][-1] = 0
    elif style == "rank":
        proof["rank"] = each(0, 1, 2)
    elif style == "expansion":
        proof |= {"g": drawn(draw, states) if draw.random() < 0.6 else zero,
                  "w": drawn(draw, states), "kind": draw.choice(["total", "average"])}  # fmt: skip
    return proof


def filled(model: checker.Model, proof: File, draw: random.Random) -> None:
    """Write the start value and the uniqueness that the checker finds, most of the time."""
    found = checker.Check(model, proof)
    if [*found.violations()] and draw.random() < 0.9:
        return
    value = found.model.sign * found.at_start()
    if not isnan(value):
        proof["start_value"] = str(value)
    proof["unique"] = found.one_optimum()


def drawn_regret(draw: random.Random, style: str, model: File, best: File) -> Iterator[File]:
    """Certificates of the regret of a random policy, for the proof of the optimum that is given."""
    read, weights = checker.Model(model), list[int]()
    for state in range(read.states):
        taken = [draw.choice([0, 1, 1]) for other in read.state if other == state]
        taken[0] += not any(taken)
        weights += [2 // sum(taken) * weight for weight in taken]
    pairs = [pair for pair, weight in enumerate(weights) if weight]
    policy = {"pairs": pairs, "weights": {"top": [x for x in weights if x], "below": [2],
                                          "group": [0] * len(pairs)}}  # fmt: skip
    alone, inner = read.isolate(model, policy), best.keys() - {"format", "version"}
    for _ in range(20):
        own = drawn_certificate(draw, style, model) | {"policy": [0] * read.states}
        own |= {"kind": best["kind"], "model": alone.digest()}
        filled(alone, own, draw)
        ends = [str(x["start_value"]) for x in (best, own)]
        lost: Any = draw.choice(["inf", 0])
        if "inf" not in "".join(ends) and draw.random() < 0.9:
            lost = str(read.sign * (Fraction(ends[0]) - Fraction(ends[1])))
        head = {key: best[key] for key in ("format", "version", "model", "sense")}
        yield head | {"kind": "regret", "policy": policy, "regret": lost,
                      "optimum": {key: best[key] for key in inner},
                      "value": {key: own[key] for key in inner}}  # fmt: skip


def tiny(draw: random.Random) -> Iterator[Case]:
    """Random certificates of tiny models: many that hold, and a part of those that do not."""
    while True:
        style = draw.choice(["goal", "goal", "above", "rank", "expansion", "discount"])
        model = tiny_model(draw, style)
        try:
            digest = checker.Model(model).digest()
        except checker.Unreadable:
            continue
        for _ in range(60):
            proof = drawn_certificate(draw, style, model) | {"model": digest}
            filled(checker.Model(model), proof, draw)
            holds = not checker.violations(model, proof)
            if holds or draw.random() < 0.03:
                yield f"random, {style}", model, proof
            if holds and draw.random() < 0.5:
                for regret in drawn_regret(draw, style, model, proof):
                    if not checker.violations(model, regret) or draw.random() < 0.02:
                        yield f"random, {style}, regret", model, regret


# ---- all of them ---------------------------------------------------------------------------------


def cases(count: int, seed: int = 0) -> Iterator[Case]:
    """Return so many certificates: of ten, one as it was proven, four altered, two weakened."""
    draw = random.Random(seed)
    whole, small = proofs(draw), tiny(draw)
    for number in range(count):
        turn = number % 10
        if turn == 0:
            case = next(whole)
            yield f"proven, {case[0]}", case[1], case[2]
        elif turn < 5:
            yield altered(draw, case)
        elif turn < 7:
            yield weakened(draw, case)
        else:
            yield next(small)


def main(count: int, seed: int) -> int:
    found = Counter[tuple[str, tuple[int, int]]]()
    for what, model, proof in cases(count, seed):
        found[what, verdicts(model, proof)] += 1
    outcomes = [(0, 0), (1, 1), (2, 2)]
    print(f"{'':32}{'hold':>8}{'do not':>8}{'not read':>9}{'differ':>8}")
    names = sorted({what for what, _ in found})
    table = {name: [found[name, both] for both in outcomes] for name in names}
    for name, row in table.items():
        other = sum(n for (what, both), n in found.items() if what == name) - sum(row)
        print(f"{name:32}{row[0]:8}{row[1]:8}{row[2]:9}{other:8}")
    alike = sum(sum(row) for row in table.values())
    print(f"{alike} of {count} alike (seed {seed})")
    return int(alike != count)


if __name__ == "__main__":
    given = [*map(int, sys.argv[1:]), *(20_000, 0)[len(sys.argv) - 1 :]]
    sys.exit(main(*given))
