"""The warehouse, the robot that drives in it, and its lidar."""
