"""Where the belts have carried a vehicle lately, for samples of the pose that come late.

A sample that is `age` old saw the vehicle where it was, so the observer predicts that: it takes
the way driven since then off its present pose. Kept are sums over time, not poses, so that the
way is always evaluated with the present estimate of the slips (constant over the delay):
    D_L = sum dt V_tL,   C_L = sum dt V_tL cos(psi),   S_L = sum dt V_tL sin(psi)     and R
    yaw  way = (g_R D_R - g_L D_L) / B,    g = V / V_t of each track
    X    way = (g_L C_L + g_R C_R) / 2 - tan(alpha) (g_L S_L + g_R S_R) / 2
    Y    way = (g_L S_L + g_R S_R) / 2 + tan(alpha) (g_L C_L + g_R C_R) / 2
with psi the estimated heading in the middle of each step. On a slope C and S hold ways on the map,
dt V_t cos(pitch), and D what turns the heading, dt V_t cos(roll) / cos(pitch). What the roll adds
to lateral ways (0.1 alpha) and the rate of pitch to psi (0.04 rad/s) is left out there. A ring of
the sums, one slot per step, reaches back for the longest delay. Stored poses would carry the slips
of then: a corrected slip would take effect only after the delay, and the observer would correct it
again and again.
"""

from typing import NamedTuple

from tracked_env.physics.jit import formula

# What is remembered of one vehicle, from column `start` of its memory on.
HEAD, FILLED, FIRST_SLOT = range(3)  # slot written last, slots written so far, slots
D_LEFT, D_RIGHT, C_LEFT, S_LEFT, C_RIGHT, S_RIGHT, BELT_LEFT, BELT_RIGHT = range(8)
SLOT = 8


class Way(NamedTuple):
    """Sums of the belts' ways [m] since some earlier step, and their speeds [m/s] then."""

    d_left: float
    d_right: float
    c_left: float
    s_left: float
    c_right: float
    s_right: float
    belt_left: float
    belt_right: float
    instrument_left: float  # speeds one step earlier: nearly the same, but with other noise
    instrument_right: float


def slots_for(longest_delay: float, control_period: float) -> int:
    """Slots that reach back over `longest_delay` [s]."""
    return round(longest_delay / control_period) + 3


def columns_for(slots: int) -> int:
    """Columns of memory that `slots` slots take."""
    return FIRST_SLOT + SLOT * slots


@formula
def push(memory, i, start, slots, way):
    """Add one step: `way` holds the step's own sums and the belt speeds at its end."""
    old = start + FIRST_SLOT + SLOT * int(memory[i, start + HEAD])
    head = (int(memory[i, start + HEAD]) + 1) % slots
    new = start + FIRST_SLOT + SLOT * head
    memory[i, start + HEAD] = head
    memory[i, start + FILLED] = min(memory[i, start + FILLED] + 1.0, 1.0 * slots)
    memory[i, new + D_LEFT] = memory[i, old + D_LEFT] + way.d_left
    memory[i, new + D_RIGHT] = memory[i, old + D_RIGHT] + way.d_right
    memory[i, new + C_LEFT] = memory[i, old + C_LEFT] + way.c_left
    memory[i, new + S_LEFT] = memory[i, old + S_LEFT] + way.s_left
    memory[i, new + C_RIGHT] = memory[i, old + C_RIGHT] + way.c_right
    memory[i, new + S_RIGHT] = memory[i, old + S_RIGHT] + way.s_right
    memory[i, new + BELT_LEFT] = way.belt_left
    memory[i, new + BELT_RIGHT] = way.belt_right


@formula
def since(memory, i, start, slots, steps):
    """Way since `steps` steps ago, at most as far back as the ring reaches; 0 gives zero sums
    and the present belt speeds."""
    head = int(memory[i, start + HEAD])
    reach = max(memory[i, start + FILLED] - 1.0, 0.0)
    back = int(min(max(steps, 0.0), reach))
    more = int(min(max(steps, 0.0) + 1.0, reach))
    now = start + FIRST_SLOT + SLOT * head
    earlier = start + FIRST_SLOT + SLOT * ((head - more + slots) % slots)
    then = start + FIRST_SLOT + SLOT * ((head - back + slots) % slots)
    return Way(
        memory[i, now + D_LEFT] - memory[i, then + D_LEFT],
        memory[i, now + D_RIGHT] - memory[i, then + D_RIGHT],
        memory[i, now + C_LEFT] - memory[i, then + C_LEFT],
        memory[i, now + S_LEFT] - memory[i, then + S_LEFT],
        memory[i, now + C_RIGHT] - memory[i, then + C_RIGHT],
        memory[i, now + S_RIGHT] - memory[i, then + S_RIGHT],
        memory[i, then + BELT_LEFT],
        memory[i, then + BELT_RIGHT],
        memory[i, earlier + BELT_LEFT],
        memory[i, earlier + BELT_RIGHT],
    )
