"""What the paper prints (section 5), to stand beside our figures."""

from __future__ import annotations

import numpy as np

__all__ = ["B_PRINTED", "FACTORS", "INNOCENTI"]

#: Mean error over input error, leg 3, by (kind, N, column): Type I at N = 7; II at N1 = 7; III at N2 = 7 (N1 = 7).
FACTORS = {
    ("direction", 7, "base_error"): 13.0,
    ("direction", 7, "platform_error"): 1.4,
    ("leg", 7, "platform_error"): 1.4,
    ("length", 7, "base_error"): 2.8,
}

#: The two b_3 that section 5.2 prints, from N1 = 7, by noise level (cm and degrees).
B_PRINTED = {
    0.01: np.array([7.8291, -1.05809, 0.007995]),
    0.001: np.array([7.82149, -1.052215, 0.0011]),
}

#: The factor of Innocenti's algorithm on N = 7, for base and platform alike. Not run here.
INNOCENTI = 15.0
