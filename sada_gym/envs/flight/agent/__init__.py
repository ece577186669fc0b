"""The flight's agent: the autopilots in JSBSim's aircraft files."""
