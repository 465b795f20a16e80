"""What a JANI model declares: its variables in order, and rewards that depend on the next state.

A reward is a transient variable of a JANI model that locations, edges and destinations assign to.
Storm gives the reward of a destination to its edge, by its expected value, from which means are
right and spreads are not. So destinations of one edge must agree about it.

Source: https://jani-spec.org
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.structured import json_of


def list_variables(text: str, where: str) -> list[str]:
    """Return the names of the variables that states consist of, in the order of the file.

    Raises ModelError where the destinations of an edge pay different rewards.
    """
    content = json_of(text, where)
    automata = [each for each in _list_objects(content, "automata") if isinstance(each, dict)]
    variables = [*_list_objects(content, "variables")]
    variables += [each for own in automata for each in _list_objects(own, "variables")]
    rewards = {each.get("name") for each in variables if _is_reward(each)}
    for own in automata:
        for number, edge in enumerate(_list_objects(own, "edges")):
            _check_destinations(edge, rewards, f"automaton {own.get('name')}, edge {number}")
    return [str(each.get("name")) for each in variables if each.get("transient") is not True]


def _list_objects(content: Any, key: str) -> Iterator[dict[str, Any]]:
    """Yield the objects of a list; what has another shape is left to Storm, which refuses it."""
    values = content.get(key) if isinstance(content, dict) else None
    return (each for each in values or () if isinstance(each, dict))


def _is_reward(variable: dict[str, Any]) -> bool:
    return variable.get("transient") is True and variable.get("type") != "bool"


def _check_destinations(edge: dict[str, Any], rewards: set[Any], where: str) -> None:
    """Raise ModelError where one destination of an edge pays what another one does not."""
    paid = [
        [each for each in _list_objects(own, "assignments") if each.get("ref") in rewards]
        for own in _list_objects(edge, "destinations")
    ]
    for own in paid:
        # An assignment with an index may read what the same destination has assigned before.
        ordered = any(each.get("index") for each in own)
        if len(paid) > 1 and (ordered or own != paid[0]):
            name = next(each["ref"] for each in own or paid[0])
            raise ModelError(
                f"the reward {name} depends on the destination",
                where=where,
                fix="let each destination enter a location of its own that assigns it; or let the "
                "edge assign the mean amount, which is the same for expected values alone",
            )
