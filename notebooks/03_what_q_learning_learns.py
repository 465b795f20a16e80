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
# # 3. What Q-learning learns
#
# **After this notebook you can** train a Q-learner on the care model as the paper does, give the
# exact value of each learned policy, and separate two kinds of loss: what a table over statuses
# cannot express, and what was learned badly.
#
# This is software for research, and no medical advice.
#
# The learner sees samples only. We know the model, so that nothing about its result has to be
# estimated by further sampling, except the variation from seed to seed.

# %%
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from exact_mdp import (
    Constant,
    Exponential,
    QLearning,
    Scenario,
    check,
    learning_curve,
    outcomes,
    plots,
    solve,
    train,
)

mdp = Scenario.load("yuan2025").compile()
optimum = solve(mdp).start_value

# %% [markdown]
# ## Train, as the paper does
#
# 6,000 epochs of 30 episodes, a table over the 16 statuses, learning rate 0.05, and two ways to
# explore. Twenty seeds of each; the full reproduction takes a thousand.

# %%
schedules = {
    "constant ε": Constant(0.1),
    "decaying ε": Exponential.through(0.8, at=300, minimum=0.03),
}
runs = {
    label: train(mdp, QLearning(exploration=exploration), 20, rng=0, n_jobs=2)
    for label, exploration in schedules.items()
}

# %% [markdown]
# ## One run, drawn as in the paper and without its noise
#
# A point of the paper's learning curve is the mean return of 40 episodes with the greedy policy of
# that epoch: the thin pale line. Each dot is the exact value of the same policy, and the heavy line
# their moving average. Most of what looks like instability is the noise of 40 episodes, but not all
# of it: the dots lie on several levels, one for each policy that the learner passes through.

# %%
curves = {label: learning_curve(mdp, each[0], rng=1) for label, each in runs.items()}
with plots.style():
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.4), sharey=True)
    for ax, (label, curve) in zip(axes, curves.items(), strict=True):
        plots.plot_learning_curves({label: curve}, optimum=optimum, ax=ax)
    axes[0].set_ylim(100, 155)
    plt.show()

# %% [markdown]
# ## Twenty runs
#
# The band holds the middle nine tenths of the exact values at each epoch.

# %%
with plots.style():
    figure, ax = plt.subplots(figsize=(8, 3.6))
    bands = {
        label: np.array([learning_curve(mdp, run, rng=1).value for run in each])
        for label, each in runs.items()
    }
    plots.plot_value_bands(bands, optimum=optimum, ax=ax)
    plt.show()

# %% [markdown]
# ## Where they end
#
# The exact regret of the final policies, and the share of runs that end with an optimal one.

# %%
found = {label: outcomes(mdp, each) for label, each in runs.items()}
table = pd.DataFrame(
    {
        label: {
            "mean regret": each.regret.mean(),
            "largest regret": each.regret.max(),
            "optimal runs": each.optimal_fraction,
            "distinct final policies": len(each.policies),
        }
        for label, each in found.items()
    }
)
table.round(3)

# %% [markdown]
# The paper reports three policies in the last hundred episodes with constant ε and two with
# decaying ε. How many there are differs from run to run:

# %%
with plots.style():
    figure, ax = plt.subplots(figsize=(6, 3))
    plots.plot_distinct(found, ax=ax)
    plt.show()

# %% [markdown]
# ## An audit of one learned table
#
# `check` compares a policy or a Q-table with the exact optimum: what it loses, in which states, and
# whether a table over statuses could have done better. In a CI job the same is
# `exact-mdp check yuan2025 q_table.npy --max-regret 0.5`.

# %%
audit = check(mdp, runs["constant ε"][0].q, max_regret=0.5)
print("passed:", audit.passed)
audit
