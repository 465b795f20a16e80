"""The text record of a conversation, timestep by timestep, as Section 4.2 of the paper describes.

Texts that come from a backend are shown on one line with control characters taken out, so that
none of them can look like a line of the record itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

OUTCOMES = {
    "completed": "step completed",
    "failed": "step not completed, another trial",
    "skipped": "step skipped after the last trial",
}


def plain(text: str) -> str:
    """Return text on one line, without control characters.

    Examples
    --------
    >>> plain("one\\nTimestep 7\\x1b[31m")
    'one Timestep 7 [31m'
    """
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def number(text: str) -> str:
    """Return an exact number for reading: whole where it is whole, else with two decimals.

    Examples
    --------
    >>> number("-8"), number("1/3")
    ('-8', '0.33')
    """
    value = Fraction(text)
    if value.denominator == 1:
        return str(value)
    whole, cents = divmod(round(abs(value) * 100), 100)
    return f"{'-' * (value < 0)}{whole}.{cents:02d}"


def vector(names: list[str], bits: str) -> str:
    """Return a status vector with its names: Forgetfulness=0, Confusion=1, …"""
    return ", ".join(
        f"{plain(name.capitalize())}={bit}" for name, bit in zip(names, bits, strict=True)
    )


def heading(header: Mapping[str, Any]) -> str:
    """Return the top of the record: what it is, and what it is not."""
    backend = ", ".join(f"{key} {value}" for key, value in header["backend"].items())
    return "\n".join(
        [
            plain(header["disclaimer"]),
            "",
            f"Scenario: {plain(header['scenario'])}; activity: {plain(header['activity'])}; "
            f"policy: {plain(header['policy'])}; seed {header['seed']}",
            f"Language: {plain(backend)}; action execution: {plain(header['variant'])}",
            f"Setting: {plain(header['setting'])}",
            "",
            "",
        ]
    )


def block(header: Mapping[str, Any], step: Mapping[str, Any]) -> str:
    """Return the lines of one timestep."""
    names, place = header["statuses"], header["steps"][step["subtask"]]
    action = header["actions"].index(step["action"])
    spoken = plain(step["assistance"])
    verbal = plain(step["behaviour"]["verbal"])
    return "\n".join(
        [
            f"Timestep {step['timestep']}",
            f"  Task: {plain(place['goal'])}",
            f"  Subtask {step['subtask'] + 1} of {len(header['steps'])}: {plain(place['step'])}",
            f"  Trial: {min(step['trial'] + 1, header['trials'])} of {header['trials']}",
            f"  PLWD status: {vector(names, step['status'])}",
            f"  PLWD nonverbal: {plain(step['behaviour']['nonverbal'])}",
            f"  PLWD verbal: {verbal or '(says nothing)'}",
            f"  Perceived status: {vector(names, step['perceived'])}",
            f"  Action: a{action} {plain(step['action'])}",
            f"  Robot Caregiver: {spoken or '(says nothing)'}",
            f"  Outcome: {OUTCOMES[step['event']]}; reward {number(step['reward'])}, "
            f"return so far {number(step['return'])}",
            "",
            "",
        ]
    )


def closing(end: Mapping[str, Any]) -> str:
    """Return the last line: how the scenario went."""
    return (
        f"End after {end['timesteps']} timesteps: {end['completed']} steps completed, "
        f"{end['skipped']} skipped, return {number(end['return'])}; "
        f"the status was misperceived in {end['misperceived']} timesteps.\n"
    )
