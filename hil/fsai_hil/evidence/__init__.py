"""Evidence that the AI side is safe: every reachable state of the supervisor and the gate, visited and checked.

`python -m fsai_hil.evidence` searches, prints figures and ends with status 1 when an invariant breaks or no safe end is
reached. This package is the one place in `hil` that knows the core's inside: it searches exactly that.
"""
