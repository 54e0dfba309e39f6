"""A table of equations with kinks, jumps, implicit functions, units, scales: right, or the reason."""

import pytest

import mbdlft
from mbdlft import MbdlftError
from mbdlft.modelica import flat_model, operating_point, translate
from tests.attack.switches import K, check, slopes, text_of

_KM, _DEG = 'Real x(unit="km"); Real z(unit="m"); ', 'Real x(unit="deg"); Real z; '  # before words
_RISES = "der(x) = u - x; "
# equations, start values, and what the message says if there is no model, or declarations
ROWS: list[tuple[str, dict[str, float], str]] = [
    ("der(x) = u - k*abs(x)", {}, "two slopes by 'x', -1 and 1"),
    ("der(x) = u - k*abs(x)", {"x": 1.0, "u": 1.0}, ""),
    ("der(x) = u - k*abs(x)", {"x": 1e-12, "u": 1e-12}, ""),
    ("der(x) = u - k*abs(x)", {"x": 1e12, "u": 1e12}, ""),
    ("der(x) = u - k*abs(x) - 2*x", {}, "two slopes by 'x', 1 and 3"),
    ("der(x) = u - x*abs(x) - k*x", {}, ""),
    ("der(x) = u - k*sign(x)", {}, "jumps from -1 to 1"),
    ("der(x) = u - k*x*sign(x - 3)", {}, ""),
    ("der(x) = u - max(k*x, 3*x)", {}, "two slopes by 'x', 3 and 1"),
    ("der(x) = u - max(k*x, -x)", {"x": 1.0, "u": 1.0}, ""),
    ("der(x) = u - min(k*x, 3*x + 9)", {"x": 1.0, "u": 1.0}, ""),
    ("der(x) = u - (if x > 0 then k*x else 2*x)", {}, "two slopes by 'x', 1 and 2"),
    ("der(x) = u - (if x > 0 then k*x else k*x + x^2)", {}, ""),
    ("der(x) = u - (if x > 0 then k*x + 1 else k*x)", {}, "jumps from 1 to 0"),
    ("der(x) = u - (if x > -1 then k*x else 2*x)", {}, ""),
    ("der(x) = u - (if k > 1 then x else 2*x)", {}, "changes its branch inside of the range of k"),
    ("der(x) = u - (if k > 0.5 then x else 2*x)", {}, ""),
    ("der(x) = u - abs(k - 2)*x", {}, ""),
    ("der(x) = u - abs(k - 1)*x", {}, "changes its branch inside of the range of k"),
    ("der(x) = u - max(k, 1)*x", {}, "changes its branch inside of the range of k"),
    ("der(x) = u - max(k, 0.5)*x", {}, ""),
    ("der(x) = u - sqrt(k^2)*x", {}, ""),
    ("der(x) = u - sqrt((1/k)^2)*x", {}, ""),
    ("der(x) = u - sqrt(k*(k*0.09))*x", {}, ""),
    ("der(x) = u - sqrt(2*k^2)*x", {}, ""),
    ("der(x) = u - sqrt(k)*x", {}, "sqrt(k) is not rational in the parameters k"),
    ("der(x) = u - sqrt(x)*k", {"x": 1.0, "u": 1.0}, ""),
    ("der(x) = u - sqrt(x)*k", {}, "no equilibrium was found"),
    ("der(x) = u - sqrt(abs(x))", {}, "there is no linear model"),
    ("der(x) = u - log(x)", {"x": 0.9}, ""),
    ("der(x) = u - 1/x", {}, "no equilibrium was found"),
    ("der(x) = u - k*sqrt(x^2 + 1e-12)", {}, "no equilibrium was found"),
    ("der(x) = u - z; z^3 + z = x", {"x": 2.0, "z": 1.0, "u": 1.0}, ""),
    ("der(x) = u - k*z; z*exp(z) = x", {"z": 0.1}, ""),
    ("der(x) = u - z; k*z + sin(z) = x", {"z": 0.1}, ""),
    (_RISES + "sin(z) = x/2", {"x": 1.0, "z": 0.5, "u": 1.0}, ""),
    (_RISES + "exp(z) = x + 1", {"z": 0.1}, ""),
    (_RISES + "k*z + sin(z) = x", {"x": 1.0, "z": 0.5, "u": 1.0}, "z depend on the parameters"),
    (_RISES + "z^2 = k^2*x", {"x": 4.0, "z": 2.0, "u": 4.0}, ""),
    (_RISES + "z^2 = k*x", {"x": 4.0, "z": 2.0, "u": 4.0}, "z depend on the parameters"),
    (_RISES + "z^2 = x", {"x": 1e-12, "z": 1e-6, "u": 1e-12}, ""),
    (_RISES + "z^2 = x", {"x": 1e12, "z": 1e6, "u": 1e12}, ""),
    (_RISES + "z^3 = x", {"x": 8.0, "z": 2.0, "u": 8.0}, ""),
    (_RISES + "z^3 = x", {}, "do not determine z there"),
    (
        _RISES + "cos(z) = x",
        {"x": 1.0, "u": 1.0},
        "do not determine z there. Give other start values of z",
    ),
    (_RISES + "sqrt(z) = k*x", {"x": 1.0, "z": 1.0, "u": 1.0}, ""),
    (_RISES + "z*abs(z) = x", {"x": 4.0, "z": 2.0, "u": 4.0}, ""),
    (_RISES + "max(z, 2*z) = x", {"x": 1.0, "z": 0.5, "u": 1.0}, ""),
    (_RISES + "max(z, 2*z) = x", {}, "two slopes by 'z', 2 and 1"),
    (_RISES + "atan(z) = k*x", {}, ""),
    (_RISES + "z + abs(z)/2 = x - k", {"x": 4.0, "z": 2.0, "u": 4.0}, ""),
    (_RISES + "sin(z/1e-12) = x + 0.5", {"z": 0.0}, ""),
    (_RISES + "1e-12*sin(z/1e12) = 1e-12*(x + 0.5)", {"z": 4e11}, ""),
    (_RISES + "1e12*z*exp(z) = 1e12*x", {"z": 0.1}, ""),
    ("1e-12*der(x) = 1e-12*(u - k*x)", {}, ""),
    ("1e12*der(x) = 1e12*(u - k*x*abs(x))", {"x": 1.0, "u": 1.0}, "x depend on the parameters"),
    ("der(x) = u - 1e-12*k*x", {}, ""),
    ("der(x) = 1e-12*u - 1e12*k*x - x^2", {}, ""),
    ("der(x) = u - k*x; z = 1000*x", {}, _KM),
    ("der(x) = u - k*x; z = x", {}, _KM + "the left side is in m, the right side in km"),
    ("der(x) = u - k*x; z = sin(x)", {}, _DEG + "sin of a value in deg"),
    ("der(x) = u - floor(x + 0.5)*k - x", {}, "floor of what is no number makes events"),
]


@pytest.mark.parametrize(("equations", "starts", "words"), ROWS)
def test_model_or_reason_is_right(equations: str, starts: dict[str, float], words: str) -> None:
    declared, end, words = words.rpartition("; ") if words.startswith("Real") else ("", "", words)
    text = text_of(equations, starts, declared + end)
    if words:
        with pytest.raises(MbdlftError) as error:
            mbdlft.linearize_dae(operating_point(*translate(flat_model(text))))
        assert words in str(error.value)
        return
    linear = mbdlft.linearize_dae(operating_point(*translate(flat_model(text))), search=0.0)
    check(linear, {k: slopes(equations, {"z": 0.0} | starts, k) for k in K})
