"""Figures: each function draws on one axes and returns it; none solves, shows or saves.

Readable in greyscale and by colour-blind readers: actions differ in lightness, in hatching and in
the letters written into them, curves in line style.
"""

from exact_mdp.analysis.plots.diagrams import plot_influence, plot_status_transitions
from exact_mdp.analysis.plots.learning import (
    plot_distinct,
    plot_instability,
    plot_learning_curves,
    plot_regrets,
    plot_value_bands,
)
from exact_mdp.analysis.plots.perception import (
    plot_accuracy_curves,
    plot_confusion,
    plot_error_costs,
    plot_hedging,
    plot_prices,
)
from exact_mdp.analysis.plots.policy import plot_policy_map, plot_return_distribution
from exact_mdp.analysis.plots.sensitivity import (
    plot_thresholds,
    plot_tornado,
    plot_two_way,
    plot_value_curves,
)
from exact_mdp.analysis.plots.style import action_styles, save, style

__all__ = [
    "action_styles",
    "plot_accuracy_curves",
    "plot_confusion",
    "plot_distinct",
    "plot_error_costs",
    "plot_hedging",
    "plot_influence",
    "plot_instability",
    "plot_learning_curves",
    "plot_policy_map",
    "plot_prices",
    "plot_regrets",
    "plot_return_distribution",
    "plot_status_transitions",
    "plot_thresholds",
    "plot_tornado",
    "plot_two_way",
    "plot_value_bands",
    "plot_value_curves",
    "save",
    "style",
]
