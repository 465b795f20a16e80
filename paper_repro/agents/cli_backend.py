"""The options that name a backend, and making it from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import click

from paper_repro.agents.chat import SHAPES, Style
from paper_repro.agents.protocol import Backend


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
    from mdp.errors import ModelError

    if kind == "scripted":
        from paper_repro.agents.scripted import Scripted

        return Scripted(noise=noise)
    style = Style(temperature=temperature, max_tokens=max_tokens, shape=shape, tries=tries)
    if kind == "local":
        from paper_repro.agents.local import DEFAULT_MODEL, LONGEST, Local

        path = Path(model) if model else DEFAULT_MODEL
        style = replace(style, longest=LONGEST)
        return Local(path=path, style=style, context=context, threads=threads)
    from paper_repro.agents.endpoint import Endpoint

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
