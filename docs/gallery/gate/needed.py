"""How many records a verdict needs.

The pairs whose counts leave the verdict open, and how many more would decide it.
"""

import pandas as pd

from exact_mdp import MDP, check
from exact_mdp.analysis import Robust

seen = [("ill", "treat", 1, "well")] * 60 + [("ill", "treat", 0, "ill")] * 20
seen += [("ill", "wait", 1, "well")] * 10 + [("ill", "wait", 0, "ill")] * 10
rows = [(k, *row) for k, row in enumerate(seen)]
columns = ["episode", "state", "action", "reward", "next_state"]
model = MDP.from_transitions(pd.DataFrame(rows, columns=columns), discount="1/2")
by = Robust(rewards="known")
audit = check(model, "always:treat", max_regret="1/10", confidence=0.95, by=by)
audit.needed().plot()
