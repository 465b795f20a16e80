"""Section 4.2, the two agents together: consequences of the decision model, and open claims.

The paper gives no transcript in full. Claims that rest on the wording of its authors' language
model, or on people's judgement, stay undetermined. The action that is optimal in the decision model
is computed and stated with them, and so is the cost of errors of perception.
"""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from exact_mdp import Policy, evaluate
from exact_mdp.mdp.care.perception import independent, perceived
from exact_mdp.paper_repro.agents.log import clean_text
from exact_mdp.paper_repro.agents.scripted import Scripted
from exact_mdp.paper_repro.agents.simulate import build_conversation
from exact_mdp.paper_repro.claim import Finding, judge_statement, judge_undecided, register_claim
from exact_mdp.paper_repro.compiled import compute_losses, list_optimal_actions
from exact_mdp.paper_repro.paper import ANGRY
from exact_mdp.paper_repro.silent_points import Reading


def value_as_perceived(reading: Reading, confusion: np.ndarray) -> float:
    """Return the value of the optimal policy if it acts on a perceived status."""
    policy = perceived(reading.mdp, Policy.of(reading.mdp, reading.optimum), confusion)
    return float(evaluate(reading.mdp, policy).mean)


@register_claim("agents.saved-as-text", "Section 4.2", "Figure 11", kind="input")
def saved_as_text(reading: Reading) -> Finding:
    """State, behaviour, action and assistance of each timestep are saved in a text file."""
    with TemporaryDirectory() as folder:
        record = build_conversation(Scripted(), seed=0).hold(Path(folder) / "talk", limit=3)
        text = (Path(folder) / "talk" / "conversation.txt").read_text("utf-8")
    parts = []
    for step in record.steps:
        parts += [step["status"], clean_text(step["behaviour"]["nonverbal"])]
        parts += [step["action"], clean_text(step["assistance"])]
    return judge_statement(
        bool(parts) and all(part in text for part in parts),
        "conversation.txt holds them, conversation.jsonl everything behind them",
    )


@register_claim("agents.behaviour-fits-status", "Section 4.2", "Figure 12", rule="open")
def behaviour_fits_status(reading: Reading) -> Finding:
    """Behaviour is realistic and fits the status (cooperative in 0000, withdrawn in 0001)."""
    return judge_undecided(
        "needs the authors' model. The scripted agent fits by construction, which shows nothing "
        "about a language model; `python -m exact_mdp.paper_repro.agents measure` counts for any "
        "endpoint how often a status can be read back out of the behaviour"
    )


@register_claim("agents.four-prompts-alike", "Section 4.2", "Figure 7", "Figure 8", rule="open")
def four_prompts_alike(reading: Reading) -> Finding:
    """The four prompts of action execution make no marked difference."""
    return judge_undecided(
        "needs the authors' model. `python -m exact_mdp.paper_repro.agents run --variant` takes "
        "each of them with any endpoint; in the decision model the wording changes nothing"
    )


@register_claim("agents.question-taken-for-forgetfulness", "Section 4.2", "Figure 11", rule="open")
def question_taken_for_forgetfulness(reading: Reading) -> Finding:
    """A question about what comes next is taken for forgetfulness."""
    confusion = np.eye(16)
    confusion[0b0000] = np.eye(16)[0b1000]
    cost = value_as_perceived(reading, confusion)
    return judge_undecided(
        f"one example of the authors' model. If 0000 were always read as 1000, and all else "
        f"rightly, the optimal policy would earn {cost:.1f} instead of "
        f"{reading.evaluate_policy('optimal').mean:.1f}"
    )


@register_claim("agents.confusion-supported", "Section 4.2", "Figure 12", rule="open")
def confusion_supported(reading: Reading) -> Finding:
    """Confusion is met with supportive assistance."""
    lost = compute_losses(reading, "0100", 1)
    return judge_undecided(
        "needs the authors' model: one example is told, and not what the robot perceived in it. In "
        "the decision model, where confusion is the only status, supportive assistance is optimal "
        f"in {sum(x == 0 for x in lost)} of {len(lost)} states; taken once in one of them it costs "
        f"{float(min(lost)):.1f} to {float(max(lost)):.1f} points from there on (the figure of "
        "costs counts from the start, with the action taken every time)"
    )


@register_claim("agents.anger-encouraged", "Section 4.2", "Section 4.1", rule="open")
def anger_encouraged(reading: Reading) -> Finding:
    """An angry person is met with encouragement."""
    best = []
    for status in ANGRY:
        best.extend(list_optimal_actions(reading, status))
    right = sum("supportive" in actions for actions in best)
    return judge_undecided(
        "needs the authors' model: one example is told. In the decision model supportive "
        f"assistance is optimal in {right} of {len(best)} states with anger, as `policy.anger` says"
    )


@register_claim("agents.perception-errors", "Section 4.2", rule="open")
def perception_errors(reading: Reading) -> Finding:
    """Despite errors of perception the robot goes on to help effectively."""
    rates, values = [], []
    for rate in (0.99, 0.95, 0.9, 0.8):  # of perception, status by status
        rates.append(f"{rate:.0%}")
        values.append(f"{value_as_perceived(reading, independent([rate] * 4, [rate] * 4)):.1f}")
    return judge_undecided(
        "how often the authors' model errs is not reported. The optimal policy earns "
        f"{reading.evaluate_policy('optimal').mean:.1f} with perfect perception; if each status is "
        f"perceived rightly in {', '.join(rates)} of cases, it earns {', '.join(values)}. Random "
        f"actions earn {reading.evaluate_policy('random').mean:.1f}"
    )


@register_claim("agents.answers-empathetic", "Section 4.2", "Figure 12", rule="open")
def answers_empathetic(reading: Reading) -> Finding:
    """Answers to confusion and anger are empathetic and in place."""
    return judge_undecided(
        "needs people to judge: it is the authors' own observation, by their own account without "
        "formal evaluation"
    )
