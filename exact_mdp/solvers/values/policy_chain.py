"""The Markov chain of a policy: its transitions, rewards, graph and equations.

    P_π(s, s') = Σ_l π(l | s) P(l, s'),     l over the pairs of s that π takes,

together with the outcomes behind it, as the spread of a return depends on the joint distribution
of next state and reward. Probabilities of actions are the exact numbers given (a float stands for
its own value), divided by their exact sum. A state *ends* if a terminal state is reached from it
with probability 1: if no state can be reached that has no way to a terminal state (Puterman, Markov
Decision Processes, 1994, A.2). Other policies of the model need not end.

A recurrent class without rewards or events counts as an end for the return; only the number of
steps is then infinite. In a class with an average reward other than 0 the return is +∞ or -∞; a
run that misses its goal also has an infinite return. The value of any policy is the optimum of the
model in which the policy's actions are the only ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from math import inf

import numpy as np
import scipy.sparse as sp

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import BellmanRows, bellman_rows, lcm_by_group
from exact_mdp.mdp.graph import Mask, find_reachable_nodes, find_start_states
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, PolicyLike, ReadAs
from exact_mdp.mdp.questions.advice import ways_out
from exact_mdp.mdp.questions.ending import make_terminal
from exact_mdp.mdp.table import (
    FLOAT_ROW_TOLERANCE,
    Floats,
    Integers,
    Numbers,
    OutcomeTable,
    Rows,
    divide,
    exact,
    make_ones,
    multiply,
    row_sums,
    to_dyadic_integers,
)
from exact_mdp.solvers.arguments import Criterion
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, BoundedVector, component_errors, gamma
from exact_mdp.solvers.bounds.linear import LinearSystem, select_rows, transpose_system
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.endless.chain import Classes, ExactChain, FloatChain, long_run
from exact_mdp.solvers.endless.quotient import of_pairs
from exact_mdp.solvers.exact.levels import Level
from exact_mdp.solvers.exact.linear import (
    FEW,
    MANY,
    build_equations,
    compute_expected_visits,
    evaluate_exactly,
    solve_policy_equations,
)
from exact_mdp.solvers.solution import Valued


def policy_of(
    model: MDP,
    policy: PolicyLike,
    *,
    kind: str = "auto",
    criterion: Criterion = "total",
) -> Policy:
    """Return the policy of any form that `Policy.of` takes; for "optimal" the model is solved."""
    if isinstance(policy, str) and policy == "optimal":
        import exact_mdp

        policy = exact_mdp.solve(model, criterion=criterion)
    return Policy.of(model, policy, kind=kind)


@dataclass(frozen=True, kw_only=True, eq=False)
class PolicyChain:
    """A model under one policy; its parts are computed on first use."""

    mdp: MDP
    chosen: Floats  # (L,) probabilities of pairs; in each state they sum to 1, up to rounding
    policy: Policy | None = None  # the source of `chosen`, with the exact probabilities

    @classmethod
    def of(
        cls,
        mdp: MDP,
        policy: PolicyLike | PolicyChain,
        *,
        kind: str = "auto",
        criterion: Criterion = "total",
    ) -> PolicyChain:
        """Return the chain of a policy in any form that `evaluate` takes.

        Beside the forms of `Policy.of`, these are "optimal" (the model is solved, by `criterion`),
        a solution or a certificate (its policy is taken), a chain of this model, and (L,)
        probabilities of pairs.
        """
        if isinstance(policy, PolicyChain):
            if policy.mdp is not mdp:
                raise ModelError(
                    "the policy was read for another model",
                    where="policy",
                    fix="give the policy itself",
                )
            return policy
        wanted = (mdp.n_pairs,)
        if isinstance(policy, np.ndarray) and policy.dtype.kind == "f" and policy.shape == wanted:
            return cls(mdp=mdp, chosen=_require_weights(mdp, policy))
        return cls.of_policy(mdp, policy_of(mdp, policy, kind=kind, criterion=criterion))

    @classmethod
    def of_policy(cls, mdp: MDP, policy: Policy) -> PolicyChain:
        """Return the chain of a policy that was read for this model."""
        return cls(mdp=mdp, chosen=policy.weights(mdp), policy=policy)

    @classmethod
    def of_pairs(cls, mdp: MDP, pairs: Integers) -> PolicyChain:
        """Return the chain of the deterministic policy that takes these pairs (S,)."""
        return cls(mdp=mdp, chosen=np.bincount(pairs, minlength=mdp.n_pairs).astype(float))

    @classmethod
    def held_fixed(cls, mdp: MDP, policy: PolicyLike) -> tuple[PolicyChain, Mask]:
        """Return the chain of a policy that is kept in other models, and its undecided states.

        These (S,) have a choice that the policy leaves open because it does not matter in this
        model. An optimum does not decide in states without any further reward.
        """
        chain = cls.of(mdp, policy)
        open_ = np.zeros(mdp.n_states, dtype=bool)
        if isinstance(policy, Valued) or (isinstance(policy, str) and policy == "optimal"):
            open_ = mdp.over & ~mdp.forced
        elif chain.policy is not None:
            open_ = chain.policy.find_undecided(mdp)
        return chain, open_

    def require_said(self, undecided: Mask, where: str) -> None:
        """Raise ModelError if the choice of an action in some states (S,) matters in this model."""
        mdp = self.mdp
        matters = undecided & mdp.ends.choice_matters & self.reached
        if matters.any():
            raise ModelError(
                "the policy held fixed names no action in a state where the choice does not matter "
                "today, but matters here",
                where=f"{mdp.space.place(int(matters.argmax()))}, {where}",
                fix="give an action there, too, by a mapping or an array over all states",
            )

    # ---- outcomes ----------------------------------------------------------------------------

    @cached_property
    def weights(self) -> Floats:
        """(L,) probability of each pair given its state; sums to 1 over the pairs of a state."""
        shares, mdp = self._shares, self.mdp
        total = np.add.reduceat(shares, mdp.pair_offsets[:-1])[mdp.pair_state]
        if shares.dtype == np.float64:
            return np.asarray(shares / total)
        return divide(shares, total)

    @cached_property
    def _shares(self) -> Numbers:
        """(L,) integers or floats in exact proportion to the probabilities."""
        if self.policy is None:
            exactly = None
        else:
            exactly = self.policy.weights_exact(self.mdp)
        if exactly is None:
            return self.chosen
        return exactly

    def exact_weights(self, state: int) -> dict[int, Fraction]:
        """Return the exact probability of each pair that is taken in a state."""
        given = self._shares
        shares = {pair: exact(given[pair]) for pair in self.mdp.pairs_of(state) if given[pair]}
        total = sum(shares.values(), Fraction(0))
        return {pair: weight / total for pair, weight in shares.items()}

    @cached_property
    def pairs(self) -> Integers:
        """(U,) the pairs that the policy takes."""
        return np.flatnonzero(self.chosen)

    @cached_property
    def roundings(self) -> int:
        """The most roundings between an exact probability and its float."""
        # The rows of n pairs are added up, and so is the total that weights are divided by: n each.
        if self.pure:
            return 1
        return 2 * int(np.bincount(self.mdp.pair_state[self.pairs]).max()) + 2

    @property
    def read_as(self) -> ReadAs:
        """How an array was read: as "q" or as "policy"."""
        if self.policy is None:
            return "policy"
        return self.policy.read_as

    @cached_property
    def pure(self) -> bool:
        """Whether the policy takes a single pair in each state."""
        return len(self.pairs) == self.mdp.n_states

    @cached_property
    def table(self) -> OutcomeTable:
        """The exact outcomes of the pairs that the policy takes, N in all."""
        return self.mdp.table.of_pairs(self.pairs)

    @cached_property
    def source(self) -> Integers:
        """(N,) the state in which each outcome happens."""
        return np.repeat(self.mdp.pair_state[self.pairs], np.diff(self.table.offsets))

    @cached_property
    def probability(self) -> Floats:
        """(N,) the probability of each outcome in its state."""
        share = np.repeat(self.weights[self.pairs], np.diff(self.table.offsets))
        return np.asarray(share * self.table.compute_probabilities())

    @cached_property
    def gain(self) -> Floats:
        """(N,) the reward of each outcome, rounded once."""
        return self.table.compute_gains()

    @cached_property
    def outcomes(self) -> Integers:
        """(S,) the number of outcomes of each state."""
        return np.bincount(self.source)

    def sum_by_state(self, amounts: Floats) -> Floats:
        """Return (S,) the sums of (N,) amounts by state."""
        return np.asarray(np.bincount(self.source, weights=amounts), dtype=np.float64)

    @cached_property
    def reward(self) -> tuple[Floats, Floats]:
        """(S,) the expected reward of each state, and a bound on its error."""
        mdp = self.mdp
        # A reward that belongs to its pair is a single rounded number.
        if self.pure and len(mdp.table.gain) == mdp.n_pairs:
            earned = mdp.reward[self.pairs]
            return earned, UNIT * np.abs(earned) + TINY * (mdp.table.gain[self.pairs] != 0)
        with np.errstate(over="ignore"):  # overflow is refused when the equations are solved
            earned = np.add.reduceat(self.weights * mdp.reward, mdp.pair_offsets[:-1])
        # A sum of n products: γ(n + k) times the sum of absolute values. A 0 is exact.
        error = self.sum_by_state(self.probability * np.abs(self.gain))
        earning = self.sum_by_state(self.gain != 0)
        return earned, gamma(self.outcomes + self.roundings + 4) * error + TINY * earning

    # ---- graph -------------------------------------------------------------------------------

    @cached_property
    def transition(self) -> sp.csr_array:
        """(S, S) probabilities; the rows of terminal states are empty."""
        mdp, live = self.mdp, ~self.mdp.terminal
        if self.pure:
            return select_rows(mdp.transition, self.pairs, live)
        # P_π = Π P, where row s of Π has the probabilities of the pairs of s.
        used = self.pairs[live[mdp.pair_state[self.pairs]]]
        shape = (mdp.n_states, mdp.n_pairs)
        mixing = sp.csr_array((self.weights[used], (mdp.pair_state[used], used)), shape)
        chain = mixing @ mdp.transition
        chain.sort_indices()
        return chain

    @cached_property
    def graph(self) -> sp.csr_array:
        """(S, S) entries where a transition is possible, however rare."""
        # The rows of a model have an entry for each outcome, even if it underflows to 0; products
        # with the probabilities of actions may lack it, and the outcomes then have the edges.
        if self.pure or self.probability.min() > 0:
            return self.transition
        moves = np.where(self.mdp.terminal, 0, self.outcomes)
        following = self.table.next[~self.mdp.terminal[self.source]]
        parts = np.ones(len(following)), following, np.append(0, np.cumsum(moves))
        graph = sp.csr_array(parts, self.transition.shape)
        graph.sum_duplicates()
        return graph

    @property
    def order(self) -> Integers | None:
        """(S,) numbers that fall along every transition; None if the model has cycles."""
        return self.mdp.ends.most_steps

    @cached_property
    def reached(self) -> Mask:
        """(S,) True for states that the policy can visit, the start included."""
        return find_reachable_nodes(self.graph, find_start_states(self.mdp))

    def may_reach(self, states: Mask) -> Mask:
        """Return (S,) True where the policy may reach some states (S,), these included."""
        if not states.any():
            return np.zeros_like(states)
        return find_reachable_nodes(self.graph.T.tocsr(), states)

    @cached_property
    def stuck(self) -> Mask:
        """(S,) True where no terminal state can be reached any more."""
        if self.order is not None:
            return np.zeros(self.mdp.n_states, dtype=bool)
        return ~self.may_reach(self.mdp.terminal)

    @cached_property
    def proper(self) -> Mask:
        """(S,) True where the policy reaches a terminal state with probability 1."""
        return ~self.may_reach(self.stuck)

    @cached_property
    def reaches_goal(self) -> Mask:
        """(S,) True where the policy ends with probability 1 and never misses a goal."""
        return self.proper & ~self.may_reach(self.mdp.ends.outside_goal)

    @property
    def ends_from_start(self) -> bool:
        """Whether every episode ends with probability 1."""
        return bool(self.proper[find_start_states(self.mdp)].all())

    @property
    def reaches_goal_from_start(self) -> bool:
        """Whether every episode ends with probability 1, and none misses a goal."""
        return bool(self.reaches_goal[find_start_states(self.mdp)].all())

    @cached_property
    def going_on(self) -> FloatChain:
        """The chain at discount 1, in which terminal states go on forever."""
        weights = self.weights[self.pairs]
        return FloatChain(self.mdp.undiscounted, self.pairs, weights, self.roundings)

    @property
    def classes(self) -> Classes:
        """The recurrent classes, terminal states among them."""
        return self.going_on.classes

    @property
    def stays_unrewarded(self) -> Mask:
        """(S,) True in recurrent classes without any reward or event."""
        busy = self.gain != 0
        if self.table.event is not None:
            busy = busy | (self.table.event != 0)
        # A class is active if one of its states is; what terminal states say does not count.
        acts = np.bincount(self.source[busy], minlength=self.mdp.n_states) > 0
        inside, own = self.classes.recurrent, self.classes.own
        active = np.bincount(own, acts & inside & ~self.mdp.terminal) > 0
        return np.asarray(inside & ~active[own])

    # ---- equations ---------------------------------------------------------------------------

    def build_equations(self, rate: Fraction) -> PolicyEquations:
        """Return x = c + rate · P_π x, at rate 1 in states that end; x = 0 in other states."""
        # At rate 1 the equations have a single solution only among states that end.
        if rate == 1:
            live = self.proper & ~self.mdp.terminal
        else:
            live = ~self.mdp.terminal
        inner = select_rows(self.transition, np.arange(len(live)), live, inner=True)
        system = LinearSystem(inner, float(rate), order=self.order, roundings=self.roundings)
        return PolicyEquations(self, live, system, partial(self.build_bellman_rows, rate))

    @cached_property
    def undiscounted(self) -> PolicyEquations:
        """Equation x = c + P_π x on the states that end; the others have empty rows."""
        return self.build_equations(Fraction(1))

    @cached_property
    def discounted(self) -> PolicyEquations:
        """Equation x = c + γ P_π x; at discount 1 on the states that end."""
        rate = self.mdp.discount_exact
        if rate == 1:
            return self.undiscounted
        return self.build_equations(rate)

    # ---- exact numbers -----------------------------------------------------------------------

    @cached_property
    def exact_outcomes(self) -> tuple[Numbers, Numbers]:
        """(N,), (S,) integers: numerators of outcomes, and one denominator for each state."""
        share, (weight, below) = self._shares[self.pairs], self.table.rows.integers
        if share.dtype == np.float64:
            share, _ = to_dyadic_integers(share, self._first)
        # Bring the pairs of a state over a common denominator; then divide by the sum of shares.
        unit, each = self._over_common(below)
        outcomes = multiply(weight, multiply(share, each)[self.table.pair])
        return outcomes, multiply(unit, row_sums(share, self._first))

    @cached_property
    def _first(self) -> Integers:
        """(S+1,) where the pairs of each state begin among those that are taken."""
        return np.searchsorted(self.mdp.pair_state[self.pairs], np.arange(self.mdp.n_states + 1))

    def _over_common(self, below: Numbers) -> tuple[Numbers, Numbers]:
        """Return a common multiple (S,) of denominators (U,) of pairs, and its factors (U,)."""
        unit = lcm_by_group(below, self._first)
        return unit, np.repeat(unit, np.diff(self._first)) // below

    def build_bellman_rows(self, rate: Fraction | None = None) -> BellmanRows:
        """Return the equations of the chain in integers, at another discount if one is given."""
        mdp, pairs = self.mdp, self.pairs
        if not self.pure:
            mdp, pairs = self.model, np.arange(self.mdp.n_states)
        if rate not in (None, mdp.discount_exact):
            mdp = mdp.with_(discount=rate)
        # The rows of a model are cached: a pure policy selects among them.
        return bellman_rows(mdp).of_pairs(pairs)

    @cached_property
    def model(self) -> MDP:
        """The model in which the policy's choices are the only ones."""
        mdp, table = self.mdp, self.table
        if self.pure:
            return of_pairs(mdp, self.pairs)
        # Each state has one pair, whose outcomes are the outcomes of all pairs taken there.
        (weight, below), states = self.exact_outcomes, np.arange(mdp.n_states)
        gain, under = table.gain, make_ones(mdp.n_states)
        if len(gain) == table.pairs:
            gain = gain[table.pair]
        # Exact rewards need a common denominator; floats need none.
        if gain.dtype != np.float64:
            under, each = self._over_common(table.gain_denominator)
            gain = multiply(gain, each[table.pair])
        order = np.lexsort((table.next, self.source))
        rows = Rows(
            offsets=np.append(0, np.cumsum(self.outcomes)),
            next=table.next[order],
            weight=weight[order],
            denominator=below,
        )
        mixed = OutcomeTable(rows=rows, gain=gain[order], gain_denominator=under)
        own = {"pair_state": states, "pair_action": np.zeros_like(states), "events": ()}
        return mdp.with_(table=mixed, actions=("mixed",), **own)

    @cached_property
    def exact_value(self) -> Level:
        """The exact values, if the equations are known to have one solution.

        They have one if the optimum is proven: a rank that falls along every pair, or w > γ P w,
        holds for mixtures of rows, too. States that need not end at discount 1 have value 0.
        """
        rows = self.build_bellman_rows()
        if self.mdp.discount_exact == 1:
            rows = replace(rows, terminal=rows.terminal | ~self.proper)
        (level,) = evaluate_exactly(rows)
        return level

    @cached_property
    def exact_visits(self) -> Level:
        """The expected discounted visits from the start; terminal states count arrivals."""
        live = self.reached & ~self.mdp.terminal
        return compute_expected_visits(self.build_bellman_rows(), live, self.mdp.start)

    @cached_property
    def exactly(self) -> ExactChain:
        """The exact chain at discount 1, in which terminal states go on forever."""
        return ExactChain(self.build_bellman_rows(Fraction(1)))

    def over(self, mdp: MDP) -> PolicyChain:
        """Return the chain in a model with the same pairs: itself, if it is the chain's own."""
        if mdp is self.mdp:
            return self
        return replace(self, mdp=mdp)

    def make_terminal(self, states: Mask) -> PolicyChain:
        """Return the chain with some states (S,) made terminal."""
        return replace(self, mdp=make_terminal(self.mdp, states))


class OfPolicy(Valued):
    """Base class of evaluations: the values of a policy together with its `chain`."""

    chain: PolicyChain

    @property
    def mdp(self) -> MDP:
        """The model; at discount 1 for an average reward."""
        return self.chain.mdp

    @property
    def policy(self) -> Policy | None:
        """The policy; None if it was given as probabilities of pairs."""
        return self.chain.policy

    @property
    def read_as(self) -> ReadAs:
        """How an array was read: as "q" or as "policy"."""
        return self.chain.read_as

    @property
    def mean(self) -> float:
        """Mean return, or gain, from the start."""
        return self.start.value

    def _sum_components(self, used: Floats, doubt: Floats) -> tuple[Floats, Floats]:
        """Return the total of each component for given visits of pairs (L,), with error bounds."""
        # Three errors: of the visits, of the sum of products, and of the rounded amounts.
        rounding = gamma(len(self.chain.pairs) + self.chain.roundings + 6)
        amounts = self.mdp.components
        size = np.abs(amounts)
        off = doubt @ size + rounding * (used @ size) + (used + doubt) @ component_errors(self.mdp)
        return used @ amounts, off * SLACK


@dataclass(frozen=True, eq=False)
class PolicyEquations:
    """x = c + rate · P x in the `live` states (S,) of a chain; x = c = 0 in the others.

    If the chain mixes or ends so slowly that floats cannot bound x, x is solved for in rationals.
    """

    chain: PolicyChain
    live: Mask
    system: LinearSystem
    rows: Callable[[], BellmanRows]  # with rate · P in integers

    @cached_property
    def visits(self) -> BoundedVector:
        """(S,) expected visits from the start, times rate^t at time t; arrivals at an end count."""
        chain, live, start = self.chain, self.live, self.chain.mdp.start_distribution
        rate, exact = self.system.discount, True
        with floats_first(chain.mdp):
            # Visits of live states solve the transposed equations, d = μ + γ Pᵀ d.
            point = transpose_system(self.system).solve(start, UNIT * start)
            # One more step forward gives the arrivals at the other states, with its rounding.
            onward = select_rows(chain.transition, np.arange(len(live)), live).T.tocsr()
            came, size = rate * (onward @ point.value), rate * (onward @ np.abs(point.value))
            off = rate * (onward @ point.error)
            terms = np.diff(onward.indptr) + chain.roundings + 4
            off += gamma(terms) * (start + size) + TINY * terms
            value = np.where(live, point.value, start + came)
            point = BoundedVector(value=value, error=np.where(live, point.error, off * SLACK))
            exact = is_too_inaccurate(point, chain.mdp)
        if exact:
            visits = compute_expected_visits(self.rows(), live, chain.mdp.start)
            point = round_fractions(visits.to_fractions())
        # Visits cannot be negative; clip rounding errors at 0.
        return BoundedVector(value=np.maximum(point.value, 0.0), error=point.error)

    def solve(self, constant: Floats, error: Floats | float = 0.0) -> BoundedVector:
        """Return x (S,) and its error bound, for a constant with an error of at most `error`.

        Raises SolverError if floats cannot bound x and rationals would take too long, or if x is
        beyond the range of floats.
        """
        exact = True
        with floats_first(self.chain.mdp):
            point, exact = self.system.solve(constant, error), False
        if not exact:
            return point
        doubt = np.broadcast_to(error, constant.shape)
        if not np.isfinite([constant, doubt]).all():
            raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
        # x is linear in c and the inverse is not negative: the error of c gives an x of its own.
        rows = self.rows()
        matrix = build_equations(rows, self.live)

        def solve_exactly(side: Floats) -> BoundedVector:
            exact_side = [*map(Fraction, side.tolist())]
            return round_fractions(solve_policy_equations(matrix, rows, exact_side).to_fractions())

        value, off = solve_exactly(constant), solve_exactly(doubt)
        return BoundedVector(value=value.value, error=value.error + off.value * SLACK)


def is_too_inaccurate(point: BoundedVector, mdp: MDP) -> bool:
    """Return whether fewer than half of the digits are sure, in a model small enough for more."""
    # A float with half of its 53 binary digits right has a relative error of 2^-26.
    return mdp.n_states <= FEW and point.error.max() > 2.0**-26 * np.abs(point.value).max()


@contextmanager
def floats_first(mdp: MDP) -> Iterator[None]:
    """Suppress SolverError from a computation in floats, unless rationals would take too long."""
    try:
        yield
    except SolverError as error:
        if mdp.n_states > MANY:
            detail = f"{error.detail or 'double precision cannot bound the error'}, and rational "
            detail += f"arithmetic takes up to {MANY:,} states"
            raise SolverError(Status.TOO_LARGE, detail) from error


def round_fractions(numbers: Iterable[Fraction]) -> BoundedVector:
    """Return (S,) exact numbers as floats, each rounded once."""
    exactly = [*numbers]
    try:
        value = np.array([float(number) for number in exactly])
    except OverflowError:
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats") from None
    return BoundedVector(
        value=value, error=UNIT * np.abs(value) + TINY * np.array([*map(bool, exactly)])
    )


def _require_weights(mdp: MDP, weights: Floats) -> Floats:
    """Return (L,) pair weights, or raise ModelError if they are not a policy."""
    total = np.add.reduceat(weights, mdp.pair_offsets[:-1])
    lowest = np.minimum.reduceat(weights, mdp.pair_offsets[:-1])
    wrong = ~((np.abs(total - 1) <= FLOAT_ROW_TOLERANCE) & (lowest >= 0))
    if wrong.any():
        state = int(np.flatnonzero(wrong)[0])
        raise ModelError(
            f"pair weights sum to {total[state]:.12g}, or one is negative",
            where=f"policy, {mdp.space.place(state)}",
            fix="make them at least 0, with sum 1",
        )
    return weights


# ---- policies that never end ---------------------------------------------------------------------


def split_infinite_returns(chain: PolicyChain) -> tuple[PolicyChain, dict[float, Mask]]:
    """Return a chain whose every run ends, and its ends (S,) for returns of inf and -inf, if any.

    Recurrent classes become ends: with an infinite return if a run gains or loses there forever,
    or has missed its goal; else for runs that earn no more. Raises ModelError if rewards cancel
    forever, so that a return has no limit.
    """
    mdp = chain.mdp
    if mdp.discount_exact != 1 or chain.reaches_goal_from_start:
        return chain, {}
    # A goal is missed where no terminal state can be reached, or a wrong one has been.
    if mdp.ends.has_goal:
        ended = mdp.ends.find_missed(chain.stuck | mdp.terminal)
        lost = {mdp.unreached: ended}
    else:
        # In a class with rewards the sign of the gain decides; a gain of 0 means that they cancel.
        ended = chain.stays_unrewarded
        busy = chain.reached & chain.classes.recurrent & ~ended & ~mdp.terminal
        gain = np.zeros(mdp.n_states)
        if busy.any():
            gain = _find_gain_signs(chain, busy)
        flat = busy & (gain == 0)
        if flat.any():
            raise ModelError(
                "rewards cancel forever, and the return has no limit",
                where=f"policy, {mdp.space.place(int(np.flatnonzero(flat)[0]))}",
                fix=ways_out(mdp, 'take evaluate(), with criterion="average"'),
            )
        lost = {inf: busy & (gain > 0), -inf: busy & (gain < 0)}
    ending = chain.make_terminal(np.logical_or.reduce([ended, *lost.values()]))
    return ending, {sign: each for sign, each in lost.items() if each.any()}


def _find_gain_signs(chain: PolicyChain, busy: Mask) -> Numbers:
    """Return (S,) gains or their signs, with sure signs in the `busy` states (S,)."""
    # Floats decide if every gain is further from 0 than its error; else rationals do.
    with floats_first(chain.mdp):
        gain, _ = chain.going_on.evaluate_chain()
        if not (busy & (np.abs(gain.value) <= gain.error)).any():
            return gain.value
    return np.sign(long_run(chain.exactly, chain.exactly.reward))
