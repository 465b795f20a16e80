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
# # 9. An ICU in exact numbers
#
# **After this notebook you can** audit a policy for a model that was learned from records: say what
# it is worth exactly, where it loses, and how far training came.
#
# **This is software for research, and no medical advice.** The model is a benchmark. Its authors
# warn that nothing in it should guide medical practice. It holds no patient's data: 716 states are
# clusters of patients, and probabilities are all that is told of them.
#
# ICU-Sepsis (Choudhary, Gupta and Thomas, Reinforcement Learning Conference 2024, arXiv:2406.05646)
# is estimated from MIMIC-III. A state is one of 713 conditions of a patient with sepsis, death,
# survival, or the end. An action is one of five doses of fluids and one of five of vasopressors.
# Survival earns 1, so that a policy's value is the probability that the patient survives.
# `pip install icu-sepsis` brings the model; it is not part of this package.

# %%
import gymnasium
import matplotlib.pyplot as plt
import numba
import numpy as np

from exact_mdp import MDP, Policy, certify, check, evaluate, plots, return_distribution

env = gymnasium.make("icu_sepsis:Sepsis/ICU-Sepsis-v2").unwrapped
mdp = MDP.from_gymnasium(env)
mdp

# %% [markdown]
# ## Survival
#
# Is the optimum right? A proof in rational arithmetic says so: every float of the model counts as
# the number that it stores, and a checker that shares nothing with the solver accepts the proof.

# %%
certificate = certify(mdp)
best = certificate.start_value
print("violations:", certificate.violations())
print("the optimum has", len(str(hex(best.numerator))), "hexadecimal digits over as many:")
print(f"{float(best):.15f}; only one optimal policy: {certificate.unique}")

# %% [markdown]
# The table has the three policies that the paper compares. Its numbers are means of simulated
# episodes, 0.78, 0.78 and 0.88 for survival, and 9.45, 9.22 and 10.99 for the length of an episode.
# These are exact up to the error given.

# %%
expert = Policy.of(mdp, env.expert_policy, kind="policy")
policies = {"random": "random", "expert": expert, "optimal": certificate.policy}
found = {name: evaluate(mdp, policy) for name, policy in policies.items()}
for name, each in found.items():
    print(f"{name:8} survival {each.start}, length {each.steps:.6f}")

# %% [markdown]
# What clinicians did, on average, is worth hardly more than chance *in this model*; the optimum
# would save 9 in 100 more. A model that was estimated from few records flatters its own optimum, so
# that the last number is no promise: `MDP.from_transitions` keeps the counts of one's own records.
#
# ## The length of a stay
#
# A model that earns 1 for each step has the length as its return. Steps are of four hours, those of
# the records behind it (Komorowski et al., Nature Medicine 24, 2018).

# %%
length = MDP.from_pairs(
    mdp.pair_state,
    mdp.pair_action,
    mdp.transition,
    np.where(mdp.terminal[mdp.pair_state], 0, 1),
    start=mdp.start_distribution,
)
stays = {name: return_distribution(length, policy) for name, policy in policies.items()}

with plots.style():
    ax = plt.subplots(figsize=(6, 3.2))[1]
    for (name, stay), line in zip(stays.items(), (":", "--", "-"), strict=True):
        days = np.array(stay.values, dtype=float) / 6
        ax.plot(days, stay.probabilities, line, label=f"{name}: mean {stay.mean / 6:.2f} days")
    ax.set(xlim=(0, 8), xlabel="length of the stay (days)", ylabel="probability")
    ax.legend()

# %% [markdown]
# The environment stops after 500 steps. Does that matter? No: hardly any stay is as long.

# %%
for name, stay in stays.items():
    longer = stay.probabilities[np.array(stay.values, dtype=float) > 100].sum()
    assert abs(stay.mean - found[name].steps) < 1e-6  # two ways to the same number
    print(f"{name:8} a stay of more than 100 steps has probability {longer:.1e}")

# %% [markdown]
# ## What the rule of admissible actions costs
#
# Where an action was seen fewer than 20 times in a state, the model does not know what it does. The
# environment then does what the mean of the others would, which is never better than the best of
# them. So the rule costs the optimum nothing. The two proofs differ all the same, in the sixteenth
# digit: the means are stored as floats, and where a state has one good action, a mean that was
# rounded upwards is the better by that much.

# %%
strict = gymnasium.make(
    "icu_sepsis:Sepsis/ICU-Sepsis-v2", inadmissible_action_strategy="raise_exception"
).unwrapped
admissible = MDP.from_gymnasium(strict)
offered = np.diff(admissible.pair_offsets)[~admissible.terminal]
difference = best - certify(admissible).start_value
print(f"the optimum without them is lower by {float(difference):.1e}")
print("states with one action:", int((offered == 1).sum()), "of", len(offered))

# %% [markdown]
# The rule matters for whoever chooses at random, and it decides what there is to gain. If a
# forbidden action were death, as another setting of the environment has it, chance would do worse.
# And if only those actions were allowed that clinicians took in a given share of the cases, how
# much of the gain would be left?

# %%
tables = env.dynamics
deadly = tables["tx_mat"].copy()
for state, actions in enumerate(tables["admissible_actions"]):
    deadly[state, np.setdiff1d(np.arange(25), actions)] = np.eye(716)[713]
lethal = MDP.from_arrays(deadly, tables["r_mat"], start=tables["d_0"], layout="sas")
print(f"random, where forbidden actions kill: {evaluate(lethal, 'random').mean:.4f}")


def allowing(share):
    """The admissible model with the actions that clinicians took in this share of the cases."""
    taken = env.expert_policy[admissible.pair_state, admissible.pair_action]
    keep = (taken >= share) | admissible.terminal[admissible.pair_state]
    most = np.maximum.reduceat(taken, admissible.pair_offsets[:-1])
    keep |= taken == most[admissible.pair_state]  # something has to be done
    return MDP.from_pairs(
        admissible.pair_state[keep],
        admissible.pair_action[keep],
        admissible.transition[keep],
        admissible.reward[keep],
        start=admissible.start_distribution,
    )


shares = [0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 1]
left = [evaluate(allowing(share), "optimal").mean for share in shares]

with plots.style():
    ax = plt.subplots(figsize=(6, 3.2))[1]
    ax.plot(shares, left, "o-", label="best policy")
    ax.axhline(found["expert"].mean, linestyle="--", color="black", label="expert")
    ax.set(
        xlabel="least share of the cases in which clinicians took an action",
        ylabel="probability of survival",
    )
    ax.legend()

# %% [markdown]
# ## How far Q-learning comes
#
# The authors train for 500,000 episodes. Exploration falls from 1 to 0.001 over the first tenth;
# only admissible actions are taken, and the table is stepped by Adam at a rate of 0.0025
# (`icu-sepsis_experiments`, `qlearning.json`). Adam goes on moving an entry for a while after its
# last visit. Below, these moves are added up in closed form when the entry is read again. After
# 3,000 episodes the tables differ by 0.6 % (root mean square) from those of Adam step by step,
# because of its bias correction, which fades.

# %%
RATE, DECAY, SQUARES = 0.0025, 0.9, 0.999
SHRINK = DECAY / np.sqrt(SQUARES)


@numba.njit
def drawn(chances, number):  # the first place whose cumulative chance is above a number
    low, high = 0, len(chances) - 1
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if chances[middle] > number else (middle + 1, high)
    return low


@numba.njit
def settled(table, actions, count, state, step):  # pays what Adam owes; the best action's place
    q, mean, square, moved = table
    best, highest = 0, -np.inf
    for i in range(count[state]):
        a = actions[state, i]
        owed = step - moved[state, a]
        if owed and square[state, a] > 0:
            total = SHRINK * (1 - SHRINK**owed) / (1 - SHRINK)
            size = np.sqrt(square[state, a] / (1 - SQUARES ** (moved[state, a] + 1))) + 1e-8
            q[state, a] -= RATE * total * mean[state, a] / size
            mean[state, a] *= DECAY**owed
            square[state, a] *= SQUARES**owed
        moved[state, a] = step
        if q[state, a] > highest:
            best, highest = i, q[state, a]
    return best, highest


@numba.njit
def train(chances, start, actions, count, episodes, parts, rng):
    table, step = np.zeros((4, *actions.shape)), 0
    q_tables, survived = np.zeros((parts, *actions.shape)), np.zeros(parts)
    for episode in range(episodes):
        part = episode * parts // episodes
        epsilon = max(0.001, 1 - 9.99 * episode / episodes)
        state = drawn(start, rng.random())
        while state < 713:
            place = settled(table, actions, count, state, step)[0]
            if rng.random() < epsilon:
                place = rng.integers(0, count[state])
            action = actions[state, place]
            after = drawn(chances[state, action], rng.random())
            aim = 1.0 if after == 714 else 0.0
            if after < 713:
                aim = settled(table, actions, count, after, step)[1]
            slope = 2 * (table[0, state, action] - aim)  # of the squared error
            table[1, state, action] += (1 - DECAY) / DECAY * slope
            table[2, state, action] += (1 - SQUARES) / SQUARES * slope**2
            state, step = after, step + 1
        survived[part] += state == 714
        if (episode + 1) * parts % episodes == 0:
            for each in range(713):
                settled(table, actions, count, each, step)
            q_tables[part] = table[0]
    return q_tables, survived * parts / episodes


count = np.array([len(each) for each in tables["admissible_actions"]])
actions = np.array([np.resize(each, 25) for each in tables["admissible_actions"]])
chances = np.cumsum(tables["tx_mat"], axis=2)
setting = (chances, np.cumsum(tables["d_0"]), actions, count)
q_tables, sampled = train(*setting, 500_000, 50, np.random.default_rng(0))

# %% [markdown]
# The dots are what the learner saw: the share of its training episodes that ended in survival. The
# line is the exact survival under the greedy policy of that moment.

# %%
allowed = np.zeros((716, 25), dtype=bool)
allowed[admissible.pair_state, admissible.pair_action] = True
greedy = np.where(allowed, q_tables, -np.inf).argmax(axis=2)
exact = [evaluate(mdp, policy).mean for policy in greedy]

with plots.style():
    ax = plt.subplots(figsize=(6, 3.6))[1]
    at = np.arange(1, 51) * 10
    ax.plot(at, sampled, "o", markersize=3, color="grey", label="training episodes (sampled)")
    ax.plot(at, exact, "-", label="greedy policy (exact)")
    for name, line in {"optimal": "-", "expert": "--", "random": ":"}.items():
        ax.axhline(found[name].mean, color="black", linestyle=line, linewidth=1, label=name)
    ax.set(xlabel="thousand episodes", ylabel="probability of survival")
    ax.legend(loc="lower right", bbox_to_anchor=(1, 0.15), fontsize=7)

# %% [markdown]
# The curve is flat long before its end, and still well below the optimum. `check` is the verdict:
# the exact regret, and how much of it each state causes.

# %%
audit = check(mdp, greedy[-1], max_regret="1/100")
print(audit.verdicts[0].told)
audit.frame(full=True).head(5)[["label", "learned", "optimal", "expected_visits", "cost", "share"]]

# %% [markdown]
# On the command line, for a policy or Q-table in a file:
#
# ```
# exact-mdp solve gymnasium:icu_sepsis:Sepsis/ICU-Sepsis-v2 --certify
# exact-mdp check gymnasium:icu_sepsis:Sepsis/ICU-Sepsis-v2 q_table.npy --max-regret 1/100
# ```
#
# One seed says little of a trainer. `check_trainer` audits many seeds, and stops as soon as it is
# known what share of them keeps the limit.
#
# ## Which states decide
#
# The regret of a policy is the sum over states of visits times what is lost there. So a share of
# the states, the costliest first, explains a share of the regret.

# %%
by_expert = check(mdp, expert)

with plots.style():
    ax = plt.subplots(figsize=(6, 3.2))[1]
    for (name, each), line in zip(
        {"expert": by_expert, "Q-learning": audit}.items(), "-:", strict=True
    ):
        share = each.frame()["share"].cumsum()
        half = int((share < 0.5).sum()) + 1
        ax.plot(np.arange(1, len(share) + 1), share, line, label=f"{name}: half in {half} states")
    ax.set(xlabel="states, the costliest first", ylabel="share of the regret", ylim=(0, 1.02))
    ax.legend()

# %% [markdown]
# Are these the sickest patients? Each state has a mean SOFA score, from 0 (well) to 24.

# %%
listed = by_expert.frame()
scores = env.sofa_scores[listed.index]
order = np.argsort(scores)
weights = listed["share"].to_numpy()[order]
middle = scores[order][np.searchsorted(weights.cumsum(), 0.5)]
print(f"half of the expert's regret lies in states with a SOFA score of at most {middle:.1f};")
visited = by_expert.visits[:713]
spread = np.argsort(env.sofa_scores[:713])
share = visited[spread].cumsum() / visited.sum()
half = env.sofa_scores[:713][spread][np.searchsorted(share, 0.5)]
print(f"half of its steps, in states with one of at most {half:.1f}")

# %% [markdown]
# All of this is exact, and all of it is about the model. What its numbers are worth depends on the
# records behind them: research software, no medical advice.
