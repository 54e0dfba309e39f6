"""Analyses in an archive: they come back as they were, and belong to their model."""

import os
from dataclasses import fields, replace
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mbdlft
from mbdlft import ArchiveError, RandomSamples
from mbdlft.archive import archive, hdf5, reading
from mbdlft.dae import DaeDraft, formula_function
from mbdlft.pipeline import delta_theta
from mbdlft.robust.evidence import BoxProof, IntervalProof, MotionProof, PolynomialProof
from tests.apart import printed
from tests.archive import models
from tests.archive.models import contents, same
from tests.archive.plain_digest import edit, instead, without
from tests.close import CLOSED_FORM, exact, target
from tests.daes import example_2
from tests.errors.scenes import cart
from tests.errors.table import refused, says
from tests.laws.random_loops import blocks_system, mixed_system
from tests.laws.test_margins import random_loop_with_channels
from tests.scenarios.commands import Call


@cache
def margin() -> mbdlft.Bounds:
    return mbdlft.robust_stability(random_loop_with_channels(), gap=0.1)


@cache
def mixed_margin() -> mbdlft.Bounds:
    return mbdlft.robust_stability(mixed_system(2), gap=0.1)


def test_round_trip(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    loop, mixed = random_loop_with_channels(), mixed_system(2)
    first, second = margin(), mbdlft.worst_case_gain(loop, "f", gap=0.1)
    third = mixed_margin()
    for system, bounds in ((loop, first), (loop, second), (mixed, third)):
        mbdlft.save_analysis(file, system, bounds)
    assert mbdlft.model_names(file) == tuple(sorted([loop.name, mixed.name]))
    names = mbdlft.analysis_names(file)
    assert names == ("matrix: robust stability", "matrix: worst-case gain", "mixed: robust stability")
    for name, bounds in zip(names, (first, second, third), strict=True):
        system, found = mbdlft.load_analysis(file, name)
        same(found, bounds)
        assert mbdlft.verify(system, found) == ""


def test_parts_fixed_blocks_and_first_files(tmp_path: Path) -> None:
    """Proofs of parts come back; those of the first files, with a bound of mu, are read as one part."""
    file, system = tmp_path / "a.h5", blocks_system(3)
    cut, whole = mbdlft.robust_stability(system, gap=0.1), mixed_margin()
    held = mbdlft.robust_stability(random_loop_with_channels(), fixed=["m"], gap=0.1)
    for model, bounds in ((system, cut), (mixed_system(2), whole), (random_loop_with_channels(), held)):
        mbdlft.save_analysis(file, model, bounds, "one")
        found_model, found = mbdlft.load_analysis(file, "one")
        same(found, bounds)
        assert mbdlft.verify(found_model, found) == ""
    assert isinstance(whole.proof, IntervalProof)
    mbdlft.save_analysis(file, mixed_system(2), whole, "one")
    beta = (1.0 - 1e-15) / whole.lower

    def old(group: Any) -> None:
        for name in ("intervals/log", "fixed", "inputs", "outputs"):
            del group[name]
        group["intervals"].attrs["beta"] = beta
        for name in ("G_real", "G_imaginary"):
            group[f"intervals/{name}"][...] *= beta**2

    edit(file, old, "analyses/one")
    model, found = mbdlft.load_analysis(file, "one")
    assert mbdlft.verify(model, found) == ""


def test_round_trip_of_motions(tmp_path: Path) -> None:
    file, loop = tmp_path / "a.h5", random_loop_with_channels()
    for rates, gap, kind in ((np.inf, 0.5, MotionProof), ({"k": 0.5}, 0.1, PolynomialProof)):
        bounds = mbdlft.robust_stability(loop, rates=rates, gap=gap, work=1.0)
        mbdlft.save_analysis(file, loop, bounds)
        assert mbdlft.analysis_names(file) == ("matrix: robust stability, moving parameters",)
        _, found = mbdlft.load_analysis(file)
        same(found, bounds)
        assert mbdlft.verify(loop, found) == ""
        assert isinstance(found.proof, kind)


def test_round_trip_of_edges(tmp_path: Path) -> None:
    file, loop = tmp_path / "a.h5", random_loop_with_channels()
    for what in ("real part", "damping"):
        bounds = mbdlft.worst_case(loop, what)
        mbdlft.save_analysis(file, loop, bounds)
        _, found = mbdlft.load_analysis(file, f"matrix: {bounds.kind}")
        same(found, bounds)
        assert mbdlft.verify(loop, found) == ""


def test_no_proof_and_infinite_bounds(tmp_path: Path) -> None:
    bounds = replace(margin(), upper=np.inf, proof=None, worst={}, delta={})
    mbdlft.save_analysis(tmp_path / "a.h5", random_loop_with_channels(), bounds, "mine")
    same(mbdlft.load_analysis(tmp_path / "a.h5")[1], bounds)


def test_an_analysis_belongs_to_its_model(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    loop = random_loop_with_channels()
    bounds = margin()
    mbdlft.save_analysis(file, loop, bounds)
    narrower = loop.with_range(k=(1.5, 2.5))
    with pytest.raises(mbdlft.ArchiveError, match="is another one than the one that was analyzed"):
        mbdlft.save_analysis(file, narrower, bounds)
    mbdlft.save(file, narrower)
    with pytest.raises(mbdlft.ArchiveError, match="is not the one that was analyzed"):
        mbdlft.load_analysis(file)


def test_a_changed_analysis_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    loop = random_loop_with_channels()
    mbdlft.save_analysis(file, loop, margin())
    name = "analyses/matrix: robust stability"

    def claim(group: object) -> None:
        group.attrs["lower"] = 99.0  # type: ignore[attr-defined]

    edit(file, claim, name, right=False)
    with pytest.raises(mbdlft.ArchiveError, match="its digest"):
        mbdlft.load_analysis(file)
    edit(file, claim, name)
    system, bounds = mbdlft.load_analysis(file)
    assert bounds.lower == 99.0
    assert "is not below its upper bound" in mbdlft.verify(system, bounds)
    edit(file, without("rates/value"), name)
    with pytest.raises(mbdlft.ArchiveError, match="rates/value is missing"):
        mbdlft.load_analysis(file)


# Nonlinear functions in archives: read without CasADi, and refused where they do not agree.

READER = """
import sys, mbdlft
model = mbdlft.load(sys.argv[1])
omega = {name: [0.3, -0.2] for name in model.omega}
for name, values in mbdlft.theta_values(model.functions, omega).items():
    print(name, *values)
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    mbdlft.save(tmp_path / "a.h5", delta_theta(example_2(), "blocks", search=0.0))
    return tmp_path / "a.h5"


def test_functions_are_read_and_evaluated_without_casadi(file: Path) -> None:
    lines = printed(READER, file, without=("casadi", "scipy", "flint", "pydantic")).splitlines()
    found = {line.split()[0]: np.array(line.split()[1:], float) for line in lines}
    model = delta_theta(example_2(), "blocks", search=0.0)
    for f in model.functions:
        own = formula_function("f", f.arguments, f.text)
        expected = [float(own(*[x] * len(f.arguments))) for x in (0.3, -0.2)]
        target(found[f.name], expected, CLOSED_FORM)


@pytest.fixture
def curve(tmp_path: Path) -> Path:
    d = DaeDraft("curve")
    x = d.variable("x")
    d.equation(d.der(x), equals=-d.table(x, [0, 1, 2, 3], [0, 2, 3, 7], "cubic"))
    d.output("x")
    mbdlft.save(tmp_path / "b.h5", delta_theta(d.dae(), search=0.0))
    return tmp_path / "b.h5"


def read_changed(file: Path, change: Any) -> None:
    (name,) = mbdlft.model_names(file)
    edit(file, change, f"models/{name}")
    mbdlft.load(file)


test_messages = refused(
    r"""
> read_changed(file, {}) => ArchiveError:
instead("theta/count", np.array({[1, 1]|[0, 4]})) => theta/count
instead("theta/text", np.array([b"__import__('os')", b"1"])) => is not allowed
instead("theta/signal", np.array([b"x", b"y", b"z", b"w"])) => unknown output 'x'
instead("theta/name", np.array([b"f", b"f"])) => stands twice
instead("theta/name", np.array([b"f", b"g"])) => unknown input 'f'
instead("theta/low", np.array([np.inf] * 4)) => theta/low
instead("theta/initial", np.zeros(3)) => theta/initial
without("theta/unit") => theta/unit
> read_changed(curve, {}) => ArchiveError:
instead("theta/tables", np.array([2])) => theta/tables: expected 1 together
instead("theta/table/count", np.array([3])) => theta/table/count: expected 4 together
instead("theta/table/pairs", np.array([2])) => theta/table/pairs: expected 3 together
instead("theta/table/breakpoint", np.array([0.0, 1.0, 1.0, 2.0]))
    => number 1: the breakpoints … increase
instead("theta/table/value", np.array([0.0, np.nan, 1.0, 2.0])) => not finite
instead("theta/table/slope", np.zeros((3, 3))) => theta/table/slope
without("theta/table/below") => theta/table/below
"""
)


def test_commands_show_functions_and_do_not_leave_them_out(
    file: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    for command in ("show", "poles", "margin"):
        code, out, err = call(command, str(file))
        if command == "show":
            assert code == 0
            assert "theta.spring.alpha(J1_phi, J2_phi) = (J1_phi - J2_phi)**2" in out
        else:
            assert code == 2
            assert "has 2 nonlinear functions, and is not linear" in err


# Sweeps in archives: layout, models beside them, atomic writes, large files.


def swept(file: Path, count: int = 5000, name: str = "s") -> None:
    """Needs more than one chunk."""
    model = models.arm()
    mbdlft.sweep(model, RandomSamples(count), file, name=name, workers=1)


def test_layout_as_documented(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    swept(file)
    with h5py.File(file) as found:
        assert found.attrs["format"] == b"mbdlft-archive"
        assert found.attrs["format_version"] == b"1.1"
        group = found["sweeps/s"]
        assert group.attrs["encoding_type"] == b"sweep"
        assert group.attrs["encoding_version"] == b"1.1"
        assert group.attrs["model"] == b"two_link_arm"
        shapes = {"samples": (7,), "A": (4, 4), "B": (4, 2), "C": (2, 4), "D": (2, 2)}
        shapes |= {"trim/value": (2,), "residual": (), "status": ()}
        for key, shape in shapes.items():
            item = group[key]
            assert item.shape == (5000, *shape)
            assert item.dtype == ("i1" if key == "status" else "<f8")
            assert item.chunks[0] < 5000
            assert item.chunks[1:] == shape
        assert b"2: no equilibrium" in group["status"].attrs["meaning"]
        assert list(group["parameters/name"].asstr()) == [p.name for p in models.arm().parameters]
        for what in ("states", "inputs", "outputs", "trim", "parameters"):
            assert set(group[what]) >= {"name", "unit"}


def test_models_and_other_sweeps_stay(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    mbdlft.save(file, models.arm())
    before = contents(file)
    swept(file, name="first")
    swept(file, name="second")
    after = contents(file)
    assert {key: after[key] for key in before if key != "/"}.keys() == before.keys() - {"/"}
    same(mbdlft.load(file), models.arm())
    first = mbdlft.load_sweep(file, "first")
    swept(file, 7, name="second")
    assert mbdlft.sweep_names(file) == ("first", "second")
    assert len(mbdlft.load_sweep(file, "second").status) == 7
    exact(mbdlft.load_sweep(file, "first").A, first.A)
    mbdlft.save(file, models.strange(6), "other")
    exact(mbdlft.load_sweep(file, "first").A, first.A)
    exact(mbdlft.load_sweep(file, "first", 10, 20).A, first.A[10:20])
    assert mbdlft.model_names(file) == ("other", "two_link_arm")


def test_large_archives_are_not_held_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small, large = tmp_path / "a.h5", tmp_path / "b.h5"
    mbdlft.save(small, models.arm())
    swept(small)
    mbdlft.save(small, models.strange(6), "other")
    monkeypatch.setattr(archive, "LARGE", -1)
    monkeypatch.setattr(reading, "LARGE", -1)

    class Empty(BytesIO):
        def __init__(self, *held: bytes) -> None:
            assert not held, "an archive is held in memory"
            super().__init__()

    for module in (archive, hdf5):
        monkeypatch.setattr(module, "BytesIO", Empty)
    swept(large)
    mbdlft.save(large, models.arm())
    mbdlft.save(large, models.strange(6), "other")
    exact(mbdlft.load(large, "other").A, models.strange(6).A)
    monkeypatch.undo()
    one, two = mbdlft.load_sweep(small), mbdlft.load_sweep(large)
    for name in ("samples", "A", "B", "C", "D", "trim", "residual", "status"):
        exact(getattr(two, name), getattr(one, name))


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_interrupted_writing_leaves_the_archive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    file = tmp_path / "a.h5"
    mbdlft.save(file, models.arm())
    before, called = file.read_bytes(), []
    original = archive.put

    def interrupt(*arguments: object, **options: object) -> None:
        called.append(step)
        raise KeyboardInterrupt

    def replace(images: dict[Path, bytes], made: Path | None = None) -> None:
        if file in images:
            monkeypatch.setattr(os, step, interrupt)
        original(images, made)

    monkeypatch.setattr(archive, "put", replace)
    with pytest.raises(KeyboardInterrupt):
        swept(file)
    monkeypatch.undo()
    assert called
    assert file.read_bytes() == before
    model = models.arm()
    assert mbdlft.sweep(model, RandomSamples(5000), file, name="s", workers=1).resumed == 5000
    same(mbdlft.load(file), model)
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_scene_without_parameters(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    mbdlft.sweep(cart(), {}, file, workers=1)
    found = mbdlft.load_sweep(file)
    assert found.samples.shape == (1, 0)
    assert found.A.shape == (1, 2, 2)
    assert found.status[0] == 0


def test_what_is_not_there_or_not_whole(tmp_path: Path) -> None:
    file = tmp_path / "a.h5"
    mbdlft.save(file, models.arm())
    with h5py.File(file, "a") as found:
        found["sweeps"] = 1.0
    with says(mbdlft.ArchiveError, f"{file}: /sweeps is not a group"):
        mbdlft.sweep_names(file)
    with h5py.File(file, "a") as found:
        del found["sweeps"]
    with says(mbdlft.ArchiveError, f"{file}: give the name of the sweep. Existing: none."):
        mbdlft.load_sweep(file)
    swept(file)
    with says(mbdlft.ArchiveError, f"{file}: ", "unknown sweep", "'x'", "s"):
        mbdlft.load_sweep(file, "x")
    for change, text in (
        (without("A"), "is not whole"),
        (lambda group: group.attrs.__setitem__("encoding_version", "2.0"), "this mbdlft reads up"),
        (lambda group: group.attrs.__setitem__("encoding_type", "x"), "encoding_type is 'x'"),
        (
            instead("D", np.zeros((4999, 2, 2))),
            ": the dataset 'D' has shape (4999, 2, 2), expected (5000, 2, 2)",
        ),
    ):
        swept(file)
        with h5py.File(file, "a") as found:
            change(found["sweeps/s"])
        with says(mbdlft.ArchiveError, "sweep 's'", text):
            mbdlft.load_sweep(file)
