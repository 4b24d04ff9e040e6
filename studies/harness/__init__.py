"""The engine of the studies: sweeps that may be killed, resumed and spread out, with the same rows to the bit.

README.md, beside this file, shows a study of your own in thirty lines.
"""

from studies.harness.driver import Run, sweep
from studies.harness.results import aggregate, iter_chunks, load
from studies.harness.store import read_manifest
from studies.harness.study import Study, StudyError, generator
from studies.harness.task import TaskError, rerun

__all__ = [
    "Run",
    "Study",
    "StudyError",
    "TaskError",
    "aggregate",
    "generator",
    "iter_chunks",
    "load",
    "read_manifest",
    "rerun",
    "sweep",
]
