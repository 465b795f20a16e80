# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # 4. Which numbers decide the policy
#
# **After this notebook you can** say which entries of the tables matter for the optimal value, at
# which value of an entry the best action changes, and how sure one can be of the policy when the
# entries are uncertain.
#
# This is software for research, and no medical advice.
#
# The probabilities of the care model are judgements. A policy computed from them is only as good as
# the entries that it depends on. Which ones are these?

# %%
import warnings

import matplotlib.pyplot as plt
import pandas as pd

from exact_mdp import (
    Scenario,
    ScenarioWarning,
    gradient,
    one_way,
    plots,
    psa,
    robust_curve,
    sobol,
    thresholds,
    tornado,
    two_way,
)

scenario = Scenario.load("yuan2025")

# %% [markdown]
# ## Derivatives, exact
#
# One backward and one forward pass give the derivative of the optimal start value by every number
# (the envelope theorem). They are rationals, not finite differences. Elasticity is the change in
# per cent that follows from a change of the number by one per cent.

# %%
frame = gradient(scenario).frame().set_index("parameter")
size = frame["elasticity (% per %)"].abs()
ranked = frame.loc[size.sort_values(ascending=False).index]
columns = ["value", "derivative (reward per unit)", "elasticity (% per %)", "claim"]
ranked[columns].head(10).round(4)

# %% [markdown]
# ## Over ranges: a tornado diagram
#
# Each probability is moved by a fifth up and down. Both ends of a bar have three values: `optimal`
# with the policy re-optimised, `fixed` with the policy held, and `regret`, what holding it loses.

# %%
names = [name for name in ranked.index if not name.startswith(("reward", "discount"))][:12]
found = tornado(scenario, names=names)
with plots.style():
    figure, ax = plt.subplots(figsize=(7, 4))
    found.plot(ax)
    plt.show()

# %% [markdown]
# ## Thresholds: where the best action changes
#
# Not from a grid: the gaps between actions are polynomials of a parameter, whose roots are
# bracketed to 1e-12 and proved on both sides. None is missed in between. Inside the shaded part of
# each range the optimal policy stays exactly as it is.

# %%
looked_at = {
    "base.anger": (0, "1/2"),
    "base.disengagement": (0, "1/2"),
    "persistence.anger": ("4/5", 1),
}
found = {name: thresholds(scenario, name, bounds) for name, bounds in looked_at.items()}
with plots.style():
    figure, ax = plt.subplots(figsize=(7, 2.6))
    plots.plot_thresholds(found, ax=ax)
    plt.show()
stable = {name: map(float, each.stable()) for name, each in found.items()}
pd.DataFrame.from_dict(stable, orient="index", columns=["the policy stays from", "to"])

# %% [markdown]
# ## One entry, continuously

# %%
curve = one_way(scenario, "base.anger", (0, "1/2"))
with plots.style():
    figure, ax = plt.subplots(figsize=(6, 3))
    curve.plot(ax)
    plt.show()

# %% [markdown]
# ## Two entries at once
#
# Regions of the plane in which the same policy is optimal.

# %%
bounds = {"base.anger": ("1/100", "1/4"), "base.disengagement": ("1/100", "2/5")}
plane = two_way(scenario, *bounds, ranges=bounds, points=15)
with plots.style():
    figure, ax = plt.subplots(figsize=(5, 4))
    plane.plot(ax)
    plt.show()

# %% [markdown]
# ## All entries at once: probabilistic sensitivity analysis
#
# Suppose each probability rests on twenty observations. Draw all of them, solve the model anew for
# every draw, and see how today's optimal policy fares: how often it is still optimal, and how much
# it loses where it is not. These are estimates, with their intervals.
#
# In a few draws a sum of chances passes 1 and is cut off there. A `ScenarioWarning` says so, with
# the sum and its terms; here we know of it and silence it.

# %%
with warnings.catch_warnings():
    warnings.simplefilter("ignore", ScenarioWarning)
    drawn = psa(scenario, 20_000, rng=0, effective_sample_size=20)
with plots.style():
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4))
    drawn.plot(left)
    plots.plot_optimal_actions(drawn, ax=right)
    plt.show()
worth = drawn.evpi()
print(f"EVPI, at least {worth.low}, at most {worth.high}")

# %% [markdown]
# On the right, each row is a status: the share of draws in which an action is the best one there.
# Where one action has nearly all draws, no plausible error in the tables changes the advice.
#
# ## Which entries drive the spread?
#
# Sobol indices split the variance of the optimal value over the entries, alone (first order) and
# with all their interactions (total).

# %%
probabilities = [name for name in scenario.names if not name.startswith("reward")]
indices = sobol(scenario, names=probabilities, n=512, rng=0)
with plots.style():
    figure, ax = plt.subplots(figsize=(7, 4))
    indices.plot(ax)
    plt.show()

# %% [markdown]
# ## And if nature is against us?
#
# Let every row of the matrix move within a distance, as badly as possible. The best policy against
# that may differ from today's; its price is what it gives up where the tables are right.

# %%
curve = robust_curve(scenario.compile(), "l1", [k / 10 for k in range(0, 13, 2)])
with plots.style():
    figure, ax = plt.subplots(figsize=(6, 3.4))
    curve.plot(ax)
    plt.show()
