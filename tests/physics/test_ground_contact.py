"""Contact of patches on uneven ground: each term of the equations by itself, and the power balance.

Scratch arrays are filled by the passes of the kernel, called one by one from Python.
"""

import math
import re

import llvmlite.binding as llvm
import numpy as np
import pytest
from numba import njit

from tracked_env.physics import patches_on_terrain as g
from tracked_env.physics import rigid_body as rigid
from tracked_env.physics.jit import COMPILED
from tracked_env.physics.patches_on_terrain import Footing, rocking_of
from tracked_env.physics.rigid_body import Drag, Twist, Wrench
from tracked_env.physics.terrain_motion import Grid
from tracked_env.terrain.ground import WAVE_SCRATCH, add_waves, fill
from tracked_env.terrain.height_field import make_height_field

HALF_LENGTH, HALF_GAUGE, WIDTH, HEIGHT = 0.35, 0.303, 0.1, 0.25
COLUMNS = 1.0 - (2.0 * np.arange(10) + 1.0) / 10
ROWS = (np.arange(4) + 0.5) / 4 - 0.5
FOOTING = Footing(HEIGHT, HALF_LENGTH, 0.07 / 40, 1e5 / 0.07, 5e3 / 0.07, 2.0, 0.0, 0.0)
FIELD = make_height_field([{"kind": "plane", "slope_x": 0.1}, {"kind": "hills", "height": 0.1}])
MU, COHESION, MODULUS, ROLLING = 0.6, 800.0, 2e-3, 0.04


def contact(seed, again=False, shift=(0.0, 0.0, 0.0), **options):
    """(scratch, rotation, twist, belt speeds) of a random motion with patches in the ground.

    shift [m]: of the centre of mass, body axes; the tracks move all the same, the twist is its own.
    changed: of the Footing.
    """
    footing = shifted(shift)._replace(**options)
    rng = np.random.default_rng(seed)
    w = np.zeros((g.SCRATCH_ROWS, g.LANES))
    lanes = g.place_patches(w, COLUMNS, ROWS, HALF_GAUGE, WIDTH, footing)
    w[g.FRICTION], w[g.ADHESION] = (MU, COHESION * FOOTING.patch_area)
    (w[g.INVERSE_MODULUS], w[g.ROLLING], w[g.FIRMNESS]) = 1.0 / MODULUS, ROLLING, 1.0
    belts = rng.uniform(-1.0, 1.0, 2)
    for side in range(2):
        g.set_belt(w, 40 * side, 40 * side + 40, belts[side], footing)
    yaw, pitch, roll = rng.uniform(-0.1, 0.1, 3)
    x, y = rng.uniform(-3.0, 3.0, 2)
    height, slope_x, _ = FIELD.at(x, y)
    r = rigid.matrix_of(rigid.quaternion_of(yaw, pitch - math.atan(slope_x), roll))
    place = np.array([x, y, float(height) + HEIGHT - 0.003])
    place += np.array(r).reshape(3, 3) @ shift
    g.locate(w, lanes, place, r, footing.height)
    fill(FIELD.relief, w, lanes)
    g.orient(w, lanes, r)
    twist = Twist(*(rng.uniform(-0.6, 0.6, 6) * [1.0, 1.0, 0.02, 0.1, 0.1, 1.0]))
    twist = rigid.at_point(twist, *shift)
    moved(w, twist, again, footing)
    return w[:, :lanes], r, twist, belts


def shifted(shift):
    """The Footing of a centre of mass that is `shift` [m] away."""
    return FOOTING._replace(height=HEIGHT + shift[2], ahead=shift[0], aside=shift[1])


def moved(w, twist, again=False, footing=FOOTING):
    """Fill the rows of the shear at a motion."""
    longest = 2.0 * HALF_LENGTH / max(np.abs(w[g.BELT, :80]).min(), 1e-6)
    g.press(w, 80, twist, footing)
    g.slide(w, 80, twist, footing, longest)
    g.resist(w, 80, again)


def arms(w, height=HEIGHT):
    """Places of the patches (80, 3), body axes."""
    return np.stack([w[g.X], w[g.Y], np.full(80, -height)], axis=1)


def normals(w):
    """Normals (80, 3) of the ground, body axes."""
    return np.stack([w[g.N_X], w[g.N_Y], w[g.N_Z]], axis=1)


def velocities(w, twist, height=HEIGHT):
    """Velocities (80, 3) of the patches, body axes."""
    return np.array(twist[:3]) + np.cross(np.array(twist[3:]), arms(w, height))


SHIFTS = ((0.07, 0.0, 0.0), (0.0, -0.05, 0.0), (-0.06, 0.04, 0.1))


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), *SHIFTS])
@pytest.mark.parametrize("seed", range(10))
def test_the_power_of_the_ground_is_that_of_belts_less_slip_rolling_and_pressing(seed, shift):
    w, _, twist, _ = contact(seed, shift=shift)
    assert (w[g.LOAD] > 0).any()
    height = HEIGHT + shift[2]
    power = np.dot(g.total_wrench(w, 80, height, 1.0), twist)
    slip = (w[g.THRUST] * w[g.SLIDE] + w[g.LATERAL] * w[g.ASIDE]).sum()
    rolled = (w[g.ROLLED] * w[g.FORWARD]).sum()
    belts = (w[g.BELT] * w[g.THRUST] * w[g.AHEAD]).sum()
    pressed = (w[g.LOAD] * (normals(w) * velocities(w, twist, height)).sum(axis=1)).sum()
    assert slip <= 0.0 <= rolled
    size = abs(slip) + abs(rolled) + abs(belts) + abs(pressed)
    assert abs(power - (belts + slip - rolled + pressed)) < 1e-12 * size


@pytest.mark.parametrize("seed", range(5))
def test_the_sinkage_is_the_distance_to_a_tilted_plane_along_its_normal(seed):
    slope_x, slope_y = np.random.default_rng(seed).uniform(-0.8, 0.8, 2)
    plane = make_height_field({"kind": "plane", "slope_x": slope_x, "slope_y": slope_y})
    w = np.zeros((g.SCRATCH_ROWS, g.LANES))
    g.place_patches(w, COLUMNS, ROWS, HALF_GAUGE, WIDTH, FOOTING)
    r = rigid.matrix_of(rigid.quaternion_of(0.3, -0.2, 0.1))
    g.locate(w, 80, (0.2, -0.4, 0.25), r, HEIGHT)
    fill(plane.relief, w, 80)
    g.orient(w, 80, r)
    n = np.array([-slope_x, -slope_y, 1.0]) / math.hypot(1.0, slope_x, slope_y)
    places = w[[g.PLACE_X, g.PLACE_Y, g.PLACE_Z], :80]
    assert w[g.SINKAGE, :80] == pytest.approx(-(n @ places), abs=1e-15)
    world = np.array(r).reshape(3, 3) @ normals(w[:, :80]).T
    assert world == pytest.approx(np.tile(n[:, None], 80), abs=1e-15)


@pytest.mark.parametrize("seed", range(5))
def test_the_load_is_of_springs_and_dampers_along_the_normal_and_never_pulls(seed):
    w, _, twist, _ = contact(seed)
    rate = -(normals(w) * velocities(w, twist)).sum(axis=1)
    stiff = 1.0 + 2.0 * twist.x * (w[g.X] + np.sign(twist.x) * HALF_LENGTH)
    springs = FOOTING.stiffness * stiff * w[g.SINKAGE] + FOOTING.damping * rate
    expected = np.where(w[g.SINKAGE] > 0, np.maximum(FOOTING.patch_area * springs, 0.0), 0.0)
    assert w[g.LOAD] == pytest.approx(expected, abs=1e-10)


def test_a_spring_pushes_only_where_it_has_sunk_in_and_not_faster_than_it_is_left():
    assert g.normal_load(-1e-3, 10.0, 0.1, 1e6, 1e5) == 0.0
    assert g.normal_load(1e-3, -1.0, 0.1, 1e6, 1e5) == 0.0
    assert g.normal_load(1e-3, 0.0, 0.1, 1e6, 1e5) == pytest.approx(100.0)
    assert g.normal_load(1e-3, 0.01, 0.1, 1e6, 1e5) == pytest.approx(200.0)


@pytest.mark.parametrize("seed", range(10))
def test_without_contact_there_is_no_force_of_cohesion_either(seed):
    w, _, _, _ = contact(seed)
    free = w[g.LOAD] == 0.0
    for row in (g.THRUST, g.LATERAL, g.ROLLED, g.K_TT, g.K_QQ):
        assert not w[row][free].any()


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("turn", [1e-9, 0.3, -1.2, 5.0, -11.0])
def test_the_shear_displacement_is_the_integral_of_the_slip_since_first_contact(seed, turn):
    u_t, u_q, belt = np.random.default_rng(seed).uniform(-0.5, 0.5, 3)
    time, w_n = 1.4, turn / 1.4
    # The point moves with u; the belt carries it aft: u_q was larger ahead, by w belt per time.
    since, weights = np.polynomial.legendre.leggauss(60)
    since, weights = 0.5 * time * (1.0 + since), 0.5 * time * weights
    angle, aside = w_n * since, u_q + w_n * belt * (time - since)
    j_t = weights @ (np.cos(angle) * (u_t - belt) - np.sin(angle) * aside)
    j_q = weights @ (np.sin(angle) * (u_t - belt) + np.cos(angle) * aside)
    short = abs(turn) <= g.SHORT_TURN
    result = g.shear_displacement(turn, time, u_t, u_q, belt, HALF_LENGTH, short)
    assert result == pytest.approx(math.hypot(j_t, j_q), abs=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_soil_turns_under_a_patch_about_the_normal_of_the_ground(seed):
    w, _, _, _ = contact(seed)
    twist = Twist(0.3, 0.1, 0.0, 1.5, -1.2, 0.2)
    moved(w, twist)
    about = normals(w) @ np.array(twist[3:])
    assert np.abs(about - twist.yaw).max() > 0.02
    for k in range(0, 80, 7):
        time, belt = w[g.TIME, k], w[g.BELT, k] * w[g.AHEAD, k]
        motion = w[g.FORWARD, k], w[g.ASIDE, k], belt, HALF_LENGTH
        j = g.shear_displacement(about[k] * time, time, *motion, False)
        assert w[g.SHEARED, k] == pytest.approx(j, rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_slip_is_measured_in_the_contact_plane(seed):
    w, _, twist, _ = contact(seed)
    n, u = normals(w), velocities(w, twist)
    ahead = np.array([1.0, 0.0, 0.0]) - n[:, :1] * n
    size = np.linalg.norm(ahead, axis=1)
    t = ahead / size[:, None]
    q = np.cross(n, t)
    assert w[g.SLIDE] == pytest.approx((u * t).sum(axis=1) - w[g.BELT] * size, abs=1e-14)
    assert w[g.ASIDE] == pytest.approx((u * q).sum(axis=1), abs=1e-14)


@pytest.mark.parametrize("seed", range(5))
def test_rolling_resistance_is_a_share_of_the_load_that_fades_below_a_centimetre_per_second(seed):
    w, _, _, _ = contact(seed)
    sign = w[g.FORWARD] / np.hypot(w[g.FORWARD], 0.01)
    assert w[g.ROLLED] == pytest.approx(ROLLING * w[g.LOAD] * sign, rel=1e-12)
    assert w[g.K_ROLL] * w[g.FORWARD] == pytest.approx(w[g.ROLLED], rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_shear_force_opposes_the_slip_with_the_strength_that_is_mobilised(seed):
    w, _, _, _ = contact(seed)
    strength = np.where(w[g.LOAD] > 0, COHESION * FOOTING.patch_area + MU * w[g.LOAD], 0.0)
    size = strength * (1.0 - np.exp(-w[g.SHEARED] / MODULUS))
    speed = np.hypot(w[g.SLIDE], w[g.ASIDE])
    assert w[g.THRUST] == pytest.approx(-size * w[g.SLIDE] / speed, rel=1e-10)
    assert w[g.LATERAL] == pytest.approx(-size * w[g.ASIDE] / speed, rel=1e-10)


@pytest.mark.parametrize("seed", range(5))
def test_the_drag_is_the_sum_over_patches_of_their_resistances_with_moments(seed):
    w, _, _, _ = contact(seed)
    expected = np.zeros((6, 6))
    for k, (n, arm) in enumerate(zip(normals(w), arms(w), strict=True)):
        t = (np.array([1.0, 0.0, 0.0]) - n[0] * n) / w[g.AHEAD, k]
        q = np.cross(n, t)
        skew = np.cross(np.eye(3), arm).T
        jacobian = np.hstack([np.eye(3), skew])
        stiff = FOOTING.patch_area * FOOTING.damping * (w[g.LOAD, k] > 0)
        matrix = (w[g.K_TT, k] + w[g.K_ROLL, k]) * np.outer(t, t) + w[g.K_QQ, k] * np.outer(q, q)
        matrix += w[g.K_TQ, k] * (np.outer(t, q) + np.outer(q, t)) + stiff * np.outer(n, n)
        expected += jacobian.T @ matrix @ jacobian
    drag = g.total_drag(w, 80, HEIGHT, FOOTING.patch_area * FOOTING.damping)
    assert full(drag) == pytest.approx(expected, rel=1e-11, abs=1e-11 * expected.max())


def full(drag):
    """A Drag as a symmetric matrix."""
    matrix = np.zeros((6, 6))
    matrix[np.tril_indices(6)] = drag
    return matrix + np.tril(matrix, -1).T


@pytest.mark.parametrize("seed", range(5))
def test_a_patch_that_speeds_up_has_the_slope_of_its_force_as_drag_and_one_that_slows_the_secant(
    seed,
):
    w, _, _, _ = contact(seed)

    def drag_along(w):
        cross = 2 * w[g.K_TQ] * w[g.SLIDE] * w[g.ASIDE]
        return w[g.K_TT] * w[g.SLIDE] ** 2 + cross + w[g.K_QQ] * w[g.ASIDE] ** 2

    secant = drag_along(w)
    for factor in (0.5, 2.0):
        w[g.OLD_SLIDE], w[g.OLD_ASIDE] = (w[g.SLIDE] / factor, w[g.ASIDE] / factor)
        g.resist(w, 80, True)
        along = w[g.K_TT] * w[g.SLIDE] ** 2 + 2 * w[g.K_TQ] * w[g.SLIDE] * w[g.ASIDE]
        along += w[g.K_QQ] * w[g.ASIDE] ** 2
        loaded = w[g.LOAD] > 0
        if factor < 1.0:
            assert along == pytest.approx(secant, rel=1e-12)
        else:
            assert (along[loaded] < secant[loaded]).all() and (along > -1e-9 * secant.max()).all()


def test_the_uniform_load_rocks_on_the_springs_of_the_nonuniform_load():
    across, along = 200, 200
    aside = WIDTH * ((np.arange(across) + 0.5) / across - 0.5)
    y = np.concatenate([HALF_GAUGE + aside, aside - HALF_GAUGE])
    x = HALF_LENGTH * (1.0 - (2.0 * np.arange(along) + 1.0) / along)
    area = 4 * HALF_LENGTH * WIDTH
    k = rocking_of(FOOTING, HALF_GAUGE, WIDTH, 80)
    assert k.area == pytest.approx(area)
    assert k.roll == pytest.approx(FOOTING.stiffness * area * (y**2).mean(), rel=1e-5)
    assert k.pitch == pytest.approx(FOOTING.stiffness * area * (x**2).mean(), rel=1e-4)
    assert k.half_width == pytest.approx(0.353)


def about(wrench, arm):
    """Force and moment (6,) about a point at `arm` from the one they are about."""
    force, moment = np.array(wrench[:3]), np.array(wrench[3:])
    return np.concatenate([force, moment - np.cross(arm, force)])


def carried(arm):
    """Matrix (6, 6) from the twist of a point to that of the one at `arm` from it."""
    matrix = np.eye(6)
    matrix[:3, 3:] = np.cross(np.eye(3), arm).T
    return matrix


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("seed", range(5))
def test_the_same_tracks_have_the_same_forces_and_their_moments_are_about_the_shifted_point(
    seed, shift
):
    w, *_ = contact(seed, stiffening=0.0)
    other, *_ = contact(seed, shift=shift, stiffening=0.0)
    for row in (g.SINKAGE, g.TIME, g.LOAD, g.SHEARED, g.FORWARD, g.THRUST, g.LATERAL, g.ROLLED):
        assert other[row] == pytest.approx(w[row], rel=1e-9, abs=1e-11 * np.abs(w[row]).max())
    wrench = g.total_wrench(w, 80, HEIGHT, 1.0)
    result = g.total_wrench(other, 80, HEIGHT + shift[2], 1.0)
    assert np.array(result) == pytest.approx(about(wrench, shift), rel=1e-10, abs=1e-9)
    damping = FOOTING.patch_area * FOOTING.damping
    here = full(g.total_drag(w, 80, HEIGHT, damping))
    there = full(g.total_drag(other, 80, HEIGHT + shift[2], damping))
    back = carried(-np.array(shift))
    assert there == pytest.approx(back.T @ here @ back, rel=1e-9, abs=1e-10 * here.max())


@pytest.mark.parametrize("seed", range(5))
def test_stiffer_ground_has_the_same_load_at_less_sinkage_and_damps_in_proportion(seed):
    w, _, twist, _ = contact(seed, stiffening=0.0)
    load = w[g.LOAD].copy()
    w[g.FIRMNESS, ::2] = 0.25
    g.press(w, 80, twist, FOOTING._replace(stiffening=0.0))
    assert w[g.LOAD, ::2] == pytest.approx(0.25 * load[::2], rel=1e-12)
    np.testing.assert_array_equal(w[g.LOAD, 1::2], load[1::2])
    w[[g.K_TT, g.K_TQ, g.K_QQ, g.K_ROLL]] = 0.0
    drag = full(g.total_drag(w, 80, HEIGHT, 1.0))
    n, loaded = normals(w), w[g.LOAD] > 0.0
    weights = np.where(loaded, w[g.FIRMNESS], 0.0)
    assert drag[:3, :3] == pytest.approx(np.einsum("k,ki,kj->ij", weights, n, n), abs=1e-11)


def uniform_contact(shift):
    """(wrench, drag, tilt) of load and tilt alone, about a centre of mass `shift` away."""
    footing = shifted(shift)
    w = np.zeros((g.SCRATCH_ROWS, g.LANES))
    lanes = g.place_patches(w, COLUMNS, ROWS, HALF_GAUGE, WIDTH, footing)
    r = rigid.matrix_of(rigid.quaternion_of(0.4, -0.15, 0.1))
    axes = np.array(r).reshape(3, 3)
    height = float(FIELD.at(0.3, 0.2)[0])
    place = np.array([0.3, 0.2, height]) + axes @ (np.array([0.0, 0.0, HEIGHT - 0.003]) + shift)
    g.locate_foot(w, g.WIDE, place, r, footing)
    fill(FIELD.relief, w, g.WIDE)
    g.orient(w, g.WIDE, r)
    g.share_plane(w, lanes)
    rocking = g.rocking_of(footing, HALF_GAUGE, WIDTH, 80)
    twist = rigid.at_point(Twist(0.3, -0.1, -0.02, 0.05, -0.08, 0.4), *shift)
    tilt = g.tilt_of(w, twist, footing, rocking)
    nothing = Wrench(*[0.0] * 6), Drag(*[0.0] * 21)
    return (*g.with_tilt(w, tilt, footing, rocking, *nothing), tilt)


@pytest.mark.parametrize("shift", SHIFTS)
def test_the_foot_of_the_uniform_load_stays_in_the_middle_of_the_tracks(shift):
    wrench, drag, tilt = uniform_contact((0.0, 0.0, 0.0))
    result, its_drag, same = uniform_contact(shift)
    assert tilt.load > 0.0
    assert np.array(same) == pytest.approx(np.array(tilt), rel=1e-9)
    assert np.array(result) == pytest.approx(about(wrench, shift), rel=1e-9, abs=1e-9)
    back = carried(-np.array(shift))
    expected = back.T @ full(drag) @ back
    assert full(its_drag) == pytest.approx(expected, rel=1e-9, abs=1e-10 * expected.max())


# Kernels of a pass each, compiled here and not from disk, where the code cannot be looked at.
PASSES = {
    "add_waves": (lambda w, t, grid, r: add_waves(w, t, grid)),
    "locate": (lambda w, t, grid, r: g.locate(w, 80, (0.0, 0.0, 0.3), r, 0.25)),
    "orient": (lambda w, t, grid, r: g.orient(w, 80, r)),
    "resist": (lambda w, t, grid, r: g.resist(w, 80, True)),
    "total_wrench": (lambda w, t, grid, r: g.total_wrench(w, 80, 0.25, 1.0)),
    "total_drag": (lambda w, t, grid, r: g.total_drag(w, 80, 0.25, 100.0)),
}


@pytest.mark.skipif(not COMPILED, reason="NUMBA_DISABLE_JIT: nothing is compiled")
@pytest.mark.skipif(
    not llvm.get_host_cpu_features().get("avx2"), reason="this processor has no AVX2: no ymm, zmm"
)
@pytest.mark.parametrize("name", PASSES)
def test_the_passes_over_the_patches_are_wide_vector_instructions(name):
    """Four or eight patches at a time: multiplications by ymm or zmm of packed doubles."""
    kernel = njit(error_model="numpy")(PASSES[name])
    w, t = np.zeros((g.SCRATCH_ROWS, g.LANES)), np.zeros(WAVE_SCRATCH)
    r = rigid.matrix_of(rigid.quaternion_of(0.0, 0.0, 0.0))
    kernel(w, t, Grid(*[0.0] * 8, 10, 4), r)
    (code,) = kernel.inspect_asm().values()
    wide = re.findall(r"\bv(?:mul|f[n]?m(?:add|sub)\d+)pd\b.*%[yz]mm", code)
    assert len(wide) >= {"add_waves": 60, "locate": 6}.get(name, 10), (
        f"{len(wide)} of packed doubles"
    )
