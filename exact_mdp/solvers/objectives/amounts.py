"""Objectives: exact amounts of every pair, by name, and the Bellman rows that they share.

An objective is a linear combination of named amounts, `2*help-anger`, or `name=2*help-anger`:

    a component of the reward     its expected amount
    reward                        the whole reward; reward' if a component has this name
    steps                         1 in every state until the episode ends
    an event                      its expected number
    a label that is not left      1 on the step into it, at discount 1: the probability of reaching

In a terminal state no reward, component or event is counted. A state without any amount that leads
only to itself also counts as terminal here. A total at discount 1 is finite under every policy if
every policy ends. Where policies may never end, or miss the goal of a model, only those with finite
totals are compared (`solvers.objectives.improper`).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from functools import cached_property
from math import inf

import numpy as np

from exact_mdp.mdp.errors import ModelError, suggest_name
from exact_mdp.mdp.exact import BellmanRows, bellman_rows
from exact_mdp.mdp.forms.names import find_free_name
from exact_mdp.mdp.graph import PairGraph
from exact_mdp.mdp.io import model_json
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import (
    Integers,
    Numbers,
    exact,
    make_ones,
    multiply,
    to_common_denominator,
    to_integer_array,
)
from exact_mdp.solvers.endless.quotient import Quotient, choose_nearer_pairs
from exact_mdp.solvers.exact.checker import Model
from exact_mdp.solvers.exact.duals import Totals
from exact_mdp.solvers.objectives.improper import (
    Column,
    FiniteTotals,
    carry_over,
    combine_columns,
)

REWARD, STEPS = "reward", "steps"
STOPPED = "stopped"  # the state that a model has besides if its totals are averages of another
FACTOR = r"\s*([+-])?\s*(?:([0-9./]+)\s*\*\s*)?"  # of a term in a sum


class Objectives:
    """Objectives of a model with S states and L pairs; more is better in all.

    `given` is the model that was asked about, and `mdp` the model whose policies are compared:
    another one if some policy has no finite totals. Rows, amounts and numbers of states and pairs
    refer to `mdp`.
    """

    def __init__(
        self, mdp: MDP, texts: Sequence[str], signs: Sequence[tuple[int, int]] | None = None
    ) -> None:
        """Read objectives; raise ModelError for an amount that cannot be counted.

        `signs` lists objectives, by number, with 1 where more is better and -1 where less is, as a
        limit may say; by default more of all is better.
        """
        self.given, self.texts = mdp, tuple(texts)
        self.names, columns = read_objectives(mdp, texts)
        losing = -np.any([top != 0 for top, _ in columns], axis=0).astype(np.int64)
        below = to_integer_array(np.lcm.reduce([b.astype(object) for _, b in columns]).tolist())
        table = replace(mdp.table, gain=losing, gain_denominator=below, event=None)
        # A model that loses wherever an objective has an amount, for its terminal states.
        self.ending = mdp.with_(table=table, events=(), goal=None, sense="max")
        if mdp.goal is not None:
            self.ending = self.ending.with_(goal=mdp.goal & self.ending.terminal, unreached=-inf)
        self.mdp, comparable = mdp, self.ending
        self.finite = FiniteTotals(self.ending, mdp)
        self._quotient: Quotient | None = None
        if self.ending.ends.has_improper_policy:
            comparable, columns = self._omit_infinite_totals(columns, signs)
        # The equations that all objectives share, without constants. Times their scale, amounts
        # are integers.
        rows = bellman_rows(comparable)
        self.rows = replace(rows, constant=np.zeros(self.mdp.n_pairs, dtype=np.int64))
        self._comparable = comparable
        own = rows.scale[self.mdp.pair_state].astype(object)
        # (L,) expected amounts times scale, negated in a model of costs
        amounts = []
        for top, bottom in columns:
            amounts.append(
                to_integer_array((mdp.sense.sign * top.astype(object) * (own // bottom)).tolist())
            )
        self.amounts = tuple(amounts)

    def _omit_infinite_totals(
        self, columns: Sequence[Column], signs: Sequence[tuple[int, int]] | None
    ) -> tuple[MDP, list[Column]]:
        """Take the model of the policies with finite totals; return it, and its amounts.

        It has a reward where the model has one, or where an objective has an amount.
        """
        given, oriented = self.given, list[Column]()
        for number, sign in signs or [(k, 1) for k in range(len(columns))]:
            top, below = columns[number]
            oriented.append((given.sense.sign * sign * top.astype(object), below))
        self.finite.require_no_growth(oriented)
        quotient = self.finite.apply()
        self.finite.require_loss(quotient, oriented)
        rewards = carry_over(quotient, given.table.expected_gain_exact)
        self._quotient = quotient
        self.mdp = quotient.mdp.with_(table=quotient.mdp.table.with_reward(*rewards))
        return quotient.mdp.with_(sense="max"), [carry_over(quotient, each) for each in columns]

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

    @property
    def rank(self) -> Integers | None:
        """(S,) proof that every policy ends, at discount 1; -1 where some policy stays."""
        return self._comparable.ends.rank_in_proof

    # ---- policies with finite totals ---------------------------------------------------------

    @property
    def reduced(self) -> bool:
        """Whether `mdp` is another model than the given one."""
        return self._quotient is not None

    @cached_property
    def first(self) -> Integers:
        """(S,) the pairs of a policy that ends, from which searches begin."""
        pairs = self.mdp.pair_offsets[:-1].copy()
        if self.reduced:
            self.choose_ending_pairs(np.arange(self.mdp.n_pairs), pairs)
        return pairs

    def choose_ending_pairs(self, some: Integers, pairs: Integers) -> None:
        """Write into `pairs` (S,) some pairs (K,) that lead nearer to the end, where they can."""
        among = np.isin(np.arange(self.mdp.n_pairs), some)
        choose_nearer_pairs(PairGraph.of(self.mdp), self.rows.terminal, among, pairs)

    def lift_pairs(self, pairs: Integers) -> Integers:
        """Return the pairs of the given model of a policy, given its pairs (S,) here."""
        if self._quotient is None:
            return pairs
        return self.finite.lift_policy(self._quotient, pairs)

    def lift_chances(
        self, pairs: Integers, chances: Mapping[int, Mapping[int, Fraction]]
    ) -> dict[int, dict[int, Fraction]]:
        """Return the probabilities of pairs of the given model, {state: {pair: probability}}.

        A policy here takes `pairs` (S,), and draws among others in some states. Raises ModelError
        if it stays in some of its runs where it leaves in others, which takes memory.
        """
        chosen = pairs.copy()
        for state, own in chances.items():
            chosen[state] = min(own)
        lifted = {}
        for state, pair in enumerate(self.lift_pairs(chosen).tolist()):
            lifted[state] = {pair: Fraction(1)}
        for own in chances.values():
            drawn = dict(own)
            if self._quotient is not None:
                drawn = {int(self._quotient.source[pair]): share for pair, share in own.items()}
            if len(drawn) == 1:
                continue
            states = {int(self.given.pair_state[pair]) if pair >= 0 else -1 for pair in drawn}
            if len(states) > 1 or -1 in states:
                raise ModelError(
                    "the best policy under the limits has to remember whether it will leave states "
                    "in which nothing is counted",
                    where=self.given.space.place(max(states)),
                    fix="choose a discount below 1, or stop after N steps (--horizon N, "
                    "mdp.within(N))",
                )
            lifted[states.pop()] = drawn
        return lifted

    def restrict_visits(self, visits: Mapping[int, Fraction]) -> dict[int, Fraction]:
        """Return how often pairs here are visited, given the visits by a policy of `given`."""
        if self._quotient is None:
            return dict(visits)
        return self.finite.restrict_visits(self._quotient, visits)


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
    return combine_columns([(factor, _read_amounts(mdp, name)) for factor, name in terms])


def reward_name(mdp: MDP) -> str:
    """Return the name of the reward itself among the amounts of a model."""
    if len(mdp.component_names) == 1:
        return REWARD
    return find_free_name(REWARD, mdp.component_names)


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
