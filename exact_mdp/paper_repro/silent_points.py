"""The points that the text leaves open, and the model and training runs under one reading of them.

Eight points of the rules are open, 576 combinations in all; "respectively" can be taken in two
orders; the number of subtasks, the discount of the experiments' returns and the actions in four
statuses are not stated. `paper.toml` has the words. The default reading takes them in their plain
sense; it was not chosen by these returns.

How far the reported returns support a reading r with an order o is the likelihood

    L(r, o) = Π_i N(a_i; m_i, v_i / 1000) · N(70; m_random, 5²)

of the three averages a_i and of the random strategy's return, of about 70; m_i and v_i are the
exact mean and variance. Weights are L divided by its sum. In the four statuses that the text does
not mention the policies are supportive, which is optimal there under the default reading.

Training is as the paper describes it (Section 3.2.4), many times over: Q-learning over the 16
statuses, learning rate 0.05, discount 0.95, 6,000 epochs of 30 episodes, ε constant at 0.1 or
decaying (Equation 2). The paper trains once with each schedule; here each is trained with many
seeds, so that the outcome of one run can be told from chance.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from itertools import product
from math import log, sqrt
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exact_mdp import (
    MDP,
    Certificate,
    Constant,
    ModelError,
    Policy,
    QLearning,
    Scenario,
    TrainingRun,
    certify,
    evaluate,
    learning_curve,
    outcomes,
    solve,
    train,
)
from exact_mdp.mdp import ScenarioWarning
from exact_mdp.paper_repro.paper import (
    ABOUT,
    ANGRY,
    AVERAGES,
    EXPERIMENTS,
    OPEN,
    ORDERS,
    PAPER,
    REPORTED,
)
from exact_mdp.solvers.learning.row_policies import common_rows, evaluate_row_policies
from exact_mdp.solvers.learning.schedules import PAPER_CONSTANT, PAPER_DECAYING

if TYPE_CHECKING:
    from exact_mdp.analysis.learning.curves import LearningCurve
    from exact_mdp.analysis.learning.outcomes import Outcomes

OPTIONS: dict[str, dict[str, str]] = {  # of each point, the default first
    name: point["options"] for name, point in PAPER["open_points"].items()
}
POINTS = {name: options for name, options in OPTIONS.items() if name != "respectively"}
TASKS = ((3, 1), (2,), (4,), (1, 1, 1), (6,))  # beside one task of three subtasks
ELSEWHERE: dict[str, dict[str, Any]] = {  # one change that is none of the eight points
    **{f"subtasks of each task: {', '.join(map(str, each))}": {"tasks": each} for each in TASKS},
    "returns discounted by 0.95 a timestep": {"discount": "19/20"},
}
SWAPPED = OPTIONS["respectively"]["swapped"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Reading:
    """The model under one reading of the text, with everything that claims ask of it."""

    scenario: Scenario
    label: str = "default"  # the changed details
    order: str = "as written"  # of "respectively"
    runs: int = 100  # training runs of each schedule
    folder: Path | None = None  # where finished training runs are kept
    training: Mapping[str, Any] = field(default_factory=dict)  # settings of the learner that differ

    @cached_property
    def mdp(self) -> MDP:
        """The compiled model."""
        return compile_quietly(self.scenario)

    @cached_property
    def certificate(self) -> Certificate:
        """Exact optimal values, proven."""
        return certify(self.mdp)

    @cached_property
    def optimum(self) -> np.ndarray:
        """(S,) an optimal action of each state."""
        return np.asarray(solve(self.mdp).policy)

    def find_reported_policy(self, start: str, order: str = "") -> dict[str, str]:
        """Return the reported policy with an action in status 0000, by status."""
        stated = {**REPORTED["stated"], **ORDERS[order or self.order]}
        return dict.fromkeys((*OPEN, *ANGRY), "supportive") | stated | {"0000": start}

    def build_policy(self, name: str, order: str = "") -> Policy:
        """Return a policy: "optimal", "random", or a reported one by its action in 0000."""
        if name == "optimal":
            return Policy.of(self.mdp, self.optimum)
        return Policy.of(
            self.mdp, name if name == "random" else self.find_reported_policy(name, order)
        )

    def evaluate_policy(self, name: str, order: str = "") -> Any:
        """Return the exact evaluation of a policy: mean, sd and the proven error of the mean."""
        key = ("value", name, order or self.order)
        if key not in self._known:
            self._known[key] = evaluate(self.mdp, self.build_policy(name, order))
        return self._known[key]

    def standard_error(self, start: str, order: str = "") -> float:
        """Return the exact standard error of the paper's average of a reported policy."""
        return float(self.evaluate_policy(start, order).sd / sqrt(EXPERIMENTS))

    def compute_deviation(self, start: str, order: str = "") -> float:
        """Return by how many standard errors the exact mean is above the paper's average."""
        above = self.evaluate_policy(start, order).mean - AVERAGES[start]
        return float(above / self.standard_error(start, order))

    def train_runs(self, schedule: str) -> Learned:
        """Return the training runs under an exploration schedule, "constant" or "decaying"."""
        key = ("learned", schedule)
        if key not in self._known:
            self._known[key] = train_learner(
                self.mdp, schedule, self.runs, folder=self.folder, changes=self.training
            )
        learned: Learned = self._known[key]
        return learned

    @cached_property
    def _known(self) -> dict[tuple[str, ...], Any]:
        return {}

    @cached_property
    def falling(self) -> Reading:
        """The same, learned with a step of 0.5 n^-0.7 at the n-th update of an entry."""
        step = {"rate": 0.5, "rate_power": 0.7}
        # At least 30 with each schedule: 59 runs that all agree show with 95 % confidence that
        # 95 % of all runs do.
        return replace(self, runs=max(self.runs // 4, 30), training={**self.training, **step})

    @cached_property
    def skip_model(self) -> MDP:
        """The same model with a timestep of its own for *skip*, whose rows show the skip rule."""
        return compile_quietly(self.scenario.with_(readings={"skip_timestep": "own"}))


def compile_quietly(scenario: Scenario) -> MDP:
    """Return the model; that influences may add up to over 1, and are cut off, is known here."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ScenarioWarning)
        return scenario.compile()


def build_default_reading(**sizes: Any) -> Reading:
    """Return the default reading."""
    return Reading(scenario=Scenario.load("yuan2025"), **sizes)


def one_change(base: Reading) -> list[Reading]:
    """Return every reading that differs from the default in one point."""
    readings = []
    for name, options in POINTS.items():
        for option in list(options)[1:]:
            other = base.scenario.with_(readings={name: option})
            readings.append(replace(base, scenario=other, label=options[option]))
    for label, change in ELSEWHERE.items():
        readings.append(replace(base, scenario=base.scenario.with_(**change), label=label))
    return [*readings, replace(base, order="swapped", label=SWAPPED)]


def log_likelihood(reading: Reading, order: str) -> float:
    """Return the logarithm of the likelihood of the reported returns, up to a constant."""
    random = reading.evaluate_policy("random").mean
    # The random strategy is reported as "around 70", read as a normal error of `ABOUT` points.
    total = -0.5 * ((random - REPORTED["random"]) / ABOUT) ** 2
    for start, average in AVERAGES.items():
        exact = reading.evaluate_policy(start, order)
        # A mean of 1,000 experiments is normal with the exact standard error of the policy.
        variance = exact.sd**2 / EXPERIMENTS
        total -= 0.5 * (exact.mean - average) ** 2 / variance + 0.5 * log(variance)
    return float(total)


@dataclass(frozen=True, kw_only=True, eq=False)
class Support:
    """How far the reported returns support each combination of points, in both orders."""

    readings: Sequence[Reading]  # (N,) each with its order; the default first
    choices: Sequence[Mapping[str, str]]  # (N,) the option of each point
    weights: np.ndarray  # (N,) that add up to 1

    @property
    def best(self) -> Reading:
        """The best supported reading."""
        return self.readings[int(self.weights.argmax())]

    @property
    def rank(self) -> int:
        """The rank of the default reading."""
        return int((self.weights > self.weights[0]).sum()) + 1

    def of_options(self) -> dict[str, dict[str, float]]:
        """Return the weight of each option of each point."""
        shares: dict[str, dict[str, float]] = {}
        for point, options in OPTIONS.items():
            shares[point] = {}
            for option in options:
                chosen = [choice[point] == option for choice in self.choices]
                shares[point][option] = float(self.weights[chosen].sum())
        return shares


def compute_support(base: Reading, progress: Callable[[str], None] = lambda text: None) -> Support:
    """Evaluate all 576 combinations of the eight points, with both orders of "respectively"."""
    readings, choices, logs = [], [], []
    for options in product(*POINTS.values()):
        # The label of a combination names the points that differ from the default.
        chosen = dict(zip(POINTS, options, strict=True))
        changes = []
        for point, option in chosen.items():
            if option != next(iter(POINTS[point])):
                changes.append(POINTS[point][option])
        scenario = base.scenario.with_(readings=chosen)
        one = replace(base, scenario=scenario)
        for order in ORDERS:
            logs.append(log_likelihood(one, order))
            named = [*changes]
            if order == "swapped":
                named.append(SWAPPED)
            label = "; ".join(named) or "default"
            # A new reading each time, so that cached results do not fill memory.
            readings.append(replace(base, scenario=scenario, order=order, label=label))
            choices.append({**chosen, "respectively": order})
        progress(f"{len(readings) // 2} readings of the text")
    # Weights are proportional to the likelihoods: every combination was as likely before.
    weights = np.exp(np.array(logs) - max(logs))
    return Support(readings=readings, choices=choices, weights=weights / weights.sum())


def describe_readings(evidence: Support, changed: Sequence[Reading]) -> dict[str, Any]:
    """Return the report's facts about the readings: options, the best, and single changes."""
    best = evidence.best

    def describe_reading(reading: Reading, order: str) -> dict[str, Any]:
        return {
            "label": reading.label,
            "order": order,
            "averages": {start: reading.evaluate_policy(start, order).mean for start in AVERAGES},
            "errors": {start: reading.compute_deviation(start, order) for start in AVERAGES},
            "random": reading.evaluate_policy("random").mean,
            "log_likelihood": log_likelihood(reading, order),
        }

    # The default in both orders, then each single change in the order that fits better.
    rows = [describe_reading(changed[0], order) for order in ORDERS]
    for each in changed[1:]:
        if each.order == "as written":
            rows.append(
                max((describe_reading(each, o) for o in ORDERS), key=lambda r: r["log_likelihood"])
            )
    # Changes of other numbers than the silent points: how far their averages are at best.
    far = [row for row in rows if row["label"] in ELSEWHERE]
    chosen = evidence.choices[int(evidence.weights.argmax())].items()
    changes = []
    for p, option in chosen:
        if option != next(iter(OPTIONS[p])):
            changes.append(f"readings.{p}={option}")
    options = evidence.of_options()
    sizes = []
    for row in far:
        for error in row["errors"].values():
            sizes.append(abs(error))
    return {
        "combinations": len(evidence.readings) // len(ORDERS),
        "identified": [p for p, each in options.items() if max(each.values()) >= 0.95],
        "least_elsewhere": min(sizes),
        "options": options,
        "best": describe_reading(best, best.order)
        | {"weight": float(evidence.weights.max()), "set": changes},
        "default_rank": evidence.rank,
        "default_weight": float(evidence.weights[0]),
        "one_change": rows,
    }


# ---- training ------------------------------------------------------------------------------------

SEED = 20250101  # of all training runs; any other would do
CURVES = 2**20  # the child of the seed that curves are drawn from
CONVERGED = 1000  # last epochs, over which a curve is averaged
SETTINGS = {
    "constant": QLearning(exploration=PAPER_CONSTANT),
    "decaying": QLearning(exploration=PAPER_DECAYING),
}
SHOWN = {"constant": "constant ε", "decaying": "decaying ε"}


def change_settings(schedule: str, changes: Mapping[str, Any]) -> QLearning:
    """Return the learner under an exploration schedule, with settings of `QLearning` changed.

    >>> change_settings("constant", {"ties": "random"}).ties
    'random'
    """
    changes = dict(changes)
    if "rate" in changes:
        changes["rate"] = Constant(float(changes["rate"]))
    try:
        return replace(SETTINGS[schedule], **changes)
    except TypeError as error:
        names = ", ".join(vars(SETTINGS[schedule]))
        raise ModelError(
            f"the learner has no such setting: {error}",
            where="training",
            fix=f"change one of {names}",
        ) from None


@dataclass(frozen=True, kw_only=True)
class Learned:
    """Training runs under one exploration schedule, with the exact values of final policies."""

    schedule: str
    runs: list[TrainingRun]
    outcomes: Outcomes

    @cached_property
    def values(self) -> np.ndarray:
        """(R, E) exact value of the greedy policy of every epoch of every run."""
        mdp, runs = self.outcomes.mdp, self.runs
        rows = common_rows(mdp, runs)
        return np.array(
            [evaluate_row_policies(mdp, rows, r.policies).value[r.snapshots] for r in runs]
        )

    @cached_property
    def converged(self) -> np.ndarray:
        """(R,) each run's mean over the last `CONVERGED` epochs."""
        return np.asarray(self.values[:, -CONVERGED:].mean(axis=1))

    @cached_property
    def final(self) -> np.ndarray:
        """(R, 16) final greedy policies, an action number for each status."""
        return np.asarray(self.outcomes.policies[self.outcomes.final])

    @cached_property
    def last(self) -> list[np.ndarray]:
        """For each run the different greedy policies of its last 100 episodes, (U, 16)."""
        return [run.policies[np.unique(run.last)] for run in self.runs]

    @property
    def drawn(self) -> LearningCurve:
        """The first run's curve as the paper draws it: 40 experiments each epoch."""
        source = spawn_seed(CURVES, list(SETTINGS).index(self.schedule))
        return learning_curve(self.outcomes.mdp, self.runs[0], rng=source)

    def find_common_actions(self) -> tuple[np.ndarray, np.ndarray]:
        """Return (16,) the most frequent final action of each status, and its share of runs."""
        actions = self.outcomes.mdp.n_actions
        shares = np.stack([(self.final == a).mean(axis=0) for a in range(actions)], axis=1)
        return shares.argmax(axis=1), shares.max(axis=1)


def spawn_seed(*numbers: int) -> np.random.SeedSequence:
    """Return a descendant of the seed, the same however many there are."""
    return np.random.SeedSequence(SEED, spawn_key=numbers)


def train_learner(
    mdp: MDP, schedule: str, runs: int, *, folder: Path | None, changes: Mapping[str, Any]
) -> Learned:
    """Train with this many seeds; runs that the folder holds are not done again."""
    chosen = change_settings(schedule, changes)
    if folder is not None:
        # The folder is named after the model and the settings, so that other runs are not taken for
        # these.
        rows = np.concatenate([mdp.transition.data, mdp.reward]).tobytes()
        mark = sha256(rows + repr(chosen).encode()).hexdigest()[:12]
        folder = folder / f"{schedule}-{mark}"
    source = spawn_seed(list(SETTINGS).index(schedule))
    trained = train(mdp, chosen, runs, rng=source, n_jobs=None, out=folder)
    results = outcomes(mdp, trained, bound=False)
    return Learned(schedule=schedule, runs=trained, outcomes=results)
