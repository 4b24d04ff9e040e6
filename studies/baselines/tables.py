"""Tables of the report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from studies.baselines.claims import Claim
from studies.baselines.cost import FILE
from studies.baselines.methods import METHODS
from studies.baselines.scenarios import NOISES, SETTINGS
from studies.baselines.summaries import each
from studies.harness.tables import with_error

__all__ = ["biases", "claimed", "convergence", "cost", "errors"]

_NOISE_OF = {settings: name for name, settings in NOISES.items()}


def claimed(claims: Sequence[Claim]) -> pd.DataFrame:
    """The claims as rows."""
    return pd.DataFrame(
        [
            {
                "figure": claim.what,
                "of": claim.where,
                "wanted": claim.wanted,
                "found": with_error(claim.found, claim.error),
                "holds": claim.holds,
            }
            for claim in claims
        ]
    )


def errors(table: pd.DataFrame, noise: str) -> pd.DataFrame:
    """By setting, block and method: RMS error over err and its ratio to the bound, a column for each N; [failures]."""
    level = NOISES[noise][1]
    part = table[[_NOISE_OF[pair] == noise for pair in zip(table.errors, table.level, strict=True)]].copy()
    part["cell"] = [
        f"{row.rms / level:.3g} ({with_error(row.ratio, row.ratio_error)})"
        + f" [{row.failures}/{row.sets}]" * (row.failures > 0)
        for row in each(part)
    ]
    part["setting"] = part["setting"].map(SETTINGS)
    part["N"] = part["n_poses"]
    index = ["setting", "block", "method"]
    wide = part.pivot(index=index, columns="N", values="cell")
    order = pd.MultiIndex.from_frame(part[index].drop_duplicates())
    wide = wide.reindex(order).sort_index(level=["setting", "block"], sort_remaining=False, key=_ranked)
    wide.columns = [f"N = {n}" for n in wide.columns]
    return wide


def _ranked(level: pd.Index) -> pd.Index:
    places = {name: place for place, name in enumerate([*SETTINGS.values()])}
    return pd.Index([places.get(name, name) for name in level])


def biases(table: pd.DataFrame) -> pd.DataFrame:
    """Length of the mean signed error over err, ± its Monte-Carlo error."""
    part = table.copy()
    part["cell"] = [with_error(row.bias / row.level, row.bias_error / row.level) for row in each(part)]
    part["N"] = part["n_poses"]
    part["setting"] = part["setting"].map(SETTINGS)
    wide = part.pivot(index=["setting", "block", "method"], columns="N", values="cell")
    wide.columns = [f"N = {n}" for n in wide.columns]
    return wide


def convergence(table: pd.DataFrame) -> pd.DataFrame:
    """Per cent of starts that find the truth, and in brackets that end elsewhere and call that a success."""
    part = table.copy()
    part["cell"] = [f"{100 * row.reached:.3g} ({100 * row.elsewhere:.3g})" for row in each(part)]
    part["setting"] = part["setting"].map(SETTINGS)
    wide = part.pivot(index=["setting", "method"], columns="off", values="cell")
    wide.columns = [f"{off:g} cm" for off in wide.columns]
    return wide


def cost(out: Path) -> pd.DataFrame | None:
    """Milliseconds a set; None where nothing was timed."""
    path = out / FILE
    if not path.exists():
        return None
    table = pd.read_csv(path)
    table["milliseconds"] = table["microseconds"] / 1000
    table["setting"], table["N"] = table["setting"].map(SETTINGS), [f"N = {n}" for n in table["n_poses"]]
    wide = table.pivot(index="method", columns=["setting", "N"], values="milliseconds")
    return wide.reindex([name for name in METHODS if name in wide.index])
