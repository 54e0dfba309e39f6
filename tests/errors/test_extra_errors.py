"""Every error of what a sweep computes besides: functions that are not there, or give nonsense."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import AnalysisError, ArchiveError, Parameter
from tests.errors.scenes import cart
from tests.errors.table import refused, says

VALUES = {"m": np.linspace(0.5, 2.0, 12)}
FUNCTIONS = """
import numpy as np

number = 3
def nothing(part): return None
def empty(part): return {}
def no_names(part): return {1: part.A[:, 0, 0]}
def one(part): return {"a": 1.0}
def matrix(part): return {"a": part.A}
def long(part): return {"a": np.append(part.A[:, 0, 0], 1.0)}
def complex_(part): return {"a": part.poles[:, 0]}
def text(part): return {"a": np.array(["x"] * len(part.A))}
def names(part): return {f"a{part.samples['m'][0] > 1.0}": part.A[:, 0, 0]}
def raises(part): raise KeyError("no such thing")
def mixes(part): return {"a": part.A[:, 1, 0] / np.max(np.abs(part.A[:, 1, 0]))}
def writes(part):
    part.A[:] = 0.0
    return {"a": part.A[:, 0, 0]}
def late(part):
    heavy = bool(np.any(np.abs(part.samples["m"] - 0.77272727) < 1e-6))
    return {"a": part.A if heavy else part.A[:, 1, 0]}
def huge(part): return {"a": 1e300 * part.A[:, 1, 0]}
"""


def scene() -> mbdlft.Scene:
    return cart("m", [Parameter("m", 1.0, low=0.5, high=2.0, unit="kg")])


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    name = f"wrong_{abs(hash(tmp_path))}"
    (tmp_path / f"{name}.py").write_text(FUNCTIONS, encoding="utf-8")
    (tmp_path / f"{name}_broken.py").write_text("1 / 0", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return name


@pytest.fixture
def swept(tmp_path: Path, module: str) -> Callable[[str], None]:
    """A sweep with a function of the module; it leaves nothing behind when it is refused."""

    def sweep(name: str) -> None:
        before = sorted(tmp_path.iterdir())
        try:
            mbdlft.sweep(scene(), VALUES, tmp_path / "a.h5", workers=1, function=module + name)
        finally:
            assert [path for path in sorted(tmp_path.iterdir()) if path.suffix] == before

    return sweep


test_messages = refused(
    r"""
> {} => AnalysisError:
# It stops the sweep, here and in a worker: the user's function has a mistake.
mbdlft.sweep(scene(), {'m': np.linspace(0.5, 2.0, 12).repeat(3)}, tmp_path / 'a.h5', workers=1,
    function=f'{module}:late')
    => sweep: function … :late: expected 'a' as 36 real numbers
mbdlft.sweep(cart(0.7, [Parameter('f', 0.5, low=0.4, high=1.0, unit='N')], {'preload': 'f'}), {'f':
    [0.5, 0.6]}, tmp_path / 'a.h5', workers=1, function=f'{module}:huge')
    => cannot be tried: none of … samples is solved
> swept({}) => AnalysisError: sweep: …
":nothing" => expected arrays by name, such as {'bandwidth': ...}, got NoneType
":empty" => expected arrays by name … got dict
":no_names" => expected arrays by name … got dict
":one" => expected 'a' as 1 real numbers, one for each sample … float64 of shape ()
":matrix" => shape (1,), got float64 of shape (1, 2, 2)
":long" => shape (1,), got float64 of shape (2,)
":complex_" => real numbers … got complex128 of shape (1,)
":text" => real numbers … got <U1 of shape (1,)
":names" => gives ['aFalse'] at one sample, and other names at another
":raises" => raised KeyError: 'no such thing' at m = 2, and at all others
":mixes" => 'a' at a sample depends on the samples beside it … first axis only
":writes" => raised ValueError: assignment destination is read-only
":none" => unknown name 'none' … mixes
":number" => is no function, but int
"_broken:f" => cannot be imported: ZeroDivisionError: division by zero
"_missing:f" => cannot be imported: ModuleNotFoundError … Modules of the working folder
{""|":"|";import os:f"} => expected a function as module:name
"""
)


def test_functions_that_others_cannot_import(tmp_path: Path) -> None:
    for function in (lambda part: {"a": part.A[:, 0, 0]}, np.linalg.eigvals.__get__):
        with says(AnalysisError, "cannot be imported by other processes", "a file of its own"):
            mbdlft.sweep(scene(), VALUES, tmp_path / "a.h5", function=function)  # type: ignore[arg-type]
    with says(AnalysisError, "expected a function or 'module:name', got int"):
        mbdlft.sweep(scene(), VALUES, tmp_path / "a.h5", function=3)  # type: ignore[arg-type]


def test_numbers_that_single_precision_does_not_have(tmp_path: Path, module: str) -> None:
    with says(ArchiveError, "function/value has the number -6e+300", "3.4e38", "double precision"):
        mbdlft.sweep(
            scene(), VALUES, tmp_path / "a.h5", workers=1, function=f"{module}:huge", float32=True
        )
    mbdlft.sweep(scene(), VALUES, tmp_path / "a.h5", workers=1, function=f"{module}:huge", restart=True)
