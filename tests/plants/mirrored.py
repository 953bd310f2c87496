"""Two vehicles of which one is the mirror image of the other."""

import pytest

from tracked_env.physics.parameters import STATE_NAMES

ODD = ("y", "yaw", "v_y", "yaw_rate", "roll", "roll_rate", "acceleration_y", "yaw_acceleration")
# [rad/s^2] The yaw acceleration is a sum over 80 patches whose order is the compiler's: 600 N at
# 0.35 m over 4.5 kg m^2, 47 rad/s^2, times the rounding unit 1.1e-16 and the root of 80.
YAW_ACCELERATION = 4.7e-14
# [m/s^2] sums of 40 patches add in another order with the vector width of the processor:
ACCELERATION = 5e-14  # 40 eps / 2 times g


def assert_mirrored(rigs, allowed):
    """The states of two rigs are mirror images, within `allowed` in SI units."""
    for name in STATE_NAMES:
        if name.endswith(("_left", "_right")):
            continue
        one, other = (getattr(rig.state, name)[0] for rig in rigs)
        within = allowed
        if "acceleration" in name:
            within = YAW_ACCELERATION if name.startswith("yaw") else max(ACCELERATION, allowed)
        assert one == pytest.approx(-other if name in ODD else other, abs=within), name
