"""Claims about the two agents and their language model (Section 4.2).

`paper_repro.agents.claims` words them, says who could check each, and computes what the decision
model has to say. What rests on the wording of the authors' model, or on people's judgement, stays
not determined.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

from exact_mdp.paper_repro.claims.claim import Finding, PaperClaim, Verdict, undecided
from exact_mdp.paper_repro.claims.policies import ANGRY, optimal_actions
from exact_mdp.paper_repro.view import View

# In the order of `agents.claims.statements`, with the places of each.
NAMES = {
    "anger-encouraged": ("Section 4.2", "Section 4.1"),
    "perception-errors": ("Section 4.2",),
    "question-taken-for-forgetfulness": ("Section 4.2", "Section 4.3", "Figure 11"),
    "saved-as-text": ("Section 4.2", "Figure 11"),
    "behaviour-fits-status": ("Section 4.2", "Figure 12"),
    "four-prompts-alike": ("Section 4.2", "Figure 7", "Figure 8"),
    "answers-empathetic": ("Section 4.2", "Figure 12"),
}


def claims() -> Iterator[PaperClaim]:
    """Yield the claims of Section 4.2."""
    for (name, places), (says, _, _) in zip(NAMES.items(), _statements(), strict=True):
        yield PaperClaim(
            id=f"agents.{name}",
            places=places,
            says=says,
            rule="statement" if name in DECIDED else "open",
            find=partial(_found, name=name),
        )


@cache
def _statements() -> tuple[tuple[str, str, str], ...]:
    """Return claim, who can check it, and what was found, of every statement."""
    from exact_mdp.paper_repro.agents.claims import statements

    return tuple((each.claim, each.kind, each.found) for each in statements())


def _found(view: View, *, name: str) -> Finding:
    _, kind, found = _statements()[list(NAMES).index(name)]
    if name in DECIDED:
        holds = DECIDED[name](view)
        verdict = Verdict.REPRODUCED if holds else Verdict.NOT_REPRODUCED
        return Finding(verdict=verdict, why=found)
    return undecided(f"{kind}: {found}")


def _encouraged(view: View) -> bool:
    supportive = view.mdp.action("supportive")
    return all(supportive in best for status in ANGRY for best in optimal_actions(view, status))


def _saved(view: View) -> bool:
    """Hold a scripted conversation and look for each timestep's four parts in the text file."""
    from exact_mdp.paper_repro.agents.conversation import conversation
    from exact_mdp.paper_repro.agents.protocol import plain
    from exact_mdp.paper_repro.agents.scripted import Scripted
    from exact_mdp.paper_repro.agents.session import hold
    from exact_mdp.paper_repro.agents.views import vector

    with TemporaryDirectory() as folder:
        record = hold(conversation(Scripted(), seed=0), Path(folder) / "talk", limit=3)
        text = (Path(folder) / "talk" / "conversation.txt").read_text("utf-8")
    names = record.header["statuses"]
    parts = [
        (
            vector(names, step["status"]),
            plain(step["behaviour"]["nonverbal"]),
            step["action"],
            plain(step["assistance"]),
        )
        for step in record.steps
    ]
    return bool(parts) and all(part in text for step in parts for part in step)


DECIDED = {"anger-encouraged": _encouraged, "saved-as-text": _saved}
