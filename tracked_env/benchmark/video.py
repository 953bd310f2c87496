"""Pictures of one episode, of one policy or of several side by side, MP4, GIF or PNG, or a page
that replays it. A policy that identifies has its beliefs in the panel, beside the truth.

Needs the extra `render`, the page the extra `viewer` too.
"""

import os
import tempfile
import zlib
from collections.abc import Iterator, Sequence
from itertools import chain, islice, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.files import file_name
from tracked_env.benchmark.policy_interface import (
    Policy,
    PolicyEntry,
    blamed,
    checked_answer,
    checked_policy,
    identifies,
    needs_truth,
    tell_plant,
)
from tracked_env.env import TrackedVehicleEnv

if TYPE_CHECKING:
    from tracked_env.rendering.viewer import Recording

Picture = NDArray[np.uint8]  # (height, width, 3)

# Suffix of a file: one picture in this many control steps is drawn.
MOST = 4  # policies in one picture
FORMATS = {".mp4": 1, ".gif": 5, ".png": 5}


def record(
    config: BenchmarkConfig, entry: PolicyEntry, uncertainty_set: str, episode: int, folder: Path
) -> Path:
    """Record one episode of the benchmark as MP4 in a folder.

    Returns the file. Raises as `draw`.
    """
    name = file_name(uncertainty_set, entry.name)
    path = folder / f"{name}--seed-{config.seed + episode}.mp4"
    draw(config, entry, uncertainty_set, episode, path)
    return path


def draw(
    config: BenchmarkConfig,
    entries: PolicyEntry | Sequence[PolicyEntry],
    uncertainty_set: str,
    episode: int,
    path: Path,
    view: str = "top",
    at: float | None = None,
) -> None:
    """Draw one episode of the benchmark, the same vehicle, soil, reference and noise.

    entries: one policy, or 2 to MOST, side by side under their names; one whose episode ends early
    stays on its last picture. path: with a suffix of FORMATS; view: as `rendering.Renderer` has it;
    at: time [s] that a PNG shows, None for the end. Raises ImportError that names the extra to
    install, ValueError for another suffix, view, time or number of policies.
    """
    entries = [entries] if isinstance(entries, PolicyEntry) else list(entries)
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(f"file {path}: must end in {', '.join(FORMATS)}")
    if not 1 <= len(entries) <= MOST:
        raise ValueError(f"{len(entries)} policies in one picture; must be 1 to {MOST}")
    steps, length = FORMATS[suffix], config.max_steps(uncertainty_set) / config.control_rate
    if at is not None and suffix != ".png":
        raise ValueError(f"file {path}: must end in .png where a time is given")
    if at is not None and not 0.0 <= at <= length:
        raise ValueError(f"time = {at:g} s; must be in [0, {length:g}] s, the episode")
    count = None if at is None else round(at * config.control_rate / steps) + 1
    films = [
        islice(pictures(config, entry, uncertainty_set, episode, steps, view), count)
        for entry in entries
    ]
    path.parent.mkdir(parents=True, exist_ok=True)
    ours = f".{os.getpid()}.tmp"  # as `files.temporary` has it: a later run removes what is left
    with tempfile.TemporaryDirectory(prefix=".video", suffix=ours, dir=path.parent) as place:
        new = Path(place) / f"new{suffix}"
        try:
            names = [entry.name for entry in entries]
            _write(new, _beside(names, films), config.control_rate / steps)
        except (ImportError, gymnasium.error.DependencyNotInstalled) as error:
            raise ImportError(
                f"{error}; pictures need pip install 'tracked-env[render]'"
            ) from error
        os.replace(new, path)


def pictures(
    config: BenchmarkConfig,
    entry: PolicyEntry,
    uncertainty_set: str,
    episode: int,
    steps: int,
    view: str = "top",
) -> Iterator[Picture]:
    """Pictures of one episode: at the start, after each `steps` control steps, and at the end.

    Raises as `draw`.
    """
    policy = checked_policy(entry, config.context(uncertainty_set))
    env = TrackedVehicleEnv(**config.arguments(uncertainty_set, needs_truth(policy)))
    driven = _driven(env, policy, entry.name, uncertainty_set, config.seed + episode, steps)
    return _pictures(env, policy, driven, view)


def record_episode(
    config: BenchmarkConfig, entry: PolicyEntry, uncertainty_set: str, episode: int
) -> "Recording":
    """One episode of the benchmark for `rendering.viewer`; raises ImportError as `draw` does."""
    from tracked_env.rendering import Recorder, source_of

    policy = checked_policy(entry, config.context(uncertainty_set))
    env = TrackedVehicleEnv(**config.arguments(uncertainty_set, needs_truth(policy)))
    recorder = Recorder(source_of(env.simulation, 0))
    for _ in _driven(env, policy, entry.name, uncertainty_set, config.seed + episode, 1):
        recorder.add(env.simulation)
    return recorder.finish()


def _write(path: Path, film: Iterator[Picture], rate: float) -> None:
    """Write pictures, `rate` a second, in the format of the suffix."""
    if path.suffix == ".mp4":
        from imageio_ffmpeg import write_frames

        first = next(film)
        height, width = first.shape[:2]
        # quality as the encoder's default; the size need not be a multiple of 16
        encoder = write_frames(
            str(path), (width, height), fps=rate, quality=None, macro_block_size=2,
            ffmpeg_log_level="error", output_params=["-crf", "23"],
        )  # fmt: skip
        encoder.send(None)
        try:
            for picture in chain([first], film):
                encoder.send(np.ascontiguousarray(picture))
        finally:
            encoder.close()
        return
    from PIL import Image

    if path.suffix == ".png":
        *_, last = film
        Image.fromarray(last).save(path)
        return
    packed, colours = [], np.zeros(2**24, dtype=bool)
    for picture in film:
        packed.append(zlib.compress(picture.tobytes(), 1))
        colours[picture @ np.array([2**16, 2**8, 1])] = True
    shape, palette = picture.shape, _palette(np.flatnonzero(colours))

    def frames() -> Iterator[Any]:
        for each in packed:
            pixels = np.frombuffer(zlib.decompress(each), np.uint8).reshape(shape)
            yield Image.fromarray(pixels).quantize(palette=palette, dither=Image.Dither.NONE)

    shown = frames()
    start = next(shown)
    duration = round(1000.0 / rate)  # [ms]
    start.save(path, save_all=True, append_images=shown, duration=duration, loop=0)


def _palette(colours: NDArray[np.int64]) -> Any:
    """An image with 256 colours for a whole film, so that nothing changes its colour between two
    pictures. colours: all that occur, as 0xRRGGBB.

    Those of quantities are among them, whatever share of the pictures they have.
    """
    from PIL import Image

    from tracked_env.rendering.canvas import QUANTITY_COLOURS

    rows = np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=-1).astype(np.uint8)
    count = 256 - len(QUANTITY_COLOURS)
    common = Image.fromarray(rows[None]).quantize(count, method=Image.Quantize.MEDIANCUT)
    entries = [*np.ravel(QUANTITY_COLOURS).tolist(), *(common.getpalette() or [])]
    palette = Image.new("P", (1, 1))
    palette.putpalette(entries[: 3 * 256])
    return palette


def _driven(
    env: TrackedVehicleEnv, policy: Policy, name: str, uncertainty_set: str, seed: int, steps: int
) -> Iterator[None]:
    """Drive one episode; stops at the start, after each `steps` control steps, and at the end."""
    observation, info = env.reset(seed=seed)
    tell_plant(policy, env.simulation.solver.reads.names)
    try:
        yield
        state, start, over, done = None, np.ones(1, dtype=bool), False, 0
        while not over:
            try:
                action, state = _acted(policy, observation, info, state, start)
            except (Exception, SystemExit) as error:
                raise blamed(error, name, f"video of set {uncertainty_set!r}") from error
            start = np.zeros(1, dtype=bool)
            observation, _, terminated, truncated, info = env.step(action)
            over, done = terminated or truncated, done + 1
            if over or done % steps == 0:
                yield
    finally:
        env.close()


def _beside(names: Sequence[str], films: Sequence[Iterator[Picture]]) -> Iterator[Picture]:
    """The pictures of several films side by side under their names, until the last film ends."""
    if len(films) == 1:
        yield from films[0]
        return
    from tracked_env.rendering.canvas import side_by_side

    shown: list[Picture] = []
    for drawn in zip_longest(*films):
        shown = [shown[k] if new is None else new for k, new in enumerate(drawn)]
        yield side_by_side(names, shown)


def beliefs_of(policy: Policy) -> dict[str, tuple[float, float]] | None:
    """(value, standard deviation) by parameter of the one vehicle; None where nothing is ever
    believed."""
    if not identifies(policy):
        return None
    estimates = policy.estimates()  # type: ignore[attr-defined]
    return {
        name: (float(np.asarray(value)[0]), float(np.asarray(deviation)[0]))
        for name, (value, deviation) in estimates.items()
    }


def _pictures(
    env: TrackedVehicleEnv, policy: Policy, driven: Iterator[None], view: str
) -> Iterator[Picture]:
    """A picture at each stop of an episode."""
    from tracked_env.rendering import Renderer, source_of

    renderer = Renderer(
        "rgb_array", env.metadata["render_fps"], view=view, terrain=source_of(env.simulation, 0)
    )
    for _ in driven:
        picture = renderer.draw(env.simulation, 0, beliefs_of(policy))
        assert picture is not None
        yield picture


def _acted(
    policy: Policy, observation: Any, info: dict[str, Any], state: Any, start: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], Any]:
    """Action (2,) and the policy's state."""
    if needs_truth(policy):
        policy.observe_truth(  # type: ignore[attr-defined]
            {key: np.array([value]) for key, value in info["truth"].items()}
        )
    answer = policy.predict(observation[None], state, start, deterministic=True)
    action, state = checked_answer(answer, 1)
    return action[0], state
