"""
The running estimate
====================

Poses of a calibration are measured one after the other, and each costs time. A filter has an estimate after every pose,
knows how good it is, and compares every new pose with what the poses before it foretold: it says when there are enough
poses, and which one to measure again while the robot still stands there.
"""

# %%
# An estimate after every pose
# ----------------------------
#
# :class:`~hexopt.Recursive` is weighted least squares, pose by pose. ``start`` takes the loop equation, ``step`` one
# more pose; a state is a value and never changes. Here the tracker loses its target once: pose 15 is 0.15 cm off.

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
N, BAD = 40, 15
good = hx.simulate_leg(robot, 3, "direction", N, noise=noise, nominal=robot, rng=21)
position = np.array(good.position)
position[BAD - 1] += [0.15, 0.0, 0.0]
data = replace(good, position=position)

loop = hx.loops.FixedDirection(data)


def run(estimator):
    """All poses, as if they arrived one by one."""
    state = estimator.start(loop)
    for i in range(N):
        state = estimator.step(state, data.poses([i]))
    return state


trusting, careful = run(hx.Recursive()), run(hx.Recursive(reject=True))
for n in (2, 3, 14, 15, N):
    now = careful.history[n - 1]
    text = now.status.name
    if now.ok:
        text += f", base point {careful.predicted_error['base_point'][n - 1]:.3f} cm"
    print(f"after {n:2d} poses: {text}")

# %%
# Below, the x coordinate of the base joint with its 95 % band, ± 1.96 standard errors. Before the third pose there is
# no estimate, and the status says so. A filter that takes the bad pose is off afterwards, well beyond its band, and
# good poses bring it back only slowly.

poses = np.arange(1, N + 1)
x = careful.parameters.labels.index("base_point.x")
truth = leg.base_point[0]
figure, axis = plt.subplots(figsize=(8.4, 4.4))
for name, state, colour, marker in (
    ("every pose counts", trusting, "C1", "s"),
    ("flagged poses are left out", careful, "C0", "o"),
):
    path = state.history
    value, error = path.values[:, x] - truth, path.standard_errors[:, x]
    axis.fill_between(
        poses, value - 1.96 * error, value + 1.96 * error, color=colour, alpha=0.25
    )
    axis.plot(poses, value, marker, color=colour, markersize=4, label=name)
axis.axhline(0.0, color="black", linewidth=1)
axis.axvline(BAD, color="black", linewidth=1, linestyle=":")
axis.text(BAD + 0.4, -0.4, "bad pose", va="center")
axis.set(xlabel="poses", ylabel="error of base_point.x (cm)", ylim=(-0.6, 0.6))
axis.set_title("The running estimate and its 95 % band")
axis.legend(loc="upper right")
plt.show()

# %%
# A bad pose, as it arrives
# -------------------------
#
# The innovation of a pose is what it says beyond what was foretold. Its square over its covariance is χ² distributed
# with three degrees of freedom, the rows of a pose; above the 99.9 % quantile a pose is flagged. Where the bad pose
# counts, it spoils the forecast for the poses after it too.

figure, axis = plt.subplots(figsize=(8.4, 4.0))
for name, state, colour, marker, shift in (
    ("every pose counts", trusting, "C1", "s", 0.12),
    ("flagged poses are left out", careful, "C0", "o", -0.12),
):
    axis.plot(poses + shift, state.nis, marker, color=colour, markersize=5, label=name)
    print(f"{name:27s} flagged: {np.flatnonzero(state.flagged) + 1}")
axis.axhline(16.27, color="black", linewidth=1, linestyle="--")
axis.text(N, 18, "99.9 %", ha="right", va="bottom")
axis.set_yscale("log")
axis.set(xlabel="pose", ylabel="normalised innovation squared")
axis.set_title("What each pose says that was not foretold")
axis.legend(loc="upper right")
plt.show()

assert careful.flagged[BAD - 1]
print("consistent:", trusting.consistent, careful.consistent)

# %%
# Enough poses
# ------------
#
# ``state.enough(base_point=0.06)`` is true once the predicted error of the base point is at most 0.06 cm. The
# prediction is a root mean square: of a single calibration the actual error may be half or twice as large. It comes
# from the geometry of the poses and the noise model, and a bad pose does not show in it: look at the innovations too.

predicted = careful.predicted_error["base_point"]
actual = careful.history.error(leg)["base_point"]
stop = careful.enough_after(base_point=0.06)
print(f"enough after {stop} poses: predicted error {predicted[stop - 1]:.3f} cm")

figure, axis = plt.subplots(figsize=(8.4, 4.0))
axis.plot(poses, predicted, "o", color="C0", markersize=4, label="predicted")
axis.plot(poses, actual, "^", color="C2", markersize=4, label="actual")
axis.axhline(0.06, color="black", linewidth=1, linestyle="--")
axis.axvline(stop, color="black", linewidth=1, linestyle=":")
axis.set_yscale("log")
axis.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5], ["0.02", "0.05", "0.1", "0.2", "0.5"])
axis.set(xlabel="poses", ylabel="error of the base point (cm)")
axis.set_title(f"0.06 cm are reached after {stop} poses")
axis.legend(loc="upper right")
plt.show()

# %%
# Equal to the batch, and a filter for nonlinear equations
# --------------------------------------------------------
#
# With weights taken at the same place the last state is the answer of all poses at once.
# :class:`~hexopt.Unscented` takes nonlinear equations: here the leg's direction stays a unit vector, as in
# :class:`~hexopt.MaximumLikelihood`. It fits the first poses together, then goes on with sigma points. From a wide
# prior alone, ``first=0``, it is off and too sure of itself: the normalised errors (NEES) tell, if the truth is known,
# and the innovations, if it is not.

clean = hx.loops.FixedDirection(good)
batch = hx.estimate(clean.linear(), hx.LeastSquares(weights="model"))
last = hx.estimate(clean, hx.Recursive())
apart = np.abs((last.values - batch.values) / batch.standard_errors).max()
print(f"recursive and batch agree to {apart:.0e} standard errors")

SETS, WIDTH = 100, 2.0
sets = hx.simulate_leg(robot, 3, "direction", 20, SETS, noise=noise, rng=5)
rng = np.random.default_rng(6)
mean = {
    name: leg.block(name) + WIDTH * rng.standard_normal((SETS, 3))
    for name in ("platform_point", "base_point")
}
prior = hx.GaussianPrior(mean, dict.fromkeys(mean, WIDTH**2), unit="cm")
free = hx.loops.FixedDirection(sets)
print("a prior of ± 2 cm, 20 poses:  median NEES (6 expected)  found out")
for name, estimator in (
    ("the prior alone", hx.Unscented(prior, first=0)),
    ("prior and first poses", hx.Unscented(prior)),
):
    state = estimator.scan(free)
    nees = np.median(state.nees(leg)[:, -1])
    print(f"{name:29s} {nees:14.1f} {state.overconfident.mean():18.0%}")
