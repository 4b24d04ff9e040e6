"""Tools for the authors of new parts: the contract that every estimator keeps."""

from .contract import CLAIMS, check_estimator

__all__ = ["CLAIMS", "check_estimator"]
