"""Benchmarks of speed (beside what everybody would take instead), planning and control: `python -m fsai_hil.bench`."""
