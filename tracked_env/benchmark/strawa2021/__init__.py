"""x."""
from tracked_env.benchmark.strawa2021.control import *
