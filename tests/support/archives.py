"""What is inside saved models, and archives of one's own making."""

from __future__ import annotations

import io
import tarfile
import zipfile
from pathlib import Path
from typing import Any

import umbi
from umbi.umb.umb_to_tar import UmbDecoder


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
