"""The world of the quadrotor: a rigid body, its motors, the air and the reference."""
