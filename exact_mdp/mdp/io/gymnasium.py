"""Models from Gymnasium environments that expose their dynamics: a table `P`, or matrices.

`P[state][action]` lists (probability, next state, reward, terminated). An episode is over after an
outcome with terminated = True, whatever `P` lists for the state that it names:

    Q(s, a) = Σ p (r + γ (1 - terminated) V(s')).

A state that can only be entered by terminated outcomes becomes an absorbing end without reward (the
goal of CliffWalking, where `P` goes on to list moves that no episode makes). Where an episode may
also pass through such a state alive, or start in it (Taxi with the passenger at the destination),
its rows stay, and terminated outcomes lead to one more state, "end", behind the others.

Without a table, `dynamics` with matrices `tx_mat` and `r_mat` (S, A, S) will do, as ICU-Sepsis has
them (Choudhary, Gupta and Thomas, Reinforcement Learning Conference 2024).

A wrapper, or an environment of one's own, whose step() or reset() does what `P` does not say is
refused: see `mdp.io.gymnasium_steps`.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Self

import numpy as np

from exact_mdp.mdp.build import FromArrays
from exact_mdp.mdp.errors import (
    ModelError,
    ShapeError,
    require_extra,
    shorten_text,
    suggest_name,
)
from exact_mdp.mdp.forms.names import ByNumber
from exact_mdp.mdp.io.gymnasium_steps import (
    compare_with_table,
    layers_of,
    refuse_changes,
    refuse_untried,
)
from exact_mdp.mdp.io.gymnasium_table import (
    LISTED,
    NOWHERE,
    Rows,
    is_outcome_table,
    is_whole_number,
    read_outcome_rows,
)
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import Numbers
from exact_mdp.mdp.validate import KNOWN, as_start, check_options

END = "end"
STARTS = ("initial_state_distrib", "isd")  # what environments call the initial distribution
TOY_TEXT = "gymnasium.envs.toy_text"
GRID = (Column(name="row", size=0), Column(name="column", size=0))
PLACES = ("Red", "Green", "Yellow", "Blue")
TOYS = {
    "FrozenLakeEnv": (("LEFT", "DOWN", "RIGHT", "UP"), GRID),
    "CliffWalkingEnv": (("UP", "RIGHT", "DOWN", "LEFT"), GRID),
    "TaxiEnv": (
        ("SOUTH", "NORTH", "EAST", "WEST", "PICKUP", "DROPOFF"),
        (
            Column(name="row", size=5),
            Column(name="column", size=5),
            Column(name="passenger", size=5, words=(*PLACES, "taxi")),
            Column(name="destination", size=4, words=PLACES),
        ),
    ),
}
"""Actions by number, and what the number of a state is made of."""


class FromGymnasium(FromArrays):
    """Models from environments."""

    @classmethod
    def from_gymnasium(cls, env: object, discount: object = 1, **names: Any) -> Self:
        """Build from a Gymnasium environment that exposes its model as `P` (toy-text).

        Parameters
        ----------
        env : gymnasium.Env, str or table
            An environment, wrapped or not; anything with an attribute `P`, or `dynamics` with
            matrices; such a table; or a registered id, "module:ID" where a module registers it.
        discount : number or "p/q"
        **names
            `start` instead of the environment's `initial_state_distrib`, or of state 0 where it
            has none; `actions`, `states`,
            `name`, `sense`, `labels`; `time_limit` instead of the environment's own. Beside an id,
            others are the environment's: `is_slippery=False`.

        Notes
        -----
        Wrappers and environments that Gymnasium does not bring are tried for some hundred steps,
        with fixed seeds, in a copy; one that cannot be copied is itself reset and stepped.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            Where the environment is unknown or exposes no `P`, `P` is not a table of distributions
            over its own states, or step() or reset() does what `P` does not say.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> class Coin:
        ...     P = {0: {0: [(0.5, 0, 1, False), (0.5, 1, 1, True)]}, 1: {0: [(1, 0, 7, False)]}}
        ...     initial_state_distrib = (1, 0)
        >>> MDP.from_gymnasium(Coin()).table.row(0)[1]
        (Fraction(1, 2), 1, Fraction(1, 1))
        """
        if isinstance(env, str):
            check_options({*names} & {"gamma"}, {})
            made = _make_environment(env, **{name: names.pop(name) for name in {*names} - KNOWN})
            try:
                return cls.from_gymnasium(made, discount, **{"name": env} | names)
            finally:
                made.close()
        if env is None or isinstance(env, bool | int | float):
            fix = f"give an environment, an id such as FrozenLake-v1, or a table: {LISTED}"
            raise ModelError(f"{env!r} is not an environment", where="env", fix=fix)
        bare = env if is_outcome_table(env) else getattr(env, "unwrapped", env)
        check_options(names, {})
        layers = [*layers_of(env)]
        refuse_changes(layers)
        names.setdefault("name", _find_environment_name(env))
        names.setdefault("time_limit", _time_limit(layers))
        where = names["name"] or "P"
        dynamics = getattr(bare, "dynamics", None)
        if not hasattr(bare, "P") and isinstance(dynamics, Mapping) and "tx_mat" in dynamics:
            refuse_untried(layers)
            options = {"start": dynamics.get("d_0"), "layout": "sas"} | names
            return cls.from_arrays(*_of_matrices(bare, dynamics, where), discount, **options)
        rows = _rows_from_table(bare, where, layers, names)
        return cls.from_outcomes(rows, discount, **names)


def _rows_from_table(
    bare: Any, where: str, layers: Sequence[Any], names: dict[str, Any]
) -> list[Any]:
    """Return the rows of a model by its table of outcomes; add what else is known to `names`."""
    rows, states = read_outcome_rows(bare, where)
    actions = max(action for _, action in rows) + 1
    known, columns = _find_toy_names(bare, states, actions)
    names.setdefault("actions", known)
    words = names.pop("states", ())
    columns = StateSpace.plain(states, words).columns if words or not columns else columns
    given = names.pop("start", None)
    start = as_start(_read_start(bare) if given is None else given, StateSpace(columns=columns))
    if not is_outcome_table(bare):
        # A start that the caller gives is another question, which reset() need not answer.
        begins = {s for s, weight in start if weight} if given is None else range(states)
        compare_with_table(layers, rows, begins, given is not None or _states_start(bare))
    ends, targets = _find_ends(rows, {state for state, _ in start})
    listed = [
        (s, a, [(p, n if not over or n in ends else states, r) for p, n, r, over in outcomes])
        for (s, a), outcomes in rows.items()
        if s not in ends
    ]
    more = bool(targets - ends)  # an end behind the other states
    over = sorted(ends) + [states] * more
    listed += [(end, 0, [(1, end, 0)]) for end in over]
    space = StateSpace(columns=columns, extra=(END,) * more)
    if "labels" not in names:
        ending = {END: np.isin(np.arange(space.size), over)} if over else {}
        names["labels"] = ending | _of_the_map(bare, space.size)
    names |= {"start": start, "space": space}
    return listed


def _of_the_map(env: Any, states: int) -> dict[str, Any]:
    """Return the goals and holes of FrozenLake's map."""
    letters = np.asarray(getattr(env, "desc", ())).ravel()
    named = {"goal": letters == b"G", "hole": letters == b"H"} if len(letters) == states else {}
    return {name: flags for name, flags in named.items() if np.any(flags)}


def _find_toy_names(env: Any, states: int, actions: int) -> tuple[list[str], tuple[Column, ...]]:
    """Return the names of the actions, and the columns of the states where they are known."""
    kind = next(
        (each.__name__ for each in type(env).__mro__ if each.__module__.startswith(TOY_TEXT)), ""
    )
    names, columns = TOYS.get(kind, ((), ()))
    shape = getattr(env, "shape", (getattr(env, "nrow", 0), getattr(env, "ncol", 0)))
    if columns == GRID:
        columns = tuple(
            replace(each, size=int(size)) for each, size in zip(GRID, shape, strict=True)
        )
    fits = StateSpace(columns=columns).size == states and len(names) == actions
    return (list(names), columns) if fits else ([str(number) for number in range(actions)], ())


def _find_ends(rows: Rows, begins: set[int]) -> tuple[set[int], set[int]]:
    """Return the states that are ends, and all that terminated outcomes name.

    The ends are the largest set of such states that no start and no outcome of a state outside
    the set enters alive; states that stay put without reward are ends however they are entered.
    """
    steps = [(s, n, r, over) for (s, _), each in rows.items() for _, n, r, over in each]
    targets = {n for _, n, _, over in steps if over}
    busy = {s for s, n, r, _ in steps if n != s or r != 0}
    ends = targets - (begins & busy) - {NOWHERE}
    while entered := ends & busy & {n for s, n, _, over in steps if s not in ends and not over}:
        ends -= entered
    return ends, targets


def _of_matrices(env: Any, dynamics: Mapping[str, Any], where: str) -> tuple[Numbers, Numbers]:
    """Return P and R (S, A, S) from `tx_mat` and `r_mat`, as ICU-Sepsis has them.

    An action that is not admissible has a row of its own there (the mean of the others), unless the
    environment refuses such actions. An episode is over as soon as nothing is left but to go on to
    the absorbing state, without a reward: from death and survival.
    """
    chances = np.array(dynamics["tx_mat"], dtype=np.float64)
    gains = np.array(dynamics.get("r_mat", np.zeros(chances.shape)), dtype=np.float64)
    if chances.ndim != 3 or chances.shape[0] != chances.shape[2] or gains.shape != chances.shape:
        raise ShapeError(
            f"tx_mat has shape {chances.shape}, r_mat {gains.shape}",
            where=where,
            fix="give both as (S, A, S)",
        )
    strategy = getattr(env, "_inadmissible_action_strategy", "mean")
    if strategy not in ("mean", "raise_exception"):
        raise ModelError(
            f"inadmissible actions are handled by {strategy!r}, which no matrix tells",
            where=where,
            fix='make the environment with inadmissible_action_strategy="mean"',
        )
    states = np.arange(len(chances))
    idle = ~((chances > 0) & (gains != 0)).any(axis=(1, 2))
    absorbing = idle & (chances[states, :, states] == 1).all(axis=1)
    over = np.flatnonzero(idle & (chances[:, :, absorbing].max(axis=2, initial=0) == 1).all(axis=1))
    chances[over], gains[over], gains[over, 1:] = 0, 0, -np.inf
    chances[over, 0, over] = 1
    if strategy != "mean":
        for state, admissible in enumerate(dynamics["admissible_actions"]):
            gains[state, ~np.isin(np.arange(chances.shape[1]), admissible)] = -np.inf
    return chances, gains


def _states_start(env: Any) -> bool:
    """Return whether an environment states where episodes start."""
    return any(hasattr(env, name) for name in STARTS)


def _read_start(env: Any) -> Any:
    """Return where episodes start: state 0, as everywhere, where the environment does not say."""
    given = next((getattr(env, name) for name in STARTS if hasattr(env, name)), 0)
    by_state = {int(given): 1} if is_whole_number(given) else given
    if isinstance(by_state, Mapping) and all(map(is_whole_number, by_state)):
        return ByNumber((int(state), chance) for state, chance in by_state.items())
    if isinstance(given, Sequence | np.ndarray) and not isinstance(given, str):
        return list(given)
    raise ModelError(
        f"initial_state_distrib is {shorten_text(repr(given), 60)}",
        where="start",
        fix="let it be (S,) probabilities, or pass start=, a state or {state: probability}",
    )


def _time_limit(layers: Sequence[Any]) -> int | None:
    """Return after how many steps the environment stops: the lowest limit of its wrappers.

    A specification says it too, where no wrapper does; a limit of -1 is none.
    """
    limits: list[Any] = [getattr(each, "__dict__", {}).get("_max_episode_steps") for each in layers]
    stated: Any = getattr(getattr(layers[0], "spec", None), "max_episode_steps", None)
    for known in (limits, [stated]):
        positive = [int(limit) for limit in known if is_whole_number(limit) and limit > 0]
        if positive:
            return min(positive)
    return None


def _find_environment_name(env: Any) -> str:
    if is_outcome_table(env):
        return ""
    spec = getattr(env, "spec", None)
    return str(getattr(spec, "id", "") or type(getattr(env, "unwrapped", env)).__name__)


def _make_environment(name: str, **options: Any) -> Any:
    with require_extra("models"):
        import gymnasium
    try:
        with warnings.catch_warnings():
            # An outdated version is refused right after the warning of it, in the same words.
            warnings.simplefilter("ignore")
            return gymnasium.make(name, **options)
    except Exception as error:  # whatever the environment's own code raises
        cause, said = error.__cause__ or error, str(error)[:200]
        if isinstance(cause, ModuleNotFoundError):
            what = f"there is no module {cause.name}"
            fix = "install it, or put the folder of the module that registers the environment on "
            fix += "PYTHONPATH"
        elif isinstance(error, gymnasium.error.Error | ImportError):
            toy = (
                key
                for key, spec in gymnasium.registry.items()
                if TOY_TEXT in str(spec.entry_point) and spec.name != "Blackjack"  # it has no P
            )
            what, fix = f"Gymnasium cannot make {name!r}: {said}", suggest_name(name, toy)
        else:
            what = f"the environment {name} raises {type(error).__name__}: {said}"
            fix = "correct the environment, or its options"
        raise ModelError(what, where=f"gymnasium:{name}", fix=fix) from error
