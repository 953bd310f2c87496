"""Track-soil interaction of a rigid track under uniform normal pressure.

Equations (S = Strawa et al. 2021; symbols in NOTATION.md):
    tau_max = c + sigma tan(phi)                                     Mohr-Coulomb, S (1)
    F_max   = A c + (W / 2) tan(phi),  A = w l                       per track,    S (2)
    F(i)    = F_max [1 - (K / (i l)) (1 - exp(-i l / K))]            per track,    S (7)
    R       = (mu_l m g / 2) G(v_track)                              per track,    S (19)
    q       = mu_t m g / l                                           lateral friction per metre
    F_y, M  = -q integral of (1, s) sign(v_y + s w) ds               over the contact length
Assumptions: level ground, centre of mass over the middle of the contact, quasi-static
shear (the slip that carries a given effort is reached at once), no sinkage.
Signs: body frame x forward, y left, z up; forces act on the vehicle.

References: [1] Strawa et al., Electronics 10 (2021) 187. [2] Wong, Theory of Ground Vehicles.
"""

import math

from tracked_env.physics.elementary import exponential, saturated_sign, signed
from tracked_env.physics.jit import formula

GRAVITY = 9.81  # [m/s^2] g, as both papers use it
MOTION_RESISTANCE_REGULARISATION = 0.1  # [m/s] slower tracks meet less rolling resistance
LATERAL_FRICTION_REGULARISATION = 0.03  # [m/s] lateral time constant eps / (1.5 mu_t g)
YAW_FRICTION_REGULARISATION = 0.06  # [rad/s] the same for the turning moment of S (21)
STANDSTILL_SPEED = 1e-6  # [m/s] a track slower than this stands; keeps 0/0 out of the slip
SLIP_SPEED_FLOOR = 1e-3  # [m/s] the slip ratio fades to 0 when track and soil both stand
LOCKED_MARGIN = 0.02  # [-] braking slip beyond 1 - this: the belt no longer tells the track's speed
LEAST_EFFORT = 1e-6  # [N] F_max of a soil without cohesion and friction; keeps 0/0 out
SERIES_LIMIT = 0.125  # [-] below it power series replace closed forms that would cancel


@formula
def mohr_coulomb(cohesion, tangent, area, load):
    """Largest shear force [N] on `area` [m^2] under a normal `load` [N]: A c + N tan(phi), S (2).

    cohesion c [Pa], tangent tan(phi) [-]; single values or arrays.
    """
    return area * cohesion + load * tangent


@formula
def maximum_tractive_effort(cohesion, friction_angle, track_width, contact_length, mass):
    """F_max >= 0 [N] of one track: A c + (W / 2) tan(phi), S (2) with W = m g on two tracks.

    cohesion c [Pa], friction_angle phi [rad], track_width w [m], contact_length l [m], mass m [kg].
    """
    area, load = track_width * contact_length, 0.5 * mass * GRAVITY
    return mohr_coulomb(cohesion, math.tan(friction_angle), area, load)


@formula
def _small_mobilised_shear(u):
    """Power series of `mobilised_shear` for u <= SERIES_LIMIT; error < 1e-14 of 1."""
    tail = 1 / 5040 - u * (1 / 40320 - u / 362880)
    return u * (1 / 2 - u * (1 / 6 - u * (1 / 24 - u * (1 / 120 - u * (1 / 720 - u * tail)))))


@formula
def mobilised_shear(shear_ratio):
    """f(u) = 1 - (1 - exp(-u)) / u [-], share of F_max at u = |i| l / K >= 0 [-], S (7).

    Limits: f(0) = 0, f -> u/2 for u -> 0, f -> 1 - 1/u for u -> inf. Monotone.
    """
    safe = max(shear_ratio, SERIES_LIMIT)
    closed = 1.0 - (1.0 - exponential(-safe)) / safe
    return _small_mobilised_shear(shear_ratio) if shear_ratio < SERIES_LIMIT else closed


@formula
def mobilised_shear_slope(shear_ratio):
    """f'(u) = [(1 - exp(-u)) / u - exp(-u)] / u [-], derivative of `mobilised_shear`, u >= 0.

    Limits: f'(0) = 1/2, f' -> 1 / u^2 for u -> inf. Series error < 1e-12 of 1.
    """
    safe = max(shear_ratio, SERIES_LIMIT)
    decay = exponential(-safe)
    closed = ((1.0 - decay) / safe - decay) / safe
    u = min(shear_ratio, SERIES_LIMIT)
    tail = 1 / 144 - u * (1 / 840 - u * (1 / 5760 - u / 45360))
    series = 1 / 2 - u * (1 / 3 - u * (1 / 8 - u * (1 / 30 - u * tail)))
    return series if shear_ratio < SERIES_LIMIT else closed


@formula
def _newton_shear_ratio(u, mobilisation):
    """One Newton step towards mobilised_shear(u) = y, from u >= 0 [-]."""
    safe = max(u, SERIES_LIMIT)
    rest = (1.0 - exponential(-safe)) / safe
    slope = (rest - (1.0 - rest * safe)) / safe
    t = min(u, SERIES_LIMIT)
    slope_series = 1 / 2 - t * (1 / 3 - t * (1 / 8 - t * (1 / 30 - t * (1 / 144 - t / 840))))
    small = u < SERIES_LIMIT
    value = _small_mobilised_shear(t) if small else 1.0 - rest
    return max(u - (value - mobilisation) / (slope_series if small else slope), 0.0)


@formula
def shear_ratio_from_mobilisation(mobilisation):
    """u >= 0 [-] with mobilised_shear(u) = y for y in [0, 1): inverse of S (7).

    Start u0 = a - 1/a, a = 1/(1-y) (right to first order at both ends), then four Newton
    steps; relative error < 1e-11. y above 1 - 1e-9 is clipped there.
    """
    y = min(max(mobilisation, 0.0), 1.0 - 1e-9)
    a = 1.0 / (1.0 - y)
    u = _newton_shear_ratio(a - 1.0 / a, y)
    u = _newton_shear_ratio(u, y)
    u = _newton_shear_ratio(u, y)
    return _newton_shear_ratio(u, y)


@formula
def tractive_effort(slip_ratio, effort_maximum, shear_length):
    """Tractive effort F [N] of one track at slip ratio i in [-1, 1], S (7), odd in i.

    effort_maximum F_max [N]; shear_length l / K [-], contact length over the shear
    deformation modulus.
    """
    return signed(effort_maximum * mobilised_shear(abs(slip_ratio) * shear_length), slip_ratio)


@formula
def slip_from_effort(effort, effort_maximum, shear_length):
    """Slip ratio i in [-1, 1] at which one track carries `effort` [N]: inverse of S (7).

    Odd in the effort. Efforts beyond F(i = 1) give |i| = 1 (the track spins or is locked).
    """
    u = shear_ratio_from_mobilisation(abs(effort) / effort_maximum)
    return signed(min(u / shear_length, 1.0), effort)


@formula
def driving_effort_limit(track_speed, inverse_belt_limit, effort_maximum, shear_length):
    """Largest effort [N] that drives a track whose belt is limited to r omega_max [m/s].

    inverse_belt_limit 1 / (r omega_max) [s/m]. The belt at its top speed V_t slips by
    i_max = 1 - |V| / V_t, so F <= F(i_max): F(1) at standstill, 0 at top speed.
    """
    speed = max(abs(track_speed), STANDSTILL_SPEED)
    slip = max(1.0 - speed * inverse_belt_limit, 0.0)
    return effort_maximum * mobilised_shear(slip * shear_length)


@formula
def belt_speed(effort, track_speed, slip_ratio, speed_limit):
    """Belt speed V_t = r omega [m/s] from the slip that carries the effort.

    Driving (F along V, or V = 0): V_t = V / (1 - |i|), at most `speed_limit`.
    Braking (F against V): V_t = V (1 - |i|), 0 when the track is locked.
    """
    speed = max(abs(track_speed), STANDSTILL_SPEED)
    slip = abs(slip_ratio)
    faster = min(speed / max(1.0 - slip, 1e-12), max(speed_limit, speed))
    driving = effort * track_speed >= 0.0 or abs(track_speed) < STANDSTILL_SPEED
    magnitude = faster if driving else speed * (1.0 - slip)
    direction = track_speed if abs(track_speed) > STANDSTILL_SPEED else effort
    moves = abs(track_speed) > STANDSTILL_SPEED or slip >= 1.0 - 1e-6
    return signed(magnitude, direction) if moves else 0.0


@formula
def slip_ratio(belt, track_speed):
    """i = (V_t - V) / max(|V_t|, |V|) [-], in [-1, 1]; 0 when both stand still."""
    return (belt - track_speed) / max(max(abs(belt), abs(track_speed)), SLIP_SPEED_FLOOR)


@formula
def track_speed_from_belt(belt, slip_ratio):
    """Track speed V [m/s] over the ground from belt speed V_t [m/s] and slip ratio i: inverse
    of `slip_ratio`.

    Driving (i V_t >= 0): V = V_t (1 - |i|), 0 for |i| >= 1. Braking: V = V_t / (1 - |i|), with
    1 - |i| not below LOCKED_MARGIN: of a locked track the belt does not tell the speed.
    """
    slip = abs(slip_ratio)
    faster = belt / max(1.0 - slip, LOCKED_MARGIN)
    return belt * max(1.0 - slip, 0.0) if slip_ratio * belt >= 0.0 else faster


@formula
def resisting(speed, applied, magnitude, inverse_width):
    """Smooth form of G in S (19): a resistance that opposes motion and does not creep.

    speed [m/s or rad/s], applied [N or N m] (what the drive pushes with), magnitude >= 0.
    With s = saturated_sign(speed): G = magnitude s + (1 - |s|) clip(applied, +-magnitude),
    SUBTRACTED from the applied load. Limits: |speed| >= 1 / inverse_width gives S (19) exactly; at
    standstill it balances any load up to `magnitude` exactly, so nothing creeps.
    """
    s = saturated_sign(speed, inverse_width)
    balanced = min(max(applied, -magnitude), magnitude)
    return magnitude * s + (1.0 - abs(s)) * balanced


@formula
def lateral_friction(lateral_speed, yaw_rate, intensity, contact_length):
    """Lateral force F_y [N] and turning moment M [N m] of both tracks, regularised.

    lateral_speed v [m/s] at the middle of the contact, yaw_rate w [rad/s], intensity
    q = mu_t m g / l [N/m] over both tracks, contact_length l [m]. Integrals over [-l/2, l/2] of
    -q g(v + s w) and -q s g(v + s w), g the regularised sign, derived in docs/physics.md: with
    h = w l / 2, e(u) = sqrt(u^2 + eps^2), P = e(v-h) e(v+h), D = e(v-h) + e(v+h),
    S = v^2 + h^2, k = v^2 - h^2, R = eps^2 / (P + k) = (P - k) / (2 S + eps^2):
        F_y = -(2 q l v / D) (1 + eps^2 / (2 P))
        M   = -(q l^3 w / 4) R^2 [2 v^2 (1 + 2 S / D^2) + P] / (D P)
    Limits: eps -> 0: |F_y| <= q l and M = -q (l^2/4 - x_icr^2) sign(w), S (20) without its
    factor 2; w -> 0: M = 0. F_y is odd in v, M odd in w; together they dissipate.
    """
    eps2 = LATERAL_FRICTION_REGULARISATION * LATERAL_FRICTION_REGULARISATION
    v, h = lateral_speed, 0.5 * yaw_rate * contact_length
    rear, front = v - h, v + h
    e_rear = math.sqrt(rear * rear + eps2)
    e_front = math.sqrt(front * front + eps2)
    product, total = e_rear * e_front, e_rear + e_front
    inverse = 1.0 / (product * total)
    inverse_total = product * inverse
    force = -2.0 * intensity * contact_length * v * (inverse_total + 0.5 * eps2 * inverse)
    k = rear * front
    s = v * v + h * h
    large = product + abs(k)
    ratio = (eps2 if k >= 0.0 else large) / (large if k >= 0.0 else 2.0 * s + eps2)
    shape = 2.0 * v * v * (1.0 + 2.0 * s * inverse_total * inverse_total) + product
    lever = 0.5 * contact_length * contact_length * h * ratio * ratio * shape * inverse
    return force, -intensity * lever
