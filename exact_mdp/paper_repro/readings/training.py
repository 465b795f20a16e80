"""Training as the paper describes it, many times over, and what Q-learning ends with.

Section 3.2.4 of Yuan et al. (2025): Q-learning over the 16 statuses, learning rate 0.05, discount
0.95, 6,000 epochs of 30 episodes, ε constant at 0.1 or decaying (Equation 2). The paper trains once
with each; here each is trained with many seeds, so that what one run shows can be told from chance.

The paper counts the greedy policies of the last 100 episodes: three with constant exploration, two
with decaying exploration (Section 4.1). Whether a reading makes that likely is
found by training with the paper's settings (Section 3.2) from many seeds: among S runs, k show the
reported number, and the likelihood is estimated by (k + 1) / (S + 2), the posterior mean under a
uniform prior; shares come with Wilson's interval. Training uses its own discount, so readings that
differ in the evaluation discount alone share their runs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.learning.curves import (
    LearningCurve,
    exact_curves,
    learning_curve,
    random_curve,
)
from exact_mdp.analysis.learning.outcomes import Interval, Outcomes, outcomes, share_interval
from exact_mdp.analysis.readings import ReadingSpace, posterior
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.completions import by_reading, counted
from exact_mdp.paper_repro.readings.evidence import Evidence
from exact_mdp.paper_repro.readings.search import ReadingSearch
from exact_mdp.paper_repro.reported import ANGRY, NUMBER, STARTS, UNIQUE_POLICIES
from exact_mdp.solvers.learning.q_learning import QLearning, Trainer, TrainingRun
from exact_mdp.solvers.learning.sampler import child
from exact_mdp.solvers.learning.schedules import (
    PAPER_CONSTANT,
    PAPER_DECAYING,
    Constant,
    Exponential,
)
from exact_mdp.solvers.learning.training import train
from exact_mdp.solvers.parallel import many

SETTINGS = {
    "constant": QLearning(exploration=PAPER_CONSTANT),
    "decaying": QLearning(exploration=PAPER_DECAYING),
}
SHOWN = {"constant": "constant ε", "decaying": "decaying ε"}
CONVERGED = 1000  # last epochs, over which a curve is averaged
CURVES = 2**20  # the child of the seed that curves are drawn from
SEEDS = 100
TRAINED = 30  # readings


COUNTED = {"episodes": "episodes", "epochs": "epochs"}.__getitem__
NUMBERS: Mapping[str, Callable[[str], Any]] = {
    "rate": lambda text: Constant(float(Fraction(text))),
    "rate_power": lambda text: float(Fraction(text)),
    "discount": str,
    "epochs": int,
    "episodes": int,
    "initial": lambda text: float(Fraction(text)),
    "ties": str,
    "bootstrap_end": {"true": True, "false": False}.__getitem__,
    "snapshot_episode": int,
    "last": int,
    "decay_at": lambda text: float(Fraction(text)),
    "counted": COUNTED,
}
"""How each setting of the learner is read that can be changed by name.

Beside those of `QLearning`: `decay_at`, the epoch at which the decaying ε is 0.8, and `counted`,
what the last 100 are: episodes, or epochs, each with the policy that the paper evaluates.
"""


def setting(name: str, text: str) -> dict[str, Any]:
    """Return a change of the learner's settings by its name and text.

    >>> setting("bootstrap_end", "true"), setting("rate", "0.5")
    ({'bootstrap_end': True}, {'rate': Constant(value=0.5)})
    """
    if name not in NUMBERS:
        raise ModelError(f"unknown setting {name!r}", where="training", fix=suggest(name, NUMBERS))
    try:
        found = {name: NUMBERS[name](text)}
    except (ValueError, KeyError):
        raise ModelError(
            f"{text!r} is no value of {name}",
            where="training",
            fix="give a number; true or false for bootstrap_end, episodes or epochs for counted",
        ) from None
    settings_of("decaying", found)  # refuses what does not fit
    return found


def settings_of(schedule: str, changes: Mapping[str, Any]) -> QLearning:
    """Return the learner under an exploration schedule, with settings changed by name.

    >>> settings_of("decaying", {"decay_at": 10.0}).exploration == PAPER_DECAYING
    False
    >>> settings_of("constant", {"decay_at": 10.0}) == SETTINGS["constant"]
    True
    """
    own = {name: value for name, value in changes.items() if name not in ("decay_at", "counted")}
    if "decay_at" in changes and schedule == "decaying":
        at, least = changes["decay_at"], PAPER_DECAYING.minimum
        own["exploration"] = Exponential.through(0.8, at=at, minimum=least)
    return replace(SETTINGS[schedule], **own)


@dataclass(frozen=True, kw_only=True, eq=False)
class Learned:
    """Training runs under one exploration schedule, with the exact values of final policies."""

    schedule: str
    runs: list[TrainingRun]
    outcomes: Outcomes
    seed: int

    @cached_property
    def values(self) -> Floats:
        """(R, E) exact value of the greedy policy of every epoch of every run."""
        return exact_curves(self.outcomes.mdp, self.runs)

    @cached_property
    def converged(self) -> Floats:
        """(R,) each run's mean over the last `CONVERGED` epochs."""
        return np.asarray(self.values[:, -CONVERGED:].mean(axis=1))

    @cached_property
    def drawn(self) -> LearningCurve:
        """The first run's curve as the paper draws it: 40 experiments each epoch."""
        number = list(SETTINGS).index(self.schedule)
        seed = child(child(self.seed, CURVES), number)
        return learning_curve(self.outcomes.mdp, self.runs[0], rng=seed)

    @property
    def final(self) -> Integers:
        """(R, 16) final greedy policies, an action number for each status."""
        return np.asarray(self.outcomes.policies[self.outcomes.final])

    def common(self) -> tuple[Integers, Floats]:
        """Return (16,) the most frequent final action of each status, and its share of runs."""
        actions = self.outcomes.mdp.n_actions
        share = np.stack([(self.final == a).mean(axis=0) for a in range(actions)], axis=1)
        return share.argmax(axis=1), share.max(axis=1)


def learn(
    mdp: MDP,
    schedule: str,
    *,
    runs: int,
    seed: int,
    folder: Path | None = None,
    changes: Mapping[str, Any] = MappingProxyType({}),
) -> Learned:
    """Train with this many seeds; runs that the folder holds are not done again.

    `changes` are settings that differ from the paper's, by name: see `NUMBERS`.
    """
    source = child(seed, list(SETTINGS).index(schedule))
    settings = settings_of(schedule, changes)
    trained = train(mdp, settings, runs, rng=source, n_jobs=None, out=folder)
    if changes.get("counted") == "epochs":
        trained = [_by_epochs(run, settings.last) for run in trained]
    found = outcomes(mdp, trained, bound=False)
    return Learned(schedule=schedule, runs=trained, outcomes=found, seed=seed)


def _by_epochs(run: TrainingRun, count: int) -> TrainingRun:
    """Return a run whose last policies are those of its last epochs, the final one last."""
    return replace(run, last=np.append(run.snapshots[-count:][:-1], run.last[-1:]))


def random_baseline(mdp: MDP, seed: int) -> LearningCurve:
    """Return the random strategy's curve: 40 experiments each epoch."""
    return random_curve(mdp, QLearning().epochs, rng=child(child(seed, CURVES), len(SETTINGS)))


# ---- under many readings -----------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True, eq=False)
class LearningEvidence:
    """S runs of both schedules under each of T readings; schedules in the order of `SETTINGS`."""

    readings: Integers  # (T,) those that were trained, at the first evaluation discount
    unique: Integers  # (T, 2, S) greedy policies in a run's last 100 episodes
    compatible: NDArray[np.bool_]  # (T, 2, S) whether these can all be what the paper describes
    final: Numbers  # (T, 2, S, 16) actions of the final policy by status

    @property
    def seeds(self) -> int:
        """Runs of each schedule."""
        return int(self.unique.shape[2])

    @property
    def hits(self) -> Integers:
        """(T, 2) runs with the reported number of unique policies."""
        wanted = np.array([UNIQUE_POLICIES[schedule] for schedule in SETTINGS])
        return np.asarray((self.unique == wanted[:, None]).sum(axis=2))

    @property
    def log_likelihood(self) -> Floats:
        """(T,) of three and two unique policies."""
        return np.asarray(np.log((self.hits + 1) / (self.seeds + 2)).sum(axis=1))

    def agreement(self) -> dict[str, Floats]:
        """Return (T, 2) shares of runs that end with the stated action, by status.

        In 0000 each of a1, a2, a3 counts; 1000 and 0100 are taken as the sentence orders them.
        """
        stated: dict[str, Sequence[str]] = {"0000": STARTS}
        stated |= {status: [action] for status, action in reported.STATED.items()}
        stated |= {status: ["supportive"] for status in ANGRY}
        return {
            status: np.isin(
                self.final[:, :, :, int(status, 2)], [NUMBER[action] for action in actions]
            ).mean(axis=2)
            for status, actions in stated.items()
        }

    def interval(self, place: int, schedule: int) -> Interval:
        """Return Wilson's 95 % interval of the share of runs with the reported number."""
        return share_interval(int(self.hits[place, schedule]), self.seeds)


def training_reading(space: ReadingSpace, number: int) -> int:
    """Return the reading that differs in nothing but has the first evaluation discount."""
    return number - number % len(space.options["evaluation_discount"])


def to_train(found: Evidence, count: int = TRAINED) -> Integers:
    """Return the `count` best supported readings, each once, at the first evaluation discount."""
    if count < 1:
        raise ModelError(f"{count} readings", where="learning", fix="give 1 or more")
    known = dict.fromkeys(training_reading(found.search.space, int(n)) for n in found.ranking)
    return np.array(list(known)[:count])


def at_random(space: ReadingSpace, count: int, seed: int) -> Integers:
    """Return `count` readings drawn at random, each once, at the first evaluation discount."""
    numbers = np.arange(0, len(space), len(space.options["evaluation_discount"]))
    if not 1 <= count <= len(numbers):
        raise ModelError(f"{count} readings", where="learning", fix=f"give 1 to {len(numbers)}")
    drawn = np.random.default_rng(seed).choice(numbers, count, replace=False)
    return np.sort(drawn)


def completion_weights(
    space: ReadingSpace, sampled: LearningEvidence, learned: Sequence[LearningEvidence] = ()
) -> Floats:
    """Return (R, C) log weights of the completions under every reading.

    From readings drawn at random, and from what others ended with themselves.
    """
    known = [sampled, *learned]
    numbers = np.concatenate([each.readings for each in known])
    counts = np.concatenate([counted(each.final) for each in known])
    place = np.full(len(space), -1)
    place[numbers] = np.arange(len(numbers))
    first = [training_reading(space, number) for number in range(len(space))]
    return by_reading(counted(sampled.final), counts, place[first])


def learning(
    search: ReadingSearch,
    readings: Sequence[int] | Integers,
    *,
    seeds: int = SEEDS,
    seed: int,
    out: str | Path | None = None,
    **how: Any,
) -> LearningEvidence:
    """Train under some readings, as `to_train` gives them; the same seeds under each.

    `seeds` runs of each schedule; the other arguments are those of `search`. The result does not
    depend on the number of processes. Raises ModelError for no seeds, or a folder that holds
    another training.
    """
    if seeds < 1:
        raise ModelError(f"{seeds} seeds", where="learning", fix="give 1 or more")
    numbers = [training_reading(search.space, int(number)) for number in readings]
    found = many(
        partial(_train, search.scenario, search.space, seeds, seed),
        numbers,
        key={
            "parameters": {name: str(value) for name, value in search.scenario.values().items()},
            "max_trial": search.scenario.max_trial,
            "settings": {name: repr(_unseen(each)) for name, each in SETTINGS.items()},
            "readings": [search.space.label(number) for number in numbers],
            "seeds": seeds,
            "seed": seed,
        },
        folder=out,
        what="trained readings",
        **how,
    )
    return LearningEvidence(
        readings=np.array(numbers),
        **{name: np.stack([piece[name] for piece in found]) for name in found[0]},
    )


def _train(
    base: Scenario, space: ReadingSpace, seeds: int, seed: int, number: int
) -> dict[str, Numbers]:
    """Return what the runs of one reading end with, for both schedules."""
    mdp = space.apply(base, number).compile()
    shape = (len(SETTINGS), seeds)
    unique, final = np.zeros(shape, dtype=np.int64), np.zeros((*shape, 16), dtype=np.int8)
    fits = np.zeros(shape, dtype=bool)
    for place, settings in enumerate(SETTINGS.values()):
        trainer = Trainer(_unseen(settings), mdp)
        for run in range(seeds):
            done = trainer.run(child(seed, run))
            last = done.policies[np.unique(done.last)]
            unique[place, run] = len(last)
            fits[place, run] = all(reported.compatible(policy) for policy in last)
            final[place, run] = done.final
    return {"unique": unique, "compatible": fits, "final": final}


def _unseen(settings: QLearning) -> QLearning:
    """Return the settings without snapshots, which nothing reads here."""
    return replace(settings, snapshot_episode=0)


def combined(found: Evidence, trained: LearningEvidence) -> tuple[Integers, Floats, float]:
    """Return readings with weights from all the evidence, and the weight of those left out.

    Only trained readings take part; the third number is the weight of all others by the exact
    evidence alone, which says how much the restriction may matter.
    """
    space = found.search.space
    place = {int(number): at for at, number in enumerate(trained.readings)}
    listed = [place.get(training_reading(space, number), -1) for number in range(len(space))]
    at = np.array(listed)
    numbers = np.flatnonzero(at >= 0)
    weights = posterior(found.marginal[numbers] + trained.log_likelihood[at[numbers]])
    order = np.argsort(-weights, kind="stable")
    return numbers[order], weights[order], float(1 - found.weights[numbers].sum())
