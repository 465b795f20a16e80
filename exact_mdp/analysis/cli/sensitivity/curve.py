"""The kind curve: the optimal value at the start as an exact function of one parameter."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.analysis.cli.render import Report, Table
from exact_mdp.analysis.cli.sensitivity.options import STATED, Asked, analysis, stated_ranges
from exact_mdp.analysis.cli.solve import whole_policy
from exact_mdp.analysis.vary.curves.checker import Bracket, CurvePiece, RationalFunction
from exact_mdp.analysis.vary.curves.curve import curve
from exact_mdp.analysis.vary.curves.regret_limits import Interval
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP


@analysis("curve")
def curve_report(asked: Asked) -> Report:
    """Return the pieces of the function, and where a policy held fixed keeps a limit."""
    names: tuple[str, ...] = asked["parameters"] or ()
    if len(names) != 1:
        raise ModelError(
            f"{len(names)} parameters", where="curve", fix="name one: --parameter NAME"
        )
    (name,) = names
    stated = any(asked[option] for option in STATED)
    ranges = stated_ranges(asked.model, asked.options) if stated else None
    limits = {limit: asked[limit] for limit in ("max_regret", "max_relative_regret")}
    held = asked.policy if asked["policy"] or asked["perception"] or any(limits.values()) else None
    found = curve(asked.model, name, ranges, policy=held)
    mdp = found.mdp
    pieces = [_piece(mdp, piece) for piece in found.pieces]
    result: dict[str, Any] = {"parameter": name, "claim": found.claim, "pieces": pieces}
    facts: dict[str, Any] = {
        "parameter": name,
        "today": float(found.parameter.value),
        "pieces": len(pieces),
        "claim": found.claim,
    }
    within = list[Interval]()
    if any(limits.values()):
        within += found.within(**limits)
        result["within"] = [
            {
                "from": _point(each.low),
                "to": _point(each.high),
                "from_bracket": list(each.low),
                "to_bracket": list(each.high),
            }
            for each in within
        ]
        ends = [(float(_point(each.low)), float(_point(each.high))) for each in within]
        words = "; ".join(f"{low:.10g} to {high:.10g}" for low, high in ends)
        facts["the policy keeps the limit"] = words or "nowhere"
    table = Table(
        title="pieces of the optimal value at the start",
        rows=found.frame(),
        columns={
            "from": "low:.10g",
            "to": "high:.10g",
            "value from": "value_low:.10g",
            "value to": "value_high:.10g",
            "degree": "degree",
        },
        note="each is a ratio of polynomials, whose exact coefficients --json prints",
    )
    return Report(result=result, facts=facts, tables=[table])


def _piece(mdp: MDP, piece: CurvePiece) -> dict[str, Any]:
    return {
        "from": _point(piece.low),
        "to": _point(piece.high),
        "from_bracket": list(piece.low),
        "to_bracket": list(piece.high),
        **_ratio(piece.value),
        **({} if piece.fixed is None else {"fixed": _ratio(piece.fixed)}),
        **_policy(mdp, piece.optimal),
    }


def _ratio(ratio: RationalFunction) -> dict[str, Any]:
    """Return the coefficients of both."""
    return {"numerator": list(ratio.numerator), "denominator": list(ratio.denominator)}


def _point(bracket: Bracket) -> Fraction:
    """Return a fraction of small denominator between two ends; the end, where they are equal."""
    low, high = bracket
    middle, most = (low + high) / 2, 1
    while True:
        near = middle.limit_denominator(most)
        if low <= near <= high:
            return near
        most *= 10


def _policy(mdp: MDP, optimal: Any) -> dict[str, Any]:
    """Return the first optimal action of each state."""
    marked = np.flatnonzero(optimal)
    first = marked[np.flatnonzero(np.diff(mdp.pair_state[marked], prepend=-1))]
    return {"policy": whole_policy(mdp, [mdp.actions[a] for a in mdp.pair_action[first]])}
