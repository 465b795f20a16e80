"""The table of questions: what becomes of each analysis and question, over many models.

`python -m questions.table [MODELS]`, run in tests/, asks every analysis every question about so
many random models and writes how many were answered and how many refused into table.toml, of which
`make docs` makes the page "What can be asked". A mismatch is printed, and nothing is written then.
"""

from __future__ import annotations

import sys
import tomllib
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from random import Random

from exact_mdp import ModelError, SolverError

from .analyses import ANALYSES, Mismatch
from .models import QUESTIONS, Case, Question

PATH = Path(__file__).with_name("table.toml")
NAMED = {question.name: question for question in QUESTIONS}
MODELS = 200


def outcome(analysis: str, question: Question, number: int) -> str:
    """Return "answered" or "refused" of one model; raises Mismatch for a wrong answer."""
    rng = Random(f"{question.name} {number}")
    case = Case.random(rng, question)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            ANALYSES[analysis](case, rng)
        except (ModelError, SolverError) as error:
            if not str(error):
                raise Mismatch("a refusal without words") from error
            return "refused"
        except TypeError as error:  # an option that the analysis does not have
            if question.options and "unexpected keyword argument" in str(error):
                return "refused"
            raise
    return "answered"


def cell(analysis: str, question: str, first: int, last: int) -> tuple[int, int]:
    """Return how many of some models were answered, and how many refused."""
    counts = {"answered": 0, "refused": 0}
    for number in range(first, last):
        try:
            counts[outcome(analysis, NAMED[question], number)] += 1
        except Exception as error:
            error.add_note(f"{analysis}, {question}, model {number}")
            raise
    return counts["answered"], counts["refused"]


def read() -> dict[str, dict[str, list[int]]]:
    """Return [answered, refused] by analysis and question."""
    return tomllib.loads(PATH.read_text("utf-8"))


def main(models: int) -> Iterator[str]:
    """Yield the lines of table.toml."""
    cells = list(product(ANALYSES, NAMED))
    with ProcessPoolExecutor(2) as pool:
        each = [pool.submit(cell, *names, 0, models) for names in cells]
        for (analysis, question), counted in zip(cells, each, strict=True):
            if question == next(iter(NAMED)):
                yield f"\n[{analysis}]"
            yield f'"{question}" = {list(counted.result())}'
            print(analysis, question, *counted.result(), file=sys.stderr, flush=True)


if __name__ == "__main__":
    models = int(sys.argv[1]) if len(sys.argv) > 1 else MODELS
    lines = [
        "# Models answered and refused; written by `python -m questions.table`.",
        *main(models),
    ]
    PATH.write_text("\n".join(lines) + "\n", "utf-8")
