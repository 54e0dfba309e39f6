from .problem import MatrixProblem as MatrixProblem
from .problem import load_matrix as load_matrix
from .problem import matrix_from_toml as matrix_from_toml
from .problem import matrix_to_toml as matrix_to_toml
from .relations import matrix_problem as matrix_problem
