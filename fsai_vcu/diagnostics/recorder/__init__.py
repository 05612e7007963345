"""Recording that a power cut does not hurt: segments on a disk that never fills, a listener that never waits for it."""
