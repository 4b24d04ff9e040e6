"""
Differences of neighbours, or one row a pose
============================================

The paper eliminates the unknown direction by taking differences of consecutive poses. The *direct* form keeps it as an
unknown instead. Without noise both are exact. With noise they are not the same estimate.
"""

# %%
# The order of the poses
# ----------------------
#
# Nothing in the experiment depends on the order in which the poses were measured. The differences do: another order
# makes other neighbours. Here is one set of eight poses, in 300 random orders.

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
data = hx.simulate_leg(robot, 3, "direction", n_poses=8, noise=noise, rng=4)

rng = np.random.default_rng(0)
orders = np.array([rng.permutation(data.n_poses) for _ in range(300)])
shuffled = hx.LegMeasurements(
    data.position[orders],
    data.rotation[orders],
    data.length[orders],
    "direction",
    noise,
    leg,
)
loop = hx.loops.FixedDirection(shuffled)
points = {
    form: hx.estimate(loop.linear(form), hx.LeastSquares()).params["base_point"]
    for form in ("consecutive", "direct")
}
print("spread of the base point over the orders, x, y, z (cm)")
for form, found in points.items():
    print(f"  {form:12s}", np.array2string(found.std(axis=0), precision=2))

# %%
# What it costs
# -------------
#
# Mean error of the base point over 1000 sets for each number of poses, over the size of the input errors.

counts = (4, 5, 6, 7, 8, 10, 12, 15, 20, 30, 50)
estimators = {
    "consecutive, unweighted (paper)": (
        "consecutive",
        hx.LeastSquares(covariance=False),
    ),
    "direct, unweighted": ("direct", hx.LeastSquares(covariance=False)),
    "direct, weighted": ("direct", hx.LeastSquares(weights="model", covariance=False)),
}
curves = {name: [] for name in estimators}
for n_poses in counts:
    batch = hx.simulate_leg(
        robot, 3, "direction", n_poses, n_sets=1000, noise=noise, rng=n_poses
    )
    loop = hx.loops.FixedDirection(batch)
    for name, (form, solver) in estimators.items():
        found = hx.estimate(loop.linear(form), solver)
        curves[name].append(found.error(leg)["base_point"].mean() / 0.01)

figure, (left, right) = plt.subplots(1, 2, figsize=(9.2, 4.2))
error = {form: found - leg.base_point for form, found in points.items()}
left.plot(
    *error["consecutive"][:, [0, 2]].T,
    "o",
    color="C1",
    markersize=4,
    alpha=0.5,
    label="consecutive",
)
left.plot(
    *error["direct"][0, [0, 2]],
    "s",
    color="C0",
    markersize=8,
    label="direct: always here",
)
left.plot(0, 0, "+", color="black", markersize=12, label="truth")
left.set(xlabel="error of base point, x (cm)", ylabel="error of base point, z (cm)")
left.set_title("One data set in 300 orders")
left.legend(loc="best")

looks = (
    {"color": "C1", "marker": "o"},
    {"color": "C0", "marker": "s"},
    {"color": "black", "marker": ".", "ls": ":"},
)
for (name, values), look in zip(curves.items(), looks, strict=True):
    right.plot(counts, values, label=name, **look)
right.set_xscale("log")
right.set_yscale("log")
right.set_xticks(counts[::2], [str(n) for n in counts[::2]])
right.set_yticks([3, 5, 10, 20], ["3", "5", "10", "20"])
right.minorticks_off()
right.set(xlabel="poses in a set, N", ylabel="mean error of base point / input error")
right.set_title("1000 sets for each N")
right.legend(loc="best")
plt.show()

# %%
print(" " * 31 + "  N =" + "".join(f"{n:6d}" for n in counts[::2]))
for name, values in curves.items():
    print(f"{name:36s}" + "".join(f"{value:6.1f}" for value in values[::2]))

# %%
# Differences make the errors of neighbouring rows correlated; plain least squares does not know it. Told of the
# correlation, the two forms are the same estimate, whatever the order. With both weighted, at the same values:

at = hx.estimate(hx.loops.FixedDirection(data).linear("direct"), hx.LeastSquares())
weighted = {
    form: hx.estimate(
        hx.loops.FixedDirection(data).linear(form, at=at),
        hx.LeastSquares(weights="model"),
    )
    for form in ("consecutive", "direct")
}
difference = (
    weighted["consecutive"].params["base_point"]
    - weighted["direct"].params["base_point"]
)
print(f"the two weighted base points differ by {np.abs(difference).max():.0e} cm")
