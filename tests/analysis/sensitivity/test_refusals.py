"""What analyses refuse: each call, and words of what is said; all say where, and what to do."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
import pytest
from made_models import grid
from refusal_tables import entries

import exact_mdp
from exact_mdp import (
    MDP,
    Column,
    Family,
    ModelError,
    Parameter,
    Scenario,
    StateSpace,
    curve,
    load_ranges,
    load_uncertainty,
    moving,
    parametric,
    uncertainty,
)

YUAN = Scenario.load("yuan2025")
SMALL = YUAN.with_(tasks=[1], max_trial=2)
CARE, TEA = parametric(YUAN), Scenario.load("tea")
# Puterman (1994), section 3.1
PUTERMAN = MDP.from_outcomes(
    [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])], "1/2"
)
HELD = curve(PUTERMAN, "discount", (0, "99/100"), policy=[0, 0])
WAIT = MDP.from_outcomes(
    [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 2, 5)]), (1, 0, [(1, 1, -1)]), (2, 0, [(1, 2, 0)])]
)
LAWS = MDP.from_arrays([[["1/2", "1/4", "1/4"], ["2/3", "1/3", 0], [0, 0, 1]]], [1, 0, 0])
THIRDS = moving(LAWS, {"a": [(0, 1)], "b": [(0, 2)]})
ROW, ONE, TWO, THREE = "row", "row: to 1", "row: to 2", "other: to 1"
ROWS = replace(
    moving(LAWS, {ONE: [(0, 1)], TWO: [(0, 2)], THREE: [(1, 1)]}, {"reward.1": 1}),
    rows={ROW: (ONE, TWO), "other": (THREE,)},
)
OPEN = Family(
    parameters={"p": "1/2"},
    build=lambda at: MDP.from_arrays([[[1 - at["p"], at["p"]], [0, 1]]], [1, 0], "1/2"),
)
BETS = Family(
    parameters={"r": 1, "s": "1/2"},
    build=lambda at: MDP.from_arrays([[[1]]] * 2, [[at["r"], at["s"]]], 0),
)
CHOICES = {"wait": [0], "treat": [1]}
SAID = {"r": {"distribution": "uniform", "low": 0, "high": 2}}
OWN = pd.DataFrame({"r": [1.0, 2.0, 3.0], "s": [0.1, 0.2, 0.4]})
KINK = Family(
    parameters=(Parameter(name="p", value="1/2", low=0, high=1),),
    build=lambda at: MDP.from_arrays([[[1]]] * 2, [[at["p"], 1 - at["p"]]], 0),
)
ROUND = MDP.from_outcomes(
    [(s, a, [(1, (s + 1) % 201, 0)]) for s in range(201) for a in (0, 1)],
    "1/2",
    components={"a": [0, 1] * 201, "b": [2, 0] * 201},
)


def file_of(text: str, read: Any) -> Any:
    with TemporaryDirectory() as folder:
        (path := Path(folder, "stated.toml")).write_text(text, "utf-8")
        return read(path)


def stated(text: str) -> Any:
    return uncertainty(CARE, file_of(text, load_uncertainty)[0])


def ranges(text: str) -> Any:
    return file_of(text, lambda path: load_ranges(CARE, path))


def statuses(rows: list[Any]) -> MDP:
    space = StateSpace(columns=(Column(name="status", size=2, bits=1),), extra=("end",))
    return MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])]).with_(space=space)


TURNING = statuses([(s, 0, [("1/2", 1 - s, 1), ("1/2", 2, 0)]) for s in (0, 1)])
REVEALING = statuses([(0, 0, [(1, 2, 1)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 2, 1)])])

REFUSED = r"""
worst_point(SMALL, "optimal", {"base.anger": (0, 2)}) -> outside
moving(LAWS, {"a": [(2, 2)]}) -> all of a row
moving(LAWS, {"a": [(0, 0), (0, 1)]}) -> 2 different
moving(LAWS, {"a": [(0, 0), (0, 0)]}) -> twice by one
THIRDS.at({"a": "9/10", "b": "3/10"}) -> more than 1
THIRDS.at({"a": 2}) -> outside
two_way(SMALL, "base.anger", "base.anger") -> both parameters are
two_way(SMALL, "discount", "base.confusion", ranges={"base.anger": (0, 1)}) ->
    base.anger has a range
ranges('"base.angre" = [0, 1]') -> unknown parameter 'base.angre'
ranges('"base.anger" = 0.2') -> not a pair
ranges('"base.anger" = [0.2') -> broken TOML
ranges("") -> no range
study(THIRDS, {"a": [0.5, 0.5], "b": [0.25, 0.75]}) -> more than 1; draw 1, a = 0.5, b = 0.75
study(THIRDS, {"a": [0.5], "b": [1.5]}) -> outside [0, 1]; draw 0; within its range
study(THIRDS, {"a": [0.5], "b": [np.nan]}) -> nan, no finite number; draw 0
study(THIRDS, {"a": <[1], "b": [1, 2]|[[1, 2]]>}) -> columns of shape
study(THIRDS, {"a": []}) -> at least one point
study(THIRDS, {}) -> none
study(THIRDS, {"as": [1]}) -> unknown parameter 'as'
study(YUAN, {"base.angr": [0.1]}) -> unknown parameter 'base.angr'
study(YUAN, {"base.anger": [<1.5|-1e-9>]}) -> base.anger
study(YUAN, {"discount": [1.01]}) -> discount
study(YUAN, {"reward.trial": [np.<inf|nan>]}) -> reward.trial is *
study(YUAN, {"reward.trial": [1e308], "reward.assist.directive": [-1e308]}) -> overflow
study(OPEN, {"p": [0.5, 1.25]}) -> draw 1, p = 1.25, state 0, action 0
curve(PUTERMAN, "discount", (0, "99/100")).within(1) -> no policy
HELD.within(1, 1) -> two limits
HELD.within(-1) -> 0 or more
HELD.at(1) -> outside the range
gradient(KINK, exact=False) -> several actions are optimal
curve(WAIT, "reward.5") -> some policy never ends; discount below 1
explore(TEA, "zzz") -> unknown parameter 'zzz'; model tea; base.anxiety, ; reward.assist.prompt
explore(PUTERMAN, "zzz") -> where: model
explore(TEA, ["base.anxiety"]) -> names of parameters are texts
psa(YUAN, <0|-1|5.0|True>, rng=0) -> n is *
psa(YUAN, 5, rng=<None|True|-1|1.5>) -> * is not a source
psa(YUAN, 5, effective_sample_size=np.nan) -> sample size nan
psa(YUAN, 5, uncertain=uncertainty(CARE, names=["persistence.anger"])) -> uncertain
psa(MDP.from_arrays([[[1]]], [1], "1/2"), 2) -> no parameter is uncertain
psa(BETS, 4, uncertain=OWN) -> 4 draws of a sample of 3
psa(BETS, uncertain=OWN.rename(columns={"r": "price"})) -> unknown parameter 'price'
sobol(BETS, n=<0|True>, rng=0) -> n is *
sobol(BETS, n=100, rng=0) -> not a power of 2
sobol(BETS, n=4, rng=0, n_jobs=0) -> n_jobs
sobol(BETS, n=4, rng=0).frame("loss") -> unknown output
sobol(SMALL, names=["reward.subtask-complete"], n=4, rng=0).plot(output="regret") ->
    the same at every draw
tornado(BETS).plot(fixed=True) -> there is no option fixed=
tornado(BETS).plot(output="fixd") -> did you mean fixed
cost_effectiveness(BETS, <["wait"]|{}>, 5, uncertain=SAID) -> give {name: policy}
cost_effectiveness(BETS, {}, 5, uncertain={}) -> no strategy
cost_effectiveness(BETS, {"a": "1"}, 5, effect="reward", cost="reward", uncertain=SAID) ->
    did you mean always:1?
cost_effectiveness(BETS, CHOICES, 5) -> for the base case
cost_effectiveness(BETS, CHOICES, 5, uncertain=["r"]) -> pandas.DataFrame
cost_effectiveness(BETS, CHOICES, 5, effect="qalys", uncertain=SAID) -> unknown component 'qalys'
cost_effectiveness(BETS, CHOICES, uncertain=pd.DataFrame([{"r": "much"}])) -> where: parameter r
stated("[base\n") -> broken TOML
stated("") -> nothing is stated
stated('"base.angre" = {effective_sample_size = 3}') -> base.angre
stated("base = {effective_sample = 3}") -> unknown setting 'effective_sample'
stated("<effective_sample_size|default> = 3") -> = 3; psa takes distributions
stated("default = {relative_sd = 3}") -> states more than
stated('default = {effective_sample_size = "three"}') -> 'three'
stated("base = {effective_sample_size = <0|nan|inf|1e-300>}") -> effective sample size *
stated("base = {effective_sample_size = true}") -> True
stated("reward = {effective_sample_size = 9}") -> a normal with mean, effective_sample_size
stated('reward = {distribution = "gamma"}') -> gamma with mean
stated('base = {fixed = "false"}') -> fixed is 'false'
stated("base = {fixed = true, effective_sample_size = 3}") -> fixed, and a distribution
stated("base = {relative_sd = 0.1, effective_sample_size = 3}") -> state a mean and one of
stated("reward = {relative_sd = <0|1e-200>}") -> relative standard deviation *
stated("reward = {relative_sd = 1e200}") -> 1e+200
stated(f"base = {{effective_sample_size = {10**300}}}") -> 1e+300
stated(f"base = {{effective_sample_size = {10**400}}}") -> too large for a float
stated('"base.anger" = [0.1, 0.2]') -> psa takes distributions
uncertainty(CARE, {"base": 50}) -> 50 is stated
uncertainty(CARE, {"reward": {"distribution": "gama"}}) -> gama
uncertainty(KINK, {"p": {"distribution": "uniform", "low": 0, "high": 2}}) ->
    outside of what the parameter may be
uncertainty(ROWS, {<ONE: {"effective_sample_size": 5}|TWO: {"fixed": True}>}) -> different settings
uncertainty(ROWS, {ROW: {"effective_sample_size": 5}, TWO: {"fixed": True}}) -> different settings
uncertainty(ROWS, {ROW: {"relative_sd": 0.3}}) -> are Dirichlet
uncertainty(ROWS, {"another row": {"fixed": True}}) -> unknown parameter
uncertainty(ROWS, names=[<ONE|TWO>]) -> without the others
uncertainty(replace(ROWS, rows={"a": (ONE,), "b": (ONE, TWO)})) -> appears twice
uncertainty(replace(ROWS, rows={"a": ("discount",)})) -> not a probability of a row
Uncertain.of("a", "beta", mean=1.2, sd=0.1) -> beta with mean = 1.2
Uncertain.of("a", "beta", mean=0.5, sd=0.6) -> beta with mean = 0.5, sd = 0.6
Uncertain.of("a", "beta", alpha=0, beta=2) -> alpha = 0
Uncertain.of("a", "gamma", mean=0, sd=1) -> gamma with mean = 0
Uncertain.of("a", "lognormal", mean=-1, sd=1) -> lognormal with mean = -1
Uncertain.of("a", "uniform", low=2, high=1) -> low = 2
Uncertain.of("a", "triangular", low=0, mode=3, high=1) -> mode = 3
Uncertain.of("a", "normal", mean=1) -> normal with mean
Uncertain.of("a", "normal", mean=1, sd=1, relative_sd=1) -> relative_sd
Uncertain.of("a", "normal", mean=np.inf, sd=1) -> around inf
Uncertain.of("a", "beta", mean=np.nan, effective_sample_size=9) -> around nan
Uncertain.of("a", "normal", mean=0, relative_sd=1) -> relative spread around 0
Uncertain.of("a", "gauss", mean=0, sd=1) -> 'gauss'
Uncertain.of_row("row", ("a", "b"), (1, 2)) -> 2 concentrations for 2
Uncertain.of_row("row", ("a",), (1, 0)) -> concentrations 1, 0
Uncertainty(parts=(Uncertain.of("a", "normal", mean=0, sd=1),) * 2, fixed={}) -> same name, 'a'
tradeoff(YUAN, ["anger", "x=2*angry-trial"]) -> called 'angry'
tradeoff(YUAN, ["anger", "anger"]) -> 'anger' is named twice
tradeoff(YUAN, "anger") -> front of 'anger' totals
tradeoff(YUAN, ["anger", "x="]) -> names nothing to count
tradeoff(YUAN, ["anger", "x=1/0*trial"]) -> not a finite rational
tradeoff(YUAN, ["anger", "x=2 trial"]) -> nothing to count
tradeoff(YUAN, ["anger", "forgetfulness"]) -> is no expected total
tradeoff(ROUND, ["a", "b"<|, "steps">]) -> 201 states lead to each other; horizon; subject_to
tradeoff(SMALL, ["anger", "trial", "steps"]).plot() -> no flat picture
error_costs(TURNING, "optimal", np.eye(2)) -> come back
accuracy_curves(TURNING) -> come back
error_costs(REVEALING, "optimal", np.eye(2)) -> reveal the status
accuracy_curves(REVEALING) -> reveal the status
error_costs(PUTERMAN, "optimal", np.eye(2)) -> no statuses
solve(grid(2, 3)).plot(down="nonsense") -> unknown state column 'nonsense'
solve(grid(2, 3)).plot(across=["rubbish"]) -> unknown state column 'rubbish'
solve(grid(2, 3)).plot(foo=3) -> unknown state column 'foo'
solve(grid(2, 3)).plot(shape=(2, 3), down="state") -> a shape and columns
plots.plot_policy(SMALL.compile(), "random", subtask=5) -> there is no subtask 5
plots.plot_policy(SMALL.compile(), "random", nothing=0) -> unknown state column 'nothing'
plots.plot_policy(SMALL.compile(), "random", shape=(3, 4)) -> shape
plots.plot_states(grid(2, 2), [1.0]) -> values of shape
plots.plot_states(grid(80, 60), np.zeros(4800), shape=(80, 60)) -> a map of 4,800 cells
plots.plot_transitions(grid(7, 7)) -> a graph of 49 states
dot(grid(15, 15)) -> a graph of 225 states
compare(grid(2, 2), {}) -> no policies
file_of("", lambda path: (certify(PUTERMAN).save(path), Certificate.load(path))[1]).plot() ->
    does not contain the model
"""
NAMES = {name: getattr(exact_mdp, name) for name in exact_mdp.__all__} | {"np": np, "grid": grid}


@pytest.mark.parametrize(("call", "said"), entries(REFUSED))
def test_refused(call: str, said: str) -> None:
    with pytest.raises(ModelError) as caught:
        eval(call, NAMES | globals())
    assert caught.value.where
    assert caught.value.fix
    assert [words for words in said.split("; ") if words not in str(caught.value)] == []
