"""What operations on models say of their results: errors and channels of all parts are counted."""

from dataclasses import replace

import numpy as np

from mbdlft import LFTModel, Parameter, invert_channels, low_pass, realize, series

K = Parameter("k", 40.0, low=30.0, high=60.0)
WRONG = 1e-3  # far above rounding


def with_error(model: LFTModel) -> LFTModel:
    return replace(model, certificate=replace(model.certificate, max_relative_error=WRONG))


def test_series_counts_channels_and_errors_of_both() -> None:
    plant = realize([["-k", "1"], ["1", "0"]], [K], states=1, inputs=["u"], outputs=["y"])
    filter_ = low_pass("0.1*k", parameters=[K])
    found = series(plant, "u", filter_).certificate
    raw = [np.sum(each.certificate.raw_order) for each in (plant, filter_)]
    assert min(raw) > 0
    assert np.sum(found.raw_order) == np.sum(raw)
    for parts in ((with_error(plant), filter_), (plant, with_error(filter_))):
        assert series(parts[0], "u", parts[1]).certificate.max_relative_error >= WRONG


def test_inversion_keeps_the_error_of_the_model() -> None:
    model = realize([["k", "1"], ["2", "3 + k"]], [K], inputs=["a.u", "b.u"], outputs=["a.y", "b.y"])
    found = invert_channels(with_error(model), ["a"]).certificate
    assert found.max_relative_error >= WRONG
