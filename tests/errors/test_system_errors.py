"""Errors of systems and their algebra: class and message."""

from dataclasses import replace

import control
import numpy as np

from mbdlft import FullBlock, Parameter, Signal, StructureError, as_system, connect, realize, state_space
from mbdlft.lft.lft import delta
from mbdlft.system import lft
from mbdlft.system.model import Trim
from tests.errors.table import refused, says

K = Parameter("k", 2.0, low=1.0, high=4.0)
STATIC = realize([["k", "1"]], [K], name="gain_of_k", inputs=["a", "b"], outputs=["c"])
OTHER = realize([["k"]], [Parameter("k", 2.0, low=1.0, high=5.0)], name="other")
ONE = state_space([[-1.0]], [[1.0]], [[1.0]], 0.0, name="one", inputs=["e"], outputs=["u"])
FULL = as_system(delta(FullBlock("D", 1)), name="unknown")


test_messages = refused(
    r"""
> {} => StructureError:
as_system("gain") => expected a System, an LFTModel, a continuous python-control sys
ONE + "k" => or a matrix, got 'k'.
ONE * None => or a matrix, got None.
ONE * np.nan => a gain needs finite numbers, got [[nan]].
feedback(ONE, [[np.inf]]) => a gain needs finite numbers, got [[inf]].
as_system(delta("k")) => an LFT with the real deltas k has no ranges: give them as
as_system(control.tf([1.0, 0.0], [1.0])) => no state space of it:
as_system(control.ss([[0.5]], [[1]], [[1]], [[0]], 0.1, name="d"))
    => system 'd': expected continuous time (dt = 0), got dt = 0.1.
as_system(STATIC, inputs=["a"]) => model 'gain_of_k', inputs: expected 2 names, got 1.
as_system(STATIC, inputs={"aa": "x"}) => inputs: unknown signal 'aa'. Did you mean 'a'? Existing: a, b.
as_system(STATIC, inputs=["x", "x"]) => x stands more than once among x, x.
state_space([[-1.0]], [[1.0]], [[1.0, 2.0]], 0.0, name="s")
    => system 's': C needs shape (1, 1), got (1, 2).
System("s", delta("k"), (), (Signal("u", "1"),), (Signal("y", "1"),), ())
    => model 's': the blocks ['k'] are not the parameters [].
STATIC.parameters["kk"] => unknown parameter 'kk'. Did you mean 'k'? Existing: k.
STATIC["c"] => expected model[outputs, inputs], with names, lists of names or sl
STATIC["d", "a"] => model 'gain_of_k', outputs: unknown signal 'd'. Existing: c.
STATIC["a", "c"] => 'a' is an input, 'c' an output, and outputs come first: model['c', 'a'].
STATIC["c", 2] => model 'gain_of_k', inputs: unknown signal '2'. Existing: a, b.
STATIC["c", ["a", "a"]] => inputs: a stands more than once among a, a.
STATIC + ONE => gain_of_k has 1 outputs and 2 inputs, one has 1 and 1; sums need
STATIC * ONE => series: one has 1 outputs (u) for the 2 inputs of gain_of_k (a, b).
append(STATIC, OTHER) => the parameter 'k' of other is not that of gain_of_k:
append() => append: expected one system or more.
append(ONE, ONE) => append, inputs: e stands more than once among e, e. as_system(
feedback(ONE, ONE, sign=2) => feedback: sign is -1 or 1, got 2.
feedback(STATIC, ONE)
    => feedback: one reads e and drives u, which are neither outputs (c) and inputs (a, b) of
feedback(STATIC, 2.0) => the number 2.0 stands between 1 signals (c) and 2 (a, b)
lft(STATIC, ONE, outputs=["d"]) => lft: outputs of gain_of_k: unknown signal 'd'.
lft(STATIC, ONE, inputs=["a", "b"])
    => lft: inputs of gain_of_k: a, b are 2, and one has 1 signals to connect them to: u.
lft(STATIC, as_system(np.eye(2), inputs=["q", "a"]), 1, 0)
    => lft, inputs: a stands more than once among a, b, a.
append(FULL, as_system(FULL, inputs=["v"], outputs=["w"])) => D stands twice, and
series(STATIC, ["a"]) => series: expected one block for the channels ['a'], got 0.
STATIC.at({"k": [1.0, 2.0]}) => model 'gain_of_k': at() takes one number for k; for arrays use
matrices_at(FULL, {"D": np.eye(2)}) => D is a full block and needs shape (1, 1)
STATIC.with_range(k=(0.5, 2.0))
    => model 'gain_of_k', with_range: k: [0.5, 2] reaches beyond [1, 4] 1, and outside of it
STATIC.with_range(m=(1, 2)) => with_range: unknown parameter 'm'. Existing: k.
STATIC.with_range(k=2.0) => k: expected (low, high) or (low, nominal, high), got 2
connect([], inputs=[], outputs=[]) => connect: expected one system or more.
wired(LOOP, inputs="b") => connect, inputs: expected a list of names, got 'b'.
wired(LOOP, outputs=["c", "c"]) => connect, outputs: c stands more than once
wired([["u", "a"], ["e", "r", "-c"]]) => connect: 'u' is an output. A connection is [input, outputs].
wired(["a", "u"]) => connections: expected lists of an input and one or more outp
wired([["a"]]) => expected lists of an input and one or more outputs, such as
wired([["q", "u"]]) => connect: unknown input 'q'. Existing: gain_of_k.a, gain_of_k.b, one.e.
wired([["a", "uu"]]) => connect: unknown output 'uu'. Existing: gain_of_k.c, one.u
wired({LOOP[:1]|None}) => connect, inputs: unknown input 'r'.
wired(LOOP, outputs=["z"]) => connect: unknown output 'z'.
wired(LOOP, inputs=["r"]) => connect: nothing drives gain_of_k.b. Name them in in
connect([ONE, as_system(ONE, name="two")], inputs=["e"], outputs=["u"])
    => connect: the output 'u' is not one signal. Say which: one.u, two.u.
connect([ONE, ONE], inputs=["e"], outputs=["u"])
    => connect: the output 'u' is not one signal. Two systems have one name: as_system(item, na
feedback(STATIC["c", "a"], -0.5)
    => WellPosednessError: model 'gain_of_k', feedback: the loop is singular at nominal: it does not
        determine a of gain_of_k,
feedback(STATIC["c", "a"], -1.0 / 3.0)
    => WellPosednessError: model 'gain_of_k', feedback: singular between the nominal values and the
        normalized ones k:
STATIC.with_range(k=(3.0, 2.0)) => SceneError: parameter 'k': low must be less than high
append(as_system(delta(FullBlock('k', 1)), name='unknown'), STATIC)
    => LFT: k is a full block here and a real one there.
"""
)


def wired(connections: object, **fields: object) -> object:
    given = {"inputs": ["b", "r"], "outputs": ["c"]} | fields
    return connect([STATIC, ONE], connections, **given)


LOOP = [["a", "u"], ["e", "r", "-c"]]


def test_a_trim_that_is_not_known_elsewhere() -> None:
    held = replace(STATIC, trim=Trim((Signal("f", "N"),), (1.0,), None))
    assert held.with_range(k=(1.5, 3.0)).trim == held.trim
    with says(StructureError, "the trim at another nominal value is not known, as its LFT was not"):
        held.with_range(k=(2.5, 3.0))
