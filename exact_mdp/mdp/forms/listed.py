"""Models as dictionaries, quadruples and nested lists, as they come from elsewhere.

    {s: {a: {t: p}}}      dictionaries by state, action and next state; any hashables
    [(s, a, t, p), …]     quadruples, (N, 4)
    P[s][a] = [p, …]      lists, with None or nothing for a missing action: `fill_missing_rows`

Rewards beside the first two are {s: r}, {s: {a: r}}, {s: {a: {t: r}}}, or, where states and actions
are whole numbers, an array (S,) or (S, A). What P does not list is not available, nor is what has
the reward -inf (inf where rewards are costs). In the first form a state without actions is an end.
The reward of an end is earned once, as textbooks with rewards R(s) mean it: such a state has the
value R(s), and leads to a state "end" that is added. Components may be dictionaries of these forms.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError, ShapeError, locate_errors, require_type
from exact_mdp.mdp.forms.numbering import Numbering, number_rows
from exact_mdp.mdp.forms.numbers import array_of, as_given, to_dense
from exact_mdp.mdp.table import exact

Path = tuple[Any, ...]
REWARDS = "{s: reward}, {s: {a: reward}} or {s: {a: {next state: reward}}}"


def is_listed(P: Any) -> bool:
    """Return whether transitions are dictionaries or quadruples, which go by name."""
    if isinstance(P, Mapping):
        return all(actions is None or isinstance(actions, Mapping) for actions in P.values())
    if isinstance(P, np.ndarray):
        return P.ndim == 2 and P.shape[1] == 4
    nested = (list, dict, np.ndarray, type(None))
    return (
        bool(isinstance(P, list | tuple) and P)
        and all(_is_list(row) and len(row) == 4 for row in P)
        and not any(isinstance(cell, nested) for row in P for cell in row)
    )


def fill_missing_rows(
    P: Any, R: Any, layout: str | None
) -> tuple[Any, Any, str | None, NDArray[np.bool_] | None]:
    """Return lists P and R[s][a] in full, the layout, and which pairs (S · A,) P lists or None.

    P is P[s][a] where there are as many lists as states, P[a][s] where each has one row a state.
    """
    if not _is_list(P) or isinstance(P, np.ndarray) or not all(map(_is_list, P)):
        return P, R, layout, None
    cells = [cell for rows in P for cell in rows]
    known = [cell is not None and not (_is_list(cell) and not len(cell)) for cell in cells]
    lengths = {*map(len, P)}
    lists = all(_is_list(cell) for cell, there in zip(cells, known, strict=True) if there)
    if not lists or (all(known) and len(lengths) == 1):
        return P, R, layout, None
    states = max([len(cell) for cell, there in zip(cells, known, strict=True) if there], default=0)
    fits = {"sas": len(P) == states, "ass": lengths == {states}}
    if layout is None and all(fits.values()):
        raise ModelError(
            "lists that leave rows out may go by state, then action, or by action, then state",
            where="P",
            fix='say layout="sas" for P[state][action], layout="ass" for P[action][state]',
        )
    layout = layout or ("ass" if fits["ass"] else "sas")
    most = max(lengths, default=0)
    there, rows = np.zeros((len(P), most), dtype=bool), list[list[Any]]()
    for place, own in enumerate(P):
        there[place, : len(own)] = [cell is not None and len(cell) > 0 for cell in own]
        rows.append([own[k] if there[place, k] else [0] * states for k in range(most)])
    if layout == "ass":
        there, most = there.T, len(P)
    if isinstance(R, list | tuple) and all(map(_is_list, R)):
        R = [[*own, *[0] * (most - len(own))] for own in R]
    return rows, R, layout, there.reshape(-1)


def keys_of(P: Mapping[Any, Any]) -> list[Any]:
    """Return the keys of matrices in the order of the model: numbers 0, 1, … are places."""
    numbering = Numbering()
    for key in P:
        numbering.add_thing(key, "a key", "P")
    return numbering.list_in_order()


class Listed:
    """Transitions by name, and what amounts beside them say of them."""

    def __init__(self, P: Any, never: float) -> None:
        self.states, actions, self.never = Numbering(), Numbering(), never
        self.pairs: dict[Any, dict[Any, list[tuple[Any, Any]]]] = {}
        for state, own in P.items() if isinstance(P, Mapping) else ():
            self.states.add_thing(state, "a state", "P")
            self.pairs[state] = {action: [] for action in own or {}}
        for state, action, then, chance in _list_quadruples(P):
            place = f"P, state {state}, action {action}"
            for numbering, thing in ((self.states, state), (actions, action), (self.states, then)):
                numbering.add_thing(thing, "a state or action", place)
            with locate_errors(f"{place}, next state {then}"):
                outcomes = self.pairs.setdefault(state, {}).setdefault(action, [])
                outcomes += [(chance, then)] if exact(chance) else []
        self.ends = [state for state, own in self.pairs.items() if not any(own.values())]
        # An action with an empty dictionary is not available; one whose numbers are all 0 is wrong.
        self.offered = [
            (state, action)
            for state, own in self.pairs.items()
            for action, outcomes in own.items()
            if outcomes or not isinstance(P, Mapping) or P[state][action]
        ]

    def read_amounts(self, values: Any, where: str) -> dict[Path, Any]:
        """Return what is earned, by the keys of a state, of a pair, or of a transition."""
        if not isinstance(values, Mapping):
            return self._by_number(values, where)
        amounts = dict(_flatten_rewards(values))
        for (state, *more), amount in amounts.items():
            own = self.pairs.get(state, {})
            nothing = amount in (self.never, 0) if state in self.ends else amount == self.never
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
        """Return the amounts of an array (S,) or (S, A), of states and actions that are numbers."""
        array, states = to_dense(array_of(values, where)), {*self.states.number}
        pairs = [(s, a) for s, own in self.pairs.items() for a in own]
        whole = all(isinstance(thing, int) and thing >= 0 for pair in pairs for thing in pair)
        size = len(states), max((action for _, action in pairs), default=-1) + 1 if whole else 0
        numbered = states == {*range(len(states))}
        if not numbered or array.shape not in (size[:1], size):
            shapes = f"({size[0]},)" + f" or {size}" * (size[1] > 0)
            raise ShapeError(
                f"rewards have shape {array.shape}",
                where=where,
                fix=f"give {REWARDS}"
                + f"; or, as states are whole numbers, an array {shapes}" * numbered,
            )
        if array.ndim == 2 and size[1] in (3, 4) and len(pairs) == size[0]:
            raise ModelError(
                f"rewards of shape {array.shape} may be of states and actions, or rows (s, a, r) "
                "or (s, a, t, r), which are not read",
                where=where,
                fix=f"give {REWARDS}",
            )
        entries = array.tolist()
        if array.ndim == 1:
            return {(state,): amount for state, amount in enumerate(entries)}
        for end in self.ends:
            stated = [x for x in entries[end] if x not in (0, self.never) and x == x]
            if stated:
                raise ModelError(
                    f"rewards of state {end} are {entries[end]}, and P lists no action there",
                    where=where,
                    fix="write 0 there; a reward that is earned once, at the end, is one of "
                    f"{{state: reward}}; one of each step needs an action in P that stays: {{{end}:"
                    f" {{0: {{{end}: 1}}}}}}",
                )
        return {(s, a): entries[s][a] for s, a in pairs}

    def list_rewarded_outcomes(
        self, pair: Path, amounts: Mapping[Path, Any], where: str
    ) -> list[Any]:
        """Return a pair's outcomes with what they earn: their own amount, or the pair's or state's.

        Each is (probability, next state, amount).
        """
        state, action = pair
        place, outcomes = f"{where}, state {state}, action {action}", []
        for chance, then in self.pairs[state][action]:
            stated = [key for key in ((*pair, then), pair, (state,)) if key in amounts]
            if not stated:
                fix = "give 0 where nothing is earned"
                raise ModelError("there is no reward", where=place, fix=fix)
            with locate_errors(place):
                outcomes.append((chance, then, as_given(amounts[stated[0]])))
        return outcomes

    def check_order(self, states: list[Any], amounts: Any, where: str) -> None:
        """Raise ModelError where amounts of pairs, of some `states`, may be those of states."""
        if {*states} != {*range(len(states))} or {*self.states.number} != {*states}:
            return
        lasting = [amounts[place] for place, state in enumerate(states) if state in self.ends]
        if states != sorted(states) or any(lasting):
            raise ModelError(
                f"{len(states)} amounts may be those of states, where an end earns its own once, "
                "or those of pairs, in the order of P, where an end earns its own at each step",
                where=where,
                fix="give {state: amount} or {state: {action: amount}}",
            )

    def read_end_amounts(self, amounts: Mapping[Path, Any], where: str) -> dict[Any, Any]:
        """Return the amounts other than 0 that are stated of states without actions."""
        with locate_errors(where):
            given = {end: as_given(amounts.get((end,), 0)) for end in self.ends}
        return {end: amount for end, amount in given.items() if amount and amount == amount}


def rows_from_listed(P: Any, R: Any, names: dict[str, Any]) -> tuple[list[Any], dict[str, Any]]:
    """Return what `MDP.from_outcomes` takes to build the model of P and R: rows, and names.

    `names` are those given beside P and R; the ones that are returned include them.
    """
    listed = Listed(P, inf if names.get("sense") == "min" else -inf)
    rewards = listed.read_amounts(R, "R")
    once = listed.read_end_amounts(rewards, "R")
    pairs = [
        (state, action)
        for state, action in listed.offered
        if rewards.get((state, action), rewards.get((state,))) != listed.never
    ]
    paid = dict(once)
    given, parts = names.get("components"), dict[str, Any]()
    for name, values in given.items() if isinstance(given, Mapping) else ():
        where = f"component {name}"
        of_pairs = [] if isinstance(values, Mapping) else to_dense(array_of(values, where))
        each = [*(state for state, _ in pairs), *listed.ends]
        if np.shape(of_pairs) == (len(each),):  # one for each pair
            listed.check_order(each, of_pairs, where)
            parts[name] = [*of_pairs]
            continue
        amounts = listed.read_amounts(values, where)
        ends = listed.read_end_amounts(amounts, where)
        paid = dict.fromkeys(ends, 0) | paid
        parts[name] = [
            _merge_equal_amounts(listed.list_rewarded_outcomes(pair, amounts, where))
            for pair in pairs
        ]
        parts[name] += [ends.get(end, 0) for end in listed.ends]
    rows = [(*pair, listed.list_rewarded_outcomes(pair, rewards, "R")) for pair in pairs]
    made, own = number_rows(rows, listed.states, listed.ends, paid)
    if paid:
        names |= _with_the_end(names, len(listed.states.number), own["space"].extra[0])
    if parts:
        names["components"] = {name: [*each, *[0] * bool(paid)] for name, each in parts.items()}
    return made, own | names


def _merge_equal_amounts(outcomes: list[tuple[Any, Any, Any]]) -> Any:
    """Return the amount of a pair, or a list of those of its outcomes where they differ."""
    amounts = [amount for *_, amount in outcomes]
    if not amounts:
        return 0
    return amounts[0] if all(amount == amounts[0] for amount in amounts) else amounts


def _with_the_end(names: dict[str, Any], states: int, end: str) -> dict[str, Any]:
    """Return what is given for each state of P (S,), with the end that is added as one more."""

    def append_value(values: Any, last: Any) -> Any:
        if isinstance(values, list | tuple | np.ndarray) and len(values) == states:
            return [*values, last]
        return values

    longer_names = {"states": append_value(names["states"], end)} if "states" in names else {}
    if not isinstance(names["start"], tuple):  # which may be a state
        longer_names["start"] = append_value(names["start"], 0)
    labels = names.get("labels")
    if isinstance(labels, Mapping):
        longer_names["labels"] = {
            name: append_value(flags, False) if np.asarray(flags).dtype == bool else flags
            for name, flags in labels.items()
        }
    return longer_names


def _list_quadruples(P: Any) -> Iterator[tuple[Any, Any, Any, Any]]:
    """Yield state, action, next state and probability."""
    if not isinstance(P, Mapping):
        for *path, chance in P.tolist() if isinstance(P, np.ndarray) else P:
            state, action, then = map(_float_to_integer, path)
            yield state, action, then, chance
        return
    for state, actions in P.items():
        for action, after in (actions or {}).items():
            fix = "give {state: {action: {next state: probability}}}"
            after = {} if after is None else require_type(after, Mapping, f"P, state {state}", fix)
            for then, chance in after.items():
                yield state, action, then, chance


def _flatten_rewards(R: Mapping[Any, Any], path: Path = ()) -> Iterator[tuple[Path, Any]]:
    """Yield the rewards in nested dictionaries, each with its keys."""
    for key, reward in R.items():
        if isinstance(reward, Mapping):
            yield from _flatten_rewards(reward, (*path, key))
        elif reward is not None:
            yield (*path, key), reward


def _is_list(values: Any) -> bool:
    return isinstance(values, list | tuple) or (isinstance(values, np.ndarray) and values.ndim > 0)


def _float_to_integer(number: Any) -> Any:
    """Return a float of an array of quadruples as the whole number that it is."""
    return int(number) if isinstance(number, float) and number.is_integer() else number
