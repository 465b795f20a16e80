"""Care models solved without their matrix: each draw's values are those of the model itself."""

import numpy as np
import pytest

from exact_mdp import Scenario, certify, evaluate, parametric
from exact_mdp.solvers.care import evaluate_care_policies, solve_care_draws

SMALL = Scenario.load("yuan2025").with_(tasks=[2, 1], max_trial=2)
NAMES = ["base.anger", "reward.anger"]
DRAWS = np.array([[0.0, -3.0], [0.05, -10.0], [0.5, 1.0]])


def test_the_optimum_of_each_draw_is_that_of_its_model() -> None:
    found = solve_care_draws(SMALL, NAMES, DRAWS)
    for k, draw in enumerate(DRAWS):
        mdp = parametric(SMALL).at(dict(zip(NAMES, draw.tolist(), strict=True)))
        assert abs(found.start[k] - float(certify(mdp).start_value)) <= found.error[k] < 1e-9


def test_policies_in_each_draw_earn_what_they_earn_in_its_model() -> None:
    mdp = SMALL.compile()
    names = ["random", "always:directive"]
    directive = np.eye(4)[list(mdp.actions).index("directive")]
    policies = np.stack([np.full((1, 1, 1, 16, 4), 0.25), np.tile(directive, (1, 1, 1, 16, 1))])
    value, error = evaluate_care_policies(SMALL, NAMES, DRAWS, policies)
    for k, draw in enumerate(DRAWS):
        model = parametric(SMALL).at(dict(zip(NAMES, draw.tolist(), strict=True)))
        own = [evaluate(model, name).start for name in names]
        assert value[k] == pytest.approx([x.value for x in own], abs=2e-9)
        assert error[k] < 1e-9
