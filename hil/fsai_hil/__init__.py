"""The far end of the bus: the simulated VCU and car, the rules on the wire, the evidence, the rehearsals."""

from pathlib import Path
from typing import Final

CHECKOUT: Final = Path(__file__).resolve().parents[2]
"""The source checkout, where this is one: the HIL suite, the units and the mutation tester's tests are in no wheel."""
