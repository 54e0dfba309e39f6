"""Errors of scene files: syntax with its line, format, keys, kinds, and the line of a table."""

import pytest

from mbdlft import MbdlftError, NotRationalError, SceneError, assemble, load_scene, scene_from_toml
from tests.errors.scenes import ARM, changed
from tests.errors.table import refused, says

M1 = 'm1     = { nominal = 3.0, percent = 20, unit = "kg" }'
THETA1 = 'theta1 = { nominal = 70.0, low = 45.0, high = 90.0, unit = "deg", role = "scheduled" }'
L1 = 'L1 = { value = 1.0, unit = "m" }'


test_messages = refused(
    r"""
assemble(scene_from_toml(ARM)) => accepted
scene_from_toml(changed("mass = 2.0", 'mass = 2.0\nname = "other"')) => body 'link2' … name
> (lambda old, new: scene_from_toml(changed(old, new)))({}) => SceneError: not valid TOML: …
"[bodies.link2]", "[bodies.link2" => (at line 28, column
"mass = 2.0", "mass = " => (at line 30, column
"[joints.elbow]", "[joints.shoulder]" => (at line 48, column
"damping = 0.1", "damping = 0,1" => (at line 46, column
> (lambda old, new: scene_from_toml(changed(old, new)))({}) => SceneError:
"scene/1", "scene/2" => format: expected 'mbdlft-scene/1', got 'mbdlft-scene/2'.
'format = "mbdlft-scene/1"', "" => the line format = 'mbdlft-scene/1' is missing.
"gravity =", "gravty =" => unknown key 'gravty'. Did you mean 'gravity'? Existing:
"[linearize]", "[linearise]" => unknown key 'linearise'. Did you mean 'linearize'?
"[linearize]", f"[{'.'.join('a' * 600)}]" => line 62: not valid TOML: expected a key of at most 500 parts.
"outputs =", "output ="
    => linearize: unknown key 'output'. Did you mean 'outputs'? Existing: inputs, outputs, states.
f"[constants]\n{L1}", "constants = 3" => constants: expected a table, got 3.
'name = "two_link_arm"', "name = 1979-05-27" => name: expected a text, got datetime.date(1979, 5, 27).
> (lambda old, new: scene_from_toml(changed(old, new)))({}) => SceneError:
M1, "m1 = 3.0" => line 13: parameter 'm1': expected a table, got 3.0.
M1, M1.replace("nominal", "nominel") => line 13: parameter 'm1': unknown key 'nominel'. Did you mean
M1, M1.replace("nominal = 3.0, ", "") => line 13: parameter 'm1': 'nominal' is missing.
M1, M1.replace("3.0", '"3"') => line 13: parameter 'm1': nominal: expected a number, got '3'.
M1, M1.replace("20", "true") => line 13: parameter 'm1': percent: expected a number, got True.
M1, M1.replace('"kg"', "1") => line 13: parameter 'm1': unit: expected a text, got 1.
M1, M1.replace("3.0", "nan") => line 13: parameter 'm1': values must be finite, got nominal nan
M1, M1.replace("percent = 20, ", "") => line 13: parameter 'm1': give the range in exactly one way
THETA1, THETA1.replace("low = 45.0, high = 90.0", "percent = 20")
    => line 18: parameter 'theta1': percent has no meaning for an angle; give low and high.
THETA1, THETA1.replace("unit", 'substitution = "half_angle", unit')
    => line 18: parameter 'theta1': substitution: unknown substitution 'half_angle'. Did you mean
        'half-angle'? Existing: half-angle, quarter-angle.
THETA1, THETA1.replace("unit", 'substitution = "identity", unit')
    => line 18: parameter 'theta1': substitution: unknown substitution 'identity'.
THETA1, THETA1.replace("45.0", "-120.0") => line 18: parameter 'theta1': the range [-120.0, 90.0] deg
> (lambda old, new: scene_from_toml(changed(old, new)))({}) => SceneError:
'"rigid"', '"rigd"' => line 21: … body 'link1': unknown kind 'rigd'. Did you mean
'"revolute"', '"revolut"' => line 39: … joint 'shoulder': unknown kind 'revolut'. D
"{ xx = 0.1 }", "{ xw = 0.1 }" => line 28: … body 'link2': inertia: unknown key 'xw'. Did you mean 'xz'?
"ports.tip", "port.tip" => line 21: … body 'link1': unknown key 'port'. Did you mean
'mass = "m3"', "" => line 35: … body 'load': 'mass' is missing.
"stiffness =", "stifness ="
    => line 39: … joint 'shoulder': unknown key 'stifness'. Did you mean 'stiffness'?
"axis = [1, 0, 0]", 'axis = ["L1", 0, 0]'
    => line 39: … joint 'shoulder': axis: expected three numbers, got ['L1', 0, 0].
"axis = [1, 0, 0]", "axis = [0, 0, 0]" => line 39: … joint 'shoulder': axis has zero length
'kind = "rigid"', "" => line 21: … body 'link1': 'kind' is missing. Kinds
'kind = "rigid"', 'knid = "rigid"' => body 'link1': 'kind' is missing, and 'knid' is no key. Kinds
'format =', 'formt =' => the line format = 'mbdlft-scene/1' is missing, and 'formt' is no key.
M1, M1.replace('"kg"', '"kgg"') => line 13: … parameter 'm1': unit 'kgg': unknown symbol 'kgg'.
L1, L1.replace("value", "valu") => line 10: … constant 'L1': 'value' is missing.
L1, L1.replace("unit", "unti") => line 10: … constant 'L1': unknown key 'unti'. Did you mean
L1, 'L1 = "abc"' => line 10: … constant 'L1': expected a finite number
L1, L1.replace('"m"', "3") => line 10: … constant 'L1': unit: expected a text, got 3.
> scene_from_toml(changed('kind = "rigid"', {})) => SceneError: body 'link1' … kind
'kind = ["rigid"]'
"kind = { a = 1 }"
"kind = 1"
> load_scene({}) => SceneError:
tmp_path => : cannot be read:  … directory
file_of(b"\x89HDF\r\n") => arm.toml: it is an archive (HDF5), not a text. mbdlft.load(path) reads its
"motor_drive.mo" => motor_drive.mo: it is a Modelica model … load_modelica
file_of('name = "Käfer"'.encode("latin-1")) => arm.toml: cannot be read:  … utf-8
file_of(changed("[bodies.link2]", "[bodies.link2").encode()) =~ ^/.*arm.toml: not valid TOML:
file_of(changed("scene/1", "scene/2").encode()) =~ ^/.*arm.toml: format: expected
file_of(changed(M1, M1.replace("nominal", "nominel")).encode())
    =~ ^/.*arm.toml: line 13: parameter 'm1': unknown key
"""
)


def test_missing_file_is_named_once_without_an_error_number(tmp_path):
    file = tmp_path / "none.toml"
    with says(SceneError, f"{file}: cannot be read: ", "No such file or directory") as raised:
        load_scene(file)
    assert str(raised.value).count(str(file)) == 1
    assert "Errno" not in str(raised.value)


@pytest.fixture
def file_of(tmp_path):
    def write(data):
        (tmp_path / "arm.toml").write_bytes(data)
        return tmp_path / "arm.toml"

    return write


def test_classes_have_one_base():
    with pytest.raises(MbdlftError):
        assemble(scene_from_toml(changed('mass = "m1"', 'mass = "sqrt(m1)"')))
    assert issubclass(NotRationalError, ValueError)
