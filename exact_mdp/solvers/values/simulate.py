"""Sampled episodes of a policy, all of them side by side.

Every episode draws its next outcome by inversion: the first outcome of its state at which the
cumulative probability exceeds a uniform number. Nothing here uses the equations of `evaluate`, so
that the two check each other (Monte Carlo policy evaluation: Sutton and Barto, Reinforcement
Learning, 2018, section 5.1).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, inf, isfinite, log, log1p, nan, sqrt
from typing import ClassVar

import numpy as np
import tqdm

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.components import require_amounts
from exact_mdp.mdp.errors import ModelError, named_options
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, format_interval, format_number
from exact_mdp.mdp.result import DataFrame, Pictured, data_frame
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import RNG, seed_of
from exact_mdp.solvers.arguments import mdp_of
from exact_mdp.solvers.bounds.gains import SLACK, TINY
from exact_mdp.solvers.claims import Claim, Estimated
from exact_mdp.solvers.dynamic.base import check_counts
from exact_mdp.solvers.values.policy_chain import PolicyChain, split_infinite_returns

MOST_STEPS = 10**8  # of an episode that need not end: minutes of work


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Simulation(Pictured):
    """Returns of sampled episodes, and the estimate of the policy's mean return.

    Attributes
    ----------
    returns : (E,)
        Discounted total reward of each episode.
    steps : (E,) ints
        Timesteps of each episode, until it ended, was cut off or was known never to end.
    events : {name: share}
        Share of the episodes in which each event of the model happened.
    truncated : int
        Episodes cut off before a terminal state: below discount 1, or by a horizon.
    truncation_error : float
        The most that a cut can have changed a return: γ^t max|r| / (1 - γ), rounding included.
        `value` and its interval include it. A horizon is not an error: episodes stop there by
        definition.
    endless : int
        Episodes that never end: they gain or lose forever, or stay in states without rewards.

    Examples
    --------
    >>> rows = [(0, 0, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])]
    >>> print(simulate(MDP.from_outcomes(rows), "random", n=3, rng=0).value)
    2 ± 0 s.e. (estimated)
    """

    returns: Floats
    steps: Integers
    events: dict[str, float]
    truncated: int
    truncation_error: float
    endless: int = 0

    claim: ClassVar[Claim] = Claim.ESTIMATED

    @property
    def episodes(self) -> int:
        """Number of episodes, E."""
        return len(self.returns)

    @property
    def value(self) -> Estimated:
        """The mean return with its standard error, and a bound on the rewards that were cut off."""
        return Estimated(
            value=self.mean, standard_error=self.standard_error, cut_off=self.truncation_error
        )

    @property
    def never_ends(self) -> float:
        """Share of the episodes that gain or lose forever; their return is infinite."""
        return float(np.isinf(self.returns).mean())

    @property
    def mean(self) -> float:
        """Mean return; infinite if a return is infinite, NaN if some are +∞ and others -∞."""
        with np.errstate(over="ignore", invalid="ignore"):
            return float(self.returns.mean())

    @property
    def sd(self) -> float:
        """Standard deviation of the returns; NaN if one is infinite, ∞ for a single episode."""
        if self.never_ends:
            return nan
        with np.errstate(over="ignore", invalid="ignore"):
            if self.episodes > 1:
                return float(self.returns.std(ddof=1))
            return inf

    @property
    def standard_error(self) -> float:
        """Standard error of `mean`, which comes from the draws alone."""
        return self.sd / sqrt(self.episodes)

    @property
    def mean_steps(self) -> float:
        """Mean number of timesteps; infinite if an episode never ends."""
        if self.endless:
            return inf
        return float(self.steps.mean())

    def report(self) -> Report:
        """Return the estimate, the number of episodes, and their settings."""
        # As people read them; an infinite mean has neither an interval nor a deviation.
        mean: object = self.value
        interval: object = None
        sd = "undefined: the mean is infinite"
        if isfinite(self.mean):
            low, high = self.value.interval
            interval = f"{format_interval(low, high, self.standard_error / 10)} (95 %)"
            sd = format_number(self.sd, self.standard_error / 10)
        else:
            mean = f"{self.mean} ({self.claim})"
        steps: object = self.mean_steps
        if self.endless:
            steps = f"{self.mean_steps}: some never end"
        return Report(
            title="simulation",
            facts={
                "claim": Shown(self.claim),
                "mean": Shown(self.mean, mean),
                "standard_error": Shown(self.standard_error),
                "interval": Shown(self.value.interval, interval),
                "sd": Shown(self.sd, sd),
                "steps": Shown(self.mean_steps, steps),
                "event_probability": self.events,
                "episodes": self.episodes,
                "never_ends": Shown(self.never_ends, self.never_ends or None),
                "truncated": Shown(self.truncated, self.truncated or None),
                "truncation_error": Shown(self.truncation_error, self.truncation_error or None),
            },
        )

    def frame(self) -> DataFrame:
        """Return the return and the steps of each episode."""
        return data_frame({"return": self.returns, "steps": self.steps})

    def __repr__(self) -> str:
        return f"Simulation({self.episodes} episodes, mean {self.value})"


@named_options
def simulate(
    model: MDP | Scenario,
    policy: PolicyLike,
    n: int,
    rng: RNG,
    *,
    kind: str = "auto",
    horizon: int | None = None,
) -> Simulation:
    """Return the sampled returns of a policy's episodes.

    Parameters
    ----------
    model : MDP or Scenario
    policy, kind : as for `evaluate`
    n : int
        Number of episodes.
    rng : int or numpy.random.Generator
        The same integer gives the same returns, byte for byte; 0 is as good as any other.
    horizon : int, optional
        Stop every episode after this many steps, without a further reward, as an environment with a
        time limit does; see `evaluate`. Without a horizon, and below discount 1, an episode is cut
        off when its remaining rewards are at most 10⁻¹² of the greatest return.

    Returns
    -------
    Simulation

    Raises
    ------
    ModelError
        If `n` or `rng` is missing or invalid; at discount 1 if rewards cancel forever.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 1, 0), ("1/2", 1, 2)]), (1, 0, [(1, 1, 0)])]
    >>> sample = simulate(MDP.from_outcomes(rows), "random", n=400, rng=0)
    >>> abs(sample.mean - 1) < 4 * sample.standard_error
    True
    """
    check_counts("simulate", n=n)
    if isinstance(rng, np.random.Generator):
        generator = rng
    else:
        generator = np.random.default_rng(seed_of(rng))
    unstopped = mdp_of(model)
    require_amounts(unstopped.table, "a sample of returns")
    if horizon is None:
        given = unstopped
    else:
        given = unstopped.within(horizon)
    # Classes in which a run stays forever become ends, so every episode at discount 1 ends.
    chain, infinite = split_infinite_returns(PolicyChain.of(given, policy, kind=kind))
    mdp = chain.mdp
    # Below discount 1, find the number of steps after which an episode may be cut off.
    size = float(np.abs(chain.gain[chain.reached[chain.source]]).max())
    missing = float(1 - mdp.discount_exact)
    limit = None
    if horizon is None and missing:
        # The greatest return is size / (1 - γ); rewards after t steps add at most γ^t of it, and
        # 1e-12 is less than any sample can show.
        if missing == 1:
            limit = 1
        else:
            limit = ceil(log(1e-12) / log1p(-missing))
        if limit > MOST_STEPS and not chain.ends_from_start:
            raise ModelError(
                f"episodes need not end, and at discount {mdp.discount:.12g} their first "
                f"{limit:,} steps count",
                where="simulate",
                fix="stop them: horizon=100000, --horizon 100000; or evaluate the policy, which "
                "takes no sample",
            )
    # One cumulative sum over the outcomes of all states, for a single search among them. It loses
    # as many digits as the number of states has, which is far below the error of any sample.
    above, last = np.cumsum(chain.probability), np.cumsum(chain.outcomes) - 1
    below = np.append(0.0, above[last])
    following, gain, event = chain.table.next, chain.gain, chain.table.event
    # Draw the first states.
    begins = np.flatnonzero(mdp.start_distribution)
    state = np.full(n, begins[0])
    if len(begins) > 1:
        share = np.cumsum(mdp.start_distribution[begins])
        drawn = np.searchsorted(share / share[-1], generator.random(n), side="right")
        state = begins[drawn]
    returns, steps = np.zeros(n), np.zeros(n, dtype=np.int64)
    happened = np.zeros(n, dtype=np.uint8)
    # Move all episodes one step at a time until each has ended; γ^t is the factor of step t.
    running, factor, step = np.flatnonzero(~mdp.terminal[state]), 1.0, 0
    with tqdm.tqdm(desc="simulating", unit="step", delay=2, disable=None) as bar:
        while len(running) and (limit is None or step < limit):
            # Inversion: a uniform number between the cumulative sums of the state.
            here = state[running]
            drawn = below[here] + generator.random(len(here)) * (below[here + 1] - below[here])
            outcome = np.minimum(np.searchsorted(above, drawn, side="right"), last[here])
            with np.errstate(over="ignore", invalid="ignore"):  # refused below
                returns[running] += factor * gain[outcome]
            steps[running] += 1
            if event is not None:
                happened[running] |= event[outcome]
            state[running] = following[outcome]
            running = running[~mdp.terminal[state[running]]]
            factor, step = factor * mdp.discount, step + 1
            bar.update()
    if not np.isfinite(returns).all():
        raise ModelError(
            "a return is beyond the range of floats", where="rewards", fix="scale them down"
        )
    for sign, lost in infinite.items():
        returns[lost[state]] = sign
    # The last layer of a model with a horizon is a copy of all states at the final time: an
    # episode was cut off there unless its own state is terminal.
    stopped = 0
    if horizon is not None:
        over = mdp.n_states - unstopped.n_states
        stopped = int((~unstopped.terminal[state[state >= over] - over]).sum())
    # Σ γ^k max|r| from the step of the cut on.
    cut_off = 0.0
    if len(running) and size:
        cut_off = size * factor / missing * SLACK + TINY
    return Simulation(
        returns=returns,
        steps=steps,
        events={name: float(((happened >> bit) & 1).mean()) for bit, name in enumerate(mdp.events)},
        truncated=len(running) + stopped,
        truncation_error=cut_off,
        endless=int((mdp.terminal & ~given.terminal)[state].sum()),
    )
