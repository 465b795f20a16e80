"""Small random models in exact numbers, and policies of them, for the files beside modules."""

from dataclasses import replace
from fractions import Fraction as F
from typing import Any

import numpy as np

from exact_mdp import MDP

Chances = dict[tuple[int, int], F]  # of each pair (state, action) that a policy takes


def small_model(
    seed: int,
    discount: object = 1,
    *,
    states: int = 5,
    ends: int = 2,
    falling: bool = False,
    leaving: bool = True,
    by_outcome: bool = True,
    **parts: Any,
) -> MDP:
    """A model whose states are numbered by chance and have one to three actions each.

    Where `falling`, each step leads nearer to an end; where `leaving`, it may; else states may lead
    to each other for ever. The rewards of a pair differ between its outcomes, if `by_outcome`.
    """
    rng = np.random.default_rng(seed)
    name = rng.permutation(states + ends).tolist()  # of the ends, then of the others
    rows: list[Any] = [(name[end], 0, [(1, name[end], 0)]) for end in range(ends)]
    for place in range(ends, states + ends):
        for action in sorted(rng.choice(3, size=rng.integers(1, 4), replace=False).tolist()):
            among = place if falling else states + ends
            following = rng.integers(0, among, size=rng.integers(1, 4)).tolist()
            if leaving and not falling:
                following.append(int(rng.integers(0, place)))
            weights = rng.integers(1, 8, size=len(following)).tolist()
            earned = [F(int(rng.integers(-6, 7)), int(rng.integers(1, 5))) for _ in following]
            rewards = earned if by_outcome else earned[:1] * len(earned)
            chances = [F(weight, sum(weights)) for weight in weights]
            each = zip(chances, [name[to] for to in following], rewards, strict=True)
            rows.append((name[place], action, list(each)))
    if "start" not in parts:
        first = rng.choice(states + ends, size=3, replace=False).tolist()
        parts["start"] = {first[0]: F(1, 2), first[1]: F(1, 3), first[2]: F(1, 6)}
    return MDP.from_outcomes(rows, discount, **parts)


def three_states(seed: int, sense: str = "max", discount: str = "3/4") -> MDP:
    """Three states of one or two pairs, rewards by outcome, a start in two states."""
    rng = np.random.default_rng(seed)
    rows: list[Any] = []
    for s in range(3):
        for a in range(1 + int(rng.integers(0, 2))):
            weights = rng.multinomial(4, [1 / 3] * 3)
            rows.append((s, a, [(F(int(k), 4), t, int(rng.integers(-3, 4)))
                                for t, k in enumerate(weights) if k]))  # fmt: skip
    mdp = MDP.from_outcomes(rows, discount, sense=sense, start={0: "1/3", 2: "2/3"})
    return mdp.with_(labels={"there": [2]})


def random_policy(mdp: MDP, seed: int, *, pure: bool = False) -> Chances:
    """Exact chances of pairs; in some states one action alone is taken, or in all where `pure`."""
    rng = np.random.default_rng(seed)
    chances: Chances = {}
    for state in range(mdp.n_states):
        actions = mdp.pair_action[mdp.pairs_of(state)].tolist()
        weights = rng.integers(0, 4, size=len(actions)).tolist()
        if pure or not any(weights):
            chosen = int(rng.integers(len(actions)))
            weights = [int(place == chosen) for place in range(len(actions))]
        for action, weight in zip(actions, weights, strict=True):
            if weight:
                chances[state, action] = F(weight, sum(weights))
    return chances


def given(chances: Chances) -> dict[int, dict[int, F]]:
    """Return the chances as a mapping that every function takes for a policy."""
    policy: dict[int, dict[int, F]] = {}
    for (state, action), chance in chances.items():
        policy.setdefault(state, {})[action] = chance
    return policy


def with_events(mdp: MDP, seed: int) -> MDP:
    """The model with two events, each of which happens in some outcomes."""
    bits = np.random.default_rng(seed).choice([0, 0, 1, 2, 3], size=len(mdp.table.next))
    bits[mdp.terminal[mdp.pair_state][mdp.table.pair]] = 0
    return mdp.with_(
        table=replace(mdp.table, event=bits.astype(np.uint8)), events=("first", "second")
    )


def outcomes_of(mdp: MDP, chances: Chances) -> list[list[Any]]:
    """Each state's outcomes under a policy: probability, next state, reward, bits of events."""
    listed: list[list[Any]] = [[] for _ in range(mdp.n_states)]
    bits = mdp.table.event
    for (state, action), chance in chances.items():
        pair = mdp.pair(state, action)
        for place, (p, to, reward) in enumerate(mdp.table.row(pair), mdp.table.offsets[pair]):
            listed[state].append((chance * p, to, reward, 0 if bits is None else int(bits[place])))
    return listed


def law_of_return(mdp: MDP, chances: Chances) -> dict[F, F]:
    """Return the law of the return of a model without cycles, run by run."""
    listed, law = outcomes_of(mdp, chances), dict[F, F]()
    waiting = [(state, F(0), chance) for state, chance in mdp.start if chance]
    while waiting:
        state, earned, chance = waiting.pop()
        if mdp.terminal[state]:
            law[earned] = law.get(earned, F(0)) + chance
        else:
            waiting += [(to, earned + r, chance * p) for p, to, r, _ in listed[state]]
    return dict(sorted(law.items()))
