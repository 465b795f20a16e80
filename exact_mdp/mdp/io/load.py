"""Models by name or file, as on the command line.

A model is a shipped scenario (`yuan2025`), a file in one of the formats of `mdp.io.formats` by its
ending, `gymnasium:ID`, or `-`: a `.json` on standard input. `FILE.umb#NAME` chooses among the
reward models of a file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.care.toml import list_shipped_scenarios
from exact_mdp.mdp.errors import ModelError, require_type, suggest_name
from exact_mdp.mdp.io.files import STANDARD_INPUT
from exact_mdp.mdp.io.formats import (
    ENVIRONMENT,
    FORMATS,
    IN_MEMORY,
    PROGRAMS,
    WRITTEN_MODELS,
    Format,
    find_format,
    find_written_format,
    join_endings,
    split_part,
)
from exact_mdp.mdp.io.gymnasium import parse_options
from exact_mdp.mdp.model import MDP

GYMNASIUM = "gymnasium:"


@dataclass(frozen=True, kw_only=True)
class Loaded:
    """A model with its name, and the scenario from which it was compiled, if any."""

    name: str
    mdp: MDP
    scenario: Scenario | None


def read_model(spec: Any, **options: Any) -> Loaded:
    """Return the model that `spec` names; with the options of `load`.

    A given discount overrides `sets`. Raises ModelError if there is no such model.
    """
    text, reward = str(spec), None
    if hasattr(spec, "transition_matrix") and hasattr(spec, "labeling"):
        kind, source, text = IN_MEMORY, spec, "a model of Storm"
    elif isinstance(spec, str | os.PathLike):
        kind, source, reward = _find_model(text)
    else:
        fix = "give a name, a path, or a sparse model of Storm"
        raise ModelError(f"a {type(spec).__name__} is not a model", where="model", fix=fix)
    given = {name: each for name, each in options.items() if each is not None}
    if reward is not None:
        given["reward"] = reward
    if given.get("constants") and "constants" not in kind.options:
        fix = f"give a {join_endings(PROGRAMS)} file"
        raise ModelError("the model has no constants", where=text, fix=fix)
    sets = given.get("sets")
    if sets and "sets" not in kind.options:
        fix = "set values on a shipped scenario or a .toml file"
        if "discount" in sets[0]:
            fix += "; use --discount for the discount"
        what = f"{sets[0]!r} cannot be set: the model is not a scenario"
        raise ModelError(what, where=text, fix=fix)
    # The reader takes some of the options; the others change the model that it returns.
    taken = {name: given[name] for name in kind.options if name in given}
    if given.get("env"):
        if kind is not ENVIRONMENT:
            fix = f"give options of an environment with {GYMNASIUM}ID only"
            raise ModelError("the model is not an environment", where="--env", fix=fix)
        taken |= parse_options(given["env"])
        taken["name"] = " ".join([source, *(f"{n}={text}" for n, text in given["env"].items())])
    mdp = kind.read_file(source, **taken)
    scenario = None
    if isinstance(mdp, Scenario):
        scenario, mdp = mdp, mdp.compile()
    changes = given.keys() & {"discount", "start"} - {*kind.options}
    if changes:
        mdp = mdp.with_(**{name: given[name] for name in changes})
    return Loaded(name=mdp.name or Path(text).stem, mdp=mdp, scenario=scenario)


def _find_model(text: str) -> tuple[Format, str, str | None]:
    """Return the kind of model that a text names, the words for its reader, and a reward model."""
    file, reward = split_part(text, (".umb",))
    if reward is not None:
        return FORMATS[".umb"], file, reward
    if text in list_shipped_scenarios():
        return FORMATS[".toml"], text, None
    if text.startswith(GYMNASIUM):
        return ENVIRONMENT, text.removeprefix(GYMNASIUM), None
    kind = find_format(text, FORMATS)
    if text == STANDARD_INPUT:
        kind = FORMATS[".json"]
    if kind is None:
        raise _unknown_model_error(text)
    return kind, text, None


def load(
    spec: Any,
    *,
    sets: Sequence[str] = (),
    discount: object | None = None,
    start: object | None = None,
    constants: str | Mapping[str, object] | None = None,
) -> MDP:
    """Return the model that `spec` names.

    Parameters
    ----------
    spec : str, path, or a model of Storm
        A shipped scenario, or a file: see `MDP.load`; or what `stormpy.build_model` returns.
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
        If the model is unknown (the most similar name is suggested), or its file is damaged.

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
    find_written_format(path, WRITTEN_MODELS, "a model").write_file(model, path)


def _unknown_model_error(text: str) -> ModelError:
    """Return the error for a name or file that is not a model, with advice."""
    known = f"{join_endings(FORMATS)} file, or {GYMNASIUM}ID"
    if Path(text).is_file():
        return ModelError("unknown kind of model file", where=text, fix=f"give a {known}")
    if re.fullmatch(r"[\w/.:-]+-v\d+", text):
        name = re.sub("^gym(nasium)?:", "", text, flags=re.IGNORECASE)
        fix = f"did you mean {GYMNASIUM}{name}?"
    else:
        fix = f"{suggest_name(text, list_shipped_scenarios())} (or give a {known})"
    return ModelError(f"unknown model {text!r}", where="model", fix=fix)
