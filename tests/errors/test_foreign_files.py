"""Files of other people: too large, of another kind, with lies about their sizes; and long messages."""

import io
import shutil
import subprocess
import sys
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from mbdlft import MbdlftError, Scene, SceneError, StructureError, load_scene
from mbdlft.base import worker
from mbdlft.base.errors import shortened, unknown_name
from mbdlft.elastic import load_matrices, load_nastran
from mbdlft.robot import load_robot
from tests.attack.scenes import CART
from tests.errors.scenes import ARM
from tests.errors.table import refused, says

ROOT = Path(__file__).parents[2]
HANGS = ROOT / "tests/archive/damaged/hang9.h5"


def packed(file: Path, name: str, data: bytes) -> Path:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, data)
    return file


def header(shape: tuple[int, ...], kind: str = "<f8") -> bytes:
    image = io.BytesIO()
    np.lib.format.write_array_header_1_0(image, {"descr": kind, "fortran_order": False, "shape": shape})
    return image.getvalue()


@pytest.fixture
def npz(tmp_path: Path) -> Callable[..., Path]:
    return lambda data, name="mass.npy": packed(tmp_path / "a.npz", name, data)


@pytest.fixture
def arrays(tmp_path: Path) -> Callable[..., Path]:
    """A file of one coordinate with some of its arrays changed."""
    one = {"numbers": [1], "coordinates": np.zeros((1, 3)), "dof": [[1, 1]], "stiffness": [[1.0]]}
    sparse = {"mass.row": [0], "mass.column": [0], "mass.value": [1.0]}

    def write(changed: dict[str, Any]) -> Path:
        np.savez(tmp_path / "a.npz", **{**one, **sparse, **changed})
        return tmp_path / "a.npz"

    return write


@pytest.fixture
def hdf5(tmp_path: Path) -> Callable[..., Path]:
    def write(make: Callable[[h5py.File], object]) -> Path:
        with h5py.File(tmp_path / "a.h5", "w") as archive:
            make(archive)
        return tmp_path / "a.h5"

    return write


@pytest.fixture
def mtx(tmp_path: Path) -> Callable[[str], Path]:
    def write(text: str) -> Path:
        (tmp_path / "a.nodes.txt").write_text("1 0 0 0 1\n")
        (tmp_path / "a.mass.mtx").write_text(f"%%MatrixMarket matrix {text}")
        return tmp_path / "a.mass.mtx"

    return write


def objects() -> bytes:
    image = io.BytesIO()
    np.save(image, np.array([{}]), allow_pickle=True)
    return image.getvalue()


test_messages_of_matrices = pytest.mark.usefixtures("read_here")(
    refused(
        r"""
> load_matrices(npz({})) => StructureError: a.npz …
header((2**40,)) => : needs 8796093022208 bytes of memory at 'mass', expected at
header((4,)) + bytes(31) => mass: expected 32 bytes of (4,), got 31
header((-4,)) => mass: has shape (-4,)
objects() => mass: expected numbers, got object; objects are not read
b"\x93NUMPY\x03\x00" + bytes(100) => mass: has npy version (3, 0), expected 1.0 or 2.0
> load_matrices(arrays({})) => StructureError: a.npz: …
{"mass.row": [0.5]} => mass.row: expected whole numbers, got float64
{"mass.column": [0.5]} => mass.column: expected whole numbers, got float64
{"numbers": np.array([2**63 + 1], "u8")} => numbers: 9223372036854775809 is too large
{"dof": np.array([[2**63 + 1, 1]], "u8")} => dof: 9223372036854775809 is too large
{str(k): k for k in range(101)} => has 108 arrays, expected at most 100
> load_matrices({}) => StructureError:
npz(header((2**20,)) + bytes(2**23)), limit=10**6
    => needs 8388608 bytes of memory at 'mass', expected at most 1000000
> load_matrices(hdf5(lambda f: {})) => StructureError: a.h5: …
f.__setitem__("A", h5py.ExternalLink("b", "/")) => 'A' is a link to another place
f.create_group("A") => 'A' is not an array
f.__setitem__("A", ["x"]) => 'A': expected numbers, got object
f.create_dataset("A", (2,), "<f8", external=[("b", 0, 16)]) => 'A' takes its numbers from another place
f.create_dataset("A", (2**20, 2**20), "<f8", chunks=(9, 9))
    => bytes of memory at 'A', expected at most 2147483648
> load_matrices(mtx({})) => StructureError: a.mass.mtx: …
"array real general\n1000000 1000000\n" => needs 8000000000000 bytes of memory
"coordinate real general\n9 9 99999\n" => says that it has 99999 entries, more than it has
"coordinate complex general\n1 1 1\n1 1 1 1\n" => expected real numbers, got complex
"""
    )
)


@pytest.mark.usefixtures("read_here")
def test_an_array_is_in_memory_once(tmp_path: Path) -> None:
    """A file of 2 GB needed 4: it was read as bytes, and these were copied."""
    size = 2**25
    file = packed(tmp_path / "a.npz", "mass.npy", header((size // 8,)) + bytes(size))
    tracemalloc.start()
    try:
        with says(StructureError, f"{file}: "):
            load_matrices(file)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert size < peak < 1.5 * size


def test_files_that_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for read in (load_scene, load_robot):
        with says(SceneError, "/dev/zero: cannot be read: it is not a regular file"):
            read("/dev/zero")
    with says(StructureError, f"{tmp_path}: cannot be read: Is a directory"):
        load_nastran(tmp_path, tmp_path)
    monkeypatch.setattr(worker.content_of, "__defaults__", (10,))
    (tmp_path / "a.toml").write_text(ARM)
    with says(SceneError, "a.toml: has more than 10 bytes, expected a smaller file"):
        load_scene(tmp_path / "a.toml")


def broken_boom(**fields: float) -> Scene:
    cart, boom = CART.bodies
    return CART.model_copy(update={"bodies": (cart, boom.model_copy(update=fields))})


def encoded(folder: Path, encoding: str) -> Path:
    file = folder / "a.urdf"
    file.write_text(f'<?xml version="1.0" encoding="{encoding}"?><robot name="é"/>', "utf-8")
    return file


test_messages = refused(
    r"""
> load_robot(encoded(tmp_path, {})) => SceneError: a.urdf: line 1:
"{shift_jis|none|utf-7}"
> load_matrices({}) => StructureError:
shutil.copy(HANGS, tmp_path / "a.h5") => a.h5:
# products of these are no numbers any more; they ended in an error of numpy
> to_lft(broken_boom({}), search=0.0) => MbdlftError: body 'boom': an entry of its matrices is
modulus=1e305
density=1e155
> worker.arrays_of("tests.dying:read", {"what": {}}, seconds=0, memory=2**28, error=SceneError)
"loop" => its reader did not end as it should
> worker.arrays_of("tests.dying:read", {"what": {}}, seconds=1, memory=2**28, error=SceneError)
"memory" => cannot be read: Unable to allocate
"die" => its reader did not end as it should (exit code 3)
"error" => cannot be read: lost
"named" => named
"""
)


def test_readers_apart_that_do_not_end_or_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = "tests.dying:read"
    found = worker.arrays_of(target, {"what": "print"}, seconds=5, memory=2**28, error=SceneError)
    assert found["a"].tolist() == [0, 1, 2]
    (tmp_path / "slow_to_import.py").write_text("import time\nwhile time.process_time() < 1.2: pass\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    limits: dict[str, Any] = {"seconds": 0, "memory": 2**28, "libraries": ("slow_to_import",)}
    assert worker.arrays_of(target, {"what": "library"}, **limits, error=SceneError)["a"].size == 3
    monkeypatch.setattr(worker, "_START", 0.0)
    monkeypatch.setattr(worker, "_CLOCK", 0.01)
    with says(SceneError, "its reader did not end as it should (it did not end)"):
        worker.arrays_of(target, {"what": ""}, seconds=1, memory=2**28, error=SceneError)
    monkeypatch.setattr(sys, "executable", "/none")
    with says(SceneError, "the process that reads it does not start"):
        worker.arrays_of(target, {"what": ""}, seconds=1, memory=2**28, error=SceneError)


def test_mjcf_that_asks_for_all_memory_is_compiled_apart(tmp_path: Path) -> None:
    pytest.importorskip("mujoco", reason="MJCF needs mujoco")
    file = tmp_path / "robot.xml"
    text = (
        '<mujoco><asset><hfield name="q" nrow="{0}" ncol="{0}" size="1 1 1 1"/></asset><worldbody>'
        '<body name="b"><joint type="hinge"/><geom size="1"/></body></worldbody></mujoco>'
    )
    file.write_text(text.format(100), encoding="utf-8")
    assert load_robot(file)[0].bodies[0].name == "b"
    file.write_text(text.format(100_000), encoding="utf-8")
    with says(SceneError, "robot.xml: mujoco cannot compile it", "2048 MB of memory"):
        load_robot(file)


def test_messages_are_short() -> None:
    """2 kB, with the beginning and the end; words are cut first."""
    assert shortened("x " * 900) == "x " * 900
    word = shortened(f"body {'x' * 5000!r} is unknown. Try y.")
    assert len(word) < 200
    assert word.startswith("body 'xxx")
    assert word.endswith("is unknown. Try y.")
    for text in ("x " * 5000, "日本 " * 5000, "\ud800 " * 5000, "x" * 100_000):
        for error in (MbdlftError, SceneError, StructureError):
            found = str(error(text)).encode("utf-8", "replace")
            assert len(found) <= 2000
    assert str(SceneError(shortened("a " * 5000 + "advice"))).endswith("advice")


def test_unknown_names_among_many() -> None:
    names = [f"a{k}" for k in range(10_000)]
    text = unknown_name("body", "x" * 100_000, [*names, "y" * 100_000])
    assert text.endswith("and 9961 more.")
    assert len(text) < 600
    assert "Did you mean 'a1'" in unknown_name("body", "a1x", names)


def run(*arguments: str, **options: object) -> "subprocess.CompletedProcess[bytes]":
    program = "from mbdlft.cli.commands import main; main()"
    return subprocess.run([sys.executable, "-c", program, *arguments], cwd=ROOT, check=False, **options)  # type: ignore[call-overload,no-any-return]


@pytest.mark.long
def test_terminals_without_letters_and_disks_without_space(tmp_path: Path) -> None:
    import os

    scene = tmp_path / "a.toml"
    scene.write_text(ARM.replace('"two_link_arm"', '"arm θ₁ 日本"'), encoding="utf-8")
    ascii_only = {**os.environ, "PYTHONIOENCODING": "ascii", "LANG": "C"}
    both = {"capture_output": True, "env": ascii_only}
    done = run("check", str(scene), **both)
    assert done.returncode == 0
    assert rb"arm \u03b8\u2081" in done.stdout
    done = run("check", str(tmp_path / "日本.toml"), **both)
    assert (done.returncode, done.stdout) == (2, b"")
    assert done.stderr.startswith(b"mbdlft: ")
    assert b"Traceback" not in done.stderr
    with Path("/dev/full").open("wb") as full:
        for arguments in (("check", str(scene)), ("linearize", str(scene), "--json")):
            done = run(*arguments, stdout=full, stderr=subprocess.PIPE)
            assert done.returncode == 2
            assert done.stderr == b"mbdlft: the output cannot be written: No space left on device.\n"
    done = run("linearize", str(scene), "-o", "/dev/full", capture_output=True)
    assert (done.returncode, done.stdout) == (2, b"")
    assert done.stderr == b"mbdlft: /dev/full: cannot be read: it is not a regular file.\n"
    reader, writer = os.pipe()
    os.close(reader)
    done = run("check", str(scene), stdout=writer, stderr=subprocess.PIPE)
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, b"")
