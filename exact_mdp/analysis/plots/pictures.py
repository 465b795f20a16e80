"""The picture of each kind of result."""

from __future__ import annotations

from typing import Any

from matplotlib.axes import Axes

from exact_mdp.analysis.plots import models, runs, sensitivity, states
from exact_mdp.mdp.errors import ModelError

PICTURES: dict[str, Any] = {
    "Audit": states.plot_audit,
    "BoundedCertificate": states.plot_solution,
    "Certificate": states.plot_solution,
    "CostEffectiveness": sensitivity.plot_cost_effectiveness,
    "Curve": sensitivity.plot_value_curves,
    "ErrorCosts": models.plot_error_costs,
    "Evaluation": states.plot_evaluation,
    "Front": models.draw_front,
    "Gradient": sensitivity.plot_gradient,
    "LearningCurve": runs.plot_learning_curves,
    "Outcomes": runs.plot_regrets,
    "PSA": sensitivity.plot_acceptability,
    "ReturnDistribution": runs.plot_return_distribution,
    "Simulation": runs.plot_simulation,
    "Sobol": sensitivity.plot_sobol,
    "Solution": states.plot_solution,
    "Thresholds": sensitivity.plot_thresholds,
    "Tornado": sensitivity.plot_tornado,
    "Trace": runs.plot_trace,
    "TrainerAudit": runs.plot_trainer,
    "TwoWay": sensitivity.plot_two_way,
    "ValueFunction": sensitivity.plot_value_function,
}


def draw(result: object, ax: Axes | None = None, **settings: Any) -> Axes:
    """Draw a result, as its `plot` does.

    Parameters
    ----------
    result : a solution, certificate, audit, curve or another result that has a picture
    ax : Axes, optional
        The axes of a new figure unless given.
    **settings
        Settings of the function that draws this kind of result: see `PICTURES`.

    Returns
    -------
    Axes

    Examples
    --------
    >>> from exact_mdp import MDP, draw, solve
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [[1], [0]])
    >>> draw(solve(mdp)).get_xlabel() != ""
    True
    """
    kinds = [kind.__name__ for kind in type(result).__mro__ if kind.__name__ in PICTURES]
    if not kinds:
        raise ModelError(
            f"there is no picture of {type(result).__name__}",
            fix=f"draw one of {', '.join(PICTURES)}",
        )
    drawn: Axes = PICTURES[kinds[0]](result, ax=ax, **settings)
    return drawn
