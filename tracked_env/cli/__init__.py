"""The command `tracked-env`; needs the core dependencies only."""
