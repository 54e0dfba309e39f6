"""The motion written down by hand, as code: by SymPy for NumPy, and by CasADi for a C compiler.

Both start from the same formulas, which are not simplified by hand; common parts are found by the tools.
"""

import ctypes
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from benchmarks.speed.motion import Circle, known_zero, state_space
from benchmarks.speed.robots import Array, Method, Samples
from benchmarks.speed.systems import System

COMPILER = ("gcc", "-O3", "-march=native", "-shared", "-fPIC")
_SYMBOLIC = 2  # coordinates: up to here SymPy solves with the mass matrix, then NumPy does
_CHUNK = 2000  # samples: vectors stay near the core


class SlowError(Exception):
    """It takes longer than it may."""


@contextmanager
def limited(seconds: float) -> Iterator[None]:
    """Interrupt what takes longer."""

    def stop(*_: Any) -> None:
        raise SlowError

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def by_sympy(system: System, seconds: float = 300.0) -> Method:
    """Symbolic matrices, made to NumPy functions of all samples (lambdify with cse).

    Raises
    ------
    SlowError
        SymPy takes more than `seconds`.
    """
    import sympy

    symbols = {p.name: sympy.Symbol(p.name) for p in system.parameters}
    degree = sympy.Float(np.pi / 180.0, 17)
    with limited(seconds):
        motion = system.motion(system.in_radians(symbols, degree), Circle(sympy.cos, sympy.sin))
        n, nu = len(motion.M), len(motion.inputs)
        if n <= _SYMBOLIC:
            entries = _entries(state_space(motion))
        else:
            entries = {
                (part, i, j): matrix[i][j]
                for part, matrix in enumerate((motion.M, motion.K, motion.outputs))
                for i in range(len(matrix))
                for j in range(len(matrix[0]))
                if not known_zero(matrix[i][j]) and (part == 2 or i <= j)
            }
        function = sympy.lambdify(
            list(symbols.values()), list(entries.values()), modules="numpy", cse=True
        )
    shape = (2 * n + len(motion.outputs), 2 * n + nu)
    inputs = np.eye(n)[:, list(motion.inputs)]

    def closed(samples: Samples, values: Array) -> None:
        columns = function(*(samples[name] for name in symbols))
        for (i, j), column in zip(entries, columns, strict=True):
            values[:, i, j] = column

    def solving(samples: Samples, values: Array) -> None:
        count = len(values)
        mass, right = np.zeros((count, n, n)), np.zeros((count, n, n + nu))
        outputs = np.zeros((count, len(motion.outputs), 3 * n))
        right[:, :, n:] = inputs
        columns = function(*(samples[name] for name in symbols))
        for (part, i, j), column in zip(entries, columns, strict=True):
            if part == 2:
                outputs[:, i, j] = column
                continue
            matrix = mass if part == 0 else right
            matrix[:, i, j] = matrix[:, j, i] = column if part == 0 else -column
        solved = np.linalg.solve(mass, right)
        values[:, :n, n : 2 * n] = np.eye(n)
        values[:, n : 2 * n, :n], values[:, n : 2 * n, 2 * n :] = np.split(solved, [n], axis=2)
        values[:, 2 * n :, : 2 * n] = outputs[:, :, : 2 * n]
        used = np.flatnonzero(outputs[:, :, 2 * n :].any(axis=(0, 2)))
        if len(used):
            values[:, 2 * n + used] += outputs[:, used, 2 * n :] @ values[:, n : 2 * n]

    def method(samples: Samples) -> Array:
        count = len(next(iter(samples.values())))
        values = np.zeros((count, *shape))
        fill = closed if n <= _SYMBOLIC else solving
        for start in range(0, count, _CHUNK):
            part = {name: value[start : start + _CHUNK] for name, value in samples.items()}
            fill(part, values[start : start + _CHUNK])
        return values

    return method


def _entries(rows: list[list[Any]]) -> dict[tuple[int, int], Any]:
    """Entries that are not zero for all values."""
    return {
        (i, j): entry
        for i, row in enumerate(rows)
        for j, entry in enumerate(row)
        if not known_zero(entry)
    }


def by_compiled_c(system: System) -> Method:
    """All of [A B ; C D] as C code, the mass matrix solved with in it, in a loop over samples in C."""
    symbols = {p.name: ca.SX.sym(p.name) for p in system.parameters}
    motion = system.motion(system.in_radians(symbols, np.pi / 180.0), Circle(ca.cos, ca.sin))
    rows = state_space(motion)
    shape = (len(rows), len(rows[0]))
    constant, varying = np.zeros(shape), {}
    for place, entry in _entries(rows).items():
        if isinstance(entry, ca.SX) and not entry.is_constant():
            varying[place] = entry
        else:
            constant[place] = float(entry)
    code = ca.Function("sample", [ca.vertcat(*symbols.values())], [ca.vertcat(*varying.values())])
    index = np.array([i * shape[1] + j for i, j in varying])
    with tempfile.TemporaryDirectory() as folder:
        library = _compiled(code, Path(folder))
    pointer = np.ctypeslib.ndpointer(dtype=float, flags="C_CONTIGUOUS")
    library.samples.argtypes = [
        ctypes.c_long,
        ctypes.c_long,
        ctypes.c_long,
        ctypes.c_long,
        pointer,
        pointer,
        np.ctypeslib.ndpointer(dtype=np.int64, flags="C_CONTIGUOUS"),
        pointer,
    ]
    index = index.astype(np.int64)

    def method(samples: Samples) -> Array:
        points = np.stack([samples[name] for name in symbols], axis=-1)
        values = np.empty((len(points), *shape))
        library.samples(
            len(points), points.shape[1], len(index), values[0].size, points, constant, index, values
        )
        return values

    return method


class NoDeviceError(Exception):
    """This machine does not have it."""


def by_jax(system: System, device: str = "cpu") -> Method:
    """The same formulas, compiled by JAX (jit) for arrays of all samples, in double precision.

    Raises
    ------
    NoDeviceError
        JAX finds no such device.
    """
    import jax

    jax.config.update("jax_enable_x64", val=True)
    import jax.numpy as jnp

    names = [p.name for p in system.parameters]

    def formulas(columns: Any) -> Any:
        values = system.in_radians(dict(zip(names, columns, strict=True)), jnp.pi / 180.0)
        rows = state_space(system.motion(values, Circle(jnp.cos, jnp.sin)))
        count = columns[0].shape
        return jnp.stack(
            [jnp.stack([jnp.broadcast_to(x, count) for x in row], axis=-1) for row in rows], axis=-2
        )

    try:
        place = jax.devices(device)[0]
    except RuntimeError:
        raise NoDeviceError("no device") from None
    compiled = jax.jit(formulas)

    def method(samples: Samples) -> Array:
        columns = [jax.device_put(samples[name], place) for name in names]
        return np.asarray(compiled(columns))

    return method


_LOOP = """
#include <string.h>
void samples(long count, long inputs, long varying, long size, const double* points,
             const double* constant, const long long* index, double* values) {
  double found[%d], work[%d];
  long long integers[%d];
  for (long k = 0; k < count; ++k) {
    const double* argument[%d] = {points + k * inputs};
    double* result[%d] = {found};
    sample(argument, result, integers, work, 0);
    memcpy(values + k * size, constant, size * sizeof(double));
    for (long i = 0; i < varying; ++i) values[k * size + index[i]] = found[i];
  }
}
"""


def _compiled(code: ca.Function, folder: Path) -> ctypes.CDLL:
    """The function in a loop, as a library; its file may go once it is loaded."""
    generator = ca.CodeGenerator("sample.c", {"casadi_int": "long long"})
    generator.add(code)
    sizes = (
        code.nnz_out(0),
        max(1, code.sz_w()),
        max(1, code.sz_iw()),
        max(1, code.sz_arg()),
        max(1, code.sz_res()),
    )
    source, library = folder / "sample.c", folder / "sample.so"
    source.write_text(generator.dump() + _LOOP % sizes, encoding="utf-8")
    subprocess.run([*COMPILER, str(source), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))
