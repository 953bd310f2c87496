"""Pictures in perspective with a depth buffer: ground as a height grid, and flat polygons.

The image plane is vertical, so that vertical lines stay vertical. With the eye at (x0, y0, z0) that
looks along the yaw psi, a point at the distance Z ahead, Y to the left and at the height z is seen
    column = c0 - f Y / Z,   row = r0 - f (z - z0) / Z         f [px]: focal length
r0 is the row of the horizon. The buffer keeps 1/Z, which is affine in column and row on a plane.
Ground: for each column the ray of each row is followed from below to the first place where the
ground is above it; that place is interpolated between two samples. Hidden ground costs nothing.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.jit import formula, loop
from tracked_env.rendering.canvas import Bytes, Floats
from tracked_env.rendering.soil_map import LINE, contour, coverage

STRIDE = 0.5  # [cells] between samples of the ground near the eye
GROWTH = 0.008  # [-] of the distance between samples farther away
MESH_INK = 0.18  # [-] darkening by the lines of the mesh on the ground
CONTOUR_INK = 0.8  # [-] opacity of contour lines
CLEAR = 0.25  # [-] of the farthest distance, seen without haze
STEEPEST_VIEW = 0.02  # [-] of the line of sight against the ground, for the width of lines


class Eye(NamedTuple):
    """From where and how a picture is taken."""

    x: float  # [m]
    y: float  # [m]
    z: float  # [m]
    cosine: float  # [-] of the yaw along which it looks
    sine: float  # [-]
    focal: float  # [px] f
    column: float  # [px] c0
    row: float  # [px] r0, of the horizon
    near: float  # [m] nothing closer is drawn
    far: float  # [m] nor anything farther


class GroundGrid(NamedTuple):
    """Heights and colours of the ground on square meshes; rows along y, columns along x."""

    heights: NDArray[np.float32]  # (R, C) [m]
    bright: NDArray[np.float32]  # (R, C) [-]
    x: float  # [m] of heights[0, 0]
    y: float  # [m]
    inverse_cell: float  # [1/m]
    soil: Bytes  # (S, T, 3) colours over the same area
    soil_step: float  # [-] cells of the heights for one of the colours
    contours: float  # [1/m] contour lines per metre of height
    mesh: float  # [1/m] lines of the mesh on the ground per metre


class Ray(NamedTuple):
    """The line of sight of one pixel, per metre ahead of the eye."""

    along_x: float  # [-]
    along_y: float  # [-]
    drop: float  # [-] downwards


@formula
def _cell(values, column, row):
    """(row, column) of the cell of a grid at a place [cells], and the shares (up, right) in it;
    beyond the edge the place on the edge."""
    column = min(max(column, 0.0), values.shape[1] - 1.001)
    row = min(max(row, 0.0), values.shape[0] - 1.001)
    j, i = int(column), int(row)
    return i, j, row - i, column - j


@formula
def _between(values, column, row):
    """Value of a grid at a place [cells], bilinear."""
    i, j, v, u = _cell(values, column, row)
    low = values[i, j] + u * (values[i, j + 1] - values[i, j])
    high = values[i + 1, j] + u * (values[i + 1, j + 1] - values[i + 1, j])
    return low + v * (high - low)


@loop
def heights_at(grid, points, out):
    """Heights (P,) [m] of the ground at places (P, 2) [m]."""
    for k in range(len(points)):
        column = (points[k, 0] - grid.x) * grid.inverse_cell
        row = (points[k, 1] - grid.y) * grid.inverse_cell
        out[k] = _between(grid.heights, column, row)


@loop
def trace(grid, eye, inverse):
    """Fill the depth buffer (H, W) with the ground; 0 where the sky is seen."""
    rows, columns = inverse.shape
    for column in range(columns):
        aside = (eye.column - (column + 0.5)) / eye.focal
        along_x = (eye.cosine - eye.sine * aside) * grid.inverse_cell
        along_y = (eye.sine + eye.cosine * aside) * grid.inverse_cell
        first_x = (eye.x - grid.x) * grid.inverse_cell
        first_y = (eye.y - grid.y) * grid.inverse_cell
        step = STRIDE / (grid.inverse_cell * math.sqrt(1.0 + aside * aside))
        before, row = eye.near, rows - 1
        last = _between(grid.heights, first_x + before * along_x, first_y + before * along_y)
        while before < eye.far and row >= 0:
            here = before + max(step, GROWTH * before)
            height = _between(grid.heights, first_x + here * along_x, first_y + here * along_y)
            while row >= 0:
                drop = (row + 0.5 - eye.row) / eye.focal  # of the ray, per metre ahead
                above = height - eye.z + drop * here
                if above < 0.0:
                    break
                under = min(last - eye.z + drop * before, 0.0)
                share = under / (under - above) if above > under else 1.0
                inverse[row, column] = 1.0 / (before + share * (here - before))
                row -= 1
            before, last = here, height
        for sky in range(row, -1, -1):
            inverse[sky, column] = 0.0


@formula
def _lit_slopes(grid, column, row):
    """Brightness [-], slopes along x and y [-] of the ground at a place [cells]."""
    heights, bright = grid.heights, grid.bright
    i, j, v, u = _cell(heights, column, row)
    h00, h01, h10, h11 = heights[i, j], heights[i, j + 1], heights[i + 1, j], heights[i + 1, j + 1]
    b00, b01, b10, b11 = bright[i, j], bright[i, j + 1], bright[i + 1, j], bright[i + 1, j + 1]
    slope_x = (h01 - h00) + v * (h11 - h10 - h01 + h00)
    slope_y = (h10 - h00) + u * (h11 - h10 - h01 + h00)
    lit = b00 + u * (b01 - b00) + v * (b10 - b00 + u * (b11 - b10 - b01 + b00))
    return lit, slope_x * grid.inverse_cell, slope_y * grid.inverse_cell


@formula
def _lines(grid, eye, ray, ahead, slope_x, slope_y):
    """Opacities [0, 1] of contour lines and of the mesh at the place `ahead` [m] on a ray.

    With s the slope along the line of sight and g = s + drop, the place moves by (Z / f) / g ahead
    from one row to that above it.
    """
    along_x, along_y, drop = ray
    pixel = ahead / eye.focal  # [m]
    grazing = slope_x * along_x + slope_y * along_y + drop
    grazing = max(abs(grazing), STEEPEST_VIEW)
    deeper = pixel / grazing  # [m] ahead, from a row to the one above
    across = (slope_y * eye.cosine - slope_x * eye.sine) * deeper  # the same, from column to column
    change = math.sqrt((deeper * (grazing - drop)) ** 2 + (drop * across) ** 2)
    change_x = abs(along_x) * deeper + abs(along_x * across + eye.sine * pixel)
    change_y = abs(along_y) * deeper + abs(along_y * across - eye.cosine * pixel)
    x, y = eye.x + ahead * along_x, eye.y + ahead * along_y
    mesh = max(coverage(x, grid.mesh, change_x, 0.5), coverage(y, grid.mesh, change_y, 0.5))
    return contour(eye.z - drop * ahead, grid.contours, change), mesh


@loop
def colour_ground(grid, eye, inverse, haze, sky, picture):
    """Colour the ground of a depth buffer: soil, brightness, grid and contour lines, haze.

    haze (3,): colour of the far ground; sky (H, 3): of each row where there is none.
    """
    rows, columns = inverse.shape
    per_step = 1.0 / grid.soil_step
    for row in range(rows):
        drop = (row + 0.5 - eye.row) / eye.focal
        for column in range(columns):
            if inverse[row, column] == 0.0:
                for c in range(3):
                    picture[row, column, c] = sky[row, c]
                continue
            ahead = 1.0 / inverse[row, column]
            aside = (eye.column - (column + 0.5)) / eye.focal
            along_x, along_y = eye.cosine - eye.sine * aside, eye.sine + eye.cosine * aside
            x, y = eye.x + ahead * along_x, eye.y + ahead * along_y
            at_x, at_y = (x - grid.x) * grid.inverse_cell, (y - grid.y) * grid.inverse_cell
            fade = min(max((ahead / eye.far - CLEAR) / (1.0 - CLEAR), 0.0), 1.0)
            bright, slope_x, slope_y = _lit_slopes(grid, at_x, at_y)
            ray = Ray(along_x, along_y, drop)
            contours, mesh = _lines(grid, eye, ray, ahead, slope_x, slope_y)
            bright *= 1.0 - MESH_INK * mesh
            ink = CONTOUR_INK * contours * (1.0 - fade)
            i = min(max(int(at_y * per_step), 0), grid.soil.shape[0] - 1)
            j = min(max(int(at_x * per_step), 0), grid.soil.shape[1] - 1)
            fade = fade * fade * (3.0 - 2.0 * fade)
            for c in range(3):
                ground = min(bright * grid.soil[i, j, c], 255.0)
                ground += ink * (LINE[c] - ground)
                picture[row, column, c] = int(ground + fade * (haze[c] - ground) + 0.5)


@formula
def _row_span(corners, first, last, middle):
    """(left, right) [px] of a convex polygon on the line of pixels with that middle."""
    left, right = np.inf, -np.inf
    for k in range(first, last):
        m = k + 1 if k + 1 < last else first
        low, high = corners[k, 1], corners[m, 1]
        if (low <= middle) != (high <= middle):
            at = corners[k, 0] + (middle - low) / (high - low) * (corners[m, 0] - corners[k, 0])
            left, right = min(left, at), max(right, at)
    return left, right


@formula
def _plane(corners, first, last):
    """(a, b, c) with 1/Z = a + b column + c row on a polygon, from three of its corners.

    A polygon seen from its edge gets its nearest corner all over.
    """
    best, a, b, c = 1e-3, 0.0, 0.0, 0.0
    for k in range(first, last):
        a = max(a, corners[k, 2])
    for k in range(first + 1, last - 1):
        u1, v1 = corners[k, 0] - corners[first, 0], corners[k, 1] - corners[first, 1]
        u2, v2 = corners[k + 1, 0] - corners[first, 0], corners[k + 1, 1] - corners[first, 1]
        area = u1 * v2 - u2 * v1
        if abs(area) > best:
            best = abs(area)
            w1, w2 = corners[k, 2] - corners[first, 2], corners[k + 1, 2] - corners[first, 2]
            b, c = (w1 * v2 - w2 * v1) / area, (u1 * w2 - u2 * w1) / area
            a = corners[first, 2] - b * corners[first, 0] - c * corners[first, 1]
    return a, b, c


@loop
def fill_polygons(corners, starts, colours, opacity, bias, inverse, picture):
    """Draw convex polygons in space, hidden where the buffer holds something nearer.

    corners (V, 3): column, row [px], 1/Z [1/m]; polygon k has those from starts[k] to
    starts[k + 1]; colours (K, 3); opacity in [0, 1]; bias [-]: by this share of its distance a
    polygon is taken as nearer. Opaque ones are written into the buffer. A polygon with a corner
    behind the near plane (1/Z <= 0) is left out.
    """
    rows, columns = inverse.shape
    for k in range(starts.size - 1):
        first, last = starts[k], starts[k + 1]
        low, high, nearest = np.inf, -np.inf, np.inf
        for v in range(first, last):
            low, high = min(low, corners[v, 1]), max(high, corners[v, 1])
            nearest = min(nearest, corners[v, 2])
        if nearest <= 0.0:
            continue
        a, b, c = _plane(corners, first, last)
        for row in range(max(int(low) - 1, 0), min(int(high) + 2, rows)):
            middle = row + 0.5
            left, right = _row_span(corners, first, last, middle)
            if left >= right:
                continue
            begin, end = max(math.ceil(left - 0.5), 0), min(math.ceil(right - 0.5), columns)
            for column in range(begin, end):
                value = (a + b * (column + 0.5) + c * middle) * (1.0 + bias)
                if value < inverse[row, column]:
                    continue
                if opacity == 1.0:
                    inverse[row, column] = value
                for channel in range(3):
                    ground = float(picture[row, column, channel])
                    ground += opacity * (colours[k, channel] - ground)
                    picture[row, column, channel] = int(ground + 0.5)


def project(eye: Eye, points: Floats) -> Floats:
    """Column, row [px] and 1/Z [1/m] of world points (..., 3) [m]; 1/Z = 0 nearer than `near`."""
    x, y, z = np.moveaxis(points - np.array([eye.x, eye.y, eye.z]), -1, 0)
    ahead, aside = eye.cosine * x + eye.sine * y, eye.cosine * y - eye.sine * x
    visible = ahead >= eye.near
    inverse = np.where(visible, 1.0 / np.where(visible, ahead, 1.0), 0.0)
    columns, rows = eye.column - eye.focal * aside * inverse, eye.row - eye.focal * z * inverse
    return np.stack([columns, rows, inverse], axis=-1)


@loop
def soften(picture, threshold, out):
    """A copy (H, W, 3) whose hard edges are averaged with their neighbours.

    A pixel counts as edge where its brightness (sum of three channels) differs by more than
    `threshold` from that of a neighbour.
    """
    rows, columns = picture.shape[:2]
    out[:] = picture
    for row in range(1, rows - 1):
        for column in range(1, columns - 1):
            here = left = right = above = below = 0
            for c in range(3):
                here += int(picture[row, column, c])
                left += int(picture[row, column - 1, c])
                right += int(picture[row, column + 1, c])
                above += int(picture[row - 1, column, c])
                below += int(picture[row + 1, column, c])
            sideways = max(abs(left - here), abs(right - here))
            if max(sideways, abs(above - here), abs(below - here)) > threshold:
                for c in range(3):
                    value = 4 * int(picture[row, column, c]) + int(picture[row, column - 1, c])
                    value += int(picture[row, column + 1, c]) + int(picture[row - 1, column, c])
                    out[row, column, c] = (value + int(picture[row + 1, column, c]) + 4) // 8
