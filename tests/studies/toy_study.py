"""A study for the tests: quick, with scenarios that can be slow, fail, or tell what they see."""

import os
import sys
import time
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
import threadpoolctl

from studies.harness import Study, cli


@dataclass(frozen=True)
class Toy:
    key: str
    scale: float = 1.0
    act: str = ""


def run(scenario: Toy, n_sets: int, rng: np.random.Generator) -> pd.DataFrame:
    x = scenario.scale * rng.normal(size=(n_sets, 50))
    _act(scenario.act, bool(x[0, 0] > 0))
    gram = x @ x.T  # BLAS takes part, so its threads could change bits
    methods = {"mean": x.mean(axis=1), "median": np.median(x, axis=1), "gram": gram.sum(axis=1)}
    frames = [pd.DataFrame({"method": m, "repetition": np.arange(n_sets), "error": e}) for m, e in methods.items()]
    rows = pd.concat(frames, ignore_index=True)
    if scenario.act == "look":
        blas = [library["num_threads"] for library in threadpoolctl.threadpool_info()]
        rows = rows.assign(threads=max(blas), variable=os.environ.get("OPENBLAS_NUM_THREADS", ""))
    return rows


def _act(act: str, coin: bool) -> None:
    if act == "fail" or (act == "fail sometimes" and coin):
        raise ZeroDivisionError("no such luck,\nin two lines")
    if act == "die":
        os._exit(7)
    if act.startswith("sleep"):
        time.sleep(float(act.split()[1]))
    if act == "slow sometimes" and coin:
        time.sleep(0.7)


STUDY = Study("toy", run, [Toy("narrow", 0.1), Toy("wide, with: odd/characters", 10.0)], sets=50, chunk_size=8, seed=5)
STUDY = replace(STUDY, packages=())  # so that the tests stand while somebody edits hexopt
SLOW = replace(STUDY, name="slow", scenarios=[Toy("a", 1.0, "sleep 0.1"), Toy("b", 2.0, "sleep 0.1")], sets=96)

if __name__ == "__main__":  # a process of its own, to be killed
    import toy_study  # so that `run` is that of a module, as in the test

    sys.exit(cli.main(toy_study.SLOW))
