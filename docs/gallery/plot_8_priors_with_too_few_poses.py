"""
Priors, and fewer poses than unknowns
=====================================

The drawing of a robot says where its joints are, to the tolerance of the workshop. That is information, and a prior
lets it in: with few poses it decides what the measurements do not, and with many it hardly matters. The estimate says
which of the two spoke.
"""

# %%
# Two poses, and what they decide
# -------------------------------
#
# Type II (the lock ``"leg"``) turns the platform about the still point c. Between two poses that is one turn, and
# along its axis b may lie anywhere. No estimator can find it; plain least squares refuses.

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
TOLERANCE = 0.1  # cm: standard deviation of a joint's coordinate in the workshop
drawing = robot.perturbed(
    TOLERANCE, rng=3
)  # the nominal; here it is the drawing that is off
noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
two = hx.simulate_leg(robot, 3, "leg", 2, noise=noise, nominal=drawing, rng=2)
problem = hx.loops.FixedLeg(two).linear()

refused = hx.estimate(problem, hx.LeastSquares(weights="model"), throw=False)
print(f"without a prior: {refused.status.name},")
print(f"unseen: {'; '.join(refused.unseen)}")

prior = hx.GaussianPrior.around(two.nominal, TOLERANCE)
found = hx.estimate(problem, hx.ConvexEstimator(prior=prior))
print(f"with a prior: {found.status.name},")
print(f"decided by it: {'; '.join(found.decided)}")
labels = found.parameters.labels
for label, value, sure in zip(labels, found.values, found.standard_errors, strict=True):
    print(f"  {label:17s} {value:9.4f} ± {sure:.4f} cm")

# %%
# ``found.decided`` names the combination that the measurements did not see. It is the axis of the turn, in the
# platform frame; along it the standard error is the prior's, across it the measurements'.

turn = two.rotation[0].T @ two.rotation[1]
axis = np.array(
    [turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]
)
axis /= np.linalg.norm(axis)
variance, direction = np.linalg.eigh(found.covariance_of("platform_point"))
print(f"largest standard error of b {np.sqrt(variance[2]):.4f} cm,")
print(
    f"at {np.rad2deg(np.arccos(min(1, abs(direction[:, 2] @ axis)))):.2f}° from the axis of the turn"
)
print(f"the two others {np.sqrt(variance[1]):.4f} and {np.sqrt(variance[0]):.4f} cm")

# %%
# Bounds
# ------
#
# A :class:`~hexopt.Box` knows less: that each coordinate of b is inside, not where. As long as no side of it is
# touched it decides nothing, and by itself does not make the answer unique:

box = hx.Box.around(two.nominal, 3 * TOLERANCE)
alone = hx.estimate(problem, hx.ConvexEstimator(bounds=box), throw=False)
print(f"box alone: {alone.status.name}")
print(f"unseen: {'; '.join(alone.unseen)}")

# %%
# Where a side is touched, it holds the answer with a force, and what is said of that direction is said by the bound.
# Here a gauge has measured b.x, and allows a narrow range that ends short of where the prior and the poses meet:

reach = found.params["platform_point"][0]
gauge = hx.Box(
    {
        "platform_point": (
            [reach + 0.02, -np.inf, -np.inf],
            [reach + 0.06, np.inf, np.inf],
        )
    }
)
held = hx.estimate(problem, hx.ConvexEstimator(prior=prior, bounds=gauge))
print("force of the bound on b (1/cm):", held.duals["box"][:3].round(3))
for name, one in (("prior", found), ("prior and box", held)):
    print(
        f"{name:14s} b = {one.params['platform_point'].round(4)} ± {one.standard_errors[:3].round(4)}"
    )

# %%
# A negative force is that of a lower bound. The direction in which it acts has no standard error any more: given the
# bound, it is known. The z of b, which the turn ties to x, becomes as sure as the measurements.

# %%
# The same happens in Type I, where two poses give six equations for nine unknowns:

direction_set = hx.simulate_leg(
    robot, 3, "direction", 2, noise=noise, nominal=drawing, rng=4
)
found = hx.estimate(
    hx.loops.FixedDirection(direction_set).linear(), hx.ConvexEstimator(prior=prior)
)
for number, one in enumerate(found.decided, start=1):
    print(f"{number}. {one}")

# %%
# From the prior to the measurements
# ----------------------------------
#
# Over 400 robots, each off its drawing by as much as the workshop promises, and with a set of N poses each: the error
# of the base point by weighted least squares, with the prior, and with a *wrong* prior, of a workshop that promises
# 0.1 cm and keeps 0.5 cm.

SETS = 400
counts = (2, 3, 4, 5, 7, 10, 15, 20, 30, 50)
rng = np.random.default_rng(0)
curves = {"no prior": [], "right prior": [], "wrong prior": []}
inside = {"right prior": [], "wrong prior": []}
chi2 = {"right prior": [], "wrong prior": []}


def drawn(off):
    """Priors ± TOLERANCE about drawings that are off by `off` (standard deviation), one a set."""
    mean = {
        name: leg.block(name) + off * rng.standard_normal((SETS, 3))
        for name in ("platform_point", "base_point")
    }
    return hx.GaussianPrior(mean, dict.fromkeys(mean, TOLERANCE**2), unit="cm")


priors = {"right prior": drawn(TOLERANCE), "wrong prior": drawn(0.5)}
for n_poses in counts:
    data = hx.simulate_leg(
        robot, 3, "direction", n_poses, n_sets=SETS, noise=noise, rng=n_poses
    )
    problem = hx.loops.FixedDirection(data).linear()
    plain = np.nan
    if n_poses >= 3:
        weighted = hx.LeastSquares(weights="model", covariance=False)
        plain = np.median(hx.estimate(problem, weighted).error(leg)["base_point"])
    curves["no prior"].append(plain)
    for name, prior in priors.items():
        found = hx.estimate(problem, hx.ConvexEstimator(prior=prior))
        curves[name].append(np.median(found.error(leg)["base_point"]))
        where = found.parameters["base_point"]
        off = np.abs(found.values[:, where] - leg.base_point)
        inside[name].append((off < 1.96 * found.standard_errors[:, where]).mean())
        chi2[name].append(np.mean(found.chi2) / found.degrees_of_freedom)

looks = {
    "no prior": {"color": "black", "marker": "o", "ls": ":"},
    "right prior": {"color": "C0", "marker": "s"},
    "wrong prior": {"color": "C1", "marker": "^"},
}
figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 4.2))
for name, values in curves.items():
    left.plot(counts, values, label=name, **looks[name])
for name, values in inside.items():
    right.plot(counts, 100 * np.array(values), label=name, **looks[name])
right.axhline(95, color="black", linewidth=1, linestyle="--")
right.text(counts[0], 91, "promised: 95 %", va="top")
for panel in (left, right):
    panel.set_xscale("log")
    panel.set_xticks([2, 3, 5, 10, 20, 50], ["2", "3", "5", "10", "20", "50"])
    panel.minorticks_off()
    panel.set_xlabel("poses in a set, N")
left.set_yscale("log")
left.set_yticks([0.03, 0.1, 0.3, 1, 3], ["0.03", "0.1", "0.3", "1", "3"])
left.minorticks_off()
left.set_ylabel("error of the base point (cm), median")
left.set_title("Error")
left.legend(loc="upper right")
right.set_ylabel("truth inside ± 1.96 σ (%)")
right.set_ylim(0, 101)
right.set_title("Honesty, coordinates of the base point")
plt.show()

# %%
# The prior helps where poses are few, and stops mattering where they are many. A wrong prior does harm in both
# respects: its answer is worse than none as soon as the measurements could do better, and its standard errors promise
# too much. It does not stay hidden: χ², in which a normal prior counts like measurements, is far above its degrees of
# freedom.

print("  N   error of the base point (cm), median    mean χ² / degrees of freedom")
print("      no prior    right     wrong             right     wrong")
for row in zip(counts, *curves.values(), *chi2.values(), strict=True):
    print(
        f"{row[0]:3d} {row[1]:10.3f} {row[2]:8.3f} {row[3]:9.3f} {row[4]:17.2f} {row[5]:9.2f}"
    )

# %%
# A prior that may be broken
# --------------------------
#
# Where the drawing holds for most joints, but nobody knows for which, :class:`~hexopt.Lasso` is the honest prior: a
# joint stays exactly on the drawing, until the measurements pull harder than its strength. Here base joint 4 was
# moved by 0.5 cm when the machine was set up again, and the other five were not.

points = np.array(robot.base_points)
points[3] += [0.3, 0.4, 0.0]
moved = replace(robot, base_points=points)  # the machine; the drawing is `robot`
print("base joint   leaves the drawing by (cm)   force of the prior")
for k in range(1, 7):
    data = hx.simulate_leg(moved, k, "direction", 15, noise=noise, nominal=robot, rng=k)
    stay = hx.Lasso({"base_point": robot.leg(k).base_point}, strength=80.0, unit="cm")
    problem = hx.loops.FixedDirection(data).linear()
    found = hx.estimate(problem, hx.ConvexEstimator(prior=stay))
    distance = np.linalg.norm(found.params["base_point"] - robot.leg(k).base_point)
    force = np.linalg.norm(found.duals["prior"])
    print(f"{k:10d} {distance:20.4f} {force:26.1f} of {stay.strength:g}")

# %%
# It names the joint that moved, and finds it short of where it is: a lasso pulls back with its whole strength. So
# measure that joint again without it:

data = hx.simulate_leg(moved, 4, "direction", 15, noise=noise, nominal=robot, rng=4)
problem = hx.loops.FixedDirection(data).linear()
alone = hx.estimate(problem, hx.LeastSquares(weights="model"))
off = np.linalg.norm(alone.params["base_point"] - robot.leg(4).base_point)
print(f"joint 4 without a prior: {off:.4f} cm from the drawing")
