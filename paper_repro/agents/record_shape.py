"""What the entries of a recording have to look like, so that a damaged one is told as such."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any

MOST_COUNTED = 10**18  # of anything that a recording counts: steps, tokens
EVENTS = ("completed", "failed", "skipped")
CALL = ("purpose", "request", "data", "attempts", "prompt_tokens", "completion_tokens", "seconds")

Test = Callable[[Any], bool]


def _whole(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < MOST_COUNTED


def _seed(value: Any) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= 0


def _text(value: Any) -> bool:
    return isinstance(value, str)


def _texts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(part, str) for part in value)


def _table(value: Any) -> bool:
    return isinstance(value, dict)


def _fraction(value: Any) -> bool:
    if not isinstance(value, str) or len(value) > 4000 or not value.isascii():
        return False
    if not value.lstrip("-").replace("/", "", 1).isdecimal():
        return False
    try:
        Fraction(value)
    except (ValueError, ZeroDivisionError):
        return False
    return True


def _steps(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(part, dict) and _text(part.get("goal")) and _text(part.get("step"))
        for part in value
    )


def _behaviour(value: Any) -> bool:
    return _table(value) and _text(value.get("nonverbal")) and _text(value.get("verbal"))


def _calls(value: Any) -> bool:
    return isinstance(value, list) and all(
        isinstance(call, dict)
        and set(call) == set(CALL)
        and _table(call["data"])
        and all(_whole(call[name]) for name in CALL[3:6])
        for call in value
    )


HEADER: dict[str, Test] = {
    **dict.fromkeys(("disclaimer", "scenario", "policy", "setting", "activity", "variant"), _text),
    **dict.fromkeys(("activity_named", "prompts_named"), _text),
    "seed": _seed,
    **dict.fromkeys(("trials", "history"), _whole),
    **dict.fromkeys(("set", "statuses", "actions"), _texts),
    "backend": _table,
    "steps": _steps,
}

STEP: dict[str, Test] = {
    **dict.fromkeys(("timestep", "state", "subtask", "trial", "next_state"), _whole),
    **dict.fromkeys(("status", "perceived", "action", "assistance"), _text),
    **dict.fromkeys(("reward", "return"), _fraction),
    "behaviour": _behaviour,
    "event": EVENTS.__contains__,
    "calls": _calls,
}

END: dict[str, Test] = {
    **dict.fromkeys(("timesteps", "completed", "skipped", "misperceived"), _whole),
    **dict.fromkeys(("requests", "attempts", "prompt_tokens", "completion_tokens"), _whole),
    "return": _fraction,
}


def fault(entry: Mapping[str, Any], shape: Mapping[str, Test]) -> str | None:
    """Return the name of a part that is missing or of another kind; None where there is none.

    Examples
    --------
    >>> fault({"seed": -1}, {"seed": _whole})
    'seed'
    """
    for name, test in shape.items():
        value = entry.get(name)
        try:
            good = name in entry and test(value)
        except TypeError:  # an unhashable value where a word is wanted
            good = False
        if not good:
            return name
    return None


def step_fault(step: Mapping[str, Any], header: Mapping[str, Any]) -> str | None:
    """Return the name of a part of a timestep that does not fit itself or the header."""
    found = fault(step, STEP)
    if found:
        return found
    for name in ("status", "perceived"):
        if len(step[name]) != len(header["statuses"]) or not set(step[name]) <= {"0", "1"}:
            return name
    if step["subtask"] >= len(header["steps"]):
        return "subtask"
    return None if step["action"] in header["actions"] else "action"
