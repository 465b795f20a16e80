"""Reading how uncertain parameters are from a TOML file.

[default]
effective_sample_size = 100

[base]                                 # every parameter whose name begins so
effective_sample_size = 40

["base.anger"]                         # or [base.anger]
effective_sample_size = 15

["reward.subtask-complete"]
distribution = "gamma"                 # or "normal", which it is unless stated
relative_sd = 0.2
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from analysis.sensitivity.uncertainty_settings import SETTINGS, number_of
from mdp.errors import ModelError, suggest
from mdp.files import SMALL, read_text
from mdp.structured import toml_of

DEFAULT = "default"


def load_uncertainty(path: str | Path) -> tuple[dict[str, dict[str, object]], float | None]:
    """Return what a file states: {name or beginning: settings}, and the default sample size.

    Raises
    ------
    ModelError
        For broken TOML, a setting that is not known, and a file that states nothing.
    """
    content = toml_of(read_text(path, most=SMALL), str(path), number=float)
    found: dict[str, dict[str, object]] = {}
    _visit("", content, found, str(path))
    if not found:
        raise ModelError(
            "nothing is stated in the file",
            where=str(path),
            fix='write "NAME" = {effective_sample_size = 50}',
        )
    general = found.pop(DEFAULT, {})
    if set(general) - {"effective_sample_size"}:
        raise ModelError(
            "[default] states something else than effective_sample_size",
            where=f"{path}, {DEFAULT}",
            fix="state that of each parameter",
        )
    key = "effective_sample_size"
    return found, number_of(general, key, DEFAULT) if general else None


def _visit(
    prefix: str, table: dict[str, Any], found: dict[str, dict[str, object]], where: str
) -> None:
    for key, value in table.items():
        name = f"{prefix}.{key}" if prefix else key
        if isinstance(value, dict):
            _visit(name, value, found, where)
        elif prefix and key in SETTINGS:
            found.setdefault(prefix, {})[key] = value
        elif isinstance(value, list):
            raise ModelError(
                f"{name} has a range",
                where=f"{where}, {prefix or 'top level'}",
                fix=f'psa takes distributions: write "{name}" = {{{SETTINGS[0]} = 50}}',
            )
        else:
            raise ModelError(
                f"unknown setting {key!r}",
                where=f"{where}, {prefix or 'top level'}",
                fix=suggest(key, SETTINGS) if prefix else f"write {key} = {{{SETTINGS[0]} = 50}}",
            )
