"""What Q-learning ends with under the best supported readings, and how well that fits.

The paper counts the greedy policies of the last 100 episodes: three with constant exploration, two
with decaying exploration (Yuan et al. 2025, Section 4.1). Whether a reading makes that likely is
found by training with the paper's settings (Section 3.2) from many seeds: among S runs, k show the
reported number, and the likelihood is estimated by (k + 1) / (S + 2), the posterior mean under a
uniform prior; shares come with Wilson's interval. Training uses its own discount, so readings that
differ in the evaluation discount alone share their runs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from exact_mdp.analysis.learning.outcomes import Interval, share_interval
from exact_mdp.analysis.readings import ReadingSpace, posterior
from exact_mdp.mdp import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.readings.evidence import Evidence
from exact_mdp.paper_repro.readings.search import STARTS, ReadingSearch
from exact_mdp.solvers.learning.q_learning import QLearning, Trainer
from exact_mdp.solvers.learning.sampler import as_sequence, child
from exact_mdp.solvers.learning.schedules import PAPER_CONSTANT, PAPER_DECAYING
from exact_mdp.solvers.parallel.many import many

SETTINGS = {
    "constant": QLearning(exploration=PAPER_CONSTANT, snapshot_episode=0),
    "decaying": QLearning(exploration=PAPER_DECAYING, snapshot_episode=0),
}
ANGRY = 0b0010
SEEDS = 100
TRAINED = 40  # readings


@dataclass(frozen=True, kw_only=True, eq=False)
class LearningEvidence:
    """S runs of both schedules under each of T readings.

    Attributes
    ----------
    readings : (T,) ints
        The readings that were trained, at the first evaluation discount.
    unique : (T, 2, S) ints
        Greedy policies in a run's last 100 episodes; schedules in the order of `SETTINGS`.
    compatible : (T, 2, S) bool
        Whether each of these policies does what the text states: its actions with anger, in 1100,
        1000 and 0100 (either order), and one of a1, a2, a3 in 0000.
    final : (T, 2, S, 16) ints
        Actions of the final policy by status.
    """

    readings: Integers
    unique: Integers
    compatible: NDArray[np.bool_]
    final: Numbers

    @property
    def seeds(self) -> int:
        """Runs of each schedule."""
        return int(self.unique.shape[2])

    @property
    def hits(self) -> Integers:
        """(T, 2) runs with the reported number of unique policies."""
        wanted = np.array([reported.UNIQUE_POLICIES[schedule] for schedule in SETTINGS])
        return np.asarray((self.unique == wanted[:, None]).sum(axis=2))

    @property
    def log_likelihood(self) -> Floats:
        """(T,) of three and two unique policies."""
        return np.asarray(np.log((self.hits + 1) / (self.seeds + 2)).sum(axis=1))

    def agreement(self) -> dict[str, Floats]:
        """Return (T, 2) shares of runs that end with the stated action, by status.

        In 0000 each of a1, a2, a3 counts; 1000 and 0100 are taken as the sentence orders them.
        """
        number = {action: place for place, action in enumerate(reported.ACTIONS)}
        stated = {"0000": [number[start] for start in STARTS]}
        stated |= {status: [number[action]] for status, action in reported.STATED.items()}
        angry = [format(status, "04b") for status in range(16) if status & ANGRY]
        stated |= {status: [number["supportive"]] for status in angry}
        return {
            status: np.isin(self.final[:, :, :, int(status, 2)], actions).mean(axis=2)
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


def learning(
    search: ReadingSearch,
    readings: Sequence[int] | Integers,
    *,
    seeds: int = SEEDS,
    seed: int,
    n_jobs: int | None = None,
    scheduler: str | None = None,
    out: str | Path | None = None,
    progress: bool = False,
) -> LearningEvidence:
    """Train under some readings; the same seeds under each.

    Parameters
    ----------
    readings : ints
        As `to_train` gives them.
    seeds : int
        Runs of each schedule under each reading.
    seed : int
    n_jobs : int, optional
        Processes; all cores where None. The result does not depend on it.
    scheduler : str, optional
        A Dask cluster instead, "tcp://host:port" or "local"; see `solvers.parallel.many.many`.
    out : path, optional
        Folder for finished readings; with the same seeds, they are used again, and others added.
    progress : bool
        Show a bar on standard error where that is a terminal.

    Raises
    ------
    ModelError
        For no seeds, or a folder that holds another training.
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
            "settings": {name: repr(each) for name, each in SETTINGS.items()},
            "readings": [search.space.label(number) for number in numbers],
            "seeds": seeds,
            "seed": seed,
        },
        n_jobs=n_jobs,
        scheduler=scheduler,
        folder=out,
        progress=progress,
        what="trained readings",
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
    root = as_sequence(seed)
    shape = (len(SETTINGS), seeds)
    unique, final = np.zeros(shape, dtype=np.int64), np.zeros((*shape, 16), dtype=np.int8)
    fits = np.zeros(shape, dtype=bool)
    for place, settings in enumerate(SETTINGS.values()):
        trainer = Trainer(settings, mdp)
        for run in range(seeds):
            done = trainer.run(child(root, run))
            last = done.policies[np.unique(done.last)]
            unique[place, run] = len(last)
            fits[place, run] = all(compatible(policy) for policy in last)
            final[place, run] = done.final
    return {"unique": unique, "compatible": fits, "final": final}


def compatible(policy: Numbers) -> bool:
    """Return whether a policy (16,) over the statuses can be one that the paper describes.

    Examples
    --------
    >>> from exact_mdp.paper_repro.readings.search import completions, policies
    >>> compatible(policies(completions()[-1:])[0]), compatible(np.zeros(16, dtype=int))
    (True, False)
    """
    number = {action: place for place, action in enumerate(reported.ACTIONS)}
    anger = [status for status in range(16) if status & ANGRY]
    return bool(
        (policy[anger] == number["supportive"]).all()
        and stated(policy)
        and policy[0] in {number[start] for start in STARTS}
    )


def stated(policy: Numbers, orders: Sequence[str] = tuple(reported.ORDERS)) -> bool:
    """Return whether a policy (16,) has the actions stated for 1100, 1000 and 0100.

    Examples
    --------
    >>> from exact_mdp.paper_repro.readings.search import completions, policies
    >>> swapped = policies(completions()[-1:])[0]
    >>> stated(swapped), stated(swapped, ["as written"])
    (True, False)
    """
    number = {action: place for place, action in enumerate(reported.ACTIONS)}
    pairs = (reported.ORDERS[order] for order in orders)
    return bool(
        policy[0b1100] == number[reported.STATED["1100"]]
        and any(
            all(policy[int(status, 2)] == number[action] for status, action in pair.items())
            for pair in pairs
        )
    )


def combined(found: Evidence, learned: LearningEvidence) -> tuple[Integers, Floats, float]:
    """Return readings with weights from all the evidence, and the weight of those left out.

    Only trained readings take part; the third number is the weight of all others by the exact
    evidence alone, which says how much the restriction may matter.
    """
    space = found.search.space
    place = {int(number): at for at, number in enumerate(learned.readings)}
    trained = [place.get(training_reading(space, number), -1) for number in range(len(space))]
    numbers = np.flatnonzero(np.array(trained) >= 0)
    logs = learned.log_likelihood[np.array(trained)[numbers]]
    weights = posterior(found.marginal[numbers] + logs)
    order = np.argsort(-weights, kind="stable")
    return numbers[order], weights[order], float(1 - found.weights[numbers].sum())
