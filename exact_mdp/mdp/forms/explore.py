"""A model from three things that one knows of it: where it starts, what can be done, what follows.

Breadth first from the start, each state and action asked once; the model is that of the states that
can be reached, whatever is done. States are any hashable objects, numbered as they are found. A
reward may be a dictionary of amounts, whose sum it is: these are the components of the reward.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping
from typing import Any, Self

import numpy as np

from exact_mdp.mdp.build import FromArrays
from exact_mdp.mdp.errors import ModelError, annotate_errors, locate_errors, require_type
from exact_mdp.mdp.forms.names import ByNumber
from exact_mdp.mdp.forms.numbering import Numbering, Row, number_rows
from exact_mdp.mdp.forms.numbers import as_given
from exact_mdp.mdp.table import exact
from exact_mdp.mdp.validate import COUNTED, check_options, require_count

MOST_STATES = 1_000_000  # that a function may lead to, unless its user allows more
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
        max_states: int = MOST_STATES,
        impossible: bool = False,
        labels: Mapping[str, Any] | None = None,
        **names: Any,
    ) -> Self:
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
        impossible : bool
            Explore outcomes of probability 0, too. Models of one function at different parameters
            then have the same states, as a `Family` needs, where some parameter may be 0.
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
        states, rows = Numbering(), list[Row]()
        if isinstance(start, ByNumber):
            raise ModelError(
                "the start of a model goes by numbers, and a function knows states as objects",
                where="start",
                fix="give a state, or {state: probability}",
            )
        begins = [*start.items()] if isinstance(start, Mapping) else [(start, 1)]
        for state, _ in begins:
            states.add_thing(state, "a state", "start")
        if not begins:
            raise ModelError("no state to start in", where="start", fix="give a state")
        waiting = deque(states.number)
        while waiting:
            state = waiting.popleft()
            for action in _call_user_function(
                actions, state, where=f"state {state}", fix="give a list"
            ):
                where = f"state {state}, action {action}"
                answer = _call_user_function(outcomes, state, action, where=where, fix=OUTCOMES)
                with locate_errors(where):
                    every = [*map(_parse_outcome, answer)]
                    possible = [each for each in every if exact(each[0])]
                rows.append((state, action, possible))
                for _, following, _ in every if impossible else possible:
                    known = len(states.number)
                    if states.add_thing(following, "a next state", where) == known:
                        waiting.append(following)
                if len(states.number) > max_states:
                    raise ModelError(
                        f"more than {max_states:,} states can be reached",
                        where=where,
                        fix="raise max_states, or describe states by less",
                    )
        ends = states.number.keys() - {state for state, _, _ in rows}
        listed, parts = number_rows(rows, states, filter(ends.__contains__, [*states.number]))
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
        return cls.from_outcomes(
            listed, discount, **(parts | {"start": places, "labels": flags} | names)
        )


def _call_user_function(ask: Callable[..., Any], *of: Any, where: str, fix: str) -> list[Any]:
    """Return what a function of the user lists; of actions, None is an empty list."""
    with annotate_errors(where):  # a generator runs only in a list
        answer = ask(*of)
        if isinstance(answer, Iterable):
            return list(answer)
    if answer is None and len(of) == 1:
        return []
    raise ModelError(f"the function returns {answer!r}, not a list", where=where, fix=fix)


def _parse_outcome(given: Any) -> tuple[Any, Hashable, Any]:
    try:
        probability, following, reward = given
    except (TypeError, ValueError) as error:
        raise ModelError(f"an outcome is {given!r}", fix=OUTCOMES) from error
    for amount in reward.values() if isinstance(reward, Mapping) else (reward,):
        as_given(amount)  # refused here, where the state and the action are known
    return probability, following, reward
