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
# # 2. Six solvers and a certificate
#
# **After this notebook you can** solve a model in six ways, read the error bound that comes with
# each answer, and obtain a proof of the optimum that someone else can check without trusting any
# solver.

# %%
import tempfile
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd

from exact_mdp import MDP, SOLVERS, Certificate, Scenario, certify, evaluate, plots, solve

scenario = Scenario.load("yuan2025")
mdp = scenario.compile()

# %% [markdown]
# ## Six ways to the same number
#
# Value iteration, Gauss-Seidel value iteration, modified policy iteration, policy iteration,
# backward induction and a linear program find the answer in different ways, so that their agreement
# means something. Each bound holds for every state, rounding errors included.

# %%
rows = []
for name in SOLVERS:
    solution = solve(mdp, name)
    rows.append((name, solution.start_value, str(solution.claim), solution.error_bound < 1e-6))
table = pd.DataFrame(rows, columns=["solver", "start value", "claim", "bound below 1e-6"])
table.style.format(precision=9)

# %% [markdown]
# ## What to do in each status
#
# The optimal action in all sixteen status vectors, in the first trial of the first subtask. It
# turns out to be the same in every trial and subtask.

# %%
solution = solve(mdp)
with plots.style():
    figure, ax = plt.subplots(figsize=(6.2, 3.8))
    plots.plot_policy(mdp, solution.policy, subtask=0, trial=0, ax=ax)
    plt.show()

# %% [markdown]
# ## A proof instead of a bound
#
# `certify` works in rational arithmetic. What it returns is a certificate: values of all states,
# which satisfy the optimality equation exactly, and a policy that attains them. The checker that
# reads it imports no solver; it goes through the equation row by row.

# %%
certificate = certify(mdp)
value = certificate.start_value
print(f"start value ≈ {float(value):.12f}")
print(f"exactly: {len(str(value.numerator))} digits over {len(str(value.denominator))}")
print("the only optimal policy:", certificate.unique)
print("violations:", certificate.violations())

# %% [markdown]
# A certificate is a file that can be handed on. Whoever has the model can check it; a forged one
# does not pass. Here one digit of one value is changed.

# %%
with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "optimum.json"
    certificate.save(path)
    print("read back:", Certificate.load(path).violations(mdp))

numerator = list(certificate.numerator)
numerator[0] += 1
forged = replace(certificate, numerator=tuple(numerator))
print("forged:", forged.violations(mdp)[0])

# %% [markdown]
# ## Any finite model
#
# The forest of Puterman's book, as it comes with a well-known toolbox: wait for the trees to grow,
# or cut them. The discounted optimum is 26.244, 29.484 and 33.484.

# %%
wait = [["1/10", "9/10", 0], ["1/10", 0, "9/10"], ["1/10", 0, "9/10"]]
cut = [[1, 0, 0]] * 3
forest = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount="9/10")
certify(forest)

# %% [markdown]
# ## Everything about one policy
#
# Evaluation is exact as well: not only the mean, but its spread, the timesteps, and what each part
# of the reward contributes. No episode is simulated.

# %%
found = evaluate(mdp, "random")
print(f"mean {found.mean:.4f}, sd {found.sd:.4f}, {found.steps:.3f} timesteps")
pd.Series(found.components, name="expected total").round(4).to_frame()
