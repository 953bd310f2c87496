"""The eye behind the vehicle: where it stands, and the projection of its picture.

It looks along a heading that follows the vehicle's yaw with a lag, so that the picture turns
smoothly. It stands behind and above the vehicle, and higher where the ground between the two
would hide the vehicle. The horizon moves in the picture and the vehicle stays at one row.
A standing eye keeps its place until the vehicle is out of the middle, too far, too close or behind
a hill: the ground is then drawn once for many pictures.
"""

import math

import numpy as np

from tracked_env.rendering.landscape import VIEW, Landscape
from tracked_env.rendering.raster import Eye, project
from tracked_env.rendering.terrain_source import BodyPose

# In contact lengths:
BEHIND, ABOVE = 3.7, 1.9  # from the vehicle to the eye
FREE = 0.45  # least height of the line of sight above the ground
NEAR = 0.4  # nothing closer is drawn
LAG = 0.6  # [s] time constant of the heading
FIELD = math.radians(54.0)  # [rad] horizontal angle of view
VEHICLE_ROW = 0.57  # [-] of the picture's height
SAMPLES = 24  # [-] of the line of sight
# Of a standing eye: distances ahead [contact lengths] and parts of the picture where the vehicle
# may be.
CLOSEST, FARTHEST = 2.2, 7.0
MIDDLE = 0.12, 0.88  # [-] of the width
UPRIGHT = 0.10, 0.86  # [-] of the height


class ChaseCamera:
    """The eye of one episode."""

    def __init__(self, yaw: float, time: float) -> None:
        """Start behind a vehicle with that yaw [rad] at that time [s]."""
        self._yaw, self._time = yaw, time

    def follow(self, yaw: float, time: float) -> None:
        """Turn towards the yaw [rad] of the vehicle (not wrapped) at that time [s]."""
        elapsed, self._time = max(time - self._time, 0.0), time
        self._yaw += (yaw - self._yaw) * (1.0 - math.exp(-elapsed / LAG))

    def eye(self, pose: BodyPose, landscape: Landscape, width: int, height: int) -> Eye:
        """The eye for a picture of that size [px]."""
        length = landscape.length
        cosine, sine = math.cos(self._yaw), math.sin(self._yaw)
        x, y = pose.x - BEHIND * length * cosine, pose.y - BEHIND * length * sine
        z = pose.z + ABOVE * length
        share = np.linspace(0.0, 0.9, SAMPLES)  # from the eye to the vehicle
        line = np.stack([x + share * (pose.x - x), y + share * (pose.y - y)], axis=1)
        needed = landscape.heights(line) + FREE * length * (1.0 - share)
        z = max(z, float(np.max((needed - share * pose.z) / (1.0 - share))))
        focal = 0.5 * width / math.tan(0.5 * FIELD)
        row = VEHICLE_ROW * height - focal * (z - pose.z) / (BEHIND * length)
        return Eye(
            x, y, z, cosine, sine, focal, 0.5 * width, row, NEAR * length, VIEW * length
        )  # fmt: skip


class StandingCamera(ChaseCamera):
    """An eye that takes a new place behind the vehicle when it no longer sees it well."""

    def __init__(self, yaw: float, time: float) -> None:
        """Start behind a vehicle with that yaw [rad] at that time [s]."""
        super().__init__(yaw, time)
        self._eye: Eye | None = None

    def follow(self, yaw: float, time: float) -> None:
        """Note the yaw [rad] of the vehicle."""
        self._yaw = yaw

    def eye(self, pose: BodyPose, landscape: Landscape, width: int, height: int) -> Eye:
        """The eye for a picture of that size [px]; the one before where that still sees it."""
        if self._eye is None or not _sees(self._eye, pose, landscape, width, height):
            self._eye = super().eye(pose, landscape, width, height)
        return self._eye


def _sees(eye: Eye, pose: BodyPose, landscape: Landscape, width: int, height: int) -> bool:
    """Whether the vehicle is in the middle of the picture, at a good distance, and not hidden."""
    column, row, inverse = project(eye, np.array([pose.x, pose.y, pose.z])).tolist()
    if not inverse or not CLOSEST < 1.0 / (inverse * landscape.length) < FARTHEST:
        return False
    if not MIDDLE[0] * width < column < MIDDLE[1] * width:
        return False
    if not UPRIGHT[0] * height < row < UPRIGHT[1] * height:
        return False
    share = np.linspace(0.0, 0.9, SAMPLES)[:, None]
    line = np.array([eye.x, eye.y, eye.z]) + share * np.array(
        [pose.x - eye.x, pose.y - eye.y, pose.z - eye.z]
    )
    return bool((line[:, 2] > landscape.heights(line[:, :2])).all())
