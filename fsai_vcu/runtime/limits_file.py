"""The operational limits' file: one small TOML, imposed by an official for a venue.

max_speed_mps = 5.0
max_axle_torque_nm = 100
max_steer_deg = 20
"""

from __future__ import annotations

from pathlib import Path

from fsai_vcu.core.limits import LimitsError, OperationalLimits, parse_limits
from fsai_vcu.runtime.toml_lines import TomlLines, line_of, tomllib, words_of


def read_limits(path: Path | str) -> OperationalLimits:
    """Raises LimitsError with one clear line that names the file, and the line in it."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise LimitsError(f"cannot read the operational limits {path}: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise LimitsError(f"the operational limits {path} are not a text file") from error
    try:
        mapping = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        place = _place(line_of(error))
        raise LimitsError(f"the operational limits {path}{place} are not valid TOML: {words_of(error)}") from error
    for name, value in mapping.items():
        try:
            parse_limits({name: value})
        except LimitsError as error:
            raise LimitsError(f"the operational limits {path}{_place(TomlLines(text).of(name))}: {error}") from error
    return parse_limits(mapping)


def _place(line: int | None) -> str:
    return "" if line is None else f", line {line}"
