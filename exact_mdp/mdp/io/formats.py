"""The kinds of files, each said once: what a file holds, who reads it, and who writes it.

The ending of a file tells its kind. To add a format, write a module with its functions, and name
them here in one entry: loading, saving, messages, the help of the command line and the page on
files follow. The functions are imported when a file is read or written, so help appears at once.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib import import_module
from operator import attrgetter
from pathlib import Path
from typing import Any

from exact_mdp.mdp.errors import ModelError


@dataclass(frozen=True)
class Format:
    """A kind of file, with the functions that read and write it.

    `holds` is the content in words. Functions are named "module:function", with the module below
    `mdp`; `options` are those that the reader takes. `loses` names the parts that are not written.
    """

    holds: str
    reader: str
    writer: str = ""
    options: tuple[str, ...] = ()
    loses: str = ""

    def read_file(self, *given: Any, **options: Any) -> Any:
        """Read a file."""
        return import_function(self.reader)(*given, **options)

    def write_file(self, *given: Any) -> None:
        """Write a file."""
        import_function(self.writer)(*given)


def import_function(place: str) -> Any:
    """Return the function that "module:function" names."""
    module, _, name = place.partition(":")
    return attrgetter(name)(import_module(f"exact_mdp.mdp.{module}"))


# Models.
OF_EXPLICIT = ("discount", "start")
OF_PROGRAM = (*OF_EXPLICIT, "constants")
PRISM = Format("a PRISM program", "io.storm:read_prism", options=OF_PROGRAM)
FORMATS: dict[str, Format] = {
    ".toml": Format("a scenario", "care.scenario:read_scenario", options=("sets", "discount")),
    ".npz": Format("a whole model", "io.npz:read_npz", "io.npz:write_npz"),
    ".umb": Format(
        "a model for model checkers",
        "io.umb:read_umb",
        "io.umb:write_umb",
        options=("discount", "start", "reward"),
    ),
    ".json": Format(
        "a model as text",
        "io.model_json:read_model_json",
        "io.model_json:write_model_json",
        loses="columns of states, parameters, events, numbers of observations",
    ),
    ".csv": Format("a row for each outcome", "model:MDP.from_frame", options=("start",)),
    ".prism": PRISM,
    ".nm": PRISM,
    ".pm": PRISM,
    ".jani": Format("a JANI model", "io.storm:read_jani", options=OF_PROGRAM),
    ".drn": Format("an explicit model of Storm", "io.storm:read_drn", options=OF_EXPLICIT),
    ".tra": Format("explicit files of PRISM", "io.explicit:read_tra", options=OF_EXPLICIT),
}
# Models that are not files: gymnasium:ID, and a model of Storm in memory.
IN_MEMORY = Format("a model of Storm", "io.storm:read_storm_model", options=OF_EXPLICIT)
ENVIRONMENT = Format("an environment", "model:MDP.from_gymnasium", options=("discount", "start"))

# Policies.
CHOICES = "policies.choices:"
ARRAY = Format(
    "a Q-table or probabilities of actions", f"{CHOICES}read_policy_array", options=("kind",)
)
POLICIES: dict[str, Format] = {
    ".json": Format(
        '{"0000": "none", ...}, or rows of numbers',
        f"{CHOICES}read_policy_json",
        options=("kind",),
    ),
    ".csv": Format(
        "rows of status,action, or of numbers",
        f"{CHOICES}read_policy_text",
        f"{CHOICES}write_policy_csv",
        options=("kind",),
    ),
    ".txt": Format("rows of numbers", f"{CHOICES}read_policy_text", options=("kind",)),
    ".npy": ARRAY,
    ".npz": ARRAY,
}

# Perceptions, and recorded transitions.
PERCEPTIONS: dict[str, Format] = {
    ".csv": Format("a confusion matrix", "care.perception:read_matrix"),
    ".toml": Format("sensitivity and specificity", "care.perception:read_rates"),
    ".jsonl": Format("labelled examples", "care.perception:read_examples"),
}
RECORDS: dict[str, Format] = {
    ".csv": Format("transitions as text", "io.transitions:TransitionRecord.iterate_csv"),
    ".jsonl": Format("a transition a line", "io.transitions:TransitionRecord.iterate_jsonl"),
    ".parquet": Format("transitions", "io.transitions:TransitionRecord.iterate_parquet"),
}

WRITTEN_MODELS = {ending: each for ending, each in FORMATS.items() if each.writer}
WRITTEN_POLICIES = {ending: each for ending, each in POLICIES.items() if each.writer}
PROGRAMS = {ending: each for ending, each in FORMATS.items() if "constants" in each.options}


def find_format(path: str | Path, formats: Mapping[str, Format]) -> Format | None:
    """Return the format of a file by its ending; None if it is not among the formats."""
    return formats.get(Path(path).suffix.lower())


def split_part(text: str, endings: Collection[str]) -> tuple[str, str | None]:
    """Return the file and the NAME of "FILE#NAME" for files with these endings, else no name."""
    named = re.fullmatch(r"(?s)(.*(\.\w+))#(.*)", text)
    if named and named[2].lower() in endings:
        return named[1], named[3]
    return text, None


def find_written_format(path: str | Path, formats: Mapping[str, Format], what: str) -> Format:
    """Return the format in which a file is to be written; raise ModelError if there is none."""
    form = find_format(path, formats)
    if form is None:
        raise ModelError(
            f"cannot write {what} as {Path(path).suffix.lower() or 'a file without extension'}",
            where=str(path),
            fix=f"name it {join_endings(formats)}",
        )
    return form


def join_endings(endings: Collection[str]) -> str:
    """Return endings as a text: ".npz, .umb or .json"."""
    *first, last = endings
    if not first:
        return last
    return f"{', '.join(first)} or {last}"


def group_endings(formats: Mapping[str, Format]) -> dict[Format, str]:
    """Return the endings of each format, ".prism, .nm, .pm"."""
    endings: dict[Format, list[str]] = {}
    for ending, each in formats.items():
        endings.setdefault(each, []).append(ending)
    return {each: ", ".join(own) for each, own in endings.items()}


def describe_formats(formats: Mapping[str, Format]) -> str:
    """Return formats as a text: ".prism, .nm, .pm (a PRISM program); .jani (a JANI model)"."""
    return "; ".join(f"{own} ({each.holds})" for each, own in group_endings(formats).items())
