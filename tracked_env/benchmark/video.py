"""One episode of a policy as a picture (PNG), a film (MP4, WebP, GIF), and a recording for a page.

A policy that identifies has its beliefs in the panel, beside the truth. Needs the extra `render`,
the page the extra `viewer` too.
"""

import os
import tempfile
import zlib
from collections.abc import Iterator
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from tracked_env.benchmark.benchmark_config import BenchmarkConfig
from tracked_env.benchmark.files import file_name
from tracked_env.benchmark.policy_interface import (
    Policy,
    PolicyEntry,
    blamed,
    checked_policy,
    identifies,
    needs_truth,
)
from tracked_env.benchmark.runner import steps_of
from tracked_env.engine.simulation import Simulation

if TYPE_CHECKING:
    from tracked_env.rendering.viewer import Recording

Picture = NDArray[np.uint8]  # (height, width, 3)
# Suffix of a file: one picture in this many control steps is drawn.
FORMATS = {".mp4": 1, ".webp": 5, ".gif": 5, ".png": 5}
# Suffix of a film that is encoded while it is drawn: what the encoder needs.
_ENCODED: dict[str, dict[str, Any]] = {
    ".mp4": {"output_params": ["-crf", "23"]},
    ".webp": {"codec": "libwebp_anim", "output_params": ["-loop", "0", "-quality", "75"]},
}


def record(
    config: BenchmarkConfig, entry: PolicyEntry, uncertainty_set: str, episode: int, folder: Path
) -> Path:
    """Record one episode of the benchmark as MP4; returns the file. Raises as `draw`."""
    seed = config.first_seed(uncertainty_set) + episode
    path = folder / f"{file_name(uncertainty_set, entry.name)}--seed-{seed}.mp4"
    draw(config, entry, uncertainty_set, episode, path)
    return path


def draw(
    config: BenchmarkConfig,
    entry: PolicyEntry,
    uncertainty_set: str,
    episode: int,
    path: Path,
    view: str = "top",
    at: float | None = None,
) -> None:
    """Draw one episode of the benchmark, the same vehicle, soil, reference and noise.

    path: with a suffix of FORMATS; view: as `rendering.Renderer` has it; at: time [s] that a PNG
    shows, None for the end. Raises ImportError that names the extra to install, ValueError for
    another suffix, view or time.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise ValueError(f"file {path}: must end in {', '.join(FORMATS)} or .html")
    steps, length = FORMATS[suffix], config.max_steps(uncertainty_set) / config.control_rate
    if at is not None and suffix != ".png":
        raise ValueError(f"file {path}: must end in .png where a time is given")
    if at is not None and not 0.0 <= at <= length:
        raise ValueError(f"time = {at:g} s; must be in [0, {length:g}] s, the episode")
    count = None if at is None else round(at * config.control_rate / steps) + 1
    film = islice(pictures(config, entry, uncertainty_set, episode, steps, view), count)
    path.parent.mkdir(parents=True, exist_ok=True)
    ending = f".{os.getpid()}.tmp"  # as `files.temporary` has it: a later run removes what is left
    with tempfile.TemporaryDirectory(prefix=".video", suffix=ending, dir=path.parent) as place:
        new = Path(place) / f"new{suffix}"
        try:
            _write(new, film, config.control_rate / steps)
        except (ImportError, gymnasium.error.DependencyNotInstalled) as error:
            message = f"{error}; pictures need pip install 'tracked-env[render]'"
            raise ImportError(message) from error
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
    from tracked_env.rendering import Renderer, source_of

    renderer: Renderer | None = None
    for simulation, policy in _driven(config, entry, uncertainty_set, episode, steps):
        if renderer is None:
            terrain = source_of(simulation, 0)
            renderer = Renderer("rgb_array", round(config.control_rate), view=view, terrain=terrain)
        picture = renderer.draw(simulation, 0, beliefs_of(policy))
        assert picture is not None
        yield picture


def record_episode(
    config: BenchmarkConfig, entry: PolicyEntry, uncertainty_set: str, episode: int
) -> "Recording":
    """One episode of the benchmark for `rendering.viewer`; raises ImportError as `draw` does."""
    from tracked_env.rendering import Recorder, source_of

    recorder: Recorder | None = None
    for simulation, _ in _driven(config, entry, uncertainty_set, episode, 1):
        recorder = recorder or Recorder(source_of(simulation, 0))
        recorder.add(simulation)
    assert recorder is not None
    return recorder.finish()


def _write(path: Path, film: Iterator[Picture], rate: float) -> None:
    """Write pictures, `rate` a second, in the format of the suffix."""
    if path.suffix == ".gif":
        _write_gif(path, film, rate)
    elif path.suffix == ".png":
        *_, last = film
        Image.fromarray(last).save(path)
    else:  # encoded one by one; the size need not be a multiple of 16
        from imageio_ffmpeg import write_frames

        first = next(film)
        options = {"ffmpeg_log_level": "error", "quality": None, "macro_block_size": 2}
        options |= _ENCODED[path.suffix]
        encoder = write_frames(str(path), first.shape[1::-1], fps=rate, **options)
        encoder.send(None)
        try:
            for picture in chain([first], film):
                encoder.send(np.ascontiguousarray(picture))
        finally:
            encoder.close()


def _write_gif(path: Path, film: Iterator[Picture], rate: float) -> None:
    """One palette of 256 colours for the whole film, so that nothing changes its colour between two
    pictures. The colours of quantities are in it, whatever share of the pictures they have.
    """
    from tracked_env.rendering.canvas import QUANTITY_COLOURS

    packed, is_used = [], np.zeros(2**24, dtype=bool)  # colours as 0xRRGGBB
    for picture in film:
        packed.append(zlib.compress(picture.tobytes(), 1))
        is_used[picture @ np.array([2**16, 2**8, 1])] = True
    colours = np.flatnonzero(is_used)
    rows = np.stack([colours >> 16, colours >> 8 & 255, colours & 255], axis=-1).astype(np.uint8)
    count = 256 - len(QUANTITY_COLOURS)
    common = Image.fromarray(rows[None]).quantize(count, method=Image.Quantize.MEDIANCUT)
    entries = [*np.ravel(QUANTITY_COLOURS).tolist(), *(common.getpalette() or [])]
    palette = Image.new("P", (1, 1))
    palette.putpalette(entries[: 3 * 256])

    def frames() -> Iterator[Image.Image]:
        for each in packed:
            pixels = np.frombuffer(zlib.decompress(each), np.uint8).reshape(picture.shape)
            yield Image.fromarray(pixels).quantize(palette=palette, dither=Image.Dither.NONE)

    shown, duration = frames(), round(1000.0 / rate)  # [ms]
    next(shown).save(path, save_all=True, append_images=shown, duration=duration, loop=0)


def _driven(
    config: BenchmarkConfig, entry: PolicyEntry, uncertainty_set: str, episode: int, steps: int
) -> Iterator[tuple[Simulation, Policy]]:
    """Drive one episode; stops at the start, after each `steps` control steps, and at the end."""
    policy = checked_policy(entry, config.context(uncertainty_set, episode))
    env = config.environment(uncertainty_set, 1, needs_truth(policy), episode)
    seeds = [config.first_seed(uncertainty_set) + episode]
    options = config.options(uncertainty_set, [episode])
    try:
        for done, step in enumerate(steps_of(policy, env, seeds, options=options)):
            if step.over.all() or done % steps == 0:
                yield env.simulation, policy
    except (Exception, SystemExit) as error:
        raise blamed(error, entry.name, f"video of set {uncertainty_set!r}") from error
    finally:
        env.close()


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
