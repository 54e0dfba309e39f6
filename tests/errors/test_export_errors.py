"""What cannot be exported is one message, and no file is left half written."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mbdlft
from mbdlft import ComplexBlock, FullBlock, Parameter
from mbdlft.base.errors import AnalysisError, ArchiveError, MbdlftError, StructureError
from mbdlft.cli.files import _counts
from mbdlft.export import dataset, export_model, lpv_grid
from mbdlft.lft import LFT
from mbdlft.lft.lft import delta
from mbdlft.system import System
from tests.archive.models import arm, numbers
from tests.errors.table import MessageError, refused
from tests.scenarios.commands import Call, Output

ARM = str(Path(__file__).parents[2] / "scenarios" / "two_link_arm.toml")


@pytest.fixture
def exported(tmp_path: Path) -> Callable[..., None]:
    """Export into an empty folder, which stays empty."""

    def export(name: str, model: mbdlft.LFTModel | System, counts: int | None = None) -> None:
        try:
            export_model(tmp_path / name, model, counts)
        finally:
            assert list(tmp_path.iterdir()) == []

    return export


COMPLEX = mbdlft.as_system(np.array([[1.0 + 2.0j]]), name="a")
test_messages = refused(
    r"""
> {} => StructureError:
export_model(tmp_path / 'a.mat', replace(one('tan_half_theta'), lft=one('tan_half_theta').lft +
    delta('theta'), parameters=(one('tan_half_theta').parameters[0], mbdlft.Angle('theta', 10.0, 0.0,
    20.0))))
    => elements of MATLAB: the names … 'tan_half_theta'
export_model(tmp_path / "grid.csv", one("D_1_1"), 2) => columns of the table clash: D_1_1 … .npz or .mat
> exported({}) => StructureError:
"arm.txt", arm() => .mat, .c, .fmu, .jl, .mo; a grid (--grid) as .mat, .csv, .npz
"arm", arm() => unknown ending ''
"arm.csv", arm() => a model is written as .mat, .c, .fmu, .jl, .mo
"arm.c", arm(), 3 => a grid is written as .mat, .csv, .npz; a model as .mat, .c, .fmu, .jl, .mo
"2 arms.mat", arm() => Call it x2_arms.mat
"end.mat", arm() => Call it end_.mat
'a"b.c', arm() => cannot include
"{one.mat|one.c}", one("theta", "θ") => 'theta' and 'θ' clash: both become 'theta'
"grid.mat", one("theta", "θ"), 2 => clash
"a.c", unknown({ComplexBlock|FullBlock}("unknown", 1)) =~ unknown \((complex|full)\)\. Export it as \.mat
"a.jl", unknown({ComplexBlock|FullBlock}("unknown", 1)) =~ unknown \((complex|full)\)\. Export it as \.mat
"a.fmu", unknown(FullBlock("unknown", 1)) => unknown (full). Export it as .mat
> export_model(tmp_path / "a.fmu", {}) => StructureError:
arm(), fmi=1 => FMI 1 is unknown; 3 and 2 are written
> dataset({}) => StructureError:
one("input") => parameter 'input' has the name of an array
one("omega"), {}, [1.0] => parameter 'omega' has the name of an array
one("input_unit") => parameter 'input_unit' has the name of an array
> lpv_grid(unknown({ComplexBlock|FullBlock}("unknown", 1)), {}) => StructureError:
2 => a grid has no blocks of dynamics
> command("export", {}) => MessageError:
"missing.h5", "-o", "a.c" => missing.h5
ARM, "-o", "a.nonsense" => .nonsense
ARM, "-o", "a.csv", "--grid", "x" => x
ARM, "-o", "a.csv", "--grid", "3", "--grid", "m1=2" => --grid
ARM, "-o", "a.csv", "--grid", "m1=2", "--grid", "m1=3" => m1
ARM, "-o", "a.csv", "--grid", "=3" => =3
ARM, "-o", "/no/such/folder/a.c" => /no/such/folder
> lpv_grid(arm(), {}) => AnalysisError:
5 => 5 x 5 x 5 x 5 x 5 x 5 x 5 = 78125 points … at most 32768 points
0 => whole number of values of at least 1, got 0
2.5 => got 2.5
True => got True
{"theta": 3} => Did you mean 'theta
{"theta1": -1} => got -1
> export_model(tmp_path / {}) => AnalysisError:
"a.c", COMPLEX => StructureError: real matrices only
"a.mat", COMPLEX => accepted
"a.npz", arm(), 10 => 1e+07 points of 45 numbers each is too large
# without parameters there is one point
"a.npz", numbers(), 10**6 => accepted
"""
)


@pytest.mark.parametrize("name", ["arm.mat", "arm.c", "arm.jl", "grid.csv"])
def test_files_that_cannot_be_written(name: str, tmp_path: Path) -> None:
    counts = 1 if name == "grid.csv" else None
    with pytest.raises(ArchiveError, match="cannot be written"):
        export_model(tmp_path / "no" / name, arm(), counts)
    (tmp_path / name).mkdir()
    with pytest.raises(ArchiveError, match=r"it is a folder. Old files are unchanged"):
        export_model(tmp_path / name, arm(), counts, archive=tmp_path / "arm.h5")


@pytest.mark.parametrize(
    ("name", "counts", "fmi"),
    [
        ("arm.fmu", None, 3),
        ("arm.fmu", None, 4),
        ("grid.csv", 0, 3),
        ("grid.csv", 10**6, 3),
        ("two words.mat", None, 3),
        ("no/arm.jl", None, 3),
    ],
)
def test_errors_name_the_file_and_leave_none(
    name: str, counts: int | None, fmi: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(MbdlftError, match=f"^{re.escape(str(tmp_path / name))}: ") as error:
        export_model(tmp_path / name, arm(), counts, fmi=fmi)
    assert str(error.value).count(str(tmp_path / name)) == 1
    assert not list(tmp_path.iterdir())


def test_no_archive_of_a_script_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "arm.jl").mkdir()
    with pytest.raises(ArchiveError, match=r"arm\.jl: cannot be written: it is a folder"):
        export_model(tmp_path / "arm.jl", arm())
    assert [path.name for path in tmp_path.iterdir()] == ["arm.jl"]


def test_all_files_or_none(tmp_path: Path) -> None:
    """The last of three files cannot be written: the first two stay as they were."""
    (tmp_path / "arm_at.m").mkdir()
    (tmp_path / "arm.mat").write_text("old", encoding="utf-8")
    with pytest.raises(ArchiveError, match=r"arm_at\.m"):
        export_model(tmp_path / "arm.mat", arm())
    assert (tmp_path / "arm.mat").read_text(encoding="utf-8") == "old"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["arm.mat", "arm_at.m"]


def test_files_of_others_beside_are_kept(tmp_path: Path) -> None:
    (tmp_path / "arm.m").write_text("% my own analysis", encoding="utf-8")
    with pytest.raises(ArchiveError, match=r"arm\.m: .* exists, and mbdlft has not written it"):
        export_model(tmp_path / "arm.mat", arm())
    assert [path.name for path in tmp_path.iterdir()] == ["arm.m"]
    for name in ("other.mat", "other.c"):  # its own are replaced
        assert export_model(tmp_path / name, arm()) == export_model(tmp_path / name, arm())


def test_files_have_the_permissions_of_others(tmp_path: Path) -> None:
    (tmp_path / "plain").touch()
    for path in export_model(tmp_path / "arm.c", arm()):
        assert path.stat().st_mode == (tmp_path / "plain").stat().st_mode


def one(*names: str) -> System:
    """A system with parameters of these names."""
    parameters = tuple(sorted((Parameter(n, 1.0, 0.5, 2.0) for n in names), key=lambda p: p.name))
    lft = LFT(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), [[1.0]])
    for p in parameters:
        lft = lft + delta(p.name)
    unit = mbdlft.Signal("u", "1")
    return System("one", lft, (), (unit,), (unit,), parameters)


def unknown(block: ComplexBlock | FullBlock) -> System:
    return mbdlft.as_system(np.eye(1) + np.eye(1) @ delta(block), name="a")


def test_command_line(tmp_path: Path, call: Call, output: Output) -> None:
    archive = tmp_path / "some.h5"
    mbdlft.save(archive, arm(), "first")
    mbdlft.save(archive, numbers(), "pid: second")
    out = output("export", str(archive), "--model", "pid: second", "-o", str(tmp_path / "n.c"))
    assert out.splitlines() == [f"file: {tmp_path / 'n.c'}", f"file: {tmp_path / 'n.h'}"]
    assert "pid_second_matrices" in (tmp_path / "n.h").read_text(encoding="utf-8")
    code, _, err = call("export", str(archive), "-o", str(tmp_path / "n.c"))
    assert code == 2
    assert "first" in err
    first = ("export", str(archive), "--model", "first")
    assert output(*first, "-o", str(tmp_path / "a.jl")).count("file: ") == 1
    assert '"some.h5"' in (tmp_path / "a.jl").read_text(encoding="utf-8")
    grid = ("--grid", "m1=2", "--grid", "theta1=3", "-o", str(tmp_path / "g.csv"))
    output(*first, *grid)
    assert len((tmp_path / "g.csv").read_text(encoding="utf-8").splitlines()) == 7
    assert _counts(["4"]) == 4
