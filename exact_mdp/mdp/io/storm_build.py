"""What Storm makes of a PRISM program or a JANI model, as JSON: a program of its own.

    python -P storm_build.py FILE CONSTANTS BYTES

Storm runs in a process apart: an expression that divides by zero ends the process that computes it,
and a model may need more memory than there is. This program imports stormpy and the standard
library alone. Standard output is one JSON object: the model; or `open`, the constants that have no
value; `kind`, a type of model that is none of ours; or `said`, what Storm refuses, with `memory`,
whether it had too little.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from contextlib import suppress
from itertools import accumulate
from pathlib import Path
from typing import Any

KINDS = ("DTMC", "MDP")
DIES_WITH_PARENT = 1  # PR_SET_PDEATHSIG of Linux


def main(path: str, constants: str, most: str) -> None:
    """Print what Storm makes of a file."""
    answer = os.fdopen(os.dup(1), "w", encoding="ascii")
    os.dup2(2, 1)  # what Storm prints is no part of the answer
    _leave_with_the_parent()
    _limit_memory(int(most))
    try:
        content = _build_model(path, constants)
    except MemoryError:
        content = {"said": "", "memory": True}
    except Exception as error:  # Storm raises several kinds, none of them for users
        content = {"said": str(error), "memory": "bad_alloc" in str(error)}
    with answer:
        json.dump(content, answer)


def _leave_with_the_parent() -> None:
    """Let Ctrl-C end the process at once, and on Linux the end of the parent as well."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Python would wait until Storm returns
    with suppress(OSError, AttributeError):
        import ctypes

        ctypes.CDLL(None).prctl(DIES_WITH_PARENT, signal.SIGKILL)


def _limit_memory(most: int) -> None:
    """Let no more than `most` bytes of memory be taken, or what is allowed already."""
    allowed, hard = resource.getrlimit(resource.RLIMIT_AS)
    limits = [each for each in (most, allowed) if each != resource.RLIM_INFINITY]
    with suppress(OSError, ValueError):  # a system that knows no such limit
        resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))


def _build_model(path: str, constants: str) -> dict[str, Any]:
    """Return Storm's sparse model with all that the file names, or what is in its way."""
    import stormpy

    if Path(path).suffix.lower() == ".jani":
        program = stormpy.parse_jani_model(path)[0]
    else:
        program = stormpy.parse_prism_program(path, prism_compatibility=True)
    if program.model_type.name not in KINDS:
        return {"kind": program.model_type.name}
    if constants:
        program = stormpy.instantiate_constants(program, constants)[0]
    if program.has_undefined_constants:
        return {"open": [each.name for each in program.constants if not each.defined]}
    options = stormpy.BuilderOptions()
    options.set_build_all_reward_models()
    options.set_build_all_labels()
    options.set_build_choice_labels(True)
    options.set_build_state_valuations(True)
    options.set_exploration_checks(True)  # else a value out of its range becomes another value
    model = stormpy.build_model[stormpy.Rational](program, options=options)
    return _list_model_parts(model)


def _list_model_parts(model: Any) -> dict[str, Any]:
    """Return the parts of a model; numbers are places in the list `numbers` of texts "p/q"."""
    numbers: dict[str, int] = {}

    def add_number(value: Any) -> int:
        return numbers.setdefault(str(value), len(numbers))

    matrix, states = model.transition_matrix, range(model.nr_states)
    choices = range(matrix.nr_rows)
    rows = [
        [(entry.column, add_number(entry.value)) for entry in matrix.get_row(c)] for c in choices
    ]
    rewards: dict[str, dict[str, list[int]]] = {}
    for name, own in model.reward_models.items():
        rewards[name] = {}
        if own.has_state_rewards:
            rewards[name]["states"] = [*map(add_number, own.state_rewards)]
        if own.has_state_action_rewards:
            rewards[name]["choices"] = [*map(add_number, own.state_action_rewards)]
    words, labels, valuations = model.choice_labeling, model.labeling, model.state_valuations
    variables = sorted(valuations.get_all_variables(), key=lambda variable: str(variable.name))
    return {
        "first_choice": [0, *map(matrix.get_row_group_end, states)],
        "first_branch": [0, *accumulate(map(len, rows))],
        "targets": [target for row in rows for target, _ in row],
        "chances": [chance for row in rows for _, chance in row],
        "choice_words": [" ".join(sorted(words.get_labels_of_choice(c))) for c in choices],
        "labels": {word: list(labels.get_states(word)) for word in labels.get_labels()},
        "rewards": rewards,
        "variables": [variable.name for variable in variables],
        "values": [
            [_integer_or_none(valuations.get_value(state, variable)) for variable in variables]
            for state in states
        ],
        "numbers": [*numbers],
    }


def _integer_or_none(value: Any) -> int | None:
    """Return a whole number or a truth value; None for a value of another kind."""
    return value if isinstance(value, int) else None


if __name__ == "__main__":
    main(*sys.argv[1:])
