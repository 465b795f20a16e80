"""A finite Markov decision process: one sparse row per available state-action pair.

    V(s) = max over pairs l of s of  r(l) + γ Σ_s' P(l, s') V(s')

Pairs are sorted by state, then action; an action that a state does not offer has no row. The exact
table of outcomes is the source; the sparse matrix and the expected rewards are derived from it,
each number rounded once (state-action pairs: Puterman, Markov Decision Processes, 1994, section
2.1).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, wraps
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.components import named_components, wrong_rows
from exact_mdp.mdp.ends import Ends
from exact_mdp.mdp.errors import (
    ModelError,
    ShapeError,
    locate_errors,
    named_options,
    require_known_name,
    require_type,
    words_of,
    wrong_type,
)
from exact_mdp.mdp.forms.long_table import FromFrame
from exact_mdp.mdp.forms.names import ByNumber, Names, text_of
from exact_mdp.mdp.forms.numbers import whole_numbers
from exact_mdp.mdp.forms.steps import FromSteps
from exact_mdp.mdp.io.gymnasium import FromGymnasium
from exact_mdp.mdp.io.transitions import FromTransitions
from exact_mdp.mdp.questions import Questions
from exact_mdp.mdp.questions.ending import NO_DATA, ONE_COMPONENT, describe_sense
from exact_mdp.mdp.questions.origin import keep_origin, keep_origin_changed, origin_of
from exact_mdp.mdp.result import ROWS_SHOWN, DataFrame, data_frame, plain_report
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import ByFields, Floats, Integers, Numbers, OutcomeTable
from exact_mdp.mdp.validate import (
    as_discount,
    as_flags,
    as_labels,
    as_start,
    check_model,
    check_options,
    require_count,
)

Found = TypeVar("Found")
SHOWN = (
    *("from_arrays", "from_pairs", "from_outcomes", "from_function", "from_frame"),
    *("from_gymnasium", "from_transitions", "load", "save", "with_", "frame"),
    *("within", "reaching", "until", "earning"),
    *("n_states", "n_actions", "n_pairs", "space", "actions", "discount", "start", "sense"),
    *("labels", "name", "table", "transition", "reward", "P", "R"),
)
"""Attributes shown by `dir()` and tab completion."""
COMMUTING = {
    *("discount_exact", "start", "episodes", "sense", "name", "labels", "goal", "target"),
    *("time_limit", "actions", "action_objects"),
}
"""Parts of the model of a question that can be changed without changing what its parameters mean:
the change made for one value of a parameter is the change made for every other."""


@dataclass(frozen=True, eq=False)
class MDP(ByFields, FromTransitions, FromGymnasium, FromFrame, FromSteps, Questions):
    """A frozen, validated finite MDP with S states, A actions and L state-action pairs.

    Build one with `MDP.from_arrays`, `from_pairs`, `from_outcomes`, `from_function`,
    `from_frame`, `from_gymnasium` or `from_transitions`, `MDP.load` or `Scenario.compile`; this
    constructor takes the parts themselves.

    Attributes
    ----------
    table : OutcomeTable
        Exact outcomes of every pair.
    pair_state, pair_action : (L,) int64
        State and action of each pair, sorted by state, then action, without duplicates.
    space : StateSpace
        The meaning of the state numbers.
    actions : tuple of str
        Names of the A actions.
    discount_exact : Fraction
        The discount γ in [0, 1].
    start : tuple of (state, probability)
        Initial distribution, by state number; state 0 by default.
    component_names : tuple of str
        Names of the C components of the reward. `components` (L, C) is the expected reward by
        component; its row sums are `reward`.
    events : tuple of str
        Names of the bits of `table.event`.
    time_limit : int, optional
        The number of steps after which the environment of the model stops. It is not part of the
        transitions; `within` makes the model of episodes that stop.
    sense : "max" or "min"
        "max" if rewards are maximised, "min" if they are costs to be minimised. All numbers of the
        model and of its solutions keep the sign in which they were given.
    labels : {str: (S,) bool}
        Named sets of states; `reaching` and `until` ask about them.
    goal : (S,) bool, optional
        Set by `until` at discount 1: a run that never reaches one of these states has the value
        `unreached`, which is infinite.
    target : (S,) bool, optional
        The states in which `until` ends every run, at any discount. At discount 1 they are the
        goal, even if `with_` sets that discount later.
    action_objects : tuple
        The objects that the actions were made from, unless these were 0 … A-1.
    observations : (L,) int64, optional
        How often each pair was observed, if the model was estimated from data; 0 for pairs that
        were never observed and lead to one state for sure.
    episodes : int, optional
        The number of recorded episodes from which `start` was estimated; None if it is known.
    float_probabilities, float_rewards : bool
        Whether some of them were given as floats, which stand for the numbers rounded to them.

    Raises
    ------
    ModelError
        For any row that is not a distribution, used or not; duplicate pairs; numbers that are
        NaN, infinite or out of range; a state without action; a discount outside [0, 1].

    Notes
    -----
    Models are equal if their fingerprints are equal; names and labels do not count.

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
        fill = object.__setattr__  # the dataclass is frozen
        check_model(self)
        # Bring the optional parts into their canonical forms.
        for name, numbers in (("probabilities", self.table.weight), ("rewards", self.table.gain)):
            if numbers.dtype == np.float64:
                fill(self, f"float_{name}", True)
        fill(self, "sense", Sense(self.sense))
        fill(self, "start", ByNumber(self.start))
        if self.observations is not None:
            fill(self, "observations", whole_numbers(self.observations, "observations"))
        if self.time_limit is not None:
            fill(self, "time_limit", require_count(self.time_limit, "time_limit"))
        fill(self, "labels", as_labels(self.labels, self.space))
        if self.goal is not None:
            fill(self, "goal", as_flags(self.goal, self.space, "goal"))
            if self.discount_exact != 1:
                raise ModelError(
                    f"a goal needs discount 1, and the discount is {self._rate}",
                    where="goal",
                    fix='ask mdp.with_(discount=1).until("LABEL"), or leave goal out',
                )
            fill(self, "target", self.goal)
        if self.target is not None:
            fill(self, "target", as_flags(self.target, self.space, "target"))
        # Derive the arrays of the float model; each number is rounded once.
        offsets = np.zeros(self.n_states + 1, dtype=np.int64)
        np.cumsum(np.bincount(self.pair_state, minlength=self.n_states), out=offsets[1:])
        fill(self, "pair_offsets", offsets)
        fill(self, "transition", self.table.rows.build_matrix(self.n_states))
        fill(self, "reward", self.table.expected_gain())
        if not np.all(np.isfinite(self.reward)):
            raise ModelError("an expected reward is too large for a float", fix="scale the rewards")
        _check_components(self)
        self._lock_arrays()
        # `ends` are found in the derived arrays, so this check comes last.
        if self.goal is not None and not self.terminal[self.goal].all():
            raise ModelError(
                "a run continues, or earns a reward, in a state of the goal",
                where="goal",
                fix="use until, which ends every run there",
            )

    def _lock_arrays(self) -> None:
        """Make all arrays read-only."""
        for part in (self, self.table, self.table.rows, self.transition):
            for value in vars(part).values():
                if isinstance(value, np.ndarray):
                    value.setflags(write=False)

    def __getstate__(self) -> dict[str, Any]:
        state = super().__getstate__()
        if "origin" in vars(self):
            state["origin"] = vars(self)["origin"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        super().__setstate__(state)
        object.__setattr__(self, "labels", as_labels(self.labels, self.space))
        self._lock_arrays()

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
        text = (
            f"MDP({self.name or 'unnamed'}: {self.n_states} states, {self.n_actions} actions, "
            f"{self.n_pairs} pairs, {self.n_transitions} transitions, discount {self._rate}"
        )
        sense = describe_sense(self)
        if sense:
            text += f", {sense}"
        return text + ")"

    def frame(self, states: object = None) -> DataFrame:
        """Return the outcomes as a table, with exact numbers.

        Parameters
        ----------
        states : state, or iterable of states, optional
            The states to show, by number or by name; all by default.

        Returns
        -------
        DataFrame
            One row for each outcome: state, action, next state, probability, reward.

        Raises
        ------
        ModelError
            For an unknown state.

        Examples
        --------
        >>> mdp = MDP.from_pairs([0, 1], [0, 0], [["1/3", "2/3"], [0, 1]], [5, 0])
        >>> print(mdp.frame([0]).to_csv(index=False))
        state,action,next state,probability,reward
        0,0,0,1/3,5
        0,0,1,2/3,5
        """
        if states is None:
            return self._frame_outcomes(range(self.n_pairs))
        pairs: list[int] = []
        for state in self.space.numbers(states):
            pairs += self.pairs_of(state)
        return self._frame_outcomes(pairs)

    def _frame_outcomes(self, pairs: Iterable[int]) -> DataFrame:
        """Return the outcomes of some pairs as a table."""
        label = self.space.plain_label
        rows = []
        for pair in pairs:
            state, action = label(self.pair_state[pair]), self.actions[self.pair_action[pair]]
            for probability, after, reward in self.table.row(pair):
                rows.append((state, action, label(after), probability, reward))
        names = ["state", "action", "next state", "probability", self.sense.amount]
        return data_frame(rows, columns=names)

    def _repr_html_(self) -> str:
        few = self._frame_outcomes(range(min(self.n_pairs, ROWS_SHOWN)))
        return plain_report(self, few, len(self.table.next)).html(ROWS_SHOWN)

    @property
    def _rate(self) -> str:
        """The discount in print: exact if that is short, else with twelve digits."""
        if self.discount_exact.denominator < 10**9:
            return str(self.discount_exact)
        return f"{self.discount:.12g}"

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
        """(L, S) how often each pair was observed to lead to each state; None without data.

        Rows of pairs that were never observed, such as the pairs of terminal states, are empty.
        `observations` (L,) holds the row sums.
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
        amounts = self.table.expected_components()
        amounts.setflags(write=False)
        return amounts

    def component(self, name: str) -> tuple[Numbers, Numbers]:
        """Return integers (L,), (L,) whose ratio is the expected amount of a component, exactly."""
        require_known_name(name, self.component_names, "component", "components")
        amount, denominator = self.table.expected_components_exact()
        return np.asarray(amount[:, self.component_names.index(name)]), denominator

    @cached_property
    def ends(self) -> Ends:
        """Where runs end, and what a run is worth that does not end as it should."""
        return Ends(**{part.name: getattr(self, part.name) for part in fields(Ends)})

    @property
    def forced(self) -> NDArray[np.bool_]:
        """(S,) True for states with a single action."""
        return self.ends.forced

    @property
    def terminal(self) -> NDArray[np.bool_]:
        """(S,) True where every action stays in the state forever and earns 0: its value is 0.

        Components or events may still be counted there; see `over`.
        """
        return self.ends.terminal

    @property
    def over(self) -> NDArray[np.bool_]:
        """(S,) True for states in which an episode is over: terminal, with no amount to count."""
        return self.ends.over

    def by_action(self, values: ArrayLike, missing: float = np.nan) -> NDArray[Any]:
        """Return a table (S, A) of numbers of pairs (L,), `missing` if an action has no pair.

        Truth values are False there.
        """
        array = np.asarray(values)
        if array.shape != (self.n_pairs,):
            raise ShapeError(
                f"an array of shape {array.shape}, not ({self.n_pairs},)",
                where="by_action",
                fix="give one number for each pair",
            )
        # NaN needs a float array; truth values and exact numbers keep their type.
        kind = np.result_type(array, np.float64)
        if array.dtype.kind in "bO":
            kind = array.dtype
        fill: Any = missing
        if array.dtype.kind == "b":
            fill = False
        table = np.full((self.n_states, self.n_actions), fill, dtype=kind)
        table[self.pair_state, self.pair_action] = array
        return table

    @property
    def R(self) -> Floats:
        """(S, A) expected rewards; -inf (inf for costs) where an action is not available."""
        return self.by_action(self.reward, self.sense.worst)

    def P(self, action: object) -> sp.csr_array:
        """Return the (S, S) transitions of an action; rows are empty where it is not available.

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

    def pairs_of(self, state: int) -> range:
        """Return the pairs of one state."""
        return range(int(self.pair_offsets[state]), int(self.pair_offsets[state + 1]))

    def pair(self, state: object, action: object) -> int:
        """Return the number of a pair; see `mdp.forms.names` for ways to name state and action.

        Raises ModelError if the action is not available in the state.
        """
        with locate_errors("states"):
            place = self.space.number(state)
        number = self.action(action)
        for pair in self.pairs_of(place):
            if self.pair_action[pair] == number:
                return pair
        offered = [self.actions[self.pair_action[pair]] for pair in self.pairs_of(place)]
        raise ModelError(
            f"action {self.actions[number]} is not available",
            where=self.space.place(place),
            fix=f"choose one of {', '.join(offered)}",
        )

    def action(self, name: object) -> int:
        """Return the number of an action; see `mdp.forms.names` for ways to name it."""
        with locate_errors("actions"):
            return self.action_names.find_number(name)

    @cached_property
    def action_names(self) -> Names:
        """The numbers of the actions by name, number, or the object that each was made from."""
        words = {word: number for number, word in enumerate(self.actions)}
        objects = enumerate(self.action_objects)
        return Names(
            what="action",
            size=self.n_actions,
            words=words,
            label=lambda number: f"action {self.actions[number]}",
            objects={thing: number for number, thing in objects},
            otherwise=lambda thing: words.get(text_of(thing).removeprefix("action ")),
        )

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
            Any other attribute of the constructor, such as `name` or `actions`; `states`, their
            names; `components`, as in `from_arrays`, for each pair (L,).

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
        check_options(parts, {})
        origin = origin_of(self)
        if discount is not None and origin is not None and origin.paid:
            # Terminal values are discounted: ask the question of the model with the new discount.
            rebuilt: Self = replace(
                origin, model=origin.model.with_(discount=discount)
            ).rebuild_model()
            if start is not None or parts:
                rebuilt = rebuilt.with_(start=start, **parts)
            return rebuilt
        # The changes as given are kept with the origin, to be made at other parameters as well.
        given = dict(parts)
        if "states" in parts:
            parts["space"] = StateSpace.plain(self.n_states, parts.pop("states"))
        if "actions" in parts:
            parts["actions"] = words_of(parts["actions"], "actions")
            parts = {"action_objects": ()} | parts
        if discount is not None:
            parts["discount_exact"] = as_discount(discount)
        # The target of `until` is a goal at discount 1 only.
        if "goal" in parts:
            parts.setdefault("target", parts["goal"])
        elif self.target is not None and "discount_exact" in parts:
            parts["goal"] = None
            if parts["discount_exact"] == 1:
                parts["goal"] = self.target
        if start is not None:
            given["start"] = parts["start"] = as_start(start, parts.get("space", self.space))
            parts.setdefault("episodes", None)
        # Data and components describe the old table; a new one starts without them.
        if "table" in parts:
            table = require_type(parts["table"], OutcomeTable, "table", "give an OutcomeTable")
            parts = NO_DATA | parts
            if not parts.keys() & {"components", "component_names"}:
                parts |= ONE_COMPONENT
                means = table.averaged and table.components is None
                earned = table.with_reward(table.gain, table.gain_denominator)
                parts["table"] = replace(earned, averaged=means)
        if "components" in parts:
            if self.table.components is not None:
                parts.setdefault("component_names", self.component_names)
            parts |= named_components(parts, parts.get("table", self.table))
        changed = replace(self, **parts)
        if origin_of(self) is not None and parts.keys() <= COMMUTING:
            keep_origin_changed(changed, self, discount, given)
        return changed

    @property
    def floats(self) -> bool:
        """Whether probabilities or rewards were given as floats."""
        return self.float_probabilities or self.float_rewards

    @property
    def undiscounted(self) -> MDP:
        """The model with discount 1 and no goal; itself if it has discount 1."""
        if self.discount_exact == 1:
            return self
        return _leave_out_discount(self)

    def negated(self) -> MDP:
        """Return the same problem with the opposite sense: all rewards times -1."""
        # Only `until` gives `unreached` a meaning. A model without its target keeps +∞, the value
        # that a later `until` needs.
        unreached = self.unreached
        if self.target is not None:
            unreached = -unreached
        negated = replace(
            self,
            table=self.table.negate_rewards(),
            sense=self.sense.opposite,
            unreached=unreached,
        )
        if origin_of(self) is not None:
            keep_origin(negated, self, "negated")
        return negated

    @property
    def maximised(self) -> MDP:
        """The same problem with rewards to maximise: itself, or its negation."""
        if self.sense.costs:
            return _negate_model(self)
        return self

    @classmethod
    @named_options
    def load(
        cls,
        path: str | Path,
        *,
        discount: object | None = None,
        start: object | None = None,
        constants: Mapping[str, object] | None = None,
    ) -> MDP:
        """Read a model from a file written by `save` or by another program.

        Parameters
        ----------
        path : str or path
            A file in one of the formats in `mdp.io.formats`, such as `.npz`; the `.toml` of a
            scenario is compiled.
        discount : number or "p/q", optional
            The discount to use instead of the one in the file.
        start : state, {state: probability} or (S,) probabilities, optional
            The initial distribution to use instead of the one in the file.
        constants : {name: number}, optional
            Values of the constants that a `.prism` or `.jani` file leaves open; a float is the
            decimal that it prints as.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If the file cannot be read, or does not hold a model.

        Examples
        --------
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     MDP.from_arrays([[["1/3", "2/3"], [0, 1]]], [1, 0]).save(f"{folder}/small.npz")
        ...     MDP.load(f"{folder}/small.npz").table.row(0)
        [(Fraction(1, 3), 0, Fraction(1, 1)), (Fraction(2, 3), 1, Fraction(1, 1))]
        """
        import exact_mdp

        return exact_mdp.load(path, discount=discount, start=start, constants=constants)

    def save(self, path: str | Path) -> None:
        """Write the model as `.npz` or `.json`, or as `.umb` for model checkers.

        The file is written completely or not at all. Raises ModelError for another file name
        extension, and if the path cannot be written to.
        """
        import exact_mdp

        exact_mdp.save(self, path)


def _check_components(mdp: MDP) -> None:
    """Raise ModelError unless the components have the right shape and add up to the reward."""
    amounts, below = mdp.table.components, mdp.table.component_denominator
    if amounts is None and len(mdp.component_names) == 1:
        return
    # Amounts are by pair or by outcome, over one positive denominator for each pair.
    shape = (mdp.n_pairs, len(mdp.component_names))
    of_outcomes = (len(mdp.table.next), len(mdp.component_names))
    fits = amounts is not None and amounts.shape in (shape, of_outcomes)
    if not fits or np.shape(below) != shape[:1]:
        raise ModelError(
            f"components have shape {np.shape(amounts)}, not {shape}",
            where="reward components",
            fix="give one column for each component name",
        )
    if not below.min() > 0:
        raise ModelError(
            "a denominator of the components is not positive",
            where="reward components",
            fix="make it positive",
        )
    # In each pair they add up to the expected reward, except for rounding.
    wrong = wrong_rows(mdp.table, mdp.reward)
    if wrong.any():
        pair = int(np.flatnonzero(wrong)[0])
        raise ModelError(
            f"components sum to {mdp.components[pair].sum():g}, the reward is {mdp.reward[pair]:g}",
            where=mdp.where(pair),
            fix="change a component so that their sum is the expected reward",
        )


def cache_on_model(find: Callable[[MDP], Found]) -> Callable[[MDP], Found]:
    """Cache a function's result on the model, so that it is computed once for each model."""
    key = f"once {find.__module__}.{find.__name__}"

    @wraps(find)
    def find_cached(mdp: MDP) -> Found:
        if not isinstance(mdp, MDP):
            raise wrong_type(mdp, "model", "give an MDP")
        cache: dict[str, Found] = vars(mdp)
        if key not in cache:
            cache[key] = find(mdp)
        return cache[key]

    return find_cached


@cache_on_model
def _negate_model(mdp: MDP) -> MDP:
    return mdp.negated()


@cache_on_model
def _leave_out_discount(mdp: MDP) -> MDP:
    return mdp.with_(discount=1, goal=None)
