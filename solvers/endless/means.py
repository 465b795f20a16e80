"""The best mean reward of an end component: its sign, its exact value, and what proves either.

    r(l) + P_l h - h(s) ≤ g  for all pairs l of the component,   with equality along a policy

says that no policy earns more than g a step for ever, and that one does. h is a potential: what is
earned on the way from s to t is h(s) - h(t), g a step apart. The sign alone is shown by any h with
r + P h - h < 0 (or > 0 along a policy) everywhere. Values V_γ with a discount γ near 1 are such
potentials, as r + P V_γ - V_γ = (1 - γ) P V_γ along an optimal policy and no more elsewhere: so
floats do, rounded. Where they leave the sign open, g and h are found in rational arithmetic as any
best average (`solvers.average`; Puterman, Markov Decision Processes, 1994, chapter 8).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from exact_mdp.mdp.exact import BellmanRows, bellman_rows
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Integers, Numbers
from exact_mdp.solvers.average.certify import certify_average
from exact_mdp.solvers.dynamic.modified import ModifiedPolicyIteration
from exact_mdp.solvers.endless.derived import Derived, derived
from exact_mdp.solvers.endless.graph import Graph, Mask
from exact_mdp.solvers.solution import PrecisionWarning, Solution, SolverError

NEARNESS = (Fraction(1, 2**8), Fraction(1, 2**16), Fraction(1, 2**26))  # 1 - γ
BITS = 40  # of a potential, below its greatest absolute value


@dataclass(frozen=True, kw_only=True, eq=False)
class Mean:
    """The best mean reward of a component, potentials (K,), and the pairs (K,) of a policy."""

    mean: Fraction
    potential: list[Fraction]
    pairs: Integers


@dataclass(frozen=True, kw_only=True, eq=False)
class Component:
    """An end component: K states and their pairs inside, as a model of its own.

    Attributes
    ----------
    states : (K,) int64
    sign : int
        That of the best mean reward.
    own : Derived
        The component as a model, the end of which cannot be reached.
    near : Solution, optional
        Its solution with a discount near 1, where floats told the sign.
    """

    states: Integers
    sign: int
    own: Derived
    near: Solution | None = None

    @cached_property
    def mean(self) -> Mean:
        """The exact mean, its potentials and its policy."""
        return exact_mean(self.own)

    @cached_property
    def proof(self) -> tuple[list[Fraction], Integers]:
        """Potentials (K,) that prove a sign other than 0, and the pairs (K,) of a policy."""
        near = self.near or nearly(self.own, NEARNESS[0])
        for nearness in (None, *NEARNESS[1:]):
            near = near if nearness is None else nearly(self.own, nearness)
            if near is None:
                continue
            largest = max(float(np.abs(near.value).max()), 2.0**-900)
            step = Fraction(2) ** (int(np.ceil(np.log2(largest))) - BITS)
            found = [step * int(x) for x in np.rint(near.value[:-1] / float(step))]
            if self._proves(found, near.pairs[:-1]):
                return found, self.own.source[near.pairs[:-1]]
        return self.mean.potential, self.mean.pairs

    def _proves(self, potential: Sequence[Fraction], pairs: Integers) -> bool:
        rows = bellman_rows(self.own.mdp)
        gain = surplus(rows, [*potential, Fraction(0)])
        if self.sign > 0:
            return all(gain[pair] > 0 for pair in pairs.tolist())
        return all(number < 0 for number in gain[:-1])


def component(
    mdp: MDP, graph: Graph, states: Integers, inside: Mask, rewards: Numbers
) -> Component:
    """Return an end component with the sign of its best mean, from the signs of rewards (L,)."""
    pairs = np.flatnonzero(inside & np.isin(graph.pair_state, states))
    label = np.full(mdp.n_states, -1, dtype=np.int64)
    label[states] = np.arange(len(states))
    own = derived(mdp, pairs, label)
    earned = rewards[pairs]
    if not (earned > 0).any():
        rest = np.zeros(mdp.n_pairs, dtype=bool)
        rest[pairs[earned == 0]] = True
        stays = rest.any() and (graph.end_components(rest)[0] >= 0).any()
        return Component(states=states, sign=0 if stays else -1, own=own)
    if not (earned < 0).any():
        return Component(states=states, sign=1, own=own)
    for nearness in NEARNESS:
        near = nearly(own, nearness)
        if near is None:
            continue
        low, high = near.value - near.error, near.value + near.error
        if high[:-1].max() < 0 or low[:-1].min() > 0:
            return Component(states=states, sign=int(np.sign(near.value[0])), own=own, near=near)
    mean = exact_mean(own)
    found = Component(states=states, sign=(mean.mean > 0) - (mean.mean < 0), own=own)
    found.__dict__["mean"] = mean
    return found


def nearly(own: Derived, nearness: Fraction) -> Solution | None:
    """Return the solution with discount 1 - `nearness`; None where floats do not bound it."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PrecisionWarning)
        try:
            return ModifiedPolicyIteration().solve(own.mdp.with_(discount=1 - nearness))
        except SolverError:
            return None


def exact_mean(own: Derived) -> Mean:
    """Return the best mean reward of an end component, given as a model of its own."""
    found = certify_average(own.mdp)
    pairs = own.mdp.pair_offsets[:-2] + found.policy[:-1]
    return Mean(mean=found.gain[0], potential=found.bias[:-1].tolist(), pairs=own.source[pairs])


def surplus(rows: BellmanRows, value: Sequence[Any], pairs: Integers | None = None) -> list[Any]:
    """Return r + P V - V(s) for some pairs (K,), or all, in rationals of the kind that V has."""
    offsets, following, weight = rows.offsets.tolist(), rows.next.tolist(), rows.weight.tolist()
    owner, scale, constant = rows.pair_state.tolist(), rows.scale.tolist(), rows.constant.tolist()
    found, zero = [], value[0] * 0
    for pair in range(len(owner)) if pairs is None else pairs.tolist():
        state, here = owner[pair], range(offsets[pair], offsets[pair + 1])
        later = sum((weight[i] * value[following[i]] for i in here), zero + constant[pair])
        found.append(later / scale[state] - value[state])
    return found
