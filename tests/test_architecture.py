"""Imports only go down, without cycles; `import hexopt` is light; studies use what is public.

DESIGN's table of rooms, as on a page: a module imports only what stands before it, lazily or not, for types or not.
Inside a room siblings may import each other, without a cycle.
"""

import ast
import inspect
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import hexopt

ROOT = Path(__file__).resolve().parents[1]
FLOORS = [
    ["errors", "arrays", "files", "rotations"],
    ["geometry", "robots", "noise", "measurements", "parameters"],
    ["kinematics", "numerics", "problem", "summaries", "result", "forward"],
    [
        "loops",
        "propagation",
        "information",
        "observing",
        "losses",
        "named",
        "priors",
        "constraints",
        "poses",
        "simulation",
        "pools",
    ],
    ["symbolic", "estimators", "selection"],
    ["sequential", "calibration", "readers", "plots", "report", "testing", "cli"],
]
PAGE = [room for floor in FLOORS for room in floor]
APART = [{"estimators", "selection"}]  # on one floor, and neither imports the other
HEAVY = ["scipy", "casadi", "cvxpy", "filterpy", "matplotlib", "pandas", "clarabel", "pyarrow", "joblib", "typer"]


def modules(root):
    """Return the source of every module of a package by its dotted name."""
    found = {}
    for path in sorted(root.rglob("*.py")):
        parts = path.relative_to(root.parent).with_suffix("").parts
        found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path.read_text(encoding="utf-8")
    return found


def imported(name, source, known, is_package):
    """Yield the modules of the package that a module imports anywhere, with the line."""
    top = name.partition(".")[0]
    home = name if is_package else name.rpartition(".")[0]

    def resolve(base, aliases):
        for alias in aliases:
            if (base, alias) != (top, "__version__"):
                yield f"{base}.{alias}" if f"{base}.{alias}" in known else base

    for node in ast.walk(ast.parse(source)):
        found: Iterator[str] = iter(())
        if isinstance(node, ast.Import):
            found = iter([alias.name for alias in node.names if alias.name.partition(".")[0] == top])
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                up = home.split(".")[: len(home.split(".")) - node.level + 1]
                base = ".".join([*up, *([base] if base else [])])
            if base.partition(".")[0] == top:
                found = resolve(base, [alias.name for alias in node.names])
        elif isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in (
            "import_module",
            "__import__",
        ):
            argument = node.args[0] if node.args else None
            if isinstance(argument, ast.Constant) and str(argument.value).partition(".")[0] == top:
                found = iter([str(argument.value)])
            elif not isinstance(argument, ast.Constant):
                found = iter(["?"])  # an import that cannot be followed
        for target in found:
            yield target, getattr(node, "lineno", 0)


def graph(sources):
    """Return who imports whom, by dotted name; the package's own lazy table is not followed."""
    packages = {name for name in sources if any(other.startswith(f"{name}.") for other in sources)}
    top = min(sources, key=len)
    return {
        name: [] if name == top else list(imported(name, source, sources, name in packages))
        for name, source in sources.items()
    }


def room(name):
    parts = name.split(".")
    return parts[1] if len(parts) > 1 else None


def breaches(sources):
    """Return every import that goes up, sideways or in a circle, and every room that has no place on the page."""
    problems = []
    edges = graph(sources)
    for name, targets in edges.items():
        here = room(name)
        if here is None:
            continue
        if here not in PAGE:
            problems.append(f"{name}: {here} has no floor")
            continue
        for target, line in targets:
            there = room(target)
            where = f"{name}:{line} imports {target}"
            if target == "?":
                problems.append(f"{name}:{line} imports what cannot be followed")
            elif there is None:
                problems.append(f"{where}: the package itself")
            elif there not in PAGE:
                problems.append(f"{where}: {there} has no floor")
            elif there != here and PAGE.index(there) >= PAGE.index(here):
                problems.append(f"{where}, which stands after it")
            elif any({here, there} == pair for pair in APART):
                problems.append(f"{where}: they must not know each other")
    return problems + circles({name: [target for target, _ in targets] for name, targets in edges.items()})


def circles(edges):
    """Return import circles among modules, found by walking depth first."""
    state, problems = {}, []

    def visit(name, path):
        state[name] = "open"
        for target in edges.get(name, []):
            if state.get(target) == "open":
                problems.append(" → ".join([*path[path.index(target) :], target]) if target in path else target)
            elif target not in state:
                visit(target, [*path, target])
        state[name] = "done"

    for name in edges:
        if name not in state:
            visit(name, [name])
    return problems


def shadowing(sources, public):
    """Return modules that, once imported, replace a public name of the package: its children of that name."""
    top = min(sources, key=len)
    return sorted(name for name in sources if name.rpartition(".")[0] == top and name.rpartition(".")[2] in public)


def private_use(source, public, members):
    """Return what a study takes from hexopt that is not public: names, modules, members of public modules."""
    tree = ast.parse(source)
    aliases, problems = {}, []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name == "hexopt":
                    aliases[alias.asname or "hexopt"] = None
                elif alias.name.startswith("hexopt."):
                    problems += [] if alias.name.removeprefix("hexopt.") in members else [alias.name]
                    aliases[alias.asname or "hexopt"] = alias.name.removeprefix("hexopt.") if alias.asname else None
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and (node.module or "").partition(".")[0] == "hexopt":
            inner = (node.module or "").partition(".")[2]
            allowed = public if not inner else members.get(inner, ())
            problems += [f"{node.module}.{alias.name}" for alias in node.names if alias.name not in allowed]
            aliases.update({a.asname or a.name: a.name for a in node.names if not inner and a.name in members})
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases:
            inner = aliases[node.value.id]
            allowed = public if inner is None else members[inner]
            if node.attr not in allowed:
                problems.append(f"hexopt.{inner + '.' if inner else ''}{node.attr}")
        if (
            isinstance(node, ast.Attribute)
            and isinstance(node.value, ast.Attribute)
            and isinstance(node.value.value, ast.Name)
            and aliases.get(node.value.value.id, "") is None
            and node.value.attr in members
            and node.attr not in members[node.value.attr]
        ):
            problems.append(f"hexopt.{node.value.attr}.{node.attr}")
    return sorted(set(problems))


def public_members():
    """Return the public modules of hexopt with their public names."""
    return {name: set(module.__all__) for name in hexopt.__all__ if inspect.ismodule(module := getattr(hexopt, name))}


# --- the package as it is


def test_imports_only_go_down():
    assert breaches(modules(ROOT / "hexopt")) == []


def test_no_module_bears_a_public_name():
    names = [name for name in hexopt.__all__ if not inspect.ismodule(getattr(hexopt, name))]
    assert shadowing(modules(ROOT / "hexopt"), names) == []


def test_studies_use_what_is_public():
    found = {
        name: private_use(source, set(hexopt.__all__), public_members())
        for name, source in modules(ROOT / "studies").items()
    }
    assert {name: problems for name, problems in found.items() if problems} == {}


@pytest.mark.parametrize(
    "statement",
    [
        "import hexopt",
        "import hexopt; dir(hexopt); hexopt.__version__",
        "from hexopt import robots; robots.left_hand()",
    ],
)
def test_import_is_light(statement):
    """In a fresh interpreter, none of the heavy libraries is loaded."""
    code = f"import sys; {statement}; print([name for name in {HEAVY!r} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


def test_a_whole_calibration_needs_no_heavy_library():
    code = (
        "import sys, hexopt as hx; robot = hx.robots.left_hand(); "
        "data = hx.simulate_leg(robot, 3, 'direction', 5, rng=0, noise=hx.UniformNoise(0.01, 1e-4, 0.01)); "
        "hx.calibrate(robot, data, hx.OneStep()).summary(); "
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip() == "[]", done.stdout + done.stderr


# --- the checks can fail

SMALL = {
    "hexopt": "from importlib import import_module",
    "hexopt.errors": "",
    "hexopt.arrays": "from .errors import InputError\nimport numpy as np",
    "hexopt.geometry": "from .leg import Leg\nfrom .robot import Robot",
    "hexopt.geometry.leg": "from ..arrays import Array",
    "hexopt.geometry.robot": "from .leg import Leg\nfrom ..errors import InputError",
    "hexopt.loops": "from .base import Loop",
    "hexopt.loops.base": "from ..geometry.leg import Leg\nfrom ..geometry import Robot",
    "hexopt.estimators": "",
    "hexopt.estimators.one": "from ..loops import Loop",
    "hexopt.selection": "from .loops import Loop\nfrom . import __version__",
}


def test_a_sound_package_passes():
    assert breaches(SMALL) == []


@pytest.mark.parametrize(
    ("name", "source", "problem"),
    [
        (
            "hexopt.arrays",
            "from .geometry import Leg",
            "hexopt.arrays:1 imports hexopt.geometry, which stands after it",
        ),
        ("hexopt.arrays", "from . import geometry", "hexopt.arrays:1 imports hexopt.geometry, which stands after it"),
        ("hexopt.arrays", "import hexopt.geometry", "hexopt.arrays:1 imports hexopt.geometry, which stands after it"),
        ("hexopt.arrays", "from hexopt.loops.base import Loop", "imports hexopt.loops.base, which stands after it"),
        ("hexopt.arrays", "def f():\n    from .loops import Loop", "hexopt.arrays:2 imports hexopt.loops, which"),
        (
            "hexopt.arrays",
            "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from .loops import Loop",
            "hexopt.arrays:3 imports hexopt.loops, which stands after it",
        ),
        ("hexopt.arrays", "import importlib\nimportlib.import_module('hexopt.loops')", "arrays:2 imports hexopt.loops"),
        ("hexopt.arrays", "from importlib import import_module\nimport_module(x)", "imports what cannot be followed"),
        ("hexopt.arrays", "import hexopt", "imports hexopt: the package itself"),
        ("hexopt.arrays", "from hexopt import Leg", "imports hexopt: the package itself"),
        (
            "hexopt.geometry.leg",
            "from .robot import Robot",
            "hexopt.geometry.leg → hexopt.geometry.robot → hexopt.geometry.leg",
        ),
        (
            "hexopt.geometry.leg",
            "def f():\n    from . import Robot",
            "hexopt.geometry → hexopt.geometry.leg → hexopt.geometry",
        ),
        ("hexopt.estimators.one", "from ..selection import choose", "which stands after it"),
        ("hexopt.selection", "from .estimators.one import One", "they must not know each other"),
        ("hexopt.extras", "", "hexopt.extras: extras has no floor"),
    ],
)
def test_a_doctored_package_fails(name, source, problem):
    assert any(problem in found for found in breaches({**SMALL, name: source})), breaches({**SMALL, name: source})


def test_a_module_with_a_public_functions_name_fails():
    public = ["Leg", "estimate", "one"]
    assert shadowing({**SMALL, "hexopt.estimate": ""}, public) == ["hexopt.estimate"]
    assert shadowing(SMALL, public) == []  # hexopt.estimators.one replaces nothing of hexopt


PUBLIC = {"estimate", "Leg", "loops"}
MEMBERS = {"loops": {"FixedLeg"}}


@pytest.mark.parametrize(
    "source",
    [
        "import hexopt as hx\nhx.estimate\nhx.loops.FixedLeg",
        "import hexopt\nhexopt.Leg",
        "from hexopt import Leg, loops\nloops.FixedLeg",
        "from hexopt.loops import FixedLeg",
        "import hexopt.loops\nhexopt.loops.FixedLeg",
        "import numpy as np\nnp.linalg._umath_linalg",
        "from .harness import sweep",
    ],
)
def test_public_use_passes(source):
    assert private_use(source, PUBLIC, MEMBERS) == []


@pytest.mark.parametrize(
    ("source", "problem"),
    [
        ("import hexopt as hx\nhx.problem.Whitening", "hexopt.problem"),
        ("import hexopt as hx\nhx.loops.base", "hexopt.loops.base"),
        ("from hexopt import problem", "hexopt.problem"),
        ("from hexopt.problem import LinearProblem", "hexopt.problem.LinearProblem"),
        ("from hexopt.loops import base", "hexopt.loops.base"),
        ("from hexopt.loops.base import Loop", "hexopt.loops.base.Loop"),
        ("import hexopt.result", "hexopt.result"),
        ("from hexopt import loops\nloops.cross_columns", "hexopt.loops.cross_columns"),
        ("def f():\n    import hexopt.numerics.lstsq as l", "hexopt.numerics.lstsq"),
    ],
)
def test_private_use_fails(source, problem):
    assert problem in private_use(source, PUBLIC, MEMBERS)
