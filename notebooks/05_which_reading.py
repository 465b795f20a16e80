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
# # 5. Which reading is it?
#
# **After this notebook you can** turn the open points of a text into a set of models, evaluate
# every policy that the text allows under each of them, exactly, and say which points the reported
# numbers settle and which they leave open.
#
# This is software for research, and no medical advice.
#
# The paper gives tables and rules, but some sentences can be understood in two or three ways. It
# also reports averages: 144.3, 139.2 and 133.5 for three policies, over a thousand experiments
# each. Do these numbers tell which reading the authors used? Here we look at the 576 readings with
# one task of three subtasks; the reproduction itself looks at all 6,912.

# %%
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from exact_mdp.analysis.plots import style
from exact_mdp.analysis.readings import ReadingSpace
from exact_mdp.mdp.care.tables import READINGS
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.evidence import contradictions, evidence, joint
from exact_mdp.paper_repro.readings.findings import sentences
from exact_mdp.paper_repro.readings.reported_policy import under_reading
from exact_mdp.paper_repro.readings.search import search
from exact_mdp.paper_repro.reported import STARTS

space = ReadingSpace(options={**READINGS, "tasks": ((3,),), "evaluation_discount": (1,)})
print(len(space), "readings")
options = {name: ", ".join(map(str, options)) for name, options in space.options.items()}
pd.Series(options, name="options").to_frame().style

# %% [markdown]
# ## Every compatible policy under every reading
#
# The text states what the policy does in twelve of the sixteen statuses, in one place ambiguously
# ("or … respectively"). The other four are enumerated. Mean and variance of the return of each of
# these 1,536 policies are computed exactly, under each reading.

# %%
found = search(space=space)
print(f"{found.evaluations:,} exact evaluations, shape {found.mean.shape}")
means = found.mean[0].T  # under the default reading, by what the policy does in 0000
pd.DataFrame(
    {"least": means.min(axis=1), "most": means.max(axis=1), "paper": reported.AVERAGE_RETURN},
    index=pd.Index(STARTS, name="in 0000"),
).round(2)

# %% [markdown]
# ## How likely does a reading make what was reported?
#
# An average of a thousand returns is normal around the exact mean, with the exact variance over a
# thousand. The two numbers that the authors read off a plot (about 70 for random actions, about 140
# after convergence) get a tolerance of 5.

# %%
judged = evidence(found)
rows = []
for number in judged.ranking[:6]:
    completion = int(judged.completion[number])
    rows.append(
        [judged.weights[number], *found.mean[number, completion], found.random_mean[number],
         space.label(int(number))]
    )  # fmt: skip
table = pd.DataFrame(rows, columns=["weight", *STARTS, "random", "reading"])
print("reported:", *reported.AVERAGE_RETURN.values(), "| random about 70")
print(f"as if {judged.effective_number:.1f} readings were equally likely")
table.style.format(precision=3)

# %% [markdown]
# ## A picture
#
# Each dot is a reading, with the policies' unstated actions filled in as fits best. The cross is
# what the paper reports.

# %%
best = found.mean[np.arange(len(space)), judged.completion]
with style():
    figure, ax = plt.subplots(figsize=(6, 4))
    ax.scatter(best[:, 0], found.random_mean, s=6, color="0.55", label="a reading")
    top = judged.ranking[:6]
    ax.scatter(best[top, 0], found.random_mean[top], s=30, color="#0072B2", label="best six")
    ax.plot(reported.AVERAGE_RETURN[STARTS[0]], 70, "x", color="black", ms=9, label="the paper")
    ax.set_xlabel(f"mean return, {STARTS[0]} in 0000")
    ax.set_ylabel("mean return of random actions")
    ax.legend(frameon=False)
    plt.show()

# %% [markdown]
# ## What is identified, what is not
#
# With all other points averaged out, a Bayes factor of 20 is taken as identified and less than 3 as
# not worth mentioning. Statements that no single reading can satisfy are listed as well.

# %%
joints = {judged.experiments: joint(judged)}
print(len(contradictions(joints[judged.experiments])), "sets of statements contradict each other")
findings = [(sentence.kind, sentence.text) for sentence in sentences({"main": judged}, joints)]
pd.DataFrame(findings, columns=["kind", "finding"]).style.hide().set_properties(
    **{"text-align": "left"}
)

# %% [markdown]
# ## A verdict on the reported policy
#
# Under the default reading: its exact value and regret, and what each deviation from the optimum
# costs.

# %%
result = under_reading(found, 0, int(judged.completion[0]))
print(f"value {float(result.value.value):.4f} of {float(result.optimal.value):.4f}")
print(f"regret {float(result.regret.value):.4f} ({result.regret.claim})")
for each in result.ranking:
    print(f"{each.experiments:,} experiments rank as in the paper with chance {each.best:.8f}")
