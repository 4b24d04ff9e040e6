"""Times hexopt against plain code: ``python -m studies timing``."""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

import hexopt as hx
from studies.harness.task import single_threaded
from studies.timing.convex import against_cvxpy, against_loops
from studies.timing.likelihood import against_peers
from studies.timing.nonlinear import against_ipopt, against_scipy, seconds
from studies.timing.plain_loop import plain_loop
from studies.timing.selection import against_clarabel, against_exchange, against_free_poses, proofs

ERR = 0.01
POSES = (7, 20, 50)


def main(argv: Sequence[str] | None = None) -> int:
    """Measure, print the tables, and write them as CSV."""
    options = argparse.ArgumentParser(prog="python -m studies timing", description=__doc__)
    options.add_argument("--out", type=Path, default=Path("results/timing"), help="results [%(default)s]")
    options.add_argument(
        "--repeats", type=int, default=5, help="runs of each, of which the median counts [%(default)s]"
    )
    options.add_argument("--sets", type=int, default=2000, help="sets in one batch [%(default)s]")
    options.add_argument(
        "--whole", action="store_true", help="also time whole sweeps: growth with the sets, and memory"
    )
    options.add_argument(
        "--candidates", type=int, default=100_000, help="the most poses to choose from; else a hundredth [%(default)s]"
    )
    options.add_argument("--prove", type=float, default=60.0, help="seconds of branch and bound, at most [%(default)s]")
    options.add_argument("--only", nargs="+", metavar="TABLE", help="these tables, by the names of their files")
    chosen = options.parse_args(argv)
    chosen.out.mkdir(parents=True, exist_ok=True)
    tables = _tables(chosen.sets, chosen.candidates, chosen.repeats, chosen.prove)
    if unknown := set(chosen.only or ()) - set(tables):
        options.error(f"--only: no table {', '.join(sorted(unknown))}; there are {', '.join(tables)}")
    with single_threaded():
        for name in chosen.only or tables:
            _show(tables[name](), chosen.out / f"{name}.csv")
    if chosen.whole:
        _show(growth(chosen.repeats), chosen.out / "growth.csv")
    return 0


def _tables(sets: int, candidates: int, repeats: int, limit: float) -> dict[str, Callable[[], pd.DataFrame]]:
    """What is measured, by name."""
    few = candidates // 100
    return {
        "plain_loop": partial(against_plain_loop, sets, repeats),
        "convex": partial(against_cvxpy, sets, repeats),
        "loops": partial(against_loops, sets, repeats),
        "nonlinear": partial(against_scipy, sets, repeats),
        "ipopt": partial(against_ipopt, sets, repeats),
        "likelihood": partial(against_peers, sets, repeats),
        "candidates": partial(against_free_poses, candidates, repeats),
        "relaxations": partial(against_clarabel, few, repeats),
        "designs": partial(against_exchange, few, candidates, repeats),
        "proofs": partial(proofs, few, limit),
    }


def _show(table: pd.DataFrame, path: Path) -> None:
    print(table.to_string(index=False, float_format="{:.3g}".format), end="\n\n")
    table.to_csv(path, index=False)


def against_plain_loop(n_sets: int, repeats: int) -> pd.DataFrame:
    """Type I from random poses to errors, batch against loop, in turn in one process and on one thread."""
    robot = hx.robots.left_hand()
    leg, home = robot.leg(3), robot.home_vectors[2] / robot.home_lengths[2]
    noise = hx.UniformNoise(ERR, float(np.deg2rad(ERR)), ERR)
    solver = hx.LeastSquares(covariance=False)
    rows = []
    for n_poses in POSES:
        few = max(n_sets // 20, 20)

        def ours(n_poses: int = n_poses) -> dict[str, np.ndarray]:
            data = hx.simulate_leg(robot, 3, "direction", n_poses, n_sets, noise=noise, rng=1)
            return hx.estimate(hx.loops.FixedDirection(data).linear("consecutive"), solver).error(leg)

        for peer, by_pose in (("pose by pose", True), ("set by set", False)):

            def plain(n_poses: int = n_poses, few: int = few, by_pose: bool = by_pose) -> np.ndarray:
                rng = np.random.default_rng(1)
                return plain_loop(leg, home, robot.ranges, n_poses, few, ERR, rng, by_pose=by_pose)

            ours(), plain()  # warm
            pairs = [(seconds(plain) / few, seconds(ours) / n_sets) for _ in range(repeats)]
            rows.append(
                {
                    "poses N": n_poses,
                    "plain loop": peer,
                    "plain loop, µs a set": 1e6 * statistics.median(slow for slow, _ in pairs),
                    "hexopt, µs a set": 1e6 * statistics.median(fast for _, fast in pairs),
                    "ratio (median of pairs)": statistics.median(slow / fast for slow, fast in pairs),
                }
            )
    return pd.DataFrame(rows)


_SWEEP = """
import sys, resource
from studies.harness import sweep
from studies.paper.run import STUDY
sweep(STUDY, sys.argv[1], sets=int(sys.argv[2]), workers=1, only="direction, N=7, err=0.01")
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


def growth(repeats: int) -> pd.DataFrame:
    """Whole sweeps of one scenario (Type I, N = 7), each in a process of its own: time and peak memory."""
    rows = []
    for n_sets in (10_000, 100_000, 1_000_000):
        times, peak = [], 0.0
        for _ in range(repeats if n_sets < 1_000_000 else 1):
            with tempfile.TemporaryDirectory() as out:
                start = time.perf_counter()
                command = [sys.executable, "-c", _SWEEP, out, str(n_sets)]
                printed = subprocess.run(command, check=True, capture_output=True, text=True).stdout
                times.append(time.perf_counter() - start)
                peak = max(peak, int(printed.split()[-1]) * (1 if sys.platform == "darwin" else 1024) / 2**30)
        rows.append({"sets": n_sets, "seconds": statistics.median(times), "peak memory, GiB": peak})
    table = pd.DataFrame(rows)
    table["time over the row above"] = table["seconds"] / table["seconds"].shift()
    return table
