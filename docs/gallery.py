"""Pictures of the gallery: every plant, kind of terrain, policy and set of the leaderboards.

    python -m docs.gallery                    # all that are missing in docs/_static/gallery
    python -m docs.gallery plant-distributed  # this one again

Nothing is chosen by its looks: each picture is of the first frozen episode of its set (seed 0), the
whole of it, and of an agent with several trainings the first one drives.
"""

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from PIL import Image

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import BenchmarkConfig, default_sets
from tracked_env.benchmark.policies import default_names, policies_for, registered_policies
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.terrain.height_field import KINDS

FOLDER = Path(__file__).resolve().parent / "_static" / "gallery"
REPLAY = "replay.html"
STEPS, BEHIND_STEPS = 15, 50  # control steps between pictures; for a still from behind the vehicle
CLIP_SHARE = 2  # of the pictures of a clip one in so many is kept
CLIP_RATE = 8.0  # [1/s] pictures of a clip
CLIP_WIDTH, STILL_WIDTH = 600, 480  # [px]
CLIP_QUALITY, STILL_QUALITY = 40, 65  # of WebP
GROUND_STEPS = 100  # [control steps] straight on, before the picture of a terrain


class Shown(NamedTuple):
    """A policy in the first episode of a set."""

    name: str  # of the file
    title: str
    env: str
    policy: str
    set: str
    view: str = "top"
    moving: bool = False

    @property
    def command(self) -> str:
        """What shows the same episode."""
        env = "" if self.env == TORQUE_ID else f" --env {self.env.partition('/')[2]}"
        view = "" if self.view == "top" else f" --view {self.view}"
        return f"tracked-env render {self.policy}{env} --set {self.set}{view}"

    def prepared(self) -> tuple[BenchmarkConfig, PolicyEntry]:
        """What the benchmark needs, as `tracked-env render` makes it."""
        entry = policies_for(self.env, [self.policy])[0]
        return BenchmarkConfig(sets=(self.set,), episodes=1), entry


# What drives on every set of an environment, and how it is seen.
BASELINES = {
    TORQUE_ID: ("adaptive", "top"),
    SPEED_ID: ("slc-adaptive", "top"),
    TERRAIN_ID: ("slc", "3d"),
}
# A clip of each plant, which are those of the pages on the ids too: file, title, episode, view.
PLANTS = [
    Shown(*row, moving=True)
    for row in (
        ("policy-adaptive", "`lumped`: closed-form traction and friction", TORQUE_ID, "adaptive",
         "payload", "top"),
        ("plant-distributed", "`distributed`: patches under the tracks", TORQUE_ID, "adaptive",
         "distributed", "top"),
        ("policy-slc-adaptive", "`distributed`, driven by sprocket speeds", SPEED_ID,
         "slc-adaptive", "friction-step", "top"),
        ("policy-slc-on-hills", "`terrain`: six degrees of freedom", TERRAIN_ID, "slc",
         "hills-noisy", "3d"),
    )
]  # fmt: skip
# Kinds of terrain that need more than their name.
HILLS = [[0.0, 0.1, 0.3, 0.4], [0.1, 0.4, 0.5, 0.3], [0.0, 0.3, 0.2, 0.0]]
TERRAINS: dict[str, dict[str, Any]] = {
    "plane": {"slope_x": 0.2, "slope_y": 0.1},
    "ramp": {"slope": 0.3, "start": 0.0},
    "step": {"height": 0.2, "start": 0.3},
    "waves": {"waves": [[0.15, 0.8, 0.3, 0.0], [0.08, -0.5, 1.6, 1.0]]},
    "map": {"heights": HILLS, "cell": 6.0, "interpolation": "bicubic"},
}


def sets(env: str) -> list[Shown]:
    """The end of the first episode of each set of the leaderboard."""
    (policy, view), track = BASELINES[env], env.partition("/")[2].lower()
    return [
        Shown(f"set-{track}-{name}", f"`{name}`", env, policy, name, view)
        for name in default_sets(env)
    ]


def policies(env: str) -> list[Shown]:
    """Each policy of the leaderboard at the end of the first episode of its first set."""
    names = default_names(registered_policies(), env)
    track, first = env.partition("/")[2].lower(), default_sets(env)[0]
    return [Shown(f"driver-{track}-{name}", f"`{name}`", env, name, first) for name in names]


def _resized(image: Image.Image, width: int) -> Image.Image:
    return image.resize((width, round(width * image.height / image.width)))


def draw(shown: Shown, path: Path) -> None:
    """Write the picture, or the clip, as WebP."""
    from tracked_env.benchmark import video

    steps = STEPS if shown.moving or shown.view == "top" else BEHIND_STEPS
    config, entry = shown.prepared()
    drawn = video.pictures(config, entry, shown.set, 0, steps, shown.view)
    images = [Image.fromarray(picture) for picture in drawn]
    if not shown.moving:
        _resized(images[-1], STILL_WIDTH).save(path, quality=STILL_QUALITY)
        return
    first, *others = (_resized(image, CLIP_WIDTH) for image in images[::CLIP_SHARE])
    clip = {"save_all": True, "append_images": others, "duration": round(1000.0 / CLIP_RATE)}
    first.save(path, loop=0, method=4, quality=CLIP_QUALITY, **clip)


def terrain(kind: str) -> dict[str, Any]:
    """The specification of a kind that the gallery shows."""
    return {"kind": kind, **TERRAINS.get(kind, {})}


def draw_terrain(kind: str, path: Path) -> None:
    """A vehicle on a kind of terrain, after GROUND_STEPS straight on from the start of seed 0."""
    from tracked_env.rendering import Renderer, source_of

    env = gymnasium.make(TERRAIN_ID, uncertainty="nominal", terrain=terrain(kind))
    env.reset(seed=0)
    for _ in range(GROUND_STEPS):
        env.step(np.array([0.3, 0.3], dtype=np.float32))
    simulation = env.unwrapped.simulation  # type: ignore[attr-defined]
    renderer = Renderer("rgb_array", 50, view="3d", terrain=source_of(simulation, 0))
    picture = renderer.draw(simulation, 0)
    assert picture is not None
    _resized(Image.fromarray(picture), STILL_WIDTH).save(path, quality=STILL_QUALITY)
    env.close()


def write_replay(shown: Shown, path: Path) -> None:
    """An episode as a page in which the eye can be moved."""
    from tracked_env.benchmark import video
    from tracked_env.rendering import viewer

    viewer.write_html(video.record_episode(*shown.prepared(), shown.set, 0), path)


def page() -> str:
    """The gallery as Markdown, below its head."""
    replayed, _, _ = PLANTS[-1].command.partition(" --view")
    grounds = [
        card(f"terrain-{kind}", f"Terrain {kind}", f"`{kind}`", f"terrain={terrain(kind)}")
        for kind in KINDS
    ]
    parts = [
        "## Plants",
        cards(PLANTS),
        "## Replay in three dimensions",
        f'```{{raw}} html\n<iframe class="replay" src="{REPLAY}" loading="lazy" '
        'title="Replay of an episode on hills"></iframe>\n'
        f'<p><a href="{REPLAY}">Open it in a page of its own.</a> Drag to turn, scroll to come '
        "nearer. Where no graphics card draws, the first picture takes some seconds.</p>\n```",
        f"`{replayed} --html {REPLAY}`",
        "## Terrains",
        "Each kind of `terrain`, with the vehicle after 2 s straight on.",
        "{.cards}\n" + "\n".join(grounds),
    ]
    for env, (policy, _) in BASELINES.items():
        track = env.partition("/")[2]
        parts += [
            f"## Sets of {track}",
            f"The end of the first episode of each set of the leaderboard; `{policy}` drives.",
            cards(sets(env)),
            f"## Policies of {track}",
            f"The end of the same episode, the first one of the set `{default_sets(env)[0]}`: the "
            "driven path is black, the reference blue. One episode shows how a policy drives, not "
            "how good it is; that is in the [results](results.md).",
            cards(policies(env)),
        ]
    return "\n\n".join(parts) + "\n"


def cards(shown: list[Shown]) -> str:
    """A list that the style sheet shows as cards."""
    texts = [(one.name, f"{one.policy} on the set {one.set}", one.title) for one in shown]
    lines = [card(*text, one.command) for text, one in zip(texts, shown, strict=True)]
    return "{.cards}\n" + "\n".join(lines)


def card(name: str, alternative: str, title: str, code: str) -> str:
    """One of them; without its picture as long as nobody has drawn it."""
    drawn = (FOLDER / f"{name}.webp").exists()
    picture = f"![{alternative}](_static/gallery/{name}.webp)" if drawn else "*not drawn yet*"
    return f"- {picture}\n\n  {title}\n\n  `{code}`"


def pictures() -> dict[str, tuple[str, Callable[[Path], None]]]:
    """Name -> the file, and what draws it."""
    shown = [*PLANTS, *(one for env in BASELINES for one in (*sets(env), *policies(env)))]
    jobs = {one.name: (f"{one.name}.webp", partial(draw, one)) for one in shown}
    jobs["replay"] = REPLAY, partial(write_replay, PLANTS[-1])
    for kind in KINDS:
        jobs[f"terrain-{kind}"] = f"terrain-{kind}.webp", partial(draw_terrain, kind)
    return jobs


def main(names: list[str]) -> int:
    """Draw those that are named, or all that are missing; returns the exit status."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    jobs = pictures()
    if unknown := [name for name in names if name not in jobs]:
        known = ", ".join(jobs)
        print(f"{unknown[0]}: no picture of the gallery; known are {known}", file=sys.stderr)
        return 2
    for name in names or [name for name, (file, _) in jobs.items() if not (FOLDER / file).exists()]:
        file, make = jobs[name]
        make(FOLDER / file)
        print(f"{FOLDER / file}: {(FOLDER / file).stat().st_size / 1e3:.0f} kB", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
