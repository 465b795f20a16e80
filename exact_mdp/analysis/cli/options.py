"""What the texts of options mean: a model, a policy, numbers, files to write."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from exact_mdp.analysis.cli.render import Report, Table
from exact_mdp.analysis.pages.page import ADVICE
from exact_mdp.mdp.care import perception as seeing
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.load import Loaded, read_model
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import exact
from exact_mdp.solvers.solver import is_average, require_no_horizon
from exact_mdp.solvers.values.policy_chain import policy_of

MOST_STEPS = 10**9
OF_CARE = "gymnasium:icu_sepsis"  # a model of care that is no scenario


@dataclass(frozen=True, kw_only=True)
class Question:
    """What the options --reach, --until, --minimize, --start and those beside them ask of a model.

    It is a function of models.
    """

    reach: str | None = None
    until: str | None = None
    reward: str | None = None
    allowed: str | None = None
    minimize: bool = False
    start: str | None = None

    def __post_init__(self) -> None:
        for needy, value, needed in (
            ("--allowed", self.allowed, self.reach),
            ("--reward", self.reward, self.until),
        ):
            if value is not None and needed is None:
                fix = {"--allowed": "--reach LABEL", "--reward": "--until LABEL, or MODEL.umb#NAME"}
                raise ModelError(
                    f"{needy} is part of another question", where=needy, fix=f"give {fix[needy]}"
                )
        if self.reach is not None and self.until is not None:
            raise ModelError(
                "--reach and --until ask two questions",
                where="--until",
                fix="leave out --until, or --reach",
            )

    def __call__(self, mdp: MDP) -> MDP:
        """Return the model whose optimal value is the answer."""
        changes: dict[str, Any] = {} if self.start is None else {"start": self.start}
        if self.minimize:
            changes["sense"] = "min"
        mdp = mdp.with_(**changes) if changes else mdp
        if self.reach is not None:
            return mdp.reaching(self.reach, self.allowed)
        return mdp if self.until is None else mdp.until(self.until, self.reward)

    def words(self) -> str | None:
        """Return the question in words; None for the total reward."""
        best = "least" if self.minimize else "greatest"
        if self.reach is not None:
            through = f" through {self.allowed}" if self.allowed else ""
            return f"{best} probability of reaching {self.reach}{through}"
        if self.until is not None:
            return f"{best} expected {self.reward or 'reward'} until {self.until}"
        return "least expected costs" if self.minimize else None


def limits_from(texts: Sequence[str]) -> dict[str, list[str]]:
    """Return what --subject-to says, as `solve` takes it."""
    found: dict[str, list[str]] = {}
    for text in texts:
        name, *limit = re.split("(>=|<=)", text, maxsplit=1)
        if not limit:
            raise ModelError(
                f"{text!r} is no limit",
                where="--subject-to",
                fix='write "NAME >= -1/2" or "NAME <= 1/20"',
            )
        found.setdefault(name.strip(), []).append("".join(limit))
    return found


@dataclass(frozen=True, kw_only=True)
class Given:
    """The model that a command names, and the policy of a command that takes one.

    Attributes
    ----------
    endless : Loaded
        The model as it is.
    loaded : Loaded
        The model that the question makes of it, of episodes that stop after the steps of --horizon
        where that is given. It is no scenario where there is a question.
    question : Question, optional
    head, facts : dict
        How result and facts begin.
    notes : tuple of str
        Says where an answer leaves the environment's time limit out.
    taken : Policy, optional
        The policy.
    average : bool
        Whether the average reward per step counts (--criterion average).
    """

    endless: Loaded
    loaded: Loaded
    question: Question | None = None
    steps: int | None
    head: dict[str, Any]
    facts: dict[str, Any]
    notes: tuple[str, ...]
    taken: Policy | None = None
    average: bool = False

    @property
    def mdp(self) -> MDP:
        """The model."""
        return self.loaded.mdp

    @property
    def asked(self) -> MDP:
        """The model of the question, of episodes that go on whatever the horizon."""
        return self.endless.mdp if self.question is None else self.question(self.endless.mdp)

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
    horizon: str | bool | None = False,
    criterion: str | None = None,
    **asking: Any,
) -> Given:
    """Return the model that a command names, and the policy where it takes one.

    Parameters
    ----------
    horizon : "N" or None, optional
        The option --horizon of a command that has it.
    criterion : str, optional
        The option --criterion of a command that has it.
    **asking
        The options of a `Question`.
    """
    asked = Question(**asking)
    question = None if asked == Question() else asked
    endless = read_model(model, sets=sets, discount=discount, start=asking.get("start"))
    loaded, steps = endless, None
    if question is not None:
        loaded = replace(endless, mdp=question(endless.mdp), scenario=None)
    average = criterion is not None and is_average(criterion)
    if average:
        require_no_horizon(horizon or None)
        if asked.reach is not None or asked.until is not None:
            raise ModelError(
                "an average reward per step has no target",
                where="--criterion",
                fix="leave out --reach and --until, or --criterion",
            )
    if isinstance(horizon, str):
        steps = whole_of(horizon, "--horizon", 1, MOST_STEPS)
        loaded = replace(loaded, mdp=loaded.mdp.within(steps))
    mdp, limit = loaded.mdp, loaded.mdp.time_limit
    also = f": --horizon {limit}" if horizon is not False and not average else ""
    head: dict[str, Any] = {"model": loaded.name, "discount": mdp.discount}
    facts: dict[str, Any] = {"model": loaded.name}
    if horizon is not False:
        head["horizon"] = steps
    if asking:
        words = question.words() if question else None
        head |= {"sense": mdp.sense, "question": words, "start": asking["start"]}
        facts |= {"question": words, "start": asking["start"]}
    if criterion is not None:
        head["criterion"] = criterion
    found = None
    if policy is not None:
        found = policy_from(mdp, policy, perception, kind=kind, average=average)
        head |= {"policy": policy, "read_as": found.read_as, "perception": perception}
        facts = {"read as": found.source or None} | facts
        facts |= {"policy": policy, "perception": perception}
    facts |= {"discount": mdp.discount, "criterion": "reward per step" if average else None}
    facts |= {"horizon": None if steps is None else f"{steps:,} steps"}
    return Given(
        endless=endless,
        loaded=loaded,
        question=question,
        steps=steps,
        head=head,
        facts=facts,
        notes=(
            *(
                ()
                if limit is None
                else (
                    f"the environment stops after {limit:,} steps; this answer is for episodes "
                    f"without a limit{also}",
                )
            ),
            *advice(endless),
        ),
        taken=found,
        average=average,
    )


def advice(loaded: Loaded) -> tuple[str, ...]:
    """Return the note on models of care, and on models from records; nothing on others."""
    care = loaded.scenario is not None or loaded.name.startswith(OF_CARE)
    return (ADVICE,) * (care or loaded.mdp.observations is not None)


def policy_from(
    mdp: MDP,
    form: str,
    perception: str | None = None,
    *,
    kind: str = "auto",
    average: bool = False,
) -> Policy:
    """Return the policy that a command names, acting on what is perceived where that is given.

    Under a perception the optimum is that of whoever sees the truth.
    """
    found = policy_of(mdp, form, kind=kind, criterion="average" if average else "total")
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


def renamed(text: str) -> tuple[str, str]:
    """Return the name and the file's column of one --column."""
    name, equals, column = text.partition("=")
    if not equals or not column.strip():
        raise ModelError(f"{text!r} names no column", where="--column", fix="write NAME=COLUMN")
    return name.strip(), column.strip()


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
