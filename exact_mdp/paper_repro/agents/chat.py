"""What the two backends with a language model share: the request's body, and reading an answer.

The form is that of chat completions: messages in, choices out, one JSON object as the content.
A content that is not JSON, or does not fit the schema, is asked for again a few times, with the
fault named; the broken text itself is not sent back.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.structured import DEEPEST, json_of
from exact_mdp.paper_repro.agents.protocol import BackendError, Reply, Request, violations

SHAPES = ("json_schema", "json_object", "none")
DIGITS = 40  # of a number in an answer
MOST_COUNTED = 10**15  # tokens of one answer; whoever counts more is not believed

Post = Callable[[dict[str, Any]], tuple[dict[str, Any], int]]


@dataclass(frozen=True, kw_only=True)
class Style:
    """How a model is asked.

    Attributes
    ----------
    temperature : float, or None to leave it to the model
    max_tokens : longest answer
    shape : one of `SHAPES`: how the form of the answer is requested; it is checked in any case
    tries : attempts for each request before the run stops
    send_seed : whether the request's seed is sent
    longest : characters of a text, where a model is to be held shorter than the schema does
    """

    temperature: float | None = 0.7
    max_tokens: int = 400
    shape: str = "json_schema"
    tries: int = 4
    send_seed: bool = True
    longest: int | None = None


class Malformed(Exception):
    """An answer that is not in the asked form; the text says how."""


def body(request: Request, style: Style, faults: list[str]) -> dict[str, Any]:
    """Return the body of a chat completion."""
    messages = [{"role": role, "content": content} for role, content in request.messages]
    if faults:
        messages[-1]["content"] += (
            f"\n\nAn earlier answer could not be used: {faults[-1]}. "
            "Answer with the JSON object alone."
        )
    found: dict[str, Any] = {"messages": messages, "max_tokens": style.max_tokens}
    if style.temperature is not None:
        found["temperature"] = style.temperature
    if style.send_seed:
        found["seed"] = (request.seed + len(faults)) % 2**31
    if style.shape == "json_schema":
        schema = shortened(request.schema, style.longest)
        named = {"name": request.purpose, "strict": True, "schema": schema}
        found["response_format"] = {"type": "json_schema", "json_schema": named}
    elif style.shape == "json_object":
        found["response_format"] = {"type": "json_object"}
    return found


def shortened(schema: Mapping[str, Any], longest: int | None) -> dict[str, Any]:
    """Return a schema with shorter texts; what fits it fits the given one, too."""
    properties = {
        name: part | {"maxLength": min(part["maxLength"], longest)}
        if longest is not None and part["type"] == "string"
        else part
        for name, part in schema["properties"].items()
    }
    return {**schema, "properties": properties}


def ask(request: Request, style: Style, post: Post, where: str) -> Reply:
    """Return an answer that fits, asking again where one does not.

    Parameters
    ----------
    post : sends a body, returns the decoded answer and the number of attempts it took
    where : the backend, for messages

    Raises
    ------
    BackendError
        For a refusal, or where every answer was malformed.
    """
    faults: list[str] = []
    attempts = prompt = completion = 0
    known = True
    started = time.perf_counter()
    while len(faults) < style.tries:
        answer, took = post(body(request, style, faults))
        attempts += took
        used = answer.get("usage")
        counts = used if isinstance(used, dict) else {}
        asked = _count(counts.get("prompt_tokens"))
        known = known and asked > 0
        prompt += asked
        completion += _count(counts.get("completion_tokens"))
        try:
            data = content_of(answer, request, where)
        except Malformed as fault:
            faults.append(str(fault))
            continue
        return Reply(
            data=data,
            attempts=attempts,
            prompt_tokens=prompt if known else 0,
            completion_tokens=completion if known else 0,
            seconds=round(time.perf_counter() - started, 3),
        )
    raise BackendError(
        f"{len(faults)} answers were not in the asked form; the last one: {faults[-1]}",
        where=f"{where}, {request.purpose}",
        fix="resume to try again; or take another model, or another --response-format",
    )


def content_of(answer: dict[str, Any], request: Request, where: str) -> dict[str, Any]:
    """Return the object in an answer; raises Malformed, or BackendError for a refusal."""
    try:
        choice = answer["choices"][0]
        message, why = choice["message"], choice.get("finish_reason")
        refusal, content = message.get("refusal"), message.get("content")
    except (KeyError, IndexError, TypeError, AttributeError) as error:
        raise Malformed("it held no choice with a message") from error
    if refusal or why == "content_filter":
        raise BackendError(
            "the model refused to answer",
            where=f"{where}, {request.purpose}",
            fix="resume to try again, take another model, or change the prompts (--prompts)",
        )
    if why == "length":
        raise Malformed("it was cut off at the greatest length")
    if not isinstance(content, str):
        raise Malformed("its content was not text")
    try:
        data = decoded(unfenced(content))
    except Malformed as fault:
        raise Malformed(f"its content {fault}") from None
    wrong = violations(data, request.schema)
    if wrong:
        raise Malformed("; ".join(wrong[:3]))
    return dict(data)


def unfenced(content: str) -> str:
    """Return text without a code fence around all of it.

    Examples
    --------
    >>> unfenced('```json\\n{"a": 1}\\n```')
    '{"a": 1}'
    """
    text = content.strip()
    if text.startswith("```") and text.endswith("```") and "\n" in text:
        return text[text.index("\n") + 1 : -3].strip()
    return text


def decoded(text: str | bytes) -> Any:
    """Return the value that JSON text stands for; what could be read in two ways is refused.

    Raises
    ------
    Malformed
        For text that is not JSON in UTF-8, a part named twice, a number that is infinite, none or
        of over `DIGITS` digits, and nesting deeper than `DEEPEST`.

    Examples
    --------
    >>> decoded('{"anger": 1}')
    {'anger': 1}
    >>> decoded('{"anger": 1, "anger": 0}')
    Traceback (most recent call last):
    exact_mdp.paper_repro.agents.chat.Malformed: names a part twice
    """
    try:
        return json_of(
            text if isinstance(text, str) else text.decode("utf-8-sig"),
            "answer",
            object_pairs_hook=_once_each,
            parse_int=_whole_number,
            parse_float=_number,
            parse_constant=_number,
        )
    except ModelError as error:
        deep = "nested" in error.what
        raise Malformed(f"is nested deeper than {DEEPEST}" if deep else "is not JSON") from None
    except UnicodeDecodeError:
        raise Malformed("is not JSON") from None


def _once_each(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise Malformed("names a part twice")
    return found


def _whole_number(text: str) -> int:
    if len(text) > DIGITS:
        raise Malformed(f"holds a number of over {DIGITS} digits")
    return int(text)


def _number(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise Malformed("holds a number that is not finite")
    return value


def _count(value: object) -> int:
    """Return a count of tokens; 0, which stands for unknown, for anything else."""
    if not isinstance(value, int) or isinstance(value, bool):
        return 0
    return value if 0 < value < MOST_COUNTED else 0
