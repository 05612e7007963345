"""The software between a Formula Student AI stack and the ADS-DV's vehicle control unit (VCU)."""
