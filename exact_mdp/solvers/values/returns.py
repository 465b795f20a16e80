"""The exact distribution of the return of a policy at discount 1.

Rewards are rationals, so returns lie on a lattice: whole multiples of one rational unit. The mass
of every pair (state, reward so far) is carried along the policy's chain, from the start to the end,

    m(s', x + r) += p · m(s, x)        for each outcome (p, s', r) of s,

state after state in an order in which no transition leads back. All terms of these sums are at
least 0, so every probability keeps a small *relative* error, however small it is. States that lead
back to each other are swept until at most 10⁻¹² of the mass is left among them; the remaining mass
is reported. Runs that gain or lose forever, or miss a goal, end with an infinite return (forward
dynamic programming; for the distribution of the return see Sobel, Journal of Applied Probability
19, 1982, section 2, and Chung and Sobel, Discounted MDP's: distribution functions and exponential
utility maximization, SIAM J. Control and Optimization 25, 1987).
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import accumulate
from math import isinf, lcm, sqrt
from typing import Any, ClassVar

import numpy as np

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.components import require_amounts
from exact_mdp.mdp.errors import ModelError, named_options
from exact_mdp.mdp.graph import Mask
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import (
    MOST_LISTED,
    Report,
    Shown,
    Table,
    format_decimal,
    format_error_bound,
)
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import (
    Floats,
    Numbers,
    OutcomeTable,
    exact,
    format_rational,
    multiply,
    to_integer_array,
)
from exact_mdp.mdp.validate import as_share
from exact_mdp.solvers.arguments import mdp_of
from exact_mdp.solvers.bounds.gains import SLACK, TINY, UNIT, gamma
from exact_mdp.solvers.claims import Claim, in_float
from exact_mdp.solvers.values.policy_chain import PolicyChain, split_infinite_returns
from exact_mdp.solvers.values.return_mass import MassFlow


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class ReturnDistribution(Pictured):
    """Every possible return with its probability, in increasing order; K of them.

    Attributes
    ----------
    multiples : (K,) ints
        Returns, as multiples of `unit`; inf or -inf for runs that gain or lose forever, or miss a
        goal. Runs that stay forever in states without rewards have a finite return.
    unit : Fraction
    probabilities : (K,)
    relative_error : float
        The error of each probability is at most this part of it, plus `remaining`.
    remaining : float
        A bound on the probability of all other returns: the mass that was still moving when the
        sweeps stopped, and parts below 10⁻²⁹⁰. 0 if all returns are listed.
    exact : tuple of Fraction, optional
        The probabilities as exact rationals, if `exact=True` was given.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 1, "1/2"), ("1/2", 1, 2)]), (1, 0, [(1, 1, 0)])]
    >>> distribution = return_distribution(MDP.from_outcomes(rows), "random")
    >>> distribution.mean, distribution.cdf(1), distribution.quantile(0.5)
    (1.25, 0.5, Fraction(1, 2))
    """

    multiples: Numbers
    unit: Fraction
    probabilities: Floats
    relative_error: float
    remaining: float
    exact: tuple[Fraction, ...] | None = None

    claim: ClassVar[Claim] = Claim.BOUNDED

    @property
    def error(self) -> Floats:
        """(K,) bounds on the errors of the probabilities."""
        return self.relative_error * self.probabilities + self.remaining + TINY

    def _compute_value(self, place: int) -> Fraction | float:
        multiple: Any = self.multiples[place]
        if isinstance(multiple, float):
            return multiple
        return self.unit * int(multiple)

    @cached_property
    def values(self) -> tuple[Fraction | float, ...]:
        """The returns as exact rationals, or infinite floats."""
        return tuple(map(self._compute_value, range(len(self.multiples))))

    @cached_property
    def _floats(self) -> Floats:
        return np.array([in_float(value) for value in self.values])

    @property
    def never_ends(self) -> float:
        """Probability of an infinite return."""
        return sum((p for value, p in self.as_dict().items() if isinf(value)), 0.0)

    @property
    def mean(self) -> float:
        """Mean of the listed returns; `evaluate` bounds the mean of all, rare ones included.

        Infinite if one is infinite; NaN if some are +∞ and others -∞.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return float(self.probabilities @ self._floats)

    @property
    def sd(self) -> float:
        """Standard deviation of the listed returns; NaN if one is infinite."""
        with np.errstate(over="ignore", invalid="ignore"):
            return sqrt(float(self.probabilities @ (self._floats - self.mean) ** 2))

    @cached_property
    def _sums(self) -> Any:
        """The cdf at each return: exact if the probabilities are exact."""
        if self.exact is None:
            return np.cumsum(self.probabilities)
        return [*accumulate(self.exact)]

    def cdf(self, value: object) -> float:
        """Return the probability of a return of at most `value` (a number or "p/q")."""
        bound = exact(value, "return") / self.unit
        count = bisect_right(self.multiples, bound.numerator // bound.denominator)
        if count:
            return float(self._sums[count - 1])
        return 0.0

    def quantile(self, share: object) -> Fraction | float:
        """Return the least return whose cdf is at least `share`; it may be infinite.

        A share is a number or "p/q", from 0 to 1; raises ModelError for any other value.

        A cdf that misses `share` by no more than its error bound counts as reaching it, so that
        the median of a fair coin is tails, whatever the roundings. Exact probabilities need no
        such allowance.
        """
        # A float means the decimal that is written for it: 0.1 is 1/10.
        if isinstance(share, float):
            share = str(share)
        wanted = exact(share, "quantile")
        if not 0 <= wanted <= 1:
            raise ModelError(
                f"no quantile is at {format_rational(wanted)}",
                where="quantile",
                fix="choose a probability from 0 to 1",
            )
        if self.exact is None:
            slack = (self.relative_error + self.remaining + len(self.multiples) * UNIT) * SLACK
            wanted -= Fraction(slack)
        return self._compute_value(min(bisect_left(self._sums, wanted), len(self.multiples) - 1))

    def tail_mean(self, share: object, *, highest: bool = False) -> Fraction | float:
        """Return the mean of the lowest share of the returns (CVaR), or of the highest.

        Parameters
        ----------
        share : number or "p/q"
            Above 0, at most 1, which gives the mean of all.
        highest : bool
            Take the highest returns, which are the worst if they are costs.

        Returns
        -------
        Fraction or float
            Exact if the probabilities are exact; else as accurate as they are, without the returns
            that are not listed (`remaining`). Infinite if one of these returns is infinite.

        Raises
        ------
        ModelError
            For any other share, and if returns that are not listed may make up all of it.

        Examples
        --------
        >>> rows = [(0, 0, [("1/2", 1, 10), ("1/2", 1, 0)]), (1, 0, [(1, 1, 0)])]
        >>> distribution = return_distribution(MDP.from_outcomes(rows), [0, 0], exact=True)
        >>> str(distribution.tail_mean("3/4")), str(distribution.tail_mean(1))
        ('10/3', '5')
        """
        part = as_share(share, "share")
        if part <= self.remaining:
            what = f"returns with a probability of up to {self.remaining:.2g} are not listed"
            fix = "choose a greater share, or a horizon, which ends cycles"
            raise ModelError(what, where="conditional value at risk", fix=fix)
        distribution = zip(self.values, self.exact or self.probabilities.tolist(), strict=True)
        mean: Fraction | float = tail_mean(dict(distribution), part, highest=highest)
        return mean

    def as_dict(self) -> dict[Fraction | float, float]:
        """Return {return: probability}, infinite returns included."""
        return dict(zip(self.values, self.probabilities.tolist(), strict=True))

    def frame(self) -> DataFrame:
        """Return the probability of every return, infinite ones included, and its error bound."""
        columns = {"probability": self.probabilities, "error": self.error}
        return data_frame(columns, index=[*self.values]).rename_axis("return")

    def report(self) -> Report:
        """Return the distribution of the return."""
        distribution = {format_decimal(value): chance for value, chance in self.as_dict().items()}
        error = float(self.error.max())
        facts: dict[str, Any] = {
            "claim": Shown(self.claim),
            "mean": self.mean,
            "sd": self.sd,
            "error_bound": Shown(
                error, f"{format_error_bound(error)} of each probability ({self.claim})"
            ),
            "remaining": Shown(self.remaining, self.remaining or None),
            "never_ends": Shown(self.never_ends, self.never_ends or None),
            "distribution": distribution,
        }
        if self.exact is not None:
            facts["exact_distribution"] = dict(zip(distribution, self.exact, strict=True))
        below = accumulate(distribution.values())
        rows = []
        for (value, chance), most in zip(distribution.items(), below, strict=True):
            rows.append({"return": value, "chance": chance, "sum": most})
        columns = {"return": "return", "probability": "chance", "at most that": "sum"}
        table = Table(title="distribution", rows=rows, columns=columns, first=MOST_LISTED)
        return Report(
            title="distribution of the return", facts=facts, tables={"distribution": table}
        )

    def __repr__(self) -> str:
        infinite = ""
        if self.never_ends:
            infinite = f", infinite with probability {self.never_ends:.6g}"
        return (
            f"ReturnDistribution({len(self.multiples)} returns, mean {self.mean:.6g}, "
            f"sd {self.sd:.6g}, remaining {self.remaining:.1g}{infinite})"
        )


def tail_mean(distribution: Mapping[Any, Any], level: Fraction, *, highest: bool = False) -> Any:
    """Return the mean of the lowest, or the highest, share of returns with their probabilities."""
    left: Any = level
    total: Any = Fraction(0)
    for value in sorted(distribution, reverse=highest):
        part = min(left, distribution[value])
        # 0 times an infinite return would be NaN.
        if part:
            total += part * value
        left -= part
    return total / level


@named_options
def return_distribution(
    model: MDP | Scenario,
    policy: PolicyLike,
    *,
    exact: bool = False,
    kind: str = "auto",
    horizon: int | None = None,
) -> ReturnDistribution:
    """Return the distribution of the total reward of an episode.

    Parameters
    ----------
    model : MDP or Scenario
        With discount 1.
    policy, kind : as for `evaluate`
    exact : bool
        Compute the probabilities as exact rationals; for small chains without cycles.
    horizon : int, optional
        Stop after this many steps; see `evaluate`.

    Returns
    -------
    ReturnDistribution

    Raises
    ------
    ModelError
        Below discount 1; if rewards cancel forever, so that a return has no limit; if there are
        too many different returns; if states that lead back to each other are left too slowly.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 1, "1/2"), ("1/2", 1, 2)]), (1, 0, [(1, 1, 0)])]
    >>> distribution = return_distribution(MDP.from_outcomes(rows), "random")
    >>> print(*distribution.values, distribution.probabilities.tolist())
    1/2 2 [0.5, 0.5]
    """
    mdp = mdp_of(model)
    require_amounts(mdp.table, "the distribution of returns")
    if mdp.discount_exact != 1:
        raise ModelError(
            f"discount {mdp.discount_exact} gives returns that are not on a lattice, so that their "
            "distribution is not a list",
            where="discount",
            fix="choose discount 1; evaluate() gives mean and sd, simulate() samples returns",
        )
    if horizon is not None:
        mdp = mdp.within(horizon)
    # Rewards as whole multiples of a unit; then carry the mass from the start to the end.
    chain, lost = split_infinite_returns(PolicyChain.of(mdp, policy, kind=kind))
    used = chain.reached[chain.source] & ~chain.mdp.terminal[chain.source]
    gain, unit = find_lattice(chain.table, used)
    multiples, masses, left, roundings = MassFlow(chain, gain, lost, exact=exact).carry_mass()
    shares = None
    relative_error = float(gamma(roundings)) * SLACK
    if exact:
        # Exact probabilities are rounded once, to floats.
        shares = tuple(masses)
        masses = np.array([float(share) for share in shares])
        relative_error = UNIT
    return ReturnDistribution(
        multiples=multiples,
        unit=unit,
        probabilities=masses,
        relative_error=relative_error,
        remaining=float(left) * SLACK,
        exact=shares,
    )


def find_lattice(table: OutcomeTable, used: Mask) -> tuple[Numbers, Fraction]:
    """Return rewards (N,) as multiples of the greatest common unit of some (N,), and that unit."""
    # Bring all rewards over one denominator.
    top, bottom = table.integer_gains
    lengths = np.diff(table.offsets)
    if len(top) == table.pairs:
        top = np.repeat(top, lengths)
    whole = lcm(*np.unique(bottom).tolist())
    factor = np.repeat(to_integer_array(whole // int(number) for number in bottom), lengths)
    scaled = multiply(top, factor)
    step = max(int(np.gcd.reduce(scaled[used])), 1)
    multiples = scaled // step
    # A return adds up fewer than 2³² multiples, so that 64 bits hold it if all are below 2³¹.
    if np.abs(multiples).max() >= 2**31:
        multiples = multiples.astype(object)
    return multiples, Fraction(step, whole)
