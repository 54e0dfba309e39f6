"""The methods that are compared, and why one cannot do a system."""

from collections.abc import Callable
from ctypes.util import find_library
from functools import partial
from importlib.util import find_spec
from shutil import which
from typing import NamedTuple

from benchmarks.speed.formulas import (
    COMPILER,
    NoDeviceError,
    SlowError,
    by_jax,
    by_plain_c,
    by_sympy,
    by_vector_c,
)
from benchmarks.speed.own import (
    TooLongError,
    by_compiled_equations,
    by_compiled_lft,
    by_equations,
    by_lft,
)
from benchmarks.speed.polynomials import by_polynomials
from benchmarks.speed.robots import Method, by_drake, by_mujoco, by_pinocchio
from benchmarks.speed.systems import System

EXACT, DIFFERENCES, FITTED = 1e-9, 1e-3, float("inf")  # errors above are mistakes: nothing is timed


class Candidate(NamedTuple):
    """A method: what it is called, how it is made, what it needs, and the largest error it may have.

    `own` is a way of this package; `general` a tool that takes any system as it is described, or symbols;
    what is neither is a reference or not exact.
    """

    name: str
    make: Callable[[System], Method]
    accepted: float = EXACT
    own: bool = False
    general: bool = True
    module: str = ""
    rigid: bool = False


CANDIDATES = (
    Candidate("mbdlft, LFT", by_lft, own=True),
    Candidate("mbdlft, equations", by_equations, own=True),
    Candidate("mbdlft, LFT compiled", by_compiled_lft, own=True, module="llvmlite"),
    Candidate("mbdlft, equations compiled", by_compiled_equations, own=True, module="llvmlite"),
    Candidate("pinocchio", by_pinocchio, module="pinocchio", rigid=True),
    Candidate("MuJoCo, one-sided", by_mujoco, DIFFERENCES, module="mujoco", rigid=True),
    Candidate(
        "MuJoCo, central", partial(by_mujoco, central=True), DIFFERENCES, module="mujoco", rigid=True
    ),
    Candidate("Drake", by_drake, module="pydrake", rigid=True),
    Candidate("SymPy", by_sympy, module="sympy"),
    Candidate("JAX", by_jax, module="jax"),
    Candidate("JAX, GPU", partial(by_jax, device="gpu"), module="jax"),
    Candidate("grid, quadratic", partial(by_polynomials, degree=2), FITTED),
    Candidate("grid, cubic", partial(by_polynomials, degree=3), FITTED),
    Candidate("plain C", by_plain_c, general=False),
    Candidate("vectorized C", by_vector_c, general=False),
)


def missing(candidate: Candidate, system: System) -> str:
    """Why the method cannot do the system; empty if it can."""
    if candidate.rigid and system.links is None:
        return "no beams among its bodies"
    if candidate.module and find_spec(candidate.module) is None:
        return "not installed"
    if candidate.make in (by_plain_c, by_vector_c) and which(COMPILER[0]) is None:
        return f"no {COMPILER[0]}"
    if candidate.make is by_vector_c and find_library("mvec") is None:
        return "no libmvec"
    return ""


def made(candidate: Candidate, system: System) -> Method | str:
    """The method, ready, or why there is none."""
    reason = missing(candidate, system)
    if reason:
        return reason
    try:
        return candidate.make(system)
    except SlowError:
        return "not ready in time"
    except (TooLongError, NoDeviceError) as error:
        return str(error)
