"""What frames that are mapped one by one must have before a forecaster sees them."""

import numpy as np
import pytest

from envpred.datamodules import Needs
from envpred.datamodules.seen import seen_of
from envpred.datamodules.variants import variant
from envpred.errors import UserError
from envpred.mapping.geometry import GridSpec
from envpred.mapping.mapper import Mapper, MappingParameters
from envpred.models import LastFrame


def test_what_the_mapper_does_not_make_is_named() -> None:
    mapper = Mapper(MappingParameters(GridSpec(cells=16)))
    mapped = [mapper.step(np.ones((1, 4), np.float32), np.eye(4), 0.1 * k) for k in range(3)]
    assert LastFrame(given=3).see(mapper, mapped)["frames"].shape == (1, 3, 2, 16, 16)
    with pytest.raises(UserError, match="2 frames mapped, LastFrame sees 3; map more first"):
        LastFrame(given=3).see(mapper, mapped[1:])
    with pytest.raises(UserError, match=r"makes no velocity, velocity_cov; give Mapper\(velocities=\.\.\.\)"):
        seen_of(mapper, mapped, variant("dst_dogma"), Needs())
    with pytest.raises(UserError, match=r"maps no wide grid.*; give Mapper\(context=256\)"):
        seen_of(mapper, mapped, variant("dst_static"), Needs(context=True))
