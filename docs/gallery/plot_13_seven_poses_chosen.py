"""
Seven poses, chosen
===================

What a pose will tell can be computed before it is measured. :func:`~hexopt.select_poses` takes the seven of a
thousand that promise most, and says how far from the best seven they can be. This script pictures them, and then
measures them five hundred times to see whether the promise holds.
"""

# %%
# Candidates
# ----------
#
# A clamp holds leg 3 in its direction at home. Candidates are poses that all six legs reach on it: the limits are
# those of the machine.

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
pool = hx.candidates(robot, 3, "direction", 1000, noise, rng=0)

low, high = robot.limits.leg_length
print(f"true length of any leg    {low} to {high} cm")
print(f"legs, off the normal      up to {np.rad2deg(robot.limits.base_tilt):.0f}°")
half = np.rad2deg(robot.limits.angles[0])
print(f"angles ({robot.limits.sequence})              within ± {half:.0f}°")

# %%
# Seven of them
# -------------
#
# The criterion A is the sum of the variances of a and b. Efficiency says how much of the best possible is reached, at
# least: no other seven of these candidates can do better than the bound.

loop = hx.loops.FixedDirection(pool.leg(3))
chosen = hx.select_poses(loop, 7)
print(chosen.summary())

# %%
# Grey dots are all candidates; the platforms are the first four of the chosen, with the locked leg in each.

hx.plots.poses(robot, pool, chosen, most=4)
plt.show()

# %%
# The sheet to measure by. The locked leg is at one end of its stroke or at the other, and the platform is turned far,
# about axes that differ.

hx.plots.pose_gallery(robot, chosen)
plt.show()

turns = hx.rotations.matrix_to_rotation_vector(chosen.poses.rotation)
angles = np.linalg.norm(turns, axis=1)
print("pose   length of leg 3      turned by    about x, y, z")
for number, (length, angle, turn) in enumerate(
    zip(chosen.poses.length + leg.offset, angles, turns, strict=True), start=1
):
    axis = "".join(f"{part:7.2f}" for part in turn / angle)
    print(f"{number:3d}{length:15.1f} cm{np.rad2deg(angle):14.0f}° {axis}")

# %%
# Against random sevens
# ---------------------
#
# The predicted error of a and b together, of ten thousand random sevens. Information adds up over poses, so this takes
# one sum and one inverse each.

rng = np.random.default_rng(1)
information = loop.information(leg)


def predicted(indices):
    """Error of a and b together (root mean square), of sets (…, 7)."""
    covariance = np.linalg.inv(information[indices].sum(axis=-3))
    return np.sqrt(np.trace(covariance[..., :6, :6], axis1=-2, axis2=-1))


random = np.stack([rng.choice(1000, 7, replace=False) for _ in range(10_000)])
errors = predicted(random)
typical = random[np.argsort(errors)[len(errors) // 2]]

figure, axis = plt.subplots(figsize=(9.2, 3.6))
axis.hist(errors, bins=np.geomspace(0.02, 0.3, 80), color="C0", alpha=0.5)
axis.set_xscale("log")
ticks = [0.02, 0.03, 0.05, 0.1, 0.2, 0.3]
axis.set_xticks(ticks, [str(tick) for tick in ticks])
axis.minorticks_off()
axis.axvline(np.sqrt(chosen.bound), color="black", linewidth=1, linestyle="--")
axis.axvline(np.sqrt(chosen.value), color="C1", linewidth=2)
top = axis.get_ylim()[1]
axis.text(0.0237, 0.6 * top, "chosen", color="C1")
axis.text(0.0225, 0.6 * top, "bound", ha="right")
axis.text(0.066, 0.6 * top, "10 000 random sevens", color="C0")
axis.set(xlabel="predicted error of a and b (cm)", ylabel="sets", xlim=(0.019, 0.3))
plt.show()
print(f"chosen {predicted(chosen.indices):.4f} cm, median {np.median(errors):.4f} cm,")
print(f"the best of 10 000 random sevens {errors.min():.4f} cm")

# %%
# Where the base point will be: regions of 95 % probability, of the median random seven and of the chosen.

names = ["a typical random seven", "chosen"]
indices = [typical, chosen.indices]
bounds = [np.linalg.inv(information[one].sum(axis=0))[3:6, 3:6] for one in indices]
hx.plots.error_ellipsoids(bounds, names, unit="cm")
plt.show()

# %%
# Does the promise hold?
# ----------------------
#
# Both sets are measured 500 times, with uniform errors in ±0.01 cm and ±0.01°, and calibrated by the paper's estimator
# and by maximum likelihood. The prediction is for the second.


def measured(poses, n_sets):
    """These poses, measured n_sets times with noise."""
    exact = (poses.position, poses.rotation, poses.length)
    often = [np.broadcast_to(one, (n_sets, *one.shape)) for one in exact]
    noisy = noise.apply(*often, np.random.default_rng(2))
    return hx.LegMeasurements(*noisy, poses.lock, noise, poses.nominal)


def rms(values):
    return float(np.sqrt(np.mean(np.square(values))))


print("RMS error (cm)            of a     of b    a, predicted  b, predicted")
for name, one, bound in zip(names, indices, bounds, strict=True):
    data = hx.loops.FixedDirection(measured(pool.leg(3).poses(one), 500))
    mobile = np.linalg.inv(information[one].sum(axis=0))[:3, :3]
    print(name)
    for title, found in (
        ("the paper's", hx.estimate(data.linear("consecutive"), hx.LeastSquares())),
        ("likeliest", hx.estimate(data, hx.MaximumLikelihood())),
    ):
        error = found.error(leg)
        base, platform = rms(error["base_point"]), rms(error["platform_point"])
        row = f"    {title:18s}{base:8.4f} {platform:8.4f}"
        if title == "likeliest":
            row += f"{np.sqrt(np.trace(bound)):14.4f}{np.sqrt(np.trace(mobile)):14.4f}"
        print(row)

# %%
# Poses that are chosen help either estimator. :doc:`/poses` has the mathematics, and what is proven.
