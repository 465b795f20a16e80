"""The table `P` of an environment: its rows of outcomes, compared with step() and reset().

`P[state][action]` lists (probability, next state, reward, terminated), in dictionaries or lists.
States and actions are whole numbers from 0, possibly as floats, and terminated may be 0 or 1.
Probabilities in single or half precision are divided by their sum if it misses 1 only by their
rounding.

A model is made from `P` alone, so an environment whose step() or reset() does something else is
another problem. Gymnasium's wrappers that only record, stop or draw are harmless, and toy-text
environments agree with their `P`. Every custom wrapper or environment is tried for a few hundred
steps with fixed seeds. After action a in state s, each step (s', r, terminated) must be an outcome
with a positive probability in P[s][a], and each start must be a state with a positive initial
probability. Rare events may be missed, and frequencies are not compared.
"""

from __future__ import annotations

import copy
import random
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import (
    FEW_NAMED,
    ModelError,
    join_few,
    locate_errors,
    shorten_text,
    warn_user,
)
from exact_mdp.mdp.forms.numbers import as_given
from exact_mdp.mdp.table import exact

NOWHERE = -1  # the next state in some tables if the episode is over
LISTED = "let P[state][action] list (probability, next state, reward, terminated)"
UNWRAP = "give env.unwrapped, or describe the change: MDP.from_function(…)"
Outcome = tuple[Any, int, Any, bool]
Rows = dict[tuple[int, int], list[Outcome]]
TOY_TEXT = "gymnasium.envs.toy_text"
HARMLESS = {
    *("TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "Autoreset", "RecordEpisodeStatistics"),
    *("RecordVideo", "RenderCollection", "HumanRendering", "DtypeObservation", "ArrayConversion"),
    *("NumpyToTorch", "JaxToNumpy", "JaxToTorch"),
}
"""Wrappers of Gymnasium that do not change states, actions, rewards or ends of episodes."""


def is_outcome_table(given: Any) -> bool:
    """Return whether a value is a table itself, not an environment with a table."""
    return isinstance(given, Mapping | list | tuple | np.ndarray)


def read_outcome_rows(env: Any, where: str) -> tuple[Rows, int]:
    """Return the outcomes of every pair, and the number of states.

    A state without a row, or with an empty one, is an end if outcomes enter it, all terminated.
    """
    table = env
    if not is_outcome_table(env):
        table = getattr(env, "P", None)
    if table is None:
        raise ModelError(
            "the environment does not expose its model as P",
            where=where,
            fix="describe it: MDP.from_function(start, actions, outcomes); or use an environment "
            "with P, such as FrozenLake-v1",
        )
    if isinstance(table, np.ndarray) and table.dtype != object:
        what = f"P is an array of shape {table.shape}, and not a table of outcomes"
        raise ModelError(what, where=where, fix="give it with the rewards: MDP.from_arrays(P, R)")
    # Read the rows; states without actions are kept apart, since some of them are ends.
    rows: Rows = {}
    empty: dict[int, Any] = {}
    for state, row in _list_items(table, where, "P"):
        if row is None or (is_outcome_table(row) and len(row) == 0):
            empty[state] = row
            continue
        for action, listed in _list_items(row, where, f"P[{state}]"):
            place = f"{where}, P[{state}][{action}]"
            each = _require_sequence(listed, place)
            outcomes = [_parse_table_outcome(outcome, place) for outcome in each]
            rows[state, action] = _without_rounding(outcomes)
    return rows, _count_states(rows, empty, where)


def _count_states(rows: Rows, empty: Mapping[int, Any], where: str) -> int:
    """Return the number of states; raise ModelError if a state without actions is not an end."""
    # States without rows: those that an episode enters, and those in which it ends.
    named = {state for state, _ in rows}
    alive, over = set[int](), set[int]()
    for outcomes in rows.values():
        alive |= {following for _, following, _, terminated in outcomes if not terminated}
        over |= {following for _, following, _, terminated in outcomes if terminated}
    alive, over = alive - named, over - named - {NOWHERE}
    stays = "an end stays: {0: [(1.0, state, 0, True)]}"
    for state, row in empty.items():
        if state in alive or state not in over:
            raise _no_action(f"P[{state}]", row, where)
    for state in sorted(alive)[:1]:
        what = f"P does not list state {state}, and an outcome that is not terminated leads there"
        fix = f"list it, or let that outcome be terminated; {stays}"
        raise ModelError(what, where=where, fix=fix)
    known = named | over
    if len(known) <= max(known):
        state = next(number for number in range(len(known) + 1) if number not in known)
        what = f"state {state} has no action: P does not list it, and no outcome ends there"
        raise ModelError(what, where=where, fix=f"number states from 0 without gaps; {stays}")
    return len(known)


def _without_rounding(outcomes: list[Outcome]) -> list[Outcome]:
    """Return outcomes with probabilities in single or half precision divided by their exact sum.

    Outcomes in double precision, or with a sum that misses 1 by more than rounding, are unchanged.
    """
    chances = [chance for chance, *_ in outcomes]
    kinds = {type(chance) for chance in chances}
    if not kinds or not kinds <= {np.float32, np.float16} or not np.all(np.isfinite(chances)):
        return outcomes
    numbers = [*map(exact, chances)]
    total = sum(numbers, Fraction(0))
    rounding = sum(float(np.finfo(type(chance)).eps) for chance in chances) / 2
    if min(numbers) < 0 or abs(total - 1) > rounding:
        return outcomes
    scaled = []
    for each, (_, *rest) in zip(numbers, outcomes, strict=True):
        scaled.append((each / total, *rest))
    return scaled


def _list_items(table: Any, where: str, what: str) -> Iterator[tuple[int, Any]]:
    """Yield the numbers and entries of a dictionary, or of a list, which counts from 0."""
    if not is_outcome_table(table) or len(table) == 0:
        raise _no_action(what, table, where)
    items: Iterable[tuple[Any, Any]] = enumerate(table)
    if isinstance(table, Mapping):
        items = table.items()
    for key, value in items:
        if not is_whole_number(key) or key < 0:
            fix = "number states and actions from 0; with other names, describe the model: "
            fix += "MDP.from_function(start, actions, outcomes)"
            raise ModelError(f"{what} has the key {key!r}", where=where, fix=fix)
        yield int(key), value


def _no_action(what: str, table: Any, where: str) -> ModelError:
    """Return the error for a state without actions."""
    fix = f"{LISTED}; an end stays: {{0: [(1.0, state, 0, True)]}}"
    return ModelError(
        f"{what} lists no action: {shorten_text(repr(table), 80)}", where=where, fix=fix
    )


def is_whole_number(number: Any) -> bool:
    """Return whether a value is a whole number of any type; truth values are not."""
    if isinstance(number, float | np.floating):
        return float(number).is_integer()
    return isinstance(number, int | np.integer) and not isinstance(number, bool)


def is_flag(value: Any) -> bool:
    """Return whether a value is True or False, 1 or 0."""
    if isinstance(value, bool | np.bool_):
        return True
    return is_whole_number(value) and value in (0, 1)


def _require_sequence(values: Any, where: str) -> Sequence[Any]:
    """Return a list, tuple or array as a sequence; raise ModelError for anything else."""
    if isinstance(values, Sequence) and not isinstance(values, str):
        return values
    if isinstance(values, np.ndarray) and values.ndim:
        return list(values)
    what = f"a list is expected, not {type(values).__name__}"
    raise ModelError(what, where=where, fix=LISTED)


def _parse_table_outcome(given: Any, place: str) -> Outcome:
    """Return an outcome (probability, next state, reward, terminated) with checked types."""
    values, why = _require_sequence(given, place), ""
    if len(values) != 4:
        why = f"it has {len(values)} entries"
    elif not is_whole_number(values[1]):
        why = f"its next state is {values[1]!r}"
    elif not is_flag(values[3]):
        why = f"terminated is {values[3]!r}"
    if why:
        raise ModelError(f"an outcome is {given!r}: {why}", where=place, fix=LISTED)
    with locate_errors(place):
        for number in (values[0], values[2]):
            as_given(number)
    return values[0], int(values[1]), values[2], bool(values[3])


# ---- wrappers, step() and reset() ----------------------------------------------------------------


def layers_of(env: Any) -> Iterator[Any]:
    """Yield an environment and the environments inside its wrappers, from the outside in."""
    while env is not None:
        yield env
        env = getattr(env, "__dict__", {}).get("env")


def refuse_changes(layers: Sequence[Any]) -> None:
    """Raise ModelError if a wrapper changes rewards or actions, or Taxi changes destinations."""
    for env in layers[:-1]:
        kinds = {each.__name__ for each in type(env).__mro__} & {"RewardWrapper", "ActionWrapper"}
        if kinds and not (kinds == {"ActionWrapper"} and only_numbers(env)):
            raise ModelError(
                f"{type(env).__name__} changes the environment, but not its table P",
                where="env",
                fix=UNWRAP,
            )
    if getattr(layers[-1], "fickle_passenger", False) is True:
        raise ModelError(
            "a fickle passenger changes the destination on the way, but P does not include that",
            where="env",
            fix="make the environment without fickle_passenger, or describe it: "
            "MDP.from_function(…)",
        )


def only_numbers(env: Any) -> bool:
    """Return whether an action wrapper only numbers combinations of choices, in the order of P."""
    levels = getattr(env.env.action_space, "nvec", None)
    if levels is None or getattr(env.action_space, "n", None) != np.prod(levels):
        return False
    own = [env.action(number) for number in range(int(env.action_space.n))]
    return bool(np.array_equal(own, np.stack(np.unravel_index(range(len(own)), levels), axis=1)))


def refuse_untried(layers: Sequence[Any]) -> None:
    """Raise ModelError for a wrapper that may change the environment, which is not tried."""
    for env in layers[:-1]:
        if not (_is_harmless(env) or only_numbers(env)):
            raise ModelError(
                f"{type(env).__name__} may change the environment, but not its matrices",
                where="env",
                fix=UNWRAP,
            )


def _is_harmless(env: Any) -> bool:
    """Return whether an environment is a wrapper of Gymnasium that changes nothing."""
    kind = type(env)
    return kind.__name__ in HARMLESS and kind.__module__.startswith("gymnasium.")


def find_first_changing(layers: Sequence[Any]) -> int:
    """Return the place of the first layer that is not a harmless wrapper."""
    inside = (k for k, each in enumerate(layers) if not _is_harmless(each))
    return next(inside, len(layers) - 1)


def compare_with_table(
    layers: Sequence[Any], rows: Rows, starts: Collection[int], stated: bool
) -> None:
    """Raise ModelError if an environment does not agree with its table.

    `starts` are the states in which episodes begin; `stated` says whether they are known or only
    assumed. A copy of the environment is tried, if it can be copied. Warns if the environment
    cannot be compared, since its observations or actions are not numbers.
    """
    # Environments of Gymnasium itself need no trial.
    env, base = layers[find_first_changing(layers)], layers[-1]
    if env is base and type(base).__module__.startswith(TOY_TEXT):
        return
    if not (callable(getattr(env, "step", None)) and callable(getattr(env, "reset", None))):
        return
    space = getattr(env, "action_space", None)
    if space is not None and not hasattr(space, "n"):
        return _warn_not_compared(env, "its actions are not numbers")
    with keep_random_state():
        _Trial(_copy_environment(env, base), env is base).run_steps(rows, starts, stated)
    return None


def _warn_not_compared(env: Any, why: str) -> None:
    """Warn that an environment was not compared with its table."""
    warn_user(f"step() of {type(env).__name__} was not compared with P: {why}")


def _copy_environment(env: Any, base: Any) -> Any:
    """Return a copy that shares the table, or the environment itself if it cannot be copied."""
    table = getattr(base, "P", None)
    try:
        return copy.deepcopy(env, {id(table): table})
    except Exception:  # locks, windows and other objects raise errors of their own
        return env


def read_random_state() -> tuple[Any, Any]:
    """Return the states of the global generators of Python and NumPy, which others may use."""
    return random.getstate(), np.random.get_state()  # noqa: NPY002


@contextmanager
def keep_random_state() -> Iterator[None]:
    """Restore the state of the global random number generators afterwards."""
    python, numpy = read_random_state()
    try:
        yield
    finally:
        random.setstate(python)
        np.random.set_state(numpy)  # noqa: NPY002


class _Trial:
    """Some hundred steps in an environment, each compared with the table."""

    def __init__(self, env: Any, own: bool) -> None:
        self.env, self.name, self.own = env, type(env).__name__, own

    def run_steps(self, rows: Rows, starts: Collection[int], stated: bool) -> None:
        """Run episodes with random actions; raise ModelError for a step that P does not list."""
        actions: dict[int, list[int]] = {}
        for state, action in rows:
            actions.setdefault(state, []).append(action)
        # At least 500 steps and 8 episodes: more would find rarer differences, and take longer.
        draw, steps, seed = random.Random(0), 0, 0
        while steps < 500 or seed < 8:
            now = self._reset_environment(seed)
            if now is None:
                return
            self._check_start(now, starts, stated, actions)
            seed += 1
            # After enough steps, only the starts of further episodes are compared.
            longest = 100
            if steps >= 500:
                longest = 0
            for _ in range(longest):
                steps += 1
                action = draw.choice(actions[now])
                done = self._take_step(now, action)
                if done is None:
                    return
                following, reward, over, cut = done
                self._check_step(now, action, rows[now, action], (following, reward, over))
                if over or cut:
                    break
                if following not in actions:
                    raise self._mismatch_error(
                        f"step() leads to {following}, which P does not list"
                    )
                now = following

    def _reset_environment(self, seed: int) -> int | None:
        """Return the state in which an episode begins; None if reset() does not return it."""
        try:
            answer = self._call_reset(seed)
        except NotImplementedError:
            return None
        except Exception as error:
            raise self._exception_error("reset()", error) from error
        if answer is None:
            return None  # the reset() of gymnasium.Env, which only sets a seed
        if type(answer) is tuple and len(answer) == 2:  # with `info`
            answer = answer[0]
        return self._read_state_number(answer)

    def _call_reset(self, seed: int) -> Any:
        """Call reset(), without a seed if it does not accept one."""
        try:
            return self.env.reset(seed=seed)
        except TypeError as error:
            if "seed" not in str(error):
                raise
            return self.env.reset()

    def _take_step(self, state: int, action: int) -> tuple[int, float, bool, bool] | None:
        """Return next state, reward, terminated and truncated; None without a step()."""
        try:
            seen, reward, over, *more = self.env.step(action)
            reward, over, cut = float(reward), bool(over), len(more) > 1 and bool(more[0])
        except NotImplementedError:
            return None
        except Exception as error:
            raise self._exception_error(f"step({action}) in state {state}", error) from error
        following = self._read_state_number(seen)
        if following is None:
            return None
        return following, reward, over, cut

    def _read_state_number(self, seen: Any) -> int | None:
        """Return the state number of an observation; warn and return None if it is not one."""
        array = np.asarray(seen)
        if array.size == 1 and array.dtype.kind in "iuf" and float(array.item()).is_integer():
            return int(array.item())
        if not self.own:
            raise self._mismatch_error(
                f"an observation is {shorten_text(repr(seen), 60)}, not a state of P"
            )
        _warn_not_compared(
            self.env, f"an observation is {shorten_text(repr(seen), 60)}, not the number of a state"
        )
        return None

    def _check_start(
        self, state: int, starts: Collection[int], stated: bool, known: Collection[int]
    ) -> None:
        """Raise ModelError unless an episode may begin in a state."""
        if state in starts and state in known:
            return
        if state not in known:
            raise self._mismatch_error(f"reset() begins in state {state}, which P does not list")
        if stated:
            what = f"reset() begins in state {state}, which has no initial probability"
            raise self._mismatch_error(
                what, "correct initial_state_distrib; or say where: start=, --start"
            )
        raise self._mismatch_error(
            f"reset() begins in state {state}, and the environment states no initial distribution",
            f"say where: start={state}, or --start {state}; or start={{state: probability}}",
        )

    def _check_step(
        self, state: int, action: int, outcomes: Sequence[Outcome], done: tuple[int, float, bool]
    ) -> None:
        """Raise ModelError unless a step is one of the outcomes of the table."""
        following, reward, over = done
        for chance, target, gain, ends in outcomes:
            # At the end of an episode the next state has no meaning, and tables name any.
            same = ends == over and (over or target == following)
            # Rewards may be in single precision.
            near = abs(float(exact(gain)) - reward) <= 1e-6 * max(1.0, abs(reward))
            if exact(chance) > 0 and same and near:
                return
        listed = []
        for _, target, gain, ends in outcomes[:FEW_NAMED]:
            listed.append(f"({target}, {float(exact(gain)):g}, {ends})")
        raise self._mismatch_error(
            f"step({action}) in state {state} gave ({following}, {reward:g}, {over}); P lists "
            f"(next state, reward, terminated) {join_few(listed, len(outcomes))}"
        )

    def _mismatch_error(self, what: str, fix: str = "") -> ModelError:
        """Return the error for an environment that differs from its table."""
        if not self.own:
            fix = UNWRAP
        elif not fix:
            fix = "make P agree with step() and reset(); or give P alone: "
            fix += "MDP.from_gymnasium(env.unwrapped.P)"
        what = f"the environment does not agree with P: {what}"
        return ModelError(what, where=self.name, fix=fix)

    def _exception_error(self, call: str, error: Exception) -> ModelError:
        """Return the error for a call that raises an exception."""
        return self._mismatch_error(
            f"{call} raises {type(error).__name__}: {shorten_text(str(error), 100)}"
        )
