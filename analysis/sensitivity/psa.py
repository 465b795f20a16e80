"""Probabilistic sensitivity analysis: the parameters drawn, each draw re-solved to optimality.

What is said of the draws, and of which policy:

- the distribution of V*, the policy re-optimised in every draw;
- the distribution of the regret V* - V^π of a policy π held fixed, and its *acceptability curve*,
  the probability that its regret is at most Δ, by Δ: how much willingness to accept a loss it takes
  for the policy to be accepted (after Chen, Ayer and Chhatwal, Medical Decision Making 37, 2017,
  whose curve tells the confidence in the base-case policy by that willingness; Δ = 0 is the
  probability that the policy is optimal);
- the probability that each action is optimal, by status, with Wilson's interval;
- what knowing all parameters before choosing would be worth,

      EVPI = E[max_π V^π] - max_π E[V^π] = E[V*] - max_π E[V^π].

The best of all policies for uncertain parameters is hard to find (Steimle, Kaufman and Denton, IISE
Transactions 53, 2021), so EVPI is told by two ends. Its upper end takes the best policy found.
Its lower end lets everything but the first action be chosen in full knowledge: no policy is worth
more than max_a E[Q*(start, a)], hence EVPI ≥ min_a E[V* - Q*(start, a)]. Where reward weights alone
are uncertain, values are linear in them, the best policy is the optimum at their means, and EVPI is
E[V*] - V*(mean), one number. Every difference is that of pairs in the same draw.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.random import SeedSequence
from numpy.typing import ArrayLike

from analysis.sensitivity.distributions import EFFECTIVE_SAMPLE_SIZE, Uncertainty, uncertainty
from analysis.sensitivity.intervals import MeanLoss, mean_loss, share_of, wilson
from analysis.sensitivity.psa_models import Arrays, Solver, merged, run, solver_of
from analysis.sensitivity.value_of_information import PartialInformation, evpi, evppi
from mdp.errors import ModelError
from mdp.fingerprint import fingerprint
from mdp.model import MDP
from mdp.parametric import Parametric, parameter_of, parametric
from mdp.scenario import Scenario
from mdp.table import Floats, Integers
from solvers.solution import Estimated

if TYPE_CHECKING:
    from pandas import DataFrame

POOL = 24  # policies that are considered as candidates
CANDIDATES = 6  # of them kept, beside the policy held and today's optimum
LEAST_GAIN = 1e-2  # of what today's optimum loses, for a policy to be added
REGRESSED = 20_000  # draws of a regression: its error is far below that of so many draws
HELD, TODAY = "policy", "optimum today"
MISSING = "EVPI among the candidates is below the lower end of EVPI"


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A policy whose value is worked out in every draw.

    Attributes
    ----------
    name : str
    weights : (L,)
        Probabilities of the model's pairs.
    frequency : int
        Draws whose optimum was found to be this policy.
    actions : {label: action} or None
        Where it says the same in all states of a label, and does not mix.
    """

    name: str
    weights: Floats
    frequency: int
    actions: Mapping[str, str] | None


@dataclass(frozen=True, kw_only=True)
class Information:
    """EVPI over all policies, between two estimates; they are one where it is known which is best.

    Attributes
    ----------
    low, high : MeanLoss
    best : str
        Name of the best candidate, by which `high` is reckoned.
    """

    low: MeanLoss
    high: MeanLoss
    best: str


@dataclass(frozen=True, kw_only=True, eq=False)
class PSA:
    """The draws of a probabilistic sensitivity analysis and what was found in each.

    Attributes
    ----------
    model : str
    uncertainty : Uncertainty
    seed : int
    draws : (D, Q)
        Drawn parameters, in the order of `uncertainty.names`.
    start, error : (D,)
        V* of the start in each draw, and how far it may be off; units of reward.
    candidates : tuple of N Candidate
        The policy that is held comes first.
    values, value_error : (D, N)
        Their values.
    labels, actions : words
        Statuses at subtask 0, trial 0 of a care scenario; of other models the states with a choice.
    compiled : bool
        Whether the batched loops of the care model did the work.
    optimal : (X, A) ints
        Draws in which an action is optimal, up to rounding.
    lost : (D, A)
        What each action costs in the first state; (D, 0) where there is more than one.
    cut : (D,) bool
        Whether some chance was cut off at 1, where `compiled`.
    today : float
        V* at today's values.
    """

    model: str
    uncertainty: Uncertainty
    seed: int
    draws: Floats
    start: Floats
    error: Floats
    candidates: tuple[Candidate, ...]
    values: Floats
    value_error: Floats
    labels: tuple[str, ...]
    actions: tuple[str, ...]
    compiled: bool
    optimal: Integers
    lost: Floats
    cut: np.ndarray
    today: float

    def __post_init__(self) -> None:
        for array in (self.draws, self.start, self.error, self.values, self.optimal, self.lost):
            array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.start)

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that were drawn."""
        return self.uncertainty.names

    def regret(self, candidate: int = 0) -> Floats:
        """Return (D,) V* less a candidate's value; 0 where rounding may be all there is."""
        gap = self.start - self.values[:, candidate]
        return np.where(gap > self.error + self.value_error[:, candidate], gap, 0.0)

    @property
    def clipped(self) -> Estimated | None:
        """Share of draws in which some chance was cut off at 1; None where that is not known."""
        return share_of(int(self.cut.sum()), len(self)) if self.compiled else None

    def acceptability(self, tolerances: ArrayLike, candidate: int = 0) -> list[Estimated]:
        """Return the probability that the candidate loses at most Δ, for each Δ."""
        regret = np.sort(self.regret(candidate))
        inside = np.searchsorted(regret, np.asarray(tolerances, dtype=float), side="right")
        return [share_of(int(n), len(self)) for n in inside]

    def accepted(self, tolerances: ArrayLike, candidate: int = 0) -> tuple[Floats, Floats, Floats]:
        """Return the same probabilities with the ends of Wilson's 95 % intervals."""
        share = np.array([each.value for each in self.acceptability(tolerances, candidate)])
        low, high = wilson(np.rint(share * len(self)), len(self))
        return share, low, high

    def probability_optimal(self) -> tuple[Floats, Floats, Floats]:
        """Return (X, A) shares of draws in which each action is optimal, and Wilson's intervals."""
        low, high = wilson(self.optimal, len(self))
        return self.optimal / len(self), low, high

    def evpi(self) -> Information:
        """Return what knowing every drawn parameter would be worth, over all policies."""
        if self.compiled and all(name.startswith("reward.") for name in self.names):
            today = [candidate.name for candidate in self.candidates].index(TODAY)
            found = mean_loss(self.regret(today))
            return Information(low=found, high=found, best=TODAY)
        best = int(self.values.mean(axis=0).argmax())
        high, low = mean_loss(self.regret(best)), mean_loss(np.zeros(len(self)))
        if self.lost.shape[1]:
            lost = self.lost[:, int(np.nanargmin(self.lost.mean(axis=0)))]
            noise = 3 * self.error + self.value_error[:, best] + 1e-12 * np.abs(self.start)
            low = mean_loss(np.where(lost > noise, lost, 0.0))
        return Information(low=low, high=high, best=self.candidates[best].name)

    def evpi_of_candidates(self) -> MeanLoss:
        """Return what it would be worth to know before choosing among the candidates."""
        return evpi(self.values)

    def evppi(
        self, groups: Mapping[str, Sequence[str]] | None = None, *, most: int = REGRESSED
    ) -> dict[str, PartialInformation]:
        """Return what knowing some parameters would be worth, choosing among the candidates.

        Parameters
        ----------
        groups : {name: parameter names}, optional
            Each parameter, or row of parameters, alone, and `groups_of` them, unless given.
        most : int
            No more than this many of the first draws are used.

        Notes
        -----
        No estimate is above EVPI of the same candidates in the same draws. Where that is below the
        lower end of EVPI over all policies, by more than twice the standard error, the candidates
        miss policies that matter, which every estimate's `doubts` then tell.
        """
        if groups is None:
            alone = {part.label: part.names for part in self.uncertainty.parts}
            groups = alone | groups_of(self.uncertainty)
        place = {name: column for column, name in enumerate(self.names)}
        among, least = self.evpi_of_candidates(), self.evpi().low
        apart = 2 * np.hypot(among.standard_error, least.standard_error)
        doubt = (MISSING,) if among.value + apart < least.value else ()
        found = {}
        for label, members in groups.items():
            unknown = [name for name in members if name not in place]
            if unknown:
                raise ModelError(
                    f"{unknown[0]!r} is not drawn",
                    where=f"EVPPI of {label}",
                    fix="name parameters that are drawn",
                )
            columns = self.draws[:most, [place[name] for name in members]]
            each = evppi(self.values[:most], columns, tuple(members))
            found[label] = replace(each, doubts=(*each.doubts, *doubt))
        return found

    def frame(self) -> DataFrame:
        """Return a table: the drawn parameters, V*, each candidate's value (units of reward)."""
        from pandas import DataFrame

        table = DataFrame(self.draws, columns=list(self.names))
        table["V* (reward)"] = self.start
        for number, candidate in enumerate(self.candidates):
            table[f"{candidate.name} (reward)"] = self.values[:, number]
        return table


def psa(
    source: Scenario | MDP | Parametric,
    samples: int,
    *,
    seed: int,
    uncertain: Uncertainty | None = None,
    effective_sample_size: float = EFFECTIVE_SAMPLE_SIZE,
    policy: object = "optimal",
    candidates: Sequence[object] = (),
    n_jobs: int | None = 1,
    scheduler: str | None = None,
    folder: str | Path | None = None,
    progress: bool = False,
) -> PSA:
    """Draw the parameters, solve every draw, and evaluate policies in every draw.

    Parameters
    ----------
    samples : int
        D, the number of draws.
    seed : int
        0 is a seed. The same seed gives the same bytes for any number of workers, and the draws
        of a larger sample begin with those of a smaller one.
    uncertain : Uncertainty, optional
        Which parameters are drawn, and from what; `uncertainty(model)` unless given, with
        `effective_sample_size`.
    policy : the policy that is held fixed
        The optimum at today's values unless given.
    candidates : more policies to evaluate
        Beside those found to be optimal where the others lose most, which are added.
    n_jobs, scheduler, progress
        As in `solvers.many`; the workers of a care scenario are threads, of other models processes.
    folder : path, optional
        Where finished pieces are kept. A larger sample with the same seed uses the whole pieces of
        an earlier one again.

    Raises
    ------
    ModelError
        For no draws, and where nothing is uncertain.

    Examples
    --------
    >>> found = psa(Scenario.load("yuan2025"), 200, seed=0, effective_sample_size=50)
    >>> len(found), found.candidates[0].actions["0000"]
    (200, 'non-directive')
    """
    model = parametric(source)
    samples, seed = whole(samples, "samples", 1), whole(seed, "seed", 0)
    chosen = uncertain
    if chosen is None:
        chosen = uncertainty(model, default=effective_sample_size)
    for name in chosen.names:
        parameter_of(model, name)
    if not chosen.parts:
        raise ModelError(
            "no parameter is uncertain", where=f"model {model.name}", fix="state what is drawn"
        )
    solver = solver_of(model)
    today, held = solver.held("optimal"), solver.held(policy)
    named = [(TODAY if np.array_equal(held, today) else HELD, held)]
    named += [(f"given {n}", solver.held(each)) for n, each in enumerate(candidates, 1)]
    if not any(name == TODAY for name, _ in named):
        named.append((TODAY, today))
    key = {
        "model": model.name,
        "fingerprint": fingerprint(solver.mdp),
        "seed": seed,
        "drawn": [[*part.names, part.kind, part.size, *part.mean] for part in chosen.parts],
        "block": solver.block,
    }
    how = {"n_jobs": n_jobs, "scheduler": scheduler, "folder": folder, "progress": progress}
    rest = samples % solver.block
    sizes = [solver.block] * (samples // solver.block) + [rest] * (rest > 0)
    pieces = list(zip(SeedSequence(seed).spawn(len(sizes)), sizes, strict=True))
    work = partial(_solve_block, solver, chosen)
    blocks = _pieces(solver, "solved", work, pieces, key, rest, how)
    drawn = [block["draws"] for block in blocks]
    joined = {
        name: np.concatenate([block[name] for block in blocks])
        for name in ("draws", "start", "error", "lost", "cut")
    }

    def valued(policies: Sequence[Floats]) -> Arrays:
        """Return value and error (D, N) of policies in every draw."""
        told = sha256(b"".join(_bytes(each) for each in policies)).hexdigest()
        work, name = partial(_value_block, solver, chosen.names, policies), f"values-{told[:12]}"
        found = _pieces(solver, name, work, drawn, key | {"policies": told}, rest, how)
        return {name: np.concatenate([each[name] for each in found]) for name in found[0]}

    first = valued([weights for _, weights in named])
    picked, frequency = _candidates(solver, chosen.names, joined, blocks, named, first)
    if len(picked) > len(named):
        more = valued([weights for _, weights in picked[len(named) :]])
        first = {name: np.hstack([first[name], more[name]]) for name in first}
    return PSA(
        model=model.name,
        uncertainty=chosen,
        seed=seed,
        draws=joined["draws"],
        start=joined["start"],
        error=joined["error"],
        candidates=tuple(
            Candidate(
                name=name,
                weights=weights,
                frequency=frequency.get(_bytes(weights), 0),
                actions=solver.shown(weights),
            )
            for name, weights in picked
        ),
        values=first["value"],
        value_error=first["error"],
        labels=solver.labels,
        actions=solver.actions,
        compiled=solver.compiled,
        optimal=np.sum([block["best"] for block in blocks], axis=0),
        lost=joined["lost"],
        cut=joined["cut"],
        today=solver.today(),
    )


def groups_of(chosen: Uncertainty) -> dict[str, tuple[str, ...]]:
    """Return the drawn parameters by the beginning of their names, where several share one.

    Examples
    --------
    >>> model = parametric(Scenario.load("yuan2025"))
    >>> list(groups_of(uncertainty(model)))
    ['base.*', 'persistence.*', 'influence.*', 'assistance.*', 'skip.*']
    """
    found: dict[str, list[str]] = {}
    for part in chosen.parts:
        start, dot, _ = part.names[0].partition(".")
        if dot and part.kind != "dirichlet":
            found.setdefault(f"{start}.*", []).extend(part.names)
    return {name: tuple(members) for name, members in found.items() if len(members) > 1}


# ---- pieces of work ------------------------------------------------------------------------------


def whole(value: object, name: str, least: int) -> int:
    """Return a whole number; raises ModelError for anything else, and where it is too small."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        what = f"{value} draws" if name == "samples" else f"{name} is {value!r}"
        raise ModelError(what, where=name, fix=f"give a whole number, at least {least}")
    return int(value)


def _pieces(
    solver: Solver,
    what: str,
    work: Callable[[Any], Arrays],
    pieces: Sequence[Any],
    key: Mapping[str, object],
    rest: int,
    how: Mapping[str, Any],
) -> list[Arrays]:
    """Do blocks of draws: whole ones in a folder for samples of any size, one of `rest` apart."""
    full = len(pieces) - (rest > 0)
    if how["folder"] is None or not rest:
        return run(solver, what, work, pieces, key, **how)
    done = run(solver, what, work, pieces[:full], key, **how) if full else []
    last = {"last block": full, "draws": rest}
    name = f"{what}-last-{full}-{rest}"
    return done + run(solver, name, work, pieces[full:], {**key, **last}, **how)


def _solve_block(solver: Solver, chosen: Uncertainty, piece: tuple[SeedSequence, int]) -> Arrays:
    draws = chosen.draw(*piece)
    return {"draws": draws} | solver.solved(chosen.names, draws)


def _value_block(
    solver: Solver, names: tuple[str, ...], policies: Sequence[Floats], draws: Floats
) -> Arrays:
    return solver.values(names, draws, policies)


def _candidates(
    solver: Solver,
    names: tuple[str, ...],
    found: Mapping[str, np.ndarray],
    blocks: Sequence[Arrays],
    named: Sequence[tuple[str, Floats]],
    valued: Arrays,
) -> tuple[list[tuple[str, Floats]], dict[bytes, int]]:
    """Return the policies to evaluate, those given and those that add most; and frequencies.

    What the given policies leave to be won is V* - max_c V^c, draw by draw. Policies are considered
    by how much of it lies in the draws whose optimum they are, and compared in the draws in which
    most of it lies. The one that adds most is taken, until none adds a hundredth of the whole.
    """
    rows, which = merged(blocks)
    best, error = valued["value"].max(axis=1), valued["error"].max(axis=1)
    left = found["start"] - best
    left = np.where(left > found["error"] + error, left, 0.0)
    counts = np.bincount(which, minlength=len(rows))
    pool: dict[bytes, Floats] = {}
    frequency: dict[bytes, int] = {}
    known = {_bytes(weights) for _, weights in named}
    # The rows that matter, and the most frequent ones, whose frequency is told.
    by_loss = np.bincount(which, weights=left, minlength=len(rows))
    order = np.argsort(-by_loss, kind="stable")[:POOL]
    for number in {*order.tolist(), *np.argsort(-counts, kind="stable")[:POOL].tolist()}:
        weights = solver.weights(rows[number])
        told = _bytes(weights)
        frequency[told] = frequency.get(told, 0) + int(counts[number])
    for number in order[by_loss[order] > 0].tolist():
        weights = solver.weights(rows[number])
        if _bytes(weights) not in known:
            pool.setdefault(_bytes(weights), weights)
    picked, total = list(named), float(left.sum())
    if not pool:
        return picked, frequency
    some = np.sort(np.argsort(-left, kind="stable")[: solver.pool])
    others = list(pool.values())
    values = solver.values(names, found["draws"][some], others)["value"]
    best = best[some]
    while len(picked) < len(named) + CANDIDATES:
        gains = np.maximum(values - best[:, None], 0.0).sum(axis=0)
        number = int(gains.argmax())
        if gains[number] <= LEAST_GAIN * total:
            break
        picked.append((f"alternative {len(picked) - len(named) + 1}", others[number]))
        best = np.maximum(best, values[:, number])
    return picked, frequency


def _bytes(weights: Floats) -> bytes:
    """Return what tells a policy from others."""
    return np.ascontiguousarray(weights, dtype="<f8").tobytes()
