"""Total hip replacement: the risk of a revision depends on the years since the operation.

Source: Briggs, Claxton and Sculpher, Decision Modelling for Health Economic Evaluation, Oxford
University Press 2006, section 3.5, for women of 60; the numbers are those that the vignette
"Reproducing exact results from DMHEE" of the R package heemod prints for it. Costs are discounted
by 6 %, QALYs by 1.5 %; the amounts of a year are those of the state in which it begins.
"""

from math import exp
from typing import Any

from exact_mdp import MDP

DEATH = {55: 0.0067, 65: 0.0193, 75: 0.0535, 85: 0.1548}  # a year, from this age on
OPERATION, AGAIN = 0.02, 0.04  # deaths in an operation, and further revisions a year
SCALE, SHAPE = exp(-5.490935 - 0.0367022 * 60), exp(0.3740968)
PRICE, RATIO = {"standard": 394, "NP1": 579}, {"standard": 1.0, "NP1": exp(-1.344474)}
YEARS = 60
DISCOUNTS = {"cost": "50/53", "qaly": "200/203"}
PUBLISHED = {"standard": (512.4327, 14.65283), "NP1": (610.3112, 14.69734)}  # cost and QALYs
PUBLISHED_ICER = 2198.977


def build_year(year: int) -> MDP:
    """Year 1, 2, …; a tunnel of states ("well", years since the operation) leads to a revision."""
    dies = DEATH[max(age for age in DEATH if age <= 60 + year)]

    def outcomes(state: Any, device: str) -> list[Any]:
        revised, since = ("revised", 0), state[1] + 1
        if state[0] == "operation":
            earned: dict[str, float] = {"cost": PRICE[device], "qaly": 0}
            rows = [(1 - OPERATION, ("well", 1)), (OPERATION, ("dead", 0))]
        elif state[0] == "well":
            earned = {"cost": 0, "qaly": 0.85}
            hazard = SCALE * RATIO[device] * (since**SHAPE - state[1] ** SHAPE)
            fails = 1 - exp(-hazard)
            rows = [(1 - fails - dies, ("well", min(since, YEARS))), (fails, ("revision", 0)),
                    (dies, ("dead", 0))]  # fmt: skip
        elif state[0] == "revision":
            earned = {"cost": 5294, "qaly": 0.3}
            rows = [(1 - OPERATION - dies, revised), (OPERATION + dies, ("dead", 0))]
        elif state == revised:
            earned = {"cost": 0, "qaly": 0.75}
            rows = [(1 - AGAIN - dies, revised), (AGAIN, ("revision", 0)), (dies, ("dead", 0))]
        else:
            earned, rows = {"cost": 0, "qaly": 0}, [(1.0, state)]
        return [(chance, to, earned) for chance, to in rows]

    return MDP.from_function(("operation", 0), lambda _: [*PRICE], outcomes)


def build_life() -> MDP:
    """60 years from the first operation on."""
    return MDP.from_steps([build_year(year) for year in range(1, YEARS + 1)])
