"""Pictures of the gallery: every plant, kind of terrain, policy and set of the leaderboards.

    python -m docs.gallery                    # all that are missing in docs/_static/gallery
    python -m docs.gallery plant-distributed  # this one again

Nothing is chosen by its looks: each picture is of the first frozen episode of its set (seed 0), the
whole of it, and of an agent with several trainings the first one drives.
"""

import sys
from collections import defaultdict
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from PIL import Image

from tracked_env import SPEED_ID, TERRAIN_ID, TORQUE_ID
from tracked_env.benchmark import BenchmarkConfig, default_sets, figures
from tracked_env.benchmark.policies import default_names, policies_for, registered_policies
from tracked_env.benchmark.policy_interface import PolicyEntry
from tracked_env.benchmark.tuning import read_candidates, undominated
from tracked_env.terrain.height_field import KINDS

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "_static" / "gallery"
CURVES = "../learning_curves.png"
REPLAY = "replay.html"
STEPS, BEHIND_STEPS = 12, 50  # control steps between pictures; for a still from behind the vehicle
CLIP_SHARE, CLIP_RATE = 3, 8.0  # one picture in so many is in a clip; [1/s] of them
WIDTH = 650  # [px] of pictures, whose texts then have 10 px
CLIP_QUALITY, STILL_QUALITY = 50, 25  # of WebP
AGENTS = ROOT / "baselines" / "learned" / "pretrained" / "Torque-v0"
FLEET = (
    *("inspection-robot", "eod-robot", "bomb-disposal-robot", "mini-excavator", "infantry-ugv"),
    *("tracked-tractor", "crawler-dozer", "m113", "infantry-fighting-vehicle", "main-battle-tank"),
)
GROUND_STEPS = 100  # [control steps] straight on, before the picture of a terrain


class Card(NamedTuple):
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

    @property
    def episode(self) -> tuple[BenchmarkConfig, PolicyEntry, str, int]:
        """What the benchmark needs, as `tracked-env render` makes it."""
        config = BenchmarkConfig(sets=(self.set,), episodes=1)
        return config, policies_for(self.env, [self.policy])[0], self.set, 0


# What drives on every set of an environment, and how it is seen.
BASELINES = {TORQUE_ID: ("adaptive", "top"), SPEED_ID: ("slc-adaptive", "top")}
BASELINES |= {TERRAIN_ID: ("slc", "3d")}
# Where all policies of an environment are seen.
OF_POLICIES = {TORQUE_ID: "outages-alternating", SPEED_ID: "floor-outages-alternating"}
OF_POLICIES |= {TERRAIN_ID: "hills-outages"}
LUMPED, PATCHES = "`lumped`: closed-form traction", "`distributed`: patches under the tracks"
BELTS, SPACE = "`distributed`, driven by sprocket speeds", "`terrain`: six degrees of freedom"
# A clip of each plant, which are those of the pages on the ids too.
PLANTS = [
    Card("policy-adaptive", LUMPED, TORQUE_ID, "adaptive", "payload", "top", True),
    Card("plant-distributed", PATCHES, TORQUE_ID, "adaptive", "distributed", "top", True),
    Card("policy-slc-adaptive", BELTS, SPEED_ID, "slc-adaptive", "friction-step", "top", True),
    Card("policy-slc-on-hills", SPACE, TERRAIN_ID, "slc", "hills-noisy", "3d", True),
]
# Kinds of terrain that need more than their name.
HILLS = [[0.0, 0.1, 0.3, 0.4], [0.1, 0.4, 0.5, 0.3], [0.0, 0.3, 0.2, 0.0]]
TERRAINS: dict[str, dict[str, Any]] = {
    "plane": {"slope_x": 0.2, "slope_y": 0.1},
    "ramp": {"slope": 0.3, "start": 0.0},
    "step": {"height": 0.2, "start": 0.3},
    "waves": {"waves": [[0.15, 0.8, 0.3, 0.0], [0.08, -0.5, 1.6, 1.0]]},
    "map": {"heights": HILLS, "cell": 6.0, "interpolation": "bicubic"},
}


def ground(kind: str) -> dict[str, Any]:
    """The specification of a kind of terrain that the gallery shows."""
    return {"kind": kind, **TERRAINS.get(kind, {})}


def sets(env: str) -> list[Card]:
    """The end of the first episode of each set of the leaderboard."""
    (policy, view), track = BASELINES[env], env.partition("/")[2].lower()
    names = default_sets(env)
    return [Card(f"set-{track}-{name}", f"`{name}`", env, policy, name, view) for name in names]


def policies(env: str) -> list[Card]:
    """Each policy of the leaderboard at the end of the first episode of one set."""
    names = default_names(registered_policies(), env)
    track = env.partition("/")[2].lower()
    return [
        Card(f"driver-{track}-{name}", f"`{name}`", env, name, OF_POLICIES[env]) for name in names
    ]


def _resized(picture: np.ndarray) -> Image.Image:
    image = Image.fromarray(picture)
    return image.resize((WIDTH, round(WIDTH * image.height / image.width)))


def draw(card: Card, path: Path) -> None:
    """Write the picture, or the clip, as WebP; the replay as a page where the eye can be moved."""
    from tracked_env.benchmark import video
    from tracked_env.rendering import viewer

    if path.name == REPLAY:
        viewer.write_html(video.record_episode(*card.episode), path)
        return
    steps = STEPS if card.moving or card.view == "top" else BEHIND_STEPS
    pictures = video.pictures(*card.episode, steps, card.view)
    if not card.moving:
        _resized(list(pictures)[-1]).save(path, quality=STILL_QUALITY, method=6)
        return
    first, *others = (_resized(picture) for picture in list(pictures)[::CLIP_SHARE])
    clip = {"save_all": True, "append_images": others, "duration": round(1000.0 / CLIP_RATE)}
    # kmax = 0: no key frames, which encode anew what stands still and so make it flicker
    first.save(path, loop=0, method=4, quality=CLIP_QUALITY, kmax=0, **clip)


def draw_terrain(kind: str, path: Path) -> None:
    """A vehicle on a kind of terrain, after GROUND_STEPS straight on from the start of seed 0."""
    from tracked_env.rendering import Renderer, source_of

    env = gymnasium.make(TERRAIN_ID, uncertainty="nominal", terrain=ground(kind))
    env.reset(seed=0)
    for _ in range(GROUND_STEPS):
        env.step(np.array([0.3, 0.3], dtype=np.float32))
    simulation = env.unwrapped.simulation  # type: ignore[attr-defined]
    renderer = Renderer("rgb_array", 50, view="3d", terrain=source_of(simulation, 0))
    picture = renderer.draw(simulation, 0)
    assert picture is not None
    _resized(picture).save(path, quality=STILL_QUALITY, method=6)
    env.close()


def pictures() -> dict[str, tuple[str, Callable[[Path], None]]]:
    """Name -> the file, and what draws it."""
    cards = [*PLANTS, *(card for env in BASELINES for card in (*sets(env), *policies(env)))]
    jobs = {card.name: (f"{card.name}.webp", partial(draw, card)) for card in cards}
    jobs["replay"] = REPLAY, partial(draw, PLANTS[-1])
    for kind in KINDS:
        jobs[f"terrain-{kind}"] = f"terrain-{kind}.webp", partial(draw_terrain, kind)
    return jobs


REPLAYED = f"""\
```{{raw}} html
<iframe class="replay" src="{REPLAY}" loading="lazy" title="Replay of an episode on hills"></iframe>
<p><a href="{REPLAY}">Open it in a page of its own.</a> Drag to turn, scroll to come nearer.</p>
```

`{PLANTS[-1].command.partition(" --view")[0]} --file {REPLAY}`"""


def page() -> str:
    """The gallery as Markdown, below its head."""
    grounds = [
        (f"terrain-{kind}", f"Terrain {kind}", f"`{kind}`", f"terrain={ground(kind)}")
        for kind in KINDS
    ]
    end = "The end of the first episode of"
    parts = [
        *("## Plants", listing(PLANTS), "## Replay in three dimensions", REPLAYED),
        "## Terrains\n\nEach kind of `terrain`, with the vehicle after 2 s straight on.",
        _listed(grounds),
    ]
    for env, (policy, _) in BASELINES.items():
        track = env.partition("/")[2]
        parts += [
            f"## Sets of {track}\n\n{end} each set of the leaderboard; `{policy}` drives.",
            listing(sets(env)),
            f"## Policies of {track}\n\n{end} the set `{OF_POLICIES[env]}`: the driven path is "
            "black, the reference blue. How good a policy is: [results](results.md).",
            listing(policies(env)),
        ]
    return "\n\n".join(parts) + "\n"


def learning_curves(path: Path) -> None:
    """Draw the error on held-out episodes over steps and over processor time, of shipped agents.

    Read from the curve.csv beside each; thick lines are the median of the seeds, pale ones each.
    """
    from matplotlib.ticker import FixedLocator

    curves = defaultdict(list)
    for file in sorted(AGENTS.parent.glob("*/*-seed*/curve.csv")):
        curve = np.genfromtxt(file, delimiter=",", names=True)
        if "held_out_rmse" not in curve.dtype.names:
            continue  # of imitation, by rounds
        measured = curve[np.isfinite(curve["held_out_rmse"])]
        agent = f"{file.parent.parent.name} {file.parent.name.rpartition('-seed')[0]}"
        budgets = measured["steps"] / 1e6, measured["cpu_seconds"] / 60.0
        curves[agent].append((budgets, measured["held_out_rmse"]))
    ticks = (0.05, 0.2, 1, 4), (0.1, 0.3, 1, 3)
    with figures.picture(path, 5.2) as figure:
        both = figure.subplots(1, 2, sharey=True)
        for k, axes in enumerate(both):
            for number, (agent, seeds) in enumerate(curves.items()):
                for budgets, rmse in seeds:
                    axes.plot(budgets[k], rmse, color=f"C{number}", alpha=0.25, linewidth=0.8)
                count = min(len(rmse) for _, rmse in seeds)
                columns = [(budgets[k][:count], rmse[:count]) for budgets, rmse in seeds]
                middle = np.median(columns, axis=0)
                axes.plot(*middle, color=f"C{number}", linewidth=1.8, label=agent)
            axes.set(xscale="log", yscale="log")
            axes.xaxis.set_major_locator(FixedLocator(ticks[k]))
            axes.yaxis.set_major_locator(FixedLocator((0.03, 0.1, 0.3, 1, 3)))
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_formatter("{x:g}")
                axis.set_minor_formatter("")
        both[0].set(xlabel="steps [million]", ylabel="held-out RMSE of the distance [m]")
        both[1].set_xlabel("processor time [min]")
        names = both[0].get_legend_handles_labels()
        figure.legend(*names, loc="outside lower center", ncols=2)


def tuning_curves(path: Path) -> None:
    """Draw error against action rate of each search of settings on Torque-v0 in results/tuning.

    Those settings of which no other has less error at no more rate; a ring: the default.
    """
    files = sorted((ROOT / "results" / "tuning").glob("*-torque-v0-*.csv"))
    with figures.picture(path, 4.0) as figure:
        axes = figure.subplots()
        for number, file in enumerate(files):
            name = file.name.partition("-torque-v0-")[0]
            found = [one for _, _, one in read_candidates(file) if one is not None]
            best = undominated(found)
            points = [(one.mean("rate") / 1e3, one.cost) for one in [*best, found[0]]]
            axes.plot(*zip(*points[:-1], strict=True), f"C{number}.-", label=name, linewidth=1.2)
            axes.plot(*points[-1], f"C{number}o", fillstyle="none", markersize=9)
        axes.set(xscale="log", yscale="log", xlabel="action rate [kN m/s]", ylabel="J [m]")
        for axis in (axes.xaxis, axes.yaxis):
            figures.plain_ticks(axis, (1.0, 1.5, 2.0, 3.0, 5.0, 7.0))
        axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def course_of(vehicle: str) -> np.ndarray:
    """Reference and position of a vehicle of the catalogue under `any-vehicle`, (steps, 2, 2) [m].

    Seed 0, on ground of `any-soil`; the course is 40 s long.
    """
    from tracked_env.benchmark.policy_interface import PolicyContext
    from tracked_env.vector_env import TrackedVehicleVectorEnv

    env = TrackedVehicleVectorEnv(
        1, vehicle=vehicle, uncertainty="any-soil", reference="random", duration=40.0
    )
    context = PolicyContext(0.02, "sliding", env.simulation.settings.sensors)
    policy: Any = policies_for(TORQUE_ID, ["any-vehicle"])[0].make(context)
    observation, _ = env.reset(seed=0)
    state, column, rows = None, env.simulation.batch.column, []
    for _ in range(round(40.0 / 0.02) - 1):
        action, state = policy.predict(observation, state)
        observation, *_ = env.step(action)
        pair = ("reference_x", "reference_y"), ("x", "y")
        rows.append([[column(of)[0] for of in each] for each in pair])
    env.close()
    return np.array(rows)


def ten_vehicles(path: Path) -> None:
    """Draw ten vehicles of the catalogue on one course, each scaled to it, under one policy.

    It is never told which it drives.
    """
    from tracked_env.vehicles import find_vehicle

    names = sorted(FLEET, key=lambda name: find_vehicle(name).contact_length)
    with figures.picture(path, 4.6) as figure:
        for axes, name in zip(figure.subplots(2, 5).flat, names, strict=True):
            vehicle, way = find_vehicle(name), course_of(name)
            away = np.hypot(*(way[250:, 0] - way[250:, 1]).T)
            axes.plot(*way[:, 0].T, color="0.75", linewidth=4.0)
            axes.plot(*way[:, 1].T, color="C0", linewidth=1.2)
            wide = 0.5 * np.ptp(way[:, 0], axis=0).max() + vehicle.contact_length
            middle = 0.5 * (way[:, 0].max(axis=0) + way[:, 0].min(axis=0))
            axes.set(
                xlim=middle[0] + [-wide, wide],
                ylim=middle[1] + [-0.98 * wide, 0.98 * wide],
                aspect="equal",
            )
            axes.plot(
                middle[0] + [-wide * 0.9, vehicle.contact_length - wide * 0.9],
                middle[1] - [wide * 0.94, wide * 0.94],
                color="k",
                linewidth=3.0,
            )
            axes.set_axis_off()
            error = 100.0 * np.sqrt(np.mean(away**2))
            mass = f"{vehicle.mass:,.0f} kg".replace(",", " ")
            axes.set_title(f"{name}\n{mass}\nerror {error:.1f} cm", fontsize="medium")


def listing(cards: list[Card]) -> str:
    """A list that the style sheet shows as cards."""
    return _listed([(c.name, f"{c.policy} on the set {c.set}", c.title, c.command) for c in cards])


def _listed(cards: list[tuple[str, ...]]) -> str:
    """Of (name of the picture, what it shows, title, code); some are not drawn yet."""
    lines = ["{.cards}"]
    for name, alternative, title, code in cards:
        exists = (FOLDER / f"{name}.webp").exists()
        # a width makes it a link to the file; the style sheet shows a card its left two thirds
        link = f'![{alternative}](_static/gallery/{name}.webp){{width="150%"}}'
        picture = link if exists else "*not drawn yet*"
        lines.append(f"- {picture}\n\n  {title}\n\n  `{code}`")
    return "\n".join(lines)


if __name__ == "__main__":  # those that are named, or all that are missing
    JOBS = {**pictures(), "learning-curves": (CURVES, learning_curves)}
    JOBS["ten-vehicles"] = "../ten_vehicles.png", ten_vehicles
    JOBS["tuning-curves"] = ("../tuning_curves.png", tuning_curves)
    missing = [name for name, (file, _) in JOBS.items() if not (FOLDER / file).exists()]
    for name in sys.argv[1:] or missing:
        file, make = JOBS[name]
        make(FOLDER / file)
        print(f"{FOLDER / file}: {(FOLDER / file).stat().st_size / 1e3:.0f} kB", flush=True)
