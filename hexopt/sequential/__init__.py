"""Estimators that take one pose after the other, and know after each how far they are."""

from .measuring import SequentialDesign, SequentialState
from .recursive import Recursive, RecursiveState
from .state import RunningState
from .unscented import Unscented
from .unscented_state import UnscentedState

__all__ = [
    "Recursive",
    "RecursiveState",
    "RunningState",
    "SequentialDesign",
    "SequentialState",
    "Unscented",
    "UnscentedState",
]
