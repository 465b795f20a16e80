"""Refuses to build a package whose folders are not there."""

from pathlib import Path
from typing import Any

from hatchling.builders.config import BuilderConfig
from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOMS = ("mdp", "solvers", "analysis", "paper_repro")


class WholePackage(BuildHookInterface[BuilderConfig]):
    """Runs before each wheel and source archive."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Raise RuntimeError where a folder of the package is missing."""
        package = Path(self.root) / "exact_mdp"
        missing = [room for room in ROOMS if not (package / room / "__init__.py").is_file()]
        if missing:
            raise RuntimeError(
                f"exact_mdp/{missing[0]}/__init__.py is missing, and the package would be empty; "
                "check out the repository anew"
            )
