"""Gated networks of random numbers."""

import math

import numpy as np


def random_weights(inputs, outputs, hidden=16, middle=12, seed=0):
    """Weights of `gated_network.layers_of`."""
    rng = np.random.default_rng(seed)
    shapes = {
        "gru.weight_ih_l0": (3 * hidden, inputs), "gru.weight_hh_l0": (3 * hidden, hidden),
        "gru.bias_ih_l0": (3 * hidden,), "gru.bias_hh_l0": (3 * hidden,),
        "middle.weight": (middle, hidden + inputs), "middle.bias": (middle,),
        "last.weight": (outputs, middle), "last.bias": (outputs,),
    }  # fmt: skip
    return {
        name: (rng.normal(size=shape) / math.sqrt(shape[-1])).astype(np.float32)
        for name, shape in shapes.items()
    }
