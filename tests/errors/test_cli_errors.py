"""Errors of the command line: exit code 2 and one readable message, never a traceback."""

import json
from pathlib import Path

import pytest

from tests.errors.robots import written
from tests.errors.table import MessageError, refused, says

MISSILE = str(Path(__file__).parents[2] / "scenarios" / "missile.toml")


@pytest.fixture
def run(monkeypatch, call, tmp_path):
    """Run the command line in an empty folder; its exit code, standard output and standard error."""
    monkeypatch.chdir(tmp_path)
    return call


@pytest.fixture
def crane(tmp_path):
    return written(tmp_path).name


test_messages = refused(
    r"""
> command("{check|trim|linearize}", arm_file({})) => MessageError:
"[bodies.link2]", "[bodies.link2" => arm.toml: not valid TOML:  … (at line 28, column
'"rigid"', '"rigd"' => arm.toml: line 21: body 'link1': unknown kind … Did you mean
> command("check", arm_file({})) => MessageError:
"scene/1", "scene/2" => arm.toml: format: expected 'mbdlft-scene/1'
'"link1.tip"', '"link1.tp"' => unknown port 'tp'. Did you mean 'tip'?
'mass = "m1"', 'mass = "m11"' => mass = 'm11': unknown name 'm11'. Did you mean 'm1'?
'mass = "m1"', 'mass = "sqrt(m1)"' => body 'link1' … sqrt(m1) is not rational in m1.
'mass = "m1"', 'mass = "m1/(rho1 - 0.31)"' => vanishes in the range, near rho1 = 0.31
"mass = 2.0", "mass = -2.0" => body 'link2': mass [kg] is negative: -2.
"axis = [1, 0, 0]", "axis = [0, 0, 0]" => axis has zero length
> command({}) => MessageError:
"{check|linearize}", arm_file('outputs = ["shoulder.angle"', 'outputs = ["shoulder.angel"')
    => scene 'two_link_arm', outputs: unknown signal 'shoulder.angel'. Did you mean 'shoulder.angle'
"{check|trim|linearize|realize|poles}", "none.toml" => none.toml: cannot be read:  … No such file
"{show|poles}", "none.h5" => none.h5: cannot be read: No such file or directory.
"import", crane, "-o", "none/crane.toml" => none/crane.toml: cannot be written: No such file or directory.
# one of two would be lost
"linearize", arm_file(), "-o", "a.pdf", "--plot", "a.pdf" => a.pdf: it is given twice
"linearize", arm_file(), "--plot", "a.png", "--plot", "bode=./a.png" => a.png: it is given twice
"simulate", arm_file(), "-o", "q.png", "--plot", "q.png" => q.png: it is given twice
"simulate", arm_file(), "-o", "arm.toml" => arm.toml: it is given twice
"tune", "t.toml", "-o", "t.toml" => t.toml: it is given twice
"tune", "t.toml", "--plot", "a.svg", "--scene", "a.svg" => a.svg: it is given twice
"import", crane, "-o", crane => crane.urdf: it is given twice
"poles", arm_file(), "--over", "m1" => --over m1: expected a figure, too
"realize", arm_file() => arm.toml: format: expected 'mbdlft-matrix/1', got 'mbdlft-scene/1'. Scenes are
"linearize", MISSILE => missile.toml: format: expected 'mbdlft-scene/1', got 'mbdlft-matrix/1'.
> command("linearize", arm_file(), {}) => MessageError:
"--plot", "any=a.png" => --plot any=a.png: unknown figure 'any'. Existing: bode … over a parameter: poles:
"--plot", "order:theta1=a.png" => --plot order:theta1=a.png: unknown figure 'order:theta1'.
"--truncate", "0" => truncation needs a tolerance above 0, such as 0.01, got 0.0.
"--truncate", "nan" => truncation needs a tolerance above 0, such as 0.01, got nan.
> command("poles", arm_file(), {}) => MessageError:
"--model", "arm" => --model arm: arm.toml is no archive; only an archive has models.
"--set", "theta1" => --set theta1: expected name=value with a number … Parameters: J1, L2, m1
"--set", "theta1=600" => model 'two_link_arm': theta1 = 600 is outside its range [45, 90] deg.
"-o", "figure.nonsense" => figure.nonsense: the figure cannot be written: … got '.nonsense'.
> command("response", arm_file(), {}) => MessageError:
"--input", "any" => model 'two_link_arm': unknown input 'any'. Existing: elbow.torque, shoulder.torque.
"--output", "any" => model 'two_link_arm': unknown output 'any'. Existing: elbow.angle, shoulder.angle.
"--at", "0" => --at 0: expected a positive finite frequency (rad/s), such as 1.5.
"--at", "nan" => --at nan: expected a positive finite frequency
"--kind", "any" => --kind any: expected one of sigma, bode
"-o", "/no/such/f.png" => /no/such/f.png: the figure cannot be written: /no/such is not a folder.
> command("simulate", arm_file(), {}) => MessageError:
"--amplitude", "{nan|inf}" => --amplitude: expected finite numbers, got [{0}].
"--until", "inf" => --until inf: expected a positive time (s).
"--initial", "shoulder.angle=nan" => --initial shoulder.angle=nan: expected state=number
"--input", "shoulder.torque={step:1@nan|inf|sine:1:nan}"
    => --input shoulder.torque={0}: expected NAME=number
"--input", "shoulder.torque=sine:1e300:1"
    => simulate: 'shoulder.torque': expected finite numbers, up to 1e+100.
"--input", "shoulder.torque=1", "--amplitude", "1e300" => expected finite numbers, up to 1e+100.
"--initial", "shoulder.rate=1e150" => simulate: 'shoulder.rate': expected finite numbers, up to 1e+100.
"--input", "shoulder.torque=1", "--input", "shoulder.torque=2" => shoulder.torque is given twice
"--input", "shoulder.torque=stairs:1" => --input shoulder.torque=stairs:1: expected NAME=number
"--input", "sholder.torque=1" => unknown input 'sholder.torque'. Did you mean 'shoulder.torque'
"--initial", "elbow.angel=1" => unknown state 'elbow.angel'. Did you mean 'elbow.angle'
"--until", "-1" => --until -1: expected a positive time (s).
"--plot", "motion.doc" => the figure cannot be written
> command("sweep", arm_file(), "-o", "a.h5", {}) => MessageError:
*() => expected exactly one of --grid, --random and --file
"--random", "3", "--grid", "m1=2" => expected exactly one of
"--grid", "m1=2", "--seed", "3" => --seed: only --random has a seed
"--grid", "m1" => --grid m1: expected NAME=COUNT
"--random", "3", "--model", "x" => only an archive has models
> command("trim", arm_file(), "--set", "m3=5.0", "--set", {}) => MessageError:
"m3=5" => --set m3=5: m3 is given twice.
"m11=3" => trim: unknown parameter 'm11'. Did you mean 'm1'? Existing: J1, L2, m1, m3, rho1
"m1" => --set m1: expected name=value with a number, such as m1=3.2.
"m1=" => --set m1=: expected name=value with a number
"m1=heavy" => --set m1=heavy: expected name=value with a number
"m1={300|nan}" => trim: m1 = {0} is outside its range [2.4, 3.6] kg.
> command("import", crane, "-o", "crane.toml", {}) => MessageError:
"--set", "arm.mass" => --set arm.mass: expected a name, = and a value.
"--vary", "arm.mass=much" => --vary arm.mass: expected a number, got 'much'.
"--parameter", "m=1,2" => --parameter m=1,2: expected NAME=LOW,NOMINAL,HIGH,UNIT
"--parameter", "m=1,x,2,kg" => --parameter m: expected a number, got 'x'.
"--set", "arm.mas=1" => values: unknown label 'arm.mas'. Did you mean 'arm.mass'?
"--moving", "swng" => Did you mean 'swing'?
"""
)


def test_a_robot_that_is_refused_leaves_no_file(command, crane, tmp_path):
    with says(MessageError, "--set arm.mass"):
        command("import", crane, "-o", "crane.toml", "--set", "arm.mass")
    assert not (tmp_path / "crane.toml").exists()


def test_set_of_right_values(run, arm_file):
    code, out, err = run("trim", arm_file(), "--set", "m3=5.5", "--set", "theta1 = 60")
    assert (code, err) == (0, "")
    assert "shoulder.torque" in out


def test_mass_matrix_that_is_singular(command, tmp_path):
    """Nothing has a mass along the rail: linearize would say so, and so does check."""
    (tmp_path / "rail.toml").write_text(
        'format = "mbdlft-scene/1"\nname = "rail"\n'
        '[bodies.cart]\nkind = "point_mass"\nmass = 0\n'
        '[joints.rail]\nkind = "prismatic"\nparent = "ground"\nchild = "cart"\naxis = [1, 0, 0]\n',
        encoding="utf-8",
    )
    for name in ("check", "linearize"):
        with says(MessageError, "scene 'rail': the mass matrix is singular", "moves with rail.velocity"):
            command(name, "rail.toml")


def test_archive_that_cannot_be_written(command, arm_file, tmp_path, monkeypatch):
    monkeypatch.setattr("mbdlft.pipeline.models.build", None)  # it is said before the work
    with says(MessageError, "none/a.h5: cannot be written: none is not a folder."):
        command("linearize", arm_file(), "-o", "none/a.h5")
    (tmp_path / "a.h5").write_text("not an archive")
    with says(MessageError, "a.h5: is not a whole HDF5 file (14 bytes)"):
        command("linearize", arm_file(), "-o", "a.h5")
    assert (tmp_path / "a.h5").read_text() == "not an archive"


def test_a_name_that_no_archive_has_is_found_before_the_work(command, arm_file, monkeypatch):
    monkeypatch.setattr("mbdlft.cli.models._of_scene", None)
    with says(MessageError, "a.h5: 'a/b' cannot name a model"):
        command("linearize", arm_file('name = "two_link_arm"', 'name = "a/b"'), "-o", "a.h5")


def test_figure_that_cannot_be_written(command, arm_file, tmp_path):
    with says(MessageError, "a.abc: the figure cannot be written: "):
        command("linearize", arm_file(), "-o", "a.h5", "--plot", "a.abc")
    assert not (tmp_path / "a.h5").exists()


def test_archive_that_cannot_be_read(command, run, arm_file, tmp_path):
    (tmp_path / "a.h5").write_bytes(b"")
    with says(MessageError, "a.h5: is not a whole HDF5 file (0 bytes)"):
        command("show", "a.h5")
    code, out, _ = run("linearize", arm_file(), "-o", "b.h5", "--json")
    assert (code, json.loads(out)["name"]) == (0, "two_link_arm")
    message = "b.h5: unknown model 'two_link_am'. Did you mean 'two_link_arm'? Existing: two_link_arm."
    with says(MessageError, message):
        command("show", "b.h5", "--name", "two_link_am")


@pytest.mark.parametrize("text", ["masses [/kg] and [red]", "[bold", "[/]", ":smile: [link=x]"])
def test_texts_with_brackets_are_printed_as_they_are(run, arm_file, text):
    old = 'description = "Two-link robotic arm with a load at its tip, scheduled on both joint angles"'
    code, out, _ = run("linearize", arm_file(old, f'description = "{text}"'), "-o", "a.h5")
    assert code == 0
    assert text in out
    code, out, _ = run("show", "a.h5")
    assert code == 0
    assert text in out


@pytest.mark.parametrize("command", ["check", "trim", "linearize"])
def test_names_with_brackets_are_printed_as_they_are(run, arm_file, command):
    code, out, _ = run(command, arm_file('name = "two_link_arm"', 'name = "arm [/x]"'))
    assert code == 0
    assert "arm [/x]" in out


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (["check"], "Missing argument 'FILE'."),
        (["chek", "arm.toml"], "No such command 'chek'."),
        (["check", "arm.toml", "--fast"], "No such option: --fast"),
        (["simulate", "arm.toml", "--steps", "1000000000"], "should be less than or equal to 1000000"),
        (["poles", "arm.toml", "--samples", "99999999999"], "should be less than or equal to 1000000"),
    ],
)
def test_usage(run, words, text):
    code, out, err = run(*words)
    assert (code, out) == (2, "")
    assert text in err
    assert "Traceback" not in err


def test_too_little_memory(command, monkeypatch):
    def large():
        raise MemoryError("Unable to allocate 9 TiB")

    monkeypatch.setattr("mbdlft.cli.commands.app", large)
    with says(MessageError, "there is too little memory: Unable to allocate 9 TiB"):
        command("show", "a.h5")


def test_a_scene_that_is_too_large_is_checked_without_its_slopes(command, run, arm_file, monkeypatch):
    """1,000 joints took more than 25 s and 2 GB, and then were called usable."""
    monkeypatch.setattr("mbdlft.multibody.to_problem._MOST_FREEDOMS", 1)
    monkeypatch.delattr("mbdlft.problem.linearization.relinearize")
    code, out, _ = run("check", arm_file())
    assert code == 0
    assert "It is too large to be linearized: its joints have 2 freedoms" in " ".join(out.split())
    with says(MessageError, "its joints have 2 freedoms. 1 take minutes"):
        command("linearize", arm_file())
