"""Probabilistic sensitivity analysis: the parameters drawn, each draw re-solved to optimality.

Every draw is a model of its own. It is solved (the policy re-optimised), and policies are evaluated
in it (held fixed): the one asked about, today's optimum, and the candidates that are sought among
the optima of the draws (`analysis.sensitivity.psa.candidates`). What is said of the draws, and of
which policy, is told in `analysis.sensitivity.psa.result`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.random import SeedSequence

from exact_mdp.analysis.sensitivity.base import digest
from exact_mdp.analysis.sensitivity.draws.blocks import in_blocks, joined, seeded, whole_number
from exact_mdp.analysis.sensitivity.draws.solver import DrawSolver, solver_of
from exact_mdp.analysis.sensitivity.psa.candidates import Candidate, identity, named, selected
from exact_mdp.analysis.sensitivity.psa.distributions import Uncertainty
from exact_mdp.analysis.sensitivity.psa.result import PSA
from exact_mdp.analysis.sensitivity.psa.uncertainty import EFFECTIVE_SAMPLE_SIZE, uncertainty
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.fingerprint import fingerprint
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric, parameter_of, parametric
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.parallel.pieces import Arrays


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
        As in `solvers.parallel.many`; the workers of a care scenario are threads, of other models
        processes.
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
    samples, seed = whole_number(samples, "samples", 1), whole_number(seed, "seed", 0)
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
    given = named(solver.base, policy, candidates)
    key = {
        "model": model.name,
        "fingerprint": fingerprint(solver.base.mdp),
        "seed": seed,
        "drawn": [[*part.names, part.kind, part.size, *part.mean] for part in chosen.parts],
        "block": solver.block,
    }
    how = {"n_jobs": n_jobs, "scheduler": scheduler, "folder": folder, "progress": progress}
    pieces, rest = seeded(seed, samples, solver.block)
    work = partial(_solve_block, solver, chosen)
    blocks = in_blocks(solver, "solved", work, pieces, key, rest, how)
    drawn = [block["draws"] for block in blocks]
    solved = joined(blocks, ("draws", "start", "error", "lost", "cut"))
    if solver.compiled and isinstance(model, ScenarioFamily) and solved["cut"].any():
        first = solved["draws"][int(solved["cut"].argmax())].tolist()
        where = f", {int(solved['cut'].sum())} of {samples} draws, in the first of them"
        model.tell(dict(zip(chosen.names, first, strict=True)), where=where)

    def valued(policies: Sequence[Floats]) -> Arrays:
        """Return value and error (D, N) of policies in every draw."""
        told = digest(*policies)
        work, name = partial(_value_block, solver, chosen.names, policies), f"values-{told[:12]}"
        more = {"policies": told}
        return joined(in_blocks(solver, name, work, drawn, key | more, rest, how))

    found = valued([weights for _, weights in given])
    picked, frequency = selected(solver, chosen.names, solved, blocks, given, found)
    if len(picked) > len(given):
        more = valued([weights for _, weights in picked[len(given) :]])
        found = {name: np.hstack([found[name], more[name]]) for name in found}
    return PSA(
        model=model.name,
        uncertainty=chosen,
        seed=seed,
        **solved,
        candidates=tuple(
            Candidate(
                name=name,
                weights=weights,
                frequency=frequency.get(identity(weights), 0),
                actions=solver.shown(weights),
            )
            for name, weights in picked
        ),
        values=found["value"],
        value_error=found["error"],
        labels=solver.labels,
        actions=solver.actions,
        compiled=solver.compiled,
        optimal=np.sum([block["best"] for block in blocks], axis=0),
        today=solver.base.solution.start_value,
    )


def _solve_block(
    solver: DrawSolver, chosen: Uncertainty, piece: tuple[SeedSequence, int]
) -> Arrays:
    draws = chosen.draw(*piece)
    return {"draws": draws} | solver.solved(chosen.names, draws)


def _value_block(
    solver: DrawSolver, names: tuple[str, ...], policies: Sequence[Floats], draws: Floats
) -> Arrays:
    return solver.values(names, draws, policies)
