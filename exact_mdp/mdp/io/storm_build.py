"""A separate program that lets Storm build the model of a file, and prints JSON.

    python -P storm_build.py LANGUAGE FILE CONSTANTS BYTES

LANGUAGE is prism, jani or drn.

Storm runs in a separate process: a division by zero ends the process that computes it, and a model
may need more memory than there is. This program imports only stormpy and the standard library.
Standard output is one JSON object: the model; or `open`, the constants without values; or `kind`,
an unsupported type of model; or `said`, Storm's error message, with `memory`, whether it lacked
memory.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from contextlib import suppress
from itertools import accumulate
from typing import Any

KINDS = ("DTMC", "MDP")


def main(language: str, path: str, constants: str, most: str) -> None:
    """Print the model that Storm builds from a file."""
    answer = os.fdopen(os.dup(1), "w", encoding="ascii")
    os.dup2(2, 1)  # Storm's own output goes to standard error
    _leave_with_the_parent()
    _limit_memory(int(most))
    try:
        content = _build_model(language, path, constants)
    except MemoryError:
        content = {"said": "", "memory": True}
    except Exception as error:  # Storm raises several kinds, none of them meant for users
        content = {"said": str(error), "memory": "bad_alloc" in str(error)}
    with answer:
        json.dump(content, answer)


def _leave_with_the_parent() -> None:
    """End the process at once after Ctrl-C, and on Linux also after the end of the parent."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Python would wait until Storm returns
    with suppress(OSError, AttributeError):
        import ctypes

        ctypes.CDLL(None).prctl(1, signal.SIGKILL)  # PR_SET_PDEATHSIG


def _limit_memory(most: int) -> None:
    """Limit the memory of the process to `most` bytes, or to the present limit if it is lower."""
    allowed, hard = resource.getrlimit(resource.RLIMIT_AS)
    limits = [each for each in (most, allowed) if each != resource.RLIM_INFINITY]
    with suppress(OSError, ValueError):  # some systems have no such limit
        resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))


def _build_model(language: str, path: str, constants: str) -> dict[str, Any]:
    """Return the parts of Storm's sparse model, or the reason why there is none."""
    import stormpy

    if language == "drn":
        options = stormpy.developer.DirectEncodingParserOptions()
        options.build_choice_labeling = True
        model = stormpy.developer.build_explicit_drn_model[stormpy.Rational](path, options)
        if model.model_type.name not in KINDS:
            return {"kind": model.model_type.name}
        return list_model_parts(model)
    if language == "jani":
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
    options.set_exploration_checks(True)  # without it, values out of range become other values
    model = stormpy.build_model[stormpy.Rational](program, options=options)
    return list_model_parts(model)


def list_model_parts(model: Any) -> dict[str, Any]:
    """Return the parts of a model; numbers are indices of the list `numbers` of texts "p/q"."""
    # Equal numbers are written once.
    numbers: dict[Any, int] = {}

    def add_number(value: Any) -> int:
        return numbers.setdefault(value, len(numbers))

    # The rows of the transition matrix: a choice is a row, a branch an entry. All entries are read
    # at once: to begin with each row anew takes ten times as long.
    matrix, states = model.transition_matrix, range(model.nr_states)
    choices, entries = range(matrix.nr_rows), list(matrix)
    lengths = [len(matrix.get_row(choice)) for choice in choices]
    # Reward models, by state and by choice.
    rewards: dict[str, dict[str, list[int]]] = {}
    for name, own in model.reward_models.items():
        rewards[name] = {}
        if own.has_state_rewards:
            rewards[name]["states"] = [*map(add_number, own.state_rewards)]
        if own.has_state_action_rewards:
            rewards[name]["choices"] = [*map(add_number, own.state_action_rewards)]
    # Names of choices, labels, and the values of the variables in each state.
    labels, words = model.labeling, [""] * len(choices)
    if model.has_choice_labeling():
        named = model.choice_labeling
        words = [" ".join(sorted(named.get_labels_of_choice(choice))) for choice in choices]
    variables: list[Any] = []
    values: list[list[int | None]] = [[] for _ in states]
    if model.has_state_valuations():
        valuations = model.state_valuations
        variables = sorted(valuations.get_all_variables(), key=lambda variable: str(variable.name))
        for state in states:
            own = [valuations.get_value(state, variable) for variable in variables]
            values[state] = [*map(_integer_or_none, own)]
    return {
        "first_choice": [0, *map(matrix.get_row_group_end, states)],
        "first_branch": [0, *accumulate(lengths)],
        "targets": [entry.column for entry in entries],
        "chances": [add_number(entry.value) for entry in entries],
        "choice_words": words,
        "labels": {word: list(labels.get_states(word)) for word in labels.get_labels()},
        "rewards": rewards,
        "variables": [variable.name for variable in variables],
        "values": values,
        "numbers": [*map(str, numbers)],
        "exact": model.is_exact,
    }


def _integer_or_none(value: Any) -> int | None:
    """Return a whole number or a truth value; None for a value of another kind."""
    if isinstance(value, int):
        return value
    return None


if __name__ == "__main__":
    main(*sys.argv[1:])
