"""Models to be written as UMB, and the files inside a UMB file."""

from __future__ import annotations

import io
import tarfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import umbi
from umbi.umb.umb_to_tar import UmbDecoder

from exact_mdp.mdp import MDP, Scenario

CARE = Scenario.load("yuan2025").with_(tasks=[1, 1], max_trial=1)
WIDE = Fraction(1, 3**60)
MODELS = {
    "care": CARE.compile(),
    "own skip": CARE.with_(readings={"skip_timestep": "own"}).compile(),
    "beyond 64 bits": CARE.with_(parameters={"base.anger": "0.1234567891234567"}).compile(),
    "wide": MDP.from_outcomes(
        [(0, 0, [(WIDE, 0, -(10**30)), (1 - WIDE, 1, Fraction(1, 7))]), (1, 0, [(1, 1, 0)])],
        start={0: WIDE, 1: 1 - WIDE}, name="wide",
    ),
    "floats": MDP.from_arrays(
        [[[0.1, 0.9], [0.0, 1]], [[1, 0], [0.3, 0.7]]], [[0.1, -2.5], [3, 0]],
        start={0: 0.25, 1: 0.75}, actions=["stay", "go"],
    ),
    "float moves": MDP.from_arrays([[[0.1, 0.9], [0, 1.0]]], [[[0.1, 1e300], [0, -0.0]]]),
    "frozen lake": MDP.from_gymnasium("FrozenLake-v1"),
}  # fmt: skip


def members_of(path: Path) -> dict[str, bytes]:
    with tarfile.open(path) as archive:
        files = {member.name: archive.extractfile(member) for member in archive}
        return {name: file.read() for name, file in files.items() if file is not None}


def archive_of(members: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        for name, data in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return stream.getvalue()


def read_by_umbi(path: Path) -> Any:
    """Read all but the states' valuations, which some releases of umbi cannot read at all."""
    decoder, content = UmbDecoder(umbpath=path), umbi.umb.ExplicitUmb()
    decoder.read_index_file(content)
    decoder.read_state_files(content)
    decoder.read_transition_files(content)
    decoder.read_annotation_files(content)
    return content
