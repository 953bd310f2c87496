"""Slip surfaces of slip models: tables, trees and families are fitted, F (54) is taken as it is.

A model is fitted by least squares at SAMPLES pairs of belt speeds that its sprockets can
drive. v_y = v_x tan(alpha) is fitted, not alpha, which jumps where v_x changes sign.
Friction: coefficients are linear in 1 / mu between those of the layers of a family, as its tables
are; so a plan is continuous in an estimated friction.
"""

from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray

from baselines.lyapunov.pseudo_kinematic import NoSlip, SlipModel
from baselines.planners.slip_surface import CHEBYSHEV, COLUMNS, EXPONENTIAL, ROWS, SlipSurface
from baselines.slip.slip_models import (
    ExponentialSlipModel,
    SlipFamily,
    TableSlipModel,
    TreeSlipModel,
)
from baselines.slip.slip_tables import layers
from tracked_env.physics.parameters import PlantParameters

Array = NDArray[np.float64]

SAMPLES = 25, 49  # speeds p, and q, at which a model is fitted
TILT = 1.4  # [rad] largest c_1 of alpha: its tangent must stay finite


def no_slip(vehicle: PlantParameters) -> SlipSurface:
    """The surface of a vehicle whose tracks do not slip; holds at any speed."""
    terms = np.zeros((3, ROWS, COLUMNS))
    return SlipSurface(
        CHEBYSHEV, terms, 1e6, 1e6, 0.5 * vehicle.track_gauge, vehicle.sprocket_radius
    )


def surface_of(
    slip_model: SlipModel | None, vehicle: PlantParameters, sprocket_speed: float, fastest: float
) -> SlipSurface:
    """The surface of a slip model of `vehicle`.

    sprocket_speed [rad/s], fastest [m/s]: up to which plans go. None is no slip; F (54) is taken as
    it is; others are fitted, a table or a layer of a family at first in 3 ms, then it is kept.
    A family needs a friction: `family.at(mu)`, or an estimator that has both.
    Raises ValueError for a table that ends below `sprocket_speed`, or a friction that is not one
    number.
    """
    if slip_model is None or isinstance(slip_model, NoSlip):
        return no_slip(vehicle)
    if isinstance(slip_model, ExponentialSlipModel):
        return _exponential_surface(slip_model, vehicle.sprocket_radius)
    radius, half_gauge = vehicle.sprocket_radius, 0.5 * vehicle.track_gauge
    reach = radius * sprocket_speed, min(fastest, radius * sprocket_speed)
    family = getattr(slip_model, "family", None)  # of an estimator of friction too
    grid = getattr(slip_model if family is None else family, "grid", None)
    if grid is not None and sprocket_speed > grid.spacing * grid.zero_left * (1.0 + 1e-9):
        raise ValueError(
            f"sprocket speed = {sprocket_speed:g} rad/s; the slip model ends at "
            f"{grid.spacing * grid.zero_left:g} rad/s. Identify slip up to the limit of the plan."
        )
    if family is not None:
        friction = np.asarray(slip_model.friction)  # type: ignore[attr-defined]
        terms = _of_friction(family, friction, radius, *reach)
    elif isinstance(slip_model, TableSlipModel | TreeSlipModel):
        terms = _kept(slip_model, radius, *reach)
    else:  # one that learns is another model each time
        terms = _fitted(slip_model, radius, *reach)
    return SlipSurface(CHEBYSHEV, terms, reach[1], reach[0], half_gauge, radius)


def _exponential_surface(model: ExponentialSlipModel, radius: float) -> SlipSurface:
    steepest = float(np.abs(model.constants[2, 0]))
    if steepest > TILT:
        raise ValueError(
            f"c_1 of alpha = {steepest:g} rad; must be in [0, {TILT:g}] rad, or the vehicle drifts "
            "sideways faster than it drives. Is it in degrees?"
        )
    terms = np.zeros((3, ROWS, COLUMNS))
    terms[:, 0, :2] = model.constants
    return SlipSurface(EXPONENTIAL, terms, 1e6, 1e6, 0.5 * model.track_gauge, radius)


def _of_friction(
    family: SlipFamily, friction: Array, radius: float, belt: float, fastest: float
) -> Array:
    """Coefficients at the friction of a family, linear in 1 / mu."""
    if friction.size != 1 or np.isnan(friction).any():
        raise ValueError(
            f"friction = {friction}; must be one number for a plan. Plan for one vehicle at a time."
        )
    if len(family.frictions) == 1:
        return _fitted_layer(family, 0, radius, belt, fastest)
    layer, share = np.empty(1, dtype=np.int64), np.empty(1)
    layers(family.frictions, friction.reshape(1), layer, share)
    low, high = (_fitted_layer(family, int(layer[0]) + k, radius, belt, fastest) for k in (0, 1))
    return (1.0 - share[0]) * low + share[0] * high


@lru_cache(maxsize=64)
def _fitted_layer(family: SlipFamily, k: int, radius: float, belt: float, fastest: float) -> Array:
    return _fitted(family.at(family.frictions[k]), radius, belt, fastest)


@lru_cache(maxsize=64)
def _kept(model: SlipModel, radius: float, belt: float, fastest: float) -> Array:
    return _fitted(model, radius, belt, fastest)


def _fitted(model: SlipModel, radius: float, belt: float, fastest: float) -> Array:
    p, q = (a.ravel() for a in np.meshgrid(
        np.linspace(0.0, fastest, SAMPLES[0]), np.linspace(0.0, belt, SAMPLES[1]), indexing="ij"
    ))  # fmt: skip
    driven = p + q <= belt * (1.0 + 1e-9)  # the others need a faster sprocket
    p, q = p[driven], q[driven]
    left, right, alpha = model.slip((p - q) / radius, (p + q) / radius)
    rows = chebvander(2.0 * p / fastest - 1.0, ROWS - 1)
    columns = chebvander(q / belt, 2 * COLUMNS - 1)
    share = (p / fastest)[:, None]
    half_sum = 0.5 * (left + right)
    wanted = (
        (share * rows, columns[:, 0::2], half_sum),
        (rows, columns[:, 1::2], 0.5 * (right - left)),
        (share * rows, columns[:, 1::2], (p - half_sum) * np.tan(alpha)),
    )
    terms = np.empty((3, ROWS, COLUMNS))
    for c, (along, across, values) in enumerate(wanted):
        products = (along[:, :, None] * across[:, None, :]).reshape(len(values), -1)
        terms[c] = np.linalg.lstsq(products, values, rcond=None)[0].reshape(ROWS, COLUMNS)
    return terms
