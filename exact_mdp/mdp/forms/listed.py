"""Models as dictionaries, quadruples and nested lists, as other programs write them.

    {s: {a: {t: p}}}      dictionaries by state, action and next state; any hashables
    [(s, a, t, p), …]     quadruples, (N, 4)
    P[s][a] = [p, …]      lists, with None or nothing for a missing action: `fill_missing_rows`

Rewards for the first two forms are {s: r}, {s: {a: r}}, {s: {a: {t: r}}}, or an array (S,) or
(S, A) if states and actions are whole numbers. A pair is not available if P does not list it, or if
its reward is -inf (inf for costs). In the first form a state without actions is an end. The reward
of an end is earned once, as in textbooks with rewards R(s): the state has the value R(s), and leads
to an additional state "end". Components may be dictionaries of these forms.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError, ShapeError, locate_errors, require_type
from exact_mdp.mdp.forms.names import (
    Numbering,
    action_names,
    count_from_zero,
    find_free_name,
    name_things,
    text_of,
)
from exact_mdp.mdp.forms.numbers import array_of, as_given, to_dense
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import exact

Path = tuple[Any, ...]
REWARDS = "{s: reward}, {s: {a: reward}} or {s: {a: {next state: reward}}}"


def is_listed(P: Any) -> bool:
    """Return whether transitions are nested dictionaries or quadruples."""
    if isinstance(P, Mapping):
        return all(actions is None or isinstance(actions, Mapping) for actions in P.values())
    if isinstance(P, np.ndarray):
        return P.ndim == 2 and P.shape[1] == 4
    if not isinstance(P, list | tuple) or not P:
        return False
    # A list of quadruples has rows of four plain values; P[s][a] has lists in its rows.
    nested = (list, dict, np.ndarray, type(None))
    for row in P:
        if not _is_list(row) or len(row) != 4:
            return False
        if any(isinstance(cell, nested) for cell in row):
            return False
    return True


def fill_missing_rows(
    P: Any, R: Any, layout: str | None
) -> tuple[Any, Any, str | None, NDArray[np.bool_] | None]:
    """Return P with rows of 0 for missing pairs, R, the layout, and (S · A,) True for listed pairs.

    The layout is P[s][a] if there are as many lists as states, and P[a][s] if each list has one row
    for each state. If no row is missing, P is returned as it is, with None for the listed pairs.
    """
    if not _is_list(P) or isinstance(P, np.ndarray) or not all(map(_is_list, P)):
        return P, R, layout, None
    # Collect the rows that are there; None and [] stand for missing ones.
    known, complete = [], True
    for own in P:
        for cell in own:
            if cell is None:
                complete = False
            elif not _is_list(cell):
                return P, R, layout, None
            elif len(cell):
                known.append(cell)
            else:
                complete = False
    lengths = {*map(len, P)}
    if complete and len(lengths) == 1:
        return P, R, layout, None
    # Find the layout from the number of states, which is the length of a row.
    states = max(map(len, known), default=0)
    fits = {"sas": len(P) == states, "ass": lengths == {states}}
    if layout is None and all(fits.values()):
        raise ModelError(
            "lists with missing rows may go by state, then action, or by action, then state",
            where="P",
            fix='say layout="sas" for P[state][action], layout="ass" for P[action][state]',
        )
    if layout is None:
        layout = "sas"
        if fits["ass"]:
            layout = "ass"
    # Fill in the missing rows.
    most = max(lengths, default=0)
    there, rows = np.zeros((len(P), most), dtype=bool), list[list[Any]]()
    for place, own in enumerate(P):
        full: list[Any] = [[0] * states for _ in range(most)]
        for k, cell in enumerate(own):
            if cell is not None and len(cell):
                there[place, k], full[k] = True, cell
        rows.append(full)
    if layout == "ass":
        there, most = there.T, len(P)
    if isinstance(R, list | tuple) and all(map(_is_list, R)):
        R = [[*own, *[0] * (most - len(own))] for own in R]
    return rows, R, layout, there.reshape(-1)


def keys_of(P: Mapping[Any, Any]) -> list[Any]:
    """Return the keys of a dictionary of matrices in the order of the model."""
    numbering = Numbering()
    for key in P:
        numbering.add_thing(key, "a key", "P")
    return numbering.list_in_order()


class Listed:
    """Transitions by name, and the reading of rewards and components given beside them.

    `pairs` is {state: {action: [(probability, next state), …]}}, `ends` the states without
    outcomes, and `offered` the available pairs. `never` is the reward of an unavailable action.
    """

    def __init__(self, P: Any, never: float) -> None:
        self.states, actions, self.never = Numbering(), Numbering(), never
        self.pairs: dict[Any, dict[Any, list[tuple[Any, Any]]]] = {}
        # The keys of dictionaries come first, so ends without actions are states, too.
        if isinstance(P, Mapping):
            for state, own in P.items():
                self.states.add_thing(state, "a state", "P")
                self.pairs[state] = {action: [] for action in own or {}}
        for state, action, then, chance in _list_quadruples(P):
            place = f"P, state {state}, action {action}"
            for numbering, thing in ((self.states, state), (actions, action), (self.states, then)):
                numbering.add_thing(thing, "a state or action", place)
            with locate_errors(f"{place}, next state {then}"):
                outcomes = self.pairs.setdefault(state, {}).setdefault(action, [])
                if exact(chance):
                    outcomes.append((chance, then))
        self.ends = [state for state, own in self.pairs.items() if not any(own.values())]
        # An action with an empty dictionary is not available. An action whose probabilities are all
        # 0 counts as available, and is refused by validation.
        self.offered = []
        for state, action in self._list_pairs():
            named = not isinstance(P, Mapping) or P[state][action]
            if self.pairs[state][action] or named:
                self.offered.append((state, action))

    def _list_pairs(self) -> list[tuple[Any, Any]]:
        """Return all pairs (state, action), available or not."""
        pairs = []
        for state, own in self.pairs.items():
            pairs += [(state, action) for action in own]
        return pairs

    def read_amounts(self, values: Any, where: str) -> dict[Path, Any]:
        """Return rewards {(s,): r}, {(s, a): r} or {(s, a, t): r}; refuse keys that P lacks."""
        if not isinstance(values, Mapping):
            return self._by_number(values, where)
        amounts = dict(_flatten_rewards(values))
        for (state, *more), amount in amounts.items():
            # A pair that P does not list may have the reward of an unavailable action; an end may
            # have 0, and NaN is refused later.
            own = self.pairs.get(state, {})
            nothing = amount == self.never or (state in self.ends and amount == 0)
            known = state in self.states.number
            known &= not more or more[0] in own or nothing or amount != amount
            if not known or len(more) > 2 or not self.states.number.keys() >= {*more[1:]}:
                raise ModelError(
                    f"a reward of {', '.join(map(repr, (state, *more)))}, which P does not list",
                    where=where,
                    fix=f"leave it out, or correct its keys: give {REWARDS}",
                )
        return amounts

    def _by_number(self, values: Any, where: str) -> dict[Path, Any]:
        """Return the amounts of an array (S,) or (S, A), if states and actions are numbers."""
        array, states = to_dense(array_of(values, where)), {*self.states.number}
        pairs = self._list_pairs()
        # An array by action needs actions that are numbers from 0.
        things = [*(state for state, _ in pairs), *(action for _, action in pairs)]
        n_actions = 0
        if all(isinstance(thing, int) and thing >= 0 for thing in things):
            n_actions = max((action for _, action in pairs), default=-1) + 1
        size = len(states), n_actions
        numbered = states == {*range(len(states))}
        if not numbered or array.shape not in (size[:1], size):
            fix = f"give {REWARDS}"
            if numbered:
                fix += f"; or, as states are whole numbers, an array ({size[0]},)"
                if n_actions > 0:
                    fix += f" or {size}"
            raise ShapeError(f"rewards have shape {array.shape}", where=where, fix=fix)
        if array.ndim == 2 and size[1] in (3, 4) and len(pairs) == size[0]:
            raise ModelError(
                f"rewards of shape {array.shape} may be by state and action, or rows (s, a, r) "
                "or (s, a, t, r); such rows are not read",
                where=where,
                fix=f"give {REWARDS}",
            )
        entries = array.tolist()
        if array.ndim == 1:
            return {(state,): amount for state, amount in enumerate(entries)}
        # An end has no pairs, so rewards of its actions would be lost.
        for end in self.ends:
            stated = [x for x in entries[end] if x not in (0, self.never) and x == x]
            if stated:
                raise ModelError(
                    f"rewards of state {end} are {entries[end]}, and P lists no action there",
                    where=where,
                    fix="write 0 there; to earn a reward once, at the end, give {state: reward}; "
                    "to earn it at each step, give the state an action in P that stays: "
                    f"{{{end}: {{0: {{{end}: 1}}}}}}",
                )
        return {(s, a): entries[s][a] for s, a in pairs}

    def list_rewarded_outcomes(
        self, pair: Path, amounts: Mapping[Path, Any], where: str
    ) -> list[Any]:
        """Return the outcomes of a pair as (probability, next state, amount).

        The amount belongs to the transition, or else to the pair, or else to the state.
        """
        state, action = pair
        place, outcomes = f"{where}, state {state}, action {action}", []
        for chance, then in self.pairs[state][action]:
            stated = [key for key in ((*pair, then), pair, (state,)) if key in amounts]
            if not stated:
                fix = "give 0 for a pair without a reward"
                raise ModelError("there is no reward", where=place, fix=fix)
            with locate_errors(place):
                outcomes.append((chance, then, as_given(amounts[stated[0]])))
        return outcomes

    def check_order(self, states: list[Any], amounts: Any, where: str) -> None:
        """Raise ModelError if amounts of pairs, which belong to `states`, could be by state."""
        # Amounts by pair and by state are the same if each state has one pair, in order, and ends
        # have the amount 0.
        if {*states} != {*range(len(states))} or {*self.states.number} != {*states}:
            return
        lasting = [amounts[place] for place, state in enumerate(states) if state in self.ends]
        if states != sorted(states) or any(lasting):
            raise ModelError(
                f"{len(states)} amounts may be by state, and an end then earns its amount once; "
                "or by pair, in the order of P, and an end then earns it at each step",
                where=where,
                fix="give {state: amount} or {state: {action: amount}}",
            )

    def read_end_amounts(self, amounts: Mapping[Path, Any], where: str) -> dict[Any, Any]:
        """Return the amounts of states without actions, except 0."""
        with locate_errors(where):
            given = {end: as_given(amounts.get((end,), 0)) for end in self.ends}
        return {end: amount for end, amount in given.items() if amount and amount == amount}


def columns_from_listed(
    P: Any, R: Any, names: dict[str, Any]
) -> tuple[OutcomeColumns, dict[str, Any]]:
    """Return the pairs and outcomes of the model of P and R, and names.

    `names` are the names given with P and R; the returned names include them.
    """
    # Read the rewards. A reward of an end is paid once.
    never = Sense.of_options(names).worst
    listed = Listed(P, never)
    rewards = listed.read_amounts(R, "R")
    paid = listed.read_end_amounts(rewards, "R")
    pairs = []
    for state, action in listed.offered:
        if rewards.get((state, action), rewards.get((state,))) != never:
            pairs.append((state, action))
    # Read the components; each becomes a list with one entry for each pair and each end.
    given, parts = names.get("components"), dict[str, Any]()
    if not isinstance(given, Mapping):
        given = {}
    states = [*(state for state, _ in pairs), *listed.ends]
    for name, values in given.items():
        where = f"component {name}"
        if not isinstance(values, Mapping):
            of_pairs = to_dense(array_of(values, where))
            if of_pairs.shape == (len(states),):
                listed.check_order(states, of_pairs, where)
                parts[name] = [*of_pairs]
                continue
        amounts = listed.read_amounts(values, where)
        ends = listed.read_end_amounts(amounts, where)
        paid = dict.fromkeys(ends, 0) | paid
        parts[name] = []
        for pair in pairs:
            outcomes = listed.list_rewarded_outcomes(pair, amounts, where)
            parts[name].append(_merge_equal_amounts(outcomes))
        parts[name] += [ends.get(end, 0) for end in listed.ends]
    # Write the rows in numbers. If an end is paid, there is one more state, with one more pair.
    columns, actions, number = OutcomeColumns(), Numbering(), listed.states.number
    for state, action in pairs:
        outcomes = listed.list_rewarded_outcomes((state, action), rewards, "R")
        act = actions.add_thing(action, "an action", f"state {state}")
        columns.add_pair(number[state], act, ((p, number[then], r) for p, then, r in outcomes))
    own = name_columns(columns, listed.states, actions, listed.ends, paid)
    if paid:
        names |= _with_the_end(names, len(listed.states.number), own["space"].extra[0])
        for amounts_of_pairs in parts.values():
            amounts_of_pairs.append(0)
    if parts:
        names["components"] = parts
    return columns, own | names


def _merge_equal_amounts(outcomes: list[tuple[Any, Any, Any]]) -> Any:
    """Return the amount of a pair, or the list of amounts of its outcomes if they differ."""
    amounts = [amount for *_, amount in outcomes]
    if not amounts:
        return 0
    if all(amount == amounts[0] for amount in amounts):
        return amounts[0]
    return amounts


def _with_the_end(names: dict[str, Any], states: int, end: str) -> dict[str, Any]:
    """Return the names, start and labels of the states of P (S,), with one more for the end."""

    def append_value(values: Any, last: Any) -> Any:
        if isinstance(values, list | tuple | np.ndarray) and len(values) == states:
            return [*values, last]
        return values

    longer: dict[str, Any] = {}
    if "states" in names:
        longer["states"] = append_value(names["states"], end)
    if not isinstance(names["start"], tuple):  # a tuple may be a state
        longer["start"] = append_value(names["start"], 0)
    labels = names.get("labels")
    if isinstance(labels, Mapping):
        longer["labels"] = {}
        for name, flags in labels.items():
            if np.asarray(flags).dtype == bool:
                flags = append_value(flags, False)
            longer["labels"][name] = flags
    return longer


def _list_quadruples(P: Any) -> Iterator[tuple[Any, Any, Any, Any]]:
    """Yield state, action, next state and probability."""
    if isinstance(P, np.ndarray):
        P = P.tolist()
    if not isinstance(P, Mapping):
        for *path, chance in P:
            state, action, then = map(_float_to_integer, path)
            yield state, action, then, chance
        return
    for state, actions in P.items():
        for action, after in (actions or {}).items():
            if after is None:
                continue
            fix = "give {state: {action: {next state: probability}}}"
            require_type(after, Mapping, f"P, state {state}", fix)
            for then, chance in after.items():
                yield state, action, then, chance


def _flatten_rewards(R: Mapping[Any, Any], path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the rewards in nested dictionaries, each with the path of its keys."""
    for key, reward in R.items():
        if isinstance(reward, Mapping):
            yield from _flatten_rewards(reward, (*path, key))
        elif reward is not None:
            yield (*path, key), reward


def _is_list(values: Any) -> bool:
    """Return whether values are a list, a tuple or an array of at least one dimension."""
    return isinstance(values, list | tuple) or (isinstance(values, np.ndarray) and values.ndim > 0)


def _float_to_integer(number: Any) -> Any:
    """Return a float that is a whole number as an int, and other values as they are."""
    if isinstance(number, float) and number.is_integer():
        return int(number)
    return number


@dataclass(frozen=True, eq=False)
class OutcomeColumns:
    """Pairs in numbers, in the order given, and all their outcomes."""

    state: list[int] = field(default_factory=list)  # (L,)
    action: list[int] = field(default_factory=list)  # (L,)
    length: list[int] = field(default_factory=list)  # (L,) the number of outcomes
    chance: list[Any] = field(default_factory=list)  # (N,)
    following: list[int] = field(default_factory=list)  # (N,)
    gain: list[Any] = field(default_factory=list)  # (N,)

    def add_pair(self, state: int, action: int, outcomes: Iterable[tuple[Any, int, Any]]) -> None:
        """Add a pair with its outcomes: probability, next state, reward."""
        listed = [*outcomes]
        columns = self.chance, self.following, self.gain
        # By columns, as to append each number alone takes twice as long.
        for column, own in zip(columns, zip(*listed, strict=True), strict=bool(listed)):
            column.extend(own)
        self.state.append(state)
        self.action.append(action)
        self.length.append(len(listed))


def name_columns(
    columns: OutcomeColumns,
    states: Numbering,
    actions: Numbering,
    ends: Iterable[Hashable] | None = None,
    paid: Mapping[Hashable, Any] = MappingProxyType({}),
) -> dict[str, Any]:
    """Return the names of states and actions; change their numbers in `columns`, and add the ends.

    Numbers change if things are whole numbers. `ends` are the states without actions: by default
    those without a pair. Those in `paid` {end: reward} earn the reward once and lead to an
    additional state.
    """
    found = list(states.number), list(actions.number)
    if ends is None:
        acting = {*columns.state}
        ends = [thing for thing, number in states.number.items() if number not in acting]
    things, doing = states.list_in_order(), actions.list_in_order() or ["stay"]
    parts = (states, columns.state), (states, columns.following), (actions, columns.action)
    for (numbering, numbers), before in zip(parts, (found[0], *found), strict=True):
        place = [numbering.number[thing] for thing in before]
        numbers[:] = [place[old] for old in numbers]
    # Ends stay put, or earn their reward and lead to the additional state, which has number S.
    number, last = states.number, len(things)
    for end in ends:
        outcome = (1, number[end], 0)
        if end in paid:
            outcome = (1, last, paid[end])
        columns.add_pair(number[end], 0, [outcome])
    if paid:
        columns.add_pair(last, 0, [(1, last, 0)])
    # Its name must differ from the names of all other states.
    extra: tuple[str, ...] = ()
    if paid:
        extra = (find_free_name("end", [*map(text_of, things)]),)
    column = Column(name="state", size=len(things))
    if not count_from_zero(things):
        column = replace(column, words=name_things(things, "state"), objects=tuple(things))
    space = StateSpace(columns=(column,), extra=extra)
    return {"space": space, **action_names(doing)}
