"""What an estimate says of itself: its summary, and the error of one that failed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .errors import EstimationError, RankDeficientError

__all__ = ["failure_of", "summary_of"]

#: What to do about a failure, by its name.
_REMEDIES = {
    "INACCURATE": "the estimator's notes say what this means; more or other poses may mend it",
    "NOT_CONVERGED": "give more iterations or another start",
    "INFEASIBLE": "nothing meets all demands: loosen the constraints, or look for bad measurements",
    "FAILED": "look for bad measurements, or take another estimator",
}


def summary_of(found: Any, names: Mapping[int, str]) -> str:
    """A readable report of an estimate: of one problem or a batch.

    Parameters
    ----------
    found : Estimate
    names : dict of int to str
        What its codes are called.
    """
    return _of_batch(found, names) if found.batch_shape else _of_one(found, names)


def failure_of(found: Any, names: Mapping[int, str]) -> EstimationError:
    """The error that says how an estimate failed, and what to do; arguments as in :func:`summary_of`."""
    bad = [int(code) for code in found.codes.flat if names[int(code)] != "OPTIMAL"]
    share = f" in {len(bad)} of {found.codes.size} problems" if found.batch_shape else ""
    who, status = found.estimator.partition("(")[0], names[bad[0]]
    if status == "RANK_DEFICIENT":
        return RankDeficientError(
            f"{who}: the measurements{share} do not determine all parameters; unseen: "
            f"{'; '.join(found.unseen)}. Add poses that differ, or give these values as known",
            found.unseen,
        )
    return EstimationError(
        f"{who}: ended with status {status}{share}; no value can be trusted. What to do: {_REMEDIES[status]}"
    )


def _of_one(found: Any, names: Mapping[int, str]) -> str:
    """Values, units, standard errors, fit and certificate."""
    lines = [f"{_shortened(found.estimator)}: {names[int(found.codes)]}"]
    lines += [f"  unseen: {combination}" for combination in found.unseen]
    lines += [f"  decided by the prior or bounds, not by the measurements: {one}" for one in found.decided]
    errors = None if found.covariance is None else found.standard_errors
    position = 0
    for block in found.parameters:
        for label in block.labels:
            sure = "" if errors is None else f" ± {errors[position]:.3g}"
            note = "  (nuisance)" if block.nuisance else ""
            lines.append(f"  {label:<20s} {found.values[position]: .6f}{sure} {block.unit}{note}")
            position += 1
    lines.append(
        f"  ± is one standard error ({found.covariance_kind} covariance)"
        if errors is not None
        else f"  no standard errors: {found.covariance_kind}"
    )
    fit = f"  degrees of freedom {found.degrees_of_freedom}"
    if found.chi2 is not None:
        fit += f", χ² {float(found.chi2):.4g}"
    lines.append(
        f"{fit}, objective {float(found.objective):.4g}, gap {float(found.gap):.1e}, "
        f"condition {float(found.condition):.3g}"
    )
    if found.chi2 is not None and _is_improbable(float(found.chi2), found.degrees_of_freedom):
        lines.append(
            "  χ² is far beyond its degrees of freedom: a wrong lock, a bad pose, too small a noise, another minimum?"
        )
    return "\n".join(lines)


def _is_improbable(chi2: float, freedom: int) -> bool:
    """Whether χ² lies more than five standard deviations up, by Wilson and Hilferty's cube root."""
    if freedom < 1:
        return False
    spread: float = 2 / (9 * freedom)
    return bool((chi2 / freedom) ** (1 / 3) > 1 - spread + 5 * spread**0.5)


def _of_batch(found: Any, names: Mapping[int, str]) -> str:
    """How many members ended how, and means and spreads of the successes."""
    counts = {name: int((found.codes == code).sum()) for code, name in names.items()}
    text = ", ".join(f"{count} {name}" for name, count in counts.items() if count)
    lines = [f"{_shortened(found.estimator)}: a batch of {found.batch_shape}: {text}"]
    good = found.values[found.ok]
    if len(good):
        for label, mean, spread in zip(found.parameters.labels, good.mean(axis=0), good.std(axis=0), strict=True):
            lines.append(f"  {label:<20s} mean {mean: .6f}, spread {spread:.3g}")
    return "\n".join(lines)


def _shortened(text: str, length: int = 100) -> str:
    return text if len(text) <= length else text[: length - 1] + "…"
