"""Why episodes end. Names and codes are those of the core; the stub beside this file has them for
type checkers."""

from __future__ import annotations

from enum import IntEnum

from . import _core

EndReason = IntEnum("EndReason", _core.END_REASONS, module=__name__)
EndReason.__doc__ = (
    """Codes of `info["end_reason"]`: below 10 terminated, others truncated by default."""
)
