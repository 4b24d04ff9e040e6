"""Every route of every combination against cvxpy + Clarabel at tolerance 1e-13, on random problems of all kinds."""

import cvxpy as cp
import numpy as np
import pytest

import hexopt as hx
from hexopt.estimators.convex.routes import GAP

LOSSES = [hx.Quadratic(), hx.Huber(), hx.GroupHuber(), hx.L1(), hx.GroupL1(), hx.Chebyshev()]
SMOOTH = (hx.Quadratic, hx.Huber, hx.GroupHuber)
KINDS = ["plain", "scaled", "tiny", "outliers", "edge"]
PRIORS = ["none", "gauss", "entry", "joint"]
BOUNDS = ["none", "box", "ball", "linear", "tied"]
BACKENDS = ["auto", "batched", "clarabel"]
PARTS, PROBLEMS = 4, 250  # a thousand in all
PARAMETERS = hx.Parameters((hx.Block("platform_point", 3, "cm"), hx.Block("base_point", 3, "cm")))
TIGHT = {"tol_gap_abs": 1e-13, "tol_gap_rel": 1e-13, "tol_feas": 1e-13, "max_iter": 200}


def random_problem(kind, rng):
    """Rows of unit variance, in blocks of three, of a problem of six unknowns; and the columns' scales."""
    blocks = int(rng.integers(3, 15))
    matrix = rng.normal(size=(3 * blocks, 6))
    if kind == "edge":  # nearly collinear columns
        matrix[:, 5] = matrix[:, :5] @ rng.normal(size=5) + 10.0 ** -rng.uniform(3, 7) * matrix[:, 5]
    noise = rng.normal(size=(blocks, 3))
    if kind == "outliers":
        bad = rng.uniform(size=blocks) < 0.2
        noise[bad] += rng.normal(size=(int(bad.sum()), 3)) * 10 ** rng.uniform(1, 3)
    scale = np.geomspace(1, 1e4, 6)[rng.permutation(6)] if kind == "scaled" else np.ones(6)
    truth = rng.normal(size=6)
    rhs = matrix @ truth + noise.reshape(-1)
    if kind == "tiny":
        rhs = 1e-6 * rhs
        truth = 1e-6 * truth
    return matrix * scale, rhs, scale, truth / scale


def parts(prior, bounds, centre, scale, kind, rng):
    """A prior and bounds near the truth, in whose units the columns are."""
    size = 1e-6 if kind == "tiny" else 1.0
    wide = size / scale
    mean = {"platform_point": centre[:3], "base_point": centre[3:] + 0.1 * wide[3:]}
    chosen = {
        "none": None,
        "gauss": hx.GaussianPrior(
            mean, {"platform_point": np.diag(scale[:3] ** -2.0), "base_point": np.diag((0.1 / scale[3:]) ** 2)}
        ),
        "entry": hx.Lasso(mean, float(rng.uniform(0.5, 20) * size * scale.min()), by="entry"),
        "joint": hx.Lasso(mean, float(rng.uniform(0.5, 20) * size * scale.min()), by="joint"),
    }[prior]
    off = rng.normal(size=6) * wide * 0.1
    sides = {
        "none": None,
        "box": hx.Box({"base_point": (centre[3:] + off[3:] - 0.1 * wide[3:], centre[3:] + off[3:] + 0.1 * wide[3:])}),
        "ball": hx.Ball({"platform_point": (centre[:3] + off[:3], 0.1 * wide[:3].min())}),
        "linear": hx.Linear({"platform_point": 1 / wide[:3], "base_point": -1 / wide[3:]}, lower=-0.1, upper=0.1),
        "tied": hx.Linear({"platform_point": [1 / wide[0], 0, 0], "base_point": [-1 / wide[3], 0, 0]}, equal=0.05),
    }[bounds]
    return chosen, sides


def objective_of(loss, z, prior, x):
    """The objective in cvxpy, written down by hand."""
    norms = cp.norm(cp.reshape(z, (z.size // 3, 3), order="C"), 2, axis=1)
    match loss:
        case hx.Quadratic():
            objective = 0.5 * cp.sum_squares(z)
        case hx.Huber():
            objective = 0.5 * cp.sum(cp.huber(z, loss.threshold))
        case hx.GroupHuber():
            objective = 0.5 * cp.sum(cp.huber(norms, loss.threshold))
        case hx.L1():
            objective = cp.norm1(z)
        case hx.GroupL1():
            objective = cp.sum(norms)
        case hx.Chebyshev():
            objective = cp.norm_inf(z)
    for i, name in enumerate(prior.mean if prior is not None else ()):
        part = x[3 * i : 3 * i + 3] - prior.mean[name]
        if isinstance(prior, hx.GaussianPrior):
            objective += 0.5 * cp.sum_squares(np.linalg.cholesky(np.linalg.inv(prior.covariance[name])).T @ part)
        else:
            objective += prior.strength * (cp.norm1(part) if prior.by == "entry" else cp.norm(part, 2))
    return objective


def constraints_of(bounds, x, scale):
    """The constraints in cvxpy, written down by hand."""
    match bounds:
        case hx.Box():
            (lower, upper), s = bounds.bounds["base_point"], scale[3:]
            return [cp.multiply(s, x[3:]) >= s * lower, cp.multiply(s, x[3:]) <= s * upper]
        case hx.Ball():
            point, radius = bounds.balls["platform_point"]
            return [cp.norm((x[:3] - point) / radius, 2) <= 1]
        case hx.Linear():
            side = bounds.coefficients["platform_point"][0] @ x[:3] + bounds.coefficients["base_point"][0] @ x[3:]
            lower, upper = bounds.lower[0], bounds.upper[0]
            return [side == lower] if lower == upper else [side >= lower, side <= upper]
    return []


def reference(matrix, rhs, loss, prior, bounds, scale):
    """The programme in scaled variables, solved about zero and then about the answer."""
    centre = np.zeros(6)
    for _ in range(2):
        t = cp.Variable(6)
        x = cp.multiply(centre + t, 1 / scale)
        z = (matrix / scale) @ t + ((matrix / scale) @ centre - rhs)
        programme = cp.Problem(cp.Minimize(objective_of(loss, z, prior, x)), constraints_of(bounds, x, scale))
        programme.solve(solver=cp.CLARABEL, **TIGHT)
        if t.value is None:
            break
        centre = centre + t.value
    return centre / scale


def value_of(matrix, rhs, loss, prior, x):
    """The objective by NumPy."""
    total = loss.total((matrix @ x - rhs).reshape(-1, 3))
    for rows in prior.rows(PARAMETERS) if prior is not None else []:
        total = total + rows.loss.total((rows.matrix @ x - rows.rhs).reshape(-1, rows.size))
    return float(total)


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("part", range(PARTS))
def test_all_routes_agree_with_the_reference(part):
    """Objectives to 1e-8, and values to 1e-6 σ where the optimum is unique; else the gap says which is right."""
    rng = np.random.default_rng(20 + part)
    seen = {}
    for number in range(PROBLEMS):
        loss = LOSSES[number % len(LOSSES)]
        kind, prior, bounds = (rng.choice(names) for names in (KINDS, PRIORS, BOUNDS))
        matrix, rhs, scale, truth = random_problem(kind, rng)
        known, held = parts(prior, bounds, truth, scale, kind, rng)
        problem = hx.LinearProblem(matrix, rhs, PARAMETERS, rows_per_block=3)
        expected = reference(matrix, rhs, loss, known, held, scale)
        best = value_of(matrix, rhs, loss, known, expected)
        for backend in BACKENDS:
            estimator = hx.ConvexEstimator(
                loss, known, held, weights=None, scale=1.0, backend=backend, covariance=False
            )
            try:
                found = hx.estimate(problem, estimator, throw=False)
            except hx.errors.InputError:
                assert backend == "batched"
                continue
            case = (backend, type(loss).__name__, kind, prior, bounds)
            seen.setdefault(case[:2], []).append(bool(found.ok))
            if not found.ok:
                assert backend != "auto", f"{case}: {found.status.name}, gap {found.gap:.1e}"
                continue
            assert found.gap <= GAP * (1 + found.objective), case
            # the reference may be the worse one: then our gap proves that it is
            assert found.objective <= best + 1e-8 * (1 + best), case
            assert found.objective >= best - max(1e-8 * (1 + best), 0.0) or found.gap <= best - found.objective, case
            if isinstance(loss, SMOOTH) and np.linalg.cond(matrix / scale) < 1e3 and found.gap <= 0.5e-12:
                rows = matrix.reshape(-1, 3, 6)
                z = (matrix @ found.values - rhs).reshape(-1, 3)
                change = found.values - expected
                apart = np.sqrt(change @ np.einsum("kdp,kdq->pq", rows, loss.curved(z, rows)) @ change)
                worse = np.sqrt(max(best - found.objective, 0.0) + 1e-14 * (1 + best))  # what the reference lacks
                assert apart <= 1e-6 + 2 * worse, case
    for case, oks in seen.items():
        assert np.mean(oks) > (0.9 if case[0] == "batched" else 0.97), case
