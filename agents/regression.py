"""Regression of a gated network on driven episodes, round by round (DAgger [1]).

A `Task` drives the episodes of each round, from the second on with the network in the loop, and
says what its outputs should be. Truncated back-propagation through time goes on with the state that
is carried from one chunk of control steps to the next. Every eighth episode is held out. The same
command goes on where it was stopped: data, network and optimiser lie in its folder.

References: [1] Ross et al., arXiv:1011.0686.
"""

import argparse
import csv
import io
import json
import math
import sys
import time
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from baselines.learned.trained_agent import FORMAT, RECIPE, WEIGHTS
from tracked_env import TORQUE_ID
from tracked_env.benchmark.executors import WorkerPool
from tracked_env.benchmark.files import machine, versions, write_atomically

# Episodes are seeded far from those of the benchmark and of the trainings of train.py.
FIRST_SEED, ROWS = 2**40, 2**16
HELD_OUT = 8  # every one so many is
DURATION = 30.0  # [s] of an episode
PERIOD = 0.02  # [s] of control
HIDDEN = 128  # of the recurrent layer and of the one behind it
LARGEST_GRADIENT = 1.0  # [-] norm
AVERAGED = 0.998  # [-] share of the mean of the weights that a gradient step keeps


class Job(NamedTuple):
    """Episodes that are driven together."""

    number: int
    first: int  # seed of its first episode
    count: int  # type: ignore[assignment]  # of episodes
    driven: bool  # by what the network says
    round: int = 0


class Episodes(NamedTuple):
    """Driven episodes: E of them, of T control steps."""

    features: Any  # (E, T, F)
    targets: Any  # (E, T, Y)
    lengths: Any  # (E,) control steps


class Task(Protocol):
    """What is learned."""

    network: "GatedNetwork"
    job: int  # [episodes] driven together
    driven: float  # share of the jobs of later rounds that the network drives
    averages: bool  # whether the mean of late weights drives

    @property
    def columns(self) -> Sequence[str]:
        """Names of what `report` answers."""
        ...

    def drive(self, network: Any, job: Job) -> Episodes:
        """The episodes of a job; network: Layers, or None before the first regression."""
        ...

    def layers(self, weights: Any) -> Any:
        """Layers of the network in the loop."""
        ...

    def schedule(self, number: int, epoch: int) -> tuple[float, int]:
        """Learning rate, and control steps of a chunk."""
        ...

    def epochs(self, number: int) -> int:
        """Of a round."""
        ...

    def losses(self, x: Any, y: Any, valid: Any, state: Any) -> tuple[Any, Any, Any]:
        """Loss, the part of it that is reported, and the state after a chunk."""
        ...

    def report(self, regression: "Regression") -> list[float]:
        """How well it does on what is held out."""
        ...

    def finish(self, regression: "Regression") -> None:
        """After the last round."""
        ...

    def recipe(self) -> dict[str, Any]:
        """What an archive says of its kind."""
        ...


class GatedNetwork(nn.Module):
    """`baselines.learned.gated_network` in PyTorch, on standardised features.

    mask (F,): 0 for features that it does not see. further: outputs that are not in the archive.
    """

    mean: torch.Tensor
    factor: torch.Tensor

    def __init__(
        self, outputs: int, further: int, mask: torch.Tensor, recurrent: bool = True
    ) -> None:
        super().__init__()
        inputs = len(mask)
        self.recurrent = recurrent
        self.gru = nn.GRU(inputs, HIDDEN)
        self.middle = nn.Linear(HIDDEN + inputs, HIDDEN)
        self.last = nn.Linear(HIDDEN, outputs)
        self.auxiliary = nn.Linear(HIDDEN, further)
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("factor", mask.clone())

    def standardise(self, features: torch.Tensor) -> None:
        """See features (K, F) as numbers of mean 0 and deviation 1, those that change."""
        self.mean.copy_(features.mean(0))
        self.factor.copy_((self.factor > 0.0) / features.std(0).clamp(min=0.1))

    def forward(self, x: torch.Tensor, state: Any = None) -> tuple[torch.Tensor, ...]:
        """Outputs (T, B, Y), further ones, and the state after x (T, B, F)."""
        x = (x - self.mean) * self.factor
        if self.recurrent:
            h, state = self.gru(x, state)
        else:
            h = self.gru(x.reshape(1, -1, x.shape[-1]))[0].reshape(*x.shape[:2], HIDDEN)
        middle = torch.relu(self.middle(torch.cat([h, x], dim=-1)))
        return self.last(middle), self.auxiliary(middle), state

    def weights(self, kind: Any = np.float16) -> dict[str, NDArray[Any]]:
        """Weights for `layers_of`, on features as they are, of a kind of number."""
        with torch.no_grad():
            state = {name: value.double().cpu() for name, value in self.state_dict().items()}
            mean, factor = state.pop("mean"), state.pop("factor")
            for name, bias, first in (
                ("gru.weight_ih_l0", "gru.bias_ih_l0", 0),
                ("middle.weight", "middle.bias", HIDDEN),
            ):
                state[name][:, first:] *= factor
                state[bias] -= state[name][:, first:] @ mean
            return {
                name: value.numpy().astype(kind)
                for name, value in state.items()
                if not name.startswith("auxiliary")
            }


class LowPass:
    """First-order low passes of sequences, e(t) = e(t - 1) + a (r(t) - e(t - 1)).

    constants: tau [s], a = h / (tau + h).
    """

    def __init__(self, constants: Sequence[float], device: torch.device) -> None:
        self._shares = [PERIOD / (tau + PERIOD) for tau in constants]
        self._matrices: dict[int, list[tuple[torch.Tensor, torch.Tensor]]] = {}
        self._device = device

    def __call__(self, r: torch.Tensor, before: Any = None) -> list[torch.Tensor]:
        """Of each constant (T, B, C), from r (T, B, C); before: their values one step earlier."""
        count = r.shape[0]
        if count not in self._matrices:
            steps = torch.arange(count, device=self._device, dtype=torch.float32)
            since = steps[:, None] - steps
            self._matrices[count] = [
                (a * (1.0 - a) ** since.clamp(min=0.0) * (since >= 0.0), (1.0 - a) ** (steps + 1.0))
                for a in self._shares
            ]
        passed = [torch.einsum("ts,sbc->tbc", kernel, r) for kernel, _ in self._matrices[count]]
        if before is None:
            return passed
        of = zip(passed, self._matrices[count], before, strict=True)
        return [each + decay[:, None, None] * last for each, (_, decay), last in of]


class Regression:
    """Optimiser and the data of all rounds so far, on one device."""

    def __init__(self, options: Any, task: Task) -> None:
        self.options, self.task, self.device = options, task, torch.device(options.device)
        self.network = task.network.to(self.device)
        self.optimiser = torch.optim.Adam(self.network.parameters(), fused=True)
        self.mean: Any = AveragedModel(
            self.network, multi_avg_fn=get_ema_multi_avg_fn(AVERAGED)
        ).requires_grad_(False)
        self.parts: list[tuple[Any, Any, Any, Any]] = []  # on the device, and what is held out

    @property
    def best(self) -> "GatedNetwork":
        """What drives and is reported: with the mean of the weights of late, or with the last."""
        network: GatedNetwork = self.mean.module if self.task.averages else self.network
        return network

    def add(self, episodes: Episodes, held_out: NDArray[np.bool_]) -> None:
        """Data of a round."""
        arrays: Any = [torch.from_numpy(np.asarray(each)).to(self.device) for each in episodes]
        if not self.parts:
            self.network.standardise(arrays[0][:, ::10].flatten(0, 1).float())
        self.parts.append((*arrays, held_out))

    def batches(
        self, held_out: bool, rng: Any, size: int, last: bool = False
    ) -> Iterator[tuple[Any, ...]]:
        """Episodes of one round each, in an order of `rng`; of the last round alone?"""
        batches = []
        for part in self.parts[-1:] if last else self.parts:
            rows = np.flatnonzero(part[3] == held_out)
            if rng is not None:
                rng.shuffle(rows)
            batches += [(part, rows[at : at + size]) for at in range(0, len(rows), size)]
        if rng is not None:
            rng.shuffle(batches)
        for (features, targets, lengths, _), rows in batches:
            chosen = torch.from_numpy(rows).to(self.device)
            yield (*(each[chosen].transpose(0, 1) for each in (features, targets)), lengths[chosen])

    def epoch(self, number: int, epoch: int) -> float:
        """Once through what is not held out, `most` episodes before the last round; the mean of
        the loss that is reported."""
        rng = np.random.default_rng([self.options.seed, number, epoch])
        task = self.task
        rate, chunk = task.schedule(number, epoch)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        total, seen = torch.zeros((), device=self.device), 0
        most = self.options.most if number < self.options.rounds else 0
        enough = most // self.options.batch if most else None
        for features, targets, lengths in islice(
            self.batches(False, rng, self.options.batch), enough
        ):
            state = None
            for at in range(0, features.shape[0], chunk):
                x, y = features[at : at + chunk].float(), targets[at : at + chunk].float()
                steps = torch.arange(at, at + x.shape[0], device=self.device)
                valid = (steps[:, None] < lengths).float()[..., None]
                loss, shown, state = task.losses(x, y, valid, state)
                self.optimiser.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(self.network.parameters(), LARGEST_GRADIENT)
                self.optimiser.step()
                if task.averages:
                    self.mean.update_parameters(self.network)
                total, seen = total + shown, seen + 1
        return float(total) / seen


def one_of(rng: np.random.Generator, choices: Any) -> Any:
    """A value by its odds."""
    odds, values = zip(*choices, strict=True)
    return values[int(rng.choice(len(values), p=odds))]


def say(text: str, began: float) -> None:
    """A line of progress."""
    print(f"[{time.perf_counter() - began:6.0f} s] {text}", flush=True)


def jobs_of(options: Any, task: Any, number: int) -> list[Job]:
    """The jobs of a round of a training."""
    episodes = options.episodes if number == 0 else options.further
    rng = np.random.default_rng([options.seed, number])
    first = FIRST_SEED + ROWS * (16 * options.seed + number)
    share = task.driven if number > 0 else 0.0
    return [
        Job(k, first + at, min(task.job, episodes - at), bool(rng.random() < share), number)
        for k, at in enumerate(range(0, episodes, task.job))
    ]


def drive_round(
    options: Any, task: Task, number: int, network: Any
) -> tuple[Episodes, NDArray[np.bool_]]:
    """Episodes of a round, and which of them are held out; read where they were driven before."""
    jobs, path = jobs_of(options, task, number), options.output / f"round{number}.npz"
    held_out = np.arange(sum(job.count for job in jobs)) % HELD_OUT == HELD_OUT - 1
    if path.is_file():
        with np.load(path) as stored:
            return Episodes(*(stored[name] for name in Episodes._fields)), held_out
    began, parts = time.perf_counter(), dict[int, Episodes]()
    results: Iterator[tuple[int, Episodes]] = (
        (k, task.drive(network, job)) for k, job in enumerate(jobs)
    )
    if options.processes > 1:
        results = WorkerPool(options.processes).results(task.drive, network, jobs)
    for k, part in results:
        parts[k] = part
        if len(parts) % max(len(jobs) // 8, 1) == 0:
            say(f"round {number}: {len(parts)} of {len(jobs)} jobs driven", began)
    columns_of = zip(*(parts[k] for k in sorted(parts)), strict=True)
    whole = Episodes(*(np.concatenate(each) for each in columns_of))
    np.savez(path.with_suffix(".part.npz"), **whole._asdict())
    path.with_suffix(".part.npz").rename(path)
    return whole, held_out


def recipe_of(options: Any, own: Mapping[str, Any]) -> dict[str, Any]:
    """What an archive says of itself; own: of its kind."""
    return {
        "format": FORMAT, "algorithm": None, "normalisation": None,
        "control_period": PERIOD, "environment": {"id": TORQUE_ID}, **own,
        "config": {k: str(v) if isinstance(v, Path) else v for k, v in vars(options).items()},
        "versions": versions() | {"torch": torch.__version__}, "machine": machine(),
    }  # fmt: skip


def archive(weights: Any, recipe: Any) -> bytes:
    """The content of agent.zip."""
    arrays, whole = io.BytesIO(), io.BytesIO()
    np.savez(arrays, **weights)
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(RECIPE, json.dumps(recipe, indent=1))
        file.writestr(WEIGHTS, arrays.getvalue())
    return whole.getvalue()


def train(options: Any, task: Task) -> None:
    """All rounds, from where the last run of the same command stopped; then the archive."""
    options.output.mkdir(parents=True, exist_ok=True)
    began, checkpoint = time.perf_counter(), options.output / "checkpoint.pt"
    regression = Regression(options, task)
    done: tuple[int, int] = 0, 0
    curve: list[list[Any]] = []
    stored: Any = None
    if checkpoint.is_file():
        stored = torch.load(checkpoint, map_location=options.device, weights_only=True)
        done, curve = tuple(stored["done"]), stored["curve"]
    for number in range(options.rounds + 1):
        network = None
        if number > 0:
            path = options.output / f"weights{number}.npz"
            if not path.is_file():
                np.savez(path, **regression.best.weights())  # type: ignore[arg-type]
            with np.load(path) as weights:
                network = task.layers({**weights})
        regression.add(*drive_round(options, task, number, network))
        if stored is not None and done[0] == number:
            regression.network.load_state_dict(stored["network"])
            regression.mean.load_state_dict(stored["mean"])
            regression.optimiser.load_state_dict(stored["optimiser"])
        for epoch in range(task.epochs(number)):
            if (number, epoch) < done:
                continue
            loss, report = regression.epoch(number, epoch), task.report(regression)
            if not math.isfinite(loss):
                sys.exit(f"the training diverged in epoch {epoch} of round {number}")
            curve.append([number, epoch, round(loss, 5), *np.round(report, 4).tolist()])
            shown = ", ".join(
                f"{name} {value:.3f}"
                for name, value in [*zip(task.columns, report, strict=True)][:8]
            )
            say(f"round {number}, epoch {epoch}: loss {loss:.4f}, {shown}", began)
            state = {"network": regression.network.state_dict(), "done": [number, epoch + 1]}
            state |= {"mean": regression.mean.state_dict(), "curve": curve}
            state |= {"optimiser": regression.optimiser.state_dict()}
            torch.save(state, checkpoint.with_suffix(".part"))
            checkpoint.with_suffix(".part").rename(checkpoint)
    task.finish(regression)
    recipe = recipe_of(options, task.recipe())
    write_atomically(options.output / "agent.zip", archive(regression.best.weights(), recipe))
    (options.output / "config.json").write_text(json.dumps(recipe, indent=1) + "\n", "utf-8")
    with (options.output / "curve.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["round", "epoch", "loss", *task.columns])
        writer.writerows(curve)
    say(f"done; {options.output / 'agent.zip'}", began)


def count_of(text: str) -> int:
    """A whole number of at least 1 from the command line. Raises argparse.ArgumentTypeError."""
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}; must be a whole number of at least 1")
    return int(text)


class _Defaults(argparse.ArgumentDefaultsHelpFormatter):
    """Says the default of every option that has a value."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        named = action.nargs != 0 and not action.required
        return super()._get_help_string(action) if named else action.help


def parser_of(description: str, **defaults: Any) -> argparse.ArgumentParser:
    """The options that all these trainings have; defaults: by name."""
    parser = argparse.ArgumentParser(description=description, formatter_class=_Defaults)
    add = parser.add_argument
    add("--output", type=Path, required=True, help="folder of this training")
    add("--seed", type=int, default=0, help="of everything random")
    add("--device", default="cpu", help="of torch, cpu or cuda")
    add("--processes", type=count_of, default=1, help="that drive episodes")
    add("--threads", type=count_of, default=1, help="of torch")
    add("--episodes", type=count_of, help="of the first round")
    add("--further", type=count_of, help="of every later round")
    add("--rounds", type=int, help="later rounds, with the network in the loop")
    add("--epochs", type=count_of, help="of each regression")
    add("--most", type=int, default=0, help="episodes of an epoch before the last round, 0 = all")
    add("--batch", type=count_of, help="episodes of a gradient step")
    add("--chunk", type=count_of, default=75, help="control steps of a gradient step")
    add("--rate", type=float, default=2e-3, help="learning rate at the beginning")
    add("--feed-forward", dest="recurrent", action="store_false", help="forget at every step")
    parser.set_defaults(**defaults)
    return parser
