"""Sections 4, 5.2 and 7.1 of Focchi et al. (2025) as experiments that can be run again.

    identification  4, 7.2.3   slip over the sprocket speeds: figures 6 to 9, exponential form
    spiral          5.2        the controllers on the pseudo-kinematic model: figure 10
    chicane         7.1        the controllers on the distributed model: figures 12 to 14
    claims, page               what the paper says, what comes out, as one page
Identification, slip models and controllers are handed in as `Tools`.

References: [1] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025).
"""

from reproduce.focchi2025.chicane import Case
from reproduce.focchi2025.results import Results
from reproduce.focchi2025.results import run_all as run_everything
from reproduce.focchi2025.runs import Run, vehicle
from reproduce.focchi2025.tools import Tools

__all__ = ["Case", "Results", "Run", "Tools", "run_everything", "vehicle"]
