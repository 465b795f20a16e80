"""Build a model by exploring from its start, given functions for actions and outcomes.

The search is breadth first, and calls each function once for each state and action. The model has
all states that some sequence of actions can reach. States are any hashable objects, numbered as
they are found. A reward may be a dictionary of amounts, the components of the reward: the reward is
their sum.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping
from fractions import Fraction
from math import isfinite
from typing import Any, Self

import numpy as np

from exact_mdp.mdp.build import FromArrays
from exact_mdp.mdp.errors import ModelError, annotate_errors, locate_errors, require_type
from exact_mdp.mdp.forms.listed import OutcomeColumns, name_columns
from exact_mdp.mdp.forms.names import ByNumber, Numbering
from exact_mdp.mdp.forms.numbers import as_given
from exact_mdp.mdp.table import exact
from exact_mdp.mdp.validate import COUNTED, check_options, require_count

OUTCOMES = "give a list of (probability, next state, reward)"


class FromFunction(FromArrays):
    """Models from functions of states and actions."""

    @classmethod
    def from_function(
        cls,
        start: Any,
        actions: Callable[[Any], Iterable[Hashable]],
        outcomes: Callable[[Any, Any], Iterable[tuple[Any, Hashable, Any]]],
        discount: object = 1,
        *,
        max_states: int = 1_000_000,
        impossible: bool = False,
        labels: Mapping[str, Any] | None = None,
        **names: Any,
    ) -> Self:
        """Build by exploring all states that can be reached from the start.

        Parameters
        ----------
        start : state, or {state: probability}
            States are any hashable objects; `mdp.space.number(state)` is the number of one. States
            that are tuples of one length are drawn as a map of their parts, named by a
            `namedtuple("Place", "row column")`.
        actions : function of a state
            Returns the actions of the state, any hashable objects. A state without actions is an
            end.
        outcomes : function of a state and an action
            Returns a list of (probability, next state, reward), each number exact or a float.
            Instead of a reward, an outcome may have {component: amount}; the reward is their sum.
        discount : number or "p/q"
        max_states : int
            Stop with an error if more states than this are found.
        impossible : bool
            Also explore outcomes of probability 0. Models of one function at different parameters
            then have the same states, as a `Family` needs, even if a probability becomes 0.
        labels : {name: function of a state}, optional
            For each label, a function that returns whether a state has it; (S,) truth values are
            accepted as well.
        **names
            As in `from_arrays`.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If there are too many states, states cannot be keys, or outcomes have another form; and
            as the constructor does.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> def bet(money, stake):
        ...     return [("2/5", money + stake, 0), ("3/5", money - stake, 0)]
        >>> def stakes(money):
        ...     return range(1, min(money, 4 - money) + 1)
        >>> mdp = MDP.from_function(2, stakes, bet)
        >>> mdp, mdp.actions
        (MDP(unnamed: 5 states, 2 actions, 6 pairs, 10 transitions, discount 1), ('1', '2'))
        """
        check_options(names, COUNTED)
        require_type(
            actions, Callable, "actions", "give a function of a state: lambda state: [0, 1]"
        )
        fix = f"give a function of a state and an action: {OUTCOMES}"
        require_type(outcomes, Callable, "outcomes", fix)
        max_states = require_count(max_states, "max_states")
        require_type(labels or {}, Mapping, "labels", "give {name: function of a state}")
        states, doing, columns = Numbering(), Numbering(), OutcomeColumns()
        if isinstance(start, ByNumber):
            raise ModelError(
                "the start of another model has numbers of states, but a function needs objects",
                where="start",
                fix="give a state, or {state: probability}",
            )
        begins: list[tuple[Any, Any]] = [(start, 1)]
        if isinstance(start, Mapping):
            begins = [*start.items()]
        for state, _ in begins:
            states.add_thing(state, "a state", "start")
        if not begins:
            raise ModelError("no state to start in", where="start", fix="give a state")
        # Breadth-first search; every new state is appended to the queue.
        frontier = deque(states.number)
        while frontier:
            state = frontier.popleft()
            for action in _call_user_function(
                actions, state, where=f"state {state}", fix="give a list"
            ):
                where = f"state {state}, action {action}"
                answer = _call_user_function(outcomes, state, action, where=where, fix=OUTCOMES)
                try:
                    every = [*map(_parse_outcome, answer)]
                    possible = [each for each in every if _is_possible(each[0])]
                except ModelError:
                    with locate_errors(where):
                        raise
                if not impossible:
                    every = possible
                for _, following, _ in every:
                    known = len(states.number)
                    if states.add_thing(following, "a next state", where) == known:
                        frontier.append(following)
                act, number = doing.add_thing(action, "an action", f"state {state}"), states.number
                numbered = ((chance, number[then], gain) for chance, then, gain in possible)
                columns.add_pair(number[state], act, numbered)
                if len(states.number) > max_states:
                    raise ModelError(
                        f"more than {max_states:,} states can be reached",
                        where=where,
                        fix="raise max_states, or describe states by less",
                    )
        parts = name_columns(columns, states, doing)  # states without a row are ends
        # Ask the functions of labels for all states.
        flags = dict(labels or {})
        for name, holds in flags.items():
            if callable(holds):
                with annotate_errors(f"label {name}"):
                    answers = [holds(state) for state in states.list_in_order()]
                for answer in answers:  # a function that forgets to return gives None
                    if not isinstance(answer, bool | np.bool_):
                        raise ModelError(
                            f"the function returns {answer!r}, not True or False",
                            where=f"label {name}",
                            fix="return a truth value: bool(…)",
                        )
                flags[name] = np.array(answers)
        places = ByNumber((states.number[state], chance) for state, chance in begins)
        names = parts | {"start": places, "labels": flags} | names
        return cls._from_columns(columns, discount, names.pop("start"), names)


def _call_user_function(ask: Callable[..., Any], *of: Any, where: str, fix: str) -> list[Any]:
    """Call a user's function and return its answer as a list; None for actions is an empty list."""
    try:  # to enter a context for each pair would take longer
        answer = ask(*of)
        if type(answer) is list:
            return answer
        if isinstance(answer, Iterable):
            return list(answer)  # the code of a generator runs here
    except Exception:
        with annotate_errors(where):
            raise
    if answer is None and len(of) == 1:
        return []
    raise ModelError(f"the function returns {answer!r}, not a list", where=where, fix=fix)


def _is_possible(chance: Any) -> bool:
    """Return whether a probability is not 0; raise ModelError if it is not a number."""
    if type(chance) is float and isfinite(chance):  # to make a fraction takes longer
        return chance != 0
    return exact(chance) != 0


def _parse_outcome(given: Any) -> tuple[Any, Hashable, Any]:
    """Return an outcome as (probability, next state, reward); raise ModelError for another form."""
    try:
        probability, following, reward = given
    except (TypeError, ValueError) as error:
        raise ModelError(f"an outcome is {given!r}", fix=OUTCOMES) from error
    if type(reward) in (int, float, Fraction):  # isinstance takes longer
        return probability, following, reward
    amounts = [reward]
    if isinstance(reward, Mapping):
        amounts = [*reward.values()]
    # A bad number is refused here, so that the message can name the state and the action.
    for amount in amounts:
        as_given(amount)
    return probability, following, reward
