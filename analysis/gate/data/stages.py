"""The robust bounds of episodes that stop after N steps, stage by stage.

With V_N = 0 and D_N = 0 every bound of `analysis.gate.data.bounds` is one backward step at each
time t, with the policy of that time, which may depend on it:

    L^π_t ≤ V^π_t ≤ U^π_t  from t + 1,        D_t(s) = max over l of  A_P,t(l) + γ P_l D_{t+1}.

The process has the same rows at every time. The sets let nature choose other ones at each, which
can only widen the interval; all rows are in their sets at once, whatever the time, so that no more
doubt is spread over the times. What rewards can add up to in the steps that are left bounds states
in which episodes were cut off, and no range of totals has to be stated at discount 1.
"""

from __future__ import annotations

import numpy as np

from exact_mdp.analysis.gate.data.bounds import RobustBounds
from exact_mdp.analysis.gate.data.interval import Ends
from exact_mdp.analysis.gate.data.sets import RowSets
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import SLACK, UNIT

tqdm = later("tqdm")


def totals(sets: RowSets, steps: int) -> Ends:
    """Return where the total of some steps lies, in every model of the sets."""
    mdp = sets.mdp
    certain = mdp.reward[sets.counted == 0]
    each = min(0.0, sets.rewards[0], *certain), max(0.0, sets.rewards[1], *certain)
    weight = float(np.cumsum(mdp.discount ** np.arange(steps))[-1]) * SLACK
    return each[0] * weight * SLACK, each[1] * weight * SLACK


def staged(sets: RowSets, own: Floats) -> RobustBounds:
    """Return the bounds at time 0; `own` (N, L) are the policy's probabilities at each time."""
    names = ("own_low", "own_high", "best_low", "best_high", "least_regret", "most_regret")
    ahead = {name: np.zeros(sets.mdp.n_states) for name in names}
    steps = len(own)
    for time in tqdm.trange(steps - 1, -1, -1, desc="stages", disable=None, delay=2):
        now = RobustBounds(sets=sets, own=own[time], returns=totals(sets, steps - time))
        vars(now).update(ahead)  # the values that follow
        here = {}
        for most, side, sign in ((False, "low", -1), (True, "high", 1)):
            bound = now.under_policy(most)(ahead[f"own_{side}"]).bound
            mixed = 4 * UNIT * sets.mdp.n_actions * np.abs(bound)
            here[f"own_{side}"] = bound + sign * mixed
            here[f"best_{side}"] = now.optimum(most)(ahead[f"best_{side}"]).bound
        for most, name, best, other in (
            (False, "least_regret", "best_low", "own_high"),
            (True, "most_regret", "best_high", "own_low"),
        ):
            found = now.gaining(most, ahead[best], here[other])(ahead[name]).bound
            apart = here[best] - here[other]
            better = np.minimum(found, apart) if most else np.maximum(found, apart)
            here[name] = np.maximum(better, 0.0)
        ahead = here
    bounds = RobustBounds(sets=sets, own=own[0], returns=totals(sets, steps))
    vars(bounds).update(ahead)
    return bounds
