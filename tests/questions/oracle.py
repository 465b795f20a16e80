"""What small models are worth, in plain fractions, by enumeration, without code of the toolkit.

A `Plain` model is rows of outcomes as a person writes them down. A question makes a `Problem` of
it: the moves of each state, the states in which a run stops and what it is worth then, and what a
run is worth that never stops there. Every deterministic policy of a problem is evaluated, and the
best value of each state is the greatest or the least of these. Problems whose states have the time
in them are solved from the last step on, since they have too many policies to list.

At discount 1 the value of a policy is the limit of its discounted values (Puterman, Markov Decision
Processes, 1994, corollary 8.2.5): with gain g and bias h it is +∞ where g > 0, -∞ where g < 0, and
h where g = 0.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction as F
from itertools import product
from math import inf
from typing import Any

Outcome = tuple[F, int, dict[str, F]]  # probability, next state, amounts of components
Value = F | float  # a fraction, or an infinity
Mixture = Sequence[F]  # the probability of each action of a state


@dataclass(frozen=True)
class Plain:
    """A model as it is written down: rows[s] lists (action, outcomes) of state s."""

    rows: Sequence[Sequence[tuple[int, Sequence[Outcome]]]]
    discount: F
    start: Mapping[int, F]
    sense: str
    labels: Mapping[str, frozenset[int]]

    def with_row(self, state: int, place: int, outcomes: Sequence[Outcome]) -> Plain:
        """Return the model with other outcomes of one action of a state."""
        rows = [list(each) for each in self.rows]
        rows[state][place] = (rows[state][place][0], outcomes)
        return replace(self, rows=rows)

    def with_chance(self, state: int, place: int, chances: Mapping[int, F]) -> Plain:
        """Return the model with other probabilities of some next states; others share the rest."""
        outcomes = self.rows[state][place][1]
        before = {to: F(0) for to in chances}
        for p, to, _ in outcomes:
            if to in before:
                before[to] += p
        left = (1 - sum(chances.values())) / (1 - sum(before.values()))
        scaled = [
            (p * (chances[to] / before[to] if to in chances else left), to, amounts)
            for p, to, amounts in outcomes
        ]
        return self.with_row(state, place, scaled)

    def with_amount(self, old: F, new: F) -> Plain:
        """Return the model in which each outcome that earned one total earns another one."""
        rows = [
            [
                (action, [(p, to, {"r": new} if sum(a.values()) == old else a) for p, to, a in row])
                for action, row in each
            ]
            for each in self.rows
        ]
        return replace(self, rows=rows)


@dataclass(frozen=True)
class Problem:
    """What is asked: moves[s] lists the actions of state s, each a list of (p, next, reward)."""

    moves: Sequence[Sequence[Sequence[tuple[F, int, F]]]]
    discount: F
    start: Mapping[int, F]
    sense: str
    stopped: Mapping[int, Value] = field(default_factory=dict)  # what a run is worth that is there
    missed: Value | None = None  # and one that never comes there, at discount 1
    average: bool = False
    layered: bool = False  # every move leads to a state of a higher number, or to a stopped one

    def best(self, values: Sequence[Value]) -> Value:
        """Return the best of some values."""
        return max(values) if self.sense == "max" else min(values)

    def choices(self) -> Iterator[tuple[int, ...]]:
        """Yield every deterministic policy, as the place of the action of each state."""
        yield from product(*(range(len(each)) for each in self.moves))


# ---- equations -----------------------------------------------------------------------------------


def solve(matrix: Sequence[Sequence[F]], right: Sequence[F]) -> list[F]:
    """Return x with matrix · x = right, by elimination."""
    size = len(right)
    rows = [[*row, value] for row, value in zip(matrix, right, strict=True)]
    for column in range(size):
        pivot = next(k for k in range(column, size) if rows[k][column])
        rows[column], rows[pivot] = rows[pivot], rows[column]
        unit = rows[column][column]
        rows[column] = [x / unit for x in rows[column]]
        for k in range(size):
            if k != column and rows[k][column]:
                factor = rows[k][column]
                rows[k] = [x - factor * y for x, y in zip(rows[k], rows[column], strict=True)]
    return [row[size] for row in rows]


def fixed_point(moves: Sequence[Mapping[int, F]], constant: Sequence[F]) -> list[F]:
    """Return x = constant + moves x."""
    size = len(constant)
    matrix = [[F(s == t) - moves[s].get(t, F(0)) for t in range(size)] for s in range(size)]
    return solve(matrix, constant)


def reaches(moves: Sequence[Mapping[int, F]]) -> list[set[int]]:
    """Return the states that each state can come to, itself among them."""
    after = []
    for state in range(len(moves)):
        seen, waiting = {state}, [state]
        while waiting:
            for to in moves[waiting.pop()]:
                if to not in seen:
                    seen.add(to)
                    waiting.append(to)
        after.append(seen)
    return after


def recurrent_classes(moves: Sequence[Mapping[int, F]]) -> list[list[int]]:
    """Return the sets of states that are never left and lead to each other."""
    after = reaches(moves)
    closed = [s for s in range(len(moves)) if all(s in after[t] for t in after[s])]
    return [sorted(after[s]) for s in closed if s == min(after[s])]


def gain_and_bias(moves: Sequence[Mapping[int, F]], reward: Sequence[F]) -> tuple[list[F], list[F]]:
    """Return the gain g and the bias h of a chain: h = r - g + P h, with mean 0 in each class."""
    size, classes = len(moves), recurrent_classes(moves)
    gain, inside = [F(0)] * size, [False] * size
    matrix: list[list[F]] = [[F(0)] * size for _ in range(size)]
    right = [F(0)] * size
    for states in classes:
        # The stationary distribution x: x = x P and sum 1, in place of one equation.
        place = {s: k for k, s in enumerate(states)}
        balance = [[moves[s].get(t, F(0)) - (s == t) for s in states] for t in states]
        balance[0] = [F(1)] * len(states)
        share = solve(balance, [F(k == 0) for k in range(len(states))])
        mean = sum((share[place[s]] * reward[s] for s in states), F(0))
        for s in states:
            gain[s], inside[s] = mean, True
        for s in states[1:]:
            matrix[s] = [F(s == t) - moves[s].get(t, F(0)) for t in range(size)]
            right[s] = reward[s] - mean
        first = states[0]
        for s in states:
            matrix[first][s] = share[place[s]]
    outside = [s for s in range(size) if not inside[s]]
    if outside:
        place = {s: k for k, s in enumerate(outside)}
        within = [{place[t]: p for t, p in moves[s].items() if t in place} for s in outside]
        from_classes = [
            sum((p * gain[t] for t, p in moves[s].items() if t not in place), F(0)) for s in outside
        ]
        for s, value in zip(outside, fixed_point(within, from_classes), strict=True):
            gain[s] = value
        for s in outside:
            matrix[s] = [F(s == t) - moves[s].get(t, F(0)) for t in range(size)]
            right[s] = reward[s] - gain[s]
    return gain, solve(matrix, right)


# ---- policies ------------------------------------------------------------------------------------


def chain_of(problem: Problem, policy: Sequence[Mixture]) -> tuple[list[dict[int, F]], list[F]]:
    """Return the transitions and expected rewards under a policy; stopped states stay."""
    moves, reward = list[dict[int, F]](), list[F]()
    for state, (actions, mixture) in enumerate(zip(problem.moves, policy, strict=True)):
        row, earned = dict[int, F](), F(0)
        if state in problem.stopped:
            row = {state: F(1)}
        else:
            for share, outcomes in zip(mixture, actions, strict=True):
                for p, to, r in outcomes if share else ():
                    row[to] = row.get(to, F(0)) + share * p
                    earned += share * p * r
        moves.append({to: p for to, p in row.items() if p})
        reward.append(earned)
    return moves, reward


def pure(problem: Problem, choice: Sequence[int]) -> list[list[F]]:
    """Return a deterministic policy as probabilities of actions."""
    return [
        [F(k == taken) for k in range(len(each))]
        for each, taken in zip(problem.moves, choice, strict=True)
    ]


def evaluate(problem: Problem, policy: Sequence[Mixture]) -> list[Value]:
    """Return the value of a policy in every state."""
    moves, reward = chain_of(problem, policy)
    size, after = len(moves), reaches(moves)
    if problem.average:
        return list(gain_and_bias(moves, reward)[0])
    lost = {s for s, value in problem.stopped.items() if isinstance(value, float)}
    if problem.discount == 1 and problem.missed is not None:
        stays = {s for each in recurrent_classes(moves) for s in each}
        lost |= stays - problem.stopped.keys()
    infinite = [bool(after[s] & lost) for s in range(size)]
    known = {s: value for s, value in problem.stopped.items() if not infinite[s]}
    left = [s for s in range(size) if not infinite[s] and s not in known]
    place, values = {s: k for k, s in enumerate(left)}, [inf if x else F(0) for x in infinite]
    for s, value in known.items():
        values[s] = value
    ahead = [sum((p * values[t] for t, p in moves[s].items() if t in known), F(0)) for s in left]
    inner = [{place[t]: p for t, p in moves[s].items() if t in place} for s in left]
    if problem.discount < 1:
        scaled = [{t: problem.discount * p for t, p in row.items()} for row in inner]
        constant = [reward[s] + problem.discount * a for s, a in zip(left, ahead, strict=True)]
        found: list[Value] = list(fixed_point(scaled, constant))
    else:
        # One more state, the end, takes what leads to stopped states, whose values are paid there.
        end = len(left)
        closed = [{**row, end: 1 - sum(row.values(), F(0))} for row in inner] + [{end: F(1)}]
        closed = [{t: p for t, p in row.items() if p} for row in closed]
        earned = [reward[s] + a for s, a in zip(left, ahead, strict=True)] + [F(0)]
        gain, bias = gain_and_bias(closed, earned)
        limits = zip(gain, bias, strict=True)
        found = [h if g == 0 else (inf if g > 0 else -inf) for g, h in limits][:end]
    for s, value in zip(left, found, strict=True):
        values[s] = value
    return values


def optimum(problem: Problem) -> list[Value]:
    """Return the best value of every state."""
    if problem.layered:
        return _backward(problem)
    each = [evaluate(problem, pure(problem, choice)) for choice in problem.choices()]
    values = [problem.best(column) for column in zip(*each, strict=True)]
    if problem.missed is not None and problem.sense == "min" and problem.discount == 1:
        for state in _falling(problem):
            values[state] = -inf
    return values


def _backward(problem: Problem) -> list[Value]:
    """Return the best values of a problem whose moves lead to states of higher numbers."""
    values: list[Value] = [F(0)] * len(problem.moves)
    for state, value in problem.stopped.items():
        values[state] = value
    for state in reversed(range(len(problem.moves))):
        if state in problem.stopped:
            continue
        worths = list[Value]()
        for outcomes in problem.moves[state]:
            ahead = [values[to] for p, to, _ in outcomes if p]
            if any(isinstance(value, float) for value in ahead):
                worths.append(inf)
                continue
            worths.append(
                sum((p * (r + problem.discount * values[t]) for p, t, r in outcomes), F(0))
            )
        values[state] = problem.best(worths)
    return values


def _falling(problem: Problem) -> list[int]:
    """Return the states from which costs fall without end, though the goal is reached for sure.

    A policy goes round where it earns, as often as it likes, and leaves for the goal in the end.
    """
    states = set(range(len(problem.moves)))
    while True:  # the states from which some policy reaches the goal with probability 1
        sure = {s for s in states if s in problem.stopped}
        grows = True
        while grows:
            more = {
                s
                for s in states - sure
                for outcomes in problem.moves[s]
                if {to for p, to, _ in outcomes if p} <= states
                and {to for p, to, _ in outcomes if p} & sure
            }
            grows = bool(more)
            sure |= more
        if sure == states:
            break
        states = sure
    kept = list[list[Any]]()  # the moves of these states that do not leave them
    for s, each in enumerate(problem.moves):
        inside = [o for o in each if {to for p, to, _ in o if p} <= states]
        kept.append(inside if s in states and s not in problem.stopped else [])
    earning, options = set[int](), [range(max(1, len(each))) for each in kept]
    for choice in product(*options):
        moves, reward = list[dict[int, F]](), list[F]()
        for s, taken in enumerate(choice):
            row, earned = {s: F(1)}, F(0)
            if kept[s]:
                row = {}
                for p, to, r in kept[s][taken]:
                    row[to] = row.get(to, F(0)) + p
                    earned += p * r
            moves.append({to: p for to, p in row.items() if p})
            reward.append(earned)
        gain, _ = gain_and_bias(moves, reward)
        earning |= {s for each in recurrent_classes(moves) for s in each if gain[s] < 0}
    after = reaches([{to: F(1) for o in each for p, to, _ in o if p} for each in kept])
    return [s for s in states if s not in problem.stopped and after[s] & earning]


def at_start(problem: Problem, values: Sequence[Value]) -> Value | None:
    """Return the mean value at the start; None where it mixes +∞ and -∞."""
    signs = {
        values[s] for s, share in problem.start.items() if share and isinstance(values[s], float)
    }
    if len(signs) == 2:
        return None
    if signs:
        return signs.pop()
    return sum((share * values[s] for s, share in problem.start.items() if share), F(0))


def returns(problem: Problem, policy: Sequence[Mixture], steps: int) -> tuple[dict[F, F], F]:
    """Return the probability of each return of runs that stop within some steps, and of the others.

    A run stops in a stopped state, or in one that it stays in for ever and earns nothing.
    """
    moves, _ = chain_of(problem, policy)
    over = set(problem.stopped)
    for s, row in enumerate(moves):
        taken = [o for share, o in zip(policy[s], problem.moves[s], strict=True) if share]
        if set(row) == {s} and not any(r for outcomes in taken for p, _, r in outcomes if p):
            over.add(s)
    stays: Value = F(0)  # what a run is worth that stays where nothing is earned
    if problem.missed is not None and problem.discount == 1:
        stays = problem.missed
    law, waiting = dict[F, F](), {(s, F(0)): p for s, p in problem.start.items() if p}
    for _ in range(steps + 1):
        following = dict[tuple[int, F], F]()
        for (s, earned), mass in waiting.items():
            if s in over:
                value = problem.stopped.get(s, stays)
                total = earned + value if not isinstance(value, float) else value
                law[total] = law.get(total, F(0)) + mass
                continue
            for share, outcomes in zip(policy[s], problem.moves[s], strict=True):
                for p, to, r in outcomes if share else ():
                    key = to, earned + r
                    following[key] = following.get(key, F(0)) + mass * share * p
        waiting = following
    return law, sum(waiting.values(), F(0))


def best_tail_mean(problem: Problem, level: F, steps: int) -> F:
    """Return the greatest mean of the worst share of returns that any policy has.

    For a threshold x it is x - (least expected shortage below x) / level; some return is the best
    threshold (Rockafellar and Uryasev, Journal of Risk 2, 2000). Shortages are found over states
    with what has been earned, so that policies may remember it.
    """
    sign = 1 if problem.sense == "max" else -1

    def totals(state: int, left: int) -> set[F]:
        if state in problem.stopped or not left:
            return {sign * problem.stopped.get(state, F(0))}
        return {
            sign * r + more
            for outcomes in problem.moves[state]
            for p, to, r in outcomes
            if p
            for more in totals(to, left - 1)
        }

    def shortage(state: int, wanted: F, left: int) -> F:
        if state in problem.stopped or not left:
            return max(wanted - sign * problem.stopped.get(state, F(0)), F(0))
        return min(
            sum((p * shortage(to, wanted - sign * r, left - 1) for p, to, r in outcomes), F(0))
            for outcomes in problem.moves[state]
        )

    starts = [(s, p) for s, p in problem.start.items() if p]
    thresholds = {x for s, _ in starts for x in totals(s, steps)}
    return sign * max(
        x - sum((p * shortage(s, x, steps) for s, p in starts), F(0)) / level for x in thresholds
    )


# ---- questions -----------------------------------------------------------------------------------

Amount = Callable[[dict[str, F]], F]


def whole(amounts: dict[str, F]) -> F:
    """Return what an outcome earns in all."""
    return sum(amounts.values(), F(0))


def component(name: str) -> Amount:
    """Return what reads one component of an outcome."""
    return lambda amounts: amounts.get(name, F(0))


def moves_of(plain: Plain, amount: Amount = whole) -> list[list[list[tuple[F, int, F]]]]:
    """Return the moves of a model, with one amount of each outcome as its reward."""
    return [
        [[(p, to, amount(each)) for p, to, each in outcomes] for _, outcomes in state]
        for state in plain.rows
    ]


def total(plain: Plain, amount: Amount = whole) -> Problem:
    """Return the problem of the total reward."""
    return Problem(moves_of(plain, amount), plain.discount, plain.start, plain.sense)


def until(plain: Plain, label: str, amount: Amount = whole) -> Problem:
    """Return the problem of the reward until a label; a run that misses it is worth +∞."""
    stopped = dict.fromkeys(plain.labels[label], F(0))
    missed = inf if plain.discount == 1 else None
    return replace(total(plain, amount), stopped=stopped, missed=missed)


def reaching(plain: Plain, label: str) -> Problem:
    """Return the problem of the probability of reaching a label."""
    goal = plain.labels[label]
    moves = [[[(p, to, F(0)) for p, to, _ in o] for _, o in state] for state in plain.rows]
    return Problem(moves, F(1), plain.start, plain.sense, stopped=dict.fromkeys(goal, F(1)))


def within(problem: Problem, steps: int) -> Problem:
    """Return the problem of runs of so many steps; states are numbered by time, then state.

    What has not stopped by then is worth what a run is worth that never stops.
    """
    size = len(problem.moves)
    late: Value = F(0) if problem.missed is None else problem.missed
    stopped = {t * size + s: v for t in range(steps + 1) for s, v in problem.stopped.items()}
    for s in range(size):
        stopped.setdefault(steps * size + s, late)
    moves: list[Any] = [
        [[(p, (t + 1) * size + to, r) for p, to, r in outcomes] for outcomes in each]
        for t in range(steps)
        for each in problem.moves
    ]
    moves += [[[]] for _ in range(size)]
    return replace(problem, moves=moves, stopped=stopped, missed=None, layered=True)
