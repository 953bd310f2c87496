"""A user's own data: parameters of a vehicle from a log, and its slip from runs.

`read_log` and `identify` for `tracked-env identify`, `read_runs` and `fit` for `tracked-env slip`.
"""
