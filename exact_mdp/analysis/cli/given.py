"""The options that commands share: the model, the question about it, and the policy."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from exact_mdp.analysis.cli.words import list_command_words, pairs_of
from exact_mdp.analysis.pages import ADVICE
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.care import perception as seeing
from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.load import Loaded, read_model
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parametric
from exact_mdp.mdp.policies.choices import find_policy_format
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.questions.horizon import describe_time_limit
from exact_mdp.mdp.questions.origin import Question
from exact_mdp.mdp.questions.until import ask_component
from exact_mdp.mdp.report import Report, Shown
from exact_mdp.mdp.sense import Sense
from exact_mdp.solvers.arguments import Criterion, is_average, require_no_horizon
from exact_mdp.solvers.values.policy_chain import policy_of

OF_CARE = "gymnasium:icu_sepsis"  # a model of care that is not a scenario
QUESTION = ("reach", "until", "reward", "allowed", "minimize", "maximize", "start")


def pose_question(mdp: MDP, *, asked: dict[str, Any], limited: bool = False) -> MDP:
    """Return the model whose optimal value answers the question of --reach, --until and others.

    A probability is maximised unless --minimize is given, also in a model of costs. If it is
    `limited`, the components that do not count remain, so that limits can name them.
    """
    changes = {}
    if asked["start"] is not None:
        changes["start"] = asked["start"]
    if asked["minimize"]:
        changes["sense"] = Sense.MIN
    elif asked["maximize"] or asked["reach"] is not None:
        changes["sense"] = Sense.MAX
    if changes:
        mdp = mdp.with_(**changes)
    if asked["reward"] is not None:
        mdp = ask_component(mdp, asked["reward"], others=limited)
    if asked["reach"] is not None:
        return mdp.reaching(asked["reach"], asked["allowed"])
    if asked["until"] is not None:
        return mdp.until(asked["until"])
    return mdp


@dataclass(frozen=True, kw_only=True, eq=False)
class Given:
    """The model, question and policy that a command names; each is read when it is first needed.

    Parameters
    ----------
    model : MODEL
    has : sequence of str
        The options that the command has.
    limited : bool
        Whether there are limits on components.
    parameters : NAME, optional
        Vary only this parameter. Unless given, all parameters of MODEL vary.
    ranges : NAME=LOW:HIGH, optional
        Vary a parameter from LOW to HIGH; or a .toml file with such ranges, NAME = [low, high].
    relative : X, optional
        Other ranges: today's value ± this share of it, 0.2 unless given; or whole, for all values
        that a parameter may have.
    policy : POLICY, optional
        The policy held fixed, whose value and regret are shown; today's optimum unless given.
    criterion : "total" or "average"
        What counts: the total reward, or the average reward per step in the long run, whatever the
        discount.
    horizon : N, 0 to 1000000000
        Stop every episode after N steps, without a further reward.
    kind : "q", "policy" or "auto"
        What an array in a file is: a Q-table, or probabilities of actions.
    perception : FILE, optional
        The policy acts on a perceived status: {formats:PERCEPTIONS}.
    reach : LABEL, optional
        Ask for the greatest probability of reaching a label, or the states of an expression such
        as 'x=3 & y>1'; with --minimize, the least.
    until : LABEL, optional
        Ask for the greatest expected reward until a label; for costs, the least.
    reward : NAME, optional
        The component of the reward that counts, beside which limits may name others; all together
        unless given.
    allowed : LABEL, optional
        With --reach: only along states with this label.
    minimize : bool
        Minimise: rewards are costs. For a probability, ask for the least.
    maximize : bool
        Maximise, even where the model's rewards are costs.
    start : STATE, optional
        Start in this state, a number or a name.
    sets : KEY=VALUE
        Change a scenario: base.anger=1/10, tasks=[3,1], readings.NAME=OPTION.
    envs : NAME=VALUE
        An option of the environment of gymnasium:ID: is_slippery=False, map_name=8x8.
    constants : A=1,B=2
        Constants that a program leaves open (extra models): {formats:PROGRAMS}.
    discount : G, optional
        Discount instead of the model's own: 0.95 or 19/20.

    Keys
    ----
    model: name of the model, or its file; sense: `min` if the least value is asked for, as in a
    model of costs, else `max`; question: what `--reach`, `--until`, `--minimize` or `--maximize`
    asks, in words, or null; start: the state of `--start`, or null; criterion: `total` reward, or
    `average` reward per step; read_as: how an array was read, as `q` or `policy`; policy: the name
    of the policy given, or the policy of the answer (by status at subtask 0 and trial 0 in
    scenarios, with probabilities if it is mixed); perception: the file of `--perception`, or null;
    discount: the discount; horizon: steps after which an episode stops, or null; claim:
    `certified`, `bounded`, `checked` or `estimated`; kind: the kind of analysis; start_value: the
    optimal value at the start, "inf" or "-inf" if infinite; error_bound: greatest error of the
    number before it; error_bounds: greatest errors of several numbers; states: number of states;
    pairs: number of state-action pairs; transitions: number of transitions of positive probability;
    model_hash: SHA-256 of the model's exact content; seconds: time taken; seed: seed of the random
    numbers; written: files written; format: version of this format, 2; notice: that this is
    research software and no medical advice; without_range: parameters without a range to move in.
    """

    model: str
    has: Collection[str] = ()
    limited: bool = False
    parameters: Sequence[str] = ()
    ranges: Sequence[str] = ()
    relative: str | None = None
    policy: str | None = None
    criterion: Criterion = "total"
    horizon: int | None = None
    kind: str = "auto"
    perception: str | None = None
    reach: str | None = None
    until: str | None = None
    reward: str | None = None
    allowed: str | None = None
    minimize: bool = False
    maximize: bool = False
    start: str | None = None
    sets: Sequence[str] = ()
    envs: Sequence[str] = ()
    constants: str | None = None
    discount: str | None = None

    def __post_init__(self) -> None:
        if self.reach is not None and self.until is not None:
            fix = "leave out --until, or --reach"
            raise ModelError("--reach and --until ask two questions", where="--until", fix=fix)
        if self.kind != "auto" and "policy" in self.has and self.policy is None:
            fix = "name the file as POLICY, after MODEL, or leave --kind out"
            if "parameters" in self.has:
                fix = "name the file: --policy FILE, or leave --kind out"
            what = "--kind says what an array in a file is, and no policy is given"
            raise ModelError(what, where="--kind", fix=fix)
        if self.reach is not None and self.reward is not None:
            fix = "leave out --reward, or --reach"
            raise ModelError("a probability counts no reward", where="--reward", fix=fix)
        if self.minimize and self.maximize:
            fix = "leave out --maximize, or --minimize"
            raise ModelError("--minimize and --maximize contradict", where="--maximize", fix=fix)
        for needy, value, needed, fix in (
            ("--allowed", self.allowed, self.reach, "give --reach LABEL"),
        ):
            if value is not None and needed is None:
                raise ModelError(f"{needy} is part of another question", where=needy, fix=fix)
        if is_average(self.criterion):
            require_no_horizon(self.horizon)
            if self.reach is not None or self.until is not None:
                raise ModelError(
                    "an average reward per step has no target",
                    where="--criterion",
                    fix="leave out --reach and --until, or --criterion",
                )

    @cached_property
    def loaded(self) -> Loaded:
        """The model as it is."""
        return read_model(
            self.model,
            sets=self.sets,
            env=pairs_of(self.envs, "--env"),
            constants=self.constants,
            discount=self.discount,
            start=self.start,
        )

    def with_limits(self, limited: object) -> Given:
        """Return the same; if there are limits, the model keeps all components for them."""
        if not limited:
            return self
        given = replace(self, limited=True)
        vars(given)["loaded"] = self.loaded
        return given

    @cached_property
    def question(self) -> partial[MDP] | None:
        """The function that makes the model of the question; None if no option asks one."""
        asked = {name: getattr(self, name) for name in QUESTION}
        if not {*asked.values()} - {None, False}:
            return None
        return partial(pose_question, asked=asked, limited=self.limited)

    @cached_property
    def asked(self) -> MDP:
        """The model of the question, without the horizon."""
        if self.question is None:
            return self.loaded.mdp
        return self.question(self.loaded.mdp)

    @cached_property
    def mdp(self) -> MDP:
        """The model of the question, whose episodes stop at the horizon."""
        if self.horizon is None:
            return self.asked
        return self.asked.within(self.horizon)

    @cached_property
    def family(self) -> Parametric:
        """The model with its parameters; a compiled scenario is not compiled again."""
        scenario = self.loaded.scenario
        if scenario is None:
            return parametric(self.mdp)
        family: Parametric = ScenarioFamily(scenario=scenario, base=self.loaded.mdp)
        if self.question is not None:
            family = family.with_question(self.question)
        if self.horizon is not None:
            family = family.with_question(Question("within", {"steps": self.horizon}))
        return family

    @cached_property
    def taken(self) -> Any:
        """The policy that was named; None without one.

        "optimal" stays a word if parameters vary, as the policy is then re-optimised.
        """
        if "policy" not in self.has or (self.policy or self.perception) is None:
            return None
        form = self.policy or "optimal"
        if (form, self.perception) == ("optimal", None) and {"parameters", "ranges"} & {*self.has}:
            return form
        return self.policy_from(form)

    @property
    def fixed(self) -> Any:
        """The policy held fixed, by default the optimum."""
        if self.taken is None:
            return "optimal"
        return self.taken

    @property
    def held(self) -> dict[str, Any]:
        """The policy held fixed and the criterion, as analyses take them."""
        return {"policy": self.fixed, "criterion": self.criterion}

    def policy_from(self, form: str) -> Policy:
        """Return the policy that a text names; with --perception, acting on perceived states.

        "optimal" is the optimum for the true states, also under a perception.
        """
        # Of two policies, as in a tornado, one may be an array.
        files = {each: find_policy_format(each) for each in (form, self.policy or form)}
        arrays = [each for each, file in files.items() if file and "kind" in file.options]
        kind = self.kind if form in arrays else "auto"
        policy: Policy = policy_of(self.mdp, form, kind=kind, criterion=self.criterion)
        if self.kind != "auto" and not arrays:  # a file that is not read was refused above
            what = f"--kind says what an array in a file is, and {form!r} is not such a file"
            raise ModelError(what, where="--kind", fix="leave it out")
        if self.perception is None:
            return policy
        matrix, _ = seeing.read_confusion_matrix(self.perception, self.mdp)
        return replace(seeing.perceived(self.mdp, policy, matrix), source=policy.source)

    def in_words(self) -> str | None:
        """Return the question in words; None if no option asks one."""
        best = self.asked.sense.best
        if self.reach is not None:
            through = ""
            if self.allowed:
                through = f" through {self.allowed}"
            return f"{best} probability of reaching {self.reach}{through}"
        amount = self.loaded.mdp.sense.amount
        if self.minimize:
            amount = Sense.MIN.amount
        if self.until is not None:
            return f"{best} expected {self.reward or amount} until {self.until}"
        if not (self.minimize or self.maximize or self.reward):
            return None
        if is_average(self.criterion):
            return f"{best} {self.reward or amount} per step in the long run"
        return f"{best} expected {self.reward or f'{amount}s'}"

    def _describe_sense(self) -> Shown:
        """Return the sense, shown to people only if costs are minimised."""
        if self.mdp.sense.costs and self.reach is None:
            return Shown(self.mdp.sense, "min: costs are minimised")
        return Shown(self.mdp.sense, None)

    @cached_property
    def head(self) -> dict[str, Any]:
        """The facts at the beginning of a report: the model, the question and the policy."""
        has, head = self.has, dict[str, Any](model=self.loaded.name)
        if "reach" in has:
            head |= {"sense": self._describe_sense(), "question": self.in_words()}
        if "reach" in has or self.start is not None:
            head["start"] = self.start
        if "criterion" in has:
            if is_average(self.criterion):
                average = "reward per step"
            else:
                average = None
            head["criterion"] = Shown(self.criterion, average)
        if "kind" in has and self.taken is not None:
            # How the policy was read comes first.
            read: Any = "policy"
            if not isinstance(self.taken, str):
                read = Shown(self.taken.read_as, self.taken.source or None)
            head = {"read_as": read} | head | {"policy": self.policy}
        if "perception" in has:
            path = self.perception
            head["perception"] = Shown(path, path and f"{path}, which the policy acts on")
        head["discount"] = self.mdp.discount
        if "horizon" in has:
            text = None
            if self.horizon is not None:
                text = f"{self.horizon:,} steps"
            head["horizon"] = Shown(self.horizon, text)
        return head

    def complete_report(self, report: Report, **more: Any) -> Report:
        """Return a report that begins with the question, then `more` facts, then the results."""
        facts = {**self.head, **more, **report.facts}
        # A note on the time limit names the option of the command, not the one in Python.
        in_python = on_command_line = ""
        if "horizon" in self.has and not is_average(self.criterion):
            in_python, on_command_line = "horizon={}", "--horizon {}"
        replaced = describe_time_limit(self.mdp, in_python)
        notes = [each for each in report.notes if each not in replaced]
        notes += describe_time_limit(self.mdp, on_command_line)
        return replace(report, facts=facts, notes=(*notes, *list_advice(self.loaded)))

    def format_record(self, solver: str, seed: int | None = None) -> str:
        """Return the record of a result, as JSON."""
        name = self.loaded.name
        made = run_record(
            self.mdp, model=name, solver=solver, seed=seed, command=list_command_words()
        )
        return json.dumps(made, indent=2) + "\n"

    def save_report(
        self, report: Report, out: str | None, name: str, made: tuple[str, int], *also: Path
    ) -> Report:
        """Write a report and its record into a folder with the files `also`."""
        if out is None:
            return report
        paths = [Path(out, name), *also, Path(out, "run.json")]
        report = replace(report, facts={**report.facts, "written": [str(path) for path in paths]})
        write_atomically(paths[0], report.json() + "\n")
        write_atomically(paths[-1], self.format_record(*made))
        return report


def list_advice(loaded: Loaded) -> tuple[str, ...]:
    """Return the advice for models of care and models from records; nothing for others."""
    care = loaded.scenario is not None or loaded.name.startswith(OF_CARE)
    if care or loaded.mdp.observations is not None:
        return (ADVICE,)
    return ()
