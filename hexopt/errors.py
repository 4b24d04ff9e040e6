"""Every error and warning of hexopt; each message says what came, what was expected, what to do."""

__all__ = [
    "EstimationError",
    "FileFormatError",
    "HexoptError",
    "InputError",
    "LockError",
    "MeasuringError",
    "NumericalWarning",
    "RankDeficientError",
    "SamplingError",
    "UnitError",
]


class HexoptError(Exception):
    """Base of all errors that hexopt raises on purpose."""


class InputError(HexoptError, ValueError):
    """An argument has a wrong shape, value or type."""


class UnitError(InputError):
    """A unit is unknown, missing, or does not match another one."""


class LockError(InputError):
    """The lock of a measurement set does not fit the loop equation or the method."""


class FileFormatError(InputError):
    """A file cannot be read: wrong columns, a truncated row, a missing key."""


class SamplingError(HexoptError, RuntimeError):
    """No (or hardly any) pose satisfies the lock within the limits."""


class EstimationError(HexoptError, RuntimeError):
    """An estimator did not reach a trustworthy answer for the one problem that it was given."""


class RankDeficientError(EstimationError):
    """The measurements do not determine all parameters.

    Attributes
    ----------
    combinations : tuple of str
        The unseen parameter combinations, by name.
    """

    def __init__(self, message: str, combinations: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.combinations = combinations

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.args[0], self.combinations)


class MeasuringError(HexoptError, RuntimeError):
    """A pose could not be measured, or what came is none; the poses before it are not lost.

    Attributes
    ----------
    state : SequentialState
        With all poses before.
    """

    def __init__(self, message: str, state: object = None) -> None:
        super().__init__(message)
        self.state = state

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.args[0], self.state)


class NumericalWarning(UserWarning):
    """An answer was computed, with fewer digits than the method can promise."""
