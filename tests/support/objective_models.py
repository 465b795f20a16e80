"""Small random models with reward components, and what every deterministic policy makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import enumerated
import numpy as np
from hypothesis import strategies as st
from strategies import models

from exact_mdp.mdp import MDP

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


def few(rows: object) -> bool:
    mdp = rows.model()  # type: ignore[attr-defined]
    return int(np.prod(np.diff(mdp.pair_offsets))) <= 48


def totals(mdp: MDP, names: list[str]) -> list[tuple[Fraction, ...]]:
    """Return the totals of every deterministic policy from the start."""
    each, ones = [], np.ones(mdp.n_pairs, dtype=np.int64)
    for name in names:
        top, bottom = (going_on(mdp), ones) if name == "steps" else mdp.component(name)
        table = replace(mdp.table, gain=top, gain_denominator=bottom, gain_doubt=None)
        alone = mdp.with_(table=table)
        each.append([value_at_start(alone, choice) for choice in enumerated.policies(alone)])
    return list(zip(*each, strict=True))


def going_on(mdp: MDP) -> np.ndarray:
    """Return (L,) 1 but in states that stay put, where no reward and no component is earned."""
    on = np.zeros(mdp.n_states, dtype=bool)
    for pair, state in enumerate(mdp.pair_state.tolist()):
        on[state] |= any(then != state or earned for _, then, earned in mdp.table.row(pair))
        on[state] |= any(mdp.component(name)[0][pair] != 0 for name in mdp.component_names)
    return on[mdp.pair_state].astype(np.int64)


def value_at_start(mdp: MDP, choice: tuple[int, ...]) -> Fraction:
    value: Sequence[Fraction | float] = (
        enumerated.discounted(mdp, choice)
        if mdp.discount_exact < 1
        else enumerated.until(mdp, choice, mdp.terminal.tolist())
    )
    return sum((weight * F(value[state]) for state, weight in mdp.start), F(0))
