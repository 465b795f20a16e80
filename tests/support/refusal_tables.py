"""Tables of refusals in text: a call, or a command, and what is said of it."""

import re
from itertools import product


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
