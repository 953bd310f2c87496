"""Ranges of the settings of trainings, and the check of a dataclass of settings against them."""

from dataclasses import fields
from typing import Any

# Of the settings of every algorithm and of train.py; a parenthesis leaves the bound out. Advantages
# are normalised over a batch, so one has two samples. Upper bounds leave out what cannot be meant:
# an update that moves every weight by more than 1, or more samples than a large machine can hold.
LIMITS = {
    "steps": "[1, 1e12]", "vehicles": "[1, 65536]", "held_out": "[0, 65536]",
    "evaluate_every": "[1, 1e12]", "checkpoint_every": "[0, 1e12]", "threads": "[1, 1024]",
    "lags": "[1, 10000]", "residual_scale": "[0, 2]", "precision": "[0, 1000]",
    "smoothness": "[0, 1e6]",
    "n_steps": "[1, 1000000]", "batch_size": "[2, 1e8]", "n_epochs": "[1, 10000]",
    "learning_rate": "(0, 1]", "gamma": "[0, 1)", "gae_lambda": "[0, 1]",
    "clip_range": "(0, 100]", "ent_coef": "[0, 1000]", "log_std_init": "[-20, 5]",
    "hidden": "[1, 16384]", "lstm_hidden": "[1, 16384]", "buffer_size": "[1, 1e9]",
    "learning_starts": "[0, 1e12]", "train_freq": "[1, 1000000]", "gradient_steps": "[1, 1000000]",
    "tau": "(0, 1]", "action_noise": "[0, 10]", "top_quantiles_to_drop_per_net": "[0, 24]",
}  # fmt: skip


def _inside(value: Any, interval: str) -> bool:
    """Whether a number is in an interval; of `auto_0.1`, the number behind `auto_`."""
    low, high = (float(bound) for bound in interval[1:-1].split(","))
    if isinstance(value, str):
        try:
            value = float("1" if value == "auto" else value.removeprefix("auto_"))
        except ValueError:
            return False
    above = value > low if interval[0] == "(" else value >= low
    return above and (value < high if interval[-1] == ")" else value <= high)


def check(settings: Any) -> None:
    """Raises ValueError for a field of a dataclass that is outside LIMITS; None is inside."""
    for name in (field.name for field in fields(settings) if field.name in LIMITS):
        value, interval = getattr(settings, name), LIMITS[name]
        entries = value if isinstance(value, tuple) else (value,)
        if not all(entry is None or _inside(entry, interval) for entry in entries):
            word = ", auto or auto_ and a number" if isinstance(value, str) else ""
            raise ValueError(f"{name} = {value!r}; must be in {interval}{word}")


def check_buffer(settings: Any, vehicles: int) -> None:
    """Raises ValueError for a buffer of samples that cannot hold `n_steps` of all vehicles."""
    least = settings.n_steps * vehicles
    if settings.buffer_size < least:
        raise ValueError(
            f"buffer_size = {settings.buffer_size}; must be at least {least}: n_steps = "
            f"{settings.n_steps} of {vehicles} vehicles"
        )


def check_budget(settings: Any, steps: int) -> None:
    """Raises ValueError for a training of `steps` that ends before its first gradient."""
    begin = getattr(settings, "learning_starts", -1)
    if steps <= begin:
        raise ValueError(
            f"steps = {steps}; must be above learning_starts = {begin}: until then actions are "
            "random and nothing is learned. Train longer, or lower learning_starts"
        )
