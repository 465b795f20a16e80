"""The commands measure, variants and claims."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from exact_mdp.paper_repro.agents.cli import (
    FILE,
    FOLDER,
    Range,
    backend_of,
    backend_options,
    price_option,
    scene_options,
    tell_use,
)


@click.command()
@scene_options
@click.option(
    "--each", default=20, show_default=True, type=click.IntRange(1),
    help="Behaviours for each status vector.",
)  # fmt: skip
@click.option(
    "--recording", "recordings", multiple=True, type=FILE,
    help="Count in these recordings instead of asking a backend. May be repeated.",
)  # fmt: skip
@click.option(
    "--scripted-behaviour", is_flag=True,
    help="Let the scripted agent behave, and the backend only perceive.",
)  # fmt: skip
@click.option(
    "--prior", default=0.0, show_default=True, type=Range(0),
    help="Pseudo-count of every cell of the matrix.",
)  # fmt: skip
@click.option("--draws", default=100, show_default=True, type=click.IntRange(0, 10_000))
@click.option("--policy", default="optimal", show_default=True, help="As in run.")
@click.option("--resume", is_flag=True, help="Go on with the measurement begun in the folder.")
@price_option
@click.option("--out", type=FOLDER, default=Path("results/agents/perception"), show_default=True)
@backend_options
def measure(
    scenario: str, sets: tuple[str, ...], activity: str, history: int,
    prompts_folder: Path | None, seed: int, each: int, recordings: tuple[Path, ...],
    scripted_behaviour: bool, prior: float, draws: int, policy: str, resume: bool,
    price: tuple[float, float] | None, out: Path, kind: str, **backend: Any,
) -> None:  # fmt: skip
    """Measure a backend's perception: confusion.csv, intervals, and what it would cost."""
    from exact_mdp.paper_repro.agents import measure as measuring
    from exact_mdp.paper_repro.agents.measure import Notebook, counted, write
    from exact_mdp.paper_repro.agents.prompts import FOLDER as OWN
    from exact_mdp.paper_repro.agents.protocol import Tap
    from exact_mdp.paper_repro.agents.scripted import Scripted
    from exact_mdp.paper_repro.agents.setup import conversation

    chosen = Tap(backend_of(kind, **backend) if not recordings else Scripted())
    talk = conversation(
        chosen, scenario=scenario, sets=sets, policy=policy, seed=seed, activity=activity,
        history=history, prompts=prompts_folder or OWN,
    )  # fmt: skip
    statuses = talk.world.scenario.statuses
    if recordings:
        counts = measuring.count(counted(recordings, statuses), len(statuses))
        source: dict[str, Any] = {"recordings": [str(path) for path in recordings]}
    else:
        behave = Scripted() if scripted_behaviour else chosen
        source = chosen.describe() | {"behaviour": behave.describe()["backend"], "each": each}
        keys = ("disclaimer", "statuses", "activity", "prompts", "seed")
        header = {key: talk.header()[key] for key in keys} | {"source": source}
        with Notebook(out, header, resume=resume) as notebook:
            found = measuring.labelled(
                talk.modules, behave, chosen, each=each, seed=seed, past=notebook.past,
                progress=notebook.add,
            )  # fmt: skip
        counts = measuring.count([(f.status, f.perceived) for f in found], len(statuses))
    world = talk.world
    worth = measuring.cost(world.mdp, world.policy, counts, prior=prior, draws=draws, seed=seed)
    result = {
        "source": source,
        "seed": seed,
        "policy": policy,
        "prior": prior,
        "statuses": list(statuses),
        "counts": counts.tolist(),
        "rates": measuring.rates(counts, statuses),
        "value": worth,
    }
    write(out, measuring.matrix(counts, prior), result, world.mdp, scenario)
    for name, both in result["rates"].items():
        for what, rate in both.items():
            shown = "none seen" if rate["rate"] is None else f"{rate['rate']:.3f}"
            click.echo(
                f"{name:14} {what:11} {shown} [{rate['low']:.3f}, {rate['high']:.3f}] "
                f"of {rate['of']}"
            )
    click.echo(
        f"value with perfect perception {worth['perfect']['value']:.2f}, "
        f"with the errors as counted {worth['measured']['value']:.2f}"
    )
    span = worth["posterior"]["interval"]
    if span:
        click.echo(
            f"value by the posterior of the counts {worth['posterior']['mean']:.2f} "
            f"[{span[0]:.2f}, {span[1]:.2f}], estimated from {draws} draws"
        )
    tell_use(chosen.used, price, chosen.uncounted)
    click.echo(out / "confusion.csv")


@click.command()
@scene_options
@click.option(
    "--status", "vectors", multiple=True, default=("0000", "0100", "0010", "1001"),
    show_default=True, help="Status vector. May be repeated.",
)  # fmt: skip
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@backend_options
def variants(
    scenario: str, sets: tuple[str, ...], activity: str, history: int,
    prompts_folder: Path | None, seed: int, vectors: tuple[str, ...], as_json: bool, kind: str,
    **backend: Any,
) -> None:  # fmt: skip
    """Put the four prompts of action execution side by side."""
    from exact_mdp.mdp import Scenario
    from exact_mdp.mdp.space import Column
    from exact_mdp.paper_repro.agents.prompts import FOLDER as OWN
    from exact_mdp.paper_repro.agents.setup import modules_of, side_by_side
    from exact_mdp.paper_repro.agents.text_view import plain

    model = Scenario.load(scenario)
    for assignment in sets:
        model = model.set(assignment)
    width = len(model.statuses)
    column = Column(name="status", size=2**width, bits=width)
    numbers = [column.parse(text) for text in vectors]
    modules = modules_of(model, activity=activity, history=history, prompts=prompts_folder or OWN)
    found = side_by_side(
        modules, backend_of(kind, **backend), vectors=numbers, actions=list(model.actions[1:]),
        seed=seed,
    )  # fmt: skip
    if as_json:
        click.echo(json.dumps({"answers": [asdict(a) for a in found]}, ensure_ascii=False))
        return
    for answers in found:
        click.echo(f"{answers.status}, {answers.action}: “{plain(answers.behaviour['verbal'])}”")
        for variant, speech in answers.speech.items():
            asked = answers.prompt_characters[variant]
            click.echo(f"  {variant:16} ({asked:,} ch.) {plain(speech)}")


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def claims(as_json: bool) -> None:
    """List the claims of the paper's Section 4.2, and which of them can be checked here."""
    from exact_mdp.paper_repro.agents.claims import statements

    found = statements()
    if as_json:
        click.echo(json.dumps({"claims": [asdict(s) for s in found]}, ensure_ascii=False))
        return
    for statement in found:
        click.echo(f"{statement.claim} ({statement.place})")
        click.echo(f"  {statement.kind}: {statement.found}")
