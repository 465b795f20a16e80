"""PRISM programs and JANI models, built state by state by Storm in exact rationals (stormpy).

Every label, reward model and action of the model that Storm builds is kept, and the values of the
variables are the names of the states. Neither language has a discount: 1 unless it is given. What
Storm prints goes to standard error.

Sources: https://www.prismmodelchecker.org/manual/ThePRISMLanguage, https://jani-spec.org
"""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, extra, located, shown_text
from exact_mdp.mdp.io.explicit import INITIAL, Explicit, model_of, named_by
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
                explicit = _explicit(_built(Path(path), constants), Path(path).stem)
            except Exception as error:  # Storm raises several kinds, none of them for users
                if isinstance(error, ModelError):
                    raise
                raise ModelError(
                    f"Storm says: {' '.join(str(error).split())[:300]}", fix="correct that place"
                ) from error
        rate, where = 1 if discount is None else discount, shown_text(str(path))
        return model_of(explicit, where, reward=None, discount=rate, start=start)


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


def _explicit(model: Any, name: str) -> Explicit:
    """Return the choices, branches, rewards, labels and names of Storm's sparse model."""
    if model.model_type.name not in KINDS:
        raise ModelError(
            f"the model is a {model.model_type.name}",
            fix=f"give a {' or '.join(KINDS)}: no continuous time, nothing hidden",
        )
    matrix, states = model.transition_matrix, range(model.nr_states)
    ends = [matrix.get_row_group_end(state) for state in states]
    rows = [
        [(entry.column, _fraction(entry.value)) for entry in matrix.get_row(row)]
        for row in range(matrix.nr_rows)
    ]
    branches = [entry for row in rows for entry in row]
    offsets = np.array([0, *ends], dtype=np.int64)
    words = [
        " ".join(sorted(model.choice_labeling.get_labels_of_choice(r))) for r in range(len(rows))
    ]
    names = tuple(dict.fromkeys(words))
    given = np.array([names.index(word) for word in words], dtype=np.int64)
    listed = {word: list(model.labeling.get_states(word)) for word in model.labeling.get_labels()}
    flags = {word: np.isin(states, on) for word, on in sorted(listed.items()) if on}
    rewards = {word: _rewards(word, own) for word, own in model.reward_models.items()}
    variables = sorted(model.state_valuations.get_all_variables(), key=lambda v: str(v.name))
    values = (
        {v.name: model.state_valuations.get_value(state, v) for v in variables} for state in states
    )
    return Explicit(
        name=name,
        state_to_choices=offsets,
        choice_to_branches=np.cumsum([0, *map(len, rows)]),
        target=[target for target, _ in branches],
        probability=[chance for _, chance in branches],
        actions=given if all(words) else None,
        action_names=names,
        initial=flags.pop(INITIAL, np.zeros(len(states), dtype=bool)),
        words=named_by(values),
        rewards=rewards,
        labels=flags,
    )


def _rewards(name: str, model: Any) -> dict[str, list[Fraction]]:
    """Return the rewards of a reward model, of states and of choices."""
    if model.has_transition_rewards:
        raise ModelError(
            "rewards that depend on the next state",
            where=f"reward {name}",
            fix="give them to states, or to actions",
        )
    by_name = {}
    if model.has_state_rewards:
        by_name["states"] = [_fraction(value) for value in model.state_rewards]
    if model.has_state_action_rewards:
        by_name["choices"] = [_fraction(value) for value in model.state_action_rewards]
    return by_name


def _fraction(value: Any) -> Fraction:
    return Fraction(int(str(value.numerator)), int(str(value.denominator)))
