from .description import Dae as Dae
from .description import Equation as Equation
from .description import Output as Output
from .description import Variable as Variable
from .draft import DaeDraft as DaeDraft
from .from_casadi import from_casadi as from_casadi
