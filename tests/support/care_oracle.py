"""A slow, exact reference for the care model: fractions and dictionaries, no shared code.

A state is ``(subtask k, failed trials t, flag c, status s)`` or ``"end"``; a status is the four
bits forgetfulness, confusion, anger, disengagement. The flag is 1 while no subtask of the current
task was skipped; it stays 1 except under ``task_bonus = "no-subtask-skipped"``.
"""

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import product
from math import lcm, prod
from typing import Any

Status = tuple[int, ...]
State = tuple[int, int, int, Status] | str
Policy = Callable[[State], Mapping[str, Fraction]]
Outcome = tuple[Fraction, State, dict[str, Fraction], bool]

END = "end"
CLEAR: Status = (0, 0, 0, 0)
STATUSES = ("forgetfulness", "confusion", "anger", "disengagement")
ACTIONS = ("none", "supportive", "non-directive", "directive")
STATUS_WEIGHTS = ("forget", "confuse", "anger", "disengaged")
COMPONENTS = (
    *STATUS_WEIGHTS,
    *("trial", "subtask-complete", "subtask-skip", "timestep", "task-complete"),
    *(f"assist.{action}" for action in ACTIONS),
)
READINGS: dict[str, tuple[str, ...]] = {
    "influence_orientation": ("row-to-column", "column-to-row"),
    "influence_on_present": ("none", "additive"),
    "status_cost": ("next", "current"),
    "trial_cost": ("every-trial", "failed-trials"),
    "max_trial_rule": ("at", "after"),
    "skip_timestep": ("same", "own"),
    "skip_onset": ("none", "base", "reset"),
    "task_bonus": ("always", "last-subtask-completed", "no-subtask-skipped"),
}
TABLE_3 = {  # in per cent: the base, then the row as printed, its diagonal being the persistence
    "forgetfulness": (30, (99, 5, 6, 2)),
    "confusion": (30, (7, 99, 8, 2)),
    "anger": (5, (7, 8, 100, 10)),
    "disengagement": (20, (7, 10, 20, 99)),
}
ASSISTANCE = {  # in per cent: the chance that a present status stays
    "supportive": {"anger": 5, "disengagement": 5},
    "non-directive": {"forgetfulness": 40, "confusion": 60},
    "directive": {"forgetfulness": 5, "confusion": 5},
}
TABLE_4 = dict(zip(COMPONENTS, (-1, -1, -5, -1, -1, 50, -10, -1, 20, 0, -1, -3, -5), strict=True))


def default_parameters() -> dict[str, Fraction]:
    values: dict[str, Fraction] = {}
    for row, (base, entries) in TABLE_3.items():
        values[f"base.{row}"] = Fraction(base, 100)
        for column, entry in zip(STATUSES, entries, strict=True):
            name = f"persistence.{row}" if row == column else f"influence.{row}.{column}"
            values[name] = Fraction(entry, 100)
    for action, stays in ASSISTANCE.items():
        for status, percent in stays.items():
            values[f"assistance.{action}.{status}.persistence"] = Fraction(percent, 100)
            values[f"assistance.{action}.{status}.onset"] = Fraction(0)
    for status in ("forgetfulness", "confusion"):
        values[f"skip.{status}.alone"] = Fraction(1, 5)
        values[f"skip.{status}.with-other"] = Fraction(1, 2)
    for status in ("anger", "disengagement"):
        values[f"skip.{status}.persistence"] = Fraction(1, 2)
    for name, weight in TABLE_4.items():
        values[f"reward.{name}"] = Fraction(weight)
    return values


class Oracle:
    """The care model under one choice of readings, tasks and parameters."""

    def __init__(
        self,
        readings: Mapping[str, str] | None = None,
        tasks: Sequence[int] = (3,),
        max_trial: int = 5,
        discount: Fraction = Fraction(1),
        parameters: Mapping[str, Fraction] | None = None,
        own: Any = None,
    ) -> None:
        # The names of statuses, actions and weights, also those of one's `own` scenario.
        self.statuses = own.statuses if own else STATUSES
        self.assistance = own.actions if own else ACTIONS
        weights = own.weights if own else dict(zip(STATUSES, STATUS_WEIGHTS, strict=True))
        self.weights = [weights[status] for status in self.statuses]
        self.others = dict(own.others) if own else dict([STATUSES[:2], STATUSES[1::-1]])
        self.clear: Status = (0,) * len(self.statuses)
        self.readings = {name: options[0] for name, options in READINGS.items()}
        self.readings.update(readings or {})
        self.parameters = dict(parameters or {}) if own else default_parameters()
        known = set(self.parameters)
        self.parameters.update({k: Fraction(v) for k, v in (parameters or {}).items()})
        if set(self.readings) != set(READINGS) or set(self.parameters) != known:
            raise ValueError("unknown reading or parameter")
        if any(self.readings[name] not in options for name, options in READINGS.items()):
            raise ValueError("unknown option of a reading")
        self.tasks = list(tasks)
        self.trials = max_trial + (self.readings["max_trial_rule"] == "after")  # M
        self.discount = Fraction(discount)
        self.start: State = (0, 0, 1, self.clear)
        # for every subtask, whether it is the last of its task
        self.last = [i == size - 1 for size in self.tasks for i in range(size)]
        self._outcomes: dict[tuple[State, str], list[Outcome]] = {}
        self._following: dict[tuple[Status, str], list[tuple[Fraction, Status]]] = {}
        self._optimal: dict[State, tuple[Fraction, frozenset[str]]] = {
            END: (Fraction(0), frozenset())
        }

    # ------------------------------------------------------------ the chances

    def influence(self, j: int, i: int) -> Fraction:
        """What status j, when present now, adds to the chance of status i next."""
        if self.readings["influence_orientation"] == "row-to-column":
            return self.parameters[f"influence.{self.statuses[j]}.{self.statuses[i]}"]
        return self.parameters[f"influence.{self.statuses[i]}.{self.statuses[j]}"]

    def unassisted(self, s: Status, i: int, present: int) -> Fraction:
        """The chance of status i next without assistance, it being `present` now, others as s."""
        pushes = sum((self.influence(j, i) for j in range(len(s)) if j != i and s[j]), Fraction(0))
        if present == 0:
            return min(Fraction(1), self.parameters[f"base.{self.statuses[i]}"] + pushes)
        persistence = self.parameters[f"persistence.{self.statuses[i]}"]
        if self.readings["influence_on_present"] == "additive":
            return min(Fraction(1), persistence + pushes)
        return persistence

    def chances(self, s: Status, action: str) -> list[Fraction]:
        """The chance of each status being 1 next, under one of the four assistive actions."""
        result = []
        for i, status in enumerate(self.statuses):
            kind = "persistence" if s[i] else "onset"
            assisted = self.parameters.get(f"assistance.{action}.{status}.{kind}")
            result.append(self.unassisted(s, i, s[i]) if assisted is None else assisted)
        return result

    def skip_chances(self, s: Status) -> list[Fraction]:
        """The chance of each status being 1 after a skip in status s."""
        if self.readings["skip_onset"] == "reset":
            return [Fraction(0)] * len(s)
        result = []
        for i, status in enumerate(self.statuses):
            if s[i] == 0:
                base = self.readings["skip_onset"] == "base"
                result.append(self.unassisted(s, i, 0) if base else Fraction(0))
            elif status in self.others:
                present = s[self.statuses.index(self.others[status])]
                other = "with-other" if present else "alone"
                result.append(self.parameters[f"skip.{status}.{other}"])
            else:
                result.append(self.parameters[f"skip.{status}.persistence"])
        return result

    def following(self, s: Status, action: str) -> list[tuple[Fraction, Status]]:
        """The statuses after an action, or after a skip: the same in each trial and subtask."""
        if (s, action) not in self._following:
            chances = self.skip_chances(s) if action == "skip" else self.chances(s, action)
            self._following[s, action] = list(independent(chances))
        return self._following[s, action]

    # ------------------------------------------------------------ one timestep

    def actions(self, state: State) -> tuple[str, ...]:
        """The actions that may be taken in a state; none at the end."""
        if isinstance(state, str):
            return ()
        return ("skip",) if state[1] == self.trials else self.assistance

    def outcomes(self, state: State, action: str) -> list[Outcome]:
        """What one timestep can lead to: (probability, next state, rewards, skipped)."""
        if action not in self.actions(state):
            raise ValueError(f"no action {action!r} in {state!r}")
        if (state, action) not in self._outcomes:
            merged: dict[Any, Fraction] = defaultdict(Fraction)
            for probability, nxt, names, skipped in self._branches(state, action):
                merged[nxt, names, skipped] += probability
            self._outcomes[state, action] = [
                (probability, nxt, {n: self.parameters[f"reward.{n}"] for n in names}, skipped)
                for (nxt, names, skipped), probability in merged.items()
                if probability > 0
            ]
        return self._outcomes[state, action]

    def _branches(self, state: State, action: str) -> Iterable[tuple[Fraction, State, Any, bool]]:
        """The outcomes before merging, rewards as the names of the weights earned."""
        assert not isinstance(state, str)
        k, t, c, s = state
        if action == "skip":  # only where skipping takes a timestep of its own
            for p, z in self.following(s, "skip"):
                earned = {"timestep", *self._status_names(s, z), *self._skip_names(k)}
                yield p, self._move_on(k, c, z, skipped=True), frozenset(earned), True
            return
        for p, s2 in self.following(s, action):
            earned = {"timestep", *self._status_names(s, s2)}
            if s2 == self.clear:
                earned |= {"subtask-complete", f"assist.{action}"}
                if self.readings["trial_cost"] == "every-trial":
                    earned.add("trial")
                if self.last[k] and c:
                    earned.add("task-complete")
                yield p, self._move_on(k, c, self.clear, skipped=False), frozenset(earned), False
                continue
            earned.add("trial")
            if t + 1 < self.trials or self.readings["skip_timestep"] == "own":
                yield p, (k, t + 1, c, s2), frozenset(earned), False
                continue
            earned |= self._skip_names(k)
            for q, z in self.following(s2, "skip"):
                yield p * q, self._move_on(k, c, z, skipped=True), frozenset(earned), True

    def _status_names(self, now: Status, nxt: Status) -> set[str]:
        paid = nxt if self.readings["status_cost"] == "next" else now
        return {name for name, bit in zip(self.weights, paid, strict=True) if bit}

    def _skip_names(self, k: int) -> set[str]:
        paid = self.last[k] and self.readings["task_bonus"] == "always"
        return {"subtask-skip", "task-complete"} if paid else {"subtask-skip"}

    def _move_on(self, k: int, c: int, z: Status, skipped: bool) -> State:
        if k + 1 == len(self.last):
            return END
        if skipped and self.readings["task_bonus"] == "no-subtask-skipped":
            c = 0
        return (k + 1, 0, 1 if self.last[k] else c, z)

    # ------------------------------------------------------------ optimum and policies

    def reachable(self) -> set[State]:
        reached: set[State] = {self.start}
        todo = list(reached)
        while todo:
            state = todo.pop()
            for action in self.actions(state):
                for _, nxt, _, _ in self.outcomes(state, action):
                    if nxt not in reached:
                        reached.add(nxt)
                        todo.append(nxt)
        return reached

    def value(self, state: State) -> Fraction:
        """The optimal expected discounted return from a state."""
        return self._best(state)[0]

    def optimal_actions(self, state: State) -> frozenset[str]:
        return self._best(state)[1]

    def _best(self, state: State) -> tuple[Fraction, frozenset[str]]:
        if state not in self._optimal:  # (k, t) only grows: the recursion ends, and is shallow
            values = {
                action: total(
                    [
                        p * (sum(rewards.values()) + self.discount * self.value(nxt))
                        for p, nxt, rewards, _ in self.outcomes(state, action)
                    ]
                )
                for action in self.actions(state)
            }
            best = max(values.values())
            self._optimal[state] = (best, frozenset(a for a in values if values[a] == best))
        return self._optimal[state]

    def _choices(self, policy: Policy, state: State) -> Mapping[str, Fraction]:
        only = self.actions(state)
        choices = {only[0]: Fraction(1)} if len(only) == 1 else policy(state)
        if sum(choices.values()) != 1 or min(choices.values()) < 0:
            raise ValueError(f"no distribution over actions in {state!r}")
        return choices

    def evaluate(self, policy: Policy, distribution: bool = True) -> dict[str, Any]:
        """Exact figures of the return under a policy; single-action states need none."""
        zero, g = Fraction(0), self.discount
        figures = ("mean", "square", "steps", "skip", *COMPONENTS)
        memo: dict[State, dict[str, Fraction]] = {END: dict.fromkeys(figures, zero)}
        spreads: dict[State, dict[Fraction, Fraction]] = {END: {zero: Fraction(1)}}

        def at(state: State) -> dict[str, Fraction]:
            if state in memo:
                return memo[state]
            parts: dict[str, list[Fraction]] = {name: [] for name in figures}
            parts["steps"].append(Fraction(1))
            to: dict[State, Fraction] = defaultdict(Fraction)
            jumps: dict[tuple[State, Fraction], Fraction] = defaultdict(Fraction)
            for action, share in self._choices(policy, state).items():
                for p, nxt, rewards, skipped in self.outcomes(state, action) if share else ():
                    w, r, later = share * p, sum(rewards.values(), zero), at(nxt)
                    to[nxt] += w
                    jumps[nxt, r] += w
                    parts["skip"].append(w * (1 if skipped else later["skip"]))
                    for name, reward in rewards.items():
                        parts[name].append(w * reward)
            for nxt, w in to.items():
                parts["steps"].append(w * at(nxt)["steps"])
                for name in COMPONENTS:
                    parts[name].append(w * g * at(nxt)[name])
            for (nxt, r), w in jumps.items():  # E(r + g G) and E(r + g G)^2
                mean, square = at(nxt)["mean"], at(nxt)["square"]
                parts["mean"].append(w * (r + g * mean))
                parts["square"].append(w * (r * r + 2 * r * g * mean + g * g * square))
            here = {name: total(each) for name, each in parts.items()}
            if distribution and g == 1:
                terms: dict[Fraction, list[Fraction]] = defaultdict(list)
                for (nxt, r), w in jumps.items():
                    for rest, p in spreads[nxt].items():
                        terms[r + rest].append(w * p)
                spreads[state] = {x: total(terms_of) for x, terms_of in terms.items()}
            memo[state] = here
            return here

        terms_of = at(self.start)
        return {
            "mean": terms_of["mean"],
            "variance": terms_of["square"] - terms_of["mean"] ** 2,
            "steps": terms_of["steps"],
            "skip_probability": terms_of["skip"],
            "components": {name: terms_of[name] for name in COMPONENTS},
            "distribution": spreads.get(self.start),
        }


def independent(chances: Sequence[Fraction]) -> Iterable[tuple[Fraction, Any]]:
    """Every status with its probability, its bits being independent."""
    for bits in product((0, 1), repeat=len(chances)):
        p = prod(
            (x if bit else 1 - x for bit, x in zip(bits, chances, strict=True)), start=Fraction(1)
        )
        if p > 0:
            yield p, bits


def total(terms: Sequence[Fraction]) -> Fraction:
    """The exact sum, over one common denominator: much faster than adding one by one."""
    common = lcm(*(term.denominator for term in terms))
    return Fraction(sum(t.numerator * (common // t.denominator) for t in terms), common)


def oracle_of(scenario: Any, changes: Mapping[str, Fraction] = {}) -> Oracle:
    """Return the independent model of a scenario's settings, some of its numbers changed."""
    values = {**scenario.values(), "discount": scenario.discount, **changes}
    discount = values.pop("discount")
    own = scenario if scenario.statuses != STATUSES else None
    return Oracle(
        dict(scenario.readings), scenario.tasks, scenario.max_trial, discount, values, own
    )


def acting(actions: Mapping[str, str]) -> Callable[[State], dict[str, Fraction]]:
    """Return the policy that takes the action of a status, such as 0110, in all its states."""

    def policy(state: State) -> dict[str, Fraction]:
        assert not isinstance(state, str)
        return {actions["".join(map(str, state[3]))]: Fraction(1)}

    return policy
