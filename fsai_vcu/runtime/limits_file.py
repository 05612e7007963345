"""The operational limits' file: one small TOML, imposed by an official for a venue.

max_speed_mps = 5.0
max_axle_torque_nm = 100
max_steer_deg = 20
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from fsai_vcu.core.limits import LimitsError, OperationalLimits, parse_limits


def read_limits(path: Path | str) -> OperationalLimits:
    """Raises LimitsError with one clear line that names the file."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise LimitsError(f"cannot read the operational limits {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise LimitsError(f"the operational limits {path} are not a text file") from error
    try:
        return parse_limits(tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise LimitsError(f"the operational limits {path} are not valid TOML: {error}") from error
    except LimitsError as error:
        raise LimitsError(f"the operational limits {path}: {error}") from error
