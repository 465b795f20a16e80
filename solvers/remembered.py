"""What the passes over a large model leave for the next: upper bounds, a policy and its rows.

    q(l) = r(l) + γ Σ_s' P(l, s') h(s'),   q(l) now ≤ q(l) then + γ ρ

where ρ is the greatest rise of h in any state between the two. The rises of all steps since the
first are added up in `rise`, so that one number for each pair, q(l) less the rise until then, is
all that has to be kept, and a pair is looked at again only once that no longer proves it beaten.
What rounding may cost is added to each bound. Bounds of this kind eliminate actions in MacQueen,
Operations Research 15 (1967), and for one iteration at a time in Hastings and van Nunen, in Markov
Decision Theory (1977); here they also spare the last, judging pass most pairs.

The rows of the policy are copied side by side, each where the longest of its state's has room, as
reading them where they are would fetch from memory what lies between them, too.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mdp.model import MDP
from mdp.table import Floats, Integers, Numbers
from solvers.rounding import UNIT

if TYPE_CHECKING:
    from solvers.bounds import Weights
    from solvers.gains import RoundingFacts


@dataclass(eq=False)
class Remembered:
    """What passes around changing values h have found; see `solvers.kernels.bellman.improve`.

    Attributes
    ----------
    flow : tuple of float
        Bounds of γ Σ_s' P(l, s') over all pairs.
    margin : tuple of float
        Bounds of the margins of all pairs.
    ceilings : (L,)
        q(l) is at most this and `rise`. At first that is said of h = 0.
    pairs : (S,) int64
        The policy found by the last pass.
    slots, ends : (S+1,), (S,)
        Where its rows are in `indices` and `data`.
    chain : (3, S)
        Rewards, leaks and margins of its pairs.
    rise : float
        How much the greatest γ P_l h can have risen since the first pass, in the sum of all steps.
    before : (S,)
        h of the last pass.
    known : bool
        Whether there is a policy.
    """

    flow: tuple[float, float]
    margin: tuple[float, float]
    ceilings: Floats
    pairs: Integers
    slots: Numbers
    ends: Numbers
    indices: Numbers
    data: Floats
    chain: Floats
    before: Floats
    rise: float = 0.0
    known: bool = False

    @classmethod
    def nothing(cls, mdp: MDP, weights: Weights, facts: RoundingFacts) -> Remembered:
        """Return what is known of a model before any pass: q(l) = r(l) for h = 0."""
        leak, leak_error = facts.leak, facts.leak_error
        least, most = float(leak.min()) - leak_error, float(leak.max()) + leak_error
        lost = 4 * UNIT * (1 + abs(least) + abs(most))
        margin, matrix = weights.margin, mdp.transition
        longest = np.diff(matrix.indptr)
        if longest.min() < longest.max():
            longest = np.maximum.reduceat(longest, mdp.pair_offsets[:-1])
        else:
            longest = longest[: mdp.n_states]
        slots = np.zeros(mdp.n_states + 1, dtype=matrix.indptr.dtype)
        np.cumsum(longest, out=slots[1:])
        return cls(
            flow=(1 - most - lost, 1 - least + lost),
            margin=(float(margin.min()) - weights.error, float(margin.max()) + weights.error),
            ceilings=mdp.reward + 4 * facts.reward_error_bound(mdp),  # rounded, too
            pairs=np.empty(mdp.n_states, dtype=np.int64),
            slots=slots,
            ends=slots[:-1].copy(),
            indices=np.empty(slots[-1], dtype=matrix.indices.dtype),
            data=np.empty(slots[-1]),
            chain=np.empty((3, mdp.n_states)),
            before=np.zeros(mdp.n_states),
        )

    @property
    def rows(self) -> tuple[Numbers, Numbers, Numbers, Floats, Floats]:
        """The policy's rows, as compiled loops take them."""
        return self.slots, self.ends, self.indices, self.data, self.chain

    @property
    def alike(self) -> float:
        """A lower bound of m(l) / m(l') for any two pairs."""
        return self.margin[0] / self.margin[1] * (1 - 4 * UNIT)

    def drop(self, shift: float) -> float:
        """Return an upper bound of -c m(l) for any pair, c being the `shift`."""
        most = max(-shift * self.margin[0], -shift * self.margin[1])
        return most + 4 * UNIT * abs(most)

    def move(self, value: Floats) -> None:
        """Go on to h = `value` (S,)."""
        from solvers.kernels.bellman import climb

        most = float(np.nextafter(climb(value, self.before), np.inf))
        grown = max(self.flow[0] * most, self.flow[1] * most)
        self.rise += grown + 4 * UNIT * (abs(grown) + abs(self.rise))
