"""Textbook examples of Puterman."""

from fractions import Fraction

from .case import Case, Pair, actions, best, indexed, over_horizon, row, rows

F = Fraction
BOOK = "Puterman, Markov Decision Processes (Wiley 2005)"
TESTS = "QuantEcon/QuantEcon.py quantecon/markov/tests/test_ddp.py"


def two_state(beta: Fraction, label: str = "") -> Case:
    """The example of section 3.1 at any discount below 1, with its closed form.

    In state 0, action 0 earns 5 and stays with probability 1/2, action 1 earns 10 and leaves;
    state 1 costs 1 for ever. Leaving is better below beta = 10/11, staying above, and at 10/11
    both are worth 0. The source gives the closed form above; below it is 10 + beta v(1).
    """
    stay = (5 - F(11, 2) * beta) / ((1 - beta / 2) * (1 - beta))
    leave = 10 - beta / (1 - beta)
    chosen = [action for action, v in enumerate((stay, leave)) if v == max(stay, leave)]
    return Case(
        name=f"puterman-two-state-{label or beta}",
        source=f"{BOOK}, section 3.1 and example 6.2.1; {TESTS}, TestDiscreteDP.setup_method",
        pairs=rows("0 0 5: 0 1/2, 1 1/2; 0 1 10: 1; 1 0 -1: 1"),
        discount=beta,
        values={0: max(stay, leave), 1: -1 / (1 - beta)},
        optimal=best(chosen, [0]),
    )


def inventory() -> Case:
    """Stochastic inventory control over three periods, expanded in time (12 states and the end).

    The stock is at most 3; ordering a units costs 4 + 2a, a unit in stock costs 1 per period, the
    demand is 0, 1 or 2 with probabilities 1/4, 1/2, 1/4, and a unit sold brings 8.
    """
    demand = ((0, F(1, 4)), (1, F(1, 2)), (2, F(1, 4)))
    pairs: list[Pair] = []
    for stock in range(4):
        for order in range(4 - stock):
            filled = stock + order
            sales = sum((8 * min(d, filled) * p for d, p in demand), F(0))
            cost = (4 + 2 * order if order else 0) + filled
            pairs.append(
                (stock, order, sales - cost, row(*((max(0, filled - d), p) for d, p in demand)))
            )
    return Case(
        name="puterman-inventory-horizon-3",
        source=f"{BOOK}, sections 3.2 and 4.6.1; {TESTS}, TestFiniteHorizon",
        pairs=over_horizon(pairs, 3),
        discount=F(1),
        values=indexed(F(v, 16) for v in (67, 129, 194, 227, 32, 100, 160, 168, 0, 80, 96, 80, 0)),
        policy=actions((3, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0)),
    )


CASES = (
    *map(
        two_state,
        (F(1, 2), F(9, 10), F(10, 11), F(19, 20), F(99, 100), F(999, 1000), F(999_999, 1_000_000)),
    ),
    two_state(F(10, 11) + F(1, 10**12), "near-tie"),
    two_state(F(1, 2) + F(1, 10**5000), "5000-digits"),  # more than Python converts to text
    inventory(),
)
