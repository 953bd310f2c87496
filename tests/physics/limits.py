"""What the plants leave out, and how they differ in a turn: the figures of two pages.

    python -m tests.physics.limits      the tables of physics.md (Limits) and of distributed.md

The case is the vehicle of Strawa et al. (2021) on heavy clay at 3 m/s on a circle of 10 m. Measured
figures come from the plants; derived ones follow from the equation beside them; estimated ones rest
on numbers that no source gives for this vehicle and soil: `HEIGHT`, `BRAKING`, and `SINKAGE`, the
pressure-sinkage constants of dry sand (Wong, Theory of Ground Vehicles, table of terrain values).
"""

import math

import numpy as np
from scipy.optimize import brentq, root

from tracked_env.physics import patches_on_level_ground as level
from tracked_env.physics import terramechanics
from tracked_env.physics.level_motion import loads_of, rates_of
from tracked_env.physics.lumped import Motion, coefficients, drive_limits
from tracked_env.physics.parameters import plant_parameters
from tracked_env.physics.patches_on_level_ground import Belts
from tracked_env.uncertainty import SOILS

G = terramechanics.GRAVITY
SPEED, RADIUS = 3.0, 10.0  # [m/s], [m]
ASIDE = 0.1  # [m/s] lateral speed of a vehicle whose tracks are locked
SLOPE = math.radians(10.0)  # [rad]
HEIGHT = 0.5  # [m] of the centre of mass; assumed
BRAKING = 3.0  # [m/s^2]; assumed
SINKAGE = (1.1, 0.99e3, 1528.43e3)  # n [-], k_c [N/m^(n+1)], k_phi [N/m^(n+2)] of dry sand
VEHICLE = plant_parameters()
PATCHES = level.make_patches()  # the default of the environments
RADII = (7.0, 10.0, 20.0, 40.0, 100.0)  # [m] of the turns compared
TURN_SPEED = 2.0  # [m/s]
# 2 J / (r^2 m) [-]: inertia of both drives and tracks over the mass, straight on.
ROTATING_SHARE = 2.0 * VEHICLE.sprocket_inertia / (VEHICLE.sprocket_radius**2 * VEHICLE.mass)
TURN_SOILS = {"heavy_clay": 0.6, "sandy_loam": 0.15, "lete_sand": 0.15}  # and their mu_l [-]


def patch_loads(p, motion, belts, patches=PATCHES):
    """Loads of the distributed plant at a motion and belt speeds [m/s]."""
    k, drive = coefficients(p, False), drive_limits(p)
    w = np.empty((level.SCRATCH_ROWS, level.LANES))
    contact = level.contact_of(p, k, drive, patches)
    r = level.resistance(w, motion, belts, (contact, contact), patches)
    return loads_of(r, motion, belts, k, (k.resistance, k.resistance))


def locked_lateral_forces(p=VEHICLE):
    """|F_y| [N] at SPEED forward and ASIDE with locked tracks: lumped, isotropic, distributed."""
    intensity = coefficients(p, False).friction_intensity
    lumped, _ = terramechanics.lateral_friction(ASIDE, 0.0, intensity, p.contact_length)
    loads = patch_loads(p, Motion(SPEED, ASIDE, 0.0), Belts(0.0, 0.0))
    share = ASIDE / math.hypot(SPEED, ASIDE)
    return abs(lumped), share * p.lateral_resistance * p.mass * G, abs(loads.lateral_force)


def moment_left_by_shear(p=VEHICLE, radius=RADIUS):
    """Share [-] of the Coulomb turning moment that shear under way leaves, without longitudinal
    slip: j = (l^2/4 - x^2) / (2 R), M / M_C = 1 - (1 - exp(-a)) / a with a = l^2 / (8 R K)."""
    a = p.contact_length**2 / (8.0 * radius * p.shear_deformation_modulus)
    return 1.0 - (1.0 - math.exp(-a)) / a


def measured_moment_left_by_shear(p=VEHICLE, slip=0.0, radius=RADIUS):
    """The same on narrow patches, over the moment for K = 0.1 mm and no slip of the belts [-]."""
    narrow = p._replace(track_width=0.01, longitudinal_resistance=0.0)
    motion = Motion(SPEED, 0.0, SPEED / radius)

    def moment(p, slip):
        turn = 0.5 * p.track_gauge * motion.yaw_rate
        belts = Belts((SPEED - turn) / (1.0 - slip), (SPEED + turn) / (1.0 - slip))
        loads = patch_loads(p, motion, belts)
        thrust = 0.5 * p.track_gauge * (loads.effort_right - loads.effort_left)
        return thrust - loads.turning_moment  # what the lateral friction takes

    # The same force on the narrower track.
    narrow = narrow._replace(cohesion=p.cohesion * (p.track_width / narrow.track_width))
    rigid = narrow._replace(shear_deformation_modulus=1e-4)
    return moment(narrow, slip) / moment(rigid, 0.0)


def icr_of_load_transfer(p=VEHICLE, braking=BRAKING, height=HEIGHT):
    """x_ICR [m] on the circle when the pressure rises towards the front, by the moment m a h.

    The share C(x) of the weight behind x carries F_y = mu_t m g (2 C(x_ICR) - 1) = m v^2 / R, with
    C(x) = 1/2 + x/l + (6 x_p / l^3) (x^2 - l^2/4) and x_p = h a / g; x_p = 0 is the lumped plant.
    """
    length = p.contact_length
    carried = 0.5 * (1.0 + SPEED**2 / (RADIUS * p.lateral_resistance * G))
    bend = 6.0 * height * braking / G / length**3

    def gap(x):
        return 0.5 + x / length + bend * (x * x - 0.25 * length * length) - carried

    return brentq(gap, -0.5 * length, 0.5 * length)


def steady_turn(p, radius, speed=TURN_SPEED):
    """(turning moment [N m] that the tracks must provide, x_ICR [m]) of the distributed plant.

    Lateral velocity and belts without acceleration, followed from a wide circle inwards. Raises
    ValueError where the soil does not carry the turn.
    """
    k, drive = coefficients(p, False), drive_limits(p)
    still = Belts(0.0, 0.0)

    def state(z, at):
        turn = speed / at
        return Motion(speed, z[0] * turn, turn), Belts(speed + z[1], speed + z[2])

    def accelerations(z, at):
        motion, belts = state(z, at)
        return rates_of(patch_loads(p, motion, belts), motion, belts, still, k, drive, 0.0)[:3]

    z = np.array([0.1, 0.0, 0.1])  # [m] -x_ICR, [m/s] belts over the speed
    for at in np.geomspace(max(200.0, radius), radius, 20):
        z = root(accelerations, z, args=(at,), method="lm", tol=1e-14).x
    if np.abs(accelerations(z, radius)).max() > 1e-6:
        raise ValueError(f"no steady turn of radius {radius:g} m at {speed:g} m/s: soil too weak")
    loads = patch_loads(p, *state(z, radius))
    right = loads.effort_right - loads.resistance_right
    left = loads.effort_left - loads.resistance_left
    return 0.5 * p.track_gauge * (right - left), float(-z[0])


def lumped_moment(p, radius, speed=TURN_SPEED):
    """Turning moment [N m] of the lumped plant, `sliding`, in the same turn."""
    q, turn = coefficients(p, False).friction_intensity, speed / radius

    def missing(v_y):
        force, _ = terramechanics.lateral_friction(v_y, turn, q, p.contact_length)
        return force - p.mass * turn * speed

    v_y = brentq(missing, -20.0, 0.0)
    return -terramechanics.lateral_friction(v_y, turn, q, p.contact_length)[1]


def matching_resistance(p, radius):
    """The mu_t [-] with which the lumped plant needs the moment of the distributed one."""
    moment, _ = steady_turn(p, radius)
    least = 1.001 * TURN_SPEED**2 / (radius * G)  # below it the vehicle slides off the circle

    def gap(mu):
        return lumped_moment(p._replace(lateral_resistance=mu), radius) - moment

    return brentq(gap, least, 1e3)


def ground(soil, resistance):
    """The vehicle on a soil by name, with that motion resistance coefficient."""
    return plant_parameters(soil=SOILS[soil]._replace(longitudinal_resistance=resistance))


def limits_table():
    """The table of physics.md, as Markdown."""
    lumped, isotropic, patches = (1e-3 * force for force in locked_lateral_forces())
    left, left_measured = moment_left_by_shear(), measured_moment_left_by_shear()
    slipping = [100 * (measured_moment_left_by_shear(slip=i) - 1) for i in (0.02, 0.05)]
    icr, braked = icr_of_load_transfer(braking=0.0), icr_of_load_transfer()
    weight = 1e-3 * VEHICLE.mass * G * math.sin(SLOPE)
    exponent, k_c, k_phi = SINKAGE  # z [m] of p = (k_c / w + k_phi) z^n, p = m g / (2 w l)
    pressure = VEHICLE.mass * G / (2.0 * VEHICLE.track_width * VEHICLE.contact_length)
    sinkage = (pressure / (k_c / VEHICLE.track_width + k_phi)) ** (1.0 / exponent)
    power = 2e-3 * VEHICLE.torque_limit * VEHICLE.sprocket_speed_limit
    rows = (
        f"combined slip | locked tracks, {ASIDE:g} m/s aside: lateral force {lumped:.1f} kN; "
        f"isotropic friction {isotropic:.2f} kN | measured; derived | no | yes, {patches:.1f} kN",
        f"lateral shear builds up | turning moment {100 * (left - 1):.0f} % | derived | no | "
        f"yes, {100 * (left_measured - 1):.0f} % without slip, {slipping[0]:.0f} % at 2 %, "
        f"{slipping[1]:.0f} % at 5 % slip",
        f"slope of 10 deg | {weight:.1f} kN downhill | derived | no | no",
        f"power limit | up to {power:.0f} kW at full torque and top speed | derived | no | "
        "no; torque fades in the last tenth of the top speed",
        f"load transfer | x_ICR {icr:.2f} m, {braked:.2f} m when braking by {BRAKING:g} m/s^2 | "
        "estimated | no | no",
        f"rotating inertia | {100 * ROTATING_SHARE:.0f} % of the mass | derived | no | "
        "yes, driven by torque",
        f"sinkage | {100 * sinkage:.1f} cm on dry sand | estimated | no | no",
    )
    head = "effect | size | how known | lumped plant | distributed plant", "-- | -- | -- | -- | --"
    return "\n".join(f"| {row} |" for row in (*head, *rows))


def turns_table():
    """The table of distributed.md, as Markdown."""
    rows = [["soil", "mu_l", *(f"R = {radius:g} m" for radius in RADII)]]
    rows.append(["--"] * 2 + ["--:"] * len(RADII))
    for soil, resistance in TURN_SOILS.items():
        p = ground(soil, resistance)
        moments = [(steady_turn(p, radius)[0], matching_resistance(p, radius)) for radius in RADII]
        cells = [f"{1e-3 * moment:.1f} / {mu:.2f}" for moment, mu in moments]
        rows.append([f"`{soil}`", f"{resistance:g}", *cells])
    moments = [f"{1e-3 * lumped_moment(VEHICLE, radius):.1f} / 0.80" for radius in RADII]
    rows.append(["lumped plant, mu_t = 0.8", "any", *moments])
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


if __name__ == "__main__":
    print(limits_table(), turns_table(), sep="\n\n")
