"""How far all parameters of a scenario may move at once before its optimal policy can change.

Let every parameter j move by at most ρ w_j. A chance enters one status's law with coefficient at
most 1, and next statuses are independent, so that every row of outcomes moves by at most ρ τ in
the L1 norm, τ = 2 Σ_j d_j w_j over the chances (d_j = 2 where a number is in the laws of a step
and of a skip). Rewards move by at most ρ R, R = Σ w_j over the weights, each of which is paid at
most once in a step; an outcome earns between the sums of the negative and of the positive weights,
G apart. Values of today's policy π span D and are at most M in size, so that one step adds at most

    ρ δ,   δ = R + τ (G + D) / 2 + w_γ M

to the change of V_π, and n(s) steps that are left add n(s) ρ δ. A gap is the difference of two such
values: π stays optimal, in every state, as long as ρ < gap(s) / (2 n(s) δ) for all s. The bound is
a proof, and is far from tight.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

from exact_mdp.analysis.gate.regret import proven
from exact_mdp.analysis.sensitivity.ranges import Ranges, around, checked
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.lazy import later
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import DISCOUNT
from exact_mdp.mdp.result import Result
from exact_mdp.solvers.proof.certificate import Certificate

if TYPE_CHECKING:
    from pandas import DataFrame

pandas = later("pandas")


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class JointRadius(Result):
    """A box around today's values in which today's optimal policy is optimal.

    Attributes
    ----------
    share : Fraction
        ρ: any move with |θ_j - today_j| < ρ w_j for all j leaves the policy optimal.
    widths : {name: w}
    state : str
        The state whose gap decides.
    """

    share: Fraction
    widths: Mapping[str, Fraction]
    state: str

    def frame(self) -> DataFrame:
        """Return one row for each parameter: how far it may move together with the others."""
        moves = {name: float(self.share * width) for name, width in self.widths.items()}
        return pandas.DataFrame({"parameter": list(moves), "moves by": list(moves.values())})


def joint_radius(model: Scenario, ranges: Mapping[str, object] | None = None) -> JointRadius:
    """Return a provable inner radius for joint changes, as a share of the parameters' ranges.

    Parameters
    ----------
    model : Scenario
    ranges : {name: (low, high)}, optional
        The parameters that move, and how far relative to each other: w is the distance of the
        farther end from today's value. All of them, ± 20 %, unless given.

    Returns
    -------
    JointRadius

    Raises
    ------
    ModelError
        For unknown names, empty ranges, or where nothing moves.

    Examples
    --------
    >>> found = joint_radius(Scenario.load("yuan2025"), {"base.anger": (0, 1)})
    >>> 0 < found.share < 1
    True
    """
    family = ScenarioFamily(scenario=model)
    today = {parameter.name: parameter.value for parameter in family.parameters}
    if ranges is None:
        spans = Ranges({parameter.name: around(parameter) for parameter in family.parameters})
    else:
        spans = checked(family, ranges)
    widths = {
        name: max(today[name] - span.low, span.high - today[name]) for name, span in spans.items()
    }
    mdp = model.compile()
    certificate = proven(mdp)
    step = _step(family, widths, today, certificate)
    if step <= 0:
        raise ModelError("nothing moves", where="joint radius", fix="widen a range")
    shares = {state: gap / (2 * left * step) for state, gap, left in _gaps(mdp, certificate)}
    if not shares:
        raise ModelError("no state with a choice", where="joint radius", fix="add an action")
    state = min(shares, key=lambda each: shares[each])
    return JointRadius(share=shares[state], widths=widths, state=mdp.space.label(state))


def _step(
    family: ScenarioFamily,
    widths: Mapping[str, Fraction],
    today: Mapping[str, Fraction],
    certificate: Certificate,
) -> Fraction:
    """Return δ."""
    zero = Fraction(0)
    weights = {name for name in today if name.startswith("reward.")}
    reward = sum((w for name, w in widths.items() if name in weights), zero)
    chances = [name for name in widths if name not in weights and name != DISCOUNT]
    law = 2 * sum((family.degree(name) * widths[name] for name in chances), zero)
    apart = sum((abs(today[name]) for name in weights), zero)
    value = certificate.value
    span, size = max(value) - min(value), max(abs(v) for v in value)
    step: Fraction = reward + law * (apart + span) / 2 + widths.get(DISCOUNT, zero) * size
    return step


def _gaps(mdp: MDP, certificate: Certificate) -> list[tuple[int, Fraction, int]]:
    """Return each state with a choice, its gap, and the steps that are left at most."""
    trials = mdp.space.column("trial").size
    places = mdp.space.column("subtask").size * trials
    gone = (mdp.space.values("subtask") * trials + mdp.space.values("trial")).tolist()
    found = []
    for state, single in enumerate((mdp.forced | mdp.terminal).tolist()):
        if not single:
            optimal = certificate.optimal_pairs[list(mdp.pairs_of(state))]
            # Several optimal actions today may part at once.
            gap = certificate.gaps[state] if optimal.sum() == 1 else Fraction(0)
            found.append((state, gap, places - gone[state]))
    return found
