"""Candidate poses on one clamp, for choices of poses: random ones that all legs reach, or the user's own list."""

from .clamp import Clamp
from .drawn import candidates
from .listed import candidates_at

__all__ = ["Clamp", "candidates", "candidates_at"]
