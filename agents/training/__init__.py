"""Trainings: options resolved into a `Run`, learners, environments, checkpoints, folders."""
