"""One reading of the paper, with everything that its claims need, worked out when first asked for.

The default view is the paper's text as `yuan2025` reads it. Alternatives change one reading at a
time, so that a verdict that hangs on a reading can be told from one that does not.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from hashlib import sha256
from typing import Any

from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.mdp.care.tables import READINGS
from exact_mdp.mdp.fingerprint import fingerprint
from exact_mdp.paper_repro.learned import Learned, learn
from exact_mdp.paper_repro.numbers import Study, study
from exact_mdp.paper_repro.store import Store
from exact_mdp.solvers import certify
from exact_mdp.solvers.proof.certificate import Certificate

SEED = 20250101
TASKS = ("[3]", "[3, 1]", "[2]", "[4]", "[1, 1, 1]", "[6]")
DISCOUNTS = ("1", "19/20")


@dataclass(frozen=True, kw_only=True)
class Sizes:
    """How much is sampled: nothing else differs between a quick and a full run.

    Attributes
    ----------
    runs : int
        Training runs of each exploration schedule.
    episodes : int
        Simulated episodes that check each exact mean.
    alternative_runs : int
        Training runs under each alternative reading; 0 tries no learning there.
    supported : int
        Readings, the best supported ones, under which open claims are worked out again.
    dpi : int
        Dots per inch of the figures as PNG.
    """

    runs: int
    episodes: int
    alternative_runs: int
    supported: int = 8
    dpi: int = 200


QUICK = Sizes(runs=100, episodes=10_000, alternative_runs=0, supported=2, dpi=110)
FULL = Sizes(runs=400, episodes=100_000, alternative_runs=40)


@dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """The model under one reading.

    Attributes
    ----------
    scenario : Scenario
    label : str
        What it changes: "default", or "reading = option".
    runs, episodes : int
        See `Sizes`.
    store : Store
    """

    scenario: Scenario
    label: str = "default"
    runs: int = QUICK.runs
    episodes: int = QUICK.episodes
    store: Store = field(default_factory=Store)

    @cached_property
    def study(self) -> Study:
        """The optimum and the policies that the paper speaks of."""
        return study(self.scenario)

    @property
    def mdp(self) -> MDP:
        """The compiled model."""
        return self.study.mdp

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
            folder = self.store.folder(f"training-{schedule}-{self.key}")
            self._learned[schedule] = learn(
                self.mdp, schedule, runs=self.runs, seed=SEED, folder=folder
            )
        return self._learned[schedule]

    def simulated(self, name: str) -> dict[str, float]:
        """Return the mean return of a policy by independent simulation, and its standard error.

        Raises
        ------
        ModelError
            Where it is more than five standard errors from the exact mean.
        """

        def sample() -> dict[str, float]:
            from exact_mdp.solvers import simulate

            found = simulate(self.mdp, self.study.policies[name], n=self.episodes, rng=SEED)
            return {"mean": found.mean, "standard_error": found.standard_error}

        found = dict(self.store.json(f"simulated-{name}-{self.episodes}-{self.key}", sample))
        exact = self.study.evaluations[name].mean
        if abs(found["mean"] - exact) > 5 * found["standard_error"]:
            raise ModelError(
                f"the exact mean {exact:.4f} and the simulated one {found['mean']:.4f} differ by "
                "more than five standard errors",
                where=f"policy {name}",
                fix="report this: one of the two is wrong",
            )
        return found


def default_view(sizes: Sizes, store: Store | None = None) -> View:
    """Return the default reading."""
    return View(
        scenario=Scenario.load("yuan2025"),
        runs=sizes.runs,
        episodes=sizes.episodes,
        store=store or Store(),
    )


def alternatives(base: View, sizes: Sizes) -> Iterator[View]:
    """Yield every reading that differs from the default in one point.

    Examples
    --------
    >>> views = list(alternatives(default_view(QUICK), QUICK))
    >>> len(views), views[0].label
    (16, 'influence_orientation = column-to-row')
    """
    changes: list[tuple[str, Mapping[str, Any]]] = [
        (f"{name} = {option}", {"readings": {name: option}})
        for name, options in READINGS.items()
        for option in options[1:]
    ]
    changes += [(f"tasks = {tasks}", {"tasks": tasks}) for tasks in TASKS[1:]]
    changes += [(f"evaluation_discount = {rate}", {"discount": rate}) for rate in DISCOUNTS[1:]]
    for label, change in changes:
        yield View(
            scenario=base.scenario.with_(**change),
            label=label,
            runs=sizes.alternative_runs,
            episodes=base.episodes,
            store=base.store,
        )
