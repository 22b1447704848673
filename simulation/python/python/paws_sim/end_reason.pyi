from enum import IntEnum

class EndReason(IntEnum):
    """Codes of `info["end_reason"]`: 1 to 9 terminated, from 10 on truncated by default; 0 is no
    end."""

    NONE = 0
    GOAL = 1
    FALL = 2
    COLLISION = 3
    TIME_LIMIT = 10
    DEVIATION = 11
    LEFT_MAP = 12
    UNKNOWN_GROUND = 13
    PHYSICS_FAULT = 14
