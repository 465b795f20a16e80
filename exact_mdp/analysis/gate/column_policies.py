"""The best policy that reads some columns of the state only, with a proof that it is the best.

A policy over the statuses cannot act differently in different trials. How much is lost by that
alone, whatever the learning, is

    V*(start) - max over policies π that read the columns of V^π(start),

a combinatorial problem (NP-hard: Littman, Memoryless policies, From Animals to Animats 3, 1994).
Below: coordinate ascent, every change of one row evaluated. Above: branch and bound (Land and Doig,
Econometrica 28, 1960). A node allows a set of actions in each row; its bound lets every state
choose among them knowing the full state (`analysis.gate.relaxation`), and it comes with a policy.
The node of the greatest bound is split, at the row that costs its policy the most.

Deterministic policies are meant. A mixed one that reads the same columns can be worth more than all
of them, but never more than V*(start), the bound at the root: `mixed_upper_bound`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import heappop, heappush
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np
import tqdm as progress
from numpy.typing import NDArray

from exact_mdp.analysis.gate.relaxation import Expansion, Relaxations, Rows, one_hot
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import listed
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.result import Result
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.mdp.validate import Flags, counted
from exact_mdp.solvers.solution import Bounded
from exact_mdp.solvers.solver import mdp_of

if TYPE_CHECKING:
    from pandas import DataFrame


WORK = 2**25  # transitions times relaxations, unless a limit is given
PROVEN = 1e-9  # of |value|
ROWS_TRIED = 64  # rows that one step of the ascent tries to change


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BestPolicy(Result):
    """The best policy found that reads some columns, and how good any other can be.

    Attributes
    ----------
    columns : tuple of str
    policy : Policy
    value : Bounded
        Its value at the start.
    upper_bound : float
        No deterministic policy that reads these columns has a higher value at the start; of costs,
        none has a lower one.
    mixed_upper_bound : float
        No policy at all has a higher value: the optimal value, which bounds mixed ones, too.
    proven : bool
        Whether `upper_bound` is the value itself, up to 1e-9 of it, or to rounding.
    nodes : int
        Relaxations solved.
    """

    columns: tuple[str, ...]
    policy: Policy
    value: Bounded
    upper_bound: float
    mixed_upper_bound: float
    proven: bool
    nodes: int

    @property
    def error(self) -> float:
        """How far the value may be off."""
        return self.value.error

    def __neg__(self) -> BestPolicy:
        upper, mixed = 0.0 - self.upper_bound, 0.0 - self.mixed_upper_bound
        return replace(self, value=-self.value, upper_bound=upper, mixed_upper_bound=mixed)

    def frame(self) -> DataFrame:
        """Return the policy, one row for each combination of values of the columns."""
        import pandas

        space, names = self.policy.space, self.policy.actions
        taken = [row for row, chances in enumerate(self.policy.table) if chances.max() > 0]
        return pandas.DataFrame(
            {
                "row": [space.label(row) or "all states" for row in taken],
                "action": [names[int(self.policy.table[row].argmax())] for row in taken],
            }
        )


def best_policy(
    model: MDP | Scenario,
    columns: Sequence[str] = ("status",),
    *,
    start: Policy | None = None,
    node_limit: int | None = None,
) -> BestPolicy:
    """Return the best deterministic policy that reads `columns`, and an upper bound on all.

    Parameters
    ----------
    model : MDP or Scenario
    columns : names of columns of the model's states; none for one action throughout
    start : Policy, optional
        A policy that reads these columns, to begin from as well.
    node_limit : int, optional
        Relaxations to solve at most; by the model's size unless given, from 100 to 5,000. Where the
        search ends there, the upper bound is sound all the same, and `proven` is false.

    Returns
    -------
    BestPolicy

    Raises
    ------
    ModelError
        For an unknown column, where states that look alike have no action in common, and at
        discount 1 where not every policy ends.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> best = best_policy(Scenario.load("yuan2025").compile(), ("status",))
    >>> best.proven, round(best.value.value, 6), best.mixed_upper_bound < 146.2359
    (True, 146.235871, True)
    """
    mdp = mdp_of(model)
    if node_limit is None:
        node_limit = max(100, min(5000, WORK // mdp.n_transitions))
    node_limit = counted(node_limit, "node_limit")
    rows = Rows.of(mdp.maximised, listed(columns, "columns"))
    search = _Search(rows, Relaxations(rows), start)
    search.run(node_limit)
    value = Bounded(value=search.value, error=search.error)
    upper = max(search.upper, value.interval[0])
    # Small rewards are rewards: beside a value of 0 alone the error counts.
    left, size = upper - (value.value - value.error), abs(value.value)
    proven = left <= PROVEN * max(1.0, size) and left <= max(PROVEN * size, 8 * value.error)
    found = BestPolicy(
        columns=rows.space.names,
        policy=rows.policy(search.choice),
        value=value,
        upper_bound=upper,
        mixed_upper_bound=search.root_upper,
        proven=proven,
        nodes=search.nodes,
    )
    return found if mdp.sense == "max" else -found


class _Search:
    """The best policy so far, and what bounds the others.

    Attributes
    ----------
    value, error, choice
        The best policy: value at the start, bound on its error, actions (K,).
    upper : float
        No policy has a higher value.
    """

    def __init__(self, rows: Rows, relaxations: Relaxations, start: Policy | None) -> None:
        self.rows = rows
        self.relaxations = relaxations
        self.nodes = 0
        self.value, self.error = -np.inf, 0.0
        self.choice: Integers = np.zeros(len(rows.asked), dtype=np.int64)
        # A row that is never asked takes the first action that it has.
        self.root = rows.available & (
            rows.asked[:, None] | one_hot(rows.available.argmax(axis=1), rows.mdp.n_actions)
        )
        self.cut = -np.inf
        first, (self.split,) = self._expand(self.root[None])
        self.root_upper = self.upper = float(first.upper[0])
        if start is not None:
            self._offer(rows.choices(start)[None])
        self._ascend(first.loss[0])

    def run(self, limit: int) -> None:
        """Split the nodes that may hold a better policy, until `limit` relaxations are solved."""
        shown = {"desc": "policies", "unit": " nodes", "delay": 1, "disable": None, "leave": False}
        with progress.tqdm(**shown) as bar:
            self._run(limit, bar)

    def _run(self, limit: int, bar: Any) -> None:
        heap, number = [(-self.upper, 0, self.root, self.split)], count(1)
        while heap:
            children = list[Flags]()
            while heap and len(children) < self.relaxations.batch:
                bound, _, node, row = heap[0]
                done = -bound <= self.worth or node[row].sum() <= 1
                if not done and self.nodes + len(children) >= limit:
                    break
                heappop(heap)
                if done:
                    self.cut = max(self.cut, -bound)
                else:
                    children += _split(node, row)
            if not children:
                break
            for nodes in _batches(np.array(children), self.relaxations.batch):
                found, rows = self._expand(nodes)
                bar.update(len(nodes))
                for i, row in zip(found.kept.tolist(), rows, strict=True):
                    heappush(heap, (-found.upper[i], next(number), nodes[i], row))
        self.upper = min(self.upper, max(self.cut, *(-entry[0] for entry in heap[:1]), -np.inf))

    @property
    def worth(self) -> float:
        """What a bound must exceed for its node to be worth splitting."""
        if self.nodes == 0:
            return -np.inf
        return self.value + 4 * self.error + 1e-13 * abs(self.value)

    def _expand(self, nodes: Flags) -> tuple[Expansion, list[int]]:
        """Return what is known of nodes (N, K, A), and the row to split each that is kept at."""
        found = self.relaxations.expand(nodes, self.worth)
        self.nodes += len(nodes)
        self.cut = max(self.cut, float(np.delete(found.upper, found.kept).max(initial=-np.inf)))
        self._offer(found.choice[found.value > self.value])
        open_rows = nodes[found.kept].sum(axis=2) > 1
        return found, np.where(open_rows, found.loss, -1.0).argmax(axis=1).tolist()

    def _offer(self, choices: Integers) -> bool:
        """Keep the best of some policies (N, K) if it beats the present one beyond rounding."""
        if not len(choices):
            return False
        values, errors = self.relaxations.evaluate(choices)
        best = int(np.argmax(values))
        if not values[best] > self.value + errors[best] + self.error:
            return False
        self.value, self.error = float(values[best]), float(errors[best])
        self.choice = choices[best]
        return True

    def _ascend(self, loss: Floats) -> None:
        """Change one of the rows that cost most, each time for the best, until no change helps."""
        tried = np.argsort(-loss, kind="stable")[:ROWS_TRIED]
        tried = tried[loss[tried] > 0]
        place, action = np.nonzero(self.root[tried])
        better = len(place) > 0
        while better:
            choices = np.repeat(self.choice[None], len(place), axis=0)
            choices[np.arange(len(place)), tried[place]] = action
            better = self._offer(choices)


def _batches(items: NDArray[Any], size: int) -> Iterator[NDArray[Any]]:
    for first in range(0, len(items), size):
        yield items[first : first + size]


def _split(node: Flags, row: int) -> list[Flags]:
    """Return the nodes (K, A) in which one row takes each of its actions."""
    children = []
    for action in np.flatnonzero(node[row]):
        child = node.copy()
        child[row] = False
        child[row, action] = True
        children.append(child)
    return children
