"""The audit of a policy by its average reward per step: what it loses in the long run, and where.

    regret = g* - g = Σ d(s) (g*(s) - E g*(s')) + Σ μ(s) (g*(s) - r + h*(s) - E h*(s'))

with the expectations over what the policy does in s, d its expected visits to states that it leaves
for good, and μ the share of time that it spends in the others. In the first, only what can still be
earned per step counts; in the others it has lost none of that. So each state has a price, and these
sum to the regret. (Summed over time, E of the first sum is g* less the mean of g* where the policy
stays; that of the second is what it earns less there.)

The verdict is exact where rational arithmetic is quick, or asked for: g* and h* come with a
certificate that its checker has accepted, and g solves the policy's own equations. Otherwise it
compares two floats with their bounds. With floats in the model, one use of a pair can move the gain
by what was rounded in its own row (e in `analysis.gate.forgiveness`, with h* for the values), so
that what is forgiven is the mean of that, and on the way to where the policy stays what the row can
move of g*: of the policy, and of an optimal one.
"""

from __future__ import annotations

from fractions import Fraction
from functools import partial

import numpy as np

from exact_mdp.analysis.gate.disagreements import Disagreement, Findings, Loss, listed
from exact_mdp.analysis.gate.exact_policy import mixed_rows
from exact_mdp.analysis.gate.forgiveness import per_use
from exact_mdp.analysis.gate.regret import LAST_CYCLE, Regret, cheap, proven
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.average.chain import ExactAverages
from exact_mdp.solvers.average.evaluate import AverageEvaluation
from exact_mdp.solvers.bounds.gains import SLACK, UNIT
from exact_mdp.solvers.bounds.linear import FixedPoint
from exact_mdp.solvers.exact.levels import Level, surplus
from exact_mdp.solvers.solution import Bounded, Certified, SolverError, regret
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.unending import average


def average_loss(mdp: MDP, policy: Policy, exact: bool | None) -> Loss:
    """Return what a policy loses per step, and where; exact unless that takes long."""
    rewards, step = mdp.maximised, mdp.maximised.undiscounted
    chain = PolicyChain.of(step, policy)
    exact = cheap(mdp, LAST_CYCLE) if exact is None else exact
    own: AverageEvaluation | None = None
    try:
        own = average(chain)
        visits = own.visits
    except SolverError:
        if not exact:
            raise
        visits = np.full(mdp.n_states, np.nan)  # the verdict stands without them
    if exact:
        lost = _certified(rewards, step, chain)
        gap = np.add.reduceat(chain.weights * lost.gap, mdp.pair_offsets[:-1])
        disagreements = listed(chain, lost, np.stack([gap, visits, visits * gap]), gap > 0)
    else:
        assert own is not None
        lost, disagreements = _bounded(rewards, own), ()
    return lost.negated() if mdp.sense == "min" else lost, partial(_both, visits, disagreements)


def _both(visits: Floats, disagreements: tuple[Disagreement, ...]) -> Findings:
    return visits, disagreements


def _certified(mdp: MDP, step: MDP, chain: PolicyChain) -> Regret:
    best = proven(mdp, "average")
    rows = bellman_rows(step)
    alone = mixed_rows(rows, chain)
    own = ExactAverages(alone)
    gain, bias, second = own.expansion(own.reward)
    levels = [Level.of(each.tolist()) for each in (gain, bias, second)]
    if any(any(tops) for tops, _ in surplus(alone, *levels)):
        raise RuntimeError("the exact gain of a policy does not solve its equations")
    learned = sum((p * gain[state] for state, p in mdp.start), Fraction(0))
    lost, short = best.losses
    gap = np.where(own.classes.recurrent[mdp.pair_state], lost + short, lost)
    optimal = np.asarray(gap == 0, dtype=bool)
    forgiven = Fraction(0)
    if mdp.floats:
        # The rounding of a row, and of the best one, can cause the whole gap.
        most = per_use(step, _rounded(best.bias))
        most = most + most[best.pairs][step.pair_state]
        optimal |= gap.astype(np.float64) * SLACK <= most
        taken = best.pairs
        ideal = ExactAverages(rows.of_pairs(taken))
        uses = [chain.exact_weights(state) for state in range(mdp.n_states)]
        forgiven += _movable(step, own, uses, (gain, bias))
        forgiven += _movable(
            step, ideal, [{l: Fraction(1)} for l in taken.tolist()], (best.value, best.bias)
        )
    return Regret(
        optimal=Certified(value=best.start_value),
        learned=Certified(value=learned),
        at_start=Certified(value=best.start_value - learned),
        optimal_value=best.value_float,
        learned_value=gain.astype(np.float64),
        by_state=(best.value - gain).astype(np.float64),
        optimal_pairs=optimal,
        unclear=np.zeros(mdp.n_pairs, dtype=bool),
        gap=np.where(optimal, 0.0, gap.astype(np.float64)),
        optimum=None,
        movable=partial(Fraction, forgiven),
    )


def _movable(
    step: MDP,
    chain: ExactAverages,
    uses: list[dict[int, Fraction]],
    values: tuple[Numbers, Numbers],
) -> Fraction:
    """Return what the rounding of floats can move of a policy's gain at the start.

    `uses` are the probabilities of its pairs in each state, `values` its gain and bias.
    """
    nothing = np.array([Fraction(0)] * step.n_states, dtype=object)

    def each(by_pair: Floats) -> Numbers:
        return np.array(
            [sum(p * Fraction(float(by_pair[l])) for l, p in use.items()) for use in uses],
            dtype=object,
        )

    inside = chain.classes.recurrent
    moved = chain.spread(chain.mean(each(per_use(step, _rounded(values[1])))))
    on_the_way = each(per_use(step, _rounded(values[0]), rewards=False))
    moved = moved + chain.total(np.where(inside, nothing, on_the_way), inside)
    return sum((p * moved[state] for state, p in step.start), Fraction(0))


def _rounded(values: Numbers) -> FixedPoint:
    """Return exact values, each rounded once."""
    floats = values.astype(np.float64)
    return FixedPoint(value=floats, error=UNIT * np.abs(floats))


def _bounded(mdp: MDP, own: AverageEvaluation) -> Regret:
    solution = solve(mdp, criterion="average")
    best = Bounded(value=solution.start.value, error=solution.start.error)
    mine = Bounded(value=own.start.value, error=own.start.error)
    taken = np.zeros(mdp.n_pairs, dtype=bool)
    taken[solution.pairs] = True
    return Regret(
        optimal=best,
        learned=mine,
        at_start=regret(best, mine),
        optimal_value=solution.value,
        learned_value=own.value,
        by_state=np.maximum(solution.value - own.value, 0.0),
        optimal_pairs=np.ones(mdp.n_pairs, dtype=bool),
        unclear=~taken,
        gap=np.zeros(mdp.n_pairs),
        optimum=None,
    )
