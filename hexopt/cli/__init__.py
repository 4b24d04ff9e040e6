"""The command line: ``hexopt robots``, ``hexopt simulate``, ``hexopt select``, ``hexopt calibrate``."""

from .app import main

__all__ = ["main"]
