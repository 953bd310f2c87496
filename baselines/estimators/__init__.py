"""On-line estimators: least squares, slip observer, soil estimator, and the stack of them."""
