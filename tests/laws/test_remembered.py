"""Programs of scenes that were compiled before: the same bits, and nothing else is taken for one.

1. the second time nothing is assembled; samples that the program cannot do are asked of the definition
2. another scene, another file of the package or of a user's kind, another version is another program
3. what is damaged, or others can write to, is made again
"""

from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import Parameter, TrimError
from mbdlft.base.samples import check_points
from mbdlft.batch import native as module
from mbdlft.batch import program_cache
from mbdlft.batch.rows import source_of
from mbdlft.lft.program.native import Cache
from mbdlft.problem import trim
from tests.close import exact
from tests.errors.scenes import cart

pytest.importorskip("llvmlite")
SCENARIOS = Path(__file__).parents[2] / "scenarios"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "native"
    monkeypatch.setenv("MBDLFT_CACHE", str(folder))
    return folder


def scene(name: str) -> mbdlft.Scene:
    return mbdlft.load_scene(SCENARIOS / f"{name}.toml")


def nothing(*_: object) -> None:
    raise AssertionError("the scene is assembled")


@pytest.mark.parametrize("name", ["two_link_arm", "flexible_manipulator", "crane", "pendulum"])
def test_the_second_time_nothing_is_assembled(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    first = mbdlft.compile(scene(name), threads=1)
    with monkeypatch.context() as patch:
        for where in (module, program_cache):
            patch.setattr(where, "source_of", nothing)
        second = mbdlft.compile(scene(name), threads=1)
        assert (second.computes, second.reason) == ("equations", "")
        assert second.layout == first.layout
        assert second.parameters == first.parameters
        assert second.source.chunk == first.source.chunk
        at = check_points(second.parameters, 3)[:203]
        for part, other in zip(second.rows(at), first.rows(at), strict=True):
            exact(part, other)


def test_samples_without_a_solution() -> None:
    force = Parameter("f", 0.0, low=-1.0, high=1.0, unit="N")
    mass = Parameter("m", 1.0, low=0.0, high=2.0, unit="kg")
    values = {"f": np.array([0.0, 0.0, 0.5, 1.0, 0.0]), "m": np.array([0.0, 1.0, 1.0, 0.0, 0.5])}
    given = cart("m", [force, mass], {"preload": "f"})
    first, second = (mbdlft.compile(given) for _ in range(2))
    assert isinstance(second.source, program_cache.SceneSource)
    rows = second(values)
    assert rows.status.tolist() == [1, 0, 2, 2, 0]
    for part, other in zip(rows, first(values), strict=True):
        assert np.array_equal(part, other, equal_nan=True)


def test_loads_through_elastic_bodies_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = (mbdlft.compile(scene("solar_arrays"), threads=1) for _ in range(2))
    assert isinstance(second.source, program_cache.SceneSource)
    at = check_points(second.parameters, 3)[:20]
    for found in (first, second):
        found.rows(at)
    for where in (module, trim):  # planted: no wrench at all is too much
        monkeypatch.setattr(where, "CARRIED", Less())
    for found in (first, second):
        with pytest.raises(TrimError, match="is elastic and carries a load at equilibrium"):
            found.rows(at)


class Less(float):
    """A part of anything that is less than nothing."""

    def __mul__(self, _: object) -> float:
        return -1.0


def kept(folder: Path) -> int:
    return len(list(folder.glob("*.program")))


def test_what_is_another_program(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    mbdlft.compile(cart())
    mbdlft.compile(cart())
    assert kept(cache) == 1
    mbdlft.compile(cart(0.8))
    assert kept(cache) == 2
    with monkeypatch.context() as patch:
        patch.setattr(program_cache, "_package", lambda: "changed")
        mbdlft.compile(cart())
    assert kept(cache) == 3
    with monkeypatch.context() as patch:
        patch.setattr(program_cache, "_file", lambda _: __file__)  # a kind of a user
        mbdlft.compile(cart())
    assert kept(cache) == 4
    # a line for each file of the package
    files = len(list(Path(program_cache.__file__).parents[1].rglob("*.py")))
    assert program_cache._package().count("\n") + 1 == files
    assert program_cache._file(type(cart().bodies[0])) is None
    assert program_cache._file(Path) is not None
    monkeypatch.setattr(program_cache, "version", lambda _: "9")
    mbdlft.compile(cart())
    assert kept(cache) == 5


def test_what_is_not_as_it_was_written(cache: Path) -> None:
    expected = mbdlft.compile(cart(), threads=1).rows(np.zeros((3, 0)))
    (file,) = cache.glob("*.program")
    whole = file.read_bytes()
    for damage in (b"", whole[:50], whole[:-1], whole[:60] + b"!" + whole[61:]):
        file.write_bytes(damage)
        assert program_cache.remembered(cart()) is None
        found = mbdlft.compile(cart(), threads=1)
        assert file.read_bytes() == whole
        for part, other in zip(found.rows(np.zeros((3, 0))), expected, strict=True):
            exact(part, other)
    # whole, of this user, and nonsense
    for image in (b"nonsense", whole[32:90], b"PK\x05\x06" + bytes(18)):
        Cache(cache).put(file.stem, image, "program")
        assert program_cache.remembered(cart()) is None
    file.write_bytes(whole)
    file.chmod(0o666)
    assert program_cache.remembered(cart()) is None


def test_code_that_cannot_be_loaded(monkeypatch: pytest.MonkeyPatch) -> None:
    mbdlft.compile(cart())
    with monkeypatch.context() as patch:
        patch.setattr(module, "compile_native", lambda *_: 1 / 0)
        with pytest.warns(mbdlft.MbdlftWarning, match="LLVM failed: ZeroDivisionError"):
            assert mbdlft.compile(cart()).program is None
    assert source_of(cart()).layout == mbdlft.compile(cart()).layout


def test_without_a_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MBDLFT_CACHE", "")
    for _ in range(2):
        assert not isinstance(mbdlft.compile(cart()).source, program_cache.SceneSource)
