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
# solved and proven, and move a slider over one of its numbers to see where the best action changes.
#
# The scenario shipped as `tea` has three statuses, three actions and two tasks. Its numbers are
# made up. Here we write a smaller one from scratch.

# %%
import tempfile
from fractions import Fraction
from pathlib import Path

from exact_mdp.analysis import value_of_memory
from exact_mdp.analysis.plots import plot_policy_map, style
from exact_mdp.analysis.plots.slider import Slider
from exact_mdp.analysis.sensitivity import thresholds
from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.solvers import certify, evaluate, solve

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
for best in value_of_memory(mdp, ["status"]):
    print(f"{best.value.value:.6f} by a policy that reads {', '.join(best.columns)}")

# %% [markdown]
# Today it does. Below, other values of one number make the best action depend on the trial.
#
# ## A slider over one entry of the tables
#
# How likely is frustration to appear by itself? Move the slider: the map of best actions changes
# where a threshold is passed. The pictures are drawn beforehand, so that the slider also works in a
# page without a running notebook.

# %%
values = [Fraction(k, 20) for k in range(15)]


def draw(number, ax):
    at = scenario.with_(parameters={"base.frustration": values[number]}).compile()
    plot_policy_map(at, solve(at).policy, statuses=scenario.statuses, ax=ax)
    ax.set_title("best action, first trial of the first subtask")


with style():
    shown = Slider(
        draw, [f"{float(v):.2f}" for v in values], name="base.frustration", first=2, size=(4.6, 2.8)
    )
shown

# %% [markdown]
# The slider moves in steps. The thresholds themselves are exact: every value at which an optimal
# action changes, certified on both sides.

# %%
found = thresholds(scenario, "base.frustration", (0, "7/10"))
for each in found.found:
    for switch in each.switches:
        print(f"{each.value:.12f}  {switch.label}: {switch.before} → {switch.after}")

# %%
folder.cleanup()
