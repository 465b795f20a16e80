"""Figures: each function draws on one axes and returns it; none solves, shows or saves.

Readable in greyscale and by colour-blind readers: actions differ in lightness, in hatching and in
the letters written into them, curves in line style. `result.plot()` calls the one of its result.
"""

from exact_mdp.mdp.errors import extra

with extra("plots"):
    from exact_mdp.analysis.plots.diagrams import plot_influence, plot_status_transitions
    from exact_mdp.analysis.plots.learning import (
        plot_distinct,
        plot_learning_curves,
        plot_regrets,
        plot_trainer,
        plot_value_bands,
    )
    from exact_mdp.analysis.plots.perception import plot_accuracy_curves, plot_confusion
    from exact_mdp.analysis.plots.psa import plot_acceptability, plot_optimal_actions
    from exact_mdp.analysis.plots.returns import plot_return_distribution
    from exact_mdp.analysis.plots.sensitivity import plot_sobol, plot_thresholds
    from exact_mdp.analysis.plots.states import plot_policy, plot_states
    from exact_mdp.analysis.plots.style import action_styles, save, style
    from exact_mdp.analysis.plots.transitions import plot_transitions

__all__ = [
    "action_styles",
    "plot_acceptability",
    "plot_accuracy_curves",
    "plot_confusion",
    "plot_distinct",
    "plot_influence",
    "plot_learning_curves",
    "plot_optimal_actions",
    "plot_policy",
    "plot_regrets",
    "plot_return_distribution",
    "plot_sobol",
    "plot_states",
    "plot_status_transitions",
    "plot_thresholds",
    "plot_trainer",
    "plot_transitions",
    "plot_value_bands",
    "save",
    "style",
]
