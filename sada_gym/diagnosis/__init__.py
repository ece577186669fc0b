"""The diagnosis: the few rules over physical parameters that say how an agent fails."""
