"""The local backend: a small language model on this machine's processor, by way of xllamacpp.

The answer's form is forced by the JSON schema while the model writes. With the 135-million
parameter model that `fetch-model` unpacks this shows that the wiring works; what such a model says
is no evidence about anything. xllamacpp listens on a loopback port while it runs.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from mdp.errors import ModelError
from paper_repro.agents.chat import Style, ask
from paper_repro.agents.protocol import BackendError, Reply, Request
from paper_repro.agents.text_view import plain

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
    try:
        import xllamacpp
    except ImportError as error:
        raise ModelError(
            "the package xllamacpp is not installed",
            where="local backend",
            fix='install it: pip install "exact-mdp[agents-local]"',
        ) from error
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
