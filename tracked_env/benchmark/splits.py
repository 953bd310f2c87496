"""Splits of the seeds: which episodes choose, which check, and which are published.

Episode i of an evaluation set is drawn from the seed FIRST + i of its split:
    FROZEN       the published episodes; nothing is ever chosen on them
    DEVELOPMENT  gains, settings and designs are chosen on these
    AUDIT        conclusions are checked on these, once, at the end
    OBSERVER     noise levels and gates of the estimators are chosen and confirmed on these
Trainings and their held-out episodes begin at seeds far above (`agents.training`).
"""

from tracked_env.validation import unknown

FROZEN = 0
DEVELOPMENT = 50_000
AUDIT = 60_000
OBSERVER = 70_000
LENGTH = 10_000  # [-] seeds of a split, at most
SPLITS = {
    "frozen": FROZEN, "development": DEVELOPMENT, "audit": AUDIT, "observer": OBSERVER
}  # fmt: skip


def seeds_of(split: str) -> range:
    """The seeds of a split. Raises ValueError for an unknown one."""
    if split not in SPLITS:
        raise unknown("split of seeds", split, SPLITS)
    return range(SPLITS[split], SPLITS[split] + LENGTH)
