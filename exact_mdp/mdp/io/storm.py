"""PRISM programs and JANI models, built state by state by Storm in exact rationals (stormpy).

Every label, reward model and action of the model that Storm builds is kept, and the values of the
variables are the names of the states. Neither language has a discount: 1 unless it is given. What
Storm prints goes to standard error.

Sources: https://www.prismmodelchecker.org/manual/ThePRISMLanguage, https://jani-spec.org
"""

from __future__ import annotations

from fractions import Fraction
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, extra, located, shown_text
from exact_mdp.mdp.io.explicit import INITIAL, model_of, named_by
from exact_mdp.mdp.io.files import LARGE, aside, read_bytes
from exact_mdp.mdp.model import MDP

KINDS = ("DTMC", "MDP")


def load(
    path: str | Path,
    *,
    constants: str = "",
    discount: object | None = None,
    start: object = None,
) -> MDP:
    """Return the model that a PRISM program or a JANI model describes.

    `constants` gives values to those that are left open, such as "N=4,p=1/3". Raises ModelError
    where Storm is missing or refuses the program, or a constant is left open.
    """
    with located(str(path)):
        read_bytes(path, most=LARGE)  # a regular file, and not too large
        with aside():
            try:
                content = _content(_built(Path(path), constants))
            except ModelError:
                raise
            except Exception as error:  # Storm raises several kinds, none of them for users
                raise ModelError(
                    f"Storm says: {' '.join(str(error).split())[:300]}", fix="correct that place"
                ) from error
        content |= {"reward": None, "discount": 1 if discount is None else discount, "start": start}
        return model_of(shown_text(str(path)), name=Path(path).stem, **content)


def _built(path: Path, constants: str) -> Any:
    """Return Storm's sparse model, with all that the program names."""
    with extra("models"):
        import stormpy
    if path.suffix.lower() == ".jani":
        program = stormpy.parse_jani_model(str(path))[0]
    else:
        program = stormpy.parse_prism_program(str(path))
    if constants:
        program = stormpy.instantiate_constants(program, constants)[0]
    if program.has_undefined_constants:
        raise ModelError(
            "a constant has no value",
            fix="give all of them: --constants N=4,p=1/3",
        )
    options = stormpy.BuilderOptions()
    options.set_build_all_reward_models()
    options.set_build_all_labels()
    options.set_build_choice_labels(True)
    options.set_build_state_valuations(True)
    return stormpy.build_model[stormpy.Rational](program, options=options)


def _content(model: Any) -> dict[str, Any]:
    """Return what `model_of` makes a model of, by Storm's sparse model."""
    if model.model_type.name not in KINDS:
        raise ModelError(
            f"the model is a {model.model_type.name}",
            fix=f"give a {' or '.join(KINDS)}: no continuous time, nothing hidden",
        )
    matrix, states = model.transition_matrix, range(model.nr_states)
    rewards: dict[str, dict[str, list[Fraction]]] = {}
    for name, own in model.reward_models.items():
        if own.has_transition_rewards:
            raise ModelError(
                "rewards that depend on the next state",
                where=f"reward {name}",
                fix="give them to states, or to actions",
            )
        given = {"states": own.has_state_rewards and own.state_rewards}
        given["choices"] = own.has_state_action_rewards and own.state_action_rewards
        rewards[name] = {over: [*map(_fraction, each)] for over, each in given.items() if each}
    rows = [list(matrix.get_row(row)) for row in range(matrix.nr_rows)]
    words = [
        " ".join(sorted(model.choice_labeling.get_labels_of_choice(row)))
        for row in range(matrix.nr_rows)
    ]
    names = [*dict.fromkeys(words)]
    listed = {word: list(model.labeling.get_states(word)) for word in model.labeling.get_labels()}
    variables = sorted(model.state_valuations.get_all_variables(), key=lambda v: str(v.name))
    values = (
        {v.name: model.state_valuations.get_value(state, v) for v in variables} for state in states
    )
    return {
        "first_choice": [0, *map(matrix.get_row_group_end, states)],
        "first_branch": [0, *accumulate(map(len, rows))],
        "targets": [entry.column for row in rows for entry in row],
        "chances": [_fraction(entry.value) for row in rows for entry in row],
        "actions": [*map(names.index, words)] if all(words) else (),
        "action_names": names,
        "words": named_by(values),
        "initial": listed.pop(INITIAL, []),
        "rewards": rewards,
        "labels": {word: np.isin(states, on) for word, on in sorted(listed.items()) if on},
    }


def _fraction(value: Any) -> Fraction:
    return Fraction(int(str(value.numerator)), int(str(value.denominator)))
