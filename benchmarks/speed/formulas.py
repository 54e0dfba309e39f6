"""The motion written down by hand, as code: by SymPy for NumPy, and as C, of numbers and of vectors.

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


def by_plain_c(system: System) -> Method:
    """All of [A B ; C D] as C code, the mass matrix solved with in it, in a loop over samples in C."""
    return _by_c(system, _LOOP)


def by_vector_c(system: System) -> Method:
    """The same statements on four samples at once: vectors of GCC, cosines and sines of libmvec."""
    return _by_c(system, _VECTOR_LOOP, "-lmvec")


def _by_c(system: System, loop: str, *libraries: str) -> Method:
    symbols = {p.name: ca.SX.sym(p.name) for p in system.parameters}
    motion = system.motion(system.in_radians(symbols, np.pi / 180.0), Circle(ca.cos, ca.sin))
    rows = state_space(motion)
    shape = (len(rows), len(rows[0]))
    constant, varying = np.zeros(shape), {}
    for (i, j), entry in _entries(rows).items():
        if isinstance(entry, ca.SX) and not entry.is_constant():
            varying[i * shape[1] + j] = entry
        else:
            constant[i, j] = float(entry)
    entries = ca.cse(ca.vertcat(*varying.values()))
    function = ca.Function(
        "sample", [ca.vertcat(*symbols.values())], [entries], {"live_variables": False}
    )
    text = loop % {
        "statements": "\n  ".join(_statements(function)),
        "places": ", ".join(map(str, varying)),
        "inputs": len(symbols),
        "varying": len(varying),
        "size": constant.size,
    }
    with tempfile.TemporaryDirectory() as folder:
        library = _compiled(text, Path(folder), libraries)
    pointer = np.ctypeslib.ndpointer(dtype=float, flags="C_CONTIGUOUS")
    library.samples.argtypes = [ctypes.c_long, pointer, pointer, pointer]

    def method(samples: Samples) -> Array:
        points = np.stack([samples[name] for name in symbols], axis=-1)
        values = np.empty((len(points), *shape))
        library.samples(len(points), points, constant, values)
        return values

    return method


_FORMULAS = {
    ca.OP_ADD: "{} + {}",
    ca.OP_SUB: "{} - {}",
    ca.OP_MUL: "{} * {}",
    ca.OP_DIV: "{} / {}",
    ca.OP_NEG: "-{}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {}",
    ca.OP_COS: "COS({})",
    ca.OP_SIN: "SIN({})",
    ca.OP_SQRT: "SQRT({})",
}


def _statements(function: ca.Function) -> Iterator[str]:
    """A statement in C for each operation of CasADi: `in` and `out` of a sample, `NUMBER` by type."""
    for k in range(function.n_instructions()):
        operation, inputs = function.instruction_id(k), function.instruction_input(k)
        target = f"const NUMBER w{function.instruction_output(k)[0]}"
        if operation == ca.OP_INPUT:
            yield f"{target} = in[{inputs[1]}];"
        elif operation == ca.OP_CONST:
            yield f"{target} = CONSTANT({function.instruction_constant(k)!r});"
        elif operation == ca.OP_OUTPUT:
            yield f"out[{function.instruction_output(k)[1]}] = w{inputs[0]};"
        else:
            yield f"{target} = {_FORMULAS[operation].format(*(f'w{i}' for i in inputs))};"


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


_SAMPLE = """
#include <math.h>
#include <string.h>
static const int places[%(varying)d] = {%(places)s};
static inline __attribute__((always_inline)) void sample(const NUMBER* in, NUMBER* out) {
  %(statements)s
}
"""

_LOOP = f"""
#define NUMBER double
#define CONSTANT(x) x
#define COS cos
#define SIN sin
#define SQRT sqrt
{_SAMPLE}
void samples(long count, const double* points, const double* constant, double* values) {{
  for (long k = 0; k < count; ++k) {{
    double out[%(varying)d], *row = values + k * %(size)d;
    sample(points + k * %(inputs)d, out);
    memcpy(row, constant, %(size)d * sizeof(double));
    for (int i = 0; i < %(varying)d; ++i) row[places[i]] = out[i];
  }}
}}
"""

_VECTOR_LOOP = f"""
typedef double vector __attribute__((vector_size(32)));
vector _ZGVdN4v_cos(vector), _ZGVdN4v_sin(vector);
#define NUMBER vector
#define CONSTANT(x) (x) - (vector){{0.0}}
#define COS _ZGVdN4v_cos
#define SIN _ZGVdN4v_sin
#define SQRT(x) (vector){{sqrt(x[0]), sqrt(x[1]), sqrt(x[2]), sqrt(x[3])}}
{_SAMPLE}
void samples(long count, const double* points, const double* constant, double* values) {{
  for (long k = 0; k < count; k += 4) {{
    vector in[%(inputs)d], out[%(varying)d];
    const long some = count - k < 4 ? count - k : 4;
    for (int i = 0; i < %(inputs)d; ++i)
      for (int lane = 0; lane < 4; ++lane)
        in[i][lane] = points[(k + (lane < some ? lane : some - 1)) * %(inputs)d + i];
    sample(in, out);
    for (int lane = 0; lane < some; ++lane) {{
      double* row = values + (k + lane) * %(size)d;
      memcpy(row, constant, %(size)d * sizeof(double));
      for (int i = 0; i < %(varying)d; ++i) row[places[i]] = out[i][lane];
    }}
  }}
}}
"""


def _compiled(text: str, folder: Path, libraries: tuple[str, ...]) -> ctypes.CDLL:
    """C as a library; its file may go once it is loaded."""
    source, library = folder / "sample.c", folder / "sample.so"
    source.write_text(text, encoding="utf-8")
    subprocess.run([*COMPILER, str(source), "-o", str(library), *libraries, "-lm"], check=True)
    return ctypes.CDLL(str(library))
