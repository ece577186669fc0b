"""Self-driving in CARLA, on a server that the user runs."""
