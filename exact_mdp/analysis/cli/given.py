"""What the words of a command mean: a model and what is asked of it, a policy, numbers, files."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from exact_mdp.analysis.cli.words import typed
from exact_mdp.analysis.pages.page import ADVICE
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.care import perception as seeing
from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.load import Loaded, read_model
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, Posed, parametric
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.questions import unlimited
from exact_mdp.mdp.report import Report, Shown
from exact_mdp.solvers.solver import Criterion, is_average, require_no_horizon
from exact_mdp.solvers.values.policy_chain import policy_of

OF_CARE = "gymnasium:icu_sepsis"  # a model of care that is no scenario


@dataclass(frozen=True, kw_only=True)
class Question:
    """What --reach, --until and those beside them ask of a model: a function of models."""

    reach: str | None = None
    until: str | None = None
    reward: str | None = None
    allowed: str | None = None
    minimize: bool = False
    start: str | None = None

    def __post_init__(self) -> None:
        for needy, value, needed, fix in (
            ("--allowed", self.allowed, self.reach, "--reach LABEL"),
            ("--reward", self.reward, self.until, "--until LABEL, or MODEL.umb#NAME"),
        ):
            if value is not None and needed is None:
                what = f"{needy} is part of another question"
                raise ModelError(what, where=needy, fix=f"give {fix}")
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


@dataclass(frozen=True, kw_only=True, eq=False)
class Given:
    """The model that a command names, with what is asked of it.

    Attributes
    ----------
    endless : Loaded
        The model as it is.
    loaded : Loaded
        The model that the question makes of it, of episodes that stop after `horizon` steps. It is
        no scenario where there is a question.
    question : Question, optional
    horizon : int, optional
    average : bool
        Whether the average reward per step counts (--criterion average).
    form : str or None
        The policy as it was typed.
    taken : Policy or "optimal", optional
        The policy, of a command that takes one: "optimal" where it is to be re-optimised.
    perception : str or None
        The file of --perception.
    kind : str
        What an array in a policy's file holds.
    head : {key: value}
        How the command's report begins.
    notes : tuple of str
        Says where an answer leaves the environment's time limit out.
    """

    endless: Loaded
    loaded: Loaded
    question: Question | None
    horizon: int | None
    average: bool
    form: str | None
    perception: str | None
    kind: str
    head: dict[str, Any]
    notes: tuple[str, ...]
    taken: Any = None

    @property
    def mdp(self) -> MDP:
        """The model."""
        return self.loaded.mdp

    @property
    def asked(self) -> MDP:
        """The model of the question, of episodes that go on whatever the horizon."""
        return self.endless.mdp if self.question is None else self.question(self.endless.mdp)

    @cached_property
    def family(self) -> Parametric:
        """The model with its parameters; what is compiled already stays so."""
        family: Parametric = parametric(self.endless.mdp)
        if self.endless.scenario is not None:
            family = ScenarioFamily(scenario=self.endless.scenario, base=self.endless.mdp)
        return family if self.question is None else Posed(family=family, ask=self.question)

    def policy(self, form: str) -> Policy:
        """Return the policy that a text names, acting on what is perceived where that is given.

        Under a perception the optimum is that of whoever sees the truth.
        """
        criterion: Criterion = "average" if self.average else "total"
        policy: Policy = policy_of(self.mdp, form, kind=self.kind, criterion=criterion)
        if self.perception is None:
            return policy
        seen: Policy = seeing.perceived(self.mdp, policy, seeing.read(self.perception, self.mdp))
        return replace(seen, source=policy.source)

    def report(self, report: Report, **more: Any) -> Report:
        """Return what was found, after what was asked; `more` are facts that stand between."""
        facts = {**self.head, **more, **report.facts}
        return replace(report, facts=facts, notes=(*report.notes, *self.notes))

    def record(self, solver: str, seed: int | None = None) -> str:
        """Return the record of a result, as JSON."""
        name = self.loaded.name
        made = run_record(self.mdp, model=name, solver=solver, seed=seed, command=typed())
        return json.dumps(made, indent=2) + "\n"

    def saved(
        self, report: Report, out: str | None, name: str, made: tuple[str, int], *also: Path
    ) -> Report:
        """Write a report and its record into a folder; `also` are the files that are there.

        `made` are solver and seed.
        """
        if out is None:
            return report
        paths = [Path(out, name), *also, Path(out, "run.json")]
        report = replace(report, facts={**report.facts, "written": [str(path) for path in paths]})
        write_atomically(paths[0], report.json() + "\n")
        write_atomically(paths[-1], self.record(*made))
        return report


def given(
    model: str,
    *,
    has: Sequence[str] = (),
    policy: str | None = None,
    criterion: str = "total",
    horizon: int | None = None,
    kind: str = "auto",
    perception: str | None = None,
    reach: str | None = None,
    until: str | None = None,
    reward: str | None = None,
    allowed: str | None = None,
    minimize: bool = False,
    start: str | None = None,
    sets: Sequence[str] = (),
    discount: str | None = None,
) -> Given:
    """Return the model that a command names, with what is asked of it.

    Parameters
    ----------
    model : MODEL
    has : sequence of str
        Which of the others the command has.
    policy : POLICY, optional
    criterion : "total" or "average"
        What counts: the total reward, or the average reward per step in the long run, whatever the
        discount.
    horizon : N, 1 to 1000000000
        Stop every episode after N steps, without a further reward.
    kind : "q", "policy" or "auto"
        What a .npy or .npz file holds: a Q-table, or probabilities of actions.
    perception : FILE, optional
        The policy acts on a perceived status: a confusion matrix as .csv, or .toml with sensitivity
        and specificity, or labelled examples (.csv true,perceived; .jsonl).
    reach : LABEL, optional
        Ask for the probability of reaching a label.
    until : LABEL, optional
        Ask for the expected reward until a label.
    reward : NAME, optional
        The reward component that counts until then.
    allowed : LABEL, optional
        Reach it through states of this label only.
    minimize : bool
        Minimise: rewards are costs.
    start : STATE, optional
        Start in this state, a number or a name.
    sets : KEY=VALUE
        Change a scenario: base.anger=1/10, tasks=[3,1], readings.NAME=OPTION.
    discount : G, optional
        Discount instead of the model's own: 0.95 or 19/20.

    Keys
    ----
    model: name of the model, or its file; sense: `max`, or `min` in a model of costs; question:
    what `--reach` or `--until` asks, in words, or null; start: the state of `--start`, or null;
    criterion: `total` reward, or `average` reward per step; read_as: how an array was read, as `q`
    or `policy`; policy: the name of the policy given, or the policy of the answer (by status at
    subtask 0 and trial 0 in scenarios, with probabilities if it is mixed); perception: the file of
    `--perception`, or null; discount: the discount; horizon: steps after which an episode stops, or
    null; claim: `certified`, `bounded`, `checked` or `estimated`; kind: the kind of analysis;
    start_value: the optimal value at the start, "inf" or "-inf" where infinite; error_bound:
    greatest error of the number before it; error_bounds: greatest errors of several numbers;
    states: number of states; pairs: number of state-action pairs; transitions: number of
    transitions of positive probability; model_hash: SHA-256 of the model's exact content; seconds:
    time taken; seed: seed of the random numbers; written: files written; format: version of this
    format, 2; notice: that this is research software and no medical advice; without_range:
    parameters without a range to move in.
    """
    asked = Question(
        reach=reach, until=until, reward=reward, allowed=allowed, minimize=minimize, start=start
    )
    question = None if asked == Question() else asked
    endless = read_model(model, sets=sets, discount=discount, start=start)
    loaded = endless
    if question is not None:
        loaded = replace(endless, mdp=question(endless.mdp), scenario=None)
    average = is_average(criterion)
    if average:
        require_no_horizon(horizon)
        if reach is not None or until is not None:
            raise ModelError(
                "an average reward per step has no target",
                where="--criterion",
                fix="leave out --reach and --until, or --criterion",
            )
    if horizon is not None:
        loaded = replace(loaded, mdp=loaded.mdp.within(horizon))
    found = Given(
        endless=endless,
        loaded=loaded,
        question=question,
        horizon=horizon,
        average=average,
        form=policy,
        perception=perception,
        kind=kind,
        head={},
        notes=(
            *unlimited(loaded.mdp, "--horizon {}" * ("horizon" in has and not average)),
            *advice(endless),
        ),
    )
    if "policy" in has and (policy or perception) is not None:
        same = (policy or "optimal", perception) == ("optimal", None) and "kind" not in has
        taken: Any = "optimal" if same else found.policy(policy or "optimal")
        found = replace(found, taken=taken)
    return replace(found, head=_head(found, has, criterion, start))


def _head(given: Given, has: Sequence[str], criterion: str, start: str | None) -> dict[str, Any]:
    """Return how a report begins; what a policy was read as comes first."""
    mdp, horizon, perception = given.mdp, given.horizon, given.perception
    head: dict[str, Any] = {"model": given.loaded.name}
    if "start" in has:
        words = given.question.words() if given.question else None
        head |= {"sense": Shown(mdp.sense), "question": words, "start": start}
    if "criterion" in has:
        head["criterion"] = Shown(criterion, "reward per step" if given.average else None)
    if given.taken is not None and "kind" in has:
        read = Shown(given.taken.read_as, given.taken.source or None)
        head = {"read_as": read} | head | {"policy": given.form}
    if "perception" in has:
        said = perception and f"{perception}, which the policy acts on"
        head |= {"perception": Shown(perception, said)}
    head |= {"discount": mdp.discount}
    if "horizon" in has:
        head["horizon"] = Shown(horizon, None if horizon is None else f"{horizon:,} steps")
    return head


def advice(loaded: Loaded) -> tuple[str, ...]:
    """Return the note on models of care, and on models from records; nothing on others."""
    care = loaded.scenario is not None or loaded.name.startswith(OF_CARE)
    return (ADVICE,) * (care or loaded.mdp.observations is not None)
