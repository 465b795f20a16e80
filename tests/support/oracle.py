"""One exact reference for small models: plain fractions, and no code of the toolkit.

A model is its rows (state, action, expected reward, {next state: probability}), a policy the rows
that its states take, in their order. All equations are solved by one elimination, `solved`.
`rows_of` reads the rows of a model off its table of outcomes.
"""

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction as F
from functools import lru_cache
from itertools import product
from math import inf
from typing import Any

Row = tuple[int, int, F, Mapping[int, F]]
Vector = list[F]
Values = list[F | float]  # some may be infinite


# ---- equations -----------------------------------------------------------------------------------


def solved(rows: Iterable[Mapping[int, F]], *right: Sequence[F]) -> list[Vector] | None:
    """Return x with rows · x = b for each right side b; None unless there is one such x."""
    above: dict[int, tuple[dict[int, F], Vector]] = {}  # by the column that was solved for
    for number, (given, *values) in enumerate(zip(rows, *right, strict=True)):
        row = dict(given)
        for column, (other, known) in above.items():
            if factor := row.pop(column, F(0)):
                for c, x in other.items():
                    row[c] = row.get(c, F(0)) - factor * x
                values = [v - factor * k for v, k in zip(values, known, strict=True)]
        row = {c: x for c, x in row.items() if x}
        if not row:
            return None
        column = number if number in row else min(row)
        pivot = row.pop(column)
        above[column] = {c: x / pivot for c, x in row.items()}, [v / pivot for v in values]
    columns: dict[int, Vector] = {}
    for column, (row, values) in reversed(above.items()):
        columns[column] = [
            v - sum((x * columns[c][k] for c, x in row.items()), F(0)) for k, v in enumerate(values)
        ]
    return [[columns[s][k] for s in sorted(columns)] for k in range(len(right))]


def fixed_point(right: Sequence[F], moves: Sequence[Mapping[int, F]]) -> Vector:
    """x = right + moves x."""
    values = solved([_less(s, row) for s, row in enumerate(moves)], right)
    if values is None:
        raise ValueError("at discount 1 this policy never ends: it has no value")
    return values[0]


def _less(state: int, row: Mapping[int, F]) -> dict[int, F]:
    return {t: -p for t, p in row.items()} | {state: 1 - row.get(state, F(0))}


def mean(row: Mapping[int, F], values: Sequence[F]) -> F:
    return sum((p * values[t] for t, p in row.items()), F(0))


# ---- models and their policies -------------------------------------------------------------------


def rows_of(mdp: Any, pairs: Iterable[int] | None = None) -> list[Row]:
    """Return the rows of a model's pairs, or of some, such as those that a policy takes."""
    rows: list[Row] = []
    for pair in range(mdp.n_pairs) if pairs is None else pairs:
        reward, law = law_of(mdp.table, int(pair))
        rows.append((int(mdp.pair_state[pair]), int(mdp.pair_action[pair]), reward, law))
    return rows


@lru_cache(maxsize=2000)
def law_of(table: Any, pair: int) -> tuple[F, Mapping[int, F]]:
    """Return the expected reward of a pair and its probabilities {next state: p}."""
    law: dict[int, F] = {}
    outcomes = table.row(pair)
    for p, t, _ in outcomes:
        law[t] = law.get(t, F(0)) + p
    return sum((p * r for p, _, r in outcomes), F(0)), law


def each_choice(mdp: Any) -> Iterator[tuple[int, ...]]:
    return product(*(mdp.pairs_of(state) for state in range(mdp.n_states)))


def policies(rows: Iterable[Row]) -> Iterator[tuple[Row, ...]]:
    by_state: dict[int, list[Row]] = {}
    for row in rows:
        by_state.setdefault(row[0], []).append(row)
    return product(*(by_state[s] for s in sorted(by_state)))


def policy_values(policy: Sequence[Row], rate: F, ended: Collection[int] = ()) -> Vector:
    """V = r + γ P V of a policy; states that have ended are worth 0."""
    earned = [F(0) if s in ended else r for s, _, r, _ in policy]
    return fixed_point(
        earned,
        [{} if s in ended else {t: rate * p for t, p in law.items()} for s, _, _, law in policy],
    )


def mixed(rows: Iterable[Row], chances: Mapping[tuple[int, int], F]) -> list[Row]:
    """The chain of a policy that takes the pairs (state, action) with these probabilities."""
    earned: dict[int, F] = defaultdict(F)
    onward: dict[int, dict[int, F]] = defaultdict(lambda: defaultdict(F))
    for s, a, r, law in rows:
        share = chances.get((s, a), F(0))
        earned[s] += share * r
        for t, p in law.items():
            onward[s][t] += share * p
    return [(s, 0, earned[s], {t: p for t, p in onward[s].items() if p}) for s in sorted(earned)]


def visits(start: Mapping[int, F], moves: Sequence[Mapping[int, F]]) -> Vector:
    """d(t) = start(t) + Σ d(s) moves(s, t): how often each state is visited."""
    back: list[dict[int, F]] = [{} for _ in moves]
    for s, row in enumerate(moves):
        for t, p in row.items():
            back[t][s] = p
    return fixed_point([start.get(s, F(0)) for s in range(len(moves))], back)


# ---- the best policies, by policy iteration -----------------------------------------------------


def solve_exact(n_states: int, pairs: Iterable[Row], discount: F) -> tuple[Vector, list[set[int]]]:
    """Return the optimal values and, for each state, the set of all its optimal actions.

    Move every state to an action of larger q(s, a), evaluate, and again (Howard 1960). At discount
    1 the search starts from a policy that ends, in states whose every action is a self loop without
    reward; they are worth 0. Where another policy never ends, the answer still holds if each such
    policy loses without bound (Bertsekas and Tsitsiklis 1991).
    """
    model = _by_state(n_states, pairs)
    ended, policy = _absorbing(model), _ending_policy(model)
    while True:
        v = policy_values([model[s][policy[s]] for s in range(n_states)], discount, ended)
        q = [{a: r + discount * mean(law, v) for _, a, r, law in x.values()} for x in model]
        worse = [s for s in range(n_states) if q[s][policy[s]] < max(q[s].values())]
        if not worse:
            return v, [{a for a in q[s] if q[s][a] == v[s]} for s in range(n_states)]
        for s in worse:
            policy[s] = max(q[s], key=q[s].__getitem__)


def evaluate_exact(
    n_states: int, pairs: Iterable[Row], discount: F, policy: Mapping[int, int]
) -> Vector:
    """Return the values of a policy given as {state: action}."""
    model = _by_state(n_states, pairs)
    return policy_values(
        [model[s][policy[s]] for s in range(n_states)], discount, _absorbing(model)
    )


def every_policy_ends(n_states: int, pairs: Iterable[Row]) -> bool:
    """Whether no policy can stay forever among the states that are not absorbing."""
    inside = set(range(n_states)) - _absorbing(model := _by_state(n_states, pairs))
    while True:
        stay = {s for s in inside if any(inside.issuperset(r[3]) for r in model[s].values())}
        if stay == inside:
            return not inside
        inside = stay


def _by_state(n_states: int, pairs: Iterable[Row]) -> list[dict[int, Row]]:
    model: list[dict[int, Row]] = [{} for _ in range(n_states)]
    for s, a, r, law in pairs:
        if a in model[s] or min(law.values()) <= 0 or sum(law.values()) != 1:
            raise ValueError(f"state {s}, action {a}: given twice, or not a distribution")
        model[s][a] = (s, a, r, law)
    return model


def _absorbing(model: list[dict[int, Row]]) -> set[int]:
    return {
        s
        for s, rows in enumerate(model)
        if all(r == 0 and law == {s: 1} for _, _, r, law in rows.values())
    }


def _ending_policy(model: list[dict[int, Row]]) -> dict[int, int]:
    """Any policy, but one that reaches the absorbing states from wherever that is possible."""
    policy = {s: min(rows) for s, rows in enumerate(model)}
    done, before = _absorbing(model), -1
    while len(done) > before:
        before = len(done)
        for s in set(policy) - done:
            if near := [a for a, row in model[s].items() if not done.isdisjoint(row[3])]:
                policy[s] = near[0]
                done.add(s)
    return policy


# ---- labels: what is reached --------------------------------------------------------------------


def hitting(policy: Sequence[Row], target: Sequence[bool], allowed: Sequence[bool]) -> Vector:
    """The probability of reaching the target through allowed states: 0 where no path leads to it,
    and there the equations are not asked, so that they have one solution."""
    some = _leading_to(policy, [bool(t) for t in target], lambda s: bool(allowed[s]))
    moves = [law if some[s] and allowed[s] and not target[s] else {} for s, _, _, law in policy]
    return fixed_point([F(bool(t)) for t in target], moves)


def until(policy: Sequence[Row], target: Sequence[bool]) -> Values:
    """The expected reward until the target; infinite where it is not reached almost surely."""
    sure = hitting(policy, target, [True] * len(policy))
    ended = {s for s, chance in enumerate(sure) if chance < 1 or target[s]}
    values = policy_values(policy, F(1), ended)
    return [v if chance == 1 else inf for v, chance in zip(values, sure, strict=True)]


def _leading_to(
    policy: Sequence[Row], ends: list[bool], through: Callable[[int], bool]
) -> list[bool]:
    """Whether a path leads to the states found, step by step, through some states."""
    while True:
        more = [ends[s] or (through(s) and any(ends[t] for t in law)) for s, _, _, law in policy]
        if more == ends:
            return ends
        ends = more


def best_within(mdp: Any, steps: int, over: Mapping[int, F], missed: F | float, pay: int) -> Values:
    """The best total of `pay` times the rewards within N steps, and of what it is worth to be over
    in some states, or to have missed all of them."""
    best, rows = max if mdp.sense == "max" else min, rows_by_state(mdp)
    values: Values = [over.get(s, missed) for s in range(mdp.n_states)]
    for _ in range(steps):
        totals = [
            [pay * r + sum(p * values[t] for t, p in law.items()) for _, _, r, law in each]
            for each in rows
        ]
        values = [over[s] if s in over else best(each) for s, each in enumerate(totals)]
    return values


def rows_by_state(mdp: Any) -> list[list[Row]]:
    return [rows_of(mdp, mdp.pairs_of(state)) for state in range(mdp.n_states)]


def by_table(
    table: Any, steps: int, rate: float = 1, choices: Sequence[int] | None = None
) -> tuple[list[float], list[list[list[float]]]]:
    """V_0 and the Q-table of every time (N, S, A), straight from a table of Gymnasium's form.

    Of the best choices, or of those given.
    """
    value, tables = [0.0] * len(table), list[list[list[float]]]()
    for _ in range(steps):
        q = [
            [
                sum(p * (r + (0 if over else rate * value[n])) for p, n, r, over in row)
                for row in table[s].values()
            ]
            for s in table
        ]
        tables.append(q)
        value = [max(row) if choices is None else row[choices[s]] for s, row in enumerate(q)]
    return value, tables[::-1]


# ---- the long run --------------------------------------------------------------------------------


def classes(policy: Sequence[Row]) -> list[list[int]]:
    """The recurrent classes of a chain, by transitive closure."""
    reach = [{s, *law} for s, _, _, law in policy]
    for _ in range(2):
        for k, i in product(range(len(reach)), repeat=2):
            if k in reach[i]:
                reach[i] |= reach[k]
    closed = {frozenset(r) for i, r in enumerate(reach) if all(i in reach[j] for j in r)}
    return [sorted(each) for each in closed]


def limit(policy: Sequence[Row]) -> list[dict[int, F]]:
    """The Cesàro limit of the powers of a chain, row by row."""
    laws = [law for *_, law in policy]
    rows: dict[int, dict[int, F]] = {}
    for each in classes(policy):
        place = {s: k for k, s in enumerate(each)}
        balance: list[dict[int, F]] = [{} for _ in each]  # of (I - P)ᵀ, and shares that sum to 1
        for s in each:
            for t, x in _less(s, laws[s]).items():
                balance[place[t]][place[s]] = x
        balance[-1] = dict.fromkeys(range(len(each)), F(1))
        shares = solved(balance, [F(s == each[-1]) for s in each])
        assert shares is not None
        rows |= {s: dict(zip(each, shares[0], strict=True)) for s in each}
    moves = [{} if s in rows else law for s, law in enumerate(laws)]
    ends = sorted(rows)
    shares = solved(
        [_less(s, row) for s, row in enumerate(moves)],
        *([rows[s].get(t, F(0)) if s in rows else F(0) for s in range(len(laws))] for t in ends),
    )
    assert shares is not None
    columns = dict(zip(ends, shares, strict=True))
    never = [F(0)] * len(laws)
    return [{t: columns.get(t, never)[s] for t in range(len(laws))} for s in range(len(laws))]


def gain_and_bias(policy: Sequence[Row]) -> tuple[tuple[F, ...], tuple[F, ...]]:
    """g = P* r and h = (I - P + P*)⁻¹ (r - g) (Puterman 1994, appendix A)."""
    star, reward = limit(policy), [r for _, _, r, _ in policy]
    gain = [mean(row, reward) for row in star]
    rows = []
    for s, _, _, law in policy:
        row = _less(s, law)
        rows.append(row | {t: row.get(t, F(0)) + x for t, x in star[s].items()})
    bias = solved(rows, [r - g for r, g in zip(reward, gain, strict=True)])
    assert bias is not None
    return tuple(gain), tuple(bias[0])


def best_average(rows: Iterable[Row]) -> tuple[tuple[F, ...], tuple[F, ...]]:
    """Return the greatest gains, and the greatest biases of the policies that have them."""
    averages = [gain_and_bias(policy) for policy in policies(rows)]
    gain = tuple(map(max, zip(*(g for g, _ in averages), strict=True)))
    return gain, tuple(map(max, zip(*(h for g, h in averages if g == gain), strict=True)))


# ---- totals without a discount -------------------------------------------------------------------


def total(policy: Sequence[Row]) -> Values:
    """The limit of the expected discounted reward from each state: g / (1 - γ) + h + …."""
    pairs = zip(*gain_and_bias(policy), strict=True)
    return [h if not g else inf if g > 0 else -inf for g, h in pairs]


def best_total(rows: Iterable[Row]) -> Values:
    """The greatest limit from each state."""
    return list(map(max, zip(*map(total, policies(rows)), strict=True)))


def reaching(rows: Iterable[Row], missed: float, sign: int) -> Values:
    """The greatest (1) or least (-1) totals until state 0; runs that miss it are worth `missed`."""
    every = []
    for policy in policies(rows):
        chances = until(policy, [s == 0 for s in range(len(policy))])
        every.append([missed if v == inf else v for v in chances])
    return list(map(max if sign > 0 else min, zip(*every, strict=True)))
