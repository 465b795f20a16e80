"""Backward induction over an operator: the care model solved without its transition matrix.

    V(k, t, s) = max over a of  E[gain + γ V(next) | s, a],

one subtask after the other from the last, one trial after the other, each a vector over the status
vectors s; `mdp.care.operator` says how the expectation is computed. The error bound is that of
`solvers.dynamic.backward_induction`, with the rounding error of a layer bounded once for all its
states: expectations are averages, so that an error of x passes on at most as it is, and with the
value of the first outcome taken off x before and added after, what rounding does inside is set by
the spread of x alone,

    ρ ≤ u ((C + 1) max |x - x_0| + (a few) (largest gain + γ max |V|)),

C the number of roundings of a sum of 2^n products, or of n folds (`Law.error`).
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from os import cpu_count
from time import perf_counter
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.mdp.care.operator import CareOperator, Expect, Law
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.bounds.bounds import ladder
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT
from exact_mdp.solvers.solution import Bounded, Solution, SolverError, Status

if TYPE_CHECKING:
    from exact_mdp.mdp.model import MDP

loops = later("exact_mdp.solvers.kernels.operator")

UNITS = UNIT * (1 + 2.0**-10)
COMPILED_FROM, LOADED_FROM = 0.3, 0.002  # seconds that the loops in NumPy would take, about
THREADED_FROM = 2**10
METHOD = "backward-induction"
POLICY = "give an action for each status vector or state, or probabilities (2^n, A)"


@np.errstate(over="ignore", invalid="ignore")
def solve_operator(model: CareOperator) -> Solution:
    """Return optimal values and policy of an operator, with bounds on their error.

    The solution is that of the explicit model up to rounding; its `mdp` is the operator.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> scenario = Scenario.load("yuan2025")
    >>> print(solve_operator(scenario.operator()).start)
    146.235870743 ± ... (bounded)
    """
    started = perf_counter()
    dense = bool(len(model.step.dense))
    induced = compiled_induce(model) if dense and _compiled(model) else induce(model)
    value, actions, above, below = induced
    high, low = _ladder(model, above), _ladder(model, below)
    if not (np.isfinite(value).all() and np.isfinite(high[0]) and np.isfinite(low[0])):
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
    errors = np.zeros(model.n_states)
    errors[:-1].reshape(len(high), -1)[:] = np.maximum(high, low)[:, None]
    return Solution(
        # A solution reads pair_action, start and backup of its model, which operators have too.
        mdp=cast("MDP", model),
        value=value,
        pairs=_pairs(model, actions),
        state_error=errors,
        regret_bound=float((high + low).max()),
        status=Status.DIRECT,
        method=METHOD,
        solver="BackwardInduction()",
        iterations=len(high),
        seconds=perf_counter() - started,
    )


def operator_mean(model: CareOperator, policy: ArrayLike) -> Bounded:
    """Return the mean return of a policy from the start, with a bound on its error.

    Parameters
    ----------
    model : CareOperator
    policy : (2^n,) or (S,) ints, or (2^n, A) floats
        Actions by status vector or by state, or probabilities of the assistive actions by status
        vector. A skip of its own is taken where it is the only action.

    Returns
    -------
    Bounded

    Raises
    ------
    ModelError
        For an array that is not a policy.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> print(operator_mean(Scenario.load("yuan2025").operator(), np.full((16, 4), 0.25)))
    85.0285... ± ... (bounded)
    """
    rules, where = model.rules, f"operator {model.name}"
    try:
        given = np.asarray(policy)
    except ValueError as fault:
        raise ModelError("rows of a policy differ in length", where=where, fix=POLICY) from fault
    by_state = given.shape == (model.n_states,)
    if given.dtype.kind in "iu" and (by_state or given.shape == (rules.vectors,)):
        state = model.space.values("trial")
        trying = given[(state >= 0) & (state < rules.trials)] if by_state else given
        valid = bool(((trying >= 0) & (trying < rules.assistive)).all())
        share = (given[:, None] == np.arange(rules.assistive)).astype(np.float64)
    else:
        valid = given.shape == (rules.vectors, rules.assistive) and bool(
            (given >= 0).all() and (np.abs(given.sum(axis=1) - 1) <= 1e-9).all()
        )
        share = given / given.sum(axis=1, keepdims=True) if valid else given
    if not valid:
        raise ModelError(
            f"an array of shape {given.shape} that is not a policy", where=where, fix=POLICY
        )

    def choose(first: int, q: Floats) -> Floats:
        here = share[first : first + rules.vectors] if by_state else share
        value: Floats = here[:, 0] * q[0]
        for action in range(1, rules.assistive):
            value = value + here[:, action] * q[action]
        return value

    # A mixture adds A products, and shares that are off by a few units each.
    value, _, error, _ = induce(model, choose=choose, mixing=3.0 * rules.assistive)
    bound = float(_ladder(model, error)[0])
    if not np.isfinite(bound):
        raise SolverError(Status.NO_BOUND, "a value is beyond the range of floats")
    return Bounded(value=float(value[0]), error=bound)


def induce(
    operator: CareOperator,
    expect: Expect | None = None,
    choose: Callable[[int, Floats], Floats] | None = None,
    *,
    mixing: float = 0.0,
) -> tuple[Floats, Integers, Floats, Floats]:
    """Return values (S,), actions (S,) and rounding errors (K, layers), upward and downward.

    Parameters
    ----------
    expect : function, optional
        Applies a law to a vector; by compiled loops where that pays, unless given.
    choose : function, optional
        From the number of a layer's first state and (A, 2^n) action values to the values of a
        policy; those of the best actions unless given.
    mixing : float
        Units of roundoff that `choose` may add, in parts of the largest value.
    """
    if expect is None:
        folding = not len(operator.step.dense)
        expect = compiled_expect if folding and _compiled(operator) else Law.expect
    rules, rate = operator.rules, operator.discount
    unit, largest, fixed, step_error, skip_error, factor = units(operator).tolist()
    value, actions, above, below = _empty(operator)
    vectors = rules.vectors
    for number in range(len(rules.places) - 1, -1, -1):
        behind = operator.after(value, number, 1)
        spread = float(np.abs(behind - behind[0]).max())
        clear = float(operator.after(value, number, 0)[0])
        magnitude = max(abs(clear), float(np.abs(behind).max()))
        if rules.own:
            doubt = (skip_error + 1.0) * spread + factor * (largest + rate * magnitude)
            above[number, -1] = below[number, -1] = unit * (doubt + fixed)
            first = number * rules.size + rules.trials * rules.flags * vectors
            alone = operator.alone_q(value, number, expect)
            value[first : (number + 1) * rules.size] = np.tile(alone, rules.flags)
            actions[first : (number + 1) * rules.size] = rules.assistive
        for trial in range(rules.trials - 1, -1, -1):
            ends = trial + 1 == rules.trials and not rules.own
            for flag in range(rules.flags):
                first = number * rules.size + (trial * rules.flags + flag) * vectors
                x = operator.ahead(value, number, trial, flag, expect)
                seen = magnitude
                if not ends:
                    later = first + rules.flags * vectors
                    seen = max(seen, float(np.abs(value[later : later + vectors]).max()))
                width = float(np.abs(x - x[0]).max())
                doubt = (step_error + 1.0) * width + (skip_error * spread if ends else 0.0)
                doubt += (2 * factor if ends else factor) * (largest + rate * seen)
                doubt = unit * (doubt + fixed)
                q = operator.q(x, expect)
                if choose is None:
                    best = q.max(axis=0)
                    slack = 2 * doubt + 16 * unit * np.abs(best)
                    taken = np.argmax(q + slack >= best - slack, axis=0)
                    short = float((doubt + (best - q[taken, np.arange(vectors)])).max())
                    actions[first : first + vectors] = taken
                else:
                    best = choose(first, q)
                    doubt += unit * mixing * float(np.abs(q).max())
                    short = doubt
                value[first : first + vectors] = best
                above[number, trial] = max(above[number, trial], doubt)
                below[number, trial] = max(below[number, trial], short)
    return value, actions, above, below


def units(operator: CareOperator) -> Floats:
    """Return what rounding errors are made of; see `solvers.kernels.operator.induce`."""
    rules = operator.rules
    complete, fail, skipped, alone, const = (
        float(np.abs(getattr(operator, name)).max())
        for name in ("complete", "fail", "skipped", "alone", "const")
    )
    largest = const + max(complete, fail + skipped, alone + skipped)
    step, skip = operator.step.error, operator.skip.error
    # Gains are rounded themselves; `const` and `alone` hold expectations.
    fixed = 8.0 * largest + step * float(np.abs(rules.rounded(rules.assist)).max()) * (1 + UNITS)
    cost = np.abs(rules.rounded(rules.present)) + np.abs(rules.rounded(rules.following))
    fixed += skip * float(cost.max()) * (1 + UNITS) if rules.own else 0.0
    factor = 3.0 if operator.discount_exact == 1 else 5.0
    return np.array([UNITS, largest, fixed, step, skip, factor])


# ---- compiled loops ------------------------------------------------------------------------------


def _compiled(operator: CareOperator) -> bool:
    """Return whether compiled loops save more time than it takes to load them."""
    rules = operator.rules
    states = len(operator.rules.places) * rules.trials * rules.flags * rules.vectors
    seconds = states * (2e-6 if len(operator.step.dense) else 1e-5 * rules.assistive)
    return seconds >= (LOADED_FROM if "numba" in sys.modules else COMPILED_FROM)


def compiled_expect(law: Law, x: Floats) -> Floats:
    """Return what `Law.expect` does, by the compiled loops; the same bits on any threads."""
    rules, vectors, count = law.chance.shape
    found = np.empty((rules, vectors))

    def work(rule: int) -> None:
        even, odd = np.empty((count, vectors // 2)), np.empty((count, vectors // 2))
        kept = np.zeros((count + 1, count + 1), dtype=np.int64)
        places = np.zeros((count + 1, 5), dtype=np.int64)
        loops.expect(law.chance[rule], law.ready[rule], x, found[rule], even, odd, kept, places)

    if rules == 1 or vectors < THREADED_FROM:
        for rule in range(rules):
            work(rule)
    else:
        with ThreadPoolExecutor(min(rules, cpu_count() or 1)) as pool:
            list(pool.map(work, range(rules)))
    return found


def compiled_induce(operator: CareOperator) -> tuple[Floats, Integers, Floats, Floats]:
    """Return what `induce` does, by compiled loops over the small matrix of the law."""
    rules = operator.rules
    induced = _empty(operator)
    loops.induce(
        operator.step.dense,
        operator.skip.dense,
        operator.const.reshape(-1),
        operator.fail,
        operator.complete,
        operator.skipped,
        operator.alone,
        rules.places,
        rules.kept,
        rules.trials,
        rules.flags,
        rules.own,
        operator.discount,
        units(operator),
        *induced,
        np.zeros((3, rules.vectors)),
        np.empty((2, operator.const.size)),
    )
    return induced


# ---- errors and numbers --------------------------------------------------------------------------


def _empty(operator: CareOperator) -> tuple[Floats, Integers, Floats, Floats]:
    """Return values, actions and errors to fill."""
    rules = operator.rules
    layers = len(rules.places), rules.trials + rules.own
    actions = np.zeros(operator.n_states, dtype=np.int64)
    return np.zeros(operator.n_states), actions, np.zeros(layers), np.zeros(layers)


def _ladder(operator: CareOperator, step: Floats) -> Floats:
    """Return errors by layer (K · layers,), from the errors that each layer adds."""
    rate = operator.discount * (1 + 8 * UNIT)
    tiny = TINY * (operator.rules.vectors + 2)
    steps = np.append(0.0, step.reshape(-1)[::-1] + tiny)
    total = np.zeros(len(steps))
    ladder(len(steps))(steps, rate, total)
    return total[:0:-1] * SLACK


def _pairs(operator: CareOperator, actions: Integers) -> Integers:
    """Return the pair (S,) of each state's action (S,), in the memory of the actions."""
    rules = operator.rules
    trying = rules.trials * rules.flags * rules.vectors
    state, _ = rules.pairs()
    table = actions[:-1].reshape(len(rules.places), rules.size)
    table[:, trying:] = 0  # a skip is the only pair of its state
    table += np.searchsorted(state, np.arange(rules.size))  # the first pair of each state
    table += np.arange(len(rules.places))[:, None] * len(state)
    actions[-1] = operator.n_pairs - 1
    return actions
