"""Reasons: one fault is planted in an input that is right, and the message has to name what was planted.

A row of `FAULTS` replaces a text of a base by another one; names of the base are drawn anew, ``~name`` is
a misspelt one, one of ``<a|b|c>`` is chosen. Without the fault there is no error. Every other seed has a
fault in a line of a scenario. The error is one of the package, is there soon, and has all of the words.
"""

import re
import time
from pathlib import Path
from typing import Any

import numpy as np

import mbdlft
from mbdlft import MbdlftError, to_lft
from tests.attack.mutations import check_message
from tests.daes import dae_of

ROOT = Path(__file__).parents[2] / "scenarios"
_UNITS = {"mass": "kg", "stiff": "N/m", "damp": "N s/m", "size": "m"}
PROCESS_SECONDS = 15.0  # of the processor; most take a tenth of one
_EQUATIONS = (
    "dist[m] speed[m/s] twice[m] slack[m] | rate: der(dist) = speed | push: mass*der(speed) = pull - "
    "stiff*dist - damp*speed | law: twice = 2*dist | loose: size*(2*slack + fabs(slack)) = "
    "dist*fabs(dist) | pull[N] | twice slack"
)
BASES: dict[str, tuple[str, str]] = {  # the text, and names that are drawn anew
    "arm": (
        (ROOT / "two_link_arm.toml").read_text("utf-8"),
        "link1 link2 load shoulder elbow grip L1 m1 J1 rho1 m3 L2 theta1 theta2 tip",
    ),
    "bar": (
        (ROOT / "four_bar.toml").read_text("utf-8"),
        "lower upper lamp elbow guide wrist hinge push tilt theta m_lamp k tip",
    ),
    "dae": (_EQUATIONS, "dist speed twice slack rate push law loose pull stiff mass damp size"),
    "matrix": ("mass*stiff, 1/(2 + mass); stiff^2, 3*mass - stiff", "mass stiff"),
}
BASES["call"] = ("", BASES["arm"][1])
# kind of the base, what is replaced, by what, words of the message
FAULTS = r"""
arm >> mass = "m1" >> mass = "~m1" >> link1 mass ~m1 m1
arm >> mass = "m1" >> mass = "<m1 +|2*(m1|m1 m3|m1^^2|sqrt(m1)|m1^0.5|sin(m1)|m1 - 2*m1>" >> link1 mass
arm >> mass = "m1" >> mass = "<m1 + L2|J1|rho1|theta1|m1/(rho1 - 0.3)>" >> link1 mass
arm >> mass = "m1" >> mass = <-1.0|-1e-3|-7e5|nan|inf|true|[1.0]> >> link1 mass
arm >> mass = 2.0 >> mass = <1e300|1e-300> >> link2 mass <300|-300>
arm >> mass = "m1"\n >> \n >> link1 mass
arm >> inertia = { xx = 0.1 } >> inertia = { xx = 0.1, yy = 0.01, zz = 0.01 } >> link2 inertia
arm >> inertia = { xx = 0.1 } >> inertia = { <rr|ixx> = 0.1 } >> link2 <rr|ixx>
arm >> nominal = 3.0, percent = 20 >> nominal = 3.0, percent = 130 >> link1 mass m1
arm >> nominal = 3.0, percent = 20 >> nominal = 3.0, low = 4.0, high = 5.0 >> m1 3 4 5
arm >> 3.0, percent = 20 >> 3.0<|, low = 3.0, high = 3.0|, low = 5.0, high = 2.0|, low = 1.0> >> m1
arm >> "kg m^2" >> "<furlong|kg meter|kg|N m|s>" >> J1
arm >> theta1 = { nominal = 70.0 >> theta1 = { nominal = 170.0 >> theta1 170 45 90
arm >> high = 135.0, unit = "deg" >> high = <500.0|1e300>, unit = "deg" >> theta2
arm >> L1 = { value = 1.0, unit = "m" } >> L1 = { value = 1.0, unit = "<kg|deg>" } >> link1 L1
arm >> L1 = { value = 1.0, unit = "m" } >> ~L1 = { value = 1.0, unit = "m" } >> L1
arm >> center_of_mass = [0, "0.5*L2", 0] >> center_of_mass = [0, "0.5*L2"] >> link2 center_of_mass
arm >> parent = "link1.tip" >> parent = "link2.tip" >> link2
arm >> child = "load" >> child = "link1" >> link1
arm >> child = "load"\n >> \n >> grip child
arm >> axis = [1, 0, 0] >> axis = <[0, 0, 0]|[1, 0]|1.0|"x"> >> shoulder axis
arm >> position = "theta1" >> position = "<L1|m1|3*theta1/theta2>" >> shoulder position
arm >> "theta2"\nstiffness = 0.1 >> "theta2"\nstiffness = "<m1|J1*m1>" >> elbow stiffness
arm >> position = "theta2" >> position = "theta2"\npreload = <0|0.1> >> no_:equilibrium elbow.torque
arm >> "elbow.torque"] >> "<elbow.force|~elbow.torque|shoulder.torque>"] >>
    <elbow.force|~elbow.torque|shoulder.torque>
arm >> gravity = [0.0, 0.0, -9.81] >> gravity = <[0.0, -9.81]|-9.81|"down"> >> gravity
arm >> "mbdlft-scene/1" >> "mbdlft-<scene/2|matrix/1>" >> <scene/2|matrix/1>
arm >> [linearize] >> [joints.spare]\nkind = "fixed"\nparent = "ground"\nchild = "load"\n[linearize]
    >> load
arm >> [linearize] >> [sensors.spare]\nkind = "position"\nport = "~link1"\n[linearize] >> spare ~link1
arm >> [linearize]
    >> [loads.spare]\nkind = "force"\nport = "link1.tip"\ndirection = [0, 0, 0]\n[linearize]
    >> spare direction
arm >> [linearize] >> [joint.spare]\nkind = "fixed"\n[linearize] >> joint
bar >> ports.tip = [0, 0.5, 0]\n\n[bodies.upper] >> ports.tip = [0, 0.6, 0]\n\n[bodies.upper] >> hinge
bar >> position = "-theta" >> position = "<theta|2*theta>" >> hinge
bar >> child = "lamp.upper"\naxis = [1, 0, 0] >> child = "lamp.upper"\naxis = [0, 1, 0] >> hinge
bar >> ports.spring = [0, 0, 0.6] >> ports.spring = [0, 0, 0.0] >> spring
bar >> stiffness = "k" >> stiffness = "<m_lamp|theta>" >> spring stiffness
bar >> preload = 0\n\n[joints.guide] >> \n[joints.guide] >> elbow.torque spring.force_density
bar >> port = "lamp.center_of_mass" >> port = "lamp.<center|com>" >> lamp <center|com>
bar >> kind = "rotation" >> kind = "<orientation|rot>" >> tilt <orientation|rot>
bar >> m_lamp = { nominal = 1.5, percent = 30 >> m_lamp = { nominal = 1.5, percent = 101 >> lamp m_lamp
dae >> | law: twice = 2*dist >> >> twice
dae >> twice = 2*dist >> twice = 2*dist | more: twice = 3*dist >> more
dae >> twice = 2*dist >> twice = <2*speed|mass*dist|exp(dist)|sqrt(mass*stiff)/damp*dist> >> law
dae >> twice = 2*dist >> twice = <fabs(dist)|fmax(dist, 2*dist)> >> law <fabs|fmax> dist
dae >> dist*fabs(dist) >> size*dist >> loose fabs slack 2_:and_:6
dae >> 2*slack + >> <slack/2|slack|-slack> + >> loose fabs slack two_:slopes
dae >> 2*slack + >> 2*damp*damp/(mass*stiff)*slack - >> loose fabs slack two_:slopes
dae >> twice = 2*dist >> twice = 2*dist + <1e400|float('nan')>*dist >> law
dae >> twice = 2*dist >> twice*twice = dist*dist - size*size >> law
dae >> | twice >> | ~twice >> ~twice
dae >> twice[m] >> twice[<furlong|metre>] >> twice <furlong|metre>
dae >> twice[m] >> twice[m] dist[m] >> dist
dae >> | law: >> | spare: speed = <2|-3>*damp*size/mass + speed - speed | law: >> spare
dae >> - damp*speed >> - damp*speed + <stiff|3*stiff>*size*size/(speed*size/damp*stiff) >> push
matrix >> 1/(2 + mass) >> 1/(mass - 1) >> (0,_:1) mass
matrix >> 1/(2 + mass) >> 1/(2 + ~mass) >> (0,_:1) ~mass
matrix >> 1/(2 + mass) >> <sqrt(mass)|sin(stiff)|mass^0.5> >> (0,_:1)
matrix >> 3*mass - stiff >> <3*mass stiff|3*/mass|(mass> >> (1,_:1)
matrix >> , 3*mass - stiff >> >> row 1 1 2
matrix >> stiff^2 >> 1e200*stiff^2 >> (1,_:0) e+200
call >> model.at(m1=3.1) >> model.at(~m1=3.1) >> ~m1 m1
call >> model.at(m1=3.1) >> model.at(m1=<7.0|-1.0|float('nan')>) >> m1 2.4 3.6
call >> model.at(m1=3.1) >> model.at(m1=[3.1, 3.2]) >> m1 matrices_at
call >> mbdlft.matrices_at(model, {"m1": [3.0, 3.1], "m3": [5.0, 5.1]})
    >> mbdlft.matrices_at(model, {"m1": [3.0, 3.1], "m3": [5.0]*3}) >> (2,) (3,)
call >> mbdlft.frequency_response(model, {}, [1.0])
    >> mbdlft.frequency_response(model, {}, [<float('nan')|"a"|[[1.0]]>]) >> omega
call >> mbdlft.hinf_norm(model, outputs="elbow.angle")
    >> mbdlft.hinf_norm(model, outputs="~elbow.angle") >> ~elbow
call >> mbdlft.step_response(model, times=[0.0, 1.0])
    >> mbdlft.step_response(model, times=[<0.0, -1.0|1.0, 0.5|"a">]) >> times
call >> mbdlft.trim_at(model, {"theta1": 60.0}) >> mbdlft.trim_at(model, {"theta1": 600.0})
    >> theta1 600 45 90
call >> mbdlft.poles(model) >> mbdlft.poles(<model.at()|scene|None|"arm.h5">) >> poles system
call >> mbdlft.corners(model.parameters[:2]) >> mbdlft.corners(["m1"]) >> corners parameters[0]
call >> mbdlft.feedback(model, [[1.0, 0.0], [0.0, 1.0]])
    >> mbdlft.feedback(model, <scene|[[1.0]]|"K">) >> feedback
call >> mbdlft.connect([model[:, "elbow.torque"]], inputs=["elbow.torque"], outputs=["elbow.angle"])
    >> mbdlft.connect([model], {"elbow.torque": "~elbow.angle"}, inputs=[], outputs=[]) >> ~elbow
call >> mbdlft.find_equilibrium(scene, {"m1": 3.1})
    >> mbdlft.find_equilibrium(scene, {"<~m1|m9>": 3.1}) >> <~m1|m9>
call >> mbdlft.save(folder / "a.h5", model) >> mbdlft.save(folder / "none" / "a.h5", model) >> a.h5 none
call >> mbdlft.simulate(scene, [0.0, 0.1], parameters={"m1": 3.1})
    >> mbdlft.simulate(scene, [0.0, 0.1], parameters={"m1": 9.0}) >> m1 9 2.4 3.6
"""


def attack(seed: int, folder: Path) -> str:
    """Plant one fault in an input, and look for its words in the message."""
    random, known = np.random.default_rng(seed), dict[str, str]()
    rows = re.sub(r"\n\s+", " ", FAULTS).strip().splitlines()
    if seed % 2:  # in any line of a scenario
        kind, wrong, words = "line", *_in_a_line(random)
    else:
        kind, *parts = (part.strip() for part in rows[seed // 2 % len(rows)].split(">>"))
        old, new, words = (part.replace("\\n", "\n") for part in parts)
        text, names = BASES[kind]
        assert old in text or kind == "call", old
        known = {name: _word(random) for name in names.split()}
        known |= {f"~{name}": _misspelt(word, random) for name, word in known.items()}
        both = (old, new) if kind == "call" else (text, text.replace(old, new, 1))
        chosen = int(random.integers(99))
        right, wrong, words = (_told(part, known, chosen) for part in (*both, words))
        _run(kind, right, known, folder)
    begun = time.process_time()
    try:
        made = _run(kind, wrong, known, folder)
    except MbdlftError as error:
        message = str(error)
    else:
        raise AssertionError(f"no error about {words}: {made}\n{wrong}")
    assert time.process_time() - begun < PROCESS_SECONDS
    check_message(MbdlftError(message))
    missing = [w for w in (word.replace("_:", " ") for word in words.split()) if w not in message]
    assert not missing, f"no {', '.join(missing)} in: {message}\n{wrong}"
    assert "this is a bug" not in message, message
    if numbers := re.search(r"(?:two slopes by \S+|jumps from) (\S+) (?:and|to) (\S+)", message):
        assert numbers[1] != numbers[2], message
    return f"told, {kind}"


def _in_a_line(random: np.random.Generator) -> tuple[str, str]:
    """A scenario with a fault in one line, and words of the message: of the item, and of the fault."""
    names = sorted(path for path in ROOT.glob("*.toml") if "-scene/1" in path.read_text("utf-8"))
    lines = names[random.integers(len(names))].read_text("utf-8").split("\n")
    item, places = "", list[tuple[int, str, str, str]]()
    for place, line in enumerate(lines):
        if header := re.match(r"\[(?:\w+)(?:\.([\w-]+))?\]", line):
            item = header[1] or ""
        elif (entry := re.match(r"(\w+) *= (.*[^\[ ]) *$", line)) and (item or entry[1] == "format"):
            places.append((place, item, entry[1], entry[2]))
    place, item, key, value = places[random.integers(len(places))]
    texts = [*re.finditer(r"[A-Za-z]\w{3,}", value)] if value[0] in '"[' else []
    match int(random.integers(5)):
        case 0 if len(key) > 3:
            new = _misspelt(key, random)
            lines[place], fault = f"{new} = {value}", new
        case 1 if texts:
            word = texts[random.integers(len(texts))]
            fault = _misspelt(word[0], random)
            lines[place] = f"{key} = {value[: word.start()]}{fault}{value[word.end() :]}"
        case 2 if re.fullmatch(r"-?[\d.e-]+", value):
            lines[place], fault = f"{key} = nan", key
        case 3:
            lines[place], fault = f"{lines[place]}\nspare = 1.0", "spare"
        case _:
            lines[place], fault = f"{key} = {{ a = 1 }}", "a" if key in ("factors", "strands") else key
    return "\n".join(lines), f"{item} {fault}"


def _told(text: str, known: dict[str, str], chosen: int) -> str:
    """A text with its names, and one of the alternatives, the same in each of a case."""
    text = re.sub(r"<([^<>]*\|[^<>]*)>", lambda m: m[1].split("|")[chosen % len(m[1].split("|"))], text)
    return re.sub(r"~?\b[A-Za-z_]\w*\b", lambda m: known.get(m[0], m[0]), text)


def _word(random: np.random.Generator) -> str:
    letters = ["bdfgklmnprst"[i] + "aeiou"[j] for i, j in random.integers(0, (12, 5), (4, 2))]
    return "".join(letters) + str(random.integers(10))


def _misspelt(word: str, random: np.random.Generator) -> str:
    """A letter is missing, doubled, another one, or exchanged with the next."""
    k = int(random.integers(1, len(word) - 2))
    a, b, rest = word[k], word[k + 1], word[k + 2 :]
    other = "z" if a == "x" else "x"
    changes = (b, a + a + b, other + b, b + a if a != b else other + a)
    return word[:k] + changes[random.integers(4)] + rest


def _run(kind: str, text: str, known: dict[str, str], folder: Path) -> Any:
    """What is made of a text."""
    if kind in ("arm", "bar", "line"):
        return to_lft(mbdlft.scene_from_toml(text), search=0.0)
    if kind == "call":
        scene = mbdlft.scene_from_toml(_told(BASES["arm"][0], known, 0))
        model = to_lft(scene, search=0.0, prove=0.0)
        return eval(text, {"mbdlft": mbdlft, "model": model, "scene": scene, "folder": folder})
    units = _UNITS if kind == "dae" else dict.fromkeys(("mass", "stiff"), "1")
    parameters = [mbdlft.Parameter(known[p], 2.0, low=0.5, high=3.0, unit=u) for p, u in units.items()]
    if kind == "matrix":
        matrix = [row.split(", ") for row in text.split("; ")]
        return mbdlft.realize([[e.strip() for e in row] for row in matrix], parameters, search=0.0)
    variables, *equations, inputs, outputs = (part.strip() for part in text.split("|"))
    dae = dae_of("it", variables, *equations, inputs=inputs, outputs=outputs, parameters=parameters)
    return mbdlft.linearize_dae(dae, search=0.0)
