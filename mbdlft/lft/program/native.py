"""Straight-line programs as native code, compiled by LLVM for the processor at hand, and its cache.

Cosines and sines are numpy's; all else runs on vectors of eight samples, with as many threads as there
are cores. Results are bit for bit those of `run`.

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
from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mbdlft.base.array import Array
from mbdlft.lft.program.llvm import LANES, Code, code
from mbdlft.lft.program.tape import COSINE, SINE, Plan, Program, needed, plan, renamed, run

_ALIGNED = 64  # bytes of a vector
_SAMPLES = 2048  # of a chunk: what comes in stays near a core
_OPTIMIZED = 2  # level of LLVM; 3 takes longer and is not faster here
_POINTER = ctypes.c_void_p
_KIND = ctypes.CFUNCTYPE(None, ctypes.c_int64, *([_POINTER] * 6))


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
    """A program as native code.

    `first` is what is done by numpy: cosines, sines and their arguments. `inputs` are those of the native
    function `call`, whose memory `engine` owns; `size` are the entries of a row.
    """

    first: Plan | None
    inputs: int
    size: int
    code: Code
    call: Any
    engine: Any


def compile_native(program: Program, size: int, cache: Cache | None = None) -> NativeProgram:
    """Compile a program whose entries have the places (0, k) in rows of a size, or find its code."""
    first, without_circles = _without_circles(program)
    compiled = code(without_circles, size)
    call, engine = _loaded(compiled.text, cache)
    return NativeProgram(first, without_circles.inputs, size, compiled, call, engine)


def run_natively(
    program: NativeProgram, points: Array, row: Array, values: Array, threads: int | None = None
) -> NDArray[np.bool_]:
    """Write whole rows of values (N, size): the entries of the program, others as in `row` (size,).

    `points` are (N, inputs of the program), and there are as many threads as cores by default. True (N,)
    where a pivot has lost digits, as in `run`.
    """
    count = len(points)
    whole = count - count % LANES
    lost = np.zeros(count, dtype=np.uint8)
    numbers = np.array(program.code.numbers or (0.0,))
    row = np.ascontiguousarray(row, dtype=float)
    assert row.shape == (program.size,)
    assert values.shape == (count, program.size)
    assert values.flags.c_contiguous

    def fill(start: int) -> None:
        chunk = slice(start, min(start + _SAMPLES, whole))
        _call(program, points[chunk], numbers, row, values[chunk], lost[chunk])

    starts = range(0, whole, _SAMPLES)
    workers = min(threads or _cores(), len(starts))
    if workers > 1:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(fill, starts))
    else:
        for start in starts:
            fill(start)
    if count > whole:
        last = np.concatenate([points[whole:], np.tile(points[-1], (whole + LANES - count, 1))])
        last_rows, last_lost = np.empty((LANES, program.size)), np.zeros(LANES, dtype=np.uint8)
        _call(program, last, numbers, row, last_rows, last_lost)
        values[whole:], lost[whole:] = last_rows[: count - whole], last_lost[: count - whole]
    return lost.astype(bool)


def _call(
    program: NativeProgram,
    points: Array,
    numbers: Array,
    row: Array,
    values: Array,
    lost: NDArray[np.uint8],
) -> None:
    """Call the native code for whole vectors of samples."""
    count, blocks = points.shape[1], len(points) // LANES
    packed = _aligned(len(points) * program.inputs).reshape(blocks, program.inputs, LANES)
    packed[:, :count] = points.reshape(blocks, LANES, count).transpose(0, 2, 1)
    if program.first is not None:
        circles = np.empty((len(points), 1, program.inputs - count))
        run(program.first, points, circles)
        packed[:, count:] = circles.reshape(blocks, LANES, -1).transpose(0, 2, 1)
    arrays = (packed, numbers, _aligned(program.code.slots * LANES), row, values, lost)
    program.call(blocks, *(array.ctypes.data for array in arrays))


def _aligned(count: int) -> Array:
    """An array of so many numbers that begins where vectors may begin."""
    room = np.empty(count + _ALIGNED // 8)
    start = (-room.ctypes.data % _ALIGNED) // 8
    return room[start : start + count]


def _cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _without_circles(program: Program) -> tuple[Plan | None, Program]:
    """The cosines and sines of a program, and what is left, to which they are inputs."""
    kept = needed(program)
    circles = [i.target for i in kept if i.operation in (COSINE, SINE)]
    if not circles:
        return None, replace(program, instructions=tuple(kept))
    entries = tuple(((0, k), register) for k, register in enumerate(circles))
    first = plan(Program(program.inputs, tuple(kept), entries, ()))
    names = {register: program.inputs + k for k, register in enumerate(circles)}

    def name(register: int) -> int:
        is_input = register < program.inputs
        return register if is_input else names.get(register, register + len(circles))

    others = [i for i in kept if i.target not in names]
    return first, renamed(program, program.inputs + len(circles), others, name)


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
