"""A pytest fixture that compares policies with the exact optimum of a model.

    policy_gate("yuan2025", "policy.json", max_regret=0.1)
    policy_gate("yuan2025", train, max_regret=0.5, runs=100, share="9/10", alpha="1/100", rng=0)

The model is an `MDP`, or any MODEL of the command line, with `set` and `discount` as its options;
files are looked for beside the test first. All else is what `check` takes, or with `runs`
`check_trainer`. The test fails, naming the costly states, where a limit does not hold; otherwise
the audit is returned. What was found is recorded in pytest's own JUnit report (`--junitxml`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from exact_mdp.analysis.gate.audit import Audit
    from exact_mdp.analysis.learning.trainers import TrainerAudit
    from exact_mdp.mdp.model import MDP

SUFFIXES = (".toml", ".npz", ".umb", ".json", ".csv", ".npy")


@pytest.fixture
def policy_gate(request: pytest.FixtureRequest) -> Callable[..., Audit | TrainerAudit]:
    """Assert that a policy loses no more than it may against the exact optimum of a model."""
    from exact_mdp.analysis.exit_status import answering
    from exact_mdp.analysis.gate.check import check
    from exact_mdp.analysis.learning.trainers import check_trainer
    from exact_mdp.mdp.io.load import load

    @answering()
    def gate(
        model: MDP | str | Path,
        policy: Any,
        *,
        set: Sequence[str] = (),
        discount: object | None = None,
        **limits: Any,
    ) -> Any:
        __tracebackhide__ = True
        if isinstance(model, str | Path):
            mdp = load(_beside(request.path, model), sets=set, discount=discount)
        else:
            mdp = model if discount is None else model.with_(discount=discount)
        # Not by `record_property`, which warns where pytest's own report is of the family xunit2.
        if "runs" in limits:
            if isinstance(policy, list | tuple | Iterator):
                policy = [_beside(request.path, one) for one in policy]
            result: Any = check_trainer(mdp, policy, **{"rng": 0} | limits)
        else:
            result = check(mdp, _beside(request.path, policy), **limits)
        request.node.user_properties += result.measures.items()
        if not result.passed:
            pytest.fail(result.message(), pytrace=False)
        return result

    return gate


def _beside(test: Path, name: Any) -> Any:
    """Return the path of a file beside the test where there is one of that name."""
    if isinstance(name, str | Path) and Path(name).suffix.lower() in SUFFIXES:
        near = test.parent / name
        return near if near.is_file() else name
    return name
