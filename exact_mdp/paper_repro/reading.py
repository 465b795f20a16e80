"""One reading of the paper, with everything that its claims need, worked out when first asked for.

The default reading is the paper's text as `yuan2025` has it. Alternatives change one point at a
time, so that a verdict that depends on a reading can be told from one that does not.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from shutil import rmtree
from typing import Any

import numpy as np

from exact_mdp.analysis.readings import option_label
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.io.files import read_text, write_atomically
from exact_mdp.mdp.io.load import load_scenario
from exact_mdp.mdp.io.structured import json_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.table import Integers
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.completions import LearnedCompletions, counted
from exact_mdp.paper_repro.readings.learner import LEARNERS
from exact_mdp.paper_repro.readings.search import PAPER_READINGS, Averages, averages
from exact_mdp.paper_repro.readings.training import (
    SETTINGS,
    Learned,
    learn,
    setting,
    settings_of,
)
from exact_mdp.solvers.learning.schedules import Constant
from exact_mdp.solvers.proof.certificate import Certificate
from exact_mdp.solvers.proof.certify import certify
from exact_mdp.solvers.solver import solve
from exact_mdp.solvers.values.evaluate import Evaluation, evaluate
from exact_mdp.solvers.values.simulate import simulate

SEED = 20250101
TRAINING = "training."
NAMED = re.compile(r"code-[0-9a-f]{12}")


def _code() -> str:
    """Return the beginning of a digest of all `*.py` and `*.toml` files of the project."""
    digest, root = sha256(), Path(__file__).resolve().parents[1]
    rooms = (root / room for room in ("mdp", "solvers", "analysis", "paper_repro"))
    for path in sorted(p for r in rooms for p in r.rglob("*") if p.suffix in (".py", ".toml")):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:12]


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """How much is sampled: nothing else differs between a quick and a full run."""

    runs: int  # training runs of each exploration schedule
    episodes: int  # simulated ones that check each exact mean
    varied: int  # training runs of each schedule under each other setting of the learner
    supported: int = 8  # best supported readings under which open claims are worked out again
    dpi: int = 200  # of the figures as PNG


QUICK = Sizes(runs=100, episodes=10_000, varied=40, supported=2, dpi=110)
FULL = Sizes(runs=400, episodes=100_000, varied=100)


@dataclass(frozen=True, kw_only=True)
class Store:
    """Finished parts of a reproduction, so that an interrupted run goes on where it stopped.

    A part is stored under OUT/work, in a folder named after the source code that made it: a change
    of any module of the four packages starts afresh, nothing stale is ever read, and the main job
    deletes what other versions left. Within it, names carry the model's fingerprint and whatever
    else the part depends on. Each file is written whole or not at all. Nothing is kept where `root`
    is None.

    >>> Store().json("sum", lambda: 1 + 1)
    2
    """

    root: Path | None = None

    @classmethod
    def under(cls, out: Path) -> Store:
        """Return the store of an output folder, made where it is missing."""
        root = out / "work" / f"code-{_code()}"
        try:
            root.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ModelError(
                f"cannot make the folder: {error.strerror}", where=str(out), fix="name another"
            ) from error
        return cls(root=root)

    def clear_others(self) -> None:
        """Delete what other versions of the source code left beside this store."""
        for folder in self.root.parent.iterdir() if self.root else ():
            other = folder != self.root and NAMED.fullmatch(folder.name) is not None
            if other and folder.is_dir() and not folder.is_symlink():
                rmtree(folder, ignore_errors=True)

    @property
    def used(self) -> bool:
        """Whether something is stored already."""
        return self.root is not None and any(self.root.iterdir())

    def folder(self, name: str) -> Path | None:
        """Return where a part that keeps its own files may keep them; None without a store."""
        return None if self.root is None else self.root / name

    def json(self, name: str, compute: Callable[[], Any]) -> Any:
        """Return a part, read where it is stored, else computed and stored."""
        if self.root is None:
            return compute()
        path = self.root / f"{name}.json"
        if not path.exists():
            found = compute()
            write_atomically(path, json.dumps(found) + "\n")
            return found
        try:
            return json_of(read_text(path), str(path))
        except ModelError as error:
            raise ModelError(
                "the file is damaged", where=str(path), fix="delete it, and run again"
            ) from error


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """The model under one reading."""

    scenario: Scenario
    label: str = "default"  # what it changes: "default", or "reading = option"
    runs: int = QUICK.runs  # see `Sizes`
    episodes: int = QUICK.episodes
    varied: int = QUICK.varied
    store: Store = field(default_factory=Store)
    training: Mapping[str, Any] = field(default_factory=dict)  # settings of the learner that differ
    ends: LearnedCompletions | None = None  # those of a reading like it, instead of its own

    @cached_property
    def mdp(self) -> MDP:
        """The compiled model."""
        return self.scenario.compile()

    @cached_property
    def optimum(self) -> Integers:
        """(S,) an optimal action of each state."""
        return np.asarray(solve(self.mdp).policy)

    @cached_property
    def averages(self) -> Averages:
        """The three reported policies under every completion, all alike."""
        return averages(self.scenario)

    @cached_property
    def completions(self) -> LearnedCompletions:
        """How often training ends with each completion."""
        if self.ends is not None:
            return self.ends
        final = np.stack([self.learned(schedule).final for schedule in SETTINGS])
        return LearnedCompletions(counts=counted(final))

    @cached_property
    def weighed(self) -> Averages:
        """The averages, with the completions weighed by how often training ends with them."""
        return replace(self.averages, log_weights=self.completions.log_weights)

    @property
    def completion(self) -> dict[str, str]:
        """How the reported policies are filled in: as written, with the highest value."""
        return dict(reported.COMPLETIONS[self.averages.best()])

    @cached_property
    def policies(self) -> dict[str, Policy]:
        """By name: "optimal", "random", and "reported.ACTION" by the action in status 0000."""
        found = {
            "optimal": Policy.from_choices(self.mdp, self.optimum),
            "random": Policy.uniform(self.mdp),
        }
        for start in reported.STARTS:
            stated = reported.policy(start, self.completion)
            found[f"reported.{start}"] = Policy.of(self.mdp, stated)
        return found

    @cached_property
    def evaluations(self) -> dict[str, Evaluation]:
        """Exact evaluations of these policies.

        >>> print(f"{default(QUICK).evaluations['reported.non-directive'].mean:.4f}")
        142.0746
        """
        return {name: evaluate(self.mdp, policy) for name, policy in self.policies.items()}

    @cached_property
    def certificate(self) -> Certificate:
        """Exact optimal values and every optimal action, proven."""
        return certify(self.mdp)

    @cached_property
    def skip_model(self) -> MDP:
        """The same model with a timestep of its own for *skip*, whose rows show the skip rule."""
        return self.scenario.with_(readings={"skip_timestep": "own"}).compile()

    @cached_property
    def key(self) -> str:
        """Names this model in files."""
        return fingerprint(self.mdp).rpartition(":")[2][:12]

    @property
    def place(self) -> str:
        """Names this reading in files: the label, shortened."""
        return sha256(self.label.encode()).hexdigest()[:12]

    @cached_property
    def _learned(self) -> dict[str, Learned]:
        return {}

    def learned(self, schedule: str) -> Learned:
        """Return the training runs under an exploration schedule, "constant" or "decaying"."""
        if schedule not in self._learned:
            settings = settings_of(schedule, self.training)
            told = b"" if settings == SETTINGS[schedule] else repr(settings).encode()
            mark = told and f"-{sha256(told).hexdigest()[:8]}"
            folder = self.store.folder(f"training-{schedule}-{self.key}{mark or ''}")
            self._learned[schedule] = learn(
                self.mdp,
                schedule,
                runs=self.runs,
                seed=SEED,
                folder=folder,
                changes=self.training,
            )
        return self._learned[schedule]

    @cached_property
    def _taught(self) -> dict[str, Reading]:
        return {}

    def taught(self, label: str, *, runs: int, **settings: Any) -> Reading:
        """Return this reading with another learner, whose runs are kept under the label."""
        if label not in self._taught:
            told = {**self.training, **settings}
            self._taught[label] = replace(self, label=label, runs=runs, training=told)
        return self._taught[label]

    @property
    def power(self) -> float:
        """How fast a falling step falls: 0.5 n^-power at the n-th update of an entry.

        Where the end is not masked, values are 5.5 to 7 times as large, and n^-0.7 has not reached
        them after 6,000 epochs: they still grow with four times as many, and those of n^-0.55 do
        not.
        """
        return 0.55 if self.training.get("bootstrap_end") else 0.7

    @property
    def falling(self) -> Reading:
        """The same, learned with a falling step."""
        step = {"rate": Constant(0.5), "rate_power": self.power}
        return self.taught("falling step", runs=self.varied, **step)

    @property
    def learners(self) -> list[Reading]:
        """The same with each other set of the learner's own settings that is tried."""
        return [self.taught(each.label, runs=self.varied, **each.changes) for each in LEARNERS[1:]]

    def simulated(self, name: str) -> dict[str, float]:
        """Return the mean return of a policy by independent simulation, and its standard error.

        Raises ModelError where it is more than five standard errors from the exact mean.
        """

        def sample() -> dict[str, float]:
            found = simulate(self.mdp, self.policies[name], n=self.episodes, rng=SEED)
            return {"mean": found.mean, "standard_error": found.standard_error}

        found = dict(self.store.json(f"simulated-{name}-{self.episodes}-{self.key}", sample))
        exact = self.evaluations[name].mean
        if abs(found["mean"] - exact) > 5 * found["standard_error"]:
            raise ModelError(
                f"the exact mean {exact:.4f} and the simulated one {found['mean']:.4f} differ by "
                "more than five standard errors",
                where=f"policy {name}",
                fix="report this: one of the two is wrong",
            )
        return found

    def other(self, label: str, scenario: Scenario) -> Reading:
        """Return another reading, which nobody trains: it has the `ends` of this one."""
        return replace(self, scenario=scenario, label=label)


def default(sizes: Sizes, store: Store | None = None) -> Reading:
    """Return the default reading."""
    return Reading(
        scenario=Scenario.load("yuan2025"),
        runs=sizes.runs,
        episodes=sizes.episodes,
        varied=sizes.varied,
        store=store or Store(),
    )


def changed(base: Reading, sets: Sequence[str]) -> Reading:
    """Return the reading with KEY=VALUE changes: of the scenario, or training.KEY of the learner.

    >>> found = changed(default(QUICK), ["readings.status_cost=current", "training.rate=0.1"])
    >>> found.scenario.readings["status_cost"], found.training
    ('current', {'rate': Constant(value=0.1)})
    """
    learner: dict[str, Any] = {}
    scene = []
    for each in sets:
        if each.startswith(TRAINING):
            name, _, text = each.removeprefix(TRAINING).partition("=")
            learner |= setting(name.strip(), text.strip())
        else:
            scene.append(each)
    return Reading(
        scenario=load_scenario("yuan2025", sets=scene),
        label=", ".join(sets),
        runs=base.runs,
        episodes=base.episodes,
        varied=base.varied,
        store=base.store,
        training=learner,
    )


def alternatives(base: Reading) -> Iterator[Reading]:
    """Yield every reading that differs from the default in one point.

    >>> found = list(alternatives(default(QUICK)))
    >>> len(found), found[0].label
    (16, 'influence_orientation = column-to-row')
    """
    for name, options in PAPER_READINGS.options.items():
        for option in options[1:]:
            told = option_label(option)
            changed = PAPER_READINGS.apply(base.scenario, PAPER_READINGS.number(**{name: option}))
            yield base.other(f"{name} = {told}", changed)
