"""What an environment does, compared with its table `P`: wrappers, step() and reset().

A model is made of `P` alone, so an environment whose step() or reset() does more is another
problem. Wrappers of Gymnasium that only watch, stop or draw are harmless, and toy-text environments
do what `P` says. Anything else, a wrapper or an environment of one's own, is tried: some hundred
steps with fixed seeds. After action a in state s each step (s', r, terminated) has to be one of the
outcomes that P[s][a] gives a positive probability, and each start one of the states that have a
positive initial probability. What happens seldom may be missed; frequencies are not compared.
"""

from __future__ import annotations

import copy
import random
import warnings
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, shorten_text
from exact_mdp.mdp.io.gymnasium_table import Outcome, Rows
from exact_mdp.mdp.table import exact

TOY_TEXT = "gymnasium.envs.toy_text"
HARMLESS = {
    *("TimeLimit", "OrderEnforcing", "PassiveEnvChecker", "Autoreset", "RecordEpisodeStatistics"),
    *("RecordVideo", "RenderCollection", "HumanRendering", "DtypeObservation", "ArrayConversion"),
    *("NumpyToTorch", "JaxToNumpy", "JaxToTorch"),
}
"""Wrappers of Gymnasium that leave states, actions, rewards and ends as they are."""
STARTS, STEPS, LONGEST_EPISODE = 8, 500, 100
CLOSE = 1e-6  # rewards may be in single precision


def layers_of(env: Any) -> Iterator[Any]:
    """Yield an environment and what it wraps, from the outside in."""
    while env is not None:
        yield env
        env = getattr(env, "__dict__", {}).get("env")


def refuse_changes(layers: Sequence[Any]) -> None:
    """Raise ModelError where a wrapper changes rewards or actions, or Taxi its destination."""
    for env in layers[:-1]:
        kinds = {each.__name__ for each in type(env).__mro__} & {"RewardWrapper", "ActionWrapper"}
        if kinds and not (kinds == {"ActionWrapper"} and only_numbers(env)):
            raise ModelError(
                f"{type(env).__name__} changes the environment, and P does not know of it",
                where="env",
                fix="give env.unwrapped, or describe the change: MDP.from_function(…)",
            )
    if getattr(layers[-1], "fickle_passenger", False) is True:
        raise ModelError(
            "a fickle passenger changes the destination on the way, and P does not know of it",
            where="env",
            fix="make the environment without fickle_passenger, or describe it: "
            "MDP.from_function(…)",
        )


def only_numbers(env: Any) -> bool:
    """Return whether an action wrapper numbers several choices, the last the fastest, as P does."""
    levels = getattr(env.env.action_space, "nvec", None)
    if levels is None or getattr(env.action_space, "n", None) != np.prod(levels):
        return False
    own = [env.action(number) for number in range(int(env.action_space.n))]
    return bool(np.array_equal(own, np.stack(np.unravel_index(range(len(own)), levels), axis=1)))


def refuse_untried(layers: Sequence[Any]) -> None:
    """Raise ModelError for a wrapper that may change what matrices, not tried here, say."""
    for env in layers[:-1]:
        if not (_is_harmless(env) or only_numbers(env)):
            raise ModelError(
                f"{type(env).__name__} may change the environment, and its matrices do not know "
                "of it",
                where="env",
                fix="give env.unwrapped, or describe the change: MDP.from_function(…)",
            )


def _is_harmless(env: Any) -> bool:
    kind = type(env)
    return kind.__name__ in HARMLESS and kind.__module__.startswith("gymnasium.")


def compare_with_table(
    layers: Sequence[Any], rows: Rows, starts: Collection[int], stated: bool
) -> None:
    """Raise ModelError where an environment does what its table does not say.

    `starts` are the states where episodes begin, as the environment has `stated` or as was assumed.
    What is tried is a copy of the environment where it can be copied. Warns where an environment
    cannot be compared, because its observations or actions are no numbers.
    """
    inside = (k for k, each in enumerate(layers) if not _is_harmless(each))
    first = next(inside, len(layers) - 1)
    env, base = layers[first], layers[-1]
    if env is base and type(base).__module__.startswith(TOY_TEXT):
        return
    if not (callable(getattr(env, "step", None)) and callable(getattr(env, "reset", None))):
        return
    space = getattr(env, "action_space", None)
    if space is not None and not hasattr(space, "n"):
        return _warn_not_compared(env, "its actions are no numbers")
    with _keep_random_state():
        _Trial(_copy_environment(env, base), env is base).run_steps(rows, starts, stated)
    return None


def _warn_not_compared(env: Any, why: str) -> None:
    what = f"step() of {type(env).__name__} was not compared with P: {why}"
    warnings.warn(what, stacklevel=4)


def _copy_environment(env: Any, base: Any) -> Any:
    """Return a copy that shares the table, or the environment itself where there is none."""
    table = getattr(base, "P", None)
    try:
        return copy.deepcopy(env, {id(table): table})
    except Exception:  # locks, windows and others refuse in ways of their own
        return env


@contextmanager
def _keep_random_state() -> Iterator[None]:
    """Leave the random numbers of the process as they were."""
    python, numpy = random.getstate(), np.random.get_state()  # noqa: NPY002  (others may use it)
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
        actions: dict[int, list[int]] = {}
        for state, action in rows:
            actions.setdefault(state, []).append(action)
        draw, steps, seed = random.Random(0), 0, 0
        while steps < STEPS or seed < STARTS:
            now = self._reset_environment(seed)
            if now is None:
                return
            self._check_start(now, starts, stated, actions)
            seed += 1
            for _ in range(LONGEST_EPISODE if steps < STEPS else 0):
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
        """Return the state in which an episode begins; None where reset() tells none."""
        try:
            answer = self._call_reset(seed)
        except NotImplementedError:
            return None
        except Exception as error:
            raise self._exception_error("reset()", error) from error
        if answer is None:
            return None  # the reset() of gymnasium.Env, which only sets a seed
        return self._read_state_number(
            answer[0] if type(answer) is tuple and len(answer) == 2 else answer
        )

    def _call_reset(self, seed: int) -> Any:
        """Call reset(), without a seed where it takes none."""
        try:
            return self.env.reset(seed=seed)
        except TypeError as error:
            if "seed" not in str(error):
                raise
            return self.env.reset()

    def _take_step(self, state: int, action: int) -> tuple[int, float, bool, bool] | None:
        """Return next state, reward, terminated and truncated; None where there is no step()."""
        try:
            seen, reward, over, *more = self.env.step(action)
            reward, over, cut = float(reward), bool(over), len(more) > 1 and bool(more[0])
        except NotImplementedError:
            return None
        except Exception as error:
            raise self._exception_error(f"step({action}) in state {state}", error) from error
        following = self._read_state_number(seen)
        return None if following is None else (following, reward, over, cut)

    def _read_state_number(self, seen: Any) -> int | None:
        """Return the number of a state that is observed; a warning, and None, where it is none."""
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
            f"reset() begins in state {state}, and the environment does not state where it begins",
            f"say where: start={state}, or --start {state}; or start={{state: probability}}",
        )

    def _check_step(
        self, state: int, action: int, outcomes: Sequence[Outcome], done: tuple[int, float, bool]
    ) -> None:
        following, reward, over = done
        for chance, target, gain, ends in outcomes:
            # Nothing follows where the episode is over: tables name any state there.
            same = ends == over and (over or target == following)
            near = abs(float(exact(gain)) - reward) <= CLOSE * max(1.0, abs(reward))
            if exact(chance) > 0 and same and near:
                return
        said = ", ".join(
            f"({target}, {float(exact(gain)):g}, {ends})" for _, target, gain, ends in outcomes[:4]
        )
        raise self._mismatch_error(
            f"step({action}) in state {state} gave ({following}, {reward:g}, {over}); P lists "
            f"(next state, reward, terminated) {said}{', …' if len(outcomes) > 4 else ''}"
        )

    def _mismatch_error(self, what: str, fix: str = "") -> ModelError:
        if not self.own:
            fix = "give env.unwrapped, or describe the change: MDP.from_function(…)"
        elif not fix:
            fix = "let P say what step() and reset() do; or give P alone: "
            fix += "MDP.from_gymnasium(env.unwrapped.P)"
        what = f"the environment does not do what P says: {what}"
        return ModelError(what, where=self.name, fix=fix)

    def _exception_error(self, call: str, error: Exception) -> ModelError:
        return self._mismatch_error(
            f"{call} raises {type(error).__name__}: {shorten_text(str(error), 100)}"
        )
