"""A conversation to read: as text, timestep by timestep (Section 4.2), and as one page.

Texts that come from a backend are shown on one line, without control characters, so that none of
them can look like a line of the record. The page follows the paper's figure of an interaction; all
text in it is escaped, it has no script and may load nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from exact_mdp.paper_repro.agents.protocol import plain
from exact_mdp.paper_repro.agents.recording import Recording

PAGE = Path(__file__).parent / "page.html"
OUTCOMES = {
    "completed": "step completed",
    "failed": "step not completed, another trial",
    "skipped": "step skipped after the last trial",
}


def number(text: str) -> str:
    """Return an exact number for reading: whole where it is whole, else with two decimals.

    Examples
    --------
    >>> number("-8"), number("1/3")
    ('-8', '0.33')
    """
    value = Fraction(text)
    if value.denominator == 1:
        return str(value)
    whole, cents = divmod(round(abs(value) * 100), 100)
    return f"{'-' * (value < 0)}{whole}.{cents:02d}"


def vector(names: list[str], bits: str) -> str:
    """Return a status vector with its names: Forgetfulness=0, Confusion=1."""
    return ", ".join(
        f"{plain(name.capitalize())}={bit}" for name, bit in zip(names, bits, strict=True)
    )


def _words_from(header: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in header["backend"].items())


def heading(header: Mapping[str, Any]) -> str:
    """Return the top of the text: what it is, and what it is not."""
    return f"""{plain(header["disclaimer"])}

Scenario: {plain(header["scenario"])}; activity: {plain(header["activity"])}; \
policy: {plain(header["policy"])}; seed {header["seed"]}
Language: {plain(_words_from(header))}; action execution: {plain(header["variant"])}
Setting: {plain(header["setting"])}

"""


def block(header: Mapping[str, Any], step: Mapping[str, Any]) -> str:
    """Return the lines of one timestep."""
    names, place = header["statuses"], header["steps"][step["subtask"]]
    behaviour, action = step["behaviour"], header["actions"].index(step["action"])
    return f"""Timestep {step["timestep"]}
  Task: {plain(place["goal"])}
  Subtask {step["subtask"] + 1} of {len(header["steps"])}: {plain(place["step"])}
  Trial: {min(step["trial"] + 1, header["trials"])} of {header["trials"]}
  PLWD status: {vector(names, step["status"])}
  PLWD nonverbal: {plain(behaviour["nonverbal"])}
  PLWD verbal: {plain(behaviour["verbal"]) or "(says nothing)"}
  Perceived status: {vector(names, step["perceived"])}
  Action: a{action} {plain(step["action"])}
  Robot Caregiver: {plain(step["assistance"]) or "(says nothing)"}
  Outcome: {OUTCOMES[step["event"]]}; reward {number(step["reward"])}, \
return so far {number(step["return"])}

"""


def spoken(header: Mapping[str, Any], step: Mapping[str, Any]) -> str:
    """Return one timestep as a dialogue: what was done and said, and what came of it."""
    behaviour, place = step["behaviour"], header["steps"][step["subtask"]]
    action = header["actions"].index(step["action"])
    return f"""{step["timestep"]}. {plain(place["step"])} \
(trial {min(step["trial"] + 1, header["trials"])} of {header["trials"]})
   [{plain(behaviour["nonverbal"])}]
   PLWD:  {plain(behaviour["verbal"]) or "(says nothing)"}
   Robot: {plain(step["assistance"]) or "(says nothing)"} (a{action} {plain(step["action"])})
   {OUTCOMES[step["event"]]}"""


def closing(end: Mapping[str, Any]) -> str:
    """Return the last line: how the scenario went."""
    return (
        f"End after {end['timesteps']} timesteps: {end['completed']} steps completed, "
        f"{end['skipped']} skipped, return {number(end['return'])}; "
        f"the status was misperceived in {end['misperceived']} timesteps.\n"
    )


def text(told: Recording) -> str:
    """Return the text of a recording, finished or not."""
    blocks = [block(told.header, step) for step in told.steps]
    return "".join([heading(told.header), *blocks, closing(told.end) if told.end else ""])


def page(told: Recording) -> str:
    """Return the page of a recording, finished or not."""
    import jinja2

    header, end = told.header, told.end
    about = {
        "Scenario": header["scenario"],
        "Setting": header["setting"],
        "Policy": header["policy"],
        "Words from": _words_from(header),
        "Action execution": header["variant"],
        "Seed": header["seed"],
    }
    parts = [
        {"number": subtask + 1, "place": place, "steps": steps}
        for subtask, place in enumerate(header["steps"])
        if (steps := [step for step in told.steps if step["subtask"] == subtask])
    ]
    tokens = 0 if end is None else end["prompt_tokens"] + end["completion_tokens"]
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, keep_trailing_newline=True
    )
    environment.filters |= {"plain": plain, "number": number}
    return str(
        environment.from_string(PAGE.read_text("utf-8")).render(
            header=header,
            steps=told.steps,
            end=end,
            about=about,
            parts=parts,
            outcomes=OUTCOMES,
            tokens=f" {tokens:,} tokens." if tokens else "",
            zip=zip,
        )
    )
