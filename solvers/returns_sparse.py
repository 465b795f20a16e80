"""Carries probability mass over (state, reward so far) on a fine lattice, in dictionaries.

The rule is that of `returns_dense`, for rewards of which few sums occur although the lattice is
fine, and for exact masses: these are integers, the masses of a block being over one denominator.
"""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction
from math import lcm
from typing import Any

import numpy as np

from mdp.errors import ModelError
from mdp.table import integers
from solvers.returns_flow import SLOW_EDGE, Carried, Flow, too_many, too_slow
from solvers.rounding import TINY

STEPS = 20_000_000


def carry_sparse(flow: Flow, max_sweeps: int) -> Carried:
    """Return the mass at the end, from a dictionary of the rewards so far of each state."""
    shares = flow.chain.probability[flow.used].tolist()
    start = {state: float(weight) for state, weight in flow.start.items()}
    masses, lost, sweeps = _carry(flow, shares, start, max_sweeps)
    multiples = sorted(multiple for multiple, mass in masses.items() if mass > 0)
    # Underflow to 0 takes some returns away altogether.
    lost += TINY * (len(masses) - len(multiples))
    roundings = (int(flow.entering.max()) + flow.chain.roundings + 7) * (sweeps + 2)
    return Carried(
        multiples=integers(multiples),
        masses=np.array([masses[multiple] for multiple in multiples]),
        roundings=roundings,
        remaining=lost,
    )


def carry_exact(flow: Flow) -> tuple[dict[int, int], int]:
    """Return the mass at the end as integers over one denominator."""
    if flow.cyclic.any():
        raise ModelError(
            "states lead back to each other, so that returns have no end",
            where="policy",
            fix="leave out exact=True: all but 10^-12 of the probability is then found",
        )
    odds, block = _odds(flow), flow.block[flow.source].tolist()
    common = [1] * int(flow.block[-1])
    for here, chance in zip(block, odds, strict=True):
        common[here] = lcm(common[here], chance.denominator)
    # Mass of block b is over start · common[0] ⋯ common[b-1]; who jumps ahead takes all of these.
    product = [1]
    for factor in common:
        product.append(product[-1] * factor)
    shares = [
        int(chance * common[here]) * (product[there] // product[here + 1])
        for chance, here, there in zip(odds, block, flow.block[flow.target].tolist(), strict=True)
    ]
    bottom = lcm(*(weight.denominator for weight in flow.start.values()))
    start = {
        state: int(weight * bottom) * product[int(flow.block[state])]
        for state, weight in flow.start.items()
    }
    masses, _, _ = _carry(flow, shares, start, 1)
    return masses, bottom * product[-1]


def _odds(flow: Flow) -> list[Fraction]:
    """Return (M,) the exact probabilities of the outcomes in their states."""
    chain, table = flow.chain, flow.chain.table
    chosen: dict[int, Fraction] = {}
    for state in range(chain.mdp.n_states):
        chosen |= chain.exact_weights(state)
    weights, denominator = table.integer_weights()
    scale = [
        chosen[l] / int(bottom) for l, bottom in zip(chain.pairs.tolist(), denominator, strict=True)
    ]
    pair = table.pair[flow.used].tolist()
    return [scale[l] * int(weights[i]) for l, i in zip(pair, flow.used.tolist(), strict=True)]


def _carry(
    flow: Flow, shares: list[Any], start: dict[int, Any], max_sweeps: int
) -> tuple[dict[int, Any], Any, int]:
    """Return the mass at the end by reward, what is not in it, and the number of sweeps."""
    rows: list[dict[tuple[int, int], Any]] = [defaultdict(int) for _ in range(flow.end)]
    steps = zip(flow.source.tolist(), flow.target.tolist(), flow.gain.tolist(), shares, strict=True)
    for source, target, gain, share in steps:
        rows[source][target, gain] += share
    masses: list[dict[int, Any]] = [defaultdict(int) for _ in range(flow.end + 1)]
    for state, weight in start.items():
        masses[state][0] += weight
    lost, sweeps, work, edge = 0, 0, 0, flow.tolerance * SLOW_EDGE
    for block in range(int(flow.block[-1])):
        members = range(int(flow.first[block]), int(flow.first[block + 1]))
        moving = {state: masses[state] for state in members}
        for _ in range(max_sweeps):
            sweeps += 1
            following: dict[int, dict[int, Any]] = {}
            for state, spread in moving.items():
                work += len(spread) * len(rows[state])
                if work > STEPS:
                    raise too_many()
                for (target, gain), share in rows[state].items():
                    inner = members.start <= target < members.stop
                    into = (
                        following.setdefault(target, defaultdict(int)) if inner else masses[target]
                    )
                    for so_far, mass in spread.items():
                        into[so_far + gain] += mass * share
            for spread in following.values():
                for multiple in [x for x, mass in spread.items() if mass < edge]:
                    lost += spread.pop(multiple)
            left = sum(sum(spread.values()) for spread in following.values())
            if left <= flow.tolerance:
                lost += left
                break
            moving = following
        else:
            raise too_slow(max_sweeps, float(left))
        for state in members:
            masses[state].clear()
    return masses[flow.end], lost, sweeps
