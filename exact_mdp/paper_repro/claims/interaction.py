"""Claims about the two agents and their language model (Section 4.2).

`paper_repro.agents.claims` words them, says who could check each, and computes what the decision
model has to say. What rests on the wording of the authors' model, or on people's judgement, stays
not determined.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryDirectory

from exact_mdp.paper_repro.agents.claims import (
    Statement,
    angry_met,
    confused_met,
    once,
    statements,
)
from exact_mdp.paper_repro.agents.conversation import conversation
from exact_mdp.paper_repro.agents.protocol import plain
from exact_mdp.paper_repro.agents.scripted import Scripted
from exact_mdp.paper_repro.agents.session import hold
from exact_mdp.paper_repro.agents.views import vector
from exact_mdp.paper_repro.claims.claim import Claims, Finding, Kind, statement, undecided
from exact_mdp.paper_repro.claims.policies import optimal_actions
from exact_mdp.paper_repro.reading import Reading
from exact_mdp.paper_repro.reported import ANGRY

# In the order of `agents.claims.statements`, with the places of each.
SOURCES = {
    "anger-encouraged": "Section 4.2, Section 4.1",
    "perception-errors": "Section 4.2",
    "question-taken-for-forgetfulness": "Section 4.2, Section 4.3, Figure 11",
    "confusion-supported": "Section 4.2, Figure 12",
    "saved-as-text": "Section 4.2, Figure 11",
    "behaviour-fits-status": "Section 4.2, Figure 12",
    "four-prompts-alike": "Section 4.2, Figure 7, Figure 8",
    "answers-empathetic": "Section 4.2, Figure 12",
}


@cache
def claims() -> Claims:
    """Return the claims of Section 4.2."""
    found = Claims()
    for (name, source), told in zip(SOURCES.items(), statements(), strict=True):
        decide = DECIDED.get(name)
        rule = "open" if decide is None else "statement"
        work = partial(_found, told=told, decide=decide)
        kind: Kind = "input" if name in DEFINITIONS else "finding"
        found.add(f"agents.{name}", source, rule, says=told.claim, kind=kind)(work)
    return found


def _found(reading: Reading, told: Statement, decide: Callable[[Reading], bool] | None) -> Finding:
    if decide is None:
        return undecided(f"{told.kind}: {told.found}")
    said = SAID.get(decide)
    return statement(decide(reading), told.found if said is None else said(reading))


def _encouraged(reading: Reading) -> bool:
    supportive = reading.mdp.action("supportive")
    return all(supportive in best for status in ANGRY for best in optimal_actions(reading, status))


def _saved(reading: Reading) -> bool:
    """Hold a scripted conversation and look for each timestep's four parts in the text file."""
    with TemporaryDirectory() as folder:
        record = hold(conversation(Scripted(), seed=0), Path(folder) / "talk", limit=3)
        text = (Path(folder) / "talk" / "conversation.txt").read_text("utf-8")
    names = record.header["statuses"]
    parts = [
        part
        for step in record.steps
        for part in (
            vector(names, step["status"]),
            plain(step["behaviour"]["nonverbal"]),
            step["action"],
            plain(step["assistance"]),
        )
    ]
    return bool(parts) and all(part in text for part in parts)


def _supported(reading: Reading) -> bool:
    return max(once(reading.mdp, "0100", "supportive")) == 0


DECIDED = {
    "anger-encouraged": _encouraged,
    "confusion-supported": _supported,
    "saved-as-text": _saved,
}
SAID: Mapping[Callable[[Reading], bool], Callable[[Reading], str]] = {  # of each reading
    _encouraged: lambda reading: angry_met(reading.mdp, reading.policies["optimal"]),
    _supported: lambda reading: confused_met(reading.mdp),
}
DEFINITIONS = {"saved-as-text"}  # what the simulator does, not what was found with it
