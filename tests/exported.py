"""Exported files, evaluated: C by a compiler, .mat files by scipy, m-files by Octave."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat, savemat

import mbdlft
from mbdlft import LFTModel
from mbdlft.export import export_model
from mbdlft.system import DeltaThetaModel, System
from tests.archive.models import arm, bare, numbers, turned_arm, unused
from tests.close import exact

COMPILER, OCTAVE = shutil.which("cc"), shutil.which("octave-cli")
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Werror", "-O1"]
ROOT = Path(__file__).parents[1]
SAMPLES = 100


@cache
def scenario(stem: str) -> LFTModel:
    """The model of a file of scenarios/, made fast."""
    path = ROOT / "scenarios" / f"{stem}.toml"
    if "mbdlft-matrix" in path.read_text(encoding="utf-8"):
        return mbdlft.realize(mbdlft.load_matrix(path), search=0.0, prove=0.0)
    return mbdlft.to_lft(mbdlft.load_scene(path), search=0.0, prove=0.0)


@cache
def off_center() -> LFTModel:
    """Bilinear maps, Greek and reserved names, no states and no trim."""
    parameters = [
        mbdlft.Parameter("µ", 1.0, 0.9, 3.0),
        mbdlft.Parameter("end", 2.0, 1.0, 2.2, unit="kg"),
        mbdlft.Parameter("größe", 1e6, 1e6 - 3.0, 1e6 + 1.0),
    ]
    matrix = [["1/(µ + end)", "µ*end^2"], ["(größe - 1000000)*µ", "end/µ"]]
    return mbdlft.realize(matrix, parameters, states=0, name="größe.λ model*/", search=0.0)


MODELS: dict[str, Callable[[], System]] = {
    "arm": arm,
    "turned": turned_arm,
    "unused": unused,
    "numbers": numbers,
    "bare": bare,
    "off_center": off_center,
    "word": lambda: mbdlft.as_system(off_center(), name="end"),
    "system": lambda: mbdlft.as_system(np.array([[1.0, 2.0]]), name="gains"),
    "loop": lambda: mbdlft.feedback(arm(), mbdlft.as_system(np.eye(2), name="gains")),
}


@cache
def exported(key: str) -> System:
    """The model of a key of `MODELS`."""
    return MODELS[key]()


def samples_of(model: System) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
    """Samples by name, among them all bounds, and A, B, C, D (N, ., .) there."""
    drawn = mbdlft.random(model.parameters, SAMPLES - 2, seed=5)
    ends = {p.name: [p.low, p.high] for p in model.parameters}
    values = {name: np.concatenate([column, ends[name]]) for name, column in drawn.items()}
    found = mbdlft.matrices_at(model, values)
    shape = (SAMPLES,) if not values else ()
    return values, [np.broadcast_to(matrix, (*shape, *matrix.shape)) for matrix in found]


def rows_of(model: System, values: dict[str, np.ndarray]) -> np.ndarray:
    """Samples (N, n_p) in the order of the parameters."""
    columns = [values[p.name] for p in model.parameters]
    return np.stack(columns, axis=1) if columns else np.zeros((SAMPLES, 0))


def compiled(model: System | DeltaThetaModel, folder: Path) -> Any:
    """The library of the exported C, without a warning."""
    if COMPILER is None:
        pytest.skip("there is no C compiler cc")
    source, _ = export_model(folder / "model.c", model)
    library = folder / "model.so"
    command = [COMPILER, *STRICT, "-shared", "-fPIC", "-o", str(library), str(source), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(library))


def pointer(numbers: np.ndarray) -> ctypes.c_void_p:
    return numbers.ctypes.data_as(ctypes.c_void_p)


def values_of_c(library: Any, name: str, model: System, rows: np.ndarray) -> list[np.ndarray]:
    """A, B, C, D (N, ., .) of the compiled library."""
    nx, nu, ny = len(model.states), len(model.inputs), len(model.outputs)
    shapes = [(nx, nx), (nx, nu), (ny, nx), (ny, nu)]
    found = [np.full((len(rows), *shape), np.nan) for shape in shapes]
    function = getattr(library, f"{name}_matrices")
    for k, row in enumerate(np.ascontiguousarray(rows)):
        assert function(pointer(row), *(pointer(matrices[k]) for matrices in found)) == 0
    return found


def read(path: Path) -> dict[str, Any]:
    """A .mat file, structures as dictionaries."""
    return {
        key: _plain(value)
        for key, value in loadmat(path, simplify_cells=False).items()
        if not key.startswith("__")
    }


def _plain(value: Any) -> Any:
    if getattr(value, "dtype", None) is not None and value.dtype.names and value.size == 1:
        return {name: _plain(value[name][0, 0]) for name in value.dtype.names}
    return value


def texts(cells: np.ndarray) -> list[str]:
    return [str(cell[0]) if len(cell) else "" for cell in cells.ravel()]


def values_of_mat(
    file: dict[str, Any], values: dict[str, np.ndarray]
) -> tuple[list[np.ndarray], np.ndarray | None]:
    """A, B, C, D and the trim of a .mat file, by the formulas of the docs."""
    p, names = file["parameters"], texts(file["parameters"]["name"])
    deltas = np.zeros((SAMPLES, len(names)))
    for k, name in enumerate(names):
        internal, kind = values[name], texts(p["substitution"])[k]
        if kind != "identity":
            unit = np.pi / 180.0 if texts(p["unit"])[k] == "deg" else 1.0
            part = {"half-angle": 2.0, "quarter-angle": 4.0}[kind]
            internal = np.tan((internal * unit - p["reference"][k, 0]) / part)
        b0, b1, a1 = p["map"][k]
        gain, distance = p["gain"][k, 0], internal - b0
        exact(b1, gain + a1 * b0)
        deltas[:, k] = distance / (gain - a1 * distance)  # b1 - a1 internal, without cancellation
    n = len(file["A"])
    left = np.vstack([file["B_w"], file["D_yw"]])
    direct = np.block([[file["A"], file["B_u"]], [file["C_y"], file["D_yu"]]])
    found = _closed(
        file["delta"], deltas, file["D_zw"], np.hstack([file["C_z"], file["D_zu"]]), left, direct
    )
    trim = None
    if "lft" in file.get("trim", {}):
        t = file["trim"]["lft"]
        trim = _closed(t["delta"], deltas, t["D_zw"], t["D_zu"], t["D_yw"], t["D_yu"])[..., 0]
    return [found[:, :n, :n], found[:, :n, n:], found[:, n:, :n], found[:, n:, n:]], trim


def _closed(blocks: Any, deltas: np.ndarray, M11: Any, M12: Any, M21: Any, M22: Any) -> np.ndarray:
    rows = blocks["rows"].ravel().astype(int)
    number = np.repeat(blocks["parameter"].ravel().astype(int), rows)
    d = deltas[:, number - 1] if len(number) else np.zeros((len(deltas), 0))
    inner = np.linalg.solve(
        np.eye(len(number)) - M11 * d[:, None, :], np.broadcast_to(M12, (len(d), *M12.shape))
    )
    return np.asarray(M22 + (M21 * d[:, None, :]) @ inner)


LOOP = """
s = load('samples.mat'); failed = '';
for k = 1:size(s.rows, 1)
  values = struct();
  for j = 1:numel(s.names), values.(s.names{j}) = s.rows(k, j); end
  [a, b, c, d, t] = STEM_at(values);
  A(:,:,k) = a; B(:,:,k) = b; C(:,:,k) = c; D(:,:,k) = d; T(1:numel(t),k) = t;
end
MORE
clear s model values;  % Octave does not write letters of other scripts as scipy reads them
save('-v6', 'found.mat');
"""


def octave(model: System, folder: Path, stem: str, rows: np.ndarray, more: str = "") -> dict[str, Any]:
    """Variables of Octave after it has evaluated exported m-files at samples."""
    if OCTAVE is None:
        pytest.skip("there is no octave-cli")
    names = read(folder / f"{stem}.mat")["parameters"]["identifier"]
    savemat(folder / "samples.mat", {"rows": rows, "names": names})
    program = LOOP.replace("STEM", stem).replace("MORE", more)
    (folder / "run_it.m").write_text(program, encoding="utf-8")
    command = [OCTAVE, "--quiet", "--norc", "--no-gui", "run_it.m"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert (folder / "found.mat").exists(), done.stderr
    return read(folder / "found.mat")
