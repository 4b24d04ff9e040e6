"""
Which unknowns can a set of poses see?
======================================

A set of poses determines some combinations of the unknowns and not others. hexopt never hides this behind a
pseudo-inverse: where something is not determined it says what, by name.
"""

# %%
# Four sets that do not see enough
# --------------------------------

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
ranges = robot.ranges
about_one_axis = replace(ranges, angles=(np.deg2rad(35), 0, 0))  # the first of z, x, z
equal = replace(ranges, length=(18, 18))
no_swing = replace(ranges, cone=0.0)


def measured(lock, n_poses=7, ranges=None):
    """Poses without noise."""
    return hx.simulate_leg(robot, 3, lock, n_poses, ranges=ranges, rng=0)


linear, nonlinear = hx.LeastSquares(), hx.InverseKinematics()
type_one = hx.loops.FixedDirection(measured("direction", ranges=equal)).linear()
type_two = hx.loops.FixedLeg(measured("leg", ranges=about_one_axis)).linear()
type_three = hx.loops.FixedLength(measured("length", ranges=no_swing)).linear()
with_offset = hx.loops.LegLength(measured("direction", 12))  # b, a and the offset

for name, target, estimator in (
    ("Type I, all lengths equal", type_one, linear),
    ("Type II, turned about one axis", type_two, linear),
    ("Type III, the leg does not swing", type_three, linear),
    ("one locked direction, offset unknown", with_offset, nonlinear),
):
    try:
        hx.estimate(target, estimator)
    except hx.RankDeficientError as error:
        print(f"{name}\n    unseen: " + "\n            ".join(error.combinations))

# %%
# Read such a line as: *this combination may change by any amount, and the equations still hold.* With equal lengths,
# the base point may move if the direction follows. Turned about z alone, the height of the platform joint is free.
#
# A batch does not fail as a whole: the member that is not determined gets NaN and a status.

good = hx.simulate_leg(robot, 3, "leg", 7, n_sets=3, rng=1)
flat = measured("leg", ranges=about_one_axis)
position, rotation = np.array(good.position), np.array(good.rotation)
position[1], rotation[1] = flat.position, flat.rotation
mixed = hx.LegMeasurements(position, rotation, None, "leg")
found = hx.estimate(hx.loops.FixedLeg(mixed).linear(), linear)
print(found.status)
print(found.params["platform_point"].round(6) + 0.0)

# %%
# From unseen to seen
# -------------------
#
# Between "not at all" and "well" lies the condition number. In Type I it is decided by how much the leg's length
# changes: the base point enters the equations only by differences of lengths. The error follows it.

noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
spreads = np.geomspace(0.05, 12, 13)
condition, base, platform = [], [], []
for spread in spreads:
    some = replace(ranges, length=(18.65 - spread / 2, 18.65 + spread / 2))
    data = hx.simulate_leg(
        robot, 3, "direction", 7, n_sets=500, noise=noise, ranges=some, rng=0
    )
    found = hx.estimate(
        hx.loops.FixedDirection(data).linear("consecutive"),
        hx.LeastSquares(covariance=False),
    )
    condition.append(np.median(found.condition))
    base.append(np.median(found.error(robot.leg(3))["base_point"]))
    platform.append(np.median(found.error(robot.leg(3))["platform_point"]))

figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 4.0))
left.loglog(spreads, condition, "o-", color="C2")
left.set(xlabel="spread of leg length (cm)", ylabel="condition number, scaled columns")
left.set_title("Median condition of the equations")
right.loglog(spreads, base, "o-", color="C0", label="base point")
right.loglog(spreads, platform, "s-", color="C1", label="platform point")
right.axhline(0.01, color="black", linewidth=1, linestyle="--")
right.text(spreads[-1], 0.0095, "input error", ha="right", va="top")
right.set_ylim(0.005, None)
right.set(xlabel="spread of leg length (cm)", ylabel="median error (cm)")
right.set_title("Median error, N = 7, input error 0.01")
right.legend(loc="upper right")
plt.show()

# %%
# The condition number is of the matrix with its columns scaled to unit length, so units do not change it. It says
# what *may* happen to errors, not how large they are: the standard errors of the estimate say that.
