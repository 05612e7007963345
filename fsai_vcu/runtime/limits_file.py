"""The operational limits' file: one small TOML, imposed by an official for a venue.

max_speed_mps = 5.0
max_axle_torque_nm = 100
max_steer_deg = 20
"""

from __future__ import annotations

from pathlib import Path

from fsai_vcu.core.limits import LimitsError, OperationalLimits, parse_limits
from fsai_vcu.files import SETTINGS_BYTES, read_named
from fsai_vcu.runtime.toml_lines import TomlLines, line_of, parse_toml, tomllib, words_of


def read_limits(path: Path | str) -> OperationalLimits:
    """Read the operational limits. Raises LimitsError with one clear line that names the file, and the line in it."""
    return limits_in(read_limits_text(path), path)


def read_limits_text(path: Path | str) -> str:
    """Return the text of the file. Raises LimitsError."""
    try:
        return read_named(path, SETTINGS_BYTES)
    except UnicodeDecodeError as error:
        raise LimitsError(f"the operational limits {path} are not a text file") from error
    except (OSError, ValueError) as error:  # a name with a NUL in it is a ValueError
        why = getattr(error, "strerror", None) or error
        raise LimitsError(f"cannot read the operational limits {path}: {why}") from error


def limits_in(text: str, path: Path | str) -> OperationalLimits:
    """Read the operational limits as `read_limits`, of a text as if from `path`."""
    try:
        mapping = parse_toml(text)
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
