import hashlib
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))  # for toy_study, here and in loky's workers


@pytest.fixture
def contents():
    """A function to the hashes of all chunks of a sweep."""

    def read(out):
        root = Path(out) / "chunks"
        files = sorted(path for path in root.rglob("*") if path.is_file())
        return {path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}

    return read
