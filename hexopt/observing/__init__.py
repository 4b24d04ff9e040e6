"""What poses see of the parameters, and how well."""

from .indices import observability_indices
from .observe import observability
from .report import Direction, Observability

__all__ = ["Direction", "Observability", "observability", "observability_indices"]
