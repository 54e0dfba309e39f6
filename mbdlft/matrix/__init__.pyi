from .problem import MatrixProblem as MatrixProblem
from .symbolic import matrix_problem as matrix_problem
from .toml import load_matrix as load_matrix
from .toml import matrix_from_toml as matrix_from_toml
from .toml import matrix_to_toml as matrix_to_toml
