"""Native code is the definition, and its cache gives nothing that was not compiled from the same text."""

import os
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import mpmath
import numpy as np
import pytest

import mbdlft
from mbdlft import MbdlftWarning
from mbdlft.base.samples import check_points
from mbdlft.batch import native as module
from mbdlft.batch.native import Compiled
from mbdlft.batch.rows import source_of
from mbdlft.lft.program import native as engine
from mbdlft.lft.program.elimination import solve, sparse
from mbdlft.lft.program.native import Cache, compile_native, key_of, run_natively, user_cache
from mbdlft.lft.program.tape import Operand, Pivot, Program, Tape, plan, rows_of_numbers, run
from mbdlft.multibody.assembly import assembly
from mbdlft.problem.digits import equations_in_digits
from tests.close import ELASTIC, EVALUATION, NOTHING, exact, roundoff
from tests.errors.scenes import cart
from tests.seeds import some

SCENARIOS = Path(__file__).parents[2] / "scenarios"
EACH = ("two_link_arm", "crane", "gimbal", "four_bar", "spinning_satellite", "launcher_slosh")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Nothing is read from, or left in, the folder of the user."""
    folder = tmp_path / "native"
    monkeypatch.setenv("MBDLFT_CACHE", str(folder))
    return folder


def scene(name: str) -> mbdlft.Scene:
    return mbdlft.load_scene(SCENARIOS / f"{name}.toml")


def drawn(seed: int, length: int) -> tuple[Program, np.ndarray]:
    """A random program of operations; its numbers overflow, and some are not numbers."""
    random = np.random.default_rng(seed)
    tape = Tape(3, 10**6)
    known: list[Operand] = [0, 1, 2, 2.5, -1.0, 1e-3]
    for _ in range(length):
        a, b = (known[int(k)] for k in random.integers(len(known), size=2))
        operation = random.choice(["add", "subtract", "multiply", "divide", "maximum", "one"])
        if operation == "one":
            if isinstance(a, int):
                known.append(tape.put(str(random.choice(["size", "root"])), a))
        elif isinstance(a, int) or isinstance(b, int):
            known.append(getattr(tape, operation)(a, b))
    registers = [one for one in known[6:] if isinstance(one, int)]
    some = [registers[int(k)] for k in random.integers(len(registers), size=6)]
    pivots = [Pivot(some[0], some[1])]
    return rows_of_numbers(tape, [*some, 1.5, 0, registers[-1], *(100 * [-2.5]), 1], pivots)


def points(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (count, 3))


@pytest.mark.parametrize("lanes", [4, 8])
@pytest.mark.parametrize("seed", range(6))
def test_bits_are_those_of_numpy(seed: int, lanes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Short programs are one function, long ones several; the last block of samples is not full."""
    monkeypatch.setattr(engine, "_lanes", lambda: lanes)
    program, row = drawn(seed, (20, 1500)[seed % 2])
    at = points(43, seed)
    expected = np.tile(row, (len(at), 1))
    lost = run(plan(program), at, expected[:, None, :])
    for threads, size in ((1, len(row)), (2, len(row) - 3)):
        found = np.empty((len(at), size))
        columns = np.repeat(row[size:, None], len(at), axis=1)
        bad = run_natively(compile_native(program, size), at, row[:size], found, threads, columns)
        assert np.array_equal(found, expected[:, :size], equal_nan=True)
        assert np.array_equal(columns.T, expected[:, size:], equal_nan=True)
        exact(bad, lost)
    assert np.sum(lost) > 0 or np.all(np.isfinite(expected))


def test_cosines_and_sines() -> None:
    """They miss by less than a unit of the last place, near multiples of pi/2 too, or are lost."""
    tape = Tape(1, 10)
    program, row = rows_of_numbers(tape, [tape.put("cosine", 0), tape.put("sine", 0)], [])
    random = np.random.default_rng(0)
    near = np.arange(-50, 51) * (np.pi / 2)
    at = [random.uniform(-9.0, 9.0, 400), random.uniform(-1.6e6, 1.6e6, 200), near, 14_000.0 * near]
    at = np.concatenate([*at, np.nextafter(near, np.inf), [-0.0, 1e-300, -1e-9]])
    beyond = [1.7e6, -1e300, np.inf, np.nan]
    found = np.empty((len(at) + len(beyond), 2))
    lost = run_natively(compile_native(program, 2), np.append(at, beyond)[:, None], row, found)
    exact(np.flatnonzero(lost), len(at) + np.arange(len(beyond)))
    with mpmath.workdps(60):
        for x, pair in zip(at, found[: len(at)], strict=True):
            for value, function in zip(pair, (mpmath.cos, mpmath.sin), strict=True):
                truth = function(mpmath.mpf(x))
                assert abs(value - truth) <= np.spacing(abs(float(truth)))
    assert np.signbit(found[len(at) - 3, 1])


def test_many_chunks_in_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(engine, "_SAMPLES", 16)
    program, row = drawn(3, 200)
    at = points(201)
    expected, found = np.tile(row, (len(at), 1)), np.empty((len(at), len(row)))
    run(plan(program), at, expected[:, None, :])
    run_natively(compile_native(program, len(row)), at, row, found, 2)
    assert np.array_equal(found, expected, equal_nan=True)


def on_tape(matrix: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Solutions (N, n, k) of equations whose entries are inputs of a program, and what is lost."""
    count, n, k = right.shape
    tape = Tape(n * (n + k), 10**6)
    entries: list[list[Operand]] = [[i * n + j for j in range(n)] for i in range(n)]
    sides: list[list[Operand]] = [[n * n + i * k + j for j in range(k)] for i in range(n)]
    solved = solve(tape, sparse(entries), sparse(sides), matrix[:8])
    assert solved is not None
    outcome = [one.get(j, 0.0) for one in solved[0] for j in range(k)]
    program, row = rows_of_numbers(tape, outcome, solved[1])
    at = np.concatenate([matrix.reshape(count, -1), right.reshape(count, -1)], axis=1)
    values = np.tile(row, (count, 1))
    lost = run(plan(program), at, values[:, None, :])
    return values.reshape(right.shape), lost


def test_equations_are_solved() -> None:
    """Rows and columns differ by powers of ten, and pivots are not on the diagonal."""
    random = np.random.default_rng(7)
    for n in (1, 2, 5):
        matrix = np.eye(n)[::-1] * 3.0 + 0.3 * random.uniform(-1.0, 1.0, (40, n, n))
        right = random.uniform(-1.0, 1.0, (40, n, 2))
        rows, columns = (10.0 ** random.integers(-6, 7, n) for _ in range(2))
        found, lost = on_tape(rows[:, None] * matrix * columns, rows[:, None] * right)
        assert not np.any(lost)
        expected = np.linalg.solve(matrix, right)
        roundoff(found * columns[:, None], expected, kappa=100.0)


def test_a_pivot_that_is_small_elsewhere_is_lost() -> None:
    """The order is chosen where the diagonal is large; samples at which it is not are seen."""
    random = np.random.default_rng(8)
    matrix = np.eye(3) + 0.1 * random.uniform(-1.0, 1.0, (30, 3, 3))
    matrix[20:, 0, 0] = 1e-9
    right = random.uniform(-1.0, 1.0, (30, 3, 1))
    found, lost = on_tape(matrix, right)
    assert np.all(lost[20:])
    assert not np.any(lost[:20])
    roundoff(found[:20], np.linalg.solve(matrix, right)[:20], kappa=10.0)


def test_singular_equations_have_no_program() -> None:
    singular = np.ones((4, 2, 2))
    tape = Tape(4, 100)
    entries: list[list[Operand]] = [[0, 1], [2, 3]]
    assert solve(tape, sparse(entries), sparse([[1.0], [1.0]]), singular) is None


def probes(given: Compiled, count: int = 203) -> np.ndarray:
    return check_points(given.parameters, 3)[:count]


@pytest.mark.parametrize("name", some(["two_link_arm", "launcher_slosh", "crane"], EACH))
def test_rows_are_those_of_the_definition(name: str) -> None:
    for given in (scene(name), mbdlft.to_lft(scene(name), search=0.0)):
        found = mbdlft.compile(given, threads=1)
        assert not found.reason
        at = probes(found)
        matrices, trim, residual, status = found.rows(at)
        expected = found.source.rows(at)
        assert np.all(status == expected[3])
        roundoff(trim, expected[1], kappa=100.0)
        size = np.max(np.abs(expected[0]), axis=0)
        # what is zero but for rounding has no size of its own
        size = np.where(size > NOTHING * np.max(size), size, np.max(size))
        roundoff(matrices / size, expected[0] / size, kappa=1000.0, scale=1.0)
        assert np.max(residual) <= EVALUATION if found.layout.trim else np.max(residual) < 1.0


@pytest.mark.parametrize("name", ["two_link_arm", "flexible_manipulator"])
def test_as_near_to_fifty_digits_as_the_definition(name: str) -> None:
    found = mbdlft.compile(scene(name), threads=1)
    source = found.source
    at = probes(found, 6)
    reference = equations_in_digits(assembly(scene(name)).exact, source.inputs, source.outputs).matrices(
        at
    )
    reference = source.need.of(reference, at)
    size = np.max(np.abs(reference), axis=0)
    some = size > 1e-8 * np.sqrt(np.outer(np.max(size, axis=1), np.max(size, axis=0)))
    errors = [
        np.max(np.max(np.abs(rows(at)[0] - reference), axis=0)[some] / size[some])
        for rows in (found.rows, source.rows)
    ]
    assert errors[0] <= 3.0 * errors[1] + EVALUATION


@pytest.mark.long
def test_a_full_model_is_computed_by_its_equations() -> None:
    """Its LFT has 116 repetitions and a program of more than 200 000 instructions."""
    model = mbdlft.to_lft(scene("rotatory_spacecraft"), search=0.0)
    found = mbdlft.compile(model, threads=1)
    assert (found.computes, found.reason) == ("equations", "")
    at = probes(found, 12)
    matrices, trim, _, status = found.rows(at)
    expected = source_of(model).rows(at)
    assert status.tolist() == [0] * 12
    assert trim.shape == expected[1].shape
    size = np.max(np.abs(expected[0]), axis=0)
    size = np.where(size > NOTHING * np.max(size), size, np.max(size))
    assert np.max(np.abs(matrices - expected[0]) / size) <= ELASTIC
    # another model of the same names is not that of the scene
    other = mbdlft.LFT(model.lft.M11, model.lft.M12, 2.0 * model.lft.M21, model.lft.M22, model.lft.blocks)
    with pytest.warns(MbdlftWarning, match="more than 200000 instructions"):
        assert mbdlft.compile(replace(model, lft=other)).computes == "LFT"


def test_a_call_takes_values_by_name() -> None:
    model = mbdlft.to_lft(scene("two_link_arm"), search=0.0)
    samples = mbdlft.random(model.parameters, 20)
    named = {"m1": samples["m1"], "theta1": samples["theta1"]}
    expected = mbdlft.matrices_at(model, named)
    found = mbdlft.compile(scene("two_link_arm"))(named)
    for part, other in zip(found[:4], expected, strict=True):
        roundoff(part, other, kappa=10.0)
    roundoff(found.trim, mbdlft.trim_at(model, named), kappa=10.0)
    assert found.status.tolist() == [0] * 20
    assert mbdlft.compile(scene("two_link_arm"))({}).A.shape == (1, 4, 4)


def test_what_is_lost_is_asked_of_the_definition(monkeypatch: pytest.MonkeyPatch) -> None:
    found = mbdlft.compile(scene("two_link_arm"), threads=1)
    at = probes(found, 40)
    expected = found.source.rows(at)
    calls = []

    def all_lost(_: object, points: np.ndarray, row: object, values: np.ndarray, *__: object) -> Any:
        values[:] = np.nan
        calls.append(len(points))
        return np.ones(len(points), dtype=bool)

    monkeypatch.setattr(engine, "run_natively", all_lost)
    for part, other in zip(found.rows(at), expected, strict=True):
        exact(part, other)
    assert calls == [40]


def test_a_scene_without_parameters() -> None:
    found = mbdlft.compile(cart())
    assert found.parameters == ()
    rows = found({})
    roundoff(rows.A[0], mbdlft.to_lft(cart(), search=0.0).A)
    assert found.rows(np.zeros((11, 0)))[0].shape == (11, *found.layout.matrix_shape)


def test_numbers_are_shared(cache: Path) -> None:
    text = mbdlft.scene_to_toml(scene("two_link_arm"))
    other = mbdlft.scene_from_toml(text.replace("= 0.1\n", "= 0.35\n"))
    assert mbdlft.scene_to_toml(other) != text
    first = mbdlft.compile(scene("two_link_arm"))
    assert len(list(cache.glob("*.o"))) == 1
    second = mbdlft.compile(other)
    assert len(list(cache.glob("*.o"))) == 1
    at = probes(second, 20)
    roundoff(second.rows(at)[0], source_of(other).rows(at)[0], kappa=10.0)
    assert np.max(np.abs(first.rows(at)[0] - second.rows(at)[0])) > 1e-3


def test_damaged_code_is_not_run(cache: Path) -> None:
    program, row = drawn(2, 30)
    at = points(16)
    expected = np.empty((16, len(row)))
    run_natively(compile_native(program, len(row), Cache(cache)), at, row, expected)
    (file,) = cache.iterdir()
    whole = file.read_bytes()
    for damage in (
        whole[:-1],
        b"",
        whole[:40],
        bytes([whole[0] ^ 1]) + whole[1:],
        whole[:99] + b"!" + whole[100:],
    ):
        file.write_bytes(damage)
        assert Cache(cache).get(file.stem) is None
        found = np.empty_like(expected)
        run_natively(compile_native(program, len(row), Cache(cache)), at, row, found)
        assert np.array_equal(found, expected, equal_nan=True)
        assert file.read_bytes()[:32] == whole[:32]  # it was compiled and kept again


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="folders of users are private")
def test_what_others_can_write_to_is_not_run(cache: Path) -> None:
    kept, key = Cache(cache), key_of("text", "processor")
    assert kept.put(key, b"code")
    assert kept.get(key) == b"code"
    assert cache.stat().st_mode & 0o077 == 0
    for path, mode in ((cache / f"{key}.o", 0o666), (cache, 0o777)):
        before = path.stat().st_mode
        path.chmod(mode)
        assert kept.get(key) is None
        path.chmod(before)
    cache.chmod(0o770)
    assert not kept.put(key, b"other")
    cache.chmod(0o700)
    (cache / f"{key}.o").rename(cache / "elsewhere")
    (cache / f"{key}.o").symlink_to(cache / "elsewhere")
    assert kept.get(key) is None


def test_writers_do_not_disturb_each_other(cache: Path) -> None:
    kept = Cache(cache)
    keys = [key_of(str(k % 3)) for k in range(24)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda key: kept.put(key, key.encode() * 1000), keys))
        found = list(pool.map(kept.get, keys))
    assert found == [key.encode() * 1000 for key in keys]
    assert len(list(cache.iterdir())) == 3


def test_a_cache_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "file"
    file.write_text("", encoding="ascii")
    monkeypatch.setenv("MBDLFT_CACHE", str(file / "below"))
    assert not mbdlft.compile(scene("pendulum")).reason
    monkeypatch.setenv("MBDLFT_CACHE", "")
    assert user_cache() is None
    assert not mbdlft.compile(scene("pendulum")).reason


def test_without_the_compiler_numpy_computes(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, broken, said in (
        ("is_available", lambda: False, "llvmlite is not installed"),
        ("compile_native", lambda *_: 1 / 0, "LLVM failed: ZeroDivisionError"),
        ("_LONGEST", 3, "more than 3 instructions"),
        ("_agrees", lambda *_: False, "differs from the definition"),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(module if hasattr(module, name) else engine, name, broken)
            with pytest.warns(MbdlftWarning, match=said):
                found = mbdlft.compile(scene("two_link_arm"))
        assert found.program is None
        at = probes(found, 10)
        exact(found.rows(at)[0], found.source.rows(at)[0])
        assert found.chunk == found.source.chunk


def test_bad_arguments() -> None:
    with pytest.raises(mbdlft.AnalysisError, match="at least 1 thread, got 0"):
        mbdlft.compile(scene("pendulum"), threads=0)
    with pytest.raises(mbdlft.AnalysisError, match="m9"):
        mbdlft.compile(scene("two_link_arm"))({"m9": 1.0})


def test_sweeps_of_many_samples_are_native(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_WORTH", 300)
    made = []
    before = module.compiled

    def counted(*arguments: object, **named: object) -> Compiled:
        made.append(1)
        return before(*arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(module, "compiled", counted)
    arm = scene("two_link_arm")
    archive = tmp_path / "sweep.h5"
    samples = mbdlft.random(arm.parameters, 300)
    first = {name: values[:299] for name, values in samples.items()}
    mbdlft.sweep(arm, first, archive, name="few", workers=1)
    assert not made
    mbdlft.sweep(arm, samples, archive, name="many", workers=1)
    assert made
    few, many = (mbdlft.load_sweep(archive, name) for name in ("few", "many"))
    roundoff(many.A[:299], few.A, kappa=10.0)
    roundoff(many.trim[:299], few.trim, kappa=10.0)


def test_large_evaluations_are_native_and_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    from mbdlft.lft import sampling

    model = mbdlft.to_lft(scene("two_link_arm"), search=0.0)
    samples = mbdlft.random(model.parameters, 2 * sampling.MANY)
    expected = mbdlft.matrices_at(model, samples)
    monkeypatch.setattr(sampling, "NATIVE", sampling.MANY)
    calls = []
    monkeypatch.setattr(engine, "run_natively", lambda *a: calls.append(1) or run_natively(*a))
    for part, other in zip(mbdlft.matrices_at(model, samples), expected, strict=True):
        exact(part, other)
    assert calls


def test_no_warning_where_there_is_code() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        mbdlft.compile(scene("pendulum"))
