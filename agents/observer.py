"""Train a learned observer (`baselines.learned.learned_observer`) from driven episodes.

    python -m agents.observer --seed 0 --output runs/learned-observer-seed0 --processes 2
Rounds of two steps each, and at the end the archive agent.zip:
    drive     episodes of every law, kind of sensors, reference and plant of `driven_episodes`,
              under controllers whose gains are drawn, so that the network is tied to none. From the
              second round on, 80 % of them with the network in the loop: it learns from what it
              then meets (DAgger [1])
    regress   true motion less the shown one, in the units of the filter, by a Huber loss of what
              is left, of its slow parts and of its changes: a controller follows an error that
              lasts, and answers a jump with torque. Beside it the logarithm of the deviation of
              what is left (Gaussian likelihood) and, as an auxiliary task, the errors of the
              identified parameters. Truncated back-propagation through time with a state that is
              carried on
Every eighth episode is held out; on those of the last round the claimed deviations are scaled, so
that COVERED of the errors are within WITHIN of them. The same command goes on where it was stopped.
Needs torch, and no other library for training; `--device cuda` keeps all data on the device.

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
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from agents.driven_episodes import BASE, GAINS, PARAMETERS, Episodes, drive_round, say
from baselines.learned.agent_policy import OBSERVER
from baselines.learned.learned_observer import (
    DISAGREEMENTS,
    FEATURES,
    LIMIT,
    MOTION,
    SPREADS,
    layers_of,
)
from baselines.learned.trained_agent import FORMAT, RECIPE, WEIGHTS
from tracked_env import TORQUE_ID
from tracked_env.benchmark.files import machine, versions, write_atomically

COVERED, WITHIN = 0.975, 2.5  # [-] of errors, deviations
# Time constants [s] of the low passes of what is left, and what makes its size that of the whole.
SLOW = ((0.3, 1.5), (1.0, 2.5), (3.0, 4.0))
FAST = 3.0  # [-] the same of its change in a control step, which a controller answers with torque
# [-] of each of MOTION in the loss, by what its truth is worth to predictive control: positions
# nearly everything, the forward speed a part; lateral speed and yaw rate hardly anything.
IMPORTANCE = (2.0, 2.0, 0.5, 1.0, 0.1, 0.2)
HIDDEN = 128  # of the recurrent layer and of the one behind it
AUXILIARY, SPREAD_WEIGHT = 0.05, 0.1  # [-] of the losses beside that of the motion
LARGEST_GRADIENT = 1.0  # [-] norm


class ObserverNetwork(nn.Module):
    """The network of an observer in PyTorch, on standardised features.

    mask (F,): 0 for features that it does not see.
    """

    mean: torch.Tensor
    factor: torch.Tensor

    def __init__(self, recurrent: bool, mask: torch.Tensor) -> None:
        super().__init__()
        inputs = len(FEATURES)
        self.recurrent = recurrent
        self.gru = nn.GRU(inputs, HIDDEN)
        self.middle = nn.Linear(HIDDEN + inputs, HIDDEN)
        self.last = nn.Linear(HIDDEN, 2 * len(MOTION))
        self.auxiliary = nn.Linear(HIDDEN, len(PARAMETERS) + len(GAINS))
        nn.init.zeros_(self.last.weight)
        nn.init.zeros_(self.last.bias)
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("factor", mask.clone())

    def standardise(self, features: torch.Tensor) -> None:
        """See features (K, F) as numbers of mean 0 and deviation 1, those that change."""
        self.mean.copy_(features.mean(0))
        self.factor.copy_((self.factor > 0.0) / features.std(0).clamp(min=0.1))

    def forward(self, x: torch.Tensor, state: Any = None) -> tuple[torch.Tensor, ...]:
        """Outputs (T, B, 12), parameters (T, B, 6) and the state after x (T, B, F)."""
        x = (x - self.mean) * self.factor
        if self.recurrent:
            h, state = self.gru(x, state)
        else:
            h = self.gru(x.reshape(1, -1, x.shape[-1]))[0].reshape(*x.shape[:2], HIDDEN)
        middle = torch.relu(self.middle(torch.cat([h, x], dim=-1)))
        return self.last(middle), self.auxiliary(middle), state

    def weights(self) -> dict[str, NDArray[np.float16]]:
        """Weights for `layers_of`, on features as they are, rounded to half precision."""
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
                name: value.numpy().astype(np.float16)
                for name, value in state.items()
                if not name.startswith("auxiliary")
            }


class LowPass:
    """First-order low passes of sequences, e(t) = e(t - 1) + a (r(t) - e(t - 1)), by SLOW."""

    def __init__(self, period: float, device: torch.device) -> None:
        self._shares = [(period / (tau + period), gain) for tau, gain in SLOW]
        self._matrices: dict[int, list[tuple[torch.Tensor, torch.Tensor]]] = {}
        self._device = device

    def __call__(self, r: torch.Tensor, before: Any = None) -> list[torch.Tensor]:
        """Of each of SLOW (T, B, 6), from r (T, B, 6); before: their values one step earlier."""
        count = r.shape[0]
        if count not in self._matrices:
            steps = torch.arange(count, device=self._device, dtype=torch.float32)
            since = steps[:, None] - steps
            self._matrices[count] = [
                (a * (1.0 - a) ** since.clamp(min=0.0) * (since >= 0.0), (1.0 - a) ** (steps + 1.0))
                for a, _ in self._shares
            ]
        passed = [torch.einsum("ts,sbc->tbc", kernel, r) for kernel, _ in self._matrices[count]]
        if before is None:
            return passed
        of = zip(passed, self._matrices[count], before, strict=True)
        return [each + decay[:, None, None] * last for each, (_, decay), last in of]


def losses_of(
    network: ObserverNetwork, low_pass: LowPass, x: Any, y: Any, valid: Any, state: Any
) -> tuple[torch.Tensor, torch.Tensor, Any]:
    """Loss, the part of the motion, and the state after x (T, B, F), targets y, valid (T, B, 1)."""
    carried, slow = (None, None) if state is None else state
    out, parameters, carried = network(x, carried)
    size = len(MOTION)
    shown, spread = out[..., :size], out[..., size:].clamp(*SPREADS)
    true, count = y[..., :size], valid.sum().clamp(min=1.0)
    left = (true - shown) * valid
    slow = low_pass(left, slow)
    parts = [left, *(gain * each * valid for each, (_, gain) in zip(slow, SLOW, strict=True))]
    parts.append(FAST * (left[1:] - left[:-1]) * valid[1:])
    importance, motion = left.new_tensor(IMPORTANCE), left.new_zeros(())
    for part in parts:
        losses = nn.functional.huber_loss(part, torch.zeros_like(part), reduction="none")
        motion = motion + (importance * losses).sum() / (count * importance.sum())
    square = (true - shown.detach().clamp(-LIMIT, LIMIT)) ** 2
    likelihood = spread + 0.5 * square * torch.exp(-2.0 * spread)
    beside = nn.functional.smooth_l1_loss(parameters, y[..., size:], reduction="none")
    loss = motion + SPREAD_WEIGHT * ((likelihood * valid).sum() / count / size)
    loss = loss + AUXILIARY * ((beside * valid).sum() / count / beside.shape[-1])
    last = [each[-1].detach() for each in slow]
    return loss, motion.detach(), (None if carried is None else carried.detach(), last)


class Regression:
    """Network, optimiser and the data of all rounds so far, on one device."""

    def __init__(self, options: Any) -> None:
        self.options, self.device = options, torch.device(options.device)
        torch.manual_seed(options.seed)
        torch.set_num_threads(options.threads)
        mask = torch.ones(len(FEATURES))
        if not options.innovations:
            mask[[FEATURES.index(name) for name in DISAGREEMENTS]] = 0.0
        self.network = ObserverNetwork(options.recurrent, mask).to(self.device)
        self.low_pass = LowPass(0.02, self.device)
        self.optimiser = torch.optim.Adam(self.network.parameters(), fused=True)
        self.parts: list[tuple[Any, Any, Any, Any]] = []  # on the device, and what is held out

    def add(self, episodes: Episodes, held_out: NDArray[np.bool_]) -> None:
        """Data of a round."""
        arrays: Any = [torch.from_numpy(np.asarray(each)).to(self.device) for each in episodes]
        if not self.parts:
            self.network.standardise(arrays[0][:, ::10].flatten(0, 1).float())
        self.parts.append((*arrays, held_out))

    def _batches(self, held_out: bool, rng: Any, size: int) -> Iterator[tuple[Any, ...]]:
        """Episodes of one round each, in an order of `rng`."""
        batches = []
        for part in self.parts:
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
        """Once through all that is not held out; returns the mean loss of the motion."""
        o, rng = self.options, np.random.default_rng([self.options.seed, number, epoch])
        share = epoch / o.epochs
        rate = (o.rate if number == 0 else 0.5 * o.rate) * (0.05 + 0.95 * (1.0 - share))
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        chunk = o.chunk if number == 0 and share < 0.5 else 2 * o.chunk
        total, seen = torch.zeros((), device=self.device), 0
        for features, targets, lengths in self._batches(False, rng, o.batch):
            state = None
            for at in range(0, features.shape[0], chunk):
                x, y = features[at : at + chunk].float(), targets[at : at + chunk].float()
                steps = torch.arange(at, at + x.shape[0], device=self.device)
                valid = (steps[:, None] < lengths).float()[..., None]
                loss, motion, state = losses_of(self.network, self.low_pass, x, y, valid, state)
                self.optimiser.zero_grad(set_to_none=True)
                loss.backward()
                nn.utils.clip_grad_norm_(self.network.parameters(), LARGEST_GRADIENT)
                self.optimiser.step()
                total, seen = total + motion, seen + 1
        return float(total) / seen

    @torch.no_grad()
    def held_out(self, calibrates: bool = False) -> NDArray[np.float64]:
        """RMS of what is left of each of MOTION over that without a network on what is held out,
        as it is, then its parts slower than each of SLOW, (1 + SLOW, 6).

        calibrates: scale the deviations by the last round.
        """
        size, sums, ratios = len(MOTION), np.zeros((2, 1 + len(SLOW), len(MOTION))), []
        parts = self.parts
        self.parts = parts[-1:] if calibrates else parts
        for features, targets, lengths in self._batches(True, None, 128):
            valid = torch.arange(features.shape[0], device=self.device)[:, None] < lengths
            out, true = self.network(features.float())[0], targets.float()[..., :size]
            shown, spread = out[..., :size].clamp(-LIMIT, LIMIT), out[..., size:].clamp(*SPREADS)
            for of, left in zip(sums, (true - shown, true), strict=True):
                for row, each in zip(of, (left, *self.low_pass(left)), strict=True):
                    row += (each[valid] ** 2).sum(0).double().cpu().numpy()
            ratios.append(((true - shown).abs() / spread.exp())[valid].cpu().numpy())
        self.parts = parts
        if calibrates:
            wider = np.quantile(np.concatenate(ratios), COVERED, axis=0) / WITHIN
            self.network.last.bias[size:] += torch.from_numpy(np.log(wider)).to(self.device)
        return np.sqrt(sums[0] / sums[1])


def recipe_of(options: Any) -> dict[str, Any]:
    """What an archive says of itself."""
    return {
        "format": FORMAT, "algorithm": None, "augmentation": OBSERVER, "normalisation": None,
        "augmentation_options": {"base": BASE, "recurrent": options.recurrent},
        "control_period": 0.02, "environment": {"id": TORQUE_ID},
        "config": {k: str(v) if isinstance(v, Path) else v for k, v in vars(options).items()},
        "versions": versions() | {"torch": torch.__version__}, "machine": machine(),
        "command": " ".join(["python -m agents.observer", *options.words]),
    }  # fmt: skip


def archive(weights: Mapping[str, Any], recipe: Mapping[str, Any]) -> bytes:
    """The content of agent.zip."""
    arrays, whole = io.BytesIO(), io.BytesIO()
    np.savez(arrays, **weights)
    with zipfile.ZipFile(whole, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr(RECIPE, json.dumps(recipe, indent=1))
        file.writestr(WEIGHTS, arrays.getvalue())
    return whole.getvalue()


def train(options: Any) -> None:
    """All rounds, from where the last run of the same command stopped."""
    options.output.mkdir(parents=True, exist_ok=True)
    began, checkpoint = time.perf_counter(), options.output / "checkpoint.pt"
    regression = Regression(options)
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
                np.savez(path, **regression.network.weights())  # type: ignore[arg-type]
            with np.load(path) as weights:
                network = layers_of({**weights}, options.recurrent)
        regression.add(*drive_round(options, number, network))
        if stored is not None and done[0] == number:
            regression.network.load_state_dict(stored["network"])
            regression.optimiser.load_state_dict(stored["optimiser"])
        for epoch in range(options.epochs):
            if (number, epoch) < done:
                continue
            loss, left = regression.epoch(number, epoch), regression.held_out()
            if not math.isfinite(loss):
                sys.exit(f"the training diverged in epoch {epoch} of round {number}")
            curve.append([number, epoch, round(loss, 5), *np.round(left, 4).ravel().tolist()])
            whole, slow = np.round(left[0], 3), np.round(left[2], 3)
            say(f"round {number}, epoch {epoch}: loss {loss:.4f}, left {whole}, slow {slow}", began)
            state = {"network": regression.network.state_dict(), "done": [number, epoch + 1]}
            state |= {"optimiser": regression.optimiser.state_dict(), "curve": curve}
            torch.save(state, checkpoint.with_suffix(".part"))
            checkpoint.with_suffix(".part").rename(checkpoint)
    regression.held_out(calibrates=True)
    recipe = recipe_of(options)
    whole = archive(regression.network.weights(), recipe)
    write_atomically(options.output / "agent.zip", whole)
    (options.output / "config.json").write_text(json.dumps(recipe, indent=1) + "\n", "utf-8")
    with (options.output / "curve.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        parts = ["", *(f"_{tau:g}_s" for tau, _ in SLOW)]
        writer.writerow(["round", "epoch", "loss", *(n + part for part in parts for n in MOTION)])
        writer.writerows(curve)
    say(f"done; {options.output / 'agent.zip'}", began)


def parse(words: list[str]) -> Any:
    """The options of the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("--output", type=Path, required=True, help="folder of this training")
    add("--seed", type=int, default=0, help="of everything random")
    add("--device", default="cpu", help="of torch, cpu or cuda")
    add("--processes", type=int, default=1, help="that drive episodes")
    add("--threads", type=int, default=1, help="of torch")
    add("--episodes", type=int, default=1076, help="of the first round")
    add("--further", type=int, default=538, help="of every later round")
    add("--rounds", type=int, default=2, help="later rounds, with the network in the loop")
    add("--epochs", type=int, default=12, help="of each regression")
    add("--batch", type=int, default=32, help="episodes of a gradient step")
    add("--chunk", type=int, default=75, help="control steps of a gradient step, later twice it")
    add("--rate", type=float, default=2e-3, help="learning rate of the first round, later half")
    add("--feed-forward", dest="recurrent", action="store_false", help="forget at every step")
    add("--no-innovations", dest="innovations", action="store_false", help="do not see them")
    options = parser.parse_args(words)
    options.words = words
    return options


if __name__ == "__main__":
    train(parse(sys.argv[1:]))
