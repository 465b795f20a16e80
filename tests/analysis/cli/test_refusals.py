"""What the commands refuse: nothing on standard output, status 2, and a sentence with its fix."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_runner import run
from made_models import forest
from refusal_tables import entries

from exact_mdp import MDP, save

SMALL = "yuan2025 --set tasks=[1] --set max_trial=2"
LAND = MDP.from_outcomes(
    [(0, 0, [("1/2", 1, 1), ("1/2", 2, 1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])],
    states=["here", "home", "sea"],
    labels={"home": [False, True, False], "dry": [True, True, False], "sea": [False, False, True]},
)
TABLE = """
info unknown.xyz -> unknown kind of model file
info folder.toml -> cannot read the file: a folder, not a regular file
info binary.toml -> the file is not UTF-8 text
info yuan2025 tea -> unexpected extra argument (tea)
info tea --json --markdown -> two forms of one output
info yuan2025 --set tasks -> 'tasks' is not a setting
info yuan2025 --set tasks=[] -> tasks is not a list of positive whole numbers, or is empty
info yuan2025 --set max_trial=-1 -> max_trial is '-1'
info yuan2025 --set max_trial=<1000000000|NINES> -> states, more than 200,000,000
<info yuan2025|solve yuan2025|convert yuan2025 x.npz> --set base.anger=1.1 -> base.anger is 1.1, out
info yuan2025 --set base.anger=<-0.1|-1e-400> -> base.anger is *, outside [0, 1]
info yuan2025 --set base.anger=1.0000000000000000000001 -> base.anger is 1 + 1e-22, outside [0,
info yuan2025 --set base.anger=often -> where: parameter base.anger
info yuan2025 --set <base.joy|reward.assist.hug>=0.1 -> unknown parameter '*'
info yuan2025 --set readings.trial_cost=never -> unknown option 'never'
info yuan2025 --discount 1.0000000000000000000001 -> discount is 1 + 1e-22, outside [0, 1]
info forest.npz --set tasks=[1] -> the model is not a scenario
solve -> Missing argument 'MODEL'
solve broken.toml -> broken TOML: Unterminated string
<solve|evaluate yuan2025> truncated.npz -> not a readable NumPy array
check yuan2025 broken.npz -> not a readable NumPy array
solve yuan2025 --discount=-1/2 -> discount is -0.5, outside [0, 1]
solve yuan2025 --method -> Option '--method' requires an argument
solve yuan2025 --method simplex -> unknown method 'simplex'
solve lake --out x.npz --policy-out x.csv --method backward-induction -> a model without cycles
solve yuan2025 --out values.csv -> cannot write .csv here
solve yuan2025 --policy-out policy.npz -> cannot write .npz here
solve yuan2025 --policy-out x.json --certificate x.json -> two results go to one file
<convert yuan2025|check yuan2025 zeros.npy --junit> x.txt -> cannot write .txt here
<solve yuan2025 --out|convert yuan2025> nowhere/x.npz -> there is no such folder
check yuan2025 zeros.npy --junit nowhere/report.xml -> there is no such folder
convert tea folder.npz -> folder.npz
evaluate yuan2025 greedy -> unknown kind of policy 'greedy'
<evaluate tea x.csv|verify x.json tea> -> cannot read the file: No such file or directory
evaluate yuan2025 missing.csv -> 1 of 16 rows are missing: status 0000
evaluate yuan2025 doubled.csv -> where: doubled.csv, line 3
evaluate yuan2025 action.json -> unknown action 'hug'
evaluate yuan2025 shape.npy -> an array of shape (3, 3) is no policy of this model
check yuan2025 broken.json -> broken JSON
check yuan2025 nan.npy -> an action value is NaN
check yuan2025 truncated.npy -> not a readable NumPy array
check yuan2025 directive -> unknown kind of policy 'directive'
check yuan2025 -> Missing argument 'LEARNED...'
check yuan2025 optimal --limit 1 -> No such option '--limit'
returns yuan2025 random --discount 0.95 -> discount 19/20 gives returns that are not on a lattice
simulate yuan2025 random -> Missing option '--episodes'
simulate yuan2025 random --episodes <0|-5|9999999999> -> * is not in the range 1<=x<=1000000000
simulate yuan2025 random --episodes 10 --seed lucky -> 'lucky' is not a valid integer range
simulate yuan2025 random --episodes 10 --seed=-1 -> where: --seed
verify yuan2025 action.json -> verify CERTIFICATE MODEL
verify truncated.json yuan2025 -> not a certificate, which is JSON text
gradients small -> gradients
<gradient|threshold|tornado> small --parameter base.angre -> unknown parameter
tornado small --range base.angre=0:1 -> unknown parameter
tornado small --range base.anger=<0.1|0:0.1:0.2> -> not a pair of numbers
<tornado|threshold|sobol> small --range base.anger=0.2:0.1 -> empty
<threshold|sobol> small --range base.anger=0.2:0.2 -> empty
<tornado|threshold|sobol> small --range base.anger=0:1.5 -> outside [0, 1]
tornado small --relative 0 -> share
threshold small --range nowhere.toml -> nowhere.toml
sobol small --samples <0|1> -> * is not in the range 2<=x<=16777216
sobol small --samples 1000 -> not a power of 2
sobol small --samples many -> where: --samples
<sobol|psa|train> small --seed -1 -> --seed
<sobol|psa|train> small --n-jobs 0 -> --n-jobs
<sobol|psa> small --parameter base.angre -> did you mean base.anger
sobol small --parameter assistance.supportive.anger.onset -> gives no range
sobol small --range base.anger -> is not NAME=LOW:HIGH
<sobol|psa> small --policy always:nothing -> nothing
sobol small --out ' ' -> --out is empty
psa small --samples 0 -> --samples
psa small --effective-sample-size <0|-1> -> effective sample size *
psa small --effective-sample-size many -> not a finite rational
psa small --uncertain none.toml -> none.toml
psa small --uncertain uncertain.toml -> did you mean base.anger
psa small --uncertain uncertain.toml -> uncertain.toml
robust small --radius -1 -> where: --radius
robust small --set-kind box --radius 1 -> --radius does not apply to a box
robust small --set-kind box --relative 0 -> above 0
robust land.npz --set-kind box -> no parameter moves
robust small --set-kind ball -> --set-kind
robust gymnasium:FrozenLake-v1 --discount 1 -> every episode to end
robust small --set-kind box --parameter base.angr -> base.angr
robust small --set-kind kl --range base.anger=0:1 -> add --set-kind box
robust small --set-kind box --range base.anger=1:0 -> empty
gradient tea --range a=0:1 -> No such option '--range'
psa tea --whole -> No such option '--whole'
curve tea --samples 4 -> No such option '--samples'
threshold tea --policy random -> No such option '--policy'
gradient tea --range a=0:1 -> exact-mdp gradient --help
curve tea <|--parameter discount --parameter base.anxiety> -> --parameter NAME
<one-way tea|two-way tea --parameter base.anger> -> parameters, and
explore tea --html p.html -> --parameter
explore tea --parameter base.anxeity --html p.html -> base.anxiety
explore tea --parameter base.anxiety --html p.txt -> .html
explore tea --parameter base.anxiety --parameter base.anxiety --html p.html -> name one or two
explore tea --parameter reward.assist.wait --html p.html -> state a range
explore tea --parameter base.anxiety --points 1 --html p.html -> --points
explore tea always:sing --parameter base.anxiety --html p.html -> sing
check tea random --gamma 0.9 -> Did you mean '--discount'?
check tea random --plot p.png -> Did you mean '--html'?
check FrozenLake-v1 random -> did you mean gymnasium:FrozenLake-v1?
solve land.npz --horizon <0|-1|1.5|x|''|1e3|true|NINES|1000000000> -> horizon
risk small -> --cvar
risk small --cvar 0 -> above 0
risk small --cvar 1/2 --discount 1/2 -> discount 1
solve land.npz --reach hom -> did you mean home
solve land.npz --reach '' -> unknown label
solve land.npz --reach home --allowed sea -> is not among the allowed states
solve land.npz --reach home --until home -> two questions
solve land.npz --until home --reward time -> no reward component 'time'
solve land.npz --reward time -> --until LABEL
solve land.npz --allowed dry -> --reach LABEL
solve land.npz --start nowhere -> unknown state 'nowhere'
<solve forest.npz|check forest.npz random> --criterion mean -> unknown criterion 'mean'
<solve forest.npz|check forest.npz random> --criterion average --horizon 5 -> no horizon
solve forest.npz --criterion average --certificate proof.json -> add --certify
solve forest.npz --criterion average --method gauss-seidel -> does not apply to an average
<solve yuan2025|check yuan2025 optimal> --subject-to anger -> is no limit
<solve yuan2025|check yuan2025 optimal> --subject-to 'anger > 1' -> is no limit
<solve yuan2025|check yuan2025 optimal> --subject-to 'angre >= 1' -> angre
tradeoff yuan2025 anger -> front of 1 totals
tradeoff yuan2025 anger angre -> angre
tradeoff yuan2025 anger trial steps skip -> front of 4 totals
perception yuan2025<| --accuracy 0.9 --perception x.csv> -> no perception, or two
perception yuan2025 --accuracy 2 -> accuracy is 2
perception yuan2025 --accuracy 1.5 -> where: --accuracy
psa gymnasium:FrozenLake-v1 --discount 0.9 --perception seen.csv -> no statuses
train yuan2025 --epsilon falling -> not a finite rational
train yuan2025 <--epsilon 1.5|--learner=rate=2> -> between 0 and 1
train yuan2025 --seeds 0 -> --seeds
train yuan2025 --learner=epochs=<many|1/2|-1> -> where: --learner epochs
train yuan2025 --learner=bootstrap_end=maybe -> where: --learner bootstrap_end
train yuan2025 --learner=method=q -> method
train yuan2025 --learner=columns=state -> unknown state column
train yuan2025 --learner=discount=2 -> outside [0, 1]
check two.npz optimal --share 1/2 -> --share does not apply to a single policy
check two.npz optimal --prove -> --prove does not apply to a single policy
check two.npz optimal random random --html page.html -> --html does not apply to several policies
check two.npz optimal random random --no-explain -> --no-explain does not apply
check ill.npz always:a <--by robust|--evidence prior=2> -> does not apply to a check without
check ill.npz always:a --confidence 0.9 --evidence prior=2 -> does not apply to robust
check ill.npz always:a --confidence 0.9 --evidence rewards=<5|0,x> -> no range
check ill.npz always:a --confidence 0.9 --by posterior --evidence n=x -> where: --evidence n
check ill.npz always:a by --evidence=records=none.csv -> none.csv
check ill.npz always:a by records --evidence=behaviour=always:a -> the behaviour never does what was
check ill.npz always:a by records --evidence=behaviour=always:b -> never does what the policy does
check yuan2025 random --max-<regret|relative-regret> BEYOND -> where: --max-*
<check yuan2025 random|solve yuan2025> --discount BEYOND -> where: --discount
solve yuan2025 --tol BEYOND -> where: --tol
train tea --seeds 1 --learner epochs=2 --learner discount=BEYOND -> where: --learner, discount
train tea --seeds 1 --learner epochs=2 --learner rate=BEYOND -> where: --learner rate
train tea --seeds BEYOND -> where: --seeds
simulate tea random --episodes BEYOND -> where: --episodes
robust tea <--radius|--set-kind kl --radius> BEYOND -> where: --radius
<threshold|tornado> tea --relative BEYOND -> where: --relative
data semicolons.csv --discount=0.9 --out=other.npz -> no column 'episode'
data ward.csv --discount=0.9 --out=other.npz -> --column state=
"""
BEYOND = "<nan|1e400|1e999|NINES>"
SHORT = {
    "NINES": "9" * 5000,
    " lake ": " gymnasium:FrozenLake-v1 --discount 0.9 ",
    " small": f" {SMALL}",
    " by ": " --confidence=.9 --by=off-policy --evidence=rewards=0,1 ",
    " records ": " --evidence=records=records.csv ",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("refusals")
    rows = [(n, "ill", ("a", "b")[n % 2], n // 2 % 2, None) for n in range(80)]
    names = ["episode", "state", "action", "reward", "next_state"]
    pd.DataFrame(rows, columns=names).to_csv(place / "records.csv", index=False)
    text = (place / "records.csv").read_text("utf-8")
    (place / "semicolons.csv").write_text(text.replace(",", ";"), "utf-8")
    (place / "ward.csv").write_text(text.replace("state", "ward", 1), "utf-8")
    (place / "uncertain.toml").write_text('["base.angre"]\neffective_sample_size = 10\n')
    labels = [f"{s:04b}" for s in range(16)]
    lines = [f"{s}," + ",".join("1" if s == t else "0" for t in labels) for s in labels]
    (place / "seen.csv").write_text("\n".join(["status," + ",".join(labels), *lines]) + "\n")
    two = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]], layout="ass")
    models = {"land": LAND, "forest": forest("9/10"), "two": two}
    models["ill"] = MDP.from_transitions(place / "records.csv", "1/2")
    for name, mdp in models.items():
        save(mdp, place / f"{name}.npz")
    rows = [f"{label},none" for label in labels]
    for name, text in {
        "broken.toml": 'name = "broken',
        "missing.csv": "\n".join(["status,action", *rows[1:]]),
        "doubled.csv": "\n".join(["status,action", rows[0], *rows]),
        "action.json": json.dumps(dict.fromkeys(labels, "hug")),
        "broken.json": '{"0000": ',
        "truncated.json": '{"format": "exact-mdp certificate",',
        "unknown.xyz": "",
    }.items():
        (place / name).write_text(text, "utf-8")
    (place / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (place / "broken.npz").write_bytes(b"PK\x03\x04 not an archive")
    np.save(place / "shape.npy", np.zeros((3, 3)))
    np.save(place / "zeros.npy", np.zeros((16, 4)))
    np.save(place / "nan.npy", np.full((16, 4), np.nan))
    for whole, part in (("forest.npz", "truncated.npz"), ("zeros.npy", "truncated.npy")):
        content = (place / whole).read_bytes()
        (place / part).write_bytes(content[: len(content) // 2])
    for name in ("folder.toml", "folder.npz"):
        (place / name).mkdir()
    return place


@pytest.mark.parametrize(("line", "said"), entries(TABLE.replace("BEYOND", BEYOND)))
def test_refused(line: str, said: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = sorted(folder.iterdir())
    monkeypatch.chdir(folder)
    for short, whole in SHORT.items():
        line = line.replace(short, whole, 1)
    assert said in run(line).refusal()
    assert sorted(folder.iterdir()) == before
