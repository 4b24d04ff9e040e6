"""
Efficiency: how far from the best that is possible?
===================================================

Under normal errors no unbiased estimator can be more exact than the Cramér–Rao bound. The bound is known before any
estimator is: :meth:`Loop.crlb <hexopt.loops.FixedDirection.crlb>` takes the poses, the noise model and the true
geometry. So an estimator can be measured against what is possible, and not only against another one.
"""

# %%
# Four estimators on the same sets
# --------------------------------
#
# Type I, leg 3, the paper's robot and pose ranges. The errors are normal here, with the standard deviations of
# uniform ones in ± 0.01 cm and ± 0.01°. Each error counts in units of the bound of its own set, and the shown
# figure is the root of the mean square: 1 is the best possible, and 1.5 needs 2.25 times as many measurements for
# the same accuracy.

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
SETS = 300


def normal(size):
    """Normal errors as large as uniform ones in ± size (cm and degrees)."""
    sigma = size / np.sqrt(3)
    return hx.NormalNoise(position=sigma, angle=np.deg2rad(sigma), length=sigma)


def loop_of(n_poses, noise):
    """Type I over a few hundred random sets; equal seeds give equal poses."""
    return hx.loops.FixedDirection(
        hx.simulate_leg(robot, 3, "direction", n_poses, SETS, noise=noise, rng=n_poses)
    )


estimators = {
    "the paper (consecutive)": ("consecutive", hx.LeastSquares(covariance=False)),
    "weighted (GLS, direct)": (
        "direct",
        hx.LeastSquares(weights="model", covariance=False),
    ),
    "unit norm kept": ("direct", hx.UnitNormLeastSquares(weights="model")),
    "maximum likelihood": (None, hx.MaximumLikelihood()),
}


def fitted(loop):
    """The estimate of each."""
    return {
        name: hx.estimate(loop.linear(form) if form else loop, estimator)
        for name, (form, estimator) in estimators.items()
    }


points = {"base_point": "base point a", "platform_point": "platform point b"}


def over_the_bound(found, bound, point):
    """RMS error over the bound, and the standard error of that figure."""
    variance = np.diagonal(bound, axis1=-2, axis2=-1)
    place = {"platform_point": slice(0, 3), "base_point": slice(3, 6)}[point]
    square = found.error(leg)[point] ** 2 / variance[:, place].sum(axis=-1)
    rms = np.sqrt(square.mean())
    return rms, square.std() / (2 * rms * np.sqrt(square.size))


counts = (4, 5, 7, 10, 15, 25, 40)
curves = {(name, point): [] for name in estimators for point in points}
for n_poses in counts:
    loop = loop_of(n_poses, normal(0.01))
    bound = loop.crlb(leg)  # (SETS, 6, 6), of b and a
    for name, found in fitted(loop).items():
        assert found.ok.all()
        for point in points:
            curves[name, point].append(over_the_bound(found, bound, point))

print("RMS error / bound              " + "".join(f"  N = {n:<3d}" for n in counts))
for (name, point), curve in curves.items():
    print(f"{name:24s} {point[:4]}   " + "".join(f"{rms:9.2f}" for rms, _ in curve))

# %%
# The bars are two standard errors of the Monte Carlo, to both sides. Points of one N are drawn side by side.

figure, axes = plt.subplots(1, 2, figsize=(9.2, 4.3), sharey=True)
for axis, (point, title) in zip(axes, points.items(), strict=True):
    axis.axhline(1, color="black", linewidth=1, linestyle="--", label="the bound")
    for k, (name, marker) in enumerate(zip(estimators, "os^D", strict=True)):
        rms, spread = np.array(curves[name, point]).T
        axis.errorbar(
            np.array(counts) * 1.045 ** (k - 1.5),
            rms,
            2 * spread,
            marker=marker,
            linewidth=1.3,
            capsize=2,
            label=name,
        )
    axis.set_xscale("log")
    axis.set_xticks(counts, [str(n) for n in counts])
    axis.minorticks_off()
    axis.set_xlabel("poses in a set, N")
    axis.set_title(title)
axes[0].set_ylabel("RMS error / Cramér–Rao bound")
axes[1].legend(loc="upper right")
plt.show()

# %%
# Weights alone bring the platform point to its bound, but not the base point: along the leg, a and the length of n
# are hard to tell apart, and that the length is 1 is known. Keeping it closes the gap.
# :class:`~hexopt.UnitNormLeastSquares` does so with a proof that no better point exists, for given weights;
# :class:`~hexopt.MaximumLikelihood` fits weights and errors to the answer too, which at errors as small as these
# changes nothing.

# %%
# Larger errors
# -------------
#
# The errors of the rotations and of the readings stand in the *matrix* of the linear equations, so that least
# squares is biased. The bias grows with the square of the errors, and is not made smaller by more poses. Here are
# 40 poses, and errors up to fifty times the paper's.

sizes = (0.01, 0.03, 0.1, 0.2, 0.5)
worse = {name: [] for name in estimators}
print("errors (cm, °)            RMS / bound   bias / size of the errors (base point)")
for size in sizes:
    loop = loop_of(40, normal(size))
    bound = loop.crlb(leg)
    for name, found in fitted(loop).items():
        assert found.ok.all()
        rms, _ = over_the_bound(found, bound, "base_point")
        off = found.params["base_point"] - leg.base_point
        bias = np.linalg.norm(off.mean(axis=0)) / size
        spread = np.sqrt(off.var(axis=0).sum() / SETS) / size
        worse[name].append((rms, bias, spread))
        if size in (0.01, 0.5):
            print(f"{size:4.2f}  {name:24s}{rms:8.2f}   {bias:8.2f} ± {spread:.2f}")

figure, axis = plt.subplots(figsize=(7.2, 4.2))
for k, (name, marker) in enumerate(zip(estimators, "os^D", strict=True)):
    _, bias, spread = np.array(worse[name]).T
    axis.errorbar(
        np.array(sizes) * 1.06 ** (k - 1.5),
        bias,
        2 * spread,
        marker=marker,
        linewidth=1.3,
        capsize=2,
        label=name,
    )
axis.set_xscale("log")
axis.set_xticks(sizes, [str(size) for size in sizes])
axis.minorticks_off()
axis.set(
    xlabel="size of the errors (cm and degrees)",
    ylabel="bias of the base point / size of the errors",
)
axis.set_title("What more poses do not remove: bias at N = 40")
axis.legend(loc="upper left")
plt.show()

# %%
# Every estimator, with its equations and when it fails: :doc:`/baselines`.
