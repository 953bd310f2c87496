"""What the tests of the torque plant share: its functions with limits, and random cases."""

import math

import numpy as np

from tracked_env.physics import lumped
from tracked_env.physics.lumped import Motion
from tracked_env.physics.parameters import SoilParameters, plant_parameters

CLAY = plant_parameters()
SANDY_LOAM = SoilParameters(cohesion=9.65e3, friction_angle=math.radians(35.0))
LATERAL_MODELS = ["sliding", "constrained"]
REST = Motion(0.0, 0.0, 0.0)
VARIED = {"mass": (500.0, 3000.0), "inertia": (300.0, 3000.0), "cohesion": (0.0, 70e3)}
VARIED |= {"friction_angle": (0.2, 0.7), "shear_deformation_modulus": (0.005, 0.1)}
VARIED |= {"longitudinal_resistance": (0.0, 1.0), "lateral_resistance": (0.1, 1.2)}


def model(lateral_model, p):
    """(loads, accelerations) as functions of motion and torques, traction limits included."""
    constrained = lateral_model == "constrained"
    k, drive = lumped.coefficients(p, constrained), lumped.drive_limits(p)
    loads = lumped.constrained_loads if constrained else lumped.sliding_loads
    rates = lumped.constrained_accelerations if constrained else lumped.sliding_accelerations

    def limited(formula):
        def evaluate(motion, left, right):
            limits = lumped.traction_limits(motion, k.half_gauge, drive)
            return formula(motion, left, right, k, limits)

        return evaluate

    return limited(loads), limited(rates)


def random_cases(lateral_model, count=400, seed=5):
    """Random parameters, motions and torques: (p, motion, torque left, torque right)."""
    draws = np.random.default_rng(seed)
    for _ in range(count):
        p = CLAY._replace(**{name: draws.uniform(*ends) for name, ends in VARIED.items()})
        p = p._replace(turning_resistance_factor=draws.choice([1.0, 2.0]))
        p = p._replace(icr_forward=draws.uniform(-0.5, 0.5))
        scale = 10.0 ** draws.uniform(-3.0, 0.7)
        v_x, v_y, yaw_rate = (float(v) for v in scale * draws.uniform(-1.0, 1.0, 3))
        v_y = -p.icr_forward * yaw_rate if lateral_model == "constrained" else v_y
        left, right = (float(t) for t in draws.uniform(-8e3, 8e3, 2))
        yield p, Motion(v_x, v_y, yaw_rate), left, right
