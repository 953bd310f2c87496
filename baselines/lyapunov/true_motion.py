"""The adaptive policies of speed-driven vehicles with the true pose, identifying as they do.

They show what a perfect filter of the pose would be worth; the friction is identified from the
sensors. The error is that of `slippage_aware`, in the plane of the vehicle where the observation
shows its attitude.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from baselines.batch_policy import Bools, Floats, body_errors
from baselines.lyapunov.slippage_aware import AdaptiveSlipPolicy, SlippageAwarePolicy
from baselines.predictive.sprocket_control import PredictiveAdaptiveSlipPolicy
from baselines.slip.slip_models import Array
from tracked_env.physics.rigid_body import in_body_plane

_POSE, _TILT = ("x", "y", "yaw"), ("pitch", "roll")


class TrueMotion(SlippageAwarePolicy):
    """With another policy behind it that policy with the true pose."""

    needs_truth = True

    def observe_truth(self, truth: Mapping[str, Any]) -> None:
        """Take over the pose, {name: number or (N,)}; other names are ignored."""
        reference, pose = (
            [np.atleast_1d(truth[prefix + name]) for name in _POSE] for prefix in ("reference_", "")
        )
        errors = body_errors(reference, *pose)
        if self._tilted:
            angles = (np.atleast_1d(truth[name]) for name in _TILT)
            errors = in_body_plane(*errors, *((np.cos(angle), np.sin(angle)) for angle in angles))
        self._true_error: Array = -np.stack(errors, axis=1)

    def _path_error(
        self, observation: Floats, error: Array, reference: Array, moving: Bools, belt_motion: Array
    ) -> tuple[Array, Array, Bools]:
        return self._true_error, reference, moving


class TrueMotionSlipPolicy(TrueMotion, AdaptiveSlipPolicy):
    """AdaptiveSlipPolicy with the true pose."""


class PredictiveTrueMotionSlipPolicy(TrueMotionSlipPolicy, PredictiveAdaptiveSlipPolicy):
    """The same with model predictive control."""
