"""
Robust against bad poses
========================

A tracker loses its target, a joint sticks, a line of the file is of another day: some poses are wrong, by far more than
the noise. Least squares spreads such an error over everything. Robust losses bound the force of a residual, and the
duals of the estimate say which poses they held back.
"""

# %%
# Five estimators, with and without bad poses
# -------------------------------------------
#
# Every pose has the usual errors of ± 0.01 cm and ± 0.01°. Beside these, 15 % of the poses have jumped by 0.5 to 2
# cm. :class:`~hexopt.Outliers` tells the estimators nothing of it.

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
spoilt = hx.Outliers(noise, fraction=0.15, shift=(0.5, 2.0))
N, SETS = 20, 1000


def sets(model, n_sets=SETS):
    """Type I sets of leg 3; equal seeds give equal poses and equal small errors."""
    return hx.simulate_leg(
        robot, 3, "direction", N, n_sets=n_sets, noise=model, nominal=robot, rng=7
    )


estimators = {
    "the paper": ("consecutive", hx.LeastSquares(covariance=False)),
    "weighted (GLS)": ("direct", hx.LeastSquares(weights="model", covariance=False)),
    "Huber": ("direct", hx.ConvexEstimator(hx.Huber(1.345), covariance=False)),
    "GroupHuber": ("direct", hx.ConvexEstimator(hx.GroupHuber(2.5), covariance=False)),
    "L1": ("direct", hx.ConvexEstimator(hx.L1(), covariance=False)),
}
errors = {}
for kind, model in (("clean", noise), ("15 % bad poses", spoilt)):
    loop = hx.loops.FixedDirection(sets(model))
    for name, (form, estimator) in estimators.items():
        found = hx.estimate(loop.linear(form), estimator)
        assert found.ok.all()  # every answer is proven
        errors[kind, name] = found.error(leg)["base_point"]

print("error of the base point (cm)      median   95 %      mean")
for (kind, name), error in errors.items():
    median, high = np.quantile(error, [0.5, 0.95])
    print(f"{kind:15s} {name:15s} {median:9.4f} {high:9.4f} {error.mean():9.4f}")

# %%
# What bad poses cost each estimator, and what it costs to be prepared for them where there are none:

best = np.median(errors["clean", "weighted (GLS)"])
print("median error / that of GLS on clean poses      clean   15 % bad poses")
for name in estimators:
    clean, bad = (
        np.median(errors[kind, name]) / best for kind in ("clean", "15 % bad poses")
    )
    print(f"{name:43s} {clean:8.2f} {bad:12.2f}")

kinds = {"clean": ("C0", -0.19, ""), "15 % bad poses": ("C1", 0.19, "//")}
figure, axis = plt.subplots(figsize=(8.4, 4.4))
for kind, (colour, shift, hatch) in kinds.items():
    boxes = axis.boxplot(
        [errors[kind, name] for name in estimators],
        positions=np.arange(len(estimators)) + shift,
        widths=0.32,
        whis=(5, 95),
        showfliers=False,
        patch_artist=True,
        medianprops={"color": "black", "linewidth": 1.6},
        label=kind,
    )
    for box in boxes["boxes"]:
        box.set(facecolor=colour, hatch=hatch, edgecolor="black", alpha=0.8)
axis.set_yscale("log")
axis.set_yticks([0.01, 0.1, 1, 10], ["0.01", "0.1", "1", "10"])
axis.set_xticks(range(len(estimators)), list(estimators))
axis.set_ylabel("error of the base point (cm)")
axis.set_title(f"{SETS} sets of {N} poses; whiskers: 5 % and 95 %")
axis.legend(loc="upper right")
plt.show()

# %%
# Which poses were bad?
# ---------------------
#
# ``found.duals["rows"]`` holds the force of each whitened row, ψ of its residual. Of GroupHuber the force of a pose
# is its residual up to the threshold, and never more. The ratio of force to residual is the weight of the pose: 1 for
# a pose that is believed.

data, clean = sets(spoilt, 200), sets(noise, 200)
threshold = 2.5
problem = hx.loops.FixedDirection(data).linear()
found = hx.estimate(problem, hx.ConvexEstimator(hx.GroupHuber(threshold)))
matrix, rhs = problem.whitened()  # residuals in standard deviations
residual = (matrix @ found.values[..., None])[..., 0] - rhs
size = np.linalg.norm(residual.reshape(-1, N, 3), axis=-1)
force = np.linalg.norm(found.duals["rows"].reshape(-1, N, 3), axis=-1)
weight = force / size

bad = np.linalg.norm(data.position - clean.position, axis=-1) > 0.4  # the jumps
assert bad.any()
print(f"{bad.sum()} of {bad.size} poses are bad")
for name, which in (("good", ~bad), ("bad", bad)):
    low, middle, high = np.quantile(weight[which], [0.05, 0.5, 0.95])
    print(
        f"weight of {name:4s} poses: 5 % {low:.4f}, median {middle:.4f}, 95 % {high:.4f}"
    )
flagged = weight < 0.1
print(f"a weight below 0.1 finds {flagged[bad].mean():.1%} of the bad poses,")
print(f"and accuses {flagged[~bad].mean():.1%} of the good ones")

# %%
# One set of these, pose by pose:

one = int(np.argmax(bad.sum(axis=-1) == 3))
figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 4.0))
poses = np.arange(1, N + 1)
for name, which, colour, marker in (
    ("good pose", ~bad[one], "C0", "o"),
    ("bad pose", bad[one], "C1", "s"),
):
    left.plot(poses[which], weight[one][which], marker, color=colour, label=name)
    right.plot(size[one][which], force[one][which], marker, color=colour, label=name)
left.set(xlabel="pose", ylabel="weight")
left.set_xticks(poses[::3])
left.set_title("Weight of each pose in one set")
left.legend(loc="center right")
line = np.geomspace(size[one].min(), size[one].max(), 200)
right.plot(line, np.minimum(line, threshold), color="black", linewidth=1, zorder=1)
right.set_xscale("log")
right.set_xticks([1, 10, 100], ["1", "10", "100"])
right.set(xlabel="residual of the pose (σ)", ylabel="force of the pose (σ)")
right.set_title("GroupHuber: the force is bounded")
plt.show()

# %%
# A bad pose hits three rows at once. GroupHuber looks at the three together, so that it takes the pose back as a
# whole, whatever the direction of its jump. What to do with the list is for you to say: measure these poses again,
# look for a cause, or leave the estimate as it is. :doc:`/formulations` states what exactly is solved, and what is
# proven of it.
