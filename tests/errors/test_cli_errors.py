"""Errors of the command line: exit code 2 and one readable message, never a traceback."""

import json

import pytest

from mbdlft.cli import commands as cli
from tests.errors.robots import written
from tests.errors.scenes import changed


@pytest.fixture
def run(monkeypatch, capsys, tmp_path):
    """Run the command line in an empty folder; its exit code, standard output and standard error."""
    monkeypatch.chdir(tmp_path)

    def _run(*words):
        monkeypatch.setattr("sys.argv", ["mbdlft", *words])
        with pytest.raises(SystemExit) as stopped:
            cli.main()
        captured = capsys.readouterr()
        return stopped.value.code or 0, captured.out, captured.err

    return _run


@pytest.fixture
def arm(tmp_path):
    """Write the arm, with a text replaced, as arm.toml."""

    def _arm(old="", new=""):
        (tmp_path / "arm.toml").write_text(changed(old, new), encoding="utf-8")
        return "arm.toml"

    return _arm


def check_message(result, *texts):
    """Exit code 2 and one message, on standard error only, that has the texts in this order."""
    code, out, err = result
    assert code == 2
    assert out == ""
    assert err.startswith("mbdlft: ")
    assert err.count("mbdlft: ") == 1
    assert err.endswith("\n")
    assert "Traceback" not in err
    position = 0
    for text in texts:
        assert text in err[position:], f"{text!r} is not in {err!r}"
        position = err.index(text, position)


@pytest.mark.parametrize("command", ["check", "trim", "linearize"])
@pytest.mark.parametrize(
    ("old", "new", "texts"),
    [
        ("[bodies.link2]", "[bodies.link2", ["arm.toml: not valid TOML: ", "(at line 28, column"]),
        ("scene/1", "scene/2", ["arm.toml: format: expected 'mbdlft-scene/1'"]),
        ('"rigid"', '"rigd"', ["arm.toml: line 21: body 'link1': unknown kind", "Did you mean"]),
        ('"link1.tip"', '"link1.tp"', ["unknown port 'tp'. Did you mean 'tip'?"]),
        ('mass = "m1"', 'mass = "m11"', ["mass = 'm11': unknown name 'm11'. Did you mean 'm1'?"]),
        ('mass = "m1"', 'mass = "sqrt(m1)"', ["body 'link1'", "sqrt(m1) is not rational in m1."]),
        ('mass = "m1"', 'mass = "m1/(rho1 - 0.31)"', ["vanishes in the range, near rho1 = 0.31"]),
        ("mass = 2.0", "mass = -2.0", ["body 'link2': mass [kg] is negative: -2."]),
        ("axis = [1, 0, 0]", "axis = [0, 0, 0]", ["axis has zero length"]),
    ],
)
def test_scene(run, arm, command, old, new, texts):
    check_message(run(command, arm(old, new)), *texts)


@pytest.mark.parametrize("command", ["check", "linearize"])
def test_unknown_signal(run, arm, command):
    file = arm('outputs = ["shoulder.angle"', 'outputs = ["shoulder.angel"')
    check_message(
        run(command, file),
        "scene 'two_link_arm', outputs: unknown signal 'shoulder.angel'. Did you mean 'shoulder.angle'",
    )


@pytest.mark.parametrize("command", ["check", "trim", "linearize"])
def test_missing_scene(run, command):
    check_message(run(command, "none.toml"), "none.toml: cannot be read: ", "No such file")


@pytest.mark.parametrize(
    ("assignment", "text"),
    [
        ("m11=3", "trim: unknown parameter 'm11'. Did you mean 'm1'? Existing: J1, L2, m1, m3, rho1"),
        ("m1", "--set m1: expected name=value with a number, such as m1=3.2."),
        ("m1=", "--set m1=: expected name=value with a number"),
        ("m1=heavy", "--set m1=heavy: expected name=value with a number"),
        ("m1=300", "trim: m1 = 300 is outside its range [2.4, 3.6] kg."),
        ("m1=nan", "trim: m1 = nan is outside its range [2.4, 3.6] kg."),
    ],
)
def test_set(run, arm, assignment, text):
    check_message(run("trim", arm(), "--set", "m3=5.0", "--set", assignment), text)


def test_set_of_right_values(run, arm):
    code, out, err = run("trim", arm(), "--set", "m3=5.5", "--set", "theta1 = 60")
    assert (code, err) == (0, "")
    assert "shoulder.torque" in out


def test_mass_matrix_that_is_singular(run, tmp_path):
    """Nothing has a mass along the rail: linearize would say so, and so does check."""
    (tmp_path / "rail.toml").write_text(
        'format = "mbdlft-scene/1"\nname = "rail"\n'
        '[bodies.cart]\nkind = "point_mass"\nmass = 0\n'
        '[joints.rail]\nkind = "prismatic"\nparent = "ground"\nchild = "cart"\naxis = [1, 0, 0]\n',
        encoding="utf-8",
    )
    for command in ("check", "linearize"):
        found = run(command, "rail.toml")
        check_message(found, "scene 'rail': the mass matrix is singular")
        check_message(found, "nothing with enough inertia moves with rail.velocity")


def test_archive_that_cannot_be_written(run, arm, tmp_path, monkeypatch):
    monkeypatch.setattr("mbdlft.pipeline.models.build", None)  # it is said before the work
    check_message(
        run("linearize", arm(), "-o", "none/a.h5"), "none/a.h5: cannot be written: none is not a folder."
    )
    (tmp_path / "a.h5").write_text("not an archive")
    check_message(run("linearize", arm(), "-o", "a.h5"), "a.h5: is not a whole HDF5 file (14 bytes)")
    assert (tmp_path / "a.h5").read_text() == "not an archive"


def test_figure_that_cannot_be_written(run, arm, tmp_path):
    check_message(
        run("linearize", arm(), "-o", "a.h5", "--plot", "a.abc"), "a.abc: the figure cannot be written: "
    )
    assert not (tmp_path / "a.h5").exists()


def test_archive_that_cannot_be_read(run, arm, tmp_path):
    check_message(run("show", "none.h5"), "none.h5: cannot be read: No such file or directory.")
    (tmp_path / "a.h5").write_bytes(b"")
    check_message(run("show", "a.h5"), "a.h5: is not a whole HDF5 file (0 bytes)")
    code, out, _ = run("linearize", arm(), "-o", "b.h5", "--json")
    assert code == 0
    assert json.loads(out)["name"] == "two_link_arm"
    check_message(
        run("show", "b.h5", "--name", "two_link_am"),
        "b.h5: unknown model 'two_link_am'. Did you mean 'two_link_arm'? Existing: two_link_arm.",
    )


@pytest.mark.parametrize("text", ["masses [/kg] and [red]", "[bold", "[/]", ":smile: [link=x]"])
def test_texts_with_brackets_are_printed_as_they_are(run, arm, text):
    old = 'description = "Two-link robotic arm with a load at its tip, scheduled on both joint angles"'
    code, out, _ = run("linearize", arm(old, f'description = "{text}"'), "-o", "a.h5")
    assert code == 0
    assert text in out
    code, out, _ = run("show", "a.h5")
    assert code == 0
    assert text in out


@pytest.mark.parametrize("command", ["check", "trim", "linearize"])
def test_names_with_brackets_are_printed_as_they_are(run, arm, command):
    code, out, _ = run(command, arm('name = "two_link_arm"', 'name = "arm [/x]"'))
    assert code == 0
    assert "arm [/x]" in out


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["check"], "Missing argument 'FILE'."),
        (["chek", "arm.toml"], "No such command 'chek'."),
        (["check", "arm.toml", "--fast"], "No such option: --fast"),
    ],
)
def test_usage(run, words, text):
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert text in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("words", "texts"),
    [
        (["--set", "arm.mass"], ["--set arm.mass: expected a name, = and a value."]),
        (["--vary", "arm.mass=much"], ["--vary arm.mass: expected a number, got 'much'."]),
        (["--parameter", "m=1,2"], ["--parameter m=1,2: expected NAME=LOW,NOMINAL,HIGH,UNIT"]),
        (["--parameter", "m=1,x,2,kg"], ["--parameter m: expected a number, got 'x'."]),
        (["--set", "arm.mas=1"], ["values: unknown label 'arm.mas'. Did you mean 'arm.mass'?"]),
        (["--moving", "swng"], ["Did you mean 'swing'?"]),
    ],
)
def test_import(run, tmp_path, words, texts):
    written(tmp_path)
    check_message(run("import", "crane.urdf", "-o", "crane.toml", *words), *texts)
    assert not (tmp_path / "crane.toml").exists()


def test_import_into_a_folder_that_is_not_there(run, tmp_path):
    written(tmp_path)
    result = run("import", "crane.urdf", "-o", "none/crane.toml")
    check_message(result, "none/crane.toml: cannot be written: No such file or directory.")
