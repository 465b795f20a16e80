"""Values that a solver of a user's own improves state by state."""

from dataclasses import dataclass
from time import perf_counter
from typing import ClassVar

import numpy as np
import pytest
from cases import BY_NAME
from strategies import of_case

from exact_mdp import MDP, Status, solve
from exact_mdp.solvers.dynamic.methods import Improving
from exact_mdp.solvers.kernels import bellman
from exact_mdp.solvers.solution import Solution


@dataclass(frozen=True, kw_only=True)
class OneByOne(Improving):
    """A solver of a user's own, which improves states one by one and tells nobody."""

    name: ClassVar[str] = "one-by-one"

    def maximise(self, model: MDP) -> Solution:
        started = perf_counter()
        values, stopping = self.begin(model)
        pairs = bellman.build_compiled_model(model, model.reward, values.weights.margin)
        for _ in range(self.max_iterations):
            values.pass_over_pairs()
            if stopping.is_reached():
                break
            values.apply_backup()
            bellman.relax_states(np.arange(model.n_states), pairs, values.value, values.level)
        return stopping.conclude(self, started)


@pytest.mark.parametrize("name", ["howard-taxicab", "forest-10-24/25", "puterman-two-state-9/10"])
def test_the_loop_sees_that_states_were_improved_one_by_one(name: str) -> None:
    """Were the values shifted to the middle of the bounds, this would bring back old errors."""
    solution = solve(of_case(BY_NAME[name]), OneByOne(max_iterations=200))
    assert solution.status is Status.CONVERGED
    assert solution.method == "one-by-one"
