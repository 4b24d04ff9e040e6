"""Measurements as CSV files: read with units and conventions stated, written without loss."""

from .reading import read_measurements
from .writing import write_measurements

__all__ = ["read_measurements", "write_measurements"]
