"""What is refused: a call and what is said of it, alone or in tables of text.

    call -> what; where; fix

is a row of a table: words of each part of the error, or =all of them. The last parts, or all, may
be left out. Indented lines continue a row; # opens a comment. <one|other> in a call stands for a
row with each, and * in the words for the first of these.
"""

import re
from collections.abc import Callable
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import pytest

import exact_mdp
from exact_mdp import ModelError


def entries(test: str, **words: str) -> list[tuple[str, str]]:
    """Return the rows of the table beside a test, of the same name, some words of it replaced."""
    table = re.sub(r"\n {4}", " ", Path(test).with_suffix(".txt").read_text("utf-8"))
    for short, text in words.items():
        table = table.replace(short, text)
    rows = []
    for row in table.splitlines():
        if not row or row.startswith("#"):
            continue
        call, _, said = row.rpartition(" ->")
        parts = re.split(r"<([^<>]*\|[^<>]*)>", call)  # text and choices take turns
        choices = [part.split("|") if k % 2 else [part] for k, part in enumerate(parts)]
        for chosen in product(*choices):
            filled = said.replace("*", chosen[1]) if chosen[1:] else said
            rows.append(("".join(chosen), filled.lstrip()))
    return rows


def table_of_refusals(
    test: str, names: dict[str, Any], kinds: dict[str, type] | None = None, **words: str
) -> Callable[..., None]:
    """Return a test of every call of the table beside it, in public names and its own.

    An error is of the type in `kinds` whose key occurs in its words, else a ModelError. Without
    `kinds` each error says where.
    """

    @pytest.mark.parametrize(("call", "said"), entries(test, **words))
    def refusals(call: str, said: str) -> None:
        public = {name: getattr(exact_mdp, name) for name in vars(exact_mdp)["__all__"]}
        known = {"np": np, "pd": pd} | public | names
        what, *more = said.split("; ", 2)
        error = refused(lambda: eval(call, known), what, *more)
        kind = [each for words, each in (kinds or {}).items() if words in what]
        assert error.where or kinds
        assert isinstance(error, kind[0] if kind else ModelError)

    return refusals


def of_file(name: str, text: str, read: Callable[[Path], Any]) -> Any:
    """What is read from a file of this name and text."""
    with TemporaryDirectory() as folder:
        (path := Path(folder) / name).write_text(text, "utf-8")
        return read(path)


def refused(call: Callable[[], object], *said: str) -> ModelError:
    """Assert that a call is refused, in these words of what, where and fix; return the error."""
    with pytest.raises(ModelError) as caught:
        call()
    error = caught.value
    for words, text in zip(said, (error.what, error.where, error.fix), strict=False):
        assert words == f"={text}" if words.startswith("=") else words in text
    assert error.fix
    return error
