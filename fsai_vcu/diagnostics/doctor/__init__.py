"""State of this machine, right or wrong: collected once, judged by pure functions, shown on one screen."""
