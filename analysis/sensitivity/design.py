"""Parameters and ranges as SALib states them, and what its samples need around them."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
from numpy.random import SeedSequence

from analysis.sensitivity.ranges import Range
from mdp.errors import ModelError
from mdp.parameters import Parameter
from mdp.table import Floats


def salib(module: str) -> Any:
    """Return a module of SALib; raises ModelError where it is not installed."""
    try:
        return import_module(f"SALib.{module}")
    except ImportError as error:
        raise ModelError(
            "Sobol and Morris designs need SALib, which is not installed",
            where=f"SALib.{module}",
            fix='install it: pip install "exact-mdp[sensitivity]"',
        ) from error


def problem_of(spans: Mapping[Parameter, Range]) -> dict[str, Any]:
    """Return the parameters and ranges as SALib states a problem."""
    return {
        "num_vars": len(spans),
        "names": [parameter.name for parameter in spans],
        "bounds": [[float(span.low), float(span.high)] for span in spans.values()],
    }


def inside(draws: Floats, spans: Mapping[Parameter, Range]) -> Floats:
    """Return draws of which rounding has pushed none beyond the end of its range.

    SALib computes low + u (high - low), which may exceed high by a few units in the last place.
    """
    low = np.array([float(span.low) for span in spans.values()])
    high = np.array([float(span.high) for span in spans.values()])
    slack = 1e-12 * (1 + np.abs(low) + np.abs(high))
    assert ((draws >= low - slack) & (draws <= high + slack)).all()
    return np.clip(draws, low, high)


def whole_seed(sequence: SeedSequence) -> int:
    """Return an integer seed that is never 0, which SALib takes for none at all.

    Examples
    --------
    >>> whole_seed(SeedSequence(0)) == whole_seed(SeedSequence(0)) > 0
    True
    """
    return int(sequence.generate_state(1)[0] >> 1) + 1  # below 2**31, as np.random.seed takes it


def check_confidence(confidence: float) -> None:
    """Raise ModelError unless the confidence lies between 0 and 1."""
    if not 0 < confidence < 1:
        raise ModelError(
            f"a confidence of {confidence}", where="confidence", fix="choose one from 0 to 1"
        )
