"""
How many poses, and which next?
===============================

Each pose costs minutes. Here is what the next one is worth, before it is measured; and, where some poses were measured
already, which five to add.
"""

# %%
# The error against the number of poses
# -------------------------------------
#
# Leg 3 keeps its direction of home. 1000 candidates within the machine's limits: true lengths of 17.25 to 25.25 cm,
# legs up to 45° off the base's normal, x-y-z angles within ±25°; errors uniform in ±0.01 cm and ±0.01°.

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
pool = hx.candidates(robot, 3, "direction", 1000, noise, rng=0).leg(3)
loop = hx.loops.FixedDirection(pool)
counts = (3, 4, 5, 6, 7, 8, 10, 12, 15, 20, 30)
designs = [hx.select_poses(loop, n) for n in counts]

hx.plots.error_against_poses(designs)
plt.show()

# %%
# From four on, the error of chosen poses falls nearly as :math:`1/\sqrt N`: new ones are no better than the old ones
# measured again, and from ten on one more gains less than 5 %. No choice of these candidates goes below the dashed
# line.
#
# Chosen and random poses, and the real error of the chosen ones over 1000 draws, by maximum likelihood (an RMS that
# these know to about 1 %):

rng = np.random.default_rng(1)
information = loop.information(leg)


def predicted(indices):
    """Error of a and b together (root mean square), of sets (…, N)."""
    covariance = np.linalg.inv(information[indices].sum(axis=-3))
    return np.sqrt(np.trace(covariance[..., :6, :6], axis1=-2, axis2=-1))


def measured(poses, n_sets, rng):
    """These poses, measured n_sets times with noise."""
    exact = (poses.position, poses.rotation, poses.length)
    often = [np.broadcast_to(one, (n_sets, *one.shape)) for one in exact]
    noisy = noise.apply(*often, np.random.default_rng(rng))
    return hx.LegMeasurements(*noisy, poses.lock, noise, poses.nominal)


def real(poses):
    """The error of a and b together over 1000 draws."""
    data = hx.loops.FixedDirection(measured(poses, 1000, rng=2))
    error = hx.estimate(data, hx.MaximumLikelihood()).error(leg)
    return np.sqrt(np.mean(error["base_point"] ** 2 + error["platform_point"] ** 2))


print(
    " N    chosen, predicted    real    random: best of 1000   median   1 of 10 above"
)
for n, design in zip(counts, designs, strict=True):
    drawn = [rng.choice(1000, n, replace=False) for _ in range(1000)]
    best, median, high = np.quantile(predicted(np.array(drawn)), [0, 0.5, 0.9])
    print(
        f"{n:2d}{np.sqrt(design.value):18.4f} cm{real(design.poses):8.4f}"
        f"{best:20.4f}{median:13.4f}{high:13.4f}"
    )

# %%
# Three poses are as many as there must be. Chosen well they serve; three random ones are likely to be useless.
#
# Seven are measured. Which five next?
# ------------------------------------
#
# Suppose seven poses were measured, without much thought: a typical random seven. They stay. ``measured=`` counts what
# they told, and the five new ones are those that tell the rest.

SEVEN = range(14, 21)
before = pool.poses(SEVEN)
first = hx.loops.FixedDirection(before)
more = hx.select_poses(loop, 5, measured=first)
print(more.summary())

# %%
# Five chosen poses bring more than five random ones, in every coordinate. To have chosen all twelve is better still.

old = hx.observability(first)
figure, axis = plt.subplots(figsize=(9.2, 3.6))
place = np.arange(6)
twelve = hx.select_poses(loop, 12)
others = np.setdiff1d(np.arange(1000), SEVEN)
drawn = [np.r_[SEVEN, rng.choice(others, 5, False)] for _ in range(1000)]
middle = drawn[np.argsort(predicted(np.array(drawn)))[500]]
blindly = np.sqrt(np.diag(np.linalg.inv(information[middle].sum(axis=0))))[:6]
for shift, (name, errors, colour, hatch) in enumerate(
    (
        ("seven, unchosen", old.standard_errors, "C3", ""),
        ("and five at random", blindly, "C1", "///"),
        ("and five chosen", more.standard_errors, "C0", ""),
        ("twelve chosen", twelve.standard_errors, "C2", "..."),
    )
):
    where = place + 0.2 * (shift - 1.5)
    axis.bar(where, errors, 0.18, color=colour, hatch=hatch, edgecolor="w", label=name)
axis.set_xticks(place, [label.replace("_point", "") for label in more.labels])
axis.set_ylabel("predicted error (cm)")
axis.legend()
plt.show()
print(f"seven, unchosen     {np.linalg.norm(old.standard_errors):.4f} cm, all together")
print(f"and five at random  {np.linalg.norm(blindly):.4f} cm")
print(f"and five chosen     {np.sqrt(more.value):.4f} cm")
print(f"twelve chosen       {np.sqrt(twelve.value):.4f} cm")

# %%
# The five of them, with the leg that is held:

hx.plots.pose_gallery(robot, more)
plt.show()

# %%
# :doc:`/poses` has more: repeats, costs, other criteria, and the choice of what the clamp holds.
