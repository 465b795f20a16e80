"""Models of environments that have step() but no table: each step is taken in a copy.

This needs an environment that is deterministic given its state, and shows this state. So it is
refused, with what to do, if reset() or step() draws a random number, if two copies
differ after the same action, or if an attribute (a key that was found, a count of steps) has two
values at the same observation. A terminated step leads to the state "end".
"""

from __future__ import annotations

import copy
import pickle
import random
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, shorten_text
from exact_mdp.mdp.io.gymnasium_table import keep_random_state, read_random_state

END = "end"
MOST = 10_000  # states: each takes about 2 ms for each action
STARTS = 8  # resets that are compared, as in the trial of an environment with a table
GENERATORS = (np.random.Generator, np.random.RandomState, random.Random)
LEAVES = (*GENERATORS, ModuleType)
Parts = dict[str, Any]
SEEDS = ("_np_random", "_np_random_seed")
FIX = (
    "describe it: MDP.from_function(start, actions, outcomes); or use an environment with P, such "
    "as FrozenLake-v1; or record episodes of a policy that tries everything, a row for each step "
    "with episode, state, action, reward, next_state, terminated and truncated, and estimate the "
    "model: MDP.from_transitions, page docs/records"
)


class CopiedEnvironment:
    """The dynamics of an environment, as functions for `MDP.from_function`."""

    def __init__(self, env: Any, where: str) -> None:
        self.where = where
        space: Any = getattr(env, "action_space", None)
        if not hasattr(space, "n"):
            raise self._error("its actions are not numbered")
        first = int(getattr(space, "start", 0))
        self.actions = range(first, first + int(space.n))
        # A copy of the environment in each state, from which the actions are tried, and its parts.
        self.copies: dict[Any, tuple[Any, Parts]] = {}
        env = self._copy(env)
        with keep_random_state():
            for seed in range(STARTS):
                before = _save_generators(_leave_out_seeded(dict(_list_parts(env))))
                seen, _ = self._call("reset()", env.reset, seed=seed)
                parts = dict(_list_parts(env))
                # A rare start may not be among these resets: none may draw at all.
                drawn = _save_generators(_leave_out_seeded(parts)) != before
                if drawn or _draws_after_seed(env, seed):
                    raise self._error("reset() draws random numbers")
                self.start = self._enter_state(seen, env, parts)
        if len(self.copies) > 1:
            raise self._error(f"episodes begin in {len(self.copies)} or more states")

    def list_actions(self, state: Any) -> range | tuple[()]:
        """Return the actions of a state."""
        if state == END:
            return ()
        return self.actions

    def list_outcomes(self, state: Any, action: int) -> list[tuple[int, Any, float]]:
        """Return (1, next state, reward) of a step, which is taken in two copies."""
        call, done = f"step({action}) in state {state}", list[tuple[int, Any, float]]()
        with keep_random_state():
            for _ in range(2):
                kept, parts = self.copies[state]
                env, before = self._copy(kept), _save_generators(parts)
                seen, reward, over, cut, _ = self._call(call, env.step, action)
                parts = dict(_list_parts(env))
                if _save_generators(parts) != before:
                    raise self._error(f"{call} draws random numbers")
                if cut:
                    raise self._error(f"{call} cuts the episode off")
                then: Any = END
                if not over:
                    then = self._enter_state(seen, env, parts)
                done.append((1, then, float(reward)))
        if done[0] != done[1]:
            raise self._error(f"{call} does not always do the same")
        return done[:1]

    def _enter_state(self, seen: Any, env: Any, parts: Parts) -> Any:
        """Return the state of an observation; keep a copy there, or compare with the one kept."""
        state = self._read_observation(seen)
        if state not in self.copies:
            if len(self.copies) == MOST:
                raise self._error(f"it has more than {MOST:,} states")
            kept = self._copy(env)
            self.copies[state] = kept, dict(_list_parts(kept))
        different = _find_difference(self.copies[state][1], parts)
        if different:
            raise self._error(
                f"{different} has two values in state {state}, which the observation does not show "
                "(count steps with the wrapper TimeLimit)"
            )
        return state

    def _read_observation(self, seen: Any) -> Any:
        """Return an observation of whole numbers as a number or a tuple of numbers."""
        array = np.asarray(seen)
        if array.dtype.kind not in "iub":
            raise self._error(
                f"an observation is {shorten_text(repr(seen), 60)}, not whole numbers"
            )
        if array.ndim:
            return tuple(int(number) for number in array.ravel())
        return int(array)

    def _copy(self, env: Any) -> Any:
        """Return a copy of the environment."""
        return self._call("copy.deepcopy", copy.deepcopy, env)

    def _call(self, what: str, function: Any, *given: Any, **options: Any) -> Any:
        """Call a function of the environment; turn its errors into ModelErrors."""
        try:
            return function(*given, **options)
        except Exception as error:  # whatever the environment's own code raises
            said = f"{type(error).__name__}: {shorten_text(str(error), 100)}"
            raise self._error(f"{what} raises {said}") from error

    def _error(self, why: str) -> ModelError:
        """Return the error for an environment that cannot be explored."""
        what = f"the environment does not expose its model as P, and cannot be explored: {why}"
        return ModelError(what, where=self.where, fix=FIX)


def _list_parts(
    thing: Any, place: str = "", around: frozenset[int] = frozenset()
) -> Iterator[tuple[str, Any]]:
    """Yield the place and value of each attribute and entry that has no parts of its own."""
    parts: Any = ()
    if isinstance(thing, Mapping):
        parts = thing.items()
    elif isinstance(thing, list | tuple):
        parts = enumerate(thing)
    elif hasattr(thing, "__dict__") and not isinstance(thing, LEAVES) and not callable(thing):
        parts = vars(thing).items()
    else:
        yield place, thing
    if id(thing) in around:
        return  # an object that contains itself
    for name, part in parts:
        yield from _list_parts(part, f"{place}.{name}".lstrip("."), around | {id(thing)})


def _leave_out_seeded(parts: Parts) -> Parts:
    """Return the parts without the generator that `reset(seed=…)` makes anew."""
    return {place: part for place, part in parts.items() if place.rpartition(".")[2] not in SEEDS}


def _draws_after_seed(env: Any, seed: int) -> bool:
    """Return whether Gymnasium's generator of an environment was used after it got a seed."""
    own = getattr(getattr(env, "unwrapped", env), "_np_random", None)
    if not isinstance(own, np.random.Generator):
        return False
    fresh = np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed)))
    return bool(own.bit_generator.state != fresh.bit_generator.state)


def _save_generators(parts: Parts) -> bytes:
    """Return the states of all random number generators that an environment may use."""
    states: list[Any] = [*read_random_state()]
    for place, part in parts.items():
        if isinstance(part, GENERATORS):
            states.append((place, part.__reduce__()))
    return pickle.dumps(states)


def _find_difference(one: Parts, other: Parts) -> str:
    """Return the first attribute in which two environments differ, "" if there is none."""
    for place in one | other:
        left: Any = one.get(place)
        right: Any = other.get(place)
        if isinstance(left, LEAVES) or callable(left) or place.rpartition(".")[2] in SEEDS:
            continue
        if not np.array_equal(left, right):
            return place
    return ""
