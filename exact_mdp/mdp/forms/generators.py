"""Models of any size to try things on, exact and drawn from a seed: the same seed, the same model.

    garnet     b random successors for each of A actions (Archibald, McKinnon and Thomas,
               Journal of the Operational Research Society 46, 1995)
    dense      every state follows every other
    layered    layer after layer to one end, without cycles
    queue      a birth-death chain: the faster the service, the dearer
    grid       steps that slip to either side, until a corner; some cells cost ten times as much

Probabilities and rewards are whole numbers over small denominators, so that certificates are cheap.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.randomness import RNG, seed_of
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import Integers, OutcomeTable, exact
from exact_mdp.mdp.validate import as_discount, counted

PARTS = 1000  # of which drawn probabilities and rewards are whole numbers
MOVES = {"UP": (-1, 0), "RIGHT": (0, 1), "DOWN": (1, 0), "LEFT": (0, -1)}


def garnet(
    states: int, *, rng: RNG, actions: int = 4, branches: int = 5, discount: object = "19/20"
) -> MDP:
    """Return a Garnet: each action has `branches` random successors and a reward in [0, 1).

    Examples
    --------
    >>> garnet(100, rng=7)
    MDP(garnet: 100 states, 4 actions, 400 pairs, 2000 transitions, discount 19/20)
    """
    draw, pairs = _draw(rng), _count(states, "states") * _count(actions, "actions")
    if not 1 <= _count(branches, "branches") <= states:
        raise ModelError(
            f"{branches} branches among {states} states",
            where="branches",
            fix="give no more branches than states",
        )
    # Without replacement: the first places of a random order, where all of it fits.
    following = np.array([draw.choice(states, branches, replace=False) for _ in range(pairs)])
    weight, gain = draw.integers(1, PARTS, (pairs, branches)), draw.integers(0, PARTS, pairs)
    return _model("garnet", following, weight, gain, actions, discount)


def dense(states: int, *, rng: RNG, actions: int = 4, discount: object = "19/20") -> MDP:
    """Return a model in which every state can follow every other.

    Examples
    --------
    >>> dense(10, rng=7).n_transitions
    400
    """
    draw, pairs = _draw(rng), _count(states, "states") * _count(actions, "actions")
    following = np.broadcast_to(np.arange(states), (pairs, states))
    weight, gain = draw.integers(1, PARTS, (pairs, states)), draw.integers(0, PARTS, pairs)
    return _model("dense", following, weight, gain, actions, discount)


def layered(
    layers: int,
    width: int,
    *,
    rng: RNG,
    actions: int = 4,
    branches: int = 3,
    discount: object = 1,
) -> MDP:
    """Return a model that goes from layer to layer, the last one of which leads to the end.

    Examples
    --------
    >>> mdp = layered(5, 10, rng=7)
    >>> mdp.n_states, mdp.terminal.sum()
    (51, np.int64(1))
    """
    draw, end = _draw(rng), _count(layers, "layers") * _count(width, "width")
    pairs = end * _count(actions, "actions")
    layer = np.arange(pairs) // (width * actions)
    shape = (pairs, _count(branches, "branches"))
    following = np.minimum((layer + 1)[:, None] * width + draw.integers(0, width, shape), end)
    weight, gain = draw.integers(1, PARTS, shape), draw.integers(0, PARTS, pairs)
    space = StateSpace(
        columns=(Column(name="layer", size=layers), Column(name="place", size=width)),
        extra=("end",),
    )
    return _model("layered", following, weight, gain, actions, discount, space=space)


def queue(capacity: int, *, rng: RNG, actions: int = 4, discount: object = "99/100") -> MDP:
    """Return a queue: waiting costs 1/capacity for each customer, service half its rate squared.

    In every step a customer arrives with probability 1/2; the rates of service are drawn.

    Examples
    --------
    >>> queue(10, rng=7)
    MDP(queue: 11 states, 4 actions, 44 pairs, 124 transitions, discount 99/100)
    """
    states = _count(capacity, "capacity") + 1
    rates = np.sort(_draw(rng).choice(np.arange(1, 100), _count(actions, "actions"), replace=False))
    waiting, rate = np.repeat(np.arange(states), actions), np.tile(rates, states)  # in hundredths
    served = np.where(waiting > 0, rate, 0)
    up, down = np.where(waiting < capacity, 100 - served, 0), served
    following = np.stack(
        [np.maximum(waiting - 1, 0), waiting, np.minimum(waiting + 1, capacity)], axis=1
    )
    weight = np.stack([down, 200 - up - down, up], axis=1)
    gain = -(20_000 * waiting + capacity * rate**2)
    bottom = 20_000 * capacity
    space = StateSpace(columns=(Column(name="waiting", size=states),))
    names = [f"rate {Fraction(int(each), 100)}" for each in rates]
    return _model("queue", following, weight, gain, names, discount, bottom=bottom, space=space)


def grid(
    rows: int,
    columns: int,
    *,
    rng: RNG,
    slip: object = "1/5",
    mud: object = "1/5",
    discount: object = "99/100",
) -> MDP:
    """Return a grid from the first cell to the last: a step costs 1, from a cell of mud 10.

    With probability `slip` a step goes to one of the sides, to either as often; the share `mud` of
    the cells is drawn. There is a label, goal.

    Examples
    --------
    >>> mdp = grid(4, 5, rng=7)
    >>> mdp.actions, mdp.space.label(6), mdp.labels["goal"].sum()
    (('UP', 'RIGHT', 'DOWN', 'LEFT'), 'row 1, column 1', np.int64(1))
    """
    shape = (_count(rows, "rows"), _count(columns, "columns"))
    cells, share, chance = rows * columns, exact(mud), exact(slip)
    for value, name in ((share, "mud"), (chance, "slip")):
        if not 0 <= value <= 1:
            raise ModelError(f"{name} is {value}", where=name, fix="give a number from 0 to 1")
    cost = np.ones(cells, dtype=np.int64)
    cost[_draw(rng).permutation(cells)[: int(share * cells)]] = 10
    cost[-1] = 0
    place, steps = np.indices(shape).reshape(2, -1), np.array(list(MOVES.values()))
    last = np.array(shape)[:, None, None] - 1
    moved = np.clip(place[:, :, None] + steps.T[:, None, :], 0, last)
    after = moved[0] * columns + moved[1]  # (S, A)
    after[-1] = cells - 1
    turns = [np.roll(after, turn, axis=1) for turn in (0, 1, -1)]
    sides, whole = chance.numerator, 2 * chance.denominator
    weight = np.broadcast_to([whole - 2 * sides, sides, sides], (4 * cells, 3))
    space = StateSpace(columns=(Column(name="row", size=rows), Column(name="column", size=columns)))
    return _model(
        "grid",
        np.stack(turns, axis=2).reshape(-1, 3),
        weight,
        -np.repeat(cost, 4),
        list(MOVES),
        discount,
        bottom=1,
        space=space,
        labels={"goal": np.arange(cells) == cells - 1},
    )


def _model(
    name: str,
    following: Integers,
    weight: Integers,
    gain: Integers,
    actions: int | list[str],
    discount: object,
    *,
    bottom: int = PARTS,
    space: StateSpace | None = None,
    **parts: Any,
) -> MDP:
    """Return the model of (L, b) successors in proportion to weights; an extra state is an end."""
    names = [str(number) for number in range(actions)] if isinstance(actions, int) else actions
    states, ends = len(gain) // len(names), 0 if space is None else len(space.extra)
    order = np.argsort(following, axis=1, kind="stable")
    following = np.take_along_axis(following, order, axis=1)
    weight = np.take_along_axis(np.ascontiguousarray(weight), order, axis=1)
    kept = weight > 0
    lengths = np.concatenate([kept.sum(axis=1), np.ones(ends, dtype=np.int64)])
    last = np.arange(states, states + ends)
    pair_state, pair_action = np.divmod(np.arange(len(gain)), len(names))
    table = OutcomeTable(
        offsets=np.concatenate([[0], np.cumsum(lengths)]),
        next=np.concatenate([following[kept], last]),
        weight=np.concatenate([weight[kept], np.ones(ends, dtype=np.int64)]),
        denominator=np.concatenate([weight.sum(axis=1), np.ones(ends, dtype=np.int64)]),
        gain=np.concatenate([gain, np.zeros(ends, dtype=np.int64)]),
        gain_denominator=np.full(len(lengths), bottom, dtype=np.int64),
    )
    return MDP(
        table,
        np.concatenate([pair_state, last]),
        np.concatenate([pair_action, np.zeros(ends, dtype=np.int64)]),
        space=space or StateSpace.plain(states),
        actions=tuple(names),
        discount_exact=as_discount(discount),
        name=name,
        **parts,
    )


def _draw(rng: RNG) -> np.random.Generator:
    return np.random.default_rng(seed_of(rng))


def _count(number: int, name: str) -> int:
    return counted(number, name)
