"""Runs of the plant on terrain: on a plane, and as `runs.json` of the reference data gives them."""

import math

import numpy as np

from tracked_env.physics.parameters import VEHICLES, plant_parameters
from tracked_env.plants.standalone import TerrainRig

SAMPLE = 0.01  # [s]
FOCCHI = VEHICLES["focchi"]._replace(longitudinal_resistance=0.0)
GRAVITY, MASS, HEIGHT, HALF_LENGTH, HALF_GAUGE, WIDTH = 9.81, 62.0, 0.25, 0.35, 0.303, 0.1
RADIUS = FOCCHI.sprocket_radius
STILL = [[0.0, 0.0]]
CENTRE = ("centre_of_mass_x", "centre_of_mass_y", "centre_of_mass_z")


def rig_with(
    shift=(0.0, 0.0, 0.0), slope=0.0, aside=False, mu=0.6, step=2e-3, factor=1.0, **options
):
    """A rig at rest on a plane of `slope` [rad], its centre of mass `shift` [m] away.

    aside: the plane rises to the left.
    """
    plane = {"kind": "plane", "slope_y" if aside else "slope_x": math.tan(slope)}
    at = dict(zip(CENTRE, shift, strict=True))
    soil = {"friction_angle": math.atan(mu), "ground_stiffness_factor": factor}
    return TerrainRig(FOCCHI._replace(**soil, **at), {"terrain": plane, **options}, step=step)


def parameters_of(spec):
    """Vehicle and soil of a run."""
    vehicle, soil = spec["vehicle"], spec["soil"]
    c_x, c_y, c_z = vehicle.get("shift", [0.0, 0.0, 0.0])
    return plant_parameters()._replace(
        mass=vehicle["m"], inertia=vehicle["inertia"][2], track_gauge=vehicle["track_gauge"],
        track_width=vehicle["track_width"], contact_length=vehicle["track_length"],
        sprocket_radius=vehicle["sprocket_radius"], drive_time_constant=0.0,
        cohesion=soil["cohesion_Pa"], friction_angle=float(np.arctan(soil["mu"])),
        shear_deformation_modulus=soil["shear_modulus_m"],
        longitudinal_resistance=soil["rolling_resistance"],
        centre_of_mass_x=c_x, centre_of_mass_y=c_y, centre_of_mass_z=c_z,
        ground_stiffness_factor=soil.get("stiffness_factor", 1.0),
    )  # fmt: skip


def terrain_of(given):
    """Terrain of a run: a, b, ramp, step and sines, those that it has."""
    parts = [{"kind": "plane", "slope_x": given.get("a", 0.0), "slope_y": given.get("b", 0.0)}]
    if "ramp" in given:
        slope, start, length = given["ramp"]
        parts.append({"kind": "ramp", "slope": slope, "start": start, "length": length})
    if "step" in given:
        height, start, length = given["step"]
        parts.append({"kind": "step", "height": height, "start": start, "length": length})
    if "sines" in given:
        parts.append({"kind": "waves", "waves": given["sines"]})
    return parts


def rig_of(spec, step, **options):
    """A rig in the initial state of a run."""
    vehicle, soil = spec["vehicle"], spec["soil"]
    roll, pitch, _ = vehicle["inertia"]
    options = {
        "terrain": terrain_of(spec["terrain"]), "load": spec["load"], "roll_inertia": roll,
        "pitch_inertia": pitch, "centre_of_mass_height": vehicle["com_height"],
        "patches": (vehicle["patches_along"], vehicle["patches_across"]),
        "stiffness": soil["stiffness_N_per_m3"], "damping": soil["damping_Ns_per_m3"],
        "stiffening": soil["stiffening_s_per_m2"], **options,
    }  # fmt: skip
    rig = TerrainRig(parameters_of(spec), options, step=step)
    rig.place(spec["initial"]["p"], spec["initial"]["q"])
    return rig


def run(spec, step, duration=None, **options):
    """Rows of x, y, z, q, v, W (body axes), N_total, N_patch_max every 10 ms."""
    rig, command = rig_of(spec, step, **options), spec["command"]
    duration = spec["duration"] if duration is None else duration
    times = SAMPLE * np.arange(round(duration / SAMPLE) + 1)
    speeds = np.stack([np.interp(times, command["t"], command[side]) for side in "LR"], axis=1)
    rows = []
    for k in range(len(times)):
        rows.append(
            np.concatenate(
                [rig.positions[0], rig.quaternions[0], rig.twists[0], rig.load, rig.largest_load]
            )
        )
        if k + 1 < len(times):
            rig.advance(speeds[k : k + 1], SAMPLE, to=speeds[k + 1 : k + 2])
    return np.array(rows)


def difference(found, truth):
    """(largest distance [mm], largest rotation [mrad]) between two runs."""
    distance = np.linalg.norm(found[:, :3] - truth[:, :3], axis=1).max()
    cosine = np.abs((found[:, 3:7] * truth[:, 3:7]).sum(axis=1))
    angle = 2.0 * np.sqrt(np.maximum(1.0 - np.minimum(cosine, 1.0) ** 2, 0.0)).max()
    return 1e3 * distance, 1e3 * angle
