"""The vehicle, and the time histories and errors of its runs: F (36), (37) and figure 13."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from baselines.slip.slip_sweep import slip_data
from tracked_env.physics.parameters import VEHICLES, PlantParameters

Floats = NDArray[np.float64]

LENGTHS = (0.5, 0.7)  # [m] contact length: nearest to figure 13, and Table 2
FRICTION = 0.1  # [-] mu of figures 6, 7, 9, 12 to 14
RESISTANCE = 0.025  # [-] c_r of Table 2
SLOWEST = 1e-3  # [m/s] a slower v_x has no alpha
BEGUN = 3.0  # [s] from here on errors count: the start is 5.8 cm off


def vehicle(
    length: float = LENGTHS[-1], friction: float = FRICTION, resistance: float = RESISTANCE
) -> PlantParameters:
    """Table 2 of F with a contact length [m], mu [-] and c_r [-]."""
    return VEHICLES["focchi"]._replace(
        contact_length=length,
        friction_angle=math.atan(friction),
        longitudinal_resistance=resistance,
    )


class Numbers(NamedTuple):
    """Errors after BEGUN, mean and standard deviation over the vehicles of a run."""

    largest: float  # [m] max Cartesian error
    largest_spread: float  # [m]
    rmse: float  # [m]
    heading: float  # [rad] max heading error

    @property
    def text(self) -> str:
        """The largest error in cm."""
        return f"{100.0 * self.largest:.2f} ± {100.0 * self.largest_spread:.2f}"


class Run(NamedTuple):
    """Time histories of N vehicles over T control steps, at the beginning of each step."""

    time: Floats  # (T,) [s]
    state: Floats  # (T, 6 or 9, N) x, y [m], yaw [rad], v_x, v_y [m/s], yaw rate [rad/s], and of
    # a plant that moves in space z [m], roll, pitch [rad]
    sprockets: Floats  # (T, 2, N) [rad/s] in force before that time, left and right
    reference: Floats  # (T, 3, N) x, y [m], yaw [rad]
    belief: dict[str, Floats]  # (T, N) estimates by name, empty when the policy has none

    @property
    def distance(self) -> Floats:
        """e_xy of F (37), (T, N) [m]."""
        apart = self.state[:, :2] - self.reference[:, :2]
        return np.asarray(np.hypot(apart[:, 0], apart[:, 1]))

    @property
    def heading(self) -> Floats:
        """e_phi of F (36), (T, N) [rad] in [-pi, pi)."""
        turned = self.state[:, 2] - self.reference[:, 2]
        return np.asarray((turned + math.pi) % (2.0 * math.pi) - math.pi)

    def numbers(self) -> Numbers:
        """Errors after BEGUN."""
        late = self.time >= BEGUN
        distance = self.distance[late]
        largest = distance.max(axis=0)
        return Numbers(
            float(largest.mean()),
            float(largest.std()),
            float(np.sqrt(np.mean(distance**2))),
            float(np.abs(self.heading[late]).max()),
        )

    def only(self, rows: slice) -> "Run":
        """Some of the vehicles."""
        return Run(
            self.time,
            self.state[:, :, rows],
            self.sprockets[:, :, rows],
            self.reference[:, :, rows],
            {name: values[:, rows] for name, values in self.belief.items()},
        )

    def slip(self, parameters: PlantParameters) -> tuple[Floats, Floats, Floats]:
        """Actual slip of the vehicles, (T, N): beta_left, beta_right [m/s] of F (31), alpha [rad]
        of (28), nan where |v_x| is below SLOWEST."""
        left, right = (self.sprockets[:, side].ravel() for side in range(2))
        motion = self.state[:, 3:6].transpose(0, 2, 1).reshape(-1, 3)
        found = slip_data(parameters, left, right, motion)
        alpha = np.where(np.abs(found.v_x) > SLOWEST, found.alpha, np.nan)
        shape = self.state[:, 0].shape
        return (
            found.beta_left.reshape(shape),
            found.beta_right.reshape(shape),
            alpha.reshape(shape),
        )
