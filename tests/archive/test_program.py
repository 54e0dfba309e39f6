"""The straight-line program of a model in an archive: used where it is shorter, and compared."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

import mbdlft
from mbdlft import ArchiveError, LFTModel, MbdlftWarning, StructureError
from mbdlft.archive import program as stored
from mbdlft.batch.rows import ModelSource
from mbdlft.lft import sampling as lft_values
from mbdlft.lft.program.tape import Pivot
from mbdlft.system.sampled import deltas_of
from tests.apart import printed
from tests.archive import models, plain_program
from tests.archive.plain_digest import edit, instead, put, put_text, without
from tests.close import exact, roundoff
from tests.errors.scenes import cart
from tests.errors.table import refused, says

COUNT = 1500
NAMES = ("A", "B", "C", "D")
CASES: dict[str, Callable[[], LFTModel]] = {
    "carried": models.carried,
    "turned arm": lambda: mbdlft.with_program(models.turned_arm()),
    "unused": lambda: mbdlft.with_program(models.unused()),
    "numbers": lambda: mbdlft.with_program(models.numbers()),
}


def written(folder: Path, model: LFTModel) -> Path:
    mbdlft.save(folder / "a.h5", model)
    return folder / "a.h5"


def dense(model: LFTModel, values: dict[str, np.ndarray]) -> np.ndarray:
    deltas = deltas_of(model, values)
    return lft_values.values_and_sizes(model.lft, deltas)[0]


def matrix_of(matrices: Any) -> np.ndarray:
    A, B, C, D = matrices[:4]
    return np.block([[A, B], [C, D]])


@pytest.mark.parametrize("name", CASES)
def test_three_readers_agree(tmp_path: Path, name: str) -> None:
    model = CASES[name]()
    file = written(tmp_path, model)
    found = mbdlft.load(file)
    models.same(found, model)
    values = mbdlft.random(model.parameters, COUNT, 3)
    plain = plain_program.matrices(file, model.name, values)
    assert not np.any(plain[-1])
    roundoff(matrix_of(plain), dense(model, values), kappa=1e3)
    if values:
        assert mbdlft.computed_by(found, COUNT).startswith("stored program")
        roundoff(matrix_of(mbdlft.matrices_at(found, values)), matrix_of(plain), kappa=10.0)
        trim = mbdlft.trim_at(replace(model, program=None), values)
        roundoff(mbdlft.trim_at(found, values), trim, kappa=1e3)
        roundoff(plain[-2], trim, kappa=1e3)
        rows = ModelSource(found).rows(np.stack(list(values.values()), axis=1))
        exact(rows[0], matrix_of(mbdlft.matrices_at(found, values)))
    mbdlft.save(file, found)
    mbdlft.save(tmp_path / "b.h5", model)
    with h5py.File(file) as one, h5py.File(tmp_path / "b.h5") as two:
        group = f"models/{model.name}"
        assert one[group].attrs["digest"] == two[group].attrs["digest"]


READER = """
import sys, mbdlft
model = mbdlft.load(sys.argv[1])
values = mbdlft.random(model.parameters, 1500, 3)
print(mbdlft.computed_by(model, 1500))
print(float(mbdlft.matrices_at(model, values).A[-1, 2, 0]).hex())
"""


def test_without_casadi(tmp_path: Path) -> None:
    model = models.carried()
    blocked = ("casadi", "scipy", "flint", "pydantic", "control")
    lines = printed(READER, written(tmp_path, model), without=blocked).split("\n")
    found = mbdlft.matrices_at(model, mbdlft.random(model.parameters, COUNT, 3))
    assert lines[:2] == ["stored program", float(found.A[-1, 2, 0]).hex()]


def test_native_code_has_the_values_of_numpy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("llvmlite")
    monkeypatch.setenv("MBDLFT_CACHE", str(tmp_path / "cache"))
    model = models.carried()
    values = mbdlft.random(model.parameters, COUNT, 3)
    expected = mbdlft.matrices_at(model, values)
    monkeypatch.setattr(lft_values, "KNOWN_NATIVE", COUNT)
    assert mbdlft.computed_by(model, COUNT) == "stored program, native"
    for part, other in zip(mbdlft.matrices_at(model, values), expected, strict=True):
        roundoff(part, other, kappa=10.0)
    assert len(list((tmp_path / "cache").iterdir())) == 1
    made = mbdlft.compile(model, threads=1)
    assert (made.computes, made.reason) == ("stored program", "")
    roundoff(matrix_of(made(values)), matrix_of(expected), kappa=10.0)
    roundoff(made(values).trim, mbdlft.trim_at(model, values), kappa=10.0)


def test_the_shorter_way_is_taken() -> None:
    model = models.carried()
    assert mbdlft.computed_by(model, 3) == "dense matrices"
    assert mbdlft.computed_by(models.arm(), COUNT) == "program of the LFT"
    found = model.program
    assert found is not None
    long = replace(
        found,
        program=replace(
            found.program, instructions=found.program.instructions + found.program.instructions * 9
        ),
    )
    other = replace(model, program=long)
    assert mbdlft.computed_by(other, COUNT) == "program of the LFT"
    assert mbdlft.compile(other, threads=1).computes == "LFT"
    with says(StructureError, "computed_by: expected a number of samples, got -1"):
        mbdlft.computed_by(model, -1)


def test_what_is_made_of_a_model_has_no_program() -> None:
    model = models.carried()
    low = model.parameters["m1"].nominal
    made = {
        "range": model.with_range(m1=(low, low * 1.01)),
        "truncated": mbdlft.truncate(model, 0.2),
        "negative": -model,
        "series": model * 2.0,
        "other": replace(model, lft=replace(model.lft, M22=2.0 * model.lft.M22)),
    }
    for name, one in made.items():
        assert one.known_program is None, name
        if isinstance(one, LFTModel):
            with says(StructureError, "with_program: ", "it is not the model" * (name != "other")):
                mbdlft.with_program(one)
            values = mbdlft.random(one.parameters, COUNT)
            roundoff(matrix_of(mbdlft.matrices_at(one, values)), dense(one, values), kappa=100.0)
    assert replace(model, name="other").known_program is model.program


def test_other_values_than_the_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    model = models.arm()
    other = replace(model, lft=replace(model.lft, M22=2.0 * model.lft.M22))
    with says(StructureError, "the equations of its scene have other values than the model"):
        mbdlft.with_program(other)
    monkeypatch.setattr("mbdlft.batch.native._LONGEST", 3)
    with says(StructureError, "no program of at most 200000 instructions"):
        mbdlft.with_program(model)


def changed(model: LFTModel, **parts: object) -> LFTModel:
    found = model.program
    assert found is not None
    return replace(model, program=replace(found, program=replace(found.program, **parts)))


def test_samples_that_are_lost_are_those_of_the_lft() -> None:
    """A pivot m1 beside 32 max(m1, nominal of m2): small where m1 is."""
    model = models.carried()
    values = mbdlft.random(model.parameters, COUNT, 3)
    program = model.program.program  # type: ignore[union-attr]
    m1 = model.parameters.names.index("m1")
    size = program.inputs + len(program.instructions)
    middle = float(np.median(values["m1"]))
    instructions = (*program.instructions, ("multiply", size, 0, 0.0))
    instructions = (*instructions, ("add", size + 1, size, 32.0 * middle))
    tape = [type(program.instructions[0])(*one) for one in instructions]
    other = changed(model, instructions=tuple(tape), pivots=(Pivot(m1, size + 1),))
    found = matrix_of(mbdlft.matrices_at(other, values))
    plain = matrix_of(mbdlft.matrices_at(model, values))
    lost = values["m1"] < middle
    assert 0.3 < np.mean(lost) < 0.7
    exact(found[~lost], plain[~lost])
    exact(found[lost], dense(model, values)[lost])


def test_wrong_values_are_seen(tmp_path: Path) -> None:
    """A file with a right digest whose program computes something else: the matrices are right."""
    model = models.carried()
    file = written(tmp_path, model)
    edit(file, lambda g: g["program/operation"].__setitem__(-1, 5), "models/carried")
    edit(file, lambda g: g["program/numbers"].__setitem__(slice(None), 2.0), "models/carried")
    with pytest.warns(MbdlftWarning, match="is left out, and its LFT evaluated"):
        found = mbdlft.load(file)
    assert found.program is None
    values = mbdlft.random(model.parameters, COUNT)
    roundoff(matrix_of(mbdlft.matrices_at(found, values)), dense(model, values), kappa=100.0)


def with_bump(
    model: LFTModel, middles: dict[int, float], share: float, *, smooth: bool = True
) -> LFTModel:
    """Its program with 50 more in an entry where some parameters are in a part of their box.

    It is 50 / (1 + sum of z^512) or, with an edge, products of max(0, 1 - |z|): z is 1 at its ends,
    and it has a share of the box. Its middle is given between 0 and 1 in each range.
    """
    program = model.program.program  # type: ignore[union-attr]
    kind, width = type(program.instructions[0]), share ** (1.0 / len(middles))
    first, added = program.inputs + len(program.instructions), list[Any]()

    def put(name: str, left: int | float, right: int | float) -> int:
        added.append(kind(name, first + len(added), left, right))
        return first + len(added) - 1

    total: int | float = 1.0
    for place, middle in middles.items():
        p = model.parameters[place]
        half = 0.5 * width * (p.high - p.low)
        z = put("divide", put("subtract", place, p.low + middle * (p.high - p.low)), half)
        if smooth:
            for _ in range(9):
                z = put("multiply", z, z)
            total = put("add", z, total)
        else:
            total = put("multiply", total, put("maximum", put("subtract", 1.0, put("size", z, 0.0)), 0.0))
    bump = put("divide", 50.0, total) if smooth else put("multiply", total, 50.0)
    (_, k), register = program.entries[0]
    entries = (((0, k), put("add", register, bump)), *program.entries[1:])
    return changed(model, instructions=(*program.instructions, *added), entries=entries)


@pytest.mark.parametrize("smooth", [False, True], ids=["edges", "smooth"])
@pytest.mark.parametrize("share", [0.001, 0.02])
def test_a_program_that_is_false_in_a_slab_is_not_used(share: float, *, smooth: bool) -> None:
    """In a slab of each parameter, which random samples of a call may not meet."""
    model = models.carried()
    assert not stored.mistake_of(model.program, model.parameters)  # type: ignore[arg-type]
    words = "it has other values" if smooth else "depends on a size or a maximum"
    for place, p in enumerate(model.parameters):
        other = with_bump(model, {place: 0.371}, share, smooth=smooth)
        assert words in stored.mistake_of(other.program, model.parameters), p.name  # type: ignore[arg-type]


@pytest.mark.parametrize("count", [2, 3, 4])
def test_a_program_that_is_false_in_a_part_of_the_box_is_not_used(count: int) -> None:
    """In one of 200 values of so many parameters; 512 points miss one of 13 such parts."""
    model = models.carried()
    for seed in range(8, 33):
        random = np.random.default_rng(seed)
        places = random.choice(len(model.parameters), count, replace=False).tolist()
        middles = dict(zip(places, random.uniform(0.2, 0.8, count), strict=True))
        other = with_bump(model, middles, 0.005)
        assert "it has other values" in stored.mistake_of(other.program, model.parameters), seed  # type: ignore[arg-type]


def test_a_file_with_a_program_that_is_false_in_a_slab(tmp_path: Path) -> None:
    model = models.carried()
    other = with_bump(model, {0: 0.371}, 0.005)
    with pytest.warns(MbdlftWarning, match="it has other values"):
        mbdlft.save(tmp_path / "a.h5", other)
    with pytest.warns(MbdlftWarning, match="is left out, and its LFT evaluated: it has other values"):
        assert mbdlft.load(tmp_path / "a.h5").program is None


def test_where_digits_are_lost_the_lft_may_be_singular(monkeypatch: pytest.MonkeyPatch) -> None:
    """There, and only there, it is asked; a model that is proved regular is not."""
    model = models.carried()
    program = model.program.program  # type: ignore[union-attr]
    size = program.inputs + len(program.instructions)
    zero = type(program.instructions[0])("subtract", size, 0, 0)
    none = changed(model, instructions=(*program.instructions, zero), pivots=(Pivot(size, 0),))
    values = mbdlft.random(model.parameters, COUNT, 3)
    asked: list[int] = []

    def singular(_: object, deltas: np.ndarray, *__: object) -> None:
        asked.append(len(deltas))
        raise mbdlft.WellPosednessError("singular")

    monkeypatch.setattr("mbdlft.system.sampled.check_regular_at", singular)
    mbdlft.matrices_at(none, values)
    assert not asked
    sampled = replace(model.certificate, well_posed="sampled")
    mbdlft.matrices_at(replace(model, certificate=sampled), values)
    assert not asked
    with pytest.raises(mbdlft.WellPosednessError, match="singular"):
        mbdlft.matrices_at(replace(none, certificate=sampled), values)
    assert asked == [COUNT]


HUGE = 200_001


@pytest.fixture
def with_program(tmp_path: Path) -> Callable[[Callable[[Any], None]], None]:
    def read(change: Callable[[Any], None]) -> None:
        file = written(tmp_path, models.carried())
        edit(file, change, "models/carried")
        mbdlft.load(file)

    return read


test_messages = refused(
    r"""
> with_program({}) => ArchiveError: a.h5: model 'carried' …
put("program/operation", 4, 9) => instruction 4 has the code 9, which is unknown; known are 0 to 8
put("program/operation", 0, -1) => instruction 0 has the code -1
put("program/left", 3, 7 + 3) => program/left: entry 3 is 10, register 10, and only registers
put("program/right", 0, 100) => program/right: entry 0 is 100, register 100
put("program/left", 0, 2**62) => program/left: entry 0 is 4611686018427387904
put("program/left", 0, -(2**63)) => program/left: entry 0 is -9223372036854775808, number
put("program/result", 0, 10**6) => program/result: entry 0 is 1000000, register 1000000
put("program/pivots", (0, 1), -1) => program/pivots: entry 1 is -1, number 0 of 0
put("program/numbers", 0, np.inf) => program/numbers has a number that is not finite
instead("program/result", np.zeros(3, np.int64)) => program/result has 3 numbers, the matrices
instead("program/left", np.zeros(3, np.int64)) => 'program/left' has shape (3,), expected
instead("program/numbers", np.zeros(3, np.int64)) => 'program/numbers' has the type int64
without("program/pivots") => the dataset 'program/pivots' is missing
without("program/operation") => 'program/operation' is missing
"""
)


def test_a_program_that_is_too_long(tmp_path: Path) -> None:
    file = written(tmp_path, models.carried())

    def change(group: Any) -> None:
        for name, kind in (("operation", np.int8), ("left", np.int64), ("right", np.int64)):
            instead(f"program/{name}", np.zeros(HUGE, kind))(group)

    edit(file, change, "models/carried")
    with says(ArchiveError, f"program has {HUGE} instructions, at most 200000 are run"):
        mbdlft.load(file)


def test_a_program_of_a_newer_version_is_left_out(tmp_path: Path) -> None:
    file = written(tmp_path, models.carried())
    edit(file, put("program/operation", 0, 40), "models/carried")
    edit(file, lambda g: put_text(g, "encoding_version", "1.2"), "models/carried")
    with pytest.warns(MbdlftWarning, match="of version 1.2 is left out, and its LFT evaluated"):
        found = mbdlft.load(file)
    assert found.program is None
    models.same(found, replace(models.carried(), program=None))


def test_one_sided_operations_have_no_right_side(tmp_path: Path) -> None:
    """Whatever a file has there: numpy and native code compute the same."""
    file = written(tmp_path, models.carried())
    with h5py.File(file) as archive:
        codes = archive["models/carried/program/operation"][()]
    some = np.flatnonzero(np.isin(codes, [stored.OPERATIONS.index(k) for k in stored.ONE_SIDED]))
    assert len(some) > 3
    edit(file, put("program/right", some, 1), "models/carried")
    models.same(mbdlft.load(file), models.carried())
