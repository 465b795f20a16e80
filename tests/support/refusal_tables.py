"""What is refused, and tables of it in text: a call, or a command, and what is said of it."""

import re
from collections.abc import Callable
from itertools import product

import pytest

from exact_mdp import ModelError


def entries(table: str) -> list[tuple[str, str]]:
    """Return the rows `call -> said` of a table; indented lines go on.

    <one|other> in a call stands for a row with each, and * in what is said for the first of these.
    """
    rows = []
    for row in re.sub(r"\n {4}", " ", table).strip().splitlines():
        call, _, said = row.rpartition(" -> ")
        parts = re.split(r"<([^<>]*\|[^<>]*)>", call)  # text and choices take turns
        choices = [part.split("|") if k % 2 else [part] for k, part in enumerate(parts)]
        for words in product(*choices):
            rows.append(("".join(words), said.replace("*", words[1]) if words[1:] else said))
    return rows


def refused(call: Callable[[], object], *said: str) -> ModelError:
    """Assert that a call is refused, in these words of what, where and fix; return the error."""
    with pytest.raises(ModelError) as caught:
        call()
    error = caught.value
    for words, text in zip(said, (error.what, error.where, error.fix), strict=False):
        assert words in text
    assert error.fix
    return error
