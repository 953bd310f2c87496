"""The simulation core: arrays of a batch, kernels of a control step, episodes."""
