"""Sections 4 to 8 of Focchi et al. (2025) as experiments that can be run again.

    identification  4, 7.2.3   slip over the sprocket speeds: figures 6 to 9, exponential form
    spiral          5.2        the controllers on the pseudo-kinematic model: figure 10
    chicane         7.1        the controllers on the distributed model: figures 12 to 14
    planning        6, 7.2     goals and plans; planning_as_coded: conventions of the authors' code;
                               planning_loop: plans tracked by both controllers, figures 16, 17
    uneven_ground   8          the height map of the authors, and a seeded field like it
    load_models     8.1, 8.2   nonuniform and uniform load, stiffness that grows: figure 21
    slope_chicane   8.3        the controllers on uneven ground: figures 22 and 23
    runs, loop      the vehicle and its time histories; a closed loop around any plant
    results         all of them run; slope_runs: those of sections 4.5 and 8,
                    planning_runs: those of 7.2
    claims, page    what the paper says, what comes out, as one page; slope_claims,
                    slope_tables, planning_claims, planning_tables: of those sections
The vehicle is that of tracked_env; slip models and controllers are those of baselines.

References: [1] Focchi et al., Pseudo-Kinematic Trajectory Control and Planning of Tracked
Vehicles (2025).
"""

from reproduce.focchi2025.page import PAGE
from reproduce.focchi2025.results import run_everything

__all__ = ["PAGE", "run_everything"]
