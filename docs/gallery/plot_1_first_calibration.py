"""
A first calibration, and how sure it is
=======================================

Lock the direction of leg 3, measure the platform in seven poses, and solve one linear system for both joints of the
leg. Then repeat the whole experiment two thousand times: the spread of the results is what the covariance of the
single estimate had predicted.
"""

# %%
# One calibration
# ---------------
#
# The robot is the paper's. Each coordinate of the position is off by up to 0.01 cm, each Euler angle by up to 0.01°,
# each leg reading by up to 0.01 cm.

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
data = hx.simulate_leg(robot, leg=3, lock="direction", n_poses=7, noise=noise, rng=2)

loop = hx.loops.FixedDirection(data)
paper = loop.linear("consecutive")  # equation (5); its least squares is (7)
found = hx.estimate(paper, hx.LeastSquares())
print(found.summary())

# %%
# No initial guess was needed. The ± are standard errors, from the noise model carried through the differences of poses
# ("sandwich" covariance). The platform point is known several times better than the base point: the leg keeps its
# direction, so that only the changes of its length tell where it begins.
#
# The experiment, two thousand times
# ----------------------------------
#
# The same seven true poses, each time with new errors. All repetitions are one batch, hence one call.

exact = hx.simulate_leg(robot, leg=3, lock="direction", n_poses=7, rng=2)
shape = (2000, exact.n_poses)
noisy = noise.apply(
    np.broadcast_to(exact.position, (*shape, 3)),
    np.broadcast_to(exact.rotation, (*shape, 3, 3)),
    np.broadcast_to(exact.length, shape),
    np.random.default_rng(0),
)
again = hx.LegMeasurements(*noisy, lock="direction", noise=noise, nominal=leg)
loops = hx.loops.FixedDirection(again)
weighted = hx.LeastSquares(weights="model")
methods = {
    "paper: differences, unweighted": hx.estimate(
        loops.linear("consecutive"), hx.LeastSquares()
    ),
    "direct form, weighted": hx.estimate(loops.linear("direct"), weighted),
}

# %%
# Cloud and ellipse
# -----------------
#
# The ellipse is the one that should hold 95 % of the points, from the covariance of the *first* repetition alone,
# about the truth. (In two dimensions that is :math:`\chi^2 = 5.99`.)


def ellipse(covariance, chi2=5.991):
    """Points of the ellipse x' covariance⁻¹ x = chi2."""
    turn = np.linspace(0, 2 * np.pi, 200)
    return np.linalg.cholesky(chi2 * covariance) @ np.stack(
        [np.cos(turn), np.sin(turn)]
    )


figure, axes = plt.subplots(1, 2, figsize=(8.4, 4.8), sharex=True, sharey=True)
x, z = 0, 2
for axis, (name, result), colour in zip(
    axes, methods.items(), ("C1", "C0"), strict=True
):
    error = result.params["base_point"] - leg.base_point
    covariance = result.covariance_of("base_point")
    plane = covariance[0][np.ix_([x, z], [x, z])]
    flat = error[:, [x, z]]
    inside = np.einsum("ni,ij,nj->n", flat, np.linalg.inv(plane), flat) < 5.991
    axis.plot(error[:, x], error[:, z], ".", color=colour, markersize=2, alpha=0.5)
    axis.plot(*ellipse(plane), color="black", label="predicted, 95 %")
    axis.plot(0, 0, "+", color="black", markersize=12, label="truth")
    mean = result.error(leg)["base_point"].mean()
    axis.set_title(f"{name}\n{inside.mean():.1%} inside, mean error {mean:.3f} cm")
    axis.set_xlabel("error of base point, x (cm)")
    axis.set_aspect("equal")
axes[0].set_ylabel("error of base point, z (cm)")
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=2)
plt.show()

# %%
# The weighted estimate uses the same readings. It differs in two points: the *direct* form keeps the unknown direction
# as a parameter, so that errors of different poses stay independent, and ``weights="model"`` makes each row count by
# its standard deviation. The cloud shrinks, and the predicted ellipse shrinks with it.
