"""The look of the figures: that of the studies, whose colours colour-blind readers tell apart."""

from typing import Any

from studies.harness.figures import use_style


def reset(gallery_conf: dict[str, Any], fname: str) -> None:
    """Before each example."""
    use_style()
