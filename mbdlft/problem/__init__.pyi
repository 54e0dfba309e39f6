from .trim import solve_trim as solve_trim
