"""The flight's world: JSBSim with an aircraft of its own."""
