"""A confusion matrix.

How likely each status is perceived where another one is true.
"""

from exact_mdp import independent, plots

sensitivity, specificity = [0.9, 0.8, 0.7, 0.95], [0.85, 0.9, 0.75, 0.6]
plots.plot_confusion(independent(sensitivity, specificity))
