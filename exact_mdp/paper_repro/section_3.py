"""Section 3, the agent Robot Caregiver: states, actions, rewards (Equation 1, Table 4), and the
settings of learning (Equation 2). Rewards are read from the compiled rows, as exact rationals.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from exact_mdp import Certified
from exact_mdp.analysis.learning.curves import EXPERIMENTS as EXPERIMENTS_OF_A_POINT
from exact_mdp.analysis.learning.outcomes import CANDIDATES
from exact_mdp.paper_repro.claim import Finding, compare_entries, judge_statement, register_claim
from exact_mdp.paper_repro.compiled import (
    derive_weights,
    list_optimal_actions,
    list_rewards,
)
from exact_mdp.paper_repro.paper import ACTIONS, BITS, SETTINGS, STATUSES, TABLE_4
from exact_mdp.paper_repro.silent_points import Reading, change_settings

CHARGED = ("forget", "confuse", "anger", "disengaged")  # the weight of each status, in order

# ---- states and actions --------------------------------------------------------------------------


@register_claim("states", "Section 3.2.1", kind="input")
def statuses_make_states(reading: Reading) -> Finding:
    """Four binary statuses make 16 states; an episode starts with none present and ends when every
    subtask is completed or skipped.
    """
    mdp, trials = reading.mdp, reading.scenario.trials
    statuses = len(set(mdp.space.values("status")[~mdp.terminal].tolist()))
    start = [mdp.space.label(state) for state, _ in mdp.start]
    ends = [mdp.space.label(state) for state in np.flatnonzero(mdp.terminal).tolist()]
    place = mdp.space.values("subtask") * (trials + 1) + mdp.space.values("trial")
    place[mdp.terminal] = longest = sum(reading.scenario.tasks) * (trials + 1)
    leads = mdp.transition.tocoo()
    onwards = bool(
        (place[leads.col] > place[mdp.pair_state[leads.row]])[
            ~mdp.terminal[mdp.pair_state[leads.row]]
        ].all()
    )
    return judge_statement(
        statuses == 16 and len(ends) == 1 and "status 0000" in start[0] and onwards,
        f"{statuses} statuses; the start is {start[0]}; every timestep leads to a later trial or "
        f"subtask, so that the only terminal state, “{ends[0]}”, is reached within {longest}",
    )


@register_claim("policy.status-suffices", "Section 3.2.1", kind="input", open=True)
def status_suffices(reading: Reading) -> Finding:
    """A policy may read the 16 statuses alone, without the trial or the subtask."""
    lacking = [s for s in STATUSES if not set.intersection(*list_optimal_actions(reading, s))]
    why = "in every status one action is optimal in all subtasks and trials"
    if lacking:
        why = f"no action is optimal throughout in {', '.join(lacking)}"
    return judge_statement(not lacking, why)


@register_claim("actions.max-trial", "Section 3.2.2", "Section 2.1", kind="input", open=True)
def max_trial(reading: Reading) -> Finding:
    """A subtask is skipped after 5 failed trials (MaxTrial)."""
    mdp, paper = reading.mdp, SETTINGS["max_trial"]
    trials = int(mdp.space.values("trial")[~mdp.forced & ~mdp.terminal].max()) + 1
    why = f"a subtask is skipped on failed trial {trials}"
    number, number_is = Certified(value=Fraction(trials)), "failed trials"
    return judge_statement(
        trials == paper, why, paper=Fraction(paper), number=number, number_is=number_is
    )


# ---- rewards -------------------------------------------------------------------------------------


@register_claim("equation1", "Equation 1", "Section 3.2.3", kind="input")
def equation_1(reading: Reading) -> Finding:
    """The immediate reward is the weighted sum of statuses, trial, completion, assistance, timestep
    and task completion.
    """
    last = (np.cumsum(reading.scenario.tasks) - 1).tolist()
    wrong, outcomes = 0, list_rewards(reading)
    for action, after, subtask, done, gain in outcomes:
        present = zip(CHARGED, BITS.values(), strict=True)
        total = sum(TABLE_4[weight] for weight, bit in present if after & bit)
        total += TABLE_4["trial"] + TABLE_4["timestep"]
        if done:
            total += TABLE_4["subtask-complete"] + TABLE_4[f"assist.{ACTIONS[action]}"]
            total += TABLE_4["task-complete"] if subtask in last else 0
        wrong += gain != total
    why = f"{len(outcomes) - wrong:,} of {len(outcomes):,} outcomes earn what the equation gives"
    return judge_statement(wrong == 0, why)


@register_claim("table4", "Table 4", kind="input", rule="entries")
def table_4(reading: Reading) -> Finding:
    """The reward has the thirteen weights of the table."""
    paper = {name: Fraction(weight) for name, weight in TABLE_4.items()}
    return compare_entries(
        paper, derive_weights(reading), ", each a difference of rewards in compiled rows"
    )


@register_claim("prose.weights", "Section 3.2.3", kind="input")
def weights_in_words(reading: Reading) -> Finding:
    """Anger is charged most of the four statuses, and completing a subtask costs more, the more
    intrusive the assistance.
    """
    values = derive_weights(reading)
    anger, others = values["anger"], [values[name] for name in CHARGED if name != "anger"]
    assist = [values[f"assist.{name}"] for name in ACTIONS]
    return judge_statement(
        anger < min(others) and assist == sorted(set(assist), reverse=True),
        f"anger {anger}, the others {', '.join(map(str, others))}; a0 to a3 "
        f"{', '.join(map(str, assist))}",
    )


# ---- learning ------------------------------------------------------------------------------------


@register_claim("training.settings", "Section 3.2.4", "Section 3.2.5", kind="input", rule="entries")
def training_settings(reading: Reading) -> Finding:
    """Q-learning has rate 0.05, discount 0.95, 6,000 epochs of 30 episodes, ε = 0.1; each epoch's
    policy is that of its 10th episode, a point of a curve is the average of 40 experiments, and the
    final policy is chosen among the five suggested most often.
    """
    code = change_settings("constant", reading.training)
    settings = {
        "rate": code.rate.values(1)[0],
        "discount": code.discount,
        "epochs": code.epochs,
        "episodes": code.episodes,
        "constant_epsilon": code.exploration.values(1)[0],
        "snapshot_episode": code.snapshot_episode,
        "experiments_of_a_point": EXPERIMENTS_OF_A_POINT,
        "candidates": CANDIDATES,
    }
    model = {name: Fraction(str(value)) for name, value in settings.items()}
    return compare_entries({name: Fraction(str(SETTINGS[name])) for name in model}, model)


@register_claim("equation2", "Equation 2", kind="input")
def equation_2(reading: Reading) -> Finding:
    """The decaying ε is 1 at epoch 0 and 0.8 at epoch 300, and comes down to 0.03."""
    code = change_settings("decaying", reading.training)
    values, far = code.exploration.values(code.epochs), code.exploration.values(100_000)[-1]
    wanted = {int(epoch): float(value) for epoch, value in SETTINGS["epsilon_at"].items()}
    least = float(Fraction(SETTINGS["epsilon_minimum"]))
    close = all(abs(values[epoch] - value) <= 1e-12 for epoch, value in wanted.items())
    return judge_statement(
        close and abs(far - least) <= 1e-12,
        ", ".join(f"ε({epoch}) = {values[epoch]:.12g}" for epoch in wanted)
        + f", ε({code.epochs - 1:,}) = {values[-1]:.4f}, in the limit {far:.12g}",
    )
