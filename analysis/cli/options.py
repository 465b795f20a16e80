"""What the texts of options mean: a model, a policy, numbers, files to write."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from exact_mdp.analysis.cli.render import Report, Table
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.load import Loaded, load
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import exact
from exact_mdp.solvers.values.policy_chain import policy_of

seeing = later("exact_mdp.mdp.care.perception")

MOST_STEPS = 10**9


@dataclass(frozen=True, kw_only=True)
class Given:
    """The model that a command names, and the policy of a command that takes one.

    Attributes
    ----------
    endless : Loaded
        The model as it is.
    loaded : Loaded
        The model of episodes that stop after the steps of --horizon, where that is given.
    head, facts : dict
        How result and facts begin.
    notes : tuple of str
        Says where an answer leaves the environment's time limit out.
    taken : Policy, optional
        The policy.
    """

    endless: Loaded
    loaded: Loaded
    steps: int | None
    head: dict[str, Any]
    facts: dict[str, Any]
    notes: tuple[str, ...]
    taken: Policy | None = None

    @property
    def mdp(self) -> MDP:
        """The model."""
        return self.loaded.mdp

    @property
    def policy(self) -> Policy:
        """The policy of a command that takes one."""
        assert self.taken is not None
        return self.taken

    def report(
        self,
        result: Mapping[str, Any],
        facts: Mapping[str, Any],
        tables: Sequence[Table] = (),
        *,
        notes: Sequence[str] = (),
        status: int = 0,
    ) -> Report:
        """Return what was found, with how result and facts begin."""
        return Report(
            result={**self.head, **result},
            facts={**self.facts, **facts},
            tables=tables,
            notes=(*notes, *self.notes),
            status=status,
        )


def given(
    model: str,
    sets: Sequence[str],
    discount: str | None,
    *,
    policy: str | None = None,
    kind: str = "auto",
    perception: str | None = None,
    **stopping: str | None,
) -> Given:
    """Return the model that a command names, and the policy where it takes one.

    Parameters
    ----------
    **stopping : {"horizon": N}, optional
        The option --horizon of a command that has it.
    """
    endless = load(model, sets=sets, discount=discount)
    loaded, steps = endless, None
    if stopping.get("horizon") is not None:
        steps = whole_of(str(stopping["horizon"]), "--horizon", 1, MOST_STEPS)
        loaded = replace(endless, mdp=endless.mdp.within(steps))
    mdp, limit = loaded.mdp, loaded.mdp.time_limit
    also = f": --horizon {limit}" if "horizon" in stopping else ""
    head: dict[str, Any] = {"model": loaded.name, "discount": mdp.discount}
    facts: dict[str, Any] = {"model": loaded.name}
    if stopping:
        head["horizon"] = steps
    found = None
    if policy is not None:
        found = policy_from(mdp, policy, perception, kind=kind)
        head |= {"policy": policy, "read_as": found.read_as, "perception": perception}
        facts = {"read as": found.source or None} | facts
        facts |= {"policy": policy, "perception": perception}
    facts |= {"discount": mdp.discount, "horizon": None if steps is None else f"{steps:,} steps"}
    return Given(
        endless=endless,
        loaded=loaded,
        steps=steps,
        head=head,
        facts=facts,
        notes=()
        if limit is None
        else (
            f"the environment stops after {limit:,} steps; this answer is for episodes without a "
            f"limit{also}",
        ),
        taken=found,
    )


def policy_from(
    mdp: MDP, form: str, perception: str | None = None, *, kind: str = "auto"
) -> Policy:
    """Return the policy that a command names, acting on what is perceived where that is given.

    Under a perception the optimum is that of whoever sees the truth.
    """
    found = policy_of(mdp, form, kind=kind)
    if perception is None:
        return found
    seen: Policy = seeing.perceived(mdp, found, seeing.read(perception, mdp))
    return replace(seen, source=found.source)


def number_of(text: str, option: str, *, positive: bool = False) -> float:
    """Return the number that an option states, as a float."""
    try:
        found = float(exact(text))
    except ModelError as error:
        raise ModelError(error.what, where=option, fix=error.fix) from error
    except OverflowError as error:
        raise ModelError("too large for a float", where=option, fix="choose less") from error
    if positive and not found > 0:
        raise ModelError(f"{text} is not positive", where=option, fix="give more than 0")
    return found


def whole_of(text: str, option: str, least: int = 0, most: int = 10**18) -> int:
    """Return the whole number that an option states."""
    if text.isascii() and text.isdigit() and len(text) <= 40 and least <= int(text) <= most:
        return int(text)
    raise ModelError(
        f"{text!r} is not a whole number from {least} to {most:,}",
        where=option,
        fix="choose one in that range",
    )


def check_outputs(*files: tuple[str | None, tuple[str, ...]]) -> None:
    """Raise ModelError, before any work, where a file (path, allowed endings) cannot be written."""
    taken = []
    for name, endings in files:
        if name is None:
            continue
        path = Path(name)
        if path.suffix.lower() not in endings:
            raise ModelError(
                f"cannot write {path.suffix or 'a file without ending'} here",
                where=name,
                fix=f"name it {' or '.join(endings)}",
            )
        if not path.parent.is_dir():
            raise ModelError("there is no such folder", where=str(path.parent), fix="make it first")
        if path.resolve() in taken:
            raise ModelError("two results go to one file", where=name, fix="name another file")
        taken.append(path.resolve())
