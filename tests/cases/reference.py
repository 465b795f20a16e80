"""An exact solver for small models, which imports nothing of the project.

Policy iteration in fractions: solve v = r + gamma P v of a policy by elimination, move every state
to an action of larger q(s, a) = r(s, a) + gamma sum_t p(t | s, a) v(t), and again (Howard 1960).
At discount 1 the search starts from a policy that ends, in states whose every action is a self
loop without reward; they are worth 0. Where another policy never ends, the answer still holds if
each such policy loses without bound (Bertsekas and Tsitsiklis 1991).
"""

from collections.abc import Iterable, Mapping
from fractions import Fraction

Pair = tuple[int, int, Fraction, Mapping[int, Fraction]]
Model = list[dict[int, tuple[Fraction, Mapping[int, Fraction]]]]


def solve_exact(
    n_states: int, pairs: Iterable[Pair], discount: Fraction
) -> tuple[list[Fraction], list[set[int]]]:
    """Return the optimal values and, for each state, the set of all its optimal actions."""
    model = _model(n_states, pairs)
    policy = _ending_policy(model)
    while True:
        v = _evaluate(model, policy, discount)
        q = [{a: r + discount * _mean(row, v) for a, (r, row) in x.items()} for x in model]
        worse = [s for s in range(n_states) if q[s][policy[s]] < max(q[s].values())]
        if not worse:
            return v, [{a for a in q[s] if q[s][a] == v[s]} for s in range(n_states)]
        for s in worse:
            policy[s] = max(q[s], key=q[s].__getitem__)


def evaluate_exact(
    n_states: int, pairs: Iterable[Pair], discount: Fraction, policy: Mapping[int, int]
) -> list[Fraction]:
    """Return the values of a policy given as {state: action}."""
    return _evaluate(_model(n_states, pairs), policy, discount)


def every_policy_ends(n_states: int, pairs: Iterable[Pair]) -> bool:
    """Whether no policy can stay for ever among the states that are not absorbing."""
    inside = set(range(n_states)) - _absorbing(model := _model(n_states, pairs))
    while True:
        stay = {s for s in inside if any(inside.issuperset(row) for _, row in model[s].values())}
        if stay == inside:
            return not inside
        inside = stay


def _model(n_states: int, pairs: Iterable[Pair]) -> Model:
    model: Model = [{} for _ in range(n_states)]
    for s, a, r, row in pairs:
        if a in model[s] or min(row.values()) <= 0 or sum(row.values()) != 1:
            raise ValueError(f"state {s}, action {a}: given twice, or not a distribution")
        model[s][a] = (r, row)
    return model


def _absorbing(model: Model) -> set[int]:
    return {s for s, acts in enumerate(model) if all(_stays(s, *x) for x in acts.values())}


def _stays(state: int, reward: Fraction, row: Mapping[int, Fraction]) -> bool:
    return reward == 0 and row == {state: 1}


def _ending_policy(model: Model) -> dict[int, int]:
    """Any policy, but one that reaches the absorbing states from wherever that is possible."""
    policy = {s: min(acts) for s, acts in enumerate(model)}
    done, before = _absorbing(model), -1
    while len(done) > before:
        before = len(done)
        for s in set(policy) - done:
            if near := [a for a, (_, row) in model[s].items() if not done.isdisjoint(row)]:
                policy[s] = near[0]
                done.add(s)
    return policy


def _mean(row: Mapping[int, Fraction], v: list[Fraction]) -> Fraction:
    return sum((p * v[t] for t, p in row.items()), Fraction(0))


def _evaluate(model: Model, policy: Mapping[int, int], discount: Fraction) -> list[Fraction]:
    """Eliminate what is left of the diagonal, row by row; then substitute back."""
    v, absorbing = [Fraction(0)] * len(model), _absorbing(model)
    above: dict[int, dict[int, Fraction]] = {}
    for s in sorted(set(range(len(model))) - absorbing):
        v[s], next_states = model[s][policy[s]]
        row = {t: -discount * p for t, p in next_states.items() if t not in absorbing}
        row[s] = row.get(s, Fraction(0)) + 1
        while (k := min(row)) < s:
            factor = row.pop(k)
            v[s] -= factor * v[k]
            for t, x in above[k].items():
                row[t] = row.get(t, Fraction(0)) - factor * x
        if (pivot := row.pop(s)) == 0:
            raise ValueError("at discount 1 this policy never ends: it has no value")
        v[s] /= pivot
        above[s] = {t: x / pivot for t, x in row.items() if x != 0}
    for s in reversed(above):
        v[s] -= _mean(above[s], v)
    return v
