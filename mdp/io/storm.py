"""PRISM programs and JANI models, built state by state by Storm in exact rationals (stormpy).

Storm writes the model as DRN, which `mdp.io.drn` reads: every label, reward model and action, and
as names of states the values of their variables. Neither language has a discount: 1 unless it is
given. What Storm prints goes to standard error.

Sources: https://www.prismmodelchecker.org/manual/ThePRISMLanguage, https://jani-spec.org
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.io import drn
from exact_mdp.mdp.io.files import LARGE, LARGEST, read_bytes, read_text
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP

stormpy = later("stormpy")


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
        with tempfile.TemporaryDirectory() as folder, _said_elsewhere():
            file = Path(folder) / f"{Path(path).stem}.drn"
            try:
                stormpy.io.export_to_drn(_built(Path(path), constants), str(file))
            except Exception as error:  # Storm raises several kinds, none of them for users
                if isinstance(error, ModelError):
                    raise
                raise ModelError(
                    f"Storm says: {' '.join(str(error).split())[:300]}", fix="correct that place"
                ) from error
            rate, text = 1 if discount is None else discount, read_text(file, most=LARGEST)
            return drn.of_text(text, path, reward=None, discount=rate, start=start)


def _built(path: Path, constants: str) -> Any:
    """Return Storm's sparse model, with all that the program names."""
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


@contextmanager
def _said_elsewhere() -> Iterator[None]:
    """Send what a library prints to standard error: standard output holds results alone."""
    sys.stdout.flush()
    kept = os.dup(1)
    try:
        os.dup2(2, 1)
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
