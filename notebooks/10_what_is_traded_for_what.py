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
# # 10. What is traded for what
#
# **After this notebook you can** say what one aim costs in terms of another, hold a policy to
# limits, give its value as a function of a number that you are unsure of, and weigh the mean
# against the worst episodes. All of it is exact, and carries a proof.
#
# This is software for research, and no medical advice.
#
# The care model adds up what it wants: completed subtasks earn 50 points each, a moment of anger
# costs 5. The sum of these weights hides a choice. Who would take fewer completed subtasks for less
# anger, and how many?

# %%
import matplotlib.pyplot as plt

from exact_mdp import (
    QLearning,
    Scenario,
    check,
    curve,
    mean_cvar,
    plots,
    rationalize,
    solve,
    tradeoff,
    train,
)

scenario = Scenario.load("yuan2025")
care = scenario.compile()
care.component_names

# %% [markdown]
# ## The front of two totals
#
# Every policy has an expected total of anger and one of completed subtasks. The front has those
# that no other policy beats in both. Its vertices are deterministic policies; between two vertices
# lie mixtures of theirs. The totals are fractions of hundreds of digits, shown here as decimals.

# %%
front = tradeoff(care, ["anger", "subtask-complete"])
front.frame().astype(float).round(3).iloc[::9]

# %% [markdown]
# `rate` is the exchange rate on the way from the vertex before: how many points of completed
# subtasks a point less of anger costs there. The first ones are cheap, the last ones dear. The
# front is checked by code that knows no solver.

# %%
print(front, front.violations())
edge = front.edges[-1]
print(f"the last point costs {float(edge.rate):.1f} points: {float(edge.rate) / 50:.2f} subtasks")

# %% [markdown]
# Where do policies stand? Three Q-learners, stopped early, beside the optimum. The distance says by
# how much both totals could be better at once.

# %%
runs = train(care, QLearning(epochs=100), 3, rng=0)
learned = {f"learned, run {number}": run for number, run in enumerate(runs)}
with plots.style():
    ax = front.plot(policies={"optimal": "optimal", **learned})

# %% [markdown]
# Other totals work alike: `steps`, the event `skip`, or a sum, `name=2*a-b`. Help is given in three
# ways, each of which has its cost.

# %%
help_ = "help=assist.supportive+assist.non-directive+assist.directive"
effort = tradeoff(scenario.with_(tasks=[1]), [help_, "subtask-complete"])
with plots.style():
    ax = effort.plot(policies={"optimal": "optimal", "random": "random"})

# %% [markdown]
# ## A limit
#
# The optimum has 1.2 points of anger. Hold it to half a point:

# %%
free = solve(care, subject_to={"anger": ">= -100"})
held = solve(care, subject_to={"anger": ">= -1/2"})
print(f"{float(free.start_value):.1f} without, {float(held.start_value):.1f} with the limit")
held.frame().astype({"total": float, "price": float})

# %% [markdown]
# The price says what one more point of anger would gain. The best policy has to draw its action, in
# as many states as limits bind:

# %%
for state, chances in held.randomises.items():
    print(care.space.label(state), {name: round(float(p), 4) for name, p in chances.items()})

# %% [markdown]
# Limits may be too much. Then that is proven, with the closest ones that can be kept.

# %%
none = solve(care, subject_to={"anger": ">= -1/2", "skip": "<= 1/2"})
print(none.feasible, {name: round(float(value), 4) for name, value in none.closest.items()})

# %% [markdown]
# ## A learned policy has to keep the limits too
#
# `check` compares with the best policy that keeps the limits. A policy that earns more by breaking
# them fails.

# %%
for name, policy in {"the optimum": "optimal", "the best that keeps it": held.policy}.items():
    audit = check(care, policy, subject_to={"anger": ">= -1/2"})
    print(f"{name}: {'passed' if audit.passed else 'failed'}")
    print(*(f"  {verdict.told}" for verdict in audit.verdicts), sep="\n")

# %% [markdown]
# ## Which weights make a policy right?
#
# The other way round: by how much must the weights be changed before "always clear instruction"
# were optimal? For one task of one subtask:

# %%
small = scenario.with_(tasks=[1], max_trial=3)
asked = rationalize(small, "always:directive")
print(f"each weight by up to {float(asked.change):.1%}")
asked.frame().head()

# %% [markdown]
# ## The value as a function
#
# The chance that anger sets in by itself is a judgement, 0.05. Over a range of it the optimal value
# is a function in pieces, ratios of polynomials with exact coefficients, each with its policy;
# today's policy, held fixed, falls behind.

# %%
curve = curve(scenario, "base.anger", (0, "1/2"), policy="optimal")
print(curve, curve.violations())
with plots.style():
    figure, ax = plt.subplots()
    curve.plot(ax=ax)

# %% [markdown]
# For which chances is today's policy within 1 % of the best? The ends are algebraic numbers, in
# proven intervals.

# %%
for interval in curve.within(max_relative_regret="1/100"):
    print(f"from {float(interval.low[0]):.6f} to {float(interval.high[1]):.6f}")

# %% [markdown]
# ## Risk
#
# A mean hides bad episodes. How well can the worst tenth of them go, and at what mean? Policies
# that look at the risk remember the reward so far; they too are found exactly. Here nothing is
# traded: the optimum for the mean is the best for the worst tenth as well, which is proven.

# %%
risk = mean_cvar(small, "1/10", policies={"optimal for the mean": "optimal", "random": "random"})
with plots.style():
    ax = risk.plot()
risk.frame()

# %% [markdown]
# From the command line:
#
# ```
# exact-mdp tradeoff yuan2025 anger subtask-complete --policy q_table.npy
# exact-mdp solve yuan2025 --subject-to "anger >= -1/2"
# exact-mdp check yuan2025 q_table.npy --subject-to "anger >= -1/2" --max-regret 1
# exact-mdp curve yuan2025 --parameter base.anger --policy optimal
# exact-mdp risk yuan2025 --cvar 1/10 --policy q_table.npy
# ```
