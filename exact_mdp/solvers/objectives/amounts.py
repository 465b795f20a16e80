"""Objectives: exact amounts of every pair, by name, and the Bellman rows that they share.

An objective is a linear combination of named amounts, `2*help-anger`, or `name=2*help-anger`:

    a component of the reward     its expected amount
    reward                        the whole reward; reward' if a component has this name
    steps                         1 in every state until the episode ends
    an event                      its expected number
    a label that is not left      1 on the step into it, at discount 1: the probability of reaching

In a terminal state no reward, component or event is counted. A state without any amount that leads
only to itself also counts as terminal here. A total at discount 1 is finite under every policy if
every policy ends. A run that misses the goal of a model has no finite total.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.advice import ways_out, where_endless
from exact_mdp.mdp.errors import ModelError, suggest_name
from exact_mdp.mdp.exact import BellmanRows, bellman_rows
from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.io import model_json
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import (
    Numbers,
    exact,
    make_ones,
    multiply,
    to_common_denominator,
    to_integer_array,
)
from exact_mdp.solvers.exact.checker import Model
from exact_mdp.solvers.exact.duals import Totals

REWARD, STEPS = "reward", "steps"
FACTOR = r"\s*([+-])?\s*(?:([0-9./]+)\s*\*\s*)?"  # of a term in a sum
Column = tuple[Numbers, Numbers]


class Objectives:
    """Objectives of a model with S states and L pairs; more is better in all."""

    def __init__(self, mdp: MDP, texts: Sequence[str]) -> None:
        """Read objectives; raise ModelError for an amount that cannot be counted."""
        self.names, columns = read_objectives(mdp, texts)
        self.mdp, self.texts = mdp, tuple(texts)
        earning = np.any([top != 0 for top, _ in columns], axis=0).astype(np.int64)
        below = to_integer_array(np.lcm.reduce([b.astype(object) for _, b in columns]).tolist())
        table = replace(mdp.table, gain=earning, gain_denominator=below)
        # A model with a reward wherever an objective has an amount, for its terminal states.
        self.ending = mdp.with_(table=table, goal=None, sense="max")
        # The equations that all objectives share, without constants. Times their scale, amounts
        # are integers.
        rows = bellman_rows(self.ending)
        self.rows = replace(rows, constant=np.zeros(mdp.n_pairs, dtype=np.int64))
        own = rows.scale[mdp.pair_state].astype(object)
        # (L,) expected amounts times scale, negated in a model of costs
        amounts = []
        for top, bottom in columns:
            amounts.append(
                to_integer_array((mdp.sense.sign * top.astype(object) * (own // bottom)).tolist())
            )
        self.amounts = tuple(amounts)
        self._require_finite()

    @property
    def sign(self) -> int:
        """1 for rewards, -1 for costs."""
        return self.mdp.sense.sign

    def weigh_amounts(self, weights: Sequence[int]) -> Numbers:
        """Return the weighted sum (L,) of the amounts."""
        total = sum(w * own.astype(object) for w, own in zip(weights, self.amounts, strict=True))
        return to_integer_array(np.asarray(total).tolist())

    def rows_for(self, weights: Sequence[int | Fraction]) -> tuple[BellmanRows, int]:
        """Return the equations of a weighted sum of objectives, times an integer, and that."""
        whole, unit = to_common_denominator([Fraction(weight) for weight in weights])
        return replace(self.rows, constant=self.weigh_amounts(whole)), unit

    def to_totals(self) -> Totals:
        """Return the amounts in the form that the checker of proofs reads."""
        model = Model(model_json.list_problem(self.mdp))
        scale = self.rows.scale[self.mdp.pair_state]
        each = [zip(own.tolist(), scale.tolist(), strict=True) for own in self.amounts]
        amounts = []
        for own in each:
            amounts.append([Fraction(top, below) for top, below in own])
        return Totals(model, self.names, amounts)

    def _require_finite(self) -> None:
        """Raise ModelError if, at discount 1, a policy may never end or may miss the goal."""
        mdp = self.mdp
        if mdp.discount_exact < 1:
            return
        if not self.ending.ends.every_policy_ends:
            raise ModelError(
                "some policy never ends, and its totals at discount 1 would grow forever",
                where=where_endless(self.ending),
                fix=ways_out(mdp),
            )
        beside = find_reachable_states(mdp) & mdp.ends.find_missed(self.ending.terminal)
        if beside.any():
            raise ModelError(
                "no total is finite: a policy may end outside the goal",
                where=mdp.space.place(int(np.flatnonzero(beside)[0])),
                fix="count in the model itself, without --until, or leave out what leads there",
            )


def read_objectives(mdp: MDP, texts: Sequence[str]) -> tuple[tuple[str, ...], list[Column]]:
    """Return the names of objectives, and the amounts (L,) of each, over denominators (L,)."""
    if not all(isinstance(text, str) for text in texts):
        raise ModelError(
            f"{list(texts)!r} is not a list of texts",
            where="objectives",
            fix='give texts: a name, or a sum such as "name=2*a-b"',
        )
    named = [_parse_objective(mdp, text) for text in texts]
    names = tuple(name for name, _ in named)
    if len(set(names)) < len(names):
        raise ModelError(
            f"{max(names, key=names.count)!r} is named twice",
            where="objectives",
            fix="name each once: name=2*a-b",
        )
    return names, [_combine_terms(mdp, terms) for _, terms in named]


Terms = list[tuple[Fraction, str]]


def _parse_objective(mdp: MDP, text: str) -> tuple[str, Terms]:
    """Return the name of an objective, and its terms."""
    # A known name, possibly after another name and "=".
    rewards = dict.fromkeys([*mdp.component_names, reward_name(mdp)])
    known = [*dict.fromkeys([*rewards, STEPS, *mdp.events, *mdp.labels])]
    name, equals, body = text.partition("=")
    if text in known or not equals:
        name, body = text, text
    name, body = name.strip(), body.strip()
    if name and body in known:
        return name, [(Fraction(1), body)]
    # Otherwise a sum of known names with factors; longer names are tried first.
    terms, at = Terms(), 0
    each = "|".join(map(re.escape, sorted(known, key=len, reverse=True)))
    term = re.compile(rf"{FACTOR}({each})\s*(?=[+-]|$)")
    while at < len(body) or not terms:
        match = term.match(body, at)
        if match is None or not name or (terms and match[1] is None):
            part = re.split(r"[-+*]", re.sub(f"^{FACTOR}", "", body[at:]))[0].strip() or body
            raise ModelError(
                f"{text!r} names no total, nor a sum of totals",
                where=f"objective {text!r}",
                fix=f"{suggest_name(part, known)}; a sum is written name=2*a-b",
            )
        factor = exact(match[2] or "1", f"objective {text!r}")
        if match[1] == "-":
            factor = -factor
        terms.append((factor, match[3]))
        at = match.end()
    return name, terms


def _combine_terms(mdp: MDP, terms: Terms) -> Column:
    """Return the amounts (L,) of a linear combination, over denominators (L,)."""
    columns = [(factor, *_read_amounts(mdp, name)) for factor, name in terms]
    below = np.lcm.reduce([f.denominator * b.astype(object) for f, _, b in columns])
    added = []
    for f, t, b in columns:
        added.append(t.astype(object) * (f.numerator * (below // (b * f.denominator))))
    top = sum(added)
    return np.asarray(top), below


def reward_name(mdp: MDP) -> str:
    """Return the name of the reward itself among the amounts of a model."""
    name = REWARD
    while name in mdp.component_names and len(mdp.component_names) > 1:
        name += "'"
    return name


def _read_amounts(mdp: MDP, name: str) -> Column:
    """Return the exact amounts (L,) of one name, over denominators (L,)."""
    if name == reward_name(mdp):
        return mdp.table.expected_gain_exact
    if name in mdp.component_names:
        return mdp.component(name)
    if name == STEPS:
        return (~mdp.over)[mdp.pair_state].astype(np.int64), make_ones(mdp.n_pairs)
    # The probability of an event, or of stepping into a label.
    weight, below = mdp.table.rows.integers
    if name in mdp.events:
        assert mdp.table.event is not None
        happens = (mdp.table.event >> mdp.events.index(name)) & 1 == 1
    else:
        happens = _find_arrivals(mdp, name)
    counted = multiply(weight, happens.astype(np.int64), terms=len(weight))
    return np.asarray(np.add.reduceat(counted, mdp.table.offsets[:-1])), below


def _find_arrivals(mdp: MDP, label: str) -> Numbers:
    """Return (N,) True for outcomes that step into a label whose states are never left."""
    inside = mdp.labels[label]
    here, there = inside[mdp.pair_state[mdp.table.pair]], inside[mdp.table.next]
    begins = any(inside[state] for state, weight in mdp.start if weight)
    if begins or mdp.discount_exact < 1 or (here & ~there).any():
        raise ModelError(
            f"the probability of label {label!r} is not an expected total here",
            where="objectives",
            fix="count a label at discount 1 that is never left again, and in which no run starts",
        )
    return np.asarray(there & ~here)
