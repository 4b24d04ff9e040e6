"""
Where the condition number misleads
===================================

The condition number κ of the equations is the classic measure of a set of poses. It depends on units, it says nothing
of the size of errors, and it counts unknowns that nobody asks for. Here is a case in which poses chosen by it are no
better than random ones, and one in which they are.
"""

# %%
# Type III: the length of a leg is held
# -------------------------------------
#
# The rows :math:`(V_i^T, 1)` are for the base point a and for the nuisance σ: lengths beside ones. The unit of length
# scales three columns of the four. So κ of the raw rows chooses seven of 300 poses, in units from 10 m to a
# millimetre; five draws of candidates show what is chance. Beside it stands Type I, whose raw rows have lengths in the
# columns of the direction. All six legs reach every pose: true lengths of 17.25 to 25.25 cm, legs up to 45° off the
# normal, x-y-z angles within ±25°.

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
LOOPS = {"direction": hx.loops.FixedDirection, "length": hx.loops.FixedLength}
SCALED = {"direction": slice(6, 9), "length": slice(0, 3)}  # columns with a length
UNITS = {"10 m": 1e-3, "m": 1e-2, "dm": 0.1, "cm": 1.0, "mm": 10.0}
COUNT, N = 300, 7


def raw(rows):
    """Rows (n, r, p) as they are, as information: not whitened, not scaled."""
    size = rows.shape[-1]
    names = tuple(f"x{i}" for i in range(size))
    squares = rows.transpose(0, 2, 1) @ rows
    return hx.PoseInformation(
        squares[None], np.zeros((1, size, size)), names, names, np.ones(size)
    )


def judge(loop, interest):
    """From sets of poses (…, N) to the predicted error of what is of interest."""
    information = loop.information(leg)

    def predicted(chosen):
        covariance = np.linalg.inv(information[chosen].sum(axis=-3))
        inner = covariance[..., :interest, :interest]
        return np.sqrt(np.trace(inner, axis1=-2, axis2=-1))

    return predicted


def compared(lock, seed):
    """Errors over that of a random seven: of κ in each unit, of A, and of random."""
    data = hx.candidates(robot, 3, lock, COUNT, noise, rng=seed).leg(3)
    loop = LOOPS[lock](data)
    predicted = judge(loop, loop.parameters.main.size)
    problem = loop.linear()
    rows = problem.matrix.reshape(COUNT, problem.rows_per_block, -1)
    errors = []
    for unit in UNITS.values():
        scale = np.ones(rows.shape[-1])
        scale[SCALED[lock]] = unit
        one = hx.select_poses(raw(rows * scale), N, "kappa", starts=3)
        errors.append(predicted(one.indices))
    rng = np.random.default_rng(seed)
    drawn = [rng.choice(COUNT, N, replace=False) for _ in range(1000)]
    random = predicted(np.array(drawn))
    best = predicted(hx.select_poses(loop, N, starts=3).indices)
    usual = np.median(random)
    return np.array(errors) / usual, best / usual, random / usual


results = {
    lock: [compared(lock, seed) for seed in range(count)]
    for lock, count in (("length", 5), ("direction", 2))
}

# %%
# One point is one draw of candidates. The dotted line is the median of random sevens, and 80 % of them lie in the band.
# A does not know of units: of one block of parameters the design is the same in all of them.

figure, axes = plt.subplots(1, 2, figsize=(9.2, 4.4), sharey=True)
place = np.arange(len(UNITS))
titles = {"length": "Type III, error of a", "direction": "Type I, error of a and b"}
for axis, (lock, draws) in zip(axes, results.items(), strict=True):
    random = np.concatenate([draw[2] for draw in draws])
    axis.axhspan(
        *np.quantile(random, [0.1, 0.9]), color="0.9", label="80 % of random sets"
    )
    axis.axhline(1, color="black", linestyle=":", linewidth=1)
    by_kappa = np.array([draw[0] for draw in draws])
    axis.plot(place, by_kappa.T, "o", color="C1", markersize=5)
    axis.plot(
        place, np.median(by_kappa, axis=0), "-", color="C1", label="least κ (median)"
    )
    best = np.mean([draw[1] for draw in draws])
    axis.axhline(best, color="C0", linewidth=2, label="A")
    axis.set_yscale("log")
    ticks = [0.2, 0.3, 0.5, 1, 2, 3, 5]
    axis.set_yticks(ticks, [str(tick) for tick in ticks])
    axis.minorticks_off()
    axis.set_xticks(place, list(UNITS))
    axis.set(xlabel="unit of length in the raw rows", title=titles[lock])
axes[0].set_ylabel("predicted error, over that of a random set")
axes[1].legend(loc="upper right")
plt.show()

# %%
# In metres κ finds what A finds; in millimetres it finds what chance finds. Nothing in κ tells which unit is right. In
# Type I it does well in all but the largest units.
#
# What it looks for
# -----------------
#
# Under this lock the platform's joint moves on a sphere about the base joint. Seen from above, the grey dots are the
# directions of the leg that candidates offer; seven of them are chosen.

data = hx.candidates(robot, 3, "length", COUNT, noise, rng=1).leg(3)
loop = hx.loops.FixedLength(data)
rows = loop.linear().matrix[:, None]
scales = {unit: np.array([UNITS[unit]] * 3 + [1]) for unit in ("m", "mm")}
chosen = {"A": hx.select_poses(loop, N, starts=3).indices}
for unit, scale in scales.items():
    one = hx.select_poses(raw(rows * scale), N, "kappa", starts=3)
    chosen[f"least κ, in {unit}"] = one.indices

joint = data.position + data.rotation @ leg.platform_point
direction = joint - leg.base_point
direction /= np.linalg.norm(direction, axis=1, keepdims=True)
figure, axes = plt.subplots(1, 3, figsize=(9.2, 3.6), sharey=True)
for axis, (name, one) in zip(axes, chosen.items(), strict=True):
    axis.plot(*direction[:, :2].T, ".", color="0.8", markersize=3)
    axis.plot(*direction[one, :2].T, "o", color="C1", markersize=7)
    axis.set_aspect("equal")
    axis.set(xlabel="direction of the leg, x", title=name)
axes[0].set_ylabel("y")
plt.show()

# %%
# A goes round the rim, and to the middle: the height of a is seen by how far the middle stands above the rim. κ in
# metres agrees. In millimetres three singular values belong to a and are large, and the least belongs to σ, whatever
# the poses are. κ then falls only where the *largest* falls. So it throws away what is known of a, and the directions
# come to lie nearly on one line:

for name, one in chosen.items():
    sigma = np.linalg.svd(rows[one, 0] * scales["mm"], compute_uv=False)
    values = " ".join(f"{value:7.2f}" for value in sigma)
    print(f"{name:18s} singular values in mm {values}   κ {sigma[0] / sigma[-1]:5.0f}")

# %%
# Real errors
# -----------
#
# 500 draws of uniform errors in ±0.01 cm and ±0.01°, weighted least squares, b known.

predicted = judge(loop, 3)
for name, one in chosen.items():
    exact = (data.position[one], data.rotation[one], data.length[one])
    often = [np.broadcast_to(array, (500, *array.shape)) for array in exact]
    noisy = noise.apply(*often, np.random.default_rng(2))
    seen = hx.LegMeasurements(*noisy, "length", noise, leg)
    problem = hx.loops.FixedLength(seen).linear()
    found = hx.estimate(problem, hx.LeastSquares(weights="model"))
    real = np.sqrt(np.mean(found.error(leg)["base_point"] ** 2))
    print(f"{name:18s} error of a {real:.4f} cm, predicted {predicted(one):.4f} cm")

# %%
# :doc:`/poses` goes on from here: which criterion to take instead, and what the indices O1…O5 have to do with it.
