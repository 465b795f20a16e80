"""Small chains with everything that may go wrong, and what is true of a policy on them, exactly.

The equations of the first and the second moment of the return are solved by `oracle`; they share
nothing with the code that they check, which uses neither of the two.
"""

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction as F
from functools import cached_property

import numpy as np
from care_oracle import ACTIONS, END, Oracle, State
from care_oracle import Policy as OraclePolicy
from hypothesis import strategies as st
from model_contents import meant
from oracle import fixed_point, hitting, visits

from exact_mdp import MDP, Policy, Scenario

Outcome = tuple[F, int, F, bool]
Law = dict[F, F]
DISCOUNTS = (F(0), F(1, 2), F(19, 20), F(9999, 10_000), F(1))
REWARDS = st.sampled_from([F(0), F(1), F(-1), F(1, 2), F(-7, 3), F(10**9), F(1, 10**9), F(20)])
WEIGHTS = st.sampled_from([1, 1, 2, 3, 7, 1000])


@dataclass(frozen=True, kw_only=True)
class Case:
    """A model as {(state, action): [(probability, next, reward, event)]}, and a policy."""

    n_states: int
    rows: dict[tuple[int, int], list[Outcome]]
    discount: F
    start: dict[int, F]
    policy: dict[tuple[int, int], F]
    floats: bool = False

    @cached_property
    def model(self) -> MDP:
        kind = float if self.floats else F
        rows = [
            (s, a, [(kind(p), t, kind(r)) for p, t, r, _ in outcomes])
            for (s, a), outcomes in self.rows.items()
        ]
        mdp = MDP.from_outcomes(rows, self.discount, start=self.start)
        happens = {
            (*key, t, F(kind(r))): event
            for key, outcomes in self.rows.items()
            for _, t, r, event in outcomes
        }
        keys = zip(mdp.pair_state.tolist(), mdp.pair_action.tolist(), strict=True)
        marks = [happens[*key, t, r] for pair, key in enumerate(keys)
                 for _, t, r in mdp.table.row(pair)]  # fmt: skip
        # The second bit is an event that never happens.
        table = replace(mdp.table, event=np.array(marks, dtype=np.uint8))
        return mdp.with_(table=table, events=("hit", "miss"))

    @cached_property
    def weights(self) -> np.ndarray:
        return np.array([float(self.policy[key]) for key in sorted(self.rows)])

    @cached_property
    def outcomes(self) -> dict[int, list[Outcome]]:
        """What can follow each state under the policy: exactly what the floats stand for."""
        listed: dict[int, list[Outcome]] = defaultdict(list)
        for s, a in sorted(self.rows):
            total = sum(F(float(w)) for (state, _), w in self.policy.items() if state == s)
            share = F(float(self.policy[s, a])) / total
            row = self.rows[s, a] if share else []
            chances = meant([float(p) if self.floats else p for p, *_ in row]) if row else []
            for p, (_, t, r, event) in zip(chances, row, strict=True):
                listed[s].append((share * F(p), t, F(float(r)) if self.floats else r, event))
        return listed

    # ---- where it leads --------------------------------------------------------------------------

    @cached_property
    def terminal(self) -> set[int]:
        moving = {s for (s, _), row in self.rows.items() for _, t, r, _ in row if t != s or r}
        return set(range(self.n_states)) - moving

    def chance(self, targets: set[int]) -> list[F]:
        """Of ever being in one of some states, from each."""
        laws = enumerate(self.moves(F(1), set(range(self.n_states))))
        chain = [(s, 0, F(0), {t: p for t, p in law.items() if p}) for s, law in laws]
        return hitting(chain, [s in targets for s in range(self.n_states)], [True] * self.n_states)

    @cached_property
    def ending(self) -> set[int]:
        """States from which a terminal one is reached with probability 1."""
        return {s for s, p in enumerate(self.chance(self.terminal)) if p == 1}

    @cached_property
    def reached(self) -> set[int]:
        each = ((t, self.chance({t})) for t in range(self.n_states))
        return {t for t, chances in each if any(chances[s] for s in self.start)}

    @property
    def ends(self) -> bool:
        return self.reached <= self.ending

    @cached_property
    def live(self) -> set[int]:
        return (self.ending if self.discount == 1 else set(range(self.n_states))) - self.terminal

    # ---- what it is worth ------------------------------------------------------------------------

    def moves(self, rate: F, among: set[int], through: bool = True) -> list[dict[int, F]]:
        """The rows of the chain, of some states alone; events stop it on demand."""
        moves: list[dict[int, F]] = [defaultdict(F) for _ in range(self.n_states)]
        for s in among:
            for p, t, _, event in self.outcomes[s]:
                moves[s][t] += rate * p * (through or not event)
        return moves

    def solve(
        self, constant: Callable[[Outcome], F], rate: F, among: set[int], through: bool = True
    ) -> list[F]:
        """x(s) = E[constant + rate x(next)], x = 0 outside `among`."""
        right = [
            sum((o[0] * constant(o) for o in self.outcomes[s] if s in among), F(0))
            for s in range(self.n_states)
        ]
        return fixed_point(right, self.moves(rate, among, through))

    @cached_property
    def value(self) -> list[F]:
        return self.solve(lambda o: o[2], self.discount, self.live)

    @cached_property
    def variance(self) -> list[F]:
        """By the second moment: E[G²] = E[r² + 2 γ r V' + γ² G'²]."""
        g, v = self.discount, self.value
        square = self.solve(lambda o: o[2] ** 2 + 2 * g * o[2] * v[o[1]], g * g, self.live)
        return [x - y**2 for x, y in zip(square, v, strict=True)]

    def mean(self, values: list[F]) -> F:
        return sum((weight * values[s] for s, weight in self.start.items()), F(0))

    @cached_property
    def total_variance(self) -> F:
        mean, pairs = self.mean(self.value), zip(self.variance, self.value, strict=True)
        return self.mean([own + (value - mean) ** 2 for own, value in pairs])

    @cached_property
    def steps(self) -> F:
        return self.mean(self.solve(lambda o: F(1), F(1), self.ending - self.terminal))

    @cached_property
    def hit(self) -> F:
        happening = {s for s in range(self.n_states) if any(e for *_, e in self.outcomes[s])}
        among = {s for s, p in enumerate(self.chance(happening - self.terminal)) if p}
        return self.mean(self.solve(lambda o: F(o[3]), F(1), among, through=False))

    def visits(self, rate: F, among: set[int]) -> list[F]:
        """Expected visits of each state, in which only those `among` lead on."""
        return visits(self.start, self.moves(rate, among))


@st.composite
def cases(
    draw: st.DrawFn,
    *,
    discounts: tuple[F, ...] = DISCOUNTS,
    rewards: st.SearchStrategy[F] = REWARDS,
    weights: st.SearchStrategy[int] = WEIGHTS,
) -> Case:
    """Draw a model with joint rewards, events, self loops and ends, and a mixed policy."""
    n_states, acyclic = draw(st.integers(1, 5)), draw(st.booleans())
    rows: dict[tuple[int, int], list[Outcome]] = {}
    policy: dict[tuple[int, int], F] = {}
    for s in range(n_states):
        actions = sorted(draw(st.sets(st.integers(0, 2), min_size=1, max_size=3)))
        over = s == n_states - 1 or draw(st.integers(0, 4)) == 0
        for a in actions:
            if over:
                rows[s, a] = [(F(1), s, F(0), False)]
                continue
            states = st.integers(s + 1 if acyclic else 0, n_states - 1)
            keys = draw(st.lists(st.tuples(states, rewards), min_size=1, max_size=4, unique=True))
            shares = [draw(weights) for _ in keys]
            rows[s, a] = [
                (F(share, sum(shares)), t, r, draw(st.booleans()))
                for share, (t, r) in zip(shares, keys, strict=True)
            ]
        shares = [draw(st.sampled_from([0, 0, 1, 2])) for _ in actions]
        shares[draw(st.integers(0, len(actions) - 1))] += 1
        policy |= {(s, a): F(n, sum(shares)) for a, n in zip(actions, shares, strict=True)}
    chosen = draw(st.lists(st.integers(0, n_states - 1), min_size=1, max_size=2, unique=True))
    odds = [draw(weights) for _ in chosen]
    start = {s: F(weight, sum(odds)) for s, weight in zip(chosen, odds, strict=True)}
    return Case(
        n_states=n_states, rows=rows, discount=draw(st.sampled_from(discounts)), start=start,
        policy=policy, floats=draw(st.booleans()),
    )  # fmt: skip


SMALL = st.sampled_from([F(0), F(1), F(-1), F(1, 2), F(-7, 3), F(5)])
LAWFUL = cases(discounts=(F(1),), rewards=SMALL, weights=st.integers(1, 3))


def brute_force(case: Case, steps: int) -> tuple[Law, F]:
    """Follow every way of an episode for some steps: the law of the ended ones, and the rest."""
    moving: dict[tuple[int, F], F] = {(s, F(0)): weight for s, weight in case.start.items()}
    ended: Law = defaultdict(F)
    for step in range(steps + 1):
        following: dict[tuple[int, F], F] = defaultdict(F)
        for (s, total), mass in moving.items():
            if s in case.terminal:
                ended[total] += mass
            elif step == steps:
                following[s, total] += mass
            else:
                for p, t, r, _ in case.outcomes[s]:
                    following[t, total + r] += mass * p
        moving = following
    return dict(ended), sum(moving.values(), F(0))


def is_acyclic(case: Case) -> bool:
    return brute_force(case, case.n_states)[1] == 0


def coin(*rewards: object, ways: int = 1) -> MDP:
    """One of some rewards at random, several times over."""
    rows = [
        (step, 0, [(F(1, len(rewards)), step + 1, reward) for reward in rewards])
        for step in range(ways)
    ]
    return MDP.from_outcomes([*rows, (ways, 0, [(1, ways, 0)])])


def geometric(stay: str, reward: object = -1) -> MDP:
    return MDP.from_outcomes(
        [(0, 0, [(stay, 0, reward), (1 - F(stay), 1, 0)]), (1, 0, [(1, 1, 0)])]
    )


# ---- the care model ------------------------------------------------------------------------------


def careful(state: State) -> dict[str, F]:
    """A mixed policy that reads every part of the state, in quarters."""
    assert not isinstance(state, str)
    k, t, c, s = state
    if s[2] or s[3]:
        return {"supportive": F(3, 4), ACTIONS[(k + t + c) % 2 * 2]: F(1, 4)}
    return {"directive" if s[0] and s[1] else "non-directive": F(1)}


def uniform(state: State) -> dict[str, F]:
    return dict.fromkeys(ACTIONS, F(1, 4))


def directive(state: State) -> dict[str, F]:
    return {"directive": F(1)}


def state_of(mdp: MDP, number: int) -> State:
    if number == mdp.n_states - 1:
        return END
    value = {name: int(mdp.space.values(name, np.array([number]))[0]) for name in mdp.space.names}
    bits = mdp.space.column("status").bits
    status = tuple(value["status"] >> shift & 1 for shift in reversed(range(bits)))
    return (value["subtask"], value["trial"], 1 - value.get("skipped", 0), status)


def policy_of(mdp: MDP, policy: OraclePolicy) -> Policy:
    table = np.zeros((mdp.n_states, mdp.n_actions))
    for number in range(mdp.n_states):
        if mdp.forced[number]:
            table[number, mdp.pair_action[mdp.pair_offsets[number]]] = 1
            continue
        for action, share in policy(state_of(mdp, number)).items():
            table[number, mdp.action(action)] += float(share)
    return Policy(space=mdp.space, actions=mdp.actions, rule=table)


def care(
    readings: dict[str, str], tasks: list[int], discount: F = F(1), max_trial: int = 2
) -> tuple[MDP, Oracle]:
    """The compiled model and the oracle of the same choices."""
    scenario = Scenario.load("yuan2025").with_(
        readings=readings, tasks=tasks, discount=discount, max_trial=max_trial
    )
    oracle = Oracle(readings, tasks=tasks, max_trial=max_trial, discount=discount)
    return scenario.compile(), oracle
