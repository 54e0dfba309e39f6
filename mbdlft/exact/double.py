"""Doubles, one or an array of them: their functions by the names of CasADi's operations."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "sqrt")},
    **{name: getattr(np, name) for name in ("exp", "expm1", "log", "log1p", "hypot", "floor")},
    **{name: getattr(np, name) for name in ("fabs", "sign", "copysign", "fmin", "fmax", "ceil")},
    **{f"a{name}": getattr(np, f"arc{name}") for name in ("sin", "cos", "tan", "tan2")},
    **{f"a{name}": getattr(np, f"arc{name}") for name in ("sinh", "cosh", "tanh")},
    **dict.fromkeys(("pow", "constpow"), np.power),
}
