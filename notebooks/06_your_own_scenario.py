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
# # 6. Your own scenario, from a TOML file
#
# **After this notebook you can** write a care scenario of your own as a text file, have it checked,
# solved and proven, and move one of its numbers to see where the best action changes.
#
# This is software for research, and no medical advice.
#
# The scenario shipped as `tea` has three statuses, three actions and two tasks. Its numbers are
# made up. Here we write a smaller one from scratch.

# %%
import tempfile
from pathlib import Path

import pandas as pd

from exact_mdp import (
    ModelError,
    Scenario,
    best_policy,
    certify,
    evaluate,
    explore,
    plots,
    thresholds,
)

text = """
name = "shoes"
title = "Putting on shoes, an illustrative scenario"
source = "illustrative numbers, no source"
statuses = ["forgetfulness", "frustration"]
actions = ["wait", "prompt", "soothe"]
tasks = [2]
max_trial = 3
discount = 1

[base]
forgetfulness = 0.3
frustration = 0.1
[persistence]
forgetfulness = 0.9
frustration = 0.8
[influence.frustration]
forgetfulness = 0.2
[influence.forgetfulness]
frustration = 0.1

[assistance.prompt.forgetfulness]
persistence = 0.2
onset = 0.05
[assistance.soothe.frustration]
persistence = 0.1
onset = 0

[skip.forgetfulness]
persistence = 0.5
[skip.frustration]
persistence = 0.5

[reward]
forgetfulness = -1
frustration = -4
trial = -1
subtask-complete = 20
subtask-skip = -8
timestep = 0
task-complete = 10
[reward.assist]
wait = 0
prompt = -3
soothe = -2
"""
folder = tempfile.TemporaryDirectory()
path = Path(folder.name) / "shoes.toml"
path.write_text(text)
scenario = Scenario.load(path)
print(scenario)

# %% [markdown]
# Numbers are read as exact rationals: 0.3 is 3/10. A mistake is refused, with its
# place and a remedy.

# %%
path.write_text(text.replace("frustration = 0.8", "frustration = 1.8"))
try:
    Scenario.load(path)
except ModelError as error:
    print(str(error).replace(str(path.parent), "…"))

# %% [markdown]
# ## Solve and prove it

# %%
mdp = scenario.compile()
certificate = certify(mdp)
print(mdp)
print("exact optimum:", certificate.start_value, "≈", round(float(certificate.start_value), 6))
print("the only optimal policy:", certificate.unique, "| violations:", certificate.violations())
print(f"acting at random: {evaluate(mdp, 'random').mean:.3f}")

# %% [markdown]
# Is it worth remembering which trial and subtask it is, or does the status alone suffice?

# %%
sets = (["status"], ["subtask", "status"], ["trial", "status"], ["subtask", "trial", "status"])
found = [best_policy(mdp, columns) for columns in sets]
pd.DataFrame({"reads": [", ".join(f.columns) for f in found], "value": [f.value for f in found]})

# %% [markdown]
# Today it does. Below, other values of one number make the best action depend on the trial.
#
# ## Move one entry of the tables
#
# How likely is frustration to appear by itself? Move the slider: the best actions change where a
# threshold is passed. Between two thresholds the optimal value is a ratio of polynomials, which the
# page evaluates exactly at any value of the parameter; at the thresholds the optimum is certified
# on both sides. The page needs no running notebook: `explored.page()` returns it as one file.

# %%
explored = explore(
    scenario, "base.frustration", ranges={"base.frustration": (0, "7/10")}, policy="always:prompt"
)
explored

# %% [markdown]
# The same thresholds as a table: every value at which an optimal action changes; and as a picture,
# beside the range in which the policy of today stays as it is.

# %%
found = thresholds(scenario, "base.frustration", (0, "7/10"))
with plots.style():
    found.plot()
found

# %% [markdown]
# From the command line: `exact-mdp new shoes.toml` writes such a file to start from,
# `exact-mdp lint shoes.toml` lists all that is wrong with it at once, and
# `exact-mdp explore shoes.toml always:prompt --parameter base.frustration --html page.html` writes
# the page.

# %%
folder.cleanup()
