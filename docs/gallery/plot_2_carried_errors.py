"""
Three steps, and the errors that they pass on
=============================================

The paper's second method finds the platform point b from one set of poses, uses it as if it were exact to find the base
point a from a second set, and both to find the offset. Standard errors that forget the error of b promise too much.
:class:`~hexopt.ThreeStep` carries it.
"""

# %%
# One leg in three steps
# ----------------------

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)

# Type II finds b; Type III finds a with that b, and then the offset
fixed_leg = hx.simulate_leg(robot, 3, "leg", n_poses=7, noise=noise, rng=1)
fixed_length = hx.simulate_leg(robot, 3, "length", n_poses=20, noise=noise, rng=2)
print(hx.calibrate(robot, [fixed_leg, fixed_length], hx.ThreeStep()).summary())

# %%
# The same by hand: an estimate that is passed on as a known value brings its covariance along, plain numbers do not.

b = hx.estimate(hx.loops.FixedLeg(fixed_leg).linear("consecutive"), hx.LeastSquares())
for known in (b, b.params["platform_point"]):
    loop = hx.loops.FixedLength(fixed_length, platform_point=known)
    a = hx.estimate(loop.linear("consecutive"), hx.LeastSquares())
    print(f"b as {type(known).__name__:9s} a ± {a.standard_errors.round(4)} cm")

# %%
# How often is the truth inside?
# ------------------------------
#
# An interval of ± 1.96 standard errors should hold the truth 95 times in 100. We count, over 1000 experiments for each
# size of the second set, with the first set kept at seven poses.

sizes = (5, 7, 10, 14, 20, 30, 50)
share = {"b taken as exact": [], "error of b carried (ThreeStep)": []}
for n_poses in sizes:
    first = hx.simulate_leg(robot, 3, "leg", 7, n_sets=1000, noise=noise, rng=n_poses)
    second = hx.simulate_leg(
        robot, 3, "length", n_poses, n_sets=1000, noise=noise, rng=100 + n_poses
    )
    result = hx.ThreeStep().calibrate_leg({first.lock: first, second.lock: second})
    error = np.abs(result.leg.base_point - leg.base_point)

    variance = np.diagonal(result.covariance, axis1=-2, axis2=-1)  # of b, a, offset
    inside = error < 1.96 * np.sqrt(variance[:, 3:6])
    share["error of b carried (ThreeStep)"].append(inside.mean())

    loop = hx.loops.FixedLength(second, platform_point=result.leg.platform_point)
    forgetful = hx.estimate(loop.linear("consecutive"), hx.LeastSquares())
    inside = error < 1.96 * forgetful.standard_errors
    share["b taken as exact"].append(inside.mean())

figure, axis = plt.subplots()
axis.axhline(95, color="black", linewidth=1, linestyle="--")
axis.text(sizes[-1], 96.6, "promised: 95 %", ha="right", va="bottom")
for (name, values), marker, colour in zip(
    share.items(), "os", ("C1", "C0"), strict=True
):
    axis.plot(sizes, 100 * np.array(values), marker=marker, color=colour, label=name)
axis.set(
    xlabel="poses of the second set, $N_2$ (first set: $N_1 = 7$)",
    ylabel="truth inside the interval (%)",
)
axis.set_ylim(50, 101)
axis.set_xscale("log")
axis.set_xticks(sizes, [str(n) for n in sizes])
axis.minorticks_off()
axis.set_title("Coverage of ± 1.96 standard errors, coordinates of the base point")
axis.legend(loc="lower left")
plt.show()

# %%
# The more poses the second set has, the better it *seems* to know a, while the error that comes from b does not shrink
# at all: the forgetful interval gets worse with more data.

for n_poses, bare, right in zip(sizes, *share.values(), strict=True):
    print(f"N2 = {n_poses:2d}: b taken as exact {bare:.0%}, carried {right:.0%}")
