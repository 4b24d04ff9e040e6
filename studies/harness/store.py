"""The folder of a sweep: a manifest of its configuration, and one Parquet file for each chunk.

    OUT/manifest.json                    what was asked for, by which code
    OUT/runs.jsonl                       a line for each run that wrote here: when, how long, how
    OUT/chunks/SCENARIO-HASH/00000.parquet

A chunk is written beside its place and renamed, so what has a chunk's name is a whole chunk.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from studies.harness.identity import source_of, versions
from studies.harness.study import Study, StudyError, chunks_of, definition_of, digest, stream_of
from studies.harness.task import METADATA

try:
    import fcntl
except ImportError:  # Windows has no such lock: there, two runs into one folder are the user's to avoid
    fcntl = None  # type: ignore[assignment]

FORMAT = 1
Manifest = dict[str, Any]
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ChunkFile:
    """The place of one chunk, and what its file must say of itself (`Task.label`)."""

    path: Path
    label: dict[str, Any]

    def read(self, columns: list[str] | None = None) -> pa.Table:
        """The rows; raises `ValueError` or `OSError` when the file is damaged or is that of another chunk."""
        with pq.ParquetFile(self.path, page_checksum_verification=True) as file:
            if json.loads((file.schema_arrow.metadata or {}).get(METADATA, b"{}")) != self.label:
                raise StaleChunkError(f"{self.path} is the chunk of another configuration or size")
            return file.read(columns=columns, use_threads=False)

    def is_whole(self) -> bool:
        """Whether the chunk stands, readable to its last page; a damaged one leaves a note in the log."""
        try:
            self.read()
        except FileNotFoundError:
            return False
        except StaleChunkError:
            return False
        except (OSError, ValueError) as error:
            reason = str(error).partition("\n")[0]
            _log.warning("note: %s is damaged and will be made again (%s)", self.path, reason)
            return False
        return True

    def write(self, data: bytes) -> None:
        """Write the whole file or nothing."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        replace(self.path, data)


class StaleChunkError(ValueError):
    """A chunk file is sound, but not the one that the manifest asks for."""


def replace(path: Path, data: bytes) -> None:
    """Give `path` this content, in one step."""
    temporary = path.with_suffix(".tmp")
    temporary.write_bytes(data)
    temporary.replace(path)


def chunk_files(out: Path, manifest: Manifest) -> Iterator[ChunkFile]:
    """Every chunk that a manifest asks for, present or not, in the order in which results are read."""
    for key, scenario in manifest["scenarios"].items():
        slug = re.sub(r"[^A-Za-z0-9.=_+-]+", "_", key)[:60].strip(".") or "_"
        folder = out / "chunks" / f"{slug}-{scenario['stream']:016x}"
        for chunk, sets in chunks_of(scenario["sets"], manifest["chunk_size"]):
            label = {"fingerprint": scenario["fingerprint"], "key": key, "chunk": chunk, "sets": sets}
            yield ChunkFile(folder / f"{chunk:05d}.parquet", label)


def plan(study: Study[Any], sets: int, seed: int) -> Manifest:
    """The manifest of a study that nothing was run of yet."""
    configuration: Manifest = {
        "format": FORMAT,
        "study": study.name,
        "seed": seed,
        "chunk_size": study.chunk_size,
        "versions": {**versions(study.packages), "study source": source_of(study.run)},
    }
    scenarios = {}
    for key, scenario in study.keyed().items():
        definition = definition_of(scenario)
        scenarios[key] = {
            "sets": sets,
            "stream": stream_of(key),
            "fingerprint": digest([configuration, definition]),
            "definition": definition,
        }
    return configuration | {"configuration": digest(configuration), "scenarios": scenarios}


def read_manifest(out: str | Path) -> Manifest:
    """The manifest of a finished or unfinished sweep."""
    path = Path(out) / "manifest.json"
    try:
        manifest: Manifest = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise StudyError(f"{out} holds no sweep: there is no {path}") from None
    except ValueError as error:
        raise StudyError(f"{path} is damaged ({error}): delete {out}, or choose another --out") from None
    return manifest


def claim(out: Path, asked: Manifest, resume: bool) -> Manifest:
    """Write the manifest of what is `asked`, merged into the one that stands; refuse to mix configurations."""
    started = any((out / "chunks").glob("*/*.parquet"))
    if started:
        held = read_manifest(out)
        if differences := list(_differences(held, asked)):
            more = f"; and {len(differences) - 3} more" if len(differences) > 3 else ""
            raise StudyError(
                f"{out} holds another configuration ({'; '.join(differences[:3])}{more}): choose another --out, or "
                f"delete {out}"
            )
        if not resume:
            raise StudyError(f"{out} holds chunks already: add --resume to go on, choose another --out, or delete it")
        asked = asked | {"scenarios": held["scenarios"] | asked["scenarios"]}
    text = json.dumps(asked, indent=2, ensure_ascii=False) + "\n"
    replace(out / "manifest.json", text.encode())
    return asked


def _differences(held: Manifest, asked: Manifest) -> Iterator[str]:
    for name in ("format", "study", "seed", "chunk_size"):
        if held.get(name) != asked[name]:
            yield f"{name} {held.get(name)!r}, not {asked[name]!r}"
    for name, version in asked["versions"].items():
        if (had := held.get("versions", {}).get(name)) != version:
            yield f"{name} {had}, not {version}"
    for key, scenario in asked["scenarios"].items():
        had = held.get("scenarios", {}).get(key, scenario)
        if digest(had["definition"]) != digest(scenario["definition"]):  # NaN is equal to itself here
            yield f"scenario {key!r} is defined otherwise"
        elif had["sets"] > scenario["sets"]:
            yield f"{had['sets']} sets of {key!r}, and --sets {scenario['sets']} would take some away"


@contextlib.contextmanager
def locked(out: Path) -> Iterator[None]:
    """Make the folder, and keep other runs out of it; the lock of a killed run is gone with it."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock = (out / ".lock").open("w")
    except OSError as error:
        raise StudyError(f"cannot write to {out}: {os.strerror(error.errno or 0)}") from None
    with lock:
        if fcntl is not None:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise StudyError(f"another run is writing to {out}: wait for it, or choose another --out") from None
        yield
