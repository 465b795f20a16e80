"""A verdict that rational arithmetic gives does not hang on visits in floating point."""

from fractions import Fraction
from pathlib import Path

import pytest
from cli_runner import run

from exact_mdp.analysis.gate.check import check
from exact_mdp.analysis.gate.exact_policy import exact_visits
from exact_mdp.mdp import MDP
from exact_mdp.mdp.io.load import save_model
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.visits import visits

HARDLY = Fraction(1, 10**20)


def loop(reward: int = 0, other: int = 1) -> MDP:
    """Return a model whose action 0 stays with probability 1 - 10**-20, and action 1 with 1/2."""
    stay = [(1 - HARDLY, 0, reward), (HARDLY, 1, reward)]
    leave = [("1/2", 0, other), ("1/2", 1, other)]
    return MDP.from_outcomes([(0, 0, stay), (0, 1, leave), (1, 0, [(1, 1, 0)])])


def patient() -> MDP:
    """Return a model of discount 1 - 10**-20, in which action 1 earns 1 a step and 0 nothing."""
    return MDP.from_outcomes(
        [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 0, 1)])], discount=1 - HARDLY
    )  # fmt: skip


CASES = [
    (loop, {"0": "0"}, Fraction(2)),
    (loop, {"0": "1"}, Fraction(0)),
    (loop, "always:0", Fraction(2)),
    (lambda: loop(-1, -1), {"0": "0"}, 10**20 - Fraction(2)),
    (lambda: loop(1, 0), {"0": "1"}, Fraction(10**20)),
    (lambda: loop(1, 0), {"0": "0"}, Fraction(0)),
    (patient, {"0": "0"}, Fraction(10**20)),
    (patient, {"0": "1"}, Fraction(0)),
    (patient, "random", Fraction(10**20, 2)),
]


@pytest.mark.parametrize("make, policy, lost", CASES)
@pytest.mark.parametrize("exact", [None, True])
def test_the_verdict_is_given_where_floats_cannot_bound_visits(
    make: object, policy: object, lost: Fraction, exact: bool | None
) -> None:
    """The exact regret is told, a limit of just that passes, and none below it."""
    assert callable(make)
    model = make()
    audit = check(model, policy, exact_values=exact)
    assert (audit.regret.at_start.value, audit.passed) == (lost, lost == 0)
    assert audit.claim == "certified"
    assert sum(each.cost for each in audit.disagreements) == pytest.approx(float(lost), rel=1e-12)
    assert all(each.gain_if_corrected is None for each in audit.disagreements)
    assert check(model, policy, max_regret=lost).passed
    assert not lost or not check(model, policy, max_regret=lost - HARDLY).passed
    assert "nan" not in audit.message()


@pytest.mark.parametrize("words", [(), ("--certify",)])
@pytest.mark.parametrize("policy", ["always:0", "p.json"])
def test_the_command_line_gives_the_verdict(
    tmp_path: Path, words: tuple[str, ...], policy: str
) -> None:
    """`check` ends with 0 or 1, the regret in full, and strict JSON."""
    save_model(loop(), tmp_path / "model.npz")
    (tmp_path / "p.json").write_text('{"0": "0", "1": "0"}')
    named = tmp_path / policy if policy.endswith("json") else policy
    asked = ["check", tmp_path / "model.npz", named, *words, "--json"]
    found = run(*asked)
    assert (found.status, found.result["exact_regret"]) == (1, "2")
    (each,) = found.result["disagreements"]
    assert each["expected_visits"] == 1e20
    assert run(*asked, "--max-regret", "2").status == 0


def test_exact_visits_are_those_of_floating_point_where_it_can() -> None:
    """Two ways agree, with a cycle, a spread start, and states that are not reached."""
    rows = [
        (0, 0, [("1/3", 1, 0), ("2/3", 2, 0)]),
        (0, 1, [(1, 2, 0)]),
        (1, 0, [("1/2", 0, 0), ("1/2", 3, 0)]),
        (2, 0, [("1/4", 0, 0), ("3/4", 3, 0)]),
        (3, 0, [(1, 3, 0)]),
        (4, 0, [(1, 0, 0)]),
    ]
    for discount in (1, "9/10"):
        model = MDP.from_outcomes(rows, discount, start={0: "1/2", 2: "1/2"})
        chain = PolicyChain.of(model, "random")
        near = visits(model, chain.discounted).value
        assert exact_visits(chain).tolist() == pytest.approx(near.tolist(), rel=1e-12)
        assert exact_visits(chain)[4] == 0
