"""
From your CSV to a calibrated robot
===================================

The way of a real calibration: a laser tracker measured the pose of the platform, the controller logged the six leg
readings, and both lie in one CSV file. We make such a file by simulation, forget the truth, and calibrate from the file
and the design drawing alone.
"""

# %%
# A file as a tracker writes it
# -----------------------------
#
# The true robot differs from its drawing: each joint coordinate by up to 1 mm, each leg offset by up to 0.5 mm. Forty
# free poses, which all six legs can reach. The noise is normal: 0.02 mm on position and reading, 0.005° on a rotation.

import csv
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import hexopt as hx

drawing = hx.robots.left_hand()  # in cm
truth = drawing.perturbed(0.1, offsets=0.05, rng=7)
noise = hx.NormalNoise(
    position=0.002, angle=np.deg2rad(0.005), length=0.002, coordinates="rotation_vector"
)
logged = hx.simulate(truth, n_poses=40, noise=noise, rng=8)

folder = Path(tempfile.mkdtemp())
angles = np.rad2deg(hx.rotations.matrix_to_euler(logged.rotation, "xyz"))
with (folder / "tracker.csv").open("w", newline="") as file:
    writer = csv.writer(file)
    writer.writerow(["X", "Y", "Z", "Rx", "Ry", "Rz", *(f"L{k}" for k in range(1, 7))])
    rows = np.hstack([10 * logged.position, angles, 10 * logged.length])  # in mm, °
    writer.writerows([f"{value:.4f}" for value in row] for row in rows)
drawing.to_toml(folder / "drawing.toml")
for line in (folder / "tracker.csv").read_text().splitlines()[:3]:
    print(line)

# %%
# Read it
# -------
#
# Units and conventions are arguments and never guessed: lengths in mm, angles about the *fixed* axes x, y, z in
# degrees. Columns of other names are mapped. The robot's drawing is in cm; lengths are converted to its unit.

nominal = hx.Hexapod.from_toml(folder / "drawing.toml")
names = {"position_x": "X", "position_y": "Y", "position_z": "Z"}
names |= {f"orientation_{i + 1}": name for i, name in enumerate(("Rx", "Ry", "Rz"))}
names |= {f"leg_length_{k}": f"L{k}" for k in range(1, 7)}
(data,) = hx.read_measurements(
    folder / "tracker.csv",
    length_unit="mm",
    orientation="xyz",
    angle_unit="deg",
    columns=names,
    nominal=nominal,
    noise=noise,
)
print(data.n_poses, "poses, lock", data.lock, "in", data.length_unit)

# %%
# Calibrate
# ---------
#
# Thirty poses to calibrate, ten to check. Free poses, seven unknowns a leg: both joints and the offset (Model 42).

result = hx.calibrate(nominal, data.poses(slice(0, 30)), hx.FreePoses(model=42))
print(result.summary())

# %%
# Does it predict poses that it has not seen?
# -------------------------------------------

check = data.poses(slice(30, None))


def residual(robot):
    """Reading that the robot predicts, minus reading; mm, one column a leg."""
    return 10 * (
        hx.inverse_kinematics(robot, check.position, check.rotation) - check.length
    )


def rms(values):
    """Root mean square over the poses."""
    return np.sqrt(np.mean(np.square(values), axis=0))


print("RMS on the ten other poses (mm)     leg 1  leg 2  leg 3  leg 4  leg 5  leg 6")
for name, robot in (
    ("drawing", nominal),
    ("calibrated", result.robot),
    ("truth (noise alone)", truth),
):
    print(f"{name:34s}" + "".join(f"{value:7.3f}" for value in rms(residual(robot))))

written = result.robot.to_toml(folder / "calibrated.toml")  # for the controller

# %%
# Before and after
# ----------------
#
# Errors of the joints are too small to see beside the robot, so they are drawn thirty times as long.

figure = plt.figure(figsize=(9.2, 4.8))
zoom = 30


def joints(robot):
    """Base joints, and platform joints at home: (12, 3)."""
    return np.vstack([robot.base_points, robot.home_position + robot.platform_points])


right = joints(truth)
for place, (title, robot) in enumerate(
    (("drawing", nominal), ("calibrated", result.robot)), start=1
):
    axis = figure.add_subplot(1, 2, place, projection="3d")
    for ring, colour, label in (
        (right[:6], "C0", "base"),
        (right[6:], "C1", "platform"),
    ):
        axis.plot(*np.vstack([ring, ring[:1]]).T, color=colour, label=f"{label}, truth")
    for k in range(6):
        axis.plot(*right[[k, k + 6]].T, color="0.6", linewidth=1)
    error = joints(robot) - right
    for start, end in zip(right, right + zoom * error, strict=True):
        axis.plot(*np.stack([start, end]).T, color="black", linewidth=2)
    axis.plot([], [], color="black", linewidth=2, label=f"joint error × {zoom}")
    axis.set_title(f"{title}: largest joint error {10 * np.abs(error).max():.2f} mm")
    axis.set(xlabel="x (cm)", ylabel="y (cm)", zlabel="z (cm)")
    axis.set(xlim=(-16, 16), ylim=(-16, 16), zlim=(-2, 22))
    axis.set(xticks=(-10, 0, 10), yticks=(-10, 0, 10), zticks=(0, 10, 20))
    axis.set_box_aspect((32, 32, 24), zoom=0.87)
    axis.view_init(elev=22, azim=-65)
handles, labels = axis.get_legend_handles_labels()
figure.legend(handles, labels, loc="outside lower center", ncols=3)
plt.show()

# %%
# On the command line the last steps are one command; ``hexopt calibrate --help`` explains it.
