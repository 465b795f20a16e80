"""The pinned values of the reproduction, and what does not agree with them.

`expected.toml` is written by hand: each published number with its value, a tolerance and the reason
for both. `python -m paper_repro --candidates` prints what a run finds in the same form; whoever
changes the file compares the two and says why. Nothing here writes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.paper_repro.claims import Judged

FILE = Path(__file__).parent / "expected.toml"


@dataclass(frozen=True, kw_only=True)
class Pinned:
    """What a claim is expected to come to.

    Attributes
    ----------
    verdict : str or list of str
        A list where the number of runs decides.
    reason : str
        Why the value is believed, and why the tolerance is what it is.
    value, tolerance : float or None
        None for a claim without a number.
    """

    verdict: str | list[str]
    reason: str
    value: float | None = None
    tolerance: float | None = None


def expected(path: Path = FILE) -> dict[str, Pinned]:
    """Read the pinned values by claim.

    Examples
    --------
    >>> expected()["table3.base.anger"].value
    0.05
    """
    try:
        data = toml_of(read_text(path, most=SMALL), str(path), number=float)
        return {name: Pinned(**entry) for name, entry in data.items()}
    except TypeError as error:
        raise ModelError(str(error), where=str(path), fix="write it as the others are") from error


def disagreements(judged: Sequence[Judged], pinned: dict[str, Pinned]) -> list[str]:
    """Return, claim by claim, what differs from the pinned values; nothing where all agree."""
    found = []
    for each in judged:
        name, exact = each.claim.id, each.finding.exact
        if name not in pinned:
            found.append(f"{name} is not pinned")
            continue
        known = pinned[name]
        allowed = [known.verdict] if isinstance(known.verdict, str) else known.verdict
        if str(each.verdict) not in allowed:
            found.append(f"{name}: {each.verdict}, pinned {' or '.join(allowed)}")
        if (exact is None) != (known.value is None):
            found.append(f"{name}: {exact}, pinned {known.value}")
        elif exact is not None and known.value is not None:
            off = abs(exact - known.value)
            if not off <= (known.tolerance or 0.0):
                found.append(
                    f"{name}: {exact!r}, pinned {known.value!r} within {known.tolerance or 0.0:g}"
                )
    return found


def candidates(judged: Sequence[Judged]) -> str:
    """Return what a run finds, in the form of `expected.toml`; the reasons are to be written."""
    lines = []
    for each in judged:
        lines += [f'["{each.claim.id}"]', f'verdict = "{each.verdict}"']
        if each.finding.exact is not None:
            lines.append(f"value = {each.finding.exact!r}")
            lines.append("tolerance = 0.0")
        lines += ['reason = ""', ""]
    return "\n".join(lines)
