"""Writing the file of a trained agent (`baselines.learned.agent_archive`), and its network in
PyTorch, for what learns on from it.
"""

import json
import zipfile
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.policies import BasePolicy

from agents.networks import build, network_of, to_npz, weights_of
from baselines.learned.agent_archive import (
    RECIPE,
    WEIGHTS,
    from_npz,
    read_entry,
    untrusted,
)
from baselines.learned.recipe import FORMAT, PICKLED
from tracked_env.benchmark.store import write_atomically


def save_agent(
    path: Path,
    model: BaseAlgorithm | BasePolicy,
    recipe: Mapping[str, Any],
    files: Mapping[str, bytes] | None = None,
) -> None:
    """Write recipe, network and further files as one archive, whole or not at all."""
    policy: BasePolicy = model.policy if isinstance(model, BaseAlgorithm) else model
    recorded = {**recipe, "format": FORMAT, "network": network_of(policy)}
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(RECIPE, json.dumps(recorded, indent=1))
        archive.writestr(WEIGHTS, to_npz(weights_of(policy)))
        for name, content in (files or {}).items():
            archive.writestr(name, content)
    write_atomically(path, buffer.getvalue())


def load_network(path: Path, recipe: Mapping[str, Any]) -> BasePolicy:
    """The network in an archive, as the policy of Stable-Baselines3. recipe: of `read_recipe`.

    Raises ValueError for an archive of the version before, and for weights that are damaged, not
    finite, or not those of the architecture.
    """
    if recipe["format"] == PICKLED:
        raise ValueError(untrusted(path, "is of a former version of train.py"))
    try:
        weights = from_npz(read_entry(path, WEIGHTS), WEIGHTS)
        return build(recipe["algorithm"], recipe["network"], weights)
    except ValueError as error:
        raise ValueError(f"agent {path} cannot be loaded: {error}") from error
