"""Rational matrices of the literature with known smallest orders, as rows of texts.

`bound` is the sum of the McMillan degrees, `published` what tools were reported to reach, and `order`
what is reached here with a search; where it is larger than the bound, it may be tightened.

O1 to O8: small matrices used to compare order reduction. O9, O10, O13: small state-space models. O11,
O12: a missile with aerodynamic coefficients that are polynomials in the angle of attack and the Mach
number, free and with the fin at its trim, numbers our own. O14: lateral motion of a transport aircraft
with 14 coefficients.
"""

from typing import NamedTuple

import numpy as np

from mbdlft import MatrixProblem, Parameter

Rows = list[list[str]]
_MOST_CORNERS = 128


class Case(NamedTuple):
    """One matrix, its parameters, and the orders that are known."""

    name: str
    matrix: Rows
    parameters: tuple[Parameter, ...]
    bound: int
    order: int
    published: str
    states: int = 0
    more: int = 0  # that pairs of parameters are proved to need above the bound

    @property
    def proved(self) -> int:
        """The proved minimum of the order."""
        return self.bound + self.more

    def problem(self, matrix: Rows | None = None) -> MatrixProblem:
        """The case as a matrix problem; with another way of writing its entries if given."""
        return MatrixProblem(
            name=self.name, matrix=matrix or self.matrix, parameters=self.parameters, states=self.states
        )


def parameters(*names: str) -> tuple[Parameter, ...]:
    """Parameters of different nominal values, +-25 percent."""
    return tuple(Parameter(name, 0.4 + 0.15 * k, percent=25) for k, name in enumerate(names))


CZ = "(29/250*Al^3 - 31/120*Al^2 - 17/100*(2 - Ma/3)*Al - 34/1000*{dp})"
CM = "(43/200*Al^3 - 39/200*Al^2 + 51/1000*(-7 + 8*Ma/3)*Al)"
SLOPE_Z = "(3*29/250*Al^2 - 2*31/120*Al - 17/100*(2 - Ma/3))"
SLOPE_M = "(3*43/200*Al^2 - 2*39/200*Al + 51/1000*(-7 + 8*Ma/3))"
M0 = "(-206/1000)"


def missile(dp: str) -> Rows:
    """[A B ; C D] of the derivatives by angle of attack, pitch rate and fin."""
    cz = CZ.format(dp=dp)
    return [
        [f"7/5*Ma*({SLOPE_Z}*(1 - Al^2/2) - {cz}*Al)", "1", "-7/5*34/1000*Ma*(1 - Al^2/2)"],
        [f"49/3*Ma^2*{SLOPE_M}", "0", f"49/3*{M0}*Ma^2"],
        [f"11/8*Ma^2*{SLOPE_Z}", "0", "-11/8*34/1000*Ma^2"],
    ]


MISSILE_RANGE = (Parameter("Al", 0.2, 0.05, 0.35), Parameter("Ma", 3.0, 2.0, 4.0))
TRIMMED = f"(-{CM}/{M0})"

COEFFICIENTS = {
    "Ybeta": -0.082,
    "Yp": 0.010827,
    "Yr": 0.060268,
    "Ydp": 0.002,
    "Ydr": 0.0118,
    "Lbeta": -0.84,
    "Lp": -0.76,
    "Lr": 0.74,
    "Ldp": 0.095,
    "Ldr": 0.06,
    "Nbeta": 0.092,
    "Np": -0.23,
    "Nr": -0.114,
    "Ndr": -0.151,
}
SINE, COSINE, GV = "0.139173100960065", "0.990268068741570", "0.146418"
LOAD = "-0.119202763786893"  # -(pi/180)/gV
LATERAL = [
    ["Ybeta", f"Yp + {SINE}", f"Yr - {COSINE}", GV, "Ydp", "Ydr"],
    ["Lbeta", "Lp", "Lr", "0", "Ldp", "Ldr"],
    ["Nbeta", "Np", "Nr", "0", "0", "Ndr"],
    ["0", "1", "0.14", "0", "0", "0"],
    [f"{LOAD}*Ybeta", f"{LOAD}*Yp", f"{LOAD}*Yr", "0", f"{LOAD}*Ydp", f"{LOAD}*Ydr"],
    ["0", "1", "0", "0", "0", "0"],
    ["0", "0", "1", "0", "0", "0"],
    ["0", "0", "0", "1", "0", "0"],
]

CASES = (
    Case(
        "O1",
        [["4*d1^2*d3", "3*d1", "0"], ["d3*d5", "5*d2^2*d4", "d2*d4^2"]],
        parameters("d1", "d2", "d3", "d4", "d5"),
        8,
        8,
        "12 plain, 9 tree",
    ),
    Case(
        "O2",
        [["(1 + a^2 + b*a)^5 - (1 + a + b)^3"]],
        parameters("a", "b"),
        15,
        15,
        "26 as written, 39 tree, 156 expanded and then 17",
    ),
    Case("O3", [["d1*d2*d3"], ["d2*d3*d1"], ["d3*d1*d2"]], parameters("d1", "d2", "d3"), 3, 3, "9"),
    Case("O4", [["d1*d2"], ["d1*d2"]], parameters("d1", "d2"), 2, 2, "2"),
    Case(
        "O5",
        [["1/(1 + d1 + d2)"], ["1/(1 + d1 + d2)"]],
        parameters("d1", "d2"),
        2,
        2,
        "2 by n-D, more by 1-D",
    ),
    Case(
        "O6",
        [["d3*d1 + d3*d2 + d4*d1 + d4*d2"], ["d1 + d2"]],
        parameters("d1", "d2", "d3", "d4"),
        4,
        4,
        "4",
    ),
    Case("O7", [["d1^2*s^2 + d1*d3*s + d1^2*d3^2"]], parameters("d1", "d3", "s"), 6, 7, "7"),
    Case(
        "O8",
        [["s*x^2*z^3 + 3*x*y*z", "x^2*y^2*z^3", "1"], ["0", "s^2*x^3*y*z", "x*y^2*z - x^2*y*z"]],
        parameters("s", "x", "y", "z"),
        16,
        17,
        "18",
        more=1,
    ),
    Case(
        "O9",
        [["0", "1", "0"], ["-f^2", "-2*xi*f", "f^2"], ["1", "0", "0"]],
        parameters("f", "xi"),
        3,
        3,
        "3",
        2,
    ),
    Case(
        "O10",
        [["3 + de + et", "de/et"], ["7 + rh", "rh + de*et"]],
        (
            Parameter("de", 2.0, percent=20),
            Parameter("et", 6.0, percent=20),
            Parameter("rh", -1.0, percent=20),
        ),
        6,
        6,
        "6",
    ),
    Case("O11", missile("dp"), (*MISSILE_RANGE, Parameter("dp", -0.1, -0.3, 0.2)), 10, 10, "12", 2),
    Case("O12", missile(TRIMMED), MISSILE_RANGE, 9, 9, "11", 2),
    Case(
        "O13",
        [["-1 + 5*a", "-10*(1 + b)", "1 + b"], ["10*(1 + c^2)", "-1 - a*b*c", "c"], ["1", "1", "0"]],
        parameters("a", "b", "c"),
        6,
        6,
        "7",
        2,
    ),
    Case(
        "O14",
        LATERAL,
        tuple(Parameter(name, value, percent=10) for name, value in COEFFICIENTS.items()),
        14,
        14,
        "14",
        4,
    ),
)


def points(case: Case, inside: int) -> list[dict[str, float]]:
    """Random points and corners of the range."""
    generator = np.random.default_rng(3)
    low = np.array([p.low for p in case.parameters])
    high = np.array([p.high for p in case.parameters])
    corners = np.array(np.meshgrid(*[(0.0, 1.0)] * min(len(low), 7))).reshape(min(len(low), 7), -1).T
    if len(low) > 7:
        corners = generator.integers(0, 2, (_MOST_CORNERS, len(low))).astype(float)
    weights = np.vstack([generator.random((inside, len(low))), corners])
    rows = low + weights * (high - low)
    return [dict(zip([p.name for p in case.parameters], row, strict=True)) for row in rows.tolist()]
