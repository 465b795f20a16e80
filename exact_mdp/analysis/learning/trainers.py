"""A gate for a trainer that is random: how many of its seeds give a policy within the limits.

Each policy is audited, one run after the other, until the share of seeds within the limits is
proven to be below `share`, and the gate fails, or to be at least `share`, and it passes. If the
share is still open after all runs, the gate passes unless a proof is required: so a trainer that is
good enough fails with probability α at most. If the runs are so few that the gate could not fail,
they are refused.

Of n independent trials k succeeded and m did not. Let p be the probability of success. A gambler
who bets against it, with stakes that depend on the trials so far, multiplies the capital within n
trials by

    E_n(p) = ∫ q^k (1 - q)^m dBeta(1/2, 1/2)(q) / (p^k (1 - p)^m)
           = C(2k, k) C(2m, m) / (4^n C(n, k)) / (p^k (1 - p)^m)

which is a martingale of mean 1. So P(E_n(p) ≥ 1/α at some n) ≤ α (Ville, Étude critique de la
notion de collectif, 1939), and all p with E_n(p) < 1/α so far are an interval that holds at all n
together with probability 1 - α (Robbins, Annals of Mathematical Statistics 41, 1970). All
computation is in integers: no rounding decides which shares are excluded.
"""

from __future__ import annotations

import sys
from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import count, islice, tee
from math import comb, log, log1p, pi
from numbers import Number
from typing import Any, ClassVar

from scipy import special

from exact_mdp.analysis.exit_status import refuse_exit
from exact_mdp.analysis.gate.audit import Audit
from exact_mdp.analysis.gate.check import check
from exact_mdp.analysis.gate.criteria import Verdict
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import DataFrame, Judged, data_frame
from exact_mdp.mdp.table import format_rational
from exact_mdp.mdp.validate import as_share, require_count
from exact_mdp.solvers.arguments import mdp_of
from exact_mdp.solvers.claims import Claim
from exact_mdp.solvers.learning.sampler import Seed, as_sequence, spawn_child_seed

GRID = 2**20  # ends of intervals are multiples of 1 / GRID, outwards

Interval = tuple[Fraction, Fraction]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class TrainerAudit(Judged):
    """Which runs of a trainer gave a policy within the limits, and what share of all seeds does."""

    names: tuple[Any, ...]  # the name of each run: its seed, or its number
    audits: tuple[Audit, ...]
    intervals: tuple[Interval, ...]  # encloses the share after each run; all hold together
    share: Fraction  # the share of seeds that has to be within the limits
    alpha: Fraction  # the risk of error
    runs: int  # how many there might have been
    proven: bool | None  # whether the share of all seeds is at least `share`; None if it is open
    passed: bool  # whether it is, or is open and need not be proven

    claim: ClassVar[Claim] = Claim.ESTIMATED

    @property
    def within(self) -> int:
        """How many runs gave a policy within the limits."""
        return sum(audit.passed for audit in self.audits)

    @property
    def value(self) -> float:
        """Their share of the runs."""
        return self.within / len(self.audits)

    @property
    def interval(self) -> Interval:
        """The interval of the share after the last run."""
        return self.intervals[-1]

    @property
    def worst(self) -> Audit:
        """The audit of the run that lost most."""
        return max(self.audits, key=lambda audit: float(audit.value.value))

    def frame(self) -> DataFrame:
        """Return one row for each run: its regret, and the interval of the share after it."""
        return data_frame(
            {
                "run": self.names,
                "regret": [float(audit.value.value) for audit in self.audits],
                "passed": [audit.passed for audit in self.audits],
                "low": [float(low) for low, _ in self.intervals],
                "high": [float(high) for _, high in self.intervals],
            }
        )

    def __repr__(self) -> str:
        low, high = self.interval
        shown_as = {True: "proven", False: "disproven", None: "open"}[self.proven]
        return (
            f"TrainerAudit({'passed' if self.passed else 'failed'}: {self.within} of "
            f"{len(self.audits)} runs within the limits, a share from {float(low):.3f} to "
            f"{float(high):.3f}; at least {format_rational(self.share, 10)} is {shown_as})"
        )

    @property
    def verdicts(self) -> tuple[Verdict]:
        """What was checked: the share of all runs."""
        decision = True if self.passed else self.proven
        least = f"at least {format_rational(self.share, 10)}"
        return (Verdict("the share of runs within the limits", least, decision, self._found),)

    @property
    def measures(self) -> dict[str, Any]:
        """What a test report keeps of it."""
        low, high = map(float, self.interval)
        runs = {"within": self.within, "runs": len(self.audits), "low": low, "high": high}
        return {"claim": str(self.claim)} | runs

    @property
    def _found(self) -> str:
        low, high = map(float, self.interval)
        return (
            f"{self.within} of {len(self.audits)} runs are, of {self.runs} at most; the share of "
            f"all is from {low:.4f} to {high:.4f}, "
            f"wrong with probability {format_rational(self.alpha, 10)} "
            "at most, whenever one stops"
        )

    def message(self, *, explain: bool = False) -> str:
        """Return the result in words, with the reasons of the run that lost most."""
        open_ = "is not proven to be " + ("below" if self.passed else "at least")
        said = {True: "is at least", False: "is not at least", None: open_}[self.proven]
        lines = [
            f"{'passed' if self.passed else 'failed'}: the share of runs within the limits {said} "
            f"{format_rational(self.share, 10)}",
            self._found,
        ]
        if self.within < len(self.audits):
            name = self.names[self.audits.index(self.worst)]
            lines += [f"the run that lost most, {name}:", self.worst.message(explain=explain)]
        return "\n".join(lines)

    def report(self, policies: Sequence[str] | None = None) -> Report:
        """Return the verdict and the runs, with the names of their policies if given."""
        names = [str(run) if policies is None else policies[run] for run in self.names]
        rows = self.frame().drop(columns="run").assign(policy=names).to_dict("records")
        facts = {
            "passed": Shown(self.passed, self.message()),
            "proven": self.proven,
            "claim": self.claim,
            "within": self.within,
            "runs": len(rows),
            "given": self.runs,
            "observed": Shown(self.value),
            "share_interval": [float(end) for end in self.interval],
            "share": self.share,
            "alpha": self.alpha,
            "max_regret": self.audits[0].max_regret,
            "max_relative_regret": self.audits[0].max_relative_regret,
            "policies": rows,
        }
        table = Table(
            title="the runs, in the order given",
            note="share: of all runs, from and to; all these intervals hold together",
            columns={"policy": "policy", "regret": "regret", "within the limits": "passed"}
            | {"share from": "low:.3f", "to": "high:.3f"},
            first=20,
        )
        return Report(title="runs", facts=facts, tables={"policies": table}, passed=self.passed)


def check_trainer(
    model: MDP | Scenario,
    train: Callable[[int], PolicyLike] | Iterable[PolicyLike],
    *,
    runs: int = 100,
    share: object = "9/10",
    alpha: object = "1/100",
    rng: Seed | None = None,
    prove: bool = False,
    **limits: Any,
) -> TrainerAudit:
    """Return whether enough of a trainer's seeds give a policy within the limits.

    Parameters
    ----------
    model : MDP or Scenario
    train : function of a seed, or an iterable of PolicyLike
        `train(seed)` draws from that seed alone, an integer below 2^32; or policies of independent
        runs.
    runs : int
        The greatest number of runs. The gate stops earlier if the share is decided.
    share : number or "p/q"
        The share of all seeds that has to be within the limits, above 0 and at most 1.
    alpha : number or "p/q"
        How likely the interval may be wrong, and so how likely a failure by chance: above 0, below
        1.
    rng : int, numpy.random.Generator or SeedSequence
        The source of the seeds; not needed for policies.
    prove : bool
        Fail if the share is still open after all runs.
    **limits
        Limits for each run, as `check` takes them.

    Returns
    -------
    TrainerAudit

    Raises
    ------
    ModelError
        For shares and counts out of range, and runs so few that no outcome could fail.

    Examples
    --------
    >>> from exact_mdp.solvers.learning.q_learning import QLearning
    >>> mdp = Scenario.load("tea").compile()
    >>> def train(seed):
    ...     return QLearning(epochs=200).train(mdp, rng=seed)
    >>> check_trainer(mdp, train, rng=0, max_relative_regret="1/2", share="1/2")
    TrainerAudit(passed: 10 of 10 runs within the limits, a share from 0.530 to 1.000;
    at least 0.5 is proven)
    """
    # Refuse a gate that proves nothing, or that could not fail.
    wanted, risk = as_share(share, "share"), as_share(alpha, "alpha")
    if risk == 1:
        what = "a risk of error of 1 proves nothing"
        raise ModelError(what, where="alpha", fix="choose less: 1/100")
    runs = require_count(runs, "runs")
    if not prove:
        _require_runs(runs, wanted, risk)
    mdp = mdp_of(model)
    if (horizon := limits.pop("horizon", None)) is not None:
        mdp = mdp.within(horizon)
    # Train and audit lazily, one run after the other; the interval follows the verdicts.
    policies = islice(_yield_policies(train, rng), runs)
    each, same = tee((name, check(mdp, policy, **limits)) for name, policy in policies)
    shares = share_intervals((audit.passed for _, audit in same), risk)
    # Stop as soon as the interval decides whether the share is reached.
    names, audits, intervals = list[Any](), list[Audit](), list[Interval]()
    hits, proven = 0, None
    with refuse_exit():
        for (name, audit), interval in zip(each, shares, strict=True):
            names.append(name)
            audits.append(audit)
            intervals.append(interval)
            hits += audit.passed
            proven = _is_share_reached(hits, len(audits), wanted, risk)
            if proven is not None:
                break
    if not audits:
        raise ModelError("no policies", where="check_trainer", fix="give at least one")
    # The given policies may have been fewer than `runs`.
    if proven is None and not prove:
        _require_runs(len(audits), wanted, risk)
    return TrainerAudit(
        names=tuple(names),
        audits=tuple(audits),
        intervals=tuple(intervals),
        share=wanted,
        alpha=risk,
        runs=runs,
        proven=proven,
        passed=proven is not False and not (prove and proven is None),
    )


def _require_runs(runs: int, share: Fraction, alpha: Fraction) -> None:
    """Raise ModelError if so few runs leave the share open even if none is within the limits."""
    if is_share_excluded(share, 0, runs, alpha):
        return
    least, noun = count_fewest_misses(share, alpha), "runs"
    if runs == 1:
        noun = "run"
    raise ModelError(
        f"of {runs} {noun} no outcome could fail: even if none keeps the limits, a "
        f"share of {format_rational(share, 10)} stays possible",
        where="runs",
        fix=f"give {least} runs or more, or ask for a proof that the share is kept (--prove, "
        "prove=True)",
    )


def _is_share_reached(hits: int, n: int, share: Fraction, alpha: Fraction) -> bool | None:
    """Return whether the chance of success is at least `share`; None if that is open."""
    return hits > n * share if is_share_excluded(share, hits, n - hits, alpha) else None


def _yield_policies(
    train: Callable[[int], PolicyLike] | Iterable[PolicyLike], rng: Seed | None
) -> Iterator[tuple[Any, PolicyLike]]:
    """Yield the policies with the names of their runs."""
    if not callable(train):
        if _is_one(train):
            raise ModelError(
                "one policy is given, but runs need several",
                where="policies",
                fix="give a function of a seed or a list of policies; or check one, without runs",
            )
        yield from enumerate(train)
        return
    if rng is None:
        raise ModelError(
            "runs are trained from seeds, and no rng is given to draw these from",
            where="rng",
            fix="give rng=0: the seeds of the runs are drawn from it",
        )
    root = as_sequence(rng)
    for number in count():
        seed = int(spawn_child_seed(root, number).generate_state(1)[0])
        yield seed, train(seed)


def _is_one(given: object) -> bool:
    """Return whether this is one policy: a name, a mapping, an array, or a list of its actions."""
    actions = isinstance(given, list | tuple) and any(isinstance(one, Number) for one in given)
    named = isinstance(given, str | Mapping) or hasattr(given, "__array__")
    return actions or named or not isinstance(given, Iterable)


# ---- an interval of a share that holds at every moment -------------------------------------------


def is_share_excluded(share: Fraction, hits: int, misses: int, alpha: Fraction) -> bool:
    """Return whether E_n(share) ≥ 1/α after these trials."""
    top, below, n = share.numerator, share.denominator, hits + misses
    won = comb(2 * hits, hits) * comb(2 * misses, misses) * below**n * alpha.numerator
    fair = comb(n, hits) * 4**n * top**hits * (below - top) ** misses * alpha.denominator
    return bool(won >= fair)


def count_fewest_misses(share: Fraction, alpha: Fraction) -> int:
    """Return the least number of misses, without a hit, that exclude a share below 1.

    As the number of misses grows, E_n(p) falls and then rises, so bisection finds it; in logarithms
    if a small share needs thousands.
    """
    if share == 1:
        return 1

    def can_exclude(misses: int) -> bool:
        # Exact integers of this many digits still take less than a millisecond.
        if misses < 1000:
            return is_share_excluded(share, 0, misses, alpha)
        mixed = special.betaln(misses + 0.5, 0.5) - log(pi)  # C(2m, m) / 4^m
        return bool(mixed - misses * log1p(-float(share)) >= -log(alpha))

    return bisect_left(range(sys.maxsize), True, key=can_exclude)


def share_intervals(trials: Iterable[bool], alpha: Fraction) -> Iterator[Interval]:
    """Yield after each trial an interval of the chance of success.

    All of them together hold with probability 1 - α; they only narrow.
    """
    low = high = hits = misses = 0
    for trial in trials:
        hits, misses = hits + bool(trial), misses + (not trial)
        low = _raise_bound(low, hits, misses, alpha)
        high = min(GRID - low, _raise_bound(high, misses, hits, alpha))  # from 1 downwards
        yield Fraction(low, GRID), Fraction(GRID - high, GRID)


def _raise_bound(known: int, hits: int, misses: int, alpha: Fraction) -> int:
    """Return the greatest number on the grid that is excluded from below, `known` at least."""

    def is_kept(number: int) -> bool:
        return not is_share_excluded(Fraction(number, GRID), hits, misses, alpha)

    seen = hits * GRID // (hits + misses)  # a share that never is excluded
    if known >= seen or is_kept(known + 1):
        return known
    return bisect_left(range(seen + 1), True, lo=known + 2, key=is_kept) - 1
