"""Where the paper says what: its sections, tables, equations and figures, by number.

Every claim names the places it is taken from; a test holds each name against this list. Numbers
are those of the paper's source (Yuan et al. 2025), titles shortened.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

SECTIONS = {
    "Abstract": "Abstract",
    "Section 1": "Introduction",
    "Section 2": "Agent PLWD",
    "Section 2.1": "Probabilistic model of PLWD states",
    "Section 2.1.1": "Without external assistance",
    "Section 2.1.2": "With external assistance",
    "Section 2.1.3": "Subtask skipping",
    "Section 2.2": "LLM-based PLWD behavior simulation",
    "Section 3": "RL-based agent Robot Caregiver",
    "Section 3.1": "LLM-based robot perception",
    "Section 3.2": "RL-based robot action selection module",
    "Section 3.2.1": "State space",
    "Section 3.2.2": "Action space",
    "Section 3.2.3": "Immediate reward",
    "Section 3.2.4": "Learning algorithm design and training",
    "Section 3.2.5": "Evaluation metrics",
    "Section 3.3": "LLM-based robot action execution module",
    "Section 4": "Results and discussion",
    "Section 4.1": "RL-based action selection strategy",
    "Section 4.2": "Agent PLWD-robot interaction",
    "Section 4.3": "Limitations and future work",
    "Section 5": "Conclusion",
}

TABLES = {
    "Table 1": "Terms and definitions",
    "Table 2": "Assistance types",
    "Table 3": "Transition probabilities without assistance",
    "Table 4": "Weights of the reward components",
}

EQUATIONS = {"Equation 1": "Immediate reward", "Equation 2": "Decaying exploration"}

FIGURES = {
    "Figure 1": "Architecture of the two agents",
    "Figure 2": "Flowchart of their interaction",
    "Figure 3": "State transition model of the agent PLWD",
    "Figure 4": "Mechanism of a status's dynamics",
    "Figure 5": "Prompt of the behavior simulation",
    "Figure 6": "Prompt of the perception module",
    "Figure 7": "Prompt of action execution, brief guidance, without status",
    "Figure 8": "Prompt of action execution, detailed guidance, with status",
    "Figure 9": "Average return during training, three strategies",
    "Figure 10": "Learned policies of the two exploration schedules",
    "Figure 11": "Screenshot of a recorded experiment",
    "Figure 12": "Example of an interaction",
}

PLACES: Mapping[str, str] = MappingProxyType(SECTIONS | TABLES | EQUATIONS | FIGURES)
"""Every place that a claim may be taken from, with its title."""


def section_of(place: str) -> str:
    """Return the section that a place stands in.

    Examples
    --------
    >>> section_of("Table 3"), section_of("Section 4.1")
    ('Section 2.1.1', 'Section 4.1')
    """
    return _HOME.get(place, place)


_HOME = {
    "Table 1": "Section 2",
    "Table 2": "Section 2.1",
    "Table 3": "Section 2.1.1",
    "Table 4": "Section 3.2.3",
    "Equation 1": "Section 3.2.3",
    "Equation 2": "Section 3.2.4",
    "Figure 1": "Section 2",
    "Figure 2": "Section 2",
    "Figure 3": "Section 2.1",
    "Figure 4": "Section 2.1",
    "Figure 5": "Section 2.2",
    "Figure 6": "Section 3.1",
    "Figure 7": "Section 3.3",
    "Figure 8": "Section 3.3",
    "Figure 9": "Section 4.1",
    "Figure 10": "Section 4.1",
    "Figure 11": "Section 4.2",
    "Figure 12": "Section 4.2",
}
