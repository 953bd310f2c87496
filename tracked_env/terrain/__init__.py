"""The ground: its height and slope, and the soil at a place, as kernels evaluate them."""
