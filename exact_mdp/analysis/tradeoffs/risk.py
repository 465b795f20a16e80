"""The mean of all episodes against the mean of the worst: best policies, and others beside them.

For weights v of the mean, policies with the most of (1 - v) CVaR + v E Z, exact points of the
trade-off (`solvers.risk`). They are best for their weight among all policies, those with a
memory included. Between two of them nothing is claimed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, Table
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import shown
from exact_mdp.solvers.risk import CVaROptimum, best_cvar, share_of, tail_mean
from exact_mdp.solvers.solution import Certified, Claim
from exact_mdp.solvers.solver import mdp_of
from exact_mdp.solvers.values.returns import return_distribution

RULES = 20  # rows of a policy with a memory that a table shows
WEIGHTS = (Fraction(0), Fraction(1, 4), Fraction(1, 2), Fraction(3, 4), Fraction(99, 100))


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class MeanCVaR(Pictured):
    """Best policies for several weights of the mean, and given policies."""

    mdp: MDP
    level: Fraction  # the share of the worst episodes
    optima: tuple[CVaROptimum, ...]  # by rising weight of the mean
    policies: Mapping[str, tuple[Fraction, Fraction]]  # mean and CVaR by name

    claim = Claim.CERTIFIED

    def __repr__(self) -> str:
        best = float(self.optima[0].value)
        return f"MeanCVaR(worst {shown(self.level)}: at best {best:.6g}; certified)"

    def report(self) -> Report:
        """Return the best policy for the worst episodes, and those for weighted means."""
        best, label = self.optima[0], self.mdp.space.label
        facts = {
            "claim": Shown(self.claim),
            "measure": Shown("cvar"),
            "value": Shown(best.value, Certified(value=best.value)),
            "level": Shown(self.level, f"the worst {self.level} of the episodes"),
            "mean": Shown(best.mean, Certified(value=best.mean)),
            "threshold": best.threshold,
            "distribution": Shown(best.distribution()),
            "points": [
                {"weight": o.weight, "mean": o.mean, "cvar": o.value, "threshold": o.threshold}
                for o in self.optima
            ],
            "policies": Shown(
                [{"policy": name, "mean": m, "cvar": v} for name, (m, v) in self.policies.items()]
            ),
            "policy": [
                {"state": label(state), "from": low, "to": high, "action": action}
                for state, low, high, action in best.rules()
            ],
        }
        points = Table(
            title="mean against the worst episodes",
            rows=self.frame(),
            columns={"policy": "policy", "mean": "mean:.10g", "of the worst": "CVaR:.10g"},
            note="the best policies remember the reward so far; each is exact, and best for its "
            "weight",
        )
        rules = Table(
            title="best policy for the worst episodes, by state and reward so far",
            columns={"state": "state", "from": "from:.10g", "to": "to:.10g", "action": "action"},
            first=RULES,
            note="--policy-out FILE writes it",
        )
        tables = {"points": points, "policy": rules}
        return Report(title="mean of the worst episodes", facts=facts, tables=tables)

    def frame(self) -> DataFrame:
        """Return one row for each best policy, and for each given one."""
        best = {
            f"best, weight {shown(o.weight)} of the mean": (o.mean, o.value) for o in self.optima
        }
        rows = [*best.items(), *self.policies.items()]
        return data_frame(
            {"policy": name, "mean": float(mean), "CVaR": float(value), "claim": "certified"}
            for name, (mean, value) in rows
        )


def mean_cvar(
    model: MDP | Scenario,
    level: object,
    *,
    policies: Mapping[str, PolicyLike] | None = None,
    weights: Sequence[object] = WEIGHTS,
) -> MeanCVaR:
    """Return the mean and the mean of the worst episodes under best and given policies, exactly.

    Parameters
    ----------
    model : MDP or Scenario
        With discount 1 and without cycles: `mdp.within(n)` has none.
    level : number or "p/q"
        The share of the worst episodes, above 0.
    policies : {name: PolicyLike}, optional
    weights : sequence of numbers
        Of the mean, each below 1.

    Returns
    -------
    MeanCVaR

    Raises
    ------
    ModelError
        As `best_cvar` does.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 1, 10), ("1/2", 1, 0)]), (0, 1, [(1, 1, 4)]), (1, 0, [(1, 1, 0)])]
    >>> points = mean_cvar(MDP.from_outcomes(rows), "1/2", policies={"bold": [0, 0]})
    >>> [str(number) for number in points.policies["bold"]]
    ['5', '0']
    """
    mdp, share, placed = mdp_of(model), share_of(level), dict[str, tuple[Fraction, Fraction]]()
    optima = [best_cvar(mdp, share, weight=weight) for weight in weights]
    for name, policy in (policies or {}).items():
        law = return_distribution(mdp, policy, exact=True)
        if law.unending:
            what, fix = "a return of the policy may be infinite", "give one that ends"
            raise ModelError(what, where="policy", fix=f"{fix}, or stop after N steps")
        assert law.exact is not None
        both = sorted((mdp.sign * x, p) for x, p in zip(law.values, law.exact, strict=True))
        mean = sum((value * p for value, p in both), Fraction(0))
        placed[name] = mdp.sign * mean, mdp.sign * tail_mean(both, share)
    optima.sort(key=lambda each: each.weight)
    return MeanCVaR(mdp=mdp, level=share, optima=tuple(optima), policies=placed)
