"""The racing world: tracks, gates, drones, and the rules of a race."""
