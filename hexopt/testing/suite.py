"""The contracts, one method each, of one estimator on one kind of target."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..arrays import Array
from ..errors import EstimationError, HexoptError, InputError
from ..geometry import Hexapod
from ..measurements import LegMeasurements, Lock
from ..noise import NormalNoise
from ..problem import LinearProblem
from ..result import Estimate, Status, estimate
from ..simulation import simulate_leg
from .helpers import Names, arrays_of, main_errors, main_values, raised
from .motions import Motion, ScaledNoise, base_motion, platform_motion, unit_change

__all__ = ["CLAIMS", "COMMON", "Suite", "TargetFactory"]

#: What an estimator may or may not promise; the other contracts hold for all.
CLAIMS = ("exact", "order", "scale", "frame", "rank")
COMMON = ("input", "repeat", "batch", "certificate", "proof", "throw", "few", "value")
GAP = 1e-8  # how close to the best objective a success must prove to be
N_SETS, BAD = 4, 2  # sets in a batch, and the one that is spoilt
KINDS = ("sandwich", "model", "residual", "posterior")

TargetFactory = Callable[[LegMeasurements], Any]


@dataclass(frozen=True)
class Suite:
    """The contracts of one estimator on one kind of target."""

    estimator: Any
    label: str
    lock: Lock
    factory: TargetFactory
    n_poses: int
    tolerance: float
    exactness: float
    robot: Hexapod
    seed: int

    def run(self, name: str) -> None:
        """One contract; whatever goes wrong is its breach."""
        try:
            getattr(self, f"_{name}")()
        except AssertionError as error:
            raise AssertionError(f"{self.estimator!r} on {self.label} breaks {name!r}: {error}") from None
        except Exception as error:
            what = " ".join(f"{type(error).__name__}: {error}".split())
            raise AssertionError(f"{self.estimator!r} on {self.label} breaks {name!r}: it raised {what}") from error

    # --- data and answers -------------------------------------------------------------------------

    def sets(self, noisy: bool = True) -> LegMeasurements:
        """A batch of sets of leg 3, with a noise model; its nominal is off where the loop asks nothing of it."""
        size = self.robot.size / 20
        length = 1e-3 * size / self.robot.gains[2]
        noise = NormalNoise(pose_covariance=np.diag([1e-3 * size] * 3 + [1e-5] * 3 + [length]) ** 2)
        nominal = self.robot.perturbed(0.1 * size, rng=self.seed).leg(3)
        if self.lock is Lock.LENGTH:  # which takes b as known
            nominal = nominal.replaced(platform_point=self.robot.leg(3).platform_point)
        data = simulate_leg(
            self.robot, 3, self.lock, self.n_poses, N_SETS, noise if noisy else None, nominal=nominal, rng=self.seed
        )
        return replace(data, noise=noise)

    def standing(self) -> LegMeasurements:
        """The batch with one set that stands still: all its poses are the first."""
        data = self.sets()
        position, rotation, length = (np.array(part) for part in (data.position, data.rotation, data.length))
        for part in (position, rotation, length):
            part[BAD] = part[BAD, :1]
        return replace(data, position=position, rotation=rotation, length=length)

    def fit(self, data: LegMeasurements) -> Estimate:
        """The estimate from a set, or from a batch."""
        result: Estimate = self.estimator.fit(self.factory(data))
        return result

    def agree(self, found: Estimate, expected: Mapping[str, Array], reference: Estimate, what: str) -> None:
        """Check that blocks are as expected, to a share of the standard errors of `reference`."""
        for name, values in expected.items():
            apart = np.abs(main_values(found)[name] - values).max()
            error = 1e-3 * self.robot.size / 20
            if reference.covariance is not None:
                error = main_errors(reference)[name]
            allowed = self.tolerance * error + 1e-9 * float(np.abs(values).max())
            assert apart <= allowed, f"{what} moves {name} by {apart:.1e}, allowed is {allowed:.1e}"

    def moved(self, motion: Motion, what: str) -> None:
        """Check that the answer moves with the frames and units in which the data are given."""
        data = self.sets()
        reference, found = self.fit(data), self.fit(motion.data(data))
        expected = {name: motion.block(name, values) for name, values in main_values(reference).items()}
        self.agree(found, expected, reference, what)

    # --- contracts that hold for all --------------------------------------------------------------

    def _input(self) -> None:
        target = self.factory(self.sets())
        before = {path: (array.copy(), array.flags.writeable) for path, array in arrays_of(target)}
        self.estimator.fit(target)
        after = dict(arrays_of(target))
        for path, (copy, writeable) in before.items():
            same = path in after and np.array_equal(copy, after[path], equal_nan=True)
            assert same, f"it changed the target's {path}"
            assert writeable == after[path].flags.writeable, f"it changed the flags of the target's {path}"

    def _repeat(self) -> None:
        target = self.factory(self.sets())
        one, two = self.estimator.fit(target), self.estimator.fit(target)
        for name in ("values", "codes", "covariance", "objective"):
            first, second = getattr(one, name), getattr(two, name)
            same = first is second is None or (np.asarray(first).tobytes() == np.asarray(second).tobytes())
            assert same, f"fitted again, its {name} differ"

    def _batch(self) -> None:
        data = self.sets()
        together = self.fit(data)
        size = together.parameters.size
        for name, shape in (("values", (N_SETS, size)), ("codes", (N_SETS,))):
            found = np.shape(getattr(together, name))
            assert found == shape, f"{N_SETS} problems of {size} unknowns gave {name} of shape {found}"
        for i in range(N_SETS):
            alone = self.fit(data[i])
            assert alone.values.shape == (size,), f"one problem gave values of shape {alone.values.shape}"
            assert int(alone.codes) == int(together.codes[i]), f"member {i} has another status alone"
            self.agree(together[i], main_values(alone), alone, f"the batch around it (member {i})")

    def _certificate(self) -> None:
        found = self.fit(self.sets())
        codes = {int(code) for code in np.ravel(found.codes)}
        assert codes <= {int(status) for status in Status}, f"of its codes {sorted(codes)} one is no Status"
        assert np.all(found.ok), f"easy problems end with the codes {sorted(codes)}"
        assert np.isfinite(found.values).all(), "a success has values that are not finite"
        gap, allowed = np.asarray(found.gap), GAP * (1 + np.abs(found.objective))
        worst = float(np.nanmax(np.abs(gap) / allowed, initial=0.0))
        assert worst <= 1, f"a success has a gap of {worst:.1e} times 1e-8·(1 + |objective|)"
        if found.covariance is None:
            assert found.covariance_kind, "there is neither a covariance nor a reason for none"
            return
        assert found.covariance_kind in KINDS, (
            f"covariance_kind {found.covariance_kind!r} is none of {', '.join(KINDS)}"
        )
        scale = np.sqrt(np.abs(np.diagonal(found.covariance, axis1=-2, axis2=-1)))
        scale = np.where(scale > 0, scale, 1.0)  # a fixed parameter has no variance
        scaled = found.covariance / scale[..., :, None] / scale[..., None, :]
        assert np.abs(scaled - np.swapaxes(scaled, -1, -2)).max() < 1e-6, "the covariance is not symmetric"
        assert np.linalg.eigvalsh(scaled).min() > -1e-6, "the covariance has a negative eigenvalue"

    def _proof(self) -> None:
        """An estimator that certifies must pass its own answer, and catch one that was tampered with."""
        certify = getattr(self.estimator, "certificate", None)
        if certify is None:
            return
        target = self.factory(self.sets())
        found = self.estimator.fit(target)
        assert np.all(certify(target, found).ok), "its certificate refuses its own answer"
        values = np.array(found.values)
        values[BAD] *= 1 + 1e-3
        ok = certify(target, replace(found, values=values)).ok
        passed = [i for i in range(N_SETS) if ok[i]]
        others = [i for i in range(N_SETS) if i != BAD]
        assert passed == others, f"with member {BAD} tampered with, the certificate passes {passed}, not {others}"
        values[BAD] = np.nan
        assert not certify(target, replace(found, values=values)).ok[BAD], "its certificate passes NaN"

    def _throw(self) -> None:
        data = self.sets()
        for throw in (None, True, False):
            for part in (data, data[0]):
                found = estimate(self.factory(part), self.estimator, throw)
                assert np.all(found.ok), f"throw={throw} changes a problem that succeeds"
        error = raised(InputError, object(), self.estimator)
        assert error is not None, "it takes any object: `accepts` is too wide"
        assert self.estimator.hint, "its hint is empty"
        assert self.estimator.hint in str(error), "the error for a wrong target lacks the hint"

    def _few(self) -> None:
        data = self.sets().poses([0])
        for throw in (None, False):
            error = raised(HexoptError, data, self.estimator, throw, self.factory)
            if error is None:  # priors and bounds may decide; where they do not, the members fail
                found = estimate(self.factory(data), self.estimator, throw=False)
                honest = found.decided or not np.any(found.ok)
                assert honest, f"one pose is too few, and throw={throw} raises nothing"
                error = raised(HexoptError, data[0], self.estimator, True, self.factory)
                assert error is not None or found.decided, "one pose is too few, and throw=True raises nothing"
            assert error is None or "\n" not in str(error), (
                f"the error for a single pose has several lines: {str(error)!r}"
            )

    def _value(self) -> None:
        assert pickle.loads(pickle.dumps(self.estimator)) == self.estimator, "it does not equal its pickled copy"
        text = repr(self.estimator)
        again = eval(text, {}, Names(self.estimator))
        assert again == self.estimator, f"{text} evaluates to something else"

    # --- contracts that an estimator may claim ----------------------------------------------------

    def _exact(self) -> None:
        found = self.fit(self.sets(noisy=False))
        assert np.all(found.ok), "exact readings end without success"
        kappa = np.where(np.isfinite(found.condition), found.condition, 0.0)
        allowed = np.maximum(100 * np.finfo(float).eps * kappa, self.exactness)
        truth = self.robot.leg(3)
        for name, values in main_values(found).items():
            unit = float(truth.gain) if name == "gain" else self.robot.size
            error = np.abs(values - truth.block(name)).max(axis=-1) / unit
            assert (error <= allowed).all(), f"without noise {name} is off by {error.max():.1e} of the robot's size"

    def _order(self) -> None:
        data = self.sets()
        reference = self.fit(data)
        for order in (np.arange(self.n_poses)[::-1], np.random.default_rng(self.seed).permutation(self.n_poses)):
            self.agree(self.fit(data.poses(order)), main_values(reference), reference, "another order of the poses")

    def _scale(self) -> None:
        self.moved(unit_change(self.robot.length_unit), "another length unit")
        problem = self.factory(self.sets())
        if not isinstance(problem, LinearProblem):
            return
        scale = np.geomspace(1e-4, 1e4, problem.parameters.size)
        noise = None if problem.noise is None else ScaledNoise(problem.noise, scale)
        scaled = replace(problem, matrix=problem.matrix * scale, noise=noise)
        reference, found = self.estimator.fit(problem), self.estimator.fit(scaled)
        found = replace(found, values=found.values * scale)
        self.agree(found, main_values(reference), reference, "another scale of the columns")

    def _frame(self) -> None:
        unit, size = self.robot.length_unit, self.robot.size
        self.moved(base_motion(unit, size), "another base frame")
        self.moved(platform_motion(unit, size), "another platform frame")

    def _rank(self) -> None:
        bad = self.standing()
        found, clean = self.fit(bad), self.fit(self.sets())
        failed = [i for i in range(N_SETS) if not found.ok[i]]
        assert failed == [BAD], f"of {N_SETS} sets only number {BAD} stands still, but {failed} fail"
        assert np.isnan(found.values[BAD]).all(), "a failed member has values that are not NaN"
        for i in set(range(N_SETS)) - {BAD}:
            self.agree(found[i], main_values(clean[i]), clean[i], f"the failed member beside it (member {i})")
        single = self.factory(bad[BAD])
        error = raised(EstimationError, single, self.estimator)
        assert error is not None, "a set that stands still raises nothing"
        assert "\n" not in str(error), "the error has several lines"
        assert getattr(error, "combinations", None), "the error names no unseen combination"
        assert not estimate(single, self.estimator, throw=False).ok, "throw=False makes a success of a failure"
        error = raised(EstimationError, self.factory(bad), self.estimator, True)
        assert error is not None, "throw=True lets a batch with a failed member pass"
