"""Declarations of a JANI model: its variables in order, and a check of its rewards.

A reward is a transient variable of a JANI model to which locations, edges and destinations assign
values. Storm replaces rewards of destinations by their expected value for the edge: means are then
right, but variances are wrong. So all destinations of an edge must have the same reward.

Source: https://jani-spec.org
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.structured import json_of


def list_variables(text: str, where: str) -> list[str]:
    """Return the names of the variables of a state, in the order of the file.

    Raises ModelError if the destinations of an edge have different rewards.
    """
    content = json_of(text, where)
    automata = [each for each in _list_objects(content, "automata") if isinstance(each, dict)]
    variables = [*_list_objects(content, "variables")]
    for own in automata:
        variables += _list_objects(own, "variables")
    rewards = {each.get("name") for each in variables if _is_reward(each)}
    for own in automata:
        for number, edge in enumerate(_list_objects(own, "edges")):
            _check_destinations(edge, rewards, f"automaton {own.get('name')}, edge {number}")
    names = []
    for each in variables:
        if each.get("transient") is not True:
            names.append(str(each.get("name")))
    return names


def _list_objects(content: Any, key: str) -> Iterator[dict[str, Any]]:
    """Yield the objects of a list; Storm refuses anything else."""
    if isinstance(content, dict):
        for each in content.get(key) or ():
            if isinstance(each, dict):
                yield each


def _is_reward(variable: dict[str, Any]) -> bool:
    """Return whether a variable is a reward: transient, and a number."""
    return variable.get("transient") is True and variable.get("type") != "bool"


def _check_destinations(edge: dict[str, Any], rewards: set[Any], where: str) -> None:
    """Raise ModelError if the destinations of an edge assign different rewards."""
    paid = []
    for destination in _list_objects(edge, "destinations"):
        assigned = _list_objects(destination, "assignments")
        paid.append([each for each in assigned if each.get("ref") in rewards])
    for own in paid:
        # An assignment with an index may read what the same destination has assigned before.
        ordered = any(each.get("index") for each in own)
        if len(paid) > 1 and (ordered or own != paid[0]):
            name = next(each["ref"] for each in own or paid[0])
            raise ModelError(
                f"the reward {name} depends on the destination",
                where=where,
                fix="let each destination enter a location of its own that assigns it; or let the "
                "edge assign the mean amount, which gives the same expected values only",
            )
