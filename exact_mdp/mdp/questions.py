"""Questions about a model, as models whose optimal value is the answer.

The probability of reaching a set T through a set C is a total reward at discount 1: the step into T
earns 1 and ends, as does the first step from T; runs that leave C ∪ T end with 0. The reward until
T is the reward of the model in which T is absorbing; a run that never reaches T has the value +∞,
as PRISM and Storm define R[F T]. Episodes of N steps have the time in their states, which makes a
model without cycles:

    V_N(s) = 0,    V_t(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V_{t+1}(s')

With terminal values v the last step earns γ v(s') in addition to its reward; a terminal state with
v ≠ 0 continues until time N. The models of `reaching` and `until` keep the numbers of states and
pairs, so policies of the original model are policies of these models as well.

Sources: Baier and Katoen, Principles of Model Checking, MIT Press 2008, sections 10.1 and 10.6;
https://www.prismmodelchecker.org/manual/PropertySpecification/Reward-basedProperties;
Puterman, Markov Decision Processes, 1994, section 4.3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import reduce
from typing import Any, Self

import numpy as np

from exact_mdp.mdp.components import with_components
from exact_mdp.mdp.errors import ModelError, locate_errors, require_known_name, suggest_name
from exact_mdp.mdp.space import TIME, Column, StateSpace
from exact_mdp.mdp.table import (
    MOST_BYTES,
    Integers,
    Numbers,
    OutcomeTable,
    estimate_outcome_bytes,
    exact,
    make_ones,
    over_groups,
    to_integer_array,
)
from exact_mdp.mdp.validate import Flags, Parts, numbers_by_state, require_count

REACHED, TERMINAL_VALUE = "reached", "terminal value"
ONE_COMPONENT = {"component_names": ("reward",)}
# A question changes the rows, so counts of the original rows no longer describe them.
NO_DATA: dict[str, Any] = {"observations": None, "episodes": None}


@dataclass(frozen=True)
class Question:
    """A question about a model: a method of `MDP` that returns another model, and its options."""

    method: str
    options: Mapping[str, Any]

    def __call__(self, model: Any) -> Any:
        """Return the model that answers the question about `model`."""
        return getattr(model, self.method)(**self.options)


@dataclass(frozen=True)
class Origin:
    """The model that questions were asked about, and the questions in order.

    A question has the parameters of its origin: one row of the origin may be many rows of the model
    of the question, such as one for each time.
    """

    model: Any
    questions: tuple[Question, ...]

    @property
    def paid(self) -> bool:
        """Whether there are terminal values that count; they do not count in a probability."""
        if any(each.method == "reaching" for each in self.questions):
            return False
        return any(each.options.get("terminal_value") is not None for each in self.questions)

    def without_terminal_value(self) -> Origin:
        """Return the same questions without terminal values."""
        asked = []
        for question in self.questions:
            options = dict(question.options)
            if "terminal_value" in options:
                options["terminal_value"] = None
            asked.append(replace(question, options=options))
        return replace(self, questions=tuple(asked))

    def rebuild_model(self) -> Any:
        """Return the model that answers all questions, one after the other."""
        return reduce(lambda model, ask: ask(model), self.questions, self.model)


def origin_of(model: Any) -> Origin | None:
    """Return the origin of the model of a question; None for any other model."""
    found: Origin | None = vars(model).get("origin")
    return found


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


def keep_origin(answer: Any, asked_of: Any, method: str, **options: Any) -> Any:
    """Record in `answer` the model and the question that it answers; return it."""
    before = origin_of(asked_of) or Origin(asked_of, ())
    question = Question(method, options)
    vars(answer)["origin"] = Origin(before.model, (*before.questions, question))
    return answer


def keep_origin_changed(
    answer: Any, asked_of: Any, discount: object | None, changes: Mapping[str, Any]
) -> None:
    """Record the origin of a copy with other parts, as `keep_origin` does.

    The discount is a parameter of the original model, so a new discount is set there. The model of
    a probability has no discount; a copy with one answers another question and has no origin.
    """
    before = origin_of(asked_of)
    assert before is not None
    if "discount_exact" in changes:
        return
    if discount is not None:
        if any(question.method == "reaching" for question in before.questions):
            return
        before = replace(before, model=before.model.with_(discount=discount))
    if changes:
        question = Question("with_", dict(changes))
        before = replace(before, questions=(*before.questions, question))
    vars(answer)["origin"] = before


class Questions(Parts):
    """The questions of a model: methods that return the model of the answer."""

    def reaching(self, label: str, allowed: str | None = None) -> Self:
        """Return the model whose value is the probability of reaching a labelled state.

        Steps into a labelled state lead to a new state `reached` instead; the labelled states keep
        the value 1. The optimum is the greatest probability, or the least if the sense is "min".
        The model has no discount. With `within(N)`, before or after, it is the probability of
        reaching a labelled state within N steps.

        Parameters
        ----------
        label : str
            One of `labels`.
        allowed : str, optional
            The label of the states that a run may pass through; all by default.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If a label is unknown, or a start state is not allowed.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> from exact_mdp import certify
        >>> walk = [["1/2", "1/6", "1/3"], [0, 1, 0], [0, 0, 1]]
        >>> mdp = MDP.from_arrays([walk], [0, 0, 0], labels={"home": [False, True, False]})
        >>> certify(mdp.reaching("home")).start_value
        Fraction(1, 3)
        """
        target, size, space = find_labelled_states(self, label), self.n_states, self.space
        outside = np.zeros(size, dtype=bool)
        if allowed is not None:
            outside = ~find_labelled_states(self, allowed)
        for state, chance in self.start:
            if chance > 0 and outside[state] and not target[state]:
                raise ModelError(
                    f"the start, {space.place(state)}, is not among the allowed states",
                    where=f"allowed {allowed!r}",
                    fix="allow it, or start elsewhere",
                )
        # Labelled states lead to `reached`, the new state S, at once; forbidden ones stay put.
        states, pairs = np.append(self.pair_state, size), self.n_pairs
        table = _redirect_pairs(
            self.table.with_reward(np.zeros(pairs, np.int64), make_ones(pairs)),
            np.append((target | outside)[self.pair_state], True),
            np.where(np.append(target, False)[states], size, states),
        )
        # Outcomes that arrive lead to `reached`. It has the greatest number, so they come last in
        # their row, which stays sorted.
        arrives = np.append(target, True)[table.next]
        order = np.argsort(2 * table.pair + arrives, kind="stable")
        arrives = arrives[order]
        table = table.map_numbers(
            lambda _, values: values,
            lambda _, values: values[order],
            offsets=table.offsets,
            next_states=np.where(arrives, table.next.dtype.type(size), table.next[order]),
        )
        # An arrival earns 1, but the step from `reached` to itself earns 0.
        parts = {
            "table": replace(table, gain=(arrives & (table.pair < pairs)).astype(np.int64)),
            "pair_state": states,
            "pair_action": np.append(self.pair_action, self.pair_action[-1]),
            "space": StateSpace(columns=space.columns, extra=(*space.extra, REACHED)),
            "discount_exact": Fraction(1),
            **ONE_COMPONENT,
            **NO_DATA,
            "labels": {name: np.append(flags, False) for name, flags in self.labels.items()},
            "goal": None,
            "target": None,
        }
        reached: Self = keep_origin(
            replace(self, **parts), self, "reaching", label=label, allowed=allowed
        )
        return reached

    def until(self, label: str, reward: str | None = None) -> Self:
        """Return the model whose value is the expected reward until a labelled state is reached.

        At discount 1 a run that never reaches one has the value +∞. The optimum is infinite if such
        runs have a positive probability under some policy; for costs, under every policy. With
        `within(N)`, before or after, these are the runs that reach no labelled state in N steps.

        Parameters
        ----------
        label : str
            One of `labels`.
        reward : str, optional
            The reward component that counts; the whole reward by default.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If the label or the component is unknown.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> from exact_mdp import certify
        >>> walk = [["1/3", "2/3"], [0, 1]]
        >>> mdp = MDP.from_arrays([walk], [1, 1], labels={"home": [False, True]})
        >>> certify(mdp.until("home")).value.tolist()
        [Fraction(3, 2), Fraction(0, 1)]
        """
        target = find_labelled_states(self, label)
        model = self
        if reward is not None:
            model = _with_component_reward(self, reward)
        # Below discount 1 a run that misses the target has a finite value, so no goal is set.
        goal = None
        if self.discount_exact == 1:
            goal = target
        _refuse_paid_goal(model, label)
        until: Self = make_terminal(model, target, goal=goal, target=target)
        asked: Self = keep_origin(until, model, "until", label=label)
        return asked

    def within(self, steps: int, *, terminal_value: object = None) -> Self:
        """Return the model of episodes that stop after N steps.

        The new model has a column `time` before the model's own columns: first all states at time
        0, then at time 1, and so on to time N, when every episode is over. Extra states, such as an
        end, have no time. A policy over the model's own states or columns is also a policy of the
        new model, the same at every time.

        Parameters
        ----------
        steps : int
            N, 1 or more.
        terminal_value : (S,) numbers or {state: number}, optional
            The value of each state at time N; 0 by default, and for states that are not named. The
            last step earns it, discounted once, so the values of the states at time N themselves
            are 0. In a model with components it is a component of its own, "terminal value".

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If `steps` is not a positive whole number, a terminal value is not finite, the new model
            would not fit in memory, or the model already has a column `time`.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> wait, go = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
        >>> mdp = MDP.from_arrays([wait, go], [[1, "3/2"], [0, 0]]).within(3)
        >>> mdp.space.names, mdp.n_states, mdp.space.label(2)
        (('time', 'state'), 8, 'time 1, state 0')
        >>> mdp.table.row(mdp.pair(2, 0))
        [(Fraction(1, 2), 4, Fraction(1, 1)), (Fraction(1, 2), 5, Fraction(1, 1))]
        """
        mdp: Any = self  # an MDP, which has more attributes than its parts
        offsets, over = mdp.pair_offsets, mdp.over
        # Read the terminal values. A run that has reached its target is over and earns none.
        values = []
        if terminal_value is not None:
            values = _read_terminal_values(terminal_value, self.space)
        if self.target is not None:
            for state in np.flatnonzero(self.target).tolist():
                if values and values[state]:
                    raise _paid_goal(self.space.place(state))
        # A terminal state with a terminal value has to wait for the horizon to earn it.
        if any(values):
            over = over & np.array([value == 0 for value in values])
        count, space = require_count(steps, "horizon"), _in_columns(self, over)
        own, states = space.regular, self.n_states
        origin = origin_of(self)
        if origin is not None and any(each.method == "within" for each in origin.questions):
            raise ModelError(
                "the model already stops after a number of steps",
                where="horizon",
                fix="leave out the horizon, or ask the model that it was made from",
            )
        if TIME in space.names:
            raise ModelError(
                f"the model has a column {TIME!r} of its own",
                where="state space",
                fix="unroll the model that it was made from, or name that column differently",
            )
        rows = _select_active_pairs(self, offsets, over)
        table = self.table.of_pairs(rows)
        _check_size(table, own, count)

        def repeat_layers(values: Numbers, last: Numbers) -> Numbers:
            """Return `values` N times, once for each of the times 0 … N-1, and then `last`."""
            return np.concatenate([np.tile(values, (count, *[1] * (values.ndim - 1))), last])

        def append_end(name: str, values: Numbers) -> Numbers:
            return repeat_layers(values, _fill_certain(name, values, states))

        # The rows of one time, N times over, and one certain outcome for each state at time N.
        lengths = repeat_layers(np.diff(table.offsets), np.ones(states, np.int64))
        layered = table.map_numbers(
            append_end,
            append_end,
            offsets=np.concatenate([[0], np.cumsum(lengths)]),
            next_states=_list_next_states(self, own, over, rows, table, count),
        )
        time = np.repeat(np.arange(count + 1), [*[len(rows)] * count, states])

        def repeat_flags(flags: Flags) -> Flags:
            return np.append(np.tile(flags[:own], count + 1), flags[own:])

        # The last step earns the terminal values.
        names = self.component_names
        if any(values):
            later = [self.discount_exact * values[state] for state in table.next]
            names, layered = _add_terminal_values(layered, len(rows) * (count - 1), later, names)
        # Extra states stand behind the states of all times, so their numbers move up.
        start = []
        for state, weight in self.start:
            if state >= own:
                state += own * count
            start.append((state, weight))
        parts = {
            "table": layered,
            "component_names": names,
            "pair_state": repeat_layers(self.pair_state[rows], np.arange(states)) + own * time,
            "pair_action": repeat_layers(self.pair_action[rows], self.pair_action[offsets[:-1]]),
            "space": StateSpace(
                columns=(Column(name=TIME, size=count + 1), *space.columns), extra=space.extra
            ),
            "start": tuple(start),
            "time_limit": None,
            "labels": {name: repeat_flags(flags) for name, flags in self.labels.items()},
            **NO_DATA,
        }
        for name, flags in (("goal", self.goal), ("target", self.target)):
            if flags is not None:
                parts[name] = repeat_flags(flags)
        options = {"steps": count, "terminal_value": terminal_value}
        stopped: Self = keep_origin(replace(self, **parts), self, "within", **options)
        return stopped


def _refuse_paid_goal(model: Any, label: str) -> None:
    """Raise ModelError if a labelled state has a terminal value."""
    origin = origin_of(model)
    if origin is None or not origin.paid:
        return
    own, inside = origin.model.space, origin.model.labels.get(label, [])
    for question in origin.questions:
        given = question.options.get("terminal_value")
        if given is None:
            continue
        values = _read_terminal_values(given, own)
        for state in np.flatnonzero(inside).tolist():
            if values[state]:
                raise _paid_goal(own.place(state))


def _paid_goal(where: str) -> ModelError:
    """Return the error for a goal state with a terminal value."""
    return ModelError(
        "a run that has reached the goal is over, and earns no terminal value at the horizon",
        where=f"terminal_value, {where}",
        fix="leave the states of the goal out of terminal_value, and reward an arrival in the step "
        "that arrives",
    )


def _with_component_reward(model: Any, name: str) -> Any:
    """Return the model whose reward is one of its components."""
    if (name,) == model.component_names and not model.table.parted_by_outcome:
        return model
    if name not in model.component_names:
        fix = suggest_name(name, model.component_names)
        raise ModelError(f"no reward component {name!r}", where="reward components", fix=fix)
    origin = origin_of(model)
    if origin is not None and name in origin.model.component_names:
        # Terminal values are a component of their own, so they do not count.
        unpaid = origin.without_terminal_value()
        return replace(unpaid, model=_with_component_reward(origin.model, name)).rebuild_model()
    table = model.table.with_component_reward(model.component_names.index(name))
    return replace(model, table=table, component_names=(name,))


def describe_time_limit(model: Parts, within: str) -> list[str]:
    """Return a note that the answer ignores the environment's time limit; [] without a limit.

    `within` is advice on how to keep the limit, with {} for the number of steps.
    """
    if model.time_limit is None:
        return []
    note = (
        f"the environment stops after {model.time_limit:,} steps; this answer is for episodes "
        "without a limit"
    )
    if within:
        note += f": {within.format(model.time_limit)}"
    return [note]


def describe_sense(model: Parts) -> str:
    """Return in words what the value of a model measures; "" for rewards to maximise."""
    if REACHED in model.space.extra:
        return f"{model.sense.best} probability of reaching"
    if model.sense.costs:
        return "costs to minimise"
    return ""


def find_labelled_states(model: Parts, label: str) -> Flags:
    """Return the states (S,) of a label; raise ModelError if the label is unknown.

    Also raised if the model already answers a question: its runs have been cut off.
    """
    if model.target is not None or REACHED in model.space.extra:
        raise ModelError(
            "this model already answers a question, and its runs end there",
            where=f"label {label!r}",
            fix="ask the model that it was made from, or give one label to the states of both "
            "questions",
        )
    if not model.labels:
        raise ModelError(
            f"unknown label {label!r}",
            where="labels",
            fix="the model has none: build it with labels={name: (S,) truth values}",
        )
    return model.labels[require_known_name(label, model.labels, "label", "labels")]


def _redirect_pairs(table: OutcomeTable, ends: Flags, follows: Numbers) -> OutcomeTable:
    """Return a table in which the pairs in `ends` (L,) lead surely to `follows` (L,), earning 0.

    Both arrays may have one entry more, for a new pair at the end.
    """

    def append_certain_pair(name: str, values: Numbers) -> Numbers:
        return np.concatenate([values, _fill_certain(name, values, 1)])

    # Append one certain outcome; every redirected pair then becomes a copy of it.
    ending = table.map_numbers(
        append_certain_pair,
        append_certain_pair,
        offsets=np.append(table.offsets, table.offsets[-1] + 1),
        next_states=np.append(table.next, table.next.dtype.type(0)),
    )
    ended = ending.of_pairs(np.where(ends, table.pairs, np.arange(len(ends))))
    # Each copy leads to a state of its own.
    lengths = np.diff(ended.offsets)
    moved = np.repeat(np.asarray(follows), lengths).astype(ended.next.dtype)
    following = np.where(np.repeat(ends, lengths), moved, ended.next)
    return replace(ended, rows=replace(ended.rows, next=following))


def make_terminal(model: Any, states: Flags, **changes: Any) -> Any:
    """Return the model with the given states (S,) made terminal, and with other changes."""
    table = _redirect_pairs(model.table, states[model.pair_state], model.pair_state)
    return replace(model, table=table, **NO_DATA, **changes)


def _fill_certain(name: str, values: Numbers, count: int) -> Numbers:
    """Return entries of the array `name` for `count` outcomes that are certain and earn 0."""
    one = name == "weight" or name.endswith("denominator")
    return np.full((count, *values.shape[1:]), int(one), dtype=values.dtype)


# ---- episodes of N steps -------------------------------------------------------------------------


def split_by_time(model: Any, weights: Numbers, steps: int) -> Numbers:
    """Return the weights of the pairs of `model.within(N)` by time and pair of `model` (N, L)."""
    # Terminal states have a single pair at each time; it takes all the weight.
    rows = _select_active_pairs(model, model.pair_offsets, model.over)
    by_step = np.zeros((steps, model.n_pairs))
    by_step[:, model.pair_offsets[:-1][model.over]] = 1.0
    by_step[:, rows] = weights[: steps * len(rows)].reshape(steps, len(rows))
    return by_step


def _select_active_pairs(model: Parts, offsets: Integers, over: Flags) -> Integers:
    """Return the pairs of every time but the last; a state whose episode is over has one."""
    inside = ~over[model.pair_state]
    inside[offsets[:-1][over]] = True
    return np.flatnonzero(inside[: offsets[_in_columns(model, over).regular]])


def _read_terminal_values(numbers: object, space: StateSpace) -> list[Fraction]:
    """Return one number for each state, from a vector or {state: number} (0 for the others)."""
    if isinstance(numbers, tuple):  # a tuple could also be read as a state
        numbers = list(numbers)
    with locate_errors("terminal_value"):
        values = numbers_by_state(numbers, space)
        if values is None:
            raise ModelError(
                f"a {type(numbers).__name__} does not give a value for each state",
                fix="give one number for each state, or {state: number}",
            )
        return [exact(values.get(state, 0)) for state in range(space.size)]


def _add_terminal_values(
    table: OutcomeTable, first: int, more: Sequence[Fraction], names: tuple[str, ...]
) -> tuple[tuple[str, ...], OutcomeTable]:
    """Return component names and table after `more` is added to the outcomes from `first` on."""
    # Exact rewards by outcome: two outcomes of a pair may now earn different amounts.
    gain, below = table.integer_gains
    if len(gain) == table.pairs:
        gain = gain[table.pair]
    gain, below = gain.astype(object), below.astype(object)
    # Add the terminal values to the outcomes of the last step, begin … begin + len(more) - 1.
    begin = int(table.offsets[first])
    here = slice(begin, begin + len(more))
    pair = table.pair[here]
    last = slice(first, int(pair[-1]) + 1)
    earned = []
    for own, bottom, later in zip(gain[here], below[pair], more, strict=True):
        earned.append(Fraction(own, bottom) + later)
    gain[here], below[last] = over_groups(earned, table.offsets[first : last.stop + 1] - begin)
    paid = table.with_reward(to_integer_array(gain.tolist()), to_integer_array(below.tolist()))
    if table.components is None:
        return names, replace(paid, averaged=table.averaged)
    # The terminal value becomes a component of its own, under a name that is still free.
    if table.parted_by_outcome:
        amounts, bottoms = table.components, table.component_denominator
    else:
        amounts, bottoms = table.expected_components_exact()
    columns = [(column, bottoms) for column in amounts.T]
    name = TERMINAL_VALUE
    while name in names:
        name += "'"
    columns.append(_of_last(table, begin, more))
    return (*names, name), replace(with_components(paid, columns), averaged=table.averaged)


def _of_last(table: OutcomeTable, begin: int, more: Sequence[Fraction]) -> tuple[Numbers, Numbers]:
    """Return amounts (N,) over denominators (L,): 0, but `more` from outcome `begin` on."""
    values = [Fraction(0)] * len(table.next)
    values[begin : begin + len(more)] = more
    return over_groups(values, table.offsets)


def _in_columns(model: Parts, over: Flags) -> StateSpace:
    """Return the state space; without columns if the process continues in an extra state."""
    space = model.space
    if over[space.regular :].all() and space.columns:
        return space
    return StateSpace.plain(space.size, space.labels(range(space.size)))


def _check_size(table: OutcomeTable, own: int, count: int) -> None:
    """Raise ModelError if the table of one step, repeated `count` times, is too large."""
    kinds = (table.weight.dtype, table.gain.dtype, table.denominator.dtype)
    each = estimate_outcome_bytes(wide=object in kinds)
    states = own * (count + 1)
    outcomes, pairs = len(table.next) * count + states, table.pairs * count + states
    # Beside the table, an audit was measured to take 20 bytes for each outcome, 250 for each
    # pair and 560 for each state.
    size = (each + 20) * outcomes + 250 * pairs + 560 * states
    if size > MOST_BYTES:
        raise ModelError(
            f"{count:,} steps of this model make {states:,} states and {outcomes:,} outcomes: "
            f"{size / 1e9:,.0f} GB of memory, more than {MOST_BYTES / 1e9:g} GB",
            where="horizon",
            fix="choose fewer steps; or no horizon, if the process ends by itself or late steps "
            "hardly count",
        )


def _list_next_states(
    model: Parts, own: int, over: Flags, rows: Integers, table: OutcomeTable, count: int
) -> Numbers:
    """Return the next states of all times: one time later, unless the episode is over."""
    lengths = np.diff(table.offsets)
    # From time t, a state of the product moves to layer t + 1, a finished one stays in its layer,
    # and an extra state keeps its place behind all layers.
    after, time = table.next.astype(np.int64), np.arange(count)
    later = np.repeat(~over[model.pair_state[rows]], lengths).astype(np.int64)
    shift = np.where(after < own, own * (time[:, None] + later), own * count)
    following = np.concatenate([(after + shift).ravel(), np.arange(model.n_states) + own * count])
    if own * (count + 1) + model.n_states < 2**31:
        return following.astype(np.int32)
    return following
