"""Figures: each function draws on one axes and returns it; none solves, shows or saves.

Readable in greyscale and by colour-blind readers: actions differ in lightness, in hatching and in
the letters written into them, curves in line style. `result.plot()` calls the one of its result.
"""

from exact_mdp.mdp.errors import require_extra

with require_extra("plots"):
    from exact_mdp.analysis.plots.models import plot_influence, plot_transitions
    from exact_mdp.analysis.plots.runs import plot_distinct, plot_learning_curves, plot_regrets
    from exact_mdp.analysis.plots.sensitivity import plot_optimal_actions, plot_thresholds
    from exact_mdp.analysis.plots.states import plot_policy, plot_states
    from exact_mdp.analysis.plots.style import style

__all__ = [
    "plot_distinct",
    "plot_influence",
    "plot_learning_curves",
    "plot_optimal_actions",
    "plot_policy",
    "plot_regrets",
    "plot_states",
    "plot_thresholds",
    "plot_transitions",
    "style",
]
