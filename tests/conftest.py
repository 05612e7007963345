"""What holds for all tests."""

from __future__ import annotations

from hypothesis import HealthCheck, settings

# How fast an example runs is the machine's affair.
settings.register_profile("fsai-vcu", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("fsai-vcu")
