"""What the words of a command mean: a model and what is asked of it, a policy, numbers, files."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
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
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.questions import unlimited
from exact_mdp.mdp.report import Report, Shown
from exact_mdp.solvers.solver import Criterion, is_average, require_no_horizon
from exact_mdp.solvers.values.policy_chain import policy_of

OF_CARE = "gymnasium:icu_sepsis"  # a model of care that is no scenario


def posed(mdp: MDP, *, asked: Mapping[str, Any]) -> MDP:
    """Return the model whose optimal value answers what --reach, --until and others ask."""
    changes = {} if asked["start"] is None else {"start": asked["start"]}
    if asked["minimize"]:
        changes["sense"] = "min"
    mdp = mdp.with_(**changes) if changes else mdp
    if asked["reach"] is not None:
        return mdp.reaching(asked["reach"], asked["allowed"])
    return mdp if asked["until"] is None else mdp.until(asked["until"], asked["reward"])


def in_words(asked: Mapping[str, Any]) -> str | None:
    """Return the question in words; None for the total reward."""
    best = "least" if asked["minimize"] else "greatest"
    if asked["reach"] is not None:
        through = f" through {asked['allowed']}" if asked["allowed"] else ""
        return f"{best} probability of reaching {asked['reach']}{through}"
    if asked["until"] is not None:
        return f"{best} expected {asked['reward'] or 'reward'} until {asked['until']}"
    return "least expected costs" if asked["minimize"] else None


@dataclass(frozen=True, kw_only=True, eq=False)
class Given:
    """The model that a command names, with what is asked of it."""

    endless: Loaded  # the model as it is
    # What the question makes of it, of episodes that stop; no scenario where there is a question.
    loaded: Loaded
    question: Callable[[MDP], MDP] | None
    criterion: Criterion
    horizon: int | None
    form: str | None  # the policy as it was typed
    options: dict[str, Any]  # all others, as `given` takes them
    has: Sequence[str]  # those that the command has

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
        return family if self.question is None else family.posed(self.question)

    @cached_property
    def taken(self) -> Any:
        """The policy that was named; "optimal" where it is to be re-optimised, None without one."""
        perception = self.options["perception"]
        if "policy" not in self.has or (self.form or perception) is None:
            return None
        if (self.form or "optimal", perception) == ("optimal", None) and "kind" not in self.has:
            return "optimal"
        return self.policy(self.form or "optimal")

    @property
    def fixed(self) -> Any:
        """The policy held fixed, the optimum unless one was named."""
        return "optimal" if self.taken is None else self.taken

    def policy(self, form: str) -> Policy:
        """Return the policy that a text names, acting on what is perceived where that is given.

        Under a perception the optimum is that of whoever sees the truth.
        """
        kind, perception = self.options["kind"], self.options["perception"]
        policy: Policy = policy_of(self.mdp, form, kind=kind, criterion=self.criterion)
        if perception is None:
            return policy
        seen: Policy = seeing.perceived(self.mdp, policy, seeing.read(perception, self.mdp))
        return replace(seen, source=policy.source)

    @cached_property
    def head(self) -> dict[str, Any]:
        """How a report begins; what a policy was read as comes first."""
        mdp, has, said = self.mdp, self.has, self.options
        head: dict[str, Any] = {"model": self.loaded.name}
        if "start" in has:
            question = in_words(said) if self.question else None
            head |= {"sense": Shown(mdp.sense), "question": question, "start": said["start"]}
        if "criterion" in has:
            average = "reward per step" if self.criterion == "average" else None
            head["criterion"] = Shown(said["criterion"], average)
        if "kind" in has and self.taken is not None:
            read = Shown(self.taken.read_as, self.taken.source or None)
            head = {"read_as": read} | head | {"policy": self.form}
        if "perception" in has:
            path = said["perception"]
            head["perception"] = Shown(path, path and f"{path}, which the policy acts on")
        head["discount"] = mdp.discount
        if "horizon" in has:
            steps = self.horizon
            head["horizon"] = Shown(steps, None if steps is None else f"{steps:,} steps")
        return head

    def report(self, report: Report, **more: Any) -> Report:
        """Return what was found, after what was asked; `more` are facts that stand between."""
        facts = {**self.head, **more, **report.facts}
        stops = "horizon" in self.has and self.criterion == "total"
        notes = (*report.notes, *unlimited(self.mdp, "--horizon {}" * stops))
        return replace(report, facts=facts, notes=(*notes, *advice(self.endless)))

    def record(self, solver: str, seed: int | None = None) -> str:
        """Return the record of a result, as JSON."""
        name = self.loaded.name
        made = run_record(self.mdp, model=name, solver=solver, seed=seed, command=typed())
        return json.dumps(made, indent=2) + "\n"

    def saved(
        self, report: Report, out: str | None, name: str, made: tuple[str, int], *also: Path
    ) -> Report:
        """Write a report and its record (solver and seed) into a folder that holds `also`."""
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
    parameters: Sequence[str] = (),
    ranges: Sequence[str] = (),
    relative: str | None = None,
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
    parameters : NAME, optional
        Vary only this parameter. Unless given, all that MODEL has.
    ranges : NAME=LOW:HIGH, optional
        Vary a parameter from LOW to HIGH; or a .toml file with such ranges, NAME = [low, high].
    relative : X, optional
        Other ranges: today's value ± this share of it, 0.2 unless given; or whole, for all that a
        parameter may be.
    policy : POLICY, optional
        The policy held fixed, whose value and regret are shown; today's optimum unless given.
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
    options = dict(locals())
    if reach is not None and until is not None:
        fix = "leave out --until, or --reach"
        raise ModelError("--reach and --until ask two questions", where="--until", fix=fix)
    for needy, value, needed, fix in (
        ("--allowed", allowed, reach, "give --reach LABEL"),
        ("--reward", reward, until, "give --until LABEL, or MODEL.umb#NAME"),
    ):
        if value is not None and needed is None:
            raise ModelError(f"{needy} is part of another question", where=needy, fix=fix)
    asked = any(each is not None for each in (reach, until, start)) or minimize
    question = partial(posed, asked=options) if asked else None
    loaded = endless = read_model(model, sets=sets, discount=discount, start=start)
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
    return Given(
        endless=endless,
        loaded=loaded,
        question=question,
        criterion="average" if average else "total",
        horizon=horizon,
        form=policy,
        options=options,
        has=has,
    )


def advice(loaded: Loaded) -> tuple[str, ...]:
    """Return the note on models of care, and on models from records; nothing on others."""
    care = loaded.scenario is not None or loaded.name.startswith(OF_CARE)
    return (ADVICE,) * (care or loaded.mdp.observations is not None)
