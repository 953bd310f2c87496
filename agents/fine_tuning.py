"""Go on with the policy for any vehicle by reinforcement learning: does it add to imitation?

    python -m agents.fine_tuning --agent runs/any-vehicle-seed0/agent.zip \\
        --output runs/any-vehicle-ppo-seed0
Proximal policy optimisation [1] of the recurrent network on episodes as `agents.untold_training`
has them, 128 vehicles of 30 s an iteration. With the true distance d to the reference, the contact
length l and the action u, the reward of a control step is
    r = -ln(1 + (d / s l)^2) / 2 - c |u - u'|^2
as the metric is a mean of logarithms of errors; a vehicle that is lost has the reward of the error
limit ever after. Noise on the actions lasts for some steps, as white noise hardly moves a vehicle
[2]; its density counts in each. The value is of a network that sees the truth as well: errors and
parameters of the vehicle. Held-out episodes give the geometric mean of the RMSE after 5 s, without
noise and with the mean of the weights of late, over that of the policy to begin with. The same
command goes on where it was stopped.

References: [1] Schulman et al., arXiv:1707.06347. [2] Raffin et al., arXiv:2005.05719.
"""

import argparse
import csv
import math
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn
from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from agents import regression
from agents.regression import PERIOD, GatedNetwork, Job, archive, recipe_of, say
from agents.untold_training import KNOWN, Scene, known_of, truth_of
from baselines.learned.agent_policy import ANY_VEHICLE
from baselines.learned.gated_network import BatchNetwork
from baselines.learned.trained_agent import WEIGHTS, drive_of, read_arrays, read_recipe
from baselines.learned.untold_policy import policy_layers
from baselines.learned.vehicle_features import FEATURES
from tracked_env.benchmark.files import write_atomically
from tracked_env.cli.command_line import reported

FIRST_SEED = regression.FIRST_SEED + 2**38  # beyond those of imitation
HELD_OUT = 8  # jobs, the same in every evaluation
JOBS, VEHICLES = 4, 32  # of an iteration, and of a job, which has one kind of sensors
LATER = round(5.0 / PERIOD)  # control steps before what an evaluation counts
GAMMA, LAMBDA = 0.985, 0.97  # [-] a horizon of 1.3 s, as `algorithms.PPOSettings`
CLIP = 0.15  # [-] of a probability ratio
AVERAGED = 0.99  # [-] share of the mean of the weights that a gradient step keeps
LOST = 2.5  # [contact lengths] at which an episode ends
COLUMNS = ("iteration", "steps", "cpu_seconds", "held_out_ratio", "reward", "deviation", "kl")


class Rollout(NamedTuple):
    """Driven episodes, (T, N, ..)."""

    features: Any
    truth: Any  # what the value sees beside them
    noise: Any  # of the actions
    hidden: Any  # (T / chunk, N, H) states of the network where a chunk begins
    away: Any  # distances to the reference [contact lengths]
    change: Any  # squares of changes of the actions
    lengths: Any  # (N,) control steps
    lost: Any  # (N,)


def load(path: Path) -> tuple[GatedNetwork, dict[str, Any]]:
    """The network of an archive, and its recipe. Raises ValueError."""
    recipe = read_recipe(path)
    options = (recipe or {}).get("augmentation_options", {})
    if recipe is None or recipe["augmentation"] != ANY_VEHICLE:
        raise ValueError(f"agent {path} is no policy for any vehicle; must be of untold_training")
    if drive_of(recipe).drive != "torque":
        raise ValueError(f"agent {path} commands speeds; what is tuned drives by torque alone")
    network = GatedNetwork(2, len(KNOWN), torch.ones(len(FEATURES)), options["recurrent"])
    weights = {name: torch.from_numpy(w).float() for name, w in read_arrays(path, WEIGHTS).items()}
    network.load_state_dict({**network.state_dict(), **weights})
    return network, dict(recipe or {})


def roll(network: GatedNetwork, job: Job, deviation: Any, options: Any) -> Rollout:
    """Drive a job; deviation (2,): of what is added to the actions."""
    scene, count = Scene(job), job.count
    layers = policy_layers(network.weights(np.float32), network.recurrent)
    policy, hidden = BatchNetwork(layers, count), np.zeros((count, regression.HIDDEN), np.float32)
    steps = scene.simulation.settings.max_steps
    features = np.zeros((steps, count, len(FEATURES)), np.float32)
    truth = np.zeros((steps, count, 6 + len(KNOWN)), np.float32)
    noise = np.zeros((steps, count, 2), np.float32)
    states = np.zeros((-(-steps // options.chunk), count, regression.HIDDEN), np.float32)
    away, change = np.zeros((2, steps, count))
    before = np.zeros((count, 2))
    for n in range(steps):
        x = scene.seen.see(scene.observation, scene.start)
        features[n] = x
        truth[n] = np.concatenate([truth_of(scene.floats), known_of(scene.floats)], axis=1)
        if n % options.chunk == 0:
            states[n // options.chunk] = hidden
        if n % options.hold == 0:
            held = deviation * scene.rng.normal(size=(count, 2))
        noise[n] = held
        action = policy(x, hidden) + scene.seen.steady + noise[n]
        over = scene.step(action)
        away[n] = np.hypot(*truth_of(scene.floats)[:, :2].T)
        action = np.clip(action, -1.0, 1.0)
        change[n] = np.square(action - before).sum(axis=1)
        before = action
        if over:
            break
    lengths = np.array(scene.simulation.steps)
    scene.env.close()
    return Rollout(features, truth, noise, states, away, change, lengths, lengths < steps)


def joined(parts: Sequence[Rollout]) -> Rollout:
    """The vehicles of several rollouts."""
    *arrays, lengths, lost = zip(*parts, strict=True)
    ends = np.concatenate(lengths), np.concatenate(lost)
    wide: list[Any] = [np.concatenate(each, axis=1) for each in arrays]
    return Rollout._make([*wide, *ends])


def job_at(place: int) -> Job:
    """Vehicles of a training, or held-out ones below 0."""
    return Job(place, FIRST_SEED + VEHICLES * place, VEHICLES, True, 1)


def held_out(network: GatedNetwork, options: Any) -> Any:
    """Logarithms of the RMSE after 5 s over the contact length, of all held-out episodes."""
    found = []
    for k in range(HELD_OUT):
        of = roll(network, job_at(-1 - k), np.zeros(2), options)
        for away, length, lost in zip(of.away.T, of.lengths, of.lost, strict=True):
            left = np.square(away[LATER:length])
            found.append(0.5 * math.log(LOST**2 if lost or not left.size else left.mean()))
    return np.array(found)


def reward_of(away: Any, change: Any, options: Any) -> Any:
    """See the head of the file."""
    return -0.5 * np.log1p(np.square(np.divide(away, options.scale))) - options.calm * change


def advantages(of: Rollout, value: Any, options: Any) -> tuple[Any, Any]:
    """Generalised advantages (T, N) from values (T, N), and which steps were driven.

    What ends by time goes on as it is.
    """
    reward, worst = reward_of(of.away, of.change, options), reward_of(LOST, 0.0, options)
    steps, count = reward.shape
    driven = np.arange(steps)[:, None] < of.lengths
    advantage, running = np.zeros((steps, count)), np.zeros(count)
    for n in reversed(range(steps)):
        last = of.lengths == n + 1
        ahead = np.where(last, np.where(of.lost, worst, value[n]), value[min(n + 1, steps - 1)])
        missed = (1.0 - GAMMA) * reward[n] + GAMMA * ahead - value[n]
        running = np.where(driven[n], missed + GAMMA * LAMBDA * np.where(last, 0.0, running), 0.0)
        advantage[n] = running
    return advantage, driven


class Tuning:
    """The policy, the network of its value, and their optimisers."""

    def __init__(self, network: GatedNetwork, options: Any) -> None:
        self.options, self.network, self.done = options, network, 0
        inputs = len(FEATURES) + 6 + len(KNOWN)
        layers = (nn.Linear(inputs, 128), nn.ReLU(), nn.Linear(128, 128), nn.ReLU())
        normed = nn.BatchNorm1d(inputs, momentum=0.05, affine=False)
        self.value = nn.Sequential(normed, *layers, nn.Linear(128, 1))
        self.log_deviation = nn.Parameter(torch.full((2,), math.log(options.deviation)))
        acting = [p for n, p in network.named_parameters() if not n.startswith("auxiliary")]
        self.acting = torch.optim.Adam([*acting, self.log_deviation], lr=options.rate, fused=True)
        self.judging = torch.optim.Adam(self.value.parameters(), lr=1e-3, fused=True)
        self.mean: Any = AveragedModel(network, multi_avg_fn=get_ema_multi_avg_fn(AVERAGED))
        self.mean.requires_grad_(False)

    def capture(self) -> dict[str, Any]:
        """All that changes."""
        parts: Any = self.network, self.value, self.acting, self.judging, self.mean
        whole = {str(k): part.state_dict() for k, part in enumerate(parts)}
        return {**whole, "deviation": self.log_deviation.detach(), "done": self.done}

    def resume(self, captured: dict[str, Any]) -> None:
        """Put back what `capture` took."""
        parts: Any = self.network, self.value, self.acting, self.judging, self.mean
        for k, part in enumerate(parts):
            part.load_state_dict(captured[str(k)])
        with torch.no_grad():
            self.log_deviation.copy_(captured["deviation"])
        self.done = captured["done"]

    def density(self, noise: torch.Tensor) -> torch.Tensor:
        """Logarithm of the density of actions `noise` (.., 2) off the mean, but for a constant."""
        scaled = noise * torch.exp(-self.log_deviation)
        return -0.5 * (scaled * scaled).sum(-1) - self.log_deviation.sum()

    def update(self, of: Rollout, rng: Any) -> float:
        """Some epochs over a rollout; returns how far the policy has moved (KL divergence)."""
        chunk, first = self.options.chunk, self.done < self.options.judging
        seen = torch.from_numpy(np.concatenate([of.features, of.truth], axis=2))
        with torch.no_grad():
            self.value.eval()
            value = self.value(seen.flatten(0, 1)).view(seen.shape[:2]).numpy().astype(float)
            self.value.train()
        advantage, driven = advantages(of, value, self.options)
        scaled = (advantage - advantage[driven].mean()) / (advantage[driven].std() + 1e-8)
        arrays = of.features, of.noise, scaled, advantage + value, driven
        parts = [torch.from_numpy(np.asarray(each, np.float32)).split(chunk) for each in arrays]
        states, both = torch.from_numpy(of.hidden).split(1), seen.split(chunk)
        with torch.no_grad():
            old = [
                (self.network(x, h)[0], self.density(noise))
                for x, h, noise in zip(parts[0], states, parts[1], strict=True)
            ]
        moved, order = [], np.arange(len(old))
        for _ in range(self.options.epochs):
            rng.shuffle(order)
            for k in order:
                x, noise, gain, target, valid = (part[k] for part in parts)
                count = valid.sum()
                if count < 1.0:
                    continue
                found = self.value(both[k].flatten(0, 1)).view_as(target)
                self._descend(self.judging, (valid * (found - target) ** 2).sum() / count)
                if first:
                    continue
                mean, density = old[k]
                off = noise + mean - self.network(x, states[k])[0]
                ratio = torch.exp(self.density(off) - density)
                gains = torch.minimum(ratio * gain, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * gain)
                self._descend(self.acting, -(valid * gains).sum() / count)
                self.mean.update_parameters(self.network)
                apart = valid * (ratio - 1.0 - ratio.log())
                moved.append(float((apart.sum() / count).detach()))
        self.done += 1
        return float(np.mean(moved)) if moved else 0.0

    @staticmethod
    def _descend(optimiser: Any, loss: torch.Tensor) -> None:
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(optimiser.param_groups[0]["params"], 0.5)
        optimiser.step()


def train(options: Any) -> None:
    """All iterations, from where the last run of the same command stopped; then the archive.

    Raises ValueError for another kind of agent, and for a folder of other options.
    """
    torch.manual_seed(options.seed)
    torch.set_num_threads(options.threads)
    began, checkpoint = time.perf_counter(), options.output / "checkpoint.pt"
    network, recipe = load(options.agent)
    options.output.mkdir(parents=True, exist_ok=True)
    tuning, curve = Tuning(network, options), list[list[float]]()
    if checkpoint.is_file():
        stored = torch.load(checkpoint, weights_only=True)
        if stored.pop("words") != options.words:
            raise ValueError(
                f"--output {options.output} holds a training with other options; give those again, "
                "or another folder"
            )
        curve, base = stored.pop("curve"), np.array(stored.pop("base"))
        tuning.resume(stored)
    else:
        base = held_out(network, options)
        say(f"imitated: held out {100.0 * np.exp(base.mean()):.2f} % of the length", began)
    while tuning.done < options.iterations:
        number, clock = tuning.done, time.process_time()
        deviation = tuning.log_deviation.exp().detach().numpy()
        for group in tuning.acting.param_groups:
            group["lr"] = options.rate * (1.0 - number / options.iterations)
        place = JOBS * (options.iterations * options.seed + number)
        of = joined([
            roll(network, job_at(place + k), deviation, options) for k in range(JOBS)
        ])  # fmt: skip
        moved = tuning.update(of, np.random.default_rng([options.seed, number]))
        cpu = time.process_time() - clock + (curve[-1][2] if curve else 0.0)
        steps = int(of.lengths.sum()) + (curve[-1][1] if curve else 0)
        ratio = math.nan
        if tuning.done % options.every == 0 or tuning.done == options.iterations:
            ratio = float(np.exp(np.mean(held_out(tuning.mean.module, options) - base)))
        driven = np.arange(len(of.away))[:, None] < of.lengths
        earned = float(reward_of(of.away, of.change, options)[driven].mean())
        row = [ratio, earned, float(deviation.mean()), moved]
        curve.append([tuning.done, steps, round(cpu, 1), *(round(v, 5) for v in row)])
        say(", ".join(f"{n} {v:.4g}" for n, v in zip(COLUMNS, curve[-1], strict=True)), began)
        if not math.isnan(ratio):
            state = {**tuning.capture(), "curve": curve, "base": base.tolist()}
            state["words"] = options.words
            torch.save(state, checkpoint.with_suffix(".part"))
            checkpoint.with_suffix(".part").rename(checkpoint)
    own = {name: recipe[name] for name in ("augmentation", "augmentation_options")}
    own["command"] = " ".join(["python -m agents.fine_tuning", *options.words])
    content = archive(tuning.mean.module.weights(), recipe_of(options, own))
    write_atomically(options.output / "agent.zip", content)
    with (options.output / "curve.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([COLUMNS, *curve])
    say(f"done; {options.output / 'agent.zip'}", began)


def parse(words: list[str]) -> Any:
    """The options of the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    add = parser.add_argument
    add("--agent", type=Path, required=True, help="archive of agents.untold_training")
    add("--output", type=Path, required=True, help="folder of this training")
    add("--seed", type=int, default=0, help="of everything random")
    add("--iterations", type=int, default=60, help="of 128 episodes each")
    add("--judging", type=int, default=4, help="first iterations, in which only the value learns")
    add("--every", type=int, default=5, help="iterations between two evaluations")
    add("--epochs", type=int, default=2, help="over the samples of an iteration")
    add("--chunk", type=int, default=75, help="control steps of a gradient step")
    add("--rate", type=float, default=1e-4, help="learning rate at the beginning, falls to 0")
    add("--deviation", type=float, default=0.05, help="of the actions to begin with")
    add("--hold", type=int, default=10, help="control steps for which noise lasts")
    add("--scale", type=float, default=0.015, help="s of the reward, contact lengths")
    add("--calm", type=float, default=1.0, help="c of the reward")
    add("--threads", type=int, default=1, help="of torch")
    options = parser.parse_args(words)
    for name, value in vars(options).items():
        may_be_0 = name in ("seed", "judging", "calm")
        if not isinstance(value, Path) and not (value >= 0 if may_be_0 else value > 0):
            parser.error(f"--{name} = {value}; must be {'at least' if may_be_0 else 'above'} 0")
    options.words = words
    return options


@reported
def main(arguments: list[str], program: str) -> int:
    """Train, with errors as one line."""
    train(parse(arguments))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:], "fine_tuning"))
