"""
All readings of all legs
========================

While one leg is locked, the other five are measured too. The paper leaves these readings unused.
:class:`~hexopt.loops.WholeRobot` puts every set and every reading into one likelihood, in which the legs that were
seen in one pose share its error. :class:`~hexopt.Joint`, the default of :func:`~hexopt.calibrate`, is this.
"""

# %%
# Six sets
# --------
#
# Each leg in turn keeps its direction for seven poses. The paper's ranges of poses are for one leg alone: the real
# machine reaches hardly any of them with all six. So here it has no limits, and the lengths that this asks of the
# legs are printed. Its own limits come further down.

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

machine = hx.robots.left_hand()
ranges = replace(machine.ranges, lock_cone=np.deg2rad(40))
robot = replace(machine, limits=hx.Limits(), ranges=ranges)
nominal = robot.perturbed(0.1, offsets=0.1, rng=0)
noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
N, SETS = 7, 80
LEGS = range(1, 7)


def six_sets(robot, n_sets):
    """Type I sets of every leg with all six readings."""
    return [
        hx.simulate(robot, "direction", N, leg=k, n_sets=n_sets, noise=noise, rng=k)
        for k in LEGS
    ]


sets = six_sets(robot, SETS)
half = ", ".join(f"{np.rad2deg(angle):.0f}" for angle in ranges.angles)
print(f"angles ({ranges.sequence})              within ± {half}°")
print(f"length of the locked leg  {ranges.length[0]} to {ranges.length[1]} cm")
print(f"its direction, off home   up to {np.rad2deg(ranges.lock_cone):.0f}°")
reading = np.concatenate([data.length.ravel() for data in sets])
low, high = np.quantile(reading + robot.offsets[0], [0.01, 0.99])
print(f"length of any leg         {low:.1f} to {high:.1f} cm in 98 % of cases")

# %%
# One leg at a time, or all together
# ----------------------------------
#
# Both are maximum likelihood, on the same sets. One leg at a time is told the true offsets, as the paper supposes,
# since one direction cannot see them. All together finds them as well: Model 42, and the six directions.

together = hx.loops.WholeRobot(*sets, nominal=nominal)
joint = hx.estimate(together, hx.MaximumLikelihood())
assert joint.ok.all()
alone = [
    hx.loops.FixedDirection(data.leg(k)) for k, data in zip(LEGS, sets, strict=True)
]
single = [hx.estimate(loop, hx.MaximumLikelihood()) for loop in alone]
assert all(found.ok.all() for found in single)


def rms(values):
    """Over everything."""
    return float(np.sqrt(np.mean(np.square(values))))


def least(loop, truth):
    """The bounds of all blocks: roots of sums over coordinates, over all sets."""
    variance = np.diagonal(loop.crlb(truth), axis1=-2, axis2=-1)
    main = loop.parameters.main
    return {n: rms(np.sqrt(variance[..., main[n]].sum(axis=-1))) for n in main.names}


def both_bounds(loops, together, truth):
    """Of one leg at a time, and of all together: by block, for every leg."""
    one = [least(loop, truth.leg(k)) for k, loop in zip(LEGS, loops, strict=True)]
    every = least(together, truth)
    return {
        block: (
            [bound.get(block, np.nan) for bound in one],
            [every[f"leg{k}.{block}"] for k in LEGS],
        )
        for block in ("base_point", "platform_point", "offset")
    }


truth = joint.error(robot)
bounds = both_bounds(alone, together, robot)
errors = {
    block: (
        [
            rms(found.error(robot.leg(k)).get(block, 0))
            for k, found in zip(LEGS, single, strict=True)
        ],
        [rms(truth[f"leg{k}.{block}"]) for k in LEGS],
    )
    for block in bounds
}
print("RMS over the legs (bound), cm    one leg at a time      all together   ratio")
for block, (one, every) in errors.items():
    row = f"{rms(every):10.4f} ({rms(bounds[block][1]):.4f})"
    if block == "offset":
        print(f"{block:28s}{'told':>22s}{row}")
    else:
        told = f"{rms(one):.4f} ({rms(bounds[block][0]):.4f})"
        print(f"{block:28s}{told:>22s}{row}{rms(one) / rms(every):8.1f}")

# %%
# Lines are the bounds, points are the errors over 80 repetitions.

figure, axes = plt.subplots(1, 2, figsize=(9.2, 4.2), sharey=True)
titles = {"base_point": "base point a", "platform_point": "platform point b"}
ways = (("one leg at a time", "C1", "s"), ("all together", "C0", "o"))
for axis, (block, title) in zip(axes, titles.items(), strict=True):
    for way, (label, colour, marker) in enumerate(ways):
        place = np.array(LEGS) + (-0.08, 0.08)[way]
        axis.hlines(bounds[block][way], place - 0.25, place + 0.25, color=colour)
        axis.plot(place, errors[block][way], marker, color=colour, label=label)
    axis.set_yscale("log")
    ticks = [0.005, 0.01, 0.02, 0.05, 0.1]
    axis.set_yticks(ticks, [str(tick) for tick in ticks])
    axis.minorticks_off()
    axis.set(xlabel="leg", title=title, ylim=(0.005, 0.2))
axes[0].set_ylabel("RMS error (cm)")
axes[1].legend(loc="upper right")
plt.show()

# %%
# So much only where there is room. Within the machine's own limits on lengths and tilts the poses differ less, and
# the gain is smaller. The bound says so without a single estimate:

narrow = six_sets(machine, 30)
tight = hx.loops.WholeRobot(*narrow, nominal=machine)
apart = [
    hx.loops.FixedDirection(data.leg(k)) for k, data in zip(LEGS, narrow, strict=True)
]
print("bounds within the limits, cm     one leg at a time      all together   ratio")
for block, (one, every) in both_bounds(apart, tight, machine).items():
    if block == "offset":
        print(f"{block:28s}{'told':>22s}{rms(every):19.4f}")
    else:
        row = f"{rms(one):22.4f}{rms(every):19.4f}{rms(one) / rms(every):8.1f}"
        print(f"{block:28s}{row}")

# %%
# What makes the offsets visible
# ------------------------------
#
# A leg that keeps its direction cannot tell a step of a along it from an offset. The sets in which *other* legs are
# locked show it from other sides. One set of the whole robot brings as many unknowns of the other legs as
# equations, at seven poses: it says next to nothing more of its locked leg. Here are the bounds of leg 1 as sets
# are added; where its offset is not seen, all offsets are told.

b_and_a = ("platform_point", "base_point")
print("sets           a of leg 1 (cm)     its offset (cm)")
bound = least(alone[0], robot.leg(1))
print(f"1, leg 1 only{bound['base_point']:13.4f}{'told':>20s}")
for count in (1, 2, 3, 6):
    loop = hx.loops.WholeRobot(*sets[:count], nominal=robot)
    try:
        bound = least(loop, robot)
        offset = f"{bound['leg1.offset']:.4f}"
    except hx.errors.RankDeficientError as failure:
        print("  unseen:", failure.combinations[0].replace("leg1.", ""))
        loop = hx.loops.WholeRobot(*sets[:count], unknown=b_and_a, nominal=robot)
        bound, offset = least(loop, robot), "told"
    print(f"{count:<13d}{bound['leg1.base_point']:13.4f}{offset:>20s}")

# %%
# Where is the platform?
# ----------------------
#
# A user of the robot asks how far off the platform will be. The errors of the legs are strongly correlated, since
# they were seen in the same poses. :func:`~hexopt.pose_covariance` carries their joint covariance to a pose, here
# home. We send every calibrated robot home, and look where the true one is then. To drop the correlations *between*
# legs is to promise something else.

home, upright = robot.home_position, robot.home_rotation
main = together.parameters.main
same_leg = np.kron(np.eye(6), np.ones((7, 7)))
off, promises = [], {"all together": [], "legs as independent": []}
for i in range(SETS):
    found = {
        k: robot.leg(k).replaced(
            platform_point=joint.params[f"leg{k}.platform_point"][i],
            base_point=joint.params[f"leg{k}.base_point"][i],
            offset=joint.params[f"leg{k}.offset"][i, 0],
        )
        for k in LEGS
    }
    calibrated = robot.with_legs(found)
    reading = hx.inverse_kinematics(calibrated, home, upright)
    off.append(hx.forward_kinematics(robot, reading).position - home)
    covariance = joint.covariance_of(*main.names)[i]
    for promise, kept in zip(promises.values(), (1.0, same_leg), strict=True):
        matrix = hx.pose_covariance(calibrated, main, covariance * kept)
        promise.append(matrix[:3, :3])
off = 1e4 * np.array(off)  # µm

print("at home (µm)                x       y       z   inside ± 1.96:    x     y     z")
print(f"{'off, RMS':22s}" + "".join(f"{rms(axis):8.1f}" for axis in off.T))
for name, promise in promises.items():
    deviation = 1e4 * np.sqrt(np.diagonal(promise, axis1=-2, axis2=-1))
    inside = (np.abs(off) < 1.96 * deviation).mean(axis=0)
    row = "".join(f"{rms(axis):8.1f}" for axis in deviation.T)
    print(f"{name:22s}{row}{'':18s}" + "".join(f"{share:6.0%}" for share in inside))

# %%
# Dropping them promises too much of the height, and too little across. Each ellipse should hold 76 of the 80 points.

figure, axis = plt.subplots(figsize=(9.2, 2.9))
turn = np.linspace(0, 2 * np.pi, 200)
circle = np.sqrt(-2 * np.log(0.05)) * np.stack([np.cos(turn), np.sin(turn)])
axis.plot(
    off[:, 0], off[:, 2], "o", color="#5b6470", markersize=3.5, label="went there"
)
for (name, promise), colour, line in zip(
    promises.items(), ("C0", "C1"), ("-", "--"), strict=True
):
    flat = 1e8 * np.mean(promise, axis=0)[np.ix_([0, 2], [0, 2])]
    axis.plot(*(np.linalg.cholesky(flat) @ circle), line, color=colour, label=name)
axis.set_aspect("equal")
axis.set(xlabel="x (µm)", ylabel="z (µm)", title="The true platform, sent home")
axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
plt.show()

# %%
# The same for one robot and six files: ``hx.calibrate(nominal, sets)``, and ``.pose_covariance()`` of what it
# returns. :doc:`/baselines` has the equations.
