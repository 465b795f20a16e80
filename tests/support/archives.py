"""What is inside saved models, and archives of one's own making."""

import io
import tarfile
import zipfile
from collections.abc import Mapping, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

import umbi
import umbi.datatypes
from refusal_tables import refused
from umbi.binary import SizedType
from umbi.umb.umb_to_tar import UmbDecoder

from exact_mdp import load


def is_refused(path: Path, message: str, **options: Any) -> None:
    """Assert that a model's file is not loaded, in so many words."""
    assert message in str(refused(lambda: load(path, **options), "", str(path)))


def unzipped(path: Path) -> dict[str, bytes]:
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def zipped(members: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", method) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return stream.getvalue()


def untarred(path: Path) -> dict[str, bytes]:
    with tarfile.open(path) as archive:
        files = {member.name: archive.extractfile(member) for member in archive}
        return {name: file.read() for name, file in files.items() if file is not None}


def tarred(members: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        for name, data in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return stream.getvalue()


def array_header(shape: str, kind: str = "<f8") -> bytes:
    """The first bytes of a .npy file, whatever they claim."""
    text = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def read_by_umbi(path: Path) -> Any:
    """Read all but the states' valuations, which some releases of umbi cannot read at all."""
    decoder, content = UmbDecoder(umbpath=path), umbi.umb.ExplicitUmb()
    decoder.read_index_file(content)
    decoder.read_state_files(content)
    decoder.read_transition_files(content)
    decoder.read_annotation_files(content)
    return content


def foreign_umb(
    states: Sequence[Sequence[Sequence[tuple[int, Any]]]],
    rewards: Mapping[str, Mapping[str, Sequence[Any]]] | None = None,
    *,
    initial: Sequence[int] = (0,),
) -> Any:
    """Return a UMB model as another program writes it, from each state's choices.

    A choice is its outcomes (target, chance). The values of a reward go by what has them: states,
    choices or branches. Releases of umbi differ in what they build models from, and not in this.
    """
    choices = [choice for each in states for choice in each]
    branches = [branch for choice in choices for branch in choice]
    kind, chances = umbi.datatypes.promote_scalars([chance for _, chance in branches])
    system = umbi.umb.index.TransitionSystem(
        time="discrete",
        num_players=1,
        num_states=len(states),
        num_initial_states=len(initial),
        num_choices=len(choices),
        num_branches=len(branches),
        branch_probability_type=SizedType.for_type(kind),
    )
    content = umbi.umb.ExplicitUmb(
        index=umbi.umb.index.UmbIndex(
            format_version=umbi.version.__format_version__,
            format_revision=umbi.version.__format_revision__,
            file_data=umbi.umb.index.umbi_file_data(),
            transition_system=system,
            annotations={"rewards": {}, "aps": {}},
        ),
        state_is_initial=[state in initial for state in range(len(states))],
        state_to_choices=[0, *accumulate(map(len, states))],
        choice_to_branches=[0, *accumulate(map(len, choices))],
        branch_to_target=[target for target, _ in branches],
        branch_to_probability=chances,
        annotations={"rewards": {}, "aps": {}},
    )
    for name, given in (rewards or {}).items():
        annotate(content, "rewards", name, given)
    return content


def annotate(content: Any, group: str, name: str, given: Mapping[str, Sequence[Any]]) -> None:
    kind, _ = umbi.datatypes.promote_scalars(
        [value for values in given.values() for value in values]
    )
    content.index.annotations[group][name] = umbi.umb.index.AnnotationDescription(
        applies_to=[*given], type=SizedType.for_type(kind)
    )
    content.annotations[group][name] = {
        over: umbi.datatypes.promote_scalars_to(values, kind) for over, values in given.items()
    }


def written(content: Any, folder: Path) -> Path:
    path = folder / "theirs.umb"
    umbi.umb.write(content, path)
    return path
