"""What strangers call and what cannot be: refused with what, where and fix."""

from contextlib import suppress
from fractions import Fraction as F
from functools import partial
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from made_models import forest
from records import POLICY, estimated, recorded
from refusal_tables import entries

import exact_mdp
from exact_mdp import (
    MDP,
    Column,
    Family,
    ModelError,
    OffPolicy,
    Scenario,
    StateSpace,
    check,
    check_trainer,
    moving,
)

nan, inf = float("nan"), float("inf")
STATES = ["a", "b"]
SLOW, FAST = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
P = {"slow": SLOW, "fast": FAST}
REWARDS = [[1, "3/2"], [0, 0]]
MODEL = MDP.from_arrays(P, REWARDS, "9/10", states=STATES)
GRID = MDP.from_function(
    (0, 0),
    lambda s: ["right", "down"] if max(s) < 2 else [],
    lambda s, a: [(1, (s[0] + (a == "down"), s[1] + (a == "right")), -1)],
)
CARE = Scenario.load("yuan2025").compile()
SWING = MDP.from_outcomes(
    [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 0, -1)]), (2, 0, [(1, 2, 0)])]
)
FLOATS = Family(
    parameters={"r": 0.15},
    build=lambda at: MDP.from_arrays([[[exp(-at["r"]), 1 - exp(-at["r"])], [0, 1]]], [1, 0], 0.5),
)
BUILT: dict[str, Any] = {"parameters": {"p": "1/2"}, "build": lambda at: MODEL}
ENDING = MDP.from_gymnasium({s: {a: [(1, s, a, a < 1)] for a in (0, 1)} for s in range(3)})
THREE = MDP.from_arrays([np.eye(3)], [1, 2, 3], "1/2")
FOREST = forest("9/10")
EARN = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, 2)])])
# A third action is offered in state 1 alone, and no action in both rows of APART.
RARE = MDP.from_outcomes(
    [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 0)]), (1, 1, [(1, 2, 0)]), (1, 2, [(1, 2, 0)]),
     (2, 0, [(1, 2, 0)])]
)  # fmt: skip
TIMES = StateSpace(columns=(Column(name="time", size=2), Column(name="row", size=1)), extra=("o",))
APART = MDP.from_outcomes(
    [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (1, 2, [(1, 2, 0)]), (1, 3, [(1, 2, 0)]),
     (2, 0, [(1, 2, 0)])]
).with_(space=TIMES)  # fmt: skip
LEAST, ENDS = F(1, 10**400), [[0, 1, 0], [0, 0, 0]]
MASKED = np.ma.masked_array([[9.0, 1, 0], *ENDS], mask=np.eye(3) * [1, 0, 0])
TRAINED = partial(check_trainer, MODEL, lambda seed: [1, 0])
FRAME = recorded(np.random.default_rng(4), 100)
SEEN = estimated(FRAME)
JUDGED = partial(check, SEEN, POLICY, confidence=0.95)


def table(rows: list[list[float]], index: list[str], columns: list[str]) -> pd.DataFrame:
    return pd.DataFrame(rows, index=index, columns=columns)


def by_records(records: pd.DataFrame = FRAME, model: MDP = SEEN, **how: Any) -> Any:
    by = OffPolicy(records=records, **{"rewards": (0, 1)} | how)
    return check(model, POLICY, confidence=0.95, by=by)


REFUSED = """
QLearning(exploration=MDP) -> not a number; exploration; number
QLearning(exploration=2) -> between 0 and 1; 2; from 0 to 1
QLearning(episodes=5) -> snapshot_episode is 10; QLearning; an epoch has 5 episodes
solve(MODEL, subject_to={"steps": 5}) -> 5 is no limit; steps; >= or <=
compare(MODEL, [[0, 0], [1, 0]]) -> policies without names; compare; {name: policy}
solve(MODEL, 1e-06) -> 1e-06 is not a solver; solve; tol=1e-6
<solve|tornado>(3) -> int is not a model; model; a
robust(MODEL, 0.1) -> 0.1 is no set of laws; ambiguity; Intervals.relative(model, 0.1)
tornado(MODEL, ranges=[0, 1]) -> [0, 1] is of type list; ranges; {name: (low, high)}
thresholds(FLOATS, "r") -> not polynomials of degree 1 in r; parameter r; not with floats
MODEL.reaching(["x"]) -> unknown label ['x']; labels; the model has none
MODEL.component(3) -> unknown component 3; components; choose one of reward
save(3, "x.npz") -> 3 is of type int; save; save(model, path)
save("x.npz", MODEL) -> 'x.npz' is of type str; save; save(model, path)
MDP.save("x.npz", MODEL) -> 'x.npz' is of type str; save; model.save(path)
MDP.from_<arrays(P, REWARDS|outcomes([(0, 0, [(1, 0, 0)])]|transitions("no.csv">, gamma=0.9) ->
    gamma=; MDP; say discount=
MDP.from_<pairs([0], [0], [[1]], [0]|gymnasium({0: {0: [(1, 0, 0, True)]}}>, gamma=0.9) ->
    gamma=; MDP; say discount=
MDP.from_function(0, lambda s: [], lambda s, a: [], gamma=0.9) -> gamma=; MDP; say discount=
MODEL.with_(gamma=0.9) -> gamma=; MDP; say discount=
MDP.from_gymnasium({0: {0: [(1, 0, 0, True)]}}, is_slippery=False) -> is_slippery=; MDP; choose
MDP.from_arrays(P, REWARDS, statess=STATES) -> statess=; MDP; did you mean states?
MDP.from_transitions("no.csv", states=STATES) -> states=; MDP; leave it out
MODEL.pair("a") -> 'a' is not; pair; both
GRID.pair((0, 1)) -> (0, 1) is not; pair; both
MDP.from_arrays([SLOW], [1, 0], states=["a", "a"]) ->
    two states have the same name, 'a'; column state; own name
MDP.from_arrays([SLOW, FAST], REWARDS, layout="ass", actions=["x", "x"]) ->
    two actions have the same name, 'x'; actions; own name
MDP.from_arrays([SLOW], [1, 0], start={0: "1/2", 1: "0.50000001"}) ->
    start probabilities sum to 1 + 1e-08, not 1; start; give a distribution
MDP.from_arrays({"go": table([[1]], ["a"], ["b"])}, [0]) ->
    the labels b, and the states are a; P; a row and a column for each state
MODEL.space.label(2) ->
    there is no state 2: numbers go from 0 to 1; state space; choose one of these
Policy.of(MODEL, [0, 9]) ->
    there is no action 9: numbers go from 0 to 1; policy; choose one of these
Policy.of(MODEL, {("a", "slow"): 1}) -> an action value is NaN; state a; every available action
Policy.of(MODEL, {("a", "slow"): 1, ("x", "slow"): 1}) ->
    unknown state 'x'; policy; choose one of a, b
Policy.of(MODEL, {("a", "slow"): 1, ("a", "fats"): 1}) ->
    unknown action 'fats'; policy; did you mean fast?
Policy.of(MODEL, {("a", "slow"): 0.5, ("a", "fast"): 0.5}) ->
    probabilities or a Q-table; state a; kind="policy"
Policy.of(MODEL, "optimal") ->
    unknown kind of policy; optimal; file; the optimal policy is solve(mdp).policy
Policy.by(MODEL, ["state"], [0.9, 0.0]) ->
    [0.9, 0.0] are not all numbers of actions; policy; from 0 to 1: 0 is slow, 1 is fast
MODEL.with_(labels={"goal": <[0, 1]|[2]>}) -> type int64; label goal; numbers of some states
train(MODEL, 3, 1) -> 3 is no learner; train; QLearning()
train(MODEL, QLearning(), 1) -> needs a seed; rng; rng=0
outcomes(MODEL, 3) -> 3 is no list of runs; runs; list
learning_curve(MODEL, 3, rng=0) -> no run of training; learning; train(model
tradeoff(MODEL, 3) -> a front of 3; tradeoff; two
psa(FLOATS, 9, uncertain={"r": ("beta", 8, 92)}, rng=0) ->
    is stated; parameter r; "distribution": "beta", "mean"
robust_curve(MODEL, "l1", ["much"]) -> 'much' is not; radius; 0.1
robust_curve(MODEL, "kl", [True]) -> True is not a number; radius; write
robust_curve(MODEL, "entropy", [10**400]) -> radius of 1e400; radius; larger than a float
Intervals(lower="much", upper=1) -> 'much' is not; lower; 0.1
solve_robust(MODEL, Intervals.relative(MODEL, 0.1), tol="much") ->
    tol is 'much'; robust; positive number
curve(Family(**BUILT), "p").at("much") -> 'much' is not; parameter p; 0.1
best_cvar(MODEL.within(2), "much") -> 'much' is not; conditional value at risk; 0.1
study(FLOATS, {"r": ["much"]}) -> 'much' is not; parameter r; 0.1
study(FLOATS, {"r": [10**400]}) -> too large for a float; points; units
tornado(FLOATS, relative="much") -> 'much' is not; relative; 0.1
return_distribution(CARE, "random").cdf("much") -> 'much' is not; return; 0.1
gradient(MODEL, names=3) -> 3 is no list of names; names; a list
gradient(SWING, policy=[0, 0, 0]) -> some policy never ends; discount 1; --discount
accuracy_curves(CARE, statuses=3) -> 3 is no list of statuses; statuses; a list
accuracy_curves(CARE, levels=["high"]) -> 'high' is not a finite; levels; 0.1
best_policy(MODEL, 3) -> 3 is no list of columns; columns; a list
best_policy(APART, ["row"]) -> no action is available in all; row 0; read more columns
best_policy(APART, ["rows"]) -> unknown state column 'rows'; state space; did you mean row?
best_policy(APART, ["time"], node_limit=0) -> node_limit is 0; node_limit; a whole number, 1 or more
"""

# What a policy does once in a billion visits is part of it, as is what numpy would hide.
AUDITS = """
check(THREE, np.array([[1.0, 2, 3]])) -> a row for each action; policy; transpose, of shape (3, 1)
check(ENDING, np.zeros((2, 3))) -> a row for each action; policy; transpose, of shape (3, 2)
check(ENDING, np.zeros((5, 2))) ->
    no policy of this model; policy; give (4, 2) over all states or (3, 2) over all but end
check(ENDING, np.zeros((3, 2)), gamma=0.9) -> gamma=; check; from_gymnasium(env, discount=
check("yuan2052", "random") -> 'yuan2052'; model; yuan2025
check(RARE, [[1, 0, <5e-10|1e-17|5e-324>], *ENDS], kind="policy") ->
    takes an action that is not available; state 0; choose one of 0, 1
check(RARE, [[1 - LEAST, LEAST, 0], *ENDS], kind="policy") ->
    smaller than any float; state 0; give 0
check(RARE, {"0": {"0": 1 - LEAST, "1": "1e-400"}, "1": "1", "2": "0"}) ->
    smaller than any float; state 0; give 0
check(RARE, MASKED, kind="q") -> entries of the array are masked; policy; array.filled(0)
check(RARE, np.array([[nan, F(1, 3), 0], *ENDS], dtype=object)) ->
    an action value is NaN; Q-table[0, 0] (state 0, action 0); a number for every available action
check(EVEN, <np.array([[3.0, 1], [nan, 2]])|[[3.0, 1], [2, nan]]>) ->
    an action value is NaN; state b; a number for every available action
check(EVEN, [[3.0, 1], [1, inf]]) -> an action value is +inf; state b, action 1; give a number
check(EVEN, np.array([[3.0, 1], [-inf, -inf]], dtype=np.float32)) ->
    every action offered has the value -inf; Q-table[1] (state b); give a number
check(MODEL, np.array([[3.0, 1], [1, 2]]), kind="policy") ->
    [3.0, 1.0], not a distribution; state a; at least 0, with sum 1
check(MODEL, np.array([[3.0, 1], [1, 2]]), kind="table") ->
    'table' is not a kind of array; kind; choose auto, q, policy
check(MODEL, <"random"|{"a": "slow", "b": "fast"}|Policy.of(MODEL, "random")>, kind="q") ->
    this is a policy, not a Q-table; policy; leave kind out
check(MODEL, np.array([0, 1]), kind="q") ->
    a Q-table has shape (2, 2); policy; of action numbers leave out kind="q"
check(EVEN.within(2), np.array(<[[1, 1], [0, 1]]|[[0, 1], [1, 0]]>)) ->
    may be action numbers by time and state, or a table; policy; (N, S, A), or say kind="q"
check(<EARN|EARN.with_(sense="min")>, [0]) ->
    both infinite, so that nothing can be compared; the total at discount 1; discount=
check(MODEL, [0, 0], <max_regret|max_relative_regret>=<nan|inf|'nan'|'inf'|'x'>) ->
    is not a finite rational; *; 0.1
check(MODEL, [0, 0], <max_regret|max_relative_regret>=<True|[1]>) -> is not a number; *; "p/q"
check(MODEL, [0, 0], <max_regret|max_relative_regret>=<-1|-1e-300|"-1/3">) -> * is -; *; 0 or more
check(MODEL, [0, 0], <max_regret|max_relative_regret>=10**400) ->
    * is 1e400, beyond the floats; *; choose less
check(CARE, "optimal", subject_to={"anger": ">= 0"}, criterion="average") ->
    limits hold of total rewards; subject_to; leave criterion out
check(FOREST, "random", horizon=3, criterion="average") -> no horizon; horizon; divide
check_trainer(MODEL, <[[0, 0]] * 9|lambda seed: [0, 0]|iter([[1, 0]] * 2)>, runs=2, rng=0) ->
    of 2 runs no outcome could fail; runs; give 3 runs or more
check_trainer(MODEL, iter([[1, 0]] * 2)) -> of 2 runs no outcome could fail; runs; give 3 runs
check_trainer(MODEL, <[0, 0]|np.array([0, 0])|"best.json"|Path("a")|{"0": 1}>) ->
    one policy, where runs ask for several; policies; a list of policies
check_trainer(MODEL, [], rng=0) -> no policies; check_trainer; at least one
TRAINED() -> no rng to draw these from; rng; the seeds of the runs are drawn from it
TRAINED(rng=0, <share|alpha>=0) -> * is 0; *; from 0 to 1, not 0
TRAINED(rng=0, share="11/10") -> share is 1.1; share; from 0 to 1, not 0
TRAINED(rng=0, share="many") -> 'many' is not a finite; share; 0.1
TRAINED(rng=0, alpha=1) -> a risk of error of 1 proves nothing; alpha; 1/100
TRAINED(rng=0, alpha=-0.5) -> alpha is -0.5; alpha; from 0 to 1, not 0
TRAINED(rng=0, runs=0) -> runs is 0; runs; 1 or more
TRAINED(rng=0, max_regret=-1) -> max_regret is -1; max_regret; 0 or more
check(SEEN, POLICY, by="posterior") -> no confidence is given; by; confidence=0.95
JUDGED(confidence=<95|0|1>) -> a confidence of *; confidence; more than 0 and less than 1
JUDGED(confidence="high") -> 'high' is not a finite; confidence; 0.1
JUDGED(confidence="0.99999999999999999999", by="posterior") ->
    a confidence of 0.9999; confidence; as a float too
JUDGED(confidence=F(1, 10**400), by="posterior") -> of 1/1000; confidence; as a float too
JUDGED(by="bootstrap") -> unknown kind of interval 'bootstrap'; by; posterior
JUDGED(by=<3|Robust|object()>) -> is not a kind of interval; by; or one of their classes
JUDGED(by="off-policy") -> no trajectories; records; by=OffPolicy(records=
JUDGED(<max_relative_regret=1|criterion="average"|subject_to={}>) ->
    records bound the total regret alone; confidence; give max_regret
JUDGED(horizon=5, by=Robust(rewards=(0, 1), returns=(0, 9))) -> rewards bound; returns; leave it out
JUDGED() -> nothing says where rewards lie; rewards; state it
JUDGED(by=Robust(rewards=(0, "1/2"))) -> rewards from 0 to 1 were seen; rewards; a range that
JUDGED(by=Robust(rewards=(1, 0))) -> the range 1 to 0; rewards; the lower end first
JUDGED(by=Robust(rewards="all")) -> rewards are 'all'; rewards; give 'known', or (low, high)
JUDGED(by=Robust(rewards="known")) -> two rewards were seen; state 0, action 0; where rewards lie
JUDGED(by=Posterior(prior=0)) -> the prior is 0; prior; such as 1
JUDGED(by=Posterior(n=1)) -> the number of draws, n, is 1; the number of draws; 2 or more
by_records(behaviour="always:1") -> never does what the policy does; state 0, action 0; robust sets
by_records(behaviour=np.array([[3.0, 1.0]] * 4)) -> not a distribution; policy[0]; with sum 1
by_records(FRAME.assign(state=9, next_state=None, episode=range(len(FRAME)))) ->
    there is no state 9; transitions; choose one of these
by_records(FRAME.assign(action="left")) -> unknown action 'left'; transitions; choose one of 0, 1
by_records(FRAME.drop(columns="reward")) -> no column 'reward'; transitions; --column reward=
by_records(model=MDP.from_transitions(FRAME, "9/10", start=1)) ->
    begins where the model never does; state 0; make the model without start=
by_records(model=MDP.from_transitions(FRAME, "9/10", start={0: "1/10", 1: "9/10"})) ->
    the records begin as they began; start; make the model without start=
JUDGED(by=Posterior(n=80)).interval.within(nan) -> nan is not a finite; limit; 0.1
by_records(rewards=None) -> nothing says where rewards lie; rewards; state it
by_records(returns=(0, "1/2")) -> a reward of 1 was seen; state 0, action 0; returns=(low, high)
by_records(returns=(0, 1)) -> returns from 0 to; returns; a range that holds them
check(MODEL, [0, 0], confidence=0.95) -> no counts; confidence; MDP.from_transitions
"""
EVEN = MDP.from_arrays([np.eye(2)] * 2, [[1, 0], [0, 1]], "1/2", layout="ass", states=STATES)
NAMES = {name: getattr(exact_mdp, name) for name in exact_mdp.__all__}


@pytest.mark.parametrize(("call", "said"), entries(REFUSED) + entries(AUDITS))
def test_refused(call: str, said: str) -> None:
    what, where, fix = said.split("; ", 2)
    with pytest.raises(ModelError) as caught:
        eval(call, NAMES | globals())
    assert what in caught.value.what
    assert where in caught.value.where
    assert fix in caught.value.fix


WRONG_TYPES = """
MODEL.with_(<states|actions>="ab") -> *
MODEL.with_(<states|actions|action_objects|table|pair_state|space|events|parameters>=3) -> *
MODEL.with_(<observations|component_names|float_rewards>=3) -> *
MODEL.with_(discount_exact=0.5) -> discount_exact
MDP.from_arrays(3, [1]) -> P
MDP.from_arrays([[[1]]], [1], layout=[]) -> layout
MDP.from_arrays([[[1]]], [1], <states|actions>=3) -> *
MDP.from_arrays({0: {0: {0: 1}}}, [1], states=3) -> states
MDP.from_function(0, lambda s: [], lambda s, a: [], labels=3) -> labels
MDP.load("no.prism", constants=3) -> constants
MDP.load("no.npz", gamma=0.9) -> MDP
load("yuan2025", sets=<3|[3]>) -> sets
MDP.from_transitions("no.csv", columns=3) -> columns
MDP.from_gymnasium({0: {0: [(1, 0, 0, True)]}}, states=3) -> states
MODEL.by_action([1]) -> by_action
Policy.by(MODEL, <3|"state">, [0, 0]) -> columns
Policy.of(MODEL, [0, 0], kind=[]) -> kind
Policy.of(MODEL, [0, 0]).write(3) -> path
Policy.<of(3, [0, 0])|by(3, ["state"], [0, 0])|from_choices(3, [0, 0])> -> model
<Policy.of(MODEL, [0, 0]).weights|fingerprint>(3) -> model
moving(3, {}) -> model
moving(MODEL, 3) -> entries
moving(MODEL, {"p": 3}) -> parameter p
moving(MODEL, {}, 3) -> rewards
Family(parameters={"p": 1}, build=3) -> build
Family(**BUILT, <degrees|breaks|rows|room>=3) -> *
Family(**BUILT).at(3) -> values
"""


@pytest.mark.parametrize(("call", "where"), entries(WRONG_TYPES))
def test_wrong_types_are_refused_by_their_place(call: str, where: str) -> None:
    with pytest.raises(ModelError) as caught:
        eval(call, NAMES | globals())
    assert caught.value.where == where
    assert caught.value.fix


VARIED = moving(MODEL, {"p": [(0, 0)]})
VARY: dict[str, dict[str, Any]] = {
    "gradient": {"model": VARIED, "names": 0, "policy": 0},
    "tornado": {"model": VARIED, "names": 0, "ranges": 0, "relative": 0, "policy": 0},
    "one_way": {"model": VARIED, "name": "p", "ranges": 0, "points": 2, "relative": 0},
    "two_way": {"model": VARIED, "x": "p", "y": "discount", "ranges": 0, "points": 2},
    "thresholds": {"model": VARIED, "name": "p", "ranges": 0, "relative": 0},
    "curve": {"model": VARIED, "name": "p", "ranges": 0, "policy": 0},
    "psa": {"model": VARIED, "n": 2, "uncertain": 0, "policy": 0, "folder": 0, "n_jobs": 0},
    "sobol": {"model": VARIED, "n": 2, "rng": 0, "names": 0, "ranges": 0, "confidence": 0},
    "worst_point": {"model": VARIED, "ranges": 0, "policy": 0},
    "study": {"model": VARIED, "points": {"p": [0.5]}, "policies": 0, "folder": 0},
    "robust": {"model": MODEL, "ambiguity": 0, "policy": 0},
    "robust_curve": {"model": MODEL, "kind": "l1", "radii": [0], "policy": 0},
    "cost_effectiveness": {"model": VARIED, "strategies": {"a": [0, 0]}, "n": 2, "uncertain": 0},
}


@pytest.mark.parametrize("wrong", [3.5, "x", [["x"]], {"x": 1}, object()], ids=list("12345"))
@pytest.mark.parametrize("function", VARY)
def test_what_varies_takes_or_refuses_whatever_is_given(
    function: str, wrong: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No option ends in an error that is not the toolkit's own; what is needed is given rightly."""
    monkeypatch.chdir(tmp_path)
    needed = {name: each for name, each in VARY[function].items() if each or name == "rng"}
    for name in VARY[function]:
        with suppress(ModelError):
            NAMES[function](**needed | {name: wrong})
