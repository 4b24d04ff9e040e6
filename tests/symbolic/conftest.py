"""What the tests of the symbolic room share: the loops, and one set of poses of each."""

import itertools

import pytest

import hexopt as hx

LOOPS = {
    "FixedDirection": ("direction", hx.loops.FixedDirection),
    "FixedLeg": ("leg", hx.loops.FixedLeg),
    "FixedLength": ("length", hx.loops.FixedLength),
    "LegLength": ("none", hx.loops.LegLength),
    "ReadLeg": ("leg", hx.loops.ReadLeg),
    "ReadLength": ("length", hx.loops.ReadLength),
}
SUBSETS = [
    (name, unknown)
    for name, (_, kind) in LOOPS.items()
    for count in range(1, len(kind.involved) + 1)
    for unknown in itertools.combinations(kind.involved, count)
]


def pytest_generate_tests(metafunc):
    if {"name", "unknown"} <= set(metafunc.fixturenames):
        metafunc.parametrize(("name", "unknown"), SUBSETS)


@pytest.fixture
def made():
    """Return a function: the loop `name` of a robot's leg under its own lock, and values that do not fit it."""

    def make(name, unknown, robot, n_sets=None):
        lock, kind = LOOPS[name]
        nominal = robot.perturbed(0.05 * robot.size, offsets=0.05 * robot.size, rng=2)
        data = hx.simulate_leg(robot, 3, lock, 5, n_sets, nominal=nominal, rng=1)
        loop = kind(data, unknown=unknown)
        return loop, loop.values(nominal.leg(3).replaced(gain=1.1 * nominal.leg(3).gain))

    return make
