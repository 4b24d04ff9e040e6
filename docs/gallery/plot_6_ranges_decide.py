"""
Why the ranges decide the factors
=================================

The paper sums up its results in factors: mean error of a point over the input error. It does not print how far its
random poses reach, and that decides every factor. So no factor here stands without its ranges.
"""

# %%
# The factors under one set of ranges
# -----------------------------------
#
# The Left Hand's own ranges are ours, chosen once for all experiments.

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

robot = hx.robots.left_hand()
leg = robot.leg(3)
ERR = 0.01  # cm, and degrees
noise = hx.UniformNoise(position=ERR, angle=np.deg2rad(ERR), length=ERR)
solver = hx.LeastSquares(covariance=False)


def factors(ranges, n_sets=1000):
    """The four factors at N = 7 (III: N1 = N2 = 7), with Monte-Carlo errors."""

    def loop(kind, lock, **known):
        data = hx.simulate_leg(
            robot, 3, lock, 7, n_sets=n_sets, noise=noise, ranges=ranges, rng=len(lock)
        )
        return hx.estimate(kind(data, **known).linear("consecutive"), solver)

    one = loop(hx.loops.FixedDirection, "direction").error(leg)
    b = loop(hx.loops.FixedLeg, "leg")
    a = loop(hx.loops.FixedLength, "length", platform_point=b)
    errors = {
        "Type I, base": one["base_point"],
        "Type I, platform": one["platform_point"],
        "Type II, platform": b.error(leg)["platform_point"],
        "Type III, base": a.error(leg)["base_point"],
    }
    return {
        name: (error.mean() / ERR, error.std() / ERR / np.sqrt(n_sets))
        for name, error in errors.items()
    }


published = {
    "Type I, base": 13,
    "Type I, platform": 1.4,
    "Type II, platform": 1.4,
    "Type III, base": 2.8,
}
print(robot.ranges.describe("cm").replace("; ", "\n"))
print("                      paper   here   ± 1 s.e.")
for name, (mean, standard_error) in factors(robot.ranges).items():
    print(f"{name:20s} {published[name]:6.1f} {mean:7.2f}   {standard_error:.2f}")

# %%
# Vary one range at a time
# ------------------------

own = robot.ranges
middle = sum(own.length) / 2
sweeps = {
    "Euler angles (± degrees)": {
        x: replace(own, angles=(np.deg2rad(x),) * 3) for x in (5, 8, 12, 18, 25, 35, 50)
    },
    "spread of leg length (cm)": {
        x: replace(own, length=(middle - x / 2, middle + x / 2))
        for x in (0.5, 1, 2, 3.3, 5, 8)
    },
    "cone of directions (± degrees)": {
        x: replace(own, cone=np.deg2rad(x)) for x in (10, 15, 20, 30, 45, 68)
    },
}
stated = (35, 3.3, 68)
looks = {
    "Type I, base": {"color": "C0", "marker": "o"},
    "Type I, platform": {"color": "C1", "marker": "^"},
    "Type II, platform": {"color": "C2", "marker": "s"},
    "Type III, base": {"color": "C3", "marker": "D"},
}


def slope(x, y):
    """The exponent p of y ∝ x^p that fits best."""
    return np.polyfit(np.log(x), np.log(y), 1)[0]


slopes = {}
figure, axes = plt.subplots(1, 3, figsize=(10.2, 4.4), sharey=True)
for axis, (label, sweep), here in zip(axes, sweeps.items(), stated, strict=True):
    results = [factors(ranges, n_sets=400) for ranges in sweep.values()]
    curves = {name: [result[name][0] for result in results] for name in looks}
    slopes[label] = [slope(list(sweep), values) for values in curves.values()]
    for name, values in curves.items():
        axis.loglog(list(sweep), values, label=name, **looks[name])
    axis.axvline(here, color="black", linewidth=1, linestyle="--")
    axis.set_xticks(list(sweep), [f"{x:g}" for x in sweep])
    axis.minorticks_off()
    axis.set_xlabel(label)
axes[0].set_ylabel("mean error / input error, N = 7")
axes[0].set_yticks([1, 2, 5, 10, 20, 50, 100], ["1", "2", "5", "10", "20", "50", "100"])
axes[0].minorticks_off()
figure.suptitle("Dashed: the ranges used elsewhere in this documentation")
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
plt.show()

# %%
# The exponent p of *factor ∝ range^p* over each panel:

print(" " * 28 + "     I, base  I, platform  II, platform  III, base")
for label, exponents in slopes.items():
    print(f"{label:30s}" + "".join(f"{value:7.2f}      " for value in exponents))

# %%
# Each factor has its own master. The platform point is seen by rotating the platform, the base point of Type I by
# changing the leg's length: halve that range, and the factor doubles. The base point of Type III is seen by swinging
# the leg, and depends on it still more, since a small cap of a sphere is nearly flat; through b it depends on the
# rotations too. Between two papers, or two robots, factors compare only if the ranges agree.
