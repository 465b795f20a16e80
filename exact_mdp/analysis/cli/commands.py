"""What can be typed after `exact-mdp`: each command with its arguments, options and help text.

Nothing heavy is imported here, so that help comes at once. To add a command, declare it here and
write the function that `does` names, which takes the options by name and returns a `Report`
(`exact_mdp.analysis.cli.render`); its module is imported when the command runs.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import wraps
from importlib import import_module
from typing import Any

import click

Function = Callable[..., Any]
Options = Callable[[Function], Function]

HERE = "exact_mdp.analysis.cli"
HELP = ["-h", "--help"]

POLICY_HELP = """POLICY is optimal, random, always:ACTION, or a file: .json {"0000": "none", ...};
.csv with the header status,action; .npy or .npz with a Q-table or with probabilities of actions
(--kind q, --kind policy; auto reads an array as probabilities if the row of each state with a
choice is a distribution, and refuses it if its greedy policy would differ)."""

PERCEPTION_HELP = (
    "The policy acts on a perceived status: a confusion matrix as .csv, or .toml with sensitivity "
    "and specificity, or labelled examples (.csv true,perceived; .jsonl)."
)


def command(
    does: str, help_line: str, *, epilog: str | None = None
) -> Callable[..., click.Command]:
    """Make a command of a function that holds only its help text.

    What it does is the "module:function" of this package in `does`; `help_line` lists it.
    """
    module, _, name = does.partition(":")

    def declare(function: Function) -> click.Command:
        @wraps(function)
        def work(*, as_json: bool, as_markdown: bool = False, **options: Any) -> int:
            aside = import_module("exact_mdp.mdp.io.files").aside
            try:
                with aside():  # a module of the user's may print: the result is printed below
                    report = getattr(import_module(f"{HERE}.{module}"), name)(**options)
            except click.exceptions.Exit as end:  # not of --help, but of code that was called
                sys.exit(end.exit_code)
            show = import_module(f"{HERE}.render").show
            status: int = show(report, as_json=as_json, as_markdown=as_markdown)
            return status

        settings = {"help_option_names": HELP}
        return click.command(short_help=help_line, epilog=epilog, context_settings=settings)(work)

    return declare


def together(*options: Options) -> Options:
    """Return several options as one decorator."""

    def add(function: Function) -> Function:
        for option in reversed(options):
            function = option(function)
        return function

    return add


# ---- options that commands share ---------------------------------------------------------------

as_json = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
of_model = together(
    click.option(
        "--set",
        "sets",
        multiple=True,
        metavar="KEY=VALUE",
        help="Change a scenario: base.anger=1/10, tasks=[3,1], readings.NAME=OPTION. "
        "May be repeated.",
    ),
    click.option(
        "--discount", metavar="G", help="Discount instead of the model's own: 0.95 or 19/20."
    ),
    as_json,
)
horizon = click.option(
    "--horizon", metavar="N", help="Stop every episode after N steps, without a further reward."
)
criterion = click.option(
    "--criterion",
    default="total",
    metavar="total|average",
    help="What counts: the total reward (the default), or the average reward per step in the long "
    "run, whatever the discount.",
)
subject_to = click.option(
    "--subject-to",
    "subject_to",
    multiple=True,
    metavar="'NAME >= X'",
    help="Keep an expected total at least (>=) or at most (<=) at X: of a component of the reward, "
    "steps, an event, or a sum such as 2*a-b. Exact. May be repeated.",
)
of_policy = together(
    click.option(
        "--kind",
        default="auto",
        metavar="q|policy|auto",
        help="What a .npy or .npz file holds: a Q-table, or probabilities of actions.",
    ),
    click.option("--perception", metavar="FILE", help=PERCEPTION_HELP),
    horizon,
)
question = together(
    click.option("--reach", metavar="LABEL", help="Ask for the probability of reaching a label."),
    click.option("--until", metavar="LABEL", help="Ask for the expected reward until a label."),
    click.option("--reward", metavar="NAME", help="The reward component that counts until then."),
    click.option("--allowed", metavar="LABEL", help="Reach it through states of this label only."),
    click.option("--minimize", is_flag=True, help="Minimise: rewards are costs."),
    click.option("--start", metavar="STATE", help="Start in this state, a number or a name."),
)
of_interval = together(
    click.option(
        "--confidence",
        metavar="C",
        help="Of a model from records: decide by an interval at this confidence, such as 0.95.",
    ),
    click.option(
        "--by",
        metavar="KIND",
        help="What makes the interval: robust (the default), posterior or off-policy.",
    ),
    click.option(
        "--rewards",
        metavar="known|LOW,HIGH",
        help="Rewards are known functions of state, action and next state, or lie in this range; "
        "robust and off-policy need one of these.",
    ),
    click.option(
        "--returns",
        metavar="LOW,HIGH",
        help="Where the total reward from any state lies; needed at discount 1.",
    ),
    click.option("--prior", metavar="X", help="posterior: observations a row begins with (1)."),
    click.option(
        "--draws", metavar="N", help="posterior, off-policy: models drawn, or bootstraps (2000)."
    ),
    click.option("--seed", metavar="S", help="posterior, off-policy: seed of the draws (0)."),
    click.option(
        "--n-jobs",
        metavar="N",
        help="posterior: processes (1). Results do not change.",
    ),
    click.option(
        "--records", metavar="FILE", help="off-policy: the trajectories, .csv or .parquet."
    ),
    click.option(
        "--column",
        "columns",
        multiple=True,
        metavar="NAME=COLUMN",
        help="off-policy: what FILE calls episode, state, action, reward, next_state or truncated.",
    ),
    click.option(
        "--behaviour",
        metavar="POLICY",
        help="off-policy: the policy that chose the recorded actions, a .npy of its probabilities; "
        "estimated unless given.",
    ),
)
model = click.argument("model")
policy = click.argument("policy")


# ---- a scenario of one's own -------------------------------------------------------------------


@command("scenario:new", "Write a commented scenario to change.")
@click.argument("file")
@as_json
def new() -> None:
    """Write FILE, a .toml scenario with every key explained, which solves as it is."""


@command("scenario:lint", "List all problems of a scenario file.")
@click.argument("file")
@as_json
def lint() -> None:
    """List all problems of the scenario FILE, with their lines; exit status 1 where there are any.

    An error keeps the scenario from being read; a warning is about numbers that can be read, and
    are probably not what was meant.
    """


# ---- the model itself --------------------------------------------------------------------------


@command("model:info", "Sizes, discount, whether every policy ends.")
@model
@of_model
def info() -> None:
    """Describe MODEL: sizes, discount, whether every policy ends, whether it is acyclic."""


@command("model:data", "Estimate a model from recorded transitions.")
@click.argument("file", metavar="FILE")
@click.option("--out", required=True, metavar="MODEL", help="Where the model is written: .npz.")
@click.option("--discount", metavar="G", help="The model's discount; 1 unless given.")
@click.option(
    "--column",
    "columns",
    multiple=True,
    metavar="NAME=COLUMN",
    help="What the file calls episode, state, action, reward, next_state or truncated. May be "
    "repeated.",
)
@click.option(
    "--unseen",
    metavar="unavailable|pessimistic|V",
    help="An action that nobody took in a state is left out there (unless given), or it is worth "
    "as little as a policy can be worth, or V.",
)
@click.option(
    "--rare", metavar="N", help="List the pairs observed fewer than N times; 5 unless given."
)
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def data() -> None:
    """Estimate a model from FILE, a .csv or .parquet with a row for each transition.

    The columns are episode, state, action, reward and next_state, in the order of time, one episode
    after the other; without a next state the episode is over. A sixth column, truncated (true or
    false), marks the rows after which an episode was cut off, as by a time limit; --column
    truncated=NAME where it is called otherwise. The numbers of observations are kept in the model.
    """


@command("model:convert", "Write a model in another format.")
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@click.option(
    "--constants", metavar="A=1,B=2", help="What a .prism or .jani file leaves open (extra models)."
)
@of_model
def convert() -> None:
    """Read the model IN and write it to OUT: .npz and .umb keep all of it.

    IN may also be a .prism or .jani file, which Storm builds.
    """


# ---- its optimum -------------------------------------------------------------------------------


@command("solve:solve", "Optimal value and policy, with a bound or a proof.")
@model
@of_model
@horizon
@question
@criterion
@click.option(
    "--method",
    default="auto",
    metavar="NAME",
    help="value-iteration, gauss-seidel, modified-policy-iteration, policy-iteration, "
    "backward-induction, linear-program or auto (the default).",
)
@click.option("--tol", metavar="X", help="Greatest absolute error of a value.")
@click.option("--certify", is_flag=True, help="Compute and prove the exact optimum.")
@subject_to
@click.option("--policy-out", metavar="FILE", help="Write the policy: .csv or .json.")
@click.option("--out", metavar="FILE", help="Write values, policy and action values: .npz.")
@click.option(
    "--certificate",
    metavar="FILE",
    help="Write a proof for `verify`: .json; of the exact optimum with --certify or under limits, "
    "else of bounds.",
)
def solve() -> None:
    """Find an optimal policy of MODEL and its value, with an error bound that is sound.

    With --certify the optimum is also computed in rational arithmetic, and proved. The result says
    whether an optimal policy needs the status alone, unless bounds without a proof leave that open.
    With --horizon episodes stop, and the optimal policy depends on the time. With --subject-to the
    optimum under limits is exact, with its policy, which may draw its actions, and the price of
    each limit; the exit status is 1 where no policy keeps the limits.
    """


@command("verify:verify", "Check a certificate of an optimum or a front.")
@click.argument("certificate")
@model
@horizon
@question
@of_model
def verify() -> None:
    """Check that CERTIFICATE proves the optimum of MODEL; exit status 1 where it does not.

    It is what solve wrote, with limits or without, or tradeoff: a front then. The checker imports
    no solver.
    """


# ---- one policy --------------------------------------------------------------------------------


@command(
    "evaluate:evaluate",
    "Mean, spread, steps, reward components and quantiles of a policy.",
    epilog=POLICY_HELP,
)
@model
@policy
@click.option(
    "--quantiles/--no-quantiles",
    default=True,
    help="Whether to compute the quantiles, which can take long in large models.",
)
@criterion
@of_policy
@question
@of_model
def evaluate() -> None:
    """Compute the mean return of POLICY in MODEL, its spread, and what it is made of."""


@command(
    "evaluate:returns",
    "The exact distribution of a policy's return, at discount 1.",
    epilog=POLICY_HELP,
)
@model
@policy
@click.option("--exact", is_flag=True, help="Give the probabilities as rationals, too.")
@of_policy
@question
@of_model
def returns() -> None:
    """Compute the probability of every return that POLICY can have in MODEL, at discount 1."""


@command(
    "evaluate:simulate",
    "An estimate of a policy's mean return by simulation.",
    epilog=POLICY_HELP,
)
@model
@policy
@click.option("--episodes", required=True, metavar="N", help="Number of episodes.")
@click.option("--seed", default="0", metavar="S", help="Seed of the random numbers (0).")
@of_policy
@question
@of_model
def simulate() -> None:
    """Estimate the mean return of POLICY in MODEL from N episodes."""


@command(
    "trainer:check",
    "Audit a learned policy or Q-table; exit status 1 if it loses too much.",
    epilog=POLICY_HELP,
)
@model
@click.argument("learned", nargs=-1, required=True)
@click.option("--max-regret", metavar="X", help="Greatest regret at the start: 0.1 or 1/10.")
@click.option(
    "--max-relative-regret", metavar="X", help="Greatest regret over the absolute optimal value."
)
@click.option("--markdown", "as_markdown", is_flag=True, help="Print Markdown.")
@click.option("--html", metavar="FILE", help="Write a page with the picture of the policy: .html.")
@click.option("--junit", metavar="FILE", help="Write a JUnit report: .xml.")
@subject_to
@click.option(
    "--share", metavar="X", help="Of several: the least share of all runs within the limits (9/10)."
)
@click.option(
    "--alpha", metavar="X", help="Of several: greatest chance of a wrong failure (1/100)."
)
@click.option("--prove", is_flag=True, help="Of several: fail a share that is still open.")
@click.option("--certify", is_flag=True, help="Use rational arithmetic, however long it takes.")
@click.option(
    "--no-explain", is_flag=True, help="Do not say what the policy's columns cannot express."
)
@of_interval
@criterion
@of_policy
@question
@of_model
def check() -> None:
    """Compare LEARNED, a policy or Q-table, with the exact optimum of MODEL.

    The check passes if the regret at the start is within the limits; if bounds leave that open, it
    fails. Without a limit it passes if the regret is zero: exactly, or up to what half a unit in
    the last place of the model's floats can cause. --max-regret 0 forgives nothing.
    LEARNED is a POLICY; a Q-table stands for its greedy policy. With --subject-to it has to keep
    the limits too, the regret is against the best policy that keeps them, and nothing is forgiven.

    Several LEARNED are the policies of independent runs of one trainer. They are audited one after
    the other until it is decided whether at least --share of all runs are within the limits; a
    share that is still open passes, so that a trainer that is good enough fails with probability
    --alpha at most, wherever it stops.

    With --confidence, MODEL is one that `exact-mdp data` made, and the check passes where the upper
    end of an interval for the regret in the process behind the records keeps the limit.
    """


@command("train:train", "Q-learning by sampling, judged by exact values.")
@model
@click.option(
    "--epsilon",
    default="constant",
    metavar="SCHEDULE",
    help="constant (0.1, the default), decaying (0.03 + 0.97 exp(-λt), 0.8 at epoch 300), or a "
    "number from 0 to 1.",
)
@click.option("--seeds", default="40", metavar="N", help="Number of runs (40).")
@click.option("--seed", default="0", metavar="S", help="Seed of the random numbers (0).")
@click.option(
    "--out",
    metavar="DIR",
    help="Folder for finished runs; runs that are there already are not repeated.",
)
@click.option(
    "--method",
    default="q-learning",
    metavar="NAME",
    help="q-learning (the default), sarsa, expected-sarsa or double-q-learning.",
)
@click.option("--epochs", default="6000", metavar="N", help="Epochs of a run (6000).")
@click.option("--episodes", default="30", metavar="N", help="Episodes of an epoch (30).")
@click.option("--rate", default="0.05", metavar="X", help="Learning rate (0.05).")
@click.option(
    "--rate-power", default="0", metavar="X", help="Rate of the n-th update: rate · n^-X (0)."
)
@click.option(
    "--learning-discount", default="0.95", metavar="G", help="The learner's discount (0.95)."
)
@click.option(
    "--columns",
    metavar="NAMES",
    help="What the learner reads: all, or columns separated by commas, such as trial,status. The "
    "default is the status, where there is one.",
)
@click.option("--initial", default="0", metavar="X", help="First value of every entry (0).")
@click.option(
    "--ties",
    default="first",
    metavar="RULE",
    help="Which of equal values is greedy: first (the default), last or random.",
)
@click.option(
    "--bootstrap-end", is_flag=True, help="Bootstrap from the end, as if the episode went on."
)
@click.option("--max-steps", default="10000", metavar="N", help="Cut longer episodes (10000).")
@click.option("--jobs", metavar="N", help="Number of threads (all cores). Does not change results.")
@of_model
def train() -> None:
    """Train on MODEL as Yuan et al. (2025) do, and compute the exact values of the policies.

    Regret is that of the final greedy policies, at the model's discount, over the seeds.
    """


# ---- its parameters ----------------------------------------------------------------------------


parameters = click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME",
    help="Vary only this parameter. May be repeated. The default is all that MODEL has.",
)
spans = together(
    click.option(
        "--range",
        "ranges",
        multiple=True,
        metavar="NAME=LOW:HIGH",
        help="Vary a parameter from LOW to HIGH. May be repeated.",
    ),
    click.option(
        "--relative", metavar="X", help="Other ranges: today's value ± this share of it (0.2)."
    ),
    click.option("--whole", is_flag=True, help="Other ranges: all that a parameter may be."),
)
range_file = click.option(
    "--ranges", "range_file", metavar="FILE", help="A .toml file with ranges, NAME = [low, high]."
)
held = together(
    click.option(
        "--policy",
        metavar="POLICY",
        help="The policy held fixed, whose value and regret are shown (the optimal one).",
    ),
    click.option(
        "--perception",
        metavar="FILE",
        help=f"{PERCEPTION_HELP} This holds for the policy held fixed; the optimum that it is "
        "compared with knows the status. Values are exact for the probabilities as rounded to "
        "floats.",
    ),
)
drawn = together(
    click.option("--seed", metavar="S", help="Seed of the draws (0)."),
    click.option(
        "--n-jobs", metavar="N", help="Number of processes (all cores). Does not change results."
    ),
    click.option(
        "--out",
        metavar="DIR",
        help="Folder for finished work and the result; work that is there already is not repeated.",
    ),
)


@command("sensitivity.one_way:gradient_report", "Derivatives by parameter.", epilog=POLICY_HELP)
@model
@parameters
@held
@question
@of_model
def gradient() -> None:
    """Compute the derivative of MODEL's start value by each parameter, and its elasticity.

    They are those of the optimum, or of the --policy held fixed. Where the optimal policy changes
    at today's value, both one-sided derivatives are given.
    """


@command("sensitivity.one_way:tornado_report", "Values at both ends of ranges.", epilog=POLICY_HELP)
@model
@parameters
@spans
@range_file
@held
@question
@of_model
def tornado() -> None:
    """Compute the start value at both ends of each parameter's range, and a policy's regret there.

    One parameter moves at a time, the others stay at today's values.
    """


@command("sensitivity.one_way:threshold_report", "Where an optimal action changes.")
@model
@parameters
@spans
@range_file
@question
@of_model
def threshold() -> None:
    """Find every value of a parameter within its range at which an optimal action changes.

    One parameter moves at a time. The policy is optimal knowing the state at every value.
    """


@command("sensitivity.curve:curve_report", "The value as an exact curve.", epilog=POLICY_HELP)
@model
@parameters
@spans
@range_file
@click.option("--max-regret", metavar="X", help="Where the policy loses at most X: 0.1 or 1/10.")
@click.option(
    "--max-relative-regret", metavar="X", help="The same, over the absolute optimal value."
)
@held
@question
@of_model
def curve() -> None:
    """Compute MODEL's optimal value as an exact function of one --parameter, piece by piece.

    With --max-regret, also for which values the policy held fixed keeps within that limit. The
    parameter moves over all that it may be, unless it is given a range.
    """


points = click.option("--points", metavar="N", help="Values along each range, ends included.")


@command("sensitivity.grids:one_way_report", "Values along one parameter.", epilog=POLICY_HELP)
@model
@parameters
@spans
@range_file
@points
@held
@question
@of_model
def one_way() -> None:
    """Compute the start value at evenly spaced values of one --parameter.

    The policy is optimal at each of the 21 values (or --points), and held fixed beside it.
    """


@command("sensitivity.grids:two_way_report", "Values over two parameters.", epilog=POLICY_HELP)
@model
@parameters
@spans
@range_file
@points
@held
@question
@of_model
def two_way() -> None:
    """Compute the start value, and which policy is optimal, over a grid of two parameters.

    Give --parameter twice: the first lies across, the second along. Each has 11 values, or
    --points.
    """


@command("sensitivity.psa:psa_report", "Probabilistic sensitivity analysis.", epilog=POLICY_HELP)
@model
@parameters
@click.option(
    "--ranges", "range_file", metavar="FILE", help="A .toml file with distributions by name."
)
@click.option("--samples", metavar="N", help="Draws (10000; 500 of slow models).")
@click.option(
    "--effective-sample-size",
    metavar="X",
    help="Number of observations behind each probability (100), or a .toml file with this "
    "number by name.",
)
@drawn
@held
@question
@of_model
def psa() -> None:
    """Draw MODEL's numbers from distributions: value, regret and optimal actions over the draws.

    The policy held fixed is judged by how likely it is to lose at most so much, and by what better
    numbers would be worth (EVPI, EVPPI).
    """


@command("sensitivity.sobol:sobol_report", "Shares of the variance.", epilog=POLICY_HELP)
@model
@parameters
@spans
@range_file
@click.option("--samples", metavar="N", help="Points of the sequence, a power of 2 (1024).")
@drawn
@held
@question
@of_model
def sobol() -> None:
    """Compute which parameters decide the start value, alone and together with others.

    First-order and total indices of Sobol, of the optimum and of a policy's regret, with intervals.
    All parameters but the discount vary unless some are named.
    """


@command("sensitivity.robust:robust_report", "Worst case of wrong tables.", epilog=POLICY_HELP)
@model
@click.option(
    "--set-kind",
    type=click.Choice(["interval", "absolute", "l1", "kl", "entropy", "box"]),
    help="What may move (interval): each probability by a share or an absolute amount, each row "
    "within a distance (l1, kl, entropy), or the tables' numbers (box).",
)
@click.option("--radius", metavar="X", help="How far it may move; at most 2 for l1.")
@parameters
@spans
@range_file
@held
@question
@of_model
def robust() -> None:
    """Compute the value against the worst numbers within sets around MODEL's tables.

    And the policy that is best against them, with the price of that where the tables are right.
    Parameters and ranges are those of a box.
    """


@command(
    "explore:explore",
    "A page on which a parameter moves, and the optimum with it.",
    epilog=POLICY_HELP,
)
@model
@click.argument("policy", required=False)
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    required=True,
    metavar="NAME",
    help="The parameter that moves. A second one moves in steps.",
)
@click.option("--html", required=True, metavar="FILE", help="Write the page: .html.")
@click.option(
    "--range",
    "ranges",
    multiple=True,
    metavar="NAME=LOW:HIGH",
    help="Move a parameter from LOW to HIGH; otherwise by ± 20 %. May be repeated.",
)
@click.option("--relative", metavar="X", help="Another share than 0.2.")
@click.option("--whole", is_flag=True, help="All values that the parameters may take.")
@click.option("--grid", default="11", metavar="N", help="Values of the second parameter (11).")
@click.option(
    "--kind",
    default="auto",
    metavar="q|policy|auto",
    help="What a .npy or .npz file holds: a Q-table, or probabilities of actions.",
)
@question
@of_model
def explore() -> None:
    """Write one page that shows how MODEL's optimum moves with a parameter, and POLICY's regret.

    The pieces between the switching points are worked out beforehand, in rational arithmetic, so
    that the page needs no server and shows exact values; it says which of them are certified.
    """


@command(
    "perception:perception",
    "What errors of perception cost, and which accuracy would be enough.",
    epilog=POLICY_HELP,
)
@model
@click.option(
    "--perception",
    metavar="FILE",
    help="A confusion matrix as .csv; .toml with sensitivity and specificity; labelled examples as "
    ".csv (true,perceived) or the .jsonl of a recording.",
)
@click.option(
    "--accuracy", metavar="X", help="Each status is read correctly with this probability instead."
)
@click.option(
    "--prior",
    metavar="X",
    help="Pseudo-count of each cell, where the file holds examples; adds a credible interval.",
)
@click.option("--draws", default="2000", metavar="N", help="Draws for that interval (2000).")
@click.option("--seed", default="0", metavar="S", help="Seed of the draws (0).")
@click.option(
    "--policy",
    default="optimal",
    metavar="POLICY",
    help="The policy that takes what is perceived for true (optimal).",
)
@of_model
def perception() -> None:
    """Compute what acting on a perceived status costs in MODEL.

    The value where the status is known, and where the policy takes what it perceives for true; then
    which errors cost most.
    """


@command(
    "tradeoff:tradeoff", "The exact front of two or three expected totals.", epilog=POLICY_HELP
)
@model
@click.argument("names", nargs=-1, required=True, metavar="A B [C]")
@click.option(
    "--policy",
    "policies",
    multiple=True,
    metavar="POLICY",
    help="A policy to place beside the front, with its distance. May be repeated.",
)
@click.option("--certificate", metavar="FILE", help="Write the proof for `verify`: .json.")
@horizon
@of_model
def tradeoff() -> None:
    """Compute the exact Pareto front of the expected totals A, B and C from MODEL's start.

    Each is a component of the reward, steps, an event, a label that is not left again, or a sum:
    name=2*a-b. The front maximises all of them; in a model of costs it minimises them.
    """


@command(
    "tradeoff:rationalize",
    "The least change of the weights that makes a policy optimal.",
    epilog=POLICY_HELP,
)
@model
@policy
@of_policy
@of_model
def rationalize() -> None:
    """Compute for which weights of the reward's components POLICY would be optimal in MODEL.

    The least relative change of the weights, exactly, with its proof; and for each component the
    interval of its weight that does it alone, the others unchanged. Multipliers are of today's
    weights. A change of 1 can make all weights zero: no smaller change makes the policy optimal.
    """


@command("tradeoff:risk", "The best policy for bad episodes.", epilog=POLICY_HELP)
@model
@click.option(
    "--cvar",
    "level",
    required=True,
    metavar="SHARE",
    help="The mean return of this share of the episodes, the worst: 0.1 or 1/10.",
)
@click.option(
    "--policy",
    "policies",
    multiple=True,
    metavar="POLICY",
    help="A policy to place beside the best ones. May be repeated.",
)
@click.option(
    "--policy-out",
    metavar="FILE",
    help="Write the policy: .csv or .json; by state and reward so far.",
)
@horizon
@of_model
def risk() -> None:
    """Find the best policy of MODEL for the worst share of the episodes, exactly.

    MODEL has discount 1 and no cycles, or a horizon. The answer is the policy with the greatest
    mean of the worst episodes, which remembers the reward so far, and those with the most of a
    weighted mean of this and the mean of all. In a model of costs, the least.
    """


GROUPS = {
    "Check": (check, verify),
    "Solve": (solve, evaluate, returns, simulate),
    "Vary": (tornado, gradient, threshold, curve, one_way, two_way, psa, sobol, robust, explore),
    "Trade": (tradeoff, rationalize, risk),
    "Models": (info, convert, data, train),
    "Care": (new, lint, perception),
}
