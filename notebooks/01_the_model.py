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
# # 1. The model and its explicit matrix
#
# **After this notebook you can** build the care model of Yuan et al. (2025) as an explicit Markov
# decision process, look up any row of its transition matrix as exact fractions, and change any
# number of its tables or any reading of its text.
#
# This is software for research, and no medical advice.
#
# A robot helps a person living with dementia through a task of several subtasks. The person has
# four statuses, each present or absent: forgetfulness, confusion, anger, disengagement. In every
# trial the robot does one of four things, the statuses move, and the trial succeeds if none is
# present afterwards. Five failed trials, and the subtask is skipped.

# %%
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from exact_mdp import Scenario, plots

scenario = Scenario.load("yuan2025")
mdp = scenario.compile()
print(scenario)
print(mdp)

# %% [markdown]
# ## States
#
# A state is a subtask, the number of failed trials so far, and a status vector; `0100` is confused
# only. One absorbing end state comes last. States are integers inside, names at the edges.

# %%
start = mdp.space.index(subtask=0, trial=0, status=0b0000)
print([mdp.space.label(state) for state in (start, start + 4, mdp.n_states - 1)])
print(mdp.space.size, "states =", "3 subtasks × 5 trials × 16 statuses + the end")

# %% [markdown]
# ## One row, in exact fractions
#
# What can happen in the first trial, statuses all absent, under verbal directive assistance? The
# float matrix is what this rational row becomes when it is rounded, once.

# %%
pair = mdp.pair(start, mdp.actions.index("directive"))
row = [
    (str(probability), round(float(probability), 6), str(gain), mdp.space.label(following))
    for probability, following, gain in mdp.table.row(pair)
]
pd.DataFrame(row, columns=["exact", "float", "reward", "next state"])

# %% [markdown]
# With probability 19/25 no anger and no disengagement appear, and the subtask is completed. Under
# directive assistance no forgetfulness and no confusion can appear, so that only four vectors are
# possible.
#
# ## The whole matrix
#
# One row for each state and action, one column for each state. The block structure is the care
# model: five trials inside a subtask, then the next subtask.

# %%
with plots.style():
    figure, ax = plt.subplots(figsize=(4.2, 7.5))
    ax.spy(mdp.transition, markersize=0.35, color="black", aspect="auto")
    ax.set_xlabel("next state")
    ax.set_ylabel("state and action")
    plt.show()
print(f"{mdp.n_transitions} transitions, {mdp.n_transitions / mdp.transition.shape[0]:.1f} a row")

# %% [markdown]
# ## How statuses influence each other
#
# Without assistance one status makes another likelier (the paper's Table 3). On the right the
# chance of each status vector (column) after directive assistance, by the one now (row), in per
# cent.

# %%
law = np.zeros((16, 16))
for now in range(16):
    row = mdp.pair(mdp.space.index(status=now), mdp.action("directive"))
    for chance, state, _ in mdp.table.row(row):  # the end counts as status 0000
        law[now, max(mdp.space.values("status")[state], 0)] += chance

with plots.style():
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.8))
    plots.plot_influence(scenario, ax=left)
    left.set_title("influence without assistance, percentage points")
    plots.plot_status_transitions(law, scenario.statuses, ax=right)
    right.set_title("after directive assistance")
    plt.show()

# %% [markdown]
# ## Change a number, or the reading
#
# Every number has a name. Where the paper's text can be read in two ways, a *reading* chooses; the
# first option of each is the default. Nothing is changed in place: `with_` gives a new scenario.

# %%
calmer = scenario.with_(parameters={"base.anger": "1/100"}, tasks=[3, 1])
other = scenario.with_(readings={"influence_orientation": "column-to-row"})
models = {"the paper's": scenario, "calmer": calmer, "other reading": other}
sizes = {label: each.compile() for label, each in models.items()}
pd.DataFrame(
    {label: (m.n_states, m.n_pairs, m.n_transitions) for label, m in sizes.items()},
    index=["states", "pairs", "transitions"],
).T

# %% [markdown]
# A wrong name is refused, with the nearest one:

# %%
from exact_mdp import ModelError

try:
    scenario.with_(parameters={"base.angry": 0.1})
except ModelError as error:
    print(error)
