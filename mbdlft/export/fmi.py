"""Functional mock-up units: models for Simulink, OpenModelica, Dymola and others, with their parameters.

A unit (FMI 3.0 or 2.0) is an archive of ``modelDescription.xml``, the C of `mbdlft.export.c` with the
functions of FMI around it, and this C compiled for the machine that writes it. It is for model exchange
and for co-simulation. Its variables, all of them deviations from the equilibrium but the first and the
last kind:

    parameter.NAME   may be set at any time; range, nominal value and unit are those of the model
    input.NAME, state.NAME, der(state.NAME), output.NAME
    trim.NAME        what holds the equilibrium at the parameters

Source: FMI Specification 3.0.2 and 2.0.5 (Modelica Association).
"""

import hashlib
import os
import platform
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree as ET
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

from mbdlft.base.errors import SceneError, StructureError
from mbdlft.base.unit import BASE, parse_unit
from mbdlft.export.c import c_texts
from mbdlft.export.names import filled, identifier, one_line, prefix
from mbdlft.system.model import LFTModel, System

VERSIONS = (3, 2)
_COMPILE = ("-std=c99", "-O1", "-fPIC", "-shared", "-fvisibility=hidden")
_SYSTEM = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib")}
_MACHINE = {"x86_64": "x86_64", "AMD64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


class _Variable(NamedTuple):
    """A variable of the description; its number is its value reference."""

    name: str
    unit: str
    causality: str
    variability: str
    initial: str | None = None  # None: that of the causality
    start: float | None = None
    low: float | None = None
    high: float | None = None


def fmu_image(model: System, stem: str, version: int) -> bytes:
    """The unit of a model as bytes; `stem` names its source."""
    if version not in VERSIONS:
        raise StructureError(f"FMI {version!r} is unknown; 3 and 2 are written.")
    name, source = prefix(model.name), identifier(stem)
    text, header = c_texts(model, source)
    variables = [v._replace(name=one_line(v.name)) for v in _variables(model)]
    twice = [name for name, count in Counter(v.name for v in variables).items() if count > 1]
    if twice:
        raise StructureError(f"two signals would be named {twice[0]!r}. Rename one of them.")
    token = hashlib.sha256(f"{version}\n{text}\n{variables}".encode()).hexdigest()
    token = f"{{{token[:8]}-{token[8:12]}-{token[12:16]}-{token[16:20]}-{token[20:32]}}}"
    sizes = {"np": len(model.parameters), "nx": len(model.states), "nu": len(model.inputs)}
    trimmed = sum(v.causality == "calculatedParameter" for v in variables)
    entries = {**sizes, "ny": len(model.outputs), "nt": trimmed, "token": token, "fmi": version}
    unit = filled("fmu.c", {**entries, "name": name, "stem": source})
    sources = {f"{source}.c": text, f"{source}.h": header, "fmu.c": unit}
    files = {"modelDescription.xml": _description(model, name, token, variables, version)}
    files |= {f"sources/{file}": content.encode() for file, content in sources.items()}
    if version == 3:
        files["sources/buildDescription.xml"] = _build(name)
    folder, ending = _place(version)
    files[f"binaries/{folder}/{name}{ending}"] = _compiled(sources)
    stream = BytesIO()
    with ZipFile(stream, "w", ZIP_DEFLATED) as archive:
        for file, image in files.items():  # the date is always the same, and so is the archive
            archive.writestr(ZipInfo(file), image, ZIP_DEFLATED)
    return stream.getvalue()


def _variables(model: System) -> Iterator[_Variable]:
    """All variables, in the order of their numbers."""
    yield _Variable("time", "s", "independent", "continuous")
    for p in model.parameters:
        value = (p.nominal, p.low, p.high)
        yield _Variable(f"parameter.{p.name}", p.unit, "parameter", "tunable", "exact", *value)
    for s in model.inputs:
        yield _Variable(f"input.{s.name}", s.unit, "input", "continuous", None, 0.0)
    for s in model.states:
        yield _Variable(f"state.{s.name}", s.unit, "local", "continuous", "exact", 0.0)
    for s in model.states:
        rate = "1/s" if s.unit == "1" else f"{s.unit}/s"
        yield _Variable(f"der(state.{s.name})", rate, "local", "continuous", "calculated")
    for s in model.outputs:
        yield _Variable(f"output.{s.name}", s.unit, "output", "continuous", "calculated")
    for s in model.trim.signals if isinstance(model, LFTModel) and model.trim.lft is not None else ():
        yield _Variable(f"trim.{s.name}", s.unit, "calculatedParameter", "tunable", "calculated")


def _description(model: System, name: str, token: str, variables: list[_Variable], version: int) -> bytes:
    """modelDescription.xml."""
    head = {"fmiVersion": "3.0" if version == 3 else "2.0", "modelName": model.name}
    head["instantiationToken" if version == 3 else "guid"] = token
    if model.description:
        head["description"] = model.description
    head |= {"generationTool": "mbdlft", "variableNamingConvention": "flat"}
    root = ET.Element("fmiModelDescription", head)
    can = (
        ("GetAndSetFMUState", "SerializeFMUState")
        if version == 3
        else ("GetAndSetFMUstate", "SerializeFMUstate")
    )
    what = {"modelIdentifier": name, **{f"can{each}": "true" for each in can}}
    derivatives = (
        ["providesDirectionalDerivatives", "providesAdjointDerivatives"]
        if version == 3
        else ["providesDirectionalDerivative"]
    )
    what |= dict.fromkeys(derivatives, "true")
    for kind in ("ModelExchange", "CoSimulation"):
        interface = ET.SubElement(root, kind, what)
        if kind == "CoSimulation":
            interface.set("canHandleVariableCommunicationStepSize", "true")
        if version == 2:
            files = ET.SubElement(interface, "SourceFiles")
            ET.SubElement(files, "File", name="fmu.c")
    units = ET.SubElement(root, "UnitDefinitions")
    for unit in dict.fromkeys(v.unit for v in variables):
        _define(ET.SubElement(units, "Unit", name=unit), unit)
    listed = ET.SubElement(root, "ModelVariables")
    rates = 1 + len(model.parameters) + len(model.inputs) + len(model.states)
    for k, v in enumerate(variables):
        attributes = {"name": v.name, "valueReference": str(k), "causality": v.causality}
        attributes["variability"] = v.variability
        if v.initial is not None:
            attributes["initial"] = v.initial
        numbers = {"min": v.low, "max": v.high, "start": v.start}
        real = {"unit": v.unit, **{key: repr(x) for key, x in numbers.items() if x is not None}}
        if rates <= k < rates + len(model.states):
            state = k - len(model.states)  # version 2 counts from 1
            real["derivative"] = str(state if version == 3 else state + 1)
        if version == 3:
            ET.SubElement(listed, "Float64", {**attributes, **real})
        else:
            ET.SubElement(ET.SubElement(listed, "ScalarVariable", attributes), "Real", real)
    _structure(ET.SubElement(root, "ModelStructure"), variables, rates, len(model.states), version)
    ET.indent(root)
    return _bytes_of(root)


def _structure(
    structure: ET.Element, variables: list[_Variable], rates: int, states: int, version: int
) -> None:
    """What is computed: outputs, derivatives of states, and all that is so at the start."""
    outputs = [k for k, v in enumerate(variables) if v.causality == "output"]
    derivatives = list(range(rates, rates + states))
    start = [k for k, v in enumerate(variables) if v.initial == "calculated"]
    names = ("Output", "ContinuousStateDerivative", "InitialUnknown")
    for name, group, numbers in zip(
        names, ("Outputs", "Derivatives", "InitialUnknowns"), (outputs, derivatives, start), strict=True
    ):
        if version == 2 and not numbers:
            continue
        parent = structure if version == 3 else ET.SubElement(structure, group)
        for k in numbers:
            if version == 3:
                ET.SubElement(parent, name, valueReference=str(k))
            else:
                ET.SubElement(parent, "Unknown", index=str(k + 1))


def _define(element: ET.Element, text: str) -> None:
    """A unit by powers of kg, m, s, A and K; one that is no product of them is a name only."""
    try:
        unit = parse_unit(text)
    except SceneError:
        return
    powers = {base: str(power) for base, power in zip(BASE, unit.dimension, strict=True) if power}
    ET.SubElement(element, "BaseUnit", {**powers, "factor": repr(unit.factor)})


def _build(name: str) -> bytes:
    """How the source of a unit of FMI 3.0 is compiled."""
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=name)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    ET.SubElement(files, "SourceFile", name="fmu.c")
    return _bytes_of(root)


def _bytes_of(root: ET.Element) -> bytes:
    """The text of a tree, without letters that XML does not allow."""
    for element in root.iter():
        element.attrib.update({key: one_line(text) for key, text in element.attrib.items()})
    return bytes(ET.tostring(root, encoding="utf-8", xml_declaration=True))


def _place(version: int) -> tuple[str, str]:
    """The folder of the binary of this machine, and the ending of its name."""
    known, machine = _SYSTEM.get(sys.platform), _MACHINE.get(platform.machine())
    if known is None or machine is None:
        raise StructureError(
            f"a unit (.fmu) is compiled on Linux or macOS; this is {sys.platform} on "
            f"{platform.machine()}. Export the model as .c, and compile it by hand."
        )
    system, ending = known
    short = version == 2 and machine == "x86_64"
    return (f"{system}64" if short else f"{machine}-{system}"), ending


def _compiled(sources: dict[str, str]) -> bytes:
    """The shared library of the sources, by the compiler `cc` or the one that CC names."""
    compiler, options = os.environ.get("CC", "cc"), os.environ.get("CFLAGS", "").split()
    with tempfile.TemporaryDirectory() as folder:
        for name, text in sources.items():
            (Path(folder) / name).write_text(text, encoding="utf-8")
        try:
            subprocess.run(
                [*compiler.split(), *_COMPILE, *options, "fmu.c", "-o", "unit", "-lm"],
                cwd=folder, check=True, capture_output=True, text=True,
            )  # fmt: skip
        except (OSError, subprocess.CalledProcessError) as error:
            said = (getattr(error, "stderr", None) or str(error)).strip().splitlines()
            raise StructureError(
                f"the C compiler {compiler!r} failed: {said[0] if said else 'no message'}. "
                "Install one (Debian: gcc), or name it in CC of the environment (CFLAGS has options); "
                ".c needs none."
            ) from error
        return (Path(folder) / "unit").read_bytes()
