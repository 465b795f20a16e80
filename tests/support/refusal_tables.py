"""Tables of refusals in text: a call, or a command, and what is said of it."""

import re


def entries(table: str) -> list[tuple[str, str]]:
    """Return the rows `call -> said` of a table; indented lines go on.

    <one|other> in a call stands for a row with each, and * in what is said for the one.
    """
    rows = []
    for row in re.sub(r"\n {4}", " ", table).strip().splitlines():
        call, _, said = row.rpartition(" -> ")
        some = re.search(r"<([^<>]*\|[^<>]*)>", call)
        for one in some[1].split("|") if some else [""]:
            rows.append((call.replace(some[0], one) if some else call, said.replace("*", one)))
    return rows
