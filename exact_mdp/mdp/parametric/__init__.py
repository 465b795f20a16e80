"""Models with named parameters: families of models, and their change with one parameter."""

from exact_mdp.mdp.parameter import Parameter as Parameter
from exact_mdp.mdp.parametric.family import DISCOUNT as DISCOUNT
from exact_mdp.mdp.parametric.family import Family as Family
from exact_mdp.mdp.parametric.family import Parametric as Parametric
from exact_mdp.mdp.parametric.family import moved_from as moved_from
from exact_mdp.mdp.parametric.family import moving as moving
from exact_mdp.mdp.parametric.family import parameter_of as parameter_of
from exact_mdp.mdp.parametric.family import parametric as parametric
from exact_mdp.mdp.parametric.family import room_of as room_of
