"""Errors of couplings: unknown joints, units, ratios of zero, what is said twice, what locks."""

from mbdlft import Scene, assemble
from mbdlft.multibody.coupling import KINDS
from tests.errors.table import refused
from tests.laws.test_couplings import machine


def gears(*ratios: float | str, **fields: float) -> Scene:
    """Gears from a to b, b to c, and so on around."""
    made = [
        KINDS["gear"](name=f"g{k}", joints=("abcabc"[k], "abcabc"[k + 1]), ratio=ratio, **fields)
        for k, ratio in enumerate(ratios)
    ]
    return machine(*made)


def of(kind: str, *, rates=(), places=(), imposed: bool = False, **fields):
    given = {"rate": rates, "position": places}
    joints = {
        n: {key: x[k] for key, x in given.items() if x and x[k] is not None} for k, n in enumerate("ab")
    }
    if imposed:
        joints = {name: {"imposed": True, "preload": None} for name in "ab"}
    return machine(KINDS[kind](name="k", **fields), inputs=None, **joints)


test_messages = refused(
    r"""
> assemble(of({})) => SceneError: coupling 'k' …
"gear", joints=("a", "d"), ratio=2.0 => unknown joint 'd'
"gear", joints=("a", "a.rate"), ratio=2.0 => 'a.rate' is no coordinate … a.angle
"gear", joints=("a", "a"), ratio=2.0 => two or more different coordinates, got a, a
"planetary", sun="a", ring="a.angle", carrier="c", ratio=2.0 => 'a' and 'a.angle' are the same coordinate
"linear", factors={"a": 1.0} => two or more different coordinates, got a
"gear", joints=("a", "s"), ratio=2.0 => 's' is a distance … rack (radius)
"rack", joint="s", slider="a", radius=0.1 => 'a' is an angle … has a distance there
"gear", joints=("a", "b"), ratio=0.0 => ratio = 0.0 is 0
"gear", joints=("a", "b"), ratio="n - 4" => ratio = 'n - 4' vanishes in the range [-1, 4]
"planetary", sun="a", ring="b", carrier="c", ratio=-1.0 => 1 + ratio = 0.0 is 0
"rack", joint="a", slider="s", radius="n*2 [kg]" => the unit does not fit: expected m, got kg
"gear", joints=("a", "b"), ratio=2.0, backlash=0.1 => backlash: got 0.1
"gear", joints=("a", "b"), ratio=2.0, damping=0.1 => damping: a rigid coupling has none, got 0.1
"gear", joints=("a", "b"), ratio=2.0, offset=0.3, places=(0.0, 0.0)
    => (a = 0, b = 0 at nominal) make 0 rad … offset is 0.3
"gear", joints=("a", "b"), ratio=2.0, rates=(10.0, 4.0) => rates do not fit: a at 10.0, b at 4.0
> assemble(of({})) => SceneError: joint 'a', position = …
"gear", joints=("a", "b"), ratio="n", offset=0.3, places=(None, 0.5)
    => 'n' is not an angle … follows from the offset of coupling 'k'
> assemble({}) => SceneError: scene 'machine': the rigid couplings …
gears(2.0, 3.0, 0.25) => g0, g1, g2 lock a.angle, b.angle, c.angle
gears(2.0, 3.0, '1/6') => g0, g1, g2 say 3 things, of which 2 are independent
gears(2.0, 3.0, 0.5, 0.5) => g0, g1, g2, g3 say 4 things, of which 3 are independent
gears(2.0, 3.0, 0.25, stiffness=10.0) => accepted
of("gear", joints=("a", "b"), ratio=2.0, imposed=True) => hold the imposed joints a, b together
"""
)
