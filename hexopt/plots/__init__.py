"""Figures: the robot and its poses, what poses see, how many are enough, and how sure the result is.

Each function takes data and, where one picture is drawn, matplotlib's ``ax=``; it returns the axes, or the figure where
there are several. None of them shows, saves or changes a setting of matplotlib. Without ``ax`` a new figure is made by
``matplotlib.pyplot``: show it, save it, or close it. Colours are those that colour-blind readers tell apart, and what
they say stands in markers, line styles or numbers too.

Examples
--------
>>> import hexopt as hx
>>> ax = hx.plots.hexapod(hx.robots.left_hand(), leg=3)
>>> ax.get_zlabel()
'z (cm)'
>>> ax.figure.savefig("hexapod.png")  # doctest: +SKIP
"""

from .bars import correlation, leverage, singular_values, standard_errors
from .counts import error_against_poses, knee
from .gallery import pose_gallery
from .regions import error_ellipsoids
from .space import hexapod, poses

__all__ = [
    "correlation",
    "error_against_poses",
    "error_ellipsoids",
    "hexapod",
    "knee",
    "leverage",
    "pose_gallery",
    "poses",
    "singular_values",
    "standard_errors",
]
