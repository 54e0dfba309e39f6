"""Reading needs h5py and numpy only: everything else is blocked."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from mbdlft import matrices_at, save
from tests.archive import models
from tests.close import exact

ROOT = Path(__file__).parents[2]
BLOCKED = (
    "casadi",
    "control",
    "matplotlib",
    "pydantic",
    "rich",
    "scipy",
    "threadpoolctl",
    "tomli_w",
    "typer",
)
PROGRAM = """
import json, sys

class Block:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in sys.argv[2].split(","):
            raise ImportError(f"{name} is blocked")

sys.meta_path.insert(0, Block())
import mbdlft

model = mbdlft.load(sys.argv[1])
matrices = mbdlft.matrices_at(model, {"m1": 2.6, "theta1": 50.0})
mbdlft.save(sys.argv[1] + ".copy", model)
response = mbdlft.frequency_response(model, mbdlft.random(model.parameters, 3), [1.0, 2.0])
print(json.dumps({"matrices": [m.tolist() for m in matrices], "shape": response.shape}))
for name in sys.argv[2].split(","):
    try:
        __import__(name)
    except ImportError as error:
        assert str(error) == f"{name} is blocked"
    else:
        raise AssertionError(name)
"""


def run(file, *blocked):
    return subprocess.run(
        [sys.executable, "-W", "error", "-c", PROGRAM, str(file), ",".join(blocked)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )


def test_reading_with_everything_else_blocked(tmp_path):
    file = tmp_path / "a.h5"
    save(file, models.arm())
    done = run(file, *BLOCKED)
    assert done.stderr == ""
    answer = json.loads(done.stdout)
    for found, wanted in zip(
        answer["matrices"], matrices_at(models.arm(), {"m1": 2.6, "theta1": 50.0}), strict=True
    ):
        exact(np.array(found), wanted)
    assert answer["shape"] == [3, 2, 2, 2]
    assert (tmp_path / "a.h5.copy").read_bytes() == file.read_bytes()


@pytest.mark.parametrize("needed", ["h5py", "numpy"])
def test_block_works(tmp_path, needed):
    save(tmp_path / "a.h5", models.arm())
    done = run(tmp_path / "a.h5", needed)
    assert done.returncode == 1
    assert f"ImportError: {needed} is blocked" in done.stderr
