"""The estimators keep the contract of `hexopt.testing`, on every kind of target that they take."""

import pytest

import hexopt as hx
from hexopt.robots import BUILT_IN
from hexopt.testing import CLAIMS, check_estimator

LEAST_SQUARES = [
    hx.LeastSquares(method, weights) for method in ("auto", "svd", "normal") for weights in (None, "model")
]
CONVEX = [hx.ConvexEstimator(), hx.ConvexEstimator(weights=None)]
KINEMATIC = [hx.InverseKinematics(), hx.InverseKinematics(weights="model"), hx.InverseKinematics(max_iterations=50)]
FORMS = [
    ("direction", "consecutive", hx.loops.FixedDirection),
    ("leg", "consecutive", hx.loops.FixedLeg),
    ("leg", "centred", hx.loops.FixedLeg),
    ("length", "consecutive", hx.loops.FixedLength),
    ("length", "centred", hx.loops.FixedLength),
]
pytestmark = pytest.mark.filterwarnings("ignore:normal equations")


@pytest.mark.parametrize("estimator", LEAST_SQUARES, ids=repr)
def test_least_squares(estimator):
    check_estimator(estimator, exactness=1e-7 if estimator.method == "normal" else 1e-9, tolerance=1e-5)


@pytest.mark.parametrize("estimator", CONVEX, ids=repr)
def test_convex(estimator):
    check_estimator(estimator, exactness=1e-7, tolerance=1e-5)


@pytest.mark.parametrize("backend", ["auto", "clarabel", "cvxpy"])
@pytest.mark.parametrize("loss", [hx.Huber(), hx.GroupHuber(), hx.L1(), hx.GroupL1(), hx.Chebyshev()], ids=repr)
def test_losses_of_the_family(loss, backend):
    """Losses per row see the axes of the frames, so that a turn changes their answer; losses per pose do not."""
    claims = [claim for claim in CLAIMS if claim != "frame" or loss.per == "pose"]
    nonsmooth = {} if loss.smooth else {"exactness": 1e-6, "tolerance": 1e-4}
    check_estimator(
        hx.ConvexEstimator(loss, backend=backend), claims=claims, **({"exactness": 1e-7, "tolerance": 1e-4} | nonsmooth)
    )


def near(name, width=0.5):
    """A nominal near the truth of leg 3, as an argument of priors and bounds."""
    return hx.robots.left_hand().leg(3).replaced(**{name: hx.robots.left_hand().leg(3).block(name) + 0.01 * width})


HELD = [
    {"prior": hx.GaussianPrior.around(near("base_point"), 0.1)},
    {"prior": hx.Ridge.around(near("base_point"), 100.0)},
    {"prior": hx.Lasso.around(near("base_point"), 10.0)},
    {"prior": hx.Lasso.around(near("base_point"), 10.0, by="entry")},
    {"bounds": hx.Box.around(near("base_point"), 0.001)},
    {"bounds": hx.Ball.around(near("base_point"), 0.001)},
    {"bounds": hx.Linear({"platform_point": [1.0, 1.0, 0.0]}, lower=-100.0, upper=6.77)},
    {"bounds": hx.Linear({"platform_point": [0.0, 0.0, 1.0]}, equal=0.0)},
]


@pytest.mark.parametrize("loss", [hx.Quadratic(), hx.GroupHuber()], ids=repr)
@pytest.mark.parametrize("settings", HELD, ids=lambda settings: type(next(iter(settings.values()))).__name__)
def test_priors_and_bounds_of_the_family(loss, settings):
    """They stay where they are when frames and units move, and make up for missing poses."""
    for kind, lock in ((hx.loops.FixedDirection, "direction"), (hx.loops.FixedLeg, "leg")):
        check_estimator(
            hx.ConvexEstimator(loss, **settings),
            lambda data, kind=kind: kind(data).linear(),
            lock=lock,
            claims=("order",),
            tolerance=1e-4,
        )


@pytest.mark.parametrize("inner", [hx.LeastSquares(weights="model"), hx.ConvexEstimator(hx.GroupHuber())], ids=repr)
def test_reweighted(inner):
    check_estimator(hx.Reweighted(inner), exactness=1e-7, tolerance=1e-3)


@pytest.mark.parametrize("estimator", KINEMATIC, ids=repr)
@pytest.mark.parametrize("unknown", [2, 3, 4])
def test_inverse_kinematics(estimator, unknown):
    names = hx.loops.LegLength.involved[:unknown]
    check_estimator(estimator, lambda data: hx.loops.LegLength(data, unknown=names), n_poses=14, tolerance=1e-5)


def test_inverse_kinematics_by_default():
    check_estimator(hx.InverseKinematics(), n_poses=14)


def test_inverse_kinematics_with_a_start_of_its_own():
    """It stays where it is when frames and units move, and claims no more."""
    leg = hx.robots.left_hand().leg(3)
    start = leg.replaced(base_point=leg.base_point + 0.1)
    check_estimator(hx.InverseKinematics(start=start), n_poses=14, claims=("exact", "order", "rank"))


@pytest.mark.parametrize("estimator", [*LEAST_SQUARES[:4], hx.ConvexEstimator()], ids=repr)
@pytest.mark.parametrize(("lock", "form", "kind"), FORMS)
def test_other_forms(estimator, lock, form, kind):
    """Consecutive rows depend on the order of the poses; weights too, through the solution they are taken at."""
    claims = [claim for claim in CLAIMS if form != "consecutive" or claim != "order"]
    check_estimator(
        estimator, lambda data: kind(data).linear(form), lock=lock, claims=claims, tolerance=1e-4, exactness=1e-7
    )


@pytest.mark.parametrize("lock", list(hx.Lock))
def test_offset_alone_under_every_lock(lock):
    def offset(data):
        leg = BUILT_IN["left-hand"]().leg(3)
        if data.length_unit != "cm":
            leg = hx.Leg(3, 10 * leg.platform_point, 10 * leg.base_point, 10 * leg.offset, leg.gain, "mm")
        return hx.loops.LegLength(
            data, unknown="offset", platform_point=leg.platform_point, base_point=leg.base_point
        ).linear()

    claims = ["exact", "order", "scale"]  # known points stay where they are when frames move; one pose is enough
    with pytest.raises(AssertionError, match="breaks 'few': one pose is too few"):
        check_estimator(hx.LeastSquares(), offset, lock=lock, claims=claims)


@pytest.mark.parametrize("robot", sorted(BUILT_IN))
def test_on_every_robot(robot):
    model = BUILT_IN[robot]()
    check_estimator(hx.LeastSquares(), robot=model, tolerance=1e-3 if robot == "rubin" else 1e-6)
    check_estimator(hx.LeastSquares(weights="model"), robot=model, tolerance=1e-3 if robot == "rubin" else 1e-6)
