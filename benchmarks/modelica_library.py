"""The examples of the Modelica Standard Library that become linear models, each checked, and the others.

Usage: ``python -m benchmarks.modelica_library FOLDER [PART OF A NAME ...]``. The folder has the library
(`Modelica/`, `ModelicaServices/`) and `examples.txt`, the names of the examples, one in a line.

Each linear model is compared with an independent linearization: the Jacobians of the residuals of the
DAE as it was translated, before its aliases are taken out and its index is reduced, at the same point.
What has no equilibrium at its start inputs is linearized at its start values; its outcome says so.
det(s E - A) of this pencil and det(s I - A) of the model have one ratio at all frequencies, and the
transfer matrices from all inputs to the states and some other variables are equal there.
"""

import signal
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import casadi as ca
import numpy as np
from scipy.sparse import csc_matrix
from scipy.sparse.linalg import splu

import mbdlft
from mbdlft.base.errors import MbdlftError, SceneError, TrimError
from mbdlft.dae.dae import Dae, Output
from mbdlft.dae.equilibria import DaeTrim
from mbdlft.dae.text import column_of
from mbdlft.modelica import FlatModel, ModelicaTable, operating_point, translate
from mbdlft.modelica.loading import compiled_model
from mbdlft.problem.sx.constants import in_doubles
from mbdlft.system.model import LFTModel

FREQUENCIES = 1j * np.logspace(-1.5, 2.0, 8) + 0.37
OUTPUTS = 12  # about so many variables, beside the states
DELAY = 2  # order of the Pade approximations of delays
LIMIT = 600  # seconds for an example


def main() -> None:
    """Print a line for each example, and counts."""

    def checked(folder: Path, name: str) -> tuple[str, float]:
        point, states, equations, error = _checked(folder, name)
        return f"linear, at {point} | {states} | {equations}", error

    good, count = run_examples("outcome | states | equations", checked, lambda error: error < 1e-6)
    print(f"\n{good} of {count} are linear models that agree with the check.")


def run_examples(
    columns: str, checked: Callable[[Path, str], tuple[str, float]], is_good: Callable[[float], bool]
) -> tuple[int, int]:
    """Print a line for each example that the command names; how many are good, and of how many.

    What checks an example gives its three columns, and its error.
    """
    folder = Path(sys.argv[1])
    names = sorted((folder / "examples.txt").read_text().split())
    chosen = [name for name in names if not sys.argv[2:] or any(p in name for p in sys.argv[2:])]
    signal.signal(signal.SIGALRM, _stop)
    print(f"| example | {columns} | s | error |\n|---|---|---|---|---|---|", flush=True)
    good = 0
    for name in chosen:
        begun = time.perf_counter()
        signal.alarm(LIMIT)
        try:
            outcome, error = checked(folder, name)
            good += is_good(error)
            outcome += f" | {time.perf_counter() - begun:.0f} | {error:.0e}"
        except MbdlftError as why:
            text = str(why).replace("\n", " ").replace("|", "/")
            outcome = f"{type(why).__name__}: {text[:600]} | | | {time.perf_counter() - begun:.0f} |"
        except TimeoutError:
            outcome = f"more than {LIMIT} s | | | |"
        finally:
            signal.alarm(0)
        print(f"| {name.removeprefix('Modelica.')} | {outcome} |", flush=True)
    return good, len(chosen)


def _stop(*_: Any) -> None:
    raise TimeoutError


def compiled_example(folder: Path, name: str, modifications: str = "") -> FlatModel:
    """An example that the compiler has read, with modifications such as ``(a(b = 1))``."""
    with TemporaryDirectory() as own:
        file = Path(own) / "one_example.mo"
        file.write_text(f"model OneExample\n  extends {name}{modifications};\nend OneExample;\n")
        return compiled_model(file, "OneExample", [folder])


def _checked(folder: Path, name: str) -> tuple[str, int, int, float]:
    """Operating point, numbers of states and equations of an example, error of its linear model."""
    flat = compiled_example(folder, name)
    try:
        return ("equilibrium", *_compared(flat, "equilibrium"))
    except (SceneError, TrimError) as error:
        try:
            return ("start", *_compared(flat, "start"))
        except MbdlftError as other:
            raise type(error)(f"{error} At the start: {other}") from None


def _compared(flat: FlatModel, point: str) -> tuple[int, int, float]:
    """Numbers of states and equations, and the error of the linear model at an operating point."""
    table = ModelicaTable(delay=DELAY, point=point)
    dae, report = translate(flat, table)
    states = [q.name for q in operating_point(dae, report, table).structure.states]
    at = operating_point(with_outputs(dae, outputs_of(dae, states)), report, table)
    model = mbdlft.linearize_dae(at)
    nominal = {p.name: p.nominal for p in dae.parameters}
    return len(at.structure.states), len(dae.equations), error_of(model, nominal, at)


def outputs_of(dae: Dae, states: Iterable[str]) -> set[str]:
    """States and some other variables."""
    others = [x.name for x in dae.variables if x.name not in states]
    return {*states, *others[:: max(1, len(others) // OUTPUTS)]}


def with_outputs(dae: Dae, names: Collection[str]) -> Dae:
    """The equations with these variables as outputs."""
    read = (Output(x.name, x.symbol, x.unit) for x in dae.variables if x.name in names)
    return replace(dae, outputs=tuple(read))


def error_of(model: LFTModel, values: Mapping[str, float], at: DaeTrim) -> float:
    """The largest relative error of the model at values, against the equations at their point."""
    dae = at.structure.source
    of = dict(at.nominal)
    for a in at.structure.aliases:
        of[f"der({a.name})"] = float(a.factor) * of.get(f"der({a.of})", 0.0)
    z = column_of(x.symbol for x in dae.variables)
    rates = [(k, x) for k, x in enumerate(dae.variables) if x.derivative is not None]
    dz = column_of(x.derivative for _, x in rates)  # type: ignore[misc]
    u = column_of(x.symbol for x in dae.inputs)
    y = column_of(o.expression for o in dae.outputs)
    F = in_doubles(column_of(e.residual for e in dae.equations))
    parts = [
        ca.jacobian(F, z),
        ca.jacobian(F, dz),
        ca.jacobian(F, u),
        ca.jacobian(y, z),
        ca.jacobian(y, u),
    ]
    at_values = ca.Function("parts", [z, dz, u, dae.p], [F, *parts])(
        [of.get(x.name, 0.0) for x in dae.variables],
        [of.get(f"der({x.name})", 0.0) for _, x in rates],
        [of.get(x.name, 0.0) for x in dae.inputs],
        [p.nominal for p in dae.parameters],
    )
    residual, Fz, Fd, Fu, Cz, Cu = (np.asarray(part.full()) for part in at_values)
    E = np.zeros_like(Fz)
    E[:, [k for k, _ in rates]] = Fd
    matrices = mbdlft.matrices_at(model, {name: [value] for name, value in values.items()})
    A, B, C, D = (np.asarray(part).reshape(np.shape(part)[-2:]) for part in matrices)
    ratios, error = [], float(np.max(np.abs(residual), initial=0.0)) * 1e-3
    for s in FREQUENCIES:
        pencil = s * E + Fz
        scale = 1.0 / np.maximum(np.max(np.abs(Fz) + np.abs(E), axis=1), 1e-300)
        lu = splu(csc_matrix(scale[:, None] * pencil))
        of_pencil = np.sum(np.log(lu.U.diagonal().astype(complex)))
        of_model = np.linalg.slogdet(s * np.eye(len(A)) - A)
        ratios.append(of_pencil - np.log(of_model[0]) - of_model[1])
        if len(dae.inputs) and len(dae.outputs):
            expected = Cu - Cz @ lu.solve((scale[:, None] * Fu).astype(complex))
            got = C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D
            size = np.maximum(np.max(np.abs(expected)), 1e-300)
            error = max(error, float(np.max(np.abs(got - expected)) / size))
    turns = np.exp(np.array(ratios) - ratios[0])  # signs of permutations differ
    return max(error, float(np.max(np.minimum(np.abs(turns - 1.0), np.abs(turns + 1.0)))))


if __name__ == "__main__":
    main()
