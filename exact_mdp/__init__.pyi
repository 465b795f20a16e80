# The public names, each with the module that it comes from. `exact_mdp/__init__.py` reads this
# list, and so do type checkers. A name is loaded when it is first asked for.

from collections.abc import Callable
from typing import Any

from exact_mdp.analysis import plots as plots
from exact_mdp.analysis.gate.audit import Audit as Audit
from exact_mdp.analysis.gate.check import assert_policy_optimal as assert_policy_optimal
from exact_mdp.analysis.gate.check import check as check
from exact_mdp.analysis.gate.columns import best_policy as best_policy
from exact_mdp.analysis.gate.data.off_policy import OffPolicy as OffPolicy
from exact_mdp.analysis.gate.data.posterior import Posterior as Posterior
from exact_mdp.analysis.gate.data.robust import Robust as Robust
from exact_mdp.analysis.learning.curves import learning_curve as learning_curve
from exact_mdp.analysis.learning.outcomes import outcomes as outcomes
from exact_mdp.analysis.learning.trainers import check_trainer as check_trainer
from exact_mdp.analysis.pages.explorer import explore as explore
from exact_mdp.analysis.perception import error_costs as error_costs
from exact_mdp.analysis.plots.pictures import draw as draw
from exact_mdp.analysis.tradeoffs.front import tradeoff as tradeoff
from exact_mdp.analysis.tradeoffs.rationalize import rationalize as rationalize
from exact_mdp.analysis.vary.curves.curve import curve as curve
from exact_mdp.analysis.vary.curves.gradient import gradient as gradient
from exact_mdp.analysis.vary.curves.thresholds import thresholds as thresholds
from exact_mdp.analysis.vary.distributions import Uncertain as Uncertain
from exact_mdp.analysis.vary.distributions import Uncertainty as Uncertainty
from exact_mdp.analysis.vary.distributions import uncertainty as uncertainty
from exact_mdp.analysis.vary.economics import CostEffectiveness as CostEffectiveness
from exact_mdp.analysis.vary.economics import cost_effectiveness as cost_effectiveness
from exact_mdp.analysis.vary.one_way import one_way as one_way
from exact_mdp.analysis.vary.one_way import tornado as tornado
from exact_mdp.analysis.vary.one_way import two_way as two_way
from exact_mdp.analysis.vary.psa import psa as psa
from exact_mdp.analysis.vary.ranges import Range as Range
from exact_mdp.analysis.vary.robust import robust as robust
from exact_mdp.analysis.vary.robust import worst_point as worst_point
from exact_mdp.analysis.vary.sobol import sobol as sobol
from exact_mdp.analysis.vary.study import study as study
from exact_mdp.mdp.care.perception import counted as counted
from exact_mdp.mdp.care.perception import frequencies as frequencies
from exact_mdp.mdp.care.perception import independent as independent
from exact_mdp.mdp.care.perception import perceived as perceived
from exact_mdp.mdp.care.scenario import Scenario as Scenario
from exact_mdp.mdp.care.tables import READINGS as READINGS
from exact_mdp.mdp.environment import MDPEnv as MDPEnv
from exact_mdp.mdp.errors import DistributionError as DistributionError
from exact_mdp.mdp.errors import ModelError as ModelError
from exact_mdp.mdp.errors import NegativeError as NegativeError
from exact_mdp.mdp.errors import ScenarioWarning as ScenarioWarning
from exact_mdp.mdp.errors import ShapeError as ShapeError
from exact_mdp.mdp.exact import fingerprint as fingerprint
from exact_mdp.mdp.io.load import load as load
from exact_mdp.mdp.io.load import save as save
from exact_mdp.mdp.model import MDP as MDP
from exact_mdp.mdp.parameter import Parameter as Parameter
from exact_mdp.mdp.parametric.family import Family as Family
from exact_mdp.mdp.parametric.family import Parametric as Parametric
from exact_mdp.mdp.parametric.family import moving as moving
from exact_mdp.mdp.parametric.family import parametric as parametric
from exact_mdp.mdp.policies.policy import Policy as Policy
from exact_mdp.mdp.policies.policy import PolicyLike as PolicyLike
from exact_mdp.mdp.space import Column as Column
from exact_mdp.mdp.space import StateSpace as StateSpace
from exact_mdp.solvers.claims import Bounded as Bounded
from exact_mdp.solvers.claims import Certified as Certified
from exact_mdp.solvers.claims import Claim as Claim
from exact_mdp.solvers.claims import Estimated as Estimated
from exact_mdp.solvers.claims import PrecisionWarning as PrecisionWarning
from exact_mdp.solvers.claims import SolverError as SolverError
from exact_mdp.solvers.claims import Status as Status
from exact_mdp.solvers.dynamic.base import Solver as Solver
from exact_mdp.solvers.dynamic.linear_program import LinearProgram as LinearProgram
from exact_mdp.solvers.dynamic.methods import BackwardInduction as BackwardInduction
from exact_mdp.solvers.dynamic.methods import GaussSeidel as GaussSeidel
from exact_mdp.solvers.dynamic.methods import ModifiedPolicyIteration as ModifiedPolicyIteration
from exact_mdp.solvers.dynamic.methods import PolicyIteration as PolicyIteration
from exact_mdp.solvers.dynamic.methods import ValueIteration as ValueIteration
from exact_mdp.solvers.endless.average import AverageSolution as AverageSolution
from exact_mdp.solvers.exact.certificate import BoundedCertificate as BoundedCertificate
from exact_mdp.solvers.exact.certificate import Certificate as Certificate
from exact_mdp.solvers.exact.certify import certify as certify
from exact_mdp.solvers.exact.regret import RegretCertificate as RegretCertificate
from exact_mdp.solvers.learning.q_learning import QLearning as QLearning
from exact_mdp.solvers.learning.q_learning import TrainingRun as TrainingRun
from exact_mdp.solvers.learning.schedules import Constant as Constant
from exact_mdp.solvers.learning.schedules import Exponential as Exponential
from exact_mdp.solvers.learning.training import train as train
from exact_mdp.solvers.objectives.limits import ConstrainedSolution as ConstrainedSolution
from exact_mdp.solvers.risk import best_cvar as best_cvar
from exact_mdp.solvers.robust.robust import solve_robust as solve_robust
from exact_mdp.solvers.robust.sets import Intervals as Intervals
from exact_mdp.solvers.solution import Solution as Solution
from exact_mdp.solvers.solver import SOLVERS as SOLVERS
from exact_mdp.solvers.solver import solve as solve
from exact_mdp.solvers.values.evaluate import Evaluation as Evaluation
from exact_mdp.solvers.values.evaluate import evaluate as evaluate
from exact_mdp.solvers.values.returns import ReturnDistribution as ReturnDistribution
from exact_mdp.solvers.values.returns import return_distribution as return_distribution
from exact_mdp.solvers.values.simulate import Simulation as Simulation
from exact_mdp.solvers.values.simulate import simulate as simulate
from exact_mdp.solvers.values.strategies import choose_once as choose_once
from exact_mdp.solvers.values.trace import Trace as Trace
from exact_mdp.solvers.values.trace import cohort_trace as cohort_trace

def names_of(room: str) -> tuple[list[str], Callable[[str], Any]]: ...

__version__: str
