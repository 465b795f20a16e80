"""Models by name or file, as on the command line.

A model is a shipped scenario (`yuan2025`), a scenario file (`.toml`), a saved model (`.npz`,
`.json`), a model checker's file (`.umb`; `.umb#NAME` chooses among its reward models), its source
(`.prism`, `.jani`, which Storm builds), `gymnasium:ID`, or `-`: a `.json` on standard input.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.care.toml import is_scenario, list_shipped_scenarios
from exact_mdp.mdp.errors import ModelError, locate_errors, require_type, suggest_name
from exact_mdp.mdp.io import model_json, npz, storm, umb
from exact_mdp.mdp.io.files import STANDARD_INPUT
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import exact

GYMNASIUM = "gymnasium:"
SOURCES = (".prism", ".nm", ".pm", ".jani")
WRITERS = {".npz": npz.write_npz, ".umb": umb.write_umb, ".json": model_json.write_model_json}
FILES = (".toml", ".npz", ".umb", ".json", *SOURCES)


@dataclass(frozen=True, kw_only=True)
class Loaded:
    """A model with its name, and the scenario from which it was compiled, if any."""

    name: str
    mdp: MDP
    scenario: Scenario | None


def read_model(
    spec: str | Path,
    *,
    sets: Sequence[str] = (),
    discount: object | None = None,
    start: object | None = None,
    constants: str | Mapping[str, object] | None = None,
) -> Loaded:
    """Return the model that `spec` names; see `load`. Raises ModelError if there is none.

    A given discount overrides `sets`.
    """
    # FILE.umb#NAME chooses a reward model of the file.
    text = str(spec)
    file, reward = text, None
    named = re.fullmatch(r"(?s)(.*\.umb)#(.*)", text, re.IGNORECASE)
    if named:
        file, reward = named.groups()
    suffix, scenario = Path(file).suffix.lower(), None
    if constants and suffix not in SOURCES:
        fix = f"give a {' or '.join(SOURCES)} file"
        raise ModelError("the model has no constants", where=text, fix=fix)
    # A scenario takes changes by name; other models take only discount and start.
    if is_scenario(text):
        scenario = Scenario.load(text)
        for assignment in require_type(sets, Sequence, "sets", 'give ["KEY=VALUE", …]'):
            scenario = scenario.set(require_type(assignment, str, "sets", 'give "KEY=VALUE"'))
        if discount is not None:
            scenario = scenario.with_(discount=discount)
        mdp = scenario.compile()
    elif sets and (text.startswith(GYMNASIUM) or text == STANDARD_INPUT or suffix in FILES):
        fix = "set values on a shipped scenario or a .toml file"
        if "discount" in sets[0]:
            fix += "; use --discount for the discount"
        what = f"{sets[0]!r} cannot be set: the model is not a scenario"
        raise ModelError(what, where=text, fix=fix)
    elif text.startswith(GYMNASIUM):
        # Without a start, the environment says where episodes begin.
        names: dict[str, Any] = {}
        if start is not None:
            names["start"] = start
        if discount is not None:
            names["discount"] = discount
        mdp = MDP.from_gymnasium(text.removeprefix(GYMNASIUM), **names)
    # Files of model checkers, then our own.
    elif suffix == ".umb":
        mdp = umb.read_umb(file, discount=discount, reward=reward, start=start)
    elif suffix in SOURCES:
        mdp = storm.read_program(
            text, constants=_format_constants(constants), discount=discount, start=start
        )
    elif suffix in (".npz", ".json") or text == STANDARD_INPUT:
        if suffix == ".npz":
            mdp = npz.read_npz(text)
        else:
            mdp = model_json.read_model_json(text)
        if discount is not None:
            mdp = mdp.with_(discount=discount)
    else:
        raise _unknown_model_error(text)
    if start is not None:
        mdp = mdp.with_(start=start)
    return Loaded(name=mdp.name or Path(text).stem, mdp=mdp, scenario=scenario)


def load(
    spec: str | Path,
    *,
    sets: Sequence[str] = (),
    discount: object | None = None,
    start: object | None = None,
    constants: str | Mapping[str, object] | None = None,
) -> MDP:
    """Return the model that `spec` names.

    Parameters
    ----------
    spec : str or path
        A shipped scenario, or a file: see `MDP.load`.
    sets : sequence of "KEY=VALUE"
        Changes to a scenario, in order.
    discount : number or "p/q", optional
        The discount to use instead of the model's own.
    start : state, {state: probability} or (S,) vector, optional
        The initial distribution to use instead of the model's own.
    constants : {name: number} or "N=4,p=1/3", optional
        Values of the constants that a `.prism` or `.jani` file leaves open; a float is the decimal
        that it prints as.

    Returns
    -------
    MDP

    Raises
    ------
    ModelError
        If there is no such model (the most similar name is suggested), or its file is damaged.

    Examples
    --------
    >>> from exact_mdp import load
    >>> load("yuan2025", sets=["tasks=[1]"]).n_states
    81
    """
    return read_model(spec, sets=sets, discount=discount, start=start, constants=constants).mdp


def save(model: MDP, path: str | Path) -> None:
    """Write a model as `.npz`, `.umb` (for model checkers) or `.json`, by the file's extension.

    Parameters
    ----------
    model : MDP
    path : str or path

    Raises
    ------
    ModelError
        For another extension, and if the path cannot be written to.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from exact_mdp import MDP, load, save
    >>> with TemporaryDirectory() as folder:
    ...     save(MDP.from_arrays([[[1]]], ["1/2"], discount="1/2"), f"{folder}/one.json")
    ...     load(f"{folder}/one.json").n_states
    1
    """
    fix = "write save(model, path), or model.save(path); a scenario is compiled first"
    require_type(model, MDP, "save", fix)
    require_type(path, str | Path, "save", fix)
    suffix = Path(path).suffix.lower()
    if suffix not in WRITERS:
        what = f"cannot write a model as {suffix or 'a file without extension'}"
        raise ModelError(what, where=str(path), fix="name it .npz, .umb or .json")
    WRITERS[suffix](model, path)


def _format_constants(constants: str | Mapping[str, object] | None) -> str:
    """Return the values of constants as text: "N=4,p=1/3"; a float is the decimal it prints as."""
    if isinstance(constants, str | None):
        return constants or ""
    given = require_type(constants, Mapping, "constants", "give {name: number}")
    assigned = []
    with locate_errors("constants"):
        for name, value in given.items():
            if isinstance(value, bool | np.bool_):
                number = str(value).lower()
            elif isinstance(value, float | np.floating):
                number = str(exact(str(value)))
            else:
                number = str(exact(value))
            assigned.append(f"{name}={number}")
    return ",".join(assigned)


def _unknown_model_error(text: str) -> ModelError:
    """Return the error for a name or file that is not a model, with advice."""
    known = f"{', '.join(FILES)} file, or {GYMNASIUM}ID"
    if Path(text).is_file():
        return ModelError("unknown kind of model file", where=text, fix=f"give a {known}")
    if re.fullmatch(r"[\w/.:-]+-v\d+", text):
        name = re.sub("^gymnasium:", "", text, flags=re.IGNORECASE)
        fix = f"did you mean {GYMNASIUM}{name}?"
    else:
        fix = f"{suggest_name(text, list_shipped_scenarios())} (or give a {known})"
    return ModelError(f"unknown model {text!r}", where="model", fix=fix)
