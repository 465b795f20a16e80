"""PRISM programs and JANI models, built state by state by Storm in exact rationals (stormpy).

Storm reads its explicit files (.drn), too, and a model that it holds in memory is taken as it is.

All labels (also those without states, `init` and `deadlock`), reward models and actions of the
model that Storm builds are kept. A choice without an action is called "unnamed"; the second choice
of a state with the action `go` is `go#2`. States are named by the values of the variables. Neither
language has a discount: it is 1 by default. The output of Storm goes to standard error. Storm runs
in a separate process, with at most a quarter of the machine's memory and at most 10 GB.

Probabilities and rewards are exact. Real numbers in a guard, an assignment or the condition of an
expression (`p > 0.3`, `x = 1/3 ? …`) are compared as doubles by Storm: numbers that differ by less
are equal there, and a proof is about the model that Storm built. Rewrite such conditions with whole
numbers. A JANI reward with different amounts for the destinations of one edge is refused, because
Storm replaces them by one expected amount: means would be right, but variances wrong.

Sources: https://www.prismmodelchecker.org/manual/ThePRISMLanguage, https://jani-spec.org
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import (
    ModelError,
    locate_errors,
    require_extra,
    require_type,
    shown_text,
)
from exact_mdp.mdp.forms.names import find_free_name
from exact_mdp.mdp.io.explicit import INITIAL, build_explicit_model, name_states
from exact_mdp.mdp.io.files import LARGE, read_text
from exact_mdp.mdp.io.storm_build import KINDS, list_model_parts
from exact_mdp.mdp.io.structured import json_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import MOST_BYTES, exact

PROGRAM = Path(__file__).with_name("storm_build.py")
SAID = re.compile(r"ERROR \(\w+\.cpp:\d+\): (.*)")  # an error in Storm's log
PLACE = re.compile(r"\b(line \d+|\d+:\d+)")
DECLARED = r"\b{}\s*:\s*(\[|bool\b|int\b)"
LOCATION = "_loc_"  # the beginning of Storm's names for locations of automata
SMALLER = "give smaller values to its constants, or a smaller model"


def read_program(
    language: str,
    path: str | Path,
    *,
    constants: str | Mapping[str, object] = "",
    discount: object = 1,
    start: object = None,
) -> MDP:
    """Return the model of a file in a language: "prism", "jani", or "drn" of Storm itself.

    `constants` gives values to open constants, such as "N=4,p=1/3". Raises ModelError if Storm is
    missing or refuses the program, or if a constant is still open.
    """
    assigned = _format_constants(constants)
    with locate_errors(str(path)):
        text = read_text(path, most=LARGE)  # a regular file, and not too large
        declared = []
        if language == "jani":
            declared = _list_variables(text, str(path))
        built = _run_storm(language, Path(path), assigned)
        # Variables in the order of the file; locations of automata come last.
        known: list[str] = built["variables"]
        if language == "jani":
            order = [name for name in declared if name in known]
            order += [name for name in known if name.startswith(LOCATION)]
        else:
            order = _in_order(known, text)
        content = _convert_parts(built, order) | {"discount": discount, "start": start}
        return build_explicit_model(shown_text(str(path)), name=Path(path).stem, **content)


read_prism, read_jani = partial(read_program, "prism"), partial(read_program, "jani")


def read_drn(path: str | Path, *, discount: object = 1, start: object = None) -> MDP:
    """Return the model of an explicit file of Storm, which has no constants."""
    return read_program("drn", path, discount=discount, start=start)


def read_storm_model(model: Any, *, discount: object = 1, start: object = None) -> MDP:
    """Return the model of a sparse model of Storm in memory."""
    fix = "give a DTMC or MDP that Storm has built"
    kind = getattr(getattr(model, "model_type", None), "name", None)
    if kind not in KINDS:
        raise ModelError(f"{kind or type(model).__name__} cannot be taken", where="model", fix=fix)
    built = list_model_parts(model)
    content = _convert_parts(built, built["variables"])
    return build_explicit_model("model", name="", discount=discount, start=start, **content)


def _format_constants(constants: str | Mapping[str, object]) -> str:
    """Return the values of constants as text: "N=4,p=1/3"; a float is the decimal it prints as."""
    if isinstance(constants, str):
        return constants
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


# ---- the separate process ------------------------------------------------------------------------


def _run_storm(language: str, path: Path, constants: str) -> dict[str, Any]:
    """Return the model of a file as `storm_build.py` prints it; raise ModelError if it fails."""
    with require_extra("models"):
        if find_spec("stormpy") is None:
            raise ModuleNotFoundError(name="stormpy")
    most = _most_memory()
    # After a signal such as Ctrl-C, `run` kills the process before it raises.
    done = subprocess.run(
        [sys.executable, "-P", str(PROGRAM), language, str(path), constants, str(most)],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        check=False,
    )
    printed = done.stderr.decode("utf-8", "replace")
    built = None
    if done.returncode == 0:
        built = json.loads(done.stdout)
    # Turn each kind of failure into an error of its own.
    too_little = "Cannot allocate memory" in printed or "bad_alloc" in printed
    if (built or {}).get("memory") or (built is None and too_little):
        raise ModelError(f"Storm needs more than {most / 1e9:.2g} GB of memory", fix=SMALLER)
    if built is None:
        raise _exit_error(done.returncode, printed)
    if "said" in built:
        raise _storm_error(built["said"], printed)
    if "open" in built:
        raise _left_open(path, built["open"], constants)
    if "kind" in built:
        fix = "give a DTMC or MDP: nothing hidden, and rates uniformised first"
        raise ModelError(f"the model is a {built['kind']}", fix=fix)
    sys.stderr.write(printed)
    return dict(built)


def _most_memory() -> int:
    """Return the number of bytes that Storm may use.

    The parts read from Storm's model need about as much memory again, and so does the model made
    from them. So Storm may use a quarter of the machine's memory, and no more than a table may.
    """
    whole = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return min(MOST_BYTES, whole // 4)


def _exit_error(status: int, printed: str) -> ModelError:
    """Return the error for a process of Storm that ended without an answer."""
    if -status == signal.SIGFPE:
        fix = "correct the expression that divides by 0, or the constant that makes it do so"
        return ModelError("an expression divides by zero, which ends Storm", fix=fix)
    name = f"exit status {status}"
    if status < 0:
        name = signal.Signals(-status).name
    last = " ".join(printed.split("\n")[-3:]).strip()[-200:]
    fix = "try the file in Storm itself: this is a fault of Storm, or of its installation"
    return ModelError(f"Storm ended with {name}: {last or 'without a message'}", fix=fix)


def _storm_error(said: str, printed: str) -> ModelError:
    """Return the error for a file that Storm refuses, in Storm's words unless they are unclear."""
    # Known messages that do not tell a user what to do.
    if "<model type>" in said:
        what = "the file does not begin with the type of the model"
        return ModelError(what, fix='write "mdp" or "dtmc" in its first line')
    if "transition rewards" in said:
        fix = "give them to states, or to actions"
        return ModelError("rewards depend on the next state", fix=fix)
    if "bad_any_cast" in said or "Exponent of power" in said:
        what = "Storm cannot compute an expression in exact rationals"
        fix = "write a number where the file has mod(…), log(…), a root or another such function"
        return ModelError(what, fix=fix)
    logged = SAID.findall(printed)
    if said in ("", "std::exception") and logged:
        said = logged[-1]
    said = " ".join(said.split())[:300]
    if "constant definition string" in said:
        fix = "write NAME=NUMBER, separated by commas, of constants that the file leaves open"
        return ModelError(f"Storm says: {said}", where="constants", fix=fix)
    fix = "correct the part of the file that this names"
    if PLACE.search(said):
        fix = "correct that place"
    return ModelError(f"Storm says: {said}", fix=fix)


def _left_open(path: Path, names: list[str], constants: str) -> ModelError:
    """Return the error for constants without values, with a command that gives them."""
    what = f"the constant {names[0]} has no value"
    if len(names) > 1:
        what = f"the constants {', '.join(names)} have no values"
    assigned = [f"{name}=…" for name in names]
    if constants:
        assigned.insert(0, constants)
    given = ",".join(assigned)
    return ModelError(
        what,
        fix=f"give their values: --constants {shown_text(given)}; in Python, "
        "MDP.load(path, constants={name: number})",
    )


# ---- the answer of the process -------------------------------------------------------------------


def _convert_parts(built: Mapping[str, Any], order: list[str]) -> dict[str, Any]:
    """Return the parts of an explicit model; states are named by the variables in `order`."""
    # Numbers of a model in doubles are floats, which print as the shortest decimals.
    numbers: list[Any] = [*map(exact if built["exact"] else float, built["numbers"])]
    states = range(len(built["first_choice"]) - 1)
    listed: dict[str, list[int]] = built["labels"]
    places = {name: place for place, name in enumerate(built["variables"])}
    shown = ({name: values[places[name]] for name in order} for values in built["values"])
    rewards: dict[str, dict[str, list[Any]]] = {}
    for given, each in built["rewards"].items():
        name = given or find_free_name("unnamed", built["rewards"])
        rewards[name] = {}
        for over, own in each.items():
            rewards[name][over] = [numbers[place] for place in own]
    return {
        "first_choice": built["first_choice"],
        "first_branch": built["first_branch"],
        "targets": built["targets"],
        "chances": [numbers[place] for place in built["chances"]],
        "choice_words": built["choice_words"],
        "words": name_states(shown),
        "initial": listed.get(INITIAL, []),
        "rewards": rewards,
        "labels": {word: np.isin(states, on) for word, on in sorted(listed.items())},
    }


def _in_order(names: list[str], program: str) -> list[str]:
    """Return the variables of a PRISM program in the order of their declarations.

    Variables of renamed modules have no declarations; they follow in the order of their first use.
    """

    def find_place(name: str) -> tuple[bool, int]:
        found = re.search(DECLARED.format(name), program)
        named = found or re.search(rf"\b{name}\b", program)
        if named is None:
            return True, len(program)
        return found is None, named.start()

    return sorted(names, key=find_place)


# ---- declarations of a JANI model ----------------------------------------------------------------


def _list_variables(text: str, where: str) -> list[str]:
    """Return the names of the variables of a state, in the order of the file.

    Raises ModelError if the destinations of an edge have different rewards.
    """
    content = json_of(text, where)
    automata = [each for each in _list_objects(content, "automata") if isinstance(each, dict)]
    variables = [*_list_objects(content, "variables")]
    for own in automata:
        variables += _list_objects(own, "variables")
    rewards = {each.get("name") for each in variables if _is_reward(each)}
    for own in automata:
        for number, edge in enumerate(_list_objects(own, "edges")):
            _check_destinations(edge, rewards, f"automaton {own.get('name')}, edge {number}")
    names = []
    for each in variables:
        if each.get("transient") is not True:
            names.append(str(each.get("name")))
    return names


def _list_objects(content: Any, key: str) -> Iterator[dict[str, Any]]:
    """Yield the objects of a list; Storm refuses anything else."""
    if isinstance(content, dict):
        for each in content.get(key) or ():
            if isinstance(each, dict):
                yield each


def _is_reward(variable: dict[str, Any]) -> bool:
    """Return whether a variable is a reward: transient, and a number."""
    return variable.get("transient") is True and variable.get("type") != "bool"


def _check_destinations(edge: dict[str, Any], rewards: set[Any], where: str) -> None:
    """Raise ModelError if the destinations of an edge assign different rewards."""
    paid = []
    for destination in _list_objects(edge, "destinations"):
        assigned = _list_objects(destination, "assignments")
        paid.append([each for each in assigned if each.get("ref") in rewards])
    for own in paid:
        # An assignment with an index may read what the same destination has assigned before.
        ordered = any(each.get("index") for each in own)
        if len(paid) > 1 and (ordered or own != paid[0]):
            name = next(each["ref"] for each in own or paid[0])
            raise ModelError(
                f"the reward {name} depends on the destination",
                where=where,
                fix="let each destination enter a location of its own that assigns it; or let the "
                "edge assign the mean amount, which gives the same expected values only",
            )
