"""The optimum under limits on expected totals, exactly: a constrained Markov decision process.

    maximise  r(π)   subject to   c_k(π) ≥ b_k,  k = 1 … m,     over all policies π

The totals of any policy are a mixture of the totals of deterministic policies. A linear program
mixes the policies known so far; its prices p weigh the totals, and the policy that is best for
r + p c is added, until no policy exceeds the mixture by these weights (Dantzig and Wolfe,
Operations Research 8, 1960). The optimal value μ V for these weights is then the proof: no policy
that keeps the limits earns more than μ V - p b. If no policy keeps the limits, the least step t by
which all limits have to be moved is minimised in place of the return, and prices sum to 1.

The visits of the mixture are the visits of one policy, which randomises in at most as many states
as there are binding limits (Altman, Constrained Markov Decision Processes, 1999, theorem 3.8).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from operator import sub
from typing import Any, ClassVar

import flint
import numpy as np

from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.forms.names import find_free_name
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.choices import of_every_state
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import DataFrame, data_frame
from exact_mdp.mdp.table import Integers, Numbers, exact, format_rational, to_common_denominator
from exact_mdp.solvers.bounds.gains import first_of
from exact_mdp.solvers.claims import Certified
from exact_mdp.solvers.exact.duals import weigh_values
from exact_mdp.solvers.exact.levels import (
    Level,
    combine_levels,
    compute_surplus_signs,
    list_level_steps,
)
from exact_mdp.solvers.objectives.amounts import Objectives, read_objectives, reward_name
from exact_mdp.solvers.objectives.averages import reduce_to_totals
from exact_mdp.solvers.objectives.simplex import list_unit_vectors, solve_linear_program
from exact_mdp.solvers.objectives.totals import (
    Attained,
    OccupancyMeasure,
    Point,
    TotalsProof,
    evaluate_objectives,
    flow_under,
    list_proof_fields,
    solve_weighted,
)

ZERO, ONE = Fraction(0), Fraction(1)
LIMIT = re.compile(r"\s*(>=|<=)\s*(\S+)\s*$")


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A total is at least (sign 1) or at most (sign -1) a bound."""

    name: str
    sign: int
    bound: Fraction

    def __str__(self) -> str:
        return self.format_limit()

    def format_limit(self, digits: int | None = None) -> str:
        """Return the limit as text, with its bound in decimals if a number of digits is given."""
        bound = str(self.bound)
        if digits is not None:
            bound = format_rational(self.bound, digits)
        relation = "<="
        if self.sign > 0:
            relation = ">="
        return f"{self.name} {relation} {bound}"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ConstrainedSolution(TotalsProof):
    """The optimum under limits and its proof, or a proof that no policy keeps them.

    Attributes
    ----------
    objectives : tuple of str
        The reward, then the limited amounts.
    limits : tuple of Limit
    feasible : bool
        Whether some policy keeps all limits.
    flow : OccupancyMeasure
        Expected visits of pairs under the optimal policy, or a policy that keeps the moved limits.
    price : tuple of Fraction
        The shadow price of each limit: the optimum gains this for each unit by which the limit is
        relaxed. If no policy keeps the limits, the weights that prove it.
    dual : Level
        Upper bounds on the values of all policies, for the limits weighted by their prices and, if
        feasible, the reward.
    shift : Fraction
        The least t such that a policy keeps all limits relaxed by t; 0 if feasible.

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
    flow: OccupancyMeasure
    price: tuple[Fraction, ...]
    dual: Level
    shift: Fraction

    kinds: ClassVar[tuple[str, ...]] = ("limits",)

    def __repr__(self) -> str:
        limits = ", ".join(map(str, self.limits))
        if self.start_value is None:
            return f"ConstrainedSolution(no policy keeps {limits}; certified)"
        return f"ConstrainedSolution({float(self.start_value):.12g} with {limits}; certified)"

    def _read_objectives(self, mdp: MDP) -> Objectives:
        names, _ = read_objectives(mdp, self.objectives)
        known = [limit for limit in self.limits if limit.name in names]  # a proof may be forged
        each = [(names.index(limit.name), limit) for limit in known]
        return Objectives(mdp, self.objectives, _orient_limits(mdp, each))

    def _list_flows(self) -> list[OccupancyMeasure]:
        return [self.flow]

    @cached_property
    def totals(self) -> dict[str, Fraction]:
        """The policy's totals of the limited amounts."""
        return dict(zip(self.of.names[1:], self._totals[1:], strict=True))

    @property
    def start_value(self) -> Fraction | None:
        """The optimum, which the policy attains; None if no policy keeps the limits."""
        if self.feasible:
            return self._totals[0]
        return None

    @property
    def start(self) -> Certified | None:
        """The optimum as a certified number; None if no policy keeps the limits."""
        if self.start_value is None:
            return None
        return Certified(value=self.start_value)

    @cached_property
    def _totals(self) -> Point:
        return tuple(self.of.sign * value for value in self.flow.compute_totals(self.of))

    @property
    def prices(self) -> dict[str, Fraction]:
        """The shadow price of each limit by name; two limits on one name are added up."""
        total = dict.fromkeys(self.of.names[1:], ZERO)
        for limit, price in zip(self.limits, self.price, strict=True):
            total[limit.name] += price
        return total

    @property
    def closest(self) -> dict[str, Fraction]:
        """The closest limits that can be kept, by name, or by limit if a name has several."""
        return name_bounds(self.limits, self.moved)

    @property
    def moved(self) -> tuple[Limit, ...]:
        """The limits, all relaxed by the least step with which a policy keeps them."""
        return tuple(replace(x, bound=x.bound - x.sign * self.shift) for x in self.limits)

    @property
    def weights(self) -> list[Fraction]:
        """The weight of each objective, given the prices of the limits."""
        return _weigh_objectives(self.of, self.limits, (Fraction(self.feasible), *self.price))

    @cached_property
    def randomises(self) -> dict[int, dict[str, Fraction]]:
        """The states in which the policy draws its action: {state: {action: probability}}."""
        mdp, drawn = self.of.given, {}
        for state, own in self._chances.items():
            if len(own) > 1:
                drawn[state] = {mdp.actions[mdp.pair_action[l]]: p for l, p in own.items()}
        return drawn

    @cached_property
    def _chances(self) -> dict[int, dict[int, Fraction]]:
        """The probability of each pair that is taken, by state."""
        of = self.of
        # An optimal pair has the advantage 0 over the dual values. In visited states the flow
        # decides.
        rows, unit = of.rows_for(self.weights)
        steps, *_ = list_level_steps(rows, combine_levels([self.dual], [unit]))
        best = first_of(of.mdp, compute_surplus_signs(rows, steps) == 0)
        return of.lift_chances(best, self.flow.compute_action_probabilities(of))

    @cached_property
    def rule(self) -> Numbers:
        """(S, A) Fractions, the probability of each action.

        In states that are never visited, the first action that is optimal for the reward and the
        prices.
        """
        mdp = self.of.given
        rule = np.full((mdp.n_states, mdp.n_actions), ZERO, dtype=object)
        for state, own in self._chances.items():
            for pair, chance in own.items():
                rule[state, mdp.pair_action[pair]] = chance
        return rule

    @cached_property
    def policy(self) -> Policy:
        """The policy, with its exact probabilities."""
        mdp = self.of.given
        return Policy(space=mdp.space, actions=mdp.actions, rule=self.rule)

    def report(self) -> Report:
        """Return the report of the optimum, or of the proof that no policy keeps the limits."""
        mdp, limits, feasible = self.of.given, self.limits, self.feasible
        drawn = []
        for row in self.rule:
            drawn.append({mdp.actions[a]: c for a, c in enumerate(row) if c})
        if feasible:
            said, error_bound = ["they can be kept"], Shown(0.0)
        else:
            said, error_bound = ["no policy keeps them all (proven)"], Shown(None)
        # Name a lower limit above an upper limit on the same total.
        for low in limits:
            for high in limits:
                opposed = (low.name, low.sign, high.sign) == (high.name, 1, -1)
                if opposed and low.bound > high.bound:
                    said.append(f"{low} and {high} contradict each other, whatever the model")
        labels = {state: mdp.space.label(state) for state in self.randomises}
        facts = {
            "method": "limits",
            "claim": Shown(self.claim),
            "feasible": Shown(feasible, "; ".join(said)),
            "start_value": Shown(self.start and float(self.start), self.start),
            "error_bound": error_bound,
            "exact_start_value": self.start_value,
            "limits": Shown([str(limit) for limit in limits]),
            "totals": Shown(self.totals),
            "prices": Shown(self.prices),
            "closest": Shown(self.closest),
            "randomises": Shown(
                [{"state": labels[s], "actions": each} for s, each in self.randomises.items()],
                [*labels.values()],
            ),
            "policy": Shown(of_every_state(mdp, drawn)),
        }
        tables = {"moved": self.table(self.totals)}
        return Report(title="optimum under limits", facts=facts, tables=tables, passed=feasible)

    def table(self, totals: Mapping[str, Fraction], keeps: Sequence[str] = ()) -> Table:
        """Return a table of limits, a policy's totals, and prices or the closest possible limits.

        `keeps` has a word for each limit that says whether the policy keeps it.
        """
        near = [limit.format_limit(10) for limit in self.moved]
        each = zip(self.limits, self.price, near, keeps or near, strict=True)
        rows = []
        for x, price, moved, word in each:
            rows.append(
                {
                    "limit": str(x),
                    "total": totals[x.name],
                    "price": price,
                    "closest": moved,
                    "kept": word,
                }
            )
        columns = {"limit": "limit", "total": "total:.10g"}
        if keeps:
            columns["kept"] = "kept"
        if self.feasible:
            note = "price: what the optimum gains if the limit is moved by one point"
            columns |= {"price": "price:.10g"}
        else:
            note = "closest: all moved by the same step, the least with which a policy keeps them"
            columns |= {"closest": "closest"}
        return Table(title="limits", rows=rows, columns=columns, note=note)

    def frame(self) -> DataFrame:
        """Return one row for each limit: the total, the price, and the closest limit."""
        each = zip(self.limits, self.price, self.moved, strict=True)
        rows = [(str(x), self.totals[x.name], price, moved.bound) for x, price, moved in each]
        return data_frame(rows, columns=["limit", "total", "price", "closest"])


def name_bounds(limits: Sequence[Limit], moved: Sequence[Limit]) -> dict[str, Fraction]:
    """Return the bounds of moved limits, by name, or by the limit if a name has several."""
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
    for name, given in subject_to.items():
        texts = [given]
        if isinstance(given, list | tuple):
            texts = [*given]
        # An empty list is refused as an empty text.
        for text in texts or [""]:
            parts = LIMIT.match(str(text))
            if parts is None:
                raise ModelError(
                    f"{text!r} is not a limit",
                    where=f"subject_to {name!r}",
                    fix='write a text with >= or <=, such as ">= -1/2" or "<= 1/20"',
                )
            if parts[1] == ">=":
                sign = 1
            else:
                sign = -1
            with locate_errors(f"subject_to {name!r}"):
                limits.append(Limit(name=str(name), sign=sign, bound=exact(parts[2])))
    return tuple(limits)


def solve_under(
    mdp: MDP, subject_to: Mapping[str, Any], *, average: bool = False
) -> ConstrainedSolution:
    """Return the optimum under limits, of totals or of averages per step; see `solve`."""
    given = limits_of(subject_to)
    names = list(dict.fromkeys(limit.name for limit in given))
    # The return needs a name that no limit has.
    title = find_free_name("return", [name.partition("=")[0].strip() for name in names])
    each = [(1 + names.index(limit.name), limit) for limit in given]
    amounts: Sequence[str] = names
    if average:
        mdp, amounts = reduce_to_totals(mdp, names)
    texts = [f"{title}={reward_name(mdp)}", *amounts]
    of = Objectives(mdp, texts, _orient_limits(mdp, each))
    limits = tuple(replace(x, name=of.names[1 + names.index(x.name)]) for x in given)
    shares, shift, price, dual = _combine_policies(of, limits)
    solution = ConstrainedSolution(
        limits=limits,
        feasible=price[0] == 1,
        flow=_as_one(of, limits, shares, shift),
        price=price[1:],
        dual=dual,
        shift=shift,
        **list_proof_fields(of, "limits"),
    )
    if of.reduced:
        assert solution.policy  # raises an error if no policy of the model does the same
    return solution


def _orient_limits(mdp: MDP, limits: Sequence[tuple[int, Limit]]) -> list[tuple[int, int]]:
    """Return whether more or less is better of the reward and of each limited total, by number."""
    return [(0, 1), *((number, mdp.sense.sign * limit.sign) for number, limit in limits)]


def _weigh_objectives(
    of: Objectives, limits: Sequence[Limit], price: Sequence[Fraction]
) -> list[Fraction]:
    """Return the weight of each objective, given the prices of the reward and of the limits."""
    weights = [price[0]] + [ZERO] * (len(of.names) - 1)
    for limit, own in zip(limits, price[1:], strict=True):
        weights[of.names.index(limit.name)] += of.sign * limit.sign * own
    return weights


def _orient_totals(of: Objectives, limits: Sequence[Limit], totals: Point) -> list[Fraction]:
    """Return the total of each limit, with the sign that makes more better."""
    return [of.sign * limit.sign * totals[of.names.index(limit.name)] for limit in limits]


Shares = list[tuple[Attained, Fraction]]


def _combine_policies(
    of: Objectives, limits: Sequence[Limit]
) -> tuple[Shares, Fraction, tuple[Fraction, ...], Level]:
    """Return the best mixture, the step of the limits, prices of reward and limits, and values."""
    # Phase 1 (`short`) minimises the step t; if it reaches 0, phase 2 maximises the return.
    size, short = len(limits), True
    reward = [1] + [0] * (len(of.names) - 1)
    policies = [evaluate_objectives(of, solve_weighted(of, reward)[0])]
    spare = [[ZERO, *row] for row in list_unit_vectors(size, -ONE)]
    bounds = [limit.sign * limit.bound for limit in limits]
    while True:
        # The column of a policy: 1, as shares sum to 1, and its room below or above each limit.
        columns = []
        for own in policies:
            columns.append([ONE, *map(sub, _orient_totals(of, limits, own.total), bounds)])
        # A spare column for each limit, as room may be left; in phase 1 one for the step t.
        columns += spare
        if short:
            columns.append([ZERO] + [ONE] * size)
            earned = [ZERO] * (len(policies) + size) + [-ONE]
        else:
            earned = [policy.total[0] for policy in policies] + [ZERO] * size
        x, (most, *due) = solve_linear_program(earned, columns, [ONE] + [ZERO] * size)
        shift = ZERO
        if short:
            shift = x[-1]
            if not shift:
                short = False
                continue
        # The prices choose the next policy; if it brings no more than the mixture, that is optimal.
        price = (Fraction(not short), *(-each for each in due))
        pairs, dual = solve_weighted(of, _weigh_objectives(of, limits, price), policies[-1].pairs)
        if dual.compute_mean(of.mdp.start) == most + weigh_values(price[1:], bounds):
            shares = []
            for each in zip(policies, x, strict=False):
                if each[1]:
                    shares.append(each)
            return shares, shift, price, dual
        policies.append(evaluate_objectives(of, pairs))


def _as_one(
    of: Objectives, limits: Sequence[Limit], shares: Shares, shift: Fraction
) -> OccupancyMeasure:
    """Return the visits of one policy that earns as much as a mixture."""
    # A vertex of the polytope of visits has one pair for each state, and at most as many further
    # pairs as there are binding limits. With more pairs, some direction changes the visits but not
    # the totals of the binding limits. Move along it until a pair is not taken any more or another
    # limit binds.
    taken = dict[int, Fraction]()
    for policy, share in shares:
        for pair, number in flow_under(of, policy.pairs).to_numbers().items():
            taken[pair] = taken.get(pair, ZERO) + share * number
    own = shares[0][0].pairs.copy()
    while True:
        # The pair of each state that is taken most often, and some further pairs.
        most = sorted(taken, key=lambda pair: (float(taken[pair]), -pair))
        if of.reduced:  # these may go round forever: take those that lead nearer to the end
            own = of.first.copy()
            of.choose_ending_pairs(np.array(most), own)
        else:
            own[of.rows.pair_state[most]] = most
        further = sorted(taken.keys() - {*own.tolist()})[: len(limits) + 1]
        flow = OccupancyMeasure.of(taken)
        # The room of each limit, and how each exchange of pairs changes its total.
        totals = _orient_totals(of, limits, flow.compute_totals(of))
        room = []
        for reached, limit in zip(totals, limits, strict=True):
            room.append(reached - limit.sign * limit.bound + shift)
        moves = [_exchange_pair(of, pair, own) for pair in further]
        changes = []
        for move in moves:
            total = OccupancyMeasure.of(move).compute_totals(of)
            changes.append(_orient_totals(of, limits, total))
        gains = [*zip(*changes, strict=True)]
        # A direction in the null space of the binding limits; none is left at a vertex.
        tight = []
        for gain, left in zip(gains, room, strict=False):
            if not left:
                tight.append(to_common_denominator(gain)[0])
        free, count = flint.fmpz_mat([[0] * len(further), *tight]).nullspace()
        if not count:
            return flow
        times = [Fraction(int(free[i, 0])) for i in range(len(further))]
        change = {}
        for l in taken:
            change[l] = weigh_values(times, [x.get(l, ZERO) for x in moves])
        # The longest step that keeps all limits and all visits at least 0.
        falling = []
        for gain, left in zip(gains, room, strict=True):
            if left:
                falling.append((left, weigh_values(times, gain)))
        falling += [(taken[pair], step) for pair, step in change.items()]
        length = min(left / -step for left, step in falling if step < 0)
        moved = {pair: left + length * change[pair] for pair, left in taken.items()}
        taken = {pair: left for pair, left in moved.items() if left}


def _exchange_pair(of: Objectives, pair: int, own: Integers) -> dict[int, Fraction]:
    """Return the change of visits if a pair is taken once in place of its state's own pair."""
    # One visit less of the state itself, and the visits of the policy after the pair's outcomes.
    rows = of.rows
    state, part = int(rows.pair_state[pair]), slice(rows.offsets[pair], rows.offsets[pair + 1])
    unit = int(rows.scale[state])
    ahead = [Fraction(weight, unit) for weight in rows.weight[part].tolist()]
    sources = [(state, -ONE), *zip(rows.next[part].tolist(), ahead, strict=True)]
    return {pair: ONE} | flow_under(of, own, sources).to_numbers()
