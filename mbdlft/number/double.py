"""Doubles, one or an array of them: their functions by the names of CasADi's operations."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "sqrt")},
    **{name: getattr(np, name) for name in ("exp", "expm1", "log", "log1p", "fabs", "sign")},
    **{name: getattr(np, name) for name in ("floor", "ceil", "fmod", "hypot", "copysign")},
    **{f"a{name}": getattr(np, f"arc{name}") for name in ("sin", "cos", "tan", "tan2")},
    **{f"a{name}": getattr(np, f"arc{name}") for name in ("sinh", "cosh", "tanh")},
    "pow": np.power,
    "constpow": np.power,
    "fmin": np.fmin,
    "fmax": np.fmax,
    "lt": lambda a, b: 1.0 * (a < b),
    "le": lambda a, b: 1.0 * (a <= b),
    "eq": lambda a, b: 1.0 * (a == b),
    "ne": lambda a, b: 1.0 * (a != b),
    "not": lambda a: 1.0 * (a == 0.0),
    "and": lambda a, b: 1.0 * ((a != 0.0) & (b != 0.0)),
    "or": lambda a, b: 1.0 * ((a != 0.0) | (b != 0.0)),
    "if_else_zero": lambda condition, a: np.where(condition != 0.0, a, 0.0),
}
