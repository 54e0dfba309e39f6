"""Exported models against the library: compiled C, .mat files read by scipy, m-files in Octave."""

import csv
import io
import re
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest

import mbdlft
from mbdlft import Block, FullBlock, LFTModel, Parameter
from mbdlft.export import export_model, lpv_grid
from mbdlft.export.names import identifier, prefix
from mbdlft.lft import LFT
from mbdlft.lft.lft import delta
from mbdlft.synthesis import scheduled, tunable_pid
from mbdlft.system import System
from tests.close import EXPORT, exact, roundoff, target
from tests.exported import (
    COMPILER,
    MODELS,
    ROOT,
    compiled,
    exported,
    octave,
    pointer,
    read,
    rows_of,
    samples_of,
    scenario,
    texts,
    values_of_c,
    values_of_mat,
)

QUICK = {"missile", "rotatory_spacecraft", "spinning_satellite", "two_link_arm", "ur5"}
SCENARIOS = [
    pytest.param(path.stem, marks=() if path.stem in QUICK else pytest.mark.long)
    for path in sorted((ROOT / "scenarios").glob("*.toml"))
]


def kappa(model: System) -> float:
    """The condition that the certificate states: kernels of other processors round otherwise."""
    return max(10.0, model.certificate.condition if isinstance(model, LFTModel) else 0.0)


def check_c(model: System, folder: Path) -> None:
    library, name = compiled(model, folder), prefix(model.name)
    values, expected = samples_of(model)
    rows = rows_of(model, values)
    for found, matrices in zip(values_of_c(library, name, model, rows), expected, strict=True):
        roundoff(found, matrices, kappa(model))
    if isinstance(model, LFTModel) and model.trim.lft is not None and model.trim.signals:
        trim = np.broadcast_to(mbdlft.trim_at(model, values), (len(rows), len(model.trim.signals)))
        found = np.full(trim.shape, np.nan)
        for k, row in enumerate(np.ascontiguousarray(rows)):
            assert getattr(library, f"{name}_trim")(pointer(row), pointer(found[k])) == 0
        roundoff(found, trim, kappa(model))
    else:
        assert not hasattr(library, f"{name}_trim")


def check_mat(model: System, folder: Path) -> None:
    file, *_ = export_model(folder / "model.mat", model)
    values, expected = samples_of(model)
    stored = read(file)
    for name in ("A", "B_w", "B_u", "C_z", "D_zw", "D_zu", "C_y", "D_yw", "D_yu"):
        exact(stored[name], getattr(model, name))
    for what in ("states", "inputs", "outputs"):
        assert texts(stored[what]["name"]) == [s.name for s in getattr(model, what)]
        assert texts(stored[what]["unit"]) == [s.unit for s in getattr(model, what)]
    assert texts(stored["parameters"]["role"]) == [p.role for p in model.parameters]
    for field in ("low", "nominal", "high"):
        exact(stored["parameters"][field].ravel(), [getattr(p, field) for p in model.parameters])
    matrices, trim = values_of_mat(stored, values)
    for found, wanted in zip(matrices, expected, strict=True):
        roundoff(found, wanted, kappa(model))
    if isinstance(model, LFTModel) and model.trim.lft is not None:
        assert trim is not None
        wanted = mbdlft.trim_at(model, values)
        roundoff(trim, np.broadcast_to(wanted, trim.shape), kappa(model))
        assert texts(stored["trim"]["name"]) == [s.name for s in model.trim.signals]


@pytest.mark.parametrize("stem", SCENARIOS)
def test_scenarios_in_c_and_in_mat_files(stem: str, tmp_path: Path) -> None:
    check_mat(scenario(stem), tmp_path)
    check_c(scenario(stem), tmp_path)


@pytest.mark.parametrize("key", MODELS)
def test_models_of_all_kinds_in_mat_files(key: str, tmp_path: Path) -> None:
    check_mat(exported(key), tmp_path)


@pytest.mark.parametrize("key", [key for key in MODELS if key not in ("arm", "unused")])
def test_models_of_all_kinds_in_c(key: str, tmp_path: Path) -> None:
    check_c(exported(key), tmp_path)


def test_c_says_what_is_outside_and_what_is_singular(tmp_path: Path) -> None:
    """value = 1/(1 - 2 delta) is singular at delta = 1/2, and c (1 + delta) at no value."""
    p = Parameter("a", 1.0, 0.0, 2.0)
    lft = LFT([[2.0]], [[1.0]], [[2.0]], [[1.0]], (Block("a", 1),))
    unit = mbdlft.Signal("u", "1")
    model = System("rational", lft, (), (unit,), (unit,), (p,))
    library = compiled(model, tmp_path)
    D = np.full(1, 7.0)
    for a, status in ((1.5, 2), (2.1, 1), (-0.1, 1), (np.nan, 1), (np.inf, 1)):
        assert library.rational_matrices(pointer(np.array([a])), None, None, None, pointer(D)) == status
        exact(D, [7.0])
    assert library.rational_matrices(pointer(np.array([1.75])), None, None, None, pointer(D)) == 0
    target(D, [1.0 / (1.0 - 2.0 * 0.75)], EXPORT)
    assert library.rational_matrices(pointer(np.array([1.75])), None, None, None, None) == 0


def test_units_inside_make_nothing_singular(tmp_path: Path) -> None:
    """The same model with signals of Delta in units that differ by 24 orders, up and down."""
    model = exported("arm")
    a, units = model.lft, 10.0 ** np.linspace(-12.0, 12.0, model.order)
    values, expected = samples_of(model)
    for u in (units, units[::-1]):
        scaled = LFT(a.M11 * u[:, None] / u, a.M12 * u[:, None], a.M21 / u, a.M22, a.blocks)
        signals = (model.states, model.inputs, model.outputs)
        other = System("arm", scaled, *signals, model.parameters)
        folder = tmp_path / str(u[0])
        folder.mkdir()
        library = compiled(other, folder)
        found = values_of_c(library, "arm", other, rows_of(model, values))
        for matrices, wanted in zip(found, expected, strict=True):
            target(matrices, wanted, EXPORT)


def test_names_are_identifiers_and_the_files_say_which(tmp_path: Path) -> None:
    assert identifier("θ₁") == "theta1"
    assert identifier("Ω.x y") == "Omega_x_y"
    assert identifier("µ") == "mu"
    assert identifier("größe") == "gro_u00DFe".replace("_u", "u")
    assert identifier("end") == "end_"
    assert identifier("日") == "u65E5"
    assert identifier("2x") == "x2x"
    model = exported("off_center")
    files = [*export_model(tmp_path / "m.mat", model), *export_model(tmp_path / "m.c", model)]
    for path in files[1:3]:
        assert "mu " in path.read_text(encoding="utf-8")
        assert " µ " in path.read_text(encoding="utf-8")
    header = files[4].read_text(encoding="utf-8")
    name = identifier(model.name)
    assert f"int {name}_matrices(" in header
    assert f" *   {name}_p_end_ " in header
    assert texts(read(files[0])["parameters"]["identifier"]) == ["end_", "grou00DFe", "mu"]


@pytest.mark.parametrize("key", ["turned", "off_center", "numbers"])
def test_functions_run_in_octave(key: str, tmp_path: Path) -> None:
    model = exported(key)
    export_model(tmp_path / "some.mat", model)
    values, expected = samples_of(model)
    rows = rows_of(model, values)
    more = "clear values; some; N = plant;"
    found = octave(model, tmp_path, "some", rows, more)
    for letter, matrices in zip("ABCD", expected, strict=True):
        shape = matrices.shape
        got = np.asarray(found[letter]).reshape(*shape[1:], -1) if matrices.size else np.zeros(0)
        target(np.moveaxis(got, -1, 0) if matrices.size else matrices, matrices, EXPORT)
    for letter in "ABCD":
        target(found["N"][letter], getattr(mbdlft.matrices_at(model, {}), letter), EXPORT)
    if isinstance(model, LFTModel) and model.trim.signals and model.trim.lft is not None:
        trim = np.broadcast_to(mbdlft.trim_at(model, values), (len(rows), len(model.trim.signals)))
        target(found["T"].T, trim, EXPORT)


# elements of a toolbox that are numbers: `uss` as it is written gives the values of the model
TOOLBOX = {
    "uss": "function x = uss(), x = []; end",
    "ureal": "function x = ureal(name, nominal, word, range)\n"
    "  global at\n  x = at.(name); assert(x >= range(1) - 1e-9 && x <= range(2) + 1e-9);\n"
    "  assert(nominal > range(1) && nominal < range(2)); assert(strcmp(word, 'Range'));\nend",
    "ss": "function x = ss(a, b, c, d), x = struct('a', a, 'b', b, 'c', c, 'd', d); end",
    "lft": "function x = lft(E, s)\n  x.StateName = s.StateName; x.StateUnit = s.StateUnit;\n"
    "  n = size(E, 1); m = size(E, 2); L = eye(n) - E * s.d(1:m, 1:n);\n"
    "  F = L \\ E;\n  x.A = s.a + s.b(:, 1:n) * F * s.c(1:m, :);\n"
    "  x.B = s.b(:, n+1:end) + s.b(:, 1:n) * F * s.d(1:m, n+1:end);\n"
    "  x.C = s.c(m+1:end, :) + s.d(m+1:end, 1:n) * F * s.c(1:m, :);\n"
    "  x.D = s.d(m+1:end, n+1:end) + s.d(m+1:end, 1:n) * F * s.d(1:m, n+1:end);\nend",
}


@pytest.mark.parametrize("key", ["turned", "off_center"])
def test_uncertain_system_of_the_script(key: str, tmp_path: Path) -> None:
    """With elements that are numbers, the script of the toolbox makes the matrices at these numbers."""
    model = exported(key)
    export_model(tmp_path / "some.mat", model)
    values, expected = samples_of(model)
    for name, text in TOOLBOX.items():
        (tmp_path / f"{name}.m").write_text(text, encoding="utf-8")
    k, elements = 17, texts(read(tmp_path / "some.mat")["parameters"]["element"])
    inner = [mbdlft.base.parameter.to_internal(p, values[p.name][k]) for p in model.parameters]
    point = "".join(f"at.{e} = {float(x):.17g};" for e, x in zip(elements, inner, strict=True))
    found = octave(model, tmp_path, "some", rows_of(model, values)[:1], f"global at\n{point}\nsome;")
    for kind, listed in (("State", model.states), ("Input", model.inputs), ("Output", model.outputs)):
        assert texts(found["plant"][f"{kind}Name"]) == [signal.name for signal in listed]
        assert texts(found["plant"][f"{kind}Unit"]) == [signal.unit for signal in listed]
    for letter, matrices in zip("ABCD", expected, strict=True):
        target(found["plant"][letter], matrices[k], EXPORT)


def test_blocks_of_other_kinds_are_carried_by_mat_files(tmp_path: Path) -> None:
    loop = mbdlft.series(
        mbdlft.as_system(np.eye(2) + 0.1 * np.eye(2) @ delta(FullBlock("unknown", 2)), name="a"),
        exported("arm"),
    )
    export_model(tmp_path / "some.mat", loop)
    stored = read(tmp_path / "some.mat")["delta"]
    assert texts(stored["kind"]) == [block.kind for block in loop.lft.blocks]
    unknown = np.array([[0.3, 0.1j], [0.2, -0.5]])
    values, _ = samples_of(loop)
    more = "values.unknown = [0.3, 0.1i; 0.2, -0.5]; [a, b, c, d] = some_at(values);"
    found = octave(loop, tmp_path, "some", rows_of(loop, values), more)
    last = {name: column[-1] for name, column in values.items()}
    expected = mbdlft.matrices_at(loop, {**last, "unknown": unknown})
    for letter in "ABCD":
        target(found[letter.lower()], getattr(expected, letter), EXPORT)


def test_octave_takes_integers_and_singles_as_doubles(tmp_path: Path) -> None:
    """An integer would make integers of the products that its angle is in."""
    model = exported("arm")
    export_model(tmp_path / "some.mat", model)
    kinds = ("int32", "uint8", "single")
    more = "".join(f"{kind}s = some_at(struct('theta1', {kind}(60)));\n" for kind in kinds)
    found = octave(model, tmp_path, "some", np.zeros((0, 7)), more)
    for kind in kinds:
        target(found[f"{kind}s"], mbdlft.matrices_at(model, {"theta1": 60.0}).A, EXPORT)


def test_octave_refuses_what_is_outside(tmp_path: Path) -> None:
    export_model(tmp_path / "some.mat", exported("arm"))
    more = "".join(
        f"try, some_at(struct('{name}', {value})); catch e, e{k} = e.message; end\n"
        for k, (name, value) in enumerate((("theta1", 300), ("theta1", "nan"), ("theta", 1)))
    )
    found = octave(exported("arm"), tmp_path, "some", np.zeros((0, 7)), more)
    assert found["e0"][0].startswith("theta1 = 300 is outside its range [45, 90] deg")
    assert "outside its range" in found["e1"][0]
    assert found["e2"][0].startswith("unknown parameter theta. Existing: J1 L2 m1")


def test_equal_models_give_equal_bytes(tmp_path: Path) -> None:
    for suffix in (".mat", ".c"):
        first = [f.read_bytes() for f in export_model(tmp_path / f"a{suffix}", exported("arm"))]
        again = [f.read_bytes() for f in export_model(tmp_path / f"a{suffix}", exported("arm"))]
        assert first == again


def block_of_docs(language: str) -> str:
    page = (ROOT / "docs" / "export.md").read_text(encoding="utf-8")
    return page.partition(f"```{language}\n")[2].partition("```")[0]


def test_example_of_the_docs_in_c(tmp_path: Path) -> None:
    export_model(tmp_path / "handed.c", scenario("two_link_arm"))
    if COMPILER is None:
        pytest.skip("there is no C compiler cc")
    begin, _, rest = block_of_docs("c").partition("\n\n")
    program = f"#include <stdio.h>\n#include <string.h>\n{begin}\nint main(void) {{ {rest}"
    program += 'for (int k = 0; k < 16; k++) { printf("%.17g\\n", A[k]); }\nreturn 0; }\n'
    (tmp_path / "main.c").write_text(program, encoding="utf-8")
    command = [COMPILER, "-std=c99", "-Wall", "-o", "main", "main.c", "handed.c", "-lm"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    out = subprocess.run([tmp_path / "main"], capture_output=True, text=True, check=True).stdout
    found = np.array(out.split(), dtype=float).reshape(4, 4)
    target(found, mbdlft.matrices_at(scenario("two_link_arm"), {"theta1": 60.0}).A, EXPORT)


def test_example_of_the_docs_in_octave(tmp_path: Path) -> None:
    model = scenario("two_link_arm")
    export_model(tmp_path / "handed.mat", model)
    found = octave(model, tmp_path, "handed", np.zeros((0, 7)), block_of_docs("matlab"))
    at = {"theta1": 60.0, "m3": 5.5}
    target(found["A"], mbdlft.matrices_at(model, at).A, EXPORT)
    target(found["trim"].ravel(), mbdlft.trim_at(model, at), EXPORT)


def test_a_schedule_in_c_is_its_polynomial(tmp_path: Path) -> None:
    """m - 2 and m^2 - 4 are at most 2 and 12 from 1 to 4, where nominal is not in the middle."""
    m = Parameter("m", low=1.0, high=4.0, nominal=2.0, role="scheduled")
    pid = scheduled(tunable_pid("pid", "e", "u", terms="PI"), [m], ["m", "m^2"])
    values = {"pid.kp": 20.0, "pid.kp*m": 6.0, "pid.kp*m^2": 3.0, "pid.ki": 5.0, "pid.ki*m^2": -1.0}
    controller, rows = pid.with_values(values), np.linspace(1.0, 4.0, 7)[:, None]
    A, B, C, D = values_of_c(compiled(controller, tmp_path), "pid", controller, rows)
    kp = 20.0 + 6.0 * (rows - 2.0) / 2.0 + 3.0 * (rows**2 - 4.0) / 12.0
    target(D[:, 0], kp, EXPORT)
    target((C @ B)[:, 0], 5.0 - (rows**2 - 4.0) / 12.0, EXPORT)
    exact(A, np.zeros((7, 1, 1)))


# Matrices on a grid in files of other tools, and the Julia script, against the library.

COUNTS = {"theta1": 3, "m3": 4}  # in the order of the names: m3, then theta1


def expected(counts: dict[str, int]) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
    model = exported("arm")
    values = mbdlft.grid(model.parameters, counts)
    return values, list(mbdlft.matrices_at(model, values))


def test_state_spaces_on_a_grid() -> None:
    model = exported("arm")
    values, matrices = expected(COUNTS)
    found = lpv_grid(model, COUNTS)
    assert len(found) == 12
    for k, system in enumerate(found):
        for letter, array in zip("ABCD", matrices, strict=True):
            exact(getattr(system, letter), array[k])
        at = model.at({name: float(column[k]) for name, column in values.items()})
        target(system.A, at.A, EXPORT)
        assert (system.input_labels, system.output_labels) == (at.input_labels, at.output_labels)
        assert system.state_labels == at.state_labels
    assert len(lpv_grid(exported("off_center"), 2)) == 8
    (single,) = lpv_grid(exported("numbers"), 9)
    exact(single.A, exported("numbers").A)


def test_grid_as_a_table(tmp_path: Path) -> None:
    model = exported("arm")
    (file,) = export_model(tmp_path / "grid.csv", model, COUNTS)
    values, matrices = expected(COUNTS)
    names, *rows = csv.reader(io.StringIO(file.read_text(encoding="utf-8")))
    table = dict(zip(names, np.array(rows, dtype=float).T, strict=True))
    for name, column in values.items():
        exact(table[name], column)
    exact(table["A_3_2"], matrices[0][:, 2, 1])
    exact(table["B_4_1"], matrices[1][:, 3, 0])
    exact(table["C_2_2"], matrices[2][:, 1, 1])
    assert isinstance(model, mbdlft.LFTModel)
    exact(table["elbow.torque"], mbdlft.trim_at(model, values)[:, 1])
    assert len(names) == 7 + 16 + 8 + 8 + 4 + 2


def test_grid_for_numpy(tmp_path: Path) -> None:
    model = exported("arm")
    (file,) = export_model(tmp_path / "grid.npz", model, COUNTS)
    values, matrices = expected(COUNTS)
    with np.load(file) as found:  # nothing is pickled
        assert list(found["parameters"]) == list(values)
        exact(found["values"], np.stack(list(values.values()), axis=1))
        exact(found["counts"], [1, 1, 1, 4, 1, 3, 1])
        for letter, array in zip("ABCD", matrices, strict=True):
            exact(found[letter], array)
        assert list(found["states"]) == [s.name for s in model.states]
        assert list(found["input_units"]) == [s.unit for s in model.inputs]
        assert found["trim"].shape == (12, 2)
        assert list(found["trimmed"]) == ["shoulder.torque", "elbow.torque"]


def test_grid_for_matlab_has_an_axis_for_each_parameter(tmp_path: Path) -> None:
    model = exported("arm")
    (file,) = export_model(tmp_path / "grid.mat", model, COUNTS)
    _, matrices = expected(COUNTS)
    found = read(file)
    assert texts(found["parameters"]["identifier"]) == list(model.parameters.names)
    exact(found["parameters"]["count"].ravel(), [1, 1, 1, 4, 1, 3, 1])
    shape = (1, 1, 1, 4, 1, 3, 1)
    assert found["A"].shape == (4, 4, *shape)
    for k in range(4):
        for j in range(3):
            values = {"m3": found["axes"]["m3"][k, 0], "theta1": found["axes"]["theta1"][j, 0]}
            at = mbdlft.matrices_at(model, values)
            target(found["A"][:, :, 0, 0, 0, k, 0, j, 0], at.A, EXPORT)
            target(found["B"][:, :, 0, 0, 0, k, 0, j, 0], at.B, EXPORT)
            assert isinstance(model, mbdlft.LFTModel)
            trim = mbdlft.trim_at(model, values)
            target(found["trim"]["value"][:, 0, 0, 0, k, 0, j, 0], trim, EXPORT)
    exact(found["B"][:, :, 0, 0, 0, 1, 0, 2, 0], matrices[1][1 * 3 + 2])


@pytest.mark.parametrize("suffix", [".mat", ".csv", ".npz"])
@pytest.mark.parametrize("key", ["numbers", "bare", "off_center", "system"])
def test_grids_of_models_of_all_kinds(key: str, suffix: str, tmp_path: Path) -> None:
    (file,) = export_model(tmp_path / f"grid{suffix}", exported(key), 2)
    assert file.stat().st_size > 0
    if suffix == ".csv":
        lines = file.read_text(encoding="utf-8").splitlines()
        assert len(lines) == 1 + 2 ** len(exported(key).parameters)


def test_julia_script_reads_what_an_archive_has(tmp_path: Path) -> None:
    model = exported("turned")
    script, archive = export_model(tmp_path / "arm.jl", model)
    assert archive == tmp_path / "arm.h5"
    assert mbdlft.load(archive).name == model.name
    text = script.read_text(encoding="utf-8")
    assert 'ARCHIVE = normpath(joinpath(@__DIR__, "arm.h5"))' in text
    assert f'MODEL = "{model.name}"' in text
    assert text.count("\nend") == text.count("\nfunction ")
    with h5py.File(archive) as file:
        group = file["models"][model.name]
        for name in re.findall(r'group\["([\w/]+)"\]', text):
            assert name in group or name in group["parameters"], name
        for name in re.findall(r'texts\(group, "(\w+)"\)', text):
            assert name in group["parameters"], name
        for name in re.findall(r'static\["([\w/]+)"\]', text):
            assert name in group["trim/lft"], name
        rows = group["delta/parameter"][()]
        blocks = [p.name for p in model.parameters for _ in range(dict(model.lft.blocks)[p.name])]
        assert [model.parameters.names[row] for row in rows] == blocks
    elsewhere = tmp_path / "scripts"
    elsewhere.mkdir()
    (script,) = export_model(elsewhere / "other.jl", model, archive=archive)
    assert 'joinpath(@__DIR__, "../arm.h5")' in script.read_text(encoding="utf-8")
