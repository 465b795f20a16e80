"""What may be stated of a parameter's uncertainty, checked.

A setting is `effective_sample_size` of a probability, `relative_sd` of a reward weight, with
`distribution` where it is not normal, or `fixed`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mdp.errors import ModelError, suggest

SETTINGS = ("effective_sample_size", "relative_sd", "distribution", "fixed")


def checked_settings(name: str, settings: object) -> Mapping[str, object]:
    """Return settings that are known, of the right kind, and go together.

    Raises
    ------
    ModelError
        For all others.

    Examples
    --------
    >>> checked_settings("base", {"effective_sample_size": 50})
    {'effective_sample_size': 50}
    """
    where = f"parameter {name}"
    if not isinstance(settings, Mapping):
        raise ModelError(
            f"{settings!r:.60} is stated",
            where=where,
            fix=f"state settings of a distribution: {{{SETTINGS[0]} = 50}}",
        )
    for key in settings:
        if key not in SETTINGS:
            raise ModelError(
                f"unknown setting {key!r}", where=where, fix=suggest(str(key), SETTINGS)
            )
    held = settings.get("fixed", False)
    if not isinstance(held, bool):
        raise ModelError(f"fixed is {held!r}", where=where, fix="write fixed = true, or leave out")
    if held and len(settings) > 1:
        raise ModelError(
            "fixed, and a distribution", where=where, fix="state one or the other of it"
        )
    kind = settings.get("distribution", "normal")
    if kind not in ("normal", "gamma"):
        raise ModelError(f"distribution {kind!r}", where=where, fix="choose normal or gamma")
    if "distribution" in settings and "relative_sd" not in settings:
        raise ModelError(
            f"distribution {kind!r} without a relative_sd", where=where, fix="state a relative_sd"
        )
    if "effective_sample_size" in settings and "relative_sd" in settings:
        raise ModelError(
            "both an effective_sample_size and a relative_sd",
            where=where,
            fix="state the first of a probability, the second of a reward weight",
        )
    for key in ("effective_sample_size", "relative_sd"):
        if key in settings:
            number_of(settings, key, name)
    return settings


def number_of(settings: Mapping[str, object], key: str, name: str) -> float:
    """Return a setting that must be a number; raises ModelError where it is none."""
    value = settings[key]
    number = isinstance(value, int | float | np.integer | np.floating)
    if isinstance(value, bool) or not number:
        raise ModelError(f"{key} is {value!r:.60}", where=f"parameter {name}", fix="give a number")
    try:
        return float(value)
    except OverflowError as error:
        raise ModelError(
            f"{key} has more than 300 digits", where=f"parameter {name}", fix="give a smaller one"
        ) from error
