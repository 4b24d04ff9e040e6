"""Reports for people: one self-contained HTML page."""

from .choice import design_report

__all__ = ["design_report"]
