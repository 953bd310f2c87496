"""Pictures of the gallery: every plant, kind of terrain, policy and set of the leaderboards.

    python -m docs.gallery                    # all that are missing in docs/_static/gallery
    python -m docs.gallery plant-distributed  # this one again

Nothing is chosen by its looks: each picture is of the first frozen episode of its set (seed 0), the
whole of it, and of an agent with several trainings the first one drives.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import BenchmarkConfig, default_sets
from tracked_env.benchmark.policies import (
    by_name,
    default_names,
    load_policies,
    open_archive,
    registered_policies,
)
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.terrain.height_field import KINDS

FOLDER = Path(__file__).resolve().parent / "_static" / "gallery"
REPLAY = "replay.html"
STEPS = 15  # control steps from one picture to the next; of a clip one in CLIP_SHARE is kept
CLIP_SHARE = 2
BEHIND_STEPS = 50  # the same for a still from behind the vehicle, where a picture takes longer
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


# What drives on every set of an environment, and the set on which every policy is shown.
BASELINES = {TORQUE_ID: "adaptive", SPEED_ID: "slc-adaptive", TERRAIN_ID: "slc"}
VIEWS = {TORQUE_ID: "top", SPEED_ID: "top", TERRAIN_ID: "3d"}
# Kinds of terrain that need more than their name.
TERRAINS: dict[str, dict[str, Any]] = {
    "plane": {"slope_x": 0.2, "slope_y": 0.1},
    "ramp": {"slope": 0.3, "start": 0.0},
    "step": {"height": 0.2, "start": 0.3},
    "waves": {"waves": [[0.15, 0.8, 0.3, 0.0], [0.08, -0.5, 1.6, 1.0]]},
    "map": {
        "heights": [[0.0, 0.1, 0.3, 0.4], [0.1, 0.4, 0.5, 0.3], [0.0, 0.3, 0.2, 0.0]],
        "cell": 6.0, "interpolation": "bicubic",
    },
}  # fmt: skip


def plants() -> list[Shown]:
    """A clip of each plant, which are those of the pages on the ids too."""
    return [
        Shown("policy-adaptive", "`lumped`: closed-form traction and friction", TORQUE_ID,
              "adaptive", "payload", moving=True),
        Shown("plant-distributed", "`distributed`: patches under the tracks", TORQUE_ID,
              "adaptive", "distributed", moving=True),
        Shown("policy-slc-adaptive", "`distributed`, driven by sprocket speeds", SPEED_ID,
              "slc-adaptive", "friction-step", moving=True),
        Shown("policy-slc-on-hills", "`terrain`: six degrees of freedom", TERRAIN_ID, "slc",
              "hills-noisy", "3d", moving=True),
    ]  # fmt: skip


def sets(env: str) -> list[Shown]:
    """The end of the first episode of each set of the leaderboard."""
    policy, track = BASELINES[env], env.partition("/")[2].lower()
    return [
        Shown(f"set-{track}-{name}", f"`{name}`", env, policy, name, VIEWS[env])
        for name in default_sets(env)
    ]


def policies(env: str) -> list[Shown]:
    """Each policy of the leaderboard at the end of the first episode of its first set."""
    names = default_names(registered_policies(), env)
    track, first = env.partition("/")[2].lower(), default_sets(env)[0]
    return [Shown(f"driver-{track}-{name}", f"`{name}`", env, name, first) for name in names]


def prepared(shown: Shown) -> tuple[BenchmarkConfig, PolicyEntry]:
    """What the benchmark needs, as `tracked-env render` makes it."""
    config = BenchmarkConfig(sets=(shown.set,), episodes=1)
    registry, trained = by_name(registered_policies(), shown.env)
    return config, load_policies([shown.policy], registry, trained, open_archive)[0]


def draw(shown: Shown, path: Path) -> None:
    """Write the picture, or the clip, as WebP."""
    from PIL import Image

    from tracked_env.benchmark import video

    width = CLIP_WIDTH if shown.moving else STILL_WIDTH
    config, entry = prepared(shown)
    steps = STEPS if shown.moving or shown.view == "top" else BEHIND_STEPS
    drawn = video.pictures(config, entry, shown.set, 0, steps, shown.view)
    images = [Image.fromarray(picture) for picture in drawn]
    kept = images[::CLIP_SHARE] if shown.moving else images[-1:]
    small = [one.resize((width, round(width * one.height / one.width))) for one in kept]
    if shown.moving:
        small[0].save(path, save_all=True, append_images=small[1:], loop=0, method=4,
                      duration=round(1000.0 / CLIP_RATE), quality=CLIP_QUALITY)  # fmt: skip
    else:
        small[0].save(path, quality=STILL_QUALITY)


def terrain(kind: str) -> dict[str, Any]:
    """The specification of a kind that the gallery shows."""
    return {"kind": kind, **TERRAINS.get(kind, {})}


def draw_terrain(kind: str, path: Path) -> None:
    """A vehicle on a kind of terrain, after GROUND_STEPS straight on from the start of seed 0."""
    import gymnasium
    import numpy as np
    from PIL import Image

    from tracked_env.rendering import Renderer, source_of

    env = gymnasium.make(TERRAIN_ID, uncertainty="nominal", terrain=terrain(kind))
    env.reset(seed=0)
    for _ in range(GROUND_STEPS):
        env.step(np.array([0.3, 0.3], dtype=np.float32))
    simulation = env.unwrapped.simulation  # type: ignore[attr-defined]
    renderer = Renderer("rgb_array", 50, view="3d", terrain=source_of(simulation, 0))
    picture = renderer.draw(simulation, 0)
    assert picture is not None
    image = Image.fromarray(picture)
    image.resize((STILL_WIDTH, round(STILL_WIDTH * image.height / image.width))).save(
        path, quality=STILL_QUALITY
    )
    env.close()


def write_replay(shown: Shown, path: Path) -> None:
    """An episode as a page in which the eye can be moved."""
    from tracked_env.benchmark import video
    from tracked_env.rendering import viewer

    config, entry = prepared(shown)
    viewer.write_html(video.record_episode(config, entry, shown.set, 0), path)


def page() -> str:
    """The gallery as Markdown, below its head."""
    replayed, _, _ = plants()[-1].command.partition(" --view")
    parts = [
        "## Plants",
        cards(plants()),
        "## Replay in three dimensions",
        f'```{{raw}} html\n<iframe class="replay" src="{REPLAY}" loading="lazy" '
        'title="Replay of an episode on hills"></iframe>\n'
        f'<p><a href="{REPLAY}">Open it in a page of its own.</a> Drag to turn, scroll to come '
        "nearer. Where no graphics card draws, the first picture takes some seconds.</p>\n```",
        f"`{replayed} --html {REPLAY}`",
        "## Terrains",
        "Each kind of `terrain`, with the vehicle after 2 s straight on.",
        "{.cards}\n" + "\n".join(
            card(f"terrain-{kind}", f"Terrain {kind}", f"`{kind}`", f"terrain={terrain(kind)}")
            for kind in KINDS
        ),
    ]  # fmt: skip
    for env, policy in BASELINES.items():
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
    return "{.cards}\n" + "\n".join(
        card(one.name, f"{one.policy} on the set {one.set}", one.title, one.command)
        for one in shown
    )


def card(name: str, alternative: str, title: str, code: str) -> str:
    """One of them; without its picture as long as nobody has drawn it."""
    drawn = (FOLDER / f"{name}.webp").exists()
    picture = f"![{alternative}](_static/gallery/{name}.webp)" if drawn else "*not drawn yet*"
    return f"- {picture}\n\n  {title}\n\n  `{code}`"


def pictures() -> dict[str, tuple[Callable[[Any, Path], None], Any, str]]:
    """Name -> what draws it, of what, and the file."""
    jobs: dict[str, Any] = {one.name: (draw, one, f"{one.name}.webp") for one in plants()}
    jobs["replay"] = (write_replay, plants()[-1], REPLAY)
    jobs |= {f"terrain-{kind}": (draw_terrain, kind, f"terrain-{kind}.webp") for kind in KINDS}
    for env in BASELINES:
        shown = (*sets(env), *policies(env))
        jobs |= {one.name: (draw, one, f"{one.name}.webp") for one in shown}
    return jobs


def main(names: list[str]) -> int:
    """Draw those that are named, or all that are missing; returns the exit status."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    jobs = pictures()
    for name in names:
        if name not in jobs:
            print(
                f"{name}: no picture of the gallery; known are {', '.join(jobs)}", file=sys.stderr
            )
            return 2
    for name in names or [name for name, job in jobs.items() if not (FOLDER / job[2]).exists()]:
        make, what, file = jobs[name]
        make(what, FOLDER / file)
        print(f"{FOLDER / file}: {(FOLDER / file).stat().st_size / 1e3:.0f} kB", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
