"""What Section 4.2 of the paper claims of the two agents, and which of it can be checked here.

Four answers: claims about the decision model alone, which are computed and decided; claims whose
cost in the decision model is computed, while whether they hold rests on records that the paper does
not give; claims about the wording of the authors' model, which cannot be checked without that model
or its records; and claims that need people to judge. Yuan et al. (2025) give no transcript in full.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np

from exact_mdp.mdp.care.perception import perceived
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.solvers.proof.certify import certify
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.evaluate import evaluate

EXACT, MODEL, PEOPLE = "decided here", "needs the authors' model", "needs people to judge"
PARTLY = "needs the authors' records; its cost is computed here"


@dataclass(frozen=True, kw_only=True)
class Statement:
    """One claim, in our words: what it says, who can check it, and what was found."""

    claim: str
    place: str
    kind: str
    found: str


def statements(levels: tuple[float, ...] = (0.99, 0.95, 0.9, 0.8)) -> list[Statement]:
    """Return the claims of Section 4.2, those about the decision model computed exactly.

    Parameters
    ----------
    levels : accuracies of perception per status for which the optimal policy is evaluated
    """
    scenario = Scenario.load("yuan2025")
    mdp = scenario.compile()
    policy = Policy.from_choices(mdp, solve(mdp).policy)
    best, random = evaluate(mdp, policy).mean, evaluate(mdp, "random").mean
    seen = [evaluate(mdp, perceived(mdp, policy, errors(1 - level, 4))).mean for level in levels]
    kept = [f"{level:.0%}: {value:.1f}" for level, value in zip(levels, seen, strict=True)]
    confused = misread(mdp, policy, {"0000": "1000"})
    return [
        Statement(
            claim="An angry person is met with encouragement.",
            place="Section 4.2, Robot Caregiver; Section 4.1",
            kind=EXACT,
            found=angry_met(mdp, policy),
        ),
        Statement(
            claim="Despite errors of perception the robot goes on to help effectively.",
            place="Section 4.2, last paragraph",
            kind=PARTLY,
            found=f"value with perfect perception {best:.1f}, random actions {random:.1f}; with "
            f"each status read rightly at a rate of {'; '.join(kept)}. How often the "
            "authors' model errs is not reported.",
        ),
        Statement(
            claim="A question about what comes next is taken for forgetfulness.",
            place="Section 4.2 and 4.3, timestep 0 of the recorded example",
            kind=PARTLY,
            found=f"if 0000 were always read as 1000, and all else rightly, the value would be "
            f"{confused:.1f} instead of {best:.1f}. That it happened is one example of the "
            "authors' model.",
        ),
        Statement(
            claim="Confusion is met with supportive assistance.",
            place="Section 4.2, Robot Caregiver, the simulated interaction",
            kind=EXACT,
            found=confused_met(mdp),
        ),
        Statement(
            claim="State, behaviour, action and assistance of each timestep are saved as text.",
            place="Section 4.2, first paragraph",
            kind=EXACT,
            found="conversation.txt holds them, conversation.jsonl everything behind them; a "
            "recording can be replayed without a model.",
        ),
        Statement(
            claim="Behaviour is realistic and fits the status (cooperative in 0000, withdrawn in "
            "0001).",
            place="Section 4.2, Agent PLWD",
            kind=MODEL,
            found="the scripted agent fits by construction, which shows nothing about a language "
            "model; `measure` holds any endpoint against it: a status that cannot be read back "
            "out of the behaviour was not expressed, or not recognised.",
        ),
        Statement(
            claim="The four prompts of action execution make no marked difference.",
            place="Section 4.2, Robot Caregiver",
            kind=MODEL,
            found="`variants` puts the four answers side by side for any backend. The scripted one "
            "differs by construction. In the decision model the wording changes nothing.",
        ),
        Statement(
            claim="Answers to confusion and anger are empathetic and in place.",
            place="Section 4.2, Figure of a simulated interaction",
            kind=PEOPLE,
            found="the authors' own observation, by their own account without formal evaluation.",
        ),
    ]


def once(mdp: MDP, status: str, action: str) -> list[Fraction]:
    """Return what an action loses in each state with a status and a choice, taken once.

    All else is optimal.

    Examples
    --------
    >>> found = once(Scenario.load("yuan2025").compile(), "0100", "supportive")
    >>> len(found), min(found) > 1
    (15, True)
    """
    value, discount = certify(mdp).value, mdp.discount_exact
    chosen = (mdp.space.values("status") == int(status, 2)) & ~mdp.forced & ~mdp.terminal
    at = np.flatnonzero(chosen)
    rows = [(state, mdp.table.row(mdp.pair(state, action))) for state in at.tolist()]
    return [
        value[state] - sum(p * (gain + discount * value[after]) for p, after, gain in row)
        for state, row in rows
    ]


def confused_met(mdp: MDP) -> str:
    """Return in words what encouraging a person who is only confused is worth in a model."""
    lost = once(mdp, "0100", "supportive")
    return (
        "in the example the robot encourages a person who is confused. Where confusion is the only "
        f"status, that is optimal in {sum(x == 0 for x in lost)} of {len(lost)} states, and costs "
        f"{float(min(lost)):.1f} to {float(max(lost)):.1f} points each time; what the robot "
        "perceived in the example is not reported."
    )


def errors(rate: float, statuses: int) -> np.ndarray:
    """Return the confusion matrix in which each status is misread independently at a rate.

    Examples
    --------
    >>> errors(0.25, 1).tolist()
    [[0.75, 0.25], [0.25, 0.75]]
    """
    one = np.array([[1 - rate, rate], [rate, 1 - rate]])
    whole = np.ones((1, 1))
    for _ in range(statuses):
        whole = np.kron(whole, one)
    return whole


def misread(mdp: MDP, policy: Policy, mistakes: dict[str, str]) -> float:
    """Return the value of a policy where some statuses are always taken for others."""
    confusion = np.eye(mdp.space.column("status").size)
    for true, seen in mistakes.items():
        confusion[int(true, 2)] = np.eye(len(confusion))[int(seen, 2)]
    return evaluate(mdp, perceived(mdp, policy, confusion)).mean


def angry_met(mdp: MDP, policy: Policy) -> str:
    """Return in words how an optimal policy of a model meets anger."""
    chosen = policy.choices(mdp)
    angry = [int("".join(bits), 2) for bits in product("01", repeat=4) if bits[2] == "1"]
    states = np.flatnonzero(np.isin(mdp.space.values("status"), angry))
    names = sorted({mdp.actions[number] for number in chosen[states]})
    share = float(np.mean(chosen[states] == mdp.action("supportive")))
    return (
        f"the optimal policy chooses supportive assistance in {share:.0%} of the "
        f"{len(states)} states with anger (choices there: {', '.join(names)})."
    )
