"""`python -m exact_mdp.paper_repro.agents`: its commands."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import click
import numpy as np

from exact_mdp import ModelError, evaluate, perceived
from exact_mdp.analysis.exit_status import Programs
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.care.perception import compute_rates, frequencies, read_counts
from exact_mdp.paper_repro.agents import log
from exact_mdp.paper_repro.agents.endpoint import SHAPES, BackendError, Endpoint
from exact_mdp.paper_repro.agents.scripted import Scripted
from exact_mdp.paper_repro.agents.simulate import NAME, Backend, Conversation, build_conversation
from exact_mdp.paper_repro.agents.texts import HISTORY, VARIANTS
from exact_mdp.paper_repro.paper import write_file

FOLDER = click.Path(file_okay=False, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)
Options = Callable[[Any], Any]


def combine_options(*options: Options) -> Options:
    """Return several options as one decorator."""

    def add_options(function: Any) -> Any:
        for each in reversed(options):
            function = each(function)
        return function

    return add_options


def option_with_default(*names: str, **settings: Any) -> Options:
    """Return an option that shows its default."""
    return click.option(*names, **{"show_default": True} | settings)


SCENE = combine_options(
    option_with_default("--scenario", default="yuan2025", help="By name, or a .toml file."),
    option_with_default(
        "--set", "sets", multiple=True, metavar="KEY=VALUE", help="Change the scenario."
    ),
    option_with_default(
        "--history", default=HISTORY, type=click.IntRange(0), help="Exchanges in a prompt."
    ),
    option_with_default(
        "--seed", default=0, type=click.IntRange(0), help="Seed of the random numbers."
    ),
    option_with_default(
        "--policy",
        default="optimal",
        help="optimal, random, always:ACTION, reported:ACTION (the paper's), or a file.",
    ),
)
VARIANT = option_with_default(
    "--variant",
    type=click.Choice(tuple(VARIANTS)),
    default="detailed+status",
    help="Prompt of action execution.",
)
BACKEND = combine_options(
    option_with_default(
        "--backend",
        type=click.Choice(("scripted", "openai")),
        default="scripted",
        help="Who plays both agents: fixed sentences, or a language model.",
    ),
    option_with_default(
        "--noise",
        default=0.0,
        type=click.FloatRange(0, 1),
        help="scripted: probability that perception errs in one status.",
    ),
    option_with_default("--model", help="openai: the model's name."),
    option_with_default("--base-url", help="openai: address of the endpoint, up to /v1."),
    option_with_default(
        "--key-variable",
        default=Endpoint.key_variable,
        help="openai: the environment variable with the key, which is never recorded.",
    ),
    option_with_default(
        "--timeout",
        default=Endpoint.timeout,
        type=click.FloatRange(0.1, 86_400),
        help="openai: seconds for a whole answer.",
    ),
    option_with_default(
        "--temperature",
        default=Endpoint.temperature,
        type=click.FloatRange(0, 2),
        help="openai: how freely the model draws its words; 0 takes the likeliest.",
    ),
    option_with_default(
        "--max-tokens",
        default=Endpoint.max_tokens,
        type=click.IntRange(16, 100_000),
        help="openai: the longest answer.",
    ),
    option_with_default(
        "--response-format",
        "shape",
        type=click.Choice(SHAPES),
        default=Endpoint.shape,
        help="openai: how the answer's form is asked for.",
    ),
    option_with_default(
        "--tries",
        default=Endpoint.tries,
        type=click.IntRange(1, 20),
        help="openai: how often a question is asked before giving up.",
    ),
)


def backend_of(words: dict[str, Any]) -> Backend:
    """Take the options of the backend out of the words; raise ModelError if one is missing."""
    kind, noise = words.pop("backend"), words.pop("noise")
    chosen = {each.name: words.pop(each.name) for each in fields(Endpoint) if each.name in words}
    if kind == "scripted":
        return Scripted(noise=noise)
    if not chosen["model"] or not chosen["base_url"]:
        raise ModelError(
            "the openai backend needs a model and an address",
            where="--backend openai",
            fix="add --model NAME --base-url URL",
        )
    return Endpoint(**chosen)


def record_run(out: Path, talk: Conversation, words: Mapping[str, Any]) -> None:
    """Write versions, commit and date."""
    record = run_record(talk.mdp, model=words["scenario"], solver="auto", seed=words["seed"])
    write_file(out / "run.json", json.dumps(record, indent=1) + "\n")


@click.group(cls=Programs)
def main() -> None:
    """Play the two agents of Yuan et al. (2025): a person with dementia and a robot caregiver.

    A simulator for research on decision models. Not medical advice.
    """


@main.command("run")
@combine_options(SCENE, VARIANT, BACKEND)
@option_with_default(
    "--out",
    type=FOLDER,
    default=Path("results/agents/conversation"),
    help="Where the recording is kept.",
)
@option_with_default("--resume", is_flag=True, help="Go on with the recording in the folder.")
@option_with_default(
    "--limit", type=click.IntRange(0), help="Stop after this many timesteps in all."
)
def converse_command(out: Path, resume: bool, limit: int | None, **words: Any) -> None:
    """Hold a conversation, print it, and write it as JSON lines and as text."""
    talk = build_conversation(backend_of(words), **words)
    header = talk.build_header()

    def print_step(step: dict[str, Any]) -> None:
        click.echo(log.format_dialogue(header, step))

    try:
        record = talk.hold(out, resume=resume, limit=limit, progress=print_step)
    except BackendError:
        click.echo(f"the recording so far is in {out / NAME}; --resume goes on", err=True)
        raise
    record_run(out, talk, words)
    state = "not finished, --resume goes on"
    if record.end:
        state = "finished"
    click.echo(f"{len(record.steps)} timesteps, {state}: {out / 'conversation.txt'}")


@main.command("measure")
@combine_options(SCENE, BACKEND)
@option_with_default(
    "--each", default=20, type=click.IntRange(1), help="Behaviours for each status vector."
)
@option_with_default(
    "--recording",
    "recordings",
    multiple=True,
    type=FILE,
    help="Count in this conversation.jsonl instead of asking; repeatable.",
)
@option_with_default(
    "--scripted-behaviour", is_flag=True, help="Let the scripted agent behave, whatever perceives."
)
@option_with_default(
    "--out",
    type=FOLDER,
    default=Path("results/agents/perception"),
    help="Where the counts are written.",
)
def measure_command(
    each: int, recordings: tuple[Path, ...], scripted_behaviour: bool, out: Path, **words: Any
) -> None:
    """Count a backend's perception: confusion.csv, rates with intervals, and the cost of errors."""
    import pandas

    talk = build_conversation(backend_of(words), **words)
    paths = list(recordings) or [out / "labelled.jsonl"]
    if len({path.resolve() for path in paths}) < len(paths):
        raise ModelError("one recording is named twice", where="--recording", fix="name it once")
    if not recordings:
        talk.label_behaviours(
            paths[0], each=each, behave=Scripted() if scripted_behaviour else talk.backend
        )
    counts = np.sum([read_counts(path, talk.mdp) for path in paths], axis=0)
    confusion = frequencies(counts)
    perfect = evaluate(talk.mdp, talk.policy).mean
    measured = evaluate(talk.mdp, perceived(talk.mdp, talk.policy, confusion)).mean
    labels = [talk.name_status(number)[0] for number in range(len(counts))]
    table = pandas.DataFrame(confusion, index=labels, columns=labels)
    write_file(out / "confusion.csv", table.to_csv(index_label="status", lineterminator="\n"))
    record_run(out, talk, words)
    for rate in compute_rates(counts, talk.modules.statuses).itertuples():
        shown = "none seen"
        if rate.total:
            shown = f"{rate.right / rate.total:.3f}"
        interval = f"[{rate.low:.3f}, {rate.high:.3f}] of {rate.total}"
        click.echo(f"{rate.status:14} {rate.rate:11} {shown} {interval}")
    click.echo(out / "confusion.csv")
    click.echo(
        f"The policy earns {perfect:.2f} with perfect perception and {measured:.2f} with these "
        "errors."
    )


if __name__ == "__main__":
    main(prog_name="python -m exact_mdp.paper_repro.agents")
