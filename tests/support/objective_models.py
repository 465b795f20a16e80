"""Small random models with reward components, and what every deterministic policy makes of them."""

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import combinations, product

import numpy as np
import pytest
from hypothesis import strategies as st
from numpy.typing import NDArray
from oracle import each_choice, policy_values, rows_of, solved, until
from strategies import Rows, models

from exact_mdp import MDP, ConstrainedSolution, evaluate

F = Fraction
AMOUNTS = st.sampled_from([F(-2), F(-1), F(0), F(0), F(1, 3), F(1), F(3)])


@st.composite
def with_components(draw: st.DrawFn, count: int, *, for_ever: bool = False) -> MDP:
    """Draw a model of few policies with components c0, c1, …, with ties and a start by chance.

    Below discount 1 its ends may earn components `for_ever`, which make up no reward.
    """
    discounts = (F(0), F(1, 2), F(9, 10), *([] if for_ever else [F(1)]))
    rows = draw(models(discounts=discounts).filter(few))
    mdp = rows.model()
    ends = mdp.terminal[mdp.pair_state] & (not for_ever)
    parts = {
        f"c{k}": [F(0) if end else draw(AMOUNTS) for end in ends.tolist()] for k in range(count)
    }
    all_ = range(mdp.n_states)
    spread = {s: F(1, mdp.n_states) for s in all_}
    start = draw(st.sampled_from([{0: F(1)}, {all_[-1]: F(1)}, spread]))
    return mdp.with_(
        components=parts, start=start, sense=draw(st.sampled_from(["max", "max", "min"]))
    )


def few(rows: Rows) -> bool:
    mdp = rows.model()
    return int(np.prod(np.diff(mdp.pair_offsets))) <= 48


def totals(mdp: MDP, names: list[str]) -> list[tuple[Fraction, ...]]:
    """Return the totals of every deterministic policy from the start."""
    each, ones = [], np.ones(mdp.n_pairs, dtype=np.int64)
    for name in names:
        if name == "steps":
            top, bottom = going_on(mdp), ones
        elif name in mdp.component_names:
            top, bottom = mdp.component(name)
        else:
            top, bottom = mdp.table.expected_gain_exact
        table = replace(mdp.table, gain=top, gain_denominator=bottom)
        alone = mdp.with_(table=table)
        each.append([value_at_start(alone, choice) for choice in each_choice(alone)])
    return list(zip(*each, strict=True))


def going_on(mdp: MDP) -> NDArray[np.int64]:
    """Return (L,) 1 but in states that stay put, where no reward and no component is earned."""
    on = np.zeros(mdp.n_states, dtype=bool)
    for pair, state in enumerate(mdp.pair_state.tolist()):
        on[state] |= any(then != state or earned for _, then, earned in mdp.table.row(pair))
        on[state] |= any(mdp.component(name)[0][pair] != 0 for name in mdp.component_names)
    pairs: NDArray[np.int64] = on[mdp.pair_state].astype(np.int64)
    return pairs


def value_at_start(mdp: MDP, choice: tuple[int, ...]) -> Fraction:
    value: Sequence[Fraction | float] = (
        policy_values(rows_of(mdp, choice), mdp.discount_exact)
        if mdp.discount_exact < 1
        else until(rows_of(mdp, choice), mdp.terminal.tolist())
    )
    return sum((weight * F(value[state]) for state, weight in mdp.start), F(0))


@st.composite
def quiet_models(draw: st.DrawFn) -> MDP:
    """Draw a model in which about half of the states earn nothing, and often stay put.

    It counts two amounts everywhere, and some states are over: nothing is counted there.
    """
    states, rows, amounts = draw(st.integers(2, 3)), [], []
    for state in range(states):
        quiet, stays = draw(st.booleans()), draw(st.booleans())
        over = quiet and stays and draw(st.booleans())
        for action in range(draw(st.integers(1, 2))):
            after = draw(st.lists(st.integers(0, states - 1), min_size=1, max_size=2))
            reward = F(0) if quiet else draw(AMOUNTS)
            law = [(F(1), state)] if quiet and stays else [(F(1, len(after)), t) for t in after]
            rows.append((state, action, [(p, t, reward) for p, t in law]))
            amounts.append([F(0), F(0)] if over else [draw(AMOUNTS), draw(AMOUNTS)])
    return MDP.from_outcomes(
        rows,
        draw(st.sampled_from([F(1, 2), F(3, 4)])),
        components=dict(zip(("c0", "c1"), zip(*amounts, strict=True), strict=True)),
        sense=draw(st.sampled_from(["max", "max", "min"])),
    )


Vector = tuple[Fraction, ...]


def counted(mdp: MDP, pair: int) -> Vector:
    amounts = (
        (mdp.component(name)[0][pair], mdp.component(name)[1][pair]) for name in ("c0", "c1")
    )
    earned = sum((p * r for p, _, r in mdp.table.row(pair)), F(0))
    return (earned, *(F(int(top), int(below)) for top, below in amounts))


def totals_within(mdp: MDP, choices: Sequence[Sequence[int]], steps: int) -> set[Vector]:
    """Return what policies that take some pairs (S, …) alone make within N steps, from state 0."""
    known: list[set[Vector]] = [{(F(0),) * 3}] * mdp.n_states
    for _ in range(steps):
        after, known = known, [set[Vector]() for _ in known]
        for state, pairs in enumerate(choices):
            for pair in pairs:
                own, row = counted(mdp, pair), mdp.table.row(pair)
                for later in product(*(after[t] for _, t, _ in row)):
                    each = zip(own, *later, strict=True)
                    known[state].add(
                        tuple(
                            now
                            + mdp.discount_exact
                            * sum(p * v for (p, _, _), v in zip(row, then, strict=True))
                            for now, *then in each
                        )
                    )
    return known[0]


def best_under(
    points: Sequence[Vector], limits: Sequence[tuple[int, int, Fraction]], sense: int
) -> Fraction | None:
    """Return the best first entry of a mixture of points that keeps limits; None without one.

    A limit (k, sign, bound) says that sign · entry k is at least sign · bound. A mixture of as few
    points as can be has one more of them than limits that bind.
    """
    totals = []
    for count in range(1, len(limits) + 2):
        for mixed, tight in product(combinations(points, count), combinations(limits, count - 1)):
            rows = [[F(1)] * count] + [[point[k] for point in mixed] for k, _, _ in tight]
            mixtures = solved(
                map(dict, map(enumerate, rows)), [F(1)] + [bound for _, _, bound in tight]
            )
            if mixtures is None or min(shares := mixtures[0]) < 0:
                continue
            total = [sum(x * p[k] for x, p in zip(shares, mixed, strict=True)) for k in range(3)]
            if all(sign * (total[k] - bound) >= 0 for k, sign, bound in limits):
                totals.append(sense * total[0])
    return sense * F(max(totals)) if totals else None


def vertices(points: Sequence[tuple[Fraction, Fraction]], sense: int) -> set[Vector]:
    """Return the points (x, y) that are best alone for some weights above 0."""
    turned = {(sense * x, sense * y) for x, y in points}
    hull: list[tuple[Fraction, Fraction]] = []
    for x, y in sorted(
        p for p in turned if not any(q != p and q >= p and q[1] >= p[1] for q in turned)
    ):
        while len(hull) > 1 and (hull[-1][0] - hull[-2][0]) * (y - hull[-2][1]) >= (
            hull[-1][1] - hull[-2][1]
        ) * (x - hull[-2][0]):
            hull.pop()
        hull.append((x, y))
    return {(sense * x, sense * y) for x, y in hull}


LIMITS = st.sampled_from([F(-3), F(-1), F(-1, 3), F(0), F(1, 7), F(1), F(5, 2)])


def sound(solution: ConstrainedSolution, binding: int) -> None:
    """What holds of every solution: the proof, the totals of its policy, few randomised states."""
    assert solution.mdp is not None
    assert solution.violations() == []
    assert sum(len(own) - 1 for own in solution.randomises.values()) <= binding
    measured = evaluate(solution.mdp, solution.policy)
    if solution.start_value is not None:
        low, high = measured.start.interval
        assert low <= solution.start_value <= high
    for name, total in solution.totals.items():
        assert measured.components[name] == pytest.approx(float(total), abs=1e-6)
