"""The optimum under limits on expected totals, exactly: a constrained Markov decision process.

    maximise  r(π)   subject to   c_k(π) ≥ b_k,  k = 1 … m,     over all policies π

Visits x of pairs make this a linear program. A basis of it has one pair for each state, which are a
deterministic policy π, and as many further pairs e, taken y(e) times, as limits bind. With the
values of π for each objective, and what a pair gains on them,

    Σ_e y(e) gain_k(e) = b_k - c_k(π)  for the limits that bind,    their prices p:
    gain_r(e) + Σ_k p_k gain_k(e) = 0  for the further pairs,

are as few equations as limits bind. Where y, all visits and p are not negative, the other limits
are kept, and no pair gains on r + p c, both are optimal, and prove each other: no policy that keeps
the limits earns more than μ V - p b. So the policy draws its action in no more states than limits
bind (Altman, Constrained Markov Decision Processes, 1999, theorem 3.8).

Floats (HiGHS) propose a basis, and the simplex method mends it in rational arithmetic (Applegate,
Cook, Dash and Espinoza, Operations Research Letters 35, 2007), by Bland's rule (Mathematics of
Operations Research 2, 1977). It is that of a program in which limits are looser by a number η that
is smaller than any other, and each state begins a yet smaller number of runs: what is 0 in a basis
then is so for one reason. Where no policy keeps the limits, the least step t by which they are all
moved takes the place of the return, as one more variable; prices sum to 1.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import flint
import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.exact import fraction as as_fraction
from exact_mdp.mdp.exact import rational
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.report import Table
from exact_mdp.mdp.table import Integers, Numbers, common, exact, shown
from exact_mdp.solvers.exact.find import first_of, nearly, visited
from exact_mdp.solvers.exact.levels import Level, combined, signs, surplus
from exact_mdp.solvers.objectives.amounts import Objectives, reward_name
from exact_mdp.solvers.objectives.totals import (
    Attained,
    Flow,
    Point,
    TotalsProof,
    about,
    attained,
    extreme,
)
from exact_mdp.solvers.solution import Certified

if TYPE_CHECKING:
    from pandas import DataFrame

ZERO, ONE = Fraction(0), Fraction(1)
NOISE = 2.0**-40  # of all visits: what floats take for none
PIVOTS = 10  # for each state, in floats: the simplex method may go round in circles
LIMIT = re.compile(r"\s*(>=|<=)\s*(\S+)\s*$")


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A total is at least (sign 1) or at most (sign -1) a bound."""

    name: str
    sign: int
    bound: Fraction

    def __str__(self) -> str:
        return f"{self.name} {'>=' if self.sign > 0 else '<='} {self.bound}"

    def text(self, digits: int) -> str:
        """Return the limit with its bound in decimals."""
        return f"{self.name} {'>=' if self.sign > 0 else '<='} {shown(self.bound, digits)}"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ConstrainedSolution(TotalsProof):
    """The optimum under limits and its proof, or a proof that no policy keeps them.

    Attributes
    ----------
    objectives : tuple of str
        The reward, then what is limited.
    limits : tuple of Limit
    feasible : bool
        Whether a policy keeps them.
    flow : Flow
        Expected visits of pairs under the policy: the optimal one, or one that keeps the moved
        limits.
    price : tuple of Fraction
        Of each limit: what the optimum gains for each unit by which the limit is moved. Where it is
        infeasible, the weights that prove it.
    dual : Level
        What no policy exceeds: the total of the reward, or 0 times it where that is infeasible, and
        of the limited totals times their prices.
    shift : Fraction
        The least t such that limits that are all moved by t can be kept: 0 where it is feasible.

    Examples
    --------
    >>> from exact_mdp import solve
    >>> rows = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    >>> mdp = MDP.from_outcomes(rows, components={"cost": [3, 1, 0]})
    >>> best = solve(mdp, subject_to={"cost": "<= 3/2"})
    >>> best.start_value, best.prices, best.randomises
    (Fraction(2, 1), {'cost': Fraction(2, 1)}, {0: {'0': Fraction(1, 4), '1': Fraction(3, 4)}})
    >>> best.violations(), solve(mdp, subject_to={"cost": "<= 1/2"}).closest
    ([], {'cost': Fraction(1, 1)})
    """

    limits: tuple[Limit, ...]
    feasible: bool
    flow: Flow
    price: tuple[Fraction, ...]
    dual: Level
    shift: Fraction

    kinds: ClassVar[tuple[str, ...]] = ("limits",)

    def __repr__(self) -> str:
        limits = ", ".join(map(str, self.limits))
        if self.start_value is None:
            return f"ConstrainedSolution(no policy keeps {limits}; certified)"
        return f"ConstrainedSolution({float(self.start_value):.12g} with {limits}; certified)"

    @cached_property
    def totals(self) -> dict[str, Fraction]:
        """The policy's total of what is limited."""
        return dict(zip(self.of.names[1:], self._totals[1:], strict=True))

    @property
    def start_value(self) -> Fraction | None:
        """The optimum, which the policy earns; None where no policy keeps the limits."""
        return self._totals[0] if self.feasible else None

    @property
    def start(self) -> Certified | None:
        """The same as a claim."""
        return None if self.start_value is None else Certified(value=self.start_value)

    @cached_property
    def _totals(self) -> Point:
        return tuple(self.of.sign * value for value in self.flow.totals(self.of))

    @property
    def prices(self) -> dict[str, Fraction]:
        """The price of each limit by name; of two limits on one name, both together."""
        total = dict.fromkeys(self.of.names[1:], ZERO)
        for limit, price in zip(self.limits, self.price, strict=True):
            total[limit.name] += price
        return total

    @property
    def closest(self) -> dict[str, Fraction]:
        """The closest limits that can be kept, all moved by the same step.

        By name, or by the whole limit where a name has several.
        """
        return bounds(self.limits, self.moved)

    @property
    def moved(self) -> tuple[Limit, ...]:
        """The limits, all moved by the least step that lets them be kept."""
        return tuple(replace(x, bound=x.bound - x.sign * self.shift) for x in self.limits)

    @property
    def weights(self) -> list[Fraction]:
        """The weight of each objective where limits have prices."""
        return _weights(self.of, self.limits, (Fraction(self.feasible), *self.price))

    @cached_property
    def randomises(self) -> dict[int, dict[str, Fraction]]:
        """The states in which the policy draws its action: {state: {action: probability}}."""
        mdp = self.of.mdp
        return {
            state: {mdp.actions[mdp.pair_action[pair]]: chance for pair, chance in own.items()}
            for state, own in self.flow.chances(self.of).items()
            if len(own) > 1
        }

    @cached_property
    def rule(self) -> Numbers:
        """(S, A) Fractions, the probability of each action.

        In states that are never visited, the first that is optimal for the reward and the prices.
        """
        of, mdp = self.of, self.of.mdp
        rule = np.full((mdp.n_states, mdp.n_actions), ZERO, dtype=object)
        whole, unit = common(self.weights)
        rows = replace(of.rows, constant=of.weighted(whole))
        best = first_of(mdp, signs(rows, combined([self.dual], [unit])) == 0)
        rule[np.arange(mdp.n_states), mdp.pair_action[best]] = ONE
        for state, own in self.flow.chances(of).items():
            rule[state] = ZERO
            for pair, chance in own.items():
                rule[state, mdp.pair_action[pair]] = chance
        return rule

    @cached_property
    def policy(self) -> Policy:
        """The policy, with its exact probabilities."""
        mdp = self.of.mdp
        return Policy(space=mdp.space, actions=mdp.actions, rule=self.rule)

    def table(self, totals: Mapping[str, Fraction], keeps: Sequence[str] = ()) -> Table:
        """Return each limit with a policy's total of it, and its price or the closest to be kept.

        `keeps` says of each limit whether the policy keeps it.
        """
        rows = [
            {"limit": str(limit), "total": totals[limit.name], "price": price, "closest": near}
            for limit, price, near in zip(
                self.limits, self.price, (limit.text(10) for limit in self.moved), strict=True
            )
        ]
        columns = {"limit": "limit", "total": "total:.10g"}
        if keeps:
            rows = [row | {"kept": word} for row, word in zip(rows, keeps, strict=True)]
            columns |= {"kept": "kept"}
        if self.feasible:
            note = "price: what the optimum gains for one point by which the limit is moved"
            columns |= {"price": "price:.10g"}
        else:
            note = "closest: all moved by the same step, the least with which a policy keeps them"
            columns |= {"closest": "closest"}
        return Table(title="limits", rows=rows, columns=columns, note=note)

    def frame(self) -> DataFrame:
        """Return one row for each limit: the total, the price, and the closest limit."""
        import pandas

        rows = [
            (str(limit), self.totals[limit.name], price, moved.bound)
            for limit, moved, price in zip(self.limits, self.moved, self.price, strict=True)
        ]
        return pandas.DataFrame(rows, columns=["limit", "total", "price", "closest"])


def bounds(limits: Sequence[Limit], moved: Sequence[Limit]) -> dict[str, Fraction]:
    """Return where limits are moved to, by name, or by the limit where a name has several."""
    names = [limit.name for limit in limits]
    keys = [x.name if names.count(x.name) == 1 else str(x) for x in limits]
    return {key: limit.bound for key, limit in zip(keys, moved, strict=True)}


def limits_of(subject_to: Mapping[str, Any]) -> tuple[Limit, ...]:
    """Return limits from {name: ">= p/q"}, or from a list of such texts for a name."""
    if not isinstance(subject_to, Mapping) or not subject_to:
        raise ModelError(
            f"{subject_to!r} states no limit",
            where="subject_to",
            fix='give {name: ">= -1/2"}, or "<= …"',
        )
    limits = []
    for name, texts in subject_to.items():
        for text in (texts if isinstance(texts, list | tuple) else [texts]) or [""]:
            parts = LIMIT.match(str(text))
            if parts is None:
                raise ModelError(
                    f"{text!r} is no limit",
                    where=f"subject_to {name!r}",
                    fix='write a text with >= or <=, such as ">= -1/2" or "<= 1/20"',
                )
            sign = 1 if parts[1] == ">=" else -1
            with located(f"subject_to {name!r}"):
                limits.append(Limit(name=str(name), sign=sign, bound=exact(parts[2])))
    return tuple(limits)


def solve_under(mdp: MDP, subject_to: Mapping[str, Any]) -> ConstrainedSolution:
    """Return the optimum under limits; see `solve`."""
    given = limits_of(subject_to)
    names = list(dict.fromkeys(limit.name for limit in given))
    title = "return"
    while title in (name.partition("=")[0].strip() for name in names):
        title += "'"
    of = Objectives.of(mdp, [f"{title}={reward_name(mdp)}", *names])
    limits = tuple(replace(x, name=of.names[1 + names.index(x.name)]) for x in given)
    vertex = _Program(of, limits).solved()
    return ConstrainedSolution(
        limits=limits,
        feasible=vertex.price[0] == 1,
        flow=vertex.flow(of),
        price=vertex.price[1:],
        dual=combined(vertex.policy.values, _weights(of, limits, vertex.price)),
        shift=vertex.shift[0],
        **about(of, "limits"),
    )


def _weights(of: Objectives, limits: Sequence[Limit], price: Sequence[Fraction]) -> list[Fraction]:
    """Return the weight of each objective where the reward and the limits have prices."""
    weights = [price[0]] + [ZERO] * (len(of.names) - 1)
    for limit, own in zip(limits, price[1:], strict=True):
        weights[of.names.index(limit.name)] += of.sign * limit.sign * own
    return weights


Number = tuple[Fraction, Fraction, Fraction]
"""a + b η + c ε, where η is smaller than any rational, and ε smaller than any multiple of η."""

NOTHING = (ZERO, ZERO, ZERO)


class _Basis(NamedTuple):
    """One pair for each state (S,), further pairs, limits that bind, and whether t is above 0."""

    pairs: Integers
    further: list[int]
    binding: list[int]
    short: bool


class _Vertex(NamedTuple):
    """What a basis stands for: numbers of its variables, and prices of the reward and limits."""

    policy: Attained
    further: dict[int, Number]
    visits: list[Level]  # of the states' own pairs: parts of the numbers
    room: list[Number]
    shift: Number
    price: tuple[Fraction, ...]

    def flow(self, of: Objectives) -> Flow:
        """Return the visits of pairs."""
        level, live = self.visits[0], ~of.rows.terminal
        own = [s for s in np.flatnonzero(live).tolist() if level.top[s]]
        more = {pair: number[0] for pair, number in self.further.items() if number[0]}
        extra = Level.of(list(more.values())) if more else Level.over([], 1)
        visits = Level(
            top=[*(level.top[s] for s in own), *extra.top],
            below=[*level.below, *extra.below],
            group=np.concatenate([level.group[own], extra.group + len(level.below)]),
        )
        return Flow(pairs=np.array([*self.policy.pairs[own], *more], dtype=np.int64), visits=visits)


class _Program:
    """The linear program of some limits; limit k is on `amount[k]`, of which more is better."""

    def __init__(self, of: Objectives, limits: Sequence[Limit]) -> None:
        self.of, self.limits, self.live = of, limits, ~of.rows.terminal
        self.amount = [of.names.index(limit.name) for limit in limits]
        self.sign = [of.sign * limit.sign for limit in limits]
        self.bound = [limit.sign * limit.bound for limit in limits]
        self.begin = [(s, ONE) for s in np.flatnonzero(self.live).tolist()]

    def solved(self) -> _Vertex:
        """Return an optimal vertex."""
        basis, vertex = self._first()
        while (entering := self._entering(basis, vertex)) is not None:
            basis = self._pivoted(basis, vertex, entering)
            vertex = self._vertex(basis)
        return vertex

    def _first(self) -> tuple[_Basis, _Vertex]:
        """Return a basis that floats propose, or that of the greatest return."""
        for short in (False, True):
            basis = self._proposed(short)
            if basis is not None:
                try:
                    vertex = self._vertex(basis)
                except ZeroDivisionError:
                    continue
                numbers = [*vertex.further.values(), *vertex.room]
                numbers += [self._number(vertex, s) for s in np.flatnonzero(self.live).tolist()]
                if min(numbers) >= NOTHING and (vertex.shift > NOTHING) is short:
                    return basis, vertex
        size = len(self.of.names)
        basis = _Basis(extreme(self.of, [1] + [0] * (size - 1)).pairs, [], [], False)
        vertex = self._vertex(basis)
        if min(vertex.room) < NOTHING:
            basis = basis._replace(binding=[vertex.room.index(min(vertex.room))], short=True)
            vertex = self._vertex(basis)
        return basis, vertex

    def _vertex(self, basis: _Basis) -> _Vertex:
        """Return the numbers of a basis; raises ZeroDivisionError where it is none."""
        of, binding, short = self.of, basis.binding, basis.short
        policy, count = attained(of, basis.pairs), len(basis.binding)
        gain = self._gains(policy, basis.further)
        spread = [value.mean(self.begin) if self.begin else ZERO for value in policy.values]
        lack = [
            (b - s * policy.total[k], -ONE, -s * spread[k])
            for k, s, b in zip(self.amount, self.sign, self.bound, strict=True)
        ]
        columns = [[gain[e][1 + k] for k in binding] for e in basis.further]
        columns += [[ONE] * count] * short
        if len(columns) != count:
            raise ZeroDivisionError
        matrix = flint.fmpq_mat([list(map(rational, row)) for row in columns]) if count else None
        numbers, prices = list[Number](), list[Fraction]()
        if matrix is not None:
            sides = flint.fmpq_mat([list(map(rational, lack[k])) for k in binding])
            for row in matrix.transpose().solve(sides).tolist():
                a, b, c = map(as_fraction, row)
                numbers.append((a, b, c))
            earned = [[rational(-gain[e][0] * (not short))] for e in basis.further]
            earned += [[rational(1)]] * short
            prices = list(map(as_fraction, matrix.solve(flint.fmpq_mat(earned)).entries()))
        shift = numbers.pop() if short else NOTHING
        further = dict(zip(basis.further, numbers, strict=True))
        price = [Fraction(not short)] + [ZERO] * len(self.limits)
        for k, own in zip(binding, prices, strict=True):
            price[1 + k] = own
        room = list[Number]()
        for k, right in enumerate(lack):
            more = [(gain[e][1 + k], y) for e, y in further.items()]
            a, b, c = (
                shift[i] + sum((g * y[i] for g, y in more), ZERO) - right[i] for i in range(3)
            )
            room.append((a, b, c))
        starts = [
            [*own, *self._sources({e: y[i] for e, y in further.items()}, basis.pairs)]
            for i, own in enumerate((of.mdp.start, [], self.begin))
        ]
        rows = of.rows.of_pairs(basis.pairs)
        visits = visited(rows, self.live, *starts)
        return _Vertex(policy, further, visits, room, shift, tuple(price))

    def _gains(self, policy: Attained, pairs: Sequence[int]) -> dict[int, list[Fraction]]:
        """Return what some pairs gain: of the reward, and of what each limit is on."""
        of, some = self.of, np.array(sorted(pairs), dtype=np.int64)
        each = []
        for amount, value in zip(of.amounts, policy.values, strict=True):
            ((top, below),) = surplus(replace(of.rows, constant=amount), value, pairs=some)
            each.append([Fraction(*number) for number in zip(top, below, strict=True)])
        limited = [[s * x for x in each[k]] for k, s in zip(self.amount, self.sign, strict=True)]
        rows = zip(*each[:1], *limited, strict=True)
        return dict(zip(some.tolist(), map(list, rows), strict=True))

    def _sources(self, taken: Mapping[int, Fraction], own: Integers) -> list[tuple[int, Fraction]]:
        """Return what comes into each state where pairs are taken in place of the states' own."""
        rows, arrivals = self.of.rows, list[tuple[int, Fraction]]()
        for pair, times in taken.items():
            state = int(rows.pair_state[pair])
            part = slice(rows.offsets[pair], rows.offsets[pair + 1])
            ahead = zip(rows.next[part].tolist(), rows.weight[part].tolist(), strict=True)
            unit = int(rows.scale[state])
            arrivals += [(state, -times), *((t, times * Fraction(w, unit)) for t, w in ahead)]
        return arrivals

    def _number(self, vertex: _Vertex, state: int) -> Number:
        """Return how often a state's own pair is taken."""
        a, b, c = (Fraction(v.top[state], v.below[v.group[state]]) for v in vertex.visits)
        return a, b, c

    def _entering(self, basis: _Basis, vertex: _Vertex) -> int | None:
        """Return the first variable that is worth more than it costs: a pair, or L + k."""
        whole, _ = common(_weights(self.of, self.limits, vertex.price))
        rows = replace(self.of.rows, constant=self.of.weighted(whole))
        own = np.append(basis.pairs, np.array(basis.further, dtype=np.int64))
        sign = signs(rows, combined(vertex.policy.values, whole), own)
        gaining = np.flatnonzero((sign > 0) & self.live[rows.pair_state])
        if len(gaining):
            return int(gaining[0])
        cheap = (k for k in sorted(basis.binding) if vertex.price[1 + k] < 0)
        first = next(cheap, None)
        return None if first is None else self.of.mdp.n_pairs + first

    def _pivoted(self, basis: _Basis, vertex: _Vertex, entering: int) -> _Basis:
        """Return the basis with a variable in place of the first one that it brings to 0."""
        pairs, pair_count = basis.pairs.copy(), self.of.mdp.n_pairs
        state = self.of.mdp.pair_state
        further, binding, short = [*basis.further], [*basis.binding], basis.short
        new = [entering] * (entering < pair_count)
        gain = self._gains(vertex.policy, [*further, *new])
        right = [-gain[entering][1 + k] if new else Fraction(k == entering - pair_count)
                 for k in binding]  # fmt: skip
        step = dict.fromkeys(new, ONE)
        rise = ZERO
        if binding:
            rows = [[gain[e][1 + k] for e in further] + [ONE] * short for k in binding]
            matrix = flint.fmpq_mat([list(map(rational, row)) for row in rows])
            side = flint.fmpq_mat([[rational(number)] for number in right])
            steps = list(map(as_fraction, matrix.solve(side).entries()))
            rise = steps.pop() if short else ZERO
            step |= dict(zip(further, steps, strict=True))
        (moves,) = visited(self.of.rows.of_pairs(pairs), self.live, self._sources(step, pairs))
        several = sorted({int(state[e]) for e in step})
        falling = [(-1, vertex.shift, rise)] * short
        falling += [(e, vertex.further[e], step[e]) for e in further]
        falling += [
            (
                int(pairs[s]),
                self._number(vertex, s),
                Fraction(moves.top[s], moves.below[moves.group[s]]),
            )
            for s in several
        ]
        for k, room in enumerate(vertex.room):
            if k not in binding:
                change = rise + sum((gain[e][1 + k] * y for e, y in step.items()), ZERO)
                falling.append((pair_count + k, room, change))
        ends = [
            (tuple(part / -move for part in number), index)
            for index, number, move in falling
            if move < 0
        ]
        _, leaving = min(ends)
        further += new
        if not new:
            binding.remove(entering - pair_count)
        if leaving < 0:
            short = False
        elif leaving >= pair_count:
            binding.append(leaving - pair_count)
        else:
            if leaving not in further:
                other = min(e for e in further if state[e] == state[leaving])
                pairs[state[leaving]], leaving = other, other
            further.remove(leaving)
        return _Basis(pairs, further, sorted(binding), short)

    def _proposed(self, short: bool) -> _Basis | None:
        """Return the basis that floats find: of the optimum, or of the least step of the limits."""
        from scipy import optimize

        of, state, size = self.of, self.of.mdp.pair_state, self.of.mdp.n_states
        rows, live = of.rows, self.live[state]
        if not self.live.any():
            return None
        scale = rows.scale[state].astype(object)
        try:
            share = live[rows.pair] * (rows.weight / scale[rows.pair]).astype(np.float64)
            each = [live * (own / scale).astype(np.float64) for own in of.amounts]
            bound = np.array([float(number) for number in self.bound])
        except OverflowError:  # beyond the floats, which only suggest a basis
            return None
        moves = sp.csr_array((share, rows.next, rows.offsets), shape=(len(state), size))
        stays = sp.csr_array((live * 1.0, (state, np.arange(len(state)))), (size, len(state)))
        start, inside = np.zeros(size), np.flatnonzero(self.live)
        for s, chance in of.mdp.start:
            start[s] = float(chance)
        limited = np.array([s * each[k] for k, s in zip(self.amount, self.sign, strict=True)])
        program = optimize.linprog(
            np.append(-each[0] * (not short), float(short)),
            A_eq=sp.hstack([(stays - moves.T).tocsr()[inside], sp.csr_array((len(inside), 1))]),
            b_eq=start[inside],
            A_ub=sp.csr_array(-np.hstack([limited, np.full((len(limited), 1), float(short))])),
            b_ub=-bound,
            bounds=(0, None),
            method="highs-ds",
            options={"maxiter": PIVOTS * size},
        )
        if program.status != 0:
            return None
        visits, price = program.x[:-1] * live, np.abs(program.ineqlin.marginals)
        exactly = [Fraction(not short), *map(Fraction, price.tolist())]
        whole, _ = common(_weights(of, self.limits, exactly))
        weighted = replace(rows, constant=of.weighted(whole))
        pairs = nearly(weighted, of.mdp.pair_offsets[:-1]).copy()
        taken = np.flatnonzero(visits > NOISE * visits.sum())
        taken = taken[np.lexsort((visits[taken], state[taken]))]  # the most visited of a state last
        last = np.diff(state[taken], append=-1) != 0
        pairs[state[taken[last]]] = taken[last]
        further = taken[~last].tolist()
        count = len(further) + short
        binding = np.lexsort((limited @ visits - bound, -price))[:count]
        return _Basis(pairs, further, sorted(binding.tolist()), short)
