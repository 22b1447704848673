"""Why episodes end. Names and codes are those of the core; the stub beside this file has them for
type checkers."""

from __future__ import annotations

from enum import IntEnum

from . import _core

EndReason = IntEnum("EndReason", _core.END_REASONS, module=__name__)
EndReason.__doc__ = (
    """Codes of `info["end_reason"]`: 1 to 9 terminated, from 10 on truncated by default; 0 is no
    end."""
)
