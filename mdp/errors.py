"""Errors that say what is wrong, where, and how to mend it."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches


class ModelError(ValueError):
    """A model, policy or file that cannot be used as it is.

    Parameters
    ----------
    what : str
        What is wrong, with the offending number in it.
    where : str, optional
        The state, action, file or key at fault.
    fix : str, optional
        What the user can do about it.

    Examples
    --------
    >>> print(ModelError("discount is 2, outside [0, 1]", where="MDP", fix="choose a smaller one"))
    discount is 2, outside [0, 1]
      where: MDP
      fix:   choose a smaller one
    """

    def __init__(self, what: str, *, where: str = "", fix: str = "") -> None:
        self.what, self.where, self.fix = what, where, fix
        lines = [what]
        if where:
            lines.append(f"  where: {where}")
        if fix:
            lines.append(f"  fix:   {fix}")
        super().__init__("\n".join(lines))

    def __reduce__(self) -> tuple[object, ...]:
        return _rebuild, (type(self), self.what, self.where, self.fix)


class ScenarioWarning(UserWarning):
    """The tables of a scenario, as they are read, state what is no probability: more than 1."""


def _rebuild(kind: type[ModelError], what: str, where: str, fix: str) -> ModelError:
    return kind(what, where=where, fix=fix)


def suggest(name: str, known: Iterable[str]) -> str:
    """Return advice that names the known spelling nearest to `name`.

    Examples
    --------
    >>> suggest("base.angre", ["base.anger", "base.confusion"])
    'did you mean base.anger?'
    >>> suggest("x", ["a", "b"])
    'choose one of a, b'
    """
    options = list(known)
    close = get_close_matches(name, options, n=1, cutoff=0.6)
    if close:
        return f"did you mean {close[0]}?"
    if len(options) <= 12:
        return f"choose one of {', '.join(options)}"
    return f"choose one of the {len(options)} known names, such as {', '.join(options[:4])}"
