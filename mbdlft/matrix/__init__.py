"""Matrices that are rational in parameters: their description, and their values in any number system."""

from mbdlft.matrix.problem import MatrixProblem as MatrixProblem
from mbdlft.matrix.symbolic import matrix_problem as matrix_problem
from mbdlft.matrix.toml import load_matrix as load_matrix
from mbdlft.matrix.toml import matrix_from_toml as matrix_from_toml
from mbdlft.matrix.toml import matrix_to_toml as matrix_to_toml
