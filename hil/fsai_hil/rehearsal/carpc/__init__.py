"""The car's PC rehearsed: the real systemd as process 1, our package on it, vcan0 and the simulated car as services."""
