r"""Noise models: what is added to exact readings, and the covariance that estimators assume.

One pose has the error :math:`e = (\delta P, \delta\omega, \delta\rho)`: position, spatial rotation
(:math:`R = \exp([\delta\omega]_\times) R_\text{true}`) and reading; 7 numbers for one leg, 12 for the
six readings of a robot. A noise model is a value that travels with the data; it is what is *assumed*.
"""

from .base import IndexedNoise, Noise
from .normal import NormalNoise
from .outliers import Outliers
from .uniform import UniformNoise

__all__ = ["IndexedNoise", "Noise", "NormalNoise", "Outliers", "UniformNoise"]
