"""Probabilistic sensitivity analysis: parameters are drawn at random, and each draw is solved.

Some policies are evaluated in every draw: the given one, today's optimum, and *candidates*, optima
of draws in which the other policies lose most. The *acceptability curve* of a policy is the
probability that its regret is at most Δ, as a function of Δ (after Chen, Ayer and Chhatwal, Medical
Decision Making 37, 2017). The expected value of knowing all parameters before choosing is

    EVPI = E[max_π V^π] - max_π E[V^π] = E[V*] - max_π E[V^π].

The best of all policies is hard to find (Steimle, Kaufman and Denton, IISE Transactions 53, 2021):
the upper end of EVPI uses the best policy found; the lower end, min_a E[V* - Q*(start, a)], assumes
that all actions but the first are chosen in full knowledge.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.analysis.vary.distributions import Stated, Uncertainty, drawn_family, uncertainty
from exact_mdp.analysis.vary.information import (
    FEWEST,
    PartialInformation,
    estimate_evpi,
    estimate_evppi,
    too_wide,
)
from exact_mdp.analysis.vary.intervals import (
    MeanLoss,
    compute_wilson_interval,
    estimate_quantiles,
    estimate_share,
    mean_loss,
    mean_of,
    tolerances_of,
)
from exact_mdp.analysis.vary.ranges import read_points
from exact_mdp.analysis.vary.study import (
    Study,
    StudyDraws,
    hash_policies,
    require_room_for_points,
    solver_of,
)
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, join_few, named_options, require_known_name
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.parametric.family import place_of
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table, format_cell, list_claim_facts, to_json_values
from exact_mdp.mdp.result import DataFrame, Pictured
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import RNG, Flags, require_count, seed_of
from exact_mdp.solvers.claims import Bounded, Estimated
from exact_mdp.solvers.parallel import How, seed_blocks

# Policies that are considered as candidates: more of them would narrow EVPI, at the cost of one
# evaluation of some draws for each.
POOL = 24
LISTED = 16  # rows of a table: as many as a care model has status vectors
HELD, TODAY = "policy", "optimum today"
MISSING = "EVPI among the candidates is below the lower end of EVPI"


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """A policy that is evaluated in every draw."""

    name: str
    weights: Floats  # (L,) probabilities of pairs
    frequency: int  # number of draws in which it is optimal
    actions: Mapping[str, str] | None  # by label; None if it is not one action for each


@dataclass(frozen=True, kw_only=True, repr=False)
class Information:
    """EVPI over all policies, between two estimates; `high` belongs to the candidate `best`."""

    low: MeanLoss
    high: MeanLoss
    best: str

    def __repr__(self) -> str:
        return f"{format_cell(self.low)} to {format_cell(self.high)} (best policy: {self.best})"


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class PSA(Pictured):
    """The draws of a probabilistic sensitivity analysis, the optimum and the policies in each."""

    model: str
    start: Bounded  # V* at the start, for today's values
    uncertainty: Uncertainty
    seed: int
    table: Study  # of the draws and the N candidates
    candidates: tuple[Candidate, ...]  # the given policy comes first
    labels: tuple[str, ...]  # (X,) statuses at subtask 0, trial 0; else the states with a choice
    actions: tuple[str, ...]  # (A,)
    compiled: bool  # whether draws of a care scenario were stacked by its rules

    def __len__(self) -> int:
        return len(self.table.optimal)

    def __repr__(self) -> str:
        asked = "".join(f"; {each.text}" for each in self.table.criterion_facts.values())
        text = (
            f"{', '.join(self.names[:3])}{asked}; draws {len(self):,}; optimum on average "
            f"{self.value}, expected loss of {self.candidates[0].name} {mean_loss(self.regret())}"
        )
        if self.uncertainty.assumption:
            text += f"; {self.uncertainty.assumption}"
        return f"PSA({text})"

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the parameters that were drawn."""
        return self.uncertainty.names

    @property
    def value(self) -> Estimated:
        """Mean of V* over the draws (reward)."""
        return mean_of(self.table.optimal)

    @property
    def gained(self) -> Floats:
        """(D, N) values of the candidates, negated for costs, so that the greatest is best."""
        return self.table.sense.sign * self.table.fixed

    def regret(self, candidate: int = 0) -> Floats:
        """Return the regrets (D,) of a candidate; 0 if rounding may explain them."""
        return self.table.regret[:, candidate]

    @property
    def clipped(self) -> Estimated | None:
        """Share of draws in which some probability was cut off at 1; None if that is not known."""
        if not self.compiled:
            return None
        return estimate_share(int(self.table.cut.sum()), len(self))

    def acceptability(
        self, tolerances: ArrayLike, candidate: int = 0
    ) -> tuple[Floats, Floats, Floats]:
        """Return the probabilities that a candidate loses at most Δ, with Wilson's intervals."""
        at = np.asarray(tolerances, dtype=float)
        inside = np.searchsorted(np.sort(self.regret(candidate)), at, side="right")
        return inside / len(self), *compute_wilson_interval(inside, len(self))

    def probability_optimal(self) -> tuple[Floats, Floats, Floats]:
        """Return the shares (X, A) of draws in which each action is optimal, with intervals."""
        counts = self.table.counts
        return counts / len(self), *compute_wilson_interval(counts, len(self))

    def evpi(self) -> Information:
        """Return the value of knowing every drawn parameter, over all policies."""
        best = int(self.gained.mean(axis=0).argmax())
        high, low = mean_loss(self.regret(best)), mean_loss(np.zeros(len(self)))
        lost = self.table.lost
        if lost.shape[1]:
            lost = lost[:, int(np.nanargmin(lost.mean(axis=0)))]
            # A loss within the errors of both values counts as 0, as for a regret.
            noise = self.table.error[:, 0] + self.table.error[:, best + 1]
            low = mean_loss(np.where(lost > noise, lost, 0.0))
        return Information(low=low, high=high, best=self.candidates[best].name)

    def evpi_of_candidates(self) -> MeanLoss:
        """Return the value of knowing the parameters before choosing among the candidates."""
        return estimate_evpi(self.gained)

    def evppi(
        self, groups: Mapping[str, Sequence[str]] | None = None
    ) -> dict[str, PartialInformation]:
        """Return the value of knowing some parameters before choosing among the candidates.

        Groups are {name: parameter names}; by default each parameter or row alone, and together all
        parameters whose names begin with the same word.
        """
        # EVPI among the candidates must reach the lower end of EVPI, or a candidate is missing.
        among, least = self.evpi_of_candidates(), self.evpi().low
        apart, doubt = 2 * np.hypot(among.standard_error, least.standard_error), tuple[str, ...]()
        if among.value + apart < least.value:
            doubt = (MISSING,)
        by_group = {}
        for label, members, columns in groups_of(self.uncertainty, groups):
            each = estimate_evppi(self.gained, self.table.points[:, columns], members)
            by_group[label] = replace(each, doubts=(*each.doubts, *doubt))
        return by_group

    def report(self, policy: str = "optimal", *, evppi: bool = False) -> Report:
        """Return the results, with EVPPI if asked; `policy` is the name of the given policy."""
        partly = dict[str, PartialInformation]()
        # EVPPI needs enough draws for a regression; the most valuable parameters come first.
        if evppi and len(self) >= FEWEST:
            ordered = sorted(self.evppi().items(), key=lambda item: -item[1].regression.value)
            partly = dict(ordered)
        information, regret, numbers = self.evpi(), self.regret(), range(len(self.candidates))
        # Losses of all candidates, and their acceptability at the same tolerances.
        names = [candidate.name for candidate in self.candidates]
        losses, tolerances = [mean_loss(self.regret(n)) for n in numbers], tolerances_of([regret])
        accepted = [self.acceptability(tolerances, n) for n in numbers]
        within, least, most = accepted[0]
        among = self.evpi_of_candidates()
        candidates = [
            {
                "name": candidate.name,
                "actions": candidate.actions,
                "mean": mean_of(self.table.fixed[:, n]),
                "expected_loss": _list_loss_facts(losses[n]),
                "probability_optimal": float(accepted[n][0][0]),  # at a tolerance of 0
                "draws_whose_optimum_it_was": candidate.frequency,
            }
            for n, candidate in enumerate(self.candidates)
        ]
        # The distribution of each parameter that is drawn.
        drawn = {}
        for part in self.uncertainty.parts:
            for name, mean, sd in zip(part.names, part.mean, part.sd, strict=True):
                drawn[name] = {
                    "distribution": part.kind,
                    "size": part.size,
                    "mean": mean,
                    "sd": sd,
                }
        several = "parameter" if len(drawn) == 1 else "parameters"
        details = {n: vars(each) | {"reliable": each.reliable} for n, each in partly.items()}
        acceptability = {
            "policy": policy,
            "tolerance": tolerances,
            "probability": within,
            "low": least,
            "high": most,
            "candidates": {name: each for name, (each, *_) in zip(names, accepted, strict=True)},
        }
        ends = {
            "low": _list_loss_facts(information.low),
            "high": _list_loss_facts(information.high),
        }
        return Report(
            title="probabilistic sensitivity analysis",
            facts={
                **self.table.criterion_facts,
                **list_claim_facts("start_value", self.start),
                "claim": "estimated",
                "draws": Shown(len(self), f"{len(self):,}, each re-solved"),
                "seed": self.seed,
                "drawn": Shown(drawn, f"{len(drawn)} {several}"),
                "fixed": Shown(self.uncertainty.fixed, len(self.uncertainty.fixed) or None),
                "assumed": Shown(self.uncertainty.assumed, self.uncertainty.assumption or None),
                "clipped": self.clipped,
                "value": _describe_draws(self.table.optimal, self.value),
                "regret": _describe_draws(regret, losses[0]),
                "acceptability": Shown(
                    acceptability, f"the policy held is optimal in {within[0]:.1%} of draws"
                ),
                "evpi": Shown(information.high.value, repr(information)),
                "evpi_bounds": Shown(ends | {"best_policy": information.best}),
                "evpi_of_candidates": Shown(_list_loss_facts(among)),
                "evppi": Shown({name: each.regression.value for name, each in partly.items()}),
                "evppi_details": Shown(details),
                "p_optimal": self._list_optimal_shares(),
                "candidates": candidates,
            },
            tables={
                "p_optimal": self._make_share_table(),
                "candidates": Table(
                    title="policies held fixed in every draw",
                    rows=[
                        each | {"loss": loss} for each, loss in zip(candidates, losses, strict=True)
                    ],
                    columns={
                        "policy": "name",
                        "mean value": "mean:.6g",
                        "expected loss": "loss",
                        "optimal in": "probability_optimal:.1%",
                    },
                ),
                "evppi_details": Table(
                    title="EVPPI, choosing among these policies: by regression, at most their "
                    "EVPI, and a lower estimate",
                    columns={"known": "", **{n: n for n in ("regression", "lower", "reliable")}},
                    first=LISTED,
                ),
            },
            notes=self._list_notes(losses[0], information, partly),
        )

    def _list_optimal_shares(self) -> dict[str, dict[str, dict[str, float]]]:
        """Return the shares of draws in which each action is optimal, by state and action."""
        share, low, high = self.probability_optimal()
        shares: dict[str, dict[str, dict[str, float]]] = {}
        for x, label in enumerate(self.labels):
            shares[label] = {}
            for a, action in enumerate(self.actions):
                ends = {"low": low[x, a], "high": high[x, a]}
                shares[label][action] = {"probability": share[x, a]} | ends
        return shares

    def _make_share_table(self) -> Table:
        """Return the table of these shares, one row for each state."""
        share, low, high = self.probability_optimal()
        reach = float(np.maximum(high - share, share - low).max(initial=0.0))
        where, first = "", "state"
        if self.compiled:
            where, first = "at subtask 0, trial 0; ", "status"
        rows = []
        for label, row in zip(self.labels, share.tolist(), strict=True):
            rows.append({"": label, **{str(n): each for n, each in enumerate(row)}})
        columns = {action: f"{n}:.4f" for n, action in enumerate(self.actions)}
        return Table(
            title=f"share of draws in which an action is optimal, {where}"
            f"ends of Wilson's 95 % intervals are within {reach:.2g}",
            rows=rows,
            columns={first: ""} | columns,
            first=LISTED,
        )

    def _list_notes(
        self, lost: MeanLoss, information: Information, partly: Mapping[str, PartialInformation]
    ) -> list[str]:
        """Return warnings of means that few draws carry, and of EVPPI with wide intervals."""
        notes = []
        means = {"regret": lost, "EVPI": information.high, "EVPI's lower end": information.low}
        few = [f"{name} by {m.carried:.0f}" for name, m in means.items() if m.few and m.value]
        if few:
            notes.append(f"carried by few draws: {', '.join(few)}; take more to rely on it")
        among = self.evpi_of_candidates()
        errors = {name: each.regression.standard_error for name, each in partly.items()}
        wide = [name for name, error in errors.items() if error > among.value]
        for text in too_wide(max(errors.values(), default=0.0), among.value, len(self)):
            notes.append(f"EVPPI of {join_few(wide, len(wide), most=3)}: {text}")
        return notes

    def frame(self) -> DataFrame:
        """Return a table: the drawn parameters, V*, each candidate's value and regret (reward)."""
        return self.table.frame()


def _list_loss_facts(loss: MeanLoss) -> dict[str, object]:
    return {**to_json_values(loss), "draws_that_carry_it": loss.carried, "few_draws": loss.few}


def _describe_draws(values: Floats, mean: Estimated) -> Shown:
    """Return the mean of draws, their spread and quantiles."""
    stated = _list_loss_facts(mean) if isinstance(mean, MeanLoss) else to_json_values(mean)
    sd = float("nan")
    if len(values) > 1:
        sd = float(values.std(ddof=1))
    every = estimate_quantiles(values)
    middle = f"{every[0]['value']:.4g} to {every[-1]['value']:.4g}"
    return Shown(
        {"mean": stated.pop("value"), **stated, "sd": sd, "quantiles": every},
        f"mean {format_cell(mean)}, 95 % of draws {middle}",
    )


def groups_of(
    chosen: Uncertainty, groups: Mapping[str, Sequence[str]] | None
) -> list[tuple[str, tuple[str, ...], list[int]]]:
    """Return groups of drawn parameters: label, names, and columns of the draws.

    By default each part alone, and together all parameters whose names begin with the same word.
    """
    place = {name: column for column, name in enumerate(chosen.names)}
    if not place:
        fix = "draw parameters, or give parameters= to CostEffectiveness.of"
        raise ModelError("no parameter of the draws is known", where="EVPPI", fix=fix)
    if groups is None:
        alike: dict[str, list[str]] = {}
        for part in chosen.parts:
            start, dot, _ = part.names[0].partition(".")
            if dot and part.kind != "dirichlet":
                alike.setdefault(f"{start}.*", []).extend(part.names)
        groups = {part.label: part.names for part in chosen.parts}
        groups |= {name: members for name, members in alike.items() if len(members) > 1}
    lists = groups.values() if isinstance(groups, Mapping) else ["none"]
    if any(isinstance(members, str) for members in lists):
        what, fix = f"{groups!r:.60} names no groups", 'give {"label": ["name", …]}'
        raise ModelError(what, where="EVPPI", fix=fix)
    for label, members in groups.items():
        for name in members:
            require_known_name(name, place, "drawn parameter", f"EVPPI of {label}")
    return [(label, tuple(m), [place[name] for name in m]) for label, m in groups.items()]


def sample_parameters(
    family: Parametric, chosen: Uncertainty, n: int | None, seed: int, block: int
) -> Floats:
    """Return the draws (n, Q): each block from its own random stream, or rows of a given sample."""
    if not chosen.parts:
        raise ModelError(
            "no parameter is uncertain",
            where=place_of(family),
            fix="state distributions (--uncertain FILE, uncertain=); for today's values alone, "
            "cost_effectiveness without n is the base case",
        )
    # The number of draws: as asked for, or all rows of a given sample.
    sample = chosen.sample
    if n is None:
        if sample is None:
            raise ModelError("the number of draws is missing", where="n", fix="say n=1000")
        n = len(sample)
    n = require_count(n, "n")
    if sample is not None and n > len(sample):
        raise ModelError(
            f"{n:,} draws of a sample of {len(sample):,}",
            where="n",
            fix=f"ask for {len(sample):,} or fewer",
        )
    require_room_for_points(n, len(chosen.names), "ask for fewer draws")
    drawn = np.concatenate([chosen.draw(*each) for each in seed_blocks(seed, n, block)])
    if sample is not None:
        drawn = np.hstack([sample[:n], drawn])
    fix = "draw finite numbers within its range: a beta stays between 0 and 1, a gamma and a "
    fix += "log-normal above 0"
    return read_points(family, dict(zip(chosen.names, drawn.T, strict=True)), fix)


@named_options
def psa(
    model: Scenario | MDP | Parametric,
    n: int | None = None,
    *,
    rng: RNG = 0,
    uncertain: Stated | None = None,
    effective_sample_size: float | None = None,
    policy: PolicyLike = "optimal",
    criterion: str = "total",
    n_jobs: int | None = 1,
    folder: str | Path | None = None,
    progress: bool = False,
) -> PSA:
    """Draw the parameters, solve every draw, and evaluate policies in every draw.

    Parameters
    ----------
    model : Scenario, MDP or Parametric
        In an MDP the probabilities of random rows are parameters, too, up to 2,000 rows.
    n : int, optional
        D, the number of draws; from a given sample the first n rows, by default all.
    rng : int or numpy.random.Generator
        The same seed gives the same bytes for any number of workers, and a larger sample begins
        with the draws of a smaller one.
    uncertain : {name: settings}, pandas.DataFrame, file or Uncertainty, optional
        The distributions of the parameters, or a sample of your own: see `uncertainty`, which uses
        `effective_sample_size` for probabilities without a stated distribution.
    policy : PolicyLike
        The policy held fixed; "optimal" is the optimum at today's values.
    criterion : "total" or "average"
        As for `study`.
    n_jobs, folder, progress : optional
        See `solvers.parallel.run_pieces`. A larger sample with the same seed reuses the complete
        pieces of an earlier one in the folder.

    Returns
    -------
    PSA

    Raises
    ------
    ModelError
        Without draws, and if nothing is uncertain.

    Examples
    --------
    >>> analysis = psa(Scenario.load("yuan2025"), 200, rng=0, effective_sample_size=50)
    >>> len(analysis), analysis.candidates[0].actions["0000"]
    (200, 'non-directive')
    """
    # Draw the parameters.
    family, seed = drawn_family(model), seed_of(rng)
    chosen = uncertainty(family, uncertain, default=effective_sample_size)
    solver = solver_of(family, chosen.names, criterion)
    points = sample_parameters(family, chosen, n, seed, solver.block)
    # The policies held fixed: the given one first, and today's optimum.
    today, fixed_policy = solver.hold_policy("optimal"), solver.hold_policy(policy)
    given = [(TODAY, today)]
    if not np.array_equal(fixed_policy, today):
        given.insert(0, (HELD, fixed_policy))
    # The key of saved pieces: the seed, and the distributions or the sample.
    drawn: object = [[*part.names, part.kind, *part.numbers] for part in chosen.parts]
    if chosen.sample is not None:
        drawn = [drawn, hash_policies(chosen.sample)]
    key = {"seed": seed, "drawn": drawn}
    # Solve every draw, evaluate these policies, then the candidates that add most.
    how = How(n_jobs=n_jobs, folder=folder, progress=progress)
    draws = StudyDraws(solver, points, solver.block, key, how)
    table = draws.with_policies(draws.run_study(()), [weights for _, weights in given])
    picked, table = _select_policies(draws, table, given)
    counts = np.bincount(table.which)  # each of the rows occurs
    return PSA(
        model=family.name,
        start=solver.solution.start,
        uncertainty=chosen,
        seed=seed,
        table=table,
        candidates=tuple(
            Candidate(
                name=name,
                weights=weights,
                frequency=int(counts[_match_policies(draws, table, weights)].sum()),
                actions=solver.describe_policy(weights),
            )
            for name, weights in picked
        ),
        labels=solver.labels,
        actions=solver.mdp.actions[: table.counts.shape[1]],
        compiled=solver.compiled,
    )


def _select_policies(
    draws: StudyDraws, table: Study, given: Sequence[tuple[str, Floats]]
) -> tuple[list[tuple[str, Floats]], Study]:
    """Return the given policies and the candidates that add most, and their study.

    The loss of the policies taken so far is V* - max_c V^c in each draw. Policies are considered in
    the order of the loss in the draws in which they are optimal. A policy gains at least that loss,
    and at least its gain over the draws with the largest losses, in which all policies of the pool
    are evaluated. The policy with the greatest gain is evaluated in every draw, until no gain is a
    hundredth of the whole loss.
    """
    rows, which, sign, picked = table.rows, table.which, table.sense.sign, list(given)

    def compute_losses() -> Floats:
        """Return the losses (D,) of the policies taken; 0 if rounding may explain them."""
        left = sign * table.optimal - (sign * table.fixed).max(axis=1)
        return np.where(left > table.error[:, 0] + table.error[:, 1:].max(axis=1), left, 0.0)

    # The pool: optima of draws with losses, without the policies given.
    left = compute_losses()
    by_loss = np.bincount(which, weights=left)
    known = np.any([_match_policies(draws, table, weights) for _, weights in given], axis=0)
    pool = np.argsort(-by_loss, kind="stable")[:POOL]
    pool = pool[(by_loss[pool] > 0) & ~known[pool]]
    if not len(pool):
        return picked, table
    # Their values in the draws with the largest losses.
    others = [draws.solver.hold_policy(row) for row in rows[pool]]
    total, some = float(left.sum()), np.sort(np.argsort(-left, kind="stable")[: draws.solver.pool])
    values = sign * draws.solver.evaluate_policies(table.points[some], others)["value"]
    # At most six are kept, beside the given one and today's optimum.
    for count in range(1, 7):
        best = (sign * table.fixed[some]).max(axis=1)
        seen = np.maximum(values - best[:, None], 0.0).sum(axis=0)
        by_loss = np.bincount(which, weights=compute_losses())
        gains = np.maximum(seen, by_loss[pool])
        number = int(gains.argmax())
        if gains[number] <= 0.01 * total:
            break
        picked.append((f"alternative {count}", others[number]))
        table = draws.with_policies(table, [others[number]])
    return picked, table


def _match_policies(draws: StudyDraws, table: Study, weights: Floats) -> Flags:
    """Return (U,) which of the optimal policies are the same as a policy."""
    return np.asarray((table.rows == draws.solver.to_action_numbers(weights)).all(axis=1))
