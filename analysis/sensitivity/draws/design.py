"""Designs: the draws over parameters' ranges at which SALib wants the model solved.

Parameters are independent and uniform over their ranges. A method of SALib chooses the draws from
the ranges and a seed; at each of them the model is solved again, and a policy held fixed is
evaluated, which gives the three outputs that are analysed: the optimum's value, the policy's, and
the policy's regret (Herman and Usher, Journal of Open Source Software 2, 2017).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.analysis.sensitivity.base import unit_of
from exact_mdp.analysis.sensitivity.draws.sampled import Sampled, sampled
from exact_mdp.analysis.sensitivity.ranges import Range, spans_of
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.table import Floats

if TYPE_CHECKING:
    from pandas import DataFrame

OUTPUTS = ("optimal", "fixed", "regret")


@dataclass(frozen=True, kw_only=True, eq=False)
class Design:
    """A model, and the parameters that vary over their ranges.

    Attributes
    ----------
    model : Parametric
    spans : {Parameter: Range}
        The P parameters, each with a range that is not empty.
    """

    model: Parametric
    spans: Mapping[Parameter, Range]

    @classmethod
    def of(
        cls,
        source: Scenario | MDP | Parametric,
        names: Iterable[str] | None,
        ranges: Mapping[str, object] | None,
        relative: Fraction | None,
    ) -> Design:
        """Return the design of what is asked for; see `analysis.sensitivity.ranges.spans_of`."""
        model = parametric(source)
        chosen = None if names is None else list(names)
        return cls(model=model, spans=spans_of(model, chosen, ranges, relative))

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters, in the order of the draws' columns."""
        return tuple(self.spans)

    @property
    def ranges(self) -> dict[str, Range]:
        """Their ranges by name."""
        return {parameter.name: span for parameter, span in self.spans.items()}

    @cached_property
    def problem(self) -> dict[str, Any]:
        """Parameters and ranges as SALib states a problem."""
        return problem_of(self.spans)

    def draws(
        self, sample: Callable[..., Floats], count: int, sequence: SeedSequence, **settings: Any
    ) -> Floats:
        """Return (D, P) draws by a sampling method of SALib."""
        drawn = sample(self.problem, count, seed=whole_seed(sequence), **settings)
        return inside(drawn, self.spans)

    def solved(self, draws: Floats, policy: object, **how: Any) -> Sampled:
        """Return the values at every draw: the optimum's, and the policy's."""
        return sampled(self.model, self.problem["names"], draws, [policy], **how)


def outputs_of(found: Sampled) -> dict[str, Floats]:
    """Return the outputs that are analysed, (D,) each, by name."""
    every = found.optimal, found.fixed[:, 0], found.regret[:, 0]
    return dict(zip(OUTPUTS, every, strict=True))


def check_output(output: str, where: str) -> None:
    """Raise ModelError unless an output has this name."""
    if output not in OUTPUTS:
        raise ModelError(
            f"unknown output {output!r}", where=where, fix=f"choose one of {', '.join(OUTPUTS)}"
        )


def frame_of(
    ranges: Mapping[str, Range],
    parameters: Sequence[Parameter],
    measures: Mapping[str, Floats],
    by: Floats,
    attrs: Mapping[str, object],
) -> DataFrame:
    """Return one row for each parameter, with measures (P,) of it, the largest `by` (P,) first."""
    from pandas import DataFrame

    spans = [ranges[parameter.name] for parameter in parameters]
    table = DataFrame(
        {
            "parameter": [parameter.name for parameter in parameters],
            "unit": [unit_of(parameter) for parameter in parameters],
            "low": [float(span.low) for span in spans],
            "high": [float(span.high) for span in spans],
            **measures,
            "claim": "estimated",
        }
    )
    table = table.iloc[np.argsort(-by, kind="stable")].reset_index(drop=True)
    table.attrs |= attrs
    return table


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
