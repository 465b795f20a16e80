"""A finite Markov decision process: one sparse row per available state-action pair.

    V(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V(s')

Pairs are sorted by state, then action; an action that a state does not offer has no row, so there
are no infinite penalties and no padding. The exact table of outcomes is the source; the sparse
matrix and the expected rewards are derived from it, each number rounded once.

The layout follows the state-action-pair formulation of Puterman, Markov Decision Processes
(1994), section 2.1.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp import build, questions
from exact_mdp.mdp.components import named_components, wrong_rows
from exact_mdp.mdp.errors import ModelError, ShapeError, located, of_type, suggest, words_of
from exact_mdp.mdp.forms import explore
from exact_mdp.mdp.forms.names import Names, Told, object_key, text_of
from exact_mdp.mdp.forms.numbers import whole_numbers
from exact_mdp.mdp.io import gymnasium, transitions
from exact_mdp.mdp.result import ROWS_SHOWN, ByFields, as_html
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Integers, Numbers, OutcomeTable, spans
from exact_mdp.mdp.validate import (
    Parts,
    as_discount,
    as_flags,
    as_labels,
    as_start,
    check_model,
    check_options,
    counted,
)

if TYPE_CHECKING:
    from pandas import DataFrame

Found = TypeVar("Found")
SHOWN = (
    *("from_arrays", "from_pairs", "from_outcomes", "from_function", "from_gymnasium"),
    *("from_transitions", "load", "save", "with_", "within", "reaching", "until", "frame"),
    *("n_states", "n_actions", "n_pairs", "space", "actions", "discount", "start", "sense"),
    *("labels", "name", "table", "transition", "reward", "components", "counts", "P", "R"),
)
"""What is listed of a model, and completed: what is asked of it from outside."""


@dataclass(frozen=True, eq=False)
class MDP(ByFields, Parts):
    """A frozen, validated finite MDP with S states, A actions and L state-action pairs.

    Build one with `MDP.from_arrays`, `from_pairs`, `from_outcomes`, `from_function`,
    `from_gymnasium` or `from_transitions`, `MDP.load` or `Scenario.compile`; this constructor takes
    the parts themselves.

    Attributes
    ----------
    table : OutcomeTable
        Exact outcomes of every pair.
    pair_state, pair_action : (L,) int64
        State and action of each pair, sorted by state, then action, without duplicates.
    space : StateSpace
        What the state numbers mean.
    actions : tuple of str
        Action names, A of them.
    discount_exact : Fraction
        The discount γ in [0, 1].
    start : tuple of (state, probability)
        Initial distribution, by the numbers of states; state 0 unless said otherwise.
    component_table, component_names : ComponentTable or None, tuple of str
        Exact expected reward by component, of which there are C; None where the reward is the only
        one. `components` has it in floats (L, C), whose row sums are `reward`.
    events : tuple of str
        Names of the bits of `table.event`.
    time_limit : int, optional
        The number of steps after which the environment that the model was made from stops. No
        transition knows of it: `within` makes the model of episodes that stop.
    sense : "max" or "min"
        Whether rewards are to be maximised, or are costs to be minimised. All numbers of the model
        and of what is found for it are as given; no sign changes.
    labels : {str: (S,) bool}
        Named sets of states; `reaching` and `until` ask about them.
    goal : (S,) bool, optional
        Of a model that `until` made: a run that never reaches one of these states is worth
        `unreached`, which is infinity.

    action_objects : tuple
        What the actions were made of, where these were objects other than 0 … A-1.
    observations : (L,) int64, optional
        How often each pair was observed, where the model comes from data; 0 for pairs that nobody
        observed and that are certain.
    episodes : int, optional
        How many recorded episodes `start` was counted from; None where the start is known.
    float_probabilities, float_rewards : bool
        Whether some were given as floats, which stand for what they were rounded from.

    Raises
    ------
    ModelError
        For any row that is not a distribution, used or not; duplicate pairs; numbers that are
        NaN, infinite or out of range; a state without action; a discount outside [0, 1].

    Notes
    -----
    Models are equal whose content is, by `fingerprint`: names and labels do not count.

    Examples
    --------
    >>> import numpy as np
    >>> stay, go = np.eye(2), np.array([[0.0, 1.0], [0.0, 1.0]])
    >>> mdp = MDP.from_arrays([stay, go], np.array([[1.0, 0.0], [0.0, 0.0]]), discount=0.5)
    >>> mdp.n_states, mdp.n_pairs, mdp.discount
    (2, 4, 0.5)
    """

    transition: sp.csr_array = field(init=False, repr=False)
    reward: Floats = field(init=False, repr=False)
    pair_offsets: Integers = field(init=False, repr=False)

    def __post_init__(self) -> None:
        fill = object.__setattr__
        if isinstance(self.table, OutcomeTable):
            fill(self, "table", self.table.settled())
        check_model(self)
        for name, numbers in (("probabilities", self.table.weight), ("rewards", self.table.gain)):
            if numbers.dtype == np.float64:
                fill(self, f"float_{name}", True)
        fill(self, "start", Told(self.start))
        if self.observations is not None:
            fill(self, "observations", whole_numbers(self.observations, "observations"))
        if self.time_limit is not None:
            fill(self, "time_limit", counted(self.time_limit, "time_limit"))
        fill(self, "labels", as_labels(self.labels, self.n_states))
        if self.goal is not None:
            fill(self, "goal", as_flags(self.goal, self.n_states, "goal"))
        offsets = np.zeros(self.n_states + 1, dtype=np.int64)
        np.cumsum(np.bincount(self.pair_state, minlength=self.n_states), out=offsets[1:])
        fill(self, "pair_offsets", offsets)
        fill(self, "transition", _transition(self.table, self.n_states))
        fill(self, "reward", self.table.expected_gain())
        if not np.all(np.isfinite(self.reward)):
            raise ModelError("an expected reward is too large for a float", fix="scale the rewards")
        _check_components(self)
        for array in self._arrays():
            array.setflags(write=False)
        if self.goal is not None and not self.terminal[self.goal].all():
            raise ModelError(
                "a run goes on, or earns, in a state of the goal",
                where="goal",
                fix="use until, which ends every run there",
            )

    def _arrays(self) -> Iterable[NDArray[Any]]:
        table, matrix = self.table, self.transition
        yield from (matrix.data, matrix.indices, matrix.indptr, self.reward)
        if self.component_table is not None:
            yield from (self.component_table.amount, self.component_table.denominator)
        yield from (self.pair_state, self.pair_action, self.pair_offsets)
        yield from (table.offsets, table.next, table.weight, table.denominator)
        yield from (table.gain, table.gain_denominator)
        yield from self.labels.values()
        optional = (table.event, self.goal, self.observations)
        yield from (part for part in optional if part is not None)

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        for array in self._arrays():
            array.setflags(write=False)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MDP):
            return NotImplemented
        import exact_mdp

        return self is other or exact_mdp.fingerprint(self) == exact_mdp.fingerprint(other)

    def __hash__(self) -> int:
        return hash((self.n_states, self.n_pairs, self.n_transitions))

    def __dir__(self) -> tuple[str, ...]:
        return SHOWN

    def __repr__(self) -> str:
        return (
            f"MDP({self.name or 'unnamed'}: {self.n_states} states, {self.n_actions} actions, "
            f"{self.n_pairs} pairs, {self.n_transitions} transitions, discount {self._rate}"
            f"{', costs to minimise' if self.sense == 'min' else ''})"
        )

    def frame(self, states: object = None) -> DataFrame:
        """Return the outcomes as a table, with exact numbers.

        Parameters
        ----------
        states : state, or iterable of states, optional
            Those whose outcomes are wanted, by number or by name; all by default.

        Returns
        -------
        DataFrame
            One row for each outcome: state, action, next state, probability, reward.

        Raises
        ------
        ModelError
            For a state that there is not.

        Examples
        --------
        >>> mdp = MDP.from_pairs([0, 1], [0, 0], [["1/3", "2/3"], [0, 1]], [5, 0])
        >>> print(mdp.frame([0]).to_csv(index=False))
        state,action,next state,probability,reward
        state 0,0,state 0,1/3,5
        state 0,0,state 1,2/3,5
        """
        chosen = range(self.n_states) if states is None else self.space.numbers(states)
        return self._outcomes(pair for state in chosen for pair in self.pairs_of(state))

    def _outcomes(self, pairs: Iterable[int]) -> DataFrame:
        import pandas

        label = self.space.label
        rows = [
            (label(self.pair_state[pair]), self.actions[self.pair_action[pair]], label(after), p, r)
            for pair in pairs
            for p, after, r in self.table.row(pair)
        ]
        earned = "cost" if self.sense == "min" else "reward"
        names = ["state", "action", "next state", "probability", earned]
        return pandas.DataFrame(rows, columns=names)

    def _repr_html_(self) -> str:
        few = self._outcomes(range(min(self.n_pairs, ROWS_SHOWN)))
        return as_html(repr(self), few, rows=len(self.table.next))

    @property
    def _rate(self) -> str:
        """The discount in print: exact where that is short."""
        short = self.discount_exact.denominator < 10**9
        return str(self.discount_exact) if short else f"{self.discount:.12g}"

    # ---- sizes -------------------------------------------------------------------------------

    @property
    def n_transitions(self) -> int:
        """Number of positive entries of the (L, S) transition matrix."""
        return int(self.transition.nnz)

    # ---- views -------------------------------------------------------------------------------

    @cached_property
    def discount(self) -> float:
        """The discount as a float."""
        return float(self.discount_exact)

    @cached_property
    def start_distribution(self) -> Floats:
        """(S,) the initial distribution."""
        weights = np.zeros(self.n_states)
        for state, probability in self.start:
            weights[state] = float(probability)
        weights.setflags(write=False)
        return weights

    @cached_property
    def counts(self) -> sp.csr_array | None:
        """(L, S) how often each pair was seen to lead to each state; None without data.

        Rows of pairs that nobody observed, such as those of the states in which all is over, are
        empty. `observations` (L,) holds the row sums.
        """
        if self.observations is None:
            return None
        table = self.table
        seen = np.where(np.repeat(self.observations > 0, np.diff(table.offsets)), table.weight, 0)
        counts = sp.csr_array(
            (seen.astype(np.int64), table.next, table.offsets),
            shape=(self.n_pairs, self.n_states),
            copy=True,
        )
        counts.sum_duplicates()
        counts.eliminate_zeros()
        return counts

    @cached_property
    def components(self) -> Floats:
        """(L, C) the expected reward of each pair by component."""
        table = self.component_table
        found = self.reward[:, None] if table is None else table.floats()
        found.setflags(write=False)
        return found

    def component(self, name: str) -> tuple[Numbers, Numbers]:
        """Return integers (L,), (L,) whose ratio is the expected amount of a component, exactly.

        Examples
        --------
        >>> mdp = MDP.from_arrays([[[1]]], [1], "1/2", components={"effort": ["-1/3"]})
        >>> mdp.component_names, [int(part[0]) for part in mdp.component("effort")]
        (('effort', 'rest'), [-1, 3])
        """
        if name not in self.component_names:
            raise ModelError(
                f"unknown component {name!r}",
                where="components",
                fix=suggest(name, self.component_names),
            )
        if self.component_table is None:
            return self.table.expected_gain_exact()
        amount, denominator = self.component_table.exact()
        return np.asarray(amount[:, self.component_names.index(name)]), denominator

    @cached_property
    def forced(self) -> NDArray[np.bool_]:
        """(S,) True where a state has a single action."""
        return np.asarray(np.diff(self.pair_offsets) == 1)

    @cached_property
    def terminal(self) -> NDArray[np.bool_]:
        """(S,) True where every action stays put for ever and earns nothing: it is worth 0.

        What is counted beside the reward may differ there; see `over`.
        """
        indptr = self.transition.indptr
        stays = np.diff(indptr) == 1
        alone = np.flatnonzero(stays)
        if not len(alone):
            return np.zeros(self.n_states, dtype=bool)
        stays[alone] = self.transition.indices[indptr[alone]] == self.pair_state[alone]
        # Of a pair that only stays, every outcome stays; others need not be looked at.
        alone = np.flatnonzero(stays)
        table = self.table
        if len(table.gain) == self.n_pairs:
            stays[alone] = table.gain[alone] == 0
        else:
            counts = table.offsets[alone + 1] - table.offsets[alone]
            before = np.cumsum(counts) - counts
            places = np.arange(counts.sum()) + np.repeat(table.offsets[alone] - before, counts)
            if len(alone):
                stays[alone] = ~np.logical_or.reduceat(table.gain[places] != 0, before)
        return np.asarray(np.logical_and.reduceat(stays, self.pair_offsets[:-1]))

    @cached_property
    def over(self) -> NDArray[np.bool_]:
        """(S,) True where all is over: terminal, without any component or event to be counted."""
        counted = np.zeros(self.n_pairs, dtype=bool)
        if self.component_table is not None:
            counted |= np.asarray(self.component_table.amount != 0, dtype=bool).any(axis=1)
        if self.table.event is not None:
            counted |= np.logical_or.reduceat(self.table.event != 0, self.table.offsets[:-1])
        return self.terminal & ~np.logical_or.reduceat(counted, self.pair_offsets[:-1])

    @cached_property
    def asked(self) -> NDArray[np.bool_]:
        """(S,) True where a policy has to say what is done: it has a choice, and not all is over.

        Elsewhere a policy may say anything, or nothing.
        """
        return ~self.forced & ~self.over

    def by_action(self, values: ArrayLike, missing: float = np.nan) -> NDArray[Any]:
        """Return a table (S, A) of numbers of pairs (L,), `missing` where there is no pair.

        Truth values are False there.

        Examples
        --------
        >>> mdp = MDP.from_pairs([0, 0, 1], [0, 1, 1], [[0, 1]] * 3, [5, "1/2", 0])
        >>> mdp.by_action(mdp.reward).tolist(), mdp.R.tolist()
        ([[5.0, 0.5], [nan, 0.0]], [[5.0, 0.5], [-inf, 0.0]])
        """
        array = np.asarray(values)
        if array.shape != (self.n_pairs,):
            raise ShapeError(
                f"an array of shape {array.shape}, not ({self.n_pairs},)",
                where="by_action",
                fix="give one number for each pair",
            )
        kind = array.dtype if array.dtype.kind in "bO" else np.result_type(array, np.float64)
        fill = False if array.dtype.kind == "b" else missing
        table = np.full((self.n_states, self.n_actions), fill, dtype=kind)
        table[self.pair_state, self.pair_action] = array
        return table

    @property
    def R(self) -> Floats:
        """(S, A) expected rewards; -inf (of costs inf) where an action is not offered."""
        return self.by_action(self.reward, np.inf if self.sense == "min" else -np.inf)

    def P(self, action: object) -> sp.csr_array:
        """Return the (S, S) transitions of an action; rows are empty where it is not offered.

        Examples
        --------
        >>> mdp = MDP.from_pairs([0, 0, 1], [0, 1, 1], [[0, 1]] * 3, [5, "1/2", 0])
        >>> mdp.P(0).toarray().tolist(), mdp.P("1").toarray().tolist()
        ([[0.0, 1.0], [0.0, 0.0]], [[0.0, 1.0], [0.0, 1.0]])
        """
        taking = np.flatnonzero(self.pair_action == self.action(action))
        rows = self.transition[taking]
        lengths = np.zeros(self.n_states, dtype=np.int64)
        lengths[self.pair_state[taking]] = np.diff(rows.indptr)
        indptr = np.concatenate([[0], np.cumsum(lengths)])
        return sp.csr_array((rows.data, rows.indices, indptr), (self.n_states, self.n_states))

    @cached_property
    def indifferent(self) -> NDArray[np.bool_]:
        """(S,) True where all actions have the same outcomes and amounts, number for number."""
        table, first = self.table, self.pair_offsets[self.pair_state]
        lengths = np.diff(table.offsets)
        same = lengths == lengths[first]
        rows = np.flatnonzero(same)
        here, there = (spans(table.offsets[x], table.offsets[x + 1]) for x in (rows, first[rows]))
        alike = np.ones(len(here), dtype=bool)
        for values in (table.next, table.weight, table.gain, table.event):
            if values is None:
                continue
            if len(values) == len(table.next) and (values is not table.gain or table.joint):
                alike &= np.asarray(values[here] == values[there], dtype=bool)
            else:
                same &= np.asarray(values == values[first], dtype=bool)
        for bottom in (table.denominator, table.gain_denominator):
            same &= np.asarray(bottom == bottom[first], dtype=bool)
        if (known := self.component_table) is not None:
            equal = np.asarray(known.amount == known.amount[first], dtype=bool).all(axis=1)
            same &= equal & np.asarray(known.denominator == known.denominator[first], dtype=bool)
        ends = np.cumsum(lengths[rows])
        same[rows] &= np.logical_and.reduceat(alike, ends - lengths[rows])
        return np.asarray(np.logical_and.reduceat(same, self.pair_offsets[:-1]))

    def pairs_of(self, state: int) -> range:
        """Return the pairs of one state."""
        return range(int(self.pair_offsets[state]), int(self.pair_offsets[state + 1]))

    def pair(self, state: object, action: object = ...) -> int:
        """Return the number of a pair; `mdp.forms.names` says how state and action are given.

        A tuple of both will do, unless it is a state.

        Raises ModelError for what is neither, and where the state lacks the action.

        Examples
        --------
        >>> mdp = MDP.from_arrays({"rest": {"go": {"work": 1}}, "work": {}}, {"rest": 5, "work": 0})
        >>> mdp.pair("rest", "go"), mdp.pair(("rest", "go")), mdp.pair(0, 0)
        (0, 0, 0)
        """
        if action is ...:
            if not isinstance(state, tuple) or len(state) != 2 or self.space.holds(state):
                raise ModelError(
                    f"{state!r} is not a state and an action", where="pair", fix="give both"
                )
            state, action = state
        with located("states"):
            place = self.space.number(state)
        number = self.action(action)
        for pair in self.pairs_of(place):
            if self.pair_action[pair] == number:
                return pair
        offered = [self.actions[self.pair_action[pair]] for pair in self.pairs_of(place)]
        raise ModelError(
            f"action {self.actions[number]} is not available",
            where=f"state ({self.space.label(place)})",
            fix=f"choose one of {', '.join(offered)}",
        )

    def action(self, name: object) -> int:
        """Return the number of an action; `mdp.forms.names` says how it is given."""
        with located("actions"):
            return self.action_names.number(name)

    @cached_property
    def action_names(self) -> Names:
        """Which action is meant by a name, a number, or the object that it was made of."""
        made = enumerate(self.action_objects)
        return Names(
            what="action",
            size=self.n_actions,
            words={word: number for number, word in enumerate(self.actions)},
            label=self._action_label,
            objects={object_key(thing): number for number, thing in made},
            otherwise=self._printed_action,
        )

    def _action_label(self, number: int) -> str:
        return f"action {self.actions[number]}"

    def _printed_action(self, thing: object) -> int | None:
        return self.action_names.words.get(text_of(thing).removeprefix("action "))

    def backup(self, value: Floats) -> Floats:
        """Return (L,) action values r + γ P V for (S,) state values."""
        return np.asarray(self.reward + self.discount * (self.transition @ value))

    # ---- change ------------------------------------------------------------------------------

    def with_(
        self, *, discount: object | None = None, start: object | None = None, **parts: Any
    ) -> Self:
        """Return a copy with other parts, validated again.

        Parameters
        ----------
        discount : number or "p/q", optional
        start : state, {state: probability} or (S,) probabilities, optional
        **parts
            Any other attribute of the constructor, such as `name` or `actions`; `states`, a name
            for each; `components`, as in `from_arrays`, for each pair (L,).

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            As the constructor does.

        Examples
        --------
        >>> MDP.from_arrays([[[1]]], [1], "1/2").with_(discount="9/10").discount
        0.9
        """
        check_options(parts)
        if "states" in parts:
            parts["space"] = StateSpace.plain(self.n_states, parts.pop("states"))
        if "actions" in parts:
            parts["actions"] = words_of(parts["actions"], "actions")
        if discount is not None:
            parts["discount_exact"] = as_discount(discount)
        if "actions" in parts:
            parts = {"action_objects": ()} | parts
        if start is not None:
            parts["start"] = as_start(start, parts.get("space", self.space))
            parts.setdefault("episodes", None)
        if "table" in parts:
            parts = questions.NO_DATA | parts
            if not parts.keys() & {"components", "component_table"}:
                parts |= questions.ONE_COMPONENT
        if "components" in parts:
            if self.component_table is not None:
                parts.setdefault("component_names", self.component_names)
            parts |= named_components(parts, parts.get("table", self.table))
        return replace(self, **parts)

    def negated(self) -> MDP:
        """Return the model of the other sense, every reward times -1: the same policies are best.

        Its values are those of this model times -1. What maximises takes it instead of a model of
        costs.

        Returns
        -------
        MDP

        Examples
        --------
        >>> costs = MDP.from_arrays([[[0, 1], [0, 1]]], ["3/2", 0], sense="min")
        >>> costs.negated().sense, costs.negated().reward.tolist()
        ('max', [-1.5, 0.0])
        """
        gain = self.table.gain
        if gain.dtype == np.int64 and gain.min() == np.iinfo(np.int64).min:
            gain = gain.astype(object)
        return replace(
            self,
            table=replace(self.table, gain=-gain),
            component_table=None if self.component_table is None else -self.component_table,
            sense="max" if self.sense == "min" else "min",
            unreached=-self.unreached,
        )

    @property
    def floats(self) -> bool:
        """Whether probabilities or rewards were given as floats."""
        return self.float_probabilities or self.float_rewards

    @cached_property
    def undiscounted(self) -> MDP:
        """The model itself, or the same in which all steps count alike: discount 1."""
        return self if self.discount_exact == 1 else self.with_(discount=1)

    @property
    def maximised(self) -> MDP:
        """The model itself, or its negation where rewards are costs."""
        return self if self.sense == "max" else self._negated

    @cached_property
    def _negated(self) -> MDP:
        return self.negated()

    def reaching(self, label: str, allowed: str | None = None) -> MDP:
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
        >>> from exact_mdp import certify
        >>> walk = [["1/2", "1/6", "1/3"], [0, 1, 0], [0, 0, 1]]
        >>> mdp = MDP.from_arrays([walk], [0, 0, 0], labels={"home": [False, True, False]})
        >>> certify(mdp.reaching("home")).start_value
        Fraction(1, 3)
        """
        return replace(self, **questions.reaching(self, label, allowed))

    def until(self, label: str, reward: str | None = None) -> MDP:
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
        >>> from exact_mdp import certify
        >>> walk = [["1/3", "2/3"], [0, 1]]
        >>> mdp = MDP.from_arrays([walk], [1, 1], labels={"home": [False, True]})
        >>> certify(mdp.until("home")).value.tolist()
        [Fraction(3, 2), Fraction(0, 1)]
        """
        return replace(self, **questions.until(self, label, reward))

    def within(self, steps: int, *, terminal_value: object = None) -> MDP:
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
        >>> wait, go = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
        >>> mdp = MDP.from_arrays([wait, go], [[1, "3/2"], [0, 0]]).within(3)
        >>> mdp.space.names, mdp.n_states, mdp.space.label(2)
        (('time', 'state'), 8, 'time 1, state 0')
        >>> mdp.table.row(mdp.pair(2, 0))
        [(Fraction(1, 2), 4, Fraction(1, 1)), (Fraction(1, 2), 5, Fraction(1, 1))]
        """
        parts = questions.unrolled(
            self, steps, offsets=self.pair_offsets, over=self.over, terminal_value=terminal_value
        )
        return replace(self, **parts)

    # ---- construction ------------------------------------------------------------------------

    @classmethod
    def from_arrays(
        cls,
        P: object,
        R: object,
        discount: object = 1,
        *,
        layout: str | None = None,
        start: object = None,
        **names: Any,
    ) -> MDP:
        """Build from transition and reward arrays, or from dictionaries, lists and quadruples.

        Parameters
        ----------
        P : (A, S, S) or (S, A, S) array, A sparse (S, S) matrices, or {action: (S, S) matrix}
            Transition probabilities: Fractions, ints, "p/q" and floats in any mixture; each number
            keeps its exact value, a float that of the binary fraction that it is. Or P[s][a][t] in
            dictionaries and lists, or quadruples (s, a, t, p): see `mdp.forms.listed`.
        R : (S,), (S, A) or (A, S, S) array, a sparse (S, A) matrix, or A sparse (S, S) ones
            Rewards of states, of pairs, or of transitions; beside quadruples for P also triples
            (s, a, r) or quadruples (s, a, t, r). An action with the reward -inf (inf
            where rewards are costs) is not available, whatever P says of it; all others are.
        discount : number or "p/q"
        layout : "ass" or "sas", optional
            Order of the indices action and state, of P and of rewards of transitions. The shape
            says it, but not where A = S: there it is needed if the two readings of P differ.
        start : state, {state: probability}, (S,) probabilities, or another model's `start`
            The first state unless given; `mdp.forms.names` says how a state is named.
        **names
            `actions` (A words), `states` (S words), `name`; `sense`, "max" or "min" where rewards
            are costs; `labels` {name: (S,) truth values}; `components` {name: amounts as `R` or
            `reward` has them, or one for each pair}: what they leave of the reward is a component
            "rest".

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            For shapes that do not fit, or fit two readings that differ; and as the constructor
            does.

        Examples
        --------
        >>> mdp = MDP.from_arrays([[["1/3", "2/3"], [0, 1]]], [1, 0], discount="9/10")
        >>> mdp.table.row(0)
        [(Fraction(1, 3), 0, Fraction(1, 1)), (Fraction(2, 3), 1, Fraction(1, 1))]
        """
        return cls(**build.from_arrays(P, R, discount, layout=layout, start=start, **names))

    @classmethod
    def from_pairs(
        cls,
        pair_state: ArrayLike,
        pair_action: ArrayLike,
        transition: object,
        reward: object,
        discount: object = 1,
        *,
        start: object = None,
        **names: Any,
    ) -> MDP:
        """Build from one row per available state-action pair, in any order.

        Parameters
        ----------
        pair_state, pair_action : (L,) ints
        transition : (L, S) array or sparse matrix
            Or a sparse matrix of integers with the denominators (L,) of its rows.
        reward : (L,) array
        discount, start, **names
            As in `from_arrays`.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            For shapes that do not fit, and as the constructor does.

        Examples
        --------
        >>> MDP.from_pairs([1, 0], [0, 0], [[0, 1], ["1/2", "1/2"]], [0, 5]).reward.tolist()
        [5.0, 0.0]
        >>> counts = sp.csr_array([[1, 2], [0, 1]])
        >>> MDP.from_pairs([0, 1], [0, 0], (counts, [3, 1]), [0, 5]).table.row(0)[0][0]
        Fraction(1, 3)
        """
        parts = build.from_pairs(
            pair_state, pair_action, transition, reward, discount, start=start, **names
        )
        return cls(**parts)

    @classmethod
    def from_outcomes(
        cls,
        rows: Iterable[tuple[int, int, Sequence[tuple[Any, int, Any]]]],
        discount: object = 1,
        *,
        start: object = None,
        **names: Any,
    ) -> MDP:
        """Build from (state, action, [(probability, next state, reward), …]) rows, kept exact.

        Parameters
        ----------
        rows : iterable
            One for each pair, in any order.
        discount, start, **names
            As in `from_arrays`.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            For rows of another form, and as the constructor does.

        Examples
        --------
        >>> mdp = MDP.from_outcomes([(0, 0, [("1/2", 0, 1), ("1/2", 1, 0)]), (1, 0, [(1, 1, 0)])])
        >>> mdp.reward.tolist()
        [0.5, 0.0]
        """
        return cls(**build.from_outcomes(rows, discount, start=start, **names))

    @classmethod
    def from_function(
        cls,
        start: Any,
        actions: Callable[[Any], Iterable[Hashable]],
        outcomes: Callable[[Any, Any], Iterable[tuple[Any, Hashable, Any]]],
        discount: object = 1,
        *,
        max_states: int = explore.MOST_STATES,
        labels: Mapping[str, Any] | None = None,
        **names: Any,
    ) -> MDP:
        """Build by exploring: from the start to all that can follow.

        Parameters
        ----------
        start : state, or {state: probability}
            States are any hashable objects; `mdp.space.number(state)` is the number of one. Those
            that are tuples of one length are drawn as a map of their parts, which a
            `namedtuple("Place", "row column")` names.
        actions : function of a state
            Its actions, any hashable objects. A state without any is an end.
        outcomes : function of a state and an action
            A list of (probability, next state, reward), each number exact or a float. In place of a
            reward there may be {component: amount}: the reward is their sum.
        discount : number or "p/q"
        max_states : int
            Give up when more states than this have been found.
        labels : {name: function of a state}, optional
            Which states a name is of; (S,) truth values are taken as well.
        **names
            As in `from_arrays`.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            Where there are too many states; for states that cannot be keys, or outcomes of another
            form; and as the constructor does.

        Examples
        --------
        >>> def bet(money, stake):
        ...     return [("2/5", money + stake, 0), ("3/5", money - stake, 0)]
        >>> def stakes(money):
        ...     return range(1, min(money, 4 - money) + 1)
        >>> mdp = MDP.from_function(2, stakes, bet)
        >>> mdp, mdp.actions
        (MDP(unnamed: 5 states, 2 actions, 6 pairs, 10 transitions, discount 1), ('1', '2'))
        """
        check_options(names)
        rows, parts = explore.explored(start, actions, outcomes, max_states, labels)
        return cls.from_outcomes(rows, discount, **(parts | names))

    @classmethod
    def load(
        cls,
        path: str | Path,
        *,
        discount: object | None = None,
        start: object | None = None,
        constants: Mapping[str, object] | None = None,
        **others: Any,
    ) -> MDP:
        """Read a model from a file that `save` wrote, or another program.

        Parameters
        ----------
        path : str or path
            `.npz`, `.umb` or another that `mdp.io.load` names; a scenario's `.toml` is compiled.
        discount : number or "p/q", optional
            Instead of the file's own.
        start : state, {state: probability} or (S,) probabilities, optional
            Likewise.
        constants : {name: number}, optional
            Values of what a `.prism` or `.jani` file leaves open.
        **others
            There are none: a misspelt option is refused.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            Where the file cannot be read, or holds no model.

        Examples
        --------
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     MDP.from_arrays([[["1/3", "2/3"], [0, 1]]], [1, 0]).save(f"{folder}/small.npz")
        ...     MDP.load(f"{folder}/small.npz").table.row(0)
        [(Fraction(1, 3), 0, Fraction(1, 1)), (Fraction(2, 3), 1, Fraction(1, 1))]
        """
        import exact_mdp

        check_options(others, known=("discount", "start", "constants"))
        return exact_mdp.load(path, discount=discount, start=start, constants=constants)

    def save(self, path: str | Path) -> None:
        """Write all of the model as `.npz`, or as `.umb` for model checkers; whole or not at all.

        Raises ModelError for another ending, and where the path cannot be written to.
        """
        import exact_mdp

        exact_mdp.save(self, path)

    @classmethod
    def from_transitions(
        cls,
        frame: DataFrame | str | Path | Iterable[DataFrame],
        discount: object = 1,
        *,
        columns: Mapping[str, str] | None = None,
        unseen: object = "unavailable",
        progress: bool = False,
        **names: Any,
    ) -> MDP:
        """Estimate a model from recorded transitions; the numbers of observations are kept.

        Parameters
        ----------
        frame : DataFrame, path of a `.csv` or `.parquet` file, or iterable of DataFrames
            One row for each transition: episode, state, action, reward and next state, in the order
            of time, one episode after the other. Without a next state the episode is over there.
            A whole number is the same name as 1 and as 1.0. A sixth column, truncated (true or
            false), marks the rows after which an episode was cut off, as by a time limit. States
            in which that happened, and that nobody left, have the label "cut off"; rows cut off
            without a next state lead to one of that name.
        discount : number or "p/q"
        columns : mapping, optional
            The names that the table has for "episode", "state", "action", "reward", "next_state"
            and, where it has it, "truncated".
        unseen : "unavailable", "pessimistic", or a number
            What is done about an action that nobody took in a state: it is left out there; or it
            ends the episode and is worth as little as a policy can be worth, or this number.
        progress : bool
            Show a bar on standard error where that is a terminal.
        **names
            `name`, `sense`; `start`, which is then known, instead of the shares of the states that
            episodes begin in, which are estimates.

        Returns
        -------
        MDP
            With `observations` (L,), `counts` (L, S) and `episodes`.

        Raises
        ------
        ModelError
            For a missing column or value, and a gap in an episode, by row; and as the constructor
            does.

        Examples
        --------
        >>> import pandas as pd
        >>> names = ["episode", "state", "action", "reward", "next_state"]
        >>> rows = [
        ...     (1, "low", "wait", 0, "low"),
        ...     (1, "low", "wait", 1, "high"),
        ...     (2, "low", "wait", 1, "high"),
        ... ]
        >>> mdp = MDP.from_transitions(pd.DataFrame(rows, columns=names), discount="9/10")
        >>> mdp.observations.tolist(), mdp.table.row(mdp.pair(1, "wait"))[0][0]
        ([0, 3], Fraction(2, 3))
        """
        start = names.pop("start", None)
        parts = transitions.from_transitions(
            frame, discount, columns=columns, unseen=unseen, progress=progress, **names
        )
        found = cls(**parts)
        return found if start is None else found.with_(start=start)

    @classmethod
    def from_gymnasium(cls, env: object, discount: object = 1, **names: Any) -> MDP:
        """Build from a Gymnasium environment that exposes its model as `P` (toy-text).

        Parameters
        ----------
        env : gymnasium.Env, str or table
            An environment, wrapped or not; anything with an attribute `P`, or `dynamics` with
            matrices; such a table; or a registered id, "module:ID" where a module registers it.
        discount : number or "p/q"
        **names
            `start` instead of the environment's `initial_state_distrib`, or of state 0 where it
            has none; `actions`, `states`,
            `name`, `sense`, `labels`; `time_limit` instead of the environment's own. Beside an id,
            others are the environment's: `is_slippery=False`.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            Where the environment is unknown or exposes no `P`, or `P` is not a table of
            distributions over its own states.

        Examples
        --------
        >>> class Coin:
        ...     P = {0: {0: [(0.5, 0, 1, False), (0.5, 1, 1, True)]}, 1: {0: [(1, 0, 7, False)]}}
        ...     initial_state_distrib = (1, 0)
        >>> MDP.from_gymnasium(Coin()).table.row(0)[1]
        (Fraction(1, 2), 1, Fraction(1, 1))
        """
        make, given, parts = gymnasium.described(env, **names)
        found: MDP = getattr(cls, make)(*given, discount, **parts)
        return found


def _transition(table: OutcomeTable, states: int) -> sp.csr_array:
    """Return the (L, S) matrix: outcomes with the same next state added up, rounded once."""
    if table.rising:
        data, indices, indptr = table.probabilities(), table.next, table.offsets
    else:
        same = table.next[1:] == table.next[:-1]
        same[table.offsets[1:-1] - 1] = False  # from one pair to the next
        first = np.flatnonzero(np.concatenate([[True], ~same]))
        merged = OutcomeTable(
            offsets=np.searchsorted(first, table.offsets).astype(np.int64),
            next=table.next[first],
            weight=np.asarray(np.add.reduceat(table.weight, first)),
            denominator=table.denominator,
            gain=table.gain[:0],
            gain_denominator=table.gain_denominator,
        )
        data, indices, indptr = merged.probabilities(), merged.next, merged.offsets
    if len(data) < 2**31 - 1:
        indptr = indptr.astype(indices.dtype)
    matrix = sp.csr_array((data, indices, indptr), shape=(table.pairs, states), copy=False)
    matrix.has_canonical_format = True
    return matrix


def _check_components(mdp: MDP) -> None:
    table, names = mdp.component_table, mdp.component_names
    if table is None and len(names) == 1:
        return
    shape = (mdp.n_pairs, len(names))
    if table is None or table.amount.shape != shape or table.denominator.shape != shape[:1]:
        raise ModelError(
            f"components have shape {None if table is None else table.amount.shape}, not {shape}",
            where="reward components",
            fix="give one column for each component name",
        )
    if not table.denominator.min() > 0:
        raise ModelError(
            "a denominator of the components is not positive",
            where="reward components",
            fix="make it > 0",
        )
    wrong = wrong_rows(table, mdp.reward)
    if wrong.any():
        pair = int(np.flatnonzero(wrong)[0])
        raise ModelError(
            f"components sum to {mdp.components[pair].sum():g}, the reward is {mdp.reward[pair]:g}",
            where=mdp.where(pair),
            fix="make the components add up to the expected reward",
        )


def once(find: Callable[[MDP], Found]) -> Callable[[MDP], Found]:
    """Return a function that finds something once for each model, and keeps it as long as that."""
    key = f"once {find.__module__}.{find.__name__}"

    @wraps(find)
    def known(mdp: MDP) -> Found:
        kept: dict[str, Found] = vars(of_type(mdp, MDP, "model", "give an MDP"))
        if key not in kept:
            kept[key] = find(mdp)
        return kept[key]

    return known
