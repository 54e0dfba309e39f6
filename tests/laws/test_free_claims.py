"""What a certificate says of accelerations and free structures is refused if matrices contradict it."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mbdlft
from mbdlft import ArchiveError, StructureError
from mbdlft.pipeline import stages
from mbdlft.pipeline.models import build
from mbdlft.pipeline.stages import DROPPED
from tests import kit
from tests.archive import models
from tests.archive.plain_digest import edit, made
from tests.attack.frames import scene_of, structure
from tests.close import RESPONSE, target
from tests.laws.test_responses import pushed, sprung
from tests.strategies import random_scene

FALSE: list[tuple[dict[str, Any], str]] = [
    (
        {"accelerations": (0, 1, 3)},
        "accelerations, driven, beside: to_a.position is a sum of accelerations, and",
    ),
    ({"driven": ()}, "accelerations, beside: to_b.acceleration is a sum of accelerations, by "),
    ({"driven": (2, 4)}, "driven: to_a.velocity is none of a structure, and"),
    ({"beside": (0, 4)}, "beside: "),
    ({"momenta": (1, 1)}, "momenta, beside: push.force leaves all momenta, and"),
    (
        {"momenta": (2, 0), "rigid_motions": (-2, 2, 2, 2)},
        "momenta, rigid_motions, beside: there are 2 motions as a rigid body, and",
    ),
    (
        {"rigid_motions": (1, 1, 1, 1)},
        "rigid_motions, beside: to_a.position sees no motion as a rigid body, and",
    ),
    (
        {"unmoved": ((0, 1), (2, 1), (3, 1))},
        "unmoved, beside: to_a.position feels nothing of the rigid motion by push.force, and",
    ),
    (
        {"unmoved": ((1, 1), (2, 1), (3, 1))},
        "unmoved, accelerations, driven: to_a.acceleration feels nothing of the rigid motion",
    ),
    ({"momenta": (), "rigid_motions": ()}, "unmoved: there are motions as a rigid body, and"),
]


@pytest.mark.parametrize(("fields", "said"), FALSE, ids=[said for _, said in FALSE])
def test_what_is_false_is_refused(tmp_path: Path, fields: dict[str, Any], said: str) -> None:
    model, file = models.free(), tmp_path / "a.h5"
    with pytest.raises(StructureError, match=re.escape(said)):
        replace(model, certificate=replace(model.certificate, **fields))
    mbdlft.save(file, model)

    def forge(group: Any) -> None:
        for name, value in fields.items():
            del group[f"certificate/{name}"]
            if value:
                made(f"certificate/{name}", data=np.array(value, "<i8"))(group)

    edit(file, forge, f"models/{model.name}")
    with pytest.raises(
        ArchiveError, match=re.escape(f"a.h5: model '{model.name}' is not as specified: ")
    ) as caught:
        mbdlft.load(file)
    assert said in str(caught.value)


def test_what_is_taken_out_loses_digits_only() -> None:
    model, omega = models.free(), np.array([0.3, 3.0, 30.0])
    expected = mbdlft.frequency_response(model, {}, omega)
    for fields in (
        {"accelerations": (1,)},
        {"momenta": (0, 0)},
        {"rigid_motions": (-1,) * 4},
        {"unmoved": ()},
    ):
        less = replace(model, certificate=replace(model.certificate, **fields))
        target(mbdlft.frequency_response(less, {}, omega) / expected, np.ones(expected.shape), RESPONSE)


def test_what_is_true_at_nominal_alone_is_refused() -> None:
    """A spring to the ground, of no stiffness at nominal, sees the motion as a rigid body."""
    own = [mbdlft.Parameter("k", 0.0, low=-1.0, high=1.0), mbdlft.Parameter("c", 2.0, percent=10)]
    rows = "0 0 1 0 0; 0 0 0 1 0; -c-k c -0.1 0.1 1; c -c 0.1 -0.1 -1; 1 -1 0 0 0"
    model = kit.plant(rows, own, 4, "f", "x")
    for fields in ({"momenta": (1,)}, {"rigid_motions": (1,)}):
        with pytest.raises(StructureError, match="there are 1 motions as a rigid body"):
            replace(model, certificate=replace(model.certificate, **fields))


def test_what_is_felt_is_told_from_rounding_beside_stiff_springs() -> None:
    model = mbdlft.to_lft(pushed(sprung(), "position.x", "to_one.rate"), search=0.0)
    for i in range(2):
        with pytest.raises(
            StructureError, match=r"unmoved: .* feels nothing of the rigid motion by push.force"
        ):
            replace(model, certificate=replace(model.certificate, unmoved=((i, 0),)))


def test_what_is_zero_is_zero_after_a_search() -> None:
    """Doubles leave 1e-17 beside 1 where a search ends: three beams, which bend in different planes."""
    scene = scene_of(structure(880015)).model_copy(update={"spin": None})
    model = mbdlft.to_lft(scene)
    assert (model.order, model.certificate.accelerations) == (21, (0,))
    A = mbdlft.matrices_at(model, {"h": 2.1}).A
    assert np.count_nonzero(A) == 6, A


def test_a_result_whose_doubles_lose_what_is_zero_is_another_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A planted contradiction: the same LFT in coordinates that keep what is zero comes next."""
    made, said = list[mbdlft.LFT](), list[str]()

    def contradicted_once(**fields: Any) -> mbdlft.LFTModel:
        made.append(fields["lft"])
        if len(made) == 1:
            raise StructureError("certificate: something is left of what is zero.")
        return mbdlft.LFTModel(**fields)

    monkeypatch.setattr(stages, "LFTModel", contradicted_once)
    assert build(random_scene(72), search=1.0, progress=said.append).model.order == 10
    assert [lft.order for lft in made] == [10, 10]
    assert np.count_nonzero(made[1].M11) < np.count_nonzero(made[0].M11)
    assert [stage for stage in said if stage.startswith(f"{DROPPED} (order 10: ")]
