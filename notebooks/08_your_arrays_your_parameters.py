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
# # 8. Your arrays, your parameters
#
# **After this notebook you can** bring a model as NumPy arrays, name the numbers in it that you are
# unsure of, and ask which of them matter, where the best action changes, and what a policy loses
# when they move.
#
# The model is a machine that wears out: it is new, used or worn. Run it, or overhaul it. The
# numbers are made up.

# %%
import numpy as np

from exact_mdp import (
    MDP,
    Family,
    Parameter,
    certify,
    explore,
    gradient,
    moving,
    plots,
    solve,
    thresholds,
    tornado,
)

run = np.array([[0.7, 0.3, 0.0], [0.0, 0.6, 0.4], [0.0, 0.0, 1.0]])
overhaul = np.array([[1.0, 0.0, 0.0]] * 3)
rewards = np.array([[10.0, -4.0], [8.0, -4.0], [3.0, -4.0]])  # (state, action)
names = {"states": ["new", "used", "worn"], "actions": ["run", "overhaul"]}
mdp = MDP.from_arrays([run, overhaul], rewards, discount=0.9, **names)
solve(mdp)

# %% [markdown]
# Floats are taken as the numbers that they store. Write `"7/10"` or a `Fraction` where you mean it
# exactly, and the whole analysis is exact in what you meant.

# %%
run = [["7/10", "3/10", 0], [0, "6/10", "4/10"], [0, 0, 1]]
mdp = MDP.from_arrays([run, overhaul.astype(int)], rewards.astype(int), discount="9/10", **names)
certificate = certify(mdp)
print([str(value) for value in certificate.value], certificate.violations())
certificate

# %% [markdown]
# ## Name the numbers that you are unsure of
#
# `moving` turns entries of the matrix and rewards into parameters: an entry is (pair, next state).
# When an entry moves, the other outcomes of its row keep their proportions and make room.

# %%
wears, breaks = mdp.pair(0, 0), mdp.pair(1, 0)  # (new, run), (used, run)
model = moving(mdp, {"wear": [(wears, 1)], "break": [(breaks, 2)]}, {"overhaul": -4, "worn": 3})
gradient(model)

# %% [markdown]
# How much moves the value most when each number is off by a fifth?

# %%
with plots.style():
    tornado(model).plot()

# %% [markdown]
# ## Where does the best action change?
#
# Every value at which it does, within the range, certified on both sides.

# %%
thresholds(model, "overhaul", (-30, 0))

# %%
with plots.style():
    thresholds(model, "overhaul", (-30, 0)).plot()

# %% [markdown]
# Two parameters on one page: the price of an overhaul moves freely, the chance of breaking in
# steps. The second line is the policy that is optimal today, held fixed.

# %%
explore(
    model,
    "overhaul",
    "break",
    ranges={"overhaul": (-30, 0), "break": ("1/10", "9/10")},
    policy=certificate,
)

# %% [markdown]
# ## A parameter of your own making
#
# A number may stand behind several entries. Then write the model as a function of it: a `Family`
# builds the model from its parameters, here one age that makes both kinds of wear likelier. That
# the rows are polynomials of the parameter is checked at points, and the result says so.

# %%


def build(at):
    wear, worse = at["age"] / 10, at["age"] / 5
    run = [[1 - wear, wear, 0], [0, 1 - worse, worse], [0, 0, 1]]
    return MDP.from_arrays([run, [[1, 0, 0]] * 3], rewards.astype(int), discount="9/10", **names)


age = Parameter(name="age", value=2, low=0, high=5)
family = Family(parameters=(age,), build=build, name="machine")
found = thresholds(family, "age", (0, 5))
print(found.claim)
found

# %% [markdown]
# How the optimal value falls with age, as an exact function with a kink at each switching point:

# %%
explore(family, "age", ranges={"age": (0, 5)})
