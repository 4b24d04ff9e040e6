"""Losses: both faces of each, their conjugates, and what the certificate asks of them."""

import dataclasses
import pickle
from dataclasses import dataclass

import cvxpy as cp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import erf, gamma
from scipy.stats import chi

import hexopt as hx
from hexopt.errors import InputError
from hexopt.estimators.convex.uncertainty import normal_moments
from hexopt.losses import Loss

LOSSES = [
    hx.Quadratic(),
    hx.Huber(),
    hx.Huber(0.3),
    hx.GroupHuber(),
    hx.GroupHuber(0.7),
    hx.L1(),
    hx.L1(2.5),
    hx.GroupL1(),
    hx.GroupL1(0.4),
    hx.Chebyshev(),
]
SMOOTH = [loss for loss in LOSSES if loss.smooth]
#: Trailing dimensions of ρ.
DIMENSIONS = {"row": 2, "pose": 1, "all": 0}


@dataclass(frozen=True)
class PseudoHuber(Loss):
    """A loss of one's own: t²(√(1 + (z/t)²) − 1), row by row."""

    threshold: float = 1.5

    def rho(self, z):
        return self.threshold**2 * (np.sqrt(1 + np.square(z / self.threshold)) - 1)

    def psi(self, z):
        return z / np.sqrt(1 + np.square(z / self.threshold))

    def psi_prime(self, z):
        return (1 + np.square(z / self.threshold)) ** -1.5

    def conjugate(self, u):
        inside = np.abs(u) <= self.threshold
        root = np.sqrt(np.where(inside, 1 - np.square(u / self.threshold), 1.0))
        return np.where(inside, self.threshold**2 * (1 - root), np.inf)

    def expression(self, z):
        rows = cp.reshape(z, (z.size, 1), order="C")
        pair = cp.hstack([np.ones((z.size, 1)), rows / self.threshold])
        return self.threshold**2 * (cp.sum(cp.norm(pair, 2, axis=1)) - z.size)


EVERY = [*LOSSES, PseudoHuber()]


def residuals(*shape, seed=0):
    """Blocks of all sizes, from far below every threshold to far beyond."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=shape) * np.geomspace(0.05, 20, shape[-2])[:, None]


def summed(loss, value):
    axes = DIMENSIONS[loss.per]
    return value.sum(axis=tuple(range(-axes, 0))) if axes else value


def inside(loss, rng, shape=(6, 3)):
    """Duals in the domain of the conjugate, most of them in its interior."""
    u = rng.normal(size=shape) * 3
    return u * (loss.shrink(u) * rng.uniform(0.3, 1 - 1e-12))[..., None, None]


# --- one face against the other --------------------------------------------------------------------------


@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_psi_is_the_gradient_of_the_sum(loss, central_difference):
    z = residuals(6, 3)
    slope = central_difference(lambda v: loss.total(v.reshape(6, 3)), z.reshape(-1), step=1e-4)
    np.testing.assert_allclose(loss.psi(z).reshape(-1), slope, atol=1e-8)


@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_psi_prime_is_the_derivative_of_psi(loss, central_difference):
    z = residuals(6, 3)
    slope = central_difference(lambda v: loss.psi(v.reshape(6, 3)).reshape(-1), z.reshape(-1), step=1e-5)
    full = np.zeros((18, 18))
    prime = loss.psi_prime(z)
    if loss.per == "pose":
        assert prime.shape == (6, 3, 3)
        for i in range(6):
            full[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = prime[i]
    else:
        assert prime.shape == (6, 3)
        full[:] = np.diag(prime.reshape(-1))
    np.testing.assert_allclose(full, slope, atol=1e-5)


@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_curved_rows_are_psi_prime_times_the_rows(loss):
    z = residuals(2, 6, 3)
    rows = np.random.default_rng(1).normal(size=(2, 6, 3, 4))
    kept = rows.copy()
    prime = loss.psi_prime(z)
    expected = prime @ rows if loss.per == "pose" else prime[..., None] * rows
    np.testing.assert_allclose(loss.curved(z, rows), expected, atol=1e-13)
    np.testing.assert_array_equal(rows, kept)


@pytest.mark.parametrize("loss", [loss for loss in EVERY if loss.per != "all"], ids=repr)
def test_the_weight_times_the_residual_is_psi(loss):
    z = residuals(2, 6, 3)
    weight = loss.weight(z)
    assert weight.shape == z.shape[: 3 if loss.per == "row" else 2]
    wide = weight[..., None] if loss.per == "pose" else weight
    np.testing.assert_allclose(wide * z, loss.psi(z), rtol=1e-13)


@pytest.mark.parametrize("loss", [loss for loss in EVERY if loss.per != "all"], ids=repr)
def test_the_weight_at_zero_is_one(loss):
    np.testing.assert_array_equal(loss.weight(np.zeros((2, 3))), 1.0)


def test_the_largest_residual_has_no_weights():
    with pytest.raises(InputError, match="Chebyshev has no weights"):
        hx.Chebyshev().weight(np.ones((2, 3)))


@pytest.mark.parametrize("shape", [(6, 3), (5, 1), (1, 2)])
@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_numpy_and_cvxpy_agree(loss, shape):
    z = residuals(*shape)
    expression = loss.expression(cp.Constant(z))
    np.testing.assert_allclose(float(expression.value), loss.total(z), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_cvxpy_can_minimise_it(loss):
    z = cp.Variable((4, 3))
    assert cp.Problem(cp.Minimize(loss.expression(z))).is_dcp()


@pytest.mark.parametrize("threshold", [0.5, 1.345, 3])
def test_cvxpys_huber_is_twice_ours(threshold):
    z = residuals(6, 3)
    theirs = cp.huber(cp.Constant(z), threshold).value
    np.testing.assert_allclose(theirs, 2 * hx.Huber(threshold).rho(z), rtol=1e-14)


@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_a_batch_is_its_members(loss):
    z = residuals(2, 4, 6, 3)
    rho = loss.rho(z)
    assert rho.shape == z.shape[: 2 + DIMENSIONS[loss.per]]
    assert loss.total(z).shape == loss.shrink(z).shape == (2, 4)
    u = loss.psi(z) * 0.9
    assert loss.psi(z).shape == z.shape
    assert loss.conjugate(u).shape == rho.shape
    assert loss.excess(z, u).shape == (2, 4)
    rows = np.ones((2, 4, 6, 3, 5))
    assert loss.curved(z, rows).shape == loss.freed(z, u, rows).shape == rows.shape
    for i in np.ndindex(2, 4):
        np.testing.assert_array_equal(loss.psi(z)[i], loss.psi(z[i]))
        np.testing.assert_allclose(rho[i], loss.rho(z[i]), rtol=1e-15)
        np.testing.assert_allclose(loss.total(z)[i], loss.total(z[i]), rtol=1e-14)
        np.testing.assert_allclose(loss.excess(z, u)[i], loss.excess(z[i], u[i]), rtol=1e-13)


@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_the_total_sums_rho(loss):
    z = residuals(4, 6, 3)
    np.testing.assert_allclose(loss.total(z), summed(loss, loss.rho(z)), rtol=1e-15)


@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_nothing_comes_of_zero(loss):
    """ρ(0) = 0, a finite subgradient, and no warning."""
    z = np.zeros((4, 3))
    assert loss.total(z) == 0
    np.testing.assert_array_equal(loss.psi(z), 0)
    assert np.isfinite(loss.psi_prime(z)).all()
    assert np.isfinite(loss.curved(z, np.ones((4, 3, 2)))).all()
    assert loss.excess(z, loss.psi(z)) == 0
    assert loss.shrink(z) == 1


# --- the conventions ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("loss", [loss for loss in LOSSES if loss.curvature == 1], ids=repr)
def test_smoothed_losses_are_half_the_square_near_zero(loss):
    z = np.array([[0.1, -0.2, 0.05]])
    np.testing.assert_allclose(loss.total(z), 0.5 * np.square(z).sum(), rtol=1e-15)
    assert loss.smooth


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_it_is_the_support_function_of_its_ball(loss):
    """ρ(z) = max u'z − M‖u‖²/2 over the ball of the radius that it states, by cvxpy."""
    z = residuals(4, 3)
    u = cp.Variable((4, 3))
    size = {"row": cp.max(cp.abs(u)), "pose": cp.max(cp.norm(u, 2, axis=1)), "all": cp.sum(cp.abs(u))}[loss.per]
    value = cp.sum(cp.multiply(u, z)) - 0.5 * loss.curvature * cp.sum_squares(u)
    held = [size <= loss.bound] if np.isfinite(loss.bound) else []
    problem = cp.Problem(cp.Maximize(value), held)
    problem.solve(solver=cp.CLARABEL)
    np.testing.assert_allclose(problem.value, loss.total(z), rtol=1e-7)


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_the_degree_is_that_of_its_homogeneity(loss):
    z = residuals(6, 3)
    if loss.degree is None:
        assert abs(loss.total(3 * z) / loss.total(z) - 3) > 1e-3
        assert abs(loss.total(3 * z) / loss.total(z) - 9) > 1e-3
    else:
        np.testing.assert_allclose(loss.total(3 * z), 3**loss.degree * loss.total(z), rtol=1e-13)


def test_losses_of_poses_see_no_frame():
    """A rotation of every block changes nothing, unlike row by row."""
    z = residuals(6, 3)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(6, 3, 3)))[0]
    turned = (turn @ z[..., None])[..., 0]
    for loss in (hx.GroupHuber(), hx.GroupL1()):
        np.testing.assert_allclose(loss.rho(turned), loss.rho(z), rtol=1e-13)
        np.testing.assert_allclose(loss.psi(turned), (turn @ loss.psi(z)[..., None])[..., 0], atol=1e-13)
    assert abs(hx.Huber().total(turned) - hx.Huber().total(z)) > 1e-3


def test_the_largest_residuals_share_the_subgradient():
    z = np.array([[3.0, -3.0], [1.0, 3.0]])
    np.testing.assert_allclose(hx.Chebyshev().psi(z), np.array([[1, -1], [0, 1]]) / 3)


# --- the dual face ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("loss", EVERY, ids=repr)
@given(seed=st.integers(0, 10**6), power=st.floats(-3, 3))
def test_the_excess_is_what_fenchel_and_young_leave(loss, seed, power):
    """ρ + ρ* − u'z: never negative, and the closed form is the definition."""
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(6, 3)) * 10**power
    u = inside(loss, rng)
    slack = summed(loss, loss.rho(z)) + summed(loss, loss.conjugate(u)) - np.sum(u * z)
    size = 1 + loss.total(z) + np.abs(u * z).sum()
    excess = loss.excess(z, u)
    assert np.isfinite(slack)
    assert excess >= 0
    assert abs(excess - slack) <= 1e-12 * size


@pytest.mark.parametrize("loss", EVERY, ids=repr)
@given(seed=st.integers(0, 10**6), power=st.floats(-3, 3))
def test_the_excess_is_zero_at_a_subgradient(loss, seed, power):
    z = np.random.default_rng(seed).normal(size=(6, 3)) * 10**power
    assert 0 <= loss.excess(z, loss.psi(z)) <= 1e-13 * (1 + loss.total(z)) * (1 + np.abs(z).max())


@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_the_excess_is_positive_elsewhere(loss):
    z = residuals(6, 3)
    u = loss.psi(z)
    rng = np.random.default_rng(5)
    for share in (1e-3, 0.1, 0.9):
        other = (1 - share) * u + share * inside(loss, rng)
        assert loss.excess(z, other) > 1e-8 * share


@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_the_conjugate_is_the_largest_difference(loss):
    """ρ*(u) = sup u'z − ρ(z): over many z, the best comes near it, and none exceeds it."""
    u = inside(loss, np.random.default_rng(4), (1, 2))
    axis = np.linspace(-8, 8, 321)
    z = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 1, 2)
    values = np.einsum("nkd,kd->n", z, u) - loss.total(z)
    best = summed(loss, loss.conjugate(u))
    assert values.max() <= best + 1e-12
    assert values.max() >= best - 2e-3


@pytest.mark.parametrize("loss", [loss for loss in EVERY if not isinstance(loss, hx.Quadratic)], ids=repr)
@given(seed=st.integers(0, 10**6), power=st.floats(-2, 4))
def test_shrinking_brings_any_dual_into_the_domain(loss, seed, power):
    """To the last digit but one; whatever is inside is left as it is."""
    u = np.random.default_rng(seed).normal(size=(6, 3)) * 10**power
    less = loss.shrink(u)
    assert 0 <= less <= 1
    assert np.isfinite(summed(loss, loss.conjugate(less * u * (1 - 1e-15))))
    if less < 1:
        assert np.isinf(summed(loss, loss.conjugate(u)))
    small = u * less * 0.999
    assert loss.shrink(small) == 1


def test_a_quadratic_takes_every_dual():
    assert hx.Quadratic().shrink(np.full((2, 3), 1e9)) == 1


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_shrinking_does_not_go_further_than_it_must(loss):
    u = 7 * residuals(6, 3)
    less = loss.shrink(u)
    if np.isfinite(loss.bound):
        assert less < 1
        assert np.isinf(summed(loss, loss.conjugate(less * (1 + 1e-9) * u)))


@pytest.mark.parametrize("loss", EVERY, ids=repr)
def test_freed_rows_are_between_none_and_all(loss):
    """What multiplies the rows is a symmetric matrix between 0 and 1 (2 where turning adds to shrinking)."""
    rng = np.random.default_rng(6)
    z = residuals(6, 3)
    for u in (loss.psi(z), inside(loss, rng)):
        eye = np.eye(18).reshape(6, 3, 18)
        factor = loss.freed(z, u, eye).reshape(18, 18)
        np.testing.assert_allclose(factor, factor.T, atol=1e-15)
        values = np.linalg.eigvalsh(factor)
        assert values.min() >= -1e-14
        assert values.max() <= (2 if isinstance(loss, hx.GroupL1) else 1) + 1e-14


def test_duals_at_the_rim_of_their_ball_are_not_free():
    rows = np.ones((2, 3, 4))
    z, u = np.ones((2, 3)), np.array([[1, -1, 1], [0, 0, 0.25]])
    np.testing.assert_array_equal(hx.L1().freed(z, u, rows)[..., 0], [[0, 0, 0], [1, 1, 0.75]])
    u = np.array([[0, 1, 0], [0, 0, 0.25]])
    np.testing.assert_allclose(hx.GroupL1().freed(z, u, rows)[..., 0], [[0, 0, 0], [0.75] * 3], atol=1e-15)
    u = np.array([[0, 0.5, 0], [0, 0, 0.25]])
    np.testing.assert_array_equal(hx.Chebyshev().freed(z, u, rows)[..., 0], [[0, 1, 0], [0, 0, 0.5]])


# --- they are values ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [hx.Huber, hx.GroupHuber, hx.L1, hx.GroupL1])
@pytest.mark.parametrize("wrong", [0, -1, float("nan"), float("inf"), "a", True, None, 1j, [1.0]], ids=repr)
def test_a_bad_threshold_is_an_error_that_names_the_loss(kind, wrong):
    with pytest.raises(InputError, match=rf"^{kind.__name__}: (threshold|scale) must be a number > 0"):
        kind(wrong)


@pytest.mark.parametrize("number", [np.float64(2.0), np.float32(2.0), np.int64(2), 2])
def test_any_kind_of_number_is_a_threshold(number):
    assert hx.Huber(number) == hx.Huber(2.0)


@pytest.mark.parametrize("loss", LOSSES, ids=repr)
def test_a_loss_is_a_value(loss):
    assert pickle.loads(pickle.dumps(loss)) == loss
    assert eval(repr(loss), vars(hx) | {type(loss).__name__: type(loss)}) == loss
    assert hash(loss) == hash(dataclasses.replace(loss))
    names = [item.name for item in dataclasses.fields(loss)] or ["anything"]
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(loss, names[0], 1.0)


def test_losses_differ_by_kind_and_threshold():
    assert len(set(LOSSES)) == len(LOSSES)
    assert hx.L1(1.0) != hx.GroupL1(1.0)


def test_the_abstract_loss_says_what_is_missing():
    with pytest.raises(TypeError, match=r"abstract.*conjugate.*expression.*psi.*psi_prime.*rho"):
        type("Half", (Loss,), {})()


# --- a loss of one's own ------------------------------------------------------------------------------------


def small_problem(n_sets=4):
    noise = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
    data = hx.simulate_leg(hx.robots.left_hand(), 3, "leg", 8, n_sets, noise=noise, rng=2)
    return hx.loops.FixedLeg(data).linear("direct")


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
def test_a_loss_of_ones_own_is_solved_and_proven():
    """The batched Newton route and cvxpy agree; a small threshold makes it differ from least squares."""
    problem = small_problem()
    loss = PseudoHuber(0.8)
    found = {backend: hx.estimate(problem, hx.ConvexEstimator(loss, backend=backend)) for backend in ("auto", "cvxpy")}
    auto, by_cvxpy = found["auto"], found["cvxpy"]
    assert auto.ok.all()
    assert by_cvxpy.ok.all()
    assert (auto.gap <= 1e-8 * (1 + auto.objective)).all()
    np.testing.assert_allclose(auto.objective, by_cvxpy.objective, rtol=1e-8)
    sigma = auto.standard_errors
    assert (np.abs(auto.values - by_cvxpy.values) / sigma).max() < 3e-6
    plain = hx.estimate(problem, hx.ConvexEstimator())
    assert (np.abs(auto.values - plain.values) / sigma).max() > 0.05
    assert auto.covariance_kind == "sandwich"


def test_the_doubts_of_a_solver_are_no_warning():
    """Every answer is proven optimal; cvxpy's "Solution may be inaccurate" would frighten for nothing."""
    assert hx.estimate(small_problem(), hx.ConvexEstimator(PseudoHuber(0.8), backend="cvxpy")).ok.all()


def test_a_loss_of_ones_own_needs_a_unit():
    with pytest.raises(InputError, match=r"PseudoHuber\(threshold=1.5\) has a threshold in σ"):
        hx.ConvexEstimator(PseudoHuber(), weights=None)


def test_clarabel_does_not_take_a_loss_of_ones_own():
    with pytest.raises(InputError, match="write backend='cvxpy'"):
        hx.estimate(small_problem(None), hx.ConvexEstimator(PseudoHuber(), backend="clarabel"))


def test_the_defaults_of_a_loss_are_those_of_its_definition():
    """What PseudoHuber inherits (excess, weight, shrink, freed) is what Huber overrides."""

    class Plain(hx.Huber):
        excess, shrink, weight, freed, curved = Loss.excess, Loss.shrink, Loss.weight, Loss.freed, Loss.curved

    rng = np.random.default_rng(8)
    ours, plain = hx.Huber(), Plain()
    z = residuals(6, 3)
    u = inside(ours, rng)
    rows = rng.normal(size=(6, 3, 4))
    np.testing.assert_allclose(plain.excess(z, u), ours.excess(z, u), rtol=1e-10)
    np.testing.assert_allclose(plain.weight(z), ours.weight(z), rtol=1e-14)
    np.testing.assert_array_equal(plain.curved(z, rows), ours.curved(z, rows))
    np.testing.assert_array_equal(plain.freed(z, u, rows), ours.freed(z, u, rows))
    rim = ours.psi(z) * (1 + 1e-6)  # duals leave their domain by rounding, not by far
    assert 1 - 4e-6 <= plain.shrink(rim) <= ours.shrink(rim) < 1


# --- moments under normal noise -----------------------------------------------------------------------------


def huber_moments(t):
    """Eψ′ and Eψ² of Huber's loss: P(|z| ≤ t), and E min(z², t²)."""
    within = erf(t / np.sqrt(2))
    density = np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi)
    return within, within - 2 * t * density + t**2 * (1 - within)


def group_huber_moments(t, d):
    """Eψ′ and Eψ² of one row of blocks of d rows, by the chi distribution of their length."""
    length = chi(d)
    within, beyond = length.cdf(t), length.sf(t)
    inner = chi(d + 2).cdf(t)  # E r²; r ≤ t is d P(χ²(d + 2) ≤ t²)
    shorter = 0.0 if d == 1 else chi(d - 1).sf(t) * _ratio(d)
    return within + (d - 1) / d * t * shorter, inner + t**2 * beyond / d


def _ratio(d):
    """E 1/r over r > t is this times P(χ(d − 1) > t)."""
    return gamma((d - 1) / 2) / (np.sqrt(2) * gamma(d / 2))


MOMENTS = [
    (hx.Quadratic(), 3, (1.0, 1.0)),
    (hx.Huber(), 3, huber_moments(1.345)),
    (hx.Huber(0.5), 1, huber_moments(0.5)),
    (hx.L1(), 3, (np.sqrt(2 / np.pi), 1.0)),
    (hx.L1(2.0), 1, (2 * np.sqrt(2 / np.pi), 4.0)),
    (hx.GroupHuber(), 3, group_huber_moments(2.5, 3)),
    (hx.GroupHuber(1.0), 2, group_huber_moments(1.0, 2)),
    (hx.GroupHuber(1.345), 1, huber_moments(1.345)),
    (hx.GroupL1(), 3, (2 / 3 * np.sqrt(2 / np.pi), 1 / 3)),
    (hx.GroupL1(3.0), 1, (3 * np.sqrt(2 / np.pi), 9.0)),
]


@pytest.mark.parametrize(("loss", "size", "expected"), MOMENTS, ids=repr)
def test_normal_moments_are_the_known_constants(loss, size, expected):
    np.testing.assert_allclose(normal_moments(loss, size), expected, rtol=1e-6)


def test_the_efficiencies_are_those_of_the_textbooks():
    """(Eψ′)²/Eψ²: 95 % of Huber's default, 2/π of least absolute values."""
    for loss, efficiency in ((hx.Huber(), 0.95), (hx.L1(), 2 / np.pi), (hx.Quadratic(), 1.0)):
        slope, square = normal_moments(loss, 1)
        np.testing.assert_allclose(slope**2 / square, efficiency, rtol=1e-3)


def test_normal_moments_of_a_loss_of_ones_own():
    rng = np.random.default_rng(9)
    z = rng.normal(size=(200_000, 1))
    loss = PseudoHuber()
    expected = (loss.psi_prime(z).mean(), np.square(loss.psi(z)).mean())
    np.testing.assert_allclose(normal_moments(loss, 3), expected, rtol=5e-3)


def test_a_loss_that_cannot_be_hashed_has_moments_too():
    """Such as a dataclass that is not frozen."""

    class Loose(hx.Huber):
        __hash__ = None

    assert normal_moments(Loose(1.345), 3) == normal_moments(hx.Huber(1.345), 3)
