"""Episodes that stop after N steps: the time becomes a part of the state, so no run has a cycle.

    V_N(s) = 0,    V_t(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V_{t+1}(s')

The states of time t are a layer, which begins at t S'; extra states, such as an end, have no time
and stand behind all layers (Puterman, Markov Decision Processes, 1994, section 4.3). An episode
that is over stays in its layer. Terminal values are earned by the last step (`terminal_values`);
if N = 0, by a step in which nothing else happens.

The way in: a policy over states, or an array by time and state (`flatten_times`). The way back:
`split_by_time`, for numbers of the pairs; `StateSpace.untimed`, the states without their time.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from exact_mdp.mdp.components import align_tables
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.questions.ending import NO_DATA, REACHED, fill_certain, make_terminal
from exact_mdp.mdp.questions.origin import origin_of
from exact_mdp.mdp.questions.terminal_values import (
    add_terminal_values,
    read_terminal_values,
    require_unpaid,
)
from exact_mdp.mdp.space import TIME, Column, StateSpace
from exact_mdp.mdp.table import (
    MOST_BYTES,
    Integers,
    Numbers,
    OutcomeTable,
    estimate_outcome_bytes,
)
from exact_mdp.mdp.validate import Flags, Parts


def ask_horizon(model: Any, steps: int, terminal_value: object = None) -> Any:
    """Return the model of episodes that stop after some steps, with values of the last states.

    Raises ModelError if the model has a time already, or its layers are too many.
    """
    values = read_terminal_values(terminal_value, model.space)
    layers, origin = TimeLayers([(model, steps)], values), origin_of(model)
    # A run that has reached its target is over and earns no terminal value.
    if model.target is not None:
        require_unpaid(values, model.target, model.space)
    if origin is not None and any(each.method == "within" for each in origin.questions):
        raise ModelError(
            "the model already stops after a number of steps",
            where="horizon",
            fix="leave out the horizon, or ask the model that it was made from",
        )
    if TIME in layers.space.names:
        raise ModelError(
            f"the model has a column {TIME!r} of its own",
            where="state space",
            fix="unroll the model that it was made from, or name that column differently",
        )
    if REACHED in model.space.extra and any(values):
        raise ModelError(
            "the value is a probability, to which terminal values do not add",
            where="terminal_value",
            fix="leave it out",
        )
    if REACHED in model.space.extra and not steps:
        raise ModelError(
            "without a step nothing is reached, and the label is no longer known",
            where="horizon",
            fix="ask the model that it was made from: mdp.within(0).reaching(LABEL)",
        )
    layers.require_memory()
    return _stop_after(layers)


def _stop_after(layers: TimeLayers) -> Any:
    """Return the model of episodes that stop after the steps of one model."""
    ((model, steps),) = layers.steps
    if not steps and any(layers.values):
        # One step in which nothing happens earns the terminal values, without discount.
        waits = np.ones(model.n_states, dtype=bool)
        still = make_terminal(model, waits, discount_exact=Fraction(1))
        paid = _stop_after(TimeLayers([(still, 1)], layers.values))
        return replace(paid, discount_exact=model.discount_exact)
    table, names = layers.join_tables(), model.component_names
    # The last step earns the terminal values.
    if any(layers.values):
        (run,) = layers.runs
        worth = [model.discount_exact * value for value in layers.values]
        earned = [worth[state] for state in run.table.next]
        names, table = add_terminal_values(table, (steps - 1) * len(run.pairs), earned, names)
    return layers.build_model(table, component_names=names)


@dataclass(frozen=True, eq=False)
class Run:
    """Steps one after the other that have the rows of one model, and the pairs that are kept."""

    model: Any
    steps: int
    over: Flags  # (S,) where an episode is over from these steps on
    pairs: Integers

    @cached_property
    def table(self) -> OutcomeTable:
        """The outcomes of these pairs."""
        table: OutcomeTable = self.model.table.of_pairs(self.pairs)
        return table

    def repeat(self, values: Numbers) -> Numbers:
        """Return values once for each step of the run."""
        return np.tile(values, (self.steps, *[1] * (values.ndim - 1)))


@dataclass(frozen=True)
class TimeLayers:
    """The states of a model, repeated for the times 0 … N; those whose episode is over stay."""

    steps: Sequence[tuple[Any, int]]  # models of the same states, and for how many steps
    values: Sequence[Fraction] = ()  # of the states at time N

    @property
    def model(self) -> Any:
        """The model of the first step, whose names and start count."""
        return self.steps[0][0]

    @cached_property
    def count(self) -> int:
        """The number of steps, N."""
        return sum(count for _, count in self.steps)

    @cached_property
    def over(self) -> list[Flags]:
        """(S,) for each run of steps, where an episode is over from then on."""
        over, later = list[Flags](), np.ones(self.model.n_states, dtype=bool)
        if any(self.values):  # a terminal state with a terminal value waits for it
            later = ~np.array(self.values, dtype=bool)
        for model, _ in reversed(self.steps):
            later = later & model.over
            over.append(later)
        return over[::-1]

    @cached_property
    def space(self) -> StateSpace:
        """The states of one time; without columns if the process goes on in an extra state."""
        space: StateSpace = self.model.space
        alike = len(self.steps) == 1 and self.over[0][space.regular :].all()
        if space.columns and (alike or not space.extra):
            return space
        return StateSpace.plain(space.size, space.labels(range(space.size)))

    @property
    def size(self) -> int:
        """The number of states of one time."""
        return self.space.regular

    @cached_property
    def runs(self) -> list[Run]:
        """The runs of steps; a state whose episode is over has one pair."""
        runs = list[Run]()
        for (model, count), over in zip(self.steps, self.over, strict=True):
            offsets, inside = model.pair_offsets, ~over[model.pair_state]
            inside[offsets[:-1][over]] = True
            pairs = np.flatnonzero(inside[: offsets[self.size]])
            runs.append(Run(model, count, over, pairs))
        return runs

    def find_first(self, state: int) -> int:
        """Return the number of a state at time 0; extra states move behind all layers."""
        if state < self.size:
            return state
        return state + self.size * self.count

    def join(self, parts: Iterable[Numbers], last: Numbers) -> Numbers:
        """Return the numbers of all steps, from those of one step of each run, and then `last`."""
        each = zip(self.runs, parts, strict=True)
        return np.concatenate([*(run.repeat(part) for run, part in each), last])

    def join_flags(self, flags: Sequence[Flags]) -> Flags:
        """Return flags (S,) of each run for the states of all times and the extra ones."""
        return self.join([own[: self.size] for own in flags], flags[-1])

    def join_tables(self) -> OutcomeTable:
        """Return the outcomes of all steps, and a certain one for each state at time N."""
        tables, states = align_tables([run.table for run in self.runs]), self.model.n_states

        def join_arrays(name: str, values: Numbers) -> Numbers:
            parts = [getattr(table, name) for table in tables]
            return self.join(parts, fill_certain(name, values, states))

        lengths = self.join([np.diff(table.offsets) for table in tables], np.ones(states, int))
        return tables[0].map_numbers(
            join_arrays,
            join_arrays,
            offsets=np.concatenate([[0], np.cumsum(lengths)]),
            next_states=self.list_next_states(),
        )

    def build_model(self, table: OutcomeTable, **changes: Any) -> Any:
        """Return the model with the outcomes of all steps."""
        model, runs, states = self.model, self.runs, np.arange(self.model.n_states)
        lengths = self.join([np.array([len(run.pairs)]) for run in runs], np.array([len(states)]))
        owner = self.join([run.model.pair_state[run.pairs] for run in runs], states)
        actions = [run.model.pair_action[run.pairs] for run in runs]
        column = Column(name=TIME, size=self.count + 1)
        parts = {
            "table": table,
            "pair_state": owner + self.size * np.repeat(np.arange(self.count + 1), lengths),
            "pair_action": self.join(actions, model.pair_action[model.pair_offsets[:-1]]),
            "space": StateSpace(columns=(column, *self.space.columns), extra=self.space.extra),
            "start": tuple((self.find_first(state), weight) for state, weight in model.start),
            "time_limit": None,
            "labels": {},
            **NO_DATA,
        }
        for name in model.labels:
            parts["labels"][name] = self.join_flags([run.model.labels[name] for run in runs])
        for name in ("goal", "target"):
            if getattr(model, name) is not None:
                parts[name] = self.join_flags([getattr(run.model, name) for run in runs])
        return replace(model, **parts, **changes)

    def list_next_states(self) -> Numbers:
        """Return the next states of all times: one time later, unless the episode is over."""
        # From time t, a state of the product moves to layer t + 1, a finished one stays in its
        # layer, and an extra state keeps its place behind all layers.
        size, states, begin = self.size, self.model.n_states, 0
        following = list[Numbers]()
        for run in self.runs:
            after, time = run.table.next.astype(np.int64), np.arange(run.steps)[:, None] + begin
            going = ~run.over[run.model.pair_state[run.pairs]]
            later = np.repeat(going, np.diff(run.table.offsets)).astype(np.int64)
            shift = np.where(after < size, size * (time + later), size * self.count)
            following.append((after + shift).ravel())
            begin += run.steps
        every = np.concatenate([*following, np.arange(states) + size * self.count])
        if size * (self.count + 1) + states < 2**31:
            return every.astype(np.int32)
        return every

    def require_memory(self) -> None:
        """Raise ModelError if the layers are too large."""
        (run,), steps, table = self.runs, self.count, self.model.table
        kinds = (table.weight.dtype, table.gain.dtype, table.denominator.dtype)
        each = estimate_outcome_bytes(wide=object in kinds)
        states = self.size * (steps + 1)
        outcomes = int(np.diff(table.offsets)[run.pairs].sum()) * steps + states
        pairs = len(run.pairs) * steps + states
        # Beside the table, an audit was measured to take 20 bytes for each outcome, 250 for each
        # pair and 560 for each state.
        size = (each + 20) * outcomes + 250 * pairs + 560 * states
        if size > MOST_BYTES:
            raise ModelError(
                f"{steps:,} steps of this model make {states:,} states and {outcomes:,} "
                f"outcomes: {size / 1e9:,.0f} GB of memory, more than {MOST_BYTES / 1e9:g} GB",
                where="horizon",
                fix="choose fewer steps; or no horizon, if the process ends by itself or late "
                "steps hardly count",
            )


def flatten_times(model: Any, table: Numbers) -> Numbers:
    """Return a table (N, S) or (N, S, A) over times and states as a table over all states.

    A table of another shape, or for a model without time, is returned as it is. S are the states
    without their time, with or without the extra states; the table may have rows for time N, when
    every episode is over, or not.
    """
    untimed = model.space.untimed
    if untimed is None or table.ndim < 2:
        return table
    times, own = model.space.columns[0].size, untimed.regular
    # At the last time there is usually no choice, so the policy may leave it out.
    steps = times
    if model.forced[(times - 1) * own :].all():
        steps = times - 1
    if table.shape[0] not in (steps, times) or table.shape[1] not in (own, untimed.size):
        return table
    spread = np.full((model.n_states, *table.shape[2:]), 0, dtype=table.dtype)
    spread[: steps * own] = table[:steps, :own].reshape(-1, *table.shape[2:])
    return spread


def split_by_time(model: Any, weights: Numbers, steps: int) -> Numbers:
    """Return the weights of the pairs of `model.within(N)` by time and pair of `model` (N, L)."""
    # Terminal states have a single pair at each time; it takes all the weight.
    pairs = TimeLayers([(model, steps)]).runs[0].pairs
    by_step = np.zeros((steps, model.n_pairs))
    by_step[:, model.pair_offsets[:-1][model.over]] = 1.0
    by_step[:, pairs] = weights[: steps * len(pairs)].reshape(steps, len(pairs))
    return by_step


def count_steps(model: Any) -> int:
    """Return after how many steps episodes stop; the one that earns values after 0 is none."""
    origin = origin_of(model)
    for question in origin.questions if origin is not None else ():
        if question.method == "within":
            return int(question.options["steps"])
    return int(model.space.columns[0].size) - 1


def repeats_in_time(model: Any) -> bool:
    """Return whether a model without origin looks like the result of `within`.

    Its first column is the time, every step leads to the next time, and time 0 and time 1 have the
    same rows.
    """
    space, table = model.space, model.table
    if not space.columns or space.names[0] != TIME or space.columns[0].size < 3:
        return False
    # Take the pairs of times 0 and 1; `own` is the number of states of one time.
    own = space.regular // space.columns[0].size
    first, second = (np.flatnonzero(model.pair_state // own == time) for time in (0, 1))
    here, there = table.of_pairs(first), table.of_pairs(second)
    # Compare the numbers of outcomes and the actions, before rows are compared number by number.
    same = np.array_equal(np.diff(here.offsets), np.diff(there.offsets))
    same = same and np.array_equal(model.pair_action[first], model.pair_action[second])
    if not same:
        return False
    # The next states of time 1 are the next states of time 0, one layer further on.
    later = np.where(here.next < space.regular, here.next + own, here.next)
    rows = (here.weight, there.weight), (here.denominator, there.denominator)
    return np.array_equal(later, there.next) and all(np.array_equal(*each) for each in rows)


def describe_time_limit(model: Parts, within: str) -> list[str]:
    """Return a note that the answer ignores the environment's time limit; [] if it does not.

    `within` is advice on how to keep the limit, with {} for the number of steps.
    """
    origin = origin_of(model)
    limit, kept = model.time_limit, "without a limit"
    if origin is not None and model.space.untimed is not None:
        limit, kept, within = origin.model.time_limit, f"of {count_steps(model):,} steps", ""
        if limit == count_steps(model):
            return []
    if limit is None:
        return []
    note = f"the environment stops after {limit:,} steps; this answer is for episodes {kept}"
    if within:
        note += f": {within.format(limit)}"
    return [note]
