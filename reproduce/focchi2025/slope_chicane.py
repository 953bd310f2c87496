"""Section 8.3: the chicane F (53) in closed loop on uneven ground, figures 22 and 23.

Both controllers take the pose error in the vehicle's plane, F (49) with the yaw counted once. The
slippage-aware one has slip of level ground ("flat") or over the direction of gravity ("slope").
c_0 = [15, 2, -2.9] m is read as a place and a heading: the mesh has no height of -2.9 m. mu = 0.6,
0.6 m/s and 0.4 rad/s; control at 200 Hz. As (53) prints it the speed reaches 1.2 m/s, 14 rad/s of
the sprockets; the sweeps for this friction in the authors' code go to 18 rad/s, which is the limit
here.

Reference: [1] Focchi et al. (2025), sections 5.3 and 8.3.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from baselines.estimators.sensor_samples import DataSheet
from baselines.lyapunov.slippage_aware import SlippageAwarePolicy, UnicyclePolicy
from baselines.slip.slip_sweep import identified_slip
from reproduce.focchi2025 import chicane
from reproduce.focchi2025.load_models import DURATION, FRICTION, HEIGHT, LOADS
from reproduce.focchi2025.loop import follow
from reproduce.focchi2025.runs import LENGTHS, Floats, Run, vehicle
from reproduce.focchi2025.uneven_ground import UnevenGround
from tracked_env import TERRAIN
from tracked_env.observation import make_layout
from tracked_env.physics.attitude import in_body_plane
from tracked_env.physics.parameters import PlantParameters
from tracked_env.plants.terrain_rig import TerrainRig
from tracked_env.references import ReferenceProfile
from tracked_env.sensors import PRESETS

SPEED, TURN, RATE = 0.6, 0.4, 200.0  # [m/s], [rad/s], [Hz]
HEADINGS = (-2.9, 0.0)  # [rad] c_0, and that of the authors' code
SPROCKET_LIMIT = 18.0  # [rad/s]
KINDS = ("uc", "flat", "slope")
