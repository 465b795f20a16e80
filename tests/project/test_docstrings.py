"""Every public function says what it takes, what it gives back, and shows it once."""

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from typing import Any

import pytest

ROOMS = ("", ".mdp", ".solvers", ".analysis")


def public() -> Iterator[tuple[str, Any]]:
    """Every exported function, and every class method of an exported class."""
    for module in (import_module(f"exact_mdp{room}") for room in ROOMS):
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if inspect.isfunction(thing):
                yield name, thing
            elif inspect.isclass(thing):
                for key, method in inspect.getmembers(thing, inspect.ismethod):
                    if not key.startswith("_") and "exact_mdp" in method.__func__.__module__:
                        yield f"{name}.{key}", method.__func__


PUBLIC = dict(public())


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_function_is_documented(name: str) -> None:
    """It names its parameters, says what it returns, and has an example that the doctests run."""
    text, signature = inspect.getdoc(PUBLIC[name]) or "", inspect.signature(PUBLIC[name])
    named = [key for key in signature.parameters if key != "cls"]
    assert not named or "Parameters\n---" in text
    for key in named:
        assert re.search(rf"^[^:]*\b{key}\b[^:]*( :|$)", text, re.M), key
    assert signature.return_annotation in ("None", "Iterator[None]") or "Returns\n---" in text
    assert ">>>" in text
