"""The loop of methods that improve values, with a solver of a user's own."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
from cases import BY_NAME
from strategies import of_case

from exact_mdp import Status, solve
from exact_mdp.solvers.dynamic.iterate import Values
from exact_mdp.solvers.dynamic.methods import Improving
from exact_mdp.solvers.kernels import bellman


@dataclass(frozen=True, kw_only=True)
class OneByOne(Improving):
    """A solver of a user's own, which improves states one by one and tells nobody."""

    name: ClassVar[str] = "one-by-one"

    def step(self, values: Values, goal: float) -> None:
        values.take()
        model = bellman.build_compiled_model(values.mdp, values.mdp.reward, values.weights.margin)
        bellman.relax_states(np.arange(values.mdp.n_states), model, values.value, values.level)


@pytest.mark.parametrize("name", ["howard-taxicab", "forest-10-24/25", "puterman-two-state-9/10"])
def test_the_loop_sees_that_states_were_improved_one_by_one(name: str) -> None:
    """Were the values shifted to the middle of the bounds, this would bring back old errors."""
    solution = solve(of_case(BY_NAME[name]), OneByOne(max_iterations=200))
    assert solution.status is Status.CONVERGED
    assert solution.method == "one-by-one"
