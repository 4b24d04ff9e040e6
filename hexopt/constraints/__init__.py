r"""Convex constraints on named parameters: boxes, balls, linear equations and inequalities."""

from .ball import Ball
from .base import BallRows, Constraint, IntervalRows
from .box import Box
from .linear import Linear

__all__ = ["Ball", "BallRows", "Box", "Constraint", "IntervalRows", "Linear"]
