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
# # 7. Your Q-table on FrozenLake
#
# **After this notebook you can** hand over a Q-table that you trained in a Gymnasium environment
# and learn exactly where its policy is wrong, what each mistake costs, and whether it matters.
#
# The learner below is yours: twenty lines of plain Q-learning, which know nothing of this package.

# %%
import gymnasium
import numpy as np

from exact_mdp import MDP, check, evaluate, explore, plots, solve


def q_learning(env, episodes, discount, rng):
    table = np.zeros((env.observation_space.n, env.action_space.n))
    for episode in range(episodes):
        state, over = env.reset(seed=episode)[0], False
        while not over:
            greedy = int(table[state].argmax())
            explores = rng.random() < 0.2 or table[state].max() == 0
            action = int(rng.integers(4)) if explores else greedy
            after, reward, ended, cut, _ = env.step(action)
            aim = reward + (0 if ended else discount * table[after].max())
            table[state, action] += 0.1 * (aim - table[state, action])
            state, over = after, ended or cut
    return table


env = gymnasium.make("FrozenLake-v1")
q_table = q_learning(env, 1500, 0.95, np.random.default_rng(1))

# %% [markdown]
# ## Five lines to a verdict
#
# The environment's own table of probabilities becomes an explicit model. `check` compares the
# greedy policy of the Q-table with the exact optimum.

# %%
mdp = MDP.from_gymnasium("FrozenLake-v1", discount=0.95)
audit = check(mdp, q_table, kind="q")
print("passed:", audit.passed)
print("optimal value:", audit.regret.optimal)
print("yours:        ", audit.regret.learned)

# %% [markdown]
# Where is it wrong? One row for each state in which your action is not optimal: how often your
# policy comes there, and what it loses there. The costly ones come first.

# %%
audit.frame()

# %%
with plots.style():
    audit.plot(shape=(4, 4))

# %% [markdown]
# The same from the command line, with a page that can be handed on:
#
# ```
# exact-mdp check gymnasium:FrozenLake-v1 q_table.npy --discount 0.95 --kind q --html audit.html
# ```
#
# ## Does it matter?
#
# A discount of 0.95 is the learner's. In the environment itself an episode ends after 100 steps,
# and what counts is the chance to arrive: the values of `within(100)`.

# %%
episodes = MDP.from_gymnasium("FrozenLake-v1", discount=1).within(100)
for name, policy in {"your Q-table": q_table, "random": "random", "optimal": "optimal"}.items():
    print(f"{name:14} reaches the goal with probability {evaluate(episodes, policy).mean:.4f}")

# %% [markdown]
# The best policy for 100 steps depends on the time that is left. How much of its value needs that?

# %%
timeless = solve(mdp).policy
print(f"the best policy at discount 0.95 arrives with {evaluate(episodes, timeless).mean:.4f}")

# %% [markdown]
# ## How does the regret move with the discount?
#
# Move the slider, or type a value such as 0.97 or 1/2. Every number is exact.

# %%
explore(mdp, "discount", ranges={"discount": ("1/2", "99/100")}, policy=audit.chain.policy)
