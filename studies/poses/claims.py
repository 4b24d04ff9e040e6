"""What is claimed of the designs, each claim with its figure and Monte-Carlo error."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd

from studies.baselines.claims import Claim
from studies.baselines.summaries import each, mean_of
from studies.poses.data import BEST
from studies.poses.designs import KAPPA, KAPPA_PAPER, REFINED, A, in_unit
from studies.poses.nominals import SINGLE
from studies.poses.raw import METRES
from studies.poses.scenarios import ROBOTS, SETTINGS
from studies.poses.summaries import against_random, efficiencies, promises

__all__ = ["LETTER", "TITLES", "WANTED", "claims"]

#: At N = 7, by how much A-optimal poses are to beat the median random set.
WANTED = {("I", "base"): 2.0, ("I", "platform"): 1.5, ("II", "platform"): 1.7, ("III", "base"): 3.3}
_NONE = (np.nan, np.nan)
TITLES = {name: robot.title for name, robot in ROBOTS.items()}
LETTER = {"base": "a", "platform": "b", "offset": "offset", "gain": "gain"}


def claims(rows: pd.DataFrame, measured: pd.DataFrame | None) -> list[Claim]:
    """All of them: from the rows, and from the real measurements, if there are some."""
    table = against_random(rows)
    parts = (_legs(table), _promised(rows), _misled(table), _nominal(rows), _real(measured))
    return [claim for part in parts for claim in part]


def _legs(table: pd.DataFrame) -> Iterator[Claim]:
    legs = table[(table.experiment == "legs") & (table.robot == "hand")]
    for (setting, block), least in WANTED.items():
        part = legs[(legs.setting == setting) & (legs.block == block)]
        for design, low in ((A, least), (REFINED, np.nan)):
            own = part[(part.design == design) & (part.estimator == BEST)]
            where = f"{SETTINGS[setting]}; N = 7, six legs"
            what = f"error of {LETTER[block]}, median random set over {design}"
            limits = _NONE if np.isnan(low) else (low, np.inf)
            yield Claim(f"{what}: mean of the legs", where, *limits, *_mean(own))
            worst = next(each(own.nsmallest(1, "gain")))
            yield Claim(f"{what}: least, leg {worst.leg}", where, *limits, worst.gain, worst.gain_error)
        random = part[(part.design == A) & (part.estimator == "paper")].set_index("leg").usual
        best = part[(part.design == A) & (part.estimator == BEST)].set_index("leg")
        both = random / best.rms
        what = f"error of {LETTER[block]}, the paper's estimator on median random poses over the best on A: mean"
        error = float((both * best.gain_error / best.gain).pow(2).sum() ** 0.5 / len(both))
        yield Claim(what, f"{SETTINGS[setting]}; N = 7, six legs", *_NONE, float(both.mean()), error)


def _mean(part: pd.DataFrame) -> tuple[float, float]:
    return float(part.gain.mean()), float(part.gain_error.pow(2).sum() ** 0.5 / len(part))


def _promised(rows: pd.DataFrame) -> Iterator[Claim]:
    table = promises(rows)
    for robot, title in TITLES.items():
        part = table[table.robot == robot].copy()
        part["far"] = (part.ratio - 1).abs()
        what = f"real over predicted error: mean of {len(part)} designs and points"
        yield Claim(what, title, 0.95, 1.05, *mean_of(part.ratio.to_numpy()))
        worst = next(each(part.nlargest(1, "far")))
        where = f"{title}, leg {worst.leg}; {SETTINGS[worst.setting]}, N = {worst.n_poses}; {worst.design}"
        yield Claim("the one that is furthest from 1", where, *_NONE, worst.ratio, worst.error)


def _misled(table: pd.DataFrame) -> Iterator[Claim]:
    """The worst that each condition number does."""
    for kappa in (KAPPA_PAPER, *map(in_unit, METRES), KAPPA, A):
        part = table[(table.design == kappa) & (table.estimator == BEST)]
        for blocks, words in ((("base", "platform", "offset"), "a, b or the offset"), (("gain",), "the gain")):
            for worst in each(part[part.block.isin(blocks)].nsmallest(1, "gain")):
                what = f"{kappa}: error over the median random one, at worst, of {words}"
                where = f"{TITLES[worst.robot]}, leg {worst.leg}; {SETTINGS[worst.setting]}, N = {worst.n_poses}"
                yield Claim(what, where, *_NONE, 1 / worst.gain, worst.gain_error / worst.gain**2)


def _nominal(rows: pd.DataFrame) -> Iterator[Claim]:
    table = efficiencies(rows, "nominal")
    for row in each(table[(table.design == SINGLE) & (table.off == 0.5)]):
        where = f"{SETTINGS[row.setting]}; every coordinate off by 0.5 cm, mean of {row.sets} nominals"
        what = "A-efficiency lost by a wrong nominal (%)"
        yield Claim(what, where, -np.inf, 0.6, 100 - 100 * row.mean, 100 * row.error)


def _real(measured: pd.DataFrame | None) -> Iterator[Claim]:
    if measured is None:
        return
    random = measured[measured.design == "random"].rms.to_numpy()
    for row in each(measured[measured.design != "random"]):
        limits = _NONE if "leg" in row.design else (95.0, np.inf)
        share = float((random > row.rms).mean())
        error = 100 * np.sqrt(share * (1 - share) / len(random))
        where = f"12 of 108 measured poses; {row.rms:.3f} mm, median random {np.median(random):.3f} mm"
        what = f"{row.design}: predicts the other poses better than random twelves (%)"
        yield Claim(what, where, *limits, 100 * share, error)
