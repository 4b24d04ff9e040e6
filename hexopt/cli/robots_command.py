"""``hexopt robots``: which robots are built in, and what one is."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ..arrays import norm
from ..errors import InputError
from ..geometry import Hexapod
from ..robots import BUILT_IN
from .options import Force, check_outputs, robot_of

__all__ = ["HELP", "NAME", "describe", "run"]

NAME = "robots"
HELP = """List the built-in robots, show one, or write its TOML file.

\b
  hexopt robots                            the list
  hexopt robots left-hand                  joints, sensors, limits, ranges
  hexopt robots left-hand --toml my.toml   a file to start your own from
  hexopt robots my.toml                    what a file holds

A leg has a joint on the base (a), one on the platform (b), and a sensor: true length = gain × reading + offset. A TOML
file needs name, length_unit, base_points and platform_points; it states each leg's offset and gain, where they are not
0 and 1, and the reading_unit, where the sensors do not report lengths.
"""


def run(
    robot: Annotated[
        str | None, typer.Argument(metavar="ROBOT", help="The robot to show: a built-in name, or a TOML file.")
    ] = None,
    toml: Annotated[Path | None, typer.Option(metavar="FILE.toml", help="Write the robot to this TOML file.")] = None,
    force: Force = False,
) -> None:
    """List robots, or show and write one."""
    if robot is None:
        if toml is not None:
            raise InputError("--toml: which robot? Write hexopt robots NAME --toml FILE")
        print(overview())
        return
    found = robot_of(robot)
    if toml is None:
        print(describe(found))
        return
    check_outputs([toml], [robot], force)
    print(f"wrote {found.to_toml(toml)}: {found.name}")


def overview() -> str:
    """A table of the built-in robots."""
    form = "{:<12s}{:<24s}{:<10s}{:<10s}{:>13s}{:>17s}   {}"
    lines = [form.format("name", "robot", "lengths", "readings", "base radius", "platform radius", "leg length")]
    for name, make in BUILT_IN.items():
        robot = make()
        low, high = robot.limits.leg_length or robot.ranges.length
        base, platform = (float(norm(points[:, :2]).max()) for points in (robot.base_points, robot.platform_points))
        lines.append(
            form.format(
                name,
                robot.name,
                robot.length_unit,
                robot.reading_unit,
                f"{base:.6g}",
                f"{platform:.6g}",
                f"{low:.6g} to {high:.6g}",
            )
        )
    return "\n".join(lines)


def describe(robot: Hexapod) -> str:
    """A robot in full: joints, sensors, home pose, limits, ranges."""
    unit, reading = robot.length_unit, robot.reading_unit
    lines = [f"{robot.name}: lengths in {unit}, leg readings in {reading}; true length = gain × reading + offset"]
    lines.append(f"  leg{'base point x, y, z':>39s}{'platform point x, y, z':>39s}{'offset':>13s}{'gain':>10s}")
    for leg in robot.legs:
        points = "".join(f"{value:>13.6g}" for value in (*leg.base_point, *leg.platform_point))
        lines.append(f"  {leg.number:<3d}{points}{float(leg.offset):>13.6g}{float(leg.gain):>10.6g}")
    x, y, z = robot.home_position
    turned = "" if np.array_equal(robot.home_rotation, np.eye(3)) else ", turned (see its TOML)"
    lines.append(f"  home position: {x:g}, {y:g}, {z:g} {unit}{turned}")
    lines.append(f"  limits: {robot.limits.describe(unit)}")
    lines.append(f"  random poses of one leg: {robot.ranges.describe(unit)}")
    return "\n".join(lines)
