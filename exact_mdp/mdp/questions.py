"""Questions about a model, as models whose optimal value is the answer.

The probability of reaching a set T through a set C is a total reward at discount 1: the step into T
earns 1 and ends, as does the first step from T; runs outside C ∪ T end with 0. The reward until T
is that of the model in which T is absorbing; a run that never reaches T is worth +∞, as PRISM and
Storm define R[F T]. Episodes of N steps have the time in their states, which makes a model without
cycles:

    V_N(s) = 0,    V_t(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V_{t+1}(s')

With terminal values v the last step earns γ v(s') beside its reward; a state in which all is over
goes on until time N where its v is not 0. States of `reaching` and `until` keep their numbers and
pairs, so that policies for the model are policies here.

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
    NARROW,
    WIDE,
    Integers,
    Numbers,
    OutcomeTable,
    exact,
    make_ones,
    over_groups,
    to_integer_array,
)
from exact_mdp.mdp.validate import Flags, Parts, numbers_by_state, require_count

REACHED, TERMINAL_VALUE = "reached", "terminal value"
FLOATS, OF_PAIR, OF_STATE = 20, 250, 560
"""Bytes beside the table for each outcome, pair and state that an audit takes, as measured."""
ONE_COMPONENT = {"component_names": ("reward",)}
# Other rows than those that were observed; a pair has no number of them for each time either.
NO_DATA: dict[str, Any] = {"observations": None, "episodes": None}


@dataclass(frozen=True)
class Question:
    """A question about a model: a method of `MDP` that makes another model, and its options."""

    method: str
    options: Mapping[str, Any]

    def __call__(self, model: Any) -> Any:
        """Return the model that answers the question about another one."""
        return getattr(model, self.method)(**self.options)


@dataclass(frozen=True)
class Origin:
    """The model that a question was asked about, and the questions, the first one first.

    The parameters of a question are those of this model: a row of it may be many rows of the model
    that answers, such as one for each time.
    """

    model: Any
    questions: tuple[Question, ...]

    @property
    def paid(self) -> bool:
        """Whether states are worth something at a horizon; a probability pays nothing."""
        if any(each.method == "reaching" for each in self.questions):
            return False
        return any(each.options.get("terminal_value") is not None for each in self.questions)

    def without_terminal_value(self) -> Origin:
        """Return the same questions, where states are worth nothing at a horizon."""
        asked = (
            replace(each, options={**each.options, "terminal_value": None})
            if "terminal_value" in each.options
            else each
            for each in self.questions
        )
        return replace(self, questions=tuple(asked))

    def rebuild_model(self) -> Any:
        """Return the model that answers."""
        return reduce(lambda model, ask: ask(model), self.questions, self.model)


def origin_of(model: Any) -> Origin | None:
    """Return the origin of a model that answers a question; None where there is none."""
    found: Origin | None = vars(model).get("origin")
    return found


def repeats_in_time(model: Any) -> bool:
    """Return whether a model without origin looks like one that `within` made.

    Its first column is the time, every step leads to the next one, and the rows of time 0 are those
    of time 1.
    """
    space, table = model.space, model.table
    if not space.columns or space.names[0] != TIME or space.columns[0].size < 3:
        return False
    own = space.regular // space.columns[0].size
    first, second = (np.flatnonzero(model.pair_state // own == time) for time in (0, 1))
    here, there = table.of_pairs(first), table.of_pairs(second)
    same = np.array_equal(np.diff(here.offsets), np.diff(there.offsets))
    same = same and np.array_equal(model.pair_action[first], model.pair_action[second])
    if not same:
        return False
    later = np.where(here.next < space.regular, here.next + own, here.next)
    rows = (here.weight, there.weight), (here.denominator, there.denominator)
    return np.array_equal(later, there.next) and all(np.array_equal(*each) for each in rows)


def keep_origin(answer: Any, asked_of: Any, method: str, **options: Any) -> Any:
    """Return a model that answers a question, which knows from now on what it was asked of."""
    before = origin_of(asked_of) or Origin(asked_of, ())
    question = Question(method, options)
    vars(answer)["origin"] = Origin(before.model, (*before.questions, question))
    return answer


def keep_origin_changed(
    answer: Any, asked_of: Any, discount: object | None, changes: Mapping[str, Any]
) -> None:
    """Let a copy with other parts know its origin, as `keep_origin` does.

    Another discount is one of the origin's model, whose parameter it is. Where that would answer
    something else, as of a probability that counts no discount, the copy has no origin.
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
    """What can be asked of a model: other models."""

    def reaching(self, label: str, allowed: str | None = None) -> Self:
        """Return the model whose value is the probability of reaching a labelled state.

        One more state, `reached`, takes the place of those of the label, which keep the value 1.
        The optimum is the greatest probability; the least one where the sense is "min". There is no
        discount. With `within(N)`, before or after, it is the probability within N steps.

        Parameters
        ----------
        label : str
            One of `labels`.
        allowed : str, optional
            The label of the states that may be passed through; all unless given.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            Where a label is unknown, or a start is not allowed.

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
        outside = (
            np.zeros(size, dtype=bool) if allowed is None else ~find_labelled_states(self, allowed)
        )
        for state, chance in self.start:
            if chance > 0 and outside[state] and not target[state]:
                raise ModelError(
                    f"the start, {space.place(state)}, is not among the allowed states",
                    where=f"allowed {allowed!r}",
                    fix="allow it, or start elsewhere",
                )
        states, pairs = np.append(self.pair_state, size), self.n_pairs
        table = _redirect_pairs(
            self.table.with_reward(np.zeros(pairs, np.int64), make_ones(pairs)),
            np.append((target | outside)[self.pair_state], True),
            np.where(np.append(target, False)[states], size, states),
        )
        arrives = np.append(target, True)[table.next]
        order = np.argsort(
            2 * table.pair + arrives, kind="stable"
        )  # the new state has the last number
        arrives = arrives[order]
        table = replace(
            table.map_numbers(lambda _, values: values, lambda _, values: values[order]),
            next=np.where(arrives, table.next.dtype.type(size), table.next[order]),
        )
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

        At discount 1 a run that never gets there is worth +∞. The optimum is infinite where such a
        run has a chance under some policy; where costs are minimised, under all. With `within(N)`,
        before or after, these are the runs that do not get there within N steps.

        Parameters
        ----------
        label : str
            One of `labels`.
        reward : str, optional
            The reward component that counts; their sum unless given.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            Where the label or the component is unknown.

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
        model = self if reward is None else _with_component_reward(self, reward)
        goal = target if self.discount_exact == 1 else None
        _refuse_paid_goal(model, label)
        until: Self = make_terminal(model, target, goal=goal, target=target)
        asked: Self = keep_origin(until, model, "until", label=label)
        return asked

    def within(self, steps: int, *, terminal_value: object = None) -> Self:
        """Return the model of episodes that stop after N steps.

        A column `time` comes before the model's own: states are those of time 0, of time 1, and so
        on to time N, where all is over; extra states, such as an end, keep no time. Everything
        that takes a model takes this one. Policies over the model's own states or columns are
        policies of this one, too, the same at every time.

        Parameters
        ----------
        steps : int
            N, 1 or more.
        terminal_value : (S,) numbers or {state: number}, optional
            What each state is worth at time N, where no reward follows unless it is given; a state
            that is not named is worth 0. The last step earns it, discounted once, so that values at
            time N itself are 0. With components, it is one more: "terminal value".

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            Where `steps` is not a positive whole number, the model would not fit in memory, or it
            has a column `time` already; for a terminal value that is not finite.

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
        mdp: Any = self  # which is whole
        offsets, over = mdp.pair_offsets, mdp.over
        values = [] if terminal_value is None else _read_terminal_values(terminal_value, self.space)
        if self.target is not None:
            for state in np.flatnonzero(self.target).tolist():
                if values and values[state]:
                    raise _paid_goal(self.space.place(state))
        if any(values):
            over = over & np.array([value == 0 for value in values])
        count, space = require_count(steps, "horizon"), _in_columns(self, over)
        own, states = space.regular, self.n_states
        origin = origin_of(self)
        if origin is not None and any(each.method == "within" for each in origin.questions):
            raise ModelError(
                "the model stops after a number of steps already",
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
            """Return what each of the times 0 … N-1 has, and what the last one has."""
            return np.concatenate([np.tile(values, (count, *[1] * (values.ndim - 1))), last])

        def append_end(name: str, values: Numbers) -> Numbers:
            return repeat_layers(values, _fill_certain(name, values, states))

        lengths = repeat_layers(np.diff(table.offsets), np.ones(states, np.int64))
        layered = replace(
            table.map_numbers(append_end, append_end),
            offsets=np.concatenate([[0], np.cumsum(lengths)]),
            next=_list_next_states(self, own, over, rows, table, count),
        )
        time = np.repeat(np.arange(count + 1), [*[len(rows)] * count, states])

        def repeat_flags(flags: Flags) -> Flags:
            return np.append(np.tile(flags[:own], count + 1), flags[own:])

        names = self.component_names
        if any(values):
            later = [self.discount_exact * values[state] for state in table.next]
            names, layered = _add_terminal_values(layered, len(rows) * (count - 1), later, names)
        parts = {
            "table": layered,
            "component_names": names,
            "pair_state": repeat_layers(self.pair_state[rows], np.arange(states)) + own * time,
            "pair_action": repeat_layers(self.pair_action[rows], self.pair_action[offsets[:-1]]),
            "space": StateSpace(
                columns=(Column(name=TIME, size=count + 1), *space.columns), extra=space.extra
            ),
            "start": tuple((s if s < own else s + own * count, weight) for s, weight in self.start),
            "time_limit": None,
            "labels": {name: repeat_flags(flags) for name, flags in self.labels.items()},
            "goal": None if self.goal is None else repeat_flags(self.goal),
            "target": None if self.target is None else repeat_flags(self.target),
            **NO_DATA,
        }
        options = {"steps": count, "terminal_value": terminal_value}
        stopped: Self = keep_origin(replace(self, **parts), self, "within", **options)
        return stopped


def _refuse_paid_goal(model: Any, label: str) -> None:
    """Raise ModelError where a state of a label is worth something at the horizon of a model."""
    origin = origin_of(model)
    if origin is None or not origin.paid:
        return
    own, inside = origin.model.space, origin.model.labels.get(label, [])
    for question in origin.questions:
        given = question.options.get("terminal_value")
        values = [] if given is None else _read_terminal_values(given, own)
        for state in np.flatnonzero(inside).tolist():
            if values and values[state]:
                raise _paid_goal(own.place(state))


def _paid_goal(where: str) -> ModelError:
    """Return the error of a goal whose states are worth something at a horizon."""
    return ModelError(
        "a run that has reached the goal is over, and is paid no terminal value at the horizon",
        where=f"terminal_value, {where}",
        fix="leave the states of the goal out of terminal_value, and pay what an arrival is worth "
        "as a reward of the step that arrives",
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
        # What states are worth at a horizon is a component of its own, which does not count.
        unpaid = origin.without_terminal_value()
        return replace(unpaid, model=_with_component_reward(origin.model, name)).rebuild_model()
    table = model.table.with_component_reward(model.component_names.index(name))
    return replace(model, table=table, component_names=(name,))


def describe_time_limit(model: Parts, within: str) -> list[str]:
    """Return the note that an answer leaves out the environment's limit; `within` keeps it."""
    if model.time_limit is None:
        return []
    also = f": {within.format(model.time_limit)}" if within else ""
    return [
        f"the environment stops after {model.time_limit:,} steps; this answer is for episodes "
        f"without a limit{also}"
    ]


def describe_sense(model: Parts) -> str:
    """Return in words what is least or greatest; nothing where rewards are maximised."""
    if REACHED in model.space.extra:
        best = "least" if model.sense == "min" else "greatest"
        return f"{best} probability of reaching"
    return "costs to minimise" if model.sense == "min" else ""


def find_labelled_states(model: Parts, label: str) -> Flags:
    """Return the states (S,) of a label, if any; raises ModelError where the label is unknown.

    So it does in the model of another question, where runs are over that the label may be asked of.
    """
    if model.target is not None or REACHED in model.space.extra:
        raise ModelError(
            "this is the model of a question already, which ends runs",
            where=f"label {label!r}",
            fix="ask the model that it was made from, or give a label to the states that both mean",
        )
    if not model.labels:
        raise ModelError(
            f"unknown label {label!r}",
            where="labels",
            fix="the model has none: build it with labels={name: (S,) truth values}",
        )
    return model.labels[require_known_name(label, model.labels, "label", "labels")]


def _redirect_pairs(table: OutcomeTable, ends: Flags, follows: Numbers) -> OutcomeTable:
    """Return the table whose marked pairs lead for sure to the states that follow, and earn 0.

    `ends` and `follows` may say this of one more pair, which is appended.
    """

    def append_certain_pair(name: str, values: Numbers) -> Numbers:
        return np.concatenate([values, _fill_certain(name, values, 1)])

    ending = replace(
        table.map_numbers(append_certain_pair, append_certain_pair),
        offsets=np.append(table.offsets, table.offsets[-1] + 1),
        next=np.append(table.next, table.next.dtype.type(0)),
    )
    ended = ending.of_pairs(np.where(ends, table.pairs, np.arange(len(ends))))
    lengths = np.diff(ended.offsets)
    moved = np.repeat(np.asarray(follows), lengths).astype(ended.next.dtype)
    return replace(ended, next=np.where(np.repeat(ends, lengths), moved, ended.next))


def make_terminal(model: Any, states: Flags, **changes: Any) -> Any:
    """Return the model with some states (S,) made terminal, and with other changes."""
    table = _redirect_pairs(model.table, states[model.pair_state], model.pair_state)
    return replace(model, table=table, **NO_DATA, **changes)


def _fill_certain(name: str, values: Numbers, count: int) -> Numbers:
    """Return the numbers of a name for outcomes that are certain, and earn 0."""
    one = name == "weight" or name.endswith("denominator")
    return np.full((count, *values.shape[1:]), int(one), dtype=values.dtype)


# ---- episodes of N steps -------------------------------------------------------------------------


def split_by_time(model: Any, weights: Numbers, steps: int) -> Numbers:
    """Return (N, L) what pairs of `model.within(N)` have, by time and pair of the model itself."""
    rows = _select_active_pairs(model, model.pair_offsets, model.over)
    by_step = np.zeros((steps, model.n_pairs))
    by_step[:, model.pair_offsets[:-1][model.over]] = 1.0
    by_step[:, rows] = weights[: steps * len(rows)].reshape(steps, len(rows))
    return by_step


def _select_active_pairs(model: Parts, offsets: Integers, over: Flags) -> Integers:
    """Return the pairs that each time but the last has: a single one where all is over."""
    inside = ~over[model.pair_state]
    inside[offsets[:-1][over]] = True
    return np.flatnonzero(inside[: offsets[_in_columns(model, over).regular]])


def _read_terminal_values(numbers: object, space: StateSpace) -> list[Fraction]:
    """Return a number for each state: from a vector, or from {state: number}, 0 for the others."""
    with locate_errors("terminal_value"):
        values = numbers_by_state(list(numbers) if isinstance(numbers, tuple) else numbers, space)
        if values is None:
            raise ModelError(
                f"a {type(numbers).__name__} does not say what each state is worth",
                fix="give one number for each state, or {state: number}",
            )
        return [exact(values.get(state, 0)) for state in range(space.size)]


def _add_terminal_values(
    table: OutcomeTable, first: int, more: Sequence[Fraction], names: tuple[str, ...]
) -> tuple[tuple[str, ...], OutcomeTable]:
    """Return a table whose outcomes from pair `first` on earn so much more; and its components."""
    gain, below = table.integer_gains()
    gain = (gain[table.pair] if len(gain) == table.pairs else gain).astype(object)
    below = below.astype(object)
    begin = int(table.offsets[first])
    here = slice(begin, begin + len(more))
    pair = table.pair[here]
    last = slice(first, int(pair[-1]) + 1)
    earned = [
        Fraction(own, bottom) + later
        for own, bottom, later in zip(gain[here], below[pair], more, strict=True)
    ]
    gain[here], below[last] = over_groups(earned, table.offsets[first : last.stop + 1] - begin)
    paid = table.with_reward(to_integer_array(gain.tolist()), to_integer_array(below.tolist()))
    if table.components is None:
        return names, replace(paid, averaged=table.averaged)
    parts = table.components if table.parted_by_outcome else None
    amounts, bottoms = table.expected_components_exact()
    if parts is not None:
        amounts, bottoms = parts, table.component_denominator
    columns = [(column, bottoms) for column in amounts.T]
    name = TERMINAL_VALUE
    while name in names:
        name += "'"
    columns.append(_of_last(table, begin, more))
    return (*names, name), replace(with_components(paid, columns), averaged=table.averaged)


def _of_last(table: OutcomeTable, begin: int, more: Sequence[Fraction]) -> tuple[Numbers, Numbers]:
    """Return amounts (N,) over denominators (L,) that are 0 but for some, from an outcome on."""
    values = [Fraction(0)] * len(table.next)
    values[begin : begin + len(more)] = more
    return over_groups(values, table.offsets)


def _in_columns(model: Parts, over: Flags) -> StateSpace:
    """Return the states, in one plain column where the process goes on in an extra state."""
    space = model.space
    if over[space.regular :].all() and space.columns:
        return space
    return StateSpace.plain(space.size, space.labels(range(space.size)))


def _check_size(table: OutcomeTable, own: int, count: int) -> None:
    """Raise ModelError where the table of one step is too large to be repeated so often."""
    wide = object in (table.weight.dtype, table.gain.dtype, table.denominator.dtype)
    each, states = FLOATS + (WIDE if wide else NARROW), own * (count + 1)
    outcomes, pairs = len(table.next) * count + states, table.pairs * count + states
    size = each * outcomes + OF_PAIR * pairs + OF_STATE * states
    if size > MOST_BYTES:
        raise ModelError(
            f"{count:,} steps of this model make {states:,} states and {outcomes:,} outcomes: "
            f"{size / 1e9:,.0f} GB of memory, more than {MOST_BYTES / 1e9:g} GB",
            where="horizon",
            fix="choose fewer steps, or none where the process ends by itself or the discount "
            "leaves late steps no weight",
        )


def _list_next_states(
    model: Parts, own: int, over: Flags, rows: Integers, table: OutcomeTable, count: int
) -> Numbers:
    """Return the next states: a step later, but where all is over and at time N."""
    lengths = np.diff(table.offsets)
    after, time = table.next.astype(np.int64), np.arange(count)
    later = np.repeat(~over[model.pair_state[rows]], lengths).astype(np.int64)
    shift = np.where(after < own, own * (time[:, None] + later), own * count)
    following = np.concatenate([(after + shift).ravel(), np.arange(model.n_states) + own * count])
    return following.astype(np.int32) if own * (count + 1) + model.n_states < 2**31 else following
