"""What is claimed of the baselines, each claim with its figure and Monte-Carlo error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from studies.baselines import summaries
from studies.baselines.methods import FK, IK, INNOCENTI, ML, PAPER
from studies.baselines.running import FIRST_FIT, PRIOR
from studies.baselines.scenarios import ERR, OFF, SETTINGS
from studies.baselines.summaries import Rows
from studies.baselines.together import ALONE, CARRIED, IGNORED, JOINTLY, PAPER_STEPS, SEPARATE, TOGETHER

__all__ = ["Claim", "claims", "ranges_of"]


@dataclass(frozen=True)
class Claim:
    """One figure, and what it was to be.

    Attributes
    ----------
    what, where : str
    low, high : float
        Between which it is to lie; infinite, or NaN where nothing is claimed.
    found, error : float
        With its Monte-Carlo error.
    """

    what: str
    where: str
    low: float
    high: float
    found: float
    error: float

    @property
    def wanted(self) -> str:
        """The interval in words."""
        if np.isnan(self.low):
            return "–"
        if np.isinf(self.high):
            return f"at least {self.low:g}"
        return f"at most {self.high:g}" if np.isinf(self.low) else f"{self.low:g} to {self.high:g}"

    @property
    def holds(self) -> str:
        """Yes or no; a dash where nothing is claimed."""
        if np.isnan(self.low):
            return "–"
        return "yes" if self.low <= self.found <= self.high else "no"


_NONE = (np.nan, np.nan)


def claims(every: Rows) -> list[Claim]:
    """All of them, from the rows."""
    return [
        claim for part in (_bound, _bias, _joint, _home, _chain, _innocenti, _starts, _running) for claim in part(every)
    ]


def ranges_of(cone: float) -> str:
    """Which poses six DIRECTION sets are of."""
    return "within the robot's limits" if np.isnan(cone) else f"no limits, locked directions within {cone:g}° of home"


def _bound(every: Rows) -> Iterator[Claim]:
    rows = every["trials"]
    table = summaries.efficiency(rows)
    for row in summaries.each(table[(table.method == ML)].drop_duplicates(["setting", "n_poses"])):
        where = f"{SETTINGS[row.setting]}; N = {row.n_poses}"
        yield Claim("ML: mean of eᵀC⁻¹e/p", where, 0.97, 1.03, row.normalised, row.normalised_error)
    part = rows[(rows.setting == "I") & (rows.n_poses == 7)]
    found = summaries.gain(part, ["n_poses"], PAPER, ML, "base_error").iloc[0]
    yield Claim(
        "RMS error of a: the paper's estimator over ML", "Type I; N = 7", 1.5, np.inf, found.gain, found.gain_error
    )


def _columns(*blocks: str) -> list[str]:
    return [f"{block}_{what}" for block in blocks for what in ("error", "bound")] + ["normalised"]


def _bias(every: Rows) -> Iterator[Claim]:
    rows = every["bias"]
    table = summaries.bias(rows, ["level"])
    for row in summaries.each(table[table.block == "base"]):
        limits = (-np.inf, 0.2) if row.method == ML else (2.5, 3.5) if row.level == 50 * ERR else _NONE
        where = f"Type I; N = 50, err = {row.level:g} cm and °"
        yield Claim(
            f"bias of a over err: {row.method}", where, *limits, row.bias / row.level, row.bias_error / row.level
        )


def _joint(every: Rows) -> Iterator[Claim]:
    rows = every["joint"]
    for column, least in (("base_error", 4.0), ("platform_error", 1.5)):
        for row in summaries.each(summaries.gain(rows, ["cone"], ALONE, TOGETHER, column)):
            what = f"six DIRECTION sets: RMS error of {column[:-6]} point, leg by leg over whole robot"
            yield Claim(what, f"N = 7; {ranges_of(row.cone)}", least, np.inf, row.gain, row.gain_error)
    rows = every["one set"]
    for row in summaries.each(summaries.gain(rows, ["n_poses"], ALONE, TOGETHER, "base_bound")):
        what = "one DIRECTION set: bound on a, its leg alone over all readings"
        limits = (0.99, 1.01) if row.n_poses == 7 else _NONE
        yield Claim(what, f"N = {row.n_poses}; within the robot's limits", *limits, row.gain, row.gain_error)


def _home(every: Rows) -> Iterator[Claim]:
    rows = every["home"]
    for row in summaries.each(summaries.covered(rows, ["n_poses"], "home_covered")):
        limits = (94.0, 96.0) if row.method == TOGETHER else _NONE
        what = f"position at home inside its 95 % interval (%): {row.method}"
        yield Claim(
            what, f"unlocked; N = {row.n_poses}, encoders ten times better", *limits, row.covered, row.covered_error
        )
    found = summaries.gain(rows, ["n_poses"], SEPARATE, TOGETHER, "home_error").iloc[0]
    what = "RMS error of the position at home: coupling dropped over whole robot"
    yield Claim(what, "unlocked; N = 30, encoders ten times better", *_NONE, found.gain, found.gain_error)


def _chain(every: Rows) -> Iterator[Claim]:
    rows = every["chain"]
    for steps in (PAPER_STEPS, IGNORED, CARRIED):
        for row in summaries.each(summaries.gain(rows, ["second"], steps, JOINTLY, "base_error")):
            limits = (1.4, np.inf) if row.second == 50 and steps != CARRIED else _NONE
            where = f"II + III; N1 = 7, N2 = {row.second}"
            yield Claim(f"RMS error of a: {steps} over joint ML", where, *limits, row.gain, row.gain_error)
    for row in summaries.each(summaries.covered(rows, ["second"], "base_covered")):
        limits = _NONE if row.method == IGNORED else (94.0, 96.0)
        where = f"II + III; N1 = 7, N2 = {row.second}"
        yield Claim(f"a inside its 95 % intervals (%): {row.method}", where, *limits, row.covered, row.covered_error)


def _innocenti(every: Rows) -> Iterator[Claim]:
    rows = every["ranges"]
    for cone, part in rows[(rows.method == INNOCENTI) & rows.ok].groupby("cone"):
        for short in ("base", "platform"):
            factor, error = summaries.mean_of(part[f"{short}_error"].to_numpy() / ERR)
            what = f"Innocenti: mean error of {short} point over err (the paper: near 15)"
            yield Claim(what, f"N = 7; angles ± 35°, directions within {cone:g}°", *_NONE, factor, error)


def _starts(every: Rows) -> Iterator[Claim]:
    table = summaries.shares(every["basin"])
    for row in summaries.each(table[(table.setting == "free") & table.method.isin([IK, FK]) & (table.off <= 1)]):
        limits = (99.0, np.inf) if row.method == IK and row.off == 0.5 else _NONE
        what = f"starts that lead to the truth (%): {row.method}"
        yield Claim(
            what,
            f"unlocked; N = 10, nominal off by {row.off:g} cm",
            *limits,
            100 * row.reached,
            100 * row.reached_error,
        )


def _running(every: Rows) -> Iterator[Claim]:
    rows = every["running"]
    last = rows[rows.poses_seen == rows.n_poses]
    for setting, title in SETTINGS.items():
        for off, most in ((OFF, 1.1), (0.5, 1.25)):
            part = last[(last.setting == setting) & (last.off == off)]
            for method in (FIRST_FIT, PRIOR):
                tried = int((part.method == method).sum())
                if not tried:
                    continue
                found = summaries.gain(part, ["n_poses"], method, ML, "base_error").iloc[0]
                where = f"{title}; N = 20, prior {off:g} cm; {found.sets} of {tried} sets succeeded"
                what = f"RMS error of a over that of ML: {method}"
                yield Claim(what, where, -np.inf, most, found.gain, found.gain_error)
