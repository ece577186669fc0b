"""The few rules over physical parameters that say how an agent fails."""
