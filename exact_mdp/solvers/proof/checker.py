"""Checks an exact certificate against the model alone, in integers, however it was found.

V is the optimal value because it is 0 in terminal states, elsewhere V(s) = max over pairs l of s of
r(l) + γ P_l V, and this has one solution: where γ < 1, or a rank falls along one transition of each
pair (Bertsekas and Tsitsiklis, Mathematics of Operations Research 16, 1991).

Where some policy never ends, `solvers.proof.endless` takes the place of such a proof.

Checks a bounded certificate against the model alone, in floats, however it was found.

If w > γ P w in all rows for some w > 0, then the Bellman equations have one solution V. If also
U ≥ r + γ P U for all pairs and L ≤ r + γ P L for those of a policy π, then L ≤ V^π ≤ V ≤ U: applied
again and again, the right sides only move the vectors towards V and V^π (Puterman, Markov Decision
Processes, 1994, theorem 6.2.2). Every rounding error is counted (Higham, Accuracy and Stability of
Numerical Algorithms, SIAM 2002, section 3.1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import inf, lcm
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.chain import reachable
from exact_mdp.mdp.exact import (
    bellman_rows,
    fingerprint,
)
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.proof.endless import (
    EndlessClaims,
    endless_violations,
    malformed,
    optimal_infinite,
)
from exact_mdp.solvers.proof.equations import equation_violations, finite_part
from exact_mdp.solvers.proof.margins import alike, gains, undecided


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactClaims:
    """What an exact certificate claims; see `solvers.proof.certificate.Certificate`."""

    model: str
    numerator: Sequence[int]
    group: Integers
    denominator: Sequence[int]
    policy: Integers
    optimal_pairs: NDArray[np.bool_]
    gap: Sequence[int | None]
    gap_scale: Sequence[int]
    unique: bool
    start_value: Fraction | float
    rank: Integers | None = None
    endless: EndlessClaims | None = None

    def __post_init__(self) -> None:
        for array in (self.group, self.policy, self.optimal_pairs, self.rank):
            if array is not None:
                array.setflags(write=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundedClaims:
    """What a bounded certificate claims; see `solvers.proof.certificate.BoundedCertificate`."""

    model: str
    lower: Floats
    upper: Floats
    policy: Integers
    weight: Floats

    def __post_init__(self) -> None:
        for array in (self.lower, self.upper, self.policy, self.weight):
            array.setflags(write=False)


def exact_violations(found: ExactClaims, mdp: MDP) -> list[str]:
    """Return what does not hold of an exact certificate, in words; nothing where it is sound."""
    wrong = not_of(mdp, found.model, found.numerator, found.group, found.gap, found.gap_scale)
    halves: Any = [getattr(found.start_value, name, None) for name in ("numerator", "denominator")]
    halves = [0, 1] if found.start_value in (inf, -inf) else halves
    wrong += [f"its {name} are not all of type int, which holds any integer" for name, values in (
        ("numerators", found.numerator), ("denominators", found.denominator),
        ("gaps", [gap for gap in found.gap if gap is not None]), ("gap scales", found.gap_scale),
        ("numbers of the start value", halves),
    ) if {*map(type, values)} - {int}]  # fmt: skip
    if not wrong and found.optimal_pairs.shape != (mdp.n_pairs,):
        wrong.append(f"it marks {found.optimal_pairs.shape} pairs, the model has {mdp.n_pairs}")
    wrong += [f"its {name} are of type {array.dtype}" for name, array, kind in (
        ("marks", found.optimal_pairs, "b"), ("groups", found.group, "i"),
        ("actions", found.policy, "i"), ("ranks", found.rank, "i"),
    ) if array is not None and array.dtype.kind != kind]  # fmt: skip
    if not wrong and not set(found.group.tolist()) <= set(range(len(found.denominator))):
        wrong.append("a state's denominator is missing")
    if wrong or min(found.denominator) <= 0:
        return wrong or ["a denominator is not positive"]
    if mdp.sense == "min":  # the least costs are minus the greatest of rewards times -1
        value = [-number for number in found.numerator]
        without = None if found.endless is None else found.endless.negated()
        found = replace(found, numerator=value, start_value=-found.start_value, endless=without)
        mdp = mdp.maximised
    ends, pairs = mdp.terminal, policy_pairs(mdp, found.policy)
    if pairs is None or not found.optimal_pairs[pairs].all():
        return ["the policy takes a pair that is not optimal"]
    wrong += [
        f"terminal state {s} is not worth 0"
        for s in np.flatnonzero(ends).tolist()
        if found.numerator[s]
    ]
    if found.endless is not None:
        wrong += _without_end(found, found.endless, mdp, pairs)
    else:
        missed = mdp.goal is not None and bool((ends & ~mdp.goal).any())
        if missed or not one_solution(mdp, found.rank):
            wrong.append("nothing proves that the Bellman equations have one solution")
        open_pairs = undecided(mdp, found)
        first = alike(mdp, open_pairs)
        differ = found.optimal_pairs[open_pairs] != found.optimal_pairs[first]
        wrong += [
            f"the optimal actions of state {s} are not those of the model"
            for s in np.unique(mdp.pair_state[open_pairs[differ]]).tolist()
        ]
        kept = np.unique(first)
        wrong += equation_violations(
            bellman_rows(mdp, kept), replace(found, optimal_pairs=found.optimal_pairs[kept])
        )
    if found.unique is not one_optimum(mdp, found.optimal_pairs):
        wrong.append(f"it says wrongly that the optimum is {'' if found.unique else 'not '}unique")
    if not _right_start(found, mdp):
        wrong.append("the start value is not that of the start states")
    return wrong


def _right_start(found: ExactClaims, mdp: MDP) -> bool:
    """Return whether the start value is that of the start; one that is both +∞ and -∞ is none."""
    start = [(state, weight) for state, weight in mdp.start if weight]
    if found.endless is not None:
        signs = found.endless.sign[[state for state, _ in start]]
        if signs.any():
            least, most = int(signs.min()), int(signs.max())
            return least * most >= 0 and found.start_value == inf * (least + most)
    if not isinstance(found.start_value, Fraction):
        return False
    parts = lcm(*(weight.denominator for _, weight in start))
    sums = dict[int, int]()  # times parts and the denominator of the group
    for state, weight in start:
        group, share = int(found.group[state]), weight.numerator * (parts // weight.denominator)
        sums[group] = sums.get(group, 0) + share * found.numerator[state]
    below = lcm(*(found.denominator[group] for group in sums))
    total = sum(own * (below // found.denominator[group]) for group, own in sums.items())
    claimed = found.start_value
    return claimed.numerator * parts * below == total * claimed.denominator


def _without_end(found: ExactClaims, claims: EndlessClaims, mdp: MDP, pairs: Integers) -> list[str]:
    """Check values that may be infinite; see `solvers.proof.endless`."""
    wrong = malformed(claims, mdp.n_states)
    if mdp.discount_exact != 1:
        wrong.append("below discount 1 no value is infinite")
    rows = bellman_rows(mdp)
    part = None if wrong else finite_part(claims.sign, rows)
    if part is None:
        return wrong or ["a finite state has no pair that leads to finite states only"]
    equations, kept = part
    infinite = claims.sign != 0
    optimal = found.optimal_pairs[kept].copy()
    optimal[infinite[mdp.pair_state[kept]]] = True
    marked = optimal_infinite(claims, rows)
    if (
        found.optimal_pairs
        != np.where(infinite[mdp.pair_state], marked, found.optimal_pairs & kept)
    ).any():
        wrong.append("the optimal actions of some state are not those of the model")
    wrong += [
        f"state {s} has a value and is infinite"
        for s in np.flatnonzero(infinite).tolist()
        if found.numerator[s]
    ]
    wrong += equation_violations(equations, replace(found, optimal_pairs=optimal))

    def value(state: int) -> Fraction:
        return Fraction(found.numerator[state], found.denominator[found.group[state]])

    marks = found.optimal_pairs
    signs = np.array([(number > 0) - (number < 0) for number in found.numerator])
    return wrong + endless_violations(claims, mdp, rows, pairs, marks, value, signs)


def not_of(mdp: MDP, model: str, *by_state: Sequence[object] | Numbers) -> list[str]:
    """Return why the certificate cannot be one of this model; nothing where it can."""
    if model != fingerprint(mdp):
        return ["the certificate is of another model"]
    sizes = {len(part) for part in by_state} - {mdp.n_states}
    return [f"it has {sizes} states, the model {mdp.n_states}"] if sizes else []


def policy_pairs(mdp: MDP, policy: Integers) -> Integers | None:
    """Return the policy's pairs (S,), None where it takes an action that is not available."""
    if policy.shape != (mdp.n_states,) or not ((policy >= 0) & (policy < mdp.n_actions)).all():
        return None
    wanted = np.arange(mdp.n_states) * mdp.n_actions + policy
    offered = mdp.pair_state * mdp.n_actions + mdp.pair_action
    pairs = np.minimum(np.searchsorted(offered, wanted), mdp.n_pairs - 1)
    return pairs if (offered[pairs] == wanted).all() else None


def one_optimum(mdp: MDP, optimal: NDArray[np.bool_]) -> bool:
    """Return whether one pair alone of each state that optimal pairs (L,) lead to is among them."""
    other = np.add.reduceat(optimal.astype(np.int64), mdp.pair_offsets[:-1]) != 1
    other &= ~mdp.terminal
    return not (other.any() and (other & reachable(mdp, pairs=optimal)).any())


def one_solution(mdp: MDP, rank: Integers | None) -> bool:
    """Return whether the discount or a rank proves that equations have one solution."""
    if mdp.discount_exact < 1:
        return True
    live, state = ~mdp.terminal, mdp.pair_state
    if rank is None or rank.shape != live.shape or (rank[~live] != 0).any():
        return False
    falls = np.minimum.reduceat(rank[mdp.table.next], mdp.table.offsets[:-1]) < rank[state]
    return bool(falls[live[state]].all() and (rank[live] > 0).all())


def bounded_violations(found: BoundedClaims, mdp: MDP) -> list[str]:
    """Return what does not hold of a bounded certificate, in words; nothing where it is sound."""
    vectors = {"lower": found.lower, "upper": found.upper, "weight": found.weight}
    wrong = not_of(mdp, found.model, *vectors.values())
    wrong += [
        f"{name} is of type {array.dtype} and shape {array.shape}"
        for name, array, kind in (
            *((name, vector, "f8") for name, vector in vectors.items()),
            ("policy", found.policy, f"i{found.policy.dtype.itemsize}"),
        )
        if array.dtype.str[1:] != kind or array.ndim != 1
    ]
    pairs = None if wrong else policy_pairs(mdp, found.policy)
    if pairs is None:
        return wrong or ["the policy takes an action that is not available"]
    if mdp.sense == "min":
        found, mdp = replace(found, lower=-found.upper, upper=-found.lower), mdp.maximised
    live = ~mdp.terminal
    open_pairs = live[mdp.pair_state]
    wrong += [
        f"{name} is not finite, or not 0 in terminal states"
        for name, vector in vectors.items()
        if not np.isfinite(vector).all() or vector[~live].any()
    ]
    gain, error = gains(mdp, found.weight, earning=False)
    if not ((found.weight[live] > 0).all() and (gain < -error)[open_pairs].all()):
        wrong.append("the weights do not prove that the Bellman equations have one solution")
    gain, error = gains(mdp, found.upper)
    if not (gain <= -error)[open_pairs].all():
        wrong.append("the upper values are not proven to be above the optimal ones")
    gain, error = gains(mdp, found.lower)
    if not (gain >= error)[pairs[live]].all():
        wrong.append("the lower values are not proven to be below the policy's")
    return wrong
