"""Every public function says what it takes, what it gives back, and shows it once."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import pytest

ROOMS = (
    "exact_mdp",
    "exact_mdp.mdp",
    "exact_mdp.solvers",
    "exact_mdp.analysis",
    "exact_mdp.analysis.perception",
    "exact_mdp.analysis.plots",
    "exact_mdp.analysis.vary",
)


def public() -> Iterator[tuple[str, Any]]:
    """Yield every exported function, and every class method of an exported class."""
    seen: set[int] = set()
    for room in ROOMS:
        module = import_module(room)
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if id(thing) in seen:
                continue
            seen.add(id(thing))
            if inspect.isfunction(thing):
                yield f"{room}.{name}", thing
            elif inspect.isclass(thing):
                parts = [vars(base) for base in thing.__mro__ if "exact_mdp" in base.__module__]
                for key, method in {k: v for part in parts for k, v in part.items()}.items():
                    if isinstance(method, classmethod) and not key.startswith("_"):
                        yield f"{room}.{name}.{key}", method.__func__


PUBLIC = dict(public())


def lacks(function: Any) -> list[str]:
    """Return the parts that a docstring lacks."""
    text, signature = inspect.getdoc(function) or "", inspect.signature(function)
    named = [key for key in signature.parameters if key != "cls"]
    found = [key for key in named if not re.search(rf"^[^:]*\b{key}\b[^:]*( :|$)", text, re.M)]
    if named and "Parameters\n---" not in text:
        found.append("Parameters")
    if signature.return_annotation not in ("None", "Iterator[None]") and "Returns\n---" not in text:
        found.append("Returns")
    return found if ">>>" in text else [*found, "an example"]


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_function_is_documented(name: str) -> None:
    """It names its parameters, says what it returns, and has an example that the doctests run."""
    assert lacks(PUBLIC[name]) == []
