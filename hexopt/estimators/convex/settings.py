"""Settings of an estimator, checked and made comparable."""

from __future__ import annotations

from typing import Any

from ...errors import InputError

__all__ = ["nested", "several"]


def several(name: str, value: Any, kind: type, example: str) -> tuple[Any, ...]:
    """One or several parts as a tuple."""
    parts = () if value is None else (value,) if isinstance(value, kind) else value
    if not isinstance(parts, (tuple, list)) or not all(isinstance(part, kind) for part in parts):
        raise InputError(f"{name}: expected {example}, or a list of such, got {value!r}")
    return tuple(parts)


def nested(value: Any) -> Any:
    """Nested lists as nested tuples, which can be compared."""
    return tuple(nested(part) for part in value) if isinstance(value, list) else value
