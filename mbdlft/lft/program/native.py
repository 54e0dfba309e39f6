"""Straight-line programs as native code, compiled by LLVM for the processor at hand, and its cache.

It runs on vectors of four samples, eight where the processor has vectors of that length, with as many
threads as there are cores. Results are bit for bit those of `run`, but for cosines and sines (`llvm.py`).

Compiled code is kept in a folder, by content: the text it was made from, and the processor. It is run as
it is read, so a folder or a file that others may write to is not used. Each file begins with the digest
of its key and its code, and is written beside its place and then moved there: writers do not disturb each
other, and what is damaged is compiled again.
"""

import ctypes
import hashlib
import os
import stat
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.base.worker import cores
from mbdlft.lft.program.llvm import Code, code
from mbdlft.lft.program.tape import Program

_ALIGNED = 64  # bytes of a vector
_SAMPLES = 8192  # of a chunk, as many as a thread gets at a time
_OPTIMIZED = 2  # level of LLVM; 3 takes longer and is not faster here
_POINTER = ctypes.c_void_p
_KIND = ctypes.CFUNCTYPE(None, *([ctypes.c_int64] * 3), *([_POINTER] * 7))


_DIGEST = 32
_FOLDER = "MBDLFT_CACHE"  # environment variable; empty for no cache


@dataclass(frozen=True, slots=True)
class Cache:
    """A folder of native code."""

    folder: Path

    def get(self, key: str, kind: str = "o") -> bytes | None:
        """The code of a key; None if it is not there, is damaged, or others may have written it."""
        path = self._path(key, kind)
        try:
            if not (_is_private(self.folder) and _is_private(path)):
                return None
            image = path.read_bytes()
        except OSError:
            return None
        code = image[_DIGEST:]
        return code if code and image[:_DIGEST] == _digest(key, code) else None

    def put(self, key: str, code: bytes, kind: str = "o") -> bool:
        """Keep code; whether that was possible."""
        try:
            self.folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            if not _is_private(self.folder):
                return False
            handle, name = tempfile.mkstemp(dir=self.folder)
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(_digest(key, code) + code)
                Path(name).replace(self._path(key, kind))
            except BaseException:
                Path(name).unlink(missing_ok=True)
                raise
        except OSError:
            return False
        return True

    def _path(self, key: str, kind: str) -> Path:
        return self.folder / f"{key}.{kind}"


def user_cache() -> Cache | None:
    """The folder of this user: `MBDLFT_CACHE`, or the one for such files; None if that is empty."""
    chosen = os.environ.get(_FOLDER)
    if chosen is not None:
        return Cache(Path(chosen).expanduser()) if chosen else None
    try:
        home = Path.home()
    except RuntimeError:
        return None
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local")
    elif sys.platform == "darwin":
        base = home / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache")
    return Cache(base / "mbdlft")


def key_of(*texts: str) -> str:
    """The key of a text and of what it is compiled for."""
    digest = hashlib.sha256()
    for text in texts:
        digest.update(f"{len(text)}:".encode() + text.encode())
    return digest.hexdigest()


def _digest(key: str, code: bytes) -> bytes:
    return hashlib.sha256(key.encode() + code).digest()


def _is_private(path: Path) -> bool:
    """Whether a file or folder is this user's, and nobody else may write to it."""
    if not hasattr(os, "getuid"):  # Windows: its folders of users are private
        return True
    status = path.stat(follow_symlinks=False)
    kind = stat.S_ISDIR(status.st_mode) or stat.S_ISREG(status.st_mode)
    return kind and status.st_uid == os.getuid() and not status.st_mode & 0o022


def is_available() -> bool:
    """Whether llvmlite is installed."""
    return find_spec("llvmlite") is not None


@dataclass(frozen=True, slots=True, eq=False)
class NativeProgram:
    """A program as native code: `size` are the entries of a row; `engine` owns the memory of `call`."""

    size: int
    code: Code
    numbers: Array
    call: Any
    engine: Any


def compile_native(program: Program, size: int, cache: Cache | None = None) -> NativeProgram:
    """Compile a program whose entries have the places (0, k), k < size in rows, or find its code."""
    compiled = code(program, size, _lanes())
    call, engine = _loaded(compiled.text, cache)
    return NativeProgram(size, compiled, np.array(compiled.numbers or (0.0,)), call, engine)


def run_natively(
    program: NativeProgram,
    points: Array,
    row: Array,
    values: Array,
    threads: int | None = None,
    columns: Array | None = None,
) -> NDArray[np.bool_]:
    """Write whole rows of values (N, size): the entries of the program, others as in `row` (size,).

    `points` are (N, inputs of the program), column by column in memory, or copied. Entries with the
    places (0, size + k) go to columns (k, N), which have their constants.
    There are as many threads as cores by default. True (N,) where a pivot has lost digits, as in `run`.
    """
    count, lanes = len(points), program.code.lanes
    lost = np.zeros(count, dtype=np.uint8)
    points = np.asfortranarray(points, dtype=float)
    row = np.ascontiguousarray(row, dtype=float)
    columns = np.empty((0, count)) if columns is None else columns
    assert row.shape == (program.size,)
    assert values.shape == (count, program.size)
    assert values.flags.c_contiguous
    assert columns.shape[1:] == (count,)
    assert columns.strides[1] == columns.itemsize or not columns.size

    def fill(start: int) -> None:
        some = slice(start, min(start + _SAMPLES, whole))
        _call(program, points[some], row, values[some], columns[:, some], lost[some])

    whole = count - count % lanes
    starts = range(0, whole, _SAMPLES)
    workers = min(threads or cores(), len(starts))
    if workers > 1:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(fill, starts))
    else:
        for start in starts:
            fill(start)
    if count > whole:  # a vector that is filled up with the last sample
        last = np.asfortranarray(points[np.minimum(np.arange(whole, whole + lanes), count - 1)])
        rows, beside = np.empty((lanes, program.size)), np.repeat(columns[:, whole, None], lanes, axis=1)
        bad = np.empty(lanes, dtype=np.uint8)
        _call(program, last, row, rows, beside, bad)
        some = slice(count - whole)
        values[whole:], columns[:, whole:], lost[whole:] = rows[some], beside[:, some], bad[some]
    return lost.view(bool)


def _call(
    program: NativeProgram,
    points: Array,
    row: Array,
    values: Array,
    columns: Array,
    lost: NDArray[np.uint8],
) -> None:
    """Call the native code for whole vectors of samples."""
    lanes = program.code.lanes
    arrays = (points, program.numbers, aligned(program.code.slots * lanes), row, values, columns, lost)
    strides = points.strides[1] // points.itemsize, columns.strides[0] // columns.itemsize
    program.call(len(points) // lanes, *strides, *(array.ctypes.data for array in arrays))


def aligned(count: int) -> Array:
    """An array of so many numbers that begins where vectors may begin."""
    room = np.empty(count + _ALIGNED // 8)
    start = (-room.ctypes.data % _ALIGNED) // 8
    return room[start : start + count]


def _lanes() -> int:
    """Samples of a vector of this processor."""
    import llvmlite.binding as llvm

    return 8 if llvm.get_host_cpu_features().get("avx512f") else 4


def _loaded(text: str, cache: Cache | None) -> tuple[Any, Any]:
    """The function of a text, and what owns its memory."""
    import llvmlite
    import llvmlite.binding as llvm

    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    processor, features = llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    machine = partial(
        target.create_target_machine, cpu=processor, features=features, opt=_OPTIMIZED, jit=True
    )
    key = key_of(text, processor, features, target.name, llvmlite.__version__)
    compiled = cache.get(key) if cache else None
    if compiled is None:
        compiled = machine().emit_object(llvm.parse_assembly(text))
        if cache:
            cache.put(key, compiled)
    # an engine owns its machine
    engine = llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())
    engine.add_object_file(llvm.ObjectFileRef.from_data(compiled))
    engine.finalize_object()
    return _KIND(engine.get_function_address("samples")), engine
