"""The convex family: every loss, prior and constraint in one programme, with a certificate."""

from .estimator import ConvexEstimator

__all__ = ["ConvexEstimator"]
