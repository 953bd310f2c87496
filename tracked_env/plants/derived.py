"""What the tracked plants derive from their parameters, and the columns that hold it."""

from tracked_env.engine import columns as b
from tracked_env.physics import vehicle
from tracked_env.physics.jit import formula
from tracked_env.physics.parameters import row_parameters
from tracked_env.physics.vehicle import Coefficients, DriveLimits

RESISTANCE = b.COEFFICIENTS + Coefficients._fields.index("resistance")
REST = 1e-12  # [m/s, rad/s] slower is rest: decaying velocities would end as slow denormals


@formula
def derive(floats, i, substep, constrained):
    """Refresh what follows from the parameters of vehicle i; substep h [s]."""
    p = row_parameters(floats, i, b.PARAMETERS)
    k = vehicle.coefficients(p, constrained)
    drive = vehicle.drive_limits(p)
    for row in range(b.COEFFICIENT_COUNT):
        floats[i, b.COEFFICIENTS + row] = k[row]
    for row in range(b.DRIVE_COUNT):
        floats[i, b.DRIVE + row] = drive[row]
    floats[i, b.TORQUE_DECAY] = vehicle.torque_decay(0.5 * substep, p.drive_time_constant)


@formula
def derive_free(floats, i, substep):
    """The same where nothing constrains the lateral motion."""
    derive(floats, i, substep, False)


@formula
def derived(floats, i):
    """Coefficients and drive limits of vehicle i."""
    f, c, d = floats, b.COEFFICIENTS, b.DRIVE
    k = Coefficients(
        f[i, c], f[i, c + 1], f[i, c + 2], f[i, c + 3], f[i, c + 4],
        f[i, c + 5], f[i, c + 6], f[i, c + 7], f[i, c + 8],
    )  # fmt: skip
    return k, DriveLimits(f[i, d], f[i, d + 1], f[i, d + 2], f[i, d + 3])
