"""Flat texts of the Modelica scenarios and of the models of `components.mo`, and their tables."""

from pathlib import Path

from mbdlft.dae.dae import Dae
from mbdlft.modelica import ModelicaReport, ModelicaTable, load_modelica, load_modelica_table

ROOT = Path(__file__).parents[2]
FLAT = Path(__file__).parent / "flat"
LIBRARY = Path(__file__).parent / "components.mo"
SCENARIOS = sorted((ROOT / "scenarios" / "modelica").glob("*.mo"))
MODELS = {  # of the library, by the names of their flat texts
    "first": "First",
    "oscillator": "Oscillator",
    "accelerate": "Accelerate",
    "cauer_low_pass": "CauerLowPass",
    "chua_circuit": "ChuaCircuit",
    "two_masses": "TwoMasses",
    "machine_start": "MachineStart",
    "pendulum": "Pendulum",
}


def table_of(name: str) -> ModelicaTable:
    """The table beside a scenario, or an empty one."""
    file = ROOT / "scenarios" / "modelica" / f"{name}.toml"
    return load_modelica_table(file) if file.exists() else ModelicaTable()


def flat(name: str) -> tuple[Dae, ModelicaReport, ModelicaTable]:
    """The description of a flat text, its report and its table."""
    table = table_of(name)
    return *load_modelica(FLAT / f"{name}.mof", table), table
