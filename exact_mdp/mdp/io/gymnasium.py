"""Models from Gymnasium environments that expose their dynamics: a table `P`, or matrices.

`P[state][action]` lists (probability, next state, reward, terminated). An episode is over after an
outcome with terminated = True, even if `P` has rows for its next state:

    Q(s, a) = Σ p (r + γ (1 - terminated) V(s')).

A state that is entered only by terminated outcomes becomes an absorbing end without reward (such as
the goal of CliffWalking, for which `P` lists moves that no episode makes). If an episode may also
pass through such a state, or start in it (Taxi with the passenger at the destination), its rows
remain, and terminated outcomes lead to an additional state "end" after the others.

Instead of a table, an environment may have `dynamics` with matrices `tx_mat` and `r_mat` (S, A, S),
like ICU-Sepsis (Choudhary, Gupta and Thomas, Reinforcement Learning Conference 2024).

A wrapper or custom environment whose step() or reset() differs from `P` is refused: see
`mdp.io.gymnasium_table`. An environment with neither is explored by its steps, if these are
deterministic: see `mdp.io.gymnasium_steps`. `mdp.io.blackjack` has the rules of Blackjack.
"""

from __future__ import annotations

import warnings
from ast import literal_eval
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from inspect import Parameter, signature
from typing import Any, Self

import numpy as np

from exact_mdp.mdp.errors import (
    ModelError,
    ShapeError,
    require_extra,
    shorten_text,
    suggest_name,
)
from exact_mdp.mdp.forms.explore import FromFunction
from exact_mdp.mdp.forms.names import ByNumber
from exact_mdp.mdp.io.blackjack import Blackjack
from exact_mdp.mdp.io.gymnasium_steps import CopiedEnvironment
from exact_mdp.mdp.io.gymnasium_table import (
    LISTED,
    NOWHERE,
    TOY_TEXT,
    Rows,
    compare_with_table,
    find_first_changing,
    is_flag,
    is_outcome_table,
    is_whole_number,
    layers_of,
    read_outcome_rows,
    refuse_changes,
    refuse_untried,
)
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import Numbers
from exact_mdp.mdp.validate import KNOWN, as_start, check_options

END = "end"
STARTS = ("initial_state_distrib", "isd")  # names of the initial distribution in environments
GRID = (Column(name="row", size=0), Column(name="column", size=0))
WORDS = {"true": "True", "false": "False", "none": "None"}
SWITCHES = ("yes", "no", "on", "off")
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
"""Names of the actions, and the columns whose combinations are the states."""


class FromGymnasium(FromFunction):
    """Models from environments."""

    @classmethod
    def from_gymnasium(cls, env: object, discount: object = 1, **names: Any) -> Self:
        """Build from a Gymnasium environment with a table `P`, or with deterministic steps.

        Parameters
        ----------
        env : gymnasium.Env, str or table
            An environment, wrapped or not; an object with an attribute `P`, or `dynamics` with
            matrices; such a table; or a registered id, or "module:ID" if a module registers it.
        discount : number or "p/q"
        **names
            `start` instead of the environment's `initial_state_distrib` (or of state 0, if it has
            none); `actions`, `states`, `name`, `sense`, `labels`; `time_limit` instead of the
            environment's own. With an id, all other names are options of the environment, such as
            `is_slippery=False`.

        Notes
        -----
        Custom environments and wrappers are tried for a few hundred steps, with fixed seeds, in a
        copy; an environment that cannot be copied is itself reset and stepped.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If the environment is unknown, if it has no `P` and is not deterministic given its
            observation, if `P` is not a table of distributions over its own states, or if step() or
            reset() differs from `P`.

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
            options = {name: names.pop(name) for name in {*names} - KNOWN}
            made = _make_environment(env, **options)
            try:
                _refuse_other_types(made, options)
                return cls.from_gymnasium(made, discount, **{"name": env} | names)
            finally:
                made.close()
        if env is None or isinstance(env, bool | int | float):
            fix = f"give an environment, an id such as FrozenLake-v1, or a table: {LISTED}"
            raise ModelError(f"{env!r} is not an environment", where="env", fix=fix)
        bare: Any = env
        if not is_outcome_table(env):
            bare = getattr(env, "unwrapped", env)
        check_options(names, {})
        layers = [*layers_of(env)]
        names.setdefault("name", _find_environment_name(env))
        names.setdefault("time_limit", _time_limit(layers))
        where = names["name"] or "P"
        dynamics: Any = getattr(bare, "dynamics", None)
        tabled = is_outcome_table(bare) or hasattr(bare, "P")
        matrices = not tabled and isinstance(dynamics, Mapping) and "tx_mat" in dynamics
        rules: Any = None
        if not matrices and is_blackjack(bare):
            refuse_untried(layers)
            rules = Blackjack(natural=bare.natural, sab=bare.sab)
        elif not (tabled or matrices) and hasattr(bare, "step"):
            rules = CopiedEnvironment(layers[find_first_changing(layers)], where)
        if rules is not None:
            start = names.pop("start", rules.start)
            return cls.from_function(
                start, rules.list_actions, rules.list_outcomes, discount, **names
            )
        # A model is made from the table alone, so no wrapper may change the environment.
        refuse_changes(layers)
        if matrices:
            refuse_untried(layers)
            options = {"start": dynamics.get("d_0"), "layout": "sas"} | names
            return cls.from_arrays(*_of_matrices(bare, dynamics, where), discount, **options)
        rows = _rows_from_table(bare, where, layers, names)
        return cls.from_outcomes(rows, discount, **names)


def is_blackjack(env: Any) -> bool:
    """Return whether an environment is Gymnasium's own Blackjack."""
    kind = type(env)
    return kind.__name__ == "BlackjackEnv" and kind.__module__.startswith(TOY_TEXT)


def _rows_from_table(
    bare: Any, where: str, layers: Sequence[Any], names: dict[str, Any]
) -> list[Any]:
    """Return the rows of the model of a table; add its start, state space and labels to `names`."""
    # Names of actions and states: given, known from Gymnasium's environments, or numbers.
    rows, states = read_outcome_rows(bare, where)
    actions = max(action for _, action in rows) + 1
    known, columns = _find_toy_names(bare, states, actions)
    names.setdefault("actions", known)
    words = names.pop("states", ())
    if words or not columns:
        columns = StateSpace.plain(states, words).columns
    # The start, with which reset() must agree unless the caller gives another one.
    given, stated = names.pop("start", None), any(hasattr(bare, name) for name in STARTS)
    begins: Collection[int] = range(states)
    if given is None:
        start = as_start(_read_start(bare), StateSpace(columns=columns))
        begins = {state for state, weight in start if weight}
    else:
        start = as_start(given, StateSpace(columns=columns))
    if not is_outcome_table(bare):
        compare_with_table(layers, rows, begins, stated or given is not None)
    # Terminated outcomes lead to ends, which stay put, or to one more state behind the others.
    ends, targets = _find_ends(rows, {state for state, _ in start})
    listed: list[Any] = []
    for (state, action), outcomes in rows.items():
        if state in ends:
            continue
        own = []
        for p, following, reward, terminated in outcomes:
            if terminated and following not in ends:
                following = states
            own.append((p, following, reward))
        listed.append((state, action, own))
    over, extra = sorted(ends), list[str]()
    if targets - ends:
        over.append(states)
        extra.append(END)
    listed += [(end, 0, [(1, end, 0)]) for end in over]
    space = StateSpace(columns=columns, extra=tuple(extra))
    if "labels" not in names:
        names["labels"] = _of_the_map(bare, space.size)
        if over:
            names["labels"] = {END: np.isin(np.arange(space.size), over)} | names["labels"]
    names |= {"start": start, "space": space}
    return listed


def _of_the_map(env: Any, states: int) -> dict[str, Any]:
    """Return the labels of the goals and holes of FrozenLake's map; {} without a map."""
    letters = np.asarray(getattr(env, "desc", ())).ravel()
    if len(letters) != states:
        return {}
    named = {"goal": letters == b"G", "hole": letters == b"H"}
    return {name: flags for name, flags in named.items() if np.any(flags)}


def _find_toy_names(env: Any, states: int, actions: int) -> tuple[list[str], tuple[Column, ...]]:
    """Return the names of the actions, and the columns of the states, or () if unknown."""
    kinds = []
    for kind in type(env).__mro__:
        if kind.__module__.startswith(TOY_TEXT):
            kinds.append(kind.__name__)
    names, columns = TOYS.get("".join(kinds[:1]), ((), ()))
    # A map has as many rows and columns as the environment says.
    shape = getattr(env, "shape", (getattr(env, "nrow", 0), getattr(env, "ncol", 0)))
    if columns == GRID:
        sized = []
        for each, size in zip(GRID, shape, strict=True):
            sized.append(replace(each, size=int(size)))
        columns = tuple(sized)
    if StateSpace(columns=columns).size == states and len(names) == actions:
        return list(names), columns
    return [str(number) for number in range(actions)], ()


def _find_ends(rows: Rows, begins: set[int]) -> tuple[set[int], set[int]]:
    """Return the states that are ends, and all next states of terminated outcomes.

    The ends are the largest set of such states in which no episode starts, and which no outcome
    from outside the set enters without being terminated. States that stay put without reward are
    ends in any case.
    """
    steps = []
    for (s, _), outcomes in rows.items():
        steps += [(s, n, r, over) for _, n, r, over in outcomes]
    targets = {n for _, n, _, over in steps if over}
    busy = {s for s, n, r, _ in steps if n != s or r != 0}
    ends = targets - (begins & busy) - {NOWHERE}
    # Remove states that are entered from outside, until there are none.
    while True:
        alive = {n for s, n, _, over in steps if s not in ends and not over}
        entered = ends & busy & alive
        if not entered:
            return ends, targets
        ends -= entered


def _of_matrices(env: Any, dynamics: Mapping[str, Any], where: str) -> tuple[Numbers, Numbers]:
    """Return P and R (S, A, S) from the matrices `tx_mat` and `r_mat` of ICU-Sepsis.

    An inadmissible action has a row there as well (the mean of the others), unless the environment
    refuses such actions. An episode is over in a state from which every action leads to the
    absorbing state without a reward: death and survival.
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
            f"inadmissible actions are handled by {strategy!r}, which the matrices do not show",
            where=where,
            fix='make the environment with inadmissible_action_strategy="mean"',
        )
    # Idle states earn nothing. They are over if they lead only to the absorbing state.
    states = np.arange(len(chances))
    idle = ~((chances > 0) & (gains != 0)).any(axis=(1, 2))
    absorbing = idle & (chances[states, :, states] == 1).all(axis=1)
    over = np.flatnonzero(idle & (chances[:, :, absorbing].max(axis=2, initial=0) == 1).all(axis=1))
    # Such a state gets a single action, which stays put.
    chances[over], gains[over], gains[over, 1:] = 0, 0, -np.inf
    chances[over, 0, over] = 1
    if strategy != "mean":
        for state, admissible in enumerate(dynamics["admissible_actions"]):
            gains[state, ~np.isin(np.arange(chances.shape[1]), admissible)] = -np.inf
    return chances, gains


def _read_start(env: Any) -> Any:
    """Return the initial distribution of an environment; state 0 if it has none."""
    given = next((getattr(env, name) for name in STARTS if hasattr(env, name)), 0)
    by_state = given
    if is_whole_number(given):
        by_state = {int(given): 1}
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
    """Return the number of steps after which an environment stops; None without a limit.

    It is the lowest limit of the wrappers, or else of the specification; -1 means no limit.
    """
    limits: list[Any] = [getattr(each, "__dict__", {}).get("_max_episode_steps") for each in layers]
    stated: Any = getattr(getattr(layers[0], "spec", None), "max_episode_steps", None)
    for known in (limits, [stated]):
        positive = [int(limit) for limit in known if is_whole_number(limit) and limit > 0]
        if positive:
            return min(positive)
    return None


def _find_environment_name(env: Any) -> str:
    """Return the id of an environment, or the name of its class; "" for a table."""
    if is_outcome_table(env):
        return ""
    spec = getattr(env, "spec", None)
    return str(getattr(spec, "id", "") or type(getattr(env, "unwrapped", env)).__name__)


def parse_options(texts: Mapping[str, str]) -> dict[str, Any]:
    """Return the options of an environment from texts such as "False", "3" or "8x8".

    A text is the value that it writes in Python; true, false and none may be in small letters, and
    any other text is a text. yes, no, on and off are refused, since a text counts as true.
    """
    options: dict[str, Any] = {}
    for name, text in texts.items():
        if name in KNOWN or name in ("env", "discount"):
            what = f"{name} is a part of the model, not an option of the environment"
            raise ModelError(what, where="--env", fix=f"give --{name}, if the command has it")
        if text.lower() in SWITCHES:
            fix = f"write {name}=True or {name}=False, or a text in quotes: {name}=\"'{text}'\""
            raise ModelError(f"{text} may be a truth value or a text", where="--env", fix=fix)
        try:
            options[name] = literal_eval(WORDS.get(text.lower(), text))
        except (ValueError, SyntaxError, MemoryError, RecursionError):
            options[name] = text
    return options


def _refuse_other_types(made: Any, options: Mapping[str, Any]) -> None:
    """Raise ModelError for an option of a type other than its default's, if one of them is a text.

    It may be taken in silence: every text but the empty one counts as true.
    """
    from gymnasium import registry
    from gymnasium.envs.registration import load_env_creator

    creator = made.spec.entry_point
    if isinstance(creator, str):
        creator = load_env_creator(creator)
    usual: dict[str, Any] = {}
    for maker in (type(made.unwrapped), creator):
        for each in signature(maker).parameters.values():
            usual[each.name] = each.default
    usual |= getattr(registry.get(made.spec.id), "kwargs", {})
    for name, value in options.items():
        default = usual.get(name)
        if default is Parameter.empty or default is None:
            continue
        kind = type(default).__name__
        wrong = value is not None and isinstance(value, str) != isinstance(default, str)
        if isinstance(default, bool):
            wrong = not is_flag(value)
        if wrong:
            raise ModelError(
                f"{name} is {value!r}, and its default {default!r} of type {kind}",
                where=f"gymnasium:{made.spec.id}",
                fix=f"give a value of type {kind}",
            )


def _make_environment(name: str, **options: Any) -> Any:
    """Return a registered environment; turn all errors of its code into ModelErrors."""
    with require_extra("models"):
        import gymnasium
    try:
        with warnings.catch_warnings():
            # After the warning about an outdated version comes an error with the same words.
            warnings.simplefilter("ignore")
            return gymnasium.make(name, **options)
    except Exception as error:  # whatever the environment's own code raises
        cause, said = error.__cause__ or error, str(error)[:200]
        if isinstance(cause, ModuleNotFoundError):
            what = f"there is no module {cause.name}"
            fix = "install it, or put the folder of the module that registers the environment on "
            fix += "PYTHONPATH"
        elif isinstance(error, gymnasium.error.Error | ImportError):
            toy = []
            for key, spec in gymnasium.registry.items():
                if TOY_TEXT in str(spec.entry_point) and spec.name != "Blackjack":  # it has no P
                    toy.append(key)
            what, fix = f"Gymnasium cannot make {name!r}: {said}", suggest_name(name, toy)
        else:
            what = f"the environment {name} raises {type(error).__name__}: {said}"
            fix = "correct the environment, or its options"
        raise ModelError(what, where=f"gymnasium:{name}", fix=fix) from error
