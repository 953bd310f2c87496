"""On-line estimators: least squares, slip observer, soil estimator, and the stack of them.

Public: IdentificationStack and what it returns and takes. The modules are loaded when a name is
first used.
"""

from importlib import import_module
from typing import Any

_MODULES = {
    "IdentificationStack": "stack", "Identification": "stack", "register": "stack",
    "MotionFilter": "motion_filter", "DataSheet": "measurement", "Estimate": "measurement",
    "Measurement": "measurement", "Quantity": "measurement", "Setting": "measurement",
    "Status": "measurement",
}  # fmt: skip
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    """A public name of one of the modules."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
