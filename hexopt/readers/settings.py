"""The settings of reader and writer, declared once and checked by pydantic."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, InstanceOf, ValidationError, model_validator

from ..errors import HexoptError, InputError
from ..geometry import Hexapod, check_length_unit
from ..noise import Noise
from .orientation import QUATERNION, OrientationKind, orientation_kind

__all__ = ["OrientationSettings", "ReaderSettings", "checked"]

Settings = TypeVar("Settings", bound="OrientationSettings")


class OrientationSettings(BaseModel):
    """How orientations are written."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    orientation: str = QUATERNION
    angle_unit: Literal["deg", "rad"] | None = None

    @property
    def kind(self) -> OrientationKind:
        """Columns and conversion of the orientation."""
        return orientation_kind(self.orientation)

    @model_validator(mode="after")
    def _unit_where_needed(self) -> Self:
        if self.kind.has_angles and self.angle_unit is None:
            raise InputError(f"angle_unit: {self.orientation!r} has angles; say whether they are 'deg' or 'rad'")
        if not self.kind.has_angles and self.angle_unit is not None:
            raise InputError(f"angle_unit: {self.orientation!r} has no angles; leave the unit out")
        return self


class ReaderSettings(OrientationSettings):
    """How a file is to be understood."""

    length_unit: Annotated[str, BeforeValidator(lambda unit: check_length_unit("length_unit", unit))]
    columns: Mapping[str, str]
    nominal: InstanceOf[Hexapod] | None
    noise: InstanceOf[Noise] | None


def checked(kind: type[Settings], **values: Any) -> Settings:
    """Settings of a kind, or the first fault in them as an error of hexopt's."""
    try:
        return kind(**values)
    except ValidationError as error:
        fault = error.errors()[0]
        cause = fault.get("ctx", {}).get("error")
        if isinstance(cause, HexoptError):
            raise cause from None
        name = ".".join(str(part) for part in fault["loc"])
        raise InputError(f"{name}: {fault['msg'][:1].lower()}{fault['msg'][1:]}, got {fault['input']!r}") from None
