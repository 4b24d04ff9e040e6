"""Every check of the contract suite can fail: estimators broken on purpose, one contract each."""

from dataclasses import dataclass, replace
from itertools import count

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import EstimationError, InputError
from hexopt.testing import CLAIMS, check_estimator


@dataclass(frozen=True)
class Sound:
    """Least squares by another road; subclasses break one thing."""

    accepts = (hx.LinearProblem,)
    hint = "write estimate(loop.linear(), Sound())"

    def fit(self, target):
        return self.spoil(hx.LeastSquares(method="svd").fit(target), target)

    def spoil(self, found, target):
        return found


def with_values(found, values):
    return replace(found, values=values)


class ChangesItsInput(Sound):
    def fit(self, target):
        found = super().fit(target)
        object.__setattr__(target, "rhs", target.rhs * (1 + 1e-15))
        return found


class ChangesItsInputInPlace(Sound):
    def fit(self, target):
        found = super().fit(target)
        array = target.matrix
        while array.base is not None:  # the read-only view's owner can be written to
            array = array.base
        array.flat[0] += 1e-12
        return found


class ChangesFlags(Sound):
    def fit(self, target):
        object.__setattr__(target, "rhs", np.array(target.rhs))
        return super().fit(target)


COUNTER = count()


class RemembersTheLastCall(Sound):
    def spoil(self, found, target):
        return with_values(found, found.values + 1e-15 * next(COUNTER))


class RemembersInTheCovariance(Sound):
    def spoil(self, found, target):
        return replace(found, covariance=found.covariance * (1 + 1e-15 * next(COUNTER)))


class MixesTheBatch(Sound):
    def spoil(self, found, target):
        mixed = found.values - 1e-3 * found.values.mean(axis=0) if found.batch_shape else found.values
        return with_values(found, mixed)


class DropsTheBatch(Sound):
    def spoil(self, found, target):
        return found[0] if found.batch_shape else found


class GivesOneStatusForAll(Sound):
    def spoil(self, found, target):
        return replace(found, codes=np.array(0, dtype=np.int8))


class FailsAlone(Sound):
    def spoil(self, found, target):
        return found if found.batch_shape else replace(found, codes=np.array(hx.Status.INACCURATE))


class InventsAStatus(Sound):
    def spoil(self, found, target):
        return replace(found, codes=found.codes + 17)


class NeverSucceeds(Sound):
    def spoil(self, found, target):
        return replace(found, codes=found.codes + hx.Status.INACCURATE)


class SucceedsWithNaN(Sound):
    def fit(self, target):
        found = super().fit(target)
        values = np.array(found.values)
        values[..., -1] = np.nan  # a nuisance, so that no other contract sees it
        return with_values(found, values)


class HasALargeGap(Sound):
    def spoil(self, found, target):
        return replace(found, gap=found.gap + 1e-7 * (1 + found.objective))


class GivesNoReason(Sound):
    def spoil(self, found, target):
        return replace(found, covariance=None, covariance_kind="")


class InventsAKind(Sound):
    def spoil(self, found, target):
        return replace(found, covariance_kind="guess")


class HasAnAsymmetricCovariance(Sound):
    def spoil(self, found, target):
        covariance = np.array(found.covariance)
        covariance[..., 0, 1] *= 1.001
        covariance[..., 0, 1] += 1e-3 * np.sqrt(covariance[..., 0, 0] * covariance[..., 1, 1])
        return replace(found, covariance=covariance)


class HasAnIndefiniteCovariance(Sound):
    def spoil(self, found, target):
        covariance = np.array(found.covariance)
        covariance[..., 0, 1] = covariance[..., 1, 0] = 2 * np.sqrt(covariance[..., 0, 0] * covariance[..., 1, 1])
        return replace(found, covariance=covariance)


class TakesAnything(Sound):
    accepts = (object,)

    def fit(self, target):
        return super().fit(target if isinstance(target, hx.LinearProblem) else SPARE)


SPARE = hx.LinearProblem(np.eye(3), np.ones(3), hx.Parameters((hx.Block("base_point", 3, "cm"),)))


class HasNoHint(Sound):
    hint = ""


class GuessesFromOnePose(Sound):
    def fit(self, target):
        if target.matrix.shape[-2] >= target.matrix.shape[-1]:
            return super().fit(target)
        wide = hx.LinearProblem(
            np.broadcast_to(np.eye(target.parameters.size), (*target.batch_shape, *[target.parameters.size] * 2)),
            np.zeros((*target.batch_shape, target.parameters.size)),
            target.parameters,
        )
        return super().fit(wide)


class FailsAtLength(Sound):
    def fit(self, target):
        if target.matrix.shape[-2] < target.matrix.shape[-1]:
            raise InputError("too few poses\nsee the manual")
        return super().fit(target)


class LetsNumPySpeak(Sound):
    def fit(self, target):
        if target.matrix.shape[-2] < target.matrix.shape[-1]:
            np.linalg.inv(np.zeros((2, 2)))
        return super().fit(target)


class IsNoValue(Sound):
    def __eq__(self, other):
        return self is other

    def __hash__(self):
        return 0


class DoesNotPickle(Sound):
    def __reduce__(self):
        raise TypeError("no")


@dataclass(frozen=True, repr=False)
class HasAnEmptyRepr(Sound):
    power: int = 2

    def __repr__(self):
        return "HasAnEmptyRepr()" if self.power == 2 else "HasAnEmptyRepr(power=2)"


class IsBiased(Sound):
    def spoil(self, found, target):
        return with_values(found, found.values * (1 + 1e-8))


class PrefersTheFirstPose(Sound):
    """Weights the first block of rows more: exact without noise, and dependent on the order."""

    def fit(self, target):
        weight = np.ones(target.matrix.shape[-2])
        weight[: target.rows_per_block] = 10.0
        heavy = replace(target, matrix=weight[:, None] * target.matrix, rhs=weight * target.rhs)
        return super().fit(heavy)


class PenalisesLargeUnknowns(Sound):
    """Ridge regression without a unit: other scales of the columns, another answer."""

    def spoil(self, found, target):
        gram = np.swapaxes(target.matrix, -1, -2) @ target.matrix + 1e-9 * np.eye(target.parameters.size)
        values = np.linalg.solve(gram, np.swapaxes(target.matrix, -1, -2) @ target.rhs[..., None])[..., 0]
        return with_values(found, np.where(np.isnan(found.values), np.nan, values))


class PrefersAnAxis(Sound):
    """Trusts x more than y: exact without noise, but another base frame is another answer."""

    def fit(self, target):
        weight = np.tile([3.0, 1.0, 1.0], target.matrix.shape[-2] // 3) if target.rows_per_block == 3 else 1.0
        skewed = replace(
            target, matrix=(weight * np.swapaxes(target.matrix, -1, -2)).swapaxes(-1, -2), rhs=weight * target.rhs
        )
        return super().fit(skewed)


class TakesThePseudoInverse(Sound):
    """Fills what the data do not say with zeros, and calls it a success."""

    def spoil(self, found, target):
        values = (np.linalg.pinv(target.matrix) @ target.rhs[..., None])[..., 0]
        codes = np.zeros_like(found.codes)
        return replace(found, values=np.where(np.isnan(found.values), values, found.values), codes=codes)


class FailsTogether(Sound):
    def spoil(self, found, target):
        if np.all(found.ok):
            return found
        return replace(found, values=found.values * np.nan, codes=np.full_like(found.codes, hx.Status.RANK_DEFICIENT))


class ReturnsNumbersOnFailure(Sound):
    def spoil(self, found, target):
        return with_values(found, np.where(np.isnan(found.values), 0.0, found.values))


class DoesNotNameTheUnseen(Sound):
    def spoil(self, found, target):
        return replace(found, unseen=())


CASES = [
    (ChangesItsInput, "input", "it changed the target's rhs"),
    (ChangesItsInputInPlace, "input", "it changed the target's matrix"),
    (ChangesFlags, "input", "it changed the flags of the target's rhs"),
    (RemembersTheLastCall, "repeat", "fitted again, its values differ"),
    (RemembersInTheCovariance, "repeat", "fitted again, its covariance differ"),
    (MixesTheBatch, "batch", r"the batch around it \(member 0\) moves"),
    (DropsTheBatch, "batch", "gave values of shape"),
    (GivesOneStatusForAll, "batch", "gave codes of shape"),
    (FailsAlone, "batch", "member 0 has another status alone"),
    (InventsAStatus, "certificate", "one is no Status"),
    (NeverSucceeds, "certificate", "easy problems end with the codes"),
    (SucceedsWithNaN, "certificate", "values that are not finite"),
    (HasALargeGap, "certificate", "a success has a gap"),
    (GivesNoReason, "certificate", "neither a covariance nor a reason"),
    (InventsAKind, "certificate", "covariance_kind 'guess' is none of"),
    (HasAnAsymmetricCovariance, "certificate", "not symmetric"),
    (HasAnIndefiniteCovariance, "certificate", "negative eigenvalue"),
    (TakesAnything, "throw", "`accepts` is too wide"),
    (HasNoHint, "throw", "its hint is empty"),
    (GuessesFromOnePose, "few", "one pose is too few, and throw=None raises nothing"),
    (FailsAtLength, "few", "several lines"),
    (LetsNumPySpeak, "few", "it raised LinAlgError: Singular matrix"),
    (IsNoValue, "value", "does not equal its pickled copy"),
    (DoesNotPickle, "value", "it raised TypeError: no"),
    (lambda: HasAnEmptyRepr(3), "value", "evaluates to something else"),
    (IsBiased, "exact", "without noise platform_point is off by"),
    (PrefersTheFirstPose, "order", "another order of the poses moves platform_point"),
    (PenalisesLargeUnknowns, "scale", "another (length unit|scale of the columns) moves"),
    (PrefersAnAxis, "frame", "another base frame moves"),
    (TakesThePseudoInverse, "rank", r"only number 2 stands still, but \[\] fail"),
    (FailsTogether, "rank", r"only number 2 stands still, but \[0, 1, 2, 3\] fail"),
    (ReturnsNumbersOnFailure, "rank", "values that are not NaN"),
    (DoesNotNameTheUnseen, "rank", "names no unseen combination"),
]


def direct(data):
    return hx.loops.FixedDirection(data).linear()


def test_the_sound_estimator_passes():
    check_estimator(Sound())
    check_estimator(Sound(), direct, lock="direction")


@pytest.mark.parametrize(("make", "contract", "message"), CASES, ids=[str(case[2])[:40] for case in CASES])
def test_a_broken_estimator_is_found_out(make, contract, message):
    # only its own claim, so that the breach is found by the check that is meant for it
    claims = [contract] if contract in CLAIMS else []
    with pytest.raises(AssertionError, match=rf"on its target breaks '{contract}': .*{message}") as caught:
        check_estimator(make(), direct, lock="direction", claims=claims)
    assert "\n" not in str(caught.value)


def test_what_is_not_claimed_is_not_checked():
    for make, contract, _ in CASES:
        if contract in CLAIMS and make is not TakesThePseudoInverse:
            check_estimator(make(), direct, lock="direction", claims=[])


def test_throw_must_not_change_a_success(monkeypatch):
    """The suite looks at `estimate` itself, too."""

    def eager(target, estimator, throw=None):
        if throw:
            raise EstimationError("always")
        return estimator.fit(target)

    monkeypatch.setattr("hexopt.testing.suite.estimate", eager)
    with pytest.raises(AssertionError, match="breaks 'throw': it raised EstimationError: always"):
        check_estimator(Sound(), direct, lock="direction", claims=[])


def test_a_failure_that_throw_lets_pass_is_found(monkeypatch):
    def lenient(target, estimator, throw=None):
        if not isinstance(target, estimator.accepts):
            raise InputError(estimator.hint)
        return estimator.fit(target)

    monkeypatch.setattr("hexopt.testing.helpers.estimate", lenient)
    with pytest.raises(AssertionError, match="breaks 'rank': a set that stands still raises nothing"):
        check_estimator(Sound(), direct, lock="direction", claims=["rank"])


def test_unknown_claims_and_targets_say_what_to_do():
    with pytest.raises(InputError, match="claims: known are exact, order, scale, frame, rank; got speed"):
        check_estimator(Sound(), claims=["speed"])

    class TakesStrings(Sound):
        accepts = (str,)

    with pytest.raises(InputError, match="makes no str by itself; give target_factory=… and lock=…"):
        check_estimator(TakesStrings())
    with pytest.raises(InputError, match="rng"):
        check_estimator(Sound(), rng=None)


SEEN = []


class Recorder(Sound):
    def fit(self, target):
        SEEN.append(float(target.rhs.flat[0]))
        return super().fit(target)


def test_the_seed_decides_which_sets_are_drawn():
    firsts = []
    for seed in (0, 0, 1):
        SEEN.clear()
        check_estimator(Recorder(), direct, lock="direction", claims=[], rng=seed)
        firsts.append(SEEN[0])
    assert firsts[0] == firsts[1] != firsts[2]
