"""The vehicle as flat polygons in its own frame: two tracks with pads and wheels, hull, cabin.

Lengths along and across are those of the parameters; heights, which the parameters do not hold, are
in shares of the contact length. The belt runs around a stadium: a straight run of the contact
length, half circles at both ends. Origin: centre of mass; the tracks stand on z = -centre_height.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from tracked_env.physics.parameters import PlantParameters
from tracked_env.rendering import canvas
from tracked_env.rendering.canvas import Colour
from tracked_env.rendering.hill_shading import AMBIENT, LIGHT
from tracked_env.rendering.scene import DECK, HULL, NOSE, PAD_PITCH

Points = NDArray[np.float64]

# In contact lengths:
BELT = 0.26  # height of a track
CLEARANCE = 0.10  # of the hull above the ground
DECK_HEIGHT = 0.34  # of the hull's top
CABIN_HEIGHT = 0.52
GAP = 0.02  # between track and hull
ARC = 6  # [-] edges of a half circle
WHEELS, SPOKES = 5, 10  # [-] wheels of a track, corners of a wheel
WINDOW: Colour = (58, 78, 96)
RUBBER: Colour = (46, 50, 54)
FLOOR, BRIGHT = 0.5, 1.1  # [-] brightness of a face in shade and of one that faces the light
PAD_SHARE = 0.4  # [-] of the belt that is pads


class Faces(NamedTuple):
    """Convex flat polygons; polygon k has the corners from starts[k] to starts[k + 1]."""

    corners: Points  # (V, 3) [m]
    starts: NDArray[np.int64]  # (K + 1,)
    colours: NDArray[np.uint8]  # (K, 3)
    inside: Points  # (K, 3) [m] a point behind each polygon, inside the body

    def lit(self, light: Sequence[float] = LIGHT) -> NDArray[np.uint8]:
        """Colours (K, 3) in the light; light: unit vector to it in the frame of the corners."""
        first = self.corners[self.starts[:-1]]
        second, third = (self.corners[self.starts[:-1] + k] for k in (1, 2))
        normals = np.cross(second - first, third - first)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
        outward = np.sign(np.sum(normals * (first - self.inside), axis=1))
        share = np.clip(outward * (normals @ np.asarray(light)), 0.0, None) / LIGHT[2]
        share = np.minimum(AMBIENT + (1.0 - AMBIENT) * share, 1.0)
        factor = FLOOR + (BRIGHT - FLOOR) * share
        return np.clip(np.round(factor[:, None] * self.colours), 0, 255).astype(np.uint8)


def joined(parts: Sequence[Faces]) -> Faces:
    """All polygons of several sets."""
    begin = np.cumsum([0, *(part.starts[-1] for part in parts)])
    starts = [part.starts[:-1] + at for part, at in zip(parts, begin, strict=False)]
    return Faces(
        np.concatenate([part.corners for part in parts]),
        np.concatenate([*starts, begin[-1:]]),
        np.concatenate([part.colours for part in parts]),
        np.concatenate([part.inside for part in parts]),
    )


def _faces(polygons: Sequence[tuple[Points, Colour]], inside: Sequence[float]) -> Faces:
    """A set from corners (k, 3) [m] and a colour each."""
    sizes = [len(corners) for corners, _ in polygons]
    return Faces(
        np.concatenate([corners for corners, _ in polygons]),
        np.cumsum([0, *sizes]),
        np.array([colour for _, colour in polygons], dtype=np.uint8),
        np.tile(np.asarray(inside, dtype=np.float64), (len(polygons), 1)),
    )


def _prism(profile: Sequence[tuple[float, float]], half: float) -> list[Points]:
    """Both ends, then the sides of an outline (x, z) [m] drawn from y = -half to y = half."""
    right, left = (np.array([(x, y, z) for x, z in profile]) for y in (-half, half))
    sides = [np.stack([right[k - 1], right[k], left[k], left[k - 1]]) for k in range(len(profile))]
    return [right, left, *sides]


def _around(p: PlantParameters) -> tuple[float, int]:
    """Length of the belt [m] and number of its pads."""
    length = p.contact_length
    around = 2.0 * length + math.pi * BELT * length
    return around, max(round(around / (PAD_PITCH * length)), 8)


def _on_belt(p: PlantParameters, place: Points) -> Points:
    """(x, z) [m] (P, 2) at places [m] (P,): below from front to rear, then above to the front."""
    length, radius = p.contact_length, 0.5 * BELT * p.contact_length
    arc = math.pi * radius
    place = place % (2.0 * length + 2.0 * arc)
    rear = np.clip((place - length) / radius, 0.0, math.pi)
    front = np.clip((place - 2.0 * length - arc) / radius, 0.0, math.pi)
    below = np.minimum(place, length)
    above = np.clip(place - length - arc, 0.0, length)
    x = 0.5 * length - below + above + radius * (np.sin(front) - np.sin(rear))
    z = radius * (1.0 - np.cos(rear)) - radius * (1.0 - np.cos(front))
    return np.stack([x, z], axis=1)


def _belt(
    p: PlantParameters,
    middle: float,
    slip: float,
    travel: float,
    loads: NDArray[np.uint8] | None = None,
) -> Faces:
    """The belt of one track, coloured by its slip, with pads; travel [m] of the upper belt.

    loads (nx, 3): colours of the loads from the rear to the front, which the belt above them
    takes; then only its pads have the colour of the slip.
    """
    around, pads = _around(p)
    length, half = p.contact_length, 0.5 * p.track_width
    pitch, arc = around / pads, 0.5 * math.pi * BELT * length
    pad = pitch * (np.arange(pads)[:, None] + np.array([0.0, PAD_SHARE])).ravel() + travel
    bends = np.linspace(0.0, arc, ARC + 1)
    edges = np.concatenate([pad % around, length + bends, 2.0 * length + arc + bends])
    edges = np.unique(np.round(edges % around, 9))
    ends = np.append(edges[1:], edges[0] + around)
    on_pad = (0.5 * (edges + ends) - travel) % pitch < PAD_SHARE * pitch
    start, end = _on_belt(p, edges), _on_belt(p, ends)
    corners = np.empty((edges.size, 4, 3))
    corners[:, (0, 3), 0], corners[:, (0, 3), 2] = start[:, :1], start[:, 1:]
    corners[:, (1, 2), 0], corners[:, (1, 2), 2] = end[:, :1], end[:, 1:]
    corners[:, :2, 1], corners[:, 2:, 1] = middle - half, middle + half
    colour = canvas.slip_colour(slip)
    if loads is None:
        colours = np.where(on_pad[:, None], canvas.shaded(colour), colour).astype(np.uint8)
    else:
        share = 0.5 * (start + end)[:, 0] / length + 0.5  # 0 at the rear, 1 at the front
        place = np.clip((share * len(loads)).astype(np.int64), 0, len(loads) - 1)
        colours = np.where(on_pad[:, None], np.array(colour, dtype=np.uint8), loads[place])
    inside = np.tile([0.0, middle, 0.5 * BELT * length], (edges.size, 1))
    return Faces(corners.reshape(-1, 3), 4 * np.arange(edges.size + 1), colours, inside)


def _wheels(p: PlantParameters, middle: float) -> Faces:
    """Side plates and road wheels of one track."""
    around, _ = _around(p)
    length, height = p.contact_length, BELT * p.contact_length
    outline = _on_belt(p, np.linspace(0.0, around, 40, endpoint=False)) * (1.0, 0.96)
    turn = np.linspace(0.0, 2.0 * math.pi, SPOKES, endpoint=False)
    polygons = []
    for half in (-0.5 * p.track_width, 0.5 * p.track_width):
        plate = np.insert(outline, 1, middle + 0.97 * half, axis=1)
        polygons.append((plate, RUBBER))
        for wheel in range(WHEELS):
            outer = wheel in (0, WHEELS - 1)
            x, z = length * (wheel / (WHEELS - 1) - 0.5), (0.5 if outer else 0.36) * height
            radius = (0.38 if outer else 0.26) * height
            y = np.full(SPOKES, middle + half)
            disc = np.stack([x + radius * np.cos(turn), y, z + radius * np.sin(turn)], axis=1)
            polygons.append((disc, DECK))
    return _faces(polygons, (0.0, middle, 0.5 * height))


def _hull(p: PlantParameters) -> Faces:
    """Hull between the tracks with a sloped front, arrow on the deck, cabin with windows."""
    length, reach = p.contact_length, 0.5 * p.contact_length
    inner = max(0.5 * (p.track_gauge - p.track_width) - GAP * length, 0.05 * length)
    low, deck, top = CLEARANCE * length, DECK_HEIGHT * length, CABIN_HEIGHT * length
    belly = [
        (-1.05 * reach, low), (0.85 * reach, low), (1.15 * reach, 0.6 * deck),
        (0.85 * reach, deck), (-1.15 * reach, deck),
    ]  # fmt: skip
    polygons = [(corners, HULL) for corners in _prism(belly, inner)]
    arrow = [(0.80 * reach, 0.0), (0.45 * reach, 0.6 * inner), (0.45 * reach, -0.6 * inner)]
    lift = deck + 0.006 * length
    polygons.append((np.array([(x, y, lift) for x, y in arrow]), NOSE))
    cabin = [
        (-0.95 * reach, deck), (-0.85 * reach, top), (0.05 * reach, top), (0.30 * reach, deck)
    ]  # fmt: skip
    for k, corners in enumerate(_prism(cabin, 0.82 * inner)):
        polygons.append((corners, DECK))
        if k in (0, 1, 3, 5):  # right, left, rear, front
            middle = corners.mean(axis=0)
            outward = middle - (-0.35 * reach, 0.0, middle[2])
            outward *= 0.008 * length / np.linalg.norm(outward)
            polygons.append((middle + 0.7 * (corners - middle) + outward, WINDOW))
    return _faces(polygons, (-0.2 * reach, 0.0, 0.7 * deck))


@lru_cache(maxsize=8)
def _rigid(p: PlantParameters) -> Faces:
    """What does not move against the body."""
    middle = 0.5 * p.track_gauge
    return joined([_wheels(p, middle), _wheels(p, -middle), _hull(p)])


def vehicle_faces(
    p: PlantParameters,
    centre_height: float,
    slips: Sequence[float],
    travel: Sequence[float],
    loads: NDArray[np.uint8] | None = None,
) -> Faces:
    """All polygons in the body's frame; (left, right): slips [-] colour, travel [m] moves pads.

    loads (2, nx, 3): colours of the loads along both tracks; None: belts show the slip alone.
    """
    sides = 0.5 * p.track_gauge, -0.5 * p.track_gauge
    under = (None, None) if loads is None else (loads[0], loads[1])
    belts = [_belt(p, *side) for side in zip(sides, slips, travel, under, strict=True)]
    faces = joined([_rigid(p), *belts])
    down = np.array([0.0, 0.0, centre_height])
    return faces._replace(corners=faces.corners - down, inside=faces.inside - down)
