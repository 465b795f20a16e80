"""The Sick-Sicker model with age-dependent mortality and costs of transitions.

Source: Alarid-Escudero et al., A Tutorial on Time-Dependent Cohort State-Transition Models in R
Using a Cost-Effectiveness Analysis Example, Medical Decision Making 43 (2023): parameters of the
appendix, results of the table of the cost-effectiveness analysis. Mortality is that of the United
States in 2015 (Human Mortality Database), for the ages of 25 to 99, by the million.
"""

from math import exp

from exact_mdp import MDP

MORTALITY = """
    1014 999 1070 1087 1162 1167 1213 1289 1331 1375 1420 1490 1550 1616 1657 1747 1902 2052
    2173 2395 2559 2807 3023 3349 3712 4085 4490 4905 5364 5806 6253 6775 7395 7895 8418
    8974 9666 10456 11384 11838 12667 13593 14700 15732 17340 18758 20967 22917 24913 26767
    29707 32412 35982 39238 43595 48727 53735 59911 66618 74051 82190 90754 103968 115093
    124341 137872 154177 172393 194100 212654 243752 259087 287781 316429 339149
"""
STATES = ["unborn", "H", "S1", "S2", "dead"]
STRATEGIES = {"usual": (0, 0), "A": (1, 0), "B": (0, 1), "AB": (1, 1)}
PUBLISHED = {  # cost and QALYs
    "usual": (116_374, 18.879),
    "A": (218_789, 19.636),
    "B": (202_536, 20.199),
    "AB": (296_300, 21.097),
}


def build_year(rate: float | None) -> MDP:
    """One year, with the death rate of the healthy; without one, the year in which all are born.

    Amounts are those of the state that a person comes to, and of the transition.
    """
    rows = []
    for number, (a, b) in enumerate(STRATEGIES.values()):
        drugs = 12_000 * a + 13_000 * b
        worth = {"H": (1.0, 2_000), "S1": (0.95 if a else 0.75, 4_000 + drugs),
                 "S2": (0.5, 15_000 + drugs), "dead": (0.0, 0)}  # fmt: skip
        h, s1, s2 = (exp(-(rate or 0) * ratio) for ratio in (1, 3, 10))  # survival
        sick, well = 1 - exp(-0.15), 1 - exp(-0.5)
        worse = 1 - exp(-0.105 * (0.6 if b else 1))
        law = {
            "unborn": {"H": 1.0} if rate is None else {"unborn": 1.0},
            "H": {"H": h * (1 - sick), "S1": h * sick, "dead": 1 - h},
            "S1": {"H": s1 * well, "S1": s1 * (1 - well - worse), "S2": s1 * worse, "dead": 1 - s1},
            "S2": {"S2": s2, "dead": 1 - s2},
            "dead": {"dead": 1.0},
        }
        for state, outcomes in law.items():
            listed = []
            for to, chance in outcomes.items():
                qaly, cost = worth.get(to, (0.0, 0))
                if (state, to) == ("H", "S1"):
                    qaly, cost = qaly - 0.01, cost + 1_000
                if to == "dead" != state:
                    cost += 2_000
                listed.append((chance, STATES.index(to), {"qaly": qaly, "cost": float(cost)}))
            rows.append((STATES.index(state), number, listed))
    return MDP.from_outcomes(rows, "100/103", states=STATES, actions=[*STRATEGIES])


def build_life() -> MDP:
    """75 years from the age of 25, by the within-cycle correction of the tutorial."""
    rates = [int(number) / 1e6 for number in MORTALITY.split()]
    years = [build_year(None), *map(build_year, rates)]
    weights = ["1/3", *("4/3" if k % 2 else "2/3" for k in range(74)), "1/3"]
    return MDP.from_steps(years).weigh_steps(weights)
