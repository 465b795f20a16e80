"""Small models with a parameter whose policies often have several recurrent classes."""

from fractions import Fraction as F
from random import Random
from typing import Any

from exact_mdp import MDP, Family, Parameter, certify

Rows = list[tuple[int, int, list[tuple[F, int, F]]]]


def two_states(at: Any) -> MDP:
    """From 0 to 1 with chance p, and back with chance q; state 0 earns r."""
    p, q, r = at["p"], at["q"], at["r"]
    rows = [(0, 0, [(1 - p, 0, r), (p, 1, r)]), (1, 0, [(q, 0, 0), (1 - q, 1, 0)])]
    return MDP.from_outcomes(rows, "1/2")


def random_rows(rng: Random, states: int = 4) -> Rows:
    """Return rows of a model whose policies often have several recurrent classes."""
    rows: Rows = []
    for state in range(states):
        for action in range(rng.choice((1, 1, 2, 2))):
            ends = rng.sample(range(states), rng.choice((1, 2, 2, 3)))
            weights = [F(rng.randint(1, 3)) for _ in ends]
            reward, total = F(rng.randint(-1, 1)), sum(weights)
            law = [(w / total, to, reward) for w, to in zip(weights, ends, strict=True)]
            rows.append((state, action, law))
    return rows


def sure_rows(rng: Random, states: int = 4) -> Rows:
    """Return rows that lead to one state each, often the same one: many classes."""
    rows: Rows = []
    for state in range(states):
        for action in range(rng.choice((1, 2))):
            to = state if rng.random() < 0.5 else rng.randrange(states)
            rows.append((state, action, [(F(1), to, F(rng.randint(-1, 1)))]))
    return rows


def moved_family(rng: Random, today: F, sense: str, rows: Rows | None = None) -> Family:
    """Return a family in which some pairs lead with chance t / 2 to a state at random."""
    if rows is None:
        rows = random_rows(rng)
    spots = {rng.randrange(len(rows)): rng.randrange(4) for _ in range(2)}

    def build(at: Any) -> MDP:
        t, moved = at["t"] / 2, list(rows)
        for place, to in spots.items():
            state, action, law = rows[place]
            reward = law[0][2] + at["t"]
            changed = [((1 - t) * p, other, reward) for p, other, _ in law] + [(t, to, reward)]
            moved[place] = state, action, [each for each in changed if each[0]]
        return MDP.from_outcomes(moved, start={"state 0": "1/3", "state 1": "2/3"}, sense=sense)

    return Family(
        parameters=(Parameter(name="t", value=today, low=0, high=1),), build=build, degrees={"t": 1}
    )


def average_of(mdp: MDP, policy: Any = "optimal") -> F:
    """Return the proven average at the start, of the optimum or of action numbers (S,)."""
    if policy != "optimal":
        pairs = [mdp.pairs_of(state)[action] for state, action in enumerate(policy)]
        rows = [(state, 0, mdp.table.row(pair)) for state, pair in enumerate(pairs)]
        start = {f"state {state}": weight for state, weight in mdp.start}
        mdp = MDP.from_outcomes(rows, start=start, sense=mdp.sense)
    return F(certify(mdp, criterion="average").start_value)
