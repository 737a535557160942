"""When a well's record is a build-up, and for how long it produced before."""

import pytest

from demflow.model.scene import Well
from demflow.sweep.figures.horner import production_time


@pytest.mark.parametrize(
    ("control", "expected"),
    [
        ({"schedule": ((0.0, 2.0), (30.0, 0.0))}, 30.0),
        ({"schedule": ((10.0, -2.0), (30.0, 0.0))}, 20.0),
        ({"schedule": ((0.0, 2.0), (30.0, 1.0))}, None),
        ({"schedule": ((0.0, 0.0), (30.0, 0.0))}, None),
        ({"schedule": ((0.0, 2.0), (30.0, 0.0), (40.0, 1.0))}, None),
        ({"rate": 1.0}, None),
        ({"pressure": 1.0}, None),
    ],
)
def test_one_rate_and_then_none_is_a_build_up(control, expected):
    well = Well(name="w", at=(0.0, 0.0), radius=0.1, **control)
    assert production_time(well) == expected
