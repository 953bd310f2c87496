"""A package that registers policies, as pip would install it into a folder."""

import sys
from collections.abc import Callable

Install = Callable[..., None]

PLUGIN = """
import numpy as np

class Coast:
    '''Lets the vehicle coast.'''
    drive = "torque"
    def predict(self, observation, state=None, episode_start=None, deterministic=True):
        return np.zeros((len(observation), 2), dtype=np.float32), state

class Anywhere(Coast):
    drive = None

class Lost(Coast):
    drive = "wheels"

NOTHING = 3

class Several:
    @staticmethod
    def policies():
        return {
            "torque": {"coast-too": Coast}, "speed": {"coast": Coast()},
            "tracked_env/Terrain-v0": {"coast": Coast()},
        }
"""


def install(place, patch, name="other-package", **entries):
    """Install a distribution of this name under `place`; entries: of `tracked_env.policies`."""
    folder = place / name
    information = folder / f"{name.replace('-', '_')}-1.0.dist-info"
    information.mkdir(parents=True)
    (folder / "plugin_policies.py").write_text(PLUGIN)
    (folder / "broken_policies.py").write_text("import not_installed_anywhere")
    about = f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n"
    (information / "METADATA").write_text(about)
    lines = [f"{key.replace('_', '-')} = {value}" for key, value in entries.items()]
    text = "\n".join(["[tracked_env.policies]", *lines]) + "\n"
    (information / "entry_points.txt").write_text(text)
    patch.syspath_prepend(folder)
    patch.delitem(sys.modules, "plugin_policies", raising=False)
