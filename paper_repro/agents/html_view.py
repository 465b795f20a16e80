"""A conversation as one self-contained page, after the paper's figure of an interaction.

Nonverbal behaviour in grey and words in black, the robot's answer across from them, status and
action beside. Every text is escaped; the page has no script and may load nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from exact_mdp.paper_repro.agents.recording import Recording
from exact_mdp.paper_repro.agents.text_view import OUTCOMES, number, plain

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1.5rem 1rem 3rem; max-width: 62rem; color: #1b1b1f;
  background: #fff; font: 16px/1.5 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; }
h1 { font-size: 1.35rem; margin: 0 0 .5rem; }
.note { border-left: 4px solid #8a5a00; background: #fff7e6; padding: .5rem .75rem; margin: 0; }
dl.about { display: grid; grid-template-columns: max-content 1fr; gap: .1rem .9rem;
  margin: 1rem 0; font-size: .9rem; }
dl.about dt { color: #55555f; } dl.about dd { margin: 0; overflow-wrap: anywhere; }
h2 { font-size: 1.05rem; margin: 2rem 0 .75rem; padding-top: .75rem;
  border-top: 2px solid #1b1b1f; }
h2 small { display: block; font-weight: normal; color: #55555f; }
ol { list-style: none; margin: 0; padding: 0; }
li { display: grid; grid-template-columns: 13rem minmax(0, 1fr); gap: .25rem 1rem;
  padding: .85rem 0; border-top: 1px solid #d9d9e0; }
li:first-child { border-top: 0; }
.side { font-size: .85rem; color: #3a3a44; }
.side b { display: block; font-size: .95rem; color: #1b1b1f; }
.row { margin: .2rem 0; }
.chips { display: flex; flex-wrap: wrap; gap: .25rem; margin: .15rem 0 .4rem; }
.chip { border: 1px solid #8a8a96; border-radius: 1rem; padding: 0 .5rem; background: #fff; }
.chip.wrong { border-style: dashed; border-color: #a3123a; color: #a3123a; font-weight: 600; }
.talk { display: grid; gap: .5rem; }
.talk p { margin: 0; overflow-wrap: anywhere; }
.plwd, .robot { border-radius: .6rem; padding: .55rem .8rem; max-width: 92%; }
.plwd { background: #fde8ef; border: 1px solid #e7b3c5; justify-self: start; }
.robot { background: #fdeedd; border: 1px solid #e2bd8d; justify-self: end; }
.who { font-size: .75rem; letter-spacing: .03em; text-transform: uppercase; color: #5c4a52; }
.nonverbal { color: #666069; font-style: italic; }
.verbal { color: #000; }
.silent { color: #666069; }
.action { font-weight: 600; text-transform: none; letter-spacing: 0; font-size: .85rem; }
.outcome { font-size: .85rem; color: #3a3a44; }
footer { margin-top: 2rem; padding-top: 1rem; border-top: 2px solid #1b1b1f; }
@media (max-width: 40rem) {
  li { grid-template-columns: minmax(0, 1fr); }
  .side { display: flex; flex-wrap: wrap; gap: 0 .9rem; align-items: baseline; }
  .row { display: flex; flex-wrap: wrap; gap: 0 .4rem; margin: 0; }
  .chips { margin: 0; }
  .plwd, .robot { max-width: 100%; }
}
@media print { li { break-inside: avoid; } }
"""

POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"


def page(told: Recording) -> str:
    """Return the page of a recording, finished or not."""
    header = told.header
    about = {
        "Scenario": header["scenario"],
        "Setting": header["setting"],
        "Policy": header["policy"],
        "Words from": ", ".join(f"{key} {value}" for key, value in header["backend"].items()),
        "Action execution": header["variant"],
        "Seed": header["seed"],
    }
    listed = "".join(f"<dt>{key}</dt><dd>{_text(value)}</dd>" for key, value in about.items())
    return f"""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{POLICY}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>Conversation: {_text(header["scenario"])}, seed {_text(header["seed"])}</title>
<style>{STYLE}</style>
</head>
<body>
<h1>A simulated conversation</h1>
<p class="note">{_text(header["disclaimer"])}</p>
<dl class="about">{listed}</dl>
<main>
{_sections(told)}
</main>
<footer>{_closing(told)}</footer>
</body>
</html>
"""


def _sections(told: Recording) -> str:
    """Return a section for each subtask, with its timesteps as a list."""
    header, parts = told.header, []
    for subtask, place in enumerate(header["steps"]):
        steps = [step for step in told.steps if step["subtask"] == subtask]
        if steps:
            parts.append(
                f"<section><h2>Step {subtask + 1} of {len(header['steps'])}: "
                f"{_text(place['step'])}<small>Task: {_text(place['goal'])}</small></h2>"
                f"<ol>{''.join(_step(header, step) for step in steps)}</ol></section>"
            )
    return "\n".join(parts)


def _step(header: Mapping[str, Any], step: Mapping[str, Any]) -> str:
    names = header["statuses"]
    behaviour, trial = step["behaviour"], min(step["trial"] + 1, header["trials"])
    words = behaviour["verbal"].strip()
    said = f'<p class="verbal">“{_text(words)}”</p>' if words else _silent("Says nothing.")
    answer = f"<p>“{_text(step['assistance'])}”</p>" if step["assistance"] else _silent("Silent.")
    action = f"a{header['actions'].index(step['action'])} {step['action']}"
    return f"""
<li>
<div class="side"><b>Timestep {step["timestep"]}</b>
<div class="row">trial {trial} of {header["trials"]}</div>
<div class="row">status {step["status"]} {_chips(names, step["status"], step["status"])}</div>
<div class="row">perceived {step["perceived"]}
{_chips(names, step["perceived"], step["status"])}</div></div>
<div class="talk">
<div class="plwd"><span class="who">Person</span>
<p class="nonverbal">{_text(behaviour["nonverbal"])}</p>{said}</div>
<div class="robot"><span class="who">Robot · <span class="action">{_text(action)}</span></span>
{answer}</div>
<div class="outcome">{OUTCOMES[step["event"]]} · reward&nbsp;{number(step["reward"])} ·
return&nbsp;{number(step["return"])}</div>
</div>
</li>"""


def _chips(names: list[str], bits: str, truth: str) -> str:
    """Return the statuses that are present; wrongly seen and missed ones are marked in words."""
    chips = []
    for name, bit, true in zip(names, bits, truth, strict=True):
        if bit == "1":
            wrong = bit != true
            mark = ' wrong">not so: ' if wrong else '">'
            chips.append(f'<span class="chip{mark}{_text(name)}</span>')
        elif true == "1":
            chips.append(f'<span class="chip wrong">missed: {_text(name)}</span>')
    return f'<span class="chips">{"".join(chips) or "<span>none present</span>"}</span>'


def _closing(told: Recording) -> str:
    end = told.end
    if end is None:
        return f"Not finished: {len(told.steps)} timesteps so far."
    tokens = end["prompt_tokens"] + end["completion_tokens"]
    counted = f" {tokens:,} tokens." if tokens else ""
    return (
        f"{end['timesteps']} timesteps, {end['completed']} steps completed, {end['skipped']} "
        f"skipped, return {number(end['return'])}. Misperceived in {end['misperceived']} "
        f"timesteps.{counted}"
    )


def _silent(text: str) -> str:
    return f'<p class="silent">{text}</p>'


def _text(value: object) -> str:
    return escape(plain(str(value)))
