"""What is right and what is wrong on this machine: collected once, judged by pure functions, shown on one screen."""
